"""Which profiles and which band's samples are worth a picture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roomfit.typing import FloatArray
from roomfit.uncertainty.answer import Answer
from roomfit.uncertainty.profile import Profile

MOST_PROFILES = 12


def shown_profiles(answer: Answer) -> list[tuple[int, Profile]]:
    """Return bands and profiles that took the place of a Gaussian, the widest.

    At most twelve, in the order of bands and materials.
    """
    bent = [
        (band, line)
        for band, lines in enumerate(answer.profiles)
        for line in lines
        if not line.gaussian and answer.interval_kinds[band][line.entry] == "profile"
    ]
    if len(bent) <= MOST_PROFILES:
        return bent
    worth = [answer.upper95[p.entry, b] - answer.lower95[p.entry, b] for b, p in bent]
    chosen = sorted(np.argsort(worth)[-MOST_PROFILES:])
    return [bent[i] for i in chosen]


def most_tied_band(samples: Sequence[FloatArray | None]) -> int | None:
    """Return the sampled band in which two materials are correlated most, None if none is.

    Examples
    --------
    >>> x = np.linspace(0.0, 1.0, 50)
    >>> most_tied_band([None, np.stack([x, x**0.5], axis=1), np.stack([x, x % 0.1], axis=1)])
    1
    """
    best: tuple[float, int] | None = None
    for band, draws in enumerate(samples):
        if draws is None:
            continue
        free = draws[:, np.ptp(draws, axis=0) > 0.0]
        n = free.shape[1]
        if n < 1:
            continue
        tied = np.abs(np.corrcoef(free.T)).reshape(n, n) - np.eye(n)
        most = float(tied.max())
        if best is None or most > best[0]:
            best = (most, band)
    return None if best is None else best[1]
