"""The edges that an eye sees of a room: where faces meet at an angle, or materials do."""

from __future__ import annotations

import numpy as np

from roomfit.geometry.mesh import area_vectors_m2
from roomfit.scene.room import Room, triangle_material
from roomfit.typing import FloatArray, IntArray

_SAME_PLANE = 0.9995
"""Cosine between normals above which two faces look flat together, 1.8 degrees."""


def outline_m(room: Room, at_most: int) -> FloatArray:
    """Return the visible edges, shape (n_edges, 2 ends, 3), in metres.

    An edge is left out where two triangles of one material lie in one plane. Of more than
    `at_most`, the longest are kept that are no shorter than a twentieth of the room's diagonal:
    the walls of a hall without the legs of its chairs.
    """
    corners = room.mesh.triangles.astype(np.int64)
    ends = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    triangle = np.repeat(np.arange(len(corners)), 3)
    lines, owner = np.unique(ends, axis=0, return_inverse=True)
    owner = owner.reshape(-1)
    order = np.argsort(owner, kind="stable")
    starts = np.searchsorted(owner[order], np.arange(len(lines)))
    several = np.bincount(owner, minlength=len(lines)) == 2
    first = triangle[order[starts]]
    second = triangle[order[np.minimum(starts + 1, len(order) - 1)]]
    flat = several & _alike(room, first, second)
    edges = room.mesh.vertices_m[lines[~flat]]
    if len(edges) <= at_most:
        return np.asarray(edges)
    lengths = np.linalg.norm(edges[:, 0] - edges[:, 1], axis=1)
    longest = np.argsort(-lengths, kind="stable")[:at_most]
    diagonal = np.linalg.norm(np.ptp(room.mesh.vertices_m, axis=0))
    return np.asarray(edges[longest[lengths[longest] >= diagonal / 20.0]])


def _alike(
    room: Room, first: IntArray, second: IntArray
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    normals = area_vectors_m2(room.mesh)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals / np.where(lengths > 0.0, lengths, 1.0)
    material = triangle_material(room)
    cosine = np.einsum("ij,ij->i", normals[first], normals[second])
    return np.asarray((np.abs(cosine) > _SAME_PLANE) & (material[first] == material[second]))
