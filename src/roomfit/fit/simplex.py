"""Searches of the unit box after Suh (2001) [1]_: downhill simplex, and annealing with it.

Where equations (2) to (10) are incomplete or unusual, this is done here. Of the simplex:

- After a failed contraction it shrinks to half its size towards its lowest vertex, and an expansion
  is tried where the reflection is the best point so far, as Nelder and Mead [2]_ have it. As
  printed, the expansion is tried only where the reflection has *failed*.
- A point outside the unit box counts as infinitely bad: moved to the wall instead, it would flatten
  the simplex into the wall, out of which no reflection leads.
- The test is (6), the spread of the errors, not the relative one of (7), which only rounding meets
  where the lowest error is 0.

Of annealing, where the paper gives the rule of acceptance and the schedule alone:

- A next state is the current one plus an even random step in every coordinate, mirrored at the
  walls. The largest step grows where more than six trials in ten are accepted and shrinks where
  fewer than four are [3]_; every fifth step may still be as long as half the box.
- The first temperature is the spread of the error over random points unless it is given.
- A simplex starts at the best state of each quarter of the schedule, and the lowest goes on with
  fresh edges until nothing is gained: in many dimensions a simplex loses its shape.

.. [1] J. S. Suh, "In-situ determination of absorption coefficients in a room" (2001).
.. [2] J. A. Nelder, R. Mead, Computer Journal 7, 308-313 (1965).
.. [3] A. Corana et al., ACM Trans. Math. Softw. 13, 262-280 (1987).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from roomfit.base.logit import expit
from roomfit.base.typing import FloatArray
from roomfit.model.parameters import Parameters, to_free
from roomfit.solver import Ending, Minimum, ResidualFunction, Solver

ErrorFunction: TypeAlias = Callable[[FloatArray], float]
"""Error of one point of the unit box, shape (n,); lower is better."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Where a search ended."""

    x: FloatArray  # (n,), best point found, within the unit box
    cost: float  # error there
    evaluations: int  # how often the error was computed
    ending: Ending
    # (n_visited, n), the lowest vertex of every simplex, or the state at the end of a temperature
    trail: FloatArray


class _Counted:
    """An error function that counts its calls and is infinite outside the unit box."""

    def __init__(self, error: ErrorFunction) -> None:
        self._error = error
        self.evaluations = 0

    def __call__(self, x: FloatArray) -> float:
        if x.min() < 0.0 or x.max() > 1.0:
            return np.inf
        self.evaluations += 1
        return float(self._error(x))


def downhill_simplex(
    error: ErrorFunction,
    start: FloatArray,
    *,
    tolerance: float = 1e-6,
    max_evaluations: int = 20_000,
) -> Fit:
    """Move a simplex downhill until its vertices agree.

    From `start` (n + 1, n), within the unit box and not in one plane; `tolerance` is tau of test
    (6).
    """
    counted = _Counted(error)
    vertices, errors = _lowest_first(np.array(start), np.array([counted(v) for v in start]))
    trail = [vertices[0].copy()]
    while True:
        # the centroid distinguishes a small simplex from one that lies evenly across a minimum
        at_centroid = counted(vertices[:-1].mean(axis=0))
        if np.sqrt(np.mean((errors - at_centroid) ** 2)) <= tolerance:  # (6)
            ending = Ending.CONVERGED
        # below, the error no longer changes by more than its own rounding
        elif np.ptp(vertices, axis=0).max() <= 1e-11:
            ending = Ending.COLLAPSED
        elif counted.evaluations >= max_evaluations:
            ending = Ending.OUT_OF_EVALUATIONS
        else:
            vertices, errors = moved_downhill(vertices, errors, counted)
            trail.append(vertices[0].copy())
            continue
        return Fit(vertices[0], float(errors[0]), counted.evaluations, ending, np.array(trail))


def _lowest_first(vertices: FloatArray, errors: FloatArray) -> tuple[FloatArray, FloatArray]:
    order = np.argsort(errors, kind="stable")
    return vertices[order], errors[order]


def moved_downhill(
    vertices: FloatArray, errors: FloatArray, error: ErrorFunction
) -> tuple[FloatArray, FloatArray]:
    """Return a simplex, lowest vertex first, with its highest replaced, or shrunk."""
    centroid = vertices[:-1].mean(axis=0)  # (2)
    away = centroid - vertices[-1]
    x = centroid + away  # (3) with alpha = 1
    e = error(x)
    if e < errors[0]:
        beyond = centroid + 2.0 * away  # (4) with gamma = 2
        e_beyond = error(beyond)
        if e_beyond < e:
            x, e = beyond, e_beyond
    elif e >= errors[-2]:
        if e >= errors[-1]:
            x, e = vertices[-1], errors[-1]
        within = centroid + 0.5 * (x - centroid)  # (5) with beta = 0.5
        e_within = error(within)
        if e_within < e:
            x, e = within, e_within
        else:
            rest = np.concatenate((vertices[1:-1], x[None]))
            rest = vertices[0] + 0.5 * (rest - vertices[0])
            each = np.array([errors[0], *(error(v) for v in rest)])
            return _lowest_first(np.concatenate((vertices[:1], rest)), each)
    return _lowest_first(np.concatenate((vertices[:-1], x[None])), np.append(errors[:-1], e))


