"""A box, the simplest room."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from roomfit.checks import float_array
from roomfit.geometry.mesh import Mesh, Surface

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
    """
    lengths = float_array("length of the box", lengths_m, (3,), low=1e-3, high=1e4, unit="m")
    corners = np.array([[k & 1, k >> 1 & 1, k >> 2 & 1] for k in range(8)]) * lengths
    triangles = [t for a, b, c, d in _QUADS for t in ((a, b, c), (a, c, d))]
    surfaces = tuple(
        Surface(name, "walls" if i < 4 else None, name) for i, name in enumerate(SHOEBOX_SURFACES)
    )
    return Mesh(corners, np.array(triangles), np.repeat(np.arange(6), 2), surfaces)
