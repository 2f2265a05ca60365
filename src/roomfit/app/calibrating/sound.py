"""Responses that a room would give under a known truth, by a road apart from the fit's own.

Boxes whose walls are smooth and rooms that are convex: pressures of an own enumeration of image
sources. Boxes that scatter: these, thinned, and noise that an own tracer of rays modulates. All
else: a trace of roomfit's with other seeds, whose image sources add as pressures and whose rays
fill with Gaussian noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.air import attenuation_per_m
from roomfit.app.calibrating.plan import CalibrationPlan
from roomfit.app.calibrating.traced_sound import traced_pressures
from roomfit.app.calibrating.truth import Truth
from roomfit.files.campaign.campaign import Campaign
from roomfit.files.campaign.schema import Directivity
from roomfit.geometry.measures import surface_area_m2, volume_m3
from roomfit.response.directivity import aimed
from roomfit.scene.room import material_areas_m2
from roomfit.testproblems.convex_cells import convex_cells
from roomfit.testproblems.pressure_box import BoxTruth, pressure_response
from roomfit.testproblems.pressure_polyhedron import PolyhedronTruth, pressure_responses
from roomfit.testproblems.scattering_box import diffuse_echogram, scattered_response
from roomfit.typing import FloatArray

BOX, SCATTERING_BOX = "images of a box", "images and scattered noise of a box"
CONVEX, TRACED = "images of a convex room", "another trace"
# Image sources of one pair at most; files of rooms that ring longer are cut there.
_MOST_IMAGES = {BOX: 1_500_000, SCATTERING_BOX: 1_000_000, CONVEX: 40_000, TRACED: np.inf}
_SHORTEST_S, _LONGEST_S = 0.3, 3.0
# Specular decays of boxes last up to 1.7 times as long as Eyring's.
_LONGER_THAN_EYRING = 1.4
# Spheres that catch the own tracer's rays.
_CLEAR_OF_WALLS_M = 0.3

Pair = tuple[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class Sound:
    """Pressures of every pair after an impulse at time 0, and the road they came by.

    Attributes
    ----------
    road : str
    pressure : mapping of (source, receiver) to float array, shape (n_samples,)
        In the unit in which a unit source's direct sound is ``1 / (4 pi r)``.
    """

    road: str
    pressure: dict[Pair, FloatArray]


def made_sound(
    plan: CalibrationPlan,
    truth: Truth,
    pairs: tuple[Pair, ...],
    rate_hz: float,
    rng: np.random.Generator,
) -> Sound:
    """Return the pressures of all pairs.

    Files last until the slowest band has fallen to its noise, as long as the measured ones at most,
    and as long as their image sources can be counted.
    """
    road = road_of(plan, truth)
    duration_s = _duration_s(plan, truth, road)
    if road == TRACED:
        found = traced_pressures(plan, truth, pairs, duration_s, rate_hz, rng)
    elif road == CONVEX:
        found = _convex(plan, truth, pairs, duration_s, rate_hz)
    else:
        found = _box(plan, truth, pairs, duration_s, rate_hz, rng)
    return Sound(road, found)


def road_of(plan: CalibrationPlan, truth: Truth) -> str:
    """Return by which road the sound of a room is made."""
    first_order = all(_is_first_order(plan.campaign, s.name) for s in truth.sources)
    even = first_order and not any(_b(plan.campaign, truth, s.name) is not None
                                   for s in truth.sources)  # fmt: skip
    smooth = not np.any(truth.scattering)
    if plan.room.shoebox_m is not None:
        if smooth and first_order:
            return BOX
        lengths = np.array(plan.room.shoebox_m)
        clear = all(
            np.min(np.minimum(p.position_m, lengths - p.position_m)) > _CLEAR_OF_WALLS_M
            for p in truth.receivers
        )
        return SCATTERING_BOX if even and clear else TRACED
    convex = smooth and even and convex_cells(plan.room) is not None
    return CONVEX if convex else TRACED


def _is_first_order(campaign: Campaign, source: str) -> bool:
    told = campaign.directivities.get(source, "omni")
    return told in ("omni", "fit") or isinstance(told, Directivity)


def _b(campaign: Campaign, truth: Truth, source: str) -> FloatArray | None:
    told = campaign.directivities.get(source, "omni")
    if source in truth.b:
        return truth.b[source]
    return aimed(told.aim, told.b).b if isinstance(told, Directivity) else None


def _duration_s(plan: CalibrationPlan, truth: Truth, road: str) -> float:
    """Eyring's time of the slowest fitted band, down to its noise."""
    areas = material_areas_m2(plan.room)
    mean = (areas @ truth.absorption / areas.sum())[plan.columns]
    m = attenuation_per_m(plan.campaign.air, plan.campaign.bands)
    volume = volume_m3(plan.room.mesh)
    left = -np.log1p(-np.minimum(mean, 0.999)) * surface_area_m2(plan.room.mesh) + 4.0 * m * volume
    t60_s = 24.0 * np.log(10.0) / truth.speed_of_sound_m_s * volume / left
    ratio_db = float(plan.snr_db.max(initial=60.0)) + 10.0
    wanted_s = _LONGER_THAN_EYRING * float(t60_s.max()) * ratio_db / 60.0
    reach_m = (0.75 / np.pi * volume * _MOST_IMAGES[road]) ** (1.0 / 3.0)
    longest_s = min(_LONGEST_S, plan.length_s, reach_m / truth.speed_of_sound_m_s)
    return float(min(max(wanted_s, _SHORTEST_S), longest_s))


