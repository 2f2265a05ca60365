"""Smoothness over frequency: logit absorption as a random walk from band to band.

Bands that were answered one by one are drawn together as far as walls change slowly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from roomfit.base.bands import Bands
from roomfit.base.errors import InputError
from roomfit.base.logit import Z95, expit, logit
from roomfit.base.typing import FloatArray
from roomfit.materials.priors import MaterialPrior, prior_logit_law
from roomfit.uncertainty.gaussian import BandEstimate, is_identifiable
from roomfit.uncertainty.intervals import LEAST_SIDE
from roomfit.uncertainty.profile import profile_under

# In units of the prior's variance: what is fixed is known this well.
_FIXED_VARIANCE = 1e-12
_STIFFEST = 1.0 - 1e-9


def smooth_over_bands(
    means: FloatArray,
    covariances: FloatArray,
    prior_mean: FloatArray,
    prior_covariance: FloatArray,
    sd_per_octave: float,
    bands: Bands,
) -> tuple[FloatArray, FloatArray]:
    """Combine Gaussian answers of separate bands under a prior that ties the bands together.

    Each band was answered by itself, under a prior of its own. Its data are what it adds
    that prior. A priori, each material's logit absorption now walks from band to band: what it is
    off its prior's mean keeps the prior's standard deviation in every band, and changes over an
    octave by `sd_per_octave`. The result is the posterior of all data and that one prior, which
    thus counts once; six answers under the same guess, put together as they are, would count it six
    times.

    Parameters
    ----------
    means : float array, shape (n_bands, n_materials)
        Logit absorption.
    covariances : float array, shape (n_bands, n_materials, n_materials)
        Symmetric and positive semi-definite. A material of zero variance is fixed; its
        neighbours in frequency are still drawn towards it. No two materials tied to each other.
    prior_mean : float array, shape (n_bands, n_materials)
        Of logit absorption in every band by itself.
    prior_covariance : float array, shape (n_bands, n_materials, n_materials)
        Positive definite. Materials that are correlated have equal variances, and what they share
        walks from band to band as what they do not.
    sd_per_octave : float
        Standard deviation of the step over one octave, above 0. Where the step from one band to the
        next reaches 1.4 prior standard deviations they are independent, and nothing changes.
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
    A Gaussian Markov process over the bands [1]_ (appendix B): in units of the prior's standard
    deviations s the correlation of two neighbours is ``1 - q / (2 s1 s2)`` with the variance q of
    the step, and not below 0. Directions in which an answer is wider than its prior have no
    data.

    References
    ----------
    .. [1] C. E. Rasmussen and C. K. I. Williams, "Gaussian Processes for Machine Learning", MIT
           Press (2006).
    """
    if not sd_per_octave > 0.0:
        raise InputError(
            "the step between bands has no spread",
            found=f"{sd_per_octave:g} per octave",
            needed="above 0, in logit absorption",
            hint="to fit one value for all bands, write a very small number",
        )
    n_bands, n = _checked_shape((means, prior_mean), (covariances, prior_covariance), len(bands))
    prior_sd = np.sqrt(np.diagonal(prior_covariance, axis1=1, axis2=2))
    roots = np.linalg.cholesky(prior_covariance)
    precision = np.zeros((n_bands, n, n_bands, n))
    pull = np.zeros((n_bands, n))
    fixed = np.zeros((n_bands, n), dtype=np.bool_)
    for b in range(n_bands):
        fixed[b] = np.diag(covariances[b]) <= 0.0
        scale = np.linalg.inv(roots[b])
        fixed_variance = np.diag(np.where(fixed[b], _FIXED_VARIANCE, 0.0))
        own = scale @ covariances[b] @ scale.T + fixed_variance
        size, direction = np.linalg.eigh(np.linalg.inv(own))
        is_determined = size > 1.0
        precision[b, :, b, :] = (direction * np.where(is_determined, size - 1.0, 0.0)) @ direction.T
        off = scale @ (means[b] - prior_mean[b])
        pull[b] = (direction * np.where(is_determined, size, 0.0)) @ (direction.T @ off)
    for i in range(n):
        precision[:, i, :, i] += _walk_precision(prior_sd[:, i], sd_per_octave, bands)
    joint = np.linalg.inv(precision.reshape(n_bands * n, n_bands * n))
    off = (joint @ pull.ravel()).reshape(n_bands, n)
    blocks = joint.reshape(n_bands, n, n_bands, n)
    free = ~fixed
    within = np.array(
        [
            roots[b] @ blocks[b, :, b, :] @ roots[b].T * np.outer(free[b], free[b])
            for b in range(n_bands)
        ]
    )
    smoothed = np.where(fixed, means, prior_mean + np.einsum("bij,bj->bi", roots, off))
    return smoothed, 0.5 * (within + np.swapaxes(within, 1, 2))


def _walk_precision(prior_sd: FloatArray, sd_per_octave: float, bands: Bands) -> FloatArray:
    """Return the inverse correlation matrix of one material over the bands, (n_bands, n_bands)."""
    octaves = np.diff(np.log2(bands.exact_centres_hz))
    r = 1.0 - sd_per_octave**2 * octaves / (2.0 * prior_sd[1:] * prior_sd[:-1])
    r = np.clip(r, 0.0, _STIFFEST)
    out = np.eye(prior_sd.size)
    link = 1.0 / (1.0 - r**2)
    here = np.arange(r.size)
    # the density is that of the first band times those of each band given the one below
    out[here, here] += r**2 * link
    out[here + 1, here + 1] += link - 1.0
    out[here, here + 1] = out[here + 1, here] = -r * link
    return out


def _checked_shape(
    vectors: tuple[FloatArray, ...], matrices: tuple[FloatArray, ...], n_bands: int
) -> tuple[int, int]:
    """Return the shape that all vectors have, the covariances' but for their last axis."""
    shapes = {np.shape(v) for v in vectors}
    shape, squares = np.shape(vectors[0]), {np.shape(m) for m in matrices}
    alike = len(shapes) == 1 and len(shape) == 2 and squares == {(*shape, shape[-1])}
    if not alike or shape[0] != n_bands:
        given = ", ".join(map(str, (*sorted(shapes), *sorted(squares))))
        raise InputError(
            "means, covariances, priors and bands do not belong together",
            found=f"shapes {given}, {n_bands} bands",
            needed="(n_bands, n) and (n_bands, n, n)",
        )
    return int(shape[0]), int(shape[1])


