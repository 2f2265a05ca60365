"""Bands fitted one after the other, each under what the others determine of the geometry.

A partly coherent fit goes in rounds: the better positions are known, the more of a response is
coherent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from roomfit.base.forks import beside, in_forks
from roomfit.base.typing import FloatArray, Progress
from roomfit.model.directivity import BandDirectivities, directed
from roomfit.model.parameters import GEOMETRY, Marginal, Parameters, position_of, prior_residuals
from roomfit.model.problem import Objective
from roomfit.pressures.data_term import CoherentTerm, with_coherence
from roomfit.pressures.geometry import geometry_block, whole_covariance
from roomfit.settings import MAX_ROUNDS, Settings
from roomfit.solver import BandFit, marginal, score_band

# Error of the model, ringing, and random phase of a reflection, from good to bad.
NOISES = ((0.1, 0.0, 0.0), (0.2, 0.1, 0.0), (0.2, 0.1, 0.5), (0.4, 0.2, 0.5))
# One as likely leads on to the next, and so does a random phase that is less likely: it is nothing
# where nothing is coherent, and the model may be wrong by more all the same.
_AS_LIKELY = 0.1
# Mean squared distance of geometries in standard deviations: half of one.
_AGREED = 0.25
# Log evidences nearer than this do not decide between two models.
UNDECIDED = 2.0
# A reduced chi-square above this says that a model does not explain its data.
MISFIT = 2.0
# Up to here a geometry that lower bands have determined makes the next band coherent, if it is the
# room's: bands that are then less likely by pressures contradict it.
TELLING_HZ = 1000.0
# How far from its answer a fit may end, in standard deviations of an absorption: before coherence
# is renewed, and where each band is fitted once more under all others.
_BEFORE_THE_NEXT_ROUND_SD, BEFORE_THE_LAST_PASS_SD = 1.0, 0.1


@dataclass(frozen=True, slots=True, eq=False)
class CoherentBand:
    """One band: its data with windows as energies, their fit, and the windows as pressures."""

    energies: Objective  # windows first, then other data
    energy_fit: BandFit
    coherent: CoherentTerm  # not coherent yet, of omnidirectional sources
    directivity: BandDirectivities | None = None

    @property
    def parameters(self) -> Parameters:
        """The unknowns of the partly coherent windows: those of the energies, and the geometry."""
        geometry = geometry_block(self.coherent.geometry)
        return Parameters((*self.energies.parameters.blocks, geometry))

    def objective(
        self,
        covariance: FloatArray | None,
        noise: tuple[float, float, float],
        joint: Marginal | None,
    ) -> Objective:
        """Return the same data with partly coherent windows.

        Shapes: `covariance` (n, n).
        """
        model, ringing, phase_sd = noise
        if covariance is None and joint is not None:
            covariance = np.asarray(np.linalg.inv(joint.information))
        plain = replace(self.coherent.energies, model_error=model, ringing_error=ringing)
        windows = with_coherence(
            replace(self.coherent, energies=plain),
            whole_covariance(self.coherent.geometry, covariance),
            phase_sd,
        )
        return replace(
            self.energies,
            parameters=replace(self.parameters, joint=joint),
            terms=(directed(windows, self.directivity), *self.energies.terms[1:]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class CoherentBandFit:
    """The last round's fit of a band with partly coherent windows."""

    fit: BandFit
    # of all data, none counted less than once, variances times the reduced chi-square where that is
    # above 1: compares models of the same data
    log_likelihood: float
    log_evidence: float  # as `log_evidence`
    # what this band and those before say of the geometry; None where nothing of it is fitted, or
    # where energies explain the band as well
    found: Marginal | None
    parameters: Parameters
    # as for `CoherentBand.objective`, of the last round
    covariance: FloatArray | None
    noise: tuple[float, float, float]
    # of the band's data with windows as energies; NaN where it was not compared
    energy_log_evidence: float = np.nan

    def objective(self, band: CoherentBand) -> Objective:
        """Return what was fitted, made anew: kept of every fit, paths would fill the memory."""
        return band.objective(self.covariance, self.noise, self.parameters.joint)


def fit_in_rounds(
    band: CoherentBand,
    start: FloatArray,
    noise: tuple[float, float, float],
    joint: Marginal | None,
    *,
    covariance: FloatArray | None = None,
    rounds: int = 2,
    max_rounds: int = MAX_ROUNDS,
    settled_sd: float | None = None,
) -> CoherentBandFit:
    """Fit, take the coherence that the fit's own geometry permits, and fit again.

    Shapes: `start` (n_free,), `covariance` (n, n).
    """
    vector = start
    for left in reversed(range(rounds)):
        used, objective = covariance, band.objective(covariance, noise, joint)
        parameters = objective.parameters
        first = position_of(parameters, GEOMETRY)
        near = _BEFORE_THE_NEXT_ROUND_SD if left and first < vector.size else settled_sd
        fit = score_band(objective, vector, max_rounds=max_rounds, settled_sd=near)
        vector = fit.vector
        likelihood = float(inflated_log_likelihood(objective, fit).sum())
        evidence = log_evidence(objective, fit)
        del objective  # before the next one is made
        if first == vector.size:
            break
        own = np.linalg.inv(fit.information)[first:, first:]
        covariance = np.asarray(own * max(fit.chi2_reduced, 1.0))
    found = None
    if first < vector.size:
        found = marginal(fit, first, geometry_information(parameters))
    return CoherentBandFit(fit, likelihood, evidence, found, parameters, used, noise)


