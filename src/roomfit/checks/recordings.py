"""Whether recordings and tables are sound, each by itself and beside the others."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from roomfit.base.findings import About, Code, Finding
from roomfit.checks.evidence import Evidence, Recorded, about_files, file_name
from roomfit.fit.measurements import recording_findings
from roomfit.model.observation import has_data_in_band
from roomfit.signals.decay import ParameterName, in_jnd
from roomfit.signals.measurement import MeasuredPair

# More than a listener's smallest step by a factor that no repetition at one place explains.
_LARGEST_JND, _LARGEST_LEVEL_DB = 2.0, 1.5
_COMPARED: tuple[ParameterName, ...] = ("T20_s", "EDT_s", "C80_dB")


def check_copies(evidence: Recorded) -> Iterator[Finding]:
    """Yield what reading raised, and each copy: left out where it stands where the first does."""
    yield from evidence.measured.findings
    for copy in evidence.measured.copies:
        one, other = copy.one, copy.other
        files = [one.where, other.where]
        pairs = tuple(dict.fromkeys((one.pair_name[:2], other.pair_name[:2])))
        text = f"{file_name(one)} and {file_name(other)} are one recording, sample by sample"
        once = copy.is_left_out
        text += (
            ": it was counted once."
            if once
            else f", of places that are {copy.apart_m:.2f} m apart or of two states of the room: "
            "one of them is wrong. No material is called identifiable."
        )
        yield Finding(
            Code.RECORDING_COUNTED_ONCE if once else Code.RECORDING_OF_TWO_PAIRS,
            About(files=files, pairs=pairs),
            text,
            {"files": files, "metres_apart": round(copy.apart_m, 4)},
        )


def check_single(evidence: Recorded) -> Iterator[Finding]:
    """Yield what is doubtful of each recording by itself, not of arrivals that have one cause."""
    measured = evidence.measured
    for finding in recording_findings(measured.scene, measured.responses):
        if not (evidence.arrivals and finding.code is Code.TIME_ZERO_MISMATCH):
            yield finding


def check_repeats(evidence: Recorded) -> Iterator[Finding]:
    """Yield a finding for each pair that was measured twice with results that differ.

    T20, EDT and C80 by more than 2 just noticeable differences, levels that share a gain by 1.5 dB.
    """
    for one, other in combinations(evidence.measured.responses, 2):
        ways = _differing(one, other) if one.pair == other.pair else []
        if not ways:
            continue
        own, pair = one.measurement, one.measurement.pair_name[:2]
        files = [own.where, other.measurement.where]
        yield Finding(
            Code.REPEATED_RESPONSES_DIFFER,
            About(files=files, pairs=[pair]),
            f"{' to '.join(pair)} was measured twice ({own.name} and {other.measurement.name}) "
            f"with different results: {'; '.join(ways)}. One of them may belong to another pair, "
            "or the room was changed in between.",
            {"source": pair[0], "receiver": pair[1], "files": files, "differences": ways},
        )


def _differing(one: MeasuredPair, other: MeasuredPair) -> list[str]:
    """Return in words in which decays and levels two responses differ."""
    parts, centres_hz = [], one.curve.bands.centres_hz
    for name in _COMPARED:
        first, second = one.parameters.of(name), other.parameters.of(name)
        mean = 0.5 * (first + second)  # so that the order does not matter
        steps = np.abs(np.nan_to_num(in_jnd(name, mean, mean + first - second), nan=0.0))
        j = int(np.argmax(steps))
        if steps[j] > _LARGEST_JND:
            symbol, unit = name.split("_")
            at = f"at {centres_hz[j]:g} Hz"
            parts.append(f"{symbol} {first[j]:.2f} and {second[j]:.2f} {unit} {at}")
    if one.measurement.level == other.measurement.level != "per-file":
        total = np.array([m.curve.energy_left[:, 0] for m in (one, other)])
        levels_db = 10.0 * np.log10(np.where(total > 0.0, total, np.nan))
        apart_db = np.abs(np.nan_to_num(levels_db[0] - levels_db[1], nan=0.0))
        j = int(np.argmax(apart_db))
        if apart_db[j] > _LARGEST_LEVEL_DB:
            parts.append(f"levels that differ by {apart_db[j]:.1f} dB at {centres_hz[j]:g} Hz")
    return parts


def check_below_noise(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding for each recording that is left out of some bands."""
    centres_hz = evidence.measured.bands.centres_hz.tolist()
    for m in evidence.measured.responses:
        own = m.measurement
        missing = [f for band, f in enumerate(centres_hz) if not has_data_in_band(m, band)]
        if own.use == "fit" and missing:
            yield Finding(
                Code.RECORDING_BELOW_NOISE,
                About(bands_hz=missing, files=[own.where], pairs=[own.pair_name[:2]]),
                f"{file_name(own)}: no decay rises above the noise at "
                f"{', '.join(f'{f:g}' for f in missing)} Hz; it was not fitted there.",
                {"bands_hz": missing},
            )


def check_outliers(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding for each recording whose variance was inflated, in their order."""
    outliers = evidence.fits.tests.outliers
    for m in (p.measurement for p in evidence.measured.responses if p.measurement in outliers):
        yield Finding(
            Code.MEASUREMENT_OUTLIER,
            about_files(m),
            f"{file_name(m)} is an outlier: its mean squared residual is {outliers[m]:.0f} times "
            "that of the other measurements. Its variance was inflated by that factor. Check its "
            "file, its positions and its level.",
            {"ratio": outliers[m]},
        )
