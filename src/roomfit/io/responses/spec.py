"""Which response to take from which file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from roomfit.measurement import TimeZero


@dataclass(frozen=True, slots=True)
class ResponseSpec:
    """One response in a file, as a campaign names it."""

    path: Path  # a WAV, MAT or SOFA file, or a text file of REW (.txt), recognised by its suffix
    # WAV: channel; MAT: column. From 0; needed where there are several
    channel: int | None = None
    variable: str | None = None  # MAT: name of the array of responses
    sampling_rate_variable: str | None = None  # MAT: name of the sampling rate in Hz
    # MAT: the sampling rate itself. Elsewhere it must agree with the file
    sampling_rate_hz: float | None = None
    measurement: int | None = None  # SOFA: from 0; needed where there are several
    receiver_index: int | None = None  # SOFA: from 0; needed where there are several
    time_zero: TimeZero = "emission"  # what the beginning of the file stands for
    # delay of the measuring chain: emission lies this long after the first sample (REW: after
    # REW's own time zero)
    latency_s: float = 0.0
    # the WAV file that was played, where `path` (WAV or MAT) is its recording and not yet an
    # impulse response; emission is the start of this file. It may be `path` itself, where another
    # channel holds a loopback
    excitation: Path | None = None
    # from 0; needed where the excitation has several channels
    excitation_channel: int | None = None
