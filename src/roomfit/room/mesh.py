"""The surface of a room as triangles that keep the names, groups and materials of their file.

Volume, area and mean free path are measured. A fault is a finding so serious that a room cannot be
traced.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from roomfit.base.arguments import float_array, int_array
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.polygon import WELD_TOLERANCE_M, Surface
from roomfit.base.typing import FloatArray, IntArray


def fault(
    code: Code,
    what: str,
    *,
    where: str | None = None,
    found: str | None = None,
    needed: str | None = None,
    hint: str | None = None,
    points_m: Iterable[FloatArray] = (),
    **evidence: Any,
) -> Finding:
    """Return a finding of a serious code with the error that it becomes where it stops a command.

    `roomfit check` lists all faults of a room; everything else stops at the first, see `refuse`.
    """
    parts = {"where": where, "found": found, "needed": needed, "try": hint}
    stated = {"what": what, **{key: text for key, text in parts.items() if text}, **evidence}
    text = what + (f" at {where}" if where else "") + (f": {found}" if found else "") + "."
    error = InputError(what, where=where, found=found, needed=needed, hint=hint)
    return Finding(code, about_points(points_m), text, stated, error=error)


_MOST_POINTS = 100


def about_points(points_m: Iterable[FloatArray]) -> About:
    """Return what concerns places in the room, the first hundred of them."""
    return About(points_m=[(p[0], p[1], p[2]) for p in islice(points_m, _MOST_POINTS)])


def refuse(findings: Iterable[Finding]) -> None:
    """Raise the first serious finding as an error; return where there is none.

    Raises
    ------
    InputError
        Says what, where, found, needed and try, and how many more faults there are.
    """
    serious = [f for f in findings if f.severity == "serious"]
    if not serious:
        return
    error = serious[0].error or InputError(serious[0].sentence)
    hints = [error.hint] if error.hint else []
    if len(serious) > 1:
        others = sorted({f.code for f in serious[1:]})
        hints.append(f"there are {len(serious) - 1} more faults ({', '.join(others)})")
    raise InputError(
        error.what,
        where=error.where,
        found=error.found,
        needed=error.needed,
        hint="; ".join(hints) or None,
        points_m=serious[0].about.points_m,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles in metres, z up, normals pointing out of the air (so a room has volume > 0)."""

    vertices_m: FloatArray  # (n_vertices, 3)
    triangles: IntArray  # int32 (n_triangles, 3), corners, counter-clockwise from outside the room
    triangle_surface: IntArray  # int32 (n_triangles,), index into `surfaces`
    surfaces: tuple[Surface, ...]

    def __post_init__(self) -> None:
        vertices = float_array("vertices", self.vertices_m, (None, 3), low=-1e6, high=1e6, unit="m")
        triangles = int_array("triangles", self.triangles, (None, 3), low=0, high=len(vertices) - 1)
        if len(triangles) == 0:
            what = "a mesh without faces"
            hint = "export the room with its surfaces, not lines or points alone"
            raise InputError(what, found="no triangle", needed="at least one triangle", hint=hint)
        owner = int_array(
            "surface of each triangle",
            self.triangle_surface,
            (len(triangles),),
            low=0,
            high=len(self.surfaces) - 1,
        )
        object.__setattr__(self, "vertices_m", vertices)
        object.__setattr__(self, "triangles", triangles)
        object.__setattr__(self, "triangle_surface", owner)
        object.__setattr__(self, "surfaces", tuple(self.surfaces))


def corners_m(mesh: Mesh) -> FloatArray:
    """Return the corners of every triangle, shape (n_triangles, 3 corners, 3)."""
    return np.asarray(mesh.vertices_m[mesh.triangles])


def area_vectors_m2(mesh: Mesh) -> FloatArray:
    """Return normal times area of every triangle, shape (n_triangles, 3); it points outwards."""
    a, b, c = np.moveaxis(corners_m(mesh), 1, 0)
    return np.asarray(0.5 * np.cross(b - a, c - a))


def triangle_areas_m2(mesh: Mesh) -> FloatArray:
    """Return the area of one side of every triangle, shape (n_triangles,)."""
    return np.asarray(np.linalg.norm(area_vectors_m2(mesh), axis=1))


