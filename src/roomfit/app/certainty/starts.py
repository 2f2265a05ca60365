"""Energies of a band fitted from random starts as well: do they end in one place?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roomfit.bands import Bands
from roomfit.findings import Finding
from roomfit.identification.least_squares import ResidualFunction
from roomfit.identification.reweighted import BandFit, first_round, fit_band
from roomfit.identification.solvers import few_gauss_newton_steps, gauss_newton
from roomfit.objective.parameters import physical_values, position_of, prior_residuals, start_vector
from roomfit.objective.problem import BandProblem
from roomfit.typing import FloatArray
from roomfit.uncertainty.gaussian import absorption_intervals

N_STARTS = 3
# Log-likelihoods with priors that differ by less do not decide between two places.
ALIKE = 2.0
# Of a standard deviation: first rounds end within a hundredth of where they lead.
_SAME_PLACE = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Starts:
    """Where least squares from random starts ended.

    Attributes
    ----------
    number : int
        Of random starts.
    agreeing : int
        How many of them ended within the interval of the best.
    other : float array, shape (n_materials,), or None
        The likeliest absorption outside of it that explains the data alike.
    loss : float
        By how much its log-likelihood, prior included, is lower.
    """

    number: int
    agreeing: int
    other: FloatArray | None
    loss: float


def from_random_starts(
    problem: BandProblem, fit: BandFit, rng: np.random.Generator, number: int = N_STARTS
) -> tuple[BandFit, Starts]:
    """Return the likeliest of a fit and of others from random starts, and whether they agree.

    Starts are drawn evenly over absorption, gains as in the fit. Those whose first round ends where
    that of the usual start does are not followed any further.

    Parameters
    ----------
    problem : BandProblem
    fit : BandFit
    rng : numpy Generator
    number : int
    """
    usual = first_round(problem, gauss_newton, start_vector(problem.parameters))
    sd = np.sqrt(np.diag(np.linalg.inv(fit.information)))
    fits = [fit]
    for _ in range(number):
        place = first_round(problem, gauss_newton, _random_start(problem, fit, rng))
        alike = bool(np.all(np.abs(place - usual) <= _SAME_PLACE * sd))
        fits.append(fit if alike else _from(problem, place))
    worth = [_log_posterior(problem, f) for f in fits]
    best = int(np.argmax(worth))
    # rounding and rounds of weights are no better answer
    best = best if worth[best] > worth[0] + 0.05 else 0
    found = absorption_intervals(
        problem.parameters, fits[best].vector, fits[best].information, fits[best].phi
    )
    places = [physical_values(problem.parameters, f.vector)[0]["absorption"] for f in fits]
    within = [bool(np.all((p >= found.lower95) & (p <= found.upper95))) for p in places]
    losses = [worth[best] - w for w in worth]
    others = [i for i in range(len(fits)) if not within[i] and losses[i] < ALIKE]
    nearest = min(others, key=lambda i: losses[i], default=None)
    return fits[best], Starts(
        number,
        sum(within) - 1,
        None if nearest is None else places[nearest],
        0.0 if nearest is None else float(losses[nearest]),
    )


def starts_findings(
    bands: Bands, materials: tuple[str, ...], starts: Sequence[Starts | None]
) -> tuple[Finding, ...]:
    """Return a finding where another place explains the energies alike."""
    told = [
        (float(f), s)
        for f, s in zip(bands.centres_hz, starts, strict=True)
        if s and s.other is not None
    ]
    if not told:
        return ()
    where = ", ".join(f"{f:g} Hz (log-likelihood lower by {s.loss:.1f})" for f, s in told)
    return (
        Finding(
            "other-minimum",
            "warning",
            "Least squares from another start ends in absorptions outside of the intervals that "
            f"explain the energies alike: {where}. Measure more positions, or tell what is known.",
            {
                "bands_hz": [f for f, _ in told],
                "other_answer": [
                    {n: round(float(a), 6) for n, a in zip(materials, s.other, strict=True)}
                    for _, s in told
                    if s.other is not None
                ],
                "log_likelihood_lower_by": [round(s.loss, 3) for _, s in told],
            },
        ),
    )


def _from(problem: BandProblem, start: FloatArray) -> BandFit:
    def there(residuals: ResidualFunction, _start: FloatArray) -> FloatArray:
        return gauss_newton(residuals, start)

    return fit_band(problem, there, few_gauss_newton_steps)


def _random_start(problem: BandProblem, fit: BandFit, rng: np.random.Generator) -> FloatArray:
    start, first = np.array(fit.vector), position_of(problem.parameters, "absorption")
    block = next(b for b in problem.parameters.blocks if b.name == "absorption")
    share = rng.uniform(0.02, 0.98, int(np.count_nonzero(block.fitted)))
    start[first : first + share.size] = np.log(share) - np.log1p(-share)
    return start


def _log_posterior(problem: BandProblem, fit: BandFit) -> float:
    prior, _ = prior_residuals(problem.parameters, fit.vector)
    return fit.log_likelihood - 0.5 * float(prior @ prior)
