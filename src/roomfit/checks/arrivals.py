"""Whether direct sounds arrive when they should, and the one cause where several do not.

Clocks, units, exchanged files and displaced points each leave a pattern in the arrivals of the
direct sound: a pattern is named once, in place of a doubt a recording.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from roomfit.base.air import speed_of_sound_m_s
from roomfit.base.arguments import in_short
from roomfit.base.errors import InputError
from roomfit.base.findings import Code, Edit, Finding, Remedy
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.checks.evidence import UNDECIDED, Recorded, about_files, files_in_words, of_files
from roomfit.model.observation import DEFAULT_POSITION_SD_M
from roomfit.room.scene import Point, Scene
from roomfit.signals.measurement import Measurement
from roomfit.signals.response import find_onset, find_peak, onset_tolerance_m

# Coordinates in one unit that are read in another are off by one of these factors.
_FACTORS = {
    0.3048: ("ft", "feet are read as metres"),
    0.0254: ("in", "inches are read as metres"),
    0.01: ("cm", "centimetres are read as metres"),
    0.001: ("mm", "millimetres are read as metres"),
    1.0 / 0.3048: ("m", "metres are read as feet"),
}
_SAME_FACTOR = 0.03
_MOST_EXCHANGED, _FEWEST = 50, 3
# One campaign in a thousand whose positions are as specified is taken for one with a displaced
# point; the standard deviation of an onset is a centimetre and a sample.
_LEVEL = 1e-3
_ONSET_SD_M, _ONSET_SD_SAMPLES = 0.01, 1.0
# What a displacement, and a scale, may be before anything is measured; steps of Gauss-Newton.
_LEAST_SHIFT_M, _MOST_SHIFT_M, _SCALES, _STEPS = 0.05, 3.0, 0.5, 6
# A delay is early or late, and as likely to be of tenths of milliseconds as of tenths of seconds.
_LOG_DELAYS = float(np.log(1e4))
_LEAD_S = 0.1  # no position is 34 m off: the recorder was started so long before the sound
_TOLERANCE_SD = 3.0  # standard deviations of an onset in its tolerance
_MORE_THAN_OTHERS = 10.0  # chi-square by which a displaced point explains more than any other

_Findings = tuple[Finding, ...]


def check(evidence: Recorded) -> _Findings:
    """Return the one cause, if there is one, why direct sounds do not arrive when they should."""
    return evidence.arrivals


@dataclass(frozen=True, slots=True, eq=False)
class _Arrivals:
    """Onsets of recordings that are on the clock of emission, beside the geometry; (n,) each."""

    measurements: list[Measurement]
    source: list[Point]
    receiver: list[Point]
    path_m: FloatArray  # of the direct sound by its onset
    peak_m: FloatArray  # by the peak of a pulse as short as the sampling rate allows
    distance_m: FloatArray  # by the geometry
    tolerance_m: FloatArray  # of an onset that is as specified
    speed_m_s: float

    @property
    def late_m(self) -> FloatArray:
        """By how much each comes late, (n,)."""
        return self.path_m - self.distance_m

    @property
    def ends(self) -> tuple[list[Point], list[Point]]:
        """Sources and receivers."""
        return self.source, self.receiver

    @property
    def away_m(self) -> FloatArray:
        """From each source to its receiver, (n, 3)."""
        return _away_m(self.source, self.receiver)


def arrival_findings(scene: Scene, measurements: Sequence[Measurement]) -> _Findings:
    """Return the one cause, if there is one, why direct sounds do not arrive when they should.

    Of recordings whose clock starts at emission, patterns are tried from the simplest on. Several
    findings where sources have delays of their own, or a delay beside a displaced point.
    """
    found = _arrivals(scene, measurements)
    if found is None:
        return ()
    if np.any(np.abs(found.late_m) > found.tolerance_m):
        for cause in (_begin_at_direct, _likeliest, _other_unit, _begin_anywhere, _exchanged):
            if findings := cause(found):
                return findings
    findings = _displaced(found)
    if findings:
        displaced = findings[0].about.files
        rest = _arrivals(scene, [m for m in found.measurements if m.where not in displaced])
        late = rest and (_one_delay(rest) or _delays(rest))
        findings = late.findings + findings if late else findings
    return findings


def _arrivals(scene: Scene, measurements: Sequence[Measurement]) -> _Arrivals | None:
    c = speed_of_sound_m_s(scene.air)
    onset_s = {}
    for m in measurements:
        try:
            onset = find_onset(m.response, m.where)
        except InputError:  # noise only, which is refused or reported elsewhere
            continue
        if m.time_zero == "emission":
            onset_s[m] = onset
    if not onset_s:
        return None
    sources, receivers = ({p.name: p for p in ps} for ps in (scene.sources, scene.receivers))
    source = [sources[m.source] for m in onset_s]
    receiver = [receivers[m.receiver] for m in onset_s]
    return _Arrivals(
        list(onset_s),
        source,
        receiver,
        c * np.array(list(onset_s.values())),
        c * np.array([find_peak(m.response, t) for m, t in onset_s.items()]),
        np.linalg.norm(_away_m(source, receiver), axis=1),
        np.array([onset_tolerance_m(c, m.response.sampling_rate_hz) for m in onset_s]),
        c,
    )


def _away_m(source: Sequence[Point], receiver: Sequence[Point]) -> FloatArray:
    return np.array([r.position_m - s.position_m for s, r in zip(source, receiver, strict=True)])


def _begin_at_direct(found: _Arrivals) -> _Findings:
    """Every file was cut at its direct sound: onsets are alike on the files' own clocks."""
    own_m = found.path_m + found.speed_m_s * np.array([m.latency_s for m in found.measurements])
    tolerance_m, distance_m = float(found.tolerance_m.max()), found.distance_m
    if len(own_m) < _FEWEST or np.ptp(own_m) > tolerance_m or np.ptp(distance_m) < 3 * tolerance_m:
        return ()
    return _clock_of_direct(
        found,
        f"begin at their direct sound, {1e3 * float(own_m.mean()) / found.speed_m_s:.2f} ms after "
        f"the first sample, whatever the distance ({distance_m.min():.2f} to "
        f"{distance_m.max():.2f} m)",
    )


