"""Are there data enough? Asked before anything is computed."""

from __future__ import annotations

import numpy as np

from roomfit.findings import Finding
from roomfit.impedance.choose import WallModel
from roomfit.impedance.laws import LAWS
from roomfit.impedance.layout import layout_of
from roomfit.impedance.model import has_free_spectra
from roomfit.impedance.problem import Problem

# Frequencies from which a curve couples them, so that phases can be done without.
_COUPLED = 4


def data_findings(problem: Problem, walls: dict[str, WallModel]) -> tuple[Finding, ...]:
    """Return a serious finding where the data cannot hold the unknowns, whatever they say.

    Two numbers a pair and frequency (levels: one), less the gains that are unknown, must be at
    least the numbers of the walls; and frequency by frequency, where nothing couples them, one pair
    more than materials [1]_: with as many there are other exact solutions.

    References
    ----------
    .. [1] docs/impedance.md
    """
    observed = problem.observed
    n_pairs, n_f = observed.pressure.shape
    n_materials = len(problem.curves)
    if n_f < _COUPLED and not observed.has_phase:
        return (
            Finding(
                "too-few-data",
                "serious",
                f"Levels without phase at {_frequencies(n_f)} do not tell a wall from others that "
                "reflect as much with another phase. Give phases, or levels over a whole band.",
                {"pairs": n_pairs, "frequencies": n_f},
            ),
        )
    if n_f < _COUPLED and n_pairs < n_materials + 1:
        return (
            Finding(
                "too-few-data",
                "serious",
                f"{n_pairs} pair{'s' * (n_pairs != 1)} at {_frequencies(n_f)} cannot tell "
                f"{n_materials} materials apart: {n_materials + 1} pairs are needed, or "
                "frequencies that a smooth curve couples.",
                {"pairs": n_pairs, "materials": n_materials, "frequencies": n_f},
            ),
        )
    needed = sum(_numbers(problem, i, w) for i, w in enumerate(walls.values()))
    n_sources = len(np.unique(problem.model.scene.pairs[:, 0]))
    data = (2 if observed.has_phase else 1) * n_pairs * n_f
    if has_free_spectra(problem.nuisances):
        data -= 2 * n_sources * n_f
    layout = layout_of(problem)
    needed += layout.gain.stop - layout.gain.start
    if data >= needed:
        return ()
    return (
        Finding(
            "too-few-data",
            "serious",
            f"{data} numbers were measured, besides what the gains take, and {needed} are unknown: "
            "measure more pairs, or tell the gain or the laws of some walls.",
            {"data": data, "unknowns": needed},
        ),
    )


def _numbers(problem: Problem, material: int, wall: WallModel) -> int:
    if wall.kind in LAWS:
        return len(LAWS[wall.kind][1])
    return len(problem.curves[material].start)


def _frequencies(n: int) -> str:
    return "one frequency" if n == 1 else f"{n} frequencies"
