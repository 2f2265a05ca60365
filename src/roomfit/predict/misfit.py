"""What the misfit of fitted pairs adds to the error of predicted ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roomfit.base.typing import BoolArray, FloatArray
from roomfit.model.room_parameters import model_sd
from roomfit.predict.decay import PairNumbers
from roomfit.signals.decay import jnd_of
from roomfit.signals.iso3382 import VALUE_NAMES

# Of the inverse chi-square prior of a variance about what theory expects of it: so many pairs that
# depart as expected stand beside those that were fitted. With one, six pairs widen intervals by a
# tenth where theory is right.
_PRIOR_PAIRS = 1.0
# Departures from their median by more than so many median absolute ones (4 standard deviations of a
# normal law) count as these: a single EDT of a few milliseconds is no scatter of all pairs.
_CLIPPED_AT = 6.0


def with_misfit(
    numbers: tuple[PairNumbers, ...],
    fitted_jnd: FloatArray | None,
    by_pressures: BoolArray | None = None,
) -> tuple[PairNumbers, ...]:
    """Return the numbers of all pairs with the variance that the fitted pairs' departures need.

    Departures of fitted pairs from their own predictions have a mean and a scatter about it. Where
    their squares exceed what is expected, the excess is expected of pairs that were not fitted,
    too: of the scatter in the noise of every pair, of the mean in the error of the model, which all
    pairs share. Pressures know how reflections interfere: what is left of that noise where they
    are added, the scatter of fitted pairs tells as well.

    Shapes: `fitted_jnd` (n_pairs, n_names, n_bands), `by_pressures` (n_bands,).

    Notes
    -----
    With the variance V that is expected of n departures of which k are free, and the sum of their
    squares Q, the variance taken is ``V max(1, (v + Q / V) / (v + k))``, for the scatter about
    pressures also where this is less than V: the mean of its posterior under an inverse chi-square
    prior of v degrees of freedom about V [1]_. V is the mean noise of the predicted pairs for the
    scatter, and its nth part with the error that the model is granted for the mean.

    References
    ----------
    .. [1] A. Gelman et al., Bayesian Data Analysis, 3rd ed. (2013), section 2.6.
    """
    if fitted_jnd is None or not np.isfinite(fitted_jnd).any():
        return numbers
    values = np.array([n.values for n in numbers])
    unit = np.stack([jnd_of(m, values[:, k]) for k, m in enumerate(VALUE_NAMES)], axis=1)
    granted = np.stack([model_sd(m, values[:, k]) for k, m in enumerate(VALUE_NAMES)], axis=1)
    with np.errstate(invalid="ignore"):  # unknown values
        noise = _mean((np.array([n.noise_sd for n in numbers]) / unit) ** 2)
        model = _mean((granted / unit) ** 2)
    n = np.isfinite(fitted_jnd).sum(axis=0)
    departures = _clipped(fitted_jnd)
    middle = _mean(departures)
    squares = np.nansum((departures - middle) ** 2, axis=0)
    least = np.zeros(n.shape[-1]) if by_pressures is None else by_pressures
    scatter = _scale(squares, noise, np.maximum(n - 1, 0), least=np.where(least, 0.0, 1.0))
    common = _scale(middle**2, scatter * noise / np.maximum(n, 1) + model, np.minimum(n, 1))
    # of the mean only what the model is to blame for: noise averages out
    common = 1.0 + (common - 1.0) * (scatter * noise / np.maximum(n, 1) + model) / model
    of_speech = [
        np.mean(x[VALUE_NAMES.index("D50_percent")]).reshape(1, 1) for x in (scatter, common)
    ]
    return tuple(
        replace(
            _widened(own, scatter, common),
            # early against late energy, too, over all octaves
            sti=None if own.sti is None else _widened(own.sti, *of_speech),
        )
        for own in numbers
    )


def _widened(numbers: PairNumbers, scatter: FloatArray, common: FloatArray) -> PairNumbers:
    return replace(
        numbers,
        noise_sd=numbers.noise_sd * np.sqrt(scatter),
        common_noise=numbers.common_noise * np.minimum(scatter, 1.0),
        model_scale=np.sqrt(common),
    )


def _clipped(departures: FloatArray) -> FloatArray:
    """Return departures with outliers drawn to the others, NaN where unknown."""
    nothing = ~np.isfinite(departures).any(axis=0)
    known = np.where(nothing, 0.0, departures)
    median = np.nanmedian(known, axis=0)
    reach = _CLIPPED_AT * np.nanmedian(np.abs(known - median), axis=0)
    return np.clip(departures, median - reach, median + reach)


def _scale(
    squares: FloatArray, expected: FloatArray, n_free: FloatArray, least: FloatArray | float = 1.0
) -> FloatArray:
    """Return by how much a variance exceeds what is expected of it, `least` or larger."""
    ratio = np.divide(squares, expected, out=np.zeros_like(squares), where=expected > 0.0)
    return np.maximum((_PRIOR_PAIRS + ratio) / (_PRIOR_PAIRS + n_free), least)


def _mean(values: FloatArray) -> FloatArray:
    """Return the mean over the first axis of what is known, 0 where nothing is."""
    known = np.isfinite(values)
    return np.asarray(np.where(known, values, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1))
