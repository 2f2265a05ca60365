"""Levenberg-Marquardt over rows of data and rows of prior knowledge."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from roomfit.impedance.rows import Linear
from roomfit.typing import FloatArray

Rows = Callable[[FloatArray], Linear]

_LEAST_DAMPING, _MOST_DAMPING = 1e-9, 1e9


class Minimum(NamedTuple):
    """Where a descent ended.

    Attributes
    ----------
    x : float array, shape (n,)
    cost : float
        Half the sum of squares, data and prior.
    normal : float array, shape (n, n)
        ``J^T J`` there, without damping.
    evaluations : int
    converged : bool
        Whether the last step gained next to nothing.
    """

    x: FloatArray
    cost: float
    normal: FloatArray
    evaluations: int
    converged: bool


def levenberg_marquardt(
    rows: Rows, x: FloatArray, *, most: int = 30, gain: float = 1e-4, damping: float = 1e-2
) -> Minimum:
    """Return a local minimum of the sum of squares [1]_.

    Parameters
    ----------
    rows : callable
        Residuals and Jacobian of everything.
    x : float array, shape (n,)
    most : int
        Evaluations.
    gain : float
        A step that lowers the cost by less than this share of it is the last one.
    damping : float
        At the first step, relative to the diagonal of the normal matrix.

    References
    ----------
    .. [1] D. W. Marquardt, "An algorithm for least-squares estimation of nonlinear parameters", J.
           Soc. Ind. Appl. Math. 11, 431-441 (1963).
    """
    here = rows(x)
    cost, evaluations = 0.5 * float(here.residual @ here.residual), 1
    normal, slope = here.jacobian.T @ here.jacobian, here.jacobian.T @ here.residual
    while evaluations < most:
        step = _step(normal, slope, damping)
        there = rows(x + step)
        evaluations += 1
        new = 0.5 * float(there.residual @ there.residual)
        if np.isfinite(new) and new < cost:
            small = cost - new <= gain * cost
            x, cost = x + step, new
            normal, slope = there.jacobian.T @ there.jacobian, there.jacobian.T @ there.residual
            damping = max(0.2 * damping, _LEAST_DAMPING)
            if small:
                return Minimum(x, cost, normal, evaluations, True)
        else:
            # no way down from here: the slope is rounding
            if damping >= _MOST_DAMPING or -float(slope @ step) <= gain * 1e-2 * cost:
                return Minimum(x, cost, normal, evaluations, True)
            damping *= 8.0
    return Minimum(x, cost, normal, evaluations, False)


def _step(normal: FloatArray, slope: FloatArray, damping: float) -> FloatArray:
    scale = np.diag(normal) + 1e-12 * np.trace(normal) / len(normal)
    return np.asarray(-cho_solve(cho_factor(normal + np.diag(damping * scale)), slope))
