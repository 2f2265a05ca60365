"""Spectra behind an exponential window, from impulse responses."""

from __future__ import annotations

import numpy as np

from roomfit.errors import InputError
from roomfit.signals.impulse_response import ImpulseResponse, times_s
from roomfit.typing import ComplexArray, FloatArray

# Times tau after which nothing of a window is left, exp(-12) = 6e-6.
_WINDOW = 12.0
# So long before the direct sound a response may begin: filters ring both ways.
_EARLY_S = 0.002
_LEAST_PARTS = 2


def damped_spectrum(
    response: ImpulseResponse, frequency_hz: FloatArray, tau_s: float, direct_s: float
) -> ComplexArray:
    """Return the spectrum of a response times ``exp(-t / tau)``, t from emission.

    ``sum h exp(-t / tau) exp(-j w t)``: a response whose direct sound is a single sample of
    ``1 / (4 pi r)`` gives ``exp(-j k r) / (4 pi r)`` with the complex wavenumber of the window.
    What comes more than 2 ms before the direct sound is no sound and left out.

    Parameters
    ----------
    response : ImpulseResponse
    frequency_hz : float array, shape (n_frequencies,)
    tau_s : float
    direct_s : float
        When the direct sound arrives, after emission.

    Raises
    ------
    InputError
        The response ends before the window does, or does not reach the highest frequency.
    """
    t = times_s(response)
    if t[-1] < direct_s + 3.0 * tau_s:
        raise InputError(
            "the response ends before the exponential window",
            found=f"{1000.0 * t[-1]:.0f} ms after emission",
            needed=f"at least {1000.0 * (direct_s + 3.0 * tau_s):.0f} ms",
            hint="choose a shorter tau_s",
        )
    if frequency_hz[-1] > 0.4 * response.sampling_rate_hz:
        raise InputError(
            "the highest frequency is too near to half of the sampling rate",
            found=f"{frequency_hz[-1]:g} Hz at {response.sampling_rate_hz:g} Hz",
            needed=f"at most {0.4 * response.sampling_rate_hz:g} Hz",
        )
    own = (t >= direct_s - _EARLY_S) & (t <= direct_s + _WINDOW * tau_s)
    return _transformed(response.pressure[own], t[own], frequency_hz, tau_s)


def damped_noise(
    response: ImpulseResponse, frequency_hz: FloatArray, tau_s: float, direct_s: float
) -> FloatArray | None:
    """Return the rms noise of a damped spectrum by what the end of the file holds.

    Windows of the same length and weight are laid side by side over its last half; the lowest
    third of them counts, so that what is left of the decay does not.

    Returns
    -------
    float array, shape (n_frequencies,), or None
        None where the file is too short.
    """
    t = times_s(response)
    window_s = min(_WINDOW * tau_s, 0.25 * (t[-1] - direct_s))
    start = max(direct_s + _WINDOW * tau_s, 0.5 * t[-1])
    n = round(window_s * response.sampling_rate_hz)
    first = int(np.searchsorted(t, start))
    count = (len(t) - first) // max(n, 1)
    if count < _LEAST_PARTS or n < 8:
        return None
    # at the window's start, as the sound that is measured
    clock = direct_s + np.arange(n) / response.sampling_rate_hz
    parts = np.reshape(response.pressure[len(t) - count * n :], (count, n))
    power = np.array(
        [np.abs(_transformed(part, clock, frequency_hz, tau_s)) ** 2 for part in parts]
    )
    quiet = np.argsort(power.sum(axis=1))[: max(count // 3, _LEAST_PARTS)]
    # few windows: neighbouring frequencies tell the same
    mean = power[quiet].mean(axis=0)
    near = np.abs(np.log(frequency_hz[:, None] / frequency_hz)) <= 0.2
    return np.asarray(np.sqrt((near @ mean) / near.sum(axis=1)))


def _transformed(
    pressure: FloatArray, t: FloatArray, frequency_hz: FloatArray, tau_s: float
) -> ComplexArray:
    damped = pressure * np.exp(-t / tau_s)
    return np.array([np.sum(damped * np.exp(-2j * np.pi * f * t)) for f in frequency_hz])
