"""Every result of Suh (2001) on the reconstructed room, and what the paper left open.

Figures 2 to 5 and Table 2; every search of its problems over many seeds, and how often it finds the
true absorption; a certificate for every problem: where its error can be lowest, and how low; and
the same with other rays for the measurement than for the model.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from roomfit.base.arguments import int_array
from roomfit.base.typing import FloatArray, Progress, part
from roomfit.base.workers import in_pool, worker_pool
from roomfit.paper.certificate import certify
from roomfit.paper.certificate_record import Certificate
from roomfit.paper.global_search import SearchSettings
from roomfit.paper.independent import (
    MEASUREMENT_PARTS,
    MEASUREMENT_RAYS,
    MODEL_RAYS,
    REPEATS,
    IndependentRow,
    fit_with_other_rays,
    mean_measurement,
    measurement_part,
    summarise,
)
from roomfit.paper.question import GlobalProblem
from roomfit.paper.room import (
    CASES,
    COMPARED_ABOVE,
    DIVISIONS,
    SPECIFICATIONS,
    TABLE2,
    TRUE_ABSORPTION,
    PaperProblem,
    SquaresProblem,
    arrivals_ms,
    division_rows,
    error,
    exchanged_walls,
    paper_problem,
    paper_scene,
    residuals,
    trace_paper_room,
    walls_apart_problem,
    whole_windows_s,
    window_energies,
)
from roomfit.paper.search import Fit, SimplexSettings, anneal, downhill_simplex, random_simplex
from roomfit.paper.searches import (
    Landscape,
    Minima,
    fit_least_squares,
    grid_errors,
    landscape,
    minima_of_descents,
    starts,
    unit_grid,
)
from roomfit.tracing.paths import Paths

_WALLS_APART_STARTS = 60


@dataclass(frozen=True, slots=True, eq=False)
class CaseResponse:
    """Energy responses of one case at the true absorption (Figures 2 and 3)."""

    name: str
    direct_ms: int  # 1 ms bin of arrival
    first_reflection_ms: int
    fine: FloatArray  # (200,), energy of each 1 ms bin from emission on, in the paper's unit
    edges_s: FloatArray  # (n_windows + 1,)
    windows: FloatArray  # (n_windows,), energy of each 5 ms window from the first reflection on


@dataclass(frozen=True, slots=True, eq=False)
class Table2:
    """Errors of the paper beside ours, row by row."""

    absorption: FloatArray  # (n_rows, 2)
    paper: FloatArray  # (n_rows,)
    ours: FloatArray  # (n_rows,), after the common factor
    common_factor: float  # near 1, for the unit of energy was found in the same way
    max_relative_error: float  # over the rows whose error in the paper is above 10


def case_responses(paths: Paths) -> tuple[CaseResponse, ...]:
    """Return Figures 2 and 3 as numbers."""
    found = []
    for case, name in enumerate(CASES):
        direct_ms, first_reflection_ms = arrivals_ms(paths, case)
        edges_s = whole_windows_s(first_reflection_ms, 5)
        fine, windows = (
            window_energies(
                division_rows(paths, case, edges, DIVISIONS[2]), np.array(TRUE_ABSORPTION)
            )
            for edges in (whole_windows_s(0, 1), edges_s)
        )
        found.append(CaseResponse(name, direct_ms, first_reflection_ms, fine, edges_s, windows))
    return tuple(found)


def table2(problem: PaperProblem) -> Table2:
    """Return Table 2 beside the errors of case 1, after one common factor.

    The factor is the one of least squared relative difference over the rows that count.
    """
    paper = TABLE2[:, 2]
    ours = np.array([error(problem.squares, row[:2]) for row in TABLE2])
    counts = paper > COMPARED_ABOVE
    ratio = ours[counts] / paper[counts]
    factor = float(np.sum(ratio) / np.sum(ratio**2))
    return Table2(
        TABLE2[:, :2],
        paper,
        factor * ours,
        factor,
        float(np.max(np.abs(factor * ratio - 1.0))),
    )


def problem_landscape(problem: PaperProblem) -> Landscape:
    """Return grid and minima of a problem of two materials."""
    return landscape(partial(error, problem.squares), partial(residuals, problem.squares))


def problems_of(paths: dict[str, Paths]) -> dict[str, PaperProblem]:
    """Return all named problems, ready to be solved."""
    return {
        name: paper_problem(name, paths[wanted.shape]) for name, wanted in SPECIFICATIONS.items()
    }


def walls_apart(exact: PaperProblem, rng: np.random.Generator) -> Minima:
    """Return the answers to case 1 with its side walls taken apart, from random descents."""
    starts = rng.random((_WALLS_APART_STARTS, exact.true_absorption.size))
    return minima_of_descents(partial(residuals, exact.squares), starts)


# Largest error of any absorption that still counts as found.
FOUND_WITHIN = 0.005
_RANDOM_STARTS = 5
# Least squares tries no further start once the error is so small a part of the measured energy
# squared: only data made by the model itself come so near.
_EXACT = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One search."""

    found: FloatArray  # (n_materials,)
    evaluations: int
    seconds: float  # wall-clock time


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """All searches of one problem by one method."""

    problem: str
    method: str
    true_absorption: FloatArray  # (n_materials,)
    worst_found: FloatArray  # (n_materials,), of the seed with the largest error
    largest_error: float  # of any absorption
    successes: int  # within `FOUND_WITHIN`
    seeds: int
    median_evaluations: float
    median_seconds: float


