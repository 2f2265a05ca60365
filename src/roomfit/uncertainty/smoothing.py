"""Neighbouring bands know of each other: absorption changes gradually with frequency."""

from __future__ import annotations

import numpy as np

from roomfit.bands import Bands
from roomfit.errors import InputError
from roomfit.typing import FloatArray


def smooth_over_bands(
    means: FloatArray, covariances: FloatArray, sd_per_octave: float, bands: Bands
) -> tuple[FloatArray, FloatArray]:
    """Combine Gaussian answers of separate bands with a random walk over the bands.

    Each band was answered by itself: logit absorption of all materials with a joint covariance.
    Beforehand, each material's logit absorption takes independent Gaussian steps from band to
    band, whose variance grows with their width in octaves. The result is the exact posterior of
    the two together: no band is counted twice, for the walk says nothing of the level.

    Parameters
    ----------
    means : float array, shape (n_bands, n_materials)
        Logit absorption.
    covariances : float array, shape (n_bands, n_materials, n_materials)
        Symmetric and positive semi-definite. A material of zero variance is held where it is; its
        neighbours in frequency are still drawn towards it.
    sd_per_octave : float
        Standard deviation of the step over one octave, above 0; infinity changes nothing.
    bands : Bands
        Of length n_bands; their distances are those of their exact centres.

    Returns
    -------
    means : float array, shape (n_bands, n_materials)
    covariances : float array, shape (n_bands, n_materials, n_materials)
        The part within each band of the joint posterior covariance.

    Raises
    ------
    InputError
        `sd_per_octave` is not above 0, or the shapes do not belong together.

    Notes
    -----
    With the differences ``d = A x`` seen as zero with variance ``Q``, the posterior of ``x`` from
    ``N(m, C)`` is ``m - K A m`` and ``C - K A C`` with ``K = C A' (A C A' + Q)^-1`` (conditioning
    of a Gaussian [1]_, eq. A.6). This form inverts no covariance, so held materials are no
    exception.

    References
    ----------
    .. [1] C. E. Rasmussen and C. K. I. Williams, "Gaussian Processes for Machine Learning", MIT
           Press (2006).
    """
    n_bands, n = _checked_shape(means, covariances, sd_per_octave, bands)
    if n_bands < 2 or np.isinf(sd_per_octave):
        return np.array(means), np.array(covariances)
    octaves = np.diff(np.log2(bands.exact_centres_hz))
    steps = np.eye(n_bands, k=1)[:-1] - np.eye(n_bands)[:-1]
    A = np.kron(steps, np.eye(n))
    C = np.zeros((n_bands * n, n_bands * n))
    for b in range(n_bands):
        C[b * n : (b + 1) * n, b * n : (b + 1) * n] = covariances[b]
    AC = A @ C
    Q = np.diag(np.repeat(sd_per_octave**2 * octaves, n))
    K = np.linalg.solve(AC @ A.T + Q, AC).T
    m = np.asarray(means, dtype=np.float64).ravel()
    smoothed = m - K @ (A @ m)
    joint = C - K @ AC
    within = np.array([joint[b * n : (b + 1) * n, b * n : (b + 1) * n] for b in range(n_bands)])
    return smoothed.reshape(n_bands, n), 0.5 * (within + np.swapaxes(within, 1, 2))


def _checked_shape(
    means: FloatArray, covariances: FloatArray, sd_per_octave: float, bands: Bands
) -> tuple[int, int]:
    if not sd_per_octave > 0.0:
        raise InputError(
            "the step between bands has no spread",
            found=f"{sd_per_octave:g} per octave",
            needed="above 0, in logit absorption",
            hint="to fit one value for all bands, write a very small number",
        )
    shape, needed = np.shape(means), np.shape(covariances)
    if len(shape) != 2 or shape[0] != len(bands) or needed != (*shape, shape[-1]):
        raise InputError(
            "means, covariances and bands do not belong together",
            found=f"shapes {shape} and {needed}, {len(bands)} bands",
            needed="(n_bands, n) and (n_bands, n, n)",
        )
    return int(shape[0]), int(shape[1])
