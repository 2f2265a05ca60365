"""One impulse response, as measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.checks import float_array
from roomfit.errors import InputError
from roomfit.typing import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ImpulseResponse:
    """Sound pressure over time after an impulse.

    Attributes
    ----------
    pressure : float array, shape (n_samples,)
        Unit as recorded; absolute only where the campaign says so.
    sampling_rate_hz : float
    time_zero_s : float
        Time of emission on the file's clock: sample 0 lies at ``-time_zero_s`` after emission.
    """

    pressure: FloatArray
    sampling_rate_hz: float
    time_zero_s: float = 0.0

    def __post_init__(self) -> None:
        if not 1000.0 <= self.sampling_rate_hz <= 1e6:
            raise InputError(
                "sampling rate is out of range",
                found=f"{self.sampling_rate_hz:g} Hz",
                needed="1000 to 1000000 Hz",
            )
        object.__setattr__(self, "pressure", float_array("pressure", self.pressure, (None,)))


def times_s(response: ImpulseResponse) -> FloatArray:
    """Return the time after emission of every sample, shape (n_samples,)."""
    samples = np.arange(len(response.pressure))
    return np.asarray(samples / response.sampling_rate_hz - response.time_zero_s)


def padded(response: ImpulseResponse, silence_s: float) -> ImpulseResponse:
    """Return the response with silence added before and after, at unchanged times after emission.

    At least `silence_s` on either side, in whole samples.
    """
    n = int(np.ceil(silence_s * response.sampling_rate_hz))
    return ImpulseResponse(
        np.pad(response.pressure, n),
        response.sampling_rate_hz,
        response.time_zero_s + n / response.sampling_rate_hz,
    )
