"""What every reader hands over, and the doubts that any recording is searched for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roomfit.errors import InputError
from roomfit.findings import Finding
from roomfit.typing import FloatArray

_SHORTEST_S = 0.01
_LOUDEST, _SOFTEST = 1e12, 1e-30  # their squares are far from what a float can hold
_CLIPPED_RUN = 4
_EQUAL_PEAKS = 5
_FEW_LEVELS = 500.0
_CREST_STEPS = 3.0
# Below this share of the peak an offset is far below any noise floor that matters (-80 dB).
_LEAST_OFFSET = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """One channel as it lies in a file.

    Attributes
    ----------
    pressure : float array, shape (n_samples,)
        Not yet checked: may hold nan.
    sampling_rate_hz : float
    delay_s : float
        By how much the file says that its first sample comes after its own time zero.
    findings : tuple of Finding
    """

    pressure: FloatArray
    sampling_rate_hz: float
    delay_s: float = 0.0
    findings: tuple[Finding, ...] = ()


def pick(kind: str, index: int | None, count: int, key: str, where: str) -> int:
    """Return the index that was asked for, or 0 where there is only one to choose.

    Raises
    ------
    InputError
        There are several and none was named, or the named one does not exist.
    """
    numbers = "0" if count == 1 else f"0 to {count - 1}"
    if index is None and count == 1:
        return 0
    if index is None:
        raise InputError(
            f"the file holds several {kind}s and none was chosen",
            where=where,
            found=f"{count} {kind}s, {numbers}",
            needed=f"{key} = a number from {numbers}",
        )
    if not 0 <= index < count:
        raise InputError(
            f"the file has no such {kind}",
            where=where,
            found=f"{key} = {index}",
            needed=f"{key} = {numbers} ({kind}s are counted from 0)",
        )
    return index


def checked(recording: Recording, where: Path) -> tuple[FloatArray, tuple[Finding, ...]]:
    """Return the pressure without a constant offset, and a finding for every doubt.

    Raises
    ------
    InputError
        Too short, nan or infinite samples, or nothing but silence.
    """
    refuse_useless(recording, where)
    pressure = recording.pressure
    offset, told = _offset(pressure, where)
    clipped = clipping(pressure, where, "Early energy is wrong") or _equal_peaks(pressure, where)
    return pressure - offset, (*recording.findings, *clipped, *told)


def refuse_useless(recording: Recording, where: Path) -> None:
    """Refuse what cannot be sound.

    Raises
    ------
    InputError
        Too short, nan or infinite samples, or nothing but silence.
    """
    pressure, place = recording.pressure, str(where)
    duration_s = len(pressure) / recording.sampling_rate_hz
    if duration_s < _SHORTEST_S:
        raise InputError(
            "the response is too short",
            where=place,
            found=f"{len(pressure)} samples, {1000.0 * duration_s:.3g} ms",
            needed=f"at least {1000.0 * _SHORTEST_S:g} ms",
        )
    bad = np.flatnonzero(~np.isfinite(pressure))
    if bad.size:
        raise InputError(
            "the response holds samples that are not finite numbers",
            where=place,
            found=f"{bad.size} of {len(pressure)}, the first at sample {bad[0]}",
            needed="finite pressures",
            hint="look at how the file was made: a division by an empty spectrum leaves nan",
        )
    largest = float(np.abs(pressure).max())
    if largest > _LOUDEST:
        raise InputError(
            "the response holds values that no pressure has",
            where=place,
            found=f"{largest:.3g}",
            needed=f"at most {_LOUDEST:g} in whatever unit",
            hint="the file may be damaged, or of another number format than it says",
        )
    if np.ptp(pressure) <= _SOFTEST:
        raise InputError(
            "the response is silent",
            where=place,
            found=f"{len(pressure)} samples, all of them {pressure[0]:g}",
            hint="another channel may hold the response",
        )


def clipping(pressure: FloatArray, where: Path, harm: str) -> tuple[Finding, ...]:
    """Return a finding where the peak was cut off: a run of equal samples with steep sides.

    A peak is one sample or two. The crest of a low tone holds more samples that a coarse converter
    takes for equal, but beside them it falls by a step or two of the converter only.

    Parameters
    ----------
    pressure : float array, shape (n_samples,)
        Finite, not all equal.
    where : Path
    harm : str
        What it does to the result.
    """
    size = np.abs(pressure)
    # full scale downwards is one step farther than upwards
    at_peak = size[1:] >= size.max() * (1.0 - 1e-4)
    repeated = (np.diff(pressure) == 0.0) & at_peak
    edges = np.flatnonzero(np.diff(np.concatenate(([0], repeated.astype(np.int8), [0]))))
    first, last = edges[::2], edges[1::2]
    steps = np.abs(np.diff(pressure))
    crest = _CREST_STEPS * float(steps[steps > 0.0].min())
    beside = np.concatenate(([0.0], steps, [0.0]))
    steep = np.maximum(beside[first], beside[last + 1]) > crest
    longest = int(np.max((last - first)[steep], initial=0)) + 1
    if longest < _CLIPPED_RUN:
        return ()
    return (
        Finding(
            "response-clipped",
            "serious",
            f"{where.name} looks clipped: {longest} samples in a row have the largest value, "
            f"{size.max():.4g}. {harm}; measure again at a lower level.",
            {"longest_run": longest, "largest": float(size.max())},
        ),
    )


def _equal_peaks(pressure: FloatArray, where: Path) -> tuple[Finding, ...]:
    """Return a finding where many separate peaks of a response are equally high.

    Short peaks that are cut off have no run of equal samples; but no two reflections of a room are
    equal, let alone five, unless a converter knows only a few levels.
    """
    size = np.abs(pressure)
    steps = np.abs(np.diff(pressure))
    if size.max() < _FEW_LEVELS * float(steps[steps > 0.0].min()):
        return ()
    high = size >= size.max() * (1.0 - 1e-6)
    before, after = np.concatenate(([0.0], size[:-1])), np.concatenate((size[1:], [0.0]))
    steep = np.minimum(before, after) < 0.99 * size.max()
    n_peaks = int(np.count_nonzero(high & steep))
    if n_peaks < _EQUAL_PEAKS:
        return ()
    return (
        Finding(
            "response-clipped",
            "serious",
            f"{where.name} looks clipped: {n_peaks} peaks have the same largest value, "
            f"{size.max():.4g}. Early energy is wrong; measure again at a lower level.",
            {"equal_peaks": n_peaks, "largest": float(size.max())},
        ),
    )


def _offset(pressure: FloatArray, where: Path) -> tuple[float, tuple[Finding, ...]]:
    """Return the offset to subtract: one where the quiet end of the file is mostly offset.

    The mean of the whole would be wrong: every response has some. What stays of an offset makes a
    step at both ends of the file, which low bands take for sound.
    """
    end = pressure[-max(1, len(pressure) // 4) :]
    mean, peak = float(end.mean()), float(np.abs(pressure).max())
    if abs(mean) <= _LEAST_OFFSET * peak or abs(mean) <= 2.0 * float(end.std()):
        return 0.0, ()
    return mean, (
        Finding(
            "dc-offset",
            "info",
            f"{where.name} has a constant offset of {mean:.3g} ({abs(mean) / peak:.2%} of its "
            "peak); it was subtracted.",
            {"offset": mean, "relative_to_peak": mean / peak},
        ),
    )
