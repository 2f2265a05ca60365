"""A design in words and tables, for a terminal."""

from __future__ import annotations

import numpy as np

from roomfit.placement.answer import Design, mean_widths, widest
from roomfit.report.answer_text import findings_text

_CRITERIA = {
    "determinant": "all intervals together (D-optimal)",
    "mean": "the mean interval",
    "worst": "the widest interval",
}
_MODELS = {
    "coherent": "pressures of image sources, added as far as arrival times are known",
    "energy": "energies of reflections",
}


def design_text(design: Design) -> str:
    """Return the chosen pairs, the expected intervals of every material, and all findings."""
    lines = [_opening(design), "", *_table(design), "", *_comparison(design), ""]
    lines += [*_materials(design)]
    found = findings_text(design.findings)
    return "\n".join([*lines, *(["", found] if found else [])])


def _opening(design: Design) -> str:
    n = len(design.scene.pairs) - design.n_held
    before = "a finished fit" if design.after_fit else f"{design.n_held} measured pairs"
    known = f", after {before}" if design.after_fit or design.n_held else ""
    return (
        f"{len(design.chosen)} of {n} pairs, chosen for {_CRITERIA[design.criterion]}{known};\n"
        f"by {_MODELS[design.model]}.\n"
        f"Receivers at least {design.source_distance_m:.2f} m from their source and "
        f"{design.receiver_distance_m:g} m from each other."
    )


def _table(design: Design) -> list[str]:
    means = mean_widths(design)
    lines = ["      source   x, y, z in m           receiver   x, y, z in m       mean interval"]
    lines += [f"   0  {'before':<52} {means[0]:>15.3f}"]
    for i, (s, r) in enumerate(design.scene.pairs[design.chosen]):
        source, receiver = design.scene.sources[s], design.scene.receivers[r]
        at = ["  ".join(f"{x:5.2f}" for x in p.position_m) for p in (source, receiver)]
        lines.append(
            f"  {i + 1:>2}  {source.name:<8} {at[0]:<22} {receiver.name:<10} {at[1]:<20}"
            f"{means[i + 1]:>7.3f}"
        )
    return lines


def _comparison(design: Design) -> list[str]:
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
    lines.append(
        f"Widest interval before: {design.materials[material]} at "
        f"{design.bands.centres_hz[band]:g} Hz, {before:.3f}; expected afterwards {after:.3f}."
    )
    return lines


def _materials(design: Design) -> list[str]:
    width = max(8, *(len(name) for name in design.materials))
    heads = "".join(f"{f:>9g}" for f in design.bands.centres_hz)
    lines = [f"expected width of the 95 % interval\n{'Hz':>{width}}{heads}"]
    for i, name in enumerate(design.materials):
        cells = (
            "".join(f"{w:>9.3f}" for w in design.widths[-1, i])
            if design.to_find[i]
            else f"{'known':>9}"
        )
        lines.append(f"{name:>{width}}{cells}")
    return lines
