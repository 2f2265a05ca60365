"""A campaign and a result as a question to `roomfit.predict`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from roomfit.base.arguments import check_known
from roomfit.base.door import check_files
from roomfit.base.errors import InputError, InsufficientDataError, located
from roomfit.files.campaign import Campaign, input_files
from roomfit.files.inputs import (
    campaign_room,
    campaign_scene,
    read_measurements,
    room_priors,
    source_directivities,
    speech_db,
)
from roomfit.files.reverberation import diffuse_field
from roomfit.predict.changes import Change
from roomfit.predict.grid import grid_scene
from roomfit.predict.question import Question, undoubted
from roomfit.predict.split import for_another_room, for_another_state
from roomfit.room.scene import Scene, material_areas_m2, named_pairs, shoebox_room
from roomfit.uncertainty.other_room import common_bands, room_posterior
from roomfit.uncertainty.posterior import AbsorptionPosterior


class Wanted(NamedTuple):
    """Which pairs of a campaign to predict."""

    # "all": every source with every receiver; "campaign": those that were measured
    pairs: str = "all"
    state: str = ""  # of the room, among the campaign's; "": as it is described
    # height and spacing in m, see `roomfit.predict.grid.grid_scene`: in place of the receivers
    grid_m: tuple[float, float] | None = None
    # changes, and states that were not fitted, also in bands in which serious findings of the
    # result concern its walls
    doubted: bool = False


def question_of(
    campaign: Campaign,
    found: AbsorptionPosterior | None = None,
    changes: Sequence[Change] = (),
    wanted: Wanted | None = None,
) -> Question:
    """Return a campaign, and the absorption of a result, as a question to `roomfit.predict`.

    Without positions, or without a result, the room is taken for a diffuse field.

    Parameters
    ----------
    campaign : Campaign
        Of the room to predict, which need not be the room in which the absorption was found.
    found : AbsorptionPosterior, optional
        From `roomfit.read_result`; materials are matched by name, bands by centre frequency.
    changes : sequence of Change
    wanted : Wanted, optional

    Raises
    ------
    InsufficientDataError
        All that is asked for rests on walls that are seriously doubted, and this is not wanted.
    InputError
        Materials without absorption, no common band, no source, receiver or pair, or files that
        cannot be read.
    """
    wanted = wanted or Wanted()
    check_known("unknown choice of pairs", wanted.pairs, ("all", "campaign"))
    if found is None or not (campaign.sources and campaign.receivers):
        return _of_field(campaign, found, changes, wanted)
    return question_of_pairs(campaign, found, changes, wanted)


def question_of_pairs(
    campaign: Campaign, found: AbsorptionPosterior, changes: Sequence[Change], wanted: Wanted
) -> Question:
    """Return what `question_of` does where positions are known."""
    # spectra, which hold impedances, do not hinder a prediction
    campaign = campaign.with_rows((*campaign.measurements, *campaign.tables))
    check_files(input_files(campaign), str(campaign.path))
    room, settings, state = campaign_room(campaign), campaign.settings, wanted.state
    with located(f"{campaign.path}, identify"):
        bands, doubts = common_bands(campaign.bands, found.bands)
    if not wanted.doubted:
        with located(str(campaign.path)):
            bands, changes, refused = undoubted(found, bands, changes, state)
        doubts = (*doubts, *refused)
    areas = dict(zip(room.materials, material_areas_m2(room).tolist(), strict=True))
    found, dominated = for_another_room(found, areas, settings.n_draws, settings.seed)
    replaced = [c.material for c in changes if c.kind != "factor"]
    with located(str(campaign.path)):
        priors = room_priors(campaign, room, bands)
        directivities = source_directivities(campaign, bands)
        known = room_posterior(found, priors, bands, directivities, replaced=replaced)
    fitted = found.fitted_states
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
    measurements = tuple(m for m in read_measurements(campaign) if m.state == state)
    scene = campaign_scene(campaign, room)
    if state:
        names, what = list(campaign.states), "the campaign does not define this state of the room"
        check_known(what, state, names, where=str(campaign.path), else_needed="a table [[states]]")
        scene = replace(scene, pair_state=np.full(len(scene.pairs), 1 + names.index(state)))
    if wanted.pairs == "campaign":
        scene = named_pairs(scene, {m.pair_name[:2] for m in measurements})
        if not len(scene.pairs):
            raise InputError(
                "the campaign has measured no pair",
                found="no measurement in this state",
                needed="one pair or more",
                hint="predict all pairs instead: --pairs all",
            )
    if wanted.grid_m is not None:
        scene, measurements = grid_scene(scene, *wanted.grid_m), ()
    known = replace(known, findings=(*doubts, *known.findings, *dominated))
    return Question(scene, known, tuple(changes), measurements, settings, speech_db(campaign))


def _of_field(
    campaign: Campaign,
    found: AbsorptionPosterior | None,
    changes: Sequence[Change],
    wanted: Wanted,
) -> Question:
    """Return a campaign as a diffuse field."""
    what = found_here = needed = hint = ""
    has_data = bool(campaign.measurements or campaign.tables)
    if found is None and campaign.reverberation is None and has_data:
        what, found_here = "the absorption of the room is not given", "recordings or tables alone"
        needed = "a result of what the campaign has measured"
        hint = "roomfit identify first, then --absorption result.json"
    elif wanted._replace(doubted=False) != Wanted():
        what, found_here = "without positions there are neither pairs nor states", "such an option"
        needed = "sources and receivers with positions, and --absorption"
        hint = "leave --pairs, --state and --grid out"
    elif wanted.doubted and found is None:
        what = "decay times and priors alone have no result that could be doubted"
        found_here, needed = "--doubted", "--absorption, a result, beside it"
        hint = "leave --doubted out: nothing is left out here"
    if what:
        where = str(campaign.path)
        raise InputError(what, where=where, found=found_here, needed=needed, hint=hint)
    field, room = diffuse_field(campaign)
    with located(str(campaign.path)):
        known = None
        if found is not None:
            refused = () if wanted.doubted else undoubted(found, field.bands, changes, "")[2]
            if refused:
                raise InsufficientDataError(
                    "the result is seriously doubted in some of the bands",
                    found=refused[0].sentence,
                    needed="a result that is not, or bands in which it is not",
                    hint="put right what the findings name; or add --doubted",
                )
            known = room_posterior(found, field.priors, field.bands)
        # of volume and surface alone no wall is known: one material, and no picture
        walls = room or shoebox_room((1.0, 1.0, 1.0), "room")
        scene = Scene(walls, (), (), np.zeros((0, 2), np.int64), campaign.air)
    return Question(scene, known, tuple(changes), settings=campaign.settings, field=field)
