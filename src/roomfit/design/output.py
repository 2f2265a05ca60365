"""A design as design.json and design.csv (format_version 1), as text, and as figures."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from roomfit.base.table import Column, Table, csv_of, html_of, text_of
from roomfit.base.typing import FloatArray
from roomfit.base.whole_files import write_json_atomically, write_text_atomically
from roomfit.files.encoding import finding_content, numbers_or_null, provenance
from roomfit.report.figures import OKABE_ITO, figure_legend, new_figure
from roomfit.report.room_figure import outline_m
from roomfit.report.text import findings_text
from roomfit.report.wording import html_findings
from roomfit.room.scene import wall_materials

if TYPE_CHECKING:
    from roomfit.design.positions import Design


def mean_widths(design: Design) -> FloatArray:
    """Return the mean width over all bands and all that is compared, shape (n_chosen + 1,)."""
    return np.asarray(design.widths[:, design.compared].mean(axis=(1, 2)))


def widest(design: Design) -> tuple[int, int]:
    """Return material and band of the widest interval before any of the chosen pairs."""
    widths = np.where(design.compared[:, None], design.widths[0], 0.0)
    material, band = np.unravel_index(int(np.argmax(widths)), widths.shape)
    return int(material), int(band)


def write_design(folder: Path, design: Design, inputs: Iterable[Path]) -> None:
    """Write ``design.json`` and ``design.csv`` into a folder."""
    write_text_atomically(folder / "design.csv", csv_of(design_records(design)))
    write_json_atomically(folder / "design.json", design_content(design, inputs))


def design_content(design: Design, inputs: Iterable[Path]) -> dict[str, Any]:
    """Return what design.json holds: lists over bands are as long as bands_hz."""
    means = mean_widths(design)
    return {
        "format": "roomfit-design",
        "format_version": 1,
        "bands_hz": design.bands.centres_hz,
        "chosen": [
            {
                "source": source,
                "source_m": source_m,
                "receiver": receiver,
                "receiver_m": receiver_m,
                "mean_width95": float(means[i + 1]),
                **_by_material(design, design.widths[i + 1], "width95", "width95_m2"),
            }
            for i, (source, source_m, receiver, receiver_m) in enumerate(chosen_positions(design))
        ],
        "before": {
            "mean_width95": float(means[0]),
            **_by_material(design, design.widths[0], "width95", "width95_m2"),
            "after_fit": design.after_fit,
            "measured_pairs": design.n_fixed,
        },
        "widest": _widest(design),
        "random": _random(design),
        "candidates": len(design.scene.pairs) - design.n_fixed,
        "assumed": {
            "criterion": design.criterion,
            "draws": design.n_draws,
            **_by_material(design, design.absorption, "absorption", "absorption_area_m2"),
            "source_distance_m": design.source_distance_m,
            "receiver_distance_m": design.receiver_distance_m,
            "wall_distance_m": design.wall_distance_m,
        },
        "findings": [finding_content(f) for f in design.findings],
        "design": {"seed": design.seed, "seconds": round(design.seconds, 3)},
        "provenance": provenance(inputs),
    }


def design_records(design: Design) -> Table:
    """Return the content of design.csv: one row a chosen pair, and the mean width after it."""
    columns = (
        *("number", "source", "source_x_m", "source_y_m", "source_z_m"),
        *("receiver", "receiver_x_m", "receiver_y_m", "receiver_z_m"),
        *("distance_m", Column("mean_width95", ".4f")),
    )
    after, rows = mean_widths(design)[1:].tolist(), []
    for i, (source, source_m, receiver, receiver_m) in enumerate(chosen_positions(design)):
        ends = (source, *source_m.tolist(), receiver, *receiver_m.tolist())
        distance_m = float(np.linalg.norm(source_m - receiver_m))
        rows.append((i + 1, *ends, distance_m, after[i]))
    return Table("", columns, rows, form=".3f")


def chosen_positions(design: Design) -> list[tuple[str, FloatArray, str, FloatArray]]:
    """Return names and positions of source and receiver of every chosen pair."""
    found = []
    for s, r in design.scene.pairs[design.chosen]:
        source, receiver = design.scene.sources[s], design.scene.receivers[r]
        found.append((source.name, source.position_m, receiver.name, receiver.position_m))
    return found


def _by_material(
    design: Design, table: FloatArray, of_walls: str, of_objects: str
) -> dict[str, Any]:
    """Return the rows of walls under one key, and those of objects, if any, under another."""
    n = len(wall_materials(design.scene.room))
    each = list(zip(design.materials, table, strict=True))
    return {of_walls: dict(each[:n])} | ({of_objects: dict(each[n:])} if each[n:] else {})


def _widest(design: Design) -> dict[str, Any]:
    material, band = widest(design)
    return {
        "material": design.materials[material],
        "band_hz": float(design.bands.centres_hz[band]),
        "width95": design.widths[:, material, band],
    }


def _random(design: Design) -> dict[str, Any]:
    """Return how random designs do after 0 to n pairs: null where none went so far."""
    means = design.random_means
    reached = np.isfinite(means).any(axis=0)
    out: dict[str, Any] = {"designs": len(means)}
    for name, share in (("median", 0.5), ("lower5", 0.05), ("upper95", 0.95)):
        row = np.full(means.shape[1], np.nan)
        if len(means):
            row[reached] = np.nanquantile(means[:, reached], share, axis=0)
        out[f"mean_width95_{name}"] = numbers_or_null(row)
    return out


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


def design_html(design: Design) -> str:
    """Return the chosen pairs, and all findings, in HTML."""
    shown = _pairs_table(design, _opening(design))
    return html_of(shown) + html_findings(design.findings)


_CRITERIA = {
    "determinant": "all intervals together (D-optimal)",
    "mean": "the mean interval",
    "worst": "the widest interval",
}


def design_text(design: Design) -> str:
    """Return the chosen pairs, the expected intervals of every material, and all findings."""
    pairs, widths = (text_of(t) for t in (_pairs_table(design), _widths_table(design)))
    parts = [_opening(design), pairs, _comparison(design), widths]
    return "\n\n".join(p for p in (*parts, findings_text(design.findings)) if p)


def _opening(design: Design) -> str:
    n = len(design.scene.pairs) - design.n_fixed
    before = "a finished fit" if design.after_fit else f"{design.n_fixed} measured pairs"
    known = f", after {before}" if design.after_fit or design.n_fixed else ""
    return (
        f"{len(design.chosen)} of {n} pairs, chosen for {_CRITERIA[design.criterion]}{known}.\n"
        f"Receivers at least {design.source_distance_m:.2f} m from their source and "
        f"{design.receiver_distance_m:g} m from each other."
    )


def _pairs_table(design: Design, caption: str = "") -> Table:
    words = [Column(name, align="<") for name in ("source", "receiver")]
    at = "x, y, z in m"
    columns = ("", words[0], at, words[1], at, "mean width of the 95 % intervals")
    means, rows = mean_widths(design).tolist(), []
    for i, (source, source_m, receiver, receiver_m) in enumerate(chosen_positions(design)):
        ends = [", ".join(f"{x:.2f}" for x in at_m) for at_m in (source_m, receiver_m)]
        rows.append((i + 1, source, ends[0], receiver, ends[1], means[i + 1]))
    before = (0, "before", "", "", "", means[0])
    return Table(caption, columns, [before, *rows], form=".3f")


def _comparison(design: Design) -> str:
    last = design.random_means[:, -1]
    last = last[np.isfinite(last)]
    lines = []
    if last.size:
        low, middle, high = np.quantile(last, (0.05, 0.5, 0.95))
        mean = float(mean_widths(design)[-1])
        lines.append(
            f"{last.size} random designs under the same rules: {middle:.3f} (median; 5 to 95 %: "
            f"{low:.3f} to {high:.3f}), {middle / mean:.2f} times as wide."
        )
    material, band = widest(design)
    before, after = design.widths[[0, -1], material, band]
    unit = " m2" * (material >= len(wall_materials(design.scene.room)))
    lines.append(
        f"Widest interval before: {design.materials[material]} at {design.bands.centres_hz[band]:g}"
        f" Hz, {before:.3f}{unit}; expected afterwards {after:.3f}{unit}."
    )
    return "\n".join(lines)


def _widths_table(design: Design) -> Table:
    rows, n = [], len(wall_materials(design.scene.room))
    for i, name in enumerate(design.materials):
        own = design.widths[-1, i]
        label = name if i < n else f"{name}, m2"
        rows.append((label, *(own.tolist() if design.to_find[i] else ["known"] * own.size)))
    heads = ("Hz", *(f"{f:g}" for f in design.bands.centres_hz))
    return Table("expected width of the 95 % interval", heads, rows, form=".3f")