def is_double_sided(mesh: Mesh) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return for every triangle whether it is a double-sided sheet, shape (n_triangles,)."""
    flags = np.array([s.double_sided for s in mesh.surfaces], dtype=np.bool_)
    return np.asarray(flags[mesh.triangle_surface])


def volume_m3(mesh: Mesh) -> float:
    """Return the enclosed volume; negative where the normals point into the air.

    The divergence theorem over the triangles that enclose (sheets in the air are left out). It is
    taken about the middle of the room: exact for a closed mesh wherever that is, and for a mesh
    with small gaps the choice that counts each missing piece least.
    """
    walls = ~is_double_sided(mesh)
    if not walls.any():
        return 0.0
    vectors = area_vectors_m2(mesh)[walls]
    middles = corners_m(mesh)[walls].mean(axis=1)
    areas = np.linalg.norm(vectors, axis=1)
    total = areas.sum()
    middle = (areas @ middles) / total if total > 0.0 else middles.mean(axis=0)
    return float(np.einsum("ij,ij->", middles - middle, vectors) / 3.0)


def surface_area_m2(mesh: Mesh) -> float:
    """Return the area that sound can strike: both sides of sheets in the air, one of walls."""
    return float(triangle_areas_m2(mesh) @ np.where(is_double_sided(mesh), 2.0, 1.0))


def mean_free_path_m(mesh: Mesh) -> float:
    """Return the mean distance between two reflections in a diffuse field, ``4 V / S`` [1]_.

    References
    ----------
    .. [1] C. W. Kosten, "The mean free path in room acoustics", Acustica 10, 245-250 (1960).
    """
    return 4.0 * volume_m3(mesh) / surface_area_m2(mesh)


SHOEBOX_SURFACES = ("west", "east", "south", "north", "floor", "ceiling")

# corner k of the unit box stands at the binary digits of k: x = bit 0, y = bit 1, z = bit 2
_QUADS = (
    *((0, 4, 6, 2), (1, 3, 7, 5)),  # west x = 0, east
    *((0, 1, 5, 4), (2, 6, 7, 3)),  # south y = 0, north
    *((0, 2, 3, 1), (4, 5, 7, 6)),  # floor z = 0, ceiling
)


def shoebox_mesh(lengths_m: ArrayLike) -> Mesh:
    """Return a box with one corner at the origin.

    Parameters
    ----------
    lengths_m : array_like, shape (3,)
        Lengths along x, y and z, each 1 mm to 10 km.

    Returns
    -------
    Mesh
        12 triangles, outward normals; surfaces west (x = 0), east, south (y = 0), north, floor
        and ceiling, in that order. Each carries its own name as material; the four upright ones
        form the group "walls", so that one key can name them all.

    Examples
    --------
    >>> box = shoebox_mesh((6.0, 5.0, 3.0))
    >>> round(volume_m3(box), 9), surface_area_m2(box), round(mean_free_path_m(box), 3)
    (90.0, 126.0, 2.857)
    """
    lengths = float_array("length of the box", lengths_m, (3,), low=1e-3, high=1e4, unit="m")
    corners = np.array([[k & 1, k >> 1 & 1, k >> 2 & 1] for k in range(8)]) * lengths
    triangles = [t for a, b, c, d in _QUADS for t in ((a, b, c), (a, c, d))]
    surfaces = tuple(
        Surface(name, "walls" if i < 4 else None, name) for i, name in enumerate(SHOEBOX_SURFACES)
    )
    return Mesh(corners, np.array(triangles), np.repeat(np.arange(6), 2), surfaces)


class Box(NamedTuple):
    """A box anywhere: a point x stands ``axes @ (x - origin_m)`` from one of its corners."""

    origin_m: FloatArray  # (3,), that corner
    axes: FloatArray  # (3, 3), unit vectors along its edges from there, one a row, right-handed
    lengths_m: FloatArray  # (3,)
    wall: IntArray  # (n_triangles,), of each: 2 axis for the wall at 0, 2 axis + 1 for the other


def box_of(mesh: Mesh) -> Box | None:
    """Return the box that a mesh is, wherever it stands and however it is turned; None for no box.

    Every triangle lies in one of six planes and faces out of the box, and those of a plane cover
    it once. A door flush in a wall is part of that; a niche, a sheet or furniture is not. What a
    box encloses is known at once, and its image sources form a lattice.

    Parameters
    ----------
    mesh : Mesh
        Normals out of the air.

    Returns
    -------
    Box or None
        The third axis is the one nearest to z, the first of the others that nearest to x.
    """
    vectors = area_vectors_m2(mesh)
    if is_double_sided(mesh).any():
        return None
    first = _facing(vectors)
    second = _facing(vectors - np.outer(vectors @ first, first))
    axes = np.array([first, second, np.cross(first, second)])
    axes = axes[np.argsort(np.abs(axes[:, 2]), kind="stable")]
    x = axes[int(np.abs(axes[1, 0]) > np.abs(axes[0, 0]))]
    x, z = x * np.copysign(1.0, x[0]), axes[2] * np.copysign(1.0, axes[2, 2])
    axes = np.array([x, np.cross(z, x), z])
    corners = corners_m(mesh) @ axes.T
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    lengths = high - low
    planes = np.stack([low, high], axis=1).ravel()
    heights = corners[:, :, [0, 0, 1, 1, 2, 2]] - planes
    lies_in = np.abs(heights).max(axis=1) <= WELD_TOLERANCE_M  # (n_triangles, 6)
    if lengths.min() < 1e-3 or not np.all(lies_in.sum(axis=1) == 1):
        return None
    wall = np.argmax(lies_in, axis=1)
    outwards = np.einsum("ni,ni->n", vectors, axes[wall // 2]) * np.where(wall % 2, 1.0, -1.0)
    whole = np.repeat(np.prod(lengths) / lengths, 2)
    # each wall is covered once, by its area and the second moments of that about its middle
    own, share = 2.0 * (corners - low) / lengths - 1.0, outwards / whole[wall]
    total = own.sum(axis=1)
    moments = np.einsum("nki,nkj->nij", own, own) + total[:, :, None] * total[:, None]
    of_wall = np.zeros((6, 3, 3))
    np.add.at(of_wall, wall, share[:, None, None] * moments / 12.0)
    expected = (1.0 + 2.0 * np.eye(3)[np.arange(6) // 2])[:, None] * np.eye(3) / 3.0
    once = np.allclose(np.bincount(wall, share, 6), 1.0, rtol=1e-4)
    if np.any(outwards < 0.0) or not once or not np.allclose(of_wall, expected, atol=1e-4):
        return None
    return Box(low @ axes, axes, lengths, wall)


def _facing(vectors: FloatArray) -> FloatArray:
    """Return the direction, (3,), of the walls that are parallel to the largest triangle."""
    sizes = np.linalg.norm(vectors, axis=1)
    largest = vectors[np.argmax(sizes)]
    along = vectors @ largest
    # all of them: the normal of a small triangle is as uncertain as its corners are
    near = np.abs(along) > 0.9 * sizes * sizes.max()
    total = np.sign(along[near]) @ vectors[near]
    return np.asarray(total / max(np.linalg.norm(total), 1e-300))


def as_shoebox(mesh: Mesh) -> Mesh | None:
    """Return the same box as `shoebox_mesh` orders it; None where the mesh is no such box.

    It is one that `box_of` finds at the origin, edges along the axes, each wall one surface. Its
    walls have names, and lengths that can be fitted.

    Parameters
    ----------
    mesh : Mesh
        Normals out of the air.

    Returns
    -------
    Mesh or None
        Surfaces west, east, south, north, floor and ceiling under the names that they had; the
        lengths are its last vertex.
    """
    box = box_of(mesh)
    if box is None:
        return None
    pairs = np.unique(np.column_stack([box.wall, mesh.triangle_surface]), axis=0)
    off_m = np.abs(box.origin_m).max() + np.abs((box.axes - np.eye(3)) * box.lengths_m).max()
    if off_m > WELD_TOLERANCE_M or len(pairs) != 6:
        return None
    named = tuple(mesh.surfaces[s] for s in pairs[:, 1])
    return replace(shoebox_mesh(np.max(mesh.vertices_m, axis=0)), surfaces=named)


def weld(points_m: FloatArray) -> IntArray:
    """Return for every point the index of the point that stands for it, shape (n_points,).

    Points nearer than the tolerance belong together, and so do chains of them. The earliest point
    stands for its group, so that coordinates of the file stay as they were written.

    `points_m` has the shape (n_points, 3).
    """
    from scipy.sparse import coo_matrix, csgraph
    from scipy.spatial import cKDTree  # heavy, and a box needs none of them

    # equal points first: a file that repeats each corner for every face has thousands of pairs
    _, first, inverse = np.unique(points_m, axis=0, return_index=True, return_inverse=True)
    pairs = cKDTree(points_m[first]).query_pairs(WELD_TOLERANCE_M, output_type="ndarray")
    n = len(first)
    links = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    n_groups, group = csgraph.connected_components(links, directed=False)
    earliest = np.full(n_groups, len(points_m))
    np.minimum.at(earliest, group, first)
    return np.asarray(earliest[group[inverse.reshape(-1)]])
