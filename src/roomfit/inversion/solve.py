"""Data and paths of every band put together and solved, with responses, room parameters or both.

Intervals of energies alone that know what windows share: the noise of the rays, and air.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from roomfit.findings import Finding
from roomfit.inversion.bands import fit_bands
from roomfit.inversion.coherent import Retrace, fit_coherent
from roomfit.inversion.directivity import (
    DirectivityScore,
    EnergyTask,
    FoundDirectivities,
    band_directivities,
    campaign_directivity_parameters,
    directed_energies,
    energy_problems,
    omnidirectional,
    score_sources,
    source_findings,
)
from roomfit.inversion.measurements import Measurements
from roomfit.inversion.sequential import CoherentOptions
from roomfit.inversion.systematics import air_error, shared_steps, with_tracing_noise
from roomfit.inversion.trace_plan import is_coherent
from roomfit.io.campaign import Campaign
from roomfit.materials.priors import MaterialPrior
from roomfit.objective.coherent import SPEED_SD, FittedGeometry
from roomfit.objective.directivity import DirectedProblem, DirectivityParameters
from roomfit.objective.energy import EnergyProblem
from roomfit.objective.observation import has_data_in_band
from roomfit.objective.parameters import Parameters
from roomfit.objective.problem import BandProblem, JointProblem
from roomfit.objective.room_parameters import RoomValuesProblem, value_problems
from roomfit.response.binned import BinnedPaths
from roomfit.scene import material_areas_m2
from roomfit.solvers.least_squares import BandFit
from roomfit.tracing.paths import Paths
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

    `directivities`, one a band, are empty where no source's was to be found.
    """

    answers: tuple[BandAnswer, ...]
    geometry: FittedGeometry | None = None
    findings: tuple[Finding, ...] = ()
    directivities: tuple[FoundDirectivities, ...] = ()


def relative_speed_sd(campaign: Campaign) -> float:
    """Return the relative standard deviation of the speed of sound beforehand.

    The speed grows as the root of the absolute temperature.
    """
    temperature_sd_c = campaign.temperature_sd_c
    if temperature_sd_c is None:
        return SPEED_SD
    return max(0.5 * temperature_sd_c / (273.15 + campaign.air.temperature_c), 1e-6)


def solve(
    campaign: Campaign,
    measurements: Measurements,
    priors: tuple[MaterialPrior, ...],
    paths: Paths,
    weights: FloatArray | None,
    binned: BinnedPaths,
    start: FloatArray,
    far_images: bool,
    fit_until_s: float,
    retrace: Retrace | None,
    refine: Refine | None,
    progress: Progress | None,
) -> BandFits:
    """Fit every band of a campaign.

    Raises
    ------
    InputError
        A certificate is asked for where other data than energies are compared.

    Parameters
    ----------
    paths : Paths
    weights : float array, shape (n_bands, n_paths), or None
        Factors on the weight of every path in every band.
    binned : BinnedPaths
        The same paths in bins, with these factors.
    start : float array, shape (n_bands,)
        Uniform absorption to start from.
    far_images : bool
        Whether there are image sources enough to add pressures.
    fit_until_s : float
        No window of a partly coherent fit ends later.
    retrace : callable or None
        Finds image sources anew where positions have moved, in rooms where that matters.
    refine : callable or None
        Makes better intervals of each band's fit.
    """
    directivity_parameters = campaign_directivity_parameters(campaign, measurements.scene)
    tested_sources = (
        omnidirectional(campaign, measurements.scene) if directivity_parameters is None else None
    )
    values = _value_problems(campaign, measurements, priors, binned, start)
    if not is_coherent(campaign) or not (far_images or campaign.model == "coherent"):
        task = EnergyTask(
            *(
                measurements.scene,
                campaign.bands,
                priors,
                measurements.responses,
                paths,
                binned,
                start,
            )
        )
        return _energies_alone(
            campaign,
            measurements,
            task,
            values,
            directivity_parameters,
            tested_sources,
            refine,
            progress,
        )
    options = CoherentOptions(
        positions="fixed" if campaign.positions == "fixed" else "fit",
        delays=campaign.wall_delays,
        model="coherent" if campaign.model == "coherent" else "auto",
        late_end_s=fit_until_s,
        speed_sd=relative_speed_sd(campaign),
    )
    fit = fit_coherent(
        *(measurements.scene, campaign.bands, priors, measurements.responses, paths, binned, start),
        options=options,
        weights=weights,
        retrace=retrace,
        extra_parts=[() if v is None else (_sharing(v),) for v in values],
        directivity_parameters=directivity_parameters,
        tested_sources=tested_sources,
        refine=refine,
        progress=part(progress, 0.0, 0.95),
    )
    values_alone = [None if a is not None else v for a, v in zip(fit.answers, values, strict=True)]
    rest = _answers(campaign, measurements, priors, values_alone, refine, part(progress, 0.95, 1.0))
    answers = tuple(r if a is None else a for a, r in zip(fit.answers, rest, strict=True))
    found = band_directivities(directivity_parameters, fit.directed, answers)
    return BandFits(answers, fit.geometry, fit.findings, found)


def _energies_alone(
    campaign: Campaign,
    measurements: Measurements,
    task: EnergyTask,
    values: tuple[RoomValuesProblem | None, ...],
    directivity_parameters: DirectivityParameters | None,
    tested_sources: DirectivityParameters | None,
    refine: Refine | None,
    progress: Progress | None,
) -> BandFits:
    """Fit window energies and room parameters, no pressures."""
    directivities = directed_energies(task, directivity_parameters)
    doubts: dict[int, DirectivityScore] = {}
    answers = _answers(
        *(
            campaign,
            measurements,
            task.priors,
            _joined(energy_problems(task, directivities), values),
        ),
        refine,
        progress,
        None if tested_sources is None else score_sources(task, tested_sources, doubts),
        shared_error_covariance(task),
    )
    findings = source_findings(tested_sources, doubts)
    return BandFits(
        answers, None, findings, band_directivities(directivity_parameters, directivities, answers)
    )


def _value_problems(
    campaign: Campaign,
    measurements: Measurements,
    priors: tuple[MaterialPrior, ...],
    binned: BinnedPaths,
    start: FloatArray,
) -> tuple[RoomValuesProblem | None, ...]:
    if not measurements.values:
        return (None,) * len(campaign.bands)
    return value_problems(
        measurements.scene, campaign.bands, priors, measurements.values, binned, start
    )


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


def _answers(
    campaign: Campaign,
    measurements: Measurements,
    priors: tuple[MaterialPrior, ...],
    problems: Iterator[BandProblem | None] | list[RoomValuesProblem | None],
    refine: Refine | None,
    progress: Progress | None,
    watch: Callable[[int, BandProblem, BandFit], None] | None = None,
    shared_covariance: SharedCovariance | None = None,
) -> tuple[BandAnswer, ...]:
    areas = material_areas_m2(measurements.scene.room)
    return fit_bands(
        *(problems, priors, areas, campaign.method, campaign.seed, progress),
        watch=watch,
        shared_covariance=shared_covariance,
        refine=refine,
    )