def smoothed(
    answers: Sequence[BandEstimate],
    priors: tuple[MaterialPrior, ...],
    bands: Bands,
    sd_per_octave: float,
) -> tuple[BandEstimate, ...]:
    """Return the answers under the assumption that logit absorption changes slowly over frequency.

    Parameters
    ----------
    sd_per_octave : float
        Standard deviation of the step over one octave; intervals are valid only as far as it is
        true.
    """
    names = [k.name for k in priors]
    owner = np.array([names.index(k.tied_to or k.name) for k in priors])
    own, leader = np.unique(owner, return_inverse=True)
    prior_mean, prior = prior_logit_law(priors)
    means, covariances = smooth_over_bands(
        np.stack([a.logit_mean[own] for a in answers]),
        np.stack([a.logit_covariance[np.ix_(own, own)] for a in answers]),
        prior_mean[own].T,
        prior[:, own][:, :, own],
        sd_per_octave,
        bands,
    )
    means, covariances = means[:, leader], covariances[:, leader][:, :, leader]
    return tuple(
        _redrawn(answer, mean, covariance, priors, band)
        for band, (answer, mean, covariance) in enumerate(
            zip(answers, means, covariances, strict=True)
        )
    )


def _redrawn(
    answer: BandEstimate,
    mean: FloatArray,
    covariance: FloatArray,
    priors: tuple[MaterialPrior, ...],
    band: int,
) -> BandEstimate:
    """Return one band's answer with another mean and covariance of logit absorption."""
    low = np.array([k.lower for k in priors])
    width = np.array([k.upper for k in priors]) - low
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    fixed = np.array([k.known is not None for k in priors])

    def physical(free: FloatArray) -> FloatArray:
        return np.asarray(low + width * expit(free))

    ends = _profile_ends(answer, mean, sd, priors)
    absorption = np.where(fixed, answer.absorption, physical(mean))
    lower = np.where(fixed, answer.lower95, physical(ends[0]))
    upper = np.where(fixed, answer.upper95, physical(ends[1]))
    prior_sd = np.sqrt(np.diag(prior_logit_law(priors)[1][band]))
    sure = is_identifiable(answer.chi2_reduced, lower, upper, sd, prior_sd)
    sure &= answer.model != "prior"
    return replace(
        answer,
        absorption=absorption,
        lower95=lower,
        upper95=upper,
        identifiable=sure | fixed,
        # samples are valid without that assumption only
        kinds=tuple("gaussian" if k == "sampled" else k for k in answer.kinds),
        samples=None,
        draws=None,
        logit_mean=mean,
        logit_covariance=covariance,
    )


def _profile_ends(
    answer: BandEstimate,
    mean: FloatArray,
    sd: FloatArray,
    priors: tuple[MaterialPrior, ...],
) -> tuple[FloatArray, FloatArray]:
    """Return the ends of every interval as free numbers: Gaussian, by profiles where there are.

    What the other bands determine of a material is the Gaussian that makes its new mean and spread
    of the old ones; it is put to the profile of the band itself.
    """
    lower, upper = mean - Z95 * sd, mean + Z95 * sd
    names = [k.name for k in priors]
    found = {p.entry: p for p in answer.profiles if not p.gaussian}
    for i, own in enumerate(priors):
        leader = names.index(own.tied_to or own.name)
        before = float(answer.logit_covariance[i, i])
        bent = i < len(answer.kinds) and answer.kinds[i] == "profile" and leader in found
        if not bent or before <= 0.0 or sd[i] <= 0.0:
            continue
        allowed, alone = priors[leader], np.array([answer.lower95[i], answer.upper95[i]])
        free = logit((alone - allowed.lower) / (allowed.upper - allowed.lower), 1e-9)
        at = float(answer.logit_mean[i])
        others = max(1.0 / sd[i] ** 2 - 1.0 / before, 0.0)
        weighed = mean[i] / sd[i] ** 2 - at / before
        ends = profile_under(
            found[leader],
            (at - free[0], free[1] - at),
            weighed / others if others > 0.0 else at,
            others,
        )
        least = LEAST_SIDE * Z95 * sd[i]
        lower[i], upper[i] = min(ends[0], mean[i] - least), max(ends[1], mean[i] + least)
    return lower, upper
