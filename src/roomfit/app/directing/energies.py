"""Energies of every band with the directivity of their sources unknown, or asked about."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from roomfit.app.binning import BinnedPaths
from roomfit.app.directing.bands import hows_after_others
from roomfit.app.directing.doubts import DirectivityDoubt, directivity_doubt
from roomfit.app.directing.unknown import Directed, Directing, directed_band, made_directed
from roomfit.app.measuring import MeasuredPair
from roomfit.app.problems import band_problems, tells_of_band
from roomfit.bands import Bands
from roomfit.identification.reweighted import BandFit, fit_band
from roomfit.identification.solvers import few_gauss_newton_steps, gauss_newton
from roomfit.materials.knowledge import MaterialKnowledge
from roomfit.objective.directed_problem import with_unknown
from roomfit.objective.energy_problem import EnergyProblem
from roomfit.objective.parameters import Parameters
from roomfit.objective.problem import BandProblem, JointProblem
from roomfit.scene.scene import Scene
from roomfit.tracing.paths import Paths
from roomfit.typing import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class EnergyTask:
    """What window energies of all bands are made from."""

    scene: Scene
    bands: Bands
    knowledge: tuple[MaterialKnowledge, ...]
    measured: tuple[MeasuredPair, ...]
    paths: Paths
    binned: BinnedPaths
    start: FloatArray


def directed_energies(task: EnergyTask, directing: Directing | None) -> tuple[Directed | None, ...]:
    """Return what is known of the sources in each band once the others have been fitted."""
    if directing is None:
        return (None,) * len(task.bands)
    hows: list[Directed | None] = []
    fits: list[BandFit | None] = []
    parameters: list[Parameters | None] = []
    for band, problem in enumerate(_problems(task)):
        if problem is None:
            hows, fits, parameters = [*hows, None], [*fits, None], [*parameters, None]
            continue
        how = directed_band(directing, task.scene, task.paths, problem, _files(task, band))
        whole = made_directed(with_unknown(problem, how.unknown), how)
        hows.append(how)
        fits.append(fit_band(whole, gauss_newton, few_gauss_newton_steps))
        parameters.append(whole.parameters)
    return hows_after_others(directing, task.bands, hows, fits, parameters)


def energy_problems(
    task: EnergyTask, hows: tuple[Directed | None, ...]
) -> Iterator[BandProblem | None]:
    """Make the problem of one band after the other, with the directivities that are unknown."""
    for problem, how in zip(_problems(task), hows, strict=True):
        if problem is None or how is None:
            yield problem
        else:
            yield made_directed(with_unknown(problem, how.unknown), how)


def doubting(
    task: EnergyTask, suspects: Directing, doubts: dict[int, DirectivityDoubt]
) -> Callable[[int, BandProblem, BandFit], None]:
    """Return what writes down, for every fitted band, what it says against its sources."""

    def watch(band: int, problem: BandProblem, fit: BandFit) -> None:
        first = problem.parts[0] if isinstance(problem, JointProblem) else problem
        if isinstance(first, EnergyProblem):
            how = directed_band(suspects, task.scene, task.paths, first, _files(task, band))
            doubts[band] = directivity_doubt(first, fit, how)

    return watch


def _problems(task: EnergyTask) -> Iterator[EnergyProblem | None]:
    return band_problems(
        *(task.scene, task.bands, task.knowledge, task.measured, task.binned, task.start)
    )


def _files(task: EnergyTask, band: int) -> tuple[MeasuredPair, ...]:
    return tuple(m for m in task.measured if tells_of_band(m, band))
