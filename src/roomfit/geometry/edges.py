"""The edges where triangles meet, also where a long edge meets several short ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from roomfit.geometry.mesh import Mesh, is_double_sided
from roomfit.geometry.weld import WELD_TOLERANCE_M
from roomfit.typing import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Directed edges of the enclosing triangles (sheets in the air are left out).

    An edge on which corners of others stand is split there, so that edges match piece by piece.

    Attributes
    ----------
    ends : int array, shape (n_edges, 2)
        Corner from which and to which each edge runs.
    triangle : int array, shape (n_edges,)
        Triangle whose border it is.
    line : int array, shape (n_edges,)
        Equal for edges between the same two corners, in whichever direction.
    """

    ends: IntArray
    triangle: IntArray
    line: IntArray


def edges_of(mesh: Mesh, tolerance_m: float = WELD_TOLERANCE_M) -> Edges:
    """Return the directed edges, split wherever a corner stands on one within the tolerance."""
    enclosing = np.flatnonzero(~is_double_sided(mesh))
    corners = mesh.triangles[enclosing].astype(np.int64)
    ends: IntArray = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2)
    triangle: IntArray = np.repeat(enclosing, 3)
    lonely = np.flatnonzero(np.bincount(_lines(ends))[_lines(ends)] != 2)
    if len(lonely):
        ends, triangle = _split(mesh.vertices_m, ends, triangle, lonely, tolerance_m)
    return Edges(ends, triangle, _lines(ends))


def unmatched(edges: Edges) -> IntArray:
    """Return the indices of edges that no other edge runs along in the opposite direction.

    None are left in a closed, consistently oriented mesh.
    """
    if not len(edges.ends):
        return np.zeros(0, dtype=np.int64)
    forward = np.where(edges.ends[:, 0] < edges.ends[:, 1], 1, -1)
    balance = np.bincount(edges.line, forward)
    return np.flatnonzero(balance[edges.line] * forward > 0)


def _lines(ends: IntArray) -> IntArray:
    if not len(ends):
        return np.zeros(0, dtype=np.int64)
    _, line = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True)
    return np.asarray(line.reshape(-1))


def _split(
    vertices_m: FloatArray, ends: IntArray, triangle: IntArray, lonely: IntArray, tolerance_m: float
) -> tuple[IntArray, IntArray]:
    posts = np.unique(ends[lonely])
    tree = cKDTree(vertices_m[posts])
    pieces, owners = [np.delete(ends, lonely, axis=0)], [np.delete(triangle, lonely)]
    for edge in lonely:
        a, b = vertices_m[ends[edge]]
        near = tree.query_ball_point((a + b) / 2, np.linalg.norm(b - a) / 2)
        chain = _chain(vertices_m, ends[edge], posts[near], tolerance_m)
        pieces.append(np.stack([chain[:-1], chain[1:]], axis=1))
        owners.append(np.full(len(chain) - 1, triangle[edge]))
    return np.concatenate(pieces), np.concatenate(owners)


def _chain(vertices_m: FloatArray, ends: IntArray, posts: IntArray, tolerance_m: float) -> IntArray:
    """Return the corners along an edge, from its start to its end, both included."""
    start, end = vertices_m[ends]
    length = np.linalg.norm(end - start)
    direction = (end - start) / length
    from_start = vertices_m[posts] - start
    along = from_start @ direction
    aside = np.linalg.norm(from_start - along[:, None] * direction, axis=1)
    on_edge = (aside < tolerance_m) & (along > tolerance_m) & (along < length - tolerance_m)
    between = posts[on_edge][np.argsort(along[on_edge])]
    return np.concatenate([ends[:1], between, ends[1:]])
