"""Whether a pair that was measured twice gave the same."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import FloatArray
from roomfit.checks.evidence import Law, Recorded, pair_of
from roomfit.signals.decay import ParameterName, in_jnd
from roomfit.signals.measurement import MeasuredPair

# More than a listener's smallest step by a factor that no repetition at one place explains.
LARGEST_JND = 2.0
LARGEST_LEVEL_DB = 1.5
_COMPARED: tuple[ParameterName, ...] = ("T20_s", "EDT_s", "C80_dB")

LAWS = {
    Code.REPEATED_RESPONSES_DIFFER: Law(
        "two responses of one pair have the same decays and levels",
        "difference of T20, EDT or C80 in just noticeable differences, of levels in dB",
    )
}


def check(evidence: Recorded) -> Iterator[Finding]:
    """Yield a finding for each pair that was measured twice with results that differ.

    Compared are T20, EDT and C80, by more than 2 just noticeable differences, and the levels of the
    bands where they are said to be alike (measurements of one source that share its gain), by more
    than 1.5 dB. Nothing but the two responses is used: no position, no model.
    """
    for one, other in combinations(evidence.measured.responses, 2):
        if one.pair != other.pair:
            continue
        ways = [*_differing(one, other), *_levels(one, other)]
        if not ways:
            continue
        names = f"{one.measurement.name} and {other.measurement.name}"
        files = [one.measurement.where, other.measurement.where]
        yield Finding(
            Code.REPEATED_RESPONSES_DIFFER,
            About(files=files, pairs=[pair_of(one.measurement)]),
            f"{one.measurement.source} to {one.measurement.receiver} was measured twice "
            f"({names}) with different results: {'; '.join(ways)}. One of them may belong to "
            "another pair, or the room was changed in between.",
            {
                "source": one.measurement.source,
                "receiver": one.measurement.receiver,
                "files": files,
                "differences": ways,
            },
        )


def _differing(one: MeasuredPair, other: MeasuredPair) -> list[str]:
    parts = []
    for name in _COMPARED:
        first, second = one.parameters.of(name), other.parameters.of(name)
        # from their mean, so that the order does not matter
        steps = np.abs(
            in_jnd(name, 0.5 * (first + second), 0.5 * (first + second) + first - second)
        )
        known: FloatArray = np.abs(np.nan_to_num(steps, nan=0.0))
        if known.max() > LARGEST_JND:
            j = int(np.argmax(known))
            symbol, unit = name.split("_")
            parts.append(
                f"{symbol} {first[j]:.2f} and {second[j]:.2f} {unit} "
                f"at {one.curve.bands.centres_hz[j]:g} Hz"
            )
    return parts


def _levels(one: MeasuredPair, other: MeasuredPair) -> list[str]:
    if one.measurement.level != other.measurement.level or one.measurement.level == "per-file":
        return []
    difference = _level_db(one) - _level_db(other)
    known: FloatArray = np.abs(np.nan_to_num(difference, nan=0.0))
    if known.max() <= LARGEST_LEVEL_DB:
        return []
    j = int(np.argmax(known))
    return [f"levels that differ by {known[j]:.1f} dB at {one.curve.bands.centres_hz[j]:g} Hz"]


def _level_db(m: MeasuredPair) -> FloatArray:
    total = m.curve.energy_left[:, 0]
    return 10.0 * np.log10(np.where(total > 0.0, total, np.nan))
