"""Rooms as convex cells: the paper's, a slanted one, an L, a turned box with door and window."""

from __future__ import annotations

import numpy as np

from roomfit.base.polygon import Face, Surface
from roomfit.base.typing import FloatArray, IntArray
from roomfit.paper.room import PLANES, paper_scene
from roomfit.room.build import build_mesh
from roomfit.room.scene import Room
from simulated_rooms.polyhedra import CellFace, Cells, cell_arrays

_BOX = ((0, 4, 7, 3), (1, 2, 6, 5), (0, 1, 5, 4), (2, 3, 7, 6), (0, 3, 2, 1), (4, 5, 6, 7))
_BOX_WALLS = ("west", "east", "south", "north", "floor", "ceiling")
# The slanted room: outward directions of its six planes, and their distances from the origin.
_SLANTED = (
    ((-1.0, 0.06, 0.05), 0.0),
    ((1.0, 0.11, -0.04), 6.2),
    ((0.05, -1.0, 0.08), 0.0),
    ((-0.09, 1.0, 0.03), 4.75),
    ((0.0, 0.0, -1.0), 0.0),
    ((0.07, 0.12, 1.0), 3.25),
)


# The turned box: lengths, the matrix that turns it by 30 degrees, and its corner.
TURNED_M, TURNED_AT_M = (6.1, 4.7, 2.8), np.array([2.3, -1.7, 0.4])
_C, _S = np.cos(np.pi / 6.0), np.sin(np.pi / 6.0)
TURNED_BY = np.array([[_C, -_S, 0.0], [_S, _C, 0.0], [0.0, 0.0, 1.0]])


def box_cells(
    low_m: tuple[float, float, float], high_m: tuple[float, float, float]
) -> tuple[FloatArray, tuple[tuple[int, ...], ...]]:
    """Return corners (8, 3) and faces of a box: west, east, south, north, floor, ceiling."""
    (x0, y0, z0), (x1, y1, z1) = low_m, high_m
    plan = ((x0, y0), (x1, y0), (x1, y1), (x0, y1))
    return np.array([(x, y, z) for z in (z0, z1) for x, y in plan]), _BOX


def box_room_cells(lengths_m: tuple[float, float, float]) -> Cells:
    """Return a box as one cell, six materials."""
    corners, faces = box_cells((0.0, 0.0, 0.0), lengths_m)
    return Cells(corners, tuple(CellFace(0, f, i) for i, f in enumerate(faces)), _BOX_WALLS)


def paper_cells() -> Cells:
    """Return the gabled room of Suh (2001), 622 m3, every plane a material of its own.

    It is convex: the ridge is its highest place.
    """
    mesh = paper_scene().room.mesh
    vertices = np.array(mesh.vertices_m)
    faces = []
    for number in range(len(PLANES)):
        own = mesh.triangles[mesh.triangle_surface == number]
        faces.append(CellFace(0, _outline(own), number))
    return Cells(vertices, tuple(faces), PLANES)


def slanted_cells() -> Cells:
    """Return a room of 74 m3 in which no two planes are parallel or at right angles."""
    directions = np.array([d for d, _ in _SLANTED])
    lengths = np.linalg.norm(directions, axis=1)
    normals, offsets = directions / lengths[:, None], np.array([o for _, o in _SLANTED]) / lengths
    corners = np.empty((8, 3))
    for v in range(8):
        own = [i for i, face in enumerate(_BOX) if v in face]
        corners[v] = np.linalg.solve(normals[own], offsets[own])
    return Cells(corners, tuple(CellFace(0, f, i) for i, f in enumerate(_BOX)), _BOX_WALLS)


def l_shaped_cells() -> Cells:
    """Return an L of 7.2 m by 6 m without a corner of 3.4 m by 2.9 m, 2.9 m high: 97 m3.

    Two boxes with an opening between them; six materials: floor, ceiling, the two walls of the
    inner corner as one, the western wall, the southern one, and the ends of the two arms.
    """
    names = ("floor", "ceiling", "inner walls", "west", "south", "ends")
    floor, ceiling, inner, west, south, ends = range(6)
    (x1, x2), (y1, y2), z = (3.8, 7.2), (3.1, 6.0), 2.9
    # the western arm with the corner of the L, then the eastern arm
    plan = ((0, 0), (x1, 0), (x2, 0), (x2, y1), (x1, y1), (x1, y2), (0, y2))
    corners = np.array([(x, y, h) for h in (0.0, z) for x, y in plan], dtype=np.float64)

    def wall(cell: int, a: int, b: int, material: int) -> CellFace:
        return CellFace(cell, (a, b, b + 7, a + 7), material)

    faces = (
        CellFace(0, (6, 5, 4, 1, 0), floor),
        CellFace(0, (7, 8, 11, 12, 13), ceiling),
        wall(0, 0, 1, south),
        CellFace(0, (1, 4, 11, 8), -1, 1),
        wall(0, 4, 5, inner),
        wall(0, 5, 6, ends),
        wall(0, 6, 0, west),
        CellFace(1, (4, 3, 2, 1), floor),
        CellFace(1, (8, 9, 10, 11), ceiling),
        wall(1, 1, 2, south),
        wall(1, 2, 3, ends),
        wall(1, 3, 4, inner),
        CellFace(1, (4, 1, 8, 11), -1, 0),
    )
    return Cells(corners, faces, names)


