"""Every search of the paper's problems over many seeds, and how often it finds the truth."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

import numpy as np

from roomfit.identification.annealing import anneal
from roomfit.identification.fit import Fit
from roomfit.identification.least_squares import fit_least_squares
from roomfit.identification.simplex import SimplexSettings, downhill_simplex, random_simplex
from roomfit.identification.start import starts
from roomfit.objective.squares import error, residuals
from roomfit.testproblems.paper_problems import PaperProblem
from roomfit.testproblems.paper_table2 import TABLE2
from roomfit.typing import FloatArray

# Largest error of any absorption that still counts as found.
FOUND_WITHIN = 0.005
_RANDOM_STARTS = 5
# Least squares tries no further start once the error is so small a part of the measured energy
# squared: only data made by the model itself come so near.
_EXACT = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One search.

    Attributes
    ----------
    found : float array, shape (n_materials,)
    evaluations : int
    seconds : float
        Wall-clock time.
    """

    found: FloatArray
    evaluations: int
    seconds: float


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """All searches of one problem by one method.

    Attributes
    ----------
    problem, method : str
    truth : float array, shape (n_materials,)
    worst_found : float array, shape (n_materials,)
        Of the seed with the largest error in any absorption.
    largest_error : float
        That error.
    successes, seeds : int
    median_evaluations, median_seconds : float
    """

    problem: str
    method: str
    truth: FloatArray
    worst_found: FloatArray
    largest_error: float
    successes: int
    seeds: int
    median_evaluations: float
    median_seconds: float


def _annealing_and_simplex(problem: PaperProblem, rng: np.random.Generator) -> Fit:
    return anneal(partial(error, problem.squares), problem.truth.size, rng)


def _simplex(problem: PaperProblem, rng: np.random.Generator) -> Fit:
    first = random_simplex(problem.truth.size, rng)
    return downhill_simplex(partial(error, problem.squares), first)


def _simplex_as_printed(problem: PaperProblem, rng: np.random.Generator) -> Fit:
    first = random_simplex(problem.truth.size, rng)
    settings = SimplexSettings(order="as-printed")
    return downhill_simplex(partial(error, problem.squares), first, settings)


def _least_squares(problem: PaperProblem, rng: np.random.Generator) -> Fit:
    return fit_least_squares(
        partial(residuals, problem.squares),
        starts(problem.uniform_start, problem.truth.size, _RANDOM_STARTS, rng),
        good_enough=_EXACT * float(problem.squares.measured @ problem.squares.measured),
    )


def _least_squares_once(problem: PaperProblem, rng: np.random.Generator) -> Fit:
    start = rng.random((1, problem.truth.size))
    return fit_least_squares(partial(residuals, problem.squares), start)


METHODS: Mapping[str, Callable[[PaperProblem, np.random.Generator], Fit]] = MappingProxyType(
    {
        "annealing+simplex": _annealing_and_simplex,
        "simplex": _simplex,
        "simplex-as-printed": _simplex_as_printed,
        "least-squares": _least_squares,
        "least-squares-one-random-start": _least_squares_once,
    }
)


LABELS: Mapping[str, str] = MappingProxyType(
    {
        "annealing+simplex": "annealing + simplex",
        "simplex": "simplex",
        "simplex-as-printed": "simplex, order as printed",
        "least-squares": "least squares",
        "least-squares-one-random-start": "least squares, one random start",
    }
)


def searches_of_table2(problem: PaperProblem, seed: int = 0) -> dict[str, Fit]:
    """Return the way of each method through case 1, from where Table 2 of the paper begins.

    The simplexes start with the first three points of the table as vertices, least squares with
    the first one; annealing starts where its seed says.
    """
    first = TABLE2[:3, :2]
    in_order = partial(downhill_simplex, partial(error, problem.squares), first)
    return {
        "annealing+simplex": _annealing_and_simplex(problem, np.random.default_rng(seed)),
        "simplex": in_order(),
        "simplex-as-printed": in_order(SimplexSettings(order="as-printed")),
        "least-squares": fit_least_squares(partial(residuals, problem.squares), first[:1]),
    }


def search_seeds(problem: PaperProblem, method: str, seeds: range) -> tuple[Run, ...]:
    """Return one run for each seed."""
    return tuple(_timed(problem, method, seed) for seed in seeds)


def _timed(problem: PaperProblem, method: str, seed: int) -> Run:
    begun = time.perf_counter()
    fit = METHODS[method](problem, np.random.default_rng(seed))
    return Run(fit.x, fit.evaluations, time.perf_counter() - begun)


def record(problem: PaperProblem, method: str, runs: Sequence[Run]) -> Record:
    """Return the summary of all runs of a method on a problem."""
    off = np.array([np.max(np.abs(run.found - problem.truth)) for run in runs])
    worst = int(np.argmax(off))
    return Record(
        problem.name,
        method,
        problem.truth,
        runs[worst].found,
        float(off[worst]),
        int(np.count_nonzero(off <= FOUND_WITHIN)),
        len(runs),
        float(np.median([run.evaluations for run in runs])),
        float(np.median([run.seconds for run in runs])),
    )
