"""What planning and tracing the paths raised: rays, images and weights."""

from __future__ import annotations

from collections.abc import Iterator

from roomfit.base.findings import Finding
from roomfit.checks.evidence import Evidence


def check(evidence: Evidence) -> Iterator[Finding]:
    """Yield what planning and tracing raised, as it stands."""
    yield from evidence.traced.findings
