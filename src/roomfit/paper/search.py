"""Searches of the unit box after Suh (2001): downhill simplex, and simulated annealing with it.

Where that text, equations (2) to (10), is incomplete or unusual, this is what is done here. Of the
simplex:

- A failed contraction: the paper is silent. The simplex shrinks to half its size towards its lowest
  vertex, as Nelder and Mead (1965) have it.
- The order of operations: as printed, every reflection below the highest vertex is taken, and the
  expansion is tried only where the reflection has *failed*, which doubles a step in a direction
  that has just proved wrong. As Nelder and Mead have it, an expansion is tried where the reflection
  is the best point so far, a contraction where it is no better than the second highest.
- Bounds: a point outside the unit box counts as infinitely bad and is not evaluated. Moving it to
  the wall instead would flatten the simplex into the wall, out of which no reflection leads.
- The test is (6), the spread of the errors. The relative difference of test (7) is not taken: where
  the lowest error is 0, as with data made by the model itself, only rounding meets it. A simplex
  too small for further change in any coordinate ends the search as well.

Of annealing, where the paper gives the rule of acceptance and the schedule alone:

- A next state is the current one plus an even random step in every coordinate, mirrored at the
  walls of the box. The largest step grows where more than six trials in ten are accepted and
  shrinks where fewer than four are (Corana et al. 1987); every fifth step may still be as long as
  half the box, for a walk of short steps alone never leaves a valley before it has cooled.
- Each temperature gets a fixed number of trials for every unknown. The first temperature is the
  spread of the error over random points unless it is given: 1e6 is only right for errors of about
  that size.
- The walk finds valleys and the simplex their bottoms: a simplex starts at the best state of each
  quarter of the schedule, since a cold walk may have ended in the wrong valley of two, and the
  lowest goes on with fresh edges from its own answer until nothing is gained. (A simplex that has
  lost its shape stops short in more than four or five dimensions; fresh edges cure that.)

References
----------
.. [1] J. S. Suh, "In-situ determination of absorption coefficients in a room" (2001).
.. [2] J. A. Nelder, R. Mead, "A simplex method for function minimization", Computer Journal 7,
       308-313 (1965).
.. [3] N. Metropolis et al., "Equation of state calculations by fast computing machines", J. Chem.
       Phys. 21, 1087-1092 (1953).
.. [4] A. Corana et al., "Minimizing multimodal functions of continuous variables with the
       'simulated annealing' algorithm", ACM Trans. Math. Softw. 13, 262-280 (1987).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

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


# alpha, gamma and beta of equations (3) to (5), and the factor after a failed contraction
_REFLECTION, _EXPANSION, _CONTRACTION, _SHRINKAGE = 1.0, 2.0, 0.5, 0.5
# Below this extent the error no longer changes by more than its own rounding.
_COLLAPSED = 1e-11


@dataclass(slots=True)
class Simplex:
    """The vertices and their errors, lowest first; the state of a search."""

    vertices: FloatArray  # (n + 1, n)
    errors: FloatArray  # (n + 1,)

    def sort(self) -> None:
        """Bring the lowest vertex to the front and the highest to the end."""
        order = np.argsort(self.errors, kind="stable")
        self.vertices, self.errors = self.vertices[order], self.errors[order]

    def replace_highest(self, x: FloatArray, error: float) -> None:
        """Replace the highest vertex by a new one."""
        self.vertices[-1], self.errors[-1] = x, error


def downhill_simplex(
    error: ErrorFunction,
    start: FloatArray,
    *,
    tolerance: float = 1e-6,
    max_evaluations: int = 20_000,
) -> Fit:
    """Move a simplex downhill until its vertices agree.

    Parameters
    ----------
    error : callable
        Takes a point of the unit box, shape (n,).
    start : float array, shape (n + 1, n)
        Vertices of the first simplex, within the unit box, not all in one plane.
    tolerance : float
        tau of test (6), in the unit of the error.
    """
    counted = _Counted(error)
    state = Simplex(np.array(start), np.array([counted(v) for v in start]))
    state.sort()
    trail = [state.vertices[0].copy()]
    while (ending := _ending(state, counted, tolerance, max_evaluations)) is None:
        move_once(state, counted)
        trail.append(state.vertices[0].copy())
    lowest, cost = state.vertices[0], float(state.errors[0])
    return Fit(lowest, cost, counted.evaluations, ending, np.array(trail))


def move_once(state: Simplex, error: ErrorFunction) -> None:
    """Replace the highest vertex of a sorted simplex by a lower point, or shrink; sort again."""
    centroid = state.vertices[:-1].mean(axis=0)  # (2)
    away = centroid - state.vertices[-1]
    x_r = centroid + _REFLECTION * away  # (3)
    e_r = error(x_r)
    if e_r < state.errors[0]:
        x_e = centroid + _EXPANSION * away  # (4)
        e_e = error(x_e)
        state.replace_highest(*((x_e, e_e) if e_e < e_r else (x_r, e_r)))
    elif e_r < state.errors[-2]:
        state.replace_highest(x_r, e_r)
    else:
        if e_r < state.errors[-1]:
            state.replace_highest(x_r, e_r)
        _contract(state, error, centroid)
    state.sort()


def _contract(state: Simplex, error: ErrorFunction, centroid: FloatArray) -> None:
    x_c = centroid + _CONTRACTION * (state.vertices[-1] - centroid)  # (5)
    e_c = error(x_c)
    if e_c < state.errors[-1]:
        state.replace_highest(x_c, e_c)
        return
    lowest = state.vertices[0]
    state.vertices[1:] = lowest + _SHRINKAGE * (state.vertices[1:] - lowest)
    state.errors[1:] = [error(v) for v in state.vertices[1:]]


def spread(state: Simplex, error: ErrorFunction) -> float:
    """Return the left side of equation (6): rms difference from the error at the centroid.

    The centroid distinguishes a small simplex from one that lies evenly across a minimum.
    """
    at_centroid = error(state.vertices[:-1].mean(axis=0))
    return float(np.sqrt(np.mean((state.errors - at_centroid) ** 2)))


def _ending(state: Simplex, counted: _Counted, tolerance: float, most: int) -> Ending | None:
    if spread(state, counted) <= tolerance:
        return Ending.CONVERGED
    if np.ptp(state.vertices, axis=0).max() <= _COLLAPSED:
        return Ending.COLLAPSED
    if counted.evaluations >= most:
        return Ending.OUT_OF_EVALUATIONS
    return None


def simplex_around(x: FloatArray, size: float) -> FloatArray:
    """Return a simplex with one vertex at `x` and its n edges along the axes.

    Parameters
    ----------
    x : float array, shape (n,)
        Within the unit box.
    size : float
        Length of each edge, at most 0.5; the edge points to the farther wall.

    The result has the shape (n + 1, n).
    """
    edges = np.diag(np.where(x <= 0.5, size, -size))
    return np.concatenate((x[None, :], x + edges))


def random_simplex(n: int, rng: np.random.Generator) -> FloatArray:
    """Return a simplex with edges of 0.3 at a point drawn evenly from the unit box, (n + 1, n)."""
    return simplex_around(rng.random(n), 0.3)


_SMALLEST_STEP, _LARGEST_STEP = 1e-3, 0.5
_LONG_EVERY = 5
_EDGE = 0.1
_MOST_RESTARTS = 10  # of the simplex, from its own answer
_ENOUGH = 1e-6  # less is no gain, as for a simplex by itself


def accepts(change: float, temperature: float, rng: np.random.Generator) -> bool:
    """Return whether a step that changes the error by `change` is taken, by equation (10).

    ``T log(random) < -(E_n - E_c)``: always where the error falls, and with probability
    ``exp(-change / T)`` where it rises.
    """
    # 1 - random lies in (0, 1], whose logarithm is finite
    return temperature * math.log(1.0 - rng.random()) < -change


class _Level(NamedTuple):
    """State at the end of a temperature, the lowest met there, and the share of accepted trials."""

    x: FloatArray
    error: float
    lowest_x: FloatArray
    lowest_error: float
    accepted: float


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
    """Walk the unit box while it cools, then go downhill from the best point met.

    Parameters
    ----------
    error : callable
        Takes a point of the unit box, shape (n,).
    n : int
        Number of unknowns.
    start_temperature : float, optional
        In the unit of the error; None takes the spread of the error over random points.
    cooling : float
        Factor from one temperature to the next.
    levels : int
        How many temperatures.
    trials_per_unknown : int
        Trials at each temperature for every unknown.

    Returns
    -------
    Fit
        The trail: states at the end of each temperature, then the simplexes' own trails.
    """
    counted = _Counted(error)
    samples = rng.random((10 * n, n))
    errors = np.array([counted(x) for x in samples])
    temperature = start_temperature or max(float(np.std(errors)), np.finfo(float).tiny)
    start = int(np.argmin(errors))
    x, e, step = samples[start], float(errors[start]), _LARGEST_STEP
    walk: list[_Level] = []
    for _ in range(levels):
        proposals = rng.uniform(-step, step, (trials_per_unknown * n, n))
        proposals[::_LONG_EVERY] *= _LARGEST_STEP / step
        walk.append(_walk_at(counted, x, e, temperature, proposals, rng))
        x, e, _, _, accepted = walk[-1]
        if accepted > 0.6:
            step = min(1.5 * step, _LARGEST_STEP)
        elif accepted < 0.4:
            step = max(step / 1.5, _SMALLEST_STEP)
        temperature *= cooling
    # from the lowest state of each quarter of the schedule
    bounds = np.linspace(0, levels, 5).round().astype(int)
    quarters = (walk[a:b] for a, b in itertools.pairwise(bounds) if b > a)
    starts = [min(quarter, key=lambda level: level.lowest_error).lowest_x for quarter in quarters]
    polished = _polish(error, starts)
    return Fit(
        polished.x,
        polished.cost,
        counted.evaluations + polished.evaluations,
        polished.ending,
        np.concatenate(([level.x for level in walk], polished.trail)),
    )


def _walk_at(
    error: _Counted,
    x: FloatArray,
    e: float,
    temperature: float,
    proposals: FloatArray,
    rng: np.random.Generator,
) -> _Level:
    """Walk at one temperature; `proposals` are the steps to try, shape (n_trials, n)."""
    lowest_x, lowest = x, e
    accepted = 0
    for proposal in proposals:
        # at most half a box outside, folded back through the wall it left
        next_x = np.asarray(1.0 - np.abs(1.0 - np.abs(x + proposal)))
        next_e = error(next_x)
        if accepts(next_e - e, temperature, rng):
            x, e = next_x, next_e
            accepted += 1
            if e < lowest:
                lowest_x, lowest = x, e
    return _Level(x, e, lowest_x, lowest, accepted / len(proposals))


def _polish(error: ErrorFunction, starts: Sequence[FloatArray]) -> Fit:
    """Descend from every start, and from the lowest end again until that gains nothing more."""
    fits = [downhill_simplex(error, simplex_around(x, _EDGE)) for x in starts]
    edge = _EDGE
    for _ in range(_MOST_RESTARTS):
        last = min(fits, key=lambda fit: fit.cost)
        edge *= 0.5
        fits.append(downhill_simplex(error, simplex_around(last.x, edge)))
        if last.cost - fits[-1].cost <= _ENOUGH:
            break
    best = min(fits, key=lambda fit: fit.cost)
    trail = np.concatenate([fit.trail for fit in fits])
    return Fit(best.x, best.cost, sum(fit.evaluations for fit in fits), best.ending, trail)


# Gains are searched within a factor of e^3, 13 dB, either side of where total energies agree.
_LOG_REACH = 3.0
_FIRST_EDGE = 0.1


def simplex_solver(parameters: Parameters) -> Solver:
    """Return the paper's downhill simplex, over absorption itself and log gains."""
    return _unit_box_solver(
        parameters, lambda error, x: downhill_simplex(error, simplex_around(x, _FIRST_EDGE))
    )


def annealing_solver(parameters: Parameters, rng: np.random.Generator) -> Solver:
    """Return the paper's simulated annealing with its simplex, over absorption and log gains."""
    return _unit_box_solver(parameters, lambda error, x: anneal(error, x.size, rng))


def _unit_box_solver(
    parameters: Parameters, search: Callable[[Callable[[FloatArray], float], FloatArray], Fit]
) -> Solver:
    """Return a solver that searches the sum of squares over the unit box."""

    def solve(residuals: ResidualFunction, start: FloatArray) -> Minimum:
        if not start.size:
            return Minimum(start, 0.0, 0, Ending.CONVERGED)

        def error(point: FloatArray) -> float:
            r, _ = residuals(_from_unit(parameters, point))
            return float(r @ r)

        found = search(error, _to_unit(parameters, start))
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
