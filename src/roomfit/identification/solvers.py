"""The paper's searches and Gauss-Newton behind one face: free vector in, better free vector out."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from scipy.optimize import least_squares

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


def gauss_newton(residuals: ResidualFunction, start: FloatArray) -> FloatArray:
    """Solve by scipy's trust-region least squares with the exact derivative."""

    def values(vector: FloatArray) -> FloatArray:
        return residuals(vector)[0]

    def derivative(vector: FloatArray) -> FloatArray:
        return residuals(vector)[1]

    return np.asarray(least_squares(values, start, derivative, xtol=1e-7, max_nfev=100).x)


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