def _begin_anywhere(found: _Arrivals) -> _Findings:
    """Every file begins long before the sound, each at another instant."""
    late_s = found.late_m / found.speed_m_s
    if len(late_s) < 2 or late_s.min() < _LEAD_S:
        return ()
    range_s = f"{late_s.min():.2f} to {late_s.max():.2f} s"
    return _clock_of_direct(
        found, f"begin before the sound is emitted, each at another instant, {range_s}"
    )


def _clock_of_direct(found: _Arrivals, text: str) -> _Findings:
    files = found.measurements
    sentence = f'All {len(files)} files {text}: set time_zero = "direct".'
    about, evidence = about_files(*files), {"time_zero": "direct"}
    advised = of_files(files, "time_zero", "direct", now=["emission"])
    return (Finding(Code.RECORDINGS_LATE, about, sentence, evidence, remedies=[advised]),)


class _Explanation(NamedTuple):
    """One cause of all late arrivals."""

    evidence: float  # logarithm of the marginal likelihood
    words: str  # after "or"
    findings: _Findings


def _likeliest(found: _Arrivals) -> _Findings:
    """Return the likeliest of delays, a scale and displaced receivers that mends all arrivals.

    A thousand times as likely as arrivals by the geometry; others within 2 units are named beside
    it.
    """
    none = np.zeros((len(found.late_m), 0))
    least = _evidence(found, found.late_m, none, none[0]) - np.log(_LEVEL)
    made = [make(found) for make in (_one_delay, _delays, _stretched, _receivers_displaced)]
    likely = [e for e in made if e is not None and e.evidence > least]
    if not likely:
        return ()
    best = max(likely, key=lambda e: e.evidence)
    others = [e.words for e in likely if e is not best and best.evidence - e.evidence < UNDECIDED]
    more = f" Or {others[0]}." if others else ""
    return tuple(replace(f, sentence=f.sentence + more) for f in best.findings)


