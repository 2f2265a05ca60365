"""The air that sound reaches from its sources, and the sides of faces that bound it.

Drawings are seldom closed shells whose normals agree: walls have a thickness, sheets hang in the
air, bodies stand in it, faces come twice or turned. So every face counts on both sides, and flights
with Lambert reflections are followed: the sides that they strike bound the air. What these sides
enclose is then measured by sound: flights from points all over them end on one of them, and their
mean length is 4 V / S in any room [1]_. A room whose faces say otherwise is refused.

References
----------
.. [1] C. W. Kosten, "The mean free path in room acoustics", Acustica 10, 245-250 (1960).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from roomfit.base.door import check_limit
from roomfit.base.findings import Code, Finding, Severity
from roomfit.base.kernels import in_threads, kernel
from roomfit.base.polygon import (
    WELD_TOLERANCE_M,
    divide,
    halves,
    is_thin,
    place,
    triangulate,
)
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.room.build import listed
from roomfit.room.inside import along, dot, nearest_triangles, put, row
from roomfit.room.mesh import (
    Mesh,
    about_points,
    area_vectors_m2,
    box_of,
    corners_m,
    fault,
    is_double_sided,
    surface_area_m2,
    triangle_areas_m2,
    volume_m3,
    weld,
)
from roomfit.tracing.bvh import WAITING, Tree, nearest_in_tree, tree_of
from roomfit.tracing.walls import EDGE_M, facet_table, ray_key, scattered, uniform

# Every face stands this far before its front, so that of two back to back sound strikes the one
# that looks at it (of a wall between bodies whose fronts look outwards, behind it); and is so much
# wider, to open no gap.
_FRONT_M, _EDGE_M = 1e-8, 1e-7
# A flight goes on from this far before the wall that it met: the way there was free.
_BACK_M = 1e-6
# Flights, reflections of each: a look from a point, or all that the sources reach, of whose points
# one in 32 stands for all.
_LOOK, _ALL, _EACH = (64, 40), (2000, 120), 32
_MOST_LOOKS = 200
_MOST_SPACES = 6
_MOST_LOST = 0.02  # of a look's hits, for a space that is closed
_WEAK = 0.02  # of the strikes that a side of its area has: from beyond a gap
_SAMPLES = 100_000
_NEAREST, _PROBES = 3, 5  # points in the air, one of which must be in sight; chances
_SHARED = 0.1  # of a look, for one into a space that is known
# Share of the area behind openings above which a drawing is no room; a decay takes 100 hits.
LEAK_LIMIT = 1e-3
_DISAGREES = 0.02  # volume or area by the faces and by sound, for a room that is refused
_DOUBTED = 2.5e-5  # of the area


class _Faces(NamedTuple):
    """Triangles of which a ray meets both sides: side 2 i is the back of triangle i, 2 i + 1 its
    front, before which corners run counter-clockwise."""

    tree: Tree  # `material` is the triangle
    corners_m: FloatArray  # (n, 3, 3)
    normal: FloatArray  # (n, 3)
    area_m2: FloatArray  # (n,)
    rng: np.random.Generator


class _Sounded(NamedTuple):
    """What flights from points all over some sides say of the room that these bound."""

    volume_m3: float = 0.0
    area_m2: float = 0.0
    open: float = 1.0  # share of flights that are lost, or end on other sides
    lost_m: FloatArray = np.zeros((0, 3))  # where these began
    lost_way: FloatArray = np.zeros((0, 3))  # and their directions
    lost_on: IntArray = np.zeros(0, dtype=np.int64)  # those other sides
    hidden_m2: FloatArray = np.zeros(0)  # (n_sides,), within a body or behind another face


class _Space(NamedTuple):
    """What flights from one place strike."""

    sides: IntArray  # (n_struck,)
    hits_m: FloatArray  # (n, 3), before what was struck
    lost: float  # flights that met nothing any more, per strike
    point_m: FloatArray  # (3,), in its air
    volume_m3: float
    mean_free_path_m: float
    is_wall: bool = False  # lies between two shells of walls
    n_positions: int = 0  # positions in it
    bounds: BoolArray = np.zeros(0, dtype=np.bool_)  # (n_sides,), which bound its air
    sounded: _Sounded = _Sounded()


def _faces_of(mesh: Mesh, outwards: BoolArray) -> _Faces:
    corners = corners_m(mesh)
    n = len(corners)
    ones = np.ones(n, dtype=np.bool_)
    facets = facet_table(corners[:, 0], corners[:, 1], corners[:, 2], ones, ones, np.arange(n))
    facets.table[:, 3] += _FRONT_M * np.where(outwards, -1.0, 1.0)
    facets.table[:, 12] *= _EDGE_M / EDGE_M
    boxes = np.stack((corners.min(axis=1) - 2 * _EDGE_M, corners.max(axis=1) + 2 * _EDGE_M), axis=1)
    return _Faces(
        tree_of(facets, boxes),
        corners,
        facets.normal,
        triangle_areas_m2(mesh),
        np.random.default_rng(1),
    )


@kernel()
def _fly(
    first: int,
    stop: int,
    tree: Tree,
    starts_m: FloatArray,
    directions: FloatArray,
    struck: IntArray,
    hits_m: FloatArray,
    length_m: FloatArray,
) -> None:
    """Follow rays until they have been reflected enough or met no wall; for threads."""
    waiting = np.empty(WAITING, np.int32)
    for r in range(first, stop):
        key = ray_key(1, 0, r)
        o, d = row(starts_m, r), row(directions, r)
        for n in range(struck.shape[1]):
            t, i = nearest_in_tree(tree, o, d, -1, waiting)
            if i < 0:
                break
            normal = row(tree.normal, i)
            struck[r, n] = 2 * tree.material[i] + (1 if dot(normal, d) < 0.0 else 0)
            length_m[r] += t
            o = along(o, d, max(t - _BACK_M, 0.5 * t))
            put(hits_m[r], n, o)
            if n + 1 < struck.shape[1]:
                d = scattered(d, normal, uniform(key, 2 * n), uniform(key, 2 * n + 1))


def _flights(
    faces: _Faces, starts_m: FloatArray, directions: FloatArray, n_hits: int = 1
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return sides struck, (n, n_hits), -1 once a ray is lost, where, and each ray's length, (n,).

    Points are a little before the sides, shape (n, n_hits, 3).
    """
    struck = np.full((len(starts_m), n_hits), -1, dtype=np.int64)
    hits_m, length_m = np.zeros((*struck.shape, 3)), np.zeros(len(starts_m))
    in_threads(_fly, len(starts_m), faces.tree, starts_m, directions, struck, hits_m, length_m)
    return struck, hits_m, length_m


