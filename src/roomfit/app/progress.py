"""One bar for several steps of a job."""

from __future__ import annotations

from roomfit.typing import Progress


def part(progress: Progress | None, begin: float, end: float) -> Progress | None:
    """Return a progress function for the part of a job from one fraction to another."""
    if progress is None:
        return None
    whole = progress

    def report(fraction: float) -> None:
        whole(begin + (end - begin) * fraction)

    return report
