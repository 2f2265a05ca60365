"""Decay times over frequency, as reports and predictions show them first: picture and words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.base.typing import BoolArray, FloatArray
from roomfit.report.wording import number

# Of these the mean is the single number of a decay time (ISO 3382-1:2009, table A.1).
MID_HZ = (500.0, 1000.0)


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """One decay time in every band, all of shape (n_bands,), NaN where unknown."""

    label: str
    values_s: FloatArray
    lower95_s: FloatArray | None = None  # None: without an interval
    upper95_s: FloatArray | None = None

    def mid_s(self, centres_hz: FloatArray) -> tuple[float, float, float]:
        """Return the mean at mid frequencies, and its bounds, NaN where a band of it has none."""
        own = _mid_bands(centres_hz, self.values_s)
        bounds = (self.lower95_s, self.upper95_s)
        low, high = (np.nan if b is None or not own.any() else float(b[own].mean()) for b in bounds)
        return mid_mean(centres_hz, self.values_s), low, high


@dataclass(frozen=True, slots=True, eq=False)
class Limit:
    """A limit of a decay time in some bands."""

    bands_hz: tuple[float, ...]
    low_s: float = -np.inf
    high_s: float = np.inf


def mid_mean(centres_hz: FloatArray, values: FloatArray) -> float:
    """Return the mean at 500 and 1000 Hz; of the nearest band where neither is known.

    Examples
    --------
    >>> mid_mean(np.array([250.0, 500.0, 1000.0]), np.array([0.9, 0.5, 0.7]))
    0.6
    """
    own = _mid_bands(centres_hz, values)
    return float(values[own].mean()) if own.any() else float("nan")


def _mid_bands(centres_hz: FloatArray, values: FloatArray) -> BoolArray:
    """Return which bands `mid_mean` is of, shape (n_bands,); none where no value is known."""
    known = np.isfinite(values)
    own = known & np.isin(centres_hz, MID_HZ)
    if own.any() or not known.any():
        return own
    distance = np.where(known, np.abs(np.log(centres_hz / 700.0)), np.inf)
    return np.asarray(np.arange(len(values)) == np.argmin(distance))


def mid_words(centres_hz: FloatArray) -> str:
    """Return which bands `mid_mean` is of: "mid frequencies", or the nearest one."""
    if np.isin(centres_hz, MID_HZ).any():
        return "mid frequencies"
    return f"{centres_hz[int(np.argmin(np.abs(np.log(centres_hz / 700.0))))]:g} Hz"


def with_interval(value: float, low: float, high: float, unit: str = " s") -> str:
    """Return a decay time with its interval, as in "0.50 s (0.41 to 0.58)"."""
    if not np.isfinite([low, high]).all():
        return f"{number(value, 2)}{unit}"
    return f"{number(value, 2)}{unit} ({number(low, 2)} to {number(high, 2)})"
