"""Every band fitted with partly coherent image sources, the geometry along with it.

Energies are fitted first; they suffice to find outliers and to equalise the magnitude responses of
the sources in all but the lowest bands. Then bands are fitted by pressures from low to high: a low
band is coherent in spite of centimetres of position error and determines positions well enough for
the next one to be coherent, too. Where they move, image sources are found anew. Last, every band is
fitted once more under what all the others determine of the geometry. What is fixed is fitted as
well, for comparison only.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from roomfit.air import attenuation_per_m
from roomfit.bands import Bands
from roomfit.findings import Finding
from roomfit.inversion.bands import affordable_certificate
from roomfit.inversion.directivity import (
    directivities_under_cavity_priors,
    directivity_score,
    moved_start,
    source_findings,
)
from roomfit.inversion.equalise import SCHROEDER_FACTOR, equalise_sources
from roomfit.inversion.geometry_checks import (
    delay_findings,
    estimate_position_sd_scale,
    geometry_findings,
    inflate_position_sds,
    position_consistency_findings,
    position_uncertainty_findings,
)
from roomfit.inversion.outliers import (
    LEAST_BY_ENERGIES,
    LEAST_BY_PRESSURES,
    BandComparison,
    outlier_files,
    outlier_findings,
    variance_inflation,
)
from roomfit.inversion.paths import Retrace, TracedPaths
from roomfit.inversion.sequential import (
    CoherentBand,
    CoherentBandFit,
    CoherentOptions,
    PartFactory,
    band_likelihoods,
    forward_pass,
    joined,
    leave_one_out_pass,
)
from roomfit.inversion.systematics import (
    air_error,
    shared_steps,
    with_both_intervals,
    with_tracing_noise,
)
from roomfit.materials.priors import MaterialPrior
from roomfit.measurement import MeasuredPair
from roomfit.objective.coherent import (
    FittedGeometry,
    campaign_geometry,
    coherent_problem,
    cut_at,
    fitted_geometry,
    moved_scene,
)
from roomfit.objective.directivity import (
    BandDirectivities,
    DirectivityParameters,
    directed_band,
    with_directivity_unknown,
    with_unknown,
)
from roomfit.objective.energy import EnergyProblem
from roomfit.objective.observation import band_problems, has_data_in_band
from roomfit.objective.parameters import physical_values
from roomfit.objective.problem import BandProblem
from roomfit.response.binned import BinnedPaths, paths_at
from roomfit.scene import Scene, material_areas_m2
from roomfit.solvers.least_squares import (
    BandFit,
    few_gauss_newton_steps,
    fit_band,
    gauss_newton,
    score_band,
)
from roomfit.tracing.paths import Paths
from roomfit.typing import FloatArray, Progress, part
from roomfit.uncertainty.gaussian import BandEstimate, FittedBand, add_covariance, band_estimate

# Shortest window in units of 1 / B: finer ones than energies need tell of phases.
_WINDOW_PERIODS = 0.75


@dataclass(frozen=True, slots=True, eq=False)
class CoherentTask:
    """What stays the same while paths are traced anew.

    `directivity_parameters` are the sources whose directivity is fitted, `tested_sources` those
    that are taken for omnidirectional. `outliers` says how many times worse than others pressures
    explain a file.
    """

    scene: Scene
    bands: Bands
    priors: tuple[MaterialPrior, ...]
    measured: tuple[MeasuredPair, ...]
    start: FloatArray
    settings: CoherentOptions
    parts: Sequence[tuple[PartFactory, ...]]
    directivity_parameters: DirectivityParameters | None = None
    tested_sources: DirectivityParameters | None = None
    outliers: Mapping[MeasuredPair, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class _Energies:
    """The energies of one band and their fit."""

    problem: EnergyProblem
    factor: FloatArray
    parts: tuple[PartFactory, ...]
    directed: BandDirectivities | None
    fit: BandFit

    def whole(self) -> BandProblem:
        return joined(
            with_directivity_unknown(self.problem, self.directed), self.factor, self.parts
        )


def files_of_band(task: CoherentTask, band: int) -> tuple[MeasuredPair, ...]:
    """Return the measurements of a band's observations, in their order."""
    return tuple(m for m in task.measured if has_data_in_band(m, band))


