"""A design as blocks: where to measure, and how narrow intervals are expected to be then."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from roomfit.base.table import Column, Table
from roomfit.design.output import chosen_positions, mean_widths, widest
from roomfit.report.blocks import Blocks, Drawing, Findings, Sentence
from roomfit.room.scene import wall_materials

if TYPE_CHECKING:
    from roomfit.design.positions import Design

_CRITERIA = {
    "determinant": "all intervals together (D-optimal)",
    "mean": "the mean interval",
    "worst": "the widest interval",
}


def describe(design: Design) -> Blocks:
    """Return the chosen pairs, the expected intervals of every material, and all findings."""
    n = len(design.scene.pairs) - design.n_fixed
    before = "a finished fit" if design.after_fit else f"{design.n_fixed} measured pairs"
    known = f", after {before}" if design.after_fit or design.n_fixed else ""
    lead = (
        f"{len(design.chosen)} of {n} pairs, chosen for {_CRITERIA[design.criterion]}{known}. "
        f"Receivers at least {design.source_distance_m:.2f} m from their source and "
        f"{design.receiver_distance_m:g} m from each other."
    )
    title, gain = "The room with the chosen pairs", "Expected width of the intervals by pairs"
    head = (
        Sentence(lead, "lead"),
        _pairs_table(design),
        Drawing("design_map", title, "", "prediction_figures.design_map", (design,)),
        Drawing("design_gain", gain, "", "prediction_figures.design_gain", (design,)),
        Sentence(_comparison(design)),
        _widths_table(design),
    )
    return Blocks("Where to measure", head, (Findings(design.findings),), "design.json")


def _pairs_table(design: Design) -> Table:
    words = [Column(name, align="<") for name in ("source", "receiver")]
    at = "x, y, z in m"
    columns = ("", words[0], at, words[1], at, "mean width of the 95 % intervals")
    means, rows = mean_widths(design).tolist(), []
    for i, (source, source_m, receiver, receiver_m) in enumerate(chosen_positions(design)):
        ends = [", ".join(f"{x:.2f}" for x in at_m) for at_m in (source_m, receiver_m)]
        rows.append((i + 1, source, ends[0], receiver, ends[1], means[i + 1]))
    before = (0, "before", "", "", "", means[0])
    return Table("Pairs, the most informative first", columns, [before, *rows], form=".3f")


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
    return " ".join(lines)


def _widths_table(design: Design) -> Table:
    rows, n = [], len(wall_materials(design.scene.room))
    for i, name in enumerate(design.materials):
        own = design.widths[-1, i]
        label = name if i < n else f"{name}, m2"
        rows.append((label, *(own.tolist() if design.to_find[i] else ["known"] * own.size)))
    heads = ("Hz", *(f"{f:g}" for f in design.bands.centres_hz))
    return Table("Expected width of the 95 % interval", heads, rows, form=".3f")
