"""Repeat every result of Suh (2001) on the reconstructed room, and what the paper left open."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from roomfit.app.progress import part
from roomfit.app.suh2001.certified import certificates_of
from roomfit.app.suh2001.independent import (
    IndependentFit,
    IndependentRow,
    IndependentSettings,
    fit_with_other_rays,
    mean_measurement,
    measurement_part,
    summarise,
)
from roomfit.app.suh2001.room import (
    CaseResponse,
    Table2,
    WallsApart,
    case_responses,
    paper_paths,
    problem_landscape,
    problems_of,
    table2,
    walls_apart,
)
from roomfit.app.suh2001.searches import METHODS, Record, record, search_seeds, searches_of_table2
from roomfit.app.workers import in_pool, worker_pool
from roomfit.checks import int_array
from roomfit.identification.certified.certificate import Certificate
from roomfit.identification.fit import Fit
from roomfit.identification.landscape import Landscape, grid_errors, unit_grid
from roomfit.objective.squares import error
from roomfit.testproblems.paper_problems import PaperProblem, walls_apart_problem
from roomfit.typing import FloatArray, Progress

_SEEDS_PER_TASK = 10
_FINE = 201


@dataclass(frozen=True, slots=True)
class PaperSettings:
    """How much of it to do.

    Attributes
    ----------
    seeds : int
        Searches of every problem by every method.
    workers : int
        Processes; 1 stays in this one.
    independent : IndependentSettings
    """

    seeds: int = 50
    workers: int = 2
    independent: IndependentSettings = field(default_factory=IndependentSettings)

    def __post_init__(self) -> None:
        int_array("number of seeds", np.array(self.seeds), (), low=1, high=100_000)


@dataclass(frozen=True, slots=True, eq=False)
class PaperResult:
    """Everything that `roomfit paper` found out.

    Attributes
    ----------
    seeds : int
    responses : tuple of CaseResponse
    table2 : Table2
    landscapes : mapping of problem name to Landscape
        Problems of two materials.
    ill_defined_fine : float array, shape (201, 201)
        The error function of Figure 5 on a grid ten times finer, to show its valley.
    case1_searches : mapping of method to Fit
        One search of case 1 by each method, from where Table 2 begins.
    records : tuple of Record
    walls_apart : WallsApart
    certificates : mapping of problem name to Certificate
        Of every problem, and of "walls_apart".
    independent_settings : IndependentSettings
    independent : tuple of IndependentRow
    """

    seeds: int
    responses: tuple[CaseResponse, ...]
    table2: Table2
    landscapes: Mapping[str, Landscape]
    ill_defined_fine: FloatArray
    case1_searches: Mapping[str, Fit]
    records: tuple[Record, ...]
    walls_apart: WallsApart
    certificates: Mapping[str, Certificate]
    independent_settings: IndependentSettings
    independent: tuple[IndependentRow, ...]


def repeat_paper(
    settings: PaperSettings | None = None, *, progress: Progress | None = None
) -> PaperResult:
    """Return all results of the paper and the two studies that go beyond it.

    Every search depends on its problem, its method and its seed alone, so that the result is the
    same for any number of workers, but for the seconds.
    """
    settings = PaperSettings() if settings is None else settings
    paths = paper_paths()
    problems = problems_of(paths)
    with worker_pool(settings.workers) as pool:
        fits = _independent(pool, settings.independent, part(progress, 0.0, 0.4))
        landscapes = _landscapes(pool, problems, part(progress, 0.4, 0.45))
        records = _records(pool, settings.seeds, problems, part(progress, 0.45, 0.95))
    mirrored = walls_apart_problem(paths["paper"], mirrored=True)
    certificates = certificates_of(problems, mirrored, part(progress, 0.95, 1.0))
    return PaperResult(
        settings.seeds,
        case_responses(paths["paper"]),
        table2(problems["case1"]),
        landscapes,
        grid_errors(partial(error, problems["ill_defined"].squares), unit_grid(_FINE)),
        searches_of_table2(problems["case1"]),
        records,
        walls_apart(paths["paper"], np.random.default_rng(0)),
        certificates,
        settings.independent,
        summarise(fits),
    )


def _independent(
    pool: Executor, wanted: IndependentSettings, progress: Progress | None
) -> list[IndependentFit]:
    parts = in_pool(
        pool,
        [
            partial(measurement_part, wanted.measurement_rays, seed)
            for seed in range(wanted.measurement_parts)
        ],
        part(progress, 0.0, 0.25),
    )
    measurement = mean_measurement(parts)
    tasks = [
        partial(fit_with_other_rays, rays, repeat, measurement)
        # the longest first, so that no worker is left with one at the end
        for rays in sorted(wanted.model_rays, reverse=True)
        for repeat in range(wanted.repeats)
    ]
    return [fit for fits in in_pool(pool, tasks, part(progress, 0.25, 1.0)) for fit in fits]


def _landscapes(
    pool: Executor, problems: Mapping[str, PaperProblem], progress: Progress | None
) -> dict[str, Landscape]:
    flat = [problem for problem in problems.values() if problem.truth.size == 2]
    found = in_pool(pool, [partial(problem_landscape, problem) for problem in flat], progress)
    return {problem.name: shape for problem, shape in zip(flat, found, strict=True)}


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
