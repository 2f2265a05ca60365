"""The results of Suh (2001) on the reconstructed room: Figures 2 to 5, Table 2 and its searches.

Beside them a proof for every problem: how low its error can be, and where.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from roomfit.base.arguments import check_range
from roomfit.base.forks import in_forks
from roomfit.base.typing import FloatArray, Progress
from roomfit.fit.simplex import anneal, downhill_simplex, random_simplex
from roomfit.paper.proof import Certificate, certify
from roomfit.paper.room import (
    CASES,
    COMPARED_ABOVE,
    DIVISIONS,
    SPECIFICATIONS,
    TABLE2,
    TRUE_ABSORPTION,
    SquaresProblem,
    arrivals_ms,
    division_rows,
    error,
    paper_problem,
    paper_scene,
    trace_paper_room,
    true_absorption,
    whole_windows_s,
    window_energies,
)
from roomfit.tracing.paths import Paths

METHODS = ("simplex", "annealing")
# Largest error of any absorption that still counts as found.
FOUND_WITHIN = 0.005
GRID = np.arange(21) / 20  # of absorptions, the paper's
FINE_GRID = np.linspace(0.0, 1.0, 201)


@dataclass(frozen=True, slots=True, eq=False)
class CaseResponse:
    """Energy responses of one case at the true absorption (Figures 2 and 3)."""

    name: str
    direct_ms: int  # 1 ms bin of arrival
    first_reflection_ms: int
    fine: FloatArray  # (200,), energy of each 1 ms bin from emission on, in the paper's unit
    edges_s: FloatArray  # (n_windows + 1,)
    windows: FloatArray  # (n_windows,), energy of each 5 ms window from the first reflection on


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
    """The results of `roomfit paper`."""

    seeds: int
    responses: tuple[CaseResponse, ...]
    table2: FloatArray  # (n_rows,), our errors in the rows of `TABLE2`, after the common factor
    common_factor: float  # near 1, for the unit of energy was found in the same way
    # by name, of the problems of two materials (Figures 4 and 5): the error on the paper's grid,
    # (21, 21), first absorption along the first axis
    grids: Mapping[str, FloatArray]
    ill_defined_fine: FloatArray  # (201, 201): the error of Figure 5, on a grid ten times finer
    searches: tuple[Searches, ...]
    certificates: Mapping[str, Certificate]  # by name, of every problem


def repeat_paper(seeds: int, *, progress: Progress | None = None) -> PaperResult:
    """Return the results of the paper.

    Every search depends on its problem, its method and its seed alone.

    `seeds`: searches of every problem by every method, 1 to 100,000.
    """
    check_range("number of seeds", seeds, 1, 100_000)
    shapes = sorted({s.shape for s in SPECIFICATIONS.values()})
    paths = {shape: trace_paper_room(paper_scene(shape)) for shape in shapes}
    problems = {n: paper_problem(n, paths[s.shape]) for n, s in SPECIFICATIONS.items()}
    searched = [(name, method) for method in reversed(METHODS) for name in problems]

    def found(i: int) -> Searches:
        if progress is not None:
            progress(i / len(searched))
        name, method = searched[i]
        return _searches(problems[name], name, method, seeds)

    errors, factor = table2(problems["case1"])
    return PaperResult(
        seeds,
        case_responses(paths["paper"]),
        errors,
        factor,
        {n: grid_errors(p, GRID) for n, p in problems.items() if len(p.rows.materials) == 2},
        grid_errors(problems["ill_defined"], FINE_GRID),
        tuple(in_forks(found, range(len(searched)))),
        {name: certify(problem) for name, problem in problems.items()},
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


def table2(problem: SquaresProblem) -> tuple[FloatArray, float]:
    """Return the errors of case 1 in the rows of Table 2 after one common factor, and the factor.

    It is the one of least squared relative difference over the rows that count.
    """
    ours = np.array([error(problem, row[:2]) for row in TABLE2])
    counts = TABLE2[:, 2] > COMPARED_ABOVE
    ratio = ours[counts] / TABLE2[counts, 2]
    factor = float(np.sum(ratio) / np.sum(ratio**2))
    return factor * ours, factor


def largest_relative_error(errors: FloatArray) -> float:
    """Return by how much the rows of Table 2 that count differ from ours at most, relative."""
    counts = TABLE2[:, 2] > COMPARED_ABOVE
    return float(np.max(np.abs(errors[counts] / TABLE2[counts, 2] - 1.0)))


def grid_errors(problem: SquaresProblem, grid: FloatArray) -> FloatArray:
    """Return the error on a square grid, the first absorption along the first axis."""
    return np.array([[error(problem, np.array([a, b])) for b in grid] for a in grid])


def grid_minima(errors: FloatArray, grid: FloatArray = GRID) -> FloatArray:
    """Return the points of a grid that lie below their four neighbours, lowest first, (n, 2).

    They need not be minima of the function: where a narrow valley runs askew to the grid, points
    next to it alternate between its floor and its flanks.
    """
    walled = np.pad(errors, 1, constant_values=np.inf)
    others = (walled[2:, 1:-1], walled[:-2, 1:-1], walled[1:-1, 2:], walled[1:-1, :-2])
    at = np.argwhere(errors < np.min(others, axis=0))
    order = np.argsort(errors[at[:, 0], at[:, 1]], kind="stable")
    return np.asarray(grid[at[order]])


def _searches(problem: SquaresProblem, name: str, method: str, seeds: int) -> Searches:
    of_point, truth = partial(error, problem), true_absorption(name)
    fits = []
    for rng in map(np.random.default_rng, range(seeds)):
        if method == "annealing":
            fits.append(anneal(of_point, truth.size, rng))
        else:
            fits.append(downhill_simplex(of_point, random_simplex(truth.size, rng)))
    off = np.array([np.max(np.abs(fit.x - truth)) for fit in fits])
    evaluations = float(np.median([fit.evaluations for fit in fits]))
    return Searches(name, method, int(np.sum(off <= FOUND_WITHIN)), float(off.max()), evaluations)
