"""Whether the first echoes come from where the stated outline of the room puts its walls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roomfit.air import speed_of_sound_m_s
from roomfit.findings import Code, Finding
from roomfit.geometry.mesh import area_vectors_m2, corners_m, is_double_sided
from roomfit.materials.priors import Scattering
from roomfit.scene import Room, Scene
from roomfit.signals.response import ImpulseResponse, echo_prominence, times_s
from roomfit.tracing.image_sources import trace_images
from roomfit.typing import BoolArray, FloatArray

_REACH_M, _STEP_M = 1.5, 0.02
# A wall this near to where it is told is where it is told.
_TOLERANCE_M = 0.12
_LEAST_WALL_SHARE = 0.03
# nearer than that, an "image" is the loudspeaker or the stand itself
_CLEAR_OF_POSITIONS_M = 0.4
_APART_S = 1e-3
_MASK_S = 0.25e-3
# Two ways to the same image differ by rounding alone.
_SAME_S = 1e-8
# An echo elsewhere counts where it stands out of its surroundings by a factor of e**1.5, by a
# factor of 2 more than what comes from the stated place or any other, and in most responses.
_LEAST_SCORE, _LEAST_LEAD, _LEAST_SHARE = 1.5, 0.7, 0.7
_LEAST_RESPONSES = 5
_EXPLAINED_ORDER = 2
# Among hundreds of seats every moment has its echo, and telling them takes minutes.
_MOST_TRIANGLES = 2000


@dataclass(frozen=True, slots=True, eq=False)
class _Wall:
    name: str
    normal: FloatArray
    offset_m: float


@dataclass(slots=True, eq=False)
class _Echoes:
    """One response: where its ends are, what is stated to arrive, how prominent every moment is."""

    source_m: FloatArray
    receiver_m: FloatArray
    direct_s: float
    arrivals_s: FloatArray
    time_s: FloatArray
    prominence: FloatArray
    explained: BoolArray


def outline_findings(
    scene: Scene, responses: Sequence[tuple[int, ImpulseResponse]]
) -> tuple[Finding, ...]:
    """Return a finding for each wall whose echo comes from elsewhere, with surface and metres.

    For every large wall, the moment at which its reflection would arrive is worked out for a wall
    moved out or in by up to 1.5 m, and the prominence of the responses at these moments is averaged
    over all that see the wall: at its true place the echoes line up. The clearest wall is settled
    first and its echoes are taken out, so that no other wall is blamed for them. What the stated
    outline explains up to the second order is no evidence against it.

    Parameters
    ----------
    scene : Scene
    responses : sequence of (pair, ImpulseResponse)
        Index of the pair in the scene; time zero is the emission. Fewer than five tell nothing;
        nor does a single source, whose own stand or table echoes in all of them alike, nor a room
        of more than 2000 triangles.

    Returns
    -------
    tuple of Finding
        `Code.WALL_POSITION_MISMATCH`; `metres_outward` in the evidence is how much farther out of
        the room than stated the wall seems to stand.
    """
    sources = {int(scene.pairs[pair, 0]) for pair, _ in responses}
    if len(responses) < _LEAST_RESPONSES or len(sources) < 2:
        return ()
    if len(scene.room.mesh.triangles) > _MOST_TRIANGLES:
        return ()
    c = speed_of_sound_m_s(scene.air)
    echoes = _all_echoes(scene, responses, c)
    walls = _large_walls(scene.room)
    findings = []
    while walls:
        met = [[e for e in echoes if _is_met(wall, e, c)] for wall in walls]
        scans = [_scan(wall, of, c) for wall, of in zip(walls, met, strict=True)]
        best = int(np.argmax([float(np.nanmax(s, initial=-np.inf)) for s in scans]))
        wall, scores = walls.pop(best), scans[best]
        if not np.any(np.isfinite(scores)):
            break
        moved_m = float(_distances_m()[int(np.nanargmax(scores))])
        findings += _judged(wall, moved_m, scores, met[best], c)
        for echo in echoes:
            arrival_s = _arrival_s(wall, moved_m, echo, c)
            echo.prominence[np.abs(echo.time_s - arrival_s) < _MASK_S] = 0.0
    return tuple(findings)


def _all_echoes(
    scene: Scene, responses: Sequence[tuple[int, ImpulseResponse]], c: float
) -> list[_Echoes]:
    size_m = float(np.linalg.norm(np.ptp(scene.room.mesh.vertices_m, axis=0)))
    duration_s = 3.0 * (size_m + 2.0 * _REACH_M) / c
    smooth = Scattering(scene.room.materials, np.zeros(len(scene.room.materials)))
    stated = trace_images(scene, _EXPLAINED_ORDER, duration_s, smooth)
    found = []
    for pair, response in responses:
        source, receiver = scene.pairs[pair]
        time_s = times_s(response)
        arrivals_s = stated.length_m[stated.pair == pair] / c
        explained = np.zeros(time_s.size, dtype=np.bool_)
        for arrival_s in arrivals_s:
            explained |= np.abs(time_s - arrival_s) < _MASK_S
        ends = scene.sources[source].position_m, scene.receivers[receiver].position_m
        direct_s = float(np.linalg.norm(ends[0] - ends[1])) / c
        prominence = echo_prominence(response)
        found.append(_Echoes(*ends, direct_s, arrivals_s, time_s, prominence, explained))
    return found


def _large_walls(room: Room) -> list[_Wall]:
    """Return the planes of the outline that hold at least 3 % of its area, sheets left out."""
    vectors = area_vectors_m2(room.mesh)
    areas = np.linalg.norm(vectors, axis=1)
    usable = (areas > 0.0) & ~is_double_sided(room.mesh)
    corners = corners_m(room.mesh)
    tolerance_m = 1e-3
    walls = []
    for seed in np.argsort(-areas, kind="stable"):
        if not usable[seed]:
            continue
        normal = vectors[seed] / areas[seed]
        offset_m = float(corners[seed].mean(axis=0) @ normal)
        flat = np.abs(corners @ normal - offset_m).max(axis=1) < tolerance_m
        same = usable & flat & (vectors @ normal > 0.99 * areas)
        usable &= ~same
        usable[seed] = False
        if areas[same].sum() >= _LEAST_WALL_SHARE * areas.sum():
            name = room.mesh.surfaces[room.mesh.triangle_surface[seed]].name
            walls.append(_Wall(name, normal, offset_m))
    return walls


def _distances_m() -> FloatArray:
    return np.asarray(np.arange(-_REACH_M, _REACH_M + 0.5 * _STEP_M, _STEP_M))


def _arrival_s(wall: _Wall, moved_m: float, echo: _Echoes, c: float) -> float:
    """Return when the reflection of a wall moved outward arrives."""
    behind_m = wall.offset_m + moved_m - float(echo.source_m @ wall.normal)
    image_m = echo.source_m + 2.0 * behind_m * wall.normal
    return float(np.linalg.norm(image_m - echo.receiver_m)) / c


def _is_met(wall: _Wall, echo: _Echoes, c: float) -> bool:
    """Whether the wall reflects to the receiver where it is told; behind a corner it does not."""
    arrival_s = _arrival_s(wall, 0.0, echo, c)
    return bool(np.any(np.abs(echo.arrivals_s - arrival_s) < _SAME_S))


def _prominences(wall: _Wall, moved_m: float, echoes: list[_Echoes], c: float) -> FloatArray:
    """Return the prominence at the wall's reflection in every response that can tell it."""
    least_m = wall.offset_m + moved_m - _CLEAR_OF_POSITIONS_M
    stated = abs(moved_m) <= _TOLERANCE_M
    values = []
    for echo in echoes:
        if max(echo.source_m @ wall.normal, echo.receiver_m @ wall.normal) > least_m:
            return np.zeros(0)
        arrival_s = _arrival_s(wall, moved_m, echo, c)
        at = int(np.searchsorted(echo.time_s, arrival_s))
        if arrival_s - echo.direct_s < _APART_S or at >= echo.time_s.size:
            continue
        if stated or not echo.explained[at]:
            values.append(float(echo.prominence[at]))
    return np.array(values)


