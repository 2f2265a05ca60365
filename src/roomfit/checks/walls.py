"""Whether the first echoes come from where the specified outline of the room has its walls."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from roomfit.base.air import speed_of_sound_m_s
from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.checks.evidence import Recorded
from roomfit.materials.priors import uniform_scattering
from roomfit.room.mesh import area_vectors_m2, corners_m, is_double_sided
from roomfit.room.scene import Room, Scene
from roomfit.signals.response import ImpulseResponse, echo_prominence, times_s
from roomfit.tracing.image_sources import trace_images

_REACH_M, _STEP_M = 3.0, 0.02
# A wall this near to its specified position counts as standing there.
_TOLERANCE_M = 0.12
# nearer than that, an "image" is the loudspeaker or the stand itself
_CLEAR_OF_POSITIONS_M = 0.4
_MASK_S = 0.25e-3
# Two computations of the same image's arrival differ by rounding alone.
_SAME_S = 1e-8
# An echo elsewhere counts where it stands out of its surroundings by a factor of e**1.5, by a
# factor of 2 in eight responses (more in fewer, as a mean's deviation, and beyond half the reach)
# more than the echo of the specified position or any other, and in most responses.
_LEAST_SCORE, _LEAST_LEAD, _LEAST_FAR_LEAD, _LEAD_RESPONSES, _LEAST_SHARE = 1.5, 0.7, 1.0, 8, 0.7
_LEAST_RESPONSES = 5
# Hundreds of seats have echoes at every time, and to trace them takes minutes.
_MAX_TRIANGLES = 2000
_DISTANCES_M = np.arange(-_REACH_M, _REACH_M + 0.5 * _STEP_M, _STEP_M)


def check(evidence: Recorded) -> Iterator[Finding]:
    """Yield a finding for each wall whose echoes come from elsewhere.

    A wrong clock also moves what seem to be echoes of walls: nothing is examined then.
    """
    measured = evidence.measured
    if not evidence.arrivals:
        fitted = [m for m in measured.responses if m.measurement.use == "fit"]
        yield from outline_findings(measured.scene, [(m.pair, m.response) for m in fitted])


class _Wall(NamedTuple):
    name: str  # of the surface
    centre_m: tuple[float, float, float]  # of its triangles, by area
    normal: FloatArray  # (3,), out of the room
    offset_m: float  # of its plane from the origin, along the normal


class _Echoes(NamedTuple):
    """One response: its ends, the arrivals by the specified outline, the prominence over time."""

    source_m: FloatArray  # (3,)
    receiver_m: FloatArray  # (3,)
    direct_s: float
    arrivals_s: FloatArray  # of the specified outline up to the second order
    time_s: FloatArray  # (n,)
    prominence: FloatArray  # (n,); set to 0 where a wall has been found
    explained: BoolArray  # (n,), near one of the arrivals


def outline_findings(
    scene: Scene, responses: Sequence[tuple[int, ImpulseResponse]]
) -> tuple[Finding, ...]:
    """Return a finding for each wall whose echoes come from elsewhere, with surface and metres.

    For every large wall, displaced outward or inward by up to 3 m, the prominence of the responses
    at the arrival of its reflection is averaged over all that its specified position reflects to:
    at the true position the echoes align. The clearest wall is decided first and its echoes are
    masked. What the specified outline explains up to the second order is no evidence against it.

    `responses` are pairs of the scene. Not examined: fewer than five; those of a single source,
    whose own stand echoes in all of them alike; and a room of more than 2000 triangles.
    """
    sources = {int(scene.pairs[pair, 0]) for pair, _ in responses}
    if len(responses) < _LEAST_RESPONSES or len(sources) < 2:
        return ()
    if len(scene.room.mesh.triangles) > _MAX_TRIANGLES:
        return ()
    c = speed_of_sound_m_s(scene.air)
    echoes = _all_echoes(scene, responses, c)
    walls = _large_walls(scene.room)
    findings: list[Finding] = []

    def is_reached(wall: _Wall, echo: _Echoes) -> bool:
        """Whether the wall, where specified, reflects to the receiver, not behind a corner."""
        arrival_s = _arrivals_s(wall, np.zeros(1), echo, c)
        return bool(np.any(np.abs(echo.arrivals_s - arrival_s) < _SAME_S))

    while walls:
        reached = [[e for e in echoes if is_reached(wall, e)] for wall in walls]
        scans = [_scan(wall, of, c) for wall, of in zip(walls, reached, strict=True)]
        best = int(np.argmax([float(np.nanmax(s, initial=-np.inf)) for s in scans]))
        wall, scores = walls.pop(best), scans[best]
        if not np.any(np.isfinite(scores)):
            break
        moved_m = float(_DISTANCES_M[int(np.nanargmax(scores))])
        findings += _mismatch(wall, moved_m, scores, reached[best], c)
        for echo in echoes:
            arrival_s = _arrivals_s(wall, np.array([moved_m]), echo, c)
            echo.prominence[np.abs(echo.time_s - arrival_s) < _MASK_S] = 0.0
    return tuple(findings)


def _all_echoes(
    scene: Scene, responses: Sequence[tuple[int, ImpulseResponse]], c: float
) -> list[_Echoes]:
    size_m = float(np.linalg.norm(np.ptp(scene.room.mesh.vertices_m, axis=0)))
    duration_s = 3.0 * (size_m + 2.0 * _REACH_M) / c
    smooth = uniform_scattering(scene.room.materials, 0.0)
    specified = trace_images(scene, 2, duration_s, smooth)
    found = []
    for pair, response in responses:
        source, receiver = scene.pairs[pair]
        ends = scene.sources[source].position_m, scene.receivers[receiver].position_m
        time_s, arrivals_s = times_s(response), specified.length_m[specified.pair == pair] / c
        near = [np.abs(time_s - arrival_s) < _MASK_S for arrival_s in arrivals_s]
        explained = np.any([np.zeros(time_s.size, dtype=np.bool_), *near], axis=0)
        direct_s = float(np.linalg.norm(ends[0] - ends[1])) / c
        prominence = echo_prominence(response)
        found.append(_Echoes(*ends, direct_s, arrivals_s, time_s, prominence, explained))
    return found


def _large_walls(room: Room) -> list[_Wall]:
    """Return the planes of the outline with at least 3 % of its area, sheets left out."""
    vectors, corners = area_vectors_m2(room.mesh), corners_m(room.mesh)
    areas = np.linalg.norm(vectors, axis=1)
    usable = (areas > 0.0) & ~is_double_sided(room.mesh)
    walls = []
    for seed in np.argsort(-areas, kind="stable"):
        if not usable[seed]:
            continue
        normal = vectors[seed] / areas[seed]
        offset_m = float(corners[seed].mean(axis=0) @ normal)
        flat = np.abs(corners @ normal - offset_m).max(axis=1) < 1e-3
        same = usable & flat & (vectors @ normal > 0.99 * areas)
        usable &= ~same
        usable[seed] = False
        if areas[same].sum() >= 0.03 * areas.sum():
            name = room.mesh.surfaces[room.mesh.triangle_surface[seed]].name
            x, y, z = areas[same] @ corners[same].mean(axis=1) / areas[same].sum()
            walls.append(_Wall(name, (float(x), float(y), float(z)), normal, offset_m))
    return walls


def _arrivals_s(wall: _Wall, moved_m: FloatArray, echo: _Echoes, c: float) -> FloatArray:
    """Return the arrival times of a wall's reflection by how far out it is moved, (n_moves,)."""
    behind_m = wall.offset_m + moved_m - float(echo.source_m @ wall.normal)
    images_m = echo.source_m + 2.0 * behind_m[:, None] * wall.normal
    return np.asarray(np.linalg.norm(images_m - echo.receiver_m, axis=1)) / c


