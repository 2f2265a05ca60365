"""Compiled walks under the law that proposals for a band's posterior are drawn from."""

from __future__ import annotations

import math

import numpy as np

from roomfit.compiled import kernel
from roomfit.typing import BoolArray, FloatArray
from roomfit.uncertainty.log_posterior import LEAST_REFLECTED


@kernel()
def walk_points(
    points: FloatArray,
    root: FloatArray,
    sizes: FloatArray,
    noise: FloatArray,
    chances: FloatArray,
    farthest: float,
    first: int,
    low: FloatArray,
    high: FloatArray,
    centre: FloatArray,
    prior: FloatArray,
    prior_mean: FloatArray,
    data: FloatArray,
    pull: FloatArray,
    measured: FloatArray,
    signal: FloatArray,
    background: FloatArray,
    slopes: FloatArray,
    curvature: FloatArray,
    weight: FloatArray,
    energies: BoolArray,
) -> FloatArray:
    """Move points by Metropolis steps under a law and return what each has gained, (n_points,).

    Parameters
    ----------
    points : shape (n_points, n)
        Moved in place.
    root : shape (n, n)
        A step of size 1 has the covariance ``root @ root.T``.
    sizes, chances, noise : shapes (n_steps,), (n_steps, n_points), (n_steps, n_points, n)
        The chance of every step: its size, the log of an even number from 0 to 1, normal numbers.
    farthest : float
        No free number may be farther from zero.
    first : int
        Where the absorptions begin, whose bounds are `low` and `high`.
    centre, prior_mean, pull : shape (n,)
    prior, data : shape (n, n)
    measured, signal, background, weight, energies : shape (n_data,)
        Of no data where `data` and `pull` say all.
    slopes, curvature : shapes (n_data, n), (n_data, n, n)
        See `roomfit.uncertainty.surrogate.Windows`.
    """
    n = points.shape[1]
    zero = np.empty(n)
    _exponents(centre, first, low, high, zero)
    gain = np.empty(len(points))
    here, trial, away = np.empty(n), np.empty(n), np.empty(n)
    for p in range(len(points)):
        here[:] = points[p]
        now = start = _log_density(
            *(here, away, zero, farthest, first, low, high, prior, prior_mean, data, pull),
            *(measured, signal, background, slopes, curvature, weight, energies),
        )
        for s in range(len(sizes)):
            for i in range(n):
                step = 0.0
                for j in range(i + 1):  # a Cholesky root is zero above its diagonal
                    step += root[i, j] * noise[s, p, j]
                trial[i] = here[i] + sizes[s] * step
            there = _log_density(
                *(trial, away, zero, farthest, first, low, high, prior, prior_mean, data, pull),
                *(measured, signal, background, slopes, curvature, weight, energies),
            )
            if chances[s, p] < there - now:  # false where both are minus infinity, whose gap is nan
                now = there
                here[:] = trial
        points[p] = here
        gain[p] = now - start
    return gain


@kernel()
def _exponents(
    kept: FloatArray, first: int, low: FloatArray, high: FloatArray, out: FloatArray
) -> None:
    """Fill in ``-log(1 - a)`` of absorptions, all other free numbers as they are."""
    out[:] = kept
    for i in range(len(low)):
        share = 0.5 * (1.0 - math.tanh(0.5 * kept[first + i]))
        less = (1.0 - high[i]) + (high[i] - low[i]) * share
        out[first + i] = -math.log(max(less, LEAST_REFLECTED))


@kernel()
def _log_density(
    kept: FloatArray,
    away: FloatArray,
    zero: FloatArray,
    farthest: float,
    first: int,
    low: FloatArray,
    high: FloatArray,
    prior: FloatArray,
    prior_mean: FloatArray,
    data: FloatArray,
    pull: FloatArray,
    measured: FloatArray,
    signal: FloatArray,
    background: FloatArray,
    slopes: FloatArray,
    curvature: FloatArray,
    weight: FloatArray,
    energies: BoolArray,
) -> float:
    """Return `roomfit.uncertainty.surrogate.Surrogate.log_density` of one point; `away` is scratch.

    Minus infinity far outside, and where a window's likelihood is no number.
    """
    n = len(kept)
    for i in range(n):
        if not abs(kept[i]) < farthest:
            return -math.inf
    _exponents(kept, first, low, high, away)
    total = 0.0
    for i in range(n):
        away[i] -= zero[i]
        of_prior = 0.0
        for j in range(n):
            of_prior += prior[i, j] * (kept[j] - prior_mean[j])
        total -= 0.5 * (kept[i] - prior_mean[i]) * of_prior
    if len(measured) == 0:
        for i in range(n):
            of_data = 0.0
            for j in range(n):
                of_data += data[i, j] * away[j]
            total += away[i] * (pull[i] - 0.5 * of_data)
        return total
    for w in range(len(measured)):
        change = 0.0
        for i in range(n):
            bend = 0.0
            for j in range(n):
                bend += curvature[w, i, j] * away[j]
            change += away[i] * (slopes[w, i] + 0.5 * bend)
        if energies[w]:
            grown = signal[w] * math.exp(change) + background[w]
            total += weight[w] * (-math.log(grown) - measured[w] / grown)
        else:
            off = measured[w] - background[w] - signal[w] - change
            total -= 0.5 * weight[w] * off * off
    return total if math.isfinite(total) else -math.inf
