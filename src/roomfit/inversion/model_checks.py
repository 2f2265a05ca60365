"""What the answers of all bands leave in doubt, and which method and intervals were used, in words.

Findings where the model misfits one band or most of them, a fit or samples did not converge, the
prior dominates an answer, or a band lies below the Schroeder frequency.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roomfit.bands import Bands, bands_in_words
from roomfit.errors import InputError
from roomfit.eyring import schroeder_hz
from roomfit.findings import Code, Finding
from roomfit.inversion.measurements import Measurements
from roomfit.logit import Z95, expit
from roomfit.materials.priors import MaterialPrior
from roomfit.settings import Settings
from roomfit.typing import FloatArray
from roomfit.uncertainty.gaussian import LARGEST_CHI2_REDUCED, BandEstimate

_FEWEST_BANDS, _LARGEST_MEDIAN_CHI2 = 3, 1.5
# Of the prior's standard deviation: an answer that keeps more of it comes from the prior.
_PRIOR_DOMINATED = 0.9


def fit_findings(bands: Bands, answers: Sequence[BandEstimate]) -> tuple[Finding, ...]:
    """Return a finding for bands that the model misfits, and one for fits that did not converge."""
    findings = []
    bad = [j for j, a in enumerate(answers) if a.chi2_reduced > LARGEST_CHI2_REDUCED]
    if bad:
        values = [f"{answers[j].chi2_reduced:.1f}" for j in bad]
        findings.append(
            Finding(
                Code.MODEL_DOES_NOT_FIT,
                "The model does not explain the data within their noise; the reduced chi-square is "
                f"{bands_in_words(bands, bad, values)}. No material is called identifiable there, "
                "and intervals are widened by the misfit.",
                {"bands_hz": bands.centres_hz[bad].tolist()},
            )
        )
    slow = [j for j, a in enumerate(answers) if not a.converged]
    if slow:
        findings.append(
            Finding(
                Code.FIT_NOT_CONVERGED,
                "The fit did not converge within the rounds of updated weights that are allowed. "
                f"Last moved: {bands_in_words(bands, slow, [_moved(answers[j]) for j in slow])}. "
                "Allow more (max_rounds in [settings]), or fix what the data do not determine.",
                {
                    "bands_hz": bands.centres_hz[slow].tolist(),
                    "moved": [list(answers[j].moved) for j in slow],
                },
            )
        )
    return tuple(findings)


def _moved(answer: BandEstimate) -> str:
    """Return what the last round moved, in words."""
    return ", ".join(answer.moved) or answer.ending.value[0]


def description_findings(answers: Sequence[BandEstimate]) -> tuple[Finding, ...]:
    """Return a finding where the model misfits most bands.

    One band that fits badly may have its own reason. Where the median of the reduced chi-square
    over the bands is high, a fault is in what all of them share, the description of the room, and a
    band whose own value happens to be low is not to be trusted either. In simulated rooms that were
    described correctly the median was 0.3 to 0.8, with a curtain or an open door forgotten 2.0,
    with directional loudspeakers taken for omnidirectional 1.2 to 1.6.

    Parameters
    ----------
    answers : sequence of BandEstimate, one a band
        Bands of room parameters alone, and those without data, are left out.
    """
    chi2_of_bands = [a.chi2_reduced for a in answers if a.model in ("coherent", "energy")]
    if len(chi2_of_bands) < _FEWEST_BANDS or not np.median(chi2_of_bands) > _LARGEST_MEDIAN_CHI2:
        return ()
    median = float(np.median(chi2_of_bands))
    return (
        Finding(
            Code.MODEL_MISFIT_ALL_BANDS,
            "In most bands the model does not explain the data within their noise (median of the "
            f"reduced chi-square {median:.1f}): the description of the room is wrong in a "
            "material, an opening, scattering, a source or a position. Intervals are too narrow, "
            "and no material is called identifiable.",
            {"median_phi": median},
        ),
    )


def schroeder_findings(bands: Bands, decay_s: FloatArray, volume_m3: float) -> tuple[Finding, ...]:
    """Return a finding for the bands that begin below the Schroeder frequency.

    There single modes are resolved, and energies that add are no model of them: in simulated boxes
    the 95 % intervals of such bands covered the true value less often than those above.

    Parameters
    ----------
    decay_s : float array, shape (n_bands,)
        Reverberation time of each band; NaN where unknown.
    volume_m3 : float
    """
    limit_hz = schroeder_hz(decay_s, volume_m3)
    low = np.flatnonzero(bands.lower_hz < limit_hz)
    if not low.size:
        return ()
    limits = [f"{limit_hz[j]:.0f} Hz" for j in low]
    return (
        Finding(
            Code.BELOW_SCHROEDER_FREQUENCY,
            "Part of the band lies below the Schroeder frequency at "
            f"{bands_in_words(bands, low, limits)}: single modes are resolved there, which the "
            "model does not contain. Trust these intervals less.",
            {"bands_hz": bands.centres_hz[low].tolist()},
        ),
    )


def prior_intervals(priors: tuple[MaterialPrior, ...]) -> FloatArray:
    """Return the prior of absorption as its 95 % interval.

    Returns
    -------
    float array, shape (3, n_materials, n_bands)
        Median, lower and upper bound; three times the value where absorption is fixed. A material
        that is tied to another has that one's.
    """
    by_name = {k.name: k for k in priors}
    rows = []
    for prior in priors:
        own = by_name[prior.tied_to or prior.name]
        if own.known is not None:
            rows.append(np.tile(own.known, (3, 1)))
            continue
        free = own.prior_logit_mean + np.outer((0.0, -Z95, Z95), own.prior_logit_sd)
        rows.append(own.lower + (own.upper - own.lower) * expit(free))
    return np.stack(rows, axis=1)


def prior_findings(
    bands: Bands, priors: tuple[MaterialPrior, ...], answers: Sequence[BandEstimate]
) -> tuple[Finding, ...]:
    """Return a finding for each material whose answer is nearly the prior that was specified.

    Under the default prior an answer that the data do not determine has a wide interval, which
    needs no finding; a specified prior makes it narrow.
    """
    findings = []
    for i, own in enumerate(priors):
        if own.known is not None or own.tied_to is not None or not own.specified:
            continue
        left = np.array([np.sqrt(a.logit_covariance[i, i]) for a in answers]) / own.prior_logit_sd
        fitted = np.array([a.model != "prior" for a in answers])
        bad = np.flatnonzero(fitted & (left > _PRIOR_DOMINATED))
        if not bad.size:
            continue
        shares = [f"{100 * min(left[j], 1.0):.0f} %" for j in bad]
        findings.append(
            Finding(
                Code.PRIOR_DOMINATED,
                f"The absorption of {own.name} is nearly its prior, of whose standard deviation so "
                f"much is left: {bands_in_words(bands, bad, shares)}. The data add next to "
                "nothing; measure pairs whose sound strikes it more often.",
                {
                    "material": own.name,
                    "bands_hz": bands.centres_hz[bad].tolist(),
                    "spread_left": [round(float(left[j]), 3) for j in bad],
                },
            )
        )
    return tuple(findings)


def sampling_findings(bands: Bands, answers: Sequence[BandEstimate]) -> tuple[Finding, ...]:
    """Return a finding for the bands whose samples did not converge."""
    samplings = {
        j: a.sampling
        for j, a in enumerate(answers)
        if a.sampling is not None and not a.sampling.converged
    }
    if not samplings:
        return ()
    bad = list(samplings)
    notes = [
        f"{s.evaluations} evaluations, autocorrelation {s.autocorrelation.max():.0f} steps, "
        f"R-hat {s.r_hat.max():.2f}"
        for s in samplings.values()
    ]
    return (
        Finding(
            Code.SAMPLING_NOT_CONVERGED,
            "The samples of the posterior did not converge within the evaluations allowed: "
            f"{bands_in_words(bands, bad, notes)}. The intervals there are Gaussian.",
            {
                "bands_hz": bands.centres_hz[bad].tolist(),
                "evaluations": [s.evaluations for s in samplings.values()],
                "largest_r_hat": [round(float(s.r_hat.max()), 4) for s in samplings.values()],
            },
        ),
    )


def method_chosen(method: str) -> str:
    """Return what "auto" stands for; every other method is what was asked for."""
    return "least-squares" if method == "auto" else method


def interval_words(answers: Sequence[BandEstimate]) -> str:
    """Return how the intervals were made, in a few words."""
    kinds = {kind for a in answers for kind in a.kinds}
    words = [w for kind, w in (("sampled", "sampled"), ("profile", "profiles")) if kind in kinds]
    if "gaussian" in kinds or not words:
        words.append("Gaussian, local" if not words else "else Gaussian")
    return ", ".join(words)


def reasons(method: str, bands: Bands, answers: Sequence[BandEstimate]) -> tuple[str, ...]:
    """Return sentences on what was chosen and why.

    Parameters
    ----------
    method : str
        As specified: "auto", "least-squares", ...
    """
    sentences = []
    if method == "auto":
        sentences.append(
            "Least squares from the absorption that the decays suggest: it has exact derivatives, "
            "and the other searches compare the same squares."
        )
    tried = [a.starts for a in answers if a.starts is not None]
    if tried:
        sentences.append(
            f"Energies were fitted from {tried[0].number} further random starts in each of "
            f"{len(tried)} bands: {sum(s.agreeing for s in tried)} of "
            f"{sum(s.number for s in tried)} ended within the intervals of the answer."
        )
    proven = [a.certificate.status for a in answers if a.certificate is not None]
    if proven:
        sentences.append(
            f"The global minimum is proven in {proven.count('certified')} of {len(proven)} bands."
        )
    elif method == "auto":
        sentences.append(
            'The global minimum is not proven: method = "certified" does that for energies.'
        )
    kinds = [kind for a in answers for kind in a.kinds if kind in ("profile", "gaussian", "none")]
    if "profile" in kinds:
        sentences.append(
            f"Of {len(kinds)} intervals {sum(len(a.profiles) for a in answers)} are so wide that a "
            f"Gaussian may fail; {kinds.count('profile')} of them were skew and are those of the "
            "profile likelihood."
        )
    if method == "posterior":
        done = [a.sampling for a in answers if a.sampling is not None and a.sampling.converged]
        sentences.append(
            f"Samples converged in {len(done)} of {len(bands)} bands: "
            f"{min(s.effective for s in done):.0f} independent ones or more, R-hat at most "
            f"{max(float(s.r_hat.max()) for s in done):.3f}."
            if done
            else "The samples converged in no band."
        )
    return tuple(sentences)


def check_certifiable(measurements: Measurements, settings: Settings) -> None:
    """Check that a certificate is asked for only of energies of windows.

    Raises
    ------
    InputError
        Pressures or room parameters are to be fitted: they have no bounds over boxes.
    """
    if settings.method != "certified":
        return
    found = []
    if settings.model == "coherent":
        found.append('model = "coherent"')
    if measurements.values:
        found.append("room parameters that are to be fitted")
    if found:
        raise InputError(
            "a certificate exists for energies of windows only",
            where="identify.method",
            found=" and ".join(found),
            needed='impulse responses alone, and model = "energy" or "auto"',
            hint="pressures and room parameters are not monotonic in absorption, so that they "
            'have no bounds over boxes: use method = "least-squares"',
        )
