"""A calibration in a picture: what intervals of every level hold, and those of 95 % by band."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from roomfit.report.pictures import OKABE_ITO, new_figure
from roomfit.uncertainty.calibration import (
    Calibration,
    CalibrationRow,
    Share,
    calibration_rows,
    coverage_at,
)

_NOMINAL = np.concatenate((np.linspace(0.05, 0.95, 19), [0.98, 0.99]))


def calibration_figure(found: Calibration) -> Figure:
    """Return coverage over nominal level, and coverage and false certainty of every band."""
    figure = new_figure(9.6, 4.8)
    left, right = figure.subplots(1, 2)
    _levels(left, coverage_at(found, _NOMINAL))
    _bands(right, calibration_rows(found)[:-1])
    n = len(found.true)
    figure.suptitle(f"{n} replicate{'' if n == 1 else 's'} with a known truth", fontsize=10)
    return figure


def _levels(axes: Axes, shares: tuple[Share, ...]) -> None:
    percent = 100.0 * _NOMINAL
    axes.plot([0, 100], [0, 100], color="black", lw=1.0, ls="--", label="as promised")
    if shares[0].of:
        low, high = (100.0 * np.array([getattr(s, n) for s in shares]) for n in ("low", "high"))
        axes.fill_between(
            *(percent, low, high), color=OKABE_ITO[0], alpha=0.25, lw=0.0, label="range of chance"
        )
        values = [100.0 * s.value for s in shares]
        axes.plot(percent, values, "o-", color=OKABE_ITO[0], ms=3.5, lw=1.4, label="found")
    axes.set_xlabel("level of the interval (%)")
    axes.set_ylabel("intervals that hold the truth (%)")
    axes.set_xlim(0, 100)
    axes.set_ylim(0, 101)
    axes.grid(alpha=0.25)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False, fontsize=8.5)


def _bands(axes: Axes, rows: tuple[CalibrationRow, ...]) -> None:
    places = np.arange(len(rows))
    axes.axhspan(90, 98, color="0.9", lw=0.0, zorder=0)
    axes.axhspan(0, 5, color="0.9", lw=0.0, zorder=0, label="aimed at")
    marks = (
        ([r.holds for r in rows], "o", OKABE_ITO[0], -0.08, "95 % intervals that hold"),
        ([r.wrong for r in rows], "s", OKABE_ITO[1], 0.08, "identifiable but outside"),
    )
    for shares, mark, colour, shift, label in marks:
        known = [i for i, s in enumerate(shares) if s.of]
        value = np.array([100.0 * shares[i].value for i in known])
        low, high = (
            np.array([100.0 * getattr(shares[i], n) for i in known]) for n in ("low", "high")
        )
        axes.errorbar(
            places[known] + shift,
            value,
            yerr=np.abs(np.array([value - low, high - value])),
            fmt=mark,
            color=colour,
            ms=5,
            capsize=2.5,
            lw=1.2,
            label=label,
        )
    axes.set_xticks(places, [f"{r.band_hz:g}" for r in rows])
    if len(rows) > 10:
        axes.tick_params(axis="x", labelrotation=90)
    axes.set_xlabel("band (Hz)")
    axes.set_ylabel("share of values (%)")
    axes.set_xlim(-0.5, len(rows) - 0.5)
    axes.set_ylim(-2, 102)
    axes.grid(alpha=0.25, axis="y")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False, fontsize=8.5)