def _annealing_and_simplex(problem: PaperProblem, rng: np.random.Generator) -> Fit:
    return anneal(partial(error, problem.squares), problem.true_absorption.size, rng)


def _simplex(
    problem: PaperProblem, rng: np.random.Generator, settings: SimplexSettings | None = None
) -> Fit:
    first = random_simplex(problem.true_absorption.size, rng)
    return downhill_simplex(partial(error, problem.squares), first, settings)


def _least_squares(problem: PaperProblem, rng: np.random.Generator) -> Fit:
    return fit_least_squares(
        partial(residuals, problem.squares),
        starts(problem.uniform_start, problem.true_absorption.size, _RANDOM_STARTS, rng),
        good_enough=_EXACT * float(problem.squares.measured @ problem.squares.measured),
    )


def _least_squares_once(problem: PaperProblem, rng: np.random.Generator) -> Fit:
    start = rng.random((1, problem.true_absorption.size))
    return fit_least_squares(partial(residuals, problem.squares), start)


class Method(NamedTuple):
    """A search, and what figures and tables call it."""

    search: Callable[[PaperProblem, np.random.Generator], Fit]
    label: str
    heading: str  # at most 13 characters


METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "annealing+simplex": Method(_annealing_and_simplex, "annealing + simplex", "annealing"),
        "simplex": Method(_simplex, "simplex", "simplex"),
        "simplex-as-printed": Method(
            partial(_simplex, settings=SimplexSettings(order="as-printed")),
            "simplex, order as printed",
            "as printed",
        ),
        "least-squares": Method(_least_squares, "least squares", "least squares"),
        "least-squares-one-random-start": Method(
            _least_squares_once, "least squares, one random start", "one start"
        ),
    }
)


def searches_of_table2(problem: PaperProblem) -> dict[str, Fit]:
    """Return the trail of each method through case 1, from the first points of Table 2.

    The simplexes start with the first three points of the table as vertices, least squares with
    the first one; annealing starts where seed 0 says.
    """
    first = TABLE2[:3, :2]
    in_order = partial(downhill_simplex, partial(error, problem.squares), first)
    return {
        "annealing+simplex": _annealing_and_simplex(problem, np.random.default_rng(0)),
        "simplex": in_order(),
        "simplex-as-printed": in_order(SimplexSettings(order="as-printed")),
        "least-squares": fit_least_squares(partial(residuals, problem.squares), first[:1]),
    }


def search_seeds(problem: PaperProblem, method: str, seeds: range) -> tuple[Run, ...]:
    """Return one run for each seed."""
    runs = []
    for seed in seeds:
        started_s = time.perf_counter()
        fit = METHODS[method].search(problem, np.random.default_rng(seed))
        runs.append(Run(fit.x, fit.evaluations, time.perf_counter() - started_s))
    return tuple(runs)


def record(problem: PaperProblem, method: str, runs: Sequence[Run]) -> Record:
    """Return the summary of all runs of a method on a problem."""
    off = np.array([np.max(np.abs(run.found - problem.true_absorption)) for run in runs])
    worst = int(np.argmax(off))
    return Record(
        problem.name,
        method,
        problem.true_absorption,
        runs[worst].found,
        float(off[worst]),
        int(np.count_nonzero(off <= FOUND_WITHIN)),
        len(runs),
        float(np.median([run.evaluations for run in runs])),
        float(np.median([run.seconds for run in runs])),
    )


def squares_global_problem(problem: SquaresProblem) -> GlobalProblem:
    """Return equation (1) over all absorptions, for a certificate.

    Raises
    ------
    InputError
        See `GlobalProblem`.
    """
    rows = problem.rows
    n = len(rows.materials)
    return GlobalProblem(
        rows.materials,
        np.ones(n, dtype=np.bool_),
        rows.offsets,
        rows.weight_per_m2,
        rows.hits,
        problem.measured,
        np.ones(rows.n_windows),
        np.full(n, -math.inf),
        np.zeros(n),
        np.zeros((n, 4)),
    )


# In the paper's unit of energy squared, where black walls err by hundreds: with the model's own
# rays the error is 0 at the truth.
DELTA = 1e-8
_MAX_SECONDS = 120.0


_SEEDS_PER_TASK = 10
_FINE = 201


