"""What a wall does to the direction of a ray."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from roomfit.compiled import kernel
from roomfit.tracing.random import uniform

Vector: TypeAlias = tuple[float, float, float]


@kernel(allocates=False)
def mirrored(d: Vector, normal: Vector) -> Vector:
    """Return the specular direction; the sense of the unit normal does not matter."""
    twice = 2.0 * (d[0] * normal[0] + d[1] * normal[1] + d[2] * normal[2])
    return d[0] - twice * normal[0], d[1] - twice * normal[1], d[2] - twice * normal[2]


@kernel(allocates=False)
def scattered(d: Vector, normal: Vector, u: float, v: float) -> Vector:
    """Return a direction by Lambert's cosine law on the side from which `d` came.

    Parameters
    ----------
    d : vector
        Direction before the hit.
    normal : vector
        Unit normal, of either sense.
    u, v : float
        Uniform in [0, 1). The cosine to the normal is ``sqrt(1 - u)``, never zero.

    Notes
    -----
    The two directions across the normal are those of T. Duff et al., "Building an orthonormal
    basis, revisited", J. Computer Graphics Techniques 6 (1), 1-8 (2017).
    """
    x, y, z = normal
    if d[0] * x + d[1] * y + d[2] * z > 0.0:
        x, y, z = -x, -y, -z
    # the change of basis lies far from z = 0, where upright walls differ by rounding alone
    sign = 1.0 if z > -0.6 else -1.0
    a = -1.0 / (sign + z)
    b = x * y * a
    along = math.sqrt(1.0 - u)
    across = math.sqrt(u)
    p = across * math.cos(2.0 * math.pi * v)
    q = across * math.sin(2.0 * math.pi * v)
    return (
        along * x + p * (1.0 + sign * x * x * a) + q * b,
        along * y + p * sign * b + q * (sign + y * y * a),
        along * z - p * sign * x - q * y,
    )


@kernel(allocates=False, inlined=True)
def after_wall(
    d: Vector, normal: Vector, scattering: float, key: np.uint64, hit: int
) -> tuple[Vector, bool]:
    """Return the direction after a hit and whether it was drawn from Lambert's law.

    Parameters
    ----------
    scattering : float
        Probability of a diffuse reflection.
    key : uint64
        The ray's, see `roomfit.tracing.random`.
    hit : int
        How many walls the ray has met before.
    """
    if scattering > 0.0 and uniform(key, 3 * hit) < scattering:
        out = scattered(d, normal, uniform(key, 3 * hit + 1), uniform(key, 3 * hit + 2))
        return out, True
    return mirrored(d, normal), False
