"""Bands fitted one after the other, each under what the others determine of the geometry.

A partly coherent fit goes in rounds: the better positions are known, the more of a response is
coherent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from roomfit.objective.coherent import SPEED_SD, CoherentProblem, with_coherence
from roomfit.objective.directivity import BandDirectivities, with_directivity_unknown
from roomfit.objective.energy import EnergyProblem
from roomfit.objective.parameters import (
    GEOMETRY,
    JointPrior,
    Marginal,
    Parameters,
    position_of,
    prior_residuals,
    whole_covariance,
)
from roomfit.objective.problem import BandProblem, InflatedVariance, JointProblem
from roomfit.solvers.least_squares import BandFit, marginal, score_band
from roomfit.typing import FloatArray, Progress

ProblemOf = Callable[[FloatArray | None], BandProblem]
"""Makes the problem whose coherence belongs to a covariance of the fitted geometry."""


@dataclass(frozen=True, slots=True, eq=False)
class CoherentBandFit:
    """The last round's fit."""

    fit: BandFit
    # of all data, none counted less than once: compares models of the same data
    log_likelihood: float
    # what this band and those before say of the geometry; None where nothing of it is fitted
    found: Marginal | None
    problem: BandProblem  # with the coherence of the last round

    @property
    def parameters(self) -> Parameters:
        """The unknowns of the problem."""
        return self.problem.parameters


def geometry_information(parameters: Parameters) -> FloatArray:
    """Return the prior information of the fitted geometry, shape (n, n)."""
    if parameters.joint is not None:
        return parameters.joint.information
    block = next(b for b in parameters.blocks if b.name == GEOMETRY)
    return np.diag(block.prior_sd[block.fitted] ** -2.0)


def fit_in_rounds(
    problem_of: ProblemOf, start: FloatArray, *, rounds: int = 3, covariance: FloatArray | None
) -> CoherentBandFit:
    """Fit, take the coherence that the fit's own geometry permits, and fit again.

    Parameters
    ----------
    problem_of : callable
    start : float array, shape (n_free,)
    rounds : int
        1 or more; one is enough where nothing of the geometry is fitted.
    covariance : float array, shape (n, n), or None
        Of the fitted geometry, for the first round; None takes the prior.
    """
    vector = start
    for _ in range(rounds):
        problem = problem_of(covariance)
        fit = score_band(problem, vector)
        vector = fit.vector
        first = position_of(problem.parameters, GEOMETRY)
        if first == vector.size:
            break
        own = np.linalg.inv(fit.information)[first:, first:]
        covariance = np.asarray(own * max(fit.chi2_reduced, 1.0))
    each = problem.log_likelihood(fit.expected, fit.variance)
    likelihood = float(each.sum())
    if first == vector.size:
        return CoherentBandFit(fit, likelihood, None, problem)
    found = marginal(fit, first, geometry_information(problem.parameters))
    return CoherentBandFit(fit, likelihood, found, problem)


def cavity_prior(final: Marginal, after: Marginal, before: FloatArray) -> JointPrior:
    """Return what all bands but one say of the geometry, as a prior for that one.

    Parameters
    ----------
    final : Marginal
        What all bands say.
    after : Marginal
        What was known after that band.
    before : float array, shape (n, n)
        Information before it.
    """
    return JointPrior(GEOMETRY, final.mean, final.information - (after.information - before))


# Later pressures tell little more and need many more images.
FIT_END_S = 0.2
# Error of the model, ringing, and random phase of a reflection, from good to bad.
_NOISES = ((0.1, 0.0, 0.0), (0.2, 0.1, 0.0), (0.2, 0.1, 0.5), (0.4, 0.2, 0.5))

PartFactory = Callable[[Parameters], BandProblem]
"""Makes another kind of data of a band from the unknowns that all kinds share."""


@dataclass(frozen=True, slots=True)
class CoherentOptions:
    """What a fit may vary."""

    # whether positions, speed of sound and latencies move within their standard deviation
    positions: Literal["fit", "fixed"] = "fit"
    delays: bool = True  # whether walls may delay what they reflect
    # "auto" leaves it to the likelihood of each band
    model: Literal["auto", "coherent", "energy"] = "auto"
    # until when pressures add, after emission; from there on energies do
    end_s: float = FIT_END_S
    # where the last window ends at the latest; without a limit it ends where the decay drowns
    late_end_s: float = np.inf
    speed_sd: float = SPEED_SD  # prior relative standard deviation of the speed of sound


