"""How often intervals hold a known truth, and how surely that is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri
from scipy.stats import beta

from roomfit.bands import Bands
from roomfit.typing import BoolArray, FloatArray
from roomfit.uncertainty.posterior import logit

_Z95 = 1.959963984540054  # standard normal, 97.5 %


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Answers to campaigns whose truth is known.

    Attributes
    ----------
    materials : tuple of str
    bands : Bands
    true, absorption, lower95, upper95 : float arrays, shape (n_replicates, n_materials, n_bands)
    identifiable : bool array, shape (n_replicates, n_materials, n_bands)
    told : bool array, shape (n_replicates, n_materials, n_bands)
        Where an interval says anything: not where an absorption was held, tied to another or not
        fitted at all.
    prior : float array, shape (n_materials, n_bands)
        Mean absorption beforehand: a null model.
    uniform : float array, shape (n_replicates, n_bands)
        Eyring's absorption of the measured decay: another.
    phi : float array, shape (n_replicates, n_bands)
    """

    materials: tuple[str, ...]
    bands: Bands
    true: FloatArray
    absorption: FloatArray
    lower95: FloatArray
    upper95: FloatArray
    identifiable: BoolArray
    told: BoolArray
    prior: FloatArray
    uniform: FloatArray
    phi: FloatArray


@dataclass(frozen=True, slots=True)
class Share:
    """A share with its own 95 % interval.

    Attributes
    ----------
    count, of : int
    low, high : float
        0 to 1 where there is nothing to count.
    """

    count: int
    of: int
    low: float
    high: float

    @property
    def value(self) -> float:
        """The share itself, NaN where there is nothing to count."""
        return self.count / self.of if self.of else float("nan")


@dataclass(frozen=True, slots=True)
class CalibrationRow:
    """One band, or all of them.

    Attributes
    ----------
    band_hz : float or None
        None for all bands together.
    holds : Share
        95 % intervals that hold the truth.
    identifiable : Share
        Values called identifiable.
    wrong : Share
        Of these, those whose interval does not hold the truth.
    width, error, error_prior, error_uniform : float
        Medians: width of the interval, |error| of the answer and of the two null models; NaN where
        there is nothing to count.
    """

    band_hz: float | None
    holds: Share
    identifiable: Share
    wrong: Share
    width: float
    error: float
    error_prior: float
    error_uniform: float


def calibration_rows(found: Calibration) -> tuple[CalibrationRow, ...]:
    """Return the table of a calibration: each band, then all of them."""
    rows = [_row(found, slice(j, j + 1), float(f)) for j, f in enumerate(found.bands.centres_hz)]
    return (*rows, _row(found, slice(None), None))


def _row(found: Calibration, chosen: slice, band_hz: float | None) -> CalibrationRow:
    true, value, low, high, sure, told = (
        getattr(found, name)[:, :, chosen]
        for name in ("true", "absorption", "lower95", "upper95", "identifiable", "told")
    )
    held = (low <= true) & (true <= high)
    prior = np.abs(found.prior[None, :, chosen] - true)
    uniform = np.abs(found.uniform[:, None, chosen] - true)
    return CalibrationRow(
        band_hz,
        grouped_share(held, told),
        grouped_share(sure, told),
        grouped_share(~held, told & sure),
        _median(high - low, told),
        _median(np.abs(value - true), told),
        _median(prior, told),
        _median(uniform, told),
    )


def _median(values: FloatArray, told: BoolArray) -> float:
    return float(np.median(values[told])) if told.any() else float("nan")


def grouped_share(hit: BoolArray, counted: BoolArray) -> Share:
    """Return a share of values that come in groups, with its 95 % interval.

    Values of one replicate share its misfortunes, so that they tell less than as many independent
    ones. The interval is that of [1]_ for the effective number: the number over the design effect,
    the variance of a group's sum over what independent values would have [2]_, never below one.

    Parameters
    ----------
    hit, counted : bool arrays, shape (n_groups, ...)

    References
    ----------
    .. [1] C. J. Clopper, E. S. Pearson, "The use of confidence or fiducial limits illustrated in
           the case of the binomial", Biometrika 26, 404-413 (1934).
    .. [2] J. N. K. Rao, A. J. Scott, "A simple method for the analysis of clustered binary data",
           Biometrics 48, 577-585 (1992).

    Examples
    --------
    Ten of ten leave room for a share of 0.69.

    >>> share = grouped_share(np.ones((10, 1), bool), np.ones((10, 1), bool))
    >>> round(share.low, 2), share.high
    (0.69, 1.0)
    """
    groups = len(counted)
    sizes = counted.reshape(groups, -1).sum(axis=1)
    hits = (hit & counted).reshape(groups, -1).sum(axis=1)
    n, k = int(sizes.sum()), int(hits.sum())
    if n == 0:
        return Share(0, 0, 0.0, 1.0)
    p = k / n
    effect = 1.0
    if groups > 1 and 0 < k < n:
        spread = groups / (groups - 1) * float(np.sum((hits - p * sizes) ** 2)) / n**2
        effect = max(spread / (p * (1.0 - p) / n), 1.0)
    effective, count = n / effect, k / effect
    low = float(beta.ppf(0.025, count, effective - count + 1.0)) if k > 0 else 0.0
    high = float(beta.ppf(0.975, count + 1.0, effective - count)) if k < n else 1.0
    return Share(k, n, low, high)


def scaled_errors(found: Calibration) -> FloatArray:
    """Return errors in standard deviations of logit absorption, as the intervals have them.

    Each by the side of the interval on which the truth lies, so that a value within +-1.96 is held
    by its 95 % interval; standard normal where intervals are right.

    Returns
    -------
    float array, shape (n_told,)
    """
    middle, true = logit(found.absorption), logit(found.true)
    up, down = logit(found.upper95) - middle, middle - logit(found.lower95)
    side = np.where(true > middle, up, down)
    z = _Z95 * (true - middle) / np.maximum(side, 1e-12)
    return np.asarray(z[found.told])


def coverage_at(found: Calibration, nominal: FloatArray) -> tuple[Share, ...]:
    """Return how many intervals of other levels hold the truth, stretched from the 95 % ones.

    Parameters
    ----------
    nominal : float array
        Above 0 and below 1.
    """
    reach = ndtri(0.5 + 0.5 * nominal)
    z = np.full(found.told.shape, np.inf)
    z[found.told] = np.abs(scaled_errors(found))
    return tuple(grouped_share(z <= r, found.told) for r in reach)
