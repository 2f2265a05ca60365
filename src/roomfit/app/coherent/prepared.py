"""What every band needs before it is fitted: energies, spoiled files, and its coherent problem."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from roomfit.air import attenuation_per_m
from roomfit.app.binning import BinnedPaths, paths_at
from roomfit.app.coherent.bands import CoherentBand, CoherentOptions, PartFactory, joined
from roomfit.app.coherent.problems import (
    campaign_geometry,
    coherent_problem,
)
from roomfit.app.coherent.shared_errors import air_error, shared_steps
from roomfit.app.coherent.spoiled import (
    LEAST_BY_ENERGIES,
    Heard,
    softened,
    spoiled_files,
    spoiled_findings,
)
from roomfit.app.coherent.tracing_noise import with_tracing_noise
from roomfit.app.directing.bands import hows_after_others, moved_start
from roomfit.app.directing.unknown import Directed, Directing, directed_band, made_directed
from roomfit.app.fitting import BandAnswer, Refine, band_answer
from roomfit.app.measuring import MeasuredPair
from roomfit.app.problems import band_problems, tells_of_band
from roomfit.bands import Bands
from roomfit.findings import Finding
from roomfit.identification.coherence_rounds import CoherentBandFit
from roomfit.identification.reweighted import BandFit, fit_band
from roomfit.identification.scoring import score_band
from roomfit.identification.solvers import few_gauss_newton_steps, gauss_newton
from roomfit.materials.knowledge import MaterialKnowledge
from roomfit.objective.directed_problem import with_unknown
from roomfit.objective.energy_problem import EnergyProblem
from roomfit.objective.parameters import physical_values
from roomfit.objective.problem import BandProblem
from roomfit.scene.scene import Scene
from roomfit.tracing.paths import Paths
from roomfit.typing import FloatArray
from roomfit.uncertainty.shared_errors import allowing_for

# Shortest window in units of 1 / B: finer ones than energies need tell of phases.
_WINDOW_PERIODS = 0.75


@dataclass(frozen=True, slots=True, eq=False)
class CoherentTask:
    """What stays the same while paths are traced anew.

    `directing` are the sources whose directivity is fitted, `suspects` those that are taken for
    omnidirectional. `spoiled` says how many times worse than others pressures explain a file,
    `refine` makes better intervals of a band's fit.
    """

    scene: Scene
    bands: Bands
    knowledge: tuple[MaterialKnowledge, ...]
    measured: tuple[MeasuredPair, ...]
    start: FloatArray
    settings: CoherentOptions
    parts: Sequence[tuple[PartFactory, ...]]
    directing: Directing | None = None
    suspects: Directing | None = None
    spoiled: Mapping[int, float] = field(default_factory=dict)
    refine: Refine | None = None


def prepared_bands(
    task: CoherentTask,
    paths: Paths,
    weights: FloatArray | None,
    binned: BinnedPaths,
    origin: FloatArray | None,
) -> tuple[tuple[CoherentBand | None, ...], tuple[Finding, ...]]:
    """Fit the energies of every band, find spoiled files, and make the coherent problems."""
    scene, bands = task.scene, task.bands
    files = [files_of_band(task, b) for b in range(len(bands))]
    energies = _energies_alone(task, paths, binned, files)
    heard = [
        Heard(e.problem, e.fit, own, e.factor)
        for e, own in zip(energies, files, strict=True)
        if e is not None
    ]
    # what pressures say of a file later knows more
    spoiled = {**spoiled_files(heard, LEAST_BY_ENERGIES), **task.spoiled}
    if spoiled:
        energies = [
            e if e is None else _fitted(replace(e, factor=softened(e.problem, own, spoiled)))
            for e, own in zip(energies, files, strict=True)
        ]
    energies = _after_others(task, energies)
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
    for b, own in enumerate(energies):
        if own is None:
            out.append(None)
            continue
        rows = [i for i, m in enumerate(told) if m in files[b]]
        geometry = replace(whole, columns=whole.columns[rows])
        coherent = coherent_problem(
            *(bands, b, own.problem, float(attenuation[b]), paths_at(paths, weights, b)),
            *(binned, geometry, None, task.settings.end_s),
        )
        out.append(
            CoherentBand(own.problem, own.fit, own.factor, coherent, own.parts, own.directed)
        )
    return tuple(out), spoiled_findings(task.measured, spoiled)


@dataclass(frozen=True, slots=True, eq=False)
class _Energies:
    """The energies of one band and their fit."""

    problem: EnergyProblem
    factor: FloatArray
    parts: tuple[PartFactory, ...]
    directed: Directed | None
    fit: BandFit

    def whole(self) -> BandProblem:
        return joined(made_directed(self.problem, self.directed), self.factor, self.parts)


def files_of_band(task: CoherentTask, band: int) -> tuple[MeasuredPair, ...]:
    """Return the measurements of a band's observations, in their order."""
    return tuple(m for m in task.measured if tells_of_band(m, band))


