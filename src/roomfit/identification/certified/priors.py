"""Gaussian priors of logit absorption: values, and lower bounds over an interval."""

from __future__ import annotations

import math

import numpy as np

from roomfit.compiled import kernel
from roomfit.identification.certified.convex import Separable
from roomfit.typing import FloatArray


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
    if x0 >= a:
        return math.inf
    if x1 <= b:
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
