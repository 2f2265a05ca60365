"""Measurements that the model explains far worse than all others: found, and trusted less."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roomfit.app.measuring import MeasuredPair
from roomfit.findings import Finding
from roomfit.identification.reweighted import BandFit
from roomfit.objective.energy_problem import EnergyProblem
from roomfit.typing import FloatArray

# So many times the others' misfit, and itself beyond this, in the median band.
_TIMES_OTHERS = 4.0
_LEAST_MISFIT = 3.0


def spoiled_files(
    problems: Sequence[EnergyProblem | None],
    fits: Sequence[BandFit | None],
    files: Sequence[tuple[MeasuredPair, ...]],
) -> tuple[list[FloatArray], tuple[Finding, ...]]:
    """Return by how much each datum's variance is to be enlarged, and a finding a spoiled file.

    A file is spoiled where its mean squared weighted residual is far above the median of all
    files, in the median band; its variances grow by that ratio. Of fewer than three files none
    can be told from the others.

    Parameters
    ----------
    problems, fits : one a band
    files : one a band
        The measurements of each band's observations, in their order.

    Returns
    -------
    list of float arrays, one a band
        Shape (n_windows,); ones where nothing is spoiled.
    tuple of Finding
    """
    ratios: dict[int, list[float]] = {}
    names: dict[int, str] = {}
    for problem, fit, heard in zip(problems, fits, files, strict=True):
        if problem is None or fit is None or len(heard) < 3:
            continue
        misfits = _misfits(problem, fit)
        for m, misfit in zip(heard, misfits, strict=True):
            beside = float(misfit / np.median(misfits)) if misfit > _LEAST_MISFIT else 1.0
            ratios.setdefault(id(m), []).append(beside)
            names[id(m)] = f"{m.file.source} to {m.file.receiver} ({m.file.response.path.name})"
    spoiled = {
        i: r for i, all_r in ratios.items() if (r := float(np.median(all_r))) > _TIMES_OTHERS
    }
    factors = []
    for problem, heard in zip(problems, files, strict=True):
        own = [] if problem is None else [o.energy.size for o in problem.observations]
        each = [spoiled.get(id(m), 1.0) for m in heard] if own else []
        factors.append(np.repeat(np.array(each, dtype=np.float64), own))
    return factors, tuple(_finding(names[i], ratio) for i, ratio in spoiled.items())


def _misfits(problem: EnergyProblem, fit: BandFit) -> FloatArray:
    """Return the mean squared weighted residual of each observation, shape (n_observations,)."""
    n = problem.measured().size
    squares = ((fit.measured - fit.expected) ** 2 / fit.variance)[:n]
    ends = np.cumsum([0, *(o.energy.size for o in problem.observations)])
    return np.asarray(np.add.reduceat(squares, ends[:-1]) / np.diff(ends))


def _finding(name: str, ratio: float) -> Finding:
    return Finding(
        "measurement-disagrees",
        "warning",
        f"{name} fits the room {ratio:.0f} times worse than the other measurements do: it was "
        "given that much less weight. Check its file, its positions and its level.",
        {"ratio": ratio},
    )
