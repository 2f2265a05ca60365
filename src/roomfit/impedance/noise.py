"""The noise of a measurement that does not tell it, by what a fit leaves."""

from __future__ import annotations

import math

import numpy as np

from roomfit.impedance.fit import ImpedanceFit
from roomfit.typing import BoolArray, FloatArray

# Frequencies that are taken together differ by less in their logarithm, and tell at least so many
# residuals.
_NEAR = 0.2
_LEAST = 24
# Medians over means of squares of normal numbers: of complex ones, and of real ones.
_COMPLEX_MEDIAN, _REAL_MEDIAN = math.log(2.0), 0.4549364
# Of the error that is allowed to the model: no noise is less.
_FLOOR = 1e-3


def estimated_noise(fit: ImpedanceFit) -> FloatArray:
    """Return the rms noise of every pair and frequency, by the residual of a fit without noise.

    A smooth function of frequency, the same for all pairs: medians of the squared residuals over
    neighbours in frequency and over pairs, so that a few bad pairs or frequencies do not count,
    averaged once more; half of the error that is allowed to the model itself is taken off.

    Returns
    -------
    float array, shape (n_pairs, n_frequencies)
        In the unit of the pressure.
    """
    problem = fit.problem
    n_pairs, n_f = problem.sd.shape
    # each row has the variance of one, of real and imaginary part or of the level
    square = np.reshape(fit.residual**2, (-1, n_pairs, n_f)).mean(axis=0) * problem.sd**2
    free = max(1.0 - fit.effective / len(fit.residual), 1e-2)
    near = _neighbours(problem.observed.frequency_hz, n_pairs)
    usual = _COMPLEX_MEDIAN if problem.observed.has_phase else _REAL_MEDIAN
    middle = np.array([np.median(square[:, own]) for own in near]) / (usual * free)
    smooth = (near @ middle) / near.sum(axis=1)
    allowed = np.mean(problem.sd**2, axis=0)
    noise = np.sqrt(np.maximum(smooth - 0.5 * allowed, _FLOOR * allowed))
    return np.tile(noise, (n_pairs, 1))


def _neighbours(frequency_hz: FloatArray, n_pairs: int) -> BoolArray:
    """Return which frequencies are taken together with each, (n_frequencies, n_frequencies)."""
    apart = np.abs(np.log(frequency_hz[:, None] / frequency_hz))
    least = min(math.ceil(_LEAST / n_pairs), len(frequency_hz))
    enough = np.sort(apart, axis=1)[:, least - 1]
    return np.asarray(apart <= np.maximum(enough, _NEAR)[:, None])
