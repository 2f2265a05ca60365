"""Boxes that a certified search leaves over, in two dimensions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from roomfit.report.pictures import OKABE_ITO, new_figure
from roomfit.typing import FloatArray


def boxes_figure(
    covers: Mapping[str, FloatArray],
    names: tuple[str, ...],
    truth: FloatArray,
    grids: tuple[FloatArray, FloatArray, FloatArray],
    levels: Sequence[float],
) -> Figure:
    """Return one panel with the covers on top of each other, the widest first.

    Parameters
    ----------
    covers : mapping of label to float array, shape (n_boxes, 2, 2)
        Lower and upper absorption of each box. Every point whose error is below what the label
        says lies in one of them.
    names : tuple of two str
    truth : float array, shape (2,)
    grids : three float arrays, shape (n, n)
        Both absorptions and the error over a grid, for its contours.
    levels : sequence of float
        Rising: the errors that bound the covers, the smallest cover's first.
    """
    figure = new_figure(5.2, 5.0)
    axes = figure.subplots()
    for (label, boxes), colour in zip(covers.items(), (4, 0, 1), strict=False):
        patches = [Rectangle((b[0, 0], b[0, 1]), *(b[1] - b[0])) for b in boxes]
        axes.add_collection(
            PatchCollection(patches, facecolor=OKABE_ITO[colour], edgecolor="white", linewidth=0.4)
        )
        noun = "box" if len(boxes) == 1 else "boxes"
        axes.plot([], [], "s", color=OKABE_ITO[colour], label=f"{label}: {len(boxes)} {noun}")
    axes.contour(*grids, levels=list(levels), colors="black", linewidths=1.0)
    axes.plot([], [], "-", color="black", lw=1.0, label="where the error has just these values")
    axes.plot(*truth, "+", color="black", ms=12, mew=1.5, label="truth")
    widest = next(iter(covers.values()))
    low, high = widest[:, 0].min(axis=0), widest[:, 1].max(axis=0)
    margin = 0.08 * float((high - low).max())
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
    axes.set_xlabel(f"absorption of {names[0]}")
    axes.set_ylabel(f"absorption of {names[1]}")
    axes.set_title("What is left after the proof", fontsize=10)
    figure.legend(loc="outside lower center", frameon=False, fontsize=9)
    return figure
