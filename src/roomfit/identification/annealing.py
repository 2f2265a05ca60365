"""Simulated annealing combined with the downhill simplex, after Suh (2001), (8) to (10).

The paper gives the rule of acceptance and the schedule (a start of, for example, 1e6, times 0.9)
and leaves open how the two methods are combined, how a next state is proposed, how many trials a
temperature gets and where the schedule ends. The choices here:

- A next state is the current one plus an even random step in every coordinate, mirrored at the
  walls of the box. The largest step grows where more than six trials in ten are accepted and
  shrinks where fewer than four are (Corana et al. 1987), so that it follows the temperature;
  every fifth step may still be as long as half the box, for a walk of short steps alone never
  leaves a valley before it has cooled.
- Each temperature gets a fixed number of trials for every unknown.
- The start temperature is the spread of the error over random points unless it is given: 1e6 is
  only right for errors of about that size.
- The walk finds valleys and the simplex their bottoms: a simplex starts at the best state of each
  quarter of the schedule (a cold walk may have settled in the wrong one of two valleys that it
  crossed while warm), and the lowest goes on with fresh edges from its own answer until that gains
  nothing more. (A simplex that has lost its shape stops short in more than four or five
  dimensions; fresh edges cure that.)

References
----------
.. [1] N. Metropolis et al., "Equation of state calculations by fast computing machines", J. Chem.
       Phys. 21, 1087-1092 (1953).
.. [2] A. Corana et al., "Minimizing multimodal functions of continuous variables with the
       'simulated annealing' algorithm", ACM Trans. Math. Softw. 13, 262-280 (1987).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from roomfit.errors import InputError
from roomfit.identification.fit import Counted, ErrorFunction, Fit, best_of
from roomfit.identification.simplex import SimplexSettings, downhill_simplex, simplex_around
from roomfit.typing import FloatArray, Progress

_SMALLEST_STEP, _LARGEST_STEP = 1e-3, 0.5
_LONG_EVERY = 5
_EDGE = 0.1


@dataclass(frozen=True, slots=True)
class AnnealingSettings:
    """Schedule of temperatures, and the simplex that follows.

    Attributes
    ----------
    start_temperature : float or None
        In the unit of the error; None takes the spread of the error over random points.
    cooling : float
        Factor from one temperature to the next.
    levels : int
        How many temperatures.
    trials_per_unknown : int
        Trials at each temperature for every unknown.
    simplex : SimplexSettings
    max_restarts : int
        How often the simplex may start again from its own answer.
    """

    start_temperature: float | None = None
    cooling: float = 0.9
    levels: int = 60
    trials_per_unknown: int = 10
    simplex: SimplexSettings = field(default_factory=SimplexSettings)
    max_restarts: int = 10

    def __post_init__(self) -> None:
        ranges = (
            ("start_temperature", self.start_temperature is None or self.start_temperature > 0.0),
            ("cooling", 0.0 < self.cooling < 1.0),
            ("levels", self.levels >= 1),
            ("trials_per_unknown", self.trials_per_unknown >= 1),
            ("max_restarts", self.max_restarts >= 0),
        )
        for name, holds in ranges:
            if not holds:
                raise InputError(
                    "annealing setting is out of range",
                    where=name,
                    found=f"{getattr(self, name):g}",
                    needed="a factor between 0 and 1" if name == "cooling" else "a positive number",
                )


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
    settings: AnnealingSettings | None = None,
    *,
    progress: Progress | None = None,
) -> Fit:
    """Walk the unit box while it cools, then go downhill from the best point met.

    Parameters
    ----------
    error : callable
        Takes a point of the unit box, shape (n,).
    n : int
        Number of unknowns.
    rng : numpy.random.Generator
    settings : AnnealingSettings, optional

    Returns
    -------
    Fit
        The trail holds the state at the end of each temperature, then the simplexes' own trails.
    """
    settings = AnnealingSettings() if settings is None else settings
    counted = Counted(error)
    walk = _walk(counted, n, rng, settings, progress)
    polished = _polish(error, _lowest_of_quarters(walk), settings)
    if progress is not None:
        progress(1.0)
    return Fit(
        polished.x,
        polished.cost,
        counted.evaluations + polished.evaluations,
        settings.levels * settings.trials_per_unknown * n + polished.iterations,
        polished.ending,
        np.concatenate(([level.x for level in walk], polished.trail)),
        np.concatenate(([level.error for level in walk], polished.trail_cost)),
    )


class _Level(NamedTuple):
    """State at the end of a temperature, the lowest met there, and the share of accepted trials."""

    x: FloatArray
    error: float
    lowest_x: FloatArray
    lowest_error: float
    accepted: float


def _walk(
    error: Counted,
    n: int,
    rng: np.random.Generator,
    settings: AnnealingSettings,
    progress: Progress | None,
) -> list[_Level]:
    samples = rng.random((10 * n, n))
    errors = np.array([error(x) for x in samples])
    temperature = settings.start_temperature or max(float(np.std(errors)), np.finfo(float).tiny)
    start = int(np.argmin(errors))
    x, e, step = samples[start], float(errors[start]), _LARGEST_STEP
    levels: list[_Level] = []
    for number in range(settings.levels):
        proposals = rng.uniform(-step, step, (settings.trials_per_unknown * n, n))
        proposals[::_LONG_EVERY] *= _LARGEST_STEP / step
        level = _walk_at(error, x, e, temperature, proposals, rng)
        levels.append(level)
        x, e = level.x, level.error
        step = _next_step(step, level.accepted)
        temperature *= settings.cooling
        if progress is not None:
            progress((number + 1) / (settings.levels + 1))
    return levels


def _walk_at(
    error: Counted,
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
        next_x = _mirrored(x + proposal)
        next_e = error(next_x)
        if accepts(next_e - e, temperature, rng):
            x, e = next_x, next_e
            accepted += 1
            if e < lowest:
                lowest_x, lowest = x, e
    return _Level(x, e, lowest_x, lowest, accepted / len(proposals))


def _lowest_of_quarters(walk: list[_Level]) -> list[FloatArray]:
    """Return the lowest state of each quarter of the schedule."""
    bounds = np.linspace(0, len(walk), 5).round().astype(int)
    quarters = [walk[a:b] for a, b in itertools.pairwise(bounds) if b > a]
    return [min(quarter, key=lambda level: level.lowest_error).lowest_x for quarter in quarters]


def _polish(error: ErrorFunction, starts: list[FloatArray], settings: AnnealingSettings) -> Fit:
    """Descend from every start, and from the lowest end again until that gains nothing more."""
    fits = [downhill_simplex(error, simplex_around(x, _EDGE), settings.simplex) for x in starts]
    edge = _EDGE
    for _ in range(settings.max_restarts):
        last = best_of(fits)
        edge *= 0.5
        again = downhill_simplex(error, simplex_around(last.x, edge), settings.simplex)
        fits.append(again)
        if last.cost - again.cost <= settings.simplex.tolerance:
            break
    return best_of(fits)


def _mirrored(x: FloatArray) -> FloatArray:
    """Fold a point at most half a box outside back through the wall it left."""
    return np.asarray(1.0 - np.abs(1.0 - np.abs(x)))


def _next_step(step: float, accepted: float) -> float:
    if accepted > 0.6:
        step *= 1.5
    elif accepted < 0.4:
        step /= 1.5
    return min(max(step, _SMALLEST_STEP), _LARGEST_STEP)
