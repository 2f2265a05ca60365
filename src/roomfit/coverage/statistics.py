"""Coverage of intervals, with its own confidence interval."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import betaincinv, ndtri

from roomfit.base.bands import Bands
from roomfit.base.logit import Z95, logit
from roomfit.base.typing import BoolArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class CoverageSample:
    """Answers to campaigns whose absorption is known."""

    materials: tuple[str, ...]
    bands: Bands
    true: FloatArray  # absorption, (n_replicates, n_materials, n_bands), as the next five
    absorption: FloatArray
    lower95: FloatArray
    upper95: FloatArray
    identifiable: BoolArray
    has_interval: BoolArray  # not where an absorption was fixed, tied to another or not fitted
    prior: FloatArray  # (n_materials, n_bands), its middle absorption: a baseline
    # (n_replicates, n_bands), Eyring's absorption of the measured decay: another baseline
    uniform: FloatArray
    chi2_reduced: FloatArray  # (n_replicates, n_bands)


@dataclass(frozen=True, slots=True)
class Proportion:
    """A proportion with its own 95 % interval."""

    count: int
    of: int
    low: float  # 0 where there is nothing to count
    high: float  # 1 where there is nothing to count

    @property
    def value(self) -> float:
        """The proportion itself, NaN where there is nothing to count."""
        return self.count / self.of if self.of else float("nan")


@dataclass(frozen=True, slots=True)
class CoverageRow:
    """One band, or all of them; medians are NaN where there is nothing to count."""

    band_hz: float | None  # None for all bands together
    holds: Proportion  # 95 % intervals that hold the true value
    identifiable: Proportion  # values called identifiable
    outside: Proportion  # of these, those whose interval does not hold the true value
    width: float  # median width of the interval
    error: float  # median |error| of the answer, and then of the two baselines
    error_prior: float
    error_uniform: float


def coverage_rows(found: CoverageSample) -> tuple[CoverageRow, ...]:
    """Return the table of an estimate of coverage: each band, then all of them."""
    rows = [_row(found, slice(j, j + 1), float(f)) for j, f in enumerate(found.bands.centres_hz)]
    return (*rows, _row(found, slice(None), None))


def _row(found: CoverageSample, chosen: slice, band_hz: float | None) -> CoverageRow:
    true, value, low, high, sure, has_interval = (
        getattr(found, name)[:, :, chosen]
        for name in ("true", "absorption", "lower95", "upper95", "identifiable", "has_interval")
    )
    covered = (low <= true) & (true <= high)
    prior = np.abs(found.prior[None, :, chosen] - true)
    uniform = np.abs(found.uniform[:, None, chosen] - true)
    return CoverageRow(
        band_hz,
        grouped_proportion(covered, has_interval),
        grouped_proportion(sure, has_interval),
        grouped_proportion(~covered, has_interval & sure),
        _median(high - low, has_interval),
        _median(np.abs(value - true), has_interval),
        _median(prior, has_interval),
        _median(uniform, has_interval),
    )


def _median(values: FloatArray, counted: BoolArray) -> float:
    return float(np.median(values[counted])) if counted.any() else float("nan")


def grouped_proportion(hit: BoolArray, counted: BoolArray) -> Proportion:
    """Return a proportion of values that come in groups, with its 95 % interval.

    Values of one replicate are correlated, so that they count less than as many independent ones.
    The interval is that of [1]_ for the effective number: the number over the design effect,
    the variance of a group's sum over what independent values would have [2]_, never below one.

    `hit`, `counted` have the shape (n_groups, ...).

    References
    ----------
    .. [1] C. J. Clopper, E. S. Pearson, "The use of confidence or fiducial limits illustrated in
           the case of the binomial", Biometrika 26, 404-413 (1934).
    .. [2] J. N. K. Rao, A. J. Scott, "A simple method for the analysis of clustered binary data",
           Biometrics 48, 577-585 (1992).

    Examples
    --------
    Ten of ten leave room for a proportion of 0.69.

    >>> share = grouped_proportion(np.ones((10, 1), bool), np.ones((10, 1), bool))
    >>> round(share.low, 2), share.high
    (0.69, 1.0)
    """
    groups = len(counted)
    sizes = counted.reshape(groups, -1).sum(axis=1)
    hits = (hit & counted).reshape(groups, -1).sum(axis=1)
    n, k = int(sizes.sum()), int(hits.sum())
    if n == 0:
        return Proportion(0, 0, 0.0, 1.0)
    p = k / n
    effect = 1.0
    if groups > 1 and 0 < k < n:
        spread = groups / (groups - 1) * float(np.sum((hits - p * sizes) ** 2)) / n**2
        effect = max(spread / (p * (1.0 - p) / n), 1.0)
    effective, count = n / effect, k / effect
    low = float(betaincinv(count, effective - count + 1.0, 0.025)) if k > 0 else 0.0
    high = float(betaincinv(count + 1.0, effective - count, 0.975)) if k < n else 1.0
    return Proportion(k, n, low, high)


def scaled_errors(found: CoverageSample) -> FloatArray:
    """Return errors in standard deviations of logit absorption, as the intervals have them.

    Each by the side of the interval on which the true value lies, so that one within +-1.96 lies
    in its 95 % interval; standard normal where intervals are right.

    The result has the shape (n_intervals,).
    """
    middle, true = logit(found.absorption), logit(found.true)
    up, down = logit(found.upper95) - middle, middle - logit(found.lower95)
    side = np.where(true > middle, up, down)
    z = Z95 * (true - middle) / np.maximum(side, 1e-12)
    return np.asarray(z[found.has_interval])


def coverage_at(found: CoverageSample, nominal: FloatArray) -> tuple[Proportion, ...]:
    """Return how many intervals of other levels hold the true value, stretched from the 95 % ones.

    `nominal`: above 0 and below 1.
    """
    reach = ndtri(0.5 + 0.5 * nominal)
    z = np.full(found.has_interval.shape, np.inf)
    z[found.has_interval] = np.abs(scaled_errors(found))
    return tuple(grouped_proportion(z <= r, found.has_interval) for r in reach)
