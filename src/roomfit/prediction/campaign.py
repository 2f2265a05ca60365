"""A result, a room and a campaign as the arguments of `roomfit.predict`."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple, TypedDict

import numpy as np

from roomfit._checks import did_you_mean
from roomfit.bands import Bands
from roomfit.errors import InputError, located
from roomfit.findings import About, Code, Finding
from roomfit.io.campaign import Campaign, input_files
from roomfit.io.door import check_files
from roomfit.io.inputs import (
    campaign_room,
    campaign_scene,
    material_priors,
    read_measurements,
    source_directivities,
)
from roomfit.materials.priors import MaterialPrior, in_bands
from roomfit.measurement import Measurement
from roomfit.prediction.changes import Change
from roomfit.response.directivity import (
    Directivities,
    Directivity,
    Pattern,
    UnknownDirectivity,
)
from roomfit.scene import Scene
from roomfit.settings import Settings
from roomfit.signals.iso3382 import MeasuredValues
from roomfit.signals.speech import speech_levels
from roomfit.typing import FloatArray
from roomfit.uncertainty.posterior import AbsorptionPosterior

PairChoice = Literal["all", "campaign"]


class WantedPairs(NamedTuple):
    """Which pairs of a campaign to predict, see `predict_arguments`."""

    pairs: PairChoice = "all"
    state: str = ""


class PredictArguments(TypedDict):
    """What `roomfit.predict` takes."""

    scene: Scene
    absorption: AbsorptionPosterior
    changes: tuple[Change, ...]
    measurements: tuple[Measurement | MeasuredValues, ...]
    settings: Settings
    speech_db: FloatArray | None


def predict_arguments(
    campaign: Campaign,
    absorption: AbsorptionPosterior,
    changes: Sequence[Change] = (),
    pairs: PairChoice = "all",
    state: str = "",
) -> PredictArguments:
    """Return a campaign and the absorption of a result as arguments of `roomfit.predict`.

    Parameters
    ----------
    campaign : Campaign
        Of the room to predict, which need not be the room in which the absorption was found.
    absorption : AbsorptionPosterior
        From `roomfit.read_result`; materials are matched by name, and bands by frequency.
    changes : sequence of Change
    pairs : {"all", "campaign"}
        Every source with every receiver, or those that were measured.
    state : str
        Of the room, among the campaign's; "": as it is described.

    Raises
    ------
    InputError
        Materials without absorption, no common band, no source, receiver or pair, an unknown
        choice of pairs, or files that cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import roomfit
    >>> text = '''
    ... [room]
    ... shoebox = [6, 5, 3]
    ... [sources.S]
    ... position = [1.5, 1.2, 1.5]
    ... [receivers.R]
    ... position = [4.0, 3.5, 1.2]
    ... [identify]
    ... from_hz = 1000
    ... to_hz = 1000
    ... [room.materials]
    ... walls = "plaster"
    ... floor = "plaster"
    ... ceiling = "plaster"
    ... '''
    >>> table = "material,band_hz,absorption,lower95,upper95,identifiable\\n"
    >>> with tempfile.TemporaryDirectory() as name:
    ...     campaign, result = Path(name) / "campaign.toml", Path(name) / "absorption.csv"
    ...     _ = campaign.write_text(text)
    ...     _ = result.write_text(table + "plaster,1000,0.3,0.25,0.36,true\\n")
    ...     known = roomfit.read_result(result)
    ...     arguments = predict_arguments(roomfit.read_campaign(campaign, to_fit=False), known)
    >>> arguments["absorption"].absorption
    array([[0.3]])
    """
    check_files(input_files(replace(campaign, spectra=())), str(campaign.path))
    room = campaign_room(campaign)
    with located(f"{campaign.path}, identify"):
        bands, doubts = common_bands(campaign.bands, absorption.bands)
    at = np.flatnonzero(np.isin(campaign.bands.centres_hz, bands.centres_hz))
    with located(str(campaign.path)):
        known = room_posterior(
            absorption,
            in_bands(material_priors(campaign, room.materials), at),
            bands,
            source_directivities(campaign, bands),
            replaced=[c.material for c in changes if c.kind != "factor"],
        )
    for kind, points in (("source", campaign.sources), ("receiver", campaign.receivers)):
        if not points:
            raise InputError(
                f"the campaign defines no {kind}",
                where=str(campaign.path),
                needed=f"[{kind}s.NAME] with a position",
            )
    # spectra, which hold impedances, do not hinder a prediction
    measurements = read_measurements(replace(campaign, spectra=()))
    measurements = tuple(m for m in measurements if m.state == state)
    scene = campaign_scene(campaign, room)
    if state:
        names = list(campaign.states)
        if state not in names:
            raise InputError(
                "the campaign does not define this state of the room",
                where=str(campaign.path),
                found=repr(state),
                needed=f"one of {', '.join(names)}" if names else "a table [[states]]",
                hint=did_you_mean(state, names),
            )
        at_state = np.full(len(scene.pairs), 1 + names.index(state))
        scene = replace(scene, pair_state=at_state)
    if pair_choice(pairs) == "campaign":
        scene = of_pairs(scene, {m.pair_name[:2] for m in measurements})
        if not len(scene.pairs):
            raise InputError("the campaign has measured no pair", hint="predict all pairs instead")
    return {
        "scene": scene,
        "absorption": replace(known, findings=(*doubts, *known.findings)),
        "changes": tuple(changes),
        "measurements": measurements,
        "settings": campaign.settings,
        "speech_db": speech_levels(campaign.speech.level_dba, campaign.speech.noise_db)
        if campaign.speech
        else None,
    }


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


def of_pairs(scene: Scene, names: Container[tuple[str, str]]) -> Scene:
    """Return a scene with those of its pairs whose source and receiver are named."""
    chosen = [(scene.sources[s].name, scene.receivers[r].name) in names for s, r in scene.pairs]
    return replace(scene, pairs=scene.pairs[np.array(chosen, dtype=np.bool_)])


def common_bands(wanted: Bands, known: Bands) -> tuple[Bands, tuple[Finding, ...]]:
    """Return those of the wanted bands in which the absorption is known.

    Raises
    ------
    InputError
        There is none.
    """
    common = [f for f in wanted.centres_hz if f in known.centres_hz and wanted.kind == known.kind]
    if not common:
        raise InputError(
            "the absorption is known in other bands than the campaign asks for",
            found=", ".join(f"{f:g}" for f in known.centres_hz),
            needed=", ".join(f"{f:g}" for f in wanted.centres_hz) + f" Hz ({wanted.kind})",
            hint="change bands, from_hz and to_hz of the campaign",
        )
    left_out = [float(f) for f in wanted.centres_hz if f not in common]
    if not left_out:
        return wanted, ()
    return Bands(wanted.kind, np.array(common)), (
        Finding(
            Code.BAND_NOT_PREDICTED,
            About(bands_hz=left_out),
            f"The absorption is not known at {', '.join(f'{f:g}' for f in left_out)} Hz: nothing "
            "is predicted there.",
            {"bands_hz": left_out},
        ),
    )


def room_posterior(
    absorption: AbsorptionPosterior,
    priors: Sequence[MaterialPrior],
    bands: Bands,
    directivities: Directivities | None = None,
    *,
    replaced: Sequence[str] = (),
) -> AbsorptionPosterior:
    """Return what is known of a room's own materials and sources, from a result of any room.

    Materials are matched by name. One that the result does not name has its fixed absorption. What
    a fit found or assumed of scattering belongs to the absorption it found, and stands wherever
    the room's own is unspecified or to be fitted; so does the directivity of sources. A source
    whose directivity is unknown and was not found has the mean of its prior, or is
    omnidirectional, with a finding.

    Parameters
    ----------
    absorption : AbsorptionPosterior
    priors : sequence of MaterialPrior
        Of all materials of the room, in its order and in these bands.
    bands : Bands
        Some of those of `absorption`, see `common_bands`.
    directivities : mapping of source to directivity, optional
        Of sources that are not omnidirectional, in these bands.
    replaced : sequence of str
        Materials whose absorption will be specified later, and need none here.

    Raises
    ------
    InputError
        The absorption of some materials is unspecified.
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
            found=f"no {', '.join(missing)} among {', '.join(absorption.materials)}",
            needed="the same names in both, or absorption = [...] in the campaign",
            hint=f"add absorption to [materials.{missing[0]}], or --set {missing[0]}=...",
        )
    own = [names.index(n) for n in absorption.materials if n in names]
    theirs = [i for i, n in enumerate(absorption.materials) if n in names]
    at = [int(np.flatnonzero(absorption.bands.centres_hz == f)[0]) for f in bands.centres_hz]
    shape = (len(names), len(bands))
    fixed = np.full(shape, 0.5)
    # what is only known after a change has no variance, and an interval of 0 to 1
    lowest, highest = np.zeros(shape), np.ones(shape)
    for i, k in enumerate(priors):
        if k.known is not None:
            fixed[i] = lowest[i] = highest[i] = k.known

    def matched(values: FloatArray | None, otherwise: FloatArray) -> FloatArray:
        found = otherwise.copy()
        if values is not None:
            found[own] = values[np.ix_(theirs, at)]
        return found

    covariance = np.zeros((len(bands), len(names), len(names)))
    for j, band in enumerate(at):
        covariance[j][np.ix_(own, own)] = absorption.logit_covariance[band][np.ix_(theirs, theirs)]
    has_prior = absorption.prior_logit_mean is not None and absorption.prior_logit_sd is not None
    before = absorption.prior_logit_covariance
    if before is not None:
        together = np.tile(np.eye(len(names)), (len(bands), 1, 1))
        for j, band in enumerate(at):
            together[j][np.ix_(own, own)] = before[band][np.ix_(theirs, theirs)]
    scattering = matched(absorption.scattering, np.full(shape, np.nan))
    for i, k in enumerate(priors):
        unspecified = k.scattering is None or k.fit_scattering
        if k.scattering is not None and (not unspecified or np.isnan(scattering[i]).any()):
            scattering[i] = k.scattering
    sources, findings = _sources_as_found(absorption, directivities or {}, at)
    misfit, specified = absorption.chi2_reduced, absorption.prior_specified
    if specified is not None:
        flags = np.ones(len(names), dtype=np.bool_)
        flags[own] = specified[theirs]
        specified = flags
    return AbsorptionPosterior(
        tuple(names),
        bands,
        matched(absorption.absorption, fixed),
        matched(absorption.lower95, lowest),
        matched(absorption.upper95, highest),
        covariance,
        matched(absorption.prior_logit_mean, np.zeros(shape)) if has_prior else None,
        matched(absorption.prior_logit_sd, np.ones(shape)) if has_prior else None,
        None if before is None else together,
        scattering=scattering,
        directivities=sources,
        prior_specified=specified,
        chi2_reduced=None if misfit is None else misfit[at],
        draws=None
        if absorption.draws is None
        else np.stack([matched(drawn, fixed) for drawn in absorption.draws]),
        findings=findings,
        result_findings=absorption.result_findings,
    )


