"""What is left of a path's energy, defined once."""

from __future__ import annotations

import numpy as np

from roomfit.base.typing import FloatArray, IntArray


def surviving_energy(hits: IntArray, coefficients: FloatArray) -> FloatArray:
    """Return the fraction of each path's energy left after all its wall hits.

    The readable form of what the compiled kernels of `roomfit.model` do; they are tested
    against it. Air and spherical spreading are separate factors.

    Parameters
    ----------
    hits : int array, shape (n_paths, n_materials)
        How often each path strikes each material.
    coefficients : float array, shape (n_materials, n_bands)
        Energy absorption, 0 to 1.

    Returns
    -------
    float array, shape (n_paths, n_bands)
        Dimensionless, 0 to 1: ``(1 - a) ** hits`` multiplied over materials [1]_.

    References
    ----------
    .. [1] C. F. Eyring, "Reverberation time in 'dead' rooms", J. Acoust. Soc. Am. 1,
           217-241 (1930).

    Examples
    --------
    Two hits on a wall that swallows half leave a quarter.

    >>> surviving_energy(np.array([[2]]), np.array([[0.5]]))
    array([[0.25]])
    """
    # a = 1 leaves nothing after one hit and everything after none: 0 ** 0 is 1 here
    return np.asarray(np.prod((1.0 - coefficients) ** hits[:, :, None], axis=1))
