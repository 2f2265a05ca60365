"""Decay and room parameters of a diffuse field, and its absorption by Eyring's formula.

Uniform absorption is where a fit starts, and a diffuse field the baseline to compare it with.
"""

from __future__ import annotations

import numpy as np

from roomfit.base.typing import VALUE_NAMES, FloatArray

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


def diffuse_values(decay_s: FloatArray, volume_m3: float, distance_m: FloatArray) -> FloatArray:
    """Return room parameters by the revised theory of Barron and Lee [1]_, (n, n_names, n_bands).

    Shapes: `decay_s` (n_bands,), `distance_m` (n,). All decay times are the given one.

    References
    ----------
    .. [1] M. Barron, L.-J. Lee, "Energy relations in concert auditoriums. I", J. Acoust. Soc. Am.
           84, 618-628 (1988).
    """
    r, t = distance_m[:, None], decay_s[None]
    direct, reverberant = 100.0 / r**2, 31200.0 * t / volume_m3 * np.exp(-0.04 * r / t)
    total = direct + reverberant
    early_50, early_80 = (direct - reverberant * np.expm1(-13.8 * s / t) for s in (0.05, 0.08))
    found = {
        "C50_dB": 10.0 * np.log10(early_50 / (total - early_50)),
        "C80_dB": 10.0 * np.log10(early_80 / (total - early_80)),
        "D50_percent": 100.0 * early_50 / total,
        "TS_ms": 1000.0 * reverberant * t / 13.8 / total,
        "G_dB": 10.0 * np.log10(total),
    }
    times = np.broadcast_to(t, total.shape)
    return np.stack([found.get(name, times) for name in VALUE_NAMES], axis=1)