def forward_pass(
    bands: Sequence[CoherentBand | None],
    settings: Settings,
    progress: Progress | None,
    starts: Sequence[FloatArray | None] = (),
    known_before: Marginal | None = None,
) -> list[CoherentBandFit | None]:
    """Fit the bands from low to high, each under what the lower ones determine of the geometry.

    With the error of the model that the likelihood prefers: larger ones are tried only while the
    data scatter more than the model says. Where the model is chosen, a band whose evidence is that
    of energies leaves the geometry as it was.

    Shapes: `starts` (n_free,).
    """
    fits: list[CoherentBandFit | None] = []
    known: Marginal | None = None
    there = [own for own in bands if own is not None and settings.model == "auto"]
    # no lower band changes them
    with beside(lambda: [evidence_of_energies(own) for own in there]) as evidences:
        for i, band in enumerate(bands):
            if band is None:
                fits.append(None)
                continue
            geometry = geometry_block(band.coherent.geometry)
            moved = np.zeros(int(geometry.fitted.sum())) if known is None else known.mean
            near = BEFORE_THE_LAST_PASS_SD if moved.size else None
            vector, covariance = band.energy_fit.vector, None
            if starts and (earlier := starts[i]) is not None:
                vector = earlier[: vector.size]
            if known_before is not None:
                moved = known_before.mean
                covariance = np.asarray(np.linalg.inv(known_before.information))
            limit = settings.max_rounds
            best = fit_in_rounds(
                band,
                np.append(vector, moved),
                NOISES[0],
                known,
                covariance=covariance,
                max_rounds=limit,
                settled_sd=near,
            )
            for noise in NOISES[1:]:
                if best.fit.chi2_reduced <= 1.0:
                    break
                fit = fit_in_rounds(
                    band, best.fit.vector, noise, known, max_rounds=limit, settled_sd=near
                )
                less_likely = fit.log_likelihood < best.log_likelihood - _AS_LIKELY
                if less_likely and noise[0] > best.noise[0]:
                    break
                best = max(best, fit, key=lambda f: f.log_likelihood)
            if there:
                evidence = evidences()[there.index(band)]
                best = compared_with_energies(band, best, evidence)
            fits.append(best)
            known = known if best.found is None else best.found
            if progress is not None:
                progress((i + 1) / len(bands))
    return fits


def contradicts_geometry(
    bands: Sequence[CoherentBand | None], fits: Sequence[CoherentBandFit | None]
) -> bool:
    """Return whether a band up to 1 kHz contradicts what lower ones have determined of geometry.

    Energies are then likelier than pressures there, by 2 units or more.
    """
    is_known = False
    for band, fit in zip(bands, fits, strict=True):
        if band is None or fit is None:
            continue
        energies, pressures = log_evidences(band, fit)
        is_telling = band.coherent.energies.centre_hz < 1.01 * TELLING_HZ
        if is_known and is_telling and pressures <= energies - UNDECIDED:
            return True
        is_known = is_known or fit.found is not None
    return False


def leave_one_out_pass(
    bands: Sequence[CoherentBand | None],
    fits: Sequence[CoherentBandFit | None],
    settings: Settings,
) -> tuple[list[CoherentBandFit | None], Marginal | None]:
    """Fit each band again under what all the others say of the geometry, and return that of all."""
    again = list(fits)
    trusted = [
        (i, band, fit, fit.found)
        for i, (band, fit) in enumerate(zip(bands, fits, strict=True))
        if band is not None and fit is not None and fit.found is not None
    ]
    if not trusted:
        return again, None
    *_, final = trusted[-1]
    covariance = np.asarray(np.linalg.inv(final.information))

    def fitted(
        which: tuple[int, CoherentBand, CoherentBandFit, Marginal],
    ) -> CoherentBandFit:
        _, band, fit, found = which
        joint = cavity_prior(final, found, geometry_information(fit.parameters))
        n = fit.fit.vector.size - final.mean.size
        start = np.concatenate((fit.fit.vector[:n], final.mean))
        last = fit_in_rounds(
            band,
            start,
            fit.noise,
            joint,
            covariance=covariance,
            rounds=1,
            max_rounds=settings.max_rounds,
        )
        return replace(last, energy_log_evidence=fit.energy_log_evidence)

    for (i, *_), last in zip(trusted, in_forks(fitted, trusted), strict=True):
        again[i] = last
    return again, final


