"""What ``roomfit paper`` leaves behind: paper.json, Table 2, the paper's figures, its text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import LogFormatterSciNotation

from roomfit.base.table import Table, csv_of, text_of
from roomfit.base.typing import FloatArray, Progress
from roomfit.base.whole_files import (
    check_output_folder,
    sole_writer,
    whole_output_folder,
    write_bytes_atomically,
    write_json_atomically,
    write_text_atomically,
)
from roomfit.paper.repeat import (
    FINE_GRID,
    FOUND_WITHIN,
    GRID,
    METHODS,
    CaseResponse,
    PaperResult,
    grid_minima,
    largest_relative_error,
    repeat_paper,
)
from roomfit.paper.room import (
    CASES,
    COMPARED_ABOVE,
    N_RAYS,
    PRINTED_ARRIVALS_MS,
    RECONSTRUCTED,
    SPECIFICATIONS,
    TABLE2,
    true_absorption,
)
from roomfit.report.figures import new_figure, png
from roomfit.report.wording import OKABE_ITO


@sole_writer
def run_paper(
    out: Path, *, seeds: int = 10, overwrite: bool = False, progress: Progress | None = None
) -> str:
    """Repeat the paper; write paper.json, table2.csv and pictures; return what was found.

    Nothing is written before everything is known. Seeds are those of `repeat_paper`.
    """
    check_output_folder(out, overwrite=overwrite)
    result = repeat_paper(seeds, progress=progress)
    columns = ("alpha1", "alpha2", "error_paper", "error_ours")
    table = Table("", columns, _table2_rows(result), form=".6g")
    with whole_output_folder(out, overwrite=overwrite) as aside:
        write_text_atomically(aside / "table2.csv", csv_of(table))
        for name, figure in _figures(result).items():
            write_bytes_atomically(aside / f"{name}.png", png(figure))
        write_json_atomically(aside / "paper.json", paper_json(result))
    return paper_text(result)


def _table2_rows(result: PaperResult) -> list[list[float]]:
    rows: list[list[float]] = np.column_stack((TABLE2, result.table2)).tolist()
    return rows


def paper_json(result: PaperResult) -> dict[str, Any]:
    """Return the content of paper.json."""
    return {
        "format": "roomfit-paper",
        "format_version": 2,
        "roomfit": version("roomfit"),
        "room": RECONSTRUCTED,
        "rays": N_RAYS,
        "seeds": result.seeds,
        "arrivals_ms": {r.name: [r.direct_ms, r.first_reflection_ms] for r in result.responses},
        "arrivals_ms_paper": {name: list(ms) for name, ms in PRINTED_ARRIVALS_MS.items()},
        "table2": [
            dict(zip(("alpha1", "alpha2", "paper", "ours"), row, strict=True))
            for row in _table2_rows(result)
        ],
        "table2_common_factor": result.common_factor,
        "table2_max_relative_error": largest_relative_error(result.table2),
        "grid_minima": {name: grid_minima(own).tolist() for name, own in result.grids.items()},
        "found_within": FOUND_WITHIN,
        "searches": [asdict(own) for own in result.searches],
        "truth": {name: true_absorption(name).tolist() for name in SPECIFICATIONS},
        "certified": {name: asdict(c) for name, c in result.certificates.items()},
    }


def paper_text(result: PaperResult) -> str:
    """Return the findings in words and tables of at most 100 columns."""
    worst = 100.0 * largest_relative_error(result.table2)
    parts = [
        RECONSTRUCTED,
        _arrivals_text(result),
        f"Table 2: every row with an error above {COMPARED_ABOVE:g} within {worst:.1f} % of the "
        "paper, after one common factor.",
        _problems_text(result),
    ]
    return "\n\n".join(parts)


def _arrivals_text(result: PaperResult) -> str:
    rows = []
    for r in result.responses:
        direct, first = PRINTED_ARRIVALS_MS[r.name]
        here = f"{r.direct_ms} / {r.first_reflection_ms}"
        rows.append((r.name, f"{here} ms, paper {direct} / {first} ms"))
    caption = "Arrival of direct sound / first reflection (1 ms bins), here and in the paper"
    return text_of(Table(caption, ("", ""), rows), indent="  ")


def _problems_text(result: PaperResult) -> str:
    """Return for every problem how often searches found it, and what is proven of its minimum."""
    own = {(s.problem, s.method): s for s in result.searches}
    rows = []
    for name, proof in result.certificates.items():
        searches = (own[name, method] for method in METHODS)
        cells = [f"{s.found} ({s.median_evaluations:.0f})" for s in searches]
        grid = str(len(grid_minima(result.grids[name]))) if name in result.grids else "-"
        single = len(proof.clusters) == 1 and proof.clusters[0].unique
        proven = "one minimum" if proof.complete and single else f"{len(proof.clusters)} regions"
        rows.append((name, *cells, grid, proven))
    caption = (
        f"Searches that found every absorption within {FOUND_WITHIN:g}, of {result.seeds} seeds "
        "(median evaluations)"
    )
    notes = (
        "  grid: minima of the paper's grid of 21 x 21. proven: no other absorption at all has an "
        "error",
        "  within 1e-08 of the lowest.",
    )
    return text_of(Table(caption, ("", *METHODS, "grid", "proven"), rows, notes), indent="  ")


_BLUE, _RED, _GREEN = OKABE_ITO[:3]
_LEVELS = np.logspace(-1.0, 5.0, 25)  # in the paper's unit of error
_TITLES = {"case1": "Case 1", "case2": "Case 2", "case3": "Case 3"}


def _figures(result: PaperResult) -> dict[str, Figure]:
    return {
        "figure2": _responses_figure(result.responses, 1),
        "figure3": _responses_figure(result.responses, 5),
        "figure4": _contours_figure(result),
        "figure5": _ill_defined_figure(result),
    }


def _responses_figure(responses: Sequence[CaseResponse], width_ms: int) -> Figure:
    """Return Figure 2 (1 ms bins) or 3 (5 ms windows): energy over time, one panel a case."""
    figure = _new_figure(9.0, 1.9 * len(responses) + 0.6)
    rows = figure.subplots(len(responses), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for axes, r in zip(rows, responses, strict=True):
        if width_ms == 1:
            axes.stairs(r.fine, np.arange(r.fine.size + 1.0), fill=True, color=_BLUE)
            marks = {"direct sound": r.direct_ms, "first reflection": r.first_reflection_ms}
        else:
            axes.stairs(r.windows, 1e3 * r.edges_s, fill=True, color=_BLUE)
            marks = {"from the first reflection": r.first_reflection_ms}
        for (text, at_ms), color in zip(marks.items(), (_RED, _GREEN), strict=False):
            axes.axvline(at_ms, color=color, lw=1.0, ls="--", label=f"{text} at {at_ms} ms")
        axes.legend(frameon=False, fontsize=9, title=_TITLES[r.name], alignment="right")
        axes.set_xlim(0.0, 200.0)
        axes.set_ylim(0.0, None)
    figure.supxlabel("time after emission (ms)", fontsize=10)
    figure.supylabel(f"energy in {width_ms:g} ms (unit of the paper)", fontsize=10)
    return figure


def _contours_figure(result: PaperResult) -> Figure:
    """Return Figure 4: contours of the error on the paper's grid, one panel a case."""
    figure = _new_figure(3.9 * len(CASES) + 0.8, 5.0)
    panels = figure.subplots(1, len(CASES), sharey=True, squeeze=False)[0]
    for axes, name in zip(panels, CASES, strict=True):
        drawn = _contours(axes, GRID, result.grids[name])
        _mark_minima(axes, result, name, grid_minima(result.grids[name]))
        axes.set_title(_TITLES[name], fontsize=10)
    _finish(figure, panels, drawn)
    return figure


