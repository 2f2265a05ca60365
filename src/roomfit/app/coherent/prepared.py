"""What every band needs before it is fitted: energies, spoiled files, and its coherent problem."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from roomfit.air import attenuation_per_m
from roomfit.app.coherent.bands import CoherentBand, CoherentOptions, PartFactory, joined
from roomfit.app.coherent.problems import (
    campaign_geometry,
    coherent_problem,
)
from roomfit.app.coherent.spoiled import spoiled_files
from roomfit.app.fitting import BandAnswer, band_answer
from roomfit.app.measuring import MeasuredPair
from roomfit.app.problems import BinnedPaths, band_problems, paths_at, tells_of_band
from roomfit.bands import Bands
from roomfit.findings import Finding
from roomfit.identification.reweighted import BandFit, fit_band
from roomfit.identification.solvers import few_gauss_newton_steps, gauss_newton
from roomfit.materials.knowledge import MaterialKnowledge
from roomfit.objective.energy_problem import EnergyProblem
from roomfit.scene.scene import Scene
from roomfit.tracing.paths import Paths
from roomfit.typing import FloatArray

# Shortest window in units of 1 / B: finer ones than energies need tell of phases.
_WINDOW_PERIODS = 0.75


@dataclass(frozen=True, slots=True, eq=False)
class CoherentTask:
    """What stays the same while paths are traced anew."""

    scene: Scene
    bands: Bands
    knowledge: tuple[MaterialKnowledge, ...]
    measured: tuple[MeasuredPair, ...]
    start: FloatArray
    settings: CoherentOptions
    parts: Sequence[tuple[PartFactory, ...]]


def prepared_bands(
    task: CoherentTask,
    paths: Paths,
    weights: FloatArray | None,
    binned: BinnedPaths,
    origin: FloatArray | None,
) -> tuple[tuple[CoherentBand | None, ...], tuple[Finding, ...]]:
    """Fit the energies of every band, find spoiled files, and make the coherent problems."""
    scene, bands, parts = task.scene, task.bands, task.parts
    problems = tuple(
        band_problems(
            *(scene, bands, task.knowledge, task.measured, binned, task.start),
            periods=_WINDOW_PERIODS,
        )
    )
    files = [tuple(m for m in task.measured if tells_of_band(m, b)) for b in range(len(bands))]
    nothing = [np.ones(0 if p is None else p.measured().size) for p in problems]
    fits = [_fit_energies(*each) for each in zip(problems, nothing, parts, strict=True)]
    factors, findings = spoiled_files(problems, fits, files)
    attenuation = attenuation_per_m(scene.air, bands)
    # every band has the same unknowns of geometry, in whichever files it hears
    told = tuple(m for m in task.measured if m.file.use == "fit")
    whole = campaign_geometry(
        *(scene, task.knowledge, told),
        positions=task.settings.positions == "fit",
        delays=task.settings.delays,
        speed_sd=task.settings.speed_sd,
    )
    whole = replace(whole, origin=origin)
    out: list[CoherentBand | None] = []
    for b, (problem, fit) in enumerate(zip(problems, fits, strict=True)):
        if problem is None or fit is None:
            out.append(None)
            continue
        if np.any(factors[b] != 1.0):
            fit = _fit_energies(problem, factors[b], parts[b]) or fit
        rows = [i for i, m in enumerate(told) if m in files[b]]
        geometry = replace(whole, columns=whole.columns[rows])
        coherent = coherent_problem(
            *(bands, b, problem, float(attenuation[b]), paths_at(paths, weights, b)),
            *(binned, geometry, None, task.settings.end_s),
        )
        out.append(CoherentBand(problem, fit, factors[b], coherent, parts[b]))
    return tuple(out), findings


def _fit_energies(
    problem: EnergyProblem | None, factor: FloatArray, parts: tuple[PartFactory, ...]
) -> BandFit | None:
    if problem is None:
        return None
    return fit_band(joined(problem, factor, parts), gauss_newton, few_gauss_newton_steps)


def energy_answers(
    problems: Iterable[EnergyProblem | None],
    prepared: tuple[CoherentBand | None, ...],
    parts: Sequence[tuple[PartFactory, ...]],
    areas_m2: FloatArray,
) -> tuple[BandAnswer | None, ...]:
    """Return what energies alone say, in the windows whose noise is known to suit them."""
    out: list[BandAnswer | None] = []
    for problem, band, own in zip(problems, prepared, parts, strict=True):
        if problem is None:
            out.append(None)
            continue
        factor = np.ones(problem.measured().size)
        if band is not None:
            # as for the finer windows: one factor an observation
            fine = [o.energy.size for o in band.energies.observations]
            first = np.cumsum([0, *fine[:-1]])
            sizes = [o.energy.size for o in problem.observations]
            factor = np.repeat(band.factor[first], sizes)
        fit = fit_band(joined(problem, factor, own), gauss_newton, few_gauss_newton_steps)
        out.append(band_answer(problem.parameters, fit, areas_m2, "energy"))
    return tuple(out)
