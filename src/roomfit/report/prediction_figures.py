"""Figures of predictions, treatments and designs: a change, decays, maps, what goes where."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex, to_rgb, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from roomfit.base.typing import FloatArray, IntArray
from roomfit.design.output import mean_widths
from roomfit.design.positions import Design
from roomfit.predict.grid import MAPPED
from roomfit.predict.prediction import Predicted, PredictedPair, named_values
from roomfit.report import figures, wording
from roomfit.report.room_figure import draw_edges, draw_faces, drawn_faces, outline_m
from roomfit.room.scene import Scene, triangle_material
from roomfit.treat.arrangements import Treatment

# ---------------------------------------------------------------- predictions


def predicted_decay_figure(predicted: Predicted, *pairs: PredictedPair) -> Figure:
    """Return predicted energy decay curves, one panel a band, measured ones beside.

    Of several pairs those of each are in a group, as in `decay_figure`.
    """
    figure, panels = figures.decay_panels(predicted.bands.centres_hz)
    shown_s = 1e-3
    for i, pair in enumerate(pairs):
        group = f"{figures.CURVES}{i}" if len(pairs) > 1 else None
        for j, axes in enumerate(panels):
            _draw_predicted(axes, predicted, pair, j, group)
        known = np.any(pair.decay.predicted_db > figures.LOWEST_DB, axis=0)
        shown_s = max(shown_s, float(pair.decay.time_s[known].max(initial=0.0)))
        title = f"{figures.literal(pair.source)} to {figures.literal(pair.receiver)}"
        if predicted.changes:
            title += " with " + figures.literal("; ".join(predicted.changes), 80)
        figures.title_of_pair(figure, title, group)
    panels[0].set_xlim(0.0, shown_s)
    figures.figure_legend(figure, 3, " ")
    return figure


def _draw_predicted(
    axes: Axes, predicted: Predicted, pair: PredictedPair, band: int, group: str | None
) -> None:
    decay, times = pair.decay, {str(name): value for name, value in pair.parameters.items()}
    measured = "measured before the change" if predicted.compares_states else "measured"
    now = "predicted after the change" if predicted.changes else "predicted"
    label = "95 % interval (absorption alone)"
    low, high = (np.column_stack((decay.time_s, y[band])) for y in (decay.lower_db, decay.upper_db))
    known = np.isfinite(low + high).all(axis=1)
    look: dict[str, Any] = {"color": wording.OKABE_ITO[1], "alpha": 0.25, "lw": 0.0}
    area = np.concatenate((low[known], high[known][::-1]))
    drawn: list[Artist] = [Polygon(area, label=label, **look)] if known.any() else []
    for label, level_db, colour, style in (
        ("predicted before the change", decay.before_db, wording.OKABE_ITO[0], "--"),
        (measured, decay.measured_db, "black", "-"),
        (now, decay.predicted_db, wording.OKABE_ITO[1], "-"),
    ):
        if level_db is not None:
            look = {"color": colour, "lw": 1.5, "ls": style}
            drawn.append(Line2D(decay.time_s, level_db[band], label=label, **look))
    for artist in drawn:
        artist.set_gid(group)
        axes.add_artist(artist)
    key = wording.decay_time_key(k for k, v in times.items() if np.isfinite(v.predicted[band]))
    if key is not None:
        words = f"{wording.parameter(key).symbol} {times[key].predicted[band]:.2f} s"
        figures.words_of_panel(axes, words, group)


def grid_figure(predicted: Predicted, scene: Scene, source: str) -> Figure:
    """Return maps of one source: each parameter, and beside it the width of its 95 % interval.

    Means of 500 and 1000 Hz, or of the bands nearest to them.
    """
    pairs = [p for p in predicted.pairs if p.source == source]
    maps = {name: _mid_values(predicted, pairs, name) for name in MAPPED}
    maps = {name: both for name, both in maps.items() if np.isfinite(both).any()}
    positions = {p.name: p.position_m for p in scene.receivers}
    at_m = np.array([positions[p.receiver] for p in pairs])
    here_m = next(p.position_m for p in scene.sources if p.name == source)
    x_m, y_m, cells = _cells(at_m[:, :2])
    figure = figures.new_figure(9.0, 2.8 * len(maps) + 0.6)
    panels = figure.subplots(len(maps), 2, squeeze=False)
    for row, (name, both) in zip(panels, maps.items(), strict=True):
        how, centres_hz = wording.parameter(name), predicted.bands.centres_hz
        unit = f" ({how.unit})" if how.unit else ""
        where = f", {wording.mid_words(centres_hz, centres_hz)}" if name != "STI" else ""
        words = f"{how.symbol}{unit}{where}"
        titles = (words, f"width of its 95 % interval{unit}")
        for axes, values, title in zip(row, both, titles, strict=True):
            table = np.full((y_m.size, x_m.size), np.nan)
            table[cells[:, 1], cells[:, 0]] = values
            drawn = axes.pcolormesh(x_m, y_m, table, shading="nearest", cmap="viridis")
            axes.plot(*here_m[:2], "k*", ms=9)
            axes.set_title(title, fontsize=9)
            axes.set_aspect("equal")
            figure.colorbar(drawn, ax=axes)
    figure.suptitle(f"From {figures.literal(source, 30)}, {at_m[0, 2]:.2f} m high; x and y in m")
    return figure


def _cells(at_m: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return x and y of evenly spaced cells, and the cell of every point, (n, 2).

    Where no point of a whole row lies in the room, the row is there, and empty.
    """
    first = at_m.min(axis=0)
    gaps = np.concatenate([np.diff(np.unique(column)) for column in at_m.T])
    step = float(gaps[gaps > 1e-6].min(initial=np.inf))
    if not np.isfinite(step):
        return at_m[:1, 0], at_m[:1, 1], np.zeros((len(at_m), 2), dtype=np.int64)
    cells = np.rint((at_m - first) / step).astype(np.int64)
    x_m, y_m = (first[i] + step * np.arange(cells[:, i].max() + 1) for i in (0, 1))
    return x_m, y_m, cells


