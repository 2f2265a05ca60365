"""Bounded least squares with the exact derivative, from several starts."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from roomfit._checks import float_array
from roomfit.solvers.ending import Ending
from roomfit.solvers.levenberg_marquardt import ResidualFunction
from roomfit.solvers.search import Fit, best_of
from roomfit.typing import FloatArray

# The trust-region method works strictly inside the box; a start on a wall is moved in by this.
_INSIDE = 1e-3


def fit_least_squares(
    residuals: ResidualFunction,
    starts: FloatArray,
    *,
    good_enough: float = 0.0,
    max_evaluations: int = 300,
) -> Fit:
    """Return the best of several trust-region descents within the unit box.

    Parameters
    ----------
    residuals : callable
    starts : float array, shape (n_starts, n)
        Tried in their order.
    good_enough : float
        Sum of squared residuals at which no further start is tried; 0 tries all.
    max_evaluations : int
        For each start.

    Returns
    -------
    Fit
        `cost` is the sum of squared residuals (not half of it). The trail holds every point at
        which the residuals were computed.

    Notes
    -----
    The "trf" method of scipy, which reflects at bounds [1]_. Columns of the derivative are scaled
    by their norm, because materials of small area move the residuals little.

    References
    ----------
    .. [1] M. A. Branch, T. F. Coleman, Y. Li, "A subspace, interior, and conjugate gradient
           method for large-scale bound-constrained minimization problems", SIAM J. Sci. Comput.
           21, 1-23 (1999).
    """
    starts = float_array("starts", starts, (None, None), low=0.0, high=1.0)
    fits: list[Fit] = []
    for start in starts:
        fits.append(_descend(residuals, start, max_evaluations))
        if fits[-1].cost <= good_enough:
            break
    return best_of(fits)


def _descend(residuals: ResidualFunction, start: FloatArray, max_evaluations: int) -> Fit:
    remembered = _Remembered(residuals)
    solution = least_squares(
        remembered.residuals,
        np.clip(start, _INSIDE, 1.0 - _INSIDE),
        remembered.derivative,
        bounds=(0.0, 1.0),
        x_scale="jac",
        xtol=1e-12,
        ftol=1e-14,
        gtol=1e-15,
        max_nfev=max_evaluations,
    )
    return Fit(
        solution.x,
        2.0 * float(solution.cost),
        len(remembered.points),
        len(remembered.points),
        # status 0: out of evaluations; above: slope, error or step within its tolerance
        Ending.CONVERGED if solution.status > 0 else Ending.OUT_OF_EVALUATIONS,
        np.array(remembered.points),
        np.array(remembered.costs),
    )


class _Remembered:
    """Computes residuals and derivative together, once a point."""

    def __init__(self, residuals: ResidualFunction) -> None:
        self._function = residuals
        self._last: tuple[FloatArray, FloatArray] | None = None
        self.points: list[FloatArray] = []
        self.costs: list[float] = []

    def residuals(self, x: FloatArray) -> FloatArray:
        return self._at(x)[0]

    def derivative(self, x: FloatArray) -> FloatArray:
        return self._at(x)[1]

    def _at(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        if self._last is None or not np.array_equal(x, self.points[-1]):
            self._last = self._function(x)
            self.points.append(np.array(x))
            self.costs.append(float(self._last[0] @ self._last[0]))
        return self._last


def starts(uniform: float, n: int, n_random: int, rng: np.random.Generator) -> FloatArray:
    """Return the uniform start followed by random ones, shape (1 + n_random, n)."""
    return np.concatenate((np.full((1, n), uniform), rng.random((n_random, n))))
