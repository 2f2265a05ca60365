"""Bands that were answered one by one, drawn together as far as walls change slowly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from roomfit.app.certainty.refining import LEAST_SIDE
from roomfit.app.fitting import BandAnswer
from roomfit.bands import Bands
from roomfit.materials.knowledge import MaterialKnowledge, prior_logits
from roomfit.typing import FloatArray
from roomfit.uncertainty.gaussian import LARGEST_PHI, WIDEST_IDENTIFIABLE
from roomfit.uncertainty.profile_under import profile_under
from roomfit.uncertainty.smoothing import smooth_over_bands

_Z95 = 1.959963984540054


def smoothed(
    answers: Sequence[BandAnswer],
    knowledge: tuple[MaterialKnowledge, ...],
    bands: Bands,
    sd_per_octave: float,
    areas_m2: FloatArray,
) -> tuple[BandAnswer, ...]:
    """Return the answers under the belief that logit absorption walks slowly over frequency.

    Parameters
    ----------
    sd_per_octave : float
        Standard deviation of the step over one octave; intervals hold only as far as it is true.
    areas_m2 : float array, shape (n_materials,)
    """
    names = [k.name for k in knowledge]
    owner = np.array([names.index(k.tied_to or k.name) for k in knowledge])
    own, leader = np.unique(owner, return_inverse=True)
    prior_mean, prior_sd = prior_logits(knowledge)
    means, covariances = smooth_over_bands(
        np.stack([a.logit_mean[own] for a in answers]),
        np.stack([a.logit_covariance[np.ix_(own, own)] for a in answers]),
        prior_mean[own].T,
        prior_sd[own].T,
        sd_per_octave,
        bands,
    )
    means, covariances = means[:, leader], covariances[:, leader][:, :, leader]
    return tuple(
        _redrawn(answer, mean, covariance, knowledge, band, areas_m2)
        for band, (answer, mean, covariance) in enumerate(
            zip(answers, means, covariances, strict=True)
        )
    )


def _redrawn(
    answer: BandAnswer,
    mean: FloatArray,
    covariance: FloatArray,
    knowledge: tuple[MaterialKnowledge, ...],
    band: int,
    areas_m2: FloatArray,
) -> BandAnswer:
    """Return one band's answer with another mean and covariance of logit absorption."""
    low = np.array([k.lower for k in knowledge])
    width = np.array([k.upper for k in knowledge]) - low
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    held = np.array([k.known is not None for k in knowledge])

    def physical(logit: FloatArray) -> FloatArray:
        return np.asarray(low + width / (1.0 + np.exp(-logit)))

    ends = _profile_ends(answer, mean, sd, knowledge)
    absorption = np.where(held, answer.absorption, physical(mean))
    lower = np.where(held, answer.lower95, physical(ends[0]))
    upper = np.where(held, answer.upper95, physical(ends[1]))
    prior_sd = np.array([k.prior_logit_sd[band] for k in knowledge])
    sure = (
        (answer.phi <= LARGEST_PHI)
        & (upper - lower <= WIDEST_IDENTIFIABLE)
        & (sd <= 0.5 * prior_sd)
        & (answer.model != "prior")
    )
    share = areas_m2 / areas_m2.sum()
    gradient = share * (absorption - low) * (low + width - absorption) / width
    mean_sd = float(np.sqrt(max(gradient @ covariance @ gradient, 0.0)))
    whole = float(share @ absorption)
    return replace(
        answer,
        absorption=absorption,
        lower95=lower,
        upper95=upper,
        identifiable=sure | held,
        # what was sampled holds without that belief only
        kinds=tuple("gaussian" if k == "sampled" else k for k in answer.kinds),
        samples=None,
        logit_mean=mean,
        logit_covariance=covariance,
        mean=(whole, max(whole - _Z95 * mean_sd, 0.0), min(whole + _Z95 * mean_sd, 1.0)),
    )


def _profile_ends(
    answer: BandAnswer,
    mean: FloatArray,
    sd: FloatArray,
    knowledge: tuple[MaterialKnowledge, ...],
) -> tuple[FloatArray, FloatArray]:
    """Return the ends of every interval as free numbers: Gaussian, by profiles where there are.

    What the other bands say of a material is the Gaussian that makes its new mean and spread of
    the old ones; it is put to the profile of the band itself.
    """
    lower, upper = mean - _Z95 * sd, mean + _Z95 * sd
    names = [k.name for k in knowledge]
    found = {p.entry: p for p in answer.profiles if not p.gaussian}
    for i, own in enumerate(knowledge):
        leader = names.index(own.tied_to or own.name)
        before = float(answer.logit_covariance[i, i])
        bent = i < len(answer.kinds) and answer.kinds[i] == "profile" and leader in found
        if not bent or before <= 0.0 or sd[i] <= 0.0:
            continue
        free = _free(np.array([answer.lower95[i], answer.upper95[i]]), knowledge[leader])
        at = float(answer.logit_mean[i])
        others = max(1.0 / sd[i] ** 2 - 1.0 / before, 0.0)
        weighed = mean[i] / sd[i] ** 2 - at / before
        ends = profile_under(
            *(found[leader], (at - free[0], free[1] - at)),
            *(weighed / others if others > 0.0 else at, others),
        )
        least = LEAST_SIDE * _Z95 * sd[i]
        lower[i], upper[i] = min(ends[0], mean[i] - least), max(ends[1], mean[i] + least)
    return lower, upper


def _free(absorption: FloatArray, own: MaterialKnowledge) -> FloatArray:
    """Return the free numbers of absorption between a material's bounds."""
    share = np.clip((absorption - own.lower) / (own.upper - own.lower), 1e-9, 1.0 - 1e-9)
    return np.asarray(np.log(share) - np.log1p(-share))