def _prominences(wall: _Wall, moved_m: FloatArray, echoes: list[_Echoes], c: float) -> FloatArray:
    """Return the prominence at the wall's reflection by displacement, (n_moves, n_echoes).

    NaN where a response cannot resolve it, and where a position would be too near to the wall.
    """
    found = np.full((moved_m.size, len(echoes)), np.nan)
    is_specified, nearest_m = np.abs(moved_m) <= _TOLERANCE_M, -np.inf
    for echo, column in zip(echoes, found.T, strict=True):
        arrival_s = _arrivals_s(wall, moved_m, echo, c)
        at = np.searchsorted(echo.time_s, arrival_s)
        resolved = (arrival_s - echo.direct_s >= 1e-3) & (at < echo.time_s.size)
        at = np.minimum(at, echo.time_s.size - 1)
        resolved &= is_specified | ~echo.explained[at]
        column[resolved] = echo.prominence[at[resolved]]
        ends_m = (float(p @ wall.normal) for p in (echo.source_m, echo.receiver_m))
        nearest_m = max(nearest_m, *ends_m)
    found[nearest_m > wall.offset_m + moved_m - _CLEAR_OF_POSITIONS_M] = np.nan
    return found


def _scan(wall: _Wall, echoes: list[_Echoes], c: float) -> FloatArray:
    """Return the mean prominence for every displacement, NaN where too few responses resolve it."""
    least = max(_LEAST_RESPONSES, len(echoes) // 2)
    prominences = _prominences(wall, _DISTANCES_M, echoes, c)
    resolved = np.isfinite(prominences)
    mean = prominences.sum(axis=1, where=resolved) / np.maximum(resolved.sum(axis=1), 1)
    return np.where(resolved.sum(axis=1) >= least, mean, np.nan)


def _mismatch(
    wall: _Wall, moved_m: float, scores: FloatArray, echoes: list[_Echoes], c: float
) -> Iterator[Finding]:
    """Yield that a wall stands elsewhere, if it does."""
    here = scores[(np.abs(_DISTANCES_M) <= _TOLERANCE_M) & np.isfinite(scores)]
    rest = scores[(np.abs(_DISTANCES_M - moved_m) > 0.15) & np.isfinite(scores)]
    if abs(moved_m) <= _TOLERANCE_M or here.size == 0 or rest.size < 20:
        return
    peak = _prominences(wall, np.array([moved_m]), echoes, c)[0]
    peak = peak[np.isfinite(peak)]
    best, share = float(np.nanmax(scores)), float(np.mean(peak > 1.0))
    lead = best - max(float(here.max()), float(rest.max()))
    least_lead = _LEAST_LEAD if abs(moved_m) <= 0.5 * _REACH_M else _LEAST_FAR_LEAD
    least_lead *= max(1.0, np.sqrt(_LEAD_RESPONSES / peak.size))
    if best < _LEAST_SCORE or lead < least_lead or share < _LEAST_SHARE:
        return
    way = "farther out than" if moved_m > 0.0 else "inside of where"
    yield Finding(
        Code.WALL_POSITION_MISMATCH,
        About(points_m=[wall.centre_m]),
        f"The echoes of {wall.name} come from a wall {abs(moved_m):.2f} m {way} the specified "
        f"outline has it, in {round(100 * share)} % of {peak.size} responses. Measure the room "
        "again, or look for what hangs or stands in front of that wall.",
        {"surface": wall.name, "metres_outward": round(moved_m, 2), "responses": peak.size},
    )
