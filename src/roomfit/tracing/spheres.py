"""Receivers as spheres that catch rays, sorted into a grid where there are many."""

from __future__ import annotations

import math
from typing import NamedTuple

from roomfit.compiled import kernel
from roomfit.tracing.bounce import Vector
from roomfit.typing import FloatArray, IntArray


class Spheres(NamedTuple):
    """The receivers of one source.

    Attributes
    ----------
    centre_m : float array, shape (n_spheres, 3)
    radius_m : float array, shape (n_spheres,)
    pair : int32 array, shape (n_spheres,)
        Pair of the scene that each stands for.
    """

    centre_m: FloatArray
    radius_m: FloatArray
    pair: IntArray


@kernel()
def chord(spheres: Spheres, k: int, o: Vector, d: Vector, flight_m: float) -> tuple[float, float]:
    """Return where a flight comes nearest to the centre of a sphere and its chord within.

    Parameters
    ----------
    o, d : vector
        Start and unit direction.
    flight_m : float
        Length of the flight.

    Returns
    -------
    tuple of float
        Distance from the start to the point of the flight nearest to the centre, and the length
        inside the sphere, both in metres; the length is 0 for a miss. Both ends of the flight may
        lie inside.
    """
    x = spheres.centre_m[k, 0] - o[0]
    y = spheres.centre_m[k, 1] - o[1]
    z = spheres.centre_m[k, 2] - o[2]
    nearest = x * d[0] + y * d[1] + z * d[2]
    radius = spheres.radius_m[k]
    square = radius * radius - (x * x + y * y + z * z - nearest * nearest)
    if square <= 0.0:
        return 0.0, 0.0
    half = math.sqrt(square)
    start, end = max(nearest - half, 0.0), min(nearest + half, flight_m)
    return min(max(nearest, 0.0), flight_m), max(end - start, 0.0)