def simplex_around(x: FloatArray, size: float) -> FloatArray:
    """Return a simplex at `x` with n edges of `size` towards the farther walls, (n + 1, n)."""
    edges = np.diag(np.where(x <= 0.5, size, -size))
    return np.concatenate((x[None, :], x + edges))


def random_simplex(n: int, rng: np.random.Generator) -> FloatArray:
    """Return a simplex with edges of 0.3 at a point drawn evenly from the unit box, (n + 1, n)."""
    return simplex_around(rng.random(n), 0.3)


_SMALLEST_STEP, _LARGEST_STEP = 1e-3, 0.5
_EDGE = 0.1


def accepts(change: float, temperature: float, rng: np.random.Generator) -> bool:
    """Return whether a step that changes the error by `change` is taken, by equation (10).

    ``T log(random) < -(E_n - E_c)``: always where the error falls, and with probability
    ``exp(-change / T)`` where it rises.
    """
    # 1 - random lies in (0, 1], whose logarithm is finite
    return temperature * math.log(1.0 - rng.random()) < -change


def anneal(
    error: ErrorFunction,
    n: int,
    rng: np.random.Generator,
    *,
    start_temperature: float | None = None,
    cooling: float = 0.9,
    levels: int = 60,
    trials_per_unknown: int = 10,
) -> Fit:
    """Walk the unit box while it cools, then go downhill from the best points met.

    By `levels` temperatures, each `cooling` times the one before; `start_temperature` None takes
    the spread of the error over random points. The trail: states at the end of each temperature,
    then those of the simplexes.
    """
    counted = _Counted(error)
    samples = rng.random((10 * n, n))
    errors = np.array([counted(x) for x in samples])
    temperature = start_temperature or max(float(np.std(errors)), np.finfo(float).tiny)
    start = int(np.argmin(errors))
    x, e, step = samples[start], float(errors[start]), _LARGEST_STEP
    trail: list[FloatArray] = []
    lowest: list[tuple[float, FloatArray]] = []  # met at each temperature
    for _ in range(levels):
        steps = rng.uniform(-step, step, (trials_per_unknown * n, n))
        steps[::5] *= _LARGEST_STEP / step
        best, accepted = (e, x), 0
        for own in steps:
            # at most half a box outside, folded back through the wall it left
            next_x = np.asarray(1.0 - np.abs(1.0 - np.abs(x + own)))
            next_e = counted(next_x)
            if accepts(next_e - e, temperature, rng):
                x, e, accepted = next_x, next_e, accepted + 1
                best = (e, x) if e < best[0] else best
        trail.append(x)
        lowest.append(best)
        if accepted > 0.6 * len(steps):
            step = min(1.5 * step, _LARGEST_STEP)
        elif accepted < 0.4 * len(steps):
            step = max(step / 1.5, _SMALLEST_STEP)
        temperature *= cooling
    bounds = np.linspace(0, levels, 5).round().astype(int)
    quarters = [lowest[a:b] for a, b in itertools.pairwise(bounds) if b > a]
    starts = [min(quarter, key=lambda met: met[0])[1] for quarter in quarters]
    fits = _polished(error, starts)
    end = min(fits, key=lambda fit: fit.cost)
    evaluations = counted.evaluations + sum(fit.evaluations for fit in fits)
    return Fit(
        end.x, end.cost, evaluations, end.ending, np.concatenate([trail, *(f.trail for f in fits)])
    )


def _polished(error: ErrorFunction, starts: Sequence[FloatArray]) -> list[Fit]:
    """Descend from every start, and from the lowest end again until that gains nothing more."""
    fits = [downhill_simplex(error, simplex_around(x, _EDGE)) for x in starts]
    edge = _EDGE
    for _ in range(10):
        last = min(fits, key=lambda fit: fit.cost)
        edge *= 0.5
        fits.append(downhill_simplex(error, simplex_around(last.x, edge)))
        # less is no gain, as for a simplex by itself
        if last.cost - fits[-1].cost <= 1e-6:
            break
    return fits


# Gains are searched within a factor of e^3, 13 dB, either side of where total energies agree.
_LOG_REACH = 3.0


def unit_box_solver(parameters: Parameters, method: str, rng: np.random.Generator) -> Solver:
    """Return a solver over absorption itself and log gains; `method`: "simplex" or "annealing"."""

    def solve(residuals: ResidualFunction, start: FloatArray) -> Minimum:
        if not start.size:
            return Minimum(start, 0.0, 0, Ending.CONVERGED)

        def error(point: FloatArray) -> float:
            r, _ = residuals(_from_unit(parameters, point))
            return float(r @ r)

        at = _to_unit(parameters, start)
        if method == "simplex":
            found = downhill_simplex(error, simplex_around(at, _EDGE))
        else:
            found = anneal(error, at.size, rng)
        x = _from_unit(parameters, found.x)
        return Minimum(x, 0.5 * found.cost, found.evaluations, found.ending)

    return solve


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
            parts.append(expit(free))
        else:
            middle = to_free(block, block.start)[block.fitted]
            parts.append(np.clip(0.5 + 0.5 * (free - middle) / _LOG_REACH, 0.0, 1.0))
    return np.concatenate(parts)