def _box(
    plan: CalibrationPlan,
    truth: Truth,
    pairs: tuple[Pair, ...],
    duration_s: float,
    rate_hz: float,
    rng: np.random.Generator,
) -> dict[Pair, FloatArray]:
    owner = plan.room.surface_material
    lengths = plan.room.shoebox_m
    assert lengths is not None  # noqa: S101 - the road says that it is a box
    box = BoxTruth(
        lengths,
        plan.grid.centres_hz,
        truth.absorption[owner],
        attenuation_per_m(plan.campaign.air, plan.grid),
        truth.speed_of_sound_m_s,
        tuple(truth.delays_s[owner].tolist()),
    )
    scattering = truth.scattering.mean(axis=1)[owner]
    at = {p.name: p.position_m for p in truth.receivers}
    flat: FloatArray = np.zeros(len(plan.grid))
    found = {}
    for source in truth.sources:
        own = [r for s, r in pairs if s == source.name]
        b = _b(plan.campaign, truth, source.name)
        if not np.any(scattering):
            for r in own:
                ends = (source.position_m, at[r], duration_s, rate_hz)
                found[source.name, r] = pressure_response(box, *ends, flat, b)
        elif own:
            places = np.array([at[r] for r in own])
            echo = diffuse_echogram(box, scattering, source.position_m, places, duration_s, rng)
            for r, energy in zip(own, echo.energy, strict=True):
                found[source.name, r] = scattered_response(
                    *(box, scattering, source.position_m, at[r], energy),
                    *(duration_s, rate_hz, flat, rng),
                )
    return found


def _convex(
    plan: CalibrationPlan,
    truth: Truth,
    pairs: tuple[Pair, ...],
    duration_s: float,
    rate_hz: float,
) -> dict[Pair, FloatArray]:
    cells = convex_cells(plan.room)
    assert cells is not None  # noqa: S101 - the road says that it is convex
    room = PolyhedronTruth(
        cells,
        plan.grid.centres_hz,
        truth.absorption,
        attenuation_per_m(plan.campaign.air, plan.grid),
        truth.speed_of_sound_m_s,
        tuple(truth.delays_s.tolist()),
    )
    at = {p.name: p.position_m for p in truth.receivers}
    found = {}
    for source in truth.sources:
        own = [r for s, r in pairs if s == source.name]
        if own:
            places = np.array([at[r] for r in own])
            made = pressure_responses(
                room, source.position_m, places, duration_s, rate_hz, np.zeros(len(plan.grid))
            )
            found.update({(source.name, r): p for r, p in zip(own, made, strict=True)})
    return found