def _mid_values(predicted: Predicted, pairs: list[PredictedPair], name: str) -> FloatArray:
    """Return a parameter of every pair at mid frequencies, and the width of its interval."""
    centres_hz = np.array([1000.0]) if name == "STI" else predicted.bands.centres_hz
    rows = []
    for pair in pairs:
        v = named_values(pair.parameters, pair.sti).get(name)
        both = () if v is None else (v.predicted, v.upper95 - v.lower95)
        rows.append([wording.mid_mean(centres_hz, x) for x in both] or [np.nan, np.nan])
    return np.array(rows).T


# ---------------------------------------------------------------- treatments


def treatment_figure(treatment: Treatment) -> Figure:
    """Return the room from above one corner, what hangs where in the first arrangement in colour.

    The less of a surface is covered the paler it is; covered walls towards the viewer are seen
    through.
    """
    figure, (axes,) = figures.grid_of(1, 1, 6.4, 4.4)
    room = treatment.room.scene.room
    texts: dict[str, list[str]] = {}
    covered: dict[str, float] = {}
    for h in treatment.arrangements[0].hung:
        text = f"{h.area_m2:.4g} m² {h.product} ({100 * h.share:.0f} %)"
        texts.setdefault(h.surface, []).append(text)
        covered[h.surface] = covered.get(h.surface, 0.0) + h.share
    colours = {}
    for i, (name, share) in enumerate(covered.items()):
        full = np.array(to_rgb(wording.COLOURS[i % len(wording.COLOURS)]))
        colours[name] = to_hex(tuple(1.0 - (0.3 + 0.7 * min(share, 1.0)) * (1.0 - full)))
    faces = drawn_faces(room)
    owner = np.array(room.materials)[triangle_material(room)]
    behind = [colours.get(name, "#EEEEEE") for name in owner[faces]]
    draw_faces(axes, room, faces, behind, behind)
    # covered walls whose inside is turned away stand before the others, and are seen through
    for name, colour in colours.items():
        front = np.setdiff1d(np.flatnonzero(owner == name), faces)
        ends = [to_rgba(colour, 0.35)], [to_rgba(colour, 0.9)]
        draw_faces(axes, room, front, *ends, zorder=2.5)
    draw_edges(axes, room)
    axes.set_aspect("equal")
    handles = [
        Patch(
            facecolor=colours[s],
            edgecolor="#777777",
            label=figures.literal(f"{s}: {', '.join(t)}", 60),
        )
        for s, t in texts.items()
    ]
    handles.append(Patch(facecolor="#EEEEEE", edgecolor="#777777", label="as it is"))
    figure.legend(handles=handles, loc="lower center", frameon=False, fontsize=8)
    figure.subplots_adjust(0.02, min(0.05 + 0.042 * len(handles), 0.7), 0.98, 0.98)
    return figure


