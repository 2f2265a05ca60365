"""Draws of absorption that stay where the data are, however far the prior lets them go."""

from __future__ import annotations

import numpy as np

from roomfit.typing import FloatArray
from roomfit.uncertainty.posterior import logit

_STEPS = 30
_LONGEST_STEP = 2.0


def draw_along_data(
    absorption: FloatArray,
    covariance_logit: FloatArray,
    prior_logit_mean: FloatArray,
    prior_logit_sd: FloatArray,
    n_draws: int,
    rng: np.random.Generator,
    *,
    looser: FloatArray | float = 1.0,
) -> FloatArray:
    """Return draws of absorption from a fit's answer and covariance, shape (n_draws, n_materials).

    A decay determines sums of ``-log(1 - a)`` very well and their parts hardly. Draws that are
    Gaussian in logit absorption leave such a sum as soon as they go far along it: in rooms of five
    materials, seen by one decay within 3 %, their 95 % intervals of the mean absorption held the
    truth in 30 of 100. Here what the data say is Gaussian in ``-log(1 - a)``, the exponents in
    which a path's energy is linear, and only the prior is Gaussian in the logit: 93 to 96.

    Parameters
    ----------
    absorption : float array, shape (n_materials,)
        The most likely values.
    covariance_logit : float array, shape (n_materials, n_materials)
        Of logit absorption, prior included; positive definite.
    prior_logit_mean, prior_logit_sd : float arrays, shape (n_materials,)
    n_draws : int
    rng : numpy.random.Generator
    looser : float or float array, shape (n_materials,)
        How many times as wide the prior of the draws is as that of the answer: what the data say
        stays as it is.

    Notes
    -----
    Each draw disturbs data and prior by their own noise and finds the most likely values again
    [1]_: exact where the problem is linear, and close to the posterior elsewhere. The data are
    those of a linear problem with the information and the maximum of the given one.

    References
    ----------
    .. [1] J. M. Bardsley, A. Solonen, H. Haario, M. Laine, "Randomize-then-optimize: a method for
           sampling from posterior distributions in nonlinear inverse problems", SIAM J. Sci.
           Comput. 36, A1895-A1910 (2014).
    """
    x, n = logit(absorption), absorption.size
    slope = np.maximum(absorption, 1e-6)  # d(-log(1 - a)) / d(logit a)
    prior = 1.0 / prior_logit_sd**2
    information = (np.linalg.inv(covariance_logit) - np.diag(prior)) / np.outer(slope, slope)
    size, direction = np.linalg.eigh(0.5 * (information + information.T))
    told = size > 1e-9 * max(float(size.max()), 1e-300)
    R = np.sqrt(size[told])[:, None] * direction[:, told].T
    # at the maximum the data pull as much as the prior does
    pull = prior * (x - prior_logit_mean) / slope
    seen = R @ _exponent(x) + np.linalg.lstsq(R.T, pull, rcond=None)[0]
    seen = seen + mirrored_noise(n_draws, seen.size, rng)
    prior_sd = looser * prior_logit_sd
    centres = prior_logit_mean + prior_sd * mirrored_noise(n_draws, n, rng)
    return _absorption(_most_likely(x, R, seen, centres, 1.0 / prior_sd))


def mirrored_noise(n_draws: int, n: int, rng: np.random.Generator) -> FloatArray:
    """Return standard normal numbers, shape (n_draws, n), the second half minus the first.

    Mirrored draws take the linear part of their scatter out of every mean over them.
    """
    half = rng.standard_normal(((n_draws + 1) // 2, n))
    return np.concatenate((half, -half))[:n_draws]


def _most_likely(
    start: FloatArray, R: FloatArray, seen: FloatArray, centres: FloatArray, weight: FloatArray
) -> FloatArray:
    """Minimise ``|R e(x) - seen|^2 + |weight (x - centre)|^2`` for all draws at once.

    By Levenberg and Marquardt, e the exponents of absorption; shape (n_draws, n_materials).
    """
    n_draws, n = centres.shape
    x = np.tile(start, (n_draws, 1))
    damping = np.full(n_draws, 1e-3)
    below = np.broadcast_to(np.diag(weight), (n_draws, n, n))
    diagonal = np.arange(n)

    def residuals(x: FloatArray) -> FloatArray:
        return np.concatenate((_exponent(x) @ R.T - seen, weight * (x - centres)), axis=1)

    r = residuals(x)
    cost = np.sum(r**2, axis=1)
    for _ in range(_STEPS):
        J = np.concatenate((R[None] * _absorption(x)[:, None, :], below), axis=1)
        H = np.swapaxes(J, 1, 2) @ J
        gradient = np.einsum("dij,di->dj", J, r)
        H[:, diagonal, diagonal] *= (1.0 + damping)[:, None]
        step = np.linalg.solve(H, gradient[..., None])[..., 0]
        trial = x - np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)
        r_trial = residuals(trial)
        trial_cost = np.sum(r_trial**2, axis=1)
        better = trial_cost < cost
        x[better], r[better], cost[better] = trial[better], r_trial[better], trial_cost[better]
        damping = np.where(better, 0.2 * damping, 5.0 * damping)
    return x


def _exponent(x: FloatArray) -> FloatArray:
    """Return ``-log(1 - a)`` of absorption given by its logit."""
    return np.asarray(np.logaddexp(0.0, x))


def _absorption(x: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * x)))