def _evidence(
    found: _Arrivals, rest_m: FloatArray, columns: FloatArray, ranges: FloatArray
) -> float:
    """Return the marginal likelihood's logarithm of unknowns that leave some residuals.

    By Laplace's approximation; each unknown has a uniform prior over its range, delays one over
    that of their logarithm. Arrivals err by Student's t with four degrees of freedom, since onsets
    of real loudspeakers scatter by more than a centimetre. `columns` (n_files, n_unknowns) are
    derivatives of the arrivals in m.
    """
    white = _whitening(found)
    chi2, own = float(np.sum((white @ rest_m) ** 2)), white @ columns
    _, logdet = np.linalg.slogdet(own.T @ own)
    width = float(np.sum(np.log(ranges))) - 0.5 * len(ranges) * np.log(2.0 * np.pi)
    return float(-0.5 * (4 + len(rest_m)) * np.log1p(chi2 / 4.0) - 0.5 * logdet - width)


def _whitening(found: _Arrivals, robust_m: float = 0.0) -> FloatArray:
    """Return what makes independent of unit variance what onsets and positions may be off."""
    rate_hz = min(m.response.sampling_rate_hz for m in found.measurements)
    onset_sd = max(_ONSET_SD_M + _ONSET_SD_SAMPLES * found.speed_m_s / rate_hz, robust_m)
    covariance = onset_sd**2 * np.eye(len(found.late_m))
    for point, own in _derivatives(found).items():
        sd = DEFAULT_POSITION_SD_M if point.position_sd_m is None else point.position_sd_m
        covariance += sd**2 * own @ own.T
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


def _is_adequate(found: _Arrivals, rest_m: FloatArray, n_unknowns: int) -> bool:
    """Return whether residuals are those of onsets and positions, by chi-square."""
    chi2 = float(np.sum((_whitening(found) @ rest_m) ** 2))
    return bool(chdtrc(len(rest_m) - n_unknowns, chi2) >= _LEVEL)


def _one_delay(found: _Arrivals) -> _Explanation | None:
    return _late_by(found, np.ones((1, len(found.late_m)), dtype=np.bool_))


def _delays(found: _Arrivals) -> _Explanation | None:
    """All recordings of some sources are late by a time of each."""
    names = np.array([m.source for m in found.measurements])
    own = np.unique(names)
    return None if len(own) < 2 else _late_by(found, own[:, None] == names)


def _late_by(found: _Arrivals, groups: BoolArray) -> _Explanation | None:
    """All recordings of each group, (n_groups, n), are late by one time, or by none."""
    findings, columns, ranges_m, rest_m = [], [], [], np.array(found.late_m)
    for group in groups:
        late_m, tolerance_m = found.late_m[group], found.tolerance_m[group]
        middle_m = float(np.median(late_m))
        is_late = abs(middle_m) > float(tolerance_m.max())
        # one alone may stand elsewhere, but not so far
        alone = len(late_m) < 2 and abs(middle_m) < _LEAD_S * found.speed_m_s
        if np.any(np.abs(late_m - middle_m) > tolerance_m) or (is_late and alone):
            return None
        if is_late:
            chosen = [found.measurements[i] for i in np.flatnonzero(group)]
            # onsets decide, which a slow pulse leaves where they are; by how much, the peaks say
            own_m = float(np.median((found.peak_m - found.distance_m)[group]))
            findings.append(_late(chosen, own_m / found.speed_m_s, groups.shape[1]))
            rest_m[group] -= float(np.mean(late_m))
            columns.append(group.astype(float))
            ranges_m.append(2.0 * _LOG_DELAYS * abs(middle_m))
    if not findings:
        return None
    evidence = _evidence(found, rest_m, np.stack(columns, axis=1), np.array(ranges_m))
    return _Explanation(evidence, "their clocks are late", tuple(findings))


