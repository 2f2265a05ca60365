"""What both kinds of image sources hand over: the exact specular paths of one pair."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.tracing.paths import Reflections
from roomfit.typing import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class ImageSet:
    """Exact specular paths from one source to one receiver, shortest first.

    Attributes
    ----------
    length_m : float array, shape (n_paths,)
    hits : uint16 array, shape (n_paths, n_materials)
    departure, arrival : float arrays, shape (n_paths, 3)
        Unit vectors: away from the source, and the direction in which sound travels on arrival.
    reflections : Reflections or None
        Every path's hits in order, where they were asked for.
    unfolding : float array, shape (n_paths, 3, 3), or None
        Product of the reflections, see `Paths`, where it was asked for.
    normals : float array, shape (n_hits, 3), or None
        Normal of the wall of each hit as the receiver sees it, mirrored by all later hits, in the
        order of `reflections`: its product with `arrival` is the cosine of incidence, for moved
        sources and receivers, too. Only of rooms that are no boxes.
    """

    length_m: FloatArray
    hits: IntArray
    departure: FloatArray
    arrival: FloatArray
    reflections: Reflections | None = None
    unfolding: FloatArray | None = None
    normals: FloatArray | None = None


def unfolded_normals(normal: FloatArray, first: IntArray) -> FloatArray:
    """Return the normals of walls as the receiver sees them, mirrored by all later hits.

    Parameters
    ----------
    normal : float array, shape (n_hits, 3)
        Unit normal of each hit's wall, either side, first hit of a path first.
    first : int array, shape (n_paths + 1,)
        Path i owns the hits ``first[i]:first[i + 1]``.
    """
    unfolded = np.empty_like(normal)
    later = np.tile(np.eye(3), (len(first) - 1, 1, 1))
    for back in range(1, int(np.max(np.diff(first), initial=0)) + 1):
        path = np.flatnonzero(np.diff(first) >= back)
        hit = first[path + 1] - back
        own = np.einsum("pij,pj->pi", later[path], normal[hit])
        unfolded[hit] = own
        # A (1 - 2 n n^T) = A - 2 (A n) n^T
        later[path] -= 2.0 * own[:, :, None] * normal[hit][:, None, :]
    return unfolded


def reflections_in_order(
    path: IntArray, place: FloatArray, material: IntArray, cosine: FloatArray, n_paths: int
) -> Reflections:
    """Return hits given in any order as ordered lists.

    Parameters
    ----------
    path : int array, shape (n_hits,)
        To which path each hit belongs.
    place : float array, shape (n_hits,)
        Rises along the path from source to receiver.
    material, cosine : arrays, shape (n_hits,)
    n_paths : int
    """
    order = np.lexsort((place, path))
    counts = np.bincount(path, minlength=n_paths)
    return Reflections(
        np.concatenate(([0], np.cumsum(counts))),
        material[order].astype(np.int32),
        # a quotient of rounded lengths may pass 1 by an ulp
        np.minimum(cosine[order], 1.0),
    )
