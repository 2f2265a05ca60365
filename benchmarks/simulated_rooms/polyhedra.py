"""Impulse responses of rooms of flat walls, independent of the fitted model.

Rooms are convex cells that open into one another. Images are found in another way than in
`roomfit.tracing`: the room is mirrored, not the source. Every wall has a mirrored copy of the room
behind it, and sound travels straight on from the one true source, through openings and walls alike.
A copy is entered through the part of its wall that is visible from the source. Whether a path
exists, and what it strikes, is then decided by sending a ball along it through the true room.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from roomfit.base.kernels import kernel
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.demo.boxes import pressure_of_images


class CellFace(NamedTuple):
    """A convex polygon of a cell's surface."""

    cell: int
    corners: tuple[int, ...]  # counter-clockwise from outside the cell
    material: int  # -1 for an opening
    beyond: int = -1  # the cell behind an opening, else -1


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """A room cut into convex cells; a convex room is one of them."""

    vertices_m: FloatArray  # (n_vertices, 3)
    faces: tuple[CellFace, ...]  # In the order of their cells
    materials: tuple[str, ...]

    def __post_init__(self) -> None:
        vertices = np.array(self.vertices_m, dtype=np.float64)
        vertices.setflags(write=False)
        object.__setattr__(self, "vertices_m", vertices)


class CellArrays(NamedTuple):
    """The same as arrays, for compiled code."""

    first_face: IntArray  # int64 (n_cells + 1,)
    normal: FloatArray  # (n_faces, 3): unit normals out of the cell
    offset_m: FloatArray  # (n_faces,)
    first_corner: IntArray  # int64 (n_faces + 1,)
    corner_m: FloatArray  # (n_corners, 3)
    material: IntArray  # int64 (n_faces,)
    beyond: IntArray  # int64 (n_faces,)


def cell_arrays(cells: Cells) -> CellArrays:
    """Return planes and corners of every face."""
    owner = np.array([face.cell for face in cells.faces])
    corners = [cells.vertices_m[list(face.corners)] for face in cells.faces]
    normals = np.array([plane_of(c)[0] for c in corners])
    offsets = np.array([plane_of(c)[1] for c in corners])
    counts = [len(c) for c in corners]
    return CellArrays(
        np.searchsorted(owner, np.arange(owner.max() + 2)).astype(np.int64),
        normals,
        offsets,
        np.concatenate(([0], np.cumsum(counts))).astype(np.int64),
        np.concatenate(corners),
        np.array([face.material for face in cells.faces], dtype=np.int64),
        np.array([face.beyond for face in cells.faces], dtype=np.int64),
    )


def plane_of(corners_m: FloatArray) -> tuple[FloatArray, float]:
    """Return unit normal and offset of a flat polygon (M. E. Newell's sum over its edges)."""
    following = np.roll(corners_m, -1, axis=0)
    vector = np.cross(corners_m, following).sum(axis=0)
    normal = vector / np.linalg.norm(vector)
    return normal, float(np.mean(corners_m @ normal))


_SIDES = 20
_ON_EDGE_M = 1e-9
_SAME_PLACE_M = 1e-5
_SHORT_M = 1e-7
_NARROW_RAD = 1e-6


def cell_images(
    cells: Cells, source_m: FloatArray, receivers_m: FloatArray, reach_m: float
) -> list[tuple[FloatArray, IntArray]]:
    """Return for each receiver length (n,) and hits per material (n, n_materials) of every path.

    Shapes: `source_m` (3,), `receivers_m` (n_receivers, 3).
    """
    arrays = cell_arrays(cells)
    source = np.array(source_m, dtype=np.float64)
    receivers = np.array(receivers_m, dtype=np.float64)
    inside = np.array([_inside(arrays, r) for r in receivers])
    start = np.flatnonzero(_inside(arrays, source))[0]
    owner, place = _straight_lines(arrays, source, int(start), receivers, inside, float(reach_m))
    found = []
    for number, receiver in enumerate(receivers):
        own = place[owner == number]
        _, first = np.unique(np.round(own / _SAME_PLACE_M), axis=0, return_index=True)
        steps = own[first] - source
        length = np.linalg.norm(steps, axis=1)
        hits = np.zeros((len(length), len(cells.materials)), dtype=np.int64)
        arrived = _balls(arrays, source, int(start), steps, receiver, hits)
        found.append((length[arrived], hits[arrived]))
    return found


