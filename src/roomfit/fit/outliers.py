"""Outliers: measurements that the model explains far worse than all others, weighted less."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from roomfit.base.typing import FloatArray
from roomfit.model.energy import EnergyTerm
from roomfit.signals.measurement import MeasuredPair
from roomfit.solver import BandFit

# An outlier has more than so many times the others' misfit, in the median band ...
_TIMES_OTHERS = 4.0
# ... and itself more than this. Energies fluctuate, so that only a large misfit is significant;
# pressures determine the energy of a window within a fifth, and a response of another room may
# still lie within it.
LEAST_BY_ENERGIES = 3.0
LEAST_BY_PRESSURES = 1.0


def file_misfits(
    files: Sequence[MeasuredPair],
    windows: EnergyTerm,
    fit: BandFit,
    inflation: FloatArray | None,
) -> dict[MeasuredPair, float]:
    """Return the mean squared weighted residual of each measurement of a band, as measured."""
    ends = np.cumsum([0, *(o.energy.size for o in windows.observations)])
    squares = (fit.measured - fit.expected) ** 2 / fit.variance
    squares = squares if inflation is None else squares * inflation
    misfits = np.add.reduceat(squares[: ends[-1]], ends[:-1]) / np.diff(ends)
    return dict(zip(files, misfits.tolist(), strict=True))


def outlier_files(
    bands: Sequence[Mapping[MeasuredPair, float]], least_misfit: float
) -> dict[MeasuredPair, float]:
    """Return the outliers, each with the ratio of its misfit to that of the others.

    Far above the median of three measurements or more, in the median band.
    """
    ratios: dict[MeasuredPair, list[float]] = {}
    for misfits in bands:
        if len(misfits) < 3:
            continue
        middle = np.median(list(misfits.values()))
        for m, misfit in misfits.items():
            ratio = float(misfit / middle) if misfit > least_misfit else 1.0
            ratios.setdefault(m, []).append(ratio)
    medians = {i: float(np.median(each)) for i, each in ratios.items()}
    return {i: ratio for i, ratio in medians.items() if ratio > _TIMES_OTHERS}


def variance_inflation(
    windows: EnergyTerm,
    files: Sequence[MeasuredPair],
    outliers: Mapping[MeasuredPair, float],
    n_data: int,
) -> FloatArray | None:
    """Return the factor on the variance of each datum, windows first; None where all are 1."""
    if not any(m in outliers for m in files):
        return None
    factor: FloatArray = np.ones(n_data)
    sizes = [o.energy.size for o in windows.observations]
    factor[: sum(sizes)] = np.repeat([outliers.get(m, 1.0) for m in files], sizes)
    return factor