def sources_of_band(task: CoherentTask, band: int) -> tuple[int, ...]:
    """Return the source of each of a band's observations."""
    return tuple(int(task.scene.pairs[m.pair][0]) for m in files_of_band(task, band))


def _energies_alone(
    state: SequentialState, files: Sequence[tuple[MeasuredPair, ...]]
) -> list[_Energies | None]:
    """Fit the energies of every band by themselves, in the windows that pressures need."""
    task = state.task
    problems = band_problems(
        task.scene,
        task.bands,
        task.priors,
        task.measured,
        state.binned,
        task.start,
        periods=_WINDOW_PERIODS,
    )
    out: list[_Energies | None] = []
    for problem, parts, observed in zip(problems, task.parts, files, strict=True):
        if problem is None:
            out.append(None)
            continue
        directivity = None
        if task.directivity_parameters is not None:
            directivity = directed_band(
                task.directivity_parameters, task.scene, state.paths, problem, observed
            )
            problem = with_unknown(problem, directivity.unknown)
        factor = np.ones(problem.measured().size)
        whole = joined(with_directivity_unknown(problem, directivity), factor, parts)
        fit = fit_band(whole, gauss_newton, few_gauss_newton_steps)
        out.append(_Energies(problem, factor, parts, directivity, fit))
    return out


def _fitted(own: _Energies) -> _Energies:
    return replace(own, fit=fit_band(own.whole(), gauss_newton, few_gauss_newton_steps))


def _under_cavity_priors(
    task: CoherentTask, energies: list[_Energies | None]
) -> list[_Energies | None]:
    """Fit the energies again under what other bands say of the directivity, where it is unknown."""
    if task.directivity_parameters is None:
        return energies
    directivities = directivities_under_cavity_priors(
        task.directivity_parameters,
        task.bands,
        [None if e is None else e.directed for e in energies],
        [None if e is None else e.fit for e in energies],
    )
    out: list[_Energies | None] = []
    for own, directivity in zip(energies, directivities, strict=True):
        if own is None or own.directed is None or directivity is None:
            out.append(own)
            continue
        start = moved_start(own.fit, own.directed.unknown, directivity.unknown)
        problem = with_unknown(own.problem, directivity.unknown)
        own = replace(own, problem=problem, directed=directivity)
        out.append(replace(own, fit=score_band(own.whole(), start)))
    return out


def first_absorption(task: CoherentTask, prepared: tuple[CoherentBand | None, ...]) -> FloatArray:
    """Return absorption by energies alone, or else the start, shape (n_materials, n_bands)."""
    out = np.tile(task.start, (len(task.priors), 1))
    for i, band in enumerate(prepared):
        if band is not None:
            parameters = band.energies.parameters
            values, _ = physical_values(parameters, band.energy_fit.vector)
            out[:, i] = values["absorption"]
    return out


