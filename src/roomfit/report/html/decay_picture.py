"""Measured and predicted energy decay curves: one pair at a time, one panel a band."""

from __future__ import annotations

from typing import Any

import numpy as np

from roomfit.report.html.pair_tables import mean_abs_jnd, pair_title
from roomfit.report.html.plots import (
    INK,
    SECOND,
    Figure,
    Plot,
    outer_titles,
    panel_axes,
    panel_layout,
    panel_title,
    rounded,
)
from roomfit.report.html.wording import count, hertz, number
from roomfit.typing import FloatArray
from roomfit.uncertainty.answer import Answer, ComparedPair, Decay

LOWEST_DB = -45.0
_LEVELS = {"range": [LOWEST_DB, 2.0], "tickvals": [-40, -30, -20, -10, 0]}
# About six characters a number: this keeps all curves of most reports within half a megabyte.
_NUMBERS, _FEWEST, _MOST = 80_000, 24, 120


def decay_of(pair: ComparedPair) -> Decay | None:
    """Return the curves of a pair; None where its values came without a recording."""
    decay: Decay | None = getattr(pair, "decay", None)
    if decay is None or not np.size(decay.time_s):
        return None
    known = np.isfinite(decay.measured_db) | np.isfinite(decay.predicted_db)
    return decay if known.any() else None


def decay_plot(answer: Answer) -> tuple[Plot, list[dict[str, Any]]] | None:
    """Return the picture of the pair that fits worst, and the curves of every pair for the page.

    Returns
    -------
    (Plot, list) or None
        Each element of the list holds ``title``, ``time``, ``measured`` and ``predicted`` (one
        list a band) and ``heads`` (words above each panel). The pair that the picture begins
        with has ``chosen`` true. None where no pair has curves.
    """
    drawn = [(pair, decay) for pair in answer.pairs if (decay := decay_of(pair)) is not None]
    if not drawn:
        return None
    n_points = int(np.clip(_NUMBERS / (2 * len(drawn) * len(answer.bands)), _FEWEST, _MOST))
    curves = [_curves(answer, pair, decay, n_points) for pair, decay in drawn]
    off = np.nan_to_num([mean_abs_jnd(pair) for pair, _ in drawn], nan=-1.0)
    worst = int(np.argmax(off))
    for i, curve in enumerate(curves):
        curve["chosen"] = i == worst
    return _plot(answer, curves[worst], len(drawn)), curves


def _plot(answer: Answer, curve: dict[str, Any], n_pairs: int) -> Plot:
    n = len(answer.bands)
    layout, height_px = panel_layout(n, {"rangemode": "tozero"}, _LEVELS)
    layout["annotations"] = [
        *(panel_title(layout, j, head) for j, head in enumerate(curve["heads"])),
        *outer_titles("time after emission (s)", "energy decay curve (dB)"),
    ]
    return Plot(
        "decay",
        {"data": _traces(curve, n), "layout": layout},
        height_px,
        f"Measured and predicted energy decay curves of {count(n_pairs, 'pair')}, one panel a "
        "band; the tables below hold the parameters derived from them.",
        "Energy left in the room relative to the whole, after each time; above each panel T20, "
        "measured → predicted. The picture begins with the pair whose parameters are furthest off.",
    )


def _traces(curve: dict[str, Any], n_bands: int) -> list[Figure]:
    looks = (
        ("measured", {"color": INK, "width": 2.0}),
        ("predicted", {"color": SECOND, "width": 2.2, "dash": "dash"}),
    )
    return [
        {
            "type": "scatter",
            "mode": "lines",
            "name": name,
            "legendgroup": name,
            "showlegend": j == 0,
            "x": curve["time"],
            "y": curve[name][j],
            "line": line,
            "hovertemplate": "%{y:.1f} dB at %{x:.3f} s",
            **panel_axes(j),
        }
        for j in range(n_bands)
        for name, line in looks
    ]


def _curves(answer: Answer, pair: ComparedPair, decay: Decay, n_points: int) -> dict[str, Any]:
    time_s = np.asarray(decay.time_s)
    either = np.fmax(decay.measured_db, decay.predicted_db).max(axis=0, initial=LOWEST_DB - 1.0)
    shown = np.flatnonzero(np.fmax(either, LOWEST_DB - 1.0) > LOWEST_DB)
    last = int(shown[-1]) + 1 if shown.size else len(time_s)
    kept = np.unique(np.linspace(0, max(last - 1, 0), n_points).round().astype(int))
    return {
        "title": pair_title(pair),
        "time": rounded(time_s[kept], 4),
        "measured": [rounded(_seen(row[kept]), 1) for row in decay.measured_db],
        "predicted": [rounded(_seen(row[kept]), 1) for row in decay.predicted_db],
        "heads": [_head(answer, pair, j) for j in range(len(answer.bands))],
    }


def _seen(levels_db: FloatArray) -> FloatArray:
    """Return the levels down to where the picture ends."""
    return np.where(levels_db > LOWEST_DB - 15.0, levels_db, np.nan)


def _head(answer: Answer, pair: ComparedPair, band: int) -> str:
    head = f"<b>{hertz(float(answer.bands.centres_hz[band]))}</b>"
    t20 = pair.parameters.get("T20_s")
    if t20 is None or not np.isfinite(t20.measured[band]) or not np.isfinite(t20.predicted[band]):
        return head
    measured, predicted = number(t20.measured[band], 2), number(t20.predicted[band], 2)
    return f"{head}: T20 {measured} → {predicted} s"
