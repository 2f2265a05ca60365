"""What a certificate of the paper's room costs: boxes and seconds of processor time, one thread.

``python benchmarks/certified.py`` prints the table of docs/certificate.md.
``python benchmarks/certified.py --picture FILE`` draws the boxes left over in two dimensions.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from roomfit.base.typing import FloatArray
from roomfit.paper.certificate import certify
from roomfit.paper.global_search import SearchSettings, first_guess, search, tools_for
from roomfit.paper.repeat import squares_global_problem
from roomfit.paper.room import (
    DIVISIONS,
    N_RAYS,
    Division,
    SquaresProblem,
    arrivals_ms,
    division_rows,
    error,
    paper_scene,
    squares_problem,
    trace_paper_room,
    whole_windows_s,
    window_energies,
)
from roomfit.tracing.paths import Paths

_CASE = 2  # the only pair off the room's plane of symmetry


def problem_of(
    own: Paths, other: Paths, division: Division, window_ms: int, case: int = _CASE
) -> SquaresProblem:
    """Return the model of one trace with the data of another."""
    edges = whole_windows_s(0, 50)
    if window_ms == 5:
        edges = whole_windows_s(arrivals_ms(own, case)[1], 5)
    truth = np.array(division.true_absorption)
    measured = window_energies(division_rows(other, case, edges, division), truth)
    return squares_problem(division_rows(own, case, edges, division), measured)


def row(name: str, problem: SquaresProblem, share: float | None, seconds: float) -> None:
    """Certify once and print a line; `share` of the lowest misfit is delta, or 1e-8."""
    global_problem = squares_global_problem(problem)
    guess = first_guess(global_problem, tools_for(global_problem)).value
    delta = 1e-8 if share is None else share * guess
    begun = time.process_time()
    found = certify(global_problem, SearchSettings(delta, width=0.05, max_seconds=seconds))
    spent = time.process_time() - begun
    single = sum(c.unique for c in found.clusters)
    gap = found.value - found.lower_bound
    print(
        f"| {name} | {found.boxes:,} | {spent:.2f} | {found.status} | {len(found.clusters)} "
        f"({single}) | {found.value:.3g} | {gap:.2g} | "
        f"{'yes' if guess <= found.value + delta else 'no'} |",
        flush=True,
    )


def main() -> None:
    """Print the table, or draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--seconds", type=float, default=60.0)
    arguments = parser.parse_args()
    own = trace_paper_room(paper_scene())
    if arguments.picture is not None:
        picture(own, arguments.picture)
        return
    other = trace_paper_room(paper_scene(), N_RAYS, "sobol", 1)
    warm = problem_of(own, own, DIVISIONS[2], 5)
    certify(squares_global_problem(warm), SearchSettings(1e-8))
    print("| problem | boxes | s | status | clusters (single) | lowest | gap | descents |")
    print("|---|---|---|---|---|---|---|---|")
    for window_ms, numbers in ((5, (2, 3, 4, 5, 6, 7)), (50, (2, 3, 4, 5))):
        for data, paths, share in (("exact", own, None), ("other rays", other, 0.01)):
            for n in numbers:
                name = f"{n} materials, {window_ms} ms, {data}"
                problem = problem_of(own, paths, DIVISIONS[n], window_ms)
                row(name, problem, share, arguments.seconds)


def picture(own: Paths, file: Path) -> None:
    """Draw the boxes left over for the narrow valley of Figure 5 at three values of delta."""
    from roomfit.report.figures import png

    problem = problem_of(own, own, DIVISIONS[2], 50, case=0)
    global_problem = squares_global_problem(problem)
    covers, deltas = {}, (30.0, 10.0, 3.0)
    for delta in deltas:
        found = search(global_problem, SearchSettings(delta, width=0.01))
        covers[f"error up to {delta:g}"] = 1.0 - np.exp(found.boxes)[:, ::-1]
    first = next(iter(covers.values()))
    low, high = first[:, 0].min(axis=0) - 0.05, first[:, 1].max(axis=0) + 0.05
    x, y = np.meshgrid(*np.clip(np.linspace(low, high, 81), 0.0, 1.0).T)
    errors = [error(problem, np.array(at)) for at in zip(x.ravel(), y.ravel(), strict=True)]
    grids = (x, y, np.reshape(errors, x.shape))
    truth = np.array(DIVISIONS[2].true_absorption)
    figure = _boxes_figure(covers, global_problem.coordinates, truth, grids, sorted(deltas))
    file.write_bytes(png(figure))


def _boxes_figure(
    covers: dict[str, FloatArray],
    names: tuple[str, ...],
    true_absorption: FloatArray,
    grids: tuple[FloatArray, FloatArray, FloatArray],
    levels: list[float],
) -> Figure:
    """Return the covers on top of each other, each of shape (n_boxes, 2, 2), the widest first.

    `grids`: both absorptions and the error, whose contours at `levels` bound the covers.
    """
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Rectangle

    from roomfit.report.figures import OKABE_ITO, new_figure

    figure = new_figure(5.2, 5.0)
    axes = figure.subplots()
    for (label, boxes), colour in zip(covers.items(), (4, 0, 1), strict=False):
        patches = [Rectangle((b[0, 0], b[0, 1]), *(b[1] - b[0])) for b in boxes]
        axes.add_collection(
            PatchCollection(patches, facecolor=OKABE_ITO[colour], edgecolor="white", linewidth=0.4)
        )
        noun = "box" if len(boxes) == 1 else "boxes"
        axes.plot([], [], "s", color=OKABE_ITO[colour], label=f"{label}: {len(boxes)} {noun}")
    axes.contour(*grids, levels=list(levels), colors="black", linewidths=1.0)
    axes.plot([], [], "-", color="black", lw=1.0, label="where the error has just these values")
    axes.plot(*true_absorption, "+", color="black", ms=12, mew=1.5, label="truth")
    widest = next(iter(covers.values()))
    low, high = widest[:, 0].min(axis=0), widest[:, 1].max(axis=0)
    margin = 0.08 * float((high - low).max())
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
    axes.set_xlabel(f"absorption of {names[0]}")
    axes.set_ylabel(f"absorption of {names[1]}")
    axes.set_title("What is left after the proof", fontsize=10)
    figure.legend(loc="outside lower center", frameon=False, fontsize=9)
    return figure


if __name__ == "__main__":
    main()
