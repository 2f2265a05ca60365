"""A billiard ball in plain numpy, and image sources by trying everything: slow, short, independent.

Nothing here shares code with the image sources that it checks.
"""

from __future__ import annotations

from itertools import pairwise, product
from typing import Any, NamedTuple

import numpy as np
import pytest

from roomfit.base.air import Air
from roomfit.base.polygon import Face, Surface
from roomfit.base.typing import FloatArray
from roomfit.room.build import build_mesh
from roomfit.room.mesh import Mesh, corners_m, is_double_sided, shoebox_mesh
from roomfit.room.scene import Point, Room, Scene, triangle_material

SPEED_M_S = 340.0
BOX_M = (6.1, 4.7, 2.8)
BOX_MATERIALS = ("west", "east", "south", "north", "floor", "ceiling")


class Followed(NamedTuple):
    """Where a ball is after a given distance, and what it struck on the way."""

    end_m: FloatArray
    direction: FloatArray
    triangles: list[int]
    cosines: list[float]


def follow(mesh: Mesh, start: FloatArray, direction: FloatArray, length_m: float) -> Followed:
    """Let a ball bounce specularly off the nearest triangle until it has gone so far."""
    corners = corners_m(mesh)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    position = np.array(start, dtype=np.float64)
    direction = np.array(direction, dtype=np.float64)
    left, triangles, cosines = length_m, [], []
    while True:
        flights = _flights(corners, position, direction)
        nearest = int(np.argmin(flights))
        if flights[nearest] >= left:
            return Followed(position + left * direction, direction, triangles, cosines)
        position = position + flights[nearest] * direction
        left -= flights[nearest]
        cosine = float(normals[nearest] @ direction)
        direction = direction - 2.0 * cosine * normals[nearest]
        triangles.append(nearest)
        cosines.append(abs(cosine))


def all_images(room: Room, source: FloatArray, receiver: FloatArray, order: int) -> list[list[int]]:
    """Return the triangle sequences of all specular paths up to an order, shortest path first.

    Every sequence of planes is tried: the source is mirrored in each in turn, a ball is sent at
    the receiver's image, and the path counts where the ball strikes those very planes.
    """
    mesh = room.mesh
    planes = _planes(mesh)
    found = []
    for n in range(order + 1):
        for sequence in product(range(len(planes)), repeat=n):
            if any(a == b for a, b in pairwise(sequence)):
                continue
            target = np.array(receiver, dtype=np.float64)
            for k in reversed(sequence):
                normal, offset, _ = planes[k]
                target = target - 2.0 * (normal @ target - offset) * normal
            length = float(np.linalg.norm(target - source))
            ball = follow(mesh, source, (target - source) / length, length)
            struck = [_plane_of(planes, t) for t in ball.triangles]
            if struck == list(sequence) and np.allclose(ball.end_m, receiver, atol=1e-9):
                found.append((length, ball.triangles))
    return [triangles for _, triangles in sorted(found, key=lambda pair: pair[0])]


def box_room(lengths_m: tuple[float, float, float] = BOX_M, *, lattice: bool = True) -> Room:
    """Return a box of six materials, with or without the note that it is one."""
    mesh = shoebox_mesh(lengths_m)
    return Room(mesh, BOX_MATERIALS, np.arange(6), lengths_m if lattice else None)


def scene_of(
    room: Room,
    sources: FloatArray | list[list[float]],
    receivers: FloatArray | list[list[float]],
    pairs: list[tuple[int, int]] | None = None,
) -> Scene:
    """Return a scene without air loss; every source with every receiver where nothing is said."""
    s = tuple(Point(f"S{i}", np.array(p)) for i, p in enumerate(sources))
    r = tuple(Point(f"R{i}", np.array(p)) for i, p in enumerate(receivers))
    everyone = [(i, j) for i in range(len(s)) for j in range(len(r))]
    air = Air(speed_of_sound_m_s=SPEED_M_S, attenuation="none")
    return Scene(room, s, r, np.array(everyone if pairs is None else pairs), air)


def room_of_polygons(
    corners: list[tuple[float, float, float]], faces: dict[str, tuple[int, ...]], *sheets: str
) -> Room:
    """Return a room with a material for each named polygon."""
    listed = [
        Face(outline, Surface(name, double_sided=name in sheets)) for name, outline in faces.items()
    ]
    mesh, _ = build_mesh(np.array(corners, dtype=np.float64), listed)
    return Room(mesh, tuple(faces), np.arange(len(faces)))


