"""What all interactive pictures of the report share: panels, axes, colours and JSON for the page.

A figure is the plain dictionary that plotly.js takes, so that making a report needs no plotting
library but the script that it embeds.
"""

from __future__ import annotations

import html
import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from roomfit.report.html.wording import hertz, shortened
from roomfit.typing import FloatArray

Figure = dict[str, Any]

INK, GRID, ACCENT, SECOND = "#222222", "#e3e6ea", "#0072B2", "#D55E00"

# P. Tol, "Colour schemes", SRON/EPS/TN/09-002 (2021), "muted", then Okabe and Ito (2008): told
# apart with every kind of colour vision; from the 17th material on they begin anew
COLOURS = (
    *("#88CCEE", "#CC6677", "#DDCC77", "#117733", "#332288", "#AA4499", "#44AA99", "#999933"),
    *("#882255", "#E69F00", "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#666666", "#BBBBBB"),
)
_FONT = "system-ui, 'Segoe UI', Helvetica, Arial, 'DejaVu Sans', sans-serif"
_GAP_X, _GAP_PX = 0.05, 52.0
_AXIS = {"gridcolor": GRID, "linecolor": "#888888", "zeroline": False, "ticks": "outside"}
MANY_PANELS = 12
"""More than so many panels are drawn smaller, with shorter words above them."""


@dataclass(frozen=True, slots=True)
class Plot:
    """A picture of the page: its name there, what plotly draws, height, and what it shows."""

    name: str
    figure: Figure
    height_px: int
    alt: str
    caption: str


def material_colour(index: int) -> str:
    """Return the colour of a material."""
    return COLOURS[index % len(COLOURS)]


def base_layout(height_px: int) -> Figure:
    """Return the layout that every picture begins with: white, quiet, as wide as the page."""
    return {
        "height": height_px,
        "autosize": True,
        "margin": {"l": 56, "r": 12, "t": 34, "b": 64},
        "paper_bgcolor": "#ffffff",
        "plot_bgcolor": "#ffffff",
        "font": {"family": _FONT, "size": 12, "color": INK},
        "hoverlabel": {"font": {"family": _FONT, "size": 12}},
        "legend": {"orientation": "h", "x": 0.0, "y": 1.0, "yanchor": "bottom"},
    }


def panel_layout(n: int, x_axis: Figure, y_axis: Figure) -> tuple[Figure, int]:
    """Return a layout with n panels in rows that share their scales, and its height in pixels.

    Axes are called x, x2, ... and y, y2, ... in reading order. More than twelve panels are drawn
    smaller, so that two dozen still fit on a sheet of A4.
    """
    columns, panel_px = (min(n, 3), 150) if n <= MANY_PANELS else (4, 115)
    rows = -(-n // columns)
    inner_px = rows * panel_px + (rows - 1) * _GAP_PX
    above_px, below_px = 74, 58
    height_px = int(inner_px + above_px + below_px)
    layout = base_layout(height_px)
    layout["margin"] |= {"t": above_px, "b": below_px}
    layout["legend"] |= {"y": 1.0 + 28.0 / inner_px}
    width = (1.0 - _GAP_X * (columns - 1)) / columns
    for i in range(n):
        row, column = divmod(i, columns)
        left = column * (width + _GAP_X)
        top = 1.0 - row * (panel_px + _GAP_PX) / inner_px
        shared_x, shared_y = ({}, {}) if i == 0 else ({"matches": "x"}, {"matches": "y"})
        domain_x = [left, min(left + width, 1.0)]
        domain_y = [max(top - panel_px / inner_px, 0.0), top]
        layout[f"xaxis{_nth(i)}"] = (
            _AXIS | x_axis | shared_x | {"domain": domain_x, "anchor": f"y{_nth(i)}"}
        )
        layout[f"yaxis{_nth(i)}"] = (
            _AXIS
            | y_axis
            | shared_y
            | {"domain": domain_y, "anchor": f"x{_nth(i)}", "showticklabels": column == 0}
        )
    return layout, height_px


def panel_axes(i: int) -> dict[str, str]:
    """Return the axes of the i-th panel for a trace."""
    return {"xaxis": f"x{_nth(i)}", "yaxis": f"y{_nth(i)}"}


def panel_title(layout: Figure, i: int, text: str) -> Figure:
    """Return the words above the i-th panel."""
    x, y = (layout[f"{axis}axis{_nth(i)}"]["domain"] for axis in "xy")
    return {
        "text": text,
        "xref": "paper",
        "yref": "paper",
        "x": x[0],
        "y": y[1],
        "xanchor": "left",
        "yanchor": "bottom",
        "yshift": 3,
        "showarrow": False,
        "font": {"size": 12},
    }


def outer_titles(below: str, left: str) -> list[Figure]:
    """Return what stands once below and once left of all panels."""
    common = {"xref": "paper", "yref": "paper", "showarrow": False}
    return [
        common | {"text": below, "x": 0.5, "y": 0.0, "yanchor": "top", "yshift": -30},
        common
        | {"text": left, "x": 0.0, "y": 0.5, "xanchor": "right", "xshift": -34, "textangle": -90},
    ]


def frequency_axis(centres_hz: FloatArray) -> Figure:
    """Return a logarithmic axis that names the bands; of more than ten every second octave."""
    named = centres_hz
    if len(centres_hz) > 10:
        named = centres_hz[np.abs(np.log2(centres_hz / 500.0) / 2.0 % 1.0 - 0.5) > 0.475]
    low, high = np.log10(centres_hz[[0, -1]])
    return {
        "type": "log",
        "range": [round(float(low) - 0.12, 4), round(float(high) + 0.12, 4)],
        "tickmode": "array",
        "tickangle": 0,
        "tickvals": [float(f) for f in named],
        "ticktext": [hertz(float(f)).removesuffix(" Hz").replace(" kHz", "k") for f in named],
    }


def label(name: str, longest: int = 34) -> str:
    """Return a name as plotly shows it literally: its markup is taken apart, its length cut."""
    return html.escape(shortened(name, longest), quote=False)


def rounded(values: FloatArray, decimals: int) -> list[float | None]:
    """Return numbers for JSON; None where there is none."""
    return [
        round(float(v), decimals) if np.isfinite(v) else None for v in np.asarray(values).ravel()
    ]


def page_json(value: Any) -> Markup:
    """Return JSON that can stand within a script element.

    Raises
    ------
    ValueError
        A number is not finite; `rounded` makes them null.
    """
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


def _nth(i: int) -> str:
    return "" if i == 0 else str(i + 1)