def _late(measurements: Sequence[Measurement], late_s: float, n_all: int) -> Finding:
    samples = abs(late_s) * measurements[0].response.sampling_rate_hz
    # one that is not 0 may hold where a file says that it begins, beside what the campaign states
    is_unset = all(m.latency_s == 0.0 for m in measurements)
    latency_s = round(late_s, 5) if is_unset else None  # 3 mm
    advice = f"add {late_s:.5f} to their latency_s"
    if latency_s is not None:
        advice = f"set latency_s = {latency_s:.7g}"
    who = files_in_words(measurements, n_all)
    how = f"are {1e3 * abs(late_s):.2f} ms {'late' if late_s > 0.0 else 'early'}"
    if abs(late_s) > _LEAD_S:
        how = f"began {abs(late_s):.2f} s {'before' if late_s > 0.0 else 'after'} emission"
    text = (
        f"{who[0].upper()}{who[1:]} {how} "
        f'({samples:.0f} samples): {advice} or time_zero = "unknown".'
    )
    evidence = {"late_s": late_s, "latency_s": latency_s, "files": [m.where for m in measurements]}
    # counted from the file's key: a format may have a delay of its own beside it
    delay = replace(of_files(measurements, "latency_s", late_s, how="add"), once=True)
    remedies = [delay, of_files(measurements, "time_zero", "unknown", now=["emission"])]
    about = about_files(*measurements)
    return Finding(Code.RECORDINGS_LATE, about, text, evidence, remedies=remedies)


def _stretched(found: _Arrivals) -> _Explanation | None:
    """All arrivals are early or late in proportion to the distance."""
    distance_m = found.distance_m
    factor = float(found.path_m @ distance_m / (distance_m @ distance_m))
    rest_m = found.path_m - factor * distance_m
    apart_m = found.late_m - np.median(found.late_m)
    clear = 2.0 * float(np.linalg.norm(rest_m)) < float(np.linalg.norm(apart_m))
    if len(rest_m) < _FEWEST or np.any(np.abs(rest_m) > found.tolerance_m):
        return None
    if not (clear or _is_adequate(found, rest_m, 1)):
        return None
    evidence = _evidence(found, rest_m, distance_m[:, None], np.array([_SCALES]))
    known = next((f for f in _FACTORS if abs(factor / f - 1.0) < _SAME_FACTOR), factor)
    words = f"all positions are {known:.4g} times as far apart"
    return _Explanation(evidence, words, (_scaled(known, found),))


def _scaled(factor: float, found: _Arrivals) -> Finding:
    another = "the scale of the drawing, the sampling rate, or the temperature is another"
    unit, what = _FACTORS.get(factor, ("", another))
    text = (
        f"The direct sounds of all {len(found.path_m)} files arrive as if all positions were "
        f"{factor:.4g} times as far apart: {what}. Compare the positions, the unit of the room "
        "and the files."
    )
    evidence = {"factor": factor, **({"unit": unit} if unit else {})}
    about = about_files(*found.measurements)
    remedies = []
    if unit:  # else it is a sampling rate, or the temperature
        points = [Edit((k, "*"), "position", factor, "scale") for k in ("sources", "receivers")]
        both = [Edit(("room",), "unit", unit, now=["ft" if unit == "m" else "m"]), *points]
        words = f"positions times {factor:.4g}"
        remedies.append(Remedy(both, f"room in {unit}, {words}", once=True))
        remedies.append(Remedy(points, f"{words}, the room as it is", once=True))
    return Finding(Code.COORDINATES_SCALED, about, text, evidence, remedies=remedies)


def _other_unit(found: _Arrivals) -> _Findings:
    """All distances are those of another unit, beside a common delay."""
    if len(found.path_m) < _FEWEST or np.ptp(found.distance_m) < 3.0 * found.tolerance_m.max():
        return ()
    for factor in _FACTORS:
        late_m = found.path_m - factor * found.distance_m
        if np.all(np.abs(late_m - np.median(late_m)) <= found.tolerance_m):
            return (_scaled(factor, found),)
    return ()


