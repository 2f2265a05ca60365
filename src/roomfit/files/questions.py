"""A campaign and a result as a question to `roomfit.predict`; decay times without positions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from roomfit.base.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.base.arguments import check_known
from roomfit.base.bands import Bands
from roomfit.base.door import check_files
from roomfit.base.errors import InputError, InsufficientDataError, located
from roomfit.base.findings import Finding
from roomfit.base.typing import FloatArray
from roomfit.files.campaign import Campaign, input_files
from roomfit.files.encoding import finding_content, provenance
from roomfit.files.inputs import (
    campaign_room,
    campaign_scene,
    material_priors,
    object_areas_m2,
    read_measurements,
    room_priors,
    source_directivities,
    speech_db,
)
from roomfit.files.results import posterior_content
from roomfit.files.values import read_decay_times
from roomfit.materials.priors import unknown_material
from roomfit.predict.changes import Change, by_variant
from roomfit.predict.diffuse_field import (
    FORMULAS,
    DiffuseAbsorption,
    DiffuseField,
    field_posterior,
)
from roomfit.predict.grid import grid_scene
from roomfit.predict.question import Question, undoubted
from roomfit.predict.split import for_another_room
from roomfit.room.mesh import area_vectors_m2, is_double_sided, triangle_areas_m2, volume_m3
from roomfit.room.scene import (
    Room,
    Scene,
    material_areas_m2,
    named_pairs,
    shoebox_room,
    triangle_material,
    wall_materials,
)
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
    variants: Sequence[str] = ()  # of `roomfit treat`, as `roomfit.read_change` takes them


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
    # of what is changed in part, or in some variants alone, the rest must be known
    replaced = set[str].intersection(
        *(
            {c.material for c in own if c.kind != "factor" and c.share >= 1.0}
            for own in by_variant(changes).values()
        )
    )
    with located(str(campaign.path)):
        priors = room_priors(campaign, room, bands)
        directivities = source_directivities(campaign, bands)
        known = room_posterior(found, priors, bands, directivities, replaced=sorted(replaced))
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
    elif wanted._replace(doubted=False, variants=()) != Wanted():
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


# Decay times without positions.

_DRAWS = 500  # in a file, of which predictions take as many


def diffuse_field(campaign: Campaign) -> tuple[DiffuseField, Room | None]:
    """Return a campaign as a diffuse field, with its decay times if it has any, and its room."""
    own = campaign.reverberation
    decay_s, bands, volume = None, campaign.bands, None
    findings: tuple[Finding, ...] = ()
    if own is not None:
        decay_s, bands, findings = read_decay_times(campaign.path.parent / own.file)
        volume = own.volume_m3
    room = campaign_room(campaign) if campaign.has_room else None
    if room is not None:
        room = replace(room, materials=wall_materials(room), objects=())
        priors = material_priors(campaign, room.materials, None, bands)
        areas_m2, volume = areas_by_axis_m2(room), volume or volume_m3(room.mesh)
    else:
        if volume is None or own is None or own.surface_m2 is None:
            raise InputError(
                "decay times of a room of unknown size",
                where=f"{campaign.path}, reverberation",
                needed="volume_m3 and surface_m2, or a table [room]",
                found="neither",
                hint="volume_m3 = 200 and surface_m2 = 220, say, under [reverberation]",
            )
        priors = (unknown_material("room", len(bands)),)
        areas_m2 = np.full((3, 1), own.surface_m2 / 3.0)
    formula = "Eyring" if own is None else own.formula
    known_m2 = _known_objects_m2(campaign, room, bands)
    # what takes energy everywhere in the volume, as the air does
    losses = attenuation_per_m(campaign.air, bands) + known_m2 / (4.0 * volume)
    return DiffuseField(
        formula, bands, priors, areas_m2, volume, speed_of_sound_m_s(campaign.air), losses, decay_s,
        findings,
    ), room  # fmt: skip


def _known_objects_m2(campaign: Campaign, room: Room | None, bands: Bands) -> FloatArray:
    """Return the area of all objects of the room as described together, shape (n_bands,)."""
    total = np.zeros(len(bands))
    for name, table in campaign.objects.items():
        if table.states is not None and "" not in table.states:
            continue
        mesh = None if room is None else room.mesh
        area_m2, _ = object_areas_m2(campaign, name, mesh, bands)
        if area_m2 is None:
            raise InputError(
                "decay times alone tell no object from the walls",
                where=f"{campaign.path}, objects.{name}",
                found="a prior",
                needed="absorption_area_m2, which is known",
                hint="roomfit identify fits areas, from responses",
            )
        total += area_m2
    return total


def diffuse_result_content(
    field: DiffuseField, found: DiffuseAbsorption, seed: int, inputs: Iterable[Path]
) -> dict[str, Any]:
    """Return decay times and the absorption that they give as the content of a result.json.

    By the field's formula. It has what every result has of materials, mean and posterior, and
    ``reverberation`` in place of pairs; no material by itself is identifiable, for priors alone
    tell walls apart.
    """
    known = field_posterior(field, _DRAWS, np.random.default_rng(seed))
    areas_m2, own = field.areas_m2.sum(axis=0), found.mean[FORMULAS.index(field.formula)]
    weights = dict(zip(known.materials, (areas_m2 / areas_m2.sum()).round(6), strict=True))
    bands = zip(field.bands.centres_hz, *own, strict=True)
    return {
        "format": "roomfit-result",
        "format_version": 1,
        "bands_hz": field.bands.centres_hz,
        "materials": {
            name: {
                "absorption": known.absorption[i],
                "lower95": known.lower95[i],
                "upper95": known.upper95[i],
                "identifiable": [False] * len(field.bands),
                "area_m2": round(float(areas_m2[i]), 4),
            }
            for i, name in enumerate(known.materials)
        },
        "combinations": [
            {
                "band_hz": centre, "kind": "mean", "weights": weights, "absorption": value,
                "lower95": low, "upper95": high, "determined": True, "differences": [],
            }
            for centre, value, low, high in bands
        ],
        "pairs": [],
        "reverberation": {
            "formula": field.formula,
            "volume_m3": field.volume_m3,
            "decay_s": found.decay_s,
            "decay_sd_s": found.decay_sd_s,
        },
        "findings": [finding_content(one) for one in found.findings],
        "fit": {
            "method": "decay times alone",
            "model": field.formula,
            "seed": seed,
            "intervals": "Gaussian in the logit, the disagreement of formulas included",
        },
        "posterior": posterior_content(known),
        "provenance": provenance(inputs) | {"speed_of_sound_m_s": field.speed_of_sound_m_s},
    }  # fmt: skip


def areas_by_axis_m2(room: Room) -> FloatArray:
    """Return the area of each material across x, y and z, shape (3, n_materials).

    A wall that is oblique counts by the squares of the components of its normal.
    """
    areas = triangle_areas_m2(room.mesh) * np.where(is_double_sided(room.mesh), 2.0, 1.0)
    squares = area_vectors_m2(room.mesh) ** 2
    shares = squares / squares.sum(axis=1, keepdims=True)
    owner, n = triangle_material(room), len(room.materials)
    return np.stack([np.bincount(owner, areas * share, n) for share in shares.T])