def _inside(arrays: CellArrays, x: FloatArray) -> BoolArray:
    heights = arrays.normal @ x - arrays.offset_m
    pairs = zip(arrays.first_face[:-1], arrays.first_face[1:], strict=True)
    return np.array([bool((heights[a:b] <= 1e-9).all()) for a, b in pairs])


@kernel()
def _straight_lines(
    arrays: CellArrays,
    source: FloatArray,
    start: int,
    receivers: FloatArray,
    inside: BoolArray,
    reach: float,
) -> tuple[IntArray, FloatArray]:
    """Return receiver and position of every mirrored receiver in view of the source."""
    owner, place, n_found = np.empty(1024, dtype=np.int64), np.empty((1024, 3)), 0
    # waiting copies of the room: cell, face entered by, turn and shift, sides of the view
    what, turn, shift = np.empty((4096, 3), np.int64), np.empty((4096, 3, 3)), np.empty((4096, 3))
    view = np.empty((4096, _SIDES, 3))
    what[0] = np.array([start, -1, 0])
    turn[0], shift[0] = np.eye(3), -source  # the source is the origin of all views
    waiting = 1
    polygon, cut, sides = np.empty((_SIDES, 3)), np.empty((2 * _SIDES, 3)), np.empty((_SIDES, 3))
    q, p, x, normal = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    nowhere = np.zeros(3)
    while waiting > 0:
        waiting -= 1
        cell, entered, n_sides = what[waiting]
        q[:], p[:] = turn[waiting], shift[waiting]
        for k in range(n_sides):
            for axis in range(3):
                sides[k, axis] = view[waiting, k, axis]
        for r in range(len(receivers)):
            if not inside[r, cell]:
                continue
            _placed(q, p, receivers[r], x)
            if x[0] ** 2 + x[1] ** 2 + x[2] ** 2 <= reach**2 and _sees(sides, n_sides, x):
                if n_found == len(owner):
                    owner = np.concatenate((owner, owner))
                    place = np.concatenate((place, place))
                owner[n_found], place[n_found] = r, x + source
                n_found += 1
        for f in range(arrays.first_face[cell], arrays.first_face[cell + 1]):
            if f == entered:
                continue
            n = 0
            for c in range(arrays.first_corner[f], arrays.first_corner[f + 1]):
                _placed(q, p, arrays.corner_m[c], polygon[n])
                n += 1
            n = _part_in_view(polygon, n, sides, n_sides, cut)
            _placed(q, nowhere, arrays.normal[f], normal)
            if n < 3 or _nearest(polygon, n, normal) > reach:
                continue
            n = _view(polygon, n, view[waiting])
            if n < 3:
                continue
            if arrays.material[f] >= 0:
                what[waiting, 0], what[waiting, 1] = cell, f
                for i in range(3):
                    shift[waiting, i] = p[i] + 2.0 * arrays.offset_m[f] * normal[i]
                    for j in range(3):
                        turn[waiting, i, j] = q[i, j] - 2.0 * normal[i] * arrays.normal[f, j]
            else:
                beyond = arrays.beyond[f]
                what[waiting, 0], what[waiting, 1] = beyond, _same_face(arrays, f, beyond)
                turn[waiting], shift[waiting] = q, p
            what[waiting, 2] = n
            waiting += 1
            if waiting == len(what):
                what, view = np.concatenate((what, what)), np.concatenate((view, view))
                turn, shift = np.concatenate((turn, turn)), np.concatenate((shift, shift))
    return owner[:n_found].copy(), place[:n_found].copy()


@kernel()
def _same_face(arrays: CellArrays, f: int, cell: int) -> int:
    """Return the face of a cell that is the other side of an opening."""
    for g in range(arrays.first_face[cell], arrays.first_face[cell + 1]):
        turned = np.dot(arrays.normal[f], arrays.normal[g]) < -0.999
        if turned and abs(arrays.offset_m[f] + arrays.offset_m[g]) < 1e-6:
            return g
    return -1


