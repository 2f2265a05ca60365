"""Equal-weight draws from a band's posterior by room parameters, which may have several modes.

A population is led from the prior to the posterior: weighed, resampled, and moved by Metropolis
steps, for some hundred evaluations.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from roomfit.base.kernels import kernel
from roomfit.base.typing import FloatArray, IntArray
from roomfit.model.parameters import (
    Parameters,
    absorption_of,
    physical_values,
    prior_residuals,
)
from roomfit.model.problem import Objective
from roomfit.solver import BandFit

# An absorption this near to 1 or 0 can no longer be distinguished from it.
FARTHEST_FREE = 40.0
# Least 1 - a of which a log is taken.
LEAST_REFLECTED = 1e-18
# Fewer points say little of where all have to go.
_LEAST_POINTS = 128
# Share of the population that must still count after it was weighed.
_LEAST_SHARE = 0.5
# Accepted moves a point before it is drawn from, and how many rounds of one evaluation a point
# they may take.
_MOVES, _MOST_ROUNDS = 0.8, 5
# Powers between the prior and the posterior, at most.
_MOST_LEVELS = 20
# Above so many numbers the second derivatives of all data cost more than what they save.
_MOST_CURVATURES = 20_000
# Of a free number, for second derivatives: large beside rounding, small beside what bends.
_STEP = 0.05

LogP: TypeAlias = Callable[[FloatArray], FloatArray]
"""From points, shape (n_points, n_free), to their log densities, up to a constant."""


def posterior_draws(
    objective: Objective, fit: BandFit, n_draws: int, rng: np.random.Generator
) -> tuple[FloatArray, int]:
    """Return draws, (n_draws, n_free), of absorptions that data with normal errors determine.

    And how many evaluations they took. The variances of the data are those of the fit, so that the
    most likely point is the fit's own. Neighbours count once, and a misfit flattens the data by
    phi. The law goes from the prior to the posterior by powers of their ratio, each as far as
    leaves half of the population [1]_. Moves are walks under a surrogate law [2]_, and differences
    of two other points [3]_.

    References
    ----------
    .. [1] P. Del Moral, A. Doucet, A. Jasra, "Sequential Monte Carlo samplers", J. R. Stat. Soc. B
           68, 411-436 (2006).
    .. [2] J. S. Liu, Monte Carlo Strategies in Scientific Computing, 2001, section 9.4.3
           ("surrogate transition").
    .. [3] C. J. F. ter Braak, "A Markov chain Monte Carlo version of the genetic algorithm
           differential evolution", Stat. Comput. 16, 239-249 (2006).
    """
    log_p_at, near = _log_density(objective, fit), _surrogate(objective, fit)
    size = max(n_draws, _LEAST_POINTS)
    root = np.linalg.cholesky(np.linalg.inv(near.law.prior))
    points = near.law.prior_mean + rng.standard_normal((size, len(root))) @ root.T
    log_p, of_prior = log_p_at(points), _log_prior(near.law, points)
    power, rounds = 0.0, 0
    for level in range(_MOST_LEVELS):
        ratio = log_p - of_prior
        step = _power_step(ratio, 1.0 - power)
        power += step
        chosen = _resampled(step * ratio, rng)
        points, log_p, of_prior = points[chosen], log_p[chosen], of_prior[chosen]
        if power >= 1.0 - 1e-9:
            break
        rounds = level + 1
        points, log_p, _ = _differed(log_p_at, points, log_p, rng, (near.law, power))
        of_prior = _log_prior(near.law, points)
    moves = 0.0
    for number in range(_MOST_ROUNDS):
        if number % 2 == 0:
            points, log_p, taken = _differed(log_p_at, points, log_p, rng)
        else:
            points, log_p, taken = _walked(log_p_at, near, points, log_p, rng)
        moves += taken
        if moves >= _MOVES:
            break
    drawn = rng.permutation(rng.permutation(points)[:n_draws])
    return drawn, size * (2 + rounds + number)


def _log_density(objective: Objective, fit: BandFit) -> LogP:
    """Return the log density of the posterior at many points; minus infinity far outside."""
    parameters, measured = objective.parameters, objective.measured()
    approximation = objective.at_points(fit.vector)
    spread = fit.variance * objective.correlation_length() * max(fit.chi2_reduced, 1.0)
    weight = 1.0 / spread

    def log_p(points: FloatArray) -> FloatArray:
        inside = np.all(np.abs(points) < FARTHEST_FREE, axis=1)
        if approximation is None:
            expected = np.array([objective.expected(p) for p in points])
        else:
            walls = [physical_values(parameters, p)[0]["absorption"] for p in points]
            expected = approximation(np.array(walls))
        off = measured - expected
        prior = np.array([prior_residuals(parameters, p)[0] for p in points])
        found = -0.5 * (np.sum(weight * off**2, axis=1) + np.sum(prior**2, axis=1))
        return np.where(inside & np.isfinite(found), found, -np.inf)

    return log_p


def _share(ratio: FloatArray, power: float) -> float:
    """Return which share of points counts that are weighed by a power of a ratio, by its log."""
    w = np.exp(power * (ratio - ratio.max()))
    return float(w.sum() ** 2 / (w @ w) / w.size)


def _power_step(ratio: FloatArray, most: float) -> float:
    """Return by how much the power may grow, `most` at most."""
    if _share(ratio, most) >= _LEAST_SHARE:
        return most
    low, high = 0.0, most
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _share(ratio, middle) >= _LEAST_SHARE else (low, middle)
    return max(low, 1e-3 * most)


def _resampled(log_weight: FloatArray, rng: np.random.Generator) -> IntArray:
    """Return indices of points, systematically as often as their weights ask for."""
    w = np.exp(log_weight - log_weight.max())
    at = (np.arange(w.size) + rng.random()) / w.size
    return np.asarray(np.minimum(np.searchsorted(np.cumsum(w / w.sum()), at), w.size - 1))


def _walked(
    log_p_at: LogP,
    near: _Surrogate,
    points: FloatArray,
    log_p: FloatArray,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray, float]:
    """Move points by walks under the surrogate."""
    there, gain = _walk(near, points, int(rng.choice(near.usual_steps)), rng)
    new = log_p_at(there)
    taken = np.log(rng.random(len(points))) < new - log_p - gain
    moved = np.where(taken[:, None], there, points)
    return moved, np.where(taken, new, log_p), float(taken.mean())


def _log_prior(law: _Law, points: FloatArray) -> FloatArray:
    away = points - law.prior_mean
    return np.asarray(-0.5 * np.einsum("pi,ij,pj->p", away, law.prior, away))


def _differed(
    log_p_at: LogP,
    points: FloatArray,
    log_p: FloatArray,
    rng: np.random.Generator,
    tempered: tuple[_Law, float] | None = None,
) -> tuple[FloatArray, FloatArray, float]:
    """Move each half of the points by differences of two points of the other half."""
    points, log_p = points.copy(), log_p.copy()
    taken = 0.0
    halves = np.array_split(rng.permutation(len(points)), 2)
    for own, other in (halves, halves[::-1]):
        pairs = np.array([rng.choice(other, 2, replace=False) for _ in own])
        scale = 2.38 / np.sqrt(2.0 * points.shape[1]) * rng.uniform(0.2, 1.0, (own.size, 1))
        there = points[own] + scale * (points[pairs[:, 0]] - points[pairs[:, 1]])
        there += 1e-5 * rng.standard_normal(there.shape)
        new = log_p_at(there)
        more = new - log_p[own]
        if tempered is not None:
            law, power = tempered
            by_prior = _log_prior(law, there) - _log_prior(law, points[own])
            more = power * more + (1.0 - power) * by_prior
        better = np.log(rng.random(own.size)) < more
        points[own[better]], log_p[own[better]] = there[better], new[better]
        taken += float(better.sum()) / len(points)
    return points, log_p, taken


class _Law(NamedTuple):
    """A law near to a posterior: in the exponents ``-log(1 - a)`` the data are nearly linear.

    Only the prior is Gaussian in the logits; see `roomfit.uncertainty.posterior`. The expectation
    of the data is quadratic in the exponents; where there are so many data that this costs more
    than it saves, the log-likelihood as a whole is.
    """

    low: FloatArray  # (n,), bounds of the fitted absorptions
    high: FloatArray
    centre: FloatArray  # (n,), the fit's answer
    prior: FloatArray  # (n, n), information
    prior_mean: FloatArray
    data: FloatArray  # (n, n), information of the data in the exponents
    pull: FloatArray  # (n,), slope of the data's log-likelihood at the centre
    residual: FloatArray  # (n_data,), at the centre; empty where `data` and `pull` suffice
    slopes: FloatArray  # (n_data, n), of the data by the exponents
    curvature: FloatArray  # (n_data, n, n), second derivative of the same
    weight: FloatArray  # (n_data,)


@dataclass(frozen=True, slots=True, eq=False)
class _Surrogate:
    """A law under which walks cost no evaluation."""

    law: _Law
    root: FloatArray  # (n, n), Cholesky root of the covariance at the centre

    @property
    def usual_steps(self) -> tuple[int, ...]:
        """Lengths of walks: a short one, and one that costs less than what it is weighed by.

        A random walk needs some 500 steps to forget its start under the skew laws of hard walls.
        """
        return (50, 500) if self.law.residual.size else (50, 4000)


def _surrogate(objective: Objective, fit: BandFit) -> _Surrogate:
    """Return the law that proposals for a band's posterior are drawn from."""
    parameters, n, flattening = objective.parameters, fit.vector.size, max(fit.chi2_reduced, 1.0)
    block = absorption_of(parameters)
    low, high = block.lower[block.fitted], block.upper[block.fitted]
    _, rows = prior_residuals(parameters, fit.vector)
    prior, mean = rows.T @ rows, block.prior_mean[block.fitted]
    data = (fit.information - prior) / flattening
    slope = _exponent_slopes(parameters, fit.vector)
    pull = prior @ (fit.vector - mean) / slope
    size, directions = np.linalg.eigh(0.5 * (data + data.T))
    data = (directions * np.maximum(size, 0.0)) @ directions.T
    covariance = np.linalg.inv(data + prior + 1e-6 * np.eye(n))
    residual, weight = np.zeros(0), np.zeros(0)
    slopes, curvature = np.zeros((0, n)), np.zeros((0, n, n))
    if fit.variance.size * n * n <= _MOST_CURVATURES:
        there = objective.predict(fit.vector)
        residual = objective.measured() - there.expected
        slopes = there.jacobian / slope
        weight = 1.0 / (fit.variance * (objective.correlation_length() * flattening))
        curvature = np.empty((*slopes.shape, n))
        for k in range(n):
            moved = fit.vector + _STEP * (np.arange(n) == k)
            ends = np.empty((2, n))
            for vector, out in zip((fit.vector, moved), ends, strict=True):
                _exponents(vector, low, high, out)
            step = max(float(ends[1, k] - ends[0, k]), 1e-12)
            by = objective.predict(moved).jacobian / _exponent_slopes(parameters, moved)
            curvature[:, :, k] = (by - slopes) / step
        curvature = 0.5 * (curvature + curvature.transpose(0, 2, 1))
    centre, data = np.array(fit.vector), data / np.outer(slope, slope)
    law = _Law(low, high, centre, prior, mean, data, pull, residual, slopes, curvature, weight)
    root = 2.38 / np.sqrt(n) * np.linalg.cholesky(covariance)
    return _Surrogate(_Law._make(np.ascontiguousarray(a) for a in law), root)


