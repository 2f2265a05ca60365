"""Whether the background noise is that of a room: stationary, and never cut off.

It falls where a window was left in the files, and stops where it was gated.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, digamma, polygamma, stdtrit

from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import FloatArray
from roomfit.checks.evidence import Evidence, about_files, file_name
from roomfit.signals.measurement import MeasuredPair

_LEVEL = 1e-4  # of a campaign whose noise is stationary
# Noise is sought above 500 Hz in so many blocks of a last part of the files, the first of three
# whose levels lie on a line, and in blocks of 1 ms until 3 ms before the direct sound.
_TAIL_SHARES, _TAIL_BLOCKS, _TAIL_HZ = (0.4, 0.25, 0.15), 8, 500.0
# A response that is limited to half of the sampling rate rings there before the direct sound; up to
# a quarter of that rate noise is noise.
_MOST_OF_RATE, _LEAST_RATE_HZ = 0.25, 4000.0
_EDGE_S, _BEFORE_S, _BLOCK_S, _MOST_BEFORE, _FEWEST_BEFORE = 0.5e-3, 3e-3, 1e-3, 8, 2
# Levels of noise scatter about the line as chi-square; of music-like or impulsive noise so many
# times as much at most. Of files without noise it is 80 times and more.
_STRAIGHT_CHANCE, _LARGEST_DISPERSION = 1e-3, 3.0
# Noise of 6 dB an octave has three degrees of freedom in a millisecond, the last modes have one.
_FEWEST_FREE = 2.0
# Averaged over so many bins, a spectrum gives the bandwidth of noise without its own scatter.
_SMOOTHED_BINS = 17
# Early sound stands 6 dB above the line of the noise at least, or what falls is the sound itself;
# a rate that is a smaller share of the room's own does less to absorption than intervals allow for.
_EARLY_S, _LEAST_EXCESS, _LEAST_RATE = 0.02, 4.0, 0.05
_MOST_BY_WINDOW = 0.8  # of the decay rate as measured
# The last of a decay over steady noise: its rate on that of the room, its energy on the noise's.
_UNDECIDED = 2.0  # gain in log-likelihood by which the noise that falls has to be the likelier one
_LATE_RATES, _OVER_NOISE = np.linspace(0.4, 1.0, 7), np.geomspace(0.01, 100.0, 41)

# Runs of equal samples of a gate last so long at least; between them sound is louder than so
# many of the smallest steps.
_GAP_S, _GAP_STEPS, _FEWEST_GAPS = 2e-3, 8.0, 3


def check_gate(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding where responses resume after intervals of digital silence, as by a gate.

    A file that is padded with zeros has them once; where the steps of a converter are coarser than
    the noise, it never is louder than a few of them between.
    """
    fitted = [m for m in evidence.measured.responses if m.measurement.use == "fit"]
    gated = {m.measurement: n for m in fitted if (n := _gaps(m)) >= _FEWEST_GAPS}
    if not gated:
        return
    gaps = {file_name(m): n for m, n in gated.items()}
    names = ", ".join(list(gaps)[:3]) + (f" and {len(gaps) - 3} more" if len(gaps) > 3 else "")
    yield Finding(
        Code.NOISE_GATED,
        about_files(*gated),
        f"The response resumes after intervals of digital silence in {names}: a noise gate or "
        "a noise reduction was left in. It shortens the late decay and hides the noise; no "
        "material is called identifiable. Export the files without.",
        {"gaps": gaps},
    )


def _gaps(m: MeasuredPair) -> int:
    """Count runs of equal samples after the peak that are followed by signal."""
    x = m.response.pressure
    steps = np.abs(np.diff(x))
    ends = np.flatnonzero(np.diff(np.concatenate(([0], (steps == 0.0).astype(np.int8), [0]))))
    first, last = ends[::2], ends[1::2]
    long = last - first >= _GAP_S * m.response.sampling_rate_hz
    long &= first > int(np.argmax(np.abs(x)))
    first, last = first[long], last[long]
    coarse = _GAP_STEPS * float(steps[steps > 0.0].min(initial=np.inf))
    return sum(
        float(np.abs(x[a : b + 1] - x[a]).max()) > coarse
        for a, b in zip(last[:-1], first[1:], strict=True)
    )


class _Levels(NamedTuple):
    """Logarithms of block energies of one file, before the direct sound and at the end."""

    time_s: FloatArray  # (n_blocks,), the last `_TAIL_BLOCKS` of the end
    level: FloatArray
    variance: FloatArray  # of Gaussian noise
    early_s: float  # 20 ms from the direct sound on
    early: float


