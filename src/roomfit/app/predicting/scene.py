"""Who is heard where in a prediction, with what walls, and what was measured of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from roomfit.app.measuring import measure
from roomfit.app.values import values_at
from roomfit.bands import Bands
from roomfit.errors import InputError
from roomfit.files.campaign.campaign import Campaign
from roomfit.files.parameters import read_parameters
from roomfit.findings import Finding
from roomfit.geometry.faults import refuse
from roomfit.materials.knowledge import MaterialKnowledge
from roomfit.scene.positions import position_findings
from roomfit.scene.room import Room
from roomfit.scene.scene import Scene
from roomfit.signals.decay import DecayCurve
from roomfit.signals.parameter_gradients import VALUE_NAMES
from roomfit.typing import FloatArray
from roomfit.uncertainty.posterior import AbsorptionPosterior

PairChoice = Literal["all", "campaign"]


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
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
    told = campaign.bands
    common = [f for f in told.centres_hz if f in known.centres_hz and told.kind == known.kind]
    if not common:
        raise InputError(
            "the absorption is known in other bands than the campaign asks for",
            where=f"{campaign.path}, identify",
            found=", ".join(f"{f:g}" for f in known.centres_hz),
            needed=", ".join(f"{f:g}" for f in told.centres_hz) + f" Hz ({told.kind})",
            hint="change bands, from_hz and to_hz of the campaign",
        )
    left_out = [float(f) for f in told.centres_hz if f not in common]
    if not left_out:
        return told, ()
    return Bands(told.kind, np.array(common)), (
        Finding(
            "band-not-predicted",
            "warning",
            f"The absorption is not known at {', '.join(f'{f:g}' for f in left_out)} Hz: nothing "
            "is predicted there.",
            {"bands_hz": left_out},
        ),
    )


def room_posterior(
    campaign: Campaign,
    knowledge: tuple[MaterialKnowledge, ...],
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
    names = [k.name for k in knowledge]
    missing = [
        k.name
        for k in knowledge
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
    told = np.full(shape, 0.5)
    for i, k in enumerate(knowledge):
        if k.known is not None:
            told[i] = k.known

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
        matched(absorption.absorption, told),
        matched(absorption.lower95, told),
        matched(absorption.upper95, told),
        covariance,
        None if plain else matched(absorption.prior_logit_mean, np.zeros(shape)),
        None if plain else matched(absorption.prior_logit_sd, np.ones(shape)),
    )


def scattering_known(
    knowledge: tuple[MaterialKnowledge, ...], bands: Bands, absorption: AbsorptionPosterior
) -> tuple[MaterialKnowledge, ...]:
    """Return what is known of each material, with the scattering of the fit where none is told.

    What a fit found or assumed of scattering belongs to the absorption it found.

    Parameters
    ----------
    knowledge : tuple of MaterialKnowledge
        In these bands.
    bands : Bands
    absorption : AbsorptionPosterior
    """
    if absorption.scattering is None:
        return knowledge
    at = [int(np.flatnonzero(absorption.bands.centres_hz == f)[0]) for f in bands.centres_hz]
    found = dict(zip(absorption.materials, absorption.scattering[:, at], strict=True))
    return tuple(
        replace(k, scattering=found[k.name])
        if k.name in found and (k.scattering is None or k.fit_scattering)
        else k
        for k in knowledge
    )


def seen_pairs(
    campaign: Campaign, bands: Bands, scene: Scene
) -> tuple[tuple[Seen, ...], tuple[Finding, ...]]:
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
        found.append(Seen(m.file.source, m.file.receiver, m.file.use, values, m.curve))
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
            found.append(Seen(t.source, t.receiver, table.use, values, None))
    return tuple(found), findings


def _measured_names(campaign: Campaign) -> set[tuple[str, str]]:
    names = {(m.source, m.receiver) for m in campaign.measurements}
    for table in campaign.tables:
        values, _ = read_parameters(table.path, table.source, table.receiver)
        names |= {(v.source, v.receiver) for v in values}
    return names
