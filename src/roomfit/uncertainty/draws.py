"""Random draws of absorption as it is known after a fit."""

from __future__ import annotations

import numpy as np

from roomfit.typing import BoolArray, FloatArray, IntArray
from roomfit.uncertainty.posterior import AbsorptionPosterior, logit
from roomfit.uncertainty.straight_draws import draw_along_data, mirrored_noise


def draw_absorption(
    posterior: AbsorptionPosterior, n_draws: int, rng: np.random.Generator
) -> FloatArray:
    """Return draws of absorption, each band by itself.

    Where the posterior tells what was known beforehand they stay where the data are (`band_draws`);
    without, they are Gaussian in logit absorption. Draws come in mirrored pairs.

    Parameters
    ----------
    posterior : AbsorptionPosterior
    n_draws : int
        2 or more; an odd number is raised by one.
    rng : numpy Generator

    Returns
    -------
    float array, shape (n_draws, n_materials, n_bands)
        0 to 1; a held material keeps its absorption exactly.
    """
    n = 2 * ((max(n_draws, 2) + 1) // 2)
    draws = np.empty((n, *posterior.absorption.shape))
    for band, covariance in enumerate(posterior.logit_covariance):
        a = posterior.absorption[:, band]
        if posterior.prior_logit_mean is None or posterior.prior_logit_sd is None:
            draws[:, :, band] = _gaussian_draws(a, covariance, n, rng)
        else:
            mean, sd = posterior.prior_logit_mean[:, band], posterior.prior_logit_sd[:, band]
            draws[:, :, band] = band_draws(a, covariance, mean, sd, n, rng)
    return draws


def band_draws(
    absorption: FloatArray,
    covariance_logit: FloatArray,
    prior_logit_mean: FloatArray,
    prior_logit_sd: FloatArray,
    n_draws: int,
    rng: np.random.Generator,
) -> FloatArray:
    """Return draws of one band that stay where the data are, shape (n_draws, n_materials).

    Parameters
    ----------
    absorption : float array, shape (n_materials,)
    covariance_logit : float array, shape (n_materials, n_materials)
        Positive semi-definite: zeros where absorption is held, equal rows where two materials are
        tied to each other.
    prior_logit_mean, prior_logit_sd : float arrays, shape (n_materials,)
    n_draws : int
    rng : numpy Generator

    See Also
    --------
    roomfit.uncertainty.straight_draws.draw_along_data : what is done for materials that vary.
    """
    held = np.diag(covariance_logit) <= 0.0
    draws = np.tile(absorption, (n_draws, 1))
    own, twin = _own(absorption, covariance_logit, held)
    if own.size:
        drawn = draw_along_data(
            absorption[own],
            covariance_logit[np.ix_(own, own)],
            prior_logit_mean[own],
            prior_logit_sd[own],
            n_draws,
            rng,
        )
        draws[:, ~held] = drawn[:, twin]
    return draws


def prior_draws(
    absorption: FloatArray,
    covariance_logit: FloatArray,
    prior_logit_mean: FloatArray,
    prior_logit_sd: FloatArray,
    n_draws: int,
    rng: np.random.Generator,
) -> FloatArray:
    """Return draws from the prior alone, held and tied as in `band_draws`."""
    held = np.diag(covariance_logit) <= 0.0
    draws = np.tile(absorption, (n_draws, 1))
    own, twin = _own(absorption, covariance_logit, held)
    if own.size:
        noise = mirrored_noise(n_draws, own.size, rng)
        drawn = _share(prior_logit_mean[own] + prior_logit_sd[own] * noise)
        draws[:, ~held] = drawn[:, twin]
    return draws


def _gaussian_draws(
    absorption: FloatArray, covariance: FloatArray, n_draws: int, rng: np.random.Generator
) -> FloatArray:
    size, direction = np.linalg.eigh(covariance)
    step = mirrored_noise(n_draws, size.size, rng) * np.sqrt(np.maximum(size, 0.0))
    share = _share(logit(absorption) + step @ direction.T)
    return np.asarray(np.where(np.diag(covariance) == 0.0, absorption, share))


def _share(x: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * x)))


def _own(
    absorption: FloatArray, covariance: FloatArray, held: BoolArray
) -> tuple[IntArray, IntArray]:
    """Return which materials vary by themselves, and for each that varies which of them it is."""
    varying = np.flatnonzero(~held)
    own: list[int] = []
    twin: list[int] = []
    for i in varying:
        same = [
            k
            for k, j in enumerate(own)
            if absorption[j] == absorption[i] and np.allclose(covariance[j], covariance[i])
        ]
        if not same:
            own.append(int(i))
        twin.append(same[0] if same else len(own) - 1)
    return np.array(own, dtype=np.int64), np.array(twin, dtype=np.int64)
