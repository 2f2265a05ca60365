"""Decay of a diffuse field, and its absorption by Eyring's formula.

Uniform absorption is where a fit starts, and the baseline to compare it with.
"""

from __future__ import annotations

import numpy as np

from roomfit.base.typing import FloatArray

# Of the absorption that a decay gives, so that a search can move either way.
_LOWEST, _HIGHEST = 0.02, 0.98


def eyring_absorption(
    decay_rate_per_s: float,
    volume_m3: float,
    surface_m2: float,
    speed_of_sound_m_s: float,
    attenuation_per_m: float = 0.0,
) -> float:
    """Return the absorption which, on all walls alike, gives a decay rate by Eyring's law.

    ``k = c (m - S ln(1 - a) / (4 V))`` (J. Acoust. Soc. Am. 1, 217 (1930)), kept within 0.02 to
    0.98 so that a search can move either way.
    """
    loss_per_m = decay_rate_per_s / speed_of_sound_m_s - attenuation_per_m
    absorption = -np.expm1(-loss_per_m * 4.0 * volume_m3 / surface_m2)
    return float(np.clip(absorption, _LOWEST, _HIGHEST))


def eyring_time_s(
    absorption: FloatArray,
    volume_m3: float,
    surface_m2: float,
    speed_of_sound_m_s: float,
    attenuation_per_m: FloatArray,
) -> FloatArray:
    """Return the reverberation time of a diffuse field, of the shape of `absorption`.

    ``T = 24 ln(10) V / (c (4 m V - S ln(1 - a)))``, the inverse of `eyring_absorption`.
    """
    lost_m2 = -surface_m2 * np.log1p(-np.minimum(absorption, 0.999))
    lost_m2 = lost_m2 + 4.0 * volume_m3 * attenuation_per_m
    return np.asarray(24.0 * np.log(10.0) * volume_m3 / (speed_of_sound_m_s * lost_m2))


def schroeder_hz(decay_s: FloatArray, volume_m3: float) -> FloatArray:
    """Return the Schroeder frequency ``2000 (T / V) ** 0.5``; below it single modes are resolved.

    M. R. Schroeder, J. Acoust. Soc. Am. 99, 3240-3241 (1996).
    """
    return np.asarray(2000.0 * np.sqrt(decay_s / volume_m3))
