"""Intervals of bands that know what a fit of one band by itself cannot know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from roomfit.app.fitting import BandAnswer
from roomfit.typing import FloatArray
from roomfit.uncertainty.gaussian import WIDEST_IDENTIFIABLE

_Z95 = 1.959963984540054
_LEAST = 1e-9
# Where absorption runs smoothly (as a raised cosine over octaves) from one band's centre to the
# next, these shares of the mean over a band belong to the band above and the one below: the
# integral of that weight over the squared magnitude of the octave filter.
ABOVE, BELOW = 0.144, 0.078


def widened_by_neighbours(
    answers: Sequence[BandAnswer | None], areas_m2: FloatArray
) -> tuple[BandAnswer | None, ...]:
    """Return intervals that allow for absorption that changes within a band.

    A fit assumes one absorption throughout a band and finds a mean over it, which belongs in part
    to the neighbours. By how much the mean would differ from the value at the centre if absorption
    ran smoothly between the fitted bands is taken as one more standard deviation. The bands at
    either end lack a neighbour, and take the other's step for it.

    Parameters
    ----------
    answers : sequence of BandAnswer or None, one a band, low to high
    areas_m2 : float array, shape (n_materials,)
    """
    out: list[BandAnswer | None] = []
    for band, answer in enumerate(answers):
        below = answers[band - 1] if band > 0 else None
        above = answers[band + 1] if band + 1 < len(answers) else None
        if answer is None or (below is None and above is None):
            out.append(answer)
            continue
        up = None if above is None else above.absorption - answer.absorption
        down = None if below is None else below.absorption - answer.absorption
        if up is not None and down is not None:
            sd = np.abs(ABOVE * up + BELOW * down)
        else:
            step = up if up is not None else down
            sd = np.hypot(ABOVE, BELOW) * np.abs(np.asarray(step))
        out.append(_widened(answer, np.asarray(sd), areas_m2))
    return tuple(out)


def with_both_intervals(best: BandAnswer, other: BandAnswer) -> BandAnswer:
    """Return an answer whose intervals hold those of another model, too."""
    lower = np.minimum(best.lower95, other.lower95)
    upper = np.maximum(best.upper95, other.upper95)
    mean = (best.mean[0], min(best.mean[1], other.mean[1]), max(best.mean[2], other.mean[2]))
    sure = best.identifiable & other.identifiable & (upper - lower <= WIDEST_IDENTIFIABLE)
    middle = _logit(best.absorption)
    reach = np.maximum(_logit(upper) - middle, middle - _logit(lower)) / _Z95
    sd = np.sqrt(np.diagonal(best.logit_covariance))
    # draws of a prediction must reach as far as the intervals do
    stretch = np.where(sd > 0.0, np.maximum(reach, sd) / np.where(sd > 0.0, sd, 1.0), 1.0)
    return replace(
        best,
        lower95=lower,
        upper95=upper,
        mean=mean,
        samples=None,
        identifiable=sure,
        logit_covariance=best.logit_covariance * np.outer(stretch, stretch),
    )


def _widened(answer: BandAnswer, sd: FloatArray, areas_m2: FloatArray) -> BandAnswer:
    held = answer.upper95 <= answer.lower95
    sd = np.where(held, 0.0, sd)
    a = np.clip(answer.absorption, _LEAST, 1.0 - _LEAST)
    by_logit = sd / (a * (1.0 - a))
    middle = _logit(a)
    lower = middle - np.hypot(middle - _logit(answer.lower95), _Z95 * by_logit)
    upper = middle + np.hypot(_logit(answer.upper95) - middle, _Z95 * by_logit)
    lower95 = np.where(held, answer.lower95, np.minimum(_absorption(lower), answer.lower95))
    upper95 = np.where(held, answer.upper95, np.maximum(_absorption(upper), answer.upper95))
    narrow = (upper95 - lower95 <= WIDEST_IDENTIFIABLE) | held
    mean, low, high = answer.mean
    more = _Z95 * float(np.linalg.norm(areas_m2 / areas_m2.sum() * sd))
    return replace(
        answer,
        lower95=lower95,
        upper95=upper95,
        samples=_scattered(answer, by_logit),
        identifiable=answer.identifiable & narrow,
        logit_covariance=answer.logit_covariance + np.diag(by_logit**2),
        mean=(
            mean,
            max(mean - float(np.hypot(mean - low, more)), 0.0),
            min(mean + float(np.hypot(high - mean, more)), 1.0),
        ),
    )


def _scattered(answer: BandAnswer, by_logit: FloatArray) -> FloatArray | None:
    """Return the samples with as much more scatter as the intervals get, always the same."""
    if answer.samples is None:
        return None
    noise = np.random.default_rng(1).standard_normal(answer.samples.shape)
    moved = _absorption(_logit(answer.samples) + noise * by_logit)
    return np.where(by_logit > 0.0, moved, answer.samples)


def _logit(a: FloatArray) -> FloatArray:
    share = np.clip(a, _LEAST, 1.0 - _LEAST)
    return np.asarray(np.log(share) - np.log1p(-share))


def _absorption(logit: FloatArray) -> FloatArray:
    return np.asarray(1.0 / (1.0 + np.exp(-logit)))
