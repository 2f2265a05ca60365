"""Who is heard where in a prediction, with what walls, and what was measured of it.

What if: materials changed before a prediction.

How the sources of a prediction radiate, where the campaign leaves that to a fit.

A room traced as far as its decay is to be predicted, with or without a measurement.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from roomfit import eyring
from roomfit._checks import nearest
from roomfit.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.bands import Bands
from roomfit.cache import Cache
from roomfit.errors import InputError, located
from roomfit.findings import Code, Finding
from roomfit.geometry.mesh import refuse, surface_area_m2, volume_m3
from roomfit.inversion.compare import predicted_curve
from roomfit.inversion.scattering import band_factors, specified_scattering
from roomfit.inversion.trace_plan import cached_trace, plan_trace
from roomfit.io.campaign import Campaign
from roomfit.io.iso3382 import read_parameters
from roomfit.io.materials import campaign_directivities, unknown_directivity
from roomfit.io.measurements import measure
from roomfit.logit import expit
from roomfit.materials.catalogue import catalogue_prior
from roomfit.materials.priors import MaterialPrior, logit_prior
from roomfit.objective.room_parameters import values_at
from roomfit.response.binned import BinnedPaths, bin_paths
from roomfit.response.directivity import Directivity, FirstOrderBands
from roomfit.scene import Room, Scene, distances_m, material_areas_m2, position_findings
from roomfit.signals.decay import DecayCurve
from roomfit.signals.iso3382 import VALUE_NAMES
from roomfit.tracing.paths import TraceSettings
from roomfit.typing import BoolArray, FloatArray, Progress, part
from roomfit.uncertainty.posterior import AbsorptionPosterior

_NEEDED = "MATERIAL=0.3, 0.3+-0.05, one value per band, x1.5+-0.2, or a name of the catalogue"
_NUMBER = r"(\d+\.?\d*|\.\d+)"
_VALUE = re.compile(rf"^(x?){_NUMBER}(?:(?:\+-|±){_NUMBER})?$")


@dataclass(frozen=True, slots=True)
class Change:
    """Another absorption for one material.

    Attributes
    ----------
    material : str
    kind : {"value", "factor", "catalogue"}
        A new absorption, a factor on the one that was found, or an entry of the catalogue.
    values, sds : tuples of float
        For all bands together, or one a band, and their standard deviations.
    entry : str
        Name in the catalogue.
    """

    material: str
    kind: Literal["value", "factor", "catalogue"]
    values: tuple[float, ...] = ()
    sds: tuple[float, ...] = ()
    entry: str = ""


def read_change(text: str) -> Change:
    """Return a change as it is written on the command line.

    Examples
    --------
    >>> read_change("ceiling=0.3+-0.05,0.6")
    Change(material='ceiling', kind='value', values=(0.3, 0.6), sds=(0.05, 0.0), entry='')

    Raises
    ------
    InputError
        It is not written so.
    """
    material, sign, specified = (part.strip() for part in text.partition("="))
    if not (material and sign and specified):
        raise InputError("a change is not written as it must be", found=repr(text), needed=_NEEDED)
    found = [_VALUE.match(part.replace(" ", "")) for part in specified.split(",")]
    matches = [m for m in found if m is not None]
    if not matches:
        return Change(material, "catalogue", entry=specified)
    factors = {m[1] for m in matches}
    if len(matches) != len(found) or len(factors) != 1:
        raise InputError("a change is not written as it must be", found=repr(text), needed=_NEEDED)
    values = tuple(float(m[2]) for m in matches)
    sds = tuple(float(m[3] or 0.0) for m in matches)
    return Change(material, "factor" if factors == {"x"} else "value", values, sds)


def change_text(change: Change) -> str:
    """Return a change in the words of the command line."""
    if change.kind == "catalogue":
        return f"{change.material}={change.entry}"
    mark = "x" if change.kind == "factor" else ""
    values = [
        f"{mark}{v:g}" + (f"+-{sd:g}" if sd else "")
        for v, sd in zip(change.values, change.sds, strict=True)
    ]
    return f"{change.material}={','.join(values)}"


def changed_draws(
    posterior: AbsorptionPosterior,
    draws: FloatArray,
    changes: Sequence[Change],
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray, tuple[Finding, ...]]:
    """Return absorption and its draws after all changes.

    Parameters
    ----------
    posterior : AbsorptionPosterior
    draws : float array, shape (n_draws, n_materials, n_bands)
    changes : sequence of Change
    rng : numpy Generator

    Returns
    -------
    absorption : float array, shape (n_materials, n_bands)
    draws : float array, shape (n_draws, n_materials, n_bands)
    findings : tuple of Finding
        `Code.ABSORPTION_CLIPPED` where a factor leads beyond 1.

    Raises
    ------
    InputError
        The room has no such material, it is changed twice, there is not one value a band, an
        absorption lies outside of 0 to 1, or the catalogue has no such entry.
    """
    absorption, drawn = posterior.absorption.copy(), draws.copy()
    findings: list[Finding] = []
    visited: set[str] = set()
    for change in changes:
        where = change_text(change)
        index = _index_of(change.material, posterior.materials, where)
        if change.material in visited:
            raise InputError("a material is changed twice", where=where)
        visited.add(change.material)
        # one number a draw for all bands: a material is thicker, or hung closer, at all frequencies
        z = rng.standard_normal(len(draws))
        with located(where):
            if change.kind == "factor":
                factor, sd = _per_band(change, posterior.bands, high=np.inf)
                wanted = absorption[index] * factor
                absorption[index] = np.minimum(wanted, 1.0)
                factors = np.maximum(factor + sd * z[:, None], 0.0)
                drawn[:, index] = np.minimum(drawn[:, index] * factors, 1.0)
                findings += _clipped(change, wanted, posterior.bands)
            else:
                mean, sd = _specified_absorption(change, posterior.bands)
                absorption[index] = mean
                drawn[:, index] = _logit_normal(mean, sd, z)
    return absorption, drawn, tuple(findings)


def _index_of(material: str, materials: tuple[str, ...], where: str) -> int:
    if material not in materials:
        guess = nearest(material, materials)
        raise InputError(
            "a change names a material that the room does not have",
            where=where,
            found=repr(material),
            needed=f"one of {', '.join(materials)}",
            hint=f"did you mean {guess!r}?" if guess else None,
        )
    return materials.index(material)


def _specified_absorption(change: Change, bands: Bands) -> tuple[FloatArray, FloatArray]:
    if change.kind == "catalogue":
        return catalogue_prior(change.entry, bands)
    return _per_band(change, bands, high=1.0)


def _per_band(change: Change, bands: Bands, high: float) -> tuple[FloatArray, FloatArray]:
    values, sds = np.array(change.values), np.array(change.sds)
    if values.size not in (1, len(bands)):
        raise InputError(
            "a change has not one value per predicted band",
            found=f"{values.size} values",
            needed=f"1 or {len(bands)}: {', '.join(f'{f:g}' for f in bands.centres_hz)} Hz",
        )
    if not (np.all(values >= 0.0) and np.all(values <= high)):
        raise InputError(
            "absorption coefficient out of range",
            found=f"{values.max():g}",
            needed="0 <= a <= 1 (energy, dimensionless)",
            hint="if these are percentages, divide by 100",
        )
    return np.broadcast_to(values, len(bands)).copy(), np.broadcast_to(sds, len(bands)).copy()


def _logit_normal(mean: FloatArray, sd: FloatArray, z: FloatArray) -> FloatArray:
    """Return draws between 0 and 1 about a mean; where the spread is 0 the mean itself."""
    inside = np.clip(mean, 1e-4, 1.0 - 1e-4)
    middle, width = logit_prior(inside, sd)
    drawn = expit(middle + width * z[:, None])
    return np.asarray(np.where(sd > 0.0, drawn, mean))


def _clipped(change: Change, wanted: FloatArray, bands: Bands) -> tuple[Finding, ...]:
    over = np.flatnonzero(wanted > 1.0)
    if not over.size:
        return ()
    where = ", ".join(f"{bands.centres_hz[j]:g} Hz ({wanted[j]:.2f})" for j in over)
    return (
        Finding(
            Code.ABSORPTION_CLIPPED,
            f"The change {change_text(change)} would make the absorption larger than 1 at {where}; "
            "1 was taken.",
            {"material": change.material, "bands_hz": bands.centres_hz[over].tolist()},
        ),
    )


PairChoice = Literal["all", "campaign"]


@dataclass(frozen=True, slots=True, eq=False)
class ObservedPair:
    """What was measured of a pair: values (n_names, n_bands), and a decay where there was one."""

    source: str
    receiver: str
    use: Literal["fit", "validate"]
    values: FloatArray
    curve: DecayCurve | None


def pair_choice(text: str) -> PairChoice:
    """Return a choice of pairs by its name.

    Raises
    ------
    InputError
        It is neither "all" nor "campaign".
    """
    if text == "all":
        return "all"
    if text == "campaign":
        return "campaign"
    raise InputError("unknown choice of pairs", found=repr(text), needed='"all" or "campaign"')


def prediction_scene(campaign: Campaign, room: Room, pairs: PairChoice) -> Scene:
    """Return the scene of a prediction: every source with every receiver, or those measured.

    Raises
    ------
    InputError
        No source, no receiver, no pair; or one stands outside the room, in a wall, or upon another.
    """
    for kind, points in (("source", campaign.sources), ("receiver", campaign.receivers)):
        if not points:
            raise InputError(
                f"the campaign defines no {kind}",
                where=str(campaign.path),
                needed=f"[{kind}s.NAME] with a position",
            )
    chosen = [(s.name, r.name) for s in campaign.sources for r in campaign.receivers]
    if pairs == "campaign":
        measured = _measured_names(campaign)
        chosen = [pair for pair in chosen if pair in measured]
        if not chosen:
            raise InputError(
                "the campaign has measured no pair",
                where=str(campaign.path),
                hint="predict all pairs instead",
            )
    refuse(position_findings(room, campaign.sources, campaign.receivers))
    source_at = {s.name: i for i, s in enumerate(campaign.sources)}
    receiver_at = {r.name: i for i, r in enumerate(campaign.receivers)}
    indices = np.array([(source_at[s], receiver_at[r]) for s, r in chosen])
    return Scene(room, campaign.sources, campaign.receivers, indices, campaign.air)


def predicted_bands(campaign: Campaign, known: Bands) -> tuple[Bands, tuple[Finding, ...]]:
    """Return the bands of the campaign in which the absorption is known.

    Raises
    ------
    InputError
        There is none.
    """
    specified = campaign.bands
    common = [
        f for f in specified.centres_hz if f in known.centres_hz and specified.kind == known.kind
    ]
    if not common:
        raise InputError(
            "the absorption is known in other bands than the campaign asks for",
            where=f"{campaign.path}, identify",
            found=", ".join(f"{f:g}" for f in known.centres_hz),
            needed=", ".join(f"{f:g}" for f in specified.centres_hz) + f" Hz ({specified.kind})",
            hint="change bands, from_hz and to_hz of the campaign",
        )
    left_out = [float(f) for f in specified.centres_hz if f not in common]
    if not left_out:
        return specified, ()
    return Bands(specified.kind, np.array(common)), (
        Finding(
            Code.BAND_NOT_PREDICTED,
            f"The absorption is not known at {', '.join(f'{f:g}' for f in left_out)} Hz: nothing "
            "is predicted there.",
            {"bands_hz": left_out},
        ),
    )


def room_posterior(
    campaign: Campaign,
    priors: tuple[MaterialPrior, ...],
    bands: Bands,
    absorption: AbsorptionPosterior,
    replaced: Sequence[str] = (),
) -> AbsorptionPosterior:
    """Return what is known of the room's own materials, matched by name, in the given bands.

    A material that the absorption does not name is taken from the campaign where its
    ``absorption`` is given there.

    Parameters
    ----------
    replaced : sequence of str
        Materials whose absorption will be told later, and need none here.

    Raises
    ------
    InputError
        The absorption of some materials is nowhere told.
    """
    names = [k.name for k in priors]
    missing = [
        k.name
        for k in priors
        if k.name not in absorption.materials and k.known is None and k.name not in replaced
    ]
    if missing:
        raise InputError(
            "the absorption of some of the room's materials is not known",
            where=str(campaign.path),
            found=f"no {', '.join(missing)} among {', '.join(absorption.materials)}",
            needed="the same names in both, or absorption = [...] in the campaign",
            hint=f"add absorption to [materials.{missing[0]}], or --set {missing[0]}=...",
        )
    own = [names.index(n) for n in absorption.materials if n in names]
    theirs = [i for i, n in enumerate(absorption.materials) if n in names]
    at = [int(np.flatnonzero(absorption.bands.centres_hz == f)[0]) for f in bands.centres_hz]
    shape = (len(names), len(bands))
    absorption_of_room = np.full(shape, 0.5)
    for i, k in enumerate(priors):
        if k.known is not None:
            absorption_of_room[i] = k.known

    def matched(theirs_: FloatArray | None, otherwise: FloatArray) -> FloatArray:
        values = otherwise.copy()
        if theirs_ is not None:
            values[own] = theirs_[np.ix_(theirs, at)]
        return values

    covariance = np.zeros((len(bands), len(names), len(names)))
    for j, band in enumerate(at):
        covariance[j][np.ix_(own, own)] = absorption.logit_covariance[band][np.ix_(theirs, theirs)]
    plain = absorption.prior_logit_mean is None or absorption.prior_logit_sd is None
    return AbsorptionPosterior(
        tuple(names),
        bands,
        matched(absorption.absorption, absorption_of_room),
        matched(absorption.lower95, absorption_of_room),
        matched(absorption.upper95, absorption_of_room),
        covariance,
        None if plain else matched(absorption.prior_logit_mean, np.zeros(shape)),
        None if plain else matched(absorption.prior_logit_sd, np.ones(shape)),
        prior_specified=_matched_flags(absorption.prior_specified, len(names), own, theirs),
    )


def _matched_flags(
    flags: BoolArray | None, n: int, own: Sequence[int], theirs: Sequence[int]
) -> BoolArray | None:
    if flags is None:
        return None
    values = np.ones(n, dtype=np.bool_)
    values[own] = flags[theirs]
    return values


def with_fitted_scattering(
    priors: tuple[MaterialPrior, ...], bands: Bands, absorption: AbsorptionPosterior
) -> tuple[MaterialPrior, ...]:
    """Return what is known of each material, with the scattering of the fit where none is told.

    What a fit found or assumed of scattering belongs to the absorption it found.

    Parameters
    ----------
    priors : tuple of MaterialPrior
        In these bands.
    bands : Bands
    absorption : AbsorptionPosterior
    """
    if absorption.scattering is None:
        return priors
    at = [int(np.flatnonzero(absorption.bands.centres_hz == f)[0]) for f in bands.centres_hz]
    found = dict(zip(absorption.materials, absorption.scattering[:, at], strict=True))
    return tuple(
        replace(k, scattering=found[k.name])
        if k.name in found and (k.scattering is None or k.fit_scattering)
        else k
        for k in priors
    )


def observed_pairs(
    campaign: Campaign, bands: Bands, scene: Scene
) -> tuple[tuple[ObservedPair, ...], tuple[Finding, ...]]:
    """Return what was measured, responses before tables of values.

    Raises
    ------
    InputError
        A file is missing or broken; a table names a pair that is not predicted.
    """
    measured, findings = measure(replace(campaign, bands=bands), scene)
    found = []
    for m in measured:
        # the level of a measurement is a question of its calibration: G is not read from responses
        values = np.vstack([m.parameters.values, np.full(len(bands), np.nan)])
        found.append(
            ObservedPair(
                m.measurement.source, m.measurement.receiver, m.measurement.use, values, m.curve
            )
        )
    pairs = {(scene.sources[s].name, scene.receivers[r].name) for s, r in scene.pairs}
    for table in campaign.tables:
        tabulated, doubts = read_parameters(table.path, table.source, table.receiver)
        findings += doubts
        for t in tabulated:
            if (t.source, t.receiver) not in pairs:
                raise InputError(
                    "a table names a pair that the campaign does not define",
                    where=str(table.path),
                    found=f"{t.source} to {t.receiver}",
                )
            values = np.stack([values_at(t, name, bands) for name in VALUE_NAMES])
            found.append(ObservedPair(t.source, t.receiver, table.use, values, None))
    return tuple(found), findings


def _measured_names(campaign: Campaign) -> set[tuple[str, str]]:
    names = {(m.source, m.receiver) for m in campaign.measurements}
    for table in campaign.tables:
        values, _ = read_parameters(table.path, table.source, table.receiver)
        names |= {(v.source, v.receiver) for v in values}
    return names


def directed_as_found(
    campaign: Campaign, bands: Bands, absorption: AbsorptionPosterior
) -> tuple[Campaign, tuple[Finding, ...]]:
    """Return the campaign with unknown directivities as the fit of the absorption found them.

    Where that fit knew none, as told before it; or omnidirectional, with a finding.

    Parameters
    ----------
    bands : Bands
        Those to be predicted, all among the absorption's.
    """
    at = [int(np.flatnonzero(absorption.bands.centres_hz == f)[0]) for f in bands.centres_hz]
    found = absorption.directivities or {}
    known, unfitted = dict(campaign.directivities), []
    for name in campaign.directivities:
        asked = unknown_directivity(campaign, name)
        if asked is None:
            continue
        if name in found:
            known[name] = FirstOrderBands(found[name][at])
        elif asked.mean is not None:
            known[name] = FirstOrderBands(np.tile(asked.mean, (len(bands), 1)))
        else:
            known[name] = "omni"
            unfitted.append(name)
    return replace(campaign, directivities=known), _findings(unfitted)


def _findings(unfitted: list[str]) -> tuple[Finding, ...]:
    if not unfitted:
        return ()
    return (
        Finding(
            Code.DIRECTIVITY_NOT_KNOWN,
            f"The directivity of {', '.join(unfitted)} was to be fitted, and the absorption comes "
            "without it: predicted as omnidirectional.",
            {"sources": unfitted},
        ),
    )


# T30 is read down to 35 dB below the beginning.
_NEEDED_DB = 36.0
_ATTEMPTS = 4
_LONGER = 1.5
_LONGEST_S = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class FollowedDecay:
    """Paths in bins, with what they were traced and weighed by and what to know about them.

    Attributes
    ----------
    binned : BinnedPaths
    settings : TraceSettings
    weighing : tuple
        Scattering of each material in each band, and the directivity of each source.
    findings : tuple of Finding
    """

    binned: BinnedPaths
    settings: TraceSettings
    weighing: tuple[FloatArray, tuple[Directivity | None, ...]]
    findings: tuple[Finding, ...]


def follow_decay(
    campaign: Campaign,
    scene: Scene,
    bands: Bands,
    priors: tuple[MaterialPrior, ...],
    absorption: FloatArray,
    measured_decay_s: float,
    cache: Cache | None,
    progress: Progress | None,
) -> FollowedDecay:
    """Trace until every band of every pair has fallen by 36 dB, in up to four attempts.

    How long is estimated from Eyring's formula and the measured decay, the longer of both; where
    walls are unlike, sound between the hard ones lasts longer still, and the trace is repeated.

    Parameters
    ----------
    campaign : Campaign
        Tells the directivity of sources, and the seed.
    priors : tuple of MaterialPrior
        In these bands; tells how walls scatter.
    absorption : float array, shape (n_materials, n_bands)
    measured_decay_s : float
        Longest measured reverberation time, 0 where none is known.
    """
    longest_s = max(measured_decay_s, float(eyring_time_s(scene, bands, absorption).max()))
    found: list[Finding] = []
    for attempt in range(_ATTEMPTS):
        plan = plan_trace(scene, priors, min(longest_s, _LONGEST_S), 0.0, campaign.seed)
        done = part(progress, attempt / _ATTEMPTS, (attempt + 1) / _ATTEMPTS)
        traced = cached_trace(scene, plan.settings, plan.scattering, cache, done)
        found += traced.findings
        paths = traced.value.paths
        scattering = specified_scattering(priors, plan.scattering.coefficients, len(bands))
        factors, degenerate = band_factors(campaign, scene, bands, paths, scattering)
        binned = bin_paths(scene, bands, paths, plan.settings.duration_s, factors)
        short = _not_followed(scene, bands, binned, absorption)
        if not short or longest_s >= _LONGEST_S:
            break
        longest_s *= _LONGER
    if progress is not None:
        progress(1.0)
    return FollowedDecay(
        binned,
        plan.settings,
        (scattering, campaign_directivities(campaign, scene, bands)),
        (
            *plan.findings,
            *traced.value.findings,
            *found,
            *degenerate,
            *_short_finding(bands, short),
        ),
    )


def eyring_time_s(scene: Scene, bands: Bands, absorption: FloatArray) -> FloatArray:
    """Return the reverberation time of a scene by Eyring's formula in every band, (n_bands,)."""
    mesh = scene.room.mesh
    areas = material_areas_m2(scene.room)
    mean = np.maximum(areas @ absorption / areas.sum(), 1e-4)
    room = (volume_m3(mesh), surface_area_m2(mesh), speed_of_sound_m_s(scene.air))
    return eyring.eyring_time_s(mean, *room, attenuation_per_m(scene.air, bands))


def _not_followed(
    scene: Scene, bands: Bands, binned: BinnedPaths, absorption: FloatArray
) -> Sequence[int]:
    attenuation = attenuation_per_m(scene.air, bands)
    direct_s = distances_m(scene) / speed_of_sound_m_s(scene.air)
    usable_db = np.array(
        [
            predicted_curve(bands, binned, i, absorption, attenuation, float(t)).usable_db
            for i, t in enumerate(direct_s)
        ]
    )
    return [int(j) for j in np.flatnonzero(usable_db.min(axis=0) < _NEEDED_DB)]


def _short_finding(bands: Bands, short: Sequence[int]) -> tuple[Finding, ...]:
    if not short:
        return ()
    centres = [float(bands.centres_hz[j]) for j in short]
    return (
        Finding(
            Code.DECAY_NOT_FOLLOWED,
            f"The trace does not follow the decay over 35 dB at "
            f"{', '.join(f'{f:g}' for f in centres)} Hz: T30 is not predicted there. Some walls "
            "swallow next to nothing.",
            {"bands_hz": centres},
        ),
    )
