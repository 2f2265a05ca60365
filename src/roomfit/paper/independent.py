"""The paper's problem with other rays for the measurement than for the model.

The paper makes "measurement" and model with the same rays, so that the error is exactly 0 at the
truth, however few the rays. A measurement in a real room has nothing to do with the model's rays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

import numpy as np

from roomfit.base.typing import FloatArray
from roomfit.model.weighing import EnergyRows
from roomfit.paper.room import (
    CASES,
    DIVISIONS,
    PRINTED_ARRIVALS_MS,
    Division,
    division_rows,
    joined_rows,
    paper_scene,
    residuals,
    squares_problem,
    trace_paper_room,
    uniform_absorption,
    whole_windows_s,
    window_energies,
)
from roomfit.paper.searches import fit_least_squares, starts
from roomfit.tracing.paths import Paths

# One pair is case 3, the only one off the room's plane of symmetry.
PAIRS: Mapping[int, tuple[int, ...]] = MappingProxyType({1: (2,), 3: (0, 1, 2)})
_RANDOM_STARTS = 3
# Seeds of measurement and model never meet.
_MODEL_SEED = 100_000

MEASUREMENT_RAYS = 262_144  # of each part of the measurement
MEASUREMENT_PARTS = 4  # independent traces whose mean is the measurement
# Of the model, for each source; and models with other rays, for each number.
MODEL_RAYS = (1_000, 3_000, 10_000, 18_000, 30_000, 100_000, 300_000)
REPEATS = 8

Key = tuple[int, int]
"""Number of materials, number of pairs."""

OtherRays = dict[Key, tuple[int, FloatArray]]
"""How many paths a model recorded within the windows; found minus true absorption of materials."""


@dataclass(frozen=True, slots=True)
class IndependentRow:
    """All repeats of one number of rays, materials and pairs."""

    rays: int
    materials: int
    pairs: int
    repeats: int
    median_paths: float
    rms_error: float  # of an absorption, over materials and repeats
    median_largest_error: float  # of the largest among the materials, over repeats
    worst_error: float


def measurement_part(n_rays: int, seed: int) -> dict[Key, FloatArray]:
    """Return the window energies at the true absorption from rays of one seed."""
    paths = trace_paper_room(paper_scene(), n_rays, "sobol", seed)
    return {
        (materials, pairs): window_energies(
            _rows(paths, division, pairs), np.array(division.true_absorption)
        )
        for materials, division in DIVISIONS.items()
        for pairs in PAIRS
    }


def mean_measurement(parts: Sequence[dict[Key, FloatArray]]) -> dict[Key, FloatArray]:
    """Return the mean of independent measurements of equal numbers of rays."""
    return {key: np.mean([part[key] for part in parts], axis=0) for key in parts[0]}


def fit_with_other_rays(n_rays: int, repeat: int, measurement: dict[Key, FloatArray]) -> OtherRays:
    """Return the fits of all divisions and pairs by one model of its own rays."""
    paths = trace_paper_room(paper_scene(), n_rays, "sobol", _MODEL_SEED + repeat)
    rng = np.random.default_rng((n_rays, repeat))
    fits = {}
    for (materials, pairs), measured in measurement.items():
        division = DIVISIONS[materials]
        rows = _rows(paths, division, pairs)
        problem, windows_s = squares_problem(rows, measured), _windows_s(PAIRS[pairs][0])
        uniform = uniform_absorption(problem.measured[: windows_s.size - 1], windows_s)
        points = starts(uniform, len(problem.rows.materials), _RANDOM_STARTS, rng)
        found = fit_least_squares(partial(residuals, problem), points).x
        off = found - np.array(division.true_absorption)
        fits[materials, pairs] = len(rows), off
    return fits


def summarise(rays: int, fits: Sequence[OtherRays]) -> list[IndependentRow]:
    """Return one row for every number of materials and pairs, of all repeats of so many rays."""
    rows = []
    for materials, pairs in fits[0]:
        paths, errors = zip(*(fit[materials, pairs] for fit in fits), strict=True)
        off = np.array(errors)
        largest = np.max(np.abs(off), axis=1)
        rows.append(
            IndependentRow(
                rays=rays,
                materials=materials,
                pairs=pairs,
                repeats=len(fits),
                median_paths=float(np.median(paths)),
                rms_error=float(np.sqrt(np.mean(off**2))),
                median_largest_error=float(np.median(largest)),
                worst_error=float(np.max(largest)),
            )
        )
    return rows


def _rows(paths: Paths, division: Division, pairs: int) -> EnergyRows:
    return joined_rows(
        [division_rows(paths, case, _windows_s(case), division) for case in PAIRS[pairs]]
    )


def _windows_s(case: int) -> FloatArray:
    # the printed arrival, not the trace's own: of few rays the first reflection arrives late
    return whole_windows_s(PRINTED_ARRIVALS_MS[CASES[case]][1], 5)
