"""The pictures of Suh (2001) again, and those of what the paper left open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import LogFormatterSciNotation, MultipleLocator

from roomfit.identification.fit import Fit
from roomfit.identification.landscape import Landscape
from roomfit.report.pictures import OKABE_ITO, new_figure
from roomfit.typing import FloatArray

_BLUE, _RED, _GREEN = OKABE_ITO[:3]
_LEVELS = np.logspace(-1.0, 5.0, 25)  # in the paper's unit of error
_AXIS_LABELS = ("absorption of floor and ceilings", "absorption of walls")


class ResponsePanel(NamedTuple):
    """One response: title, edges of its bins in ms, energy of each bin, and marked times in ms."""

    title: str
    edges_ms: FloatArray
    energy: FloatArray
    marks_ms: Mapping[str, int]


class Curve(NamedTuple):
    """A line of a picture: its name, x and y."""

    name: str
    x: FloatArray
    y: FloatArray


def responses_figure(panels: Sequence[ResponsePanel], note: str) -> Figure:
    """Return Figure 2 or 3: energy over time, one panel a case."""
    figure = _noted(9.0, 1.9 * len(panels) + 0.6, note)
    rows = figure.subplots(len(panels), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for axes, panel in zip(rows, panels, strict=True):
        axes.stairs(panel.energy, panel.edges_ms, fill=True, color=_BLUE)
        for (text, at_ms), color in zip(panel.marks_ms.items(), (_RED, _GREEN), strict=False):
            axes.axvline(at_ms, color=color, lw=1.0, ls="--", label=f"{text} at {at_ms} ms")
        axes.legend(frameon=False, fontsize=9, title=panel.title, alignment="right")
        axes.set_xlim(0.0, 200.0)
        axes.set_ylim(0.0, None)
    width_ms = float(np.diff(panels[0].edges_ms[:2])[0])
    figure.supxlabel("time after emission (ms)", fontsize=10)
    figure.supylabel(f"energy in {width_ms:g} ms (unit of the paper)", fontsize=10)
    return figure


def contours_figure(shapes: Mapping[str, Landscape], note: str) -> Figure:
    """Return Figure 4: contours of the error on the paper's grid, one panel a case."""
    figure = _noted(3.9 * len(shapes) + 0.8, 5.0, note)
    panels = figure.subplots(1, len(shapes), sharey=True, squeeze=False)[0]
    for axes, (title, shape) in zip(panels, shapes.items(), strict=True):
        drawn = _contours(axes, shape.grid, shape.errors, _LEVELS)
        _mark_minima(axes, shape)
        axes.set_title(title, fontsize=10)
    panels[0].set_ylabel(_AXIS_LABELS[1])
    _error_bar(figure, panels, drawn)
    _legend_below(figure, panels[0])
    return figure


def ill_defined_figure(shape: Landscape, fine_errors: FloatArray, note: str) -> Figure:
    """Return Figure 5 twice: on the paper's grid, with its islands, and on a fine grid without.

    Parameters
    ----------
    shape : Landscape
    fine_errors : float array, shape (n, n)
        The same function on n points from 0 to 1.
    note : str
    """
    figure = _noted(9.6, 5.4, note)
    panels = figure.subplots(1, 2, sharey=True)
    fine = np.linspace(0.0, 1.0, len(fine_errors))
    _contours(panels[0], shape.grid, shape.errors, _LEVELS)
    drawn = _contours(panels[1], fine, fine_errors, _LEVELS)
    _mark_minima(panels[0], shape)
    _mark_minima(panels[1], shape, of_grid=False)
    n_false = len(shape.four_neighbours) - len(shape.minima.x)
    panels[0].set_title(f"the paper's grid, 21 x 21: {n_false} minima that are none", fontsize=10)
    panels[1].set_title(
        f"{len(fine)} x {len(fine)}: one valley, true minima: {len(shape.minima.x)}", fontsize=10
    )
    panels[0].set_ylabel(_AXIS_LABELS[1])
    _error_bar(figure, panels, drawn)
    _legend_below(figure, panels[0])
    return figure


def search_paths_figure(
    shape: Landscape, fits: Mapping[str, Fit], truth: tuple[float, float], note: str
) -> Figure:
    """Return the way of each search over the contours of its problem, one panel a method."""
    columns = min(len(fits), 2)
    rows = -(-len(fits) // columns)
    figure = _noted(4.6 * columns, 4.6 * rows + 0.7, note)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axes, (method, fit) in zip(panels, fits.items(), strict=False):
        axes.contour(shape.grid, shape.grid, shape.errors.T, _LEVELS, colors="0.75", linewidths=0.6)
        axes.plot(*fit.trail.T, "-", color="0.3", lw=0.6)
        order = np.linspace(0.0, 1.0, len(fit.trail))
        axes.scatter(*fit.trail.T, c=order, cmap="viridis", s=16, zorder=3)
        style: dict[str, Any] = {"ls": "none", "clip_on": False}
        axes.plot(*fit.trail[0], marker="s", color=_RED, mfc="none", mew=2, ms=10, label="start",
                  **style)  # fmt: skip
        axes.plot(*truth, marker="x", color=_RED, mew=2, ms=11, label="true absorption", **style)
        axes.set_title(f"{method}: {fit.evaluations} evaluations", fontsize=10)
        axes.set_aspect("equal")
    for axes in panels[-columns:]:
        axes.set_xlabel(_AXIS_LABELS[0])
    for axes in panels[::columns]:
        axes.set_ylabel(_AXIS_LABELS[1])
    handles, labels = panels[0].get_legend_handles_labels()
    title = "points from dark (first) to light (last); contours as in Figure 4, case 1"
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, title=title)
    return figure