@dataclass(frozen=True, slots=True, eq=False)
class PaperResult:
    """Everything that `roomfit paper` finds."""

    seeds: int
    responses: tuple[CaseResponse, ...]
    table2: Table2
    landscapes: Mapping[str, Landscape]  # by name, of the problems of two materials
    ill_defined_fine: FloatArray  # (201, 201): the error of Figure 5, on a grid ten times finer
    case1_searches: Mapping[str, Fit]  # by method, one search each from the start of Table 2
    records: tuple[Record, ...]
    walls_apart: Minima  # of case 1 with four separate walls, its mirror symmetry made exact
    # Of the mirrored truth with the 18,000 rays as traced, whose own slight asymmetry is all the
    # evidence against it
    mirrored_error_of_trace: float
    error_of_silence: float  # sum of the squared measured energies, to compare with
    certificates: Mapping[str, Certificate]  # by name, of every problem and of "walls_apart"
    independent: tuple[IndependentRow, ...]


def repeat_paper(seeds: int, workers: int, *, progress: Progress | None = None) -> PaperResult:
    """Return all results of the paper and the two studies that go beyond it.

    Every search depends on its problem, its method and its seed alone, so that the result is the
    same for any number of workers, but for the seconds.

    Parameters
    ----------
    seeds : int
        Searches of every problem by every method, 1 to 100,000. Of other rays as many, 8 at most.
    workers : int
        Processes; 1 stays in this one.
    """
    int_array("number of seeds", np.array(seeds), (), low=1, high=100_000)
    rooms = sorted({s.shape for s in SPECIFICATIONS.values()})
    paths: dict[str, Paths] = {room: trace_paper_room(paper_scene(room)) for room in rooms}
    problems = problems_of(paths)
    with worker_pool(workers) as pool:
        independent = _independent(pool, min(seeds, REPEATS), part(progress, 0.0, 0.4))
        flat = {n: p for n, p in problems.items() if p.true_absorption.size == 2}
        shapes = [partial(problem_landscape, problem) for problem in flat.values()]
        found = in_pool(pool, shapes, part(progress, 0.4, 0.45))
        records = _records(pool, seeds, problems, part(progress, 0.45, 0.95))
    exact, as_traced = (
        walls_apart_problem(paths["paper"], mirrored=mirrored) for mirrored in (True, False)
    )
    certificates, last = {}, part(progress, 0.95, 1.0)
    for name, problem in {**problems, "walls_apart": exact}.items():
        certified = squares_global_problem(problem.squares)
        certificates[name] = certify(certified, SearchSettings(DELTA, max_seconds=_MAX_SECONDS))
        if last is not None:
            last(len(certificates) / (len(problems) + 1))
    exchanged = exact.true_absorption[exchanged_walls(exact.squares.rows.materials)]
    return PaperResult(
        seeds,
        case_responses(paths["paper"]),
        table2(problems["case1"]),
        dict(zip(flat, found, strict=True)),
        grid_errors(partial(error, problems["ill_defined"].squares), unit_grid(_FINE)),
        searches_of_table2(problems["case1"]),
        records,
        walls_apart(exact, np.random.default_rng(0)),
        error(as_traced.squares, exchanged),
        float(exact.squares.measured @ exact.squares.measured),
        certificates,
        independent,
    )


def _independent(
    pool: Executor, sets: int, progress: Progress | None
) -> tuple[IndependentRow, ...]:
    every = [partial(measurement_part, MEASUREMENT_RAYS, i) for i in range(MEASUREMENT_PARTS)]
    parts = in_pool(pool, every, part(progress, 0.0, 0.25))
    measurement = mean_measurement(parts)
    # the longest first, so that no worker is left with one at the end
    numbers = sorted(MODEL_RAYS, reverse=True)
    tasks = [partial(fit_with_other_rays, n, i, measurement) for n in numbers for i in range(sets)]
    fits = iter(in_pool(pool, tasks, part(progress, 0.25, 1.0)))
    rows = [row for n in numbers for row in summarise(n, [next(fits) for _ in range(sets)])]
    return tuple(sorted(rows, key=lambda row: (row.pairs, row.materials, row.rays)))


def _records(
    pool: Executor, seeds: int, problems: Mapping[str, PaperProblem], progress: Progress | None
) -> tuple[Record, ...]:
    chunks = [
        range(first, min(first + _SEEDS_PER_TASK, seeds))
        for first in range(0, seeds, _SEEDS_PER_TASK)
    ]
    searched = [(problem, method) for problem in problems.values() for method in METHODS]
    tasks = [
        partial(search_seeds, problem, method, chunk)
        for problem, method in searched
        for chunk in chunks
    ]
    runs = iter(in_pool(pool, tasks, progress))
    return tuple(
        record(problem, method, [run for _ in chunks for run in next(runs)])
        for problem, method in searched
    )
