"""A result, a room and a campaign as the arguments of `roomfit.predict`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, NamedTuple, TypedDict

import numpy as np

from roomfit.base.arguments import check_known
from roomfit.base.bands import Bands
from roomfit.base.errors import InputError, InsufficientDataError, located
from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.checks.verdict import voids_walls
from roomfit.files.campaign import Campaign
from roomfit.files.inputs import CampaignInputs
from roomfit.predict.changes import Change, values_per_band
from roomfit.predict.split import for_another_room, for_another_state
from roomfit.room.scene import Scene, material_areas_m2, named_pairs
from roomfit.settings import Settings
from roomfit.signals.iso3382 import MeasuredValues
from roomfit.signals.measurement import Measurement
from roomfit.uncertainty.other_room import common_bands, room_posterior
from roomfit.uncertainty.posterior import AbsorptionPosterior

PairChoice = Literal["all", "campaign"]


class WantedPairs(NamedTuple):
    """Which pairs of a campaign to predict, see `predict_arguments`."""

    pairs: PairChoice = "all"
    state: str = ""
    # height and spacing in m, see `roomfit.predict.grid.grid_scene`: in place of the receivers
    grid_m: tuple[float, float] | None = None
    doubted: bool = False


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
    doubted: bool = False,
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
    doubted : bool
        Whether to predict changes, and states that were not fitted, also in bands in which serious
        findings of the result concern its walls.

    Raises
    ------
    InsufficientDataError
        All that is asked for rests on walls that are doubted so, and `doubted` is false.
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
    # spectra, which hold impedances, do not hinder a prediction
    inputs = CampaignInputs(replace(campaign, spectra=()))
    inputs.check_files()
    room = inputs.room()
    with located(f"{campaign.path}, identify"):
        bands, doubts = common_bands(campaign.bands, absorption.bands)
    if not doubted:
        with located(str(campaign.path)):
            bands, changes, refused = undoubted(absorption, bands, changes, state)
        doubts = (*doubts, *refused)
    areas = dict(zip(room.materials, material_areas_m2(room).tolist(), strict=True))
    settings = campaign.settings
    absorption, dominated = for_another_room(absorption, areas, settings.n_draws, settings.seed)
    with located(str(campaign.path)):
        known = room_posterior(
            absorption,
            inputs.priors(room, bands),
            bands,
            inputs.directivities(bands),
            replaced=[c.material for c in changes if c.kind != "factor"],
        )
    fitted = absorption.fitted_states
    if fitted is not None and state not in fitted:
        names = ["", *campaign.states]
        # of states of another campaign the areas are not known: those of the room as described
        at = [i for i, name in enumerate(names) if name in fitted] or [0]
        by_state = np.array([material_areas_m2(room, i) for i in at]).reshape(len(at), -1)
        known = for_another_state(known, by_state, settings.n_draws, settings.seed)
    for kind, points in (("source", campaign.sources), ("receiver", campaign.receivers)):
        if not points:
            what, where = f"the campaign defines no {kind}", str(campaign.path)
            hint = f"add [{kind}s.NAME] with position = [x, y, z]"
            raise InputError(what, where=where, found="none", needed="one or more", hint=hint)
    measurements = tuple(m for m in inputs.measurements() if m.state == state)
    scene = _at_state(inputs.scene(room), campaign, state)
    if pair_choice(pairs) == "campaign":
        scene = named_pairs(scene, {m.pair_name[:2] for m in measurements})
        if not len(scene.pairs):
            raise InputError(
                "the campaign has measured no pair",
                found="no measurement in this state",
                needed="one pair or more",
                hint="predict all pairs instead: --pairs all",
            )
    return {
        "scene": scene,
        "absorption": replace(known, findings=(*doubts, *known.findings, *dominated)),
        "changes": tuple(changes),
        "measurements": measurements,
        "settings": campaign.settings,
        "speech_db": inputs.speech_db(),
    }


def undoubted(
    absorption: AbsorptionPosterior, bands: Bands, changes: Sequence[Change], state: str
) -> tuple[Bands, Sequence[Change], tuple[Finding, ...]]:
    """Return the bands in which other walls can be predicted, changes there, and what is left out.

    All of them where the room is as it was fitted. Elsewhere not those in which a serious finding
    says that all absorptions are wrong: intervals hold every split of the sum that was measured,
    but the sum itself may be wrong. Of a finding about some materials the split is.
    """
    fitted = absorption.fitted_states
    if not changes and (fitted is None or state in fitted):
        return bands, changes, ()
    void = [
        f
        for f in absorption.result_findings
        if f.severity == "serious" and voids_walls(f) and not f.about.materials
    ]
    centres_hz = bands.centres_hz.tolist()
    kept = np.array([not any(f.about.in_band(c) for f in void) for c in centres_hz])
    if kept.all():
        return bands, changes, ()
    codes = ", ".join(dict.fromkeys(f.code.value for f in void))
    if not kept.any():
        raise InsufficientDataError(
            "other walls are not predicted from a result whose walls are seriously doubted",
            found=f"{codes}, in every band",
            needed="in some band, absorptions that no serious finding calls wrong",
            hint="put right what the findings name, and identify again; or add --doubted (in "
            "Python doubted=True), whose intervals hold less than they say",
        )
    own = tuple(_at(c, bands, kept) if len(c.values) > 1 else c for c in changes)
    left_out = bands.centres_hz[~kept].tolist()
    text = (
        f"With other walls nothing is predicted at {', '.join(f'{f:g}' for f in left_out)} Hz: the "
        f"result is seriously doubted there ({codes}). With --doubted it is, by intervals that "
        "hold less than they say."
    )
    finding = Finding(Code.RESULT_DOUBTED, About(bands_hz=left_out), text)
    return Bands(bands.kind, bands.centres_hz[kept]), own, (finding,)


def _at(change: Change, bands: Bands, kept: BoolArray) -> Change:
    """Return a change, which has one value a band, with those of some bands."""
    values, sds = (tuple(of[kept].tolist()) for of in values_per_band(change, bands, np.inf))
    return replace(change, values=values, sds=sds)


def _at_state(scene: Scene, campaign: Campaign, state: str) -> Scene:
    """Return a scene with all of its pairs in one state of the room."""
    if not state:
        return scene
    names = list(campaign.states)
    what = "the campaign does not define this state of the room"
    check_known(what, state, names, where=str(campaign.path), else_needed="a table [[states]]")
    return replace(scene, pair_state=np.full(len(scene.pairs), 1 + names.index(state)))


def pair_choice(text: str) -> PairChoice:
    """Return a choice of pairs by its name."""
    check_known("unknown choice of pairs", text, ("all", "campaign"))
    return "campaign" if text == "campaign" else "all"