@kernel()
def _placed(q: FloatArray, p: FloatArray, x: FloatArray, out: FloatArray) -> None:
    """Write q x + p."""
    for i in range(3):
        out[i] = q[i, 0] * x[0] + q[i, 1] * x[1] + q[i, 2] * x[2] + p[i]


@kernel()
def _sees(sides: FloatArray, n: int, x: FloatArray) -> bool:
    for k in range(n):
        if sides[k, 0] * x[0] + sides[k, 1] * x[1] + sides[k, 2] * x[2] < -_ON_EDGE_M:
            return False
    return True


@kernel()
def _part_in_view(polygon: FloatArray, n: int, sides: FloatArray, m: int, cut: FloatArray) -> int:
    """Cut a polygon, in place, to its part within all sides through the origin.

    `cut` is working memory, (2 * _SIDES, 3).
    """
    heights = cut[_SIDES:, 0]
    for k in range(m):
        outside = 0
        for i in range(n):
            h = 0.0
            for axis in range(3):
                h += sides[k, axis] * polygon[i, axis]
            heights[i] = h
            outside += h < 0.0
        if outside == n:
            return 0
        if outside == 0:
            continue
        kept = 0
        for i in range(n):
            j = i + 1 if i + 1 < n else 0
            ha, hb = heights[i], heights[j]
            if ha >= 0.0 and kept < _SIDES:
                for axis in range(3):
                    cut[kept, axis] = polygon[i, axis]
                kept += 1
            if ha * hb < 0.0 and kept < _SIDES:
                for axis in range(3):
                    step = polygon[j, axis] - polygon[i, axis]
                    cut[kept, axis] = polygon[i, axis] + ha / (ha - hb) * step
                kept += 1
        n = kept
        for i in range(n):
            for axis in range(3):
                polygon[i, axis] = cut[i, axis]
        if n < 3:
            return 0
    return n


@kernel()
def _view(polygon: FloatArray, n: int, sides: FloatArray) -> int:
    """Write the planes through the origin and each edge of a polygon; return how many.

    0 for a sliver of no width: its planes would face anywhere, and two that are opposite would
    also show what lies behind the origin.
    """
    mx = my = mz = 0.0
    for i in range(n):
        mx, my, mz = mx + polygon[i, 0], my + polygon[i, 1], mz + polygon[i, 2]
    count = 0
    for i in range(n):
        ax, ay, az = polygon[i, 0], polygon[i, 1], polygon[i, 2]
        k = (i + 1) % n
        ex, ey, ez = polygon[k, 0] - ax, polygon[k, 1] - ay, polygon[k, 2] - az
        # corners that cutting has made coincide span no plane
        if ex * ex + ey * ey + ez * ez < _SHORT_M**2:
            continue
        sx, sy, sz = ay * ez - az * ey, az * ex - ax * ez, ax * ey - ay * ex
        length = np.sqrt(sx * sx + sy * sy + sz * sz)
        if length == 0.0:
            continue
        depth = (sx * mx + sy * my + sz * mz) / (n * length)
        if abs(depth) < _ON_EDGE_M:
            return 0
        if depth < 0.0:
            length = -length
        sides[count, 0], sides[count, 1], sides[count, 2] = sx / length, sy / length, sz / length
        for j in range(count):
            together = 0.0
            for axis in range(3):
                together += (sides[j, axis] + sides[count, axis]) ** 2
            if together < _NARROW_RAD**2:
                return 0
        count += 1
    return count


@kernel()
def _nearest(polygon: FloatArray, n: int, normal: FloatArray) -> float:
    """Return a lower bound of the distance from the origin: to the plane, or corner less size."""
    size, to_corner, height = 0.0, 0.0, 0.0
    for axis in range(3):
        to_corner += polygon[0, axis] ** 2
        height += polygon[0, axis] * normal[axis]
    for i in range(1, n):
        away = 0.0
        for axis in range(3):
            away += (polygon[i, axis] - polygon[0, axis]) ** 2
        size = max(size, away)
    return float(max(abs(height), np.sqrt(to_corner) - np.sqrt(size)))


