"""Which method and which intervals were chosen, and why, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roomfit.app.fitting import BandAnswer
from roomfit.bands import Bands
from roomfit.findings import Finding
from roomfit.uncertainty.sampling import Sampled


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
    told = []
    if method == "auto":
        told.append(
            "Least squares from the absorption that the decays suggest: it has exact derivatives, "
            "and the other searches compare the same squares."
        )
    told += [_starts(answers), _certificates(method, answers), _intervals(answers)]
    if method == "posterior":
        told.append(_samples(bands, answers))
    return tuple(t for t in told if t)


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
    told = ", ".join(f"{f:g} Hz ({_quality(s)})" for f, s in bad)
    return (
        Finding(
            "posterior-not-sampled",
            "warning",
            f"The samples of the posterior did not come to rest within the evaluations allowed: "
            f"{told}. The intervals there are the Gaussian ones.",
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
