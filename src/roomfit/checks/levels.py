"""Whether recordings that share a gain have one level, and those of one source one polarity."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from roomfit.base.findings import Code, Finding
from roomfit.base.typing import FloatArray
from roomfit.checks.evidence import Recorded, about_files, files_in_words, of_files
from roomfit.signals.measurement import MeasuredPair, Measurement
from roomfit.signals.response import find_onset, times_s

# The reverberant level of a source varies by 1 to 2 dB over a room, the direct sound's more. Two
# files say nothing of how alike others are: of 87 right rooms with loudspeakers 3 made 4 to 4.7 dB.
_LEAST_STEP_DB, _LEAST_STEP_OF_TWO_DB, _WITHIN_DB, _DIRECT_WITHIN_DB = 4.0, 5.0, 1.2, 2.0
_DIRECT_S, _BEFORE_S = 1.5e-3, 0.3e-3
_LIKENESS = 0.6  # of two direct sounds, whose sign it decides


def check_levels(evidence: Recorded) -> Iterator[Finding]:
    """Yield a finding where recordings that share a gain fall into two levels apart.

    Or have the same peak each, as files that were normalised one by one. Only a gain moves the
    direct sound, with the distance allowed for, and the reverberant field 50 ms later alike.
    """
    groups: dict[tuple[str, str], list[MeasuredPair]] = {}
    for m in evidence.measured.responses:
        own = m.measurement
        if own.level != "per-file":
            key = "" if own.level == "absolute" else own.source
            groups.setdefault((key, own.state), []).append(m)
    for group in groups.values():
        finding = _levelled(group) or _stepped(group)
        if finding is not None:
            yield finding


def _levelled(group: Sequence[MeasuredPair]) -> Finding | None:
    """Return that all have one peak, to 16 bits, although direct sounds travel 1 dB apart."""
    sizes = [np.abs(m.measurement.response.pressure) for m in group]
    direct_s = [m.direct_s for m in group]
    peaks = np.array([x.max() for x in sizes])
    # several samples have it where peaks are cut off
    single = all(np.count_nonzero(x > 0.9999 * x.max()) == 1 for x in sizes)
    alike = single and bool(np.ptp(peaks) <= 1e-4 * peaks.max())
    if len(group) < 3 or not alike or max(direct_s) <= 1.12 * min(direct_s):
        return None
    files, peak = [m.measurement for m in group], float(peaks[0])
    text = (
        f"All {len(files)} files of {', '.join(dict.fromkeys(f.source for f in files))} have the "
        f"same peak, {peak:.3g}, at unlike distances: they were normalised one by one, and their "
        'levels say nothing. Set level = "per-file", or export them without normalisation.'
    )
    return _apart(files, text, {"peak": peak})


def _stepped(group: Sequence[MeasuredPair]) -> Finding | None:
    """Return that levels of direct sound and decay fall into two groups, by another gain."""
    energies = np.array([float(np.sum(_direct_sound(m) ** 2)) for m in group])
    with np.errstate(divide="ignore"):
        direct_db = 10.0 * np.log10(energies) + 20.0 * np.log10([m.direct_s for m in group])
    late_db = _late_levels_db(group)
    if len(group) < 2 or not np.all(np.isfinite(late_db + direct_db)):
        return None
    order = np.argsort(late_db)
    steps = np.diff(late_db[order])
    at = int(np.argmax(steps)) + 1
    low, high = order[:at], order[at:]
    both = (late_db, direct_db)
    step_db, apart_db = (float(np.median(x[high]) - np.median(x[low])) for x in both)
    alike = max(np.std(late_db[low]), np.std(late_db[high])) <= _WITHIN_DB
    least_db = _LEAST_STEP_DB if len(group) > 2 else _LEAST_STEP_OF_TWO_DB
    if steps[at - 1] < least_db or not alike or abs(step_db - apart_db) > _DIRECT_WITHIN_DB:
        return None
    odd, way = (high, "louder") if len(high) <= len(low) else (low, "softer")
    files = [group[i].measurement for i in odd]
    names = f"{', '.join(m.name for m in files[:4])}{' and more' if files[4:] else ''}"
    text = (
        f"{names}: {step_db:.1f} dB {way} than the other {len(group) - len(files)} files of "
        f"{files[0].source}, direct sound and decay alike, as by another gain: set level = "
        '"per-file", or correct the levels.'
    )
    return _apart(files, text, {"step_db": step_db})


def _apart(files: Sequence[Measurement], text: str, numbers: dict[str, Any]) -> Finding:
    numbers |= {"files": [m.where for m in files]}
    advised = of_files(files, "level", "per-file")
    return Finding(Code.LEVELS_APART, about_files(*files), text, numbers, remedies=[advised])


def _late_levels_db(group: Sequence[MeasuredPair]) -> FloatArray:
    """Return reverberant levels, the mean over the bands that all have by bandwidth, (n,)."""
    rows = []
    for m in group:
        at_s = m.curve.onset_s + 0.05
        left = np.array([np.interp(at_s, m.curve.time_s, row) for row in m.curve.energy_left])
        has_level = (left > 0.0) & (m.curve.usable_end_s > at_s)
        rows.append(10.0 * np.log10(np.where(has_level, left, np.nan)))
    levels = np.array(rows)
    known = np.all(np.isfinite(levels), axis=0)
    if not known.any():
        return np.full(len(group), np.nan)
    # a level fluctuates the less, the wider its band
    weights = group[0].curve.bands.centres_hz[known]
    return np.asarray(levels[:, known] @ weights / weights.sum())


def check_polarity(evidence: Recorded) -> Iterator[Finding]:
    """Yield a finding where some recordings have the opposite polarity of the others.

    By the largest correlation of direct sounds of one source. Fits are not affected.
    """
    measured = evidence.measured.responses
    by_source: dict[str, list[MeasuredPair]] = {}
    for m in measured:
        by_source.setdefault(m.measurement.source, []).append(m)
    inverted: list[Measurement] = []
    for group in by_source.values():
        sounds = [_direct_sound(m) for m in group]
        strongest = int(np.argmax([float(np.max(np.abs(s), initial=0.0)) for s in sounds]))
        likeness = np.array([_likeness(s, sounds[strongest]) for s in sounds])
        signs = np.where(np.abs(likeness) < _LIKENESS, 0.0, np.sign(likeness))
        n, odd = np.count_nonzero(signs), 1 if np.sum(signs) < 0 else -1
        minority = [group[i].measurement for i in np.flatnonzero(signs == odd)]
        inverted += minority if n >= 3 and 2 * len(minority) < n else []
    if inverted:
        who = files_in_words(inverted, len(measured))
        yield Finding(
            Code.POLARITY_DIFFERS,
            about_files(*inverted),
            f"{who[0].upper()}{who[1:]} have the opposite polarity of the others of their source: "
            "a cable, a channel or a microphone differs. The fit does not depend on it.",
            {"files": [m.where for m in inverted]},
        )


def _likeness(sound: FloatArray, reference: FloatArray) -> float:
    """Return the largest correlation, of either sign."""
    norm = float(np.linalg.norm(sound) * np.linalg.norm(reference))
    correlated = np.correlate(sound, reference, mode="full")
    return float(correlated[int(np.argmax(np.abs(correlated)))]) / norm if norm > 0.0 else 0.0


def _direct_sound(m: MeasuredPair) -> FloatArray:
    """Return the samples about the onset, as measured."""
    since_s = times_s(m.response) - find_onset(m.response, m.measurement.where)
    return np.asarray(m.response.pressure[(since_s >= -_BEFORE_S) & (since_s <= _DIRECT_S)])
