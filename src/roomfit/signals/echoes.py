"""How clearly single echoes stand out of a response."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import butter, hilbert, sosfiltfilt

from roomfit.signals.impulse_response import ImpulseResponse
from roomfit.typing import FloatArray

# Above 800 Hz an echo is a millisecond long at most; above 8 kHz few loudspeakers radiate evenly.
_LOWEST_HZ, _HIGHEST_HZ = 800.0, 8000.0
_ECHO_S = 0.3e-3
_SURROUNDINGS_S = 10e-3
_FLOOR = 1e-9


def echo_prominence(response: ImpulseResponse) -> FloatArray:
    """Return by how much the energy of each moment exceeds that of its surroundings.

    The natural logarithm of the squared envelope between 0.8 and 8 kHz, over 0.3 ms, less its mean
    over 10 ms: 0 on average, 2 to 4 for a strong wall reflection.

    Returns
    -------
    float array, shape (n_samples,)
        On the samples of `response`. Zeros where the sampling rate leaves no such band.
    """
    rate_hz = response.sampling_rate_hz
    high_hz = min(_HIGHEST_HZ, 0.45 * rate_hz)
    if high_hz < 2.0 * _LOWEST_HZ:
        return np.zeros(len(response.pressure))
    band = butter(4, (_LOWEST_HZ, high_hz), btype="band", fs=rate_hz, output="sos")
    squared = np.abs(hilbert(sosfiltfilt(band, response.pressure))) ** 2
    energy = uniform_filter1d(squared, max(round(_ECHO_S * rate_hz), 1))
    level = np.log(energy + _FLOOR * float(energy.max(initial=0.0)) + np.finfo(float).tiny)
    return np.asarray(level - uniform_filter1d(level, max(round(_SURROUNDINGS_S * rate_hz), 1)))
