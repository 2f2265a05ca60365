"""Whether Markov chains have come to rest: how often, how long, how much alike."""

from __future__ import annotations

import numpy as np

from roomfit.checks import float_array
from roomfit.typing import FloatArray


def split_r_hat(chains: FloatArray) -> FloatArray:
    """Return Gelman and Rubin's R-hat of chains cut in halves, for each unknown.

    The root of how much larger the variance over all halves is than the mean variance within one:
    1 where all halves tell the same [1]_.

    Parameters
    ----------
    chains : float array, shape (n_steps, n_chains, n_unknowns)
        4 steps or more.

    Returns
    -------
    float array, shape (n_unknowns,)
        1 where nothing moves and all agree.

    References
    ----------
    .. [1] A. Gelman et al., Bayesian Data Analysis, 3rd ed., 2013, section 11.4.
    """
    told = float_array("chains", chains, (None, None, None))
    half = len(told) // 2
    parts = np.concatenate((told[:half], told[-half:]), axis=1)
    within = parts.var(axis=0, ddof=1).mean(axis=0)
    between = parts.mean(axis=0).var(axis=0, ddof=1)
    pooled = (half - 1) / half * within + between
    return np.asarray(np.sqrt(np.where(within > 0.0, pooled / np.where(within > 0, within, 1), 1)))


def autocorrelation_steps(chains: FloatArray) -> FloatArray:
    """Return the integrated autocorrelation time of each unknown in steps, 1 or more.

    The autocorrelation is averaged over the chains and summed up to the first lag beyond five times
    the sum [1]_.

    Parameters
    ----------
    chains : float array, shape (n_steps, n_chains, n_unknowns)

    Returns
    -------
    float array, shape (n_unknowns,)

    References
    ----------
    .. [1] A. Sokal, "Monte Carlo methods in statistical mechanics", in: Functional Integration,
           1997, section 3; as in emcee.
    """
    told = float_array("chains", chains, (None, None, None))
    n = len(told)
    away = told - told.mean(axis=(0, 1))
    spectrum = np.abs(np.fft.rfft(away, 2 * n, axis=0)) ** 2
    # dividing by n at every lag, as usual, keeps far lags quiet
    correlation = np.fft.irfft(spectrum, axis=0)[:n].mean(axis=1)
    size = correlation[0]
    correlation = np.where(size > 0.0, correlation / np.where(size > 0.0, size, 1.0), 0.0)
    sums = 2.0 * np.cumsum(correlation, axis=0) - 1.0
    enough = np.arange(n)[:, None] >= 5.0 * sums
    last = np.where(enough.any(axis=0), enough.argmax(axis=0), n - 1)
    return np.maximum(sums[last, np.arange(sums.shape[1])], 1.0)
