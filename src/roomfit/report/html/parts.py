"""What all interactive pictures of the report share: panels, axes, colours and JSON for the page.

A figure is the plain dictionary that plotly.js takes, so that making a report needs no plotting
library but the script that it embeds.

A table as the template draws it: captions, heads and cells of text, no numbers.

Numbers and names as a reader expects them: sensible digits, units, no NaN.
"""

from __future__ import annotations

import html
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from markupsafe import Markup

from roomfit.typing import BoolArray, FloatArray, IntArray

DASH = "\N{EN DASH}"


@dataclass(frozen=True, slots=True)
class Parameter:
    """How a room-acoustic parameter is written.

    Attributes
    ----------
    symbol, unit : str
    decimals : int
        Of a value in `unit`.
    error_unit : str
        "%" where errors are told relative to the measured value.
    error_decimals : int
    """

    symbol: str
    unit: str
    decimals: int
    error_unit: str
    error_decimals: int


PARAMETERS = {
    "T20_s": Parameter("T20", "s", 2, "%", 1),
    "T30_s": Parameter("T30", "s", 2, "%", 1),
    "EDT_s": Parameter("EDT", "s", 2, "%", 1),
    "C50_dB": Parameter("C50", "dB", 1, "dB", 2),
    "C80_dB": Parameter("C80", "dB", 1, "dB", 2),
    "D50_percent": Parameter("D50", "%", 0, "points", 1),
    "TS_ms": Parameter("TS", "ms", 0, "ms", 1),
    "G_dB": Parameter("G", "dB", 1, "dB", 2),
}
"""In the order in which tables show them; those of ISO 3382-1."""


def number(value: float, decimals: int, *, signed: bool = False) -> str:
    """Return a number with a true minus sign, never "-0.0"; a dash where there is none.

    Examples
    --------
    >>> number(-0.04, 1, signed=True), number(1.25, 2), number(float("nan"), 1)
    ('0.0', '1.25', '–')
    """
    if not np.isfinite(value):
        return DASH
    rounded = round(float(value), decimals) + 0.0
    if rounded == 0.0:
        return f"{0.0:.{decimals}f}"
    return f"{rounded:{'+' if signed else ''}.{decimals}f}".replace("-", "\N{MINUS SIGN}")


def coefficient(value: float, upper: float) -> str:
    """Return an absorption coefficient with two decimals; three where all of it is below 0.1."""
    return number(value, 3 if upper < 0.1 else 2)


def area(value_m2: float) -> str:
    """Return an area or absorption area in m2 with about three digits."""
    return number(value_m2, 2 if abs(value_m2) < 9.995 else 1)


def hertz(frequency_hz: float) -> str:
    """Return a frequency with its unit.

    Examples
    --------
    >>> hertz(125.0), hertz(2000.0), hertz(31.5)
    ('125 Hz', '2 kHz', '31.5 Hz')
    """
    if frequency_hz >= 1000.0:
        return f"{frequency_hz / 1000.0:g} kHz"
    return f"{frequency_hz:g} Hz"


def count(number_of: int, singular: str, plural: str | None = None) -> str:
    """Return a number with its noun.

    Examples
    --------
    >>> count(1, "pair"), count(3, "pair"), count(0, "frequency", "frequencies")
    ('1 pair', '3 pairs', '0 frequencies')
    """
    return f"{number_of} {singular if number_of == 1 else plural or singular + 's'}"


def listing(words: Sequence[str]) -> str:
    """Return words as a sentence lists them.

    Examples
    --------
    >>> listing(["a", "b", "c"])
    'a, b and c'
    """
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} and {words[-1]}"


def band_ranges(centres_hz: FloatArray, chosen: BoolArray) -> str:
    """Return the chosen bands in words; neighbours are joined.

    Examples
    --------
    >>> bands = np.array([125.0, 250.0, 500.0, 1000.0, 2000.0])
    >>> band_ranges(bands, np.array([True, False, True, True, True]))
    '125 Hz and 500 Hz to 2 kHz'
    """
    runs = []
    for wanted, members in groupby(range(len(centres_hz)), key=lambda j: bool(chosen[j])):
        run = list(members)
        if wanted:
            ends = [hertz(float(centres_hz[j])) for j in (run[0], run[-1])]
            runs.append(ends[0] if len(run) == 1 else " to ".join(ends))
    return listing(runs)


def shortened(name: str, longest: int = 34) -> str:
    """Return a name that fits above a panel: the end of a long one is cut."""
    return name if len(name) <= longest else name[: longest - 1] + "…"


def parameter(key: str) -> Parameter:
    """Return how a parameter is written; of an unknown one the key tells symbol and unit."""
    symbol, _, unit = key.partition("_")
    return PARAMETERS.get(key) or Parameter(symbol, unit, 2, unit, 2)


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


BANDS_AT_MOST = 8
"""Columns that fit on a sheet of A4; further bands go into a table below."""


@dataclass(frozen=True, slots=True)
class Cell:
    """Text, smaller lines below it, and the style sheet's name for what it means."""

    text: str
    small: tuple[str, ...] = ()
    style: str = ""


@dataclass(frozen=True, slots=True)
class Row:
    """The head of a row, a colour beside it (CSS, or none), and its cells."""

    head: str
    cells: tuple[Cell, ...]
    small: str = ""
    colour: str = ""
    style: str = ""


@dataclass(frozen=True, slots=True)
class Table:
    """A captioned table; `corner` heads the column of row heads."""

    caption: str
    corner: str
    columns: tuple[str, ...]
    rows: tuple[Row, ...]


def band_blocks(n_bands: int) -> Iterator[IntArray]:
    """Yield the indices of the bands of each table, evenly shared out."""
    n_blocks = -(-n_bands // BANDS_AT_MOST)
    yield from np.array_split(np.arange(n_bands), n_blocks)


def band_heads(centres_hz: FloatArray, block: IntArray) -> tuple[str, ...]:
    """Return the column heads of the bands of a block."""
    return tuple(hertz(float(f)) for f in centres_hz[block])


def block_caption(caption: str, centres_hz: FloatArray, block: IntArray) -> str:
    """Return a caption that tells the bands where one table does not hold them all."""
    if len(block) == len(centres_hz):
        return caption
    low, high = (hertz(float(centres_hz[j])) for j in (block[0], block[-1]))
    return f"{caption}; {low} to {high}"