@dataclass(frozen=True, slots=True, eq=False)
class CoherentBand:
    """One band on its way: what the energies say, and the problem in every setting of noise."""

    energies: EnergyProblem
    energy_fit: BandFit
    factor: FloatArray
    problem: CoherentProblem
    parts: tuple[PartFactory, ...]
    directed: BandDirectivities | None = None

    def with_noise(self, model: float, ringing: float) -> CoherentBand:
        changed = replace(self.problem.energies, model_error=model, ringing_error=ringing)
        return replace(self, problem=replace(self.problem, energies=changed))

    def after(self, joint: JointPrior | None) -> CoherentBand:
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
        return joined(with_directivity_unknown(own, self.directed), self.factor, self.parts)


def joined(problem: BandProblem, factor: FloatArray, parts: Sequence[PartFactory]) -> BandProblem:
    """Return a problem softened by a factor a datum, with other kinds of data joined to it."""
    inflated: BandProblem = problem
    if np.any(factor != 1.0):
        inflated = InflatedVariance(problem, factor)
    if not parts:
        return inflated
    return JointProblem((inflated, *(make(problem.parameters) for make in parts)))


def forward_pass(
    prepared: tuple[CoherentBand | None, ...], settings: CoherentOptions, progress: Progress | None
) -> tuple[list[CoherentBandFit | None], list[tuple[float, float, float]]]:
    """Fit the bands from low to high, each under what the lower ones determine of the geometry."""
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
    band: CoherentBand, known: Marginal | None
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
        if fit.fit.chi2_reduced <= 1.0:
            break
    assert best is not None  # noqa: S101 - the loop runs at least once
    return best


def _rounds(
    band: CoherentBand,
    start: FloatArray,
    phase_sd: float,
    covariance: FloatArray | None,
    rounds: int = 2,
) -> CoherentBandFit:
    return fit_in_rounds(
        lambda c: band.at(c, phase_sd), start, rounds=rounds, covariance=covariance
    )


def _start(band: CoherentBand, known: Marginal | None) -> FloatArray:
    """Return what the energies say, with the geometry of the bands below."""
    block = next(b for b in band.problem.parameters.blocks if b.name == GEOMETRY)
    geometry = np.zeros(int(block.fitted.sum())) if known is None else known.mean
    return np.concatenate((band.energy_fit.vector, geometry))


def leave_one_out_pass(
    prepared: tuple[CoherentBand | None, ...],
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
        prior = cavity_prior(final, fit.found, geometry_information(fit.parameters))
        model, ringing, phase_sd = noises[i]
        own = band.after(prior).with_noise(model, ringing)
        n = fit.fit.vector.size - final.mean.size
        start = np.concatenate((fit.fit.vector[:n], final.mean))
        again[i] = _rounds(own, start, phase_sd, covariance, rounds=1)
    return again, final


def _advantage(band: CoherentBand, fit: CoherentBandFit) -> float:
    """Return by how much the partly coherent model explains the data better than energies.

    Log-likelihoods of the same windows, the geometry's prior counted against it.
    """
    coherent, energies = _pair_of_likelihoods(band, fit)
    return coherent - energies


def _pair_of_likelihoods(band: CoherentBand, fit: CoherentBandFit) -> tuple[float, float]:
    n = band.energy_fit.vector.size
    prior, rows = prior_residuals(fit.parameters, fit.fit.vector)
    moved = prior[np.any(rows[:, n:] != 0.0, axis=1)]
    energies = joined(band.energies, band.factor, band.parts)
    each = energies.log_likelihood(band.energy_fit.expected, band.energy_fit.variance)
    return fit.log_likelihood - 0.5 * float(moved @ moved), float(each.sum())


def band_likelihoods(
    prepared: tuple[CoherentBand | None, ...], fits: Sequence[CoherentBandFit | None]
) -> FloatArray:
    out: FloatArray = np.full((len(prepared), 2), np.nan)
    for i, (band, fit) in enumerate(zip(prepared, fits, strict=True)):
        if band is not None and fit is not None:
            out[i] = _pair_of_likelihoods(band, fit)[::-1]
    return out
