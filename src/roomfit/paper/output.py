"""What ``roomfit paper`` leaves behind: paper.json, CSV tables, the paper's figures, its text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
from matplotlib.ticker import LogFormatterSciNotation, MultipleLocator

from roomfit.base.table import Column, Table, Value, csv_of, text_of
from roomfit.base.typing import FloatArray, Progress
from roomfit.base.whole_files import (
    check_output_folder,
    sole_writer,
    whole_output_folder,
    write_bytes_atomically,
    write_json_atomically,
    write_text_atomically,
)
from roomfit.paper.certificate_record import Certificate
from roomfit.paper.independent import (
    MEASUREMENT_PARTS,
    MEASUREMENT_RAYS,
    PAIRS,
    IndependentRow,
)
from roomfit.paper.repeat import (
    FOUND_WITHIN,
    METHODS,
    CaseResponse,
    PaperResult,
    Record,
    repeat_paper,
)
from roomfit.paper.room import (
    CASES,
    COMPARED_ABOVE,
    DIVISIONS,
    MATERIAL_PROBLEMS,
    N_RAYS,
    PRINTED_ARRIVALS_MS,
    RECONSTRUCTED,
    SPECIFICATIONS,
    TRUE_ABSORPTION,
    WALLS_APART,
)
from roomfit.paper.searches import Landscape
from roomfit.report.figures import OKABE_ITO, new_figure, png


@sole_writer
def run_paper(
    folder: Path,
    *,
    seeds: int = 50,
    workers: int = 2,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> PaperResult:
    """Repeat the paper and write paper.json, CSV tables and pictures into a folder.

    Nothing is written before everything is known. Seeds and workers are those of `repeat_paper`.

    Raises
    ------
    InputError
        The folder exists and is not empty, and `overwrite` is false.
    """
    check_output_folder(folder, overwrite=overwrite)
    result = repeat_paper(seeds, workers, progress=progress)
    with whole_output_folder(folder, overwrite=overwrite) as aside:
        for name, table in _tables(result).items():
            write_text_atomically(aside / f"{name}.csv", csv_of(table))
        for name, figure in _figures(result).items():
            write_bytes_atomically(aside / f"{name}.png", png(figure))
        write_json_atomically(aside / "paper.json", paper_json(result))
    return result


def paper_json(result: PaperResult) -> dict[str, Any]:
    """Return the content of paper.json."""
    table = result.table2
    return {
        "format": "roomfit-paper",
        "format_version": 1,
        "roomfit": version("roomfit"),
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
        "grid_minima": {
            name: {
                "four_neighbours": len(shape.four_neighbours),
                "eight_neighbours": len(shape.eight_neighbours),
                "four_neighbours_at": [list(x) for x in shape.four_neighbours],
                "eight_neighbours_at": [list(x) for x in shape.eight_neighbours],
            }
            for name, shape in result.landscapes.items()
        },
        "minima": {
            name: np.column_stack((shape.minima.x, shape.minima.error)).tolist()
            for name, shape in result.landscapes.items()
        },
        "identified": [_identified_content(record) for record in result.records],
        "walls_apart": _walls_apart_content(result),
        "certified": {name: _certificate_content(c) for name, c in result.certificates.items()},
        "independent_rays": {
            "measurement_rays": MEASUREMENT_RAYS * MEASUREMENT_PARTS,
            "repeats": result.independent[0].repeats,
            "method": "least-squares",
            "sentence": "Measurement and model have different rays. With the same rays the error "
            "is exactly 0 at the truth, which says nothing about a real room.",
            "truth": {str(n): list(division.true_absorption) for n, division in DIVISIONS.items()},
            "rows": [asdict(row) for row in result.independent],
        },
    }


def _certificate_content(certificate: Certificate) -> dict[str, Any]:
    """Return the content of a certificate; absorptions in the order of the names."""
    return {
        "status": certificate.status,
        "sentence": certificate.sentence,
        "unknowns": certificate.coordinates,
        "value": certificate.value,
        "lower_bound": certificate.lower_bound,
        "delta": certificate.delta,
        "clusters": [asdict(c) for c in certificate.clusters],
        "open": certificate.n_open,
        "boxes": certificate.boxes,
        "seconds": round(certificate.seconds, 3),
    }


def _identified_content(record: Record) -> dict[str, Any]:
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


def _walls_apart_content(result: PaperResult) -> dict[str, Any]:
    walls = result.walls_apart
    return {
        "problem": "case1",
        "materials": list(WALLS_APART.materials),
        "truth": list(WALLS_APART.true_absorption),
        "answers": [
            {"absorption": x, "error": e, "descents": n}
            for x, e, n in zip(walls.x.tolist(), walls.error.tolist(), walls.descents, strict=True)
        ],
        "mirrored_error_of_trace": result.mirrored_error_of_trace,
        "error_of_silence": result.error_of_silence,
        "sentence": "Source and receiver of case 1 stand half way between the south and the north "
        "wall: exchanging the two changes nothing, and both answers are equally right. What little "
        "the trace says against the mirrored one is the asymmetry of its own rays.",
    }


def _tables(result: PaperResult) -> dict[str, Table]:
    """Return every CSV table by its name."""
    table, shapes, responses = result.table2, result.landscapes, result.responses
    searched = (
        *("problem", "method", "materials", "successes", "seeds", "largest_error"),
        *("median_evaluations", "median_seconds"),
    )
    proven = (
        *("problem", "materials", "status", "clusters", "proven_single", "value"),
        *("lower_bound", "delta", "boxes", "seconds"),
    )
    records = [
        [len(r.true_absorption) if n == "materials" else getattr(r, n) for n in searched]
        for r in result.records
    ]
    energies = np.column_stack([r.fine for r in responses]).tolist()
    independent = [asdict(row) for row in result.independent]
    described: dict[str, tuple[Sequence[str], Sequence[Sequence[Value]]]] = {
        "table2": (
            ("alpha1", "alpha2", "error_paper", "error_ours"),
            np.column_stack((table.absorption, table.paper, table.ours)).tolist(),
        ),
        "arrivals": (
            ("case", "direct_ms", "first_reflection_ms"),
            [(r.name, r.direct_ms, r.first_reflection_ms) for r in responses],
        ),
        "responses_1ms": (("from_ms", *CASES), [(i, *e) for i, e in enumerate(energies)]),
        "responses_5ms": (
            ("case", "from_ms", "energy"),
            [
                (r.name, round(1e3 * t), e)
                for r in responses
                for t, e in zip(r.edges_s[:-1].tolist(), r.windows.tolist(), strict=True)
            ],
        ),
        "grid_errors": (
            ("problem", "alpha1", "alpha2", "error"),
            [
                (name, a, b, shape.errors[i, j].item())
                for name, shape in shapes.items()
                for i, a in enumerate(shape.grid.tolist())
                for j, b in enumerate(shape.grid.tolist())
            ],
        ),
        "minima": (("problem", "kind", "alpha1", "alpha2", "descents"), _minima_rows(shapes)),
        "search_paths": (
            ("method", "step", "alpha1", "alpha2", "error"),
            [
                (name, i, *x, e)
                for name, fit in result.case1_searches.items()
                for i, (*x, e) in enumerate(np.column_stack((fit.trail, fit.trail_cost)).tolist())
            ],
        ),
        "identified": (searched, records),
        "certified": (proven, _certified_rows(result)),
        "independent_rays": (tuple(independent[0]), [tuple(r.values()) for r in independent]),
    }
    return {
        name: Table("", columns, rows, form=".6g") for name, (columns, rows) in described.items()
    }


def _minima_rows(shapes: Mapping[str, Landscape]) -> list[Sequence[Value]]:
    """Return minima of the grid in either sense, and true ones with how many descents end there."""
    rows: list[Sequence[Value]] = []
    for name, shape in shapes.items():
        rows += [(name, "grid, 4 neighbours", *x, "") for x in shape.four_neighbours]
        rows += [(name, "grid, 8 neighbours", *x, "") for x in shape.eight_neighbours]
        found = zip(shape.minima.x.tolist(), shape.minima.descents, strict=True)
        rows += [(name, "true", *x, n) for x, n in found]
    return rows


def _certified_rows(result: PaperResult) -> list[Sequence[Value]]:
    """Return what is proven of each problem: how low, in how many boxes, with how much work."""
    rows: list[Sequence[Value]] = []
    for name, c in result.certificates.items():
        single = sum(cluster.unique for cluster in c.clusters)
        proven = (name, len(c.coordinates), c.status, len(c.clusters), single)
        rows.append((*proven, c.value, c.lower_bound, c.delta, c.boxes, c.seconds))
    return rows


def paper_text(result: PaperResult) -> str:
    """Return the findings in words and tables of at most 100 columns."""
    worst = 100.0 * result.table2.max_relative_error
    parts = [
        RECONSTRUCTED,
        _arrivals_text(result),
        f"Table 2: every row with an error above {COMPARED_ABOVE:g} within {worst:.1f} % of the "
        "paper, after one common factor.",
        _minima_text(result),
        _searches_text(result),
        _walls_apart_text(result),
        _certified_text(result),
        _independent_text(result),
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


def _minima_text(result: PaperResult) -> str:
    lines = [
        "Minima of the error over two absorption coefficients: of the 21 x 21 grid (4 and 8 "
        "neighbours),",
        "and true ones, where descents from all 441 grid points end",
    ]
    for name, shape in result.landscapes.items():
        true = ", ".join(f"({x[0]:.3f}, {x[1]:.3f})" for x in shape.minima.x)
        counts = f"{len(shape.four_neighbours):2d} {len(shape.eight_neighbours):2d}"
        lines.append(f"  {name:<29} {counts}   true: {len(shape.minima.x)} at {true}")
    shape = result.landscapes["ill_defined"]
    islands = len(shape.four_neighbours) - len(shape.minima.x)
    lines.append(
        f"The islands of Figure 5 are {islands} minima of the grid which the function does not "
        "have:\nits one narrow valley runs askew to the grid."
    )
    return "\n".join(lines)


def _searches_text(result: PaperResult) -> str:
    rows = []
    records = {(r.problem, r.method): r for r in result.records}
    for problem, wanted in SPECIFICATIONS.items():
        own = (records[problem, method] for method in METHODS)
        cells = (f"{r.successes} ({r.median_evaluations:.0f})" for r in own)
        rows.append((problem + ("" if wanted.in_paper else " *"), *cells))
    caption = (
        f"Searches that found every absorption within 0.005, of {result.seeds} seeds "
        "(median evaluations)"
    )
    notes = (
        "  * not in the paper. least squares: from the one absorption that the decay gives,",
        "  then random points; one start: from one random point alone",
    )
    columns = ("", *(method.heading for method in METHODS.values()))
    return text_of(Table(caption, columns, rows, notes), indent="  ")


def _walls_apart_text(result: PaperResult) -> str:
    walls = result.walls_apart
    lines = [
        "Case 1 with its four walls taken apart: source and receiver stand half way between south "
        "and north,",
        f"and {len(walls.x)} answers are equally right:",
    ]
    for x, e in zip(walls.x, walls.error, strict=True):
        named = ", ".join(
            f"{name} {value:.3f}" for name, value in zip(WALLS_APART.materials, x, strict=True)
        )
        lines.append(f"  {named}: error {e:.1e}")
    against, silence = result.mirrored_error_of_trace, result.error_of_silence
    lines.append(
        f"(With the rays as traced the mirrored one has the error {against:.3f}, black walls "
        f"{silence:.0f}:\nthe asymmetry of these rays, which a measurement would not share.)"
    )
    return "\n".join(lines)


def _certified_text(result: PaperResult) -> str:
    rows = []
    for name, c in result.certificates.items():
        single = sum(cluster.unique for cluster in c.clusters)
        outcome = "all" if single == len(c.clusters) else f"{single} of {len(c.clusters)}"
        if c.status != "certified":
            outcome = f"{c.status}: at best {c.value - c.lower_bound:.1e} better"
        rows.append((name, len(c.coordinates), len(c.clusters), c.boxes, outcome))
    outcomes = Column("proven to hold one minimum each", align="<")
    caption = (
        "Certified: no absorption at all errs less, and only in these regions is the error within "
        "1e-08 of it"
    )
    columns = ("", "materials", "regions", "boxes", outcomes)
    notes = ("  (of these rays: what other rays would change is not in it)",)
    return text_of(Table(caption, columns, rows, notes), indent="  ")


def _independent_text(result: PaperResult) -> str:
    rays = [f"{r.rays:,}" for r in _rows_of(result, 1, 2)]
    rows = [
        (f"{pairs}, {materials}", *(r.rms_error for r in _rows_of(result, pairs, materials)))
        for pairs in (1, 3)
        for materials in DIVISIONS
    ]
    caption = (
        "The same with other rays for the measurement than for the model: rms error of the found "
        "absorption"
    )
    columns = ("pairs, materials", *rays[:-1], f"{rays[-1]} rays")
    return text_of(Table(caption, columns, rows, form=".3f"), indent="  ")


def _rows_of(result: PaperResult, pairs: int, materials: int) -> list[IndependentRow]:
    return [r for r in result.independent if (r.pairs, r.materials) == (pairs, materials)]


_BLUE, _RED, _GREEN = OKABE_ITO[:3]
_MARKERS = "osD^vP"
_LEVELS = np.logspace(-1.0, 5.0, 25)  # in the paper's unit of error
_AXIS_LABELS = ("absorption of floor and ceilings", "absorption of walls")
_TITLES = {"case1": "Case 1", "case2": "Case 2", "case3": "Case 3"}


def _figures(result: PaperResult) -> dict[str, Figure]:
    """Return name and picture of everything that is drawn."""
    return {
        "figure2": _responses_figure(result.responses, 1),
        "figure3": _responses_figure(result.responses, 5),
        "figure4": _contours_figure({_TITLES[name]: result.landscapes[name] for name in CASES}),
        "figure5": _ill_defined_figure(result.landscapes["ill_defined"], result.ill_defined_fine),
        "search_paths": _search_paths_figure(result),
        "methods": _methods_figure(result),
        "independent_rays": _independent_figure(result),
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


def _contours_figure(shapes: Mapping[str, Landscape]) -> Figure:
    """Return Figure 4: contours of the error on the paper's grid, one panel a case."""
    figure = _new_figure(3.9 * len(shapes) + 0.8, 5.0)
    panels = figure.subplots(1, len(shapes), sharey=True, squeeze=False)[0]
    for axes, (title, shape) in zip(panels, shapes.items(), strict=True):
        drawn = _contours(axes, shape.grid, shape.errors)
        _mark_minima(axes, shape)
        axes.set_title(title, fontsize=10)
    panels[0].set_ylabel(_AXIS_LABELS[1])
    _error_bar(figure, panels, drawn)
    _legend_below(figure, panels[0])
    return figure


