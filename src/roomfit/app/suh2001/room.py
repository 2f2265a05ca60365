"""Figures 2 to 5 and Table 2 of Suh (2001), on the reconstructed room."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from roomfit.identification.landscape import Landscape, Minima, landscape, minima_of_descents
from roomfit.objective.squares import error, residuals, window_energies
from roomfit.testproblems.paper_problems import (
    SPECIFICATIONS,
    PaperProblem,
    division_rows,
    exchanged_walls,
    paper_problem,
    walls_apart_problem,
)
from roomfit.testproblems.paper_room import (
    CASES,
    DIVISIONS,
    TRUE_ABSORPTION,
    arrivals_ms,
    paper_edges_s,
    paper_scene,
    response_edges_s,
    trace_paper_room,
)
from roomfit.testproblems.paper_table2 import COMPARED_ABOVE, TABLE2
from roomfit.tracing.paths import Paths
from roomfit.typing import FloatArray

_WALLS_APART_STARTS = 60


@dataclass(frozen=True, slots=True, eq=False)
class CaseResponse:
    """Energy responses of one case at the true absorption (Figures 2 and 3).

    Attributes
    ----------
    name : str
    direct_ms, first_reflection_ms : int
        1 ms bins of arrival.
    fine : float array, shape (200,)
        Energy of each 1 ms bin from emission on, in the paper's unit.
    edges_s : float array, shape (n_windows + 1,)
    windows : float array, shape (n_windows,)
        Energy of each 5 ms window from the first reflection on.
    """

    name: str
    direct_ms: int
    first_reflection_ms: int
    fine: FloatArray
    edges_s: FloatArray
    windows: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Table2:
    """Errors of the paper beside ours, row by row.

    Attributes
    ----------
    absorption : float array, shape (n_rows, 2)
    paper, ours : float arrays, shape (n_rows,)
        Ours after the common factor.
    common_factor : float
        What ours was multiplied by; near 1, for the unit of energy was found in the same way.
    max_relative_error : float
        Over the rows whose error in the paper is above 10.
    """

    absorption: FloatArray
    paper: FloatArray
    ours: FloatArray
    common_factor: float
    max_relative_error: float


@dataclass(frozen=True, slots=True, eq=False)
class WallsApart:
    """Case 1 with four separate walls: what answers there are, and how well each explains.

    Attributes
    ----------
    materials : tuple of str
    truth : float array, shape (n_materials,)
    answers : Minima
        With the room's mirror symmetry made exact.
    mirrored_error_of_trace : float
        Error of the mirrored truth with the 18,000 rays as traced, whose own slight asymmetry is
        all that speaks against it.
    error_of_silence : float
        Sum of the squared measured energies, to compare with.
    """

    materials: tuple[str, ...]
    truth: FloatArray
    answers: Minima
    mirrored_error_of_trace: float
    error_of_silence: float


def paper_paths() -> dict[str, Paths]:
    """Return the 18,000 rays of each shape of the room."""
    shapes = {s.shape for s in SPECIFICATIONS.values()}
    return {shape: trace_paper_room(paper_scene(shape)) for shape in sorted(shapes)}


def case_responses(paths: Paths) -> tuple[CaseResponse, ...]:
    """Return Figures 2 and 3 as numbers."""
    return tuple(_case_response(paths, case, name) for case, name in enumerate(CASES))


def _case_response(paths: Paths, case: int, name: str) -> CaseResponse:
    truth = np.array(TRUE_ABSORPTION)
    direct_ms, first_reflection_ms = arrivals_ms(paths, case)
    edges_s = paper_edges_s(first_reflection_ms)
    fine = division_rows(paths, case, response_edges_s(), DIVISIONS[2])
    windows = division_rows(paths, case, edges_s, DIVISIONS[2])
    return CaseResponse(
        name,
        direct_ms,
        first_reflection_ms,
        window_energies(fine, truth),
        edges_s,
        window_energies(windows, truth),
    )


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


def walls_apart(paths: Paths, rng: np.random.Generator) -> WallsApart:
    """Return the answers to case 1 with its side walls taken apart, from random descents."""
    exact = walls_apart_problem(paths, mirrored=True)
    as_traced = walls_apart_problem(paths, mirrored=False)
    materials = exact.squares.rows.materials
    starts = rng.random((_WALLS_APART_STARTS, exact.truth.size))
    return WallsApart(
        materials,
        exact.truth,
        minima_of_descents(partial(residuals, exact.squares), starts),
        error(as_traced.squares, exact.truth[exchanged_walls(materials)]),
        float(exact.squares.measured @ exact.squares.measured),
    )
