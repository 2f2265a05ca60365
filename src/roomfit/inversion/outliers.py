"""Outliers: measurements that the model explains far worse than all others, weighted less."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from roomfit.findings import Code, Finding
from roomfit.measurement import MeasuredPair
from roomfit.objective.energy import EnergyProblem
from roomfit.solvers.least_squares import BandFit
from roomfit.typing import FloatArray

# An outlier has more than so many times the others' misfit, in the median band ...
_TIMES_OTHERS = 4.0
# ... and itself more than this. Energies fluctuate, so that only a large misfit is significant;
# pressures determine the energy of a window within a fifth, and a response of another room may
# still lie within it.
LEAST_BY_ENERGIES = 3.0
LEAST_BY_PRESSURES = 1.0
_FEWEST = 3


@dataclass(frozen=True, slots=True, eq=False)
class BandComparison:
    """The fit of one band to the windows of its measurements."""

    problem: EnergyProblem  # with the observations
    fit: BandFit  # its first data are the windows of these
    files: tuple[MeasuredPair, ...]  # of the observations, in their order
    factor: FloatArray  # (n_windows,), by which variances were inflated already


def outlier_files(
    bands: Sequence[BandComparison], least_misfit: float
) -> dict[MeasuredPair, float]:
    """Return the outliers, each with the ratio of its misfit to that of the others.

    The misfit is the mean squared weighted residual; an outlier's is far above the median of all
    measurements, in the median band. Of fewer than three measurements none can be distinguished.

    Parameters
    ----------
    bands : sequence of BandComparison
        Those that were fitted.
    least_misfit : float
        A measurement with a smaller misfit counts as good in that band.

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
            ratio = float(misfit / np.median(misfits)) if misfit > least_misfit else 1.0
            ratios.setdefault(m, []).append(ratio)
    medians = {i: float(np.median(each)) for i, each in ratios.items()}
    return {i: ratio for i, ratio in medians.items() if ratio > _TIMES_OTHERS}


def variance_inflation(
    problem: EnergyProblem, files: Sequence[MeasuredPair], outliers: Mapping[MeasuredPair, float]
) -> FloatArray:
    """Return the factor that inflates the variance of each window, shape (n_windows,)."""
    sizes = [o.energy.size for o in problem.observations]
    return np.repeat(np.array([outliers.get(m, 1.0) for m in files]), sizes)


def outlier_findings(
    measured: Sequence[MeasuredPair], outliers: Mapping[MeasuredPair, float]
) -> tuple[Finding, ...]:
    """Return a finding for each outlier, in the order of the measurements."""
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
        f"{name} is an outlier: its mean squared residual is {ratio:.0f} times that of the other "
        "measurements. Its variance was inflated by that factor. Check its file, its positions "
        "and its level.",
        {"ratio": ratio},
    )
