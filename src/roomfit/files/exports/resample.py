"""From the bands that were fitted to the bands that another program wants."""

from __future__ import annotations

import numpy as np

from roomfit.bands import Bands
from roomfit.typing import BoolArray, FloatArray


def resample(values: FloatArray, bands: Bands, wanted: Bands) -> tuple[FloatArray, BoolArray]:
    """Return values in other bands, and which of them nobody measured.

    A band that is there is taken as it is; an octave from third octaves is their mean; a third
    octave within the range of the octaves is interpolated linearly in the logarithm of frequency.
    Beyond the lowest and the highest band the nearest value is held, and gaps between bands are
    interpolated: those are the ones that nobody measured.

    Parameters
    ----------
    values : float array, shape (n_materials, n_bands)
    bands, wanted : Bands

    Returns
    -------
    resampled : float array, shape (n_materials, n_wanted)
    filled : bool array, shape (n_wanted,)
        True where no fitted band covers the wanted one.
    """
    at, known = np.log2(wanted.exact_centres_hz), np.log2(bands.exact_centres_hz)
    resampled = np.array([np.interp(at, known, row) for row in values])
    filled = np.ones(len(wanted), dtype=np.bool_)
    for i, (low, high) in enumerate(zip(wanted.lower_hz, wanted.upper_hz, strict=True)):
        inside = (bands.exact_centres_hz > low) & (bands.exact_centres_hz < high)
        if np.any(inside):
            resampled[:, i] = values[:, inside].mean(axis=1)
        centre = wanted.exact_centres_hz[i]
        covering = (bands.lower_hz < centre) & (centre < bands.upper_hz)
        filled[i] = not (np.any(inside) or np.any(covering))
    return resampled, filled
