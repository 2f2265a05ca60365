"""What `roomfit paper` says in the end."""

from __future__ import annotations

from roomfit.app.suh2001.independent import IndependentRow
from roomfit.app.suh2001.repeat import PaperResult
from roomfit.app.suh2001.searches import METHODS, Record
from roomfit.identification.landscape import Landscape
from roomfit.testproblems.paper_problems import SPECIFICATIONS
from roomfit.testproblems.paper_room import DIVISIONS, PRINTED_ARRIVALS_MS, RECONSTRUCTED
from roomfit.testproblems.paper_table2 import COMPARED_ABOVE


def paper_text(result: PaperResult) -> str:
    """Return the findings in words and tables of at most 100 columns."""
    parts = [RECONSTRUCTED, _arrivals(result), _table2(result), _minima(result)]
    parts += [_searches(result), _walls_apart(result), _certified(result), _independent(result)]
    return "\n\n".join(parts)


def _arrivals(result: PaperResult) -> str:
    lines = ["Arrival of direct sound / first reflection (1 ms bins), here and in the paper"]
    for r in result.responses:
        direct, first = PRINTED_ARRIVALS_MS[r.name]
        here = f"{r.direct_ms} / {r.first_reflection_ms}"
        lines.append(f"  {r.name}  {here} ms, paper {direct} / {first} ms")
    return "\n".join(lines)


def _table2(result: PaperResult) -> str:
    worst = 100.0 * result.table2.max_relative_error
    return (
        f"Table 2: every row with an error above {COMPARED_ABOVE:g} within {worst:.1f} % of the "
        "paper, after one common factor."
    )


def _minima(result: PaperResult) -> str:
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


def _walls_apart(result: PaperResult) -> str:
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


def _certified(result: PaperResult) -> str:
    lines = [
        "Certified: no absorption at all errs less, and only in these places is the error within "
        "1e-08 of it",
        f"  {'':<29}{'materials':>10}{'places':>8}{'boxes':>8}   proven to hold one minimum each",
    ]
    for name, c in result.certificates.items():
        single = sum(cluster.unique for cluster in c.clusters)
        told = "all" if single == len(c.clusters) else f"{single} of {len(c.clusters)}"
        if c.status != "certified":
            told = f"{c.status}: at best {c.value - c.lower_bound:.1e} better"
        lines.append(
            f"  {name:<29}{len(c.coordinates):>10}{len(c.clusters):>8}{c.boxes:>8}   {told}"
        )
    lines.append("  (of these rays: what other rays would change is not in it)")
    return "\n".join(lines)


def _independent(result: PaperResult) -> str:
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