def l_shaped_room() -> Room:
    """Return an L of 6 m by 5 m without its far corner of 3 m by 3 m, 2.5 m high."""
    outline = [(0.0, 0.0), (6.0, 0.0), (6.0, 2.0), (3.0, 2.0), (3.0, 5.0), (0.0, 5.0)]
    corners = [(x, y, z) for z in (0.0, 2.5) for x, y in outline]
    sides = {f"side {i}": (i, (i + 1) % 6, (i + 1) % 6 + 6, i + 6) for i in range(6)}
    return room_of_polygons(
        corners, {"floor": (5, 4, 3, 2, 1, 0), "ceiling": (6, 7, 8, 9, 10, 11), **sides}
    )


def box_with_sheet() -> Room:
    """Return a box of 4 m by 3 m by 2.5 m with a curtain across half its width."""
    corners = [(x, y, z) for z in (0.0, 2.5) for x, y in ((0, 0), (4, 0), (4, 3), (0, 3))]
    corners += [(2.1, 0.3, 0.2), (2.1, 1.6, 0.2), (2.3, 1.6, 2.0), (2.3, 0.3, 2.0)]
    sides = {f"side {i}": (i, (i + 1) % 4, (i + 1) % 4 + 4, i + 4) for i in range(4)}
    faces = {"floor": (3, 2, 1, 0), "ceiling": (4, 5, 6, 7), **sides, "curtain": (8, 9, 10, 11)}
    return room_of_polygons(corners, faces, "curtain")


def hits_of(room: Room, triangles: list[int]) -> list[int]:
    """Return how often each material occurs in a sequence of triangles."""
    owner = triangle_material(room)[triangles] if triangles else np.zeros(0, dtype=np.int64)
    return np.bincount(owner, minlength=len(room.materials)).tolist()


def _flights(corners: FloatArray, start: FloatArray, direction: FloatArray) -> FloatArray:
    """Solve start + t direction = a + u (b - a) + v (c - a) for t; infinity for a miss."""
    a, along_u, along_v = (
        corners[:, 0],
        corners[:, 1] - corners[:, 0],
        corners[:, 2] - corners[:, 0],
    )
    away = start - a
    across = np.cross(direction, along_v)
    # Cramer's rule: determinants as triple products
    determinant = np.einsum("ij,ij->i", along_u, across)
    beside = np.cross(away, along_u)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("ij,ij->i", away, across) / determinant
        v = beside @ direction / determinant
        t = np.einsum("ij,ij->i", beside, along_v) / determinant
    inside = np.minimum(np.minimum(u, v), 1.0 - u - v) >= -1e-12
    met = inside & (np.abs(determinant) >= 1e-12) & (t > 1e-9)
    return np.asarray(np.where(met, t, np.inf))


def _planes(mesh: Mesh) -> list[tuple[FloatArray, float, list[int]]]:
    """Return the distinct planes, each with its triangles. Either side of a sheet is one plane."""
    planes: list[tuple[FloatArray, float, list[int]]] = []
    sheet = is_double_sided(mesh)
    for i, corners in enumerate(corners_m(mesh)):
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        normal /= np.linalg.norm(normal)
        offset = float(normal @ corners[0])
        for known, where, members in planes:
            same = np.allclose(known, normal) and np.isclose(where, offset)
            if same and sheet[members[0]] == sheet[i]:
                members.append(i)
                break
        else:
            planes.append((normal, offset, [i]))
    return planes


def _plane_of(planes: list[tuple[FloatArray, float, list[int]]], triangle: int) -> int:
    return next(k for k, (_, _, members) in enumerate(planes) if triangle in members)


def their_images(
    room: Room, source: FloatArray, receiver: FloatArray, order: int
) -> tuple[FloatArray, FloatArray]:
    """Return distance and energy left of every image that the other program sees.

    Absorption rises evenly over the materials from 0.1 to 0.7.
    """
    pra: Any = pytest.importorskip("pyroomacoustics")
    a = np.linspace(0.1, 0.7, len(room.materials))
    owner = room.surface_material[room.mesh.triangle_surface]
    walls = [
        pra.wall_factory(triangle.T, [a[m]], [0.0], f"triangle {i}")
        for i, (triangle, m) in enumerate(zip(corners_m(room.mesh), owner, strict=True))
    ]
    theirs = pra.Room(walls, fs=16000, max_order=order, air_absorption=False)
    theirs.add_source(source)
    theirs.add_microphone(receiver)
    theirs.image_source_model()
    observed = np.asarray(theirs.visibility[0][0]).astype(bool)
    distance = np.linalg.norm(theirs.sources[0].images[:, observed].T - receiver, axis=1)
    near = np.argsort(distance)
    return distance[near], np.asarray(theirs.sources[0].damping[0, observed] ** 2)[near]
