"""One cause behind what several recordings show, found before any fit.

Clocks, units, exchanged files, displaced points, gains and polarity each leave a pattern in the
arrivals and levels of the direct sound: a pattern is named once, in place of a doubt a recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.special import chdtrc

from roomfit.air import speed_of_sound_m_s
from roomfit.errors import InputError
from roomfit.findings import About, Code, Finding
from roomfit.measurement import MeasuredPair, Measurement
from roomfit.objective.observation import DEFAULT_POSITION_SD_M
from roomfit.scene import Point, Scene
from roomfit.signals.response import find_onset, onset_tolerance_m, times_s
from roomfit.typing import BoolArray, FloatArray

# Coordinates in one unit that are read in another are off by one of these factors.
_FACTORS = {
    0.3048: "feet are read as metres",
    0.0254: "inches are read as metres",
    0.01: "centimetres are read as metres",
    0.001: "millimetres are read as metres",
    1.0 / 0.3048: "metres are read as feet",
}
_SAME_FACTOR = 0.03
_MOST_EXCHANGED = 50
_FEWEST = 3
# One campaign in a thousand whose positions are as specified is taken for one with a displaced
# point; the standard deviation of an onset is a centimetre and a sample.
_LEVEL = 1e-3
_ONSET_SD_M, _ONSET_SD_SAMPLES = 0.01, 1.0
_LEAST_SHIFT_M = 0.05
_LEAD_S = 0.1  # no position is 34 m off: the recorder was started so long before the sound
_MORE_THAN_OTHERS = 10.0  # chi-square by which a displaced point explains more than any other
# Gains: the reverberant level of a source varies by 1 to 2 dB over a room, the direct sound's more.
_LEAST_STEP_DB, _WITHIN_DB, _DIRECT_WITHIN_DB = 4.0, 1.2, 2.5
_DIRECT_S, _BEFORE_S, _LATE_S = 1.5e-3, 0.3e-3, 0.05
_LIKENESS = 0.6  # of two direct sounds, whose sign it decides


@dataclass(frozen=True, slots=True, eq=False)
class _Arrivals:
    """Onsets of recordings that are on the clock of emission, beside the geometry."""

    measurements: list[Measurement]
    source: list[Point]
    receiver: list[Point]
    path_m: FloatArray  # (n,), of the direct sound by its onset
    distance_m: FloatArray  # (n,), by the geometry
    tolerance_m: FloatArray  # (n,), of an onset that is as specified
    speed_m_s: float

    @property
    def late_m(self) -> FloatArray:
        """By how much each comes late, (n,)."""
        return self.path_m - self.distance_m


def arrival_findings(scene: Scene, measurements: Sequence[Measurement]) -> tuple[Finding, ...]:
    """Return the one cause, if there is one, why direct sounds do not arrive when they should.

    Only recordings whose clock starts at emission are compared. Patterns are tried from the
    simplest on: every file begins at its direct sound; all of a source are late alike; coordinates
    in another unit; every file begins long before, each at another instant; two files, or two
    points, exchanged; one point displaced.

    Parameters
    ----------
    scene : Scene
    measurements : sequence of Measurement
        Of sources and receivers of the scene.

    Returns
    -------
    tuple of Finding
        Of one cause; several where sources have delays of their own, or a delay beside a displaced
        point.
    """
    found = _arrivals(scene, measurements)
    if found is None:
        return ()
    off = np.abs(found.late_m) > found.tolerance_m
    if off.any():
        for cause in (
            _begin_at_direct,
            _stretched,
            _alike_late,
            _other_unit,
            _begin_anywhere,
            _exchanged,
        ):
            findings = cause(found)
            if findings:
                return findings
    findings = _displaced(found)
    if findings:
        kept = [m for m in found.measurements if m.where not in findings[0].evidence["files"]]
        rest = _arrivals(scene, kept)
        if rest is not None:
            findings = (*_alike_late(rest), *findings)
    return findings


def _arrivals(scene: Scene, measurements: Sequence[Measurement]) -> _Arrivals | None:
    sources = {p.name: p for p in scene.sources}
    receivers = {p.name: p for p in scene.receivers}
    c = speed_of_sound_m_s(scene.air)
    chosen, onset_s = [], []
    for m in measurements:
        try:
            onset = find_onset(m.response, m.where)
        except InputError:  # noise only, which is refused or reported elsewhere
            continue
        if m.time_zero == "emission":
            chosen.append(m)
            onset_s.append(onset)
    if not chosen:
        return None
    source = [sources[m.source] for m in chosen]
    receiver = [receivers[m.receiver] for m in chosen]
    return _Arrivals(
        chosen,
        source,
        receiver,
        c * np.array(onset_s),
        _distances_m(source, receiver),
        np.array([onset_tolerance_m(c, m.response.sampling_rate_hz) for m in chosen]),
        c,
    )


def _distances_m(source: Sequence[Point], receiver: Sequence[Point]) -> FloatArray:
    at = [[p.position_m for p in points] for points in (source, receiver)]
    return np.asarray(np.linalg.norm(np.array(at[0]) - np.array(at[1]), axis=1))


def _files(measurements: Sequence[Measurement], n_all: int) -> str:
    names = ", ".join(m.name for m in measurements[:4])
    if len(measurements) == n_all:
        return f"all {n_all} files"
    more = f" and {len(measurements) - 4} more" if len(measurements) > 4 else ""
    return f"{len(measurements)} of {n_all} files ({names}{more})"


def _begin_at_direct(found: _Arrivals) -> tuple[Finding, ...]:
    """Every file was cut at its direct sound: onsets are alike on the files' own clocks."""
    own_m = found.path_m + found.speed_m_s * np.array([m.latency_s for m in found.measurements])
    spread, expected = np.ptp(own_m), np.ptp(found.distance_m)
    tolerance_m = float(found.tolerance_m.max())
    if len(own_m) < _FEWEST or spread > tolerance_m or expected < 3.0 * tolerance_m:
        return ()
    own_ms = 1e3 * float(own_m.mean()) / found.speed_m_s
    text = (
        f"All {len(own_m)} files begin at their direct sound, {own_ms:.2f} ms "
        f"after the first sample, whatever the distance ({found.distance_m.min():.2f} to "
        f'{found.distance_m.max():.2f} m): set time_zero = "direct".'
    )
    return (Finding(Code.RECORDINGS_LATE, About(), text, {"time_zero": "direct"}),)