@kernel()
def _dot(a: FloatArray, b: FloatArray) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@kernel()
def _over(arrays: CellArrays, f: int, x: FloatArray, direction: FloatArray, t: float) -> bool:
    """Return whether a ball comes down on a face after a distance: coplanar ones share a plane."""
    start, stop = arrays.first_corner[f], arrays.first_corner[f + 1]
    n = arrays.normal[f]
    px, py, pz = x[0] + t * direction[0], x[1] + t * direction[1], x[2] + t * direction[2]
    for c in range(start, stop):
        a = arrays.corner_m[c]
        b = arrays.corner_m[c + 1 if c + 1 < stop else start]
        ex, ey, ez = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        wx, wy, wz = px - a[0], py - a[1], pz - a[2]
        area = n[0] * (ey * wz - ez * wy) + n[1] * (ez * wx - ex * wz) + n[2] * (ex * wy - ey * wx)
        if area < -_ON_EDGE_M:
            return False
    return True


@kernel()
def _balls(
    arrays: CellArrays,
    source: FloatArray,
    start: int,
    steps: FloatArray,
    receiver: FloatArray,
    hits: IntArray,
) -> BoolArray:
    """Send a ball along each step through the true room; count its hits; return its arrivals."""
    arrived = np.zeros(len(steps), dtype=np.bool_)
    x, direction = np.empty(3), np.empty(3)
    for i in range(len(steps)):
        left, cell, face = np.sqrt(_dot(steps[i], steps[i])), start, -1
        for axis in range(3):
            x[axis], direction[axis] = source[axis], steps[i, axis] / left
        while True:
            first, struck = np.inf, -1
            for f in range(arrays.first_face[cell], arrays.first_face[cell + 1]):
                speed = _dot(arrays.normal[f], direction)
                if f != face and speed > 0.0:
                    t = max((arrays.offset_m[f] - _dot(arrays.normal[f], x)) / speed, 0.0)
                    if t < first and _over(arrays, f, x, direction, t):
                        first, struck = t, f
            flight = min(first, left)
            for axis in range(3):
                x[axis] += flight * direction[axis]
            if struck < 0 or first >= left:
                break
            left, face = left - first, struck
            if arrays.material[struck] >= 0:
                hits[i, arrays.material[struck]] += 1
                twice = 2.0 * _dot(arrays.normal[struck], direction)
                for axis in range(3):
                    direction[axis] -= twice * arrays.normal[struck, axis]
            else:
                cell = arrays.beyond[struck]
                face = _same_face(arrays, struck, cell)
        missed = 0.0
        for axis in range(3):
            missed += (x[axis] - receiver[axis]) ** 2
        arrived[i] = missed < 1e-12
    return arrived


@dataclass(frozen=True, slots=True, eq=False)
class SyntheticPolyhedron:
    """A room whose walls are known."""

    cells: Cells
    # (n_bands,), octave centres, rising; absorption applies at a centre and changes smoothly in
    # between
    centres_hz: FloatArray
    absorption: FloatArray  # (n_materials, n_bands), of each of `cells.materials`
    attenuation_per_m: FloatArray  # (n_bands,), of energy in air
    speed_of_sound_m_s: float
    delays_s: tuple[float, ...]  # of each material at every reflection


def pressure_responses(
    synthetic: SyntheticPolyhedron,
    source_m: FloatArray,
    receivers_m: FloatArray,
    duration_s: float,
    sampling_rate_hz: float,
    level_db: FloatArray,
) -> list[FloatArray]:
    """Return the sound pressure at each receiver after an impulse at the source at time 0.

    Every image within the duration contributes ``1 / (4 pi r)``, times the root of what each wall
    reflects. There is no diffraction.

    Shape (n_samples,). Shapes: `source_m` (3,), `receivers_m` (n_receivers, 3), `level_db`
    (n_bands,).
    """
    reach_m = synthetic.speed_of_sound_m_s * duration_s
    return [
        pressure_of_images(
            (lengths, hits.astype(np.float64)), synthetic, duration_s, sampling_rate_hz, level_db
        )
        for lengths, hits in cell_images(synthetic.cells, source_m, receivers_m, reach_m)
    ]
