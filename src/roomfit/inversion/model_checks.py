"""Which method and which intervals were chosen, and why, in words.

Doubts that the fits of all bands leave.

What was known beforehand beside what the data say.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roomfit.bands import Bands
from roomfit.errors import InputError
from roomfit.findings import Code, Finding
from roomfit.inversion.measurements import Measurements
from roomfit.materials.priors import MaterialPrior
from roomfit.settings import Settings
from roomfit.typing import FloatArray
from roomfit.uncertainty.gaussian import LARGEST_CHI2_REDUCED, BandAnswer
from roomfit.uncertainty.sampling import Sampled

_FEWEST_BANDS, _LARGEST_MEDIAN_CHI2 = 3, 1.5


def fit_findings(bands: Bands, answers: Sequence[BandAnswer]) -> tuple[Finding, ...]:
    """Return every doubt that the fits leave."""
    findings = []
    bad = [j for j, a in enumerate(answers) if a.chi2_reduced > LARGEST_CHI2_REDUCED]
    if bad:
        listed = ", ".join(
            f"{bands.centres_hz[j]:g} Hz ({answers[j].chi2_reduced:.1f})" for j in bad
        )
        findings.append(
            Finding(
                Code.MODEL_DOES_NOT_FIT,
                f"The model does not explain the measurement within its noise at {listed}: nothing "
                "is called identifiable there, and intervals are widened by the misfit.",
                {"bands_hz": [float(bands.centres_hz[j]) for j in bad]},
            )
        )
    slow = [j for j, a in enumerate(answers) if not a.converged]
    if slow:
        listed = ", ".join(f"{bands.centres_hz[j]:g} Hz" for j in slow)
        findings.append(
            Finding(
                Code.FIT_NOT_CONVERGED,
                f"The fit was still moving by more than a tenth of its interval at {listed}.",
                {"bands_hz": [float(bands.centres_hz[j]) for j in slow]},
            )
        )
    return tuple(findings)


def description_findings(answers: Sequence[BandAnswer]) -> tuple[Finding, ...]:
    """Return a finding where most bands are explained worse than their noise allows.

    One band that fits badly may have its own reason. Where the median over the bands is high, a
    fault is in what all of them share, the description of the room, and a band whose phi happens
    to be low is not to be trusted either. In simulated rooms described as they are the median was
    0.3 to 0.8, with a curtain or an open door forgotten 2.0, with loudspeakers of one direction
    taken for omnidirectional 1.2 to 1.6.

    Parameters
    ----------
    answers : sequence of BandAnswer, one a band
        Those of which nothing was heard are left out.
    """
    chi2_of_bands = [a.chi2_reduced for a in answers if a.model in ("coherent", "energy")]
    if len(chi2_of_bands) < _FEWEST_BANDS or not np.median(chi2_of_bands) > _LARGEST_MEDIAN_CHI2:
        return ()
    median = float(np.median(chi2_of_bands))
    return (
        Finding(
            Code.MODEL_MISFIT_ALL_BANDS,
            f"In most bands the model does not explain the measurement within its noise (median "
            f"phi {median:.1f}): something in the description of the room is not so, as a "
            "material, an opening, scattering, a source or a place. Intervals are too narrow, and "
            "nothing is called identifiable.",
            {"median_phi": median},
        ),
    )


def schroeder_findings(bands: Bands, decay_s: FloatArray, volume_m3: float) -> tuple[Finding, ...]:
    """Return a finding for the bands that begin below the Schroeder frequency.

    There a room rings in single modes and energies that add are no model of it: in simulated
    boxes the 95 % intervals of such bands held the truth less often than those above.

    Parameters
    ----------
    bands : Bands
    decay_s : float array, shape (n_bands,)
        Reverberation time of each band; NaN where unknown.
    volume_m3 : float

    References
    ----------
    .. [1] M. R. Schroeder, "The 'Schroeder frequency' revisited", J. Acoust. Soc. Am. 99,
           3240-3241 (1996): ``2000 (T / V) ** 0.5`` in Hz, s and m3.
    """
    limit_hz = 2000.0 * np.sqrt(decay_s / volume_m3)
    low = np.flatnonzero(bands.lower_hz < limit_hz)
    if not low.size:
        return ()
    listed = ", ".join(f"{bands.centres_hz[j]:g} Hz ({limit_hz[j]:.0f} Hz)" for j in low)
    return (
        Finding(
            Code.BELOW_SCHROEDER_FREQUENCY,
            f"Part of the band lies below the Schroeder frequency at {listed}: single modes decide "
            "there, which the model does not have. Trust these intervals less.",
            {"bands_hz": [float(bands.centres_hz[j]) for j in low]},
        ),
    )


_Z95 = 1.959963984540054
# Of the prior's standard deviation: what leaves more of it comes from the prior.
NEARLY_THE_PRIOR = 0.9


def prior_intervals(priors: tuple[MaterialPrior, ...]) -> FloatArray:
    """Return absorption as it was known beforehand with its 95 % interval.

    Returns
    -------
    float array, shape (3, n_materials, n_bands)
        Median, lower and upper bound; of what is held fixed three times its value. What is tied to
        another material has that one's.
    """
    by_name = {k.name: k for k in priors}
    rows = []
    for prior in priors:
        own = by_name[prior.tied_to or prior.name]
        if own.known is not None:
            rows.append(np.tile(own.known, (3, 1)))
            continue
        free = own.prior_logit_mean + np.outer((0.0, -_Z95, _Z95), own.prior_logit_sd)
        rows.append(own.lower + (own.upper - own.lower) * 0.5 * (1.0 + np.tanh(0.5 * free)))
    return np.stack(rows, axis=1)


def prior_findings(
    bands: Bands, priors: tuple[MaterialPrior, ...], answers: Sequence[BandAnswer]
) -> tuple[Finding, ...]:
    """Return a finding for each material whose answer is nearly the prior that was given for it.

    Where nothing was given, an answer that the data do not tell is wide and says so by itself; a
    prior makes it narrow.
    """
    findings = []
    for i, own in enumerate(priors):
        if own.known is not None or own.tied_to is not None or not own.specified:
            continue
        left = np.array([np.sqrt(a.logit_covariance[i, i]) for a in answers]) / own.prior_logit_sd
        fitted = np.array([a.model != "prior" for a in answers])
        bad = np.flatnonzero(fitted & (left > NEARLY_THE_PRIOR))
        if not bad.size:
            continue
        listed = ", ".join(
            f"{bands.centres_hz[j]:g} Hz ({100 * min(left[j], 1.0):.0f} %)" for j in bad
        )
        findings.append(
            Finding(
                Code.PRIOR_DOMINATED,
                f"What is told of {own.name} is nearly the prior that was given for it, with so "
                f"much of its spread left: {listed}. The data add next to nothing.",
                {
                    "material": own.name,
                    "bands_hz": [float(bands.centres_hz[j]) for j in bad],
                    "spread_left": [round(float(left[j]), 3) for j in bad],
                },
            )
        )
    return tuple(findings)


def method_chosen(method: str) -> str:
    """Return what "auto" stands for; every other method is what was asked for."""
    return "least-squares" if method == "auto" else method


def reasons(method: str, bands: Bands, answers: Sequence[BandAnswer]) -> tuple[str, ...]:
    """Return sentences on what was chosen and why; empty lines are left out.

    Parameters
    ----------
    method : str
        As the campaign has it.
    bands : Bands
    answers : sequence of BandAnswer, one a band
    """
    sentences = []
    if method == "auto":
        sentences.append(
            "Least squares from the absorption that the decays suggest: it has exact derivatives, "
            "and the other searches compare the same squares."
        )
    sentences += [_starts(answers), _certificates(method, answers), _intervals(answers)]
    if method == "posterior":
        sentences.append(_samples(bands, answers))
    return tuple(t for t in sentences if t)


def interval_words(answers: Sequence[BandAnswer]) -> str:
    """Return how the intervals were made, in a few words."""
    kinds = {kind for a in answers for kind in a.kinds}
    words = [w for kind, w in (("sampled", "sampled"), ("profile", "profiles")) if kind in kinds]
    if "gaussian" in kinds or not words:
        words.append("Gaussian, local" if not words else "else Gaussian")
    return ", ".join(words)


def sampling_findings(bands: Bands, answers: Sequence[BandAnswer]) -> tuple[Finding, ...]:
    """Return a finding for the bands whose samples did not come to rest."""
    bad = [
        (float(f), a.sampling)
        for f, a in zip(bands.centres_hz, answers, strict=True)
        if a.sampling is not None and not a.sampling.converged
    ]
    if not bad:
        return ()
    listed = ", ".join(f"{f:g} Hz ({_quality(s)})" for f, s in bad)
    return (
        Finding(
            Code.SAMPLING_NOT_CONVERGED,
            f"The samples of the posterior did not come to rest within the evaluations allowed: "
            f"{listed}. The intervals there are the Gaussian ones.",
            {
                "bands_hz": [f for f, _ in bad],
                "evaluations": [s.evaluations for _, s in bad],
                "largest_r_hat": [round(float(s.r_hat.max()), 4) for _, s in bad],
            },
        ),
    )


def _quality(found: Sampled) -> str:
    return (
        f"{found.evaluations} evaluations, autocorrelation "
        f"{found.autocorrelation.max():.0f} steps, "
        f"R-hat {found.r_hat.max():.2f}"
    )


def _starts(answers: Sequence[BandAnswer]) -> str:
    tried = [a.starts for a in answers if a.starts is not None]
    if not tried:
        return ""
    ends = sum(s.agreeing for s in tried)
    return (
        f"Energies were fitted from {tried[0].number} random starts more in each of {len(tried)} "
        f"bands: {ends} of {sum(s.number for s in tried)} ended in the answer's interval."
    )


def _certificates(method: str, answers: Sequence[BandAnswer]) -> str:
    proven = [a.certificate for a in answers if a.certificate is not None]
    if proven:
        return f"The lowest cost is proven in {sum(c.status == 'certified' for c in proven)} bands."
    if method == "auto":
        return 'There is no proof of the lowest cost: method = "certified" gives one for energies.'
    return ""


def _intervals(answers: Sequence[BandAnswer]) -> str:
    counts = {
        kind: sum(a.kinds.count(kind) for a in answers) for kind in ("profile", "gaussian", "none")
    }
    if not counts["profile"]:
        return ""
    looked = sum(len(a.profiles) for a in answers)
    return (
        f"Of {sum(counts.values())} intervals {looked} are so wide that a Gaussian may fail; "
        f"{counts['profile']} of them were skew and are profiles of the likelihood."
    )


def _samples(bands: Bands, answers: Sequence[BandAnswer]) -> str:
    done = [
        (f, a.sampling)
        for f, a in zip(bands.centres_hz, answers, strict=True)
        if a.sampling is not None and a.sampling.converged
    ]
    if not done:
        return "No band's samples came to rest."
    worst = float(np.max([s.r_hat.max() for _, s in done]))
    fewest = min(s.effective for _, s in done)
    return (
        f"Samples came to rest in {len(done)} bands: {fewest:.0f} independent ones or more, "
        f"R-hat at most {worst:.3f}."
    )


def check_certifiable(measurements: Measurements, settings: Settings) -> None:
    """Refuse a certificate of what has no bounds over boxes: pressures and room parameters.

    Raises
    ------
    InputError
        A certificate is asked for, and not of energies alone.
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
            "there is no certificate but for energies",
            where="identify.method",
            found=" and ".join(found),
            needed='impulse responses alone, and model = "energy" or "auto"',
            hint="pressures and room parameters may rise and fall with an absorption, so that "
            'boxes have no bounds: use method = "least-squares"',
        )
