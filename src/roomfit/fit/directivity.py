"""Directivity of sources: fitted in every band, or tested where it is taken for none.

A source has one vector b a band, alone or with all sources of its make: its amplitude is linear in
b (`roomfit.model.patterns.pattern_basis`), and b correlates from band to band. Bands are
first fitted independently; each is then fitted under the cavity prior that the data of all others
leave (Opper and Winther, Neural Comput. 12, 2655 (2000)). A source taken for omnidirectional is
tested by how much the likelihood would rise if b were free.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeAlias, cast

import numpy as np
from scipy.linalg import block_diag

from roomfit.base.bands import Bands
from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray
from roomfit.fit.measurements import Measurements
from roomfit.fit.paths import TracedPaths
from roomfit.materials.priors import MaterialPrior
from roomfit.model.directivity import (
    CORRELATION_PER_OCTAVE,
    DEFAULT_B_SD,
    BandDirectivities,
    DirectivityParameters,
    FittedDirectivity,
    UnknownDirectivities,
    directed_band,
    energy_objective,
    row_bases,
    vectors_of,
)
from roomfit.model.energy import EnergyTerm
from roomfit.model.observation import energy_terms, fitted_in_band
from roomfit.model.parameters import marginal_information
from roomfit.model.patterns import UnknownDirectivity
from roomfit.model.problem import Objective
from roomfit.room.scene import Scene
from roomfit.settings import LEAST_SQUARES_METHODS, Settings
from roomfit.solver import COMPARED_SD, BandFit, fit_band, score_band
from roomfit.uncertainty.gaussian import BandEstimate

# Three unknowns that explain nothing gain one and a half in log-likelihood on average: where the
# second-order estimate is larger, b is fitted.
_BY_CHANCE = 1.5
# Larger gains, so much for each band and so much besides, contradict an omnidirectional source: 20
# in six bands, where chance gives 9. With three windows counted as one, all gains and limits 0.45
# times as large, six omnidirectional sources in three boxes of another program
# (benchmarks/other_boxes.py) gained 2 to 4 in all; of six with |b| = 0.5 one gained 4, the others
# 21 to 52.
_GAIN_PER_BAND, _GAIN = 1.1, 13.4

DirectivityScore: TypeAlias = tuple[FloatArray, FloatArray]
"""Evidence of one band against omnidirectional sources.

