"""The misfit itself, and a descent from a point to a local minimum."""

from __future__ import annotations

import math

import numpy as np

from roomfit.compiled import kernel
from roomfit.identification.certified.convex import newton_step
from roomfit.identification.certified.misfits import in_log, misfit, stiffness
from roomfit.identification.certified.priors import prior_at
from roomfit.identification.certified.question import Arrays
from roomfit.identification.certified.rows import energies, log_slopes, powers
from roomfit.typing import FloatArray

_STEPS = 60


@kernel()
def total_misfit(kind: int, question: Arrays, g: FloatArray, most: int) -> float:
    """Return the misfit at g, priors included; g may hold minus infinities."""
    measured, precision, prior = question[3], question[4], question[5]
    energy = np.empty(len(measured))
    energies(question, powers(g, most), energy)
    total = 0.0
    for i in range(len(measured)):
        total += misfit(kind, measured[i], precision[i], energy[i])
    for m in range(len(g)):
        total += prior_at(prior[m], g[m])[0]
    return total


@kernel()
def misfit_slopes(
    kind: int, question: Arrays, g: FloatArray, most: int, gradient: FloatArray, hessian: FloatArray
) -> float:
    """Return the misfit and fill its gradient and Gauss-Newton Hessian by g."""
    measured, precision, prior = question[3], question[4], question[5]
    n, windows = len(g), len(measured)
    far = np.zeros(n, dtype=np.bool_)
    energy, slope = np.empty(windows), np.empty((windows, n))
    log_slopes(question, powers(g, most), far, np.empty(len(question[1])), energy, slope)
    total = 0.0
    for a in range(n):
        value, first, second = prior_at(prior[a], g[a])
        total += value
        gradient[a] = first
        for b in range(n):
            hessian[a, b] = max(second, 0.0) if a == b else 0.0
    for i in range(windows):
        r, m, c = energy[i], measured[i], precision[i]
        total += misfit(kind, m, c, r)
        if r <= 0.0:
            continue
        if kind == 0:
            first = 2.0 * c * r * (r - m)
        elif kind == 1:
            first = 2.0 * c * math.log(r / m)
        else:
            first = 2.0 * c * (1.0 - m / r)
        second = stiffness(kind, c, r)
        for a in range(n):
            gradient[a] += first * slope[i, a]
            for b in range(n):
                hessian[a, b] += second * slope[i, a] * slope[i, b]
    return total


@kernel()
def _clipped(g: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    inside = np.empty(len(g))
    for a in range(len(g)):
        inside[a] = min(max(g[a], low[a]), high[a])
    return inside


@kernel()
def descend(
    kind: int, question: Arrays, start: FloatArray, low: FloatArray, high: FloatArray, most: int
) -> tuple[FloatArray, float]:
    """Return where damped Gauss-Newton steps within bounds end, and the misfit there."""
    n = len(start)
    g = _clipped(start, low, high)
    gradient, hessian, damped = np.empty(n), np.empty((n, n)), np.empty((n, n))
    here = misfit_slopes(kind, question, g, most, gradient, hessian)
    damping = 1e-3
    for _ in range(_STEPS):
        for a in range(n):
            for b in range(n):
                damped[a, b] = hessian[a, b]
            damped[a, a] += damping * hessian[a, a]
        step = newton_step(gradient, damped, g, low, high)
        for a in range(n):
            step[a] += g[a]
        other = _clipped(step, low, high)
        there = total_misfit(kind, question, other, most)
        if not there < here:
            damping *= 8.0
            if damping > 1e8:
                break
            continue
        done = here - there <= 1e-13 * here
        g, damping = other, max(damping * 0.2, 1e-12)
        here = misfit_slopes(kind, question, g, most, gradient, hessian)
        if done:
            break
    return g, total_misfit(kind, question, g, most)


@kernel()
def least_of_convex(
    kind: int,
    question: Arrays,
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
    place, value = descend(kind, question, start, box[0], box[1], most)
    gradient, hessian = np.empty(n), np.empty((n, n))
    here = misfit_slopes(kind, question, place, most, gradient, hessian)
    bound, reach = here, 0.0
    for m in range(n):
        bound += min(gradient[m] * (box[0, m] - place[m]), gradient[m] * (box[1, m] - place[m]))
        reach = max(reach, box[1, m] - box[0, m])
    size = _sensitivity(kind, question, place, most, reach)
    return place, value, bound - 8.0 * rounding * size - 1e-12 * (here + abs(here - bound))


@kernel()
def _sensitivity(kind: int, question: Arrays, g: FloatArray, most: int, reach: float) -> float:
    """Return by how much misfit and tangent change for a relative change of every energy by 1.

    Of a misfit by ``|f'|``, of a tangent over a distance by ``(|f'| + |f''|)`` times the mean
    exponents and the distance.
    """
    measured, precision = question[3], question[4]
    windows = len(measured)
    far = np.zeros(len(g), dtype=np.bool_)
    energy, slope = np.empty(windows), np.empty((windows, len(g)))
    log_slopes(question, powers(g, most), far, np.empty(len(question[1])), energy, slope)
    total = 0.0
    for i in range(windows):
        if energy[i] > 0.0:
            _, first, second = in_log(kind, measured[i], precision[i], math.log(energy[i]))
            hits = 0.0
            for m in range(len(g)):
                hits += slope[i, m]
            total += (abs(first) + abs(second)) * (1.0 + hits * reach)
    return total
