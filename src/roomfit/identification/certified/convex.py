"""The convex lower bound of the misfit over a box, minimised with a certificate at every step."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from roomfit.compiled import kernel
from roomfit.identification.certified.misfits import lowered
from roomfit.identification.certified.question import Arrays
from roomfit.identification.certified.sandwich import Planes
from roomfit.typing import BoolArray, FloatArray

Separable: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]
"""value, slope and curvature (0 or more) of the priors' lower bounds, each of shape (n,)."""

# Of what is summed: a few hundred windows, each off by a few units of 1.1e-16.
SUMMED = 1e-12
_STEPS = 12
_ARMIJO = 1e-4


@kernel()
def bound_at(
    kind: int,
    question: Arrays,
    planes: Planes,
    separable: Separable,
    d: FloatArray,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """Return the convex lower bound at d and fill its gradient and a Hessian."""
    measured, precision = question[3], question[4]
    level, slope, remainder, tail, _, planar = planes
    n = len(d)
    total = 0.0
    for a in range(n):
        value, first, second = separable[0][a], separable[1][a], separable[2][a]
        total += value + first * d[a] + 0.5 * second * d[a] * d[a]
        gradient[a] = first + second * d[a]
        for b in range(n):
            hessian[a, b] = second if a == b else 0.0
    for i in range(len(level)):
        if not planar[i]:
            continue
        here = level[i]
        for a in range(n):
            here += slope[i, a] * d[a]
        value, first, second = lowered(kind, measured[i], precision[i], here, remainder[i], tail[i])
        total += value
        if first == 0.0:
            continue
        for a in range(n):
            gradient[a] += first * slope[i, a]
            of_a = second * slope[i, a]
            for b in range(a + 1):
                hessian[a, b] += of_a * slope[i, b]
    for a in range(n):
        for b in range(a):
            hessian[b, a] = hessian[a, b]
    return total


@kernel()
def least_over(
    kind: int,
    question: Arrays,
    planes: Planes,
    separable: Separable,
    low: FloatArray,
    high: FloatArray,
    threshold: float,
    d: FloatArray,
    thorough: bool,
) -> float:
    """Return a number that the convex bound exceeds all over ``low <= d <= high``.

    At any d the tangent plane lies below a convex function: its least value over the box is a
    bound, however far d is from the minimum. Projected Newton steps bring d near it.

    Parameters
    ----------
    threshold : float
        Stops when the bound reaches it, or, unless `thorough`, when the function is seen below it.
    d : float array, shape (n,)
        Where to start; left where the search ended.
    """
    n = len(d)
    gradient, hessian = np.empty(n), np.empty((n, n))
    other, unused = np.empty(n), np.empty((n, n))
    for a in range(n):
        d[a] = min(max(d[a], low[a]), high[a])
    here = bound_at(kind, question, planes, separable, d, gradient, hessian)
    best = -math.inf
    for _ in range(_STEPS):
        best = max(best, _tangent_bound(here, gradient, d, low, high))
        if best >= threshold or (here < threshold and not thorough):
            break
        if here - best <= 1e-3 * abs(threshold - best):
            break
        step = newton_step(gradient, hessian, d, low, high)
        moved, size = False, 1.0
        for _ in range(12):
            gain = 0.0
            for a in range(n):
                other[a] = min(max(d[a] + size * step[a], low[a]), high[a])
                gain += gradient[a] * (other[a] - d[a])
            there = bound_at(kind, question, planes, separable, other, unused[0], unused)
            if there <= here + _ARMIJO * gain and there < here:
                moved = True
                break
            size *= 0.35
        if not moved:
            break
        for a in range(n):
            d[a] = other[a]
        here = bound_at(kind, question, planes, separable, d, gradient, hessian)
    return max(best, _tangent_bound(here, gradient, d, low, high))


@kernel(allocates=False)
def _tangent_bound(
    here: float, gradient: FloatArray, d: FloatArray, low: FloatArray, high: FloatArray
) -> float:
    """Return the least value of the tangent plane over the box, less what rounding may cost."""
    bound, size = here, abs(here)
    for a in range(len(d)):
        change = min(gradient[a] * (low[a] - d[a]), gradient[a] * (high[a] - d[a]))
        bound += change
        size += abs(change)
    return bound - SUMMED * size


@kernel()
def newton_step(
    gradient: FloatArray, hessian: FloatArray, d: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    """Return a descent step in which coordinates held by a face of the box do not move."""
    n = len(d)
    trace = 0.0
    free = np.ones(n, dtype=np.bool_)
    for a in range(n):
        trace += hessian[a, a]
        if (d[a] <= low[a] and gradient[a] > 0.0) or (d[a] >= high[a] and gradient[a] < 0.0):
            free[a] = False
    matrix = np.zeros((n, n))
    for a in range(n):
        for b in range(n):
            if free[a] and free[b]:
                matrix[a, b] = hessian[a, b]
        matrix[a, a] += 1e-9 * trace + 1e-300
        if not free[a]:
            matrix[a, a] = 1.0
    _cholesky(matrix)
    return _solved(matrix, gradient, free)


@kernel(allocates=False)
def _cholesky(matrix: FloatArray) -> None:
    """Overwrite the lower triangle by the Cholesky factor; tiny pivots are lifted."""
    n = len(matrix)
    for a in range(n):
        for b in range(a + 1):
            total = matrix[a, b]
            for c in range(b):
                total -= matrix[a, c] * matrix[b, c]
            if a == b:
                matrix[a, a] = math.sqrt(max(total, 1e-14 * abs(matrix[a, a]) + 1e-300))
            else:
                matrix[a, b] = total / matrix[b, b]


@kernel()
def _solved(factor: FloatArray, gradient: FloatArray, free: BoolArray) -> FloatArray:
    n = len(gradient)
    step = np.empty(n)
    for a in range(n):
        total = -gradient[a] if free[a] else 0.0
        for b in range(a):
            total -= factor[a, b] * step[b]
        step[a] = total / factor[a, a]
    for a in range(n - 1, -1, -1):
        for b in range(a + 1, n):
            step[a] -= factor[b, a] * step[b]
        step[a] /= factor[a, a]
    return step
