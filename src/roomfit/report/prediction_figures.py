"""Figures of predictions and treatments: a change, decay curves, maps, what hangs where."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_hex, to_rgb, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from roomfit.base.typing import FloatArray, IntArray
from roomfit.predict.grid import MAPPED
from roomfit.predict.prediction import Predicted, PredictedPair, named_values
from roomfit.report.decay_times import mid_mean, mid_words
from roomfit.report.figures import (
    LOWEST_DB,
    band_panels,
    figure_legend,
    frame_panels,
    literal,
    new_figure,
)
from roomfit.report.predicted import SHOWN
from roomfit.report.room_figure import drawn_faces, outline_m, projection
from roomfit.report.wording import COLOURS, OKABE_ITO, decay_time_key, parameter
from roomfit.room.mesh import corners_m
from roomfit.room.scene import Scene, triangle_material
from roomfit.treat.arrangements import Arrangement, Treatment


def change_figure(predicted: Predicted) -> Figure:
    """Return means over the pairs before and after a change, one panel a parameter, by band.

    Beside each other in every band: measured before, model before, model after, and measured before
    carried over by the model's change; bars are 95 % intervals.

    """
    means = named_values(predicted.mean, predicted.sti)
    compared = [(v.change, name) for name, v in means.items() if v.change is not None]
    shown = [(c, n, label) for n, label, _ in SHOWN for c, m in compared if m == n]
    shown = [row for row in shown if np.isfinite(row[0].change).any()]
    heads = [f"{f:g}" for f in predicted.bands.centres_hz]
    figure = new_figure(9.0, 2.2 * -(-len(shown) // 2) + 0.8)
    panels = figure.subplots(-(-len(shown) // 2), 2, squeeze=False).ravel()
    for unused in panels[len(shown) :]:
        unused.set_visible(False)
    for axes, (c, name, label) in zip(panels, shown, strict=False):
        v, at = means[name], np.arange(means[name].predicted.size)
        series = (
            ("measured before", "black", v.measured, v.measured, v.measured),
            ("model before", OKABE_ITO[0], c.before, c.before_lower95, c.before_upper95),
            ("model after", OKABE_ITO[1], v.predicted, v.lower95, v.upper95),
            ("measured before, carried over", OKABE_ITO[2],
             c.carried, c.carried_lower95, c.carried_upper95),
        )  # fmt: skip
        for i, (text, color, middle, low, high) in enumerate(series):
            x = at + 0.16 * (i - 1.5)
            axes.vlines(x, low, high, color=color, lw=1.6)
            axes.plot(x, middle, "o", color=color, ms=4, label=text)
        axes.set_title(label, fontsize=9)
        axes.set_xticks(at, ["125 to 8000"] if name == "STI" else heads)
        axes.set_xlim(-0.6, at.size - 0.4)
        axes.grid(alpha=0.25, axis="y")
    figure.supxlabel("frequency (Hz)", fontsize=10)
    figure_legend(figure, panels[0], 4, "mean with " + literal("; ".join(predicted.changes), 80))
    return figure


def predicted_decay_figure(predicted: Predicted, pair: PredictedPair) -> Figure:
    """Return predicted energy decay curves of one pair, one panel a band, measured ones beside."""
    figure, panels = band_panels(len(predicted.bands), 2.3)
    decay = pair.decay
    times = {str(name): value for name, value in pair.parameters.items()}
    key = decay_time_key(times)
    shown_s = 1e-3
    for j, axes in enumerate(panels):
        axes.fill_between(
            decay.time_s, decay.lower_db[j], decay.upper_db[j], color=OKABE_ITO[1], alpha=0.25,
            lw=0.0, label="95 % interval (absorption alone)",
        )  # fmt: skip
        axes.plot(
            decay.time_s,
            decay.predicted_db[j],
            color=OKABE_ITO[1],
            lw=1.6,
            label="predicted after the change" if predicted.changes else "predicted",
        )
        if decay.before_db is not None:
            axes.plot(
                decay.time_s, decay.before_db[j], color=OKABE_ITO[0], lw=1.2, ls="--",
                label="predicted before the change",
            )  # fmt: skip
        if decay.measured_db is not None:
            label = "measured before the change" if predicted.compares_states else "measured"
            axes.plot(decay.time_s, decay.measured_db[j], color="black", lw=1.4, label=label)
        known = decay.predicted_db[j] > LOWEST_DB
        shown_s = max(shown_s, float(decay.time_s[known].max(initial=0.0)))
        label = f"{predicted.bands.centres_hz[j]:g} Hz"
        if key is not None and np.isfinite(times[key].predicted[j]):
            label += f": {parameter(key).symbol} {times[key].predicted[j]:.2f} s"
        axes.set_title(label, fontsize=9)
    panels[0].set_ylim(LOWEST_DB, 2.0)
    panels[0].set_xlim(0.0, shown_s)
    title = f"{literal(pair.source)} to {literal(pair.receiver)}"
    if predicted.changes:
        title += " with " + literal("; ".join(predicted.changes), 80)
    frame_panels(
        figure, panels, "time after emission (s)", "energy decay curve (dB)",
        legend_columns=3, title=title,
    )  # fmt: skip
    return figure


def grid_figure(predicted: Predicted, scene: Scene, source: str) -> Figure:
    """Return maps of one source: each parameter, and beside it the width of its 95 % interval.

    Means of 500 and 1000 Hz, or of the bands nearest to them.
    """
    pairs = [p for p in predicted.pairs if p.source == source]
    known = [n for n in MAPPED if any(np.isfinite(v).any() for v in _of(predicted, pairs, n))]
    positions = {p.name: p.position_m for p in scene.receivers}
    at_m = np.array([positions[p.receiver] for p in pairs])
    here_m = next(p.position_m for p in scene.sources if p.name == source)
    x_m, y_m, cells = _cells(at_m[:, :2])
    figure = new_figure(9.0, 2.8 * len(known) + 0.6)
    panels = figure.subplots(len(known), 2, squeeze=False)
    for row, name in zip(panels, known, strict=True):
        value, width = _of(predicted, pairs, name)
        how, where = parameter(name), f", {mid_words(predicted.bands.centres_hz)}"
        unit = f" ({how.unit})" if how.unit else ""
        words = f"{how.symbol}{unit}{where if name != 'STI' else ''}"
        titles = (words, f"width of its 95 % interval{unit}")
        for axes, numbers, title in zip(row, (value, width), titles, strict=True):
            table = np.full((y_m.size, x_m.size), np.nan)
            table[cells[:, 1], cells[:, 0]] = numbers
            drawn = axes.pcolormesh(x_m, y_m, table, shading="nearest", cmap="viridis")
            axes.plot(*here_m[:2], "k*", ms=9)
            axes.set_title(title, fontsize=9)
            axes.set_aspect("equal")
            figure.colorbar(drawn, ax=axes)
    figure.suptitle(f"From {literal(source, 30)}, {at_m[0, 2]:.2f} m high; x and y in m")
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


def _of(
    predicted: Predicted, pairs: list[PredictedPair], name: str
) -> tuple[FloatArray, FloatArray]:
    """Return a parameter of every pair at mid frequencies, and the width of its interval."""
    centres_hz = np.array([1000.0]) if name == "STI" else predicted.bands.centres_hz
    rows = []
    for pair in pairs:
        v = named_values(pair.parameters, pair.sti).get(name)
        both = () if v is None else (v.predicted, v.upper95 - v.lower95)
        rows.append([mid_mean(centres_hz, x) for x in both] or [np.nan, np.nan])
    value, width = np.array(rows).T
    return value, width


def treatment_figure(treatment: Treatment) -> Figure:
    """Return the room and what hangs where in the first arrangement."""
    figure = new_figure(6.4, 4.4)
    _draw_room(figure.add_subplot(), treatment, treatment.arrangements[0])
    return figure


def _draw_room(axes: Axes, treatment: Treatment, a: Arrangement) -> None:
    """Draw the room from above one corner, treated surfaces in colour; walls in front left out."""
    room, onto = treatment.room.scene.room, projection()[:2]
    by_surface: dict[str, list[str]] = {}
    covered: dict[str, float] = {}
    for h in a.hung:
        text = f"{h.area_m2:.4g} m² {h.product} ({100 * h.share:.0f} %)"
        by_surface.setdefault(h.surface, []).append(text)
        covered[h.surface] = covered.get(h.surface, 0.0) + h.share
    # the less of a surface is covered the paler it is
    colour = {}
    for i, (name, share) in enumerate(covered.items()):
        red, green, blue = (
            1.0 - (0.3 + 0.7 * min(share, 1.0)) * (1.0 - part)
            for part in to_rgb(COLOURS[i % len(COLOURS)])
        )
        colour[name] = to_hex((red, green, blue))
    faces, _ = drawn_faces(room)
    owner = [room.materials[int(i)] for i in triangle_material(room)[faces]]
    colours = [colour.get(name, "#EEEEEE") for name in owner]
    axes.add_collection(
        PolyCollection(
            list(corners_m(room.mesh)[faces] @ onto.T),
            facecolors=colours, edgecolors=colours, linewidths=0.5, closed=True, clip_on=False,
        )
    )  # fmt: skip
    # covered walls whose inside is turned away stand before the others, and are seen through
    is_hidden = ~np.isin(np.arange(len(room.mesh.triangles)), faces)
    for name in colour:
        front = is_hidden & (triangle_material(room) == room.materials.index(name))
        axes.add_collection(
            PolyCollection(
                list(corners_m(room.mesh)[front] @ onto.T),
                facecolors=[to_rgba(colour[name], 0.35)], edgecolors=[to_rgba(colour[name], 0.9)],
                linewidths=0.5, closed=True, clip_on=False, zorder=2.5,
            )
        )  # fmt: skip
    edges = outline_m(room, 1500)
    axes.add_collection(
        LineCollection(list(edges @ onto.T), colors="#444444", linewidths=0.8, clip_on=False)
    )
    flat = room.mesh.vertices_m @ onto.T
    axes.set_xlim(flat[:, 0].min(), flat[:, 0].max())
    axes.set_ylim(flat[:, 1].min(), flat[:, 1].max())
    axes.set_aspect("equal")
    axes.set_axis_off()
    handles = [
        Patch(facecolor=colour[s], edgecolor="#777777", label=literal(f"{s}: {', '.join(t)}", 60))
        for s, t in by_surface.items()
    ]
    handles.append(Patch(facecolor="#EEEEEE", edgecolor="#777777", label="as it is"))
    axes.legend(
        handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.02), frameon=False, fontsize=8
    )