def absorption_so_far(guess: FloatArray, fits: Sequence[CoherentBandFit | None]) -> FloatArray:
    """Return a guess with the absorption of the bands that pressures have determined so far.

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


# Bands up to here determine positions within a few millimetres, in spite of hidden images.
_RETRACE_BELOW_HZ = 1000.0
# Bands up to here are those in which a first guess of the walls does not determine the magnitude
# response of a loudspeaker.
_RETRACE_ENERGIES_BELOW_HZ = 250.0


@dataclass(frozen=True, slots=True, eq=False)
class SequentialState:
    """A task, its paths, and its bands made ready."""

    # with the measurements as sources of a flat magnitude response would have given them
    task: CoherentTask
    paths: Paths
    weights: FloatArray | None  # (n_bands, n_paths)
    binned: BinnedPaths
    # free numbers of the geometry for which the paths were traced; None for those specified
    origin: FloatArray | None
    bands: tuple[CoherentBand | None, ...]
    findings: tuple[Finding, ...]


def initialise(
    task: CoherentTask,
    paths: Paths,
    weights: FloatArray | None,
    binned: BinnedPaths,
    retrace: Retrace | None,
) -> SequentialState:
    """Return the bands ready to be fitted.

    Parameters
    ----------
    paths, weights, binned
        As for `fit_coherent`.
    retrace : callable or None
        Traces a scene with other positions.
    """
    state = rebuild(SequentialState(task, paths, weights, binned, None, (), ()))
    settings, measured = task.settings, task.measured
    if settings.model == "energy":
        return state
    coloured = False
    if task.directivity_parameters is None:
        even = _even(state, measured, first_absorption(task, state.bands), SCHROEDER_FACTOR)
        coloured = any(new is not old for new, old in zip(even, measured, strict=True))
        if coloured:
            state = rebuild(replace(state, task=replace(task, measured=even)))
    moves = retrace is not None and settings.positions == "fit"
    if not (moves or coloured):
        return state
    fits = _first_fits(state, _RETRACE_BELOW_HZ if moves else _RETRACE_ENERGIES_BELOW_HZ)
    guess = absorption_so_far(first_absorption(state.task, state.bands), fits)
    if retrace is not None and moves:
        state = _moved(state, fits, retrace)
    if coloured:
        even = _even(state, measured, guess, 0.0)
        state = replace(state, task=replace(state.task, measured=even))
    return rebuild(state)


def rebuild(state: SequentialState) -> SequentialState:
    """Return the same task and paths with bands made anew.

    The energies of every band are fitted, outliers found, and the coherent problems made.
    """
    task = state.task
    scene, bands = task.scene, task.bands
    files = [files_of_band(task, b) for b in range(len(bands))]
    energies = _energies_alone(state, files)
    comparisons = [
        BandComparison(e.problem, e.fit, own, e.factor)
        for e, own in zip(energies, files, strict=True)
        if e is not None
    ]
    # what pressures say of a file later knows more
    outliers = {**outlier_files(comparisons, LEAST_BY_ENERGIES), **task.outliers}
    if outliers:
        energies = [
            e
            if e is None
            else _fitted(replace(e, factor=variance_inflation(e.problem, own, outliers)))
            for e, own in zip(energies, files, strict=True)
        ]
    energies = _under_cavity_priors(task, energies)
    attenuation = attenuation_per_m(scene.air, bands)
    # every band has the same unknowns of geometry, in whichever files it hears
    fitted = tuple(m for m in task.measured if m.measurement.use == "fit")
    whole = campaign_geometry(
        scene,
        task.priors,
        fitted,
        positions=task.settings.positions == "fit",
        delays=task.settings.delays,
        speed_sd=task.settings.speed_sd,
    )
    whole = replace(whole, origin=state.origin)
    out: list[CoherentBand | None] = []
    for b, own in enumerate(energies):
        if own is None:
            out.append(None)
            continue
        rows = [i for i, m in enumerate(fitted) if m in files[b]]
        geometry = replace(whole, columns=whole.columns[rows])
        coherent = coherent_problem(
            bands,
            b,
            own.problem,
            float(attenuation[b]),
            paths_at(state.paths, state.weights, b),
            state.binned,
            geometry,
            task.settings.end_s,
        )
        out.append(
            CoherentBand(own.problem, own.fit, own.factor, coherent, own.parts, own.directed)
        )
    findings = outlier_findings(task.measured, outliers)
    return replace(state, bands=tuple(out), findings=findings)


def _even(
    state: SequentialState,
    measured: tuple[MeasuredPair, ...],
    absorption: FloatArray,
    schroeder_factor: float,
) -> tuple[MeasuredPair, ...]:
    task = state.task
    return equalise_sources(
        task.scene, task.bands, measured, state.paths, absorption, schroeder_factor=schroeder_factor
    )


def _first_fits(state: SequentialState, highest_hz: float) -> list[CoherentBandFit | None]:
    """Return fits of the bands up to a frequency, None for the others."""
    low = tuple(
        band if f <= highest_hz else None
        for band, f in zip(state.bands, state.task.bands.centres_hz, strict=True)
    )
    return forward_pass(low, state.task.settings, None)[0]


def _moved(
    state: SequentialState, fits: Sequence[CoherentBandFit | None], retrace: Retrace
) -> SequentialState:
    """Return paths traced at the positions that the lower bands tell."""
    known = [f.found for f in fits if f is not None and f.found is not None]
    geometry = next((b.problem.geometry for b in state.bands if b is not None), None)
    if not known or geometry is None:
        return state
    place, origin = moved_scene(state.task.scene, geometry, known[-1].mean)
    paths, weights, binned = retrace(place)
    binned = cut_at(binned, state.task.settings.late_end_s)
    return replace(state, paths=paths, weights=weights, binned=binned, origin=origin)


def fixed_parameter_checks(
    state: SequentialState, fits: Sequence[CoherentBandFit | None]
) -> tuple[Finding, ...]:
    """Return findings where the data are far likelier when what is fixed is fitted.

    Parameters
    ----------
    state : SequentialState
    fits : sequence of CoherentBandFit or None, one a band
        Of its bands, with nothing set free.
    """
    settings = state.task.settings
    if settings.model == "energy":
        return ()
    findings: tuple[Finding, ...] = ()
    if not settings.delays:
        freed, _ = _freed(state, replace(settings, delays=True))
        findings = delay_findings(_gain(fits, freed))
    if settings.positions == "fixed":
        freed, freer = _freed(state, replace(settings, positions="fit"))
        n = _n_unknowns(freer) - _n_unknowns(state)
        n_windows = sum(f.fit.expected.size for f in fits if f is not None)
        findings = (*findings, *position_consistency_findings(_gain(fits, freed), n, n_windows))
    return findings


def _freed(
    state: SequentialState, settings: CoherentOptions
) -> tuple[Sequence[CoherentBandFit | None], SequentialState]:
    """Return the fits of all bands with more unknowns, and the bands that were fitted."""
    freer = rebuild(replace(state, task=replace(state.task, settings=settings)))
    return forward_pass(freer.bands, settings, None)[0], freer


def _gain(
    fixed: Sequence[CoherentBandFit | None], freed: Sequence[CoherentBandFit | None]
) -> float:
    """Return by how much the data are likelier, over all bands."""
    pairs = zip(fixed, freed, strict=True)
    return sum(b.log_likelihood - a.log_likelihood for a, b in pairs if a and b)


def _n_unknowns(state: SequentialState) -> int:
    """Return how many coordinates, times and delays are fitted."""
    geometry = next((b.problem.geometry for b in state.bands if b is not None), None)
    if geometry is None:
        return 0
    return int(np.count_nonzero(geometry.fitted & (geometry.sd > 0.0)))


# Log-likelihoods nearer than this do not decide between two models.
_UNDECIDED = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class CoherentFit:
    """Every band fitted with partly coherent image sources, and what was found on the way."""

    state: SequentialState
    fits: tuple[CoherentBandFit | None, ...]  # None where too few windows rise above the noise
    # of the energy model and of the partly coherent one; NaN where not tried; (n_bands, 2)
    log_likelihoods: FloatArray
    geometry: FittedGeometry | None  # None where no band was coherent
    findings: tuple[Finding, ...]


def fit_coherent(
    task: CoherentTask, traced: TracedPaths, progress: Progress | None = None
) -> CoherentFit:
    """Fit every band with image sources as coherent as their times are known.

    Which images a receiver sees depends on where it stands, except in a box: elsewhere the bands
    up to 1 kHz are fitted first, images are found anew at the positions they tell, and everything
    is fitted again from the specified prior.

    Parameters
    ----------
    task : CoherentTask
    traced : TracedPaths
        Of all pairs: image sources, the further the better, and rays for what they leave.
    """
    settings = task.settings
    state = initialise(
        task,
        traced.paths,
        traced.factors,
        cut_at(traced.binned, settings.late_end_s),
        traced.again,
    )
    fits, chosen_noise = forward_pass(state.bands, settings, part(progress, 0.0, 0.8))
    outliers = outlier_files(_band_comparisons(state, fits), LEAST_BY_PRESSURES)
    if outliers:
        state = rebuild(replace(state, task=replace(state.task, outliers=outliers)))
        fits, chosen_noise = forward_pass(state.bands, settings, part(progress, 0.8, 1.0))
    position_sd_scale = estimate_position_sd_scale(state.task.scene, state.bands, fits)
    if position_sd_scale > 1.0:
        place, origin = inflate_position_sds(state.task.scene, state.origin, position_sd_scale)
        state = rebuild(replace(state, task=replace(state.task, scene=place), origin=origin))
        fits, chosen_noise = forward_pass(state.bands, settings, part(progress, 0.8, 1.0))
    findings = (*state.findings, *position_uncertainty_findings(position_sd_scale))
    findings = (*findings, *fixed_parameter_checks(state, fits))
    fits, final = leave_one_out_pass(state.bands, fits, chosen_noise, settings)
    geometry = next((b.problem.geometry for b in state.bands if b is not None), None)
    estimate = None if geometry is None or final is None else fitted_geometry(geometry, final)
    findings = (*findings, *_source_findings(state), *geometry_findings(estimate))
    return CoherentFit(state, tuple(fits), band_likelihoods(state.bands, fits), estimate, findings)


def _band_comparisons(
    state: SequentialState, fits: Sequence[CoherentBandFit | None]
) -> list[BandComparison]:
    """Return what pressures explain, band by band, for the search of outliers."""
    return [
        BandComparison(band.energies, fit.fit, files_of_band(state.task, i), band.factor)
        for i, (band, fit) in enumerate(zip(state.bands, fits, strict=True))
        if band is not None and fit is not None
    ]


def _source_findings(state: SequentialState) -> tuple[Finding, ...]:
    """Return a finding where a source taken for omnidirectional is none."""
    task, doubts = state.task, {}
    for i, band in enumerate(state.bands):
        if band is not None and task.tested_sources is not None:
            observed = files_of_band(task, i)
            directivity = directed_band(
                task.tested_sources, task.scene, state.paths, band.energies, observed
            )
            doubts[i] = directivity_score(band.energies, band.energy_fit, directivity, band.factor)
    return source_findings(task.tested_sources, doubts)


def coherent_estimates(fit: CoherentFit) -> Iterator[FittedBand | None]:
    """Give what pressures say of each band, with the errors that windows share.

    Without fit and problem where energies explain the band better: its intervals are of no use.
    """
    state, task = fit.state, fit.state.task
    areas_m2 = material_areas_m2(task.scene.room)
    each = zip(state.bands, fit.fits, fit.log_likelihoods, strict=True)
    for number, (band, found, likelihoods) in enumerate(each):
        if band is None or found is None:
            yield None
            continue
        sources = sources_of_band(task, number)
        noisy = with_tracing_noise(found.problem, band.energies, sources, found.fit)
        air = air_error(task.scene.air, task.bands, number, band.energies)
        steps = shared_steps(found.problem, found.fit, band.energies, air, band)
        noisy = add_covariance(noisy, steps)
        own = band_estimate(found.parameters, noisy, areas_m2, "coherent")
        beaten = task.settings.model != "coherent" and likelihoods[0] - likelihoods[1] >= _UNDECIDED
        yield FittedBand(own) if beaten else FittedBand(own, found.problem, found.fit)


def energy_estimates(fit: CoherentFit) -> Iterator[FittedBand | None]:
    """Give what energies alone say of each band, in the windows whose noise is known to suit them.

    None where the partly coherent model decides, or where there are no data.
    """
    state, task = fit.state, fit.state.task
    areas_m2 = material_areas_m2(task.scene.room)
    wanted = [
        _needs_energy_fit(f, x, task.settings)
        for f, x in zip(fit.fits, fit.log_likelihoods, strict=True)
    ]
    if not any(wanted):
        yield from [None] * len(wanted)
        return
    problems = band_problems(
        task.scene, task.bands, task.priors, task.measured, state.binned, task.start
    )
    bands = zip(
        (p if wants else None for p, wants in zip(problems, wanted, strict=True)),
        state.bands,
        task.parts,
        strict=True,
    )
    for number, (problem, band, own) in enumerate(bands):
        if problem is None:
            yield None
            continue
        factor = np.ones(problem.measured().size)
        if band is not None:
            # as for the finer windows: one factor an observation
            fine = [o.energy.size for o in band.energies.observations]
            first = np.cumsum([0, *fine[:-1]])
            sizes = [o.energy.size for o in problem.observations]
            factor = np.repeat(band.factor[first], sizes)
        directivity = None if band is None else band.directed
        if directivity is not None and task.directivity_parameters is not None:
            # other windows may hear other rows
            observed = files_of_band(task, number)
            rows = directed_band(
                task.directivity_parameters, task.scene, state.paths, problem, observed
            )
            directivity = replace(rows, unknown=directivity.unknown)
            problem = with_unknown(problem, directivity.unknown)
        whole = joined(with_directivity_unknown(problem, directivity), factor, own)
        own_fit = fit_band(whole, gauss_newton, few_gauss_newton_steps)
        noisy = with_tracing_noise(whole, problem, sources_of_band(task, number), own_fit)
        air = air_error(task.scene.air, task.bands, number, problem)
        steps = shared_steps(whole, own_fit, problem, air)
        noisy = add_covariance(noisy, steps)
        answer = band_estimate(problem.parameters, noisy, areas_m2, "energy")
        yield FittedBand(answer, whole, own_fit)


def decided(
    fit: CoherentFit,
    energy: Sequence[BandEstimate | None],
    coherent: Sequence[BandEstimate | None],
) -> tuple[BandEstimate | None, ...]:
    """Return each band's estimate by the model that explains it better, None without data.

    With what is proven of its energies alone, where that is affordable.
    """
    task = fit.state.task
    chosen = [
        _decided(*each, task.settings)
        for each in zip(energy, coherent, fit.log_likelihoods, strict=True)
    ]
    if task.settings.model != "auto":
        return tuple(chosen)
    return tuple(_certified(*each) for each in zip(chosen, fit.state.bands, strict=True))


def _certified(answer: BandEstimate | None, band: CoherentBand | None) -> BandEstimate | None:
    """Return an estimate with what is proven of its energies alone, where that is affordable."""
    # a proof would be of other costs where variances are inflated, or data of other kinds joined
    if answer is None or band is None or band.parts or np.any(band.factor != 1.0):
        return answer
    proof = affordable_certificate(band.energies, band.energy_fit.vector)
    return replace(answer, certificate=proof)


def _needs_energy_fit(
    fit: CoherentBandFit | None, likelihoods: FloatArray, settings: CoherentOptions
) -> bool:
    """Whether the energy model's answer of a band may be needed."""
    if fit is None:
        return True
    return settings.model != "coherent" and bool(likelihoods[1] - likelihoods[0] < _UNDECIDED)


def _decided(
    energy: BandEstimate | None,
    coherent: BandEstimate | None,
    likelihoods: FloatArray,
    settings: CoherentOptions,
) -> BandEstimate | None:
    """Return the likelier answer; with both intervals where the likelihood cannot decide."""
    if coherent is None:
        return energy
    if energy is None or settings.model == "coherent":
        return coherent
    better = likelihoods[1] - likelihoods[0]
    best, other = (coherent, energy) if better > 0.0 else (energy, coherent)
    return best if abs(better) >= _UNDECIDED else with_both_intervals(best, other)
