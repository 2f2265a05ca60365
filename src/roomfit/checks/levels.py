"""Whether recordings that share a gain have one level."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import FloatArray
from roomfit.checks.evidence import Law, Recorded, pair_of
from roomfit.checks.polarity import direct_sound
from roomfit.signals.measurement import MeasuredPair

# The reverberant level of a source varies by 1 to 2 dB over a room, the direct sound's more. Two
# files say nothing of how alike others are: of 87 right rooms with loudspeakers 3 made 4 to 4.7 dB.
_LEAST_STEP_DB, _LEAST_STEP_OF_TWO_DB, _WITHIN_DB, _DIRECT_WITHIN_DB = 4.0, 5.0, 1.2, 2.0
_LATE_S = 0.05

LAWS = {
    Code.LEVELS_APART: Law(
        "recordings of one source and state share their gain",
        "the largest step between reverberant levels, which direct sounds make as well; or peaks "
        "that are equal to 16 bits",
    )
}


def check(evidence: Recorded) -> Iterator[Finding]:
    """Yield a finding where recordings that share a gain fall into two levels apart.

    Or have the same peak each, as files that were normalised one by one. Else compared are the
    energy of the direct sound, with the distance allowed for, and the level of the reverberant
    field 50 ms later, which hardly depends on position: only a gain moves both by the same number
    of decibels.
    """
    groups: dict[tuple[str, str], list[MeasuredPair]] = {}
    for m in evidence.measured.responses:
        own = m.measurement
        if own.level != "per-file":
            key = "" if own.level == "absolute" else own.source
            groups.setdefault((key, own.state), []).append(m)
    for group in groups.values():
        peaks = [_peak(m) for m in group]
        if len(group) > 2 and _is_levelled(peaks, [m.direct_s for m in group]):
            yield _levelled(group, peaks[0])
            continue
        late_db, direct_db = _late_levels_db(group), _direct_levels_db(group)
        if len(group) < 2 or not np.all(np.isfinite(late_db) & np.isfinite(direct_db)):
            continue
        order = np.argsort(late_db)
        steps = np.diff(late_db[order])
        at = int(np.argmax(steps)) + 1
        low, high = order[:at], order[at:]
        step_db = float(np.median(late_db[high]) - np.median(late_db[low]))
        apart_db = float(np.median(direct_db[high]) - np.median(direct_db[low]))
        alike = max(np.std(late_db[low]), np.std(late_db[high])) <= _WITHIN_DB
        least_db = _LEAST_STEP_DB if len(group) > 2 else _LEAST_STEP_OF_TWO_DB
        if steps[at - 1] < least_db or not alike or abs(step_db - apart_db) > _DIRECT_WITHIN_DB:
            continue
        odd, louder = (high, True) if len(high) <= len(low) else (low, False)
        files = [group[i].measurement for i in odd]
        text = (
            f"{', '.join(m.name for m in files[:4])}{' and more' if files[4:] else ''}: "
            f"{step_db:.1f} dB {'louder' if louder else 'softer'} than the other "
            f"{len(group) - len(files)} files of {files[0].source}, direct sound and decay alike, "
            'as by another gain: set level = "per-file", or correct the levels.'
        )
        about = About(files=[m.where for m in files], pairs=[pair_of(m) for m in files])
        numbers = {"step_db": step_db, "files": [m.where for m in files]}
        yield Finding(Code.LEVELS_APART, about, text, numbers)


def _peak(m: MeasuredPair) -> float:
    """Return the largest size of a sample; NaN where several have it, as where it is cut off."""
    sizes = np.abs(m.measurement.response.pressure)
    peak = float(sizes.max())
    return peak if np.count_nonzero(sizes > 0.9999 * peak) == 1 else np.nan


def _is_levelled(peaks: Sequence[float], direct_s: Sequence[float]) -> bool:
    """Whether all files have one peak, although direct sounds travel distances 1 dB apart."""
    known = np.array(peaks)
    # to 16 bits; False with NaN
    alike = bool(np.ptp(known) <= 1e-4 * known.max())
    return alike and max(direct_s) > 1.12 * min(direct_s)


def _levelled(group: Sequence[MeasuredPair], peak: float) -> Finding:
    files = [m.measurement for m in group]
    text = (
        f"All {len(files)} files of {', '.join(dict.fromkeys(f.source for f in files))} have the "
        f"same peak, {peak:.3g}, at unlike distances: they were normalised one by one, and their "
        'levels say nothing. Set level = "per-file", or export them without normalisation.'
    )
    about = About(files=[m.where for m in files], pairs=[pair_of(m) for m in files])
    return Finding(
        Code.LEVELS_APART, about, text, {"peak": peak, "files": [m.where for m in files]}
    )


def _late_levels_db(group: Sequence[MeasuredPair]) -> FloatArray:
    """Return reverberant levels, the mean over the bands that all have by bandwidth, (n,)."""
    rows = []
    for m in group:
        at_s = m.curve.onset_s + _LATE_S
        left = np.array([np.interp(at_s, m.curve.time_s, row) for row in m.curve.energy_left])
        has_level = (left > 0.0) & (m.curve.usable_end_s > at_s)
        rows.append(np.where(has_level, 10.0 * np.log10(np.where(has_level, left, 1.0)), np.nan))
    levels = np.array(rows)
    known = np.all(np.isfinite(levels), axis=0)
    if not known.any():
        return np.full(len(group), np.nan)
    # a level fluctuates the less, the wider its band
    weights = group[0].curve.bands.centres_hz[known]
    return np.asarray(levels[:, known] @ weights / weights.sum())


def _direct_levels_db(group: Sequence[MeasuredPair]) -> FloatArray:
    c_distances = np.array([m.direct_s for m in group])
    energies = np.array([float(np.sum(direct_sound(m) ** 2)) for m in group])
    with np.errstate(divide="ignore"):
        return np.asarray(10.0 * np.log10(energies) + 20.0 * np.log10(c_distances))