Rise of the log-likelihood if a source has a b of its own, the prior of b counted against it, shape
(n_sources,); and the b that it would have, shape (n_sources, 3).
"""


def directivity_score(
    energies: Objective, fit: BandFit, directivity: BandDirectivities
) -> DirectivityScore:
    """Return the evidence of a fitted band against each of its sources being omnidirectional.

    Rao's score test (Proc. Camb. Phil. Soc. 44, 50-57 (1948)) gives the gain to second order. Where
    that is more than chance gives, b is fitted and likelihoods are compared. Gains are divided by
    the reduced chi-square where that is above 1.
    """
    windows, inflation = cast(EnergyTerm, energies.terms[0]), energies.inflation
    inflation = None if inflation is None else inflation[: windows.measured().size]
    plain = Objective(energies.parameters, (windows,), inflation)
    free = energy_objective(windows, energies.parameters, directivity)
    gains, steps = _second_order_gains(replace(free, inflation=inflation), fit)
    for s, name in enumerate(directivity.unknown.sources):
        if gains[s] > _BY_CHANCE:
            own = slice(3 * s, 3 * s + 3)
            unknown = UnknownDirectivities(
                (name,), directivity.unknown.mean[own], directivity.unknown.root[own, own]
            )
            alone = replace(
                directivity, unknown=unknown, source=np.where(directivity.source == s, 0, -1)
            )
            free = energy_objective(windows, energies.parameters, alone)
            free = replace(free, inflation=inflation)
            gains[s], steps[s] = _full_gain(free, plain, fit, steps[s])
    return gains, vectors_of(directivity.unknown, steps.ravel())


def _second_order_gains(free: Objective, fit: BandFit) -> tuple[FloatArray, FloatArray]:
    """Return half the squared score of each b over its variance, (n,), and a step of it, (n, 3).

    Each source by itself, as if the others were omnidirectional.
    """
    n = fit.vector.size
    size = len(free.parameters.blocks[-1].labels)
    found = free.predict(np.concatenate((fit.vector, np.zeros(size))))
    n_data, misfit = found.expected.size, max(fit.chi2_reduced, 1.0)
    variance = free.correlation_length() * fit.variance[:n_data] * misfit
    residual = fit.measured[:n_data] - found.expected
    gains, steps = np.zeros(size // 3), np.zeros((size // 3, 3))
    for s in range(size // 3):
        own = found.jacobian[:, n + 3 * s : n + 3 * s + 3]
        weighed = own / variance[:, None]
        # all other unknowns are at their optimum: only b has a slope there
        score = weighed.T @ residual
        cross = weighed.T @ found.jacobian[:, :n]
        information = weighed.T @ own + np.eye(3)
        information -= cross @ np.linalg.solve(fit.information / misfit, cross.T)
        steps[s] = np.linalg.solve(information, score)
        gains[s] = 0.5 * float(steps[s] @ score)
    return gains, steps


def _full_gain(
    free: Objective, plain: Objective, fit: BandFit, step: FloatArray
) -> tuple[float, FloatArray]:
    """Return by how much the log-likelihood rises if b is fitted, and its free numbers."""
    alone = fit
    if fit.measured.size != plain.measured().size:
        alone = score_band(plain, fit.vector, settled_sd=COMPARED_SD)
    free_fit = score_band(free, np.concatenate((fit.vector, step)), settled_sd=COMPARED_SD)
    found = free_fit.vector[-3:]
    rise = (free_fit.log_likelihood - alone.log_likelihood) / max(free_fit.chi2_reduced, 1.0)
    return float(rise - 0.5 * found @ found), np.asarray(found)


class SourceGain(NamedTuple):
    """Evidence of all bands against one source being omnidirectional."""

    source: str
    log_likelihood_gain: float  # of a first-order directivity, its prior counted against it
    b: FloatArray  # (n_bands, 3), of the bands that have data


def contradicted_sources(
    tested_sources: DirectivityParameters | None, scores: Mapping[int, DirectivityScore]
) -> tuple[SourceGain, ...]:
    """Return the sources taken for omnidirectional that the data contradict."""
    if tested_sources is None or not scores:
        return ()
    least = _GAIN_PER_BAND * len(scores) + _GAIN
    total = np.sum([gain for gain, _ in scores.values()], axis=0)
    vectors = np.array([scores[band][1] for band in sorted(scores)])
    return tuple(
        SourceGain(name, float(total[s]), vectors[:, s])
        for s, name in enumerate(tested_sources.prior.sources)
        if total[s] > least
    )


def with_fitted_sources(
    unknown: DirectivityParameters | None, tested: DirectivityParameters
) -> DirectivityParameters:
    """Return the sources whose directivity is fitted, joined by those that were tested."""
    if unknown is None:
        return tested
    first, then = unknown.prior, tested.prior
    mean, root = np.concatenate((first.mean, then.mean)), block_diag(first.root, then.root)
    later = tested.of_source + len(first.sources)
    return DirectivityParameters(
        UnknownDirectivities((*first.sources, *then.sources), mean, root),
        np.where(tested.of_source >= 0, later, unknown.of_source),
        unknown.aims,
    )


def band_information(fit: BandFit, first: int) -> tuple[FloatArray, FloatArray]:
    """Return the Gaussian likelihood of the last entries of a fit's vector, the others unknown.

    Information (n, n) and weighted mean (n,), their unit normal prior taken out; divided by the
    reduced chi-square where that is above 1, since data that the model misses determine less.
    """
    marginal = marginal_information(fit.information, first)
    data = marginal - np.eye(len(marginal))
    misfit = max(fit.chi2_reduced, 1.0)
    return 0.5 * (data + data.T) / misfit, marginal @ fit.vector[first:] / misfit


def cavity_priors(
    likelihoods: Sequence[tuple[FloatArray, FloatArray] | None],
    octaves: FloatArray,
    correlation: float,
    n: int,
) -> list[tuple[FloatArray, FloatArray]]:
    """Return mean and covariance of each band's unknowns from all other bands and the prior.

    Unit normal in every band; between bands d octaves apart they correlate by ``correlation ** d``.
    """
    apart = np.abs(octaves[:, None] - octaves[None, :])
    prior = np.linalg.inv(np.kron(correlation**apart, np.eye(n)))
    blocks = [slice(n * band, n * (band + 1)) for band in range(len(likelihoods))]
    out = []
    for own in blocks:
        information, weighted_mean = prior.copy(), np.zeros(len(prior))
        for other, likelihood in zip(blocks, likelihoods, strict=True):
            if other != own and likelihood is not None:
                information[other, other] += likelihood[0]
                weighted_mean[other] += likelihood[1]
        covariance = np.linalg.inv(information)
        out.append((np.asarray((covariance @ weighted_mean)[own]), np.array(covariance[own, own])))
    return out


def directivities_under_cavity_priors(
    parameters: DirectivityParameters,
    bands: Bands,
    directivities: Sequence[BandDirectivities | None],
    fits: Sequence[BandFit | None],
) -> tuple[BandDirectivities | None, ...]:
    """Return the directivities of each band with the prior that all other bands leave."""
    start, n = parameters.prior, parameters.prior.mean.size
    likelihoods = [None if f is None else band_information(f, f.vector.size - n) for f in fits]
    priors = cavity_priors(likelihoods, np.log2(bands.centres_hz), CORRELATION_PER_OCTAVE, n)
    unknown = [
        UnknownDirectivities(
            start.sources, start.mean + start.root @ mean, start.root @ np.linalg.cholesky(spread)
        )
        for mean, spread in priors
    ]
    return tuple(
        None if own is None else replace(own, unknown=known)
        for own, known in zip(directivities, unknown, strict=True)
    )


def moved_start(fit: BandFit, old: UnknownDirectivities, new: UnknownDirectivities) -> FloatArray:
    """Return the vector of a fit in the free numbers of another prior, the same b."""
    first = fit.vector.size - old.mean.size
    b = old.mean + old.root @ fit.vector[first:]
    return np.concatenate((fit.vector[:first], np.linalg.solve(new.root, b - new.mean)))


def band_directivities(
    scene: Scene,
    parameters: DirectivityParameters | None,
    directivities: Sequence[BandDirectivities | None],
    answers: Sequence[BandEstimate | None],
) -> tuple[FittedDirectivity, ...]:
    """Return the fitted directivity of each source; in bands without a fit, the prior."""
    if parameters is None:
        return ()
    vectors, deviations = [], []
    for directivity, answer in zip(directivities, answers, strict=True):
        unknown = parameters.prior
        free, covariance = np.zeros(unknown.mean.size), np.eye(unknown.mean.size)
        if directivity is not None and answer is not None and answer.directivity is not None:
            unknown, (free, covariance) = directivity.unknown, answer.directivity
        variance = np.einsum("ij,jk,ik->i", unknown.root, covariance, unknown.root)
        vectors.append(vectors_of(unknown, free))
        deviations.append(np.sqrt(np.maximum(variance, 0.0)).reshape(-1, 3))
    found = []
    for s, name in enumerate(parameters.prior.sources):
        of = np.flatnonzero(parameters.of_source == s)
        aims = {scene.sources[i].name: parameters.aims[i] for i in of}
        b, sd = (np.stack([x[s] for x in each]) for each in (vectors, deviations))
        found.append(FittedDirectivity(name, b, sd, aims))
    return tuple(found)


def directed_energies(
    measured: Measurements,
    priors: tuple[MaterialPrior, ...],
    traced: TracedPaths,
    start: FloatArray,
    parameters: DirectivityParameters | None,
) -> tuple[BandDirectivities | None, ...]:
    """Return the unknown directivities of each band with the prior that all other bands leave."""
    scene, bands, responses = measured.scene, measured.bands, measured.responses
    if parameters is None:
        return (None,) * len(bands)
    directivities: list[BandDirectivities | None] = []
    fits: list[BandFit | None] = []
    bases = row_bases(parameters, scene, traced.paths, traced.binned)
    made = energy_terms(scene, bands, priors, responses, traced.binned, start)
    for band, own in enumerate(made):
        directivity, fit = None, None
        if own is not None:
            files = fitted_in_band(responses, band)
            directivity = directed_band(parameters, scene, bases, own[0], files)
            fit = fit_band(energy_objective(*own, directivity))
        directivities.append(directivity)
        fits.append(fit)
    return directivities_under_cavity_priors(parameters, bands, directivities, fits)


def source_scorer(
    measured: Measurements, traced: TracedPaths, tested_sources: DirectivityParameters
) -> Callable[[int, Objective, BandFit], DirectivityScore | None]:
    """Return what finds a fitted band's evidence against its sources, None without windows."""
    bases = row_bases(tested_sources, measured.scene, traced.paths, traced.binned)

    def score(band: int, objective: Objective, fit: BandFit) -> DirectivityScore | None:
        windows, files = objective.as_energies(fit.vector), fitted_in_band(measured.responses, band)
        if windows is None:
            return None
        directivity = directed_band(tested_sources, measured.scene, bases, windows, files)
        return directivity_score(objective, fit, directivity)

    return score