def _alike_late(found: _Arrivals) -> tuple[Finding, ...]:
    """All recordings, or all of some sources, are late by one time."""
    n_all = len(found.measurements)
    together = [np.ones(n_all, dtype=np.bool_)]
    names = np.array([m.source for m in found.measurements])
    by_source = [np.asarray(names == name) for name in dict.fromkeys(names.tolist())]
    for groups in (together, by_source):
        findings, fits = [], True
        for group in groups:
            late_m, tolerance_m = found.late_m[group], found.tolerance_m[group]
            middle_m = float(np.median(late_m))
            fits &= bool(np.all(np.abs(late_m - middle_m) <= tolerance_m))
            if abs(middle_m) > float(tolerance_m.max()):
                fits &= len(late_m) >= 2
                chosen = [m for m, own in zip(found.measurements, group, strict=True) if own]
                findings.append(_late(chosen, middle_m / found.speed_m_s, n_all))
        if fits and findings:
            return tuple(findings)
    return ()


def _late(measurements: Sequence[Measurement], late_s: float, n_all: int) -> Finding:
    samples = abs(late_s) * measurements[0].response.sampling_rate_hz
    latencies = {m.latency_s for m in measurements}
    latency_s = round(latencies.pop() + late_s, 5) if len(latencies) == 1 else None  # 3 mm
    advice = (
        f"add {late_s:.5f} to their latency_s"
        if latency_s is None
        else f"set latency_s = {latency_s:.7g}"
    )
    who = _files(measurements, n_all)
    order = "late" if late_s > 0.0 else "early"
    how = f"are {1e3 * abs(late_s):.2f} ms {order}"
    if late_s > _LEAD_S:
        how = f"begin {late_s:.2f} s before the sound is emitted"
    text = (
        f"{who[0].upper()}{who[1:]} {how} "
        f'({samples:.0f} samples): {advice} or time_zero = "unknown".'
    )
    evidence = {"late_s": late_s, "latency_s": latency_s, "files": [m.where for m in measurements]}
    return Finding(Code.RECORDINGS_LATE, About(), text, evidence)