def _ill_defined_figure(result: PaperResult) -> Figure:
    """Return Figure 5 twice: on the paper's grid, with its islands, and on a fine grid without."""
    errors = result.grids["ill_defined"]
    minima = grid_minima(errors)
    figure = _new_figure(9.6, 5.4)
    panels = figure.subplots(1, 2, sharey=True)
    _contours(panels[0], GRID, errors)
    drawn = _contours(panels[1], FINE_GRID, result.ill_defined_fine)
    _mark_minima(panels[0], result, "ill_defined", minima)
    _mark_minima(panels[1], result, "ill_defined", None)
    title = f"the paper's grid, 21 x 21: {len(minima) - 1} minima that are none"
    panels[0].set_title(title, fontsize=10)
    panels[1].set_title(f"{len(FINE_GRID)} x {len(FINE_GRID)}: one valley", fontsize=10)
    _finish(figure, panels, drawn)
    return figure


def _new_figure(width_in: float, height_in: float) -> Figure:
    """Return a figure that says above that the room is a reconstruction."""
    figure = new_figure(width_in, height_in)
    engine = figure.get_layout_engine()
    if isinstance(engine, ConstrainedLayoutEngine):
        engine.set(rect=(0.0, 0.0, 1.0, 1.0 - 0.25 / height_in))
    y = 1.0 - 0.05 / height_in
    figure.text(0.995, y, RECONSTRUCTED, fontsize=8, color="0.35", ha="right", va="top")
    return figure


def _contours(axes: Axes, grid: FloatArray, errors: FloatArray) -> ScalarMappable:
    norm = LogNorm(_LEVELS[0], _LEVELS[-1])
    shown = np.clip(errors.T, _LEVELS[0], _LEVELS[-1])
    filled = axes.contourf(grid, grid, shown, _LEVELS, norm=norm, cmap="viridis_r")
    axes.contour(grid, grid, shown, _LEVELS, colors="white", linewidths=0.4)
    axes.set_aspect("equal")
    axes.set_xlabel("absorption of floor and ceilings")
    return filled


def _mark_minima(axes: Axes, result: PaperResult, name: str, minima: FloatArray | None) -> None:
    """Mark the minima of the grid, where there is one, and those that are proven."""
    inside: dict[str, Any] = {"clip_on": False, "zorder": 5, "ls": "none", "mew": 1.8}
    if minima is not None:
        text = "minimum of the grid"
        axes.plot(*minima.T, marker="o", color=_RED, mfc="none", ms=9, label=text, **inside)
    proven = np.array([c.minimiser for c in result.certificates[name].clusters])
    text = "lowest error of all, proven"
    axes.plot(*proven.T, marker="x", color="black", ms=6, label=text, **inside)


def _finish(figure: Figure, panels: Sequence[Axes], drawn: ScalarMappable) -> None:
    panels[0].set_ylabel("absorption of walls")
    bar = figure.colorbar(drawn, ax=list(panels), shrink=0.8, ticks=10.0 ** np.arange(-1, 6))
    bar.ax.yaxis.set_major_formatter(LogFormatterSciNotation())
    bar.set_label("error (unit of the paper)")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=9)
