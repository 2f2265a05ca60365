"""Bands that were answered one by one, drawn together as far as walls change slowly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from roomfit.app.fitting import BandAnswer
from roomfit.bands import Bands
from roomfit.materials.knowledge import MaterialKnowledge
from roomfit.typing import FloatArray
from roomfit.uncertainty.gaussian import LARGEST_PHI, WIDEST_IDENTIFIABLE
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
        Standard deviation of the step over one octave; below about 0.5 the belief outweighs most
        data, and intervals hold only as far as it is true.
    areas_m2 : float array, shape (n_materials,)
    """
    means, covariances = smooth_over_bands(
        np.stack([a.logit_mean for a in answers]),
        np.stack([a.logit_covariance for a in answers]),
        sd_per_octave,
        bands,
    )
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

    absorption = np.where(held, answer.absorption, physical(mean))
    lower = np.where(held, answer.lower95, physical(mean - _Z95 * sd))
    upper = np.where(held, answer.upper95, physical(mean + _Z95 * sd))
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
        # what was profiled or sampled holds without that belief only
        kinds=tuple("gaussian" if k in ("profile", "sampled") else k for k in answer.kinds),
        samples=None,
        logit_mean=mean,
        logit_covariance=covariance,
        mean=(whole, max(whole - _Z95 * mean_sd, 0.0), min(whole + _Z95 * mean_sd, 1.0)),
    )