def _sees(faces: _Faces, hits_m: FloatArray, points_m: FloatArray) -> BoolArray:
    """Return from which points the way to one of the nearest points in the air is free."""
    from scipy.spatial import cKDTree  # heavy, and a box needs none

    _, near = cKDTree(hits_m).query(points_m, _NEAREST, eps=1)
    starts = np.repeat(points_m, _NEAREST, axis=0)
    ways = hits_m[np.minimum(near, len(hits_m) - 1).ravel()] - starts
    far_m = np.linalg.norm(ways, axis=1)
    struck, _, length_m = _flights(faces, starts, ways / np.maximum(far_m, 1e-12)[:, None])
    free = (struck[:, 0] < 0) | (length_m >= far_m)
    return np.asarray(free.reshape(-1, _NEAREST).any(axis=1))


def _is_joined(
    faces: _Faces, hits_m: FloatArray, points_m: FloatArray, away: FloatArray
) -> BoolArray:
    """Return from which points before sides sound comes to points in the air, straight or once
    reflected."""
    joined = _sees(faces, hits_m, points_m)
    unsure = faces.rng.permutation(np.flatnonzero(~joined))[: _ALL[0]]
    starts, away = (np.repeat(x[unsure], _PROBES, axis=0) for x in (points_m, away))
    struck, ends_m, _ = _flights(faces, starts, _cosine(faces, away))
    sees = (struck[:, 0] >= 0) & _sees(faces, hits_m, ends_m[:, 0])
    joined[unsure] = sees.reshape(-1, _PROBES).any(axis=1)
    return joined


