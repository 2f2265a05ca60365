"""Random draws of absorption as it is known after a fit."""

from __future__ import annotations

import numpy as np

from roomfit.materials.knowledge import is_assumed
from roomfit.typing import BoolArray, FloatArray, IntArray
from roomfit.uncertainty.posterior import AbsorptionPosterior, logit
from roomfit.uncertainty.straight_draws import draw_along_data, mirrored_noise

# A prior that nobody told may as well be so many times as wide.
LOOSER = 2.0


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

    The prior of a wall of which nobody told anything is a guess. In a room with many hard walls it
    pulls them all one way, and then their sum lies farther off than its parts. The draws take such
    a prior for up to twice as wide as the answer did: by as much as the data know of the wall.

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
        mean, sd = prior_logit_mean[own], prior_logit_sd[own]
        answer = (absorption[own], covariance_logit[np.ix_(own, own)], mean, sd)
        # where the data say little a wider prior would let other walls go wherever they like
        told = np.clip(1.0 - np.diag(answer[1]) / sd**2, 0.0, 1.0)
        looser = np.where(is_assumed(mean, sd), 1.0 + (LOOSER - 1.0) * told, 1.0)
        drawn = draw_along_data(*answer, n_draws, rng, looser=looser)
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