def _exponent_slopes(parameters: Parameters, vector: FloatArray) -> FloatArray:
    """Return the derivative of each exponent by its free number, (n_free,)."""
    values, slopes = physical_values(parameters, vector)
    by_exponent = slopes["absorption"] / np.maximum(1.0 - values["absorption"], 1e-12)
    return np.asarray(np.maximum(by_exponent[absorption_of(parameters).fitted], 1e-9))


def _walk(
    near: _Surrogate, points: FloatArray, steps: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return points after Metropolis steps under a law, and their gain in its log density.

    The walk is reversible under the law, so a proposal made by it is weighed by that gain alone.
    """
    # drawn whatever the point, so that each step stays reversible; small ones still move along
    # narrow ridges
    sizes = np.exp(rng.uniform(np.log(0.1), np.log(2.0), steps))
    here = np.array(points, dtype=np.float64, order="C")
    noise = rng.standard_normal((steps, *here.shape))
    gain = walk_points(here, near.root, sizes, noise, np.log(rng.random(noise.shape[:2])), near.law)
    return here, gain


@kernel()
def walk_points(
    points: FloatArray,
    root: FloatArray,
    sizes: FloatArray,
    noise: FloatArray,
    chances: FloatArray,
    law: _Law,
) -> FloatArray:
    """Move points by Metropolis steps under a law and return what each has gained, (n_points,).

    Shapes: `points` (n_points, n), `root` (n, n), `sizes, chances, noise` (n_steps,), (n_steps,
    n_points), (n_steps, n_points, n).
    """
    n = points.shape[1]
    zero = np.empty(n)
    _exponents(law.centre, law.low, law.high, zero)
    gain = np.empty(len(points))
    here, trial, away = np.empty(n), np.empty(n), np.empty(n)
    for p in range(len(points)):
        here[:] = points[p]
        now = start = _log_density_near(here, away, zero, law)
        for s in range(len(sizes)):
            for i in range(n):
                step = 0.0
                for j in range(i + 1):  # a Cholesky root is zero above its diagonal
                    step += root[i, j] * noise[s, p, j]
                trial[i] = here[i] + sizes[s] * step
            there = _log_density_near(trial, away, zero, law)
            if chances[s, p] < there - now:  # false where both are minus infinity, whose gap is nan
                now = there
                here[:] = trial
        points[p] = here
        gain[p] = now - start
    return gain


@kernel()
def _exponents(kept: FloatArray, low: FloatArray, high: FloatArray, out: FloatArray) -> None:
    """Fill in ``-log(1 - a)`` of absorptions, without rounding where a comes near to 1."""
    for i in range(len(low)):
        share = 0.5 * (1.0 - math.tanh(0.5 * kept[i]))
        less = (1.0 - high[i]) + (high[i] - low[i]) * share
        out[i] = -math.log(max(less, LEAST_REFLECTED))


@kernel()
def _log_density_near(kept: FloatArray, away: FloatArray, zero: FloatArray, law: _Law) -> float:
    """Return the log density of a law at one point, up to a constant; `away` is scratch."""
    n = len(kept)
    for i in range(n):
        if not abs(kept[i]) < FARTHEST_FREE:
            return -math.inf
    _exponents(kept, law.low, law.high, away)
    total = 0.0
    for i in range(n):
        away[i] -= zero[i]
        of_prior = 0.0
        for j in range(n):
            of_prior += law.prior[i, j] * (kept[j] - law.prior_mean[j])
        total -= 0.5 * (kept[i] - law.prior_mean[i]) * of_prior
    if len(law.residual) == 0:
        for i in range(n):
            of_data = 0.0
            for j in range(n):
                of_data += law.data[i, j] * away[j]
            total += away[i] * (law.pull[i] - 0.5 * of_data)
        return total
    for w in range(len(law.residual)):
        change = 0.0
        for i in range(n):
            bend = 0.0
            for j in range(n):
                bend += law.curvature[w, i, j] * away[j]
            change += away[i] * (law.slopes[w, i] + 0.5 * bend)
        off = law.residual[w] - change
        total -= 0.5 * law.weight[w] * off * off
    return total if math.isfinite(total) else -math.inf