def methods_figure(evaluations: Sequence[Curve], successes: Sequence[Curve], note: str) -> Figure:
    """Return evaluations and rate of success over the number of materials, for each method."""
    figure = _noted(9.6, 4.0, note)
    left, right = figure.subplots(1, 2)
    for i, curve in enumerate(evaluations):
        style: dict[str, Any] = {"color": OKABE_ITO[i], "marker": "osD^v"[i], "ms": 6, "lw": 1.2}
        left.plot(curve.x, curve.y, label=curve.name, **style)
    width = 0.8 / len(successes)
    for i, curve in enumerate(successes):
        aside = width * (i - 0.5 * (len(successes) - 1))
        right.bar(curve.x + aside, curve.y, width, color=OKABE_ITO[i])
    left.set_yscale("log")
    left.set_ylabel("evaluations of the error (median)")
    right.set_ylabel("searches that found the truth (%)")
    for axes in (left, right):
        axes.xaxis.set_major_locator(MultipleLocator(1))
        axes.set_xlabel("number of materials")
        axes.grid(alpha=0.25, axis="y")
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=3,
                  frameon=False, fontsize=9)  # fmt: skip
    return figure


def independent_figure(panels: Mapping[str, Sequence[Curve]], note: str) -> Figure:
    """Return the error of the found absorption over the number of the model's rays.

    Parameters
    ----------
    panels : mapping of title to curves
        One curve for each number of materials: rays a source, root mean square error.
    note : str
    """
    figure = _noted(9.6, 4.6, note)
    rows = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axes, (title, curves) in zip(rows, panels.items(), strict=True):
        for i, curve in enumerate(curves):
            style: dict[str, Any] = {
                "color": OKABE_ITO[i],
                "marker": "osD^vP"[i],
                "ms": 5,
                "lw": 1.4,
            }
            axes.loglog(curve.x, curve.y, label=curve.name, **style)
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("rays of the model for each source")
        axes.axvline(18_000, color="0.5", lw=1.0, ls=":")
        axes.text(19_500, 0.0012, "the paper's 18,000", color="0.35", fontsize=8, rotation=90)
        axes.grid(alpha=0.25, which="both")
    rows[0].set_ylabel("rms error of the found absorption")
    figure.legend(*rows[0].get_legend_handles_labels(), loc="outside lower center",
                  ncols=len(panels) * 3, frameon=False, fontsize=9)  # fmt: skip
    return figure


def _noted(width_in: float, height_in: float, note: str) -> Figure:
    figure = new_figure(width_in, height_in)
    engine = figure.get_layout_engine()
    if isinstance(engine, ConstrainedLayoutEngine):
        engine.set(rect=(0.0, 0.0, 1.0, 1.0 - 0.25 / height_in))
    figure.text(0.995, 1.0 - 0.05 / height_in, note, fontsize=8, color="0.35", ha="right", va="top")
    return figure


def _contours(
    axes: Axes, grid: FloatArray, errors: FloatArray, levels: FloatArray
) -> ScalarMappable:
    norm = LogNorm(levels[0], levels[-1])
    shown = np.clip(errors.T, levels[0], levels[-1])
    filled = axes.contourf(grid, grid, shown, levels, norm=norm, cmap="viridis_r")
    axes.contour(grid, grid, shown, levels, colors="white", linewidths=0.4)
    axes.set_aspect("equal")
    axes.set_xlabel(_AXIS_LABELS[0])
    return filled


def _error_bar(figure: Figure, panels: Sequence[Axes], drawn: ScalarMappable) -> None:
    bar = figure.colorbar(drawn, ax=list(panels), shrink=0.8, ticks=10.0 ** np.arange(-1, 6))
    bar.ax.yaxis.set_major_formatter(LogFormatterSciNotation())
    bar.set_label("error (unit of the paper)")


def _mark_minima(axes: Axes, shape: Landscape, *, of_grid: bool = True) -> None:
    inside: dict[str, Any] = {"clip_on": False, "zorder": 5, "ls": "none"}
    if of_grid:
        axes.plot(*np.array(shape.four_neighbours).T, marker="o", color=_RED, mfc="none", mew=1.8,
                  ms=9, label="minimum of the grid, 4 neighbours", **inside)  # fmt: skip
        axes.plot(*np.array(shape.eight_neighbours).T, marker="s", color="black", mfc="none",
                  mew=1.4, ms=14, label="minimum of the grid, 8 neighbours", **inside)  # fmt: skip
    axes.plot(*shape.minima.x.T, marker="x", color="black", mew=1.8, ms=6,
              label="true minimum: end of descents", **inside)  # fmt: skip


def _legend_below(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