def _scan(wall: _Wall, echoes: list[_Echoes], c: float) -> FloatArray:
    """Return the mean prominence for every distance that the wall may be moved, NaN if untold."""
    least = max(_LEAST_RESPONSES, len(echoes) // 2)
    prominences = [_prominences(wall, float(d), echoes, c) for d in _distances_m()]
    return np.array([s.mean() if s.size >= least else np.nan for s in prominences])


def _judged(
    wall: _Wall, moved_m: float, scores: FloatArray, echoes: list[_Echoes], c: float
) -> list[Finding]:
    if abs(moved_m) <= _TOLERANCE_M:
        return []
    distances_m = _distances_m()
    best = float(np.nanmax(scores))
    here = scores[(np.abs(distances_m) <= _TOLERANCE_M) & np.isfinite(scores)]
    rest = scores[(np.abs(distances_m - moved_m) > 0.15) & np.isfinite(scores)]
    if here.size == 0 or rest.size < 20:
        return []
    peak = _prominences(wall, moved_m, echoes, c)
    share = float(np.mean(peak > 1.0))
    lead = best - max(float(here.max()), float(rest.max()))
    if best < _LEAST_SCORE or lead < _LEAST_LEAD or share < _LEAST_SHARE:
        return []
    way = "farther out than" if moved_m > 0.0 else "inside of where"
    return [
        Finding(
            Code.WALL_POSITION_MISMATCH,
            f"The echoes of {wall.name} come from a wall {abs(moved_m):.2f} m {way} the stated "
            f"outline has it, in {round(100 * share)} % of {peak.size} responses. Measure the room "
            "again, or look for what hangs or stands in front of that wall.",
            {"surface": wall.name, "metres_outward": round(moved_m, 2), "responses": peak.size},
        )
    ]
