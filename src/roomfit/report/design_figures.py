"""Figures of a design: where pairs stand, and what they are worth."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from roomfit.base.typing import FloatArray
from roomfit.design.output import mean_widths
from roomfit.design.positions import Design
from roomfit.report.figures import figure_legend, new_figure
from roomfit.report.room_figure import outline_m
from roomfit.report.wording import OKABE_ITO

_BLUE, _ORANGE, _GREY = OKABE_ITO[0], OKABE_ITO[1], "0.62"
_MOST_EDGES = 1500
_WIDTH_IN = 8.6
_AXES = ("x (m)", "y (m)", "z (m)")


def design_map(design: Design) -> Figure:
    """Return the room from above and from the side, with candidates and numbered pairs."""
    edges = outline_m(design.scene.room, _MOST_EDGES)
    size = np.ptp(design.scene.room.mesh.vertices_m, axis=0)
    across = _WIDTH_IN - 1.1
    tall = [min(across * max(size[i] / max(size[0], 1e-9), 0.18), 7.0) for i in (1, 2)]
    figure = new_figure(_WIDTH_IN, sum(tall) + 2.1)
    plan, side = figure.subplots(2, 1, sharex=True, height_ratios=tall)
    for axes, up, title in ((plan, 1, "from above"), (side, 2, "from the side")):
        _panel(axes, design, edges, up)
        axes.set_title(title, fontsize=9, loc="left")
        axes.set_ylabel(_AXES[up])
    side.set_xlabel(_AXES[0])
    figure_legend(figure, plan, 3)
    return figure


def _panel(axes: Axes, design: Design, edges: FloatArray, up: int) -> None:
    """Draw the room along x and one other axis."""
    scene, at = design.scene, [0, up]
    axes.add_collection(LineCollection(list(edges[:, :, at]), colors="black", linewidths=0.9))
    sources, receivers = (
        np.array([p.position_m for p in points])[:, at]
        for points in (scene.sources, scene.receivers)
    )
    pairs = scene.pairs[design.chosen]
    axes.plot(*receivers.T, ".", color=_GREY, ms=4, label="candidate receiver")
    axes.plot(*sources.T, "^", color=_GREY, ms=6, mfc="none", label="candidate source")
    fixed = scene.pairs[: design.n_fixed]
    if len(fixed):
        used = receivers[np.unique(fixed[:, 1])]
        axes.plot(*used.T, "s", color="black", ms=6, mfc="none", label="measured already")
    for s, r in pairs:
        ends = np.array([sources[s], receivers[r]])
        axes.plot(*ends.T, "-", color=_BLUE, lw=0.9, alpha=0.6)
    axes.plot(*sources[np.unique(pairs[:, 0])].T, "^", color=_ORANGE, ms=10, label="source")
    axes.plot(*receivers[pairs[:, 1]].T, "o", color=_BLUE, ms=12, label="receiver, in this order")
    for r in np.unique(pairs[:, 1]):
        number = ",".join(str(i + 1) for i in np.flatnonzero(pairs[:, 1] == r))
        axes.annotate(
            number, receivers[r], color="white", fontsize=8, ha="center", va="center_baseline",
            fontweight="bold", zorder=5,
        )  # fmt: skip
    for s in np.unique(pairs[:, 0]):
        axes.annotate(
            scene.sources[s].name, sources[s], xytext=(7, 5), textcoords="offset points",
            fontsize=8, color=_ORANGE, zorder=5,
            path_effects=[withStroke(linewidth=2.0, foreground="white")],
        )  # fmt: skip
    axes.set_aspect("equal")
    axes.margins(0.03)


def design_gain(design: Design) -> Figure:
    """Return the expected mean interval against the number of pairs, beside random designs."""
    figure = new_figure(6.4, 4.0)
    axes = figure.subplots()
    steps = np.arange(len(design.chosen) + 1)
    reached = np.isfinite(design.random_means).any(axis=0)
    if len(design.random_means):
        low, middle, high = np.nanquantile(
            design.random_means[:, reached], (0.05, 0.5, 0.95), axis=0
        )
        axes.fill_between(
            steps[reached], low, high, color=_GREY, alpha=0.35, lw=0.0,
            label=f"{len(design.random_means)} random designs, 5 to 95 %",
        )  # fmt: skip
        axes.plot(steps[reached], middle, color="0.25", lw=1.4, ls="--", label="their median")
    axes.plot(steps, mean_widths(design), "o-", color=_BLUE, lw=1.8, label="chosen")
    axes.set_ylim(bottom=0.0)
    axes.set_xlim(left=0.0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    beside = " beside what is known" if design.after_fit or design.n_fixed else ""
    axes.set_xlabel(f"measured pairs of source and receiver{beside}")
    axes.set_ylabel("expected width of the 95 % interval,\nmean over materials and bands")
    axes.grid(alpha=0.25)
    axes.legend(frameon=False)
    return figure
