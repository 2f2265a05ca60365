"""The absorption of every band estimated: by energies, or by pressures where they explain more."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from roomfit.air import Air, relative_speed_sd
from roomfit.findings import Finding
from roomfit.inversion.bands import fit_bands
from roomfit.inversion.coherent import (
    CoherentTask,
    coherent_estimates,
    decided,
    energy_estimates,
    fit_coherent,
)
from roomfit.inversion.directivity import (
    DirectivityScore,
    EnergyTask,
    band_directivities,
    directed_energies,
    directivity_parameters,
    energy_problems,
    omnidirectional,
    score_sources,
    source_findings,
)
from roomfit.inversion.measurements import Measurements
from roomfit.inversion.paths import TracedPaths
from roomfit.inversion.sequential import CoherentOptions
from roomfit.inversion.systematics import (
    air_error,
    shared_steps,
    widened_by_neighbours,
    with_tracing_noise,
)
from roomfit.materials.priors import MaterialPrior
from roomfit.objective.coherent import FittedGeometry
from roomfit.objective.directivity import DirectedProblem, FittedDirectivity
from roomfit.objective.energy import EnergyProblem
from roomfit.objective.observation import has_data_in_band
from roomfit.objective.parameters import Parameters
from roomfit.objective.problem import BandProblem, JointProblem
from roomfit.objective.room_parameters import RoomValuesProblem, value_problems
from roomfit.scene import material_areas_m2
from roomfit.settings import Settings
from roomfit.solvers.least_squares import BandFit
from roomfit.typing import FloatArray, Progress, part
from roomfit.uncertainty.gaussian import BandEstimate, Refine, SharedCovariance, add_covariance


def shared_error_covariance(task: EnergyTask) -> SharedCovariance:
    """Return what adds to a band's fit the covariance of the errors that its windows share.

    Room parameters without responses stay as they are.

    Parameters
    ----------
    task : EnergyTask
    """

    def add_shared_errors(band: int, problem: BandProblem, fit: BandFit) -> BandFit:
        first = problem.parts[0] if isinstance(problem, JointProblem) else problem
        energies = first.problem if isinstance(first, DirectedProblem) else first
        if not isinstance(energies, EnergyProblem) or not fit.vector.size:
            return fit
        observed = [m for m in task.measured if has_data_in_band(m, band)]
        sources = [int(task.scene.pairs[m.pair][0]) for m in observed]
        noisy = with_tracing_noise(problem, energies, sources, fit)
        air = air_error(task.scene.air, task.bands, band, energies)
        return add_covariance(noisy, shared_steps(problem, fit, energies, air))

    return add_shared_errors


@dataclass(frozen=True, slots=True, eq=False)
class BandFits:
    """The answer of every band, and what was found of arrival times and sources on the way.

    `directivities`, one a source, are empty where none was to be fitted.
    """

    answers: tuple[BandEstimate, ...]
    geometry: FittedGeometry | None = None
    findings: tuple[Finding, ...] = ()
    directivities: tuple[FittedDirectivity, ...] = ()


def prior_speed_sd(air: Air, settings: Settings) -> float:
    """Return the prior relative standard deviation of the speed of sound, 1e-6 at least."""
    if settings.temperature_sd_c is None:
        return settings.speed_of_sound_sd
    return max(relative_speed_sd(air, settings.temperature_sd_c), 1e-6)


def estimate_energies(
    measured: Measurements,
    priors: tuple[MaterialPrior, ...],
    traced: TracedPaths,
    start: FloatArray,
    settings: Settings,
    refine: Refine,
    progress: Progress | None,
) -> BandFits:
    """Estimate the absorption of every band by window energies and room parameters.

    Parameters
    ----------
    start : float array, shape (n_bands,)
        Uniform absorption to start from.
    refine : callable
        Makes better intervals of each band's fit.

    Raises
    ------
    InputError
        A directivity is to be fitted where it cannot.
    """
    scene, bands = measured.scene, measured.bands
    unknown = directivity_parameters(measured, settings)
    tested = omnidirectional(measured) if unknown is None else None
    task = EnergyTask(scene, bands, priors, measured.responses, traced.paths, traced.binned, start)
    directivities = directed_energies(task, unknown)
    scores: dict[int, DirectivityScore] = {}
    fitted = fit_bands(
        _joined(
            energy_problems(task, directivities), _value_problems(measured, priors, traced, start)
        ),
        priors,
        material_areas_m2(scene.room),
        settings,
        progress,
        watch=None if tested is None else score_sources(task, tested, scores),
        shared_covariance=shared_error_covariance(task),
    )
    estimates = tuple(refine(band, None) for band in fitted)
    found = band_directivities(unknown, directivities, estimates)
    return BandFits(estimates, None, source_findings(tested, scores), found)


def estimate_pressures(
    measured: Measurements,
    priors: tuple[MaterialPrior, ...],
    traced: TracedPaths,
    start: FloatArray,
    settings: Settings,
    refine: Refine,
    progress: Progress | None,
) -> BandFits:
    """Estimate the absorption of every band by partly coherent image sources where they explain it.

    The parameters are those of `estimate_energies`.
    """
    scene = measured.scene
    unknown = directivity_parameters(measured, settings)
    values = _value_problems(measured, priors, traced, start)
    task = CoherentTask(
        scene,
        measured.bands,
        priors,
        measured.responses,
        start,
        CoherentOptions(
            positions="fixed" if settings.positions == "fixed" else "fit",
            delays=settings.reflection_delays,
            model="coherent" if settings.model == "coherent" else "auto",
            end_s=settings.coherent_until_s,
            late_end_s=traced.fit_until_s,
            speed_sd=prior_speed_sd(scene.air, settings),
        ),
        tuple(() if v is None else (_sharing(v),) for v in values),
        unknown,
        omnidirectional(measured) if unknown is None else None,
    )
    fit = fit_coherent(task, traced, part(progress, 0.0, 0.75))
    n = len(fit.fits)
    coherent: list[BandEstimate | None] = []
    for i, band in enumerate(coherent_estimates(fit)):
        done = part(progress, 0.75 + 0.2 * i / n, 0.75 + 0.2 * (i + 1) / n)
        coherent.append(None if band is None else refine(band, done))
    areas_m2 = material_areas_m2(scene.room)
    energy = [None if b is None else refine(b, None) for b in energy_estimates(fit)]
    chosen = decided(fit, energy, widened_by_neighbours(tuple(coherent), areas_m2))
    # where no response has data, room parameters or the prior
    alone = [None if e is not None else v for e, v in zip(chosen, values, strict=True)]
    rest = fit_bands(alone, priors, areas_m2, settings, part(progress, 0.95, 1.0))
    estimates = tuple(
        refine(r, None) if e is None else e for e, r in zip(chosen, rest, strict=True)
    )
    directed = tuple(None if b is None else b.directed for b in fit.state.bands)
    found = band_directivities(unknown, directed, estimates)
    return BandFits(estimates, fit.geometry, fit.findings, found)


def _value_problems(
    measured: Measurements,
    priors: tuple[MaterialPrior, ...],
    traced: TracedPaths,
    start: FloatArray,
) -> tuple[RoomValuesProblem | None, ...]:
    scene, bands = measured.scene, measured.bands
    if not measured.values:
        return (None,) * len(bands)
    return value_problems(scene, bands, priors, measured.values, traced.binned, start)


def _sharing(values: RoomValuesProblem) -> Callable[[Parameters], BandProblem]:
    """Return what makes the same room parameters depend on another problem's unknowns."""
    return lambda parameters: replace(values, parameters=parameters)


def _joined(
    windows: Iterator[BandProblem | None], values: tuple[RoomValuesProblem | None, ...]
) -> Iterator[BandProblem | None]:
    """Make one problem after the other from window energies, room parameters, or both."""
    for from_windows, from_values in zip(windows, values, strict=True):
        if from_windows is None or from_values is None:
            yield from_windows or from_values
        else:
            yield JointProblem(
                (from_windows, replace(from_values, parameters=from_windows.parameters))
            )