def _before(faces: _Faces, sides: IntArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return sides, a random point before each, and the unit vector away from it, each (n, 3).

    Points upon which another face lies are left out.
    """
    u, v = faces.rng.random((2, len(sides), 1))
    u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
    a, b, c = np.moveaxis(faces.corners_m[sides // 2], 1, 0)
    away = faces.normal[sides // 2] * np.where(sides % 2, 1.0, -1.0)[:, None]
    points_m = a + u * (b - a) + v * (c - a) + _BACK_M * away
    bare = _flights(faces, points_m, -away)[0][:, 0] == sides
    return sides[bare], points_m[bare], away[bare]


def _cosine(faces: _Faces, away: FloatArray) -> FloatArray:
    """Return directions by Lambert's law about unit vectors, shape (n, 3)."""
    ball = faces.rng.normal(size=away.shape)
    ball = away + ball / np.linalg.norm(ball, axis=1)[:, None]
    return np.asarray(ball / np.maximum(np.linalg.norm(ball, axis=1), 1e-12)[:, None])


def _look(faces: _Faces, starts_m: FloatArray, directions: FloatArray, n_hits: int) -> _Space:
    """Return the space in which flights from some points stay, or that they leave."""
    struck, hits_m, length_m = _flights(faces, starts_m, directions, n_hits)
    stays, n_struck = struck[:, -1] >= 0, max(int(np.count_nonzero(struck >= 0)), 1)
    lost = np.count_nonzero(~stays) / n_struck
    own = (struck >= 0) & (stays | (lost > _MOST_LOST))[:, None]
    sides, times = np.unique(struck[own], return_counts=True)
    # sides that were struck once stand for those that were not yet
    covered = 1.0 - min(np.count_nonzero(times == 1) / max(times.sum(), 1), 0.98)
    free_m = float(length_m.sum() / n_struck)
    volume_m3 = float(faces.area_m2[sides // 2].sum() / covered * free_m / 4.0)
    return _Space(sides, hits_m[own], lost, starts_m[0], volume_m3, free_m)


def _spaces(faces: _Faces, positions_m: FloatArray) -> tuple[list[_Space], IntArray]:
    """Return closed spaces, or the one that loses least, and in which each position is, or -1."""
    n_rays, n_hits = _LOOK
    closed: list[_Space] = []
    leaking: list[_Space] = []
    owner = np.full(2 * len(faces.area_m2) + 1, -1)  # the last stands for no side

    def space_at(at_m: FloatArray, away: FloatArray) -> int:
        starts, ways = np.tile(at_m, (n_rays, 1)), _cosine(faces, np.tile(away, (n_rays, 1)))
        struck, hits, _ = _flights(faces, starts, ways)
        for i in set(owner[struck[:, 0]].tolist()) - {-1}:
            if _is_within(faces, closed[i], hits[struck[:, 0] >= 0, 0]):
                return int(i)
        space = _look(faces, starts, ways, n_hits)
        if space.lost > _MOST_LOST:
            leaking[:] = sorted([*leaking, space], key=lambda s: s.lost)[:1]
            return -1
        owner[space.sides] = np.where(owner[space.sides] < 0, len(closed), owner[space.sides])
        closed.append(space)
        return len(closed) - 1

    within = np.array([space_at(at_m, np.zeros(3)) for at_m in positions_m], dtype=np.int64)
    n_looks = 0
    for triangle in np.argsort(-faces.area_m2, kind="stable"):
        for side in (2 * triangle, 2 * triangle + 1):
            if owner[side] < 0 and n_looks < _MOST_LOOKS:
                for at_m, away in zip(*_before(faces, np.array([side]))[1:], strict=True):
                    space_at(at_m, away)
                n_looks += 1
    return closed or [space for space in leaking if len(space.sides)], within


def _is_within(faces: _Faces, space: _Space, hits_m: FloatArray) -> bool:
    """Return whether what flights struck stands in the air of a space: hardly any does beyond."""
    return bool(len(hits_m) and _sees(faces, space.hits_m, hits_m).mean() > _SHARED)


def _within_walls(faces: _Faces, spaces: Sequence[_Space]) -> BoolArray:
    """Return which spaces lie between two shells of walls: about others, and narrower than they."""
    boxes = [faces.corners_m[s.sides // 2].reshape(-1, 3) for s in spaces]
    low, high = (np.array([f(b, axis=0) for b in boxes]) for f in (np.min, np.max))
    low, high = low - WELD_TOLERANCE_M, high + WELD_TOLERANCE_M
    holds = np.all((low[:, None] <= low) & (high[:, None] >= high), axis=2)
    free_m = np.array([s.mean_free_path_m for s in spaces])
    return np.asarray(np.any(holds & (free_m > free_m[:, None]), axis=1))


def _sounded(faces: _Faces, bounds: BoolArray, hits_m: FloatArray) -> _Sounded:
    own = np.flatnonzero(bounds)
    ends = np.cumsum(faces.area_m2[own // 2])
    shots = (np.arange(_SAMPLES) + faces.rng.random(_SAMPLES)) / _SAMPLES
    drawn = own[np.minimum(np.searchsorted(ends, shots * ends[-1]), len(own) - 1)]
    side, points, away = _before(faces, drawn)
    ways = _cosine(faces, away)
    struck, _, length_m = _flights(faces, points, ways)
    returns = (struck[:, 0] >= 0) & bounds[struck[:, 0]]
    inside = returns.copy()
    inside[~returns] = _is_joined(faces, hits_m, points[~returns], away[~returns])
    lost, n_inside = inside & ~returns, max(int(np.count_nonzero(inside)), 1)
    n_hidden = np.bincount(drawn, minlength=len(bounds)) - np.bincount(
        side[inside], minlength=len(bounds)
    )
    area_m2 = float(ends[-1]) * n_inside / _SAMPLES
    return _Sounded(
        max(area_m2 * float(length_m[returns].sum()) / max(int(returns.sum()), 1) / 4.0, 1e-9),
        area_m2,
        np.count_nonzero(lost) / n_inside,
        points[lost],
        ways[lost],
        struck[lost & (struck[:, 0] >= 0), 0],
        n_hidden * float(ends[-1]) / _SAMPLES,
    )


def _bounding(faces: _Faces, space: _Space, starts_m: FloatArray) -> _Space:
    """Return a space with all the sides that bound its air, and points before them.

    Where flights from the air end on other sides others follow: a corridor is longer than they are.
    """
    area_m2, is_open = np.repeat(faces.area_m2, 2), space.lost > _MOST_LOST
    bounds, strikes = np.zeros(len(area_m2), dtype=np.bool_), np.zeros(len(area_m2))
    hits_m, sounded = np.zeros((0, 3)), _Sounded(open=1.0)
    for _ in range(_MOST_LOOKS):
        before = bounds.copy()
        if sounded.open > LEAK_LIMIT:
            starts = np.resize(starts_m, (_ALL[0], 3))
            ways = _cosine(faces, np.zeros_like(starts))
            struck, points, _ = _flights(faces, starts, ways, _ALL[1])
            stays = struck[:, -1:] >= 0
            is_open |= not stays.any()
            own = (struck >= 0) & (stays | is_open)
            strikes += np.bincount(struck[own], minlength=len(area_m2))
            expected = strikes.sum() * area_m2 / max(area_m2[strikes > 0].sum(), 1e-300)
            bounds |= strikes > (0.0 if is_open else _WEAK * expected)
            hits_m = np.concatenate((hits_m, points[own & bounds[struck]][::_EACH]))
        for _ in range(0 if is_open else 4):
            # what is too small to be struck, but looks at what was
            small = (expected < 20.0) & (area_m2 > 0.0)
            small[sounded.lost_on] = True
            chosen = np.repeat(np.flatnonzero(small & ~bounds), _PROBES)
            others, at_m, away = _before(faces, chosen)
            joined = _is_joined(faces, hits_m, at_m, away)
            votes = np.bincount(others, np.where(joined, 1.0, -1.0), len(bounds))
            joined &= votes[others] > 0.0
            bounds |= votes > 0.0
            hits_m = np.concatenate((hits_m, at_m[joined]))
            if not joined.any():
                break
        if np.array_equal(bounds, before):
            break
        sounded = _sounded(faces, bounds, hits_m)
        starts_m = sounded.lost_m
    return space._replace(hits_m=hits_m, bounds=bounds, sounded=sounded)


def _bounded(mesh: Mesh, bounds: BoolArray) -> Mesh:
    """Return the triangles that bound the air, normals out of it, sheets where both sides do.

    The mesh itself where that changes nothing.
    """
    back, front = bounds.reshape(-1, 2).T
    kept = back | front
    is_sheet = back & front
    if np.array_equal(is_sheet, is_double_sided(mesh)) and np.all(back):
        return mesh
    triangles = np.where((front & ~back)[:, None], mesh.triangles[:, ::-1], mesh.triangles)[kept]
    kind = 2 * mesh.triangle_surface[kept] + is_sheet[kept]
    # names that bound no air stay, so that a campaign may speak of them
    kinds = np.union1d(kind, 2 * np.setdiff1d(np.arange(len(mesh.surfaces)), kind // 2))
    surfaces = [replace(mesh.surfaces[k // 2], double_sided=bool(k % 2)) for k in kinds]
    used, corners = np.unique(triangles, return_inverse=True)
    return Mesh(
        mesh.vertices_m[used], corners.reshape(-1, 3), np.searchsorted(kinds, kind), tuple(surfaces)
    )


def reached(mesh: Mesh, positions_m: ArrayLike = ()) -> tuple[Mesh, tuple[Finding, ...]]:
    """Return the faces that bound the air which sound reaches, and in what the drawing differs.

    Parameters
    ----------
    mesh : Mesh
        Of `roomfit.room.build.build_mesh`: faces turned anyhow, with whatever else was drawn.
    positions_m : array_like, shape (n, 3), optional
        The closed space that holds most of them is the room; without any the largest.

    Returns
    -------
    mesh : Mesh
        Normals out of the air, sheets double-sided; the same mesh where it is so already.
    findings : tuple of Finding
        Leaks, with size and place, and bodies that cross are faults.
    """
    if box_of(mesh) is not None:  # the kernels take seconds to compile
        return mesh, ()
    positions = np.asarray(positions_m, dtype=np.float64).reshape(-1, 3)
    drawn, crossed = mesh, np.zeros(len(mesh.triangles), dtype=np.bool_)
    for n_cuts in range(4):
        explored = _explored(mesh, positions, np.zeros(len(mesh.triangles), dtype=np.bool_))
        if explored is None:
            return drawn, ()
        faces, spaces = explored
        sounded = spaces[0].sounded
        hidden = sounded.hidden_m2.reshape(-1, 2).sum(axis=1)
        is_whole = hidden.sum() <= _DOUBTED * sounded.area_m2 or spaces[0].lost > _MOST_LOST
        if is_whole or n_cuts == 3:
            break
        mesh, crossed = _cut(mesh, hidden > 0.0, crossed)
    outwards = _between_bodies(drawn, faces, spaces)
    if outwards.any() and (explored := _explored(mesh, positions, outwards)) is not None:
        faces, spaces = explored
        sounded = spaces[0].sounded
    bounds = spaces[0].bounds
    mostly = sounded.hidden_m2 > 0.5 * np.repeat(faces.area_m2, 2)
    if np.any(bounds & ~mostly) and mostly.any():  # those were reached through a crack
        bounds = bounds & ~mostly
        sounded = _sounded(faces, bounds, spaces[0].hits_m)
    room = _bounded(mesh, bounds)
    spaces[0] = spaces[0]._replace(volume_m3=volume_m3(room))
    findings = (
        *_several(spaces, len(positions)),
        *_reached(drawn, mesh, room, bounds),
        *_crossing(mesh, room, spaces, sounded, crossed),
    )
    if not any(f.severity == "serious" for f in findings):
        findings += tuple(_leaks(room, sounded))
    return room, findings


def _planes(corners_m: FloatArray, normals: FloatArray) -> list[tuple[float, ...]]:
    """Return the plane of each side and where it looks, to the millimetre."""
    looks = np.repeat(normals, 2, axis=0) * np.resize([-1.0, 1.0], 2 * len(normals))[:, None]
    off_m = np.einsum("ij,ij->i", looks, np.repeat(corners_m[:, 0], 2, axis=0))
    # rounded at no round number
    return [*map(tuple, np.round(np.column_stack((looks, off_m)) + 3.7e-4, 3).tolist())]


def _between_bodies(drawn: Mesh, faces: _Faces, spaces: Sequence[_Space]) -> BoolArray:
    """Return which triangles lie in walls to other rooms, of bodies whose fronts look outwards.

    Such a wall closes a body: edges of it are those of others, the other way round.
    """
    own = _planes(faces.corners_m, faces.normal)
    back_m2, front_m2 = spaces[0].bounds.reshape(-1, 2).T @ faces.area_m2
    others = [s.bounds for s in spaces[1:] if not s.is_wall and back_m2 > 2 * front_m2]
    beyond = {own[i] for bounds in others for i in np.flatnonzero(bounds)}
    shared = {own[i ^ 1] for i in np.flatnonzero(spaces[0].bounds)} & beyond
    normals = area_vectors_m2(drawn) / np.maximum(triangle_areas_m2(drawn), 1e-300)[:, None]
    ways = np.stack((drawn.triangles, np.roll(drawn.triangles, -1, axis=1)), axis=2)
    sides = [plane in shared for plane in _planes(corners_m(drawn), normals)]
    in_wall = np.repeat(np.reshape(sides, (-1, 2)).any(axis=1), 3)
    edges = ways.reshape(-1, 2)
    around = set(map(tuple, edges[~in_wall].tolist()))
    closing = sum((b, a) in around for a, b in edges[in_wall].tolist())
    if 3 * closing < np.count_nonzero(in_wall):
        shared = set()
    return np.asarray(np.reshape([plane in shared for plane in own], (-1, 2)).any(axis=1))


def _explored(
    mesh: Mesh, positions_m: FloatArray, outwards: BoolArray
) -> tuple[_Faces, list[_Space]] | None:
    """Return the room and other spaces worth a word; None where no flight meets a face."""
    faces = _faces_of(mesh, outwards)
    looks, within = _spaces(faces, positions_m)
    if not looks:
        return None
    is_wall = _within_walls(faces, looks)
    looks = [
        look._replace(n_positions=int(np.sum(within == i)), is_wall=bool(is_wall[i]))
        for i, look in enumerate(looks)
    ]
    spaces: list[_Space] = []
    for i in sorted(range(len(looks)), key=lambda i: _rank(looks[i]), reverse=True):
        look, n = looks[i], looks[i].n_positions
        first_m = look.hits_m[:: _LOOK[1]]
        k = next((k for k, s in enumerate(spaces) if _is_within(faces, s, first_m)), None)
        if k is not None:
            spaces[k] = spaces[k]._replace(n_positions=spaces[k].n_positions + n)
        elif not spaces or (
            (n or look.volume_m3 > _DISAGREES * spaces[0].volume_m3) and len(spaces) < _MOST_SPACES
        ):
            space = _bounding(faces, look, positions_m[within == i] if n else look.point_m)
            spaces.append(space._replace(volume_m3=volume_m3(_bounded(mesh, space.bounds))))
    return faces, sorted(spaces, key=_rank, reverse=True)


def _rank(space: _Space) -> tuple[int, bool, float]:
    """Return by what the room is chosen: positions, or else the volume, except of walls."""
    return space.n_positions, not space.is_wall, space.volume_m3


def _cut(mesh: Mesh, some: BoolArray, crossed: BoolArray) -> tuple[Mesh, BoolArray]:
    """Return a mesh in which some triangles end where others cross them or lie upon them.

    Of two of one plane that face the same way the smaller keeps what both cover. Second come the
    triangles that are pieces of one which others cross.
    """
    corners, areas = corners_m(mesh), triangle_areas_m2(mesh)
    normals = area_vectors_m2(mesh) / np.maximum(areas, 1e-300)[:, None]
    low, high = corners.min(axis=1) - WELD_TOLERANCE_M, corners.max(axis=1) + WELD_TOLERANCE_M
    pieces = [corners[~some]]
    origin = [np.flatnonzero(~some)]
    crossed, n_pairs = crossed.copy(), 0
    for i in np.flatnonzero(some):
        parts, spans = [corners[i]], np.stack((low[i], high[i]))[None]
        near = np.all((low <= high[i]) & (high >= low[i]), axis=1)
        near[i] = False
        for j in np.flatnonzero(near):
            touched = np.all((spans[:, 0] <= high[j]) & (spans[:, 1] >= low[j]), axis=1)
            n_pairs += int(np.count_nonzero(touched))
            check_limit("crossings", n_pairs, "the room file")
            mine = [parts[k] for k in np.flatnonzero(touched)]
            height_m = (corners[j] - corners[i, 0]) @ normals[i]
            if np.all(np.abs(height_m) < WELD_TOLERANCE_M):
                faces_alike = normals[i] @ normals[j] > 0.0
                if faces_alike and (areas[j], j) >= (areas[i], i):
                    continue
                divided = [divide(part, corners[j]) for part in mine]
                new = [p for _, outside in divided for p in outside]
                if not faces_alike:
                    new += [inner for inner, _ in divided if inner is not None]
            elif height_m.min() < WELD_TOLERANCE_M and height_m.max() > -WELD_TOLERANCE_M:
                new = [p for part in mine for p in _halved(part, corners[j, 0], normals[j])]
                crosses = height_m.min() < -WELD_TOLERANCE_M and height_m.max() > WELD_TOLERANCE_M
                crossed[i] |= crosses and len(new) > len(mine)
            else:
                continue
            parts = [parts[k] for k in np.flatnonzero(~touched)] + new
            new_spans = [(p.min(axis=0), p.max(axis=0)) for p in new]
            spans = np.concatenate((spans[~touched], np.reshape(new_spans, (-1, 2, 3))))
        own = [part[triangulate(part).triangles] for part in parts]
        pieces += own
        origin.append(np.full(sum(map(len, own)), i))
    points, of = np.concatenate(pieces).reshape(-1, 3), np.concatenate(origin)
    order = np.argsort(of, kind="stable")
    stands_for = weld(points)
    triangles = stands_for.reshape(-1, 3)[order]
    whole = np.all(triangles != np.roll(triangles, 1, axis=1), axis=1)
    cut = Mesh(points, triangles[whole], mesh.triangle_surface[of[order][whole]], mesh.surfaces)
    return cut, crossed[of[order][whole]]


def _halved(part: FloatArray, at_m: FloatArray, normal: FloatArray) -> list[FloatArray]:
    """Return a polygon whole, or its two sides of a plane."""
    two = halves(part, at_m, normal)
    return [part] if any(map(is_thin, two)) else list(two)


def _several(spaces: Sequence[_Space], n_positions: int) -> Iterator[Finding]:
    """Yield which closed spaces there are beside the room, which is the first of them."""
    own = [s for s in spaces[1:] if s.n_positions or not s.is_wall]
    if not own:
        return
    parts = []
    for space in (spaces[0], *own):
        of = f" with {space.n_positions} of {n_positions} positions" if n_positions else ""
        parts.append(f"{space.volume_m3:.3g} m3{of} near {place(space.point_m)}")
    text = (
        f"The drawing has {len(parts)} closed spaces: {parts[0]}, which is taken as the room; "
        f"{'; '.join(parts[1:])}. No path leads from one to another."
    )
    is_clear = spaces[0].n_positions and not any(s.n_positions for s in own)
    about, evidence = about_points([s.point_m for s in own]), {"n_spaces": len(parts)}
    graded: Severity = "info" if is_clear else "warning"
    yield Finding(Code.SEVERAL_SPACES, about, text, evidence, graded=graded)


def _reached(drawn: Mesh, mesh: Mesh, room: Mesh, bounds: BoolArray) -> Iterator[Finding]:
    """Yield what of a drawing is not in the room as it was drawn."""
    back, front = bounds.reshape(-1, 2).T
    areas = triangle_areas_m2(mesh)
    drawn_m3, drawn_m2 = abs(volume_m3(drawn)), surface_area_m2(drawn)
    own_m3, own_m2 = volume_m3(room), surface_area_m2(room)
    left_out, sheet = ~(back | front), back & front & ~is_double_sided(mesh)
    turned = front & ~back
    if areas[turned].sum() > 0.5 * areas[~left_out].sum():
        turned = back & ~front  # against the rest
    said = []
    for which, what in (
        (left_out, "bound no air that it reaches and are left out"),
        (sheet, "are struck on both sides, which both count"),
        (turned, "were oriented against the rest and are turned"),
    ):
        if which.any():
            parts = _names(mesh, which, areas)
            said.append(f"{which.sum()} triangles of {areas[which].sum():.3g} m2 {what} ({parts})")
    if not said:
        return
    changes = max(abs(own_m3 / max(drawn_m3, 1e-9) - 1.0), abs(own_m2 / drawn_m2 - 1.0)) > 0.01
    text = (
        f"Sound reaches {own_m3:.2f} m3 within {own_m2:.2f} m2; as they were drawn the faces "
        f"enclose {drawn_m3:.2f} m3 and have {drawn_m2:.2f} m2. {'; '.join(said)}."
    )
    at = corners_m(mesh)[left_out | sheet | turned].mean(axis=1)
    evidence = {"volume_m3": own_m3, "area_m2": own_m2, "drawn_m3": drawn_m3, "drawn_m2": drawn_m2}
    graded: Severity = "warning" if changes else "info"
    yield Finding(Code.AIR_REACHED, about_points(at), text, evidence, graded=graded)


def _names(mesh: Mesh, which: BoolArray, size: FloatArray) -> str:
    """Return the surfaces of some triangles, each with its largest, the largest first."""
    spots: dict[str, str] = {}
    middles = corners_m(mesh).mean(axis=1)
    for t in np.flatnonzero(which)[np.argsort(-size[which], kind="stable")]:
        name = mesh.surfaces[mesh.triangle_surface[t]].name
        if name not in spots:
            spots[name] = place(middles[t])
    return listed(list(spots.items()))


def _leaks(room: Mesh, sounded: _Sounded) -> Iterator[Finding]:
    """Yield through which opening sound is lost."""
    if not len(sounded.lost_m):
        return
    # where they leave the box about the room
    far_m = np.where(sounded.lost_way > 0.0, room.vertices_m.max(axis=0), room.vertices_m.min(0))
    with np.errstate(divide="ignore", invalid="ignore"):
        along_m = np.nanmin((far_m - sounded.lost_m) / sounded.lost_way, axis=1, initial=1e6)
    exits_m = (sounded.lost_m + np.maximum(along_m, 0.0)[:, None] * sounded.lost_way)[:200]
    beside = room.triangle_surface[nearest_triangles(room, exits_m)[1]]
    spots = [
        (room.surfaces[k].name, place(np.median(exits_m[beside == k], axis=0)))
        for k in sorted(set(beside.tolist()), key=lambda k: -np.count_nonzero(beside == k))
    ]
    lost = sounded.open
    size = f"an opening of about {lost * sounded.area_m2:.3g} m2"
    found = f"{size}: {len(sounded.lost_m)} of {_SAMPLES} flights lost ({1e2 * lost:.3g} %)"
    serious = lost > LEAK_LIMIT
    yield fault(
        Code.LEAK if serious else Code.SMALL_LEAK,
        "the mesh leaks" if serious else "the mesh leaks a little",
        where=listed(spots),
        found=found,
        needed=f"at most {1e2 * LEAK_LIMIT:g} %",
        hint="close the gap in the drawing program, or add the missing surface",
        points_m=sounded.lost_m,
        share=lost,
        area_m2=lost * sounded.area_m2,
    )


def _crossing(
    mesh: Mesh, room: Mesh, spaces: Sequence[_Space], sounded: _Sounded, crossed: BoolArray
) -> Iterator[Finding]:
    """Yield faces for which it is open what is air, or which have not the volume that sound has."""
    own_m3, own_m2 = volume_m3(room), surface_area_m2(room)
    beyond = [
        s.volume_m3
        for s in spaces[1:]
        if crossed[s.sides // 2].any() and s.volume_m3 > _DISAGREES * own_m3
    ]
    off = max(abs(own_m3 / sounded.volume_m3 - 1.0), abs(own_m2 / sounded.area_m2 - 1.0))
    if len(beyond) > 1:
        size_m2 = triangle_areas_m2(mesh) * crossed
        found = f"{own_m3:.4g} m3 on one side of their faces, {sum(beyond):.3g} m3 beyond"
        what, needed = "bodies run through each other", "bodies that do not share space"
        hint = (
            "unite them in the drawing program (Boolean union), so that no face divides the air, "
            "or take out the one that is no air"
        )
    elif off > _DISAGREES and sounded.open <= LEAK_LIMIT:
        size_m2 = sounded.hidden_m2.reshape(-1, 2).sum(axis=1)
        found = (
            f"{own_m3:.4g} m3 and {own_m2:.4g} m2 by the faces, {sounded.volume_m3:.4g} m3 and "
            f"{sounded.area_m2:.4g} m2 by flights of sound"
        )
        what, needed = "the faces do not bound the air", f"agreement within {1e2 * _DISAGREES:g} %"
        hint = "draw faces that meet edge to edge; of two faces on one place delete one"
    else:
        return
    at, where = corners_m(mesh)[size_m2 > 0.0].mean(axis=1), _names(mesh, size_m2 > 0.0, size_m2)
    code = Code.FACES_CROSS
    yield fault(code, what, where=where, found=found, needed=needed, hint=hint, points_m=at)
