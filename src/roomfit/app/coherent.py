"""Every band of a campaign fitted with partly coherent image sources, the geometry along with it.

Bands go from low to high: a low band is coherent in spite of centimetres of error and tells where
everything stands, so that the next one may be coherent, too. Then every band is fitted once more
under what all the others have found.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from roomfit.air import attenuation_per_m
from roomfit.app.coherent_answers import widened_by_neighbours, with_both_intervals
from roomfit.app.coherent_problems import (
    SPEED_SD,
    campaign_geometry,
    coherent_problem,
    cut_at,
    moved_scene,
)
from roomfit.app.coherent_spoiled import spoiled_files
from roomfit.app.fitting import BandAnswer, band_answer
from roomfit.app.measuring import MeasuredPair
from roomfit.app.problems import BinnedPaths, band_problems, paths_at, tells_of_band
from roomfit.bands import Bands
from roomfit.findings import Finding
from roomfit.identification.coherence_rounds import (
    CoherentBandFit,
    fit_in_rounds,
    geometry_information,
    without_band,
)
from roomfit.identification.reweighted import BandFit, fit_band
from roomfit.identification.scoring import Marginal
from roomfit.identification.solvers import gauss_newton
from roomfit.materials.knowledge import MaterialKnowledge
from roomfit.objective.coherent_geometry import GEOMETRY, Geometry, whole_covariance
from roomfit.objective.coherent_problem import CoherentProblem, with_coherence
from roomfit.objective.energy_problem import EnergyProblem
from roomfit.objective.parameters import JointPrior, Parameters, prior_residuals
from roomfit.objective.problem import BandProblem, JointProblem
from roomfit.objective.softened import SoftenedProblem
from roomfit.scene.room import material_areas_m2
from roomfit.scene.scene import Scene
from roomfit.tracing.paths import Paths
from roomfit.typing import FloatArray, Progress
from roomfit.uncertainty.answer import FittedGeometry

# Later windows tell little more and need many more images.
FIT_END_S = 0.2
# Shortest window in units of 1 / B: finer ones than energies need tell of phases.
_WINDOW_PERIODS = 0.75
# Bands up to here tell positions to a few millimetres, in spite of images that are not seen.
_RETRACE_BELOW_HZ = 1000.0
# Log-likelihoods nearer than this do not decide between two models.
_UNDECIDED = 2.0
# Error of the model, ringing, and random phase of a reflection, from good to bad.
_NOISES = ((0.1, 0.0, 0.0), (0.2, 0.1, 0.0), (0.2, 0.1, 0.5), (0.4, 0.2, 0.5))


@dataclass(frozen=True, slots=True)
class CoherentOptions:
    """What a fit may vary.

    Attributes
    ----------
    positions : {"fit", "fixed"}
        Whether places, speed of sound and latencies move within their spread.
    delays : bool
        Whether walls may delay what they reflect.
    model : {"auto", "coherent", "energy"}
        "auto" leaves it to the likelihood of each band.
    end_s : float
        Where the last window ends at the latest, after emission.
    speed_sd : float
        Relative standard deviation of the speed of sound beforehand.
    """

    positions: Literal["fit", "fixed"] = "fit"
    delays: bool = True
    model: Literal["auto", "coherent", "energy"] = "auto"
    end_s: float = FIT_END_S
    speed_sd: float = SPEED_SD


@dataclass(frozen=True, slots=True, eq=False)
class CoherentFit:
    """The answer of every band.

    Attributes
    ----------
    answers : tuple of BandAnswer or None, one a band
        None where too few windows rise above the noise.
    log_likelihoods : float array, shape (n_bands, 2)
        Of the energy model and of the partly coherent one; NaN where not tried.
    geometry : FittedGeometry or None
        None where no band was coherent.
    findings : tuple of Finding
    """

    answers: tuple[BandAnswer | None, ...]
    log_likelihoods: FloatArray
    geometry: FittedGeometry | None
    findings: tuple[Finding, ...]


PartFactory = Callable[[Parameters], BandProblem]
"""Makes another kind of data of a band from the unknowns that all kinds share."""

Retrace = Callable[[Scene], tuple[Paths, FloatArray | None, BinnedPaths]]
"""Traces a scene whose positions have moved: paths, their factors in each band, the same binned."""


@dataclass(frozen=True, slots=True, eq=False)
class _Band:
    """One band on its way: what the energies say, and the problem in every setting of noise."""

    energies: EnergyProblem
    energy_fit: BandFit
    factor: FloatArray
    problem: CoherentProblem
    parts: tuple[PartFactory, ...]

    def with_noise(self, model: float, ringing: float) -> _Band:
        changed = replace(self.problem.energies, model_error=model, ringing_error=ringing)
        return replace(self, problem=replace(self.problem, energies=changed))

    def after(self, joint: JointPrior | None) -> _Band:
        blocks = self.problem.parameters.blocks
        return replace(self, problem=replace(self.problem, parameters=Parameters(blocks, joint)))

    def at(self, covariance: FloatArray | None, phase_sd: float) -> BandProblem:
        """Return the whole problem with the coherence of a covariance of the fitted geometry."""
        joint = self.problem.parameters.joint
        if covariance is None and joint is not None:
            covariance = np.asarray(np.linalg.inv(joint.information))
        own = with_coherence(
            self.problem, whole_covariance(self.problem.geometry, covariance), phase_sd
        )
        return joined(own, self.factor, self.parts)


def joined(problem: BandProblem, factor: FloatArray, parts: Sequence[PartFactory]) -> BandProblem:
    """Return a problem softened by a factor a datum, with other kinds of data joined to it."""
    softened: BandProblem = problem
    if np.any(factor != 1.0):
        softened = SoftenedProblem(problem, factor)
    if not parts:
        return softened
    return JointProblem((softened, *(make(problem.parameters) for make in parts)))


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    """What stays the same while paths are traced anew."""

    scene: Scene
    bands: Bands
    knowledge: tuple[MaterialKnowledge, ...]
    measured: tuple[MeasuredPair, ...]
    start: FloatArray
    settings: CoherentOptions
    parts: Sequence[tuple[PartFactory, ...]]


def fit_coherent(
    scene: Scene,
    bands: Bands,
    knowledge: tuple[MaterialKnowledge, ...],
    measured: tuple[MeasuredPair, ...],
    paths: Paths,
    binned: BinnedPaths,
    start: FloatArray,
    *,
    options: CoherentOptions | None = None,
    extra_parts: Sequence[tuple[PartFactory, ...]] = (),
    weights: FloatArray | None = None,
    retrace: Retrace | None = None,
    progress: Progress | None = None,
) -> CoherentFit:
    """Fit every band with image sources as coherent as their times are known.

    Parameters
    ----------
    paths : Paths
        Of all pairs: image sources, the further the better, and rays for what they leave.
    binned : BinnedPaths
        The same paths in bins (`bin_paths`).
    start : float array, shape (n_bands,)
        Uniform absorption to start from.
    options : CoherentOptions, optional
    extra_parts : sequence of tuples, one a band; optional
        Other kinds of data of each band, made from the unknowns that all kinds share.
    weights : float array, shape (n_bands, n_paths), optional
        Factor of every path's weight in each band, as in `binned`.
    retrace : callable, optional
        Traces a scene with other positions, as `paths` were. Which images a receiver sees
        depends on where it stands, except in a box: there the bands up to 1 kHz are fitted first,
        images are found anew at the positions they tell, and everything is fitted again from what
        was told.
    """
    settings = CoherentOptions() if options is None else options
    parts = tuple(extra_parts) or ((),) * len(bands)
    task = _Task(scene, bands, knowledge, measured, start, settings, parts)
    binned = cut_at(binned, settings.end_s)
    prepared, findings = _prepared(task, paths, weights, binned, None)
    if retrace is not None and settings.positions == "fit" and settings.model != "energy":
        moved = _moved(task, prepared)
        if moved is not None:
            place, origin = moved
            paths, weights, binned = retrace(place)
            binned = cut_at(binned, settings.end_s)
            prepared, findings = _prepared(task, paths, weights, binned, origin)
    fits, chosen_noise = _upwards(prepared, settings, progress)
    fits, final = _once_more(prepared, fits, chosen_noise, settings)
    likelihoods = _log_likelihoods(prepared, fits)
    answers = _answers(task, binned, prepared, fits, likelihoods)
    geometry = next((b.problem.geometry for b in prepared if b is not None), None)
    told = None if geometry is None or final is None else _fitted_geometry(geometry, final)
    return CoherentFit(answers, likelihoods, told, (*findings, *_findings(told)))


def _answers(
    task: _Task,
    binned: BinnedPaths,
    prepared: tuple[_Band | None, ...],
    fits: Sequence[CoherentBandFit | None],
    likelihoods: FloatArray,
) -> tuple[BandAnswer | None, ...]:
    """Return each band's answer by the model that explains it better."""
    areas = material_areas_m2(task.scene.room)
    coherent = tuple(
        None if f is None else band_answer(f.parameters, f.fit, areas, "coherent") for f in fits
    )
    coherent = widened_by_neighbours(coherent, areas)
    energy: Sequence[BandAnswer | None] = (None,) * len(task.bands)
    if any(_asks_energies(f, x, task.settings) for f, x in zip(fits, likelihoods, strict=True)):
        coarse = band_problems(
            *(task.scene, task.bands, task.knowledge, task.measured, binned, task.start)
        )
        energy = _energy_answers(coarse, prepared, task.parts, areas)
    return tuple(
        _decided(*each, task.settings) for each in zip(energy, coherent, likelihoods, strict=True)
    )


