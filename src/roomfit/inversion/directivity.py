"""Sources taken for omnidirectional that the data contradict.

The vectors b of every band, each under what the other bands say of them.

Energies of every band with the directivity of their sources unknown, or asked about.

What bands say of each other where the same unknowns change smoothly from band to band.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from roomfit.bands import Bands
from roomfit.errors import InputError
from roomfit.findings import Code, Finding
from roomfit.inversion.measurements import Measurements
from roomfit.materials.priors import MaterialPrior
from roomfit.measurement import MeasuredPair
from roomfit.objective.directivity import (
    CORRELATION_PER_OCTAVE,
    DEFAULT_B_SD,
    DIRECTIVITY,
    BandDirectivities,
    DirectivityParameters,
    FittedDirectivity,
    UnknownDirectivities,
    directed,
    directed_band,
    directivity_prior,
    vectors_of,
    with_cavity_prior,
    with_directivity_unknown,
    with_unknown,
)
from roomfit.objective.energy import EnergyProblem
from roomfit.objective.observation import band_problems, has_data_in_band
from roomfit.objective.parameters import Parameters, position_of
from roomfit.objective.problem import BandProblem, InflatedVariance, JointProblem
from roomfit.response.binned import BinnedPaths
from roomfit.response.directivity import UnknownDirectivity
from roomfit.scene import Scene
from roomfit.settings import Settings
from roomfit.solvers.least_squares import (
    BandFit,
    few_gauss_newton_steps,
    fit_band,
    gauss_newton,
    score_band,
)
from roomfit.tracing.paths import Paths
from roomfit.typing import FloatArray
from roomfit.uncertainty.gaussian import BandAnswer

# Three unknowns that explain nothing gain one and a half in log-likelihood on average: more is
# looked at closely.
_BY_CHANCE = 1.5
# A third of it where three windows count as one; 9 are asked for in six bands. Six omnidirectional
# sources in three boxes of another program (benchmarks/other_boxes.py) gained 2 to 4 in all, of six
# with |b| = 0.5 one gained 4, the others 21 to 52.
_A_BAND, _CONTRADICTS = 0.5, 6.0


@dataclass(frozen=True, slots=True, eq=False)
class DirectivityScore:
    """What one band says against omnidirectional sources.

    Attributes
    ----------
    gain : float array, shape (n_sources,)
        By how much the log-likelihood rises if a source may have its own b, the prior of b
        counted against it.
    b : float array, shape (n_sources, 3)
        What it would then have.
    """

    gain: FloatArray
    b: FloatArray


def directivity_score(
    problem: EnergyProblem,
    fit: BandFit,
    directivity: BandDirectivities,
    factor: FloatArray | None = None,
) -> DirectivityScore:
    """Return what a fitted band says against each of its sources.

    First by Rao's score test [1]_: one evaluation at the answer, with the derivative by b, tells
    the gain to second order. Where that is more than chance gives, the source's b is fitted, and
    the full log-likelihoods are compared. What the model misses anyway, phi above 1, counts
    against the gain.

    Parameters
    ----------
    problem : EnergyProblem
        Without directivity.
    fit : BandFit
        Of this problem; room parameters that were fitted along stand behind its windows.
    directivity : BandDirectivities
        Of its sources.
    factor : float array, shape (n_windows,), optional
        By which the fit's variances were enlarged.

    References
    ----------
    .. [1] C. R. Rao, "Large sample tests of statistical hypotheses concerning several parameters",
           Proc. Camb. Phil. Soc. 44, 50-57 (1948).
    """
    soft = np.ones(problem.measured().size) if factor is None else factor
    gains, steps = _second_order_gains(_with_directivity(problem, directivity, soft), fit)
    for s, name in enumerate(directivity.unknown.sources):
        if gains[s] > _BY_CHANCE:
            own = slice(3 * s, 3 * s + 3)
            unknown = UnknownDirectivities(
                (name,), directivity.unknown.mean[own], directivity.unknown.root[own, own]
            )
            alone = replace(
                directivity, unknown=unknown, source=np.where(directivity.source == s, 0, -1)
            )
            plain = InflatedVariance(problem, soft)
            gains[s], steps[s] = _full_gain(
                _with_directivity(problem, alone, soft), plain, fit, steps[s]
            )
    return DirectivityScore(gains, vectors_of(directivity.unknown, steps.ravel()))


def _with_directivity(
    problem: EnergyProblem, directivity: BandDirectivities, soft: FloatArray
) -> InflatedVariance:
    """Return the problem with the directivity of some sources unknown."""
    unknown = with_unknown(problem, directivity.unknown)
    return InflatedVariance(
        directed(unknown, directivity.unknown, directivity.source, directivity.departure), soft
    )


def _second_order_gains(needed: InflatedVariance, fit: BandFit) -> tuple[FloatArray, FloatArray]:
    """Return half the squared score of each b over its variance, (n,), and a step of it, (n, 3).

    Each source by itself, as if the others were omnidirectional.
    """
    n = fit.vector.size
    size = len(needed.parameters.blocks[-1].labels)
    found = needed.predict(np.concatenate((fit.vector, np.zeros(size))))
    n_data, misfit = found.expected.size, max(fit.chi2_reduced, 1.0)
    spread = needed.correlation_length() * fit.variance[:n_data] * misfit
    residual = fit.measured[:n_data] - found.expected
    gains, steps = np.zeros(size // 3), np.zeros((size // 3, 3))
    for s in range(size // 3):
        own = found.jacobian[:, n + 3 * s : n + 3 * s + 3]
        weighed = own / spread[:, None]
        # all other unknowns stand at their best: only b has a slope there
        score = weighed.T @ residual
        cross = weighed.T @ found.jacobian[:, :n]
        information = weighed.T @ own + np.eye(3)
        information -= cross @ np.linalg.solve(fit.information / misfit, cross.T)
        steps[s] = np.linalg.solve(information, score)
        gains[s] = 0.5 * float(steps[s] @ score)
    return gains, steps


def _full_gain(
    needed: InflatedVariance, plain: InflatedVariance, fit: BandFit, free: FloatArray
) -> tuple[float, FloatArray]:
    """Return by how much the log-likelihood rises if b is fitted, and its free numbers."""
    alone = fit if fit.measured.size == plain.measured().size else score_band(plain, fit.vector)
    free_fit = score_band(needed, np.concatenate((fit.vector, free)))
    found = free_fit.vector[-3:]
    rise = (free_fit.log_likelihood - alone.log_likelihood) / max(free_fit.chi2_reduced, 1.0)
    return float(rise - 0.5 * found @ found), np.asarray(found)


def source_findings(
    tested_sources: DirectivityParameters | None, scores: Mapping[int, DirectivityScore]
) -> tuple[Finding, ...]:
    """Return a finding for each source taken for omnidirectional that the data contradict.

    Parameters
    ----------
    tested_sources : DirectivityParameters or None
    scores : mapping of band to DirectivityScore
    """
    if tested_sources is None or not scores:
        return ()
    needed = _A_BAND * len(scores) + _CONTRADICTS
    total = np.sum([d.gain for d in scores.values()], axis=0)
    findings = []
    for s, name in enumerate(tested_sources.sources):
        if total[s] <= needed:
            continue
        b = np.array([scores[band].b[s] for band in sorted(scores)])
        strongest = b[int(np.argmax(np.linalg.norm(b, axis=1)))]
        towards = ", ".join(f"{x:.1f}" for x in strongest / np.linalg.norm(strongest))
        findings.append(
            Finding(
                Code.SOURCE_NOT_OMNIDIRECTIONAL,
                f"{name} was taken for omnidirectional, and the data contradict that: they are "
                f"likelier if it sends more towards ({towards}). Absorption makes up for it, so "
                "nothing is called identifiable. Tell its directivity, or let it be fitted with "
                'directivity = "fit".',
                {"source": name, "log_likelihood_gain": float(total[s]), "b": b.tolist()},
            )
        )
    return tuple(findings)


@dataclass(frozen=True, slots=True, eq=False)
class BandInformation:
    """What the data of one band alone say of some unknowns: a Gaussian likelihood.

    Attributes
    ----------
    information : float array, shape (n, n)
        Symmetric; of no size in directions of which the data say nothing.
    weighed : float array, shape (n,)
        Information times the most likely value.
    """

    information: FloatArray
    weighed: FloatArray


def band_information(fit: BandFit, first: int) -> BandInformation:
    """Return what one band's data say of the last entries of its vector, all others unknown.

    Those entries have a unit normal prior, which is taken out; what the data say is divided by
    max(phi, 1), since data that the model misses tell less.

    Parameters
    ----------
    first : int
        Where the entries begin; they reach to the end of the vector.
    """
    whole = fit.information
    cross = whole[first:, :first]
    schur = whole[first:, first:] - cross @ np.linalg.solve(whole[:first, :first], cross.T)
    data = schur - np.eye(len(schur))
    misfit = max(fit.chi2_reduced, 1.0)
    return BandInformation(0.5 * (data + data.T) / misfit, schur @ fit.vector[first:] / misfit)


def cavity_priors(
    bands_information: Sequence[BandInformation | None],
    octaves: FloatArray,
    correlation: float,
    n: int,
) -> list[tuple[FloatArray, FloatArray]]:
    """Return mean and covariance of each band's unknowns from all other bands and the prior.

    Beforehand each unknown has a unit normal law in every band; between bands d octaves apart its
    values correlate by ``correlation ** d``.

    Parameters
    ----------
    bands_information : sequence of BandInformation or None, one a band
        None where a band has no data.
    octaves : float array, shape (n_bands,)
        Log2 of the bands' centres, in any unit.
    correlation : float
        From 0 to below 1.
    n : int
        Number of unknowns of a band.

    Returns
    -------
    list of (mean, covariance), one a band
        Shapes (n,) and (n, n).
    """
    apart = np.abs(octaves[:, None] - octaves[None, :])
    prior = np.linalg.inv(np.kron(correlation**apart, np.eye(n)))
    out = []
    for band in range(len(bands_information)):
        information, weighed = prior.copy(), np.zeros(len(prior))
        for other, one in enumerate(bands_information):
            if other != band and one is not None:
                own = slice(n * other, n * (other + 1))
                information[own, own] += one.information
                weighed[own] += one.weighed
        covariance = np.linalg.inv(information)
        own = slice(n * band, n * (band + 1))
        out.append((np.asarray((covariance @ weighed)[own]), np.asarray(covariance[own, own])))
    return out


@dataclass(frozen=True, slots=True, eq=False)
class FoundDirectivities:
    """The vectors b of the unknown sources in one band.

    Attributes
    ----------
    sources : tuple of str
    b, sd : float arrays, shape (n_sources, 3)
        Most likely values and their standard deviations, misfit included.
    """

    sources: tuple[str, ...]
    b: FloatArray
    sd: FloatArray


def first_of_directivity(parameters: Parameters) -> int:
    """Return where the directivity begins in the free vector, which it must end."""
    return position_of(parameters, DIRECTIVITY)


def directivities_under_cavity_priors(
    directivity_parameters: DirectivityParameters,
    bands: Bands,
    directivities: Sequence[BandDirectivities | None],
    fits: Sequence[BandFit | None],
    parameters: Sequence[Parameters | None],
) -> tuple[BandDirectivities | None, ...]:
    """Return what is known of the sources in each band once the others have been fitted.

    Parameters
    ----------
    directivities, fits, parameters : one a band
        With nothing known yet but what the campaign says.
    """
    information: list[BandInformation | None] = [
        None if f is None or p is None else band_information(f, first_of_directivity(p))
        for f, p in zip(fits, parameters, strict=True)
    ]
    octaves = np.log2(bands.centres_hz)
    said = cavity_priors(
        information, octaves, CORRELATION_PER_OCTAVE, directivity_parameters.mean.size
    )
    return tuple(
        None
        if directivity is None
        else replace(directivity, unknown=with_cavity_prior(directivity_parameters, *other))
        for directivity, other in zip(directivities, said, strict=True)
    )


def moved_start(fit: BandFit, old: UnknownDirectivities, new: UnknownDirectivities) -> FloatArray:
    """Return the vector of a fit in the free numbers of another prior, the same b."""
    first = fit.vector.size - old.mean.size
    b = old.mean + old.root @ fit.vector[first:]
    return np.concatenate((fit.vector[:first], np.linalg.solve(new.root, b - new.mean)))


def found_directivities(
    unknown: UnknownDirectivities, free: FloatArray, covariance: FloatArray
) -> FoundDirectivities:
    """Return the vectors b of free numbers with their covariance."""
    variance = np.einsum("ij,jk,ik->i", unknown.root, covariance, unknown.root)
    sd = np.sqrt(np.maximum(variance, 0.0))
    return FoundDirectivities(unknown.sources, vectors_of(unknown, free), sd.reshape(-1, 3))


def fitted_directivities(found: Sequence[FoundDirectivities]) -> tuple[FittedDirectivity, ...]:
    """Return what was found in all bands, source by source."""
    if not found:
        return ()
    return tuple(
        FittedDirectivity(
            name, np.stack([f.b[s] for f in found]), np.stack([f.sd[s] for f in found])
        )
        for s, name in enumerate(found[0].sources)
    )


def prior_only_directivities(directivity_parameters: DirectivityParameters) -> FoundDirectivities:
    """Return what was known beforehand, for a band that was not fitted."""
    unknown = directivity_prior(directivity_parameters)
    n = unknown.mean.size
    return found_directivities(unknown, np.zeros(n), np.eye(n))


def band_directivities(
    directivity_parameters: DirectivityParameters | None,
    directivities: Sequence[BandDirectivities | None],
    answers: Sequence[BandAnswer | None],
) -> tuple[FoundDirectivities, ...]:
    """Return the vectors b of every band; what was known beforehand where none was fitted."""
    if directivity_parameters is None:
        return ()
    return tuple(
        prior_only_directivities(directivity_parameters)
        if directivity is None or answer is None or answer.directivity is None
        else found_directivities(directivity.unknown, *answer.directivity)
        for directivity, answer in zip(directivities, answers, strict=True)
    )


@dataclass(frozen=True, slots=True, eq=False)
class EnergyTask:
    """What window energies of all bands are made from."""

    scene: Scene
    bands: Bands
    priors: tuple[MaterialPrior, ...]
    measured: tuple[MeasuredPair, ...]
    paths: Paths
    binned: BinnedPaths
    start: FloatArray


def directed_energies(
    task: EnergyTask, directivity_parameters: DirectivityParameters | None
) -> tuple[BandDirectivities | None, ...]:
    """Return what is known of the sources in each band once the others have been fitted."""
    if directivity_parameters is None:
        return (None,) * len(task.bands)
    directivities: list[BandDirectivities | None] = []
    fits: list[BandFit | None] = []
    parameters: list[Parameters | None] = []
    for band, problem in enumerate(_problems(task)):
        if problem is None:
            directivities, fits, parameters = (
                [*directivities, None],
                [*fits, None],
                [*parameters, None],
            )
            continue
        directivity = directed_band(
            directivity_parameters, task.scene, task.paths, problem, _files(task, band)
        )
        whole = with_directivity_unknown(with_unknown(problem, directivity.unknown), directivity)
        directivities.append(directivity)
        fits.append(fit_band(whole, gauss_newton, few_gauss_newton_steps))
        parameters.append(whole.parameters)
    return directivities_under_cavity_priors(
        directivity_parameters, task.bands, directivities, fits, parameters
    )


def energy_problems(
    task: EnergyTask, directivities: tuple[BandDirectivities | None, ...]
) -> Iterator[BandProblem | None]:
    """Make the problem of one band after the other, with the directivities that are unknown."""
    for problem, directivity in zip(_problems(task), directivities, strict=True):
        if problem is None or directivity is None:
            yield problem
        else:
            yield with_directivity_unknown(with_unknown(problem, directivity.unknown), directivity)


def score_sources(
    task: EnergyTask, tested_sources: DirectivityParameters, scores: dict[int, DirectivityScore]
) -> Callable[[int, BandProblem, BandFit], None]:
    """Return what writes down, for every fitted band, what it says against its sources."""

    def watch(band: int, problem: BandProblem, fit: BandFit) -> None:
        first = problem.parts[0] if isinstance(problem, JointProblem) else problem
        if isinstance(first, EnergyProblem):
            directivity = directed_band(
                tested_sources, task.scene, task.paths, first, _files(task, band)
            )
            scores[band] = directivity_score(first, fit, directivity)

    return watch


def _problems(task: EnergyTask) -> Iterator[EnergyProblem | None]:
    return band_problems(
        *(task.scene, task.bands, task.priors, task.measured, task.binned, task.start)
    )


def _files(task: EnergyTask, band: int) -> tuple[MeasuredPair, ...]:
    return tuple(m for m in task.measured if has_data_in_band(m, band))


_METHODS = ("auto", "least-squares", "posterior")


def directivity_parameters(
    measurements: Measurements, settings: Settings
) -> DirectivityParameters | None:
    """Return the sources whose directivity is to be fitted; None where there is none.

    Raises
    ------
    InputError
        The method cannot, or there are room parameters to be fitted as well.
    """
    unknown = [
        (i, s.name, d)
        for i, s in enumerate(measurements.scene.sources)
        if isinstance(d := measurements.directivities.get(s.name), UnknownDirectivity)
    ]
    if not unknown:
        return None
    names = tuple(name for _, name, _ in unknown)
    _check_fittable(measurements, settings, names)
    mean = np.array([np.zeros(3) if d.mean is None else d.mean for _, _, d in unknown])
    sd = np.array([DEFAULT_B_SD if d.sd is None else d.sd for _, _, d in unknown])
    return DirectivityParameters(names, np.array([i for i, _, _ in unknown]), mean, sd)


def omnidirectional(measurements: Measurements) -> DirectivityParameters | None:
    """Return the sources that are taken for omnidirectional, to see whether the data agree."""
    own = [
        (i, s.name)
        for i, s in enumerate(measurements.scene.sources)
        if s.name not in measurements.directivities
    ]
    if not own:
        return None
    n = len(own)
    names, number = tuple(name for _, name in own), np.array([i for i, _ in own])
    return DirectivityParameters(names, number, np.zeros((n, 3)), np.full(n, DEFAULT_B_SD))


def _check_fittable(measurements: Measurements, settings: Settings, sources: Sequence[str]) -> None:
    where = f"sources.{sources[0]}.directivity"
    if settings.method not in _METHODS:
        raise InputError(
            "directivity is fitted by least squares only",
            where=where,
            found=f"method = {settings.method!r}",
            needed='method = "auto", "least-squares" or "posterior", or a directivity that is '
            "specified",
        )
    if measurements.values:
        raise InputError(
            "directivity is fitted to impulse responses only",
            where=where,
            found="room parameters that are to be fitted as well",
            needed='impulse responses alone, or use = "validate" for the tables',
            hint="fit the directivity to the responses first, then specify it as {aim, b}",
        )
