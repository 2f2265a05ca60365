"""Data and paths of every band put together and solved, with responses, room parameters or both.

Intervals of energies alone that know what windows share: the noise of the rays, and air.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from roomfit.air import Air
from roomfit.findings import Finding
from roomfit.inversion.bands import fit_bands
from roomfit.inversion.coherent import CoherentTask, fit_coherent
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
from roomfit.inversion.systematics import air_error, shared_steps, with_tracing_noise
from roomfit.inversion.trace_plan import is_coherent
from roomfit.materials.priors import MaterialPrior
from roomfit.objective.coherent import SPEED_SD, FittedGeometry
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
from roomfit.uncertainty.gaussian import BandAnswer, Refine, SharedCovariance, add_covariance


def shared_error_covariance(task: EnergyTask) -> SharedCovariance:
    """Return what makes a band's fit as sure as the errors that its windows share permit.

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

    answers: tuple[BandAnswer, ...]
    geometry: FittedGeometry | None = None
    findings: tuple[Finding, ...] = ()
    directivities: tuple[FittedDirectivity, ...] = ()


def relative_speed_sd(air: Air, settings: Settings) -> float:
    """Return the relative standard deviation of the speed of sound beforehand.

    The speed grows as the root of the absolute temperature.
    """
    temperature_sd_c = settings.temperature_sd_c
    if temperature_sd_c is None:
        return SPEED_SD
    return max(0.5 * temperature_sd_c / (273.15 + air.temperature_c), 1e-6)


def solve(
    measurements: Measurements,
    priors: tuple[MaterialPrior, ...],
    traced: TracedPaths,
    start: FloatArray,
    settings: Settings,
    refine: Refine | None,
    progress: Progress | None,
) -> BandFits:
    """Fit every band.

    Parameters
    ----------
    start : float array, shape (n_bands,)
        Uniform absorption to start from.
    refine : callable or None
        Makes better intervals of each band's fit.

    Raises
    ------
    InputError
        A directivity is to be fitted where it cannot.
    """
    scene, bands = measurements.scene, measurements.bands
    unknown = directivity_parameters(measurements, settings)
    tested = omnidirectional(measurements) if unknown is None else None
    values: tuple[RoomValuesProblem | None, ...] = (None,) * len(bands)
    if measurements.values:
        values = value_problems(scene, bands, priors, measurements.values, traced.binned, start)
    areas_m2 = material_areas_m2(scene.room)
    coherent = is_coherent(measurements.responses, settings)
    if not coherent or not (traced.far_images or settings.model == "coherent"):
        task = EnergyTask(
            scene, bands, priors, measurements.responses, traced.paths, traced.binned, start
        )
        directivities = directed_energies(task, unknown)
        scores: dict[int, DirectivityScore] = {}
        answers = fit_bands(
            _joined(energy_problems(task, directivities), values),
            priors,
            areas_m2,
            settings,
            progress,
            watch=None if tested is None else score_sources(task, tested, scores),
            shared_covariance=shared_error_covariance(task),
            refine=refine,
        )
        found = band_directivities(unknown, directivities, answers)
        return BandFits(answers, None, source_findings(tested, scores), found)
    coherent_task = CoherentTask(
        scene,
        bands,
        priors,
        measurements.responses,
        start,
        CoherentOptions(
            positions="fixed" if settings.positions == "fixed" else "fit",
            delays=settings.reflection_delays,
            model="coherent" if settings.model == "coherent" else "auto",
            late_end_s=traced.fit_until_s,
            speed_sd=relative_speed_sd(scene.air, settings),
        ),
        tuple(() if v is None else (_sharing(v),) for v in values),
        unknown,
        tested,
        refine=refine,
    )
    fit = fit_coherent(coherent_task, traced, part(progress, 0.0, 0.95))
    alone = [None if a is not None else v for a, v in zip(fit.answers, values, strict=True)]
    rest = fit_bands(alone, priors, areas_m2, settings, part(progress, 0.95, 1.0), refine=refine)
    answers = tuple(r if a is None else a for a, r in zip(fit.answers, rest, strict=True))
    found = band_directivities(unknown, fit.directed, answers)
    return BandFits(answers, fit.geometry, fit.findings, found)


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
