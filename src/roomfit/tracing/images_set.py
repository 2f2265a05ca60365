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
    """

    length_m: FloatArray
    hits: IntArray
    departure: FloatArray
    arrival: FloatArray
    reflections: Reflections | None = None
    unfolding: FloatArray | None = None


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
