"""The paper's searches and Gauss-Newton behind one face: free vector in, better free vector out."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from roomfit.identification.annealing import anneal
from roomfit.identification.least_squares import ResidualFunction
from roomfit.identification.simplex import downhill_simplex, simplex_around
from roomfit.objective.parameters import Parameters, to_free
from roomfit.typing import FloatArray

Solver: TypeAlias = Callable[[ResidualFunction, FloatArray], FloatArray]
"""Residuals with derivative, and a start, shape (n,), to the free vector of least squares."""

# Gains are searched within a factor of e^3, 13 dB, either side of where total energies agree.
_LOG_REACH = 3.0
_FIRST_EDGE = 0.1
_FIRST_DAMPING, _MOST_DAMPING = 1e-3, 1e10
_MOST_STEPS = 40
_FEW_STEPS = 15
_NEAR = 0.01
# of the sum of squares: a thousandth of what one standard deviation would cost
_LEAST_GAIN = 1e-3


def gauss_newton(
    residuals: ResidualFunction, start: FloatArray, *, most_steps: int = _MOST_STEPS
) -> FloatArray:
    """Solve by damped Gauss-Newton steps with the exact derivative.

    Marquardt's damping [1]_, lowered after a step that helps and raised after one that does not.
    Ends when a step is shorter than a hundredth of a standard deviation, or gains next to nothing.
    Few unknowns and many residuals: normal equations cost a tenth of the singular values that
    scipy's solver takes.

    References
    ----------
    .. [1] D. W. Marquardt, "An algorithm for least-squares estimation of nonlinear parameters",
           J. Soc. Indust. Appl. Math. 11, 431-441 (1963).
    """
    x = np.array(start, dtype=np.float64)
    if not x.size:
        return x
    values, jacobian = residuals(x)
    damping = _FIRST_DAMPING
    for _ in range(most_steps):
        gradient, hessian = jacobian.T @ values, jacobian.T @ jacobian
        scale = np.diag(hessian)
        step = -np.linalg.solve(hessian + damping * np.diag(scale), gradient)
        there, slope_there = residuals(x + step)
        if not there @ there < values @ values:
            damping *= 8.0
            if damping > _MOST_DAMPING:
                break
            continue
        gain = values @ values - there @ there
        x, values, jacobian = x + step, there, slope_there
        damping *= 0.1
        if step @ hessian @ step < _NEAR**2 or gain < _LEAST_GAIN:
            break
    return x


def few_gauss_newton_steps(residuals: ResidualFunction, start: FloatArray) -> FloatArray:
    """Take steps of `gauss_newton` towards squares whose weights will be renewed anyway."""
    return gauss_newton(residuals, start, most_steps=_FEW_STEPS)


def simplex_solver(parameters: Parameters) -> Solver:
    """Return the paper's downhill simplex, over absorption itself and log gains."""

    def solve(residuals: ResidualFunction, start: FloatArray) -> FloatArray:
        if not start.size:
            return start
        error, first = _in_unit_box(parameters, residuals, start)
        found = downhill_simplex(error, simplex_around(first, _FIRST_EDGE))
        return _from_unit(parameters, found.x)

    return solve


def annealing_solver(parameters: Parameters, rng: np.random.Generator) -> Solver:
    """Return the paper's simulated annealing with its simplex, over absorption and log gains."""

    def solve(residuals: ResidualFunction, start: FloatArray) -> FloatArray:
        if not start.size:
            return start
        error, first = _in_unit_box(parameters, residuals, start)
        return _from_unit(parameters, anneal(error, first.size, rng).x)

    return solve


def _in_unit_box(
    parameters: Parameters, residuals: ResidualFunction, start: FloatArray
) -> tuple[Callable[[FloatArray], float], FloatArray]:
    """Return the sum of squares over the unit box, and the start's place in it."""

    def error(point: FloatArray) -> float:
        r, _ = residuals(_from_unit(parameters, point))
        return float(r @ r)

    return error, _to_unit(parameters, start)


def _from_unit(parameters: Parameters, point: FloatArray) -> FloatArray:
    """Map the unit box: absorption between its bounds, evenly; gains evenly in logarithm."""
    parts, position = [], 0
    for block in parameters.blocks:
        n = int(np.count_nonzero(block.fitted))
        share = point[position : position + n]
        position += n
        if block.transform == "logit":
            values = np.array(block.start)
            low, high = block.lower[block.fitted], block.upper[block.fitted]
            values[block.fitted] = low + (high - low) * share
            parts.append(to_free(block, values)[block.fitted])
        else:
            middle = to_free(block, block.start)[block.fitted]
            parts.append(middle + _LOG_REACH * (2.0 * share - 1.0))
    return np.concatenate(parts)


def _to_unit(parameters: Parameters, vector: FloatArray) -> FloatArray:
    parts, position = [], 0
    for block in parameters.blocks:
        n = int(np.count_nonzero(block.fitted))
        free = vector[position : position + n]
        position += n
        if block.transform == "logit":
            parts.append(1.0 / (1.0 + np.exp(-free)))
        else:
            middle = to_free(block, block.start)[block.fitted]
            parts.append(np.clip(0.5 + 0.5 * (free - middle) / _LOG_REACH, 0.0, 1.0))
    return np.concatenate(parts)
