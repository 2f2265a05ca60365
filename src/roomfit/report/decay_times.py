"""Decay times over frequency, as reports and predictions show them first: picture and words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from roomfit.base.typing import BoolArray, FloatArray
from roomfit.report.figures import OKABE_ITO, figure_legend, literal, new_figure
from roomfit.report.wording import number, short_hertz
from roomfit.signals.decay import jnd_of

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


def decay_time_figure(
    centres_hz: FloatArray,
    series: Sequence[Series],
    symbol: str = "T30",
    limits: Sequence[Limit] = (),
    *,
    narrow: bool = False,
) -> Figure:
    """Return decay times over frequency with their intervals.

    Pale boxes are one just noticeable difference about the first of the series; black lines are
    limits.

    Parameters
    ----------
    centres_hz : float array, shape (n_bands,)
    series : sequence of Series
        Two, or three: marks differ by shape and colour.
    limits : sequence of Limit
    narrow : bool
        For the screen of a telephone.
    """
    figure = new_figure(3.75 if narrow else 7.6, 3.2)
    axes, at = figure.add_subplot(), np.arange(len(centres_hz), dtype=np.float64)
    first = series[0].values_s
    step = jnd_of("T30_s", first)
    # a box a band, wide enough for the marks of all series, which stand side by side
    axes.bar(
        at, 2.0 * step, 0.5, first - step, color=OKABE_ITO[4], alpha=0.3, lw=0.0,
        label="just noticeable difference",
    )  # fmt: skip
    highest = [float(np.nanmax(first, initial=0.0))]
    shift = 0.24 / max(len(series) - 1, 1)
    for i, (one, mark) in enumerate(zip(series, "so^", strict=False)):
        x, colour = at + shift * i - 0.12, OKABE_ITO[i]
        if one.lower95_s is not None and one.upper95_s is not None:
            axes.vlines(x, one.lower95_s, one.upper95_s, color=colour, lw=1.8)
            known = one.upper95_s[np.isfinite(one.upper95_s)]
            highest.append(float(np.quantile(known, 0.75)) if known.size else 0.0)
        axes.plot(
            x, one.values_s, mark, color=colour, ms=5, label=literal(one.label, 60), ls="-", lw=0.8
        )
        highest.append(float(np.nanmax(one.values_s, initial=0.0)))
    label = "target"
    for limit in limits:
        chosen = np.flatnonzero(np.isin(centres_hz, limit.bands_hz))
        for value in (limit.low_s, limit.high_s):
            if np.isfinite(value) and chosen.size:
                axes.hlines(
                    np.full(chosen.size, value), chosen - 0.4, chosen + 0.4, color="black", lw=2.0,
                    label=label,
                )  # fmt: skip
                highest.append(value)
                label = "_"
    heads = [short_hertz(float(f)) for f in centres_hz]
    if len(heads) > 10:
        heads = [h if k % 3 == 0 else "" for k, h in enumerate(heads)]
    axes.set_xticks(at, heads)
    axes.set_xlim(-0.6, len(at) - 0.4)
    axes.set_ylim(0.0, 1.15 * max(highest))
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel(f"{symbol} (s)")
    axes.grid(alpha=0.25, axis="y")
    figure_legend(figure, axes, 2 if narrow else 4)
    return figure