def _ill_defined_figure(shape: Landscape, fine_errors: FloatArray) -> Figure:
    """Return Figure 5 twice: on the paper's grid, with its islands, and on a fine grid without."""
    figure = _new_figure(9.6, 5.4)
    panels = figure.subplots(1, 2, sharey=True)
    fine = np.linspace(0.0, 1.0, len(fine_errors))
    _contours(panels[0], shape.grid, shape.errors)
    drawn = _contours(panels[1], fine, fine_errors)
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


def _search_paths_figure(result: PaperResult) -> Figure:
    """Return the trail of each search of case 1 over the contours of its error."""
    shape, fits = result.landscapes["case1"], result.case1_searches
    columns = min(len(fits), 2)
    rows = -(-len(fits) // columns)
    figure = _new_figure(4.6 * columns, 4.6 * rows + 0.7)
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
            *TRUE_ABSORPTION, marker="x", color=_RED, mew=2, ms=11, label="true absorption", **style
        )
        axes.set_title(f"{METHODS[method].label}: {fit.evaluations} evaluations", fontsize=10)
        axes.set_aspect("equal")
    for axes in panels[-columns:]:
        axes.set_xlabel(_AXIS_LABELS[0])
    for axes in panels[::columns]:
        axes.set_ylabel(_AXIS_LABELS[1])
    handles, labels = panels[0].get_legend_handles_labels()
    title = "points from dark (first) to light (last); contours as in Figure 4, case 1"
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, title=title)
    return figure