def _moved(task: _Task, prepared: tuple[_Band | None, ...]) -> tuple[Scene, FloatArray] | None:
    """Return the scene at the positions that the lower bands tell, and these as free numbers."""
    low = tuple(
        b
        for b, f in zip(prepared, task.bands.centres_hz, strict=True)
        if b is not None and f <= _RETRACE_BELOW_HZ
    )
    if not low:
        return None
    fits, _ = _upwards(low, task.settings, None)
    known = [f.found for f in fits if f is not None and f.found is not None]
    if not known:
        return None
    return moved_scene(task.scene, low[0].problem.geometry, known[-1].mean)


def _prepared(
    task: _Task,
    paths: Paths,
    weights: FloatArray | None,
    binned: BinnedPaths,
    origin: FloatArray | None,
) -> tuple[tuple[_Band | None, ...], tuple[Finding, ...]]:
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
    out: list[_Band | None] = []
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
            *(binned, geometry, None),
        )
        out.append(_Band(problem, fit, factors[b], coherent, parts[b]))
    return tuple(out), findings


def _fit_energies(
    problem: EnergyProblem | None, factor: FloatArray, parts: tuple[PartFactory, ...]
) -> BandFit | None:
    if problem is None:
        return None
    return fit_band(joined(problem, factor, parts), gauss_newton, gauss_newton)