class _Line(NamedTuple):
    """Noise that falls by one rate in all files."""

    rate_per_s: float
    sd: float
    chi2: float
    n_free: int
    excess: float  # logarithm, of early sound over the line
    # gain in log-likelihood over noise that is steady after the sound and has another level before
    over_steady: float

    def is_straight(self, dispersion: float = 0.0) -> bool:
        """Whether levels scatter as those of noise do, or by so many times as much at most."""
        limit = max(float(chdtri(self.n_free, _STRAIGHT_CHANCE)), dispersion * self.n_free)
        return self.chi2 <= limit


def check_window(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding where the background noise falls, as in files under an exponential window.

    Noise is stationary, unless a window was applied after it was recorded. The levels before the
    direct sound and at the end of the files are put on one line, and taken for noise only if they
    scatter about it as the energies of noise do: sound that decays, that rises before the direct
    sound as that of a filter, or that a simulator puts there, scatters by far more. A rest of
    reverberation is fitted along.
    """
    measured = [m for m in evidence.measured.responses if m.measurement.use == "fit"]
    rings = [1.0 / t for m in measured for t in m.noise.tail_time_constant_s if t > 0.0]
    if not rings:
        return
    ring_per_s = float(np.median(rings))
    line = _noise_line(measured, ring_per_s)
    if line is None or not line.is_straight(_LARGEST_DISPERSION):
        return
    rate = line.rate_per_s
    least = max(float(stdtrit(line.n_free, 1.0 - _LEVEL)) * line.sd, _LEAST_RATE * ring_per_s)
    if line.excess < np.log(_LEAST_EXCESS) or rate <= least or line.over_steady < _UNDECIDED:
        return
    files = [m for m in measured if _levels(m, _TAIL_SHARES[-1]) is not None]
    yield Finding(
        Code.DECAY_BENT,
        About(files=[m.measurement.where for m in files]),
        f"The background noise falls by {10.0 * rate / np.log(10.0):.0f} dB per second "
        "from before the direct sound to the end of the files: an "
        f"exponential window of {2.0 / rate:.2g} s (pressure) was left in them, by which "
        "every decay is too fast. No material is called identifiable; undo it, or export the "
        "files without.",
        {
            "rate_per_s": round(rate, 3),
            "rate_sd_per_s": round(line.sd, 3),
            "dispersion": round(line.chi2 / line.n_free, 2),
            "files": len(files),
        },
    )


def _noise_line(measured: Sequence[MeasuredPair], ring_per_s: float) -> _Line | None:
    """Return the line of all files' noise, from the longest end that is straight.

    Else the least crooked. None where too little comes before the direct sound, or files are too
    short.
    """
    lines = []
    for share in _TAIL_SHARES:
        files = [x for m in measured if (x := _levels(m, share)) is not None]
        if not files:
            continue
        first_per_s = _least_squares(files, ring_per_s)[0]
        # over the line of the noise, reverberation falls by what it falls faster
        slower_per_s = float(np.clip(first_per_s, 0.0, _MOST_BY_WINDOW * ring_per_s))
        rate, sd, chi2, n_free = _least_squares(files, ring_per_s - slower_per_s)
        excess = [
            f.early - np.average(f.level + rate * (f.time_s - f.early_s), weights=1.0 / f.variance)
            for f in files
        ]
        dispersion = max(chi2 / n_free, 1.0)
        over_steady = 0.5 * (_steady_chi2(files, ring_per_s) - chi2) / dispersion
        sd *= float(np.sqrt(dispersion))
        line = _Line(rate, sd, chi2, n_free, float(np.median(excess)), over_steady)
        if line.is_straight():
            return line
        lines.append(line)
    return min(lines, key=lambda line: line.chi2 / line.n_free, default=None)


def _steady_chi2(files: Sequence[_Levels], ring_per_s: float) -> float:
    """Return chi-square of noise of one level after the sound, and another before it, in each file.

    Reverberation stands above the noise as much in all files, at the best of a grid.
    """
    time_s, level, variance = (
        np.array([getattr(f, name)[-_TAIL_BLOCKS:] for f in files])
        for name in ("time_s", "level", "variance")
    )
    rate_per_s, over = np.meshgrid(ring_per_s * _LATE_RATES, _OVER_NOISE)
    fallen = np.exp(-rate_per_s[..., None, None] * (time_s - time_s[:, :1]))
    rest, weight = level - np.log1p(over[..., None, None] * fallen), 1.0 / variance
    mean = np.sum(weight * rest, axis=-1, keepdims=True) / weight.sum(axis=1)[:, None]
    best = float(np.min(np.sum(weight * (rest - mean) ** 2, axis=(-2, -1))))
    for f in files:
        before, weights = f.level[:-_TAIL_BLOCKS], 1.0 / f.variance[:-_TAIL_BLOCKS]
        best += float(np.sum(weights * (before - np.average(before, weights=weights)) ** 2))
    return best


def _least_squares(files: Sequence[_Levels], ring_per_s: float) -> tuple[float, float, float, int]:
    """Return the rate that all files share, its deviation, chi-square, and freedom.

    Beside a height of each file and one share of reverberation, which is not negative.
    """
    columns = []
    for f in files:
        since_s = f.time_s - f.time_s[-_TAIL_BLOCKS]
        ringing = np.where(since_s >= 0.0, np.exp(-ring_per_s * np.maximum(since_s, 0.0)), 0.0)
        weight = 1.0 / f.variance
        rows = np.stack((-f.time_s, ringing, f.level))
        rows -= np.average(rows, axis=1, weights=weight)[:, None]
        columns.append(np.concatenate((rows, weight[None])))
    earlier, ringing, level, weight = np.concatenate(columns, axis=1)
    both = np.stack((earlier, ringing), axis=1)
    covariance = np.linalg.inv(both.T @ (weight[:, None] * both))
    rate, share = covariance @ both.T @ (weight * level)
    if share < 0.0:  # no reverberation takes noise away
        rate, share = float(np.sum(weight * earlier * level) / np.sum(weight * earlier**2)), 0.0
    n_free = level.size - len(files) - 2
    chi2 = float(np.sum(weight * (level - rate * earlier - share * ringing) ** 2))
    return float(rate), float(np.sqrt(covariance[0, 0])), chi2, n_free


def _levels(m: MeasuredPair, share: float) -> _Levels | None:
    """Return what noise may be in one file; None where there is too little of it.

    `share` is of the time from the direct sound to the last sample that is not zero. The energy of
    Gaussian noise in a block is chi-square with twice as many degrees of freedom as the product of
    time and statistical bandwidth; the mean of its logarithm is taken off.
    """
    x, rate_hz = m.response.pressure, m.response.sampling_rate_hz
    sounding = np.flatnonzero(x)
    begin, end = int(sounding[0]) + round(_EDGE_S * rate_hz), int(sounding[-1]) + 1
    direct = round((m.direct_s + m.response.time_zero_s) * rate_hz)
    stop = direct - round(_BEFORE_S * rate_hz)
    n_before = min(int((stop - begin) / (_BLOCK_S * rate_hz)), _MOST_BEFORE)
    size = int(share * (end - direct)) // _TAIL_BLOCKS
    if n_before < _FEWEST_BEFORE or size < _BLOCK_S * rate_hz or rate_hz < _LEAST_RATE_HZ:
        return None
    from scipy.signal import butter, sosfilt  # takes half a second to load

    high = butter(4, _TAIL_HZ, "high", fs=rate_hz, output="sos")
    pressure = sosfilt(np.concatenate([high, butter(8, 2.0 * _MOST_OF_RATE, output="sos")]), x)
    before = np.linspace(begin, stop, n_before + 1).astype(np.int64)
    tail = np.arange(end - _TAIL_BLOCKS * size, end + 1, size)
    first, last = np.append(before[:-1], tail[:-1]), np.append(before[1:], tail[1:])
    squared = pressure**2
    # not as differences of a cumulative sum, whose rounding is louder than noise under a window
    energy = np.array([squared[a:b].mean() for a, b in zip(first, last, strict=True)])
    early = direct, min(direct + round(_EARLY_S * rate_hz), end)
    loud = float(squared[slice(*early)].mean())
    if not (np.all(energy > 0.0) and loud > 0.0):
        return None
    power = np.abs(np.fft.rfft(pressure[tail[0] :])) ** 2
    power = np.convolve(power, np.ones(_SMOOTHED_BINS) / _SMOOTHED_BINS, "same")
    half_free = 0.5 * (last - first) * np.sum(power) ** 2 / (power.size * np.sum(power**2))
    if 2.0 * np.min(half_free) < _FEWEST_FREE:
        return None
    middle_s = np.asarray(0.5 * (first + last) / rate_hz)
    level = np.log(energy) - (digamma(half_free) - np.log(half_free))
    return _Levels(
        middle_s, level, polygamma(1, half_free), 0.5 * sum(early) / rate_hz, float(np.log(loud))
    )
