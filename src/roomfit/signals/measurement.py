"""What was measured: impulse responses and values of ISO 3382, with what is known of each.

No reading of files here: `roomfit.files` makes these records from files, anyone else from arrays.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from roomfit.base.arguments import check_known, float_array
from roomfit.base.errors import InputError
from roomfit.base.findings import Finding
from roomfit.base.typing import FloatArray
from roomfit.signals.decay import DecayCurve, RoomParameters
from roomfit.signals.noise import NoiseEstimate
from roomfit.signals.response import ImpulseResponse

TimeZero = Literal["emission", "direct", "unknown"]
Level = Literal["per-source", "per-file", "absolute"]
Use = Literal["fit", "validate"]


# Standard deviation of the moment of emission in s where it is unspecified, by `time_zero`.
LATENCY_SD_S = {"emission": 2e-5, "direct": 1e-4, "unknown": 1e-4}


@runtime_checkable
class Signal(Protocol):
    """Samples with their rate, such as a ``pyfar.Signal``."""

    @property
    def time(self) -> FloatArray:
        """Samples, the last axis over time."""

    @property
    def sampling_rate(self) -> float:
        """In Hz."""


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """One measured impulse response between a source and a receiver.

    Raises
    ------
    InputError
        The samples are not one finite channel, their rate is missing or out of range, or a choice
        is unknown.

    Examples
    --------
    >>> measured = Measurement("S1", "R1", [0.0, 1.0, 0.5], 48_000)
    >>> measured.response.sampling_rate_hz
    48000.0
    """

    source: str  # name of a source of the scene
    receiver: str  # name of a receiver of the scene
    samples: ArrayLike | Signal  # pressure, shape (n_samples,); or with its rate: a pyfar.Signal
    sampling_rate_hz: float | None = None  # 1 kHz to 1 MHz; may be left out for a Signal
    latency_s: float = 0.0  # emission lies this long after the first sample
    time_zero: TimeZero = "emission"  # what the first sample stands for, apart from the latency
    latency_sd_s: float | None = None  # standard deviation of the latency; None: unspecified
    level: Level = "per-source"  # what shares a gain; "absolute": 1 / (4 pi r) at r metres
    use: Use = "fit"  # or kept for validation
    name: str = ""  # of the file, for findings
    where: str = ""  # the file and the part of it, for messages
    findings: tuple[Finding, ...] = ()  # what reading it raised
    state: str = ""  # of the room, among its `states`; "": as the room is described
    response: ImpulseResponse = field(init=False)  # the samples, time zero by the latency alone

    def __post_init__(self) -> None:
        where = self.where or f"{self.source} to {self.receiver}"
        samples, rate_hz = self.samples, self.sampling_rate_hz
        if isinstance(samples, Signal):
            own_hz = float(samples.sampling_rate)
            if rate_hz is not None and rate_hz != own_hz:
                raise InputError(
                    "a signal with another sampling rate than the one that is given",
                    where=where,
                    found=f"{own_hz:g} and {rate_hz:g} Hz",
                    needed="one of the two, or the same twice",
                    hint="leave sampling_rate_hz out: the signal has its own",
                )
            samples, rate_hz = np.squeeze(samples.time), own_hz
        if rate_hz is None:
            what, found = "a measurement without a sampling rate", "samples without a rate"
            needed, hint = "sampling_rate_hz in Hz", "give sampling_rate_hz, or a Signal of pyfar"
            raise InputError(what, where=where, found=found, needed=needed, hint=hint)
        for key, value, known in (
            ("time_zero", self.time_zero, LATENCY_SD_S),
            ("level", self.level, ("per-source", "per-file", "absolute")),
            ("use", self.use, ("fit", "validate")),
        ):
            check_known(f"unknown {key} of a measurement", value, known, where=where)
        pressure = float_array(f"samples of {where}", samples, (None,))
        object.__setattr__(self, "samples", pressure)
        object.__setattr__(self, "sampling_rate_hz", float(rate_hz))
        object.__setattr__(self, "name", self.name or f"{self.source} to {self.receiver}")
        object.__setattr__(self, "where", where)
        object.__setattr__(
            self, "response", ImpulseResponse(pressure, float(rate_hz), self.latency_s)
        )

    @property
    def pair_name(self) -> tuple[str, str, str]:
        """Source, receiver and state of the room."""
        return self.source, self.receiver, self.state


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPair:
    """One measured response and what is known from it without any model."""

    measurement: Measurement
    pair: int  # index of the pair in the scene
    response: ImpulseResponse  # on the clock of emission, whatever the file's own said
    direct_s: float  # travel time of the direct sound by the geometry
    noise: NoiseEstimate
    curve: DecayCurve
    parameters: RoomParameters
    fit_end_s: FloatArray  # (n_bands,), after emission: later windows are not fitted
