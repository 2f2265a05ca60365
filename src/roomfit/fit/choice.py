"""What is chosen along the way, by evidence: one rule for all that has alternatives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

T = TypeVar("T")


def choose(
    alternatives: Sequence[T], log_evidence: Sequence[float], alike: float, least_gain: float = 0.0
) -> tuple[T, list[T]]:
    """Return the alternative of largest evidence, and all that do as well, in their order.

    The first one is what stands by default: another is chosen where it gains more than
    `least_gain`. As well do those whose log-evidence is lower than the largest by `alike` or less.

    Examples
    --------
    >>> choose(["as specified", "moved"], [-3.0, -2.0], alike=2.0)
    ('moved', ['as specified', 'moved'])
    """
    most = max(log_evidence)
    best = list(log_evidence).index(most) if most > log_evidence[0] + least_gain else 0
    each = zip(alternatives, log_evidence, strict=True)
    return alternatives[best], [one for one, found in each if found >= log_evidence[best] - alike]
