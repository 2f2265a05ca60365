"""One impulse response, as measured."""

from __future__ import annotations

from dataclasses import dataclass

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
