"""Which response to take from which file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from roomfit.measurement import TimeZero


@dataclass(frozen=True, slots=True)
class ResponseSpec:
    """One response in a file, as a campaign names it.

    Attributes
    ----------
    path : Path
        A WAV, MAT or SOFA file, or a text file of REW (.txt), told by its ending.
    channel : int or None
        WAV: channel; MAT: column. From 0; needed where there are several.
    variable : str or None
        MAT: name of the array of responses.
    sampling_rate_variable : str or None
        MAT: name of the sampling rate in Hz.
    sampling_rate_hz : float or None
        MAT: the sampling rate itself. Elsewhere it must agree with the file.
    measurement, receiver_index : int or None
        SOFA: from 0; needed where there are several.
    time_zero : {"emission", "direct", "unknown"}
        What the beginning of the file stands for.
    latency_s : float
        Delay of the measuring chain: emission lies this long after the first sample (REW: after
        REW's own time zero).
    excitation : Path or None
        The WAV file that was played, where `path` (WAV or MAT) is its recording and not yet an
        impulse response; emission is the start of this file. It may be `path` itself, where
        another channel holds a loopback.
    excitation_channel : int or None
        From 0; needed where the excitation has several channels.
    """

    path: Path
    channel: int | None = None
    variable: str | None = None
    sampling_rate_variable: str | None = None
    sampling_rate_hz: float | None = None
    measurement: int | None = None
    receiver_index: int | None = None
    time_zero: TimeZero = "emission"
    latency_s: float = 0.0
    excitation: Path | None = None
    excitation_channel: int | None = None
