"""Convex lower bounds of the misfit over a box, and the descents that use them.

The bound is minimised with a valid lower value at every step; slices where it exceeds the threshold
are cut off the box; where the misfit itself is proven convex, the box has one minimum at most.
Gaussian priors of logit absorption have bounds of their own over an interval.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from roomfit.base.kernels import kernel
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.paper.bounds import (
    VANISHING,
    Planes,
    energies,
    in_log,
    log_slopes,
    lower_bound,
    misfit,
    powers,
    stiffness,
)
from roomfit.paper.question import Arrays

Separable: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]
"""value, slope and curvature (0 or more) of the priors' lower bounds, each of shape (n,)."""

# Of what is summed: a few hundred windows, each off by a few units of 1.1e-16.
SUMMED = 1e-12
_CONVEX_STEPS = 12
_ARMIJO = 1e-4


@kernel()
def bound_at(
    global_problem: Arrays,
    planes: Planes,
    separable: Separable,
    d: FloatArray,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """Return the convex lower bound at d and fill its gradient and a Hessian."""
    measured, precision = global_problem[3], global_problem[4]
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
        value, first, second = lower_bound(measured[i], precision[i], here, remainder[i], tail[i])
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
def minimum_over(
    global_problem: Arrays,
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
    here = bound_at(global_problem, planes, separable, d, gradient, hessian)
    best = -math.inf
    for _ in range(_CONVEX_STEPS):
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
            there = bound_at(global_problem, planes, separable, other, unused[0], unused)
            if there <= here + _ARMIJO * gain and there < here:
                moved = True
                break
            size *= 0.35
        if not moved:
            break
        for a in range(n):
            d[a] = other[a]
        here = bound_at(global_problem, planes, separable, d, gradient, hessian)
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
    """Return a descent step in which coordinates fixed by a face of the box do not move."""
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


@kernel(allocates=False)
def prior_at(prior: FloatArray, g: float) -> tuple[float, float, float]:
    """Return ``p (z - mean)**2`` and its two derivatives by g, z the logit of the absorption.

    With x = exp(g), A = 1 - lower bound and B = 1 - upper bound: ``z = log(A - x) - log(x - B)``.
    Infinite where the absorption leaves its bounds.
    """
    p, mean, a, b = prior[0], prior[1], prior[2], prior[3]
    if p == 0.0:
        return 0.0, 0.0, 0.0
    x = math.exp(g)
    if x >= a or x <= b:
        return math.inf, 0.0, 0.0
    off = math.log((a - x) / (x - b)) - mean
    first = -x / (a - x) - x / (x - b)
    second = -x * a / (a - x) ** 2 + x * b / (x - b) ** 2
    return p * off * off, 2.0 * p * off * first, 2.0 * p * (first * first + off * second)


@kernel(allocates=False)
def least_curvature(prior: FloatArray, lo: float, hi: float) -> float:
    """Return no more than the prior's second derivative anywhere between lo and hi."""
    p, mean, a, b = prior[0], prior[1], prior[2], prior[3]
    if p == 0.0:
        return 0.0
    x0, x1 = math.exp(lo), math.exp(hi)
    if x0 <= b or x1 >= a:
        return -math.inf
    # z falls with x; so do a - x and 1 / (x - b)
    most = math.log((a - x0) / (x0 - b)) - mean
    least = math.log((a - x1) / (x1 - b)) - mean
    first = x0 / (a - x0) + x1 / (x1 - b)
    up = -x0 * a / (a - x0) ** 2 + x1 * b / (x0 - b) ** 2
    down = -x1 * a / (a - x1) ** 2 + x0 * b / (x1 - b) ** 2
    worst = min(min(most * up, most * down), min(least * up, least * down))
    whole = 2.0 * p * (first * first + worst)
    return float(whole - 1e-9 * (abs(whole) + 2.0 * p * (first * first + abs(worst))))


@kernel(allocates=False)
def least_prior(prior: FloatArray, lo: float, hi: float) -> float:
    """Return no more than the prior anywhere between lo and hi; lo may be minus infinity."""
    p, mean, a, b = prior[0], prior[1], prior[2], prior[3]
    if p == 0.0:
        return 0.0
    x0, x1 = math.exp(lo), math.exp(hi)
    most = math.log((a - x0) / (x0 - b)) if b < x0 < a else math.inf
    least = math.log((a - x1) / (x1 - b)) if b < x1 < a else -math.inf
    if x0 >= a or x1 <= b:
        return math.inf
    off = max(max(mean - most, least - mean), 0.0)
    return float(p * off * off * (1.0 - 1e-12))


@kernel()
def priors_over(
    priors: FloatArray, lo: FloatArray, hi: FloatArray, centre: FloatArray, half: FloatArray
) -> Separable:
    """Return a quadratic below every prior on its interval, about the centre.

    ``p(c + d) >= p(c) + p'(c) d + k d**2 / 2`` with k no more than p'' anywhere between. A k below
    0 would not be convex: its worst, ``k h**2 / 2``, is taken off instead. Where that falls below
    the least value of the prior on the interval, as on intervals that are long, this value serves.
    """
    n = len(lo)
    value, slope, curve = np.zeros(n), np.zeros(n), np.zeros(n)
    for m in range(n):
        if priors[m, 0] == 0.0:
            continue
        flat = least_prior(priors[m], lo[m], hi[m])
        value[m] = flat
        if not math.isfinite(lo[m]):
            continue
        here, first, _ = prior_at(priors[m], centre[m])
        least = least_curvature(priors[m], centre[m] - half[m], centre[m] + half[m])
        if not math.isfinite(here) or not math.isfinite(least):
            continue
        offset = here - 1e-10 * (abs(here) + abs(first) * (1.0 + half[m]))
        if least < 0.0:
            offset += 0.5 * least * half[m] * half[m]
        curvature = max(least, 0.0)
        at_best = offset - abs(first) * half[m]
        if curvature > 0.0:
            place = min(max(-first / curvature, -half[m]), half[m])
            at_best = offset + first * place + 0.5 * curvature * place * place
        if at_best >= flat - 0.5 * abs(here - flat) or at_best >= flat:
            value[m], slope[m], curve[m] = offset, first, curvature
    return value, slope, curve


# Rows may change their weight within a window by no more than this, or the test is not tried.
_MOST_CHANGE = 3.0
# What must be left of a whitened curvature of 1, far above the rounding of its parts.
_MARGIN = 1e-3
_SHARES = (1e-4, 1e-3, 1e-2, 0.03, 0.1, 0.25)


@kernel()
def is_convex(global_problem: Arrays, box: FloatArray, most: int, values: FloatArray) -> bool:
    """Return True only where the Hessian is positive definite at every point of the box.

    With f the misfit of a window as a function of its log energy, nbar the mean and C the
    covariance of its exponents, the Hessian is the sum of ``f'' nbar nbar' + f' C``. Over the box:
    f'' and f' lie above their least values between the energies of the two corners. The mean
    moves by y, and ``(x + y)(x + y)' >= (1 - t) x x' - (1 / t - 1) y y'`` for 0 < t < 1. A weight
    p_k becomes ``p_k exp(u_k) / Z`` with ``|u_k| <= rho_k`` and Z at least 1, so that C is at most
    the second moment with weights ``p_k exp(rho_k)``, and at least C at the centre times the least
    ratio. What these leave is compared in the basis in which it is the unit matrix at t = 0.
    """
    measured, prior = global_problem[3], global_problem[5]
    n, windows = box.shape[1], len(measured)
    centre, half = np.empty(n), np.empty(n)
    far = np.zeros(n, dtype=np.bool_)
    for m in range(n):
        if not math.isfinite(box[0, m]):
            return False
        centre[m] = 0.5 * (box[0, m] + box[1, m])
        half[m] = 0.5 * (box[1, m] - box[0, m]) * (1.0 + 1e-12) + 1e-14 * (1.0 + abs(centre[m]))
    energy, low, high = np.empty(windows), np.empty(windows), np.empty(windows)
    slope, stiff = np.empty((windows, n)), np.empty(windows)
    log_slopes(global_problem, powers(centre, most), far, values, energy, slope)
    energies(global_problem, powers(box[0], most), low)
    energies(global_problem, powers(box[1], most), high)
    outer, whole = np.zeros((n, n)), np.zeros((n, n))
    for i in range(windows):
        if high[i] == 0.0:
            stiff[i] = 0.0  # no path at all: a constant
            continue
        if low[i] < VANISHING:
            return False
        stiff[i], pull = _least_slopes(
            measured[i], global_problem[4][i], low[i] * (1.0 - 1e-10), high[i] * (1.0 + 1e-10)
        )
        # a part that bends down is taken off in full: (x + y)(x + y)' <= 2 x x' + 2 y y'
        factor = stiff[i] if stiff[i] >= 0.0 else 2.0 * stiff[i]
        for a in range(n):
            for b in range(n):
                part = factor * slope[i, a] * slope[i, b]
                whole[a, b] += part
                outer[a, b] += max(stiff[i], 0.0) * slope[i, a] * slope[i, b]
        if not _add_covariance(global_problem, i, values, energy[i], slope[i], half, pull, whole):
            return False
    for m in range(n):
        whole[m, m] += least_curvature(prior[m], centre[m] - half[m], centre[m] + half[m])
        if not math.isfinite(whole[m, m]):
            return False
    basis = _whitening(whole)
    if not math.isfinite(basis[0, 0]):
        return False
    moved = np.zeros(n)
    for i in range(windows):
        if high[i] > 0.0:
            _add_movement(
                global_problem, i, values, energy[i], slope[i], half, basis, stiff[i], moved
            )
    return _stays_definite(basis, whole, outer, moved)


@kernel()
def _stays_definite(
    basis: FloatArray, whole: FloatArray, outer: FloatArray, moved: FloatArray
) -> bool:
    """Whether some t leaves ``whole - t outer - (1 / t - 1) y y'`` positive definite."""
    n = len(moved)
    white, size = _congruent(basis, whole)
    part, more = _congruent(basis, outer)
    trial = np.empty((n, n))
    for t in _SHARES:
        for a in range(n):
            for b in range(n):
                trial[a, b] = white[a, b] - t * part[a, b]
            trial[a, a] -= (1.0 / t - 1.0) * moved[a]
        # the eigenvalue is off by a few units of the sums behind it, far below the margin
        if np.linalg.eigvalsh(trial)[0] - 1e-12 * (size + more) > _MARGIN:
            return True
    return False


@kernel(allocates=False)
def _least_slopes(m: float, c: float, low: float, high: float) -> tuple[float, float]:
    """Return the least f'' and the least f' for energies between low and high."""
    at = min(max(low, 0.25 * m), high)
    turn = min(max(low, 0.5 * m), high)
    return 2.0 * c * at * (2.0 * at - m), 2.0 * c * turn * (turn - m)


@kernel()
def _whitening(matrix: FloatArray) -> FloatArray:
    """Return a W with W' A W near the unit matrix, or infinities where A is not clearly definite.

    W need not be exact: what it makes of A is computed afterwards.
    """
    n = len(matrix)
    scaled, basis = np.empty((n, n)), np.empty((n, n))
    for a in range(n):
        if matrix[a, a] <= 0.0:
            basis[0, 0] = math.inf
            return basis
    for a in range(n):
        for b in range(n):
            scaled[a, b] = matrix[a, b] / math.sqrt(matrix[a, a] * matrix[b, b])
    values, vectors = np.linalg.eigh(scaled)
    for a in range(n):
        for b in range(n):
            basis[a, b] = vectors[a, b] / math.sqrt(max(values[b], 1e-300) * matrix[a, a])
    if values[0] < 1e-9:
        basis[0, 0] = math.inf
    return basis


@kernel(allocates=False)
def _add_covariance(
    global_problem: Arrays,
    i: int,
    values: FloatArray,
    total: float,
    slope: FloatArray,
    half: FloatArray,
    pull: float,
    whole: FloatArray,
) -> bool:
    """Add the least that ``pull C`` may be; False where a row may change too much."""
    offsets, exponents = global_problem[0], global_problem[2]
    n = len(half)
    reach, partition = 0.0, 1.0
    for k in range(offsets[i], offsets[i + 1]):
        rho = _reach(exponents[k], slope, half)
        lost = values[k] == 0.0 and global_problem[1][k] > 0.0
        if rho > _MOST_CHANGE or lost:
            return False
        reach = max(reach, rho)
        partition += values[k] / total * (math.exp(rho) - 1.0 - rho)
    least = math.exp(-reach) / partition * (1.0 - 1e-9)
    for k in range(offsets[i], offsets[i + 1]):
        p = pull * values[k] / total
        p *= least if pull > 0.0 else math.exp(_reach(exponents[k], slope, half)) * (1.0 + 1e-9)
        for a in range(n):
            of_a = p * (exponents[k, a] - slope[a])
            for b in range(n):
                whole[a, b] += of_a * (exponents[k, b] - slope[b])
    return True


@kernel()
def _add_movement(
    global_problem: Arrays,
    i: int,
    values: FloatArray,
    total: float,
    slope: FloatArray,
    half: FloatArray,
    basis: FloatArray,
    stiff: float,
    moved: FloatArray,
) -> None:
    """Add a diagonal above ``f'' y y'`` in the basis: e_m sum(e) for ``|y_m| <= e_m`` dominates.

    A weight p_k moves by at most ``p_k max(exp(rho_k) - 1, 1 - exp(-rho_k) / Z)``.
    """
    offsets, exponents = global_problem[0], global_problem[2]
    n = len(half)
    change = np.zeros(n)
    partition = 1.0 + 1e-9
    for k in range(offsets[i], offsets[i + 1]):
        rho = _reach(exponents[k], slope, half)
        partition += values[k] / total * (math.exp(rho) - 1.0 - rho)
    for k in range(offsets[i], offsets[i + 1]):
        rho = _reach(exponents[k], slope, half) + 1e-9
        off = values[k] / total * max(math.exp(rho) - 1.0, 1.0 - math.exp(-rho) / partition)
        for b in range(n):
            white = 0.0
            for a in range(n):
                white += basis[a, b] * (exponents[k, a] - slope[a])
            change[b] += off * abs(white)
    together = 0.0
    for a in range(n):
        together += change[a]
    factor = stiff if stiff >= 0.0 else -2.0 * stiff
    for a in range(n):
        moved[a] += factor * change[a] * together


@kernel(allocates=False)
def _reach(exponents: FloatArray, slope: FloatArray, half: FloatArray) -> float:
    total = 0.0
    for m in range(len(half)):
        total += abs(exponents[m] - slope[m]) * half[m]
    return total


@kernel()
def _congruent(basis: FloatArray, matrix: FloatArray) -> tuple[FloatArray, float]:
    """Return ``basis' matrix basis`` and the largest sum of absolute terms behind an entry."""
    n = len(matrix)
    out, most = np.zeros((n, n)), 0.0
    for a in range(n):
        for b in range(n):
            size = 0.0
            for c in range(n):
                for d in range(n):
                    term = basis[c, a] * matrix[c, d] * basis[d, b]
                    out[a, b] += term
                    size += abs(term)
            most = max(most, size)
    return out, most


_DESCENT_STEPS = 60


@kernel()
def total_misfit(global_problem: Arrays, g: FloatArray, most: int) -> float:
    """Return the misfit at g, priors included; g may hold minus infinities."""
    measured, precision, prior = global_problem[3], global_problem[4], global_problem[5]
    energy = np.empty(len(measured))
    energies(global_problem, powers(g, most), energy)
    total = 0.0
    for i in range(len(measured)):
        total += misfit(measured[i], precision[i], energy[i])
    for m in range(len(g)):
        total += prior_at(prior[m], g[m])[0]
    return total


@kernel()
def _slopes_at(global_problem: Arrays, g: FloatArray, most: int) -> tuple[FloatArray, FloatArray]:
    """Return window energies and the slopes of their logarithms by g, (n_windows, n)."""
    energy = np.empty(len(global_problem[3]))
    slope, values = np.empty((len(energy), len(g))), np.empty(len(global_problem[1]))
    far = np.zeros(len(g), dtype=np.bool_)
    log_slopes(global_problem, powers(g, most), far, values, energy, slope)
    return energy, slope


@kernel()
def misfit_slopes(
    global_problem: Arrays,
    g: FloatArray,
    most: int,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """Return the misfit and fill its gradient and Gauss-Newton Hessian by g."""
    measured, precision, prior = global_problem[3], global_problem[4], global_problem[5]
    n, windows = len(g), len(measured)
    energy, slope = _slopes_at(global_problem, g, most)
    total = 0.0
    for a in range(n):
        value, first, second = prior_at(prior[a], g[a])
        total += value
        gradient[a] = first
        for b in range(n):
            hessian[a, b] = max(second, 0.0) if a == b else 0.0
    for i in range(windows):
        r, m, c = energy[i], measured[i], precision[i]
        total += misfit(m, c, r)
        if r <= 0.0:
            continue
        first = 2.0 * c * r * (r - m)
        second = stiffness(c, r)
        for a in range(n):
            gradient[a] += first * slope[i, a]
            for b in range(n):
                hessian[a, b] += second * slope[i, a] * slope[i, b]
    return total


@kernel()
def descend(
    global_problem: Arrays,
    start: FloatArray,
    low: FloatArray,
    high: FloatArray,
    most: int,
) -> tuple[FloatArray, float]:
    """Return where damped Gauss-Newton steps within bounds end, and the misfit there."""
    n = len(start)
    g = np.minimum(np.maximum(start, low), high)
    gradient, hessian, damped = np.empty(n), np.empty((n, n)), np.empty((n, n))
    here = misfit_slopes(global_problem, g, most, gradient, hessian)
    damping = 1e-3
    for _ in range(_DESCENT_STEPS):
        for a in range(n):
            for b in range(n):
                damped[a, b] = hessian[a, b]
            damped[a, a] += damping * hessian[a, a]
        step = newton_step(gradient, damped, g, low, high)
        other = np.minimum(np.maximum(step + g, low), high)
        there = total_misfit(global_problem, other, most)
        if not there < here:
            damping *= 8.0
            if damping > 1e8:
                break
            continue
        done = here - there <= 1e-13 * here
        g, damping = other, max(damping * 0.2, 1e-12)
        here = misfit_slopes(global_problem, g, most, gradient, hessian)
        if done:
            break
    return g, total_misfit(global_problem, g, most)


@kernel()
def least_of_convex(
    global_problem: Arrays,
    box: FloatArray,
    start: FloatArray,
    most: int,
    rounding: float,
) -> tuple[FloatArray, float, float]:
    """Return the lowest point of a box on which the misfit is convex, its misfit, and a bound.

    The tangent plane at the point lies below a convex function: its least value over the box is a
    bound for the whole box. Taken off is what rounding may have added: an energy off by the
    fraction e changes a window's misfit by |f'| e, and its slope by as much of f' and f''.
    """
    n = len(start)
    place, value = descend(global_problem, start, box[0], box[1], most)
    gradient, hessian = np.empty(n), np.empty((n, n))
    here = misfit_slopes(global_problem, place, most, gradient, hessian)
    bound, reach = here, 0.0
    for m in range(n):
        bound += min(gradient[m] * (box[0, m] - place[m]), gradient[m] * (box[1, m] - place[m]))
        reach = max(reach, box[1, m] - box[0, m])
    size = _sensitivity(global_problem, place, most, reach)
    return place, value, bound - 8.0 * rounding * size - 1e-12 * (here + abs(here - bound))


@kernel()
def _sensitivity(global_problem: Arrays, g: FloatArray, most: int, reach: float) -> float:
    """Return by how much misfit and tangent change for a relative change of every energy by 1.

    Of a misfit by ``|f'|``, of a tangent over a distance by ``(|f'| + |f''|)`` times the mean
    exponents and the distance.
    """
    measured, precision = global_problem[3], global_problem[4]
    energy, slope = _slopes_at(global_problem, g, most)
    total = 0.0
    for i in range(len(measured)):
        if energy[i] > 0.0:
            _, first, second = in_log(measured[i], precision[i], math.log(energy[i]))
            hits = 0.0
            for m in range(len(g)):
                hits += slope[i, m]
            total += (abs(first) + abs(second)) * (1.0 + hits * reach)
    return total


# Slices of a box tried at each face, as a share of its width.
_SLICES = (0.5, 0.25, 0.125)


@kernel()
def contract(
    global_problem: Arrays,
    planes: Planes,
    separable: Separable,
    box: FloatArray,
    centre: FloatArray,
    half: FloatArray,
    threshold: float,
    low_ends: FloatArray,
) -> float:
    """Shrink a box in place and return the share of its volume that is kept.

    Parameters
    ----------
    box : float array, shape (2, n)
        In g; a coordinate that reaches minus infinity keeps its lower end.
    threshold : float
        A slice is cut off where the convex bound reaches it.
    low_ends : float array, shape (n,)
        Where over the whole box the convex bound is lowest, from the centre.
    """
    n = box.shape[1]
    low, high, d = np.empty(n), np.empty(n), np.empty(n)
    for m in range(n):
        low[m], high[m] = -half[m], half[m]
    kept = 1.0
    for m in range(n):
        for side in range(2):
            if not math.isfinite(box[0, m]):
                continue
            for share in _SLICES:
                old_low, old_high = low[m], high[m]
                step = share * (old_high - old_low)
                edge = old_low + step if side == 0 else old_high - step
                if side == 0:
                    high[m] = edge
                else:
                    low[m] = edge
                for a in range(n):
                    d[a] = low_ends[a]
                bound = minimum_over(
                    global_problem, planes, separable, low, high, threshold, d, False
                )
                low[m], high[m] = old_low, old_high
                if bound < threshold:
                    continue
                # more than the rounding of the sum, and of the centre's exponential
                slack = 2e-15 * (1.0 + abs(centre[m]) + abs(edge))
                if side == 0:
                    low[m] = edge
                    box[0, m] = max(box[0, m], centre[m] + edge - slack)
                else:
                    high[m] = edge
                    box[1, m] = min(box[1, m], centre[m] + edge + slack)
                kept *= 1.0 - share
                break
    return kept
