"""Whether fits converged."""

from __future__ import annotations

from collections.abc import Iterator

from roomfit.base.bands import bands_in_words
from roomfit.base.findings import About, Code, Finding
from roomfit.checks.evidence import Evidence, Law

LAWS = {
    Code.FIT_NOT_CONVERGED: Law("the fit converged", "rounds of updated weights"),
}


def check(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding for the bands whose fits did not converge."""
    bands, answers = evidence.measured.bands, evidence.fits.answers
    slow = [j for j, a in enumerate(answers) if not a.converged]
    if slow:
        # what the last round moved, in words
        moved = [", ".join(answers[j].moved) or answers[j].ending.value[0] for j in slow]
        yield Finding(
            Code.FIT_NOT_CONVERGED,
            About(bands_hz=bands.centres_hz[slow].tolist()),
            "The fit did not converge within the rounds of updated weights that are allowed. "
            f"Last moved: {bands_in_words(bands, slow, moved)}. "
            "Allow more (max_rounds in [settings]), or fix what the data do not determine.",
            {
                "bands_hz": bands.centres_hz[slow].tolist(),
                "moved": [list(answers[j].moved) for j in slow],
            },
        )