def increases_likelihood(
    before: Sequence[CoherentBandFit | None], after: Sequence[CoherentBandFit | None]
) -> float:
    """Return by how much all bands' data together are likelier after than before."""
    each = zip(before, after, strict=True)
    return sum(b.log_likelihood - a.log_likelihood for a, b in each if a and b)


def agree(fits: Sequence[CoherentBandFit | None], final: Marginal) -> bool:
    """Whether each band's geometry, by its data under all others', is that of all.

    Positions that are far off permit little coherence, and little coherence draws them little: the
    passes from low to high then end before the geometry is found, and the bands disagree.
    """
    n = final.mean.size
    moved = [f.fit.vector[-n:] - final.mean for f in fits if f is not None and f.found is not None]
    return all(float(d @ final.information @ d) <= _AGREED * n for d in moved)


def geometry_information(parameters: Parameters) -> FloatArray:
    """Return the prior information of the fitted geometry, shape (n, n)."""
    if parameters.joint is not None:
        return parameters.joint.information
    block = next(b for b in parameters.blocks if b.name == GEOMETRY)
    return np.diag(block.prior_sd[block.fitted] ** -2.0)


def cavity_prior(final: Marginal, after: Marginal, before: FloatArray) -> Marginal:
    """Return what all bands but one say of the geometry, as a prior for that one.

    Shapes: `before` (n, n).
    """
    return Marginal(final.mean, final.information - (after.information - before))


def evidence_of_energies(band: CoherentBand) -> float:
    """Return the log evidence of a band's data with windows as energies.

    Energies have the error of the model, of `NOISES`, that suits them best, as pressures have.
    """
    found = []
    for model, ringing in dict.fromkeys(noise[:2] for noise in NOISES):
        plain = replace(band.coherent.energies, model_error=model, ringing_error=ringing)
        terms = (directed(plain, band.directivity), *band.energies.terms[1:])
        objective = replace(band.energies, terms=terms)
        own = score_band(objective, band.energy_fit.vector, settled_sd=BEFORE_THE_LAST_PASS_SD)
        found.append(log_evidence(objective, own))
    return max(found)


def compared_with_energies(
    band: CoherentBand, fit: CoherentBandFit, energy_log_evidence: float
) -> CoherentBandFit:
    """Return a fit with the evidence of energies, and without geometry where that is no smaller."""
    fit = replace(fit, energy_log_evidence=energy_log_evidence)
    energies, pressures = log_evidences(band, fit)
    return fit if pressures > energies else replace(fit, found=None)


def log_evidences(band: CoherentBand, fit: CoherentBandFit) -> tuple[float, float]:
    """Return the log evidences of a band's data with windows as energies and as pressures.

    Where they are within `UNDECIDED`, that of a model whose reduced chi-square is above 2 is minus
    infinity if the other's is not. Where they decide, they have allowed for the misfit.
    """
    chi2 = band.energy_fit.chi2_reduced, fit.fit.chi2_reduced
    energies, pressures = fit.energy_log_evidence, fit.log_evidence
    if abs(energies - pressures) < UNDECIDED and max(chi2) > MISFIT >= min(chi2):
        return (-np.inf, pressures) if chi2[0] > chi2[1] else (energies, -np.inf)
    return energies, pressures


def inflated_log_likelihood(objective: Objective, fit: BandFit) -> FloatArray:
    """Return the log density of each datum, variances times the reduced chi-square if above 1.

    Densities of energies have exponential tails, so that under the variances themselves a model
    that fits most windows closely and some not at all would be the likelier one.
    """
    return objective.log_likelihood(fit.expected, max(fit.chi2_reduced, 1.0) * fit.variance)


def log_evidence(objective: Objective, fit: BandFit) -> float:
    """Return the log evidence of a band's data by Laplace's approximation [1]_.

    The log-likelihood of `inflated_log_likelihood`, neighbours that share information counted once,
    with the priors, and half the log of the ratio of the prior's information on the geometry to
    that of prior and data on all unknowns. What models of the same data have in common is left out.

    References
    ----------
    .. [1] D. J. C. MacKay, "Bayesian interpolation", Neural Comput. 4, 415-447 (1992).
    """
    data = float((inflated_log_likelihood(objective, fit) / objective.correlation_length()).sum())
    prior, _ = prior_residuals(objective.parameters, fit.vector)
    known = 0.0
    if any(b.name == GEOMETRY for b in objective.parameters.blocks):
        known = float(np.linalg.slogdet(geometry_information(objective.parameters))[1])
    spent = float(np.linalg.slogdet(fit.information)[1]) - known
    return data - 0.5 * float(prior @ prior) - 0.5 * spent
