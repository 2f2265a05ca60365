"""Whether sources and receivers stand where they can."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roomfit.findings import Finding
from roomfit.geometry.faults import fault, place
from roomfit.geometry.inside import is_inside, nearest_triangles
from roomfit.scene.room import Room
from roomfit.scene.scene import Point
from roomfit.typing import FloatArray

NEAREST_WALL_M = 0.01
"""A point nearer to a wall than 1 cm counts as inside it; positions are seldom known better."""

NEAREST_PAIR_M = 0.01


def position_findings(
    room: Room, sources: Sequence[Point], receivers: Sequence[Point]
) -> tuple[Finding, ...]:
    """Return a fault for each point outside the room or in a wall, and each pair at one place.

    Pass the result to `roomfit.geometry.faults.refuse` to have the first one raised.
    """
    named = [*(("source", p) for p in sources), *(("receiver", p) for p in receivers)]
    if not named:
        return ()
    points = np.array([p.position_m for _, p in named])
    inside = is_inside(room.mesh, points)
    distance, triangle = nearest_triangles(room.mesh, points)
    low, high = room.mesh.vertices_m.min(axis=0), room.mesh.vertices_m.max(axis=0)
    found: list[Finding] = []
    for i, (kind, point) in enumerate(named):
        wall = room.mesh.surfaces[room.mesh.triangle_surface[triangle[i]]].name
        if distance[i] < NEAREST_WALL_M:
            found.append(_in_wall(f"{kind} {point.name!r}", point, wall, float(distance[i])))
        elif not inside[i]:
            found.append(_outside(f"{kind} {point.name!r}", point, wall, distance[i], low, high))
    return (*found, *_coinciding(sources, receivers))


def _in_wall(who: str, point: Point, wall: str, distance_m: float) -> Finding:
    return fault(
        "position-in-wall",
        f"{who} stands in a wall",
        where=place(point.position_m),
        found=f"{1e3 * distance_m:.1f} mm from surface {wall!r}",
        needed=f"at least {1e3 * NEAREST_WALL_M:.0f} mm",
        hint="move it to where it truly stood, in front of the wall",
    )


def _outside(
    who: str, point: Point, wall: str, distance_m: float, low: FloatArray, high: FloatArray
) -> Finding:
    return fault(
        "position-outside",
        f"{who} stands outside the room",
        where=place(point.position_m),
        found=f"{distance_m:.3g} m from the nearest surface, {wall!r}",
        needed=f"a place within the walls; the room reaches from {place(low)} to {place(high)}",
        hint="check unit, up axis and origin of the room file against the positions",
    )


def _coinciding(sources: Sequence[Point], receivers: Sequence[Point]) -> list[Finding]:
    found = []
    for source in sources:
        for receiver in receivers:
            apart = float(np.linalg.norm(source.position_m - receiver.position_m))
            if apart < NEAREST_PAIR_M:
                found.append(
                    fault(
                        "source-at-receiver",
                        f"source {source.name!r} stands where receiver {receiver.name!r} is",
                        where=place(source.position_m),
                        found=f"{1e3 * apart:.1f} mm apart",
                        needed=f"at least {1e3 * NEAREST_PAIR_M:.0f} mm",
                        hint="check the two positions",
                    )
                )
    return found