def _methods_figure(result: PaperResult) -> Figure:
    """Return evaluations and rate of success over the number of materials, for each method."""
    records = {(r.problem, r.method): r for r in result.records}
    n_materials = np.array(list(MATERIAL_PROBLEMS), dtype=np.float64)
    figure = _new_figure(9.6, 4.0)
    left, right = figure.subplots(1, 2)
    width = 0.8 / len(METHODS)
    for i, (name, method) in enumerate(METHODS.items()):
        own = [records[problem, name] for problem in MATERIAL_PROBLEMS.values()]
        style: dict[str, Any] = {"color": OKABE_ITO[i], "marker": _MARKERS[i], "ms": 6, "lw": 1.2}
        left.plot(n_materials, [r.median_evaluations for r in own], label=method.label, **style)
        rates = [100.0 * r.successes / r.seeds for r in own]
        aside = width * (i - 0.5 * (len(METHODS) - 1))
        right.bar(n_materials + aside, rates, width, color=OKABE_ITO[i])
    left.set_yscale("log")
    left.set_ylabel("evaluations of the error (median)")
    right.set_ylabel("searches that found the truth (%)")
    for axes in (left, right):
        axes.xaxis.set_major_locator(MultipleLocator(1))
        axes.set_xlabel("number of materials")
        axes.grid(alpha=0.25, axis="y")
    _legend_below(figure, left)
    return figure


