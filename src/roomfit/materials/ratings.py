"""Single-number ratings of sound absorption in octaves."""

from __future__ import annotations

import numpy as np

from roomfit.base.bands import Bands
from roomfit.base.typing import FloatArray

_REFERENCE = np.array([0.8, 1.0, 1.0, 1.0, 0.9])  # ISO 11654:1997, 250 Hz to 4 kHz


def rated_bands(bands: Bands) -> list[int]:
    """Return the indices of the octaves from 250 Hz to 4 kHz; none where one is missing."""
    at = np.flatnonzero((bands.centres_hz >= 250.0) & (bands.centres_hz <= 4000.0)).tolist()
    return at if bands.kind == "octave" and len(at) == _REFERENCE.size else []


def _to_step(values: FloatArray | float) -> FloatArray:
    return np.minimum(np.floor(20.0 * np.asarray(values) + 0.5) / 20.0, 1.0)


def weighted_absorption(octaves: FloatArray) -> tuple[float, str]:
    """Return the weighted sound absorption coefficient of ISO 11654:1997 and its shape indicators.

    `octaves`, shape (5,): absorption at 250 Hz to 4 kHz, 0 to 1; nan gives nan. The reference curve
    is shifted in steps of .05 until no more than .10 of the practical coefficients lies below it.

    Examples
    --------
    >>> weighted_absorption(np.array([0.35, 0.7, 0.65, 0.6, 0.55]))
    (0.6, '')
    >>> weighted_absorption(np.array([0.35, 1.0, 0.65, 0.6, 0.55]))
    (0.6, 'M')
    """
    practical = _to_step(octaves)
    if np.isnan(practical).any():
        return float("nan"), ""
    shifts = np.arange(21) / 20.0
    below = np.maximum(_REFERENCE - shifts[:, None] - practical, 0.0).sum(axis=1)
    shift = shifts[np.flatnonzero(below <= 0.1 + 1e-9)[0]]
    over = practical - (_REFERENCE - shift) > 0.25 - 1e-9
    shapes = {"L": over[:1], "M": over[1:3], "H": over[3:]}
    indicators = "".join(letter for letter, own in shapes.items() if own.any())
    return round(float(1.0 - shift), 2), indicators


def noise_reduction_coefficient(octaves: FloatArray) -> float:
    """Return the mean of 250 Hz to 2 kHz to the nearest .05, of ASTM C423; `octaves` as above."""
    return round(float(_to_step(float(np.mean(octaves[:4])))), 2)