def directivity_parameters(
    measurements: Measurements, settings: Settings
) -> DirectivityParameters | None:
    """Return the sources whose directivity is to be fitted, with its prior; None without any."""
    names = [s.name for s in measurements.scene.sources]
    known = measurements.directivities
    unknown = {
        i: d for i, n in enumerate(names) if isinstance(d := known.get(n), UnknownDirectivity)
    }
    if not unknown:
        return None
    if not is_fittable(measurements, settings):
        raise InputError(
            "directivity is fitted by least squares, to impulse responses only",
            where=f"sources.{names[next(iter(unknown))]}.directivity",
            found=f"method = {settings.method!r}"
            + (" and room parameters that are to be fitted" if measurements.values else ""),
            needed='method = "auto" or "least-squares" and impulse responses alone, use = '
            '"validate" for the tables; or a specified directivity',
            hint="fit the directivity to the responses first, then specify it as {aim, b}",
        )
    aims: list[FloatArray | None] = [None] * len(names)
    of_source = np.full(len(names), -1)
    first: dict[str, UnknownDirectivity] = {}  # of sources that share one, the first speaks
    for i, directivity in unknown.items():
        own = names[i] if directivity.loudspeaker is None else directivity.loudspeaker
        first.setdefault(own, directivity)
        of_source[i], aims[i] = list(first).index(own), directivity.aim
    mean = np.concatenate([np.zeros(3) if d.mean is None else d.mean for d in first.values()])
    sd = np.array([DEFAULT_B_SD if d.sd is None else d.sd for d in first.values()])
    prior = UnknownDirectivities(tuple(first), mean, np.diag(np.repeat(sd, 3)))
    return DirectivityParameters(prior, of_source, tuple(aims))


def omnidirectional(measurements: Measurements) -> DirectivityParameters | None:
    """Return the sources that are taken for omnidirectional, to be tested; None without any."""
    known = np.array([s.name in measurements.directivities for s in measurements.scene.sources])
    names = [s.name for s, k in zip(measurements.scene.sources, known, strict=True) if not k]
    if not names:
        return None
    of_source, n = np.where(known, -1, np.cumsum(~known) - 1), 3 * len(names)
    prior = UnknownDirectivities(tuple(names), np.zeros(n), DEFAULT_B_SD * np.eye(n))
    return DirectivityParameters(prior, of_source, (None,) * known.size)


def is_fittable(measurements: Measurements, settings: Settings) -> bool:
    """Return whether directivities can be fitted: by least squares, to responses alone."""
    return settings.method in LEAST_SQUARES_METHODS and not measurements.values