def _independent_figure(result: PaperResult) -> Figure:
    """Return the error of the found absorption over the number of the model's rays."""
    figure = _new_figure(9.6, 4.6)
    panels = figure.subplots(1, len(PAIRS), sharey=True, squeeze=False)[0]
    for axes, pairs in zip(panels, PAIRS, strict=True):
        for i, materials in enumerate(DIVISIONS):
            own = _rows_of(result, pairs, materials)
            style: dict[str, Any] = {"color": OKABE_ITO[i], "marker": _MARKERS[i], "ms": 5}
            rays, errors = [r.rays for r in own], [r.rms_error for r in own]
            axes.loglog(rays, errors, label=f"{materials} materials", lw=1.4, **style)
        title = "one pair (case 3)" if pairs == 1 else "three pairs (cases 1 to 3)"
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("rays of the model for each source")
        axes.axvline(18_000, color="0.5", lw=1.0, ls=":")
        axes.text(19_500, 0.0012, "the paper's 18,000", color="0.35", fontsize=8, rotation=90)
        axes.grid(alpha=0.25, which="both")
    panels[0].set_ylabel("rms error of the found absorption")
    _legend_below(figure, panels[0], 6)
    return figure


def _new_figure(width_in: float, height_in: float) -> Figure:
    """Return a figure that says above that the room is a reconstruction."""
    figure = new_figure(width_in, height_in, formulas=True)
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


def _legend_below(figure: Figure, axes: Axes, n_columns: int = 3) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=n_columns, frameon=False, fontsize=9
    )