def _receivers_displaced(found: _Arrivals) -> _Explanation | None:
    """All receivers stand elsewhere by one vector, found by Gauss-Newton steps."""
    at = {p.name: p.position_m for p in found.receiver}
    if len(at) < 2 or len(found.late_m) <= 3:
        return None
    shift_m = np.zeros(3)
    for _ in range(_STEPS):
        away = found.away_m + shift_m
        distance_m = np.linalg.norm(away, axis=1)
        columns = away / distance_m[:, None]
        step_m, _, rank, _ = np.linalg.lstsq(columns, found.path_m - distance_m, rcond=1e-3)
        if rank < 3:
            return None
        shift_m += step_m
    rest_m = found.path_m - np.linalg.norm(found.away_m + shift_m, axis=1)
    size_m = float(np.linalg.norm(shift_m))
    if not _LEAST_SHIFT_M < size_m < _MOST_SHIFT_M or np.any(np.abs(rest_m) > found.tolerance_m):
        return None
    if not _is_adequate(found, rest_m, 3):
        return None  # not all of them alike
    evidence = _evidence(found, rest_m, columns, np.full(3, 2.0 * _MOST_SHIFT_M))
    by = ", ".join(f"{x:+.2f}" for x in shift_m)
    words = f"all {len(at)} receivers stand elsewhere than specified, by ({by}) m"
    text = (
        f"By the direct sounds {words} against the sources: these explain the arrivals better than "
        "a delay. Measure them again, or compare the origins of both lists."
    )
    about = replace(about_files(*found.measurements), points_m=[p.tolist() for p in at.values()])
    numbers = {"receivers": sorted(at), "metres": size_m, "shift_m": shift_m.tolist()}
    shift = tuple(shift_m.tolist())
    moved = [Edit(("receivers", name), "position", shift, "add") for name in sorted(at)]
    advised = Remedy(moved, f"{in_short(sorted(at))} moved by ({by}) m", once=True)
    finding = Finding(Code.DISPLACEMENT_DETECTED, about, text, numbers, remedies=[advised])
    return _Explanation(evidence, words, (finding,))


def _exchanged(found: _Arrivals) -> _Findings:
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
            evidence = {"files": [a.where, b.where]}
            edits = [
                Edit(("measurements", m.where), key, getattr(other, key))
                for m, other in ((a, b), (b, a))
                for key in ("source", "receiver")
            ]
            advised = Remedy(edits, f"exchange {a.name} and {b.name}", once=True)
            about = about_files(a, b)
            return (Finding(Code.EXCHANGED, about, text, evidence, remedies=[advised]),)
    exchanges = [
        (who, e)
        for who, e, ends in _two_exchanged(found, off)
        if mends(np.asarray(np.linalg.norm(_away_m(*ends), axis=1)))
    ]
    if len(exchanges) != 1:
        return ()
    ((who, exchange),) = exchanges
    text = (
        f"The {who} are exchanged: all direct sounds arrive when they should "
        "if each has the position of the other."
    )
    sources, receivers = exchange.get("sources", []), exchange.get("receivers", [])
    both = [m for m in found.measurements if m.source in sources or m.receiver in receivers]
    ends = {("sources", p.name): p for p in found.source if p.name in sources}
    ends |= {("receivers", p.name): p for p in found.receiver if p.name in receivers}
    edits = [
        Edit(end, "position", tuple(other.position_m.tolist()))
        for end, other in zip(ends, reversed(ends.values()), strict=True)
    ]
    words = " and ".join(name for _, name in ends)
    advised = Remedy(edits, f"exchange the positions of {words}", once=True)
    return (Finding(Code.EXCHANGED, about_files(*both), text, exchange, remedies=[advised]),)