def _sources_as_found(
    absorption: AbsorptionPosterior, directivities: Directivities, at: Sequence[int]
) -> tuple[Mapping[str, Directivity], tuple[Finding, ...]]:
    """Return known directivities, and unknown ones as the fit of the absorption found them.

    Parameters
    ----------
    at : sequence of int
        Indices of the bands among those of the absorption.
    """
    found = absorption.directivities or {}
    known: dict[str, Directivity] = {}
    unfitted = []
    for name, directivity in directivities.items():
        if not isinstance(directivity, UnknownDirectivity):
            known[name] = directivity
            continue
        fitted = found.get(name)
        if isinstance(fitted, Pattern) and fitted.b.ndim == 2:
            known[name] = Pattern(fitted.b[at], fitted.aim)
        elif fitted is not None:
            known[name] = fitted
        elif directivity.mean is not None:
            known[name] = Pattern(np.tile(directivity.mean, (len(at), 1)), directivity.aim)
        else:
            unfitted.append(name)
    if not unfitted:
        return known, ()
    return known, (
        Finding(
            Code.DIRECTIVITY_NOT_KNOWN,
            About(),
            f"The directivity of {', '.join(unfitted)} was to be fitted, and the absorption comes "
            "without it: predicted as omnidirectional.",
            {"sources": unfitted},
        ),
    )
