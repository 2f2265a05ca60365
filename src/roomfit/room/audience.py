"""The area with which a block of seats absorbs: its own, and a strip along its free edges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roomfit.base.errors import InputError
from roomfit.base.polygon import area_vector_m2, place, triangulate
from roomfit.base.typing import FloatArray
from roomfit.room.inside import is_inside, to_walls_m
from roomfit.room.mesh import Mesh, corners_m

EAR_M = 0.4  # above the floor: within a block of seats, below most rails
_SAMPLES = 9  # of the room beside an edge
_STEP_M = 0.01
# Edges that turn by less run on, and corners sharper than 120 degrees get no longer strip.
_STRAIGHT, _SHARPEST = np.radians(10.0), np.radians(120.0)


def audience_area_m2(
    mesh: Mesh, outlines_m: Sequence[FloatArray], edge_m: float
) -> tuple[float, float]:
    """Return the area of blocks of seats on the floor, and that with strips along free edges.

    A strip is `edge_m` wide, and narrower where a wall, or half of an aisle between two of the
    blocks, is nearer: none where a block stands at a wall or a rail. Strips meet in corners, so
    that a block of L by W that stands free counts (L + 2 edge) (W + 2 edge) [1]_ [2]_.

    Parameters
    ----------
    mesh : Mesh
    outlines_m : sequence of float arrays, shape (n_corners, 3)
        Corners of each block in order, on the floor; sloping floors have sloping blocks.
    edge_m : float
        0 or more; 0.5 in the tables of Beranek and Hidaka.

    Raises
    ------
    InputError
        An outline has no area or crosses itself, or 0.4 m above it is no air.

    References
    ----------
    .. [1] U. Kath and W. Kuhl, "Messungen zur Schallabsorption von Polsterstuehlen mit und ohne
           Personen", Acustica 15, 127-131 (1965).
    .. [2] L. L. Beranek and T. Hidaka, "Sound absorption in concert halls by seats, occupied and
           unoccupied, and by the hall's interior surfaces", J. Acoust. Soc. Am. 104, 3169-3177
           (1998).

    Examples
    --------
    >>> from roomfit.room.mesh import shoebox_mesh
    >>> hall, block = shoebox_mesh((20, 10, 8)), [(5, 2, 0), (15, 2, 0), (15, 8, 0), (5, 8, 0)]
    >>> [round(a, 9) for a in audience_area_m2(hall, [np.array(block, dtype=float)], 0.5)]
    [60.0, 77.0]
    """
    outlines = [_turning_left(o) for o in outlines_m]
    for outline in outlines:
        above = points_on(outline) + np.array([0.0, 0.0, EAR_M])
        outside = above[~is_inside(mesh, above)]
        if len(outside):
            raise InputError(
                "over a block of seats is no air",
                found=f"{place(outside[0])} is not within the room",
                needed=f"corners on the floor, and air {EAR_M:g} m above it",
                hint="a block that is drawn as a solid absorbs by its faces: give their material "
                "the absorption, and leave the outline out",
            )
    walls_m = corners_m(mesh)
    own = float(sum(np.linalg.norm(area_vector_m2(o)) for o in outlines))
    strips = 0.0
    for i, outline in enumerate(outlines):
        others = [o for k, o in enumerate(outlines) if k != i]
        sides = np.roll(outline, -1, axis=0) - outline
        lengths = np.linalg.norm(sides, axis=1)
        widths = _widths_m(walls_m, outline, others, edge_m)
        strips += float(lengths @ widths)
        way = sides[:, :2] / np.linalg.norm(sides[:, :2], axis=1)[:, None]
        strips += sum(
            _corner_m2(widths[k - 1], widths[k], way[k - 1], way[k]) for k in range(len(way))
        )
    return own, own + strips


def points_on(outline_m: FloatArray) -> FloatArray:
    """Return points within an outline, in the middle and near every corner, shape (n, 3)."""
    corners = outline_m[triangulate(outline_m).triangles]
    middles = corners.mean(axis=1, keepdims=True)
    near = corners + 0.02 * (middles - corners)  # of the way to the middle of the triangle
    return np.concatenate([middles, near], axis=1).reshape(-1, 3)


def _turning_left(outline_m: FloatArray) -> FloatArray:
    cut = triangulate(outline_m)
    if not len(cut.triangles) or cut.crosses_itself:
        found = "an outline that crosses itself" if len(cut.triangles) else "no area"
        what, needed = "the outline of a block is none", "corners x, y, z in m, around the block"
        hint = "list them as they are met on a walk around the seats"
        raise InputError(what, found=found, needed=needed, hint=hint)
    # walls beside an edge are looked for on a level
    up = float(area_vector_m2(outline_m)[2])
    if abs(up) < 0.5 * cut.area_m2:
        what, found = "a block of seats stands upright", f"{abs(up):.2f} m2 as seen from above"
        needed, hint = "corners on the floor", "z is the height of the floor at each corner"
        raise InputError(what, found=found, needed=needed, hint=hint)
    sides_m = np.linalg.norm((outline_m - np.roll(outline_m, 1, axis=0))[:, :2], axis=1)
    if sides_m.min() < _STEP_M:
        what, needed = "a corner of a block stands twice", f"{_STEP_M:g} m or more between them"
        found, hint = f"two, {sides_m.min():g} m apart", "the last corner is not the first again"
        raise InputError(what, found=found, needed=needed, hint=hint)
    return outline_m if up > 0.0 else outline_m[::-1]


def _widths_m(
    walls_m: FloatArray, outline_m: FloatArray, others_m: Sequence[FloatArray], edge_m: float
) -> FloatArray:
    """Return the mean width of the strip along every edge of a block, shape (n_edges,)."""
    ends = np.roll(outline_m, -1, axis=0)
    at = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    found = []
    for a, b in zip(outline_m, ends, strict=True):
        flat = (b - a)[:2] / np.linalg.norm((b - a)[:2])
        outwards = np.array([flat[1], -flat[0], 0.0])
        # a block may end in the wall itself
        starts = a + at[:, None] * (b - a) + [0.0, 0.0, EAR_M] - _STEP_M * outwards
        free = to_walls_m(walls_m, starts, outwards) - _STEP_M
        for other in others_m:
            aisle = _to_block_m(other[:, :2], starts[:, :2], outwards[:2]) - _STEP_M
            free = np.minimum(free, 0.5 * aisle)
        found.append(np.clip(free, 0.0, edge_m).mean())
    return np.array(found)


def _to_block_m(outline_m: FloatArray, starts_m: FloatArray, way: FloatArray) -> FloatArray:
    """Return the distance from points to another block as seen from above, shape (n_points,)."""
    a = outline_m
    side = np.roll(a, -1, axis=0) - a
    cross = way[0] * side[:, 1] - way[1] * side[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        s = a - starts_m[:, None]
        t = (s[..., 0] * side[:, 1] - s[..., 1] * side[:, 0]) / cross
        u = (s[..., 0] * way[1] - s[..., 1] * way[0]) / cross
    hit = (u >= 0.0) & (u <= 1.0) & (t > 0.0)
    return np.asarray(np.where(hit, t, np.inf).min(axis=1))


def _corner_m2(before_m: float, after_m: float, way: FloatArray, next_way: FloatArray) -> float:
    """Return what strips of two widths share at a corner: negative where they overlap.

    The lines at these distances from the edges meet; with the turn f that is the area
    (v w - (v^2 + w^2) cos f / 2) / sin f beyond both strips.
    """
    turn = np.arctan2(way[0] * next_way[1] - way[1] * next_way[0], way @ next_way)
    if abs(turn) < _STRAIGHT:
        return 0.0
    turn = float(np.clip(turn, -_SHARPEST, _SHARPEST))
    squares = 0.5 * (before_m**2 + after_m**2) * np.cos(turn)
    return float((before_m * after_m - squares) / np.sin(turn))