def _two_exchanged(
    found: _Arrivals, off: IntArray
) -> Iterator[tuple[str, dict[str, list[str]], Sequence[Sequence[Point]]]]:
    """Yield two points of doubtful files, in words and by kind, with all ends if exchanged.

    None of a kind of which so many are doubtful that it is something that all have in common.
    """
    few = [list({points[i].name: points[i] for i in off}.values()) for points in found.ends]
    few = [points if len(points) <= _MOST_EXCHANGED else [] for points in few]

    def moved(points: Sequence[Point], to: dict[str, Point]) -> list[Point]:
        return [to.get(p.name, p) for p in points]

    for k, kind in ((1, "receivers"), (0, "sources")):
        for one, other in combinations(few[k], 2):
            ends, names = list(found.ends), [one.name, other.name]
            ends[k] = moved(ends[k], {one.name: other, other.name: one})
            yield f"{kind} {one.name} and {other.name}", {kind: names}, ends
    for one, other in product(*few):
        ends = [moved(found.source, {one.name: other}), moved(found.receiver, {other.name: one})]
        who = f"source {one.name} and the receiver {other.name}"
        yield who, {"sources": [one.name], "receivers": [other.name]}, ends


def _displaced(found: _Arrivals) -> _Findings:
    """One source or receiver stands elsewhere, the others as specified: chi-square decides.

    Each source may have a delay; the three coordinates of one point after the other are fitted.
    """
    n = len(found.late_m)
    if n < _FEWEST + 1:
        return ()
    columns = _derivatives(found)
    names = np.array([m.source for m in found.measurements])
    delays = (names[:, None] == list(dict.fromkeys(names.tolist()))).astype(float)
    robust_m = 1.4826 * float(np.median(np.abs(found.late_m - np.median(found.late_m))))
    white = _whitening(found, robust_m)
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
    own = np.any(columns[best] != 0.0, axis=1)
    one_file = [
        whole - _left(np.hstack([base, white[:, [i]]]), data)[0] for i in np.flatnonzero(own)
    ]
    # what a displacement leaves unchanged of the other paths is less likely the farther it is
    ratio = float(np.abs(found.late_m[own]).max() / found.tolerance_m.max())
    unchanged = min(int(own.sum()) - 1, 2)
    unlikely = unchanged * np.log(_TOLERANCE_SD * ratio) - 0.5 * (gain - max(one_file))
    if unlikely > UNDECIDED:
        return ()  # one file by itself, which is reported as such
    return _displacement(found, best, ~own, delays)


def _derivatives(found: _Arrivals) -> dict[Point, FloatArray]:
    """Return the derivatives of all paths by the coordinates of each point, (n, 3)."""
    along = found.away_m / found.distance_m[:, None]
    columns: dict[Point, FloatArray] = {}
    for points, sign in zip(found.ends, (-1.0, 1.0), strict=True):
        for i, point in enumerate(points):
            columns.setdefault(point, np.zeros_like(along))[i] = sign * along[i]
    return columns


def _left(columns: FloatArray, data: FloatArray) -> tuple[float, int]:
    """Return the sum of squares that least squares leave, and the rank."""
    solution, _, rank, _ = np.linalg.lstsq(columns, data, rcond=1e-8)
    return float(np.sum((data - columns @ solution) ** 2)), int(rank)


def _displacement(
    found: _Arrivals, point: Point, others: BoolArray, delays: FloatArray
) -> _Findings:
    delay_m, *_ = np.linalg.lstsq(delays[others], found.late_m[others], rcond=None)
    rest_m = (found.late_m - delays @ delay_m)[~others]
    size_m = float(np.max(np.abs(rest_m)))  # no path changes by more than its end moves
    if size_m < _LEAST_SHIFT_M:
        return ()
    kind, name = "receiver" if point in found.receiver else "source", point.name
    chosen = [found.measurements[i] for i in np.flatnonzero(~others)]
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
    about = replace(about_files(*chosen), points_m=[point.position_m.tolist()])
    sd_m = round(size_m, 2)
    opened = Remedy([Edit((f"{kind}s", name), "position_sd", sd_m)])
    remedies = [opened] if sd_m <= 1.0 else []  # else to be measured again
    return (Finding(Code.DISPLACEMENT_DETECTED, about, text, evidence, remedies=remedies),)
