"""Equal-weight draws from a band's posterior by population Monte Carlo.

A population starts from a law that takes no evaluation, and is led from there to the posterior
itself: weighed, resampled, and moved by Metropolis steps, for some hundred evaluations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from roomfit.base.typing import FloatArray, IntArray
from roomfit.model.parameters import physical_values, prior_residuals
from roomfit.model.problem import Objective
from roomfit.solver import BandFit
from roomfit.uncertainty.sampling import (
    FARTHEST_FREE,
    LogPosterior,
    Surrogate,
    log_posterior,
    surrogate,
)

# Each point is drawn from twice, some moves apart; fewer say little of where all have to go.
_LEAST_POINTS = 64
# Share of the population that must still count after it was weighed.
_LEAST_SHARE = 0.5
# Accepted moves a point before it is drawn from, and again before it is a second time; and how many
# rounds of one evaluation a point they may take.
_MOVES, _MOST_ROUNDS = 0.8, 5
# Powers between the first law and the posterior, at most.
_MOST_LEVELS = 20
# Above so many numbers the second derivatives of all windows cost more than what they save.
_MOST_CURVATURES = 20_000


@dataclass(frozen=True, slots=True, eq=False)
class Population:
    """Draws from a posterior, all of the same weight."""

    draws: FloatArray  # (n_draws, n_kept)
    moves: float  # accepted a point before it was drawn from
    evaluations: int


def posterior_draws(
    objective: Objective, fit: BandFit, n_draws: int, rng: np.random.Generator
) -> Population:
    """Return draws from the posterior of all unknowns of a band but its arrival times.

    The weights of the data are those of the fit: energies follow Gamma laws of its shapes, all else
    normal laws of its variances, so that the most likely point is the fit's own. Neighbours count
    once, and a misfit flattens the data by phi.

    The law goes from the first to the posterior by powers of their ratio, each as far as leaves
    half of the population [1]_. Moves are walks under the surrogate, and differences of two other
    points [2]_. The first law is the surrogate about the fit for energies, which have one minimum
    (random starts look for others), and the prior for values alone, which may have several.

    References
    ----------
    .. [1] P. Del Moral, A. Doucet, A. Jasra, "Sequential Monte Carlo samplers", J. R. Stat. Soc. B
           68, 411-436 (2006).
    .. [2] C. J. F. ter Braak, "A Markov chain Monte Carlo version of the genetic algorithm
           differential evolution", Stat. Comput. 16, 239-249 (2006).
    """
    law = replace(log_posterior(objective, fit), fixed_weights=fit)
    n = law.n_kept
    approximation = objective.at_points(fit.vector)
    log_p_at = _one_by_one(law) if approximation is None else _all_together(law, approximation, fit)
    near = surrogate(law, fit, windows=fit.variance.size * n * n <= _MOST_CURVATURES)
    size = max((n_draws + 1) // 2, _LEAST_POINTS)
    # gains have no prior to begin with, and energies one minimum; values alone may have several
    from_prior = not bool(objective.is_gamma().any())
    if from_prior:
        size = max(n_draws, 2 * _LEAST_POINTS)
        root = np.linalg.cholesky(np.linalg.inv(near.prior))
        points = near.prior_mean + rng.standard_normal((size, n)) @ root.T
        of_near = _log_prior(near, points)
    else:
        points, of_near = near.walk(np.tile(near.centre, (size, 1)), near.usual_steps[1], rng)
    log_p = log_p_at(points)
    here, rounds = _led_to_posterior(
        log_p_at, near, (points, log_p, of_near), rng, from_prior=from_prior
    )
    drawn: list[FloatArray] = []
    moves: list[float] = []
    while len(drawn) * size < n_draws:
        here, taken, more = _moved(log_p_at, near, here, rng, from_prior=from_prior)
        rounds += more
        moves.append(taken)
        drawn.append(rng.permutation(here[0]))
    kept = rng.permutation(np.concatenate(drawn)[:n_draws])
    return Population(kept, min(moves), size * (1 + rounds))


LogP: TypeAlias = Callable[[FloatArray], FloatArray]
"""From points, shape (n_points, n_kept), to their log densities."""

Points: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]
"""Points, (n_points, n_kept), and their log densities, of the posterior and of the first law."""


def _led_to_posterior(
    log_p_at: LogP, near: Surrogate, here: Points, rng: np.random.Generator, *, from_prior: bool
) -> tuple[Points, int]:
    """Return points led from the first law to the posterior, and how many rounds that took."""
    points, log_p, of_near = here
    power = 0.0
    for rounds in range(_MOST_LEVELS):
        ratio = log_p - of_near
        step = _power_step(ratio, 1.0 - power)
        power += step
        chosen = _resampled(step * ratio, rng)
        points, log_p, of_near = points[chosen], log_p[chosen], of_near[chosen]
        if power >= 1.0 - 1e-9:
            return (points, log_p, of_near), rounds
        if from_prior:
            points, log_p, _ = _differed(log_p_at, points, log_p, rng, (near, power))
            of_near = _log_prior(near, points)
        else:
            here = points, log_p, of_near
            points, log_p, of_near, _ = _walked(log_p_at, near, here, power, rng)
    return (points, log_p, of_near), _MOST_LEVELS


def _moved(
    log_p_at: LogP, near: Surrogate, here: Points, rng: np.random.Generator, *, from_prior: bool
) -> tuple[Points, float, int]:
    """Return points after Metropolis steps, accepted moves a point, and the number of rounds."""
    points, log_p, of_near = here
    moves = 0.0
    for number in range(_MOST_ROUNDS):
        if number % 2 != from_prior:
            points, log_p, taken = _differed(log_p_at, points, log_p, rng)
        else:
            here = points, log_p, of_near
            points, log_p, of_near, taken = _walked(log_p_at, near, here, 1.0, rng)
        moves += taken
        if moves >= _MOVES:
            break
    return (points, log_p, of_near), moves, number + 1


def _one_by_one(law: LogPosterior) -> LogP:
    return lambda points: np.array([law(p) for p in points])


def _all_together(
    law: LogPosterior, approximation: Callable[[FloatArray], FloatArray], fit: BandFit
) -> LogP:
    """Return the same law by data that are approximated at all points together."""
    parameters, measured = law.objective.parameters, law.objective.measured()
    weight = 1.0 / (fit.variance * law.objective.correlation_length() * law.flattening)

    def log_p(points: FloatArray) -> FloatArray:
        inside = np.all(np.abs(points) < FARTHEST_FREE, axis=1)
        walls = [physical_values(parameters, p)[0]["absorption"] for p in points]
        off = measured - approximation(np.array(walls))
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
    log_p_at: LogP, near: Surrogate, here: Points, power: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Move points, with their log densities under both laws, by walks under the surrogate."""
    points, log_p, of_near = here
    there, gain = near.walk(points, int(rng.choice(near.usual_steps)), rng)
    new = log_p_at(there)
    taken = np.log(rng.random(len(points))) < power * (new - log_p - gain)
    return (
        np.where(taken[:, None], there, points),
        np.where(taken, new, log_p),
        np.where(taken, of_near + gain, of_near),
        float(taken.mean()),
    )


def _log_prior(near: Surrogate, points: FloatArray) -> FloatArray:
    away = points - near.prior_mean
    return np.asarray(-0.5 * np.einsum("pi,ij,pj->p", away, near.prior, away))


def _differed(
    log_p_at: LogP,
    points: FloatArray,
    log_p: FloatArray,
    rng: np.random.Generator,
    tempered: tuple[Surrogate, float] | None = None,
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
            near, power = tempered
            by_prior = _log_prior(near, there) - _log_prior(near, points[own])
            more = power * more + (1.0 - power) * by_prior
        better = np.log(rng.random(own.size)) < more
        points[own[better]], log_p[own[better]] = there[better], new[better]
        taken += float(better.sum()) / len(points)
    return points, log_p, taken
