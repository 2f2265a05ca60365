"""Whether energies have one minimum: by random starts."""

from __future__ import annotations

from collections.abc import Iterator

from roomfit.base.findings import About, Code, Finding
from roomfit.checks.evidence import Evidence, Law

LAWS = {
    Code.MULTIPLE_MINIMA_MULTISTART: Law(
        "all starts whose log-likelihood is within 2 end within the intervals",
        "ends of fits from random starts",
    )
}


def check_starts(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding where another place explains the energies alike."""
    lower_minima = [
        (float(f), e.starts)
        for f, e in zip(evidence.measured.bands.centres_hz, evidence.fits.answers, strict=True)
        if e.starts is not None and e.starts.other is not None
    ]
    if not lower_minima:
        return
    centres_hz = [f for f, _ in lower_minima]
    where = ", ".join(f"{f:g} Hz (log-likelihood lower by {s.loss:.1f})" for f, s in lower_minima)
    yield Finding(
        Code.MULTIPLE_MINIMA_MULTISTART,
        About(bands_hz=centres_hz),
        "Least squares from another start ends in absorptions outside of the intervals that "
        f"explain the energies alike: {where}. Measure more positions, or tell what is known.",
        {
            "bands_hz": centres_hz,
            "other_answer": [
                {n: round(float(a), 6) for n, a in zip(evidence.materials, s.other, strict=True)}
                for _, s in lower_minima
                if s.other is not None
            ],
            "log_likelihood_lower_by": [round(s.loss, 3) for _, s in lower_minima],
        },
    )
