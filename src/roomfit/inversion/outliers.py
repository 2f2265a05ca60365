"""Measurements that the model explains far worse than all others: found, and trusted less."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from roomfit.findings import Code, Finding
from roomfit.measurement import MeasuredPair
from roomfit.objective.energy import EnergyProblem
from roomfit.solvers.least_squares import BandFit
from roomfit.typing import FloatArray

# So many times the others' misfit, in the median band ...
_TIMES_OTHERS = 4.0
# ... and itself beyond this. Energies scatter, so that a misfit must be large to mean anything;
# pressures say what a window holds to a fifth, and a file of another room may still lie within it.
LEAST_BY_ENERGIES = 3.0
LEAST_BY_PRESSURES = 1.0
_FEWEST = 3


@dataclass(frozen=True, slots=True, eq=False)
class BandComparison:
    """One band: what was compared with what.

    Attributes
    ----------
    problem : EnergyProblem
        With the observations.
    fit : BandFit
        Of these windows first, whatever else it was made of.
    files : tuple of MeasuredPair
        Of the observations, in their order.
    factor : float array, shape (n_windows,)
        By how much variances were enlarged already.
    """

    problem: EnergyProblem
    fit: BandFit
    files: tuple[MeasuredPair, ...]
    factor: FloatArray


def outlier_files(
    bands: Sequence[BandComparison], least_misfit: float
) -> dict[MeasuredPair, float]:
    """Return how many times worse than the others the spoiled files are explained.

    A file is spoiled where its mean squared weighted residual is far above the median of all
    files, in the median band. Of fewer than three files none can be told from the others.

    Parameters
    ----------
    bands : sequence of BandComparison
        Those that were fitted.
    least_misfit : float
        A file that is explained better than this counts as good in that band.

    Returns
    -------
    dict
        By measurement, which is the same only as itself.
    """
    ratios: dict[MeasuredPair, list[float]] = {}
    for band in bands:
        if len(band.files) < _FEWEST:
            continue
        misfits = _misfits(band)
        for m, misfit in zip(band.files, misfits, strict=True):
            beside = float(misfit / np.median(misfits)) if misfit > least_misfit else 1.0
            ratios.setdefault(m, []).append(beside)
    medians = {i: float(np.median(each)) for i, each in ratios.items()}
    return {i: ratio for i, ratio in medians.items() if ratio > _TIMES_OTHERS}


def variance_inflation(
    problem: EnergyProblem, files: Sequence[MeasuredPair], outliers: Mapping[MeasuredPair, float]
) -> FloatArray:
    """Return by how much the variance of each window is to be enlarged, shape (n_windows,)."""
    sizes = [o.energy.size for o in problem.observations]
    return np.repeat(np.array([outliers.get(m, 1.0) for m in files]), sizes)


def outlier_findings(
    measured: Sequence[MeasuredPair], outliers: Mapping[MeasuredPair, float]
) -> tuple[Finding, ...]:
    """Return a finding for each spoiled file, in the order of the campaign."""
    return tuple(_finding(m, outliers[m]) for m in measured if m in outliers)


def _misfits(band: BandComparison) -> FloatArray:
    """Return the mean squared weighted residual of each observation, shape (n_observations,)."""
    n = band.factor.size
    squares = ((band.fit.measured - band.fit.expected) ** 2 / band.fit.variance)[:n]
    squares = squares * band.factor
    ends = np.cumsum([0, *(o.energy.size for o in band.problem.observations)])
    return np.asarray(np.add.reduceat(squares, ends[:-1]) / np.diff(ends))


def _finding(m: MeasuredPair, ratio: float) -> Finding:
    name = f"{m.measurement.source} to {m.measurement.receiver} ({m.measurement.name})"
    return Finding(
        Code.MEASUREMENT_OUTLIER,
        f"{name} fits the room {ratio:.0f} times worse than the other measurements do: it was "
        "given that much less weight. Check its file, its positions and its level.",
        {"ratio": ratio},
    )
