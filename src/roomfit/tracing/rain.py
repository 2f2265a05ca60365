"""Diffuse rain: what each diffuse reflection sends straight to each receiver.

A wall that scatters by Lambert's law sends the share ``cos / pi`` of its energy into each unit of
solid angle; at a point r metres away that arrives on ``cos / (pi r**2)`` of it per square metre.
Every diffuse reflection that sees a receiver thus adds a path, exact in time and direction, where a
sphere catches one ray of many. Only paths whose last reflection is diffuse can be had so; the
others are still caught by spheres. The method is "diffuse rain" of D. Schroeder, "Physically based
real-time auralization of interactive virtual environments", Aachen 2011, section 5.3, or next-event
estimation of path tracing.
"""

# ruff: noqa: ARG001, ARG005 -- numba matches overloads by the names of all their arguments

from __future__ import annotations

import math
from typing import Any

from numba.extending import overload

from roomfit.compiled import kernel
from roomfit.tracing.bounce import Vector
from roomfit.tracing.planes import Planes
from roomfit.tracing.spheres import Spheres
from roomfit.tracing.tree import Tree, nearest_in_tree

# What lies nearer to the receiver than this share of the way is no screen but rounding.
_SAME_PLACE = 1e-9


def unobstructed(walls: Planes | Tree, o: Vector, d: Vector, last: int, distance_m: float) -> bool:
    """Return whether nothing stands in a straight way; only for use in kernels.

    Parameters
    ----------
    o, d : vector
        Start, on wall `last`, and unit direction.
    distance_m : float
        Length of the way.
    """
    raise TypeError("only compiled code may call this")


@overload(unobstructed, strict=False)
def _unobstructed(walls: Any, o: Any, d: Any, last: Any, distance_m: Any) -> Any:
    kind = getattr(walls, "instance_class", None)
    if kind is Planes:  # a convex room hides nothing
        return lambda walls, o, d, last, distance_m: True
    if kind is Tree:
        return lambda walls, o, d, last, distance_m: (
            nearest_in_tree(walls, o, d, last)[0] >= distance_m * (1.0 - _SAME_PLACE)
        )
    return None


@kernel(allocates=False)
def towards(
    spheres: Spheres, k: int, o: Vector, d: Vector, normal: Vector
) -> tuple[float, Vector, float]:
    """Return how a wall that scatters rains on the centre of a sphere.

    Parameters
    ----------
    o : vector
        Point on the wall.
    d : vector
        Direction before the hit: the wall scatters to the side from which it came.
    normal : vector
        Unit normal, of either sense.

    Returns
    -------
    float
        Distance to the centre in metres.
    vector
        Unit direction.
    float
        ``cos / pi / distance**2`` in 1/m2, 0 where the centre lies behind the wall.

    Notes
    -----
    The variance of the sum of many is finite for every receiver that is off the walls; nothing is
    clamped. Towards a wall at distance h it grows as ``1 / h**2``.
    """
    x = spheres.centre_m[k, 0] - o[0]
    y = spheres.centre_m[k, 1] - o[1]
    z = spheres.centre_m[k, 2] - o[2]
    square = x * x + y * y + z * z
    if square <= 0.0:
        return 0.0, d, 0.0
    distance = math.sqrt(square)
    x, y, z = x / distance, y / distance, z / distance
    cosine = x * normal[0] + y * normal[1] + z * normal[2]
    if d[0] * normal[0] + d[1] * normal[1] + d[2] * normal[2] > 0.0:
        cosine = -cosine
    return distance, (x, y, z), max(cosine, 0.0) / (math.pi * square)