def _upwards(
    prepared: tuple[_Band | None, ...], settings: CoherentOptions, progress: Progress | None
) -> tuple[list[CoherentBandFit | None], list[tuple[float, float, float]]]:
    """Fit the bands from low to high, each under what the lower ones say of the geometry."""
    fits: list[CoherentBandFit | None] = []
    noises: list[tuple[float, float, float]] = []
    known: Marginal | None = None
    for i, band in enumerate(prepared):
        noises.append(_NOISES[0])
        if band is None or settings.model == "energy":
            fits.append(None)
            continue
        joint = None if known is None else JointPrior(GEOMETRY, known.mean, known.information)
        fit, noises[-1] = _with_best_noise(band.after(joint), known)
        fits.append(fit)
        trusted = settings.model == "coherent" or _advantage(band, fit) > 0.0
        known = fit.found if trusted else known
        if progress is not None:
            progress((i + 1) / len(prepared))
    return fits, noises


def _with_best_noise(
    band: _Band, known: Marginal | None
) -> tuple[CoherentBandFit, tuple[float, float, float]]:
    """Return the fit with the error of the model that the likelihood prefers.

    Larger errors are tried only while the data scatter more than the model says.
    """
    best: tuple[CoherentBandFit, tuple[float, float, float]] | None = None
    for noise in _NOISES:
        model, ringing, phase_sd = noise
        own = band.with_noise(model, ringing)
        start = _start(own, known) if best is None else best[0].fit.vector
        fit = _rounds(own, start, phase_sd, None)
        if best is not None and fit.log_likelihood <= best[0].log_likelihood:
            break
        best = fit, noise
        if fit.fit.phi <= 1.0:
            break
    assert best is not None  # noqa: S101 - the loop runs at least once
    return best


def _rounds(
    band: _Band, start: FloatArray, phase_sd: float, covariance: FloatArray | None, rounds: int = 2
) -> CoherentBandFit:
    return fit_in_rounds(
        lambda c: band.at(c, phase_sd), start, rounds=rounds, covariance=covariance
    )


def _start(band: _Band, known: Marginal | None) -> FloatArray:
    """Return what the energies say, with the geometry of the bands below."""
    block = next(b for b in band.problem.parameters.blocks if b.name == GEOMETRY)
    geometry = np.zeros(int(block.fitted.sum())) if known is None else known.mean
    return np.concatenate((band.energy_fit.vector, geometry))


