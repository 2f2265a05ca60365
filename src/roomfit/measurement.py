"""Measured files of a campaign: read, put on the clock of emission, and judged band by band.

Which response to take from which file.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from roomfit.signals.decay import DecayCurve, RoomParameters
from roomfit.signals.noise import NoiseEstimate
from roomfit.signals.response import ImpulseResponse

TimeZero = Literal["emission", "direct", "unknown"]


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


Level = Literal["per-source", "per-file", "absolute"]
Use = Literal["fit", "validate"]


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredFile:
    """One measured response: where it lies, whose pair it is, and how it is to be used.

    Attributes
    ----------
    source, receiver : str
    response : ResponseSpec
    level : {"per-source", "per-file", "absolute"}
    use : {"fit", "validate"}
    latency_sd_s : float or None
        How uncertain the moment of emission is; None where nothing was told.
    """

    source: str
    receiver: str
    response: ResponseSpec
    level: Level
    use: Use
    latency_sd_s: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredTable:
    """One table of ISO 3382 values, and which of its rows are meant; None means all."""

    path: Path
    source: str | None
    receiver: str | None
    use: Use


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredSpectrum:
    """One file of damped pressures, for impedances; `level` is None where none was told."""

    source: str
    receiver: str
    path: Path
    level: Level | None
    use: Use


# How well the moment of emission is known where nothing is told, by `time_zero`.
LATENCY_SD_S = {"emission": 2e-5, "direct": 1e-4, "unknown": 1e-4}


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPair:
    """One measured response and what is known from it without any model.

    Attributes
    ----------
    file : MeasuredFile
    pair : int
        Index of the pair in the scene.
    response : ImpulseResponse
        Its `time_zero_s` is the emission, whatever the file's own clock said.
    direct_s : float
        Travel time of the direct sound by the geometry.
    noise : NoiseEstimate
    curve : DecayCurve
    parameters : RoomParameters
    """

    file: MeasuredFile
    pair: int
    response: ImpulseResponse
    direct_s: float
    noise: NoiseEstimate
    curve: DecayCurve
    parameters: RoomParameters
