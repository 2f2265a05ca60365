"""Whether a recording is an impulse response at all, and whether its decay is long enough."""

from __future__ import annotations

import numpy as np

from roomfit.errors import InputError
from roomfit.signals.decay import DecayCurve
from roomfit.signals.impulse_response import ImpulseResponse
from roomfit.typing import FloatArray

_LEAST_RANGE_DB = 15.0
_N_BLOCKS = 12
# Nobody excites a room for less; in a dry room nearly all energy comes within a few ms.
_SHORTEST_EXCITATION_S = 0.05


def check_is_response(response: ImpulseResponse, where: str | None = None) -> None:
    """Refuse a recording of the excitation that nobody has deconvolved.

    Two signs are looked for between the instants by which 5 and 95 % of the energy have come. A
    sweep climbs: the median frequency rises from block to block by two octaves or more in all. A
    long excitation of any kind does not decay: half its energy comes in more than 0.6 of the time
    of the other half (an exponential decay: 0.28), and no peak stands out of its mean by 16 dB.

    Raises
    ------
    InputError
    """
    pressure = response.pressure - np.mean(response.pressure)
    cumulative = np.cumsum(pressure**2)
    begin, middle, end = np.searchsorted(cumulative, cumulative[-1] * np.array([0.05, 0.5, 0.95]))
    loud = pressure[begin : end + 1]
    if len(loud) < _SHORTEST_EXCITATION_S * response.sampling_rate_hz:
        return
    crest = float(np.max(loud**2) / np.mean(loud**2))
    lasting = bool(middle - begin > 0.6 * (end - middle)) and crest < 40.0
    if not (lasting or _climbs(loud)):
        return
    raise InputError(
        "this looks like a recording of the excitation, not like an impulse response",
        where=where,
        found=f"sound that lasts {len(loud) / response.sampling_rate_hz:.2f} s without decaying",
        needed="the response after deconvolution: one onset, then a decay",
        hint="divide the recorded spectrum by that of the sweep, and give the result",
    )


def check_decay_range(curve: DecayCurve, where: str | None = None) -> None:
    """Refuse a response of which no band has 15 dB of decay above its noise and before its end.

    Single bands that fall short of T20 are told by `room_parameters.range_findings` instead.

    Raises
    ------
    InputError
        Says whether the file is cut short or drowned in noise.
    """
    deepest = int(np.argmax(curve.usable_db))
    if curve.usable_db[deepest] >= _LEAST_RANGE_DB:
        return
    cut = not curve.noise_reached[deepest]
    raise InputError(
        "the decay is cut short" if cut else "the decay drowns in noise",
        where=where,
        found=f"{curve.usable_db[deepest]:.0f} dB of decay at "
        f"{curve.bands.centres_hz[deepest]:g} Hz, and no more in any other band",
        needed=f"at least {_LEAST_RANGE_DB:g} dB in some band, 25 dB for T20",
        hint="give the whole response" if cut else "measure with a longer sweep, or louder",
    )


def _climbs(loud: FloatArray) -> bool:
    size = len(loud) // _N_BLOCKS
    if size < 64:
        return False
    power = np.abs(np.fft.rfft(loud[: size * _N_BLOCKS].reshape(_N_BLOCKS, size), axis=1)) ** 2
    cumulative = np.cumsum(power, axis=1)
    median = np.argmax(cumulative >= 0.5 * cumulative[:, -1:], axis=1) + 0.5
    rises = int(np.sum(np.diff(median) > 0.0))
    return rises >= _N_BLOCKS - 3 and bool(median[-1] > 4.0 * median[0])
