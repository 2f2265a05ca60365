"""The results of Suh (2001) on the reconstructed room: Figures 2 to 5, Table 2 and its searches.

Beside them a proof for every problem: how low its error can be, and where.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from roomfit.base.arguments import int_array
from roomfit.base.forks import in_forks
from roomfit.base.typing import FloatArray, Progress
from roomfit.paper.certificate import Certificate, certify
from roomfit.paper.room import (
    CASES,
    COMPARED_ABOVE,
    DIVISIONS,
    SPECIFICATIONS,
    TABLE2,
    TRUE_ABSORPTION,
    PaperProblem,
    arrivals_ms,
    division_rows,
    error,
    paper_problem,
    paper_scene,
    trace_paper_room,
    whole_windows_s,
    window_energies,
)
from roomfit.paper.search import anneal, downhill_simplex, random_simplex
from roomfit.tracing.paths import Paths

METHODS = ("simplex", "annealing")
# Largest error of any absorption that still counts as found.
FOUND_WITHIN = 0.005
_FINE = 201


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


@dataclass(frozen=True, slots=True, eq=False)
class Landscape:
    """The error of a problem of two materials on the paper's grid (Figures 4 and 5)."""

    grid: FloatArray  # (21,)
    errors: FloatArray  # (21, 21), first absorption along the first axis
    minima: FloatArray  # (n, 2), points of the grid below their four neighbours, lowest first


@dataclass(frozen=True, slots=True)
class Searches:
    """All searches of one problem by one method."""

    problem: str
    method: str
    found: int  # how many came within `FOUND_WITHIN` of every absorption
    largest_error: float  # of any absorption
    median_evaluations: float


@dataclass(frozen=True, slots=True, eq=False)
class PaperResult:
    """What `roomfit paper` finds."""

    seeds: int
    responses: tuple[CaseResponse, ...]
    table2: Table2
    landscapes: Mapping[str, Landscape]  # by name, of the problems of two materials
    ill_defined_fine: FloatArray  # (201, 201): the error of Figure 5, on a grid ten times finer
    searches: tuple[Searches, ...]
    certificates: Mapping[str, Certificate]  # by name, of every problem


def repeat_paper(seeds: int, *, progress: Progress | None = None) -> PaperResult:
    """Return the results of the paper.

    Every search depends on its problem, its method and its seed alone.

    Parameters
    ----------
    seeds : int
        Searches of every problem by every method, 1 to 100,000.
    """
    int_array("number of seeds", np.array(seeds), (), low=1, high=100_000)
    shapes = sorted({s.shape for s in SPECIFICATIONS.values()})
    paths = {shape: trace_paper_room(paper_scene(shape)) for shape in shapes}
    problems = {n: paper_problem(n, paths[s.shape]) for n, s in SPECIFICATIONS.items()}
    searched = [(p, method) for method in reversed(METHODS) for p in problems.values()]

    def found(i: int) -> Searches:
        if progress is not None:
            progress(i / len(searched))
        return _searches(*searched[i], seeds)

    flat = {n: p for n, p in problems.items() if p.true_absorption.size == 2}
    return PaperResult(
        seeds,
        case_responses(paths["paper"]),
        table2(problems["case1"]),
        {name: landscape(problem) for name, problem in flat.items()},
        grid_errors(problems["ill_defined"], np.linspace(0.0, 1.0, _FINE)),
        tuple(in_forks(found, range(len(searched)))),
        {name: certify(problem.squares) for name, problem in problems.items()},
    )


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
    largest = float(np.max(np.abs(factor * ratio - 1.0)))
    return Table2(TABLE2[:, :2], paper, factor * ours, factor, largest)


def landscape(problem: PaperProblem) -> Landscape:
    """Return the error of a problem of two materials on the paper's grid of steps of 0.05."""
    grid = np.arange(21) / 20
    errors = grid_errors(problem, grid)
    return Landscape(grid, errors, grid_minima(errors, grid))


def grid_errors(problem: PaperProblem, grid: FloatArray) -> FloatArray:
    """Return the error on a square grid, the first absorption along the first axis."""
    return np.array([[error(problem.squares, np.array([a, b])) for b in grid] for a in grid])


def grid_minima(errors: FloatArray, grid: FloatArray) -> FloatArray:
    """Return the points of a grid that lie below their four neighbours, lowest first.

    They need not be minima of the function: where a narrow valley runs askew to the grid, points
    next to it alternate between its floor and its flanks.
    """
    walled = np.pad(errors, 1, constant_values=np.inf)
    others = (walled[2:, 1:-1], walled[:-2, 1:-1], walled[1:-1, 2:], walled[1:-1, :-2])
    at = np.argwhere(errors < np.min(others, axis=0))
    order = np.argsort(errors[at[:, 0], at[:, 1]], kind="stable")
    return np.asarray(grid[at[order]])


def _searches(problem: PaperProblem, method: str, seeds: int) -> Searches:
    of_point, n = partial(error, problem.squares), problem.true_absorption.size
    fits = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        if method == "annealing":
            fits.append(anneal(of_point, n, rng))
        else:
            fits.append(downhill_simplex(of_point, random_simplex(n, rng)))
    off = np.array([np.max(np.abs(fit.x - problem.true_absorption)) for fit in fits])
    return Searches(
        problem.name,
        method,
        int(np.count_nonzero(off <= FOUND_WITHIN)),
        float(off.max()),
        float(np.median([fit.evaluations for fit in fits])),
    )
