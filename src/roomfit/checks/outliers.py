"""Whether some recordings are explained far worse than all others."""

from __future__ import annotations

from collections.abc import Iterator

from roomfit.base.findings import About, Code, Finding
from roomfit.checks.evidence import Evidence, Law, file_name, pair_of

LAWS = {
    Code.MEASUREMENT_OUTLIER: Law(
        "all recordings are explained alike",
        "misfit of a recording over the median of all, in the median band, above 4",
    )
}


def check(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding for each recording whose variance was inflated, in their order."""
    outliers = evidence.fits.tests.outliers
    for m in (p for p in evidence.measured.responses if p.measurement in outliers):
        own, ratio = m.measurement, outliers[m.measurement]
        yield Finding(
            Code.MEASUREMENT_OUTLIER,
            About(files=[own.where], pairs=[pair_of(own)]),
            f"{file_name(own)} is an outlier: its mean squared residual is {ratio:.0f} times that "
            "of the other measurements. Its variance was inflated by that factor. Check its file, "
            "its positions and its level.",
            {"ratio": ratio},
        )
