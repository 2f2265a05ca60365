"""The paper's problem with other rays for the measurement than for the model.

The paper makes "measurement" and model with the same rays, so that the error is exactly 0 at the
truth, however few the rays. A real room does not know the model's rays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

import numpy as np

from roomfit.response.energy import EnergyRows
from roomfit.suh2001.room import (
    CASES,
    DIVISIONS,
    PRINTED_ARRIVALS_MS,
    Division,
    SquaresProblem,
    division_rows,
    joined_rows,
    paper_edges_s,
    paper_scene,
    residuals,
    squares_problem,
    trace_paper_room,
    uniform_absorption,
    window_energies,
)
from roomfit.suh2001.searches import fit_least_squares, starts
from roomfit.tracing.paths import Paths
from roomfit.typing import FloatArray

# One pair is case 3, the only one off the room's plane of symmetry.
PAIRS: Mapping[int, tuple[int, ...]] = MappingProxyType({1: (2,), 3: (0, 1, 2)})
_RANDOM_STARTS = 3
# Seeds of measurement and model never meet.
_MODEL_SEED = 100_000

Key = tuple[int, int]
"""Number of materials, number of pairs."""


@dataclass(frozen=True, slots=True)
class IndependentSettings:
    """How much is traced.

    Attributes
    ----------
    measurement_rays : int
        Rays of each part of the measurement.
    measurement_parts : int
        Independent traces whose mean is the measurement.
    model_rays : tuple of int
        Numbers of rays of the model, for each source.
    repeats : int
        Models with other rays, for each number.
    """

    measurement_rays: int = 262_144
    measurement_parts: int = 4
    model_rays: tuple[int, ...] = (1_000, 3_000, 10_000, 18_000, 30_000, 100_000, 300_000)
    repeats: int = 8


@dataclass(frozen=True, slots=True, eq=False)
class IndependentFit:
    """One fit with other rays than the measurement's.

    Attributes
    ----------
    rays, materials, pairs : int
    paths : int
        How many paths the model recorded within the windows.
    off : float array, shape (n_materials,)
        Found minus true absorption.
    """

    rays: int
    materials: int
    pairs: int
    paths: int
    off: FloatArray


@dataclass(frozen=True, slots=True)
class IndependentRow:
    """All repeats of one number of rays, materials and pairs.

    Attributes
    ----------
    rays, materials, pairs, repeats : int
    median_paths : float
    rms_error : float
        Root mean square error of an absorption, over materials and repeats.
    median_largest_error, worst_error : float
        Of the largest error among the materials: its median and its maximum over repeats.
    """

    rays: int
    materials: int
    pairs: int
    repeats: int
    median_paths: float
    rms_error: float
    median_largest_error: float
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


def fit_with_other_rays(
    n_rays: int, repeat: int, measurement: dict[Key, FloatArray]
) -> tuple[IndependentFit, ...]:
    """Return the fits of all divisions and pairs by one model of its own rays."""
    paths = trace_paper_room(paper_scene(), n_rays, "sobol", _MODEL_SEED + repeat)
    rng = np.random.default_rng((n_rays, repeat))
    fits = []
    for (materials, pairs), measured in measurement.items():
        division = DIVISIONS[materials]
        rows = _rows(paths, division, pairs)
        found = _fit(squares_problem(rows, measured), pairs, rng)
        fits.append(
            IndependentFit(
                n_rays, materials, pairs, len(rows), found - np.array(division.true_absorption)
            )
        )
    return tuple(fits)


def summarise(fits: Sequence[IndependentFit]) -> tuple[IndependentRow, ...]:
    """Return one row for every number of pairs, materials and rays."""
    keys = sorted({(fit.pairs, fit.materials, fit.rays) for fit in fits})
    return tuple(_row([f for f in fits if (f.pairs, f.materials, f.rays) == key]) for key in keys)


def _row(fits: Sequence[IndependentFit]) -> IndependentRow:
    off = np.array([fit.off for fit in fits])
    largest = np.max(np.abs(off), axis=1)
    return IndependentRow(
        fits[0].rays,
        fits[0].materials,
        fits[0].pairs,
        len(fits),
        float(np.median([fit.paths for fit in fits])),
        float(np.sqrt(np.mean(off**2))),
        float(np.median(largest)),
        float(np.max(largest)),
    )


def _rows(paths: Paths, division: Division, pairs: int) -> EnergyRows:
    return joined_rows(
        [division_rows(paths, case, _edges_s(case), division) for case in PAIRS[pairs]]
    )


def _edges_s(case: int) -> FloatArray:
    # the printed arrival, not the trace's own: few rays hear the first reflection late
    return paper_edges_s(PRINTED_ARRIVALS_MS[CASES[case]][1])


def _fit(problem: SquaresProblem, pairs: int, rng: np.random.Generator) -> FloatArray:
    edges_s = _edges_s(PAIRS[pairs][0])
    uniform = uniform_absorption(problem.measured[: edges_s.size - 1], edges_s)
    points = starts(uniform, len(problem.rows.materials), _RANDOM_STARTS, rng)
    return fit_least_squares(partial(residuals, problem), points).x