def _stretched(found: _Arrivals) -> tuple[Finding, ...]:
    """All arrivals are early or late in proportion to the distance, better than by one delay."""
    distance_m, tolerance_m = found.distance_m, found.tolerance_m
    factor = float(found.path_m @ distance_m / (distance_m @ distance_m))
    rest_m = found.path_m - factor * distance_m
    apart_m = found.late_m - np.median(found.late_m)
    clear = 2.0 * float(np.linalg.norm(rest_m)) < float(np.linalg.norm(apart_m))
    if len(rest_m) < _FEWEST or not clear or np.any(np.abs(rest_m) > tolerance_m):
        return ()
    for known, what in _FACTORS.items():
        if abs(factor / known - 1.0) < _SAME_FACTOR:
            return (_scaled(known, what, len(rest_m)),)
    what = "the scale of the drawing, the sampling rate, or the temperature is another"
    return (_scaled(factor, what, len(rest_m)),)


def _scaled(factor: float, what: str, n: int) -> Finding:
    text = (
        f"The direct sounds of all {n} files arrive as if all positions were {factor:.4g} times as "
        f"far apart: {what}. Compare the positions, the unit of the room and the files."
    )
    return Finding(Code.COORDINATES_SCALED, About(), text, {"factor": factor})


def _other_unit(found: _Arrivals) -> tuple[Finding, ...]:
    """All distances are those of another unit, beside a common delay."""
    if len(found.path_m) < _FEWEST or np.ptp(found.distance_m) < 3.0 * found.tolerance_m.max():
        return ()
    for factor, what in _FACTORS.items():
        late_m = found.path_m - factor * found.distance_m
        if np.all(np.abs(late_m - np.median(late_m)) <= found.tolerance_m):
            return (_scaled(factor, what, len(late_m)),)
    return ()


def _begin_anywhere(found: _Arrivals) -> tuple[Finding, ...]:
    """Every file begins long before the sound, each at another instant."""
    late_s = found.late_m / found.speed_m_s
    if len(late_s) < 2 or late_s.min() < _LEAD_S:
        return ()
    text = (
        f"All {len(late_s)} files begin before the sound is emitted, each at another instant, "
        f'{late_s.min():.2f} to {late_s.max():.2f} s: set time_zero = "direct".'
    )
    return (Finding(Code.RECORDINGS_LATE, About(), text, {"time_zero": "direct"}),)


def as_advised(measurements: Sequence[Measurement], causes: Sequence[Finding]) -> list[Measurement]:
    """Return recordings on the clock that the findings of `arrival_findings` say to set.

    In their order; those of which nothing is said as they are.
    """
    advised = []
    for m in measurements:
        for cause in causes:
            if cause.code is Code.RECORDINGS_LATE and m.time_zero == "emission":
                if "time_zero" in cause.evidence:
                    m = replace(m, time_zero="direct")
                elif m.where in cause.evidence["files"]:
                    m = replace(m, latency_s=m.latency_s + cause.evidence["late_s"])
        advised.append(m)
    return advised


def _exchanged(found: _Arrivals) -> tuple[Finding, ...]:
    """Two files, receivers or sources have each other's name; one exchange mends it all."""
    middle_m = float(np.median(found.late_m))
    common_m = middle_m if abs(middle_m) > float(found.tolerance_m.max()) else 0.0
    off = np.flatnonzero(np.abs(found.late_m - common_m) > found.tolerance_m)
    if len(off) < 2 or len(found.late_m) < _FEWEST:
        return ()

    def mends(distance_m: FloatArray) -> bool:
        late_m = found.path_m - distance_m - common_m
        return bool(np.all(np.abs(late_m) <= found.tolerance_m))

    if len(off) == 2:
        order = np.arange(len(found.late_m))
        order[off] = off[::-1]
        if mends(found.distance_m[order]):
            a, b = (found.measurements[i] for i in off)
            text = (
                f"{a.name} and {b.name} are exchanged: each arrives when that of the other should "
                f"({a.source} to {a.receiver}, {b.source} to {b.receiver})."
            )
            return (
                Finding(
                    Code.EXCHANGED,
                    About(files=[a.where, b.where]),
                    text,
                    {"files": [a.where, b.where]},
                ),
            )
    exchanges = []
    for kind, points in (("receivers", found.receiver), ("sources", found.source)):
        doubtful = {points[i].name: points[i] for i in off}
        if len(doubtful) > _MOST_EXCHANGED:
            continue  # not two of them: something that all have in common
        for one, other in combinations(doubtful.values(), 2):
            to = {one.name: other, other.name: one}
            moved = [to.get(p.name, p) for p in points]
            ends = (found.source, moved) if kind == "receivers" else (moved, found.receiver)
            if mends(_distances_m(*ends)):
                exchanges.append((kind, one.name, other.name))
    if len(exchanges) != 1:
        return ()
    ((kind, first, second),) = exchanges
    text = (
        f"The {kind} {first} and {second} are exchanged: all direct sounds arrive when they should "
        "if each has the position of the other."
    )
    return (Finding(Code.EXCHANGED, About(), text, {kind: [first, second]}),)


