"""How much of the room's absorption each material contributes."""

from __future__ import annotations

import numpy as np

from roomfit.checks import float_array
from roomfit.typing import FloatArray


def absorption_shares(
    areas_m2: FloatArray, absorption: FloatArray, draws: FloatArray
) -> FloatArray:
    """Return the share of each material in the sum of absorption areas, with its 95 % interval.

    ``A_i / sum A`` with ``A_i = alpha_i S_i``; the air is left out. Errors of two materials that
    the data know only together go against each other, so that no interval can be had from those of
    the coefficients.

    Parameters
    ----------
    areas_m2 : float array, shape (n_materials,)
    absorption : float array, shape (n_materials,)
        The answer of one band, 0 to 1.
    draws : float array, shape (n_draws, n_materials)
        Of the posterior.

    Returns
    -------
    float array, shape (3, n_materials)
        Share, its lower and its upper bound, 0 to 1; zeros where nothing absorbs.

    Examples
    --------
    >>> areas, a = np.array([10.0, 30.0]), np.array([0.3, 0.1])
    >>> print(absorption_shares(areas, a, np.tile(a, (10, 1)))[0].round(3))
    [0.5 0.5]
    """
    n = len(areas_m2)
    areas = float_array("areas", areas_m2, (n,), low=0.0, unit="m2")
    a = float_array("absorption", absorption, (n,), low=0.0, high=1.0)
    shares = [_shares(areas * x) for x in (a[None], np.asarray(draws))]
    low, high = np.quantile(shares[1], (0.025, 0.975), axis=0)
    value = shares[0][0]
    # a mode may lie outside of the quantiles of a skew law; a table that says so would be read as
    # a mistake
    return np.stack([value, np.minimum(low, value), np.maximum(high, value)])


def _shares(parts: FloatArray) -> FloatArray:
    total = parts.sum(axis=1, keepdims=True)
    return np.asarray(np.divide(parts, total, out=np.zeros_like(parts), where=total > 0.0))
