"""Absorption over frequency, one panel a material."""

from __future__ import annotations

import numpy as np

from roomfit.report.html.absorption_tables import given
from roomfit.report.html.plots import (
    ACCENT,
    INK,
    MANY_PANELS,
    Figure,
    Plot,
    frequency_axis,
    label,
    outer_titles,
    panel_axes,
    panel_layout,
    panel_title,
    rounded,
)
from roomfit.report.html.wording import count, hertz, number
from roomfit.typing import BoolArray, FloatArray
from roomfit.uncertainty.answer import Answer

_LEVELS = {"range": [-0.03, 1.03], "tickvals": [0.0, 0.25, 0.5, 0.75, 1.0]}


def absorption_plot(answer: Answer) -> Plot:
    """Return absorption with 95 % bars: filled where identifiable, hollow where not.

    The last panel is the mean of the room by area.
    """
    n = len(answer.materials)
    layout, height_px = panel_layout(n + 1, frequency_axis(answer.bands.centres_hz), _LEVELS)
    layout["annotations"] = [
        *(panel_title(layout, i, _title(answer, i)) for i in range(n)),
        panel_title(layout, n, "<b>mean of the room</b>, by area"),
        *outer_titles("band centre (Hz)", "absorption coefficient"),
    ]
    return Plot(
        "absorption",
        {"data": _traces(answer), "layout": layout},
        height_px,
        f"Absorption coefficient over frequency with 95 % intervals, "
        f"{count(n, 'material')} and the mean of the room; the table below holds every number.",
        "Above each panel: in how many bands the material is identifiable. Points with bars: "
        "absorption and its 95 % interval. Filled: identifiable. Hollow: not "
        "identifiable, the number may come from what was assumed beforehand. Diamonds: given.",
    )


def _title(answer: Answer, material: int) -> str:
    found = int(answer.identifiable[material].sum())
    if len(answer.materials) < MANY_PANELS:
        name = label(answer.materials[material], 20)
        return f"<b>{name}</b>: {found} of {len(answer.bands)} identifiable"
    return f"<b>{label(answer.materials[material], 16)}</b>: {found} of {len(answer.bands)}"


def _traces(answer: Answer) -> list[Figure]:
    held = given(answer)
    kinds = (
        ("identifiable", answer.identifiable & ~held, "circle", ACCENT),
        ("not identifiable", ~answer.identifiable & ~held, "circle", "#ffffff"),
        ("given", held, "diamond", INK),
    )
    traces = []
    for name, chosen, symbol, fill in kinds:
        marker = {
            "symbol": symbol,
            "size": 8,
            "color": fill,
            "line": {"color": INK if fill == INK else ACCENT, "width": 1.8},
        }
        first = True
        for i in np.flatnonzero(chosen.any(axis=1)):
            values = (answer.absorption[i], answer.lower95[i], answer.upper95[i])
            trace = _bars(answer, int(i), name, chosen[i], *values)
            traces.append(trace | {"marker": marker, "legendgroup": name, "showlegend": first})
            first = False
    everywhere = np.ones(len(answer.bands), dtype=np.bool_)
    mean = _bars(
        answer, len(answer.materials), "mean of the room", everywhere, *answer.mean_absorption
    )
    marker = {"symbol": "square", "size": 7, "color": INK, "line": {"color": INK, "width": 1.5}}
    return [*traces, mean | {"marker": marker, "showlegend": False}]


def _bars(
    answer: Answer,
    panel: int,
    name: str,
    chosen: BoolArray,
    value: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
) -> Figure:
    centres, a, low, high = (v[chosen] for v in (answer.bands.centres_hz, value, lower, upper))
    return {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "x": rounded(centres, 1),
        "y": rounded(a, 4),
        "error_y": {
            "type": "data",
            "symmetric": False,
            "array": rounded(np.maximum(high - a, 0.0), 4),
            "arrayminus": rounded(np.maximum(a - low, 0.0), 4),
            "thickness": 1.4,
            "width": 3,
            "color": "#555555",
        },
        "text": [
            f"{hertz(f)}: {number(m, 3)} ({number(b, 3)} to {number(t, 3)}), {name}"
            for f, m, b, t in zip(centres, a, low, high, strict=True)
        ],
        "hoverinfo": "text",
        **panel_axes(panel),
    }