def turned_cells() -> Cells:
    """Return a box of 80 m3 off the origin, turned by 30 degrees; door and window make it eight.

    Materials, that is; both lie in the planes of their walls.
    """
    x, y, z = TURNED_M
    rectangles = (
        *(("west", (0, 0, 0), (0, 1, z)), ("west", (0, 1.9, 0), (0, y, z))),
        *(("west", (0, 1, 2.1), (0, 1.9, z)), ("door", (0, 1, 0), (0, 1.9, 2.1))),
        ("east", (x, 0, 0), (x, y, z)),
        *(("south", (0, 0, 0), (2, 0, z)), ("south", (4, 0, 0), (x, 0, z))),
        *(("south", (2, 0, 0), (4, 0, 0.9)), ("south", (2, 0, 2.1), (4, 0, z))),
        ("window", (2, 0, 0.9), (4, 0, 2.1)),
        ("north", (0, y, 0), (x, y, z)),
        *(("floor", (0, 0, 0), (x, y, 0)), ("ceiling", (0, 0, z), (x, y, z))),
    )
    materials = (*_BOX_WALLS, "door", "window")
    points: list[FloatArray] = []
    faces = []
    for name, low, high in rectangles:
        ends = np.array([low, high])
        axis = int(np.argmin(np.ptp(ends, axis=0)))
        corners = np.tile(ends[0], (4, 1))
        corners[[1, 2], (axis + 1) % 3] = ends[1, (axis + 1) % 3]
        corners[[2, 3], (axis + 2) % 3] = ends[1, (axis + 2) % 3]
        first = len(points)
        points += list(corners if ends[0, axis] > 0.0 else corners[::-1])
        own = (first, first + 1, first + 2, first + 3)
        faces.append(CellFace(0, own, materials.index(name)))
    return Cells(np.array(points) @ TURNED_BY.T + TURNED_AT_M, tuple(faces), materials)


def room_of(cells: Cells) -> Room:
    """Return the walls of cells as a room that can be traced, materials in the same order."""
    faces, owner = [], []
    for number, face in enumerate(cells.faces):
        if face.material >= 0:
            surface = Surface(f"{cells.materials[face.material]} {number}")
            faces.append(Face(face.corners, surface))
            owner.append(face.material)
    mesh, _ = build_mesh(np.array(cells.vertices_m), faces)
    return Room(mesh, cells.materials, np.array(owner))


def _outline(triangles: IntArray) -> tuple[int, ...]:
    """Return the corners in turn of a polygon that triangles of one orientation fill."""
    edges = {(int(t[k]), int(t[(k + 1) % 3])) for t in triangles for k in range(3)}
    following = {a: b for a, b in edges if (b, a) not in edges}
    start = next(iter(following))
    turn = [start]
    while following[turn[-1]] != start:
        turn.append(following[turn[-1]])
    return tuple(turn)


def cell_volume_m3(cells: Cells) -> float:
    """Return the volume: a third of area times height over the origin, summed over the walls."""
    total = 0.0
    for face in cells.faces:
        corners = cells.vertices_m[list(face.corners)]
        vector = 0.5 * np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0)
        total += float(vector @ corners[0]) / 3.0
    return total


def with_moved_planes(cells: Cells, shift_m: FloatArray) -> Cells:
    """Return a room with each wall's plane moved outwards, for convex rooms.

    Every corner goes to where the planes of its three faces meet now.

    Parameters
    ----------
    cells : Cells
        One cell with three faces at every corner.
    shift_m : float array, shape (n_faces,)
    """
    arrays = cell_arrays(cells)
    moved = np.empty_like(cells.vertices_m)
    for v in range(len(moved)):
        own = [i for i, face in enumerate(cells.faces) if v in face.corners]
        offsets = arrays.offset_m[own] + shift_m[own]
        moved[v] = np.linalg.solve(arrays.normal[own], offsets)
    return Cells(moved, cells.faces, cells.materials)


def obj_text(cells: Cells) -> str:
    """Return the walls as Wavefront OBJ, metres and z up, with a `usemtl` for each material."""
    lines = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in cells.vertices_m]
    for number, face in enumerate(cells.faces):
        if face.material >= 0:
            name = cells.materials[face.material]
            lines += [f"o {name}_{number}", f"usemtl {name}"]
            lines.append("f " + " ".join(str(c + 1) for c in face.corners))
    return "\n".join(lines) + "\n"
