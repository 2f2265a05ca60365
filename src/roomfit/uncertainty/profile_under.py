"""Ends of a profile likelihood when something else says something of the same unknown."""

from __future__ import annotations

import numpy as np

from roomfit.typing import FloatArray
from roomfit.uncertainty.profile import RISE95, Profile, profile_curve

_N_POINTS = 2001
# Beyond its points a profile goes on as straight as between its last two, so many times as far.
_BEYOND = 3.0


def profile_under(
    found: Profile, sides: tuple[float, float], mean: float, information: float
) -> tuple[float, float]:
    """Return the ends of a 95 % interval by a profile and by a Gaussian that is told of it.

    The profile's rise and the Gaussian's half square are added; the ends are where the sum has
    risen by 1.92 from its lowest. Exact for one unknown; of several it takes what the others say of
    this one for Gaussian.

    Parameters
    ----------
    found : Profile
    sides : tuple of two floats
        Lengths below and above the profile's centre that its interval has by now; the curve is
        stretched to them.
    mean, information : float
        Of the Gaussian, in the profile's free number; an information of 0 says nothing.

    Returns
    -------
    lower, upper : float
        Free numbers.
    """
    free, rise = profile_curve(found, _N_POINTS)
    centre = float(free[int(np.argmin(rise))])
    below = sides[0] / max(centre - found.lower, 1e-12)
    above = sides[1] / max(found.upper - centre, 1e-12)
    away = free - centre
    x = centre + np.where(away < 0.0, below, above) * away
    reach = _BEYOND * (sides[0] + sides[1])
    grid = np.linspace(x[0] - reach, x[-1] + reach, 4 * _N_POINTS)
    root = np.sqrt(np.maximum(rise, 0.0)) * np.where(away < 0.0, -1.0, 1.0)
    whole = _carried_on(grid, x, root) ** 2 + 0.5 * information * (grid - mean) ** 2
    inside = np.flatnonzero(whole - whole.min() <= RISE95)
    return float(grid[inside[0]]), float(grid[inside[-1]])


def _carried_on(grid: FloatArray, x: FloatArray, root: FloatArray) -> FloatArray:
    """Return a line through points, straight on beyond both of its ends."""
    inner = np.interp(grid, x, root)
    first = (root[1] - root[0]) / max(x[1] - x[0], 1e-12)
    last = (root[-1] - root[-2]) / max(x[-1] - x[-2], 1e-12)
    inner = np.where(grid < x[0], root[0] + first * (grid - x[0]), inner)
    return np.asarray(np.where(grid > x[-1], root[-1] + last * (grid - x[-1]), inner))
