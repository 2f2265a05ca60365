"""Boxes anywhere, with doors and windows flush in their walls, built from nothing but corners."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roomfit.base.polygon import Face, Surface
from roomfit.base.typing import FloatArray
from roomfit.room.build import build_mesh
from roomfit.room.mesh import Mesh
from roomfit.room.scene import Room

WALLS = ("west", "east", "south", "north", "floor", "ceiling")


def rotation(yaw_deg: float, tilt_deg: float = 0.0) -> FloatArray:
    """Return the matrix that turns about z, after a tilt about x."""
    a, b = np.radians([yaw_deg, tilt_deg])
    yaw = [[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]]
    tilt = [[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]]
    return np.array(yaw) @ np.array(tilt)


def holed_wall(
    lengths_m: Sequence[float], wall: int, hole: Sequence[float]
) -> list[tuple[FloatArray, bool]]:
    """Return the nine rectangles about a hole and whether each is it, outwards; those of no area
    left out.

    `hole`: from and to along the first of the wall's own two axes, and along the second, as shares.
    """
    axis = wall // 2
    u, v = [k for k in range(3) if k != axis]
    at_u = [lengths_m[u] * s for s in (0.0, hole[0], hole[1], 1.0)]
    at_v = [lengths_m[v] * s for s in (0.0, hole[2], hole[3], 1.0)]
    pieces = []
    for i in range(3):
        for j in range(3):
            if at_u[i + 1] - at_u[i] < 1e-9 or at_v[j + 1] - at_v[j] < 1e-9:
                continue
            corners = np.full((4, 3), (wall % 2) * lengths_m[axis])
            corners[:, u] = at_u[i], at_u[i + 1], at_u[i + 1], at_u[i]
            corners[:, v] = at_v[j], at_v[j], at_v[j + 1], at_v[j + 1]
            # u, v, axis are right-handed for axis 0 and 2
            outwards = (wall % 2 == 1) == (axis != 1)
            pieces.append((corners if outwards else corners[::-1], (i, j) == (1, 1)))
    return pieces


def box_with_doors(
    lengths_m: Sequence[float],
    doors: dict[int, Sequence[float]],
    turn: FloatArray | None = None,
    by_m: Sequence[float] = (0.0, 0.0, 0.0),
) -> Mesh:
    """Return a box of six surfaces and one more, "door K", in each wall K that has a hole."""
    faces, points = [], []
    for wall, name in enumerate(WALLS):
        for corners, is_door in holed_wall(lengths_m, wall, doors.get(wall, (0, 0, 0, 0))):
            own = tuple(range(len(points), len(points) + 4))
            points += list(corners)
            faces.append(Face(own, Surface(f"door {wall}" if is_door else name, None, name)))
    placed = np.array(points) @ (np.eye(3) if turn is None else turn).T + np.array(by_m)
    return build_mesh(placed, faces)[0]


def room_with_doors(mesh: Mesh) -> Room:
    """Return the room in which every surface has a material of its own."""
    names = tuple(dict.fromkeys(s.name for s in mesh.surfaces))
    return Room(mesh, names, np.array([names.index(s.name) for s in mesh.surfaces]))