def _displaced(found: _Arrivals) -> tuple[Finding, ...]:
    """One source or receiver stands elsewhere, the others as specified: chi-square decides.

    Each source may have a delay of its own. To the residuals of all arrivals the three coordinates
    of one point after the other are fitted.
    """
    n = len(found.late_m)
    if n < _FEWEST + 1:
        return ()
    columns = _derivatives(found)
    names = np.array([m.source for m in found.measurements])
    delays = np.stack([names == name for name in dict.fromkeys(names.tolist())], axis=1).astype(
        float
    )
    rate_hz = min(m.response.sampling_rate_hz for m in found.measurements)
    robust = 1.4826 * float(np.median(np.abs(found.late_m - np.median(found.late_m))))
    onset_sd = max(_ONSET_SD_M + _ONSET_SD_SAMPLES * found.speed_m_s / rate_hz, robust)
    covariance = onset_sd**2 * np.eye(n)
    for point, own in columns.items():
        sd = DEFAULT_POSITION_SD_M if point.position_sd_m is None else point.position_sd_m
        covariance += sd**2 * own @ own.T
    white = np.linalg.inv(np.linalg.cholesky(covariance))
    data, base = white @ found.late_m, white @ delays
    whole, rank = _left(base, data)
    gains = {}
    for point, own in columns.items():
        rest, with_point = _left(np.hstack([base, white @ own]), data)
        if rank < with_point < n:
            gains[point] = (whole - rest, with_point - rank, rest, n - with_point)
    if not gains:
        return ()
    best = max(gains, key=lambda point: gains[point][0])
    gain, n_free, rest, n_left = gains[best]
    second = max((g[0] for point, g in gains.items() if point is not best), default=0.0)
    sure = chdtrc(n_free, gain) * len(gains) < _LEVEL and gain - second > _MORE_THAN_OTHERS
    if not sure or chdtrc(n_left, rest) < _LEVEL:
        return ()
    return _displacement(found, best, np.asarray(~columns[best].any(axis=1)), delays)


def _derivatives(found: _Arrivals) -> dict[Point, FloatArray]:
    """Return the derivatives of all paths by the coordinates of each point, (n, 3)."""
    source, receiver = (
        np.array([p.position_m for p in ends]) for ends in (found.source, found.receiver)
    )
    along = (receiver - source) / found.distance_m[:, None]
    columns: dict[Point, FloatArray] = {}
    for ends, sign in ((found.source, -1.0), (found.receiver, 1.0)):
        for i, point in enumerate(ends):
            columns.setdefault(point, np.zeros_like(along))[i] = sign * along[i]
    return columns


def _left(columns: FloatArray, data: FloatArray) -> tuple[float, int]:
    """Return the sum of squares that least squares leave, and the rank."""
    solution, _, rank, _ = np.linalg.lstsq(columns, data, rcond=1e-8)
    return float(np.sum((data - columns @ solution) ** 2)), int(rank)


def _displacement(
    found: _Arrivals, point: Point, others: BoolArray, delays: FloatArray
) -> tuple[Finding, ...]:
    delay_m, *_ = np.linalg.lstsq(delays[others], found.late_m[others], rcond=None)
    rest_m = (found.late_m - delays @ delay_m)[~others]
    size_m = float(np.max(np.abs(rest_m)))  # no path changes by more than its end moves
    if size_m < _LEAST_SHIFT_M:
        return ()
    kind, name = "receiver" if point in found.receiver else "source", point.name
    chosen = [m for m, other in zip(found.measurements, others.tolist(), strict=True) if not other]
    each = ", ".join(
        f"{100 * abs(late):.0f} cm {'farther from' if late > 0 else 'nearer to'} "
        f"{m.source if kind == 'receiver' else m.receiver}"
        for m, late in zip(chosen[:4], rest_m.tolist(), strict=False)
    )
    text = (
        f"The {kind} {name} stands elsewhere than specified, by {size_m:.2f} m or more: its direct "
        f"sounds arrive as if it were {each}; those of all other positions agree. Measure it again."
    )
    evidence = {kind: name, "metres": size_m, "files": [m.where for m in chosen]}
    return (Finding(Code.DISPLACEMENT_DETECTED, About(), text, evidence),)


