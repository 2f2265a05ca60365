"""Decay times without positions: a campaign with ``[reverberation]``, read."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.base.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import Bands
from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray
from roomfit.files.campaign import Campaign
from roomfit.files.encoding import provenance
from roomfit.files.inputs import campaign_room, material_priors, object_areas_m2
from roomfit.files.results import posterior_content
from roomfit.files.values import read_decay_times
from roomfit.materials.priors import unknown_material
from roomfit.predict.diffuse_field import (
    FORMULAS,
    DiffuseAbsorption,
    DiffuseField,
    field_posterior,
)
from roomfit.room.mesh import area_vectors_m2, is_double_sided, triangle_areas_m2, volume_m3
from roomfit.room.scene import Room, triangle_material, wall_materials

_DRAWS = 500  # in a file, of which predictions take as many


def diffuse_field(campaign: Campaign) -> tuple[DiffuseField, Room | None]:
    """Return a campaign as a diffuse field, with its decay times if it has any, and its room."""
    own = campaign.reverberation
    decay_s, bands, volume = None, campaign.bands, None
    if own is not None:
        decay_s, bands = read_decay_times(campaign.path.parent / own.file)
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
        "findings": [],
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
