"""The pictures of Suh (2001) again, and those of what the paper left open.

The pictures of `roomfit paper`, from its result.

What `roomfit paper` leaves behind: paper.json, CSV tables and pictures.

The content of paper.json.

The CSV tables beside paper.json.

What `roomfit paper` says in the end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import LogFormatterSciNotation, MultipleLocator

import roomfit
from roomfit.cache import (
    check_output_folder,
    whole_output_folder,
    write_bytes_atomically,
    write_json_atomically,
    write_text_atomically,
)
from roomfit.io.encoding import csv_text
from roomfit.io.results import certificate_content
from roomfit.report.figures import OKABE_ITO, new_figure, png
from roomfit.solvers.search import Fit
from roomfit.suh2001.independent import PAIRS, IndependentRow
from roomfit.suh2001.landscape import Landscape
from roomfit.suh2001.repeat import (
    FOUND_WITHIN,
    LABELS,
    METHODS,
    CaseResponse,
    PaperResult,
    PaperSettings,
    Record,
    repeat_paper,
)
from roomfit.suh2001.room import (
    CASES,
    COMPARED_ABOVE,
    DIVISIONS,
    MATERIAL_PROBLEMS,
    N_RAYS,
    PRINTED_ARRIVALS_MS,
    RECONSTRUCTED,
    SPECIFICATIONS,
    TRUE_ABSORPTION,
)
from roomfit.typing import FloatArray, Progress


def paper_json(result: PaperResult) -> dict[str, Any]:
    """Return the content of paper.json."""
    table = result.table2
    return {
        "format": "roomfit-paper",
        "format_version": 1,
        "roomfit": roomfit.__version__,
        "room": RECONSTRUCTED,
        "rays": N_RAYS,
        "seeds": result.seeds,
        "arrivals_ms": {
            r.name: {"direct": r.direct_ms, "first_reflection": r.first_reflection_ms}
            for r in result.responses
        },
        "arrivals_ms_paper": {
            name: {"direct": direct, "first_reflection": first}
            for name, (direct, first) in PRINTED_ARRIVALS_MS.items()
        },
        "table2": [
            {"alpha1": float(a[0]), "alpha2": float(a[1]), "paper": float(p), "ours": float(o)}
            for a, p, o in zip(table.absorption, table.paper, table.ours, strict=True)
        ],
        "table2_common_factor": table.common_factor,
        "table2_max_relative_error": table.max_relative_error,
        "grid_minima": {name: _grid_minima(shape) for name, shape in result.landscapes.items()},
        "minima": {
            name: [[*x, e] for x, e in zip(m.x.tolist(), m.error.tolist(), strict=True)]
            for name, m in ((n, shape.minima) for n, shape in result.landscapes.items())
        },
        "identified": [_json_content_identified(record) for record in result.records],
        "walls_apart": _json_content_walls_apart(result),
        "certified": {name: certificate_content(c) for name, c in result.certificates.items()},
        "independent_rays": _json_content_independent_rays(result),
    }


def _grid_minima(shape: Landscape) -> dict[str, Any]:
    return {
        "four_neighbours": len(shape.four_neighbours),
        "eight_neighbours": len(shape.eight_neighbours),
        "four_neighbours_at": [list(x) for x in shape.four_neighbours],
        "eight_neighbours_at": [list(x) for x in shape.eight_neighbours],
    }


def _json_content_identified(record: Record) -> dict[str, Any]:
    wanted = SPECIFICATIONS[record.problem]
    return {
        "problem": record.problem,
        "in_paper": wanted.in_paper,
        "method": record.method,
        "materials": list(wanted.division.materials),
        "truth": record.true_absorption.tolist(),
        "worst_found": record.worst_found.tolist(),
        "largest_error": record.largest_error,
        "found_within": FOUND_WITHIN,
        "successes": record.successes,
        "seeds": record.seeds,
        "median_evaluations": record.median_evaluations,
        "median_seconds": record.median_seconds,
    }


def _json_content_walls_apart(result: PaperResult) -> dict[str, Any]:
    walls = result.walls_apart
    return {
        "problem": "case1",
        "materials": list(walls.materials),
        "truth": walls.true_absorption.tolist(),
        "answers": [
            {"absorption": x, "error": e, "descents": n}
            for x, e, n in zip(
                walls.answers.x.tolist(),
                walls.answers.error.tolist(),
                walls.answers.descents,
                strict=True,
            )
        ],
        "mirrored_error_of_trace": walls.mirrored_error_of_trace,
        "error_of_silence": walls.error_of_silence,
        "sentence": "Source and receiver of case 1 stand half way between the south and the north "
        "wall: exchanging the two changes nothing, and both answers are equally right. What little "
        "the trace says against the mirrored one is the asymmetry of its own rays.",
    }


def _json_content_independent_rays(result: PaperResult) -> dict[str, Any]:
    settings = result.independent_settings
    return {
        "measurement_rays": settings.measurement_rays * settings.measurement_parts,
        "repeats": settings.repeats,
        "method": "least-squares",
        "sentence": "Measurement and model have different rays. With the same rays the error is "
        "exactly 0 at the truth, which says nothing about a real room.",
        "truth": {str(n): list(division.true_absorption) for n, division in DIVISIONS.items()},
        "rows": [asdict(row) for row in result.independent],
    }


Row: TypeAlias = Sequence[object]


def paper_tables(result: PaperResult) -> dict[str, str]:
    """Return file name and text of every table."""
    return {
        "table2.csv": _tables_table2(result),
        "arrivals.csv": _tables_arrivals(result),
        "responses_1ms.csv": _responses_1ms(result),
        "responses_5ms.csv": _responses_5ms(result),
        "grid_errors.csv": _grid_errors(result),
        "minima.csv": _tables_minima(result),
        "search_paths.csv": _search_paths(result),
        "identified.csv": _tables_identified(result),
        "certified.csv": _tables_certified(result),
        "independent_rays.csv": _tables_independent_rays(result),
    }


def _csv(heading: Row, rows: Sequence[Row]) -> str:
    return csv_text(
        heading,
        ([f"{cell:.6g}" if isinstance(cell, float) else cell for cell in row] for row in rows),
    )


def _tables_table2(result: PaperResult) -> str:
    table = result.table2
    columns = np.column_stack((table.absorption, table.paper, table.ours))
    return _csv(("alpha1", "alpha2", "error_paper", "error_ours"), columns.tolist())


def _tables_arrivals(result: PaperResult) -> str:
    rows = [(r.name, r.direct_ms, r.first_reflection_ms) for r in result.responses]
    return _csv(("case", "direct_ms", "first_reflection_ms"), rows)


def _responses_1ms(result: PaperResult) -> str:
    columns = np.column_stack([r.fine for r in result.responses])
    rows = [(i, *energies) for i, energies in enumerate(columns.tolist())]
    return _csv(("from_ms", *CASES), rows)


def _responses_5ms(result: PaperResult) -> str:
    rows = [
        (r.name, round(1e3 * t), e)
        for r in result.responses
        for t, e in zip(r.edges_s[:-1].tolist(), r.windows.tolist(), strict=True)
    ]
    return _csv(("case", "from_ms", "energy"), rows)


def _grid_errors(result: PaperResult) -> str:
    rows = [
        (name, a, b, shape.errors[i, j].item())
        for name, shape in result.landscapes.items()
        for i, a in enumerate(shape.grid.tolist())
        for j, b in enumerate(shape.grid.tolist())
    ]
    return _csv(("problem", "alpha1", "alpha2", "error"), rows)


def _tables_minima(result: PaperResult) -> str:
    """Minima of the grid in either sense, and true ones with how many of 441 descents end there."""
    rows: list[Row] = []
    for name, shape in result.landscapes.items():
        rows += [(name, "grid, 4 neighbours", *x, "") for x in shape.four_neighbours]
        rows += [(name, "grid, 8 neighbours", *x, "") for x in shape.eight_neighbours]
        found = zip(shape.minima.x.tolist(), shape.minima.descents, strict=True)
        rows += [(name, "true", *x, n) for x, n in found]
    return _csv(("problem", "kind", "alpha1", "alpha2", "descents"), rows)


def _search_paths(result: PaperResult) -> str:
    rows = [
        (method, i, *x, e)
        for method, fit in result.case1_searches.items()
        for i, (x, e) in enumerate(zip(fit.trail.tolist(), fit.trail_cost.tolist(), strict=True))
    ]
    return _csv(("method", "step", "alpha1", "alpha2", "error"), rows)


def _tables_identified(result: PaperResult) -> str:
    rows = [
        (
            *(r.problem, r.method, len(r.true_absorption), r.successes, r.seeds, r.largest_error),
            *(r.median_evaluations, r.median_seconds),
        )
        for r in result.records
    ]
    heading = ("problem", "method", "materials", "successes", "seeds", "largest_error")
    return _csv((*heading, "median_evaluations", "median_seconds"), rows)


def _tables_certified(result: PaperResult) -> str:
    """What is proven of each problem: how low, in how many places, and with how much work."""
    rows = [
        (
            *(name, len(c.coordinates), c.status, len(c.clusters)),
            sum(cluster.unique for cluster in c.clusters),
            *(c.value, c.lower_bound, c.delta, c.boxes, c.seconds),
        )
        for name, c in result.certificates.items()
    ]
    heading = ("problem", "materials", "status", "clusters", "proven_single", "value")
    return _csv((*heading, "lower_bound", "delta", "boxes", "seconds"), rows)


def _tables_independent_rays(result: PaperResult) -> str:
    rows = [asdict(row) for row in result.independent]
    return _csv(tuple(rows[0]), [tuple(row.values()) for row in rows])


def paper_text(result: PaperResult) -> str:
    """Return the findings in words and tables of at most 100 columns."""
    parts = [RECONSTRUCTED, _text_arrivals(result), _text_table2(result), _text_minima(result)]
    parts += [
        _searches(result),
        _text_walls_apart(result),
        _text_certified(result),
        _text_independent(result),
    ]
    return "\n\n".join(parts)


def _text_arrivals(result: PaperResult) -> str:
    lines = ["Arrival of direct sound / first reflection (1 ms bins), here and in the paper"]
    for r in result.responses:
        direct, first = PRINTED_ARRIVALS_MS[r.name]
        here = f"{r.direct_ms} / {r.first_reflection_ms}"
        lines.append(f"  {r.name}  {here} ms, paper {direct} / {first} ms")
    return "\n".join(lines)


def _text_table2(result: PaperResult) -> str:
    worst = 100.0 * result.table2.max_relative_error
    return (
        f"Table 2: every row with an error above {COMPARED_ABOVE:g} within {worst:.1f} % of the "
        "paper, after one common factor."
    )


def _text_minima(result: PaperResult) -> str:
    lines = [
        "Minima of the error over two absorption coefficients: of the 21 x 21 grid (4 and 8 "
        "neighbours),",
        "and true ones, where descents from all 441 grid points end",
    ]
    lines += [_minima_line(name, shape) for name, shape in result.landscapes.items()]
    shape = result.landscapes["ill_defined"]
    islands = len(shape.four_neighbours) - len(shape.minima.x)
    lines.append(
        f"The islands of Figure 5 are {islands} minima of the grid which the function does not "
        "have:\nits one narrow valley runs askew to the grid."
    )
    return "\n".join(lines)


def _minima_line(name: str, shape: Landscape) -> str:
    true = ", ".join(f"({x[0]:.3f}, {x[1]:.3f})" for x in shape.minima.x)
    counts = f"{len(shape.four_neighbours):2d} {len(shape.eight_neighbours):2d}"
    return f"  {name:<29} {counts}   true: {len(shape.minima.x)} at {true}"


def _searches(result: PaperResult) -> str:
    lines = [
        f"Searches that found every absorption within 0.005, of {result.seeds} seeds "
        "(median evaluations)",
        f"  {'':<29}" + "".join(f"{_SHORT[method]:>14}" for method in METHODS),
    ]
    records = {(r.problem, r.method): r for r in result.records}
    for problem, wanted in SPECIFICATIONS.items():
        cells = "".join(f"{_cell(records[problem, method]):>14}" for method in METHODS)
        mark = "" if wanted.in_paper else " *"
        lines.append(f"  {problem + mark:<29}{cells}")
    lines += [
        "  * not in the paper. least squares: from the one absorption that the decay gives,",
        "  then random points; one start: from one random point alone",
    ]
    return "\n".join(lines)


_SHORT = {
    "annealing+simplex": "annealing",
    "simplex": "simplex",
    "simplex-as-printed": "as printed",
    "least-squares": "least squares",
    "least-squares-one-random-start": "one start",
}


def _cell(record: Record) -> str:
    return f"{record.successes} ({record.median_evaluations:.0f})"


def _text_walls_apart(result: PaperResult) -> str:
    walls = result.walls_apart
    lines = [
        "Case 1 with its four walls taken apart: source and receiver stand half way between south "
        "and north,",
        f"and {len(walls.answers.x)} answers are equally right:",
    ]
    for x, e in zip(walls.answers.x, walls.answers.error, strict=True):
        named = ", ".join(
            f"{name} {value:.3f}" for name, value in zip(walls.materials, x, strict=True)
        )
        lines.append(f"  {named}: error {e:.1e}")
    against, silence = walls.mirrored_error_of_trace, walls.error_of_silence
    lines.append(
        f"(With the rays as traced the mirrored one has the error {against:.3f}, black walls "
        f"{silence:.0f}:\nthe asymmetry of these rays, which a measurement would not share.)"
    )
    return "\n".join(lines)


def _text_certified(result: PaperResult) -> str:
    lines = [
        "Certified: no absorption at all errs less, and only in these places is the error within "
        "1e-08 of it",
        f"  {'':<29}{'materials':>10}{'places':>8}{'boxes':>8}   proven to hold one minimum each",
    ]
    for name, c in result.certificates.items():
        single = sum(cluster.unique for cluster in c.clusters)
        outcome = "all" if single == len(c.clusters) else f"{single} of {len(c.clusters)}"
        if c.status != "certified":
            outcome = f"{c.status}: at best {c.value - c.lower_bound:.1e} better"
        lines.append(
            f"  {name:<29}{len(c.coordinates):>10}{len(c.clusters):>8}{c.boxes:>8}   {outcome}"
        )
    lines.append("  (of these rays: what other rays would change is not in it)")
    return "\n".join(lines)


def _text_independent(result: PaperResult) -> str:
    rays = [r.rays for r in result.independent if (r.pairs, r.materials) == (1, 2)]
    lines = [
        "The same with other rays for the measurement than for the model: rms error of the found "
        "absorption",
        f"  {'pairs, materials':<18}" + "".join(f"{n:>9,}" for n in rays) + "  rays",
    ]
    for pairs in (1, 3):
        for materials in DIVISIONS:
            own = [r for r in result.independent if (r.pairs, r.materials) == (pairs, materials)]
            lines.append(f"  {f'{pairs}, {materials}':<18}" + "".join(_error_cell(r) for r in own))
    return "\n".join(lines)


def _error_cell(row: IndependentRow) -> str:
    return f"{row.rms_error:>9.3f}"


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
    shape: Landscape, fits: Mapping[str, Fit], true_absorption: tuple[float, float], note: str
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
        axes.plot(
            *true_absorption, marker="x", color=_RED, mew=2, ms=11, label="true absorption", **style
        )
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


_TITLES = {"case1": "Case 1", "case2": "Case 2", "case3": "Case 3"}


def paper_figures(result: PaperResult) -> dict[str, Figure]:
    """Return file name and picture of everything that is drawn."""
    landscapes = result.landscapes
    cases = {_TITLES[name]: landscapes[name] for name in CASES}
    note = RECONSTRUCTED
    searches = {LABELS[method]: fit for method, fit in result.case1_searches.items()}
    return {
        "figure2.png": responses_figure([_fine_panel(r) for r in result.responses], note),
        "figure3.png": responses_figure([_window_panel(r) for r in result.responses], note),
        "figure4.png": contours_figure(cases, note),
        "figure5.png": ill_defined_figure(landscapes["ill_defined"], result.ill_defined_fine, note),
        "search_paths.png": search_paths_figure(
            landscapes["case1"], searches, TRUE_ABSORPTION, note
        ),
        "methods.png": _methods(result),
        "independent_rays.png": _figures_independent(result),
    }


def _fine_panel(response: CaseResponse) -> ResponsePanel:
    marks = {
        "direct sound": response.direct_ms,
        "first reflection": response.first_reflection_ms,
    }
    edges_ms: FloatArray = np.arange(response.fine.size + 1.0)
    return ResponsePanel(_TITLES[response.name], edges_ms, response.fine, marks)


def _window_panel(response: CaseResponse) -> ResponsePanel:
    marks = {"from the first reflection": response.first_reflection_ms}
    return ResponsePanel(_TITLES[response.name], 1e3 * response.edges_s, response.windows, marks)


def _methods(result: PaperResult) -> Figure:
    records = {(r.problem, r.method): r for r in result.records}
    numbers = np.array(list(MATERIAL_PROBLEMS), dtype=np.float64)
    evaluations, successes = [], []
    for method in METHODS:
        own = [records[problem, method] for problem in MATERIAL_PROBLEMS.values()]
        counts = np.array([r.median_evaluations for r in own])
        rates = np.array([100.0 * r.successes / r.seeds for r in own])
        evaluations.append(Curve(LABELS[method], numbers, counts))
        successes.append(Curve(LABELS[method], numbers, rates))
    return methods_figure(evaluations, successes, RECONSTRUCTED)


def _figures_independent(result: PaperResult) -> Figure:
    panels = {}
    for pairs in PAIRS:
        curves = []
        for materials in DIVISIONS:
            own = [r for r in result.independent if (r.pairs, r.materials) == (pairs, materials)]
            rays = np.array([float(r.rays) for r in own])
            errors = np.array([r.rms_error for r in own])
            curves.append(Curve(f"{materials} materials", rays, errors))
        title = "one pair (case 3)" if pairs == 1 else "three pairs (cases 1 to 3)"
        panels[title] = curves
    return independent_figure(panels, RECONSTRUCTED)


def run_paper(
    folder: Path,
    settings: PaperSettings | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> PaperResult:
    """Repeat the paper and write paper.json, CSV tables and pictures into a folder.

    Nothing is written before everything is known.

    Raises
    ------
    InputError
        The folder exists and is not empty, and `overwrite` is false.
    """
    check_output_folder(folder, overwrite=overwrite)
    result = repeat_paper(settings, progress=progress)
    with whole_output_folder(folder, overwrite=overwrite) as aside:
        for name, text in paper_tables(result).items():
            write_text_atomically(aside / name, text)
        for name, figure in paper_figures(result).items():
            write_bytes_atomically(aside / name, png(figure))
        write_json_atomically(aside / "paper.json", paper_json(result))
    return result
