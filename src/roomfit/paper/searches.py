"""Searches of an error function over the unit box: the best of several descents, and all minima.

A grid's minimum need not be one of the function: where a narrow valley runs askew to the grid, the
points next to it alternate between its floor and its flanks, and a point of the grid may lie below
its neighbours although the valley falls all the way. Only descents show the true minima.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import least_squares

from roomfit.base.arguments import float_array
from roomfit.base.typing import FloatArray
from roomfit.paper.search import ErrorFunction, Fit, best_of
from roomfit.solver import Ending, ResidualFunction

# The trust-region method works strictly inside the box; a start on a wall is moved in by this.
_INSIDE = 1e-3
_MOST_EVALUATIONS = 300  # from each start


def fit_least_squares(
    residuals: ResidualFunction,
    starts: FloatArray,
    *,
    good_enough: float = 0.0,
) -> Fit:
    """Return the best of several trust-region descents within the unit box.

    Parameters
    ----------
    starts : float array, shape (n_starts, n)
        Tried in their order.
    good_enough : float
        Sum of squared residuals at which no further start is tried; 0 tries all.

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
        fits.append(_trust_region(residuals, start))
        if fits[-1].cost <= good_enough:
            break
    return best_of(fits)


def _trust_region(residuals: ResidualFunction, start: FloatArray) -> Fit:
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
        max_nfev=_MOST_EVALUATIONS,
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
    """Computes residuals and derivative together, once a point, and keeps the trail."""

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


Neighbours = Literal[4, 8]

_SIDES = ((1, 0), (-1, 0), (0, 1), (0, -1))
_DAMPINGS = 10.0 ** np.arange(-9.0, 0.0, 0.5)
_CORNERS = ((1, 1), (1, -1), (-1, 1), (-1, -1))
# Ends of descents that differ by no more in every unknown are one.
_APART = 0.005
_LONGEST_STEP, _MOST_STEPS = 0.02, 2000


@dataclass(frozen=True, slots=True, eq=False)
class Minima:
    """Distinct ends of descents, lowest error first."""

    x: FloatArray  # (n_minima, n)
    error: FloatArray  # (n_minima,)
    descents: tuple[int, ...]  # how many descents ended there


@dataclass(frozen=True, slots=True, eq=False)
class Landscape:
    """An error function of two unknowns on a grid, and its true minima."""

    grid: FloatArray  # (n_points,)
    errors: FloatArray  # (n_points, n_points), first unknown along the first axis
    four_neighbours: tuple[tuple[float, float], ...]  # minima of the grid, lowest first
    eight_neighbours: tuple[tuple[float, float], ...]
    minima: Minima  # ends of the descents from every grid point


def landscape(error: ErrorFunction, residuals: ResidualFunction) -> Landscape:
    """Return the paper's grid, its minima and the true minima of a function of two unknowns.

    `error` is the sum of the squares of what `residuals` returns.
    """
    grid = unit_grid()
    errors = grid_errors(error, grid)
    starts = np.array([(a, b) for a in grid for b in grid])
    return Landscape(
        grid,
        errors,
        grid_minima(errors, grid, 4),
        grid_minima(errors, grid, 8),
        minima_of_descents(residuals, starts),
    )


def unit_grid(n_points: int = 21) -> FloatArray:
    """Return the points 0 to 1 of one axis, by default in the paper's steps of 0.05."""
    return np.arange(n_points) / (n_points - 1)


def grid_errors(error: ErrorFunction, grid: FloatArray) -> FloatArray:
    """Return the error of two unknowns on a square grid, the first unknown along the first axis."""
    return np.array([[error(np.array([a, b])) for b in grid] for a in grid])


def grid_minima(
    errors: FloatArray, grid: FloatArray, neighbours: Neighbours
) -> tuple[tuple[float, float], ...]:
    """Return the grid points that lie below all their neighbours, lowest first.

    Neighbours are the 4 along the axes, or the 8 with the diagonal ones; beyond the box there are
    none.
    """
    n = len(grid)
    walled = np.pad(errors, 1, constant_values=np.inf)
    below = np.ones_like(errors, dtype=np.bool_)
    for i, j in _SIDES if neighbours == 4 else _SIDES + _CORNERS:
        below &= errors < walled[1 + i : 1 + i + n, 1 + j : 1 + j + n]
    found = sorted(np.argwhere(below).tolist(), key=lambda index: errors[index[0], index[1]])
    return tuple((float(grid[i]), float(grid[j])) for i, j in found)


def minima_of_descents(residuals: ResidualFunction, starts: FloatArray) -> Minima:
    """Return where descents from all starts, (n_starts, n), end."""
    ends = sorted((descend(residuals, start) for start in starts), key=lambda end: end[1])
    kept: list[tuple[FloatArray, float]] = []
    counts: list[int] = []
    for x, error in ends:
        near = [i for i, (other, _) in enumerate(kept) if np.max(np.abs(other - x)) <= _APART]
        if near:
            counts[near[0]] += 1
        else:
            kept.append((x, error))
            counts.append(1)
    return Minima(
        np.array([x for x, _ in kept]), np.array([error for _, error in kept]), tuple(counts)
    )


def descend(residuals: ResidualFunction, start: FloatArray) -> tuple[FloatArray, float]:
    """Return the foot of the slope on which a point lies, and the error there.

    Damped Gauss-Newton steps (Levenberg), each downhill and, by its damping, no longer than 0.02 in
    any unknown. A good search leaps over ridges; this one must not, for it counts
    the minima. A start on a bound is moved into the box by 0.001: at absorption 1 a wall has no
    slope by any path that meets it twice.
    """
    x = np.clip(start, 1e-3, 1.0 - 1e-3)
    r, jacobian = residuals(x)
    longest = _LONGEST_STEP
    for _ in range(_MOST_STEPS):
        trial = np.clip(x + _damped_step(x, r, jacobian, longest), 0.0, 1.0)
        if np.max(np.abs(trial - x)) < 1e-10:
            break
        trial_r, trial_jacobian = residuals(trial)
        if trial_r @ trial_r < r @ r:
            x, r, jacobian = trial, trial_r, trial_jacobian
            longest = min(2.0 * longest, _LONGEST_STEP)
        else:
            longest = 0.25 * float(np.max(np.abs(trial - x)))
    return x, float(r @ r)


def _damped_step(x: FloatArray, r: FloatArray, jacobian: FloatArray, longest: float) -> FloatArray:
    """Return a step damped until it is short enough, in the unknowns that are at no bound."""
    slope = jacobian.T @ r
    free = ~(((x <= 0.0) & (slope > 0.0)) | ((x >= 1.0) & (slope < 0.0)))
    step = np.zeros_like(x)
    if not np.any(slope[free]):
        return step
    curvature, axes = np.linalg.eigh(jacobian[:, free].T @ jacobian[:, free])
    along = axes.T @ slope[free]
    # the last damping is enough for any slope
    enough = np.linalg.norm(along) / longest
    damping = np.append(max(curvature[-1], enough) * _DAMPINGS, enough)
    steps = -(along / (np.maximum(curvature, 0.0) + damping[:, None])) @ axes.T
    short_enough = np.abs(steps).max(axis=1) <= longest
    step[free] = steps[int(np.argmax(short_enough))]
    return step
