"""Figures without a window or a hidden state, and colours that everybody can tell apart."""

from __future__ import annotations

import io

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullLocator

from roomfit.typing import FloatArray

# M. Okabe, K. Ito, "Color Universal Design" (2008), without the yellow that vanishes on white
OKABE_ITO = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")


def new_figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure whose labels never overlap."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def png(figure: Figure, dpi: int = 130) -> bytes:
    """Return a figure as the bytes of a PNG file."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=dpi)
    return stream.getvalue()


def frequency_axis(axes: Axes, centres_hz: FloatArray) -> None:
    """Give an axis octaves of equal width, labelled with the bands' nominal centres."""
    axes.set_xscale("log", base=2)
    axes.set_xticks(list(centres_hz))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda f, _: _hertz(f)))


def _hertz(frequency: float) -> str:
    return f"{frequency / 1000:g}k" if frequency >= 1000 else f"{frequency:g}"
