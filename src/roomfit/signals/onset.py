"""When the direct sound arrives, and whether that is when the geometry says it does."""

from __future__ import annotations

import numpy as np

from roomfit.errors import InputError
from roomfit.findings import Finding
from roomfit.signals.impulse_response import ImpulseResponse
from roomfit.typing import FloatArray

_BELOW_PEAK = 10.0 ** (-20.0 / 20.0)
# A normal noise exceeds 5 standard deviations once in 1.7 million samples.
_ABOVE_NOISE = 5.0
_TOLERANCE_M = 0.1
# how far off `find_onset` itself may be, in samples
_ONSET_SAMPLES = 3.0
# Farther off than any wrong position: early and late windows hold the wrong reflections.
_SERIOUS_M = 3.0


def find_onset(response: ImpulseResponse, where: str | None = None) -> float:
    """Return when the direct sound arrives, in seconds after emission.

    The moment when the pressure first comes within 20 dB of its peak [1]_ and out of the noise,
    found between samples by a straight line. A lone sample is thus found 0.9 samples early, a sharp
    band-limited click up to 3.

    Parameters
    ----------
    response : ImpulseResponse
    where : str, optional
        Names the response in a message.

    Raises
    ------
    InputError
        Nothing stands out of the noise.

    Notes
    -----
    Noise is what the quietest tenth of the file holds; an offset is subtracted first.

    References
    ----------
    .. [1] ISO 3382-1:2009, annex A: the response begins where it rises clearly out of the
           background, and is more than 20 dB below its maximum before.
    """
    pressure = response.pressure - np.median(response.pressure)
    size = np.abs(pressure)
    peak = float(size.max(initial=0.0))
    noise = _ABOVE_NOISE * _quietest_rms(pressure)
    if not noise < peak:
        raise InputError(
            "no direct sound was found in the response",
            where=where,
            found=f"a peak of {peak:.3g} and noise of {noise / _ABOVE_NOISE:.3g} (rms)",
            needed=f"a peak at least {_ABOVE_NOISE:g} times the noise",
            hint="another channel may hold the response, or the file may be noise only",
        )
    threshold = max(_BELOW_PEAK * peak, min(noise, 0.5 * peak))
    first = int(np.argmax(size >= threshold))
    sample = float(first)
    if first > 0:
        before = float(size[first - 1])
        sample -= (float(size[first]) - threshold) / (float(size[first]) - before)
    return sample / response.sampling_rate_hz - response.time_zero_s


def check_travel(response: ImpulseResponse, travel_s: float, where: str | None = None) -> None:
    """Refuse a response that ends before the direct sound can have arrived.

    Parameters
    ----------
    response : ImpulseResponse
    travel_s : float
        Distance over speed of sound.
    where : str, optional

    Raises
    ------
    InputError
    """
    end_s = len(response.pressure) / response.sampling_rate_hz - response.time_zero_s
    if end_s <= travel_s:
        raise InputError(
            "the response ends before the direct sound arrives",
            where=where,
            found=f"the file ends {1000.0 * abs(end_s):.1f} ms "
            f"{'after' if end_s >= 0.0 else 'before'} emission",
            needed=f"more than {1000.0 * travel_s:.1f} ms, the travel time of the direct sound",
            hint="check the positions, the unit of the room, the latency and the file",
        )


def compare_onset(
    onset_s: float,
    travel_s: float,
    speed_of_sound_m_s: float,
    where: str,
    sampling_rate_hz: float,
) -> tuple[Finding, ...]:
    """Return a finding where the onset and the geometry disagree by more than 10 cm.

    What three samples of the file span is added to that, and it is serious from 3 m on.

    Parameters
    ----------
    onset_s : float
        Measured, from `find_onset`.
    travel_s : float
        Distance over speed of sound.
    speed_of_sound_m_s : float
    where : str
        Names the response in the sentence.
    sampling_rate_hz : float
    """
    apart_m = (onset_s - travel_s) * speed_of_sound_m_s
    tolerance_m = _TOLERANCE_M + _ONSET_SAMPLES / sampling_rate_hz * speed_of_sound_m_s
    if abs(apart_m) <= tolerance_m:
        return ()
    order = "later" if apart_m > 0.0 else "earlier"
    return (
        Finding(
            "time-zero-disagrees",
            "serious" if abs(apart_m) > _SERIOUS_M else "warning",
            f"{where}: the direct sound arrives {1000.0 * abs(onset_s - travel_s):.2f} ms {order} "
            f"than the geometry says, which is {abs(apart_m):.2f} m of path. Check the positions, "
            "latency_s and time_zero; sound that is blocked or that a loudspeaker sends elsewhere "
            "arrives late, too.",
            {"onset_s": onset_s, "travel_s": travel_s, "difference_m": apart_m},
        ),
    )


def time_zero_from_direct(
    response: ImpulseResponse, travel_s: float, where: str | None = None
) -> ImpulseResponse:
    """Return the response on a clock by which its direct sound arrives when the geometry says.

    For files that begin at the direct sound, or whose beginning means nothing.

    Raises
    ------
    InputError
        No direct sound.
    """
    shift_s = find_onset(response, where) - travel_s
    return ImpulseResponse(
        response.pressure, response.sampling_rate_hz, response.time_zero_s + shift_s
    )


def _quietest_rms(pressure: FloatArray) -> float:
    """Return the least rms of ten equal parts of the file."""
    parts = np.array_split(pressure, 10)
    return float(np.sqrt(min(np.mean(part**2) for part in parts if part.size)))