def gain_findings(measured: Sequence[MeasuredPair]) -> tuple[Finding, ...]:
    """Return a finding where recordings that share a gain fall into two levels apart.

    Compared are the energy of the direct sound, with the distance allowed for, and the level of
    the reverberant field 50 ms later, which hardly depends on position: only a gain moves both by
    the same number of decibels.
    """
    findings = []
    groups: dict[tuple[str, str], list[MeasuredPair]] = {}
    for m in measured:
        own = m.measurement
        if own.level != "per-file":
            key = "" if own.level == "absolute" else own.source
            groups.setdefault((key, own.state), []).append(m)
    for group in groups.values():
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
        if (
            steps[at - 1] < _LEAST_STEP_DB
            or not alike
            or abs(step_db - apart_db) > _DIRECT_WITHIN_DB
        ):
            continue
        odd, louder = (high, True) if len(high) <= len(low) else (low, False)
        files = [group[i].measurement for i in odd]
        text = (
            f"{', '.join(m.name for m in files[:4])}{' and more' if files[4:] else ''}: "
            f"{step_db:.1f} dB {'louder' if louder else 'softer'} than the other "
            f"{len(group) - len(files)} files of {files[0].source}, direct sound and decay alike, "
            'as by another gain: set level = "per-file", or correct the levels.'
        )
        evidence = {"step_db": step_db, "files": [m.where for m in files]}
        findings.append(Finding(Code.LEVELS_APART, About(), text, evidence))
    return tuple(findings)


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
    energies = np.array([float(np.sum(_direct_sound(m) ** 2)) for m in group])
    with np.errstate(divide="ignore"):
        return np.asarray(10.0 * np.log10(energies) + 20.0 * np.log10(c_distances))


def _direct_sound(m: MeasuredPair) -> FloatArray:
    """Return the samples about the onset, as measured."""
    onset_s = find_onset(m.response, m.measurement.where)
    since_s = times_s(m.response) - onset_s
    chosen = (since_s >= -_BEFORE_S) & (since_s <= _DIRECT_S)
    return np.asarray(m.response.pressure[chosen])


def polarity_findings(measured: Sequence[MeasuredPair]) -> tuple[Finding, ...]:
    """Return a finding where some recordings have the opposite polarity of the others.

    By the sign of the largest correlation of direct sounds of one source. Fits by energies, and by
    pressures whose sign is free, are not affected; a cable or a channel is other than supposed.
    """
    by_source: dict[str, list[MeasuredPair]] = {}
    for m in measured:
        by_source.setdefault(m.measurement.source, []).append(m)
    inverted: list[Measurement] = []
    for group in by_source.values():
        sounds = [_direct_sound(m) for m in group]
        strongest = int(np.argmax([float(np.max(np.abs(s), initial=0.0)) for s in sounds]))
        signs = np.array([_sign(s, sounds[strongest]) for s in sounds])
        if np.count_nonzero(signs) >= _FEWEST:
            odd = 1 if np.sum(signs) < 0 else -1
            minority = [m.measurement for m, s in zip(group, signs, strict=True) if s == odd]
            inverted += minority if 2 * len(minority) < np.count_nonzero(signs) else []
    if not inverted:
        return ()
    who = _files(inverted, len(measured))
    text = (
        f"{who[0].upper()}{who[1:]} have the opposite polarity of the others of their source: a "
        "cable, a channel or a microphone differs. The fit does not depend on it."
    )
    return (
        Finding(
            Code.POLARITY_DIFFERS,
            About(files=[m.where for m in inverted]),
            text,
            {"files": [m.where for m in inverted]},
        ),
    )


def _sign(sound: FloatArray, reference: FloatArray) -> int:
    """Return the sign of the largest correlation, 0 where the two are not alike."""
    norm = float(np.linalg.norm(sound) * np.linalg.norm(reference))
    if norm == 0.0:
        return 0
    likeness = np.correlate(sound, reference, mode="full") / norm
    best = float(likeness[int(np.argmax(np.abs(likeness)))])
    return 0 if abs(best) < _LIKENESS else int(np.sign(best))
