"""Bands of a campaign fitted with a proof that no other absorption does better."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roomfit.bands import Bands
from roomfit.errors import InputError
from roomfit.files.campaign.campaign import Campaign
from roomfit.findings import Finding
from roomfit.identification.certified.certificate import Certificate, certify
from roomfit.identification.certified.questions import (
    energy_question,
    free_vector,
    is_certifiable,
)
from roomfit.identification.certified.search import SearchSettings
from roomfit.identification.least_squares import ResidualFunction
from roomfit.identification.reweighted import BandFit, fit_band
from roomfit.identification.solvers import Solver, gauss_newton
from roomfit.objective.energy_problem import EnergyProblem, tracing_variance
from roomfit.objective.parameters import physical_values
from roomfit.objective.problem import BandProblem
from roomfit.typing import FloatArray, Progress

# Of half the weighted squares: one standard deviation costs 0.5.
_LEAST_DELTA = 0.02
# Of boxes left over; narrower ones would tell more of the places, and take longer.
_WIDTH = 0.25
# Weights change with the answer: certify, fit again from the best place, certify again.
_ROUNDS = 2


@dataclass(frozen=True, slots=True)
class CertifyLimits:
    """How much one band may cost.

    Attributes
    ----------
    max_boxes : int
    max_seconds : float
    max_rows : int
        Rows of all windows, paths of equal hits as one.
    """

    max_boxes: int = 200_000
    max_seconds: float = 60.0
    max_rows: int = 400_000


# What a proof that nobody asked for may cost. With more unknowns it took a minute.
AFFORDABLE = CertifyLimits(max_boxes=3_000, max_seconds=2.0, max_rows=60_000)
_AFFORDABLE_UNKNOWNS = 3
# Half of what one standard deviation costs: finer proofs take many times as many boxes.
_AFFORDABLE_DELTA = 0.25


def check_certifiable(campaign: Campaign) -> None:
    """Refuse a certificate of what has no bounds over boxes: pressures and room parameters.

    Raises
    ------
    InputError
        A certificate is asked for, and not of energies alone.
    """
    if campaign.method != "certified":
        return
    found = []
    if campaign.model == "coherent":
        found.append('model = "coherent"')
    if any(t.use == "fit" for t in campaign.tables):
        found.append("room parameters that are to be fitted")
    if found:
        raise InputError(
            "there is no certificate but for energies",
            where=f"{campaign.path}, identify.method",
            found=" and ".join(found),
            needed='impulse responses alone, and model = "energy" or "auto"',
            hint="pressures and room parameters may rise and fall with an absorption, so that "
            'boxes have no bounds: use method = "least-squares"',
        )


def certified_fit(
    problem: BandProblem,
    limits: CertifyLimits | None = None,
    *,
    progress: Progress | None = None,
) -> tuple[BandFit, Certificate | None]:
    """Fit one band by least squares, and prove how low its cost can be.

    Where the search finds a better place, the fit starts again from there, and the proof is made
    again with the weights of the new answer. There is none where nothing is unknown.

    Raises
    ------
    InputError
        The band holds other data than energies, or more rows than the limits allow.
    """
    limits = CertifyLimits() if limits is None else limits
    if not isinstance(problem, EnergyProblem):
        raise InputError(
            "only energies can be certified",
            found="room parameters, or pressures that are added",
            needed='impulse responses alone, method = "certified" and model = "energy" or "auto"',
            hint='use method = "least-squares"',
        )
    fit = fit_band(problem, gauss_newton, gauss_newton)
    if not fit.vector.size:
        return fit, None
    for number in range(_ROUNDS):
        question = energy_question(problem, fit.vector)
        if len(question.weight) > limits.max_rows:
            raise InputError(
                "too many rows for a certificate",
                found=f"{len(question.weight)} at {problem.centre_hz:g} Hz",
                needed=f"at most {limits.max_rows}",
                hint='fewer materials, fewer pairs, or method = "least-squares"',
            )
        settings = _settings(limits, tracing_delta(problem, fit.vector, question.precision))
        certificate = certify(question, settings)
        if progress is not None:
            progress((number + 1) / _ROUNDS)
        if fit.cost <= certificate.value + 1e-3 + 0.01 * settings.delta:
            break
        place = free_vector(problem, certificate.clusters[0].minimiser)
        fit = fit_band(problem, _staying_at(place), gauss_newton)
    return fit, certificate


def affordable_certificate(problem: BandProblem, vector: FloatArray) -> Certificate | None:
    """Return what is proven of a band's energies near a fit, where that takes a moment.

    None where other data are fitted, more than three numbers are unknown, there are too many rows,
    or the search is not complete after two seconds.

    Parameters
    ----------
    problem : BandProblem
    vector : float array, shape (n_free,)
        The fit; its weights are held.
    """
    few = 0 < vector.size <= _AFFORDABLE_UNKNOWNS
    if not (few and isinstance(problem, EnergyProblem) and is_certifiable(problem)):
        return None
    question = energy_question(problem, vector)
    if len(question.weight) > AFFORDABLE.max_rows:
        return None
    delta = max(tracing_delta(problem, vector, question.precision), _AFFORDABLE_DELTA)
    certificate = certify(question, _settings(AFFORDABLE, delta))
    return certificate if certificate.status == "certified" else None


def _settings(limits: CertifyLimits, delta: float) -> SearchSettings:
    return SearchSettings(
        delta, width=_WIDTH, max_boxes=limits.max_boxes, max_seconds=limits.max_seconds
    )


def _staying_at(place: FloatArray) -> Solver:
    def stay(_residuals: ResidualFunction, _start: FloatArray) -> FloatArray:
        return place

    return stay


def tracing_delta(problem: EnergyProblem, vector: FloatArray, precision: FloatArray) -> float:
    """Return how much of a cost may be the rays' own doing: nothing below it is told apart.

    Other rays change window energies by errors e of variance v, and the cost ``sum c (r + e)**2``
    by ``sum c v`` on average, give or take twice ``(sum (2 c r)**2 v) ** 0.5``.

    Parameters
    ----------
    vector : float array, shape (n_free,)
    precision : float array, shape (n_windows,)
        c.

    Returns
    -------
    float
        Not below 0.02, a 25th of what one standard deviation costs.
    """
    values, _ = physical_values(problem.parameters, vector)
    gains = np.append(values["gain"], 1.0)
    variance = np.concatenate(
        [
            gains[seen.gain] ** 2
            * tracing_variance(rows, seen, values["absorption"][:, None], np.zeros(1))
            for rows, seen in zip(problem.rows, problem.observations, strict=True)
        ]
    )
    off = problem.predict(vector).expected - problem.measured()
    linear = float(np.sqrt(np.sum((2.0 * precision * off) ** 2 * variance)))
    return max(float(np.sum(precision * variance)) + 2.0 * linear, _LEAST_DELTA)


def certificate_findings(
    bands: Bands, certificates: Sequence[Certificate | None]
) -> tuple[Finding, ...]:
    """Return a finding for bands without proof, and one for those with several answers."""
    findings = []
    named = [(float(f), c) for f, c in zip(bands.centres_hz, certificates, strict=True)]
    open_ = [(f, c) for f, c in named if c is not None and c.status != "certified"]
    if open_:
        told = ", ".join(f"{f:g} Hz (at most {c.value - c.lower_bound:.2g})" for f, c in open_)
        findings.append(
            Finding(
                "not-certified",
                "warning",
                "The search for a better answer was stopped before it was complete; the cost could "
                f"be lower at {told}.",
                {"bands_hz": [f for f, _ in open_]},
            )
        )
    several = [(f, c) for f, c in named if c is not None and len(c.clusters) > 1]
    if several:
        told = ", ".join(f"{f:g} Hz ({len(c.clusters)} places)" for f, c in several)
        findings.append(
            Finding(
                "several-answers",
                "warning",
                f"Absorptions far apart explain the energies within what rays can tell: {told}. "
                "The intervals are about one of them; fit.certified holds all.",
                {"bands_hz": [f for f, _ in several]},
            )
        )
    return tuple(findings)