def _once_more(
    prepared: tuple[_Band | None, ...],
    fits: list[CoherentBandFit | None],
    noises: list[tuple[float, float, float]],
    settings: CoherentOptions,
) -> tuple[list[CoherentBandFit | None], Marginal | None]:
    """Fit each band again under what all the others say of the geometry."""
    trusted = [
        i
        for i, (band, fit) in enumerate(zip(prepared, fits, strict=True))
        if band is not None
        and fit is not None
        and fit.found is not None
        and (settings.model == "coherent" or _advantage(band, fit) > 0.0)
    ]
    if not trusted:
        return fits, None
    final = fits[trusted[-1]].found  # type: ignore[union-attr]
    assert final is not None  # noqa: S101 - only bands with a found geometry are trusted
    covariance = np.linalg.inv(final.information)
    again = list(fits)
    for i in trusted:
        band, fit = prepared[i], fits[i]
        if band is None or fit is None or fit.found is None:
            continue
        prior = without_band(final, fit.found, geometry_information(fit.parameters))
        model, ringing, phase_sd = noises[i]
        own = band.after(prior).with_noise(model, ringing)
        n = fit.fit.vector.size - final.mean.size
        start = np.concatenate((fit.fit.vector[:n], final.mean))
        again[i] = _rounds(own, start, phase_sd, covariance, rounds=1)
    return again, final


def _advantage(band: _Band, fit: CoherentBandFit) -> float:
    """Return by how much the partly coherent model explains the data better than energies.

    Log-likelihoods of the same windows, the geometry's prior counted against it.
    """
    coherent, energies = _pair_of_likelihoods(band, fit)
    return coherent - energies


def _pair_of_likelihoods(band: _Band, fit: CoherentBandFit) -> tuple[float, float]:
    n = band.energy_fit.vector.size
    prior, rows = prior_residuals(fit.parameters, fit.fit.vector)
    moved = prior[np.any(rows[:, n:] != 0.0, axis=1)]
    energies = joined(band.energies, band.factor, band.parts)
    each = energies.log_likelihood(band.energy_fit.expected, band.energy_fit.variance)
    return fit.log_likelihood - 0.5 * float(moved @ moved), float(each.sum())


def _log_likelihoods(
    prepared: tuple[_Band | None, ...], fits: Sequence[CoherentBandFit | None]
) -> FloatArray:
    out: FloatArray = np.full((len(prepared), 2), np.nan)
    for i, (band, fit) in enumerate(zip(prepared, fits, strict=True)):
        if band is not None and fit is not None:
            out[i] = _pair_of_likelihoods(band, fit)[::-1]
    return out


def _asks_energies(
    fit: CoherentBandFit | None, likelihoods: FloatArray, settings: CoherentOptions
) -> bool:
    """Whether the energy model's answer of a band may be needed."""
    if fit is None:
        return True
    return settings.model != "coherent" and bool(likelihoods[1] - likelihoods[0] < _UNDECIDED)


def _energy_answers(
    problems: Iterable[EnergyProblem | None],
    prepared: tuple[_Band | None, ...],
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
        fit = fit_band(joined(problem, factor, own), gauss_newton, gauss_newton)
        out.append(band_answer(problem.parameters, fit, areas_m2, "energy"))
    return tuple(out)


def _decided(
    energy: BandAnswer | None,
    coherent: BandAnswer | None,
    likelihoods: FloatArray,
    settings: CoherentOptions,
) -> BandAnswer | None:
    """Return the likelier answer; with both intervals where the likelihood cannot decide."""
    if coherent is None:
        return energy
    if energy is None or settings.model == "coherent":
        return coherent
    better = likelihoods[1] - likelihoods[0]
    best, other = (coherent, energy) if better > 0.0 else (energy, coherent)
    return best if abs(better) >= _UNDECIDED else with_both_intervals(best, other)


def _fitted_geometry(geometry: Geometry, final: Marginal) -> FittedGeometry:
    free = np.flatnonzero(geometry.fitted & (geometry.sd > 0.0))
    change, sd = np.zeros(geometry.sd.size), np.array(geometry.sd)
    change[free] = geometry.sd[free] * final.mean
    sd[free] = geometry.sd[free] * np.sqrt(np.diag(np.linalg.inv(final.information)))
    speed = geometry.labels.index("speed of sound")
    c = geometry.speed_m_s * float(np.exp(change[speed]))
    return FittedGeometry(geometry.labels, change, sd, geometry.sd, c)


def _findings(geometry: FittedGeometry | None) -> tuple[Finding, ...]:
    """Return a finding where the fit had to move something farther than was told."""
    if geometry is None:
        return ()
    told = np.where(geometry.told_sd > 0.0, geometry.told_sd, np.inf)
    far = np.flatnonzero(np.abs(geometry.change) / told > 3.5)
    if not far.size:
        return ()
    names = ", ".join(geometry.labels[i] for i in far)
    return (
        Finding(
            "geometry-moved-far",
            "warning",
            f"To explain the arrival times, the fit moved {names} by more than three and a half "
            "times its stated spread: it may be told wrong, or make up for an error of the model.",
            {
                "labels": [geometry.labels[i] for i in far],
                "change": [float(geometry.change[i]) for i in far],
                "told_sd": [float(geometry.told_sd[i]) for i in far],
            },
        ),
    )
