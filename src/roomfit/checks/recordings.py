"""Whether each recording and table by itself is sound."""

from __future__ import annotations

from collections.abc import Iterator

from roomfit.base.air import speed_of_sound_m_s
from roomfit.base.findings import Code, Finding
from roomfit.checks.evidence import Recorded
from roomfit.fit.measurements import recording_findings


def check_tables(evidence: Recorded) -> Iterator[Finding]:
    """Yield what reading and joining tables of room parameters raised."""
    yield from evidence.measured.findings


def check(evidence: Recorded) -> Iterator[Finding]:
    """Yield what is doubtful of each recording by itself.

    Where arrivals have one cause, it is not repeated for every recording.
    """
    measured = evidence.measured
    for finding in recording_findings(measured.responses, speed_of_sound_m_s(measured.scene.air)):
        if not (evidence.arrivals and finding.code is Code.TIME_ZERO_MISMATCH):
            yield finding
