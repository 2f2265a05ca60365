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
    DirectivityDoubt,
    EnergyTask,
    FoundDirectivities,
    band_directivities,
    campaign_directing,
    directed_energies,
    doubting,
    energy_problems,
    omnidirectional,
    source_findings,
)
from roomfit.inversion.measurements import Gathered
from roomfit.inversion.sequential import CoherentOptions
from roomfit.inversion.systematics import air_error, shared_steps, with_tracing_noise
from roomfit.inversion.trace_plan import is_coherent
from roomfit.io.campaign import Campaign
from roomfit.materials.priors import MaterialKnowledge
from roomfit.objective.coherent import SPEED_SD, FittedGeometry
from roomfit.objective.directivity import DirectedProblem, Directing
from roomfit.objective.energy import EnergyProblem
from roomfit.objective.observation import tells_of_band
from roomfit.objective.parameters import Parameters
from roomfit.objective.problem import BandProblem, JointProblem
from roomfit.objective.room_parameters import RoomValuesProblem, value_problems
from roomfit.response.binned import BinnedPaths
from roomfit.scene import material_areas_m2
from roomfit.solvers.least_squares import BandFit
from roomfit.tracing.paths import Paths
from roomfit.typing import FloatArray, Progress, part
from roomfit.uncertainty.gaussian import Allow, BandAnswer, Refine, allowing_for


def allowing_for_shared_errors(task: EnergyTask) -> Allow:
    """Return what makes a band's fit as sure as the errors that its windows share permit.

    Room parameters without responses stay as they are.

    Parameters
    ----------
    task : EnergyTask
    """

    def allow(band: int, problem: BandProblem, fit: BandFit) -> BandFit:
        first = problem.parts[0] if isinstance(problem, JointProblem) else problem
        energies = first.problem if isinstance(first, DirectedProblem) else first
        if not isinstance(energies, EnergyProblem) or not fit.vector.size:
            return fit
        heard = [m for m in task.measured if tells_of_band(m, band)]
        sources = [int(task.scene.pairs[m.pair][0]) for m in heard]
        noisy = with_tracing_noise(problem, energies, sources, fit)
        air = air_error(task.scene.air, task.bands, band, energies)
        return allowing_for(noisy, shared_steps(problem, fit, energies, air))

    return allow


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
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
    told = campaign.temperature_sd_c
    if told is None:
        return SPEED_SD
    return max(0.5 * told / (273.15 + campaign.air.temperature_c), 1e-6)


def solve(
    campaign: Campaign,
    gathered: Gathered,
    knowledge: tuple[MaterialKnowledge, ...],
    paths: Paths,
    weights: FloatArray | None,
    binned: BinnedPaths,
    start: FloatArray,
    far_images: bool,
    fit_until_s: float,
    retrace: Retrace | None,
    refine: Refine | None,
    progress: Progress | None,
) -> Solved:
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
    directing = campaign_directing(campaign, gathered.scene)
    suspects = omnidirectional(campaign, gathered.scene) if directing is None else None
    values = _value_problems(campaign, gathered, knowledge, binned, start)
    if not is_coherent(campaign) or not (far_images or campaign.model == "coherent"):
        task = EnergyTask(
            *(gathered.scene, campaign.bands, knowledge, gathered.responses, paths, binned, start)
        )
        return _energies_alone(
            campaign, gathered, task, values, directing, suspects, refine, progress
        )
    options = CoherentOptions(
        positions="fixed" if campaign.positions == "fixed" else "fit",
        delays=campaign.wall_delays,
        model="coherent" if campaign.model == "coherent" else "auto",
        late_end_s=fit_until_s,
        speed_sd=relative_speed_sd(campaign),
    )
    fit = fit_coherent(
        *(gathered.scene, campaign.bands, knowledge, gathered.responses, paths, binned, start),
        options=options,
        weights=weights,
        retrace=retrace,
        extra_parts=[() if v is None else (_sharing(v),) for v in values],
        directing=directing,
        suspects=suspects,
        refine=refine,
        progress=part(progress, 0.0, 0.95),
    )
    untold = [None if a is not None else v for a, v in zip(fit.answers, values, strict=True)]
    rest = _answers(campaign, gathered, knowledge, untold, refine, part(progress, 0.95, 1.0))
    answers = tuple(r if a is None else a for a, r in zip(fit.answers, rest, strict=True))
    found = band_directivities(directing, fit.directed, answers)
    return Solved(answers, fit.geometry, fit.findings, found)


def _energies_alone(
    campaign: Campaign,
    gathered: Gathered,
    task: EnergyTask,
    values: tuple[RoomValuesProblem | None, ...],
    directing: Directing | None,
    suspects: Directing | None,
    refine: Refine | None,
    progress: Progress | None,
) -> Solved:
    """Fit window energies and room parameters, no pressures."""
    hows = directed_energies(task, directing)
    doubts: dict[int, DirectivityDoubt] = {}
    answers = _answers(
        *(campaign, gathered, task.knowledge, _joined(energy_problems(task, hows), values)),
        refine,
        progress,
        None if suspects is None else doubting(task, suspects, doubts),
        allowing_for_shared_errors(task),
    )
    findings = source_findings(suspects, doubts)
    return Solved(answers, None, findings, band_directivities(directing, hows, answers))


def _value_problems(
    campaign: Campaign,
    gathered: Gathered,
    knowledge: tuple[MaterialKnowledge, ...],
    binned: BinnedPaths,
    start: FloatArray,
) -> tuple[RoomValuesProblem | None, ...]:
    if not gathered.values:
        return (None,) * len(campaign.bands)
    return value_problems(gathered.scene, campaign.bands, knowledge, gathered.values, binned, start)


def _sharing(values: RoomValuesProblem) -> Callable[[Parameters], BandProblem]:
    """Return what makes the same room parameters depend on another problem's unknowns."""
    return lambda parameters: replace(values, parameters=parameters)


def _joined(
    windows: Iterator[BandProblem | None], values: tuple[RoomValuesProblem | None, ...]
) -> Iterator[BandProblem | None]:
    """Make one problem after the other from window energies, room parameters, or both."""
    for heard, told in zip(windows, values, strict=True):
        if heard is None or told is None:
            yield heard or told
        else:
            yield JointProblem((heard, replace(told, parameters=heard.parameters)))


def _answers(
    campaign: Campaign,
    gathered: Gathered,
    knowledge: tuple[MaterialKnowledge, ...],
    problems: Iterator[BandProblem | None] | list[RoomValuesProblem | None],
    refine: Refine | None,
    progress: Progress | None,
    watch: Callable[[int, BandProblem, BandFit], None] | None = None,
    allow: Allow | None = None,
) -> tuple[BandAnswer, ...]:
    areas = material_areas_m2(gathered.scene.room)
    return fit_bands(
        *(problems, knowledge, areas, campaign.method, campaign.seed, progress),
        watch=watch,
        allow=allow,
        refine=refine,
    )