def sources_of_band(task: CoherentTask, band: int) -> tuple[int, ...]:
    """Return the source of each of a band's observations."""
    return tuple(int(task.scene.pairs[m.pair][0]) for m in files_of_band(task, band))


def _energies_alone(
    task: CoherentTask,
    paths: Paths,
    binned: BinnedPaths,
    files: Sequence[tuple[MeasuredPair, ...]],
) -> list[_Energies | None]:
    """Fit the energies of every band by themselves, in the windows that pressures need."""
    problems = band_problems(
        *(task.scene, task.bands, task.knowledge, task.measured, binned, task.start),
        periods=_WINDOW_PERIODS,
    )
    out: list[_Energies | None] = []
    for problem, parts, heard in zip(problems, task.parts, files, strict=True):
        if problem is None:
            out.append(None)
            continue
        how = None
        if task.directing is not None:
            how = directed_band(task.directing, task.scene, paths, problem, heard)
            problem = with_unknown(problem, how.unknown)
        factor = np.ones(problem.measured().size)
        whole = joined(made_directed(problem, how), factor, parts)
        fit = fit_band(whole, gauss_newton, few_gauss_newton_steps)
        out.append(_Energies(problem, factor, parts, how, fit))
    return out


def _fitted(own: _Energies) -> _Energies:
    return replace(own, fit=fit_band(own.whole(), gauss_newton, few_gauss_newton_steps))


def _after_others(task: CoherentTask, energies: list[_Energies | None]) -> list[_Energies | None]:
    """Fit the energies again under what other bands say of the directivity, where it is unknown."""
    if task.directing is None:
        return energies
    hows = hows_after_others(
        *(task.directing, task.bands, [None if e is None else e.directed for e in energies]),
        [None if e is None else e.fit for e in energies],
        [None if e is None else e.problem.parameters for e in energies],
    )
    out: list[_Energies | None] = []
    for own, how in zip(energies, hows, strict=True):
        if own is None or own.directed is None or how is None:
            out.append(own)
            continue
        start = moved_start(own.fit, own.directed.unknown, how.unknown)
        problem = with_unknown(own.problem, how.unknown)
        own = replace(own, problem=problem, directed=how)
        out.append(replace(own, fit=score_band(own.whole(), start)))
    return out


def first_absorption(task: CoherentTask, prepared: tuple[CoherentBand | None, ...]) -> FloatArray:
    """Return absorption by energies alone, or else the start, shape (n_materials, n_bands)."""
    out = np.tile(task.start, (len(task.knowledge), 1))
    for i, band in enumerate(prepared):
        if band is not None:
            parameters = band.energies.parameters
            values, _ = physical_values(parameters, band.energy_fit.vector)
            out[:, i] = values["absorption"]
    return out


def absorption_so_far(guess: FloatArray, fits: Sequence[CoherentBandFit | None]) -> FloatArray:
    """Return a guess with the absorption of those bands that pressures have told already.

    Parameters
    ----------
    guess : float array, shape (n_materials, n_bands)
    fits : sequence of CoherentBandFit or None, one a band
    """
    out = guess.copy()
    for i, fit in enumerate(fits):
        if fit is not None:
            out[:, i] = physical_values(fit.parameters, fit.fit.vector)[0]["absorption"]
    return out


def energy_answers(
    task: CoherentTask,
    paths: Paths,
    problems: Iterable[EnergyProblem | None],
    prepared: tuple[CoherentBand | None, ...],
    areas_m2: FloatArray,
) -> tuple[BandAnswer | None, ...]:
    """Return what energies alone say, in the windows whose noise is known to suit them."""
    out: list[BandAnswer | None] = []
    bands = zip(problems, prepared, task.parts, strict=True)
    for number, (problem, band, own) in enumerate(bands):
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
        how = None if band is None else band.directed
        if how is not None and task.directing is not None:
            # other windows may hear other rows
            heard = files_of_band(task, number)
            rows = directed_band(task.directing, task.scene, paths, problem, heard)
            how = replace(rows, unknown=how.unknown)
            problem = with_unknown(problem, how.unknown)
        whole = joined(made_directed(problem, how), factor, own)
        fit = fit_band(whole, gauss_newton, few_gauss_newton_steps)
        noisy = with_tracing_noise(whole, problem, sources_of_band(task, number), fit)
        air = air_error(task.scene.air, task.bands, number, problem)
        steps = shared_steps(whole, fit, problem, air)
        noisy = allowing_for(noisy, steps)
        answer = band_answer(problem.parameters, noisy, areas_m2, "energy")
        out.append(answer if task.refine is None else task.refine(whole, fit, answer, None))
    return tuple(out)
