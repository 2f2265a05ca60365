"""The results of Suh (2001) on the reconstructed room: Figures 2 to 5, Table 2 and its searches.

Beside them a proof for every problem: how low its error can be, and where.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import LogFormatterSciNotation

from roomfit.base import whole_files
from roomfit.base.arguments import check_range
from roomfit.base.forks import in_forks
from roomfit.base.table import Table, csv_of, text_of
from roomfit.base.typing import FloatArray, Progress
from roomfit.fit.simplex import anneal, downhill_simplex, random_simplex
from roomfit.paper import room
from roomfit.paper.proof import Certificate, certify
from roomfit.report.figures import new_figure, png
from roomfit.report.wording import OKABE_ITO
from roomfit.tracing.paths import Paths


@whole_files.sole_writer
def run_paper(
    out: Path, *, seeds: int = 10, overwrite: bool = False, progress: Progress | None = None
) -> str:
    """Repeat the paper; write paper.json, table2.csv and pictures; return what was found.

    Nothing is written before everything is known. Seeds are those of `repeat_paper`.
    """
    whole_files.check_output_folder(out, overwrite=overwrite)
    result = repeat_paper(seeds, progress=progress)
    columns = ("alpha1", "alpha2", "error_paper", "error_ours")
    table = Table("", columns, _table2_rows(result), form=".6g")
    with whole_files.whole_output_folder(out, overwrite=overwrite) as aside:
        whole_files.write_text_atomically(aside / "table2.csv", csv_of(table))
        for name, figure in _figures(result).items():
            whole_files.write_bytes_atomically(aside / f"{name}.png", png(figure))
        whole_files.write_json_atomically(aside / "paper.json", paper_json(result))
    return paper_text(result)


def _table2_rows(result: PaperResult) -> list[list[float]]:
    rows: list[list[float]] = np.column_stack((room.TABLE2, result.table2)).tolist()
    return rows


def paper_json(result: PaperResult) -> dict[str, Any]:
    """Return the content of paper.json."""
    return {
        "format": "roomfit-paper",
        "format_version": 2,
        "roomfit": version("roomfit"),
        "room": room.RECONSTRUCTED,
        "rays": room.N_RAYS,
        "seeds": result.seeds,
        "arrivals_ms": {r.name: [r.direct_ms, r.first_reflection_ms] for r in result.responses},
        "arrivals_ms_paper": {name: list(ms) for name, ms in room.PRINTED_ARRIVALS_MS.items()},
        "table2": [
            dict(zip(("alpha1", "alpha2", "paper", "ours"), row, strict=True))
            for row in _table2_rows(result)
        ],
        "table2_common_factor": result.common_factor,
        "table2_max_relative_error": largest_relative_error(result.table2),
        "grid_minima": {name: grid_minima(own).tolist() for name, own in result.grids.items()},
        "found_within": FOUND_WITHIN,
        "searches": [own._asdict() for own in result.searches],
        "truth": {name: room.true_absorption(name).tolist() for name in room.SPECIFICATIONS},
        "certified": {
            name: {**own._asdict(), "clusters": [c._asdict() for c in own.clusters]}
            for name, own in result.certificates.items()
        },
    }


def paper_text(result: PaperResult) -> str:
    """Return the findings in words and tables of at most 100 columns."""
    worst = 100.0 * largest_relative_error(result.table2)
    parts = [
        room.RECONSTRUCTED,
        _arrivals_text(result),
        f"Table 2: every row with an error above {room.COMPARED_ABOVE:g} within {worst:.1f} % of "
        "the paper, after one common factor.",
        _problems_text(result),
    ]
    return "\n\n".join(parts)


def _arrivals_text(result: PaperResult) -> str:
    rows = []
    for r in result.responses:
        direct, first = room.PRINTED_ARRIVALS_MS[r.name]
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
    figure = _new_figure(3.9 * len(room.CASES) + 0.8, 5.0)
    panels = figure.subplots(1, len(room.CASES), sharey=True, squeeze=False)[0]
    for axes, name in zip(panels, room.CASES, strict=True):
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
    figure.text(0.995, y, room.RECONSTRUCTED, fontsize=8, color="0.35", ha="right", va="top")
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


METHODS = ("simplex", "annealing")
# Largest error of any absorption that still counts as found.
FOUND_WITHIN = 0.005
GRID = np.arange(21) / 20  # of absorptions, the paper's
FINE_GRID = np.linspace(0.0, 1.0, 201)


class CaseResponse(NamedTuple):
    """Energy responses of one case at the true absorption (Figures 2 and 3)."""

    name: str
    direct_ms: int  # 1 ms bin of arrival
    first_reflection_ms: int
    fine: FloatArray  # (200,), energy of each 1 ms bin from emission on, in the paper's unit
    edges_s: FloatArray  # (n_windows + 1,)
    windows: FloatArray  # (n_windows,), energy of each 5 ms window from the first reflection on


class Searches(NamedTuple):
    """All searches of one problem by one method."""

    problem: str
    method: str
    found: int  # how many came within `FOUND_WITHIN` of every absorption
    largest_error: float  # of any absorption
    median_evaluations: float


class PaperResult(NamedTuple):
    """The results of `roomfit paper`."""

    seeds: int
    responses: tuple[CaseResponse, ...]
    table2: FloatArray  # (n_rows,), our errors in the rows of `TABLE2`, after the common factor
    common_factor: float  # near 1, for the unit of energy was found in the same way
    # by name, of the problems of two materials (Figures 4 and 5): the error on the paper's grid,
    # (21, 21), first absorption along the first axis
    grids: Mapping[str, FloatArray]
    ill_defined_fine: FloatArray  # (201, 201): the error of Figure 5, on a grid ten times finer
    searches: tuple[Searches, ...]
    certificates: Mapping[str, Certificate]  # by name, of every problem


def repeat_paper(seeds: int, *, progress: Progress | None = None) -> PaperResult:
    """Return the results of the paper.

    Every search depends on its problem, its method and its seed alone.

    `seeds`: searches of every problem by every method, 1 to 100,000.
    """
    check_range("number of seeds", seeds, 1, 100_000)
    shapes = sorted({s.shape for s in room.SPECIFICATIONS.values()})
    paths = {shape: room.trace_paper_room(room.paper_scene(shape)) for shape in shapes}
    problems = {n: room.paper_problem(n, paths[s.shape]) for n, s in room.SPECIFICATIONS.items()}
    searched = [(name, method) for method in reversed(METHODS) for name in problems]

    def found(i: int) -> Searches:
        if progress is not None:
            progress(i / len(searched))
        name, method = searched[i]
        return _searches(problems[name], name, method, seeds)

    errors, factor = table2(problems["case1"])
    return PaperResult(
        seeds,
        case_responses(paths["paper"]),
        errors,
        factor,
        {n: grid_errors(p, GRID) for n, p in problems.items() if len(p.rows.materials) == 2},
        grid_errors(problems["ill_defined"], FINE_GRID),
        tuple(in_forks(found, range(len(searched)))),
        {name: certify(problem) for name, problem in problems.items()},
    )


def case_responses(paths: Paths) -> tuple[CaseResponse, ...]:
    """Return Figures 2 and 3 as numbers."""
    found = []
    for case, name in enumerate(room.CASES):
        direct_ms, first_reflection_ms = room.arrivals_ms(paths, case)
        edges_s = room.whole_windows_s(first_reflection_ms, 5)
        fine, windows = (
            room.window_energies(
                room.division_rows(paths, case, own, room.DIVISIONS[2]), room.true_absorption(name)
            )
            for own in (room.whole_windows_s(0, 1), edges_s)
        )
        found.append(CaseResponse(name, direct_ms, first_reflection_ms, fine, edges_s, windows))
    return tuple(found)


def table2(problem: room.SquaresProblem) -> tuple[FloatArray, float]:
    """Return the errors of case 1 in the rows of Table 2 after one common factor, and the factor.

    It is the one of least squared relative difference over the rows that count.
    """
    ours = np.array([room.error(problem, row[:2]) for row in room.TABLE2])
    counts = room.TABLE2[:, 2] > room.COMPARED_ABOVE
    ratio = ours[counts] / room.TABLE2[counts, 2]
    factor = float(np.sum(ratio) / np.sum(ratio**2))
    return factor * ours, factor


def largest_relative_error(errors: FloatArray) -> float:
    """Return by how much the rows of Table 2 that count differ from ours at most, relative."""
    counts = room.TABLE2[:, 2] > room.COMPARED_ABOVE
    return float(np.max(np.abs(errors[counts] / room.TABLE2[counts, 2] - 1.0)))


def grid_errors(problem: room.SquaresProblem, grid: FloatArray) -> FloatArray:
    """Return the error on a square grid, the first absorption along the first axis."""
    return np.array([[room.error(problem, np.array([a, b])) for b in grid] for a in grid])


def grid_minima(errors: FloatArray, grid: FloatArray = GRID) -> FloatArray:
    """Return the points of a grid that lie below their four neighbours, lowest first, (n, 2).

    They need not be minima of the function: where a narrow valley runs askew to the grid, points
    next to it alternate between its floor and its flanks.
    """
    walled = np.pad(errors, 1, constant_values=np.inf)
    others = (walled[2:, 1:-1], walled[:-2, 1:-1], walled[1:-1, 2:], walled[1:-1, :-2])
    at = np.argwhere(errors < np.min(others, axis=0))
    order = np.argsort(errors[at[:, 0], at[:, 1]], kind="stable")
    return np.asarray(grid[at[order]])


def _searches(problem: room.SquaresProblem, name: str, method: str, seeds: int) -> Searches:
    of_point, truth = partial(room.error, problem), room.true_absorption(name)
    fits = []
    for rng in map(np.random.default_rng, range(seeds)):
        if method == "annealing":
            fits.append(anneal(of_point, truth.size, rng))
        else:
            fits.append(downhill_simplex(of_point, random_simplex(truth.size, rng)))
    off = np.array([np.max(np.abs(fit.x - truth)) for fit in fits])
    evaluations = float(np.median([fit.evaluations for fit in fits]))
    return Searches(name, method, int(np.sum(off <= FOUND_WITHIN)), float(off.max()), evaluations)