# ---------------------------------------------------------------- designs

_BLUE, _ORANGE, _GREY = wording.OKABE_ITO[0], wording.OKABE_ITO[1], "0.62"
_MAP_IN = 8.6


def design_map(design: Design) -> Figure:
    """Return the room from above and from the side, with candidates and numbered pairs."""
    edges = outline_m(design.scene.room)
    size = np.ptp(design.scene.room.mesh.vertices_m, axis=0)
    across = _MAP_IN - 1.1
    tall = [min(across * max(size[i] / max(size[0], 1e-9), 0.18), 7.0) for i in (1, 2)]
    figure, (plan, side) = figures.grid_of(
        2, 1, _MAP_IN, sum(tall) + 2.1, sharex=True, height_ratios=tall
    )
    for axes, up, title, label in (
        (plan, 1, "from above", "y (m)"),
        (side, 2, "from the side", "z (m)"),
    ):
        lines = LineCollection(list(edges[:, :, [0, up]]), colors="black", linewidths=0.9)
        axes.add_collection(lines)
        _draw_pairs(axes, design, up)
        axes.set_title(title, fontsize=9, loc="left")
        axes.set_ylabel(label)
        axes.set_aspect("equal")
        axes.margins(0.03)
    side.set_xlabel("x (m)")
    figures.figure_legend(figure, 3)
    return figure


def _draw_pairs(axes: Axes, design: Design, up: int) -> None:
    """Draw candidates and chosen pairs along x and one other axis."""
    scene = design.scene
    sources, receivers = (
        np.array([p.position_m for p in points])[:, [0, up]]
        for points in (scene.sources, scene.receivers)
    )
    pairs, fixed = scene.pairs[design.chosen], scene.pairs[: design.n_fixed]
    axes.plot(*receivers.T, ".", color=_GREY, ms=4, label="candidate receiver")
    axes.plot(*sources.T, "^", color=_GREY, ms=6, mfc="none", label="candidate source")
    if len(fixed):
        used = receivers[np.unique(fixed[:, 1])]
        axes.plot(*used.T, "s", color="black", ms=6, mfc="none", label="measured already")
    for s, r in pairs:
        axes.plot(*np.array([sources[s], receivers[r]]).T, "-", color=_BLUE, lw=0.9, alpha=0.6)
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
            figures.literal(scene.sources[s].name), sources[s], xytext=(7, 5),
            textcoords="offset points", fontsize=8, color=_ORANGE, zorder=5,
            path_effects=[withStroke(linewidth=2.0, foreground="white")],
        )  # fmt: skip


def design_gain(design: Design) -> Figure:
    """Return the expected mean interval against the number of pairs, beside random designs."""
    figure = figures.new_figure(6.4, 4.0)
    axes = figure.subplots()
    reached = np.isfinite(design.random_means).any(axis=0)
    if len(design.random_means):
        rows = np.nanquantile(design.random_means[:, reached], (0.05, 0.5, 0.95), axis=0)
        low, middle, high = rows
        steps = np.flatnonzero(reached)
        label = f"{len(design.random_means)} random designs, 5 to 95 %"
        axes.fill_between(steps, low, high, color=_GREY, alpha=0.35, lw=0.0, label=label)
        axes.plot(steps, middle, color="0.25", lw=1.4, ls="--", label="their median")
    axes.plot(mean_widths(design), "o-", color=_BLUE, lw=1.8, label="chosen")
    axes.set_ylim(bottom=0.0)
    axes.set_xlim(left=0.0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    beside = " beside what is known" if design.after_fit or design.n_fixed else ""
    axes.set_xlabel(f"measured pairs of source and receiver{beside}")
    axes.set_ylabel("expected width of the 95 % interval,\nmean over materials and bands")
    axes.grid(alpha=0.25)
    axes.legend(frameon=False)
    return figure
