"""The CSV tables beside paper.json."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict
from typing import TypeAlias

import numpy as np

from roomfit.app.suh2001.repeat import PaperResult
from roomfit.testproblems.paper_room import CASES

Row: TypeAlias = Sequence[object]


def paper_tables(result: PaperResult) -> dict[str, str]:
    """Return file name and text of every table."""
    return {
        "table2.csv": _table2(result),
        "arrivals.csv": _arrivals(result),
        "responses_1ms.csv": _responses_1ms(result),
        "responses_5ms.csv": _responses_5ms(result),
        "grid_errors.csv": _grid_errors(result),
        "minima.csv": _minima(result),
        "search_paths.csv": _search_paths(result),
        "identified.csv": _identified(result),
        "certified.csv": _certified(result),
        "independent_rays.csv": _independent_rays(result),
    }


def _csv(heading: Row, rows: Sequence[Row]) -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(heading)
    writer.writerows(
        [f"{cell:.6g}" if isinstance(cell, float) else cell for cell in row] for row in rows
    )
    return stream.getvalue()


def _table2(result: PaperResult) -> str:
    table = result.table2
    columns = np.column_stack((table.absorption, table.paper, table.ours))
    return _csv(("alpha1", "alpha2", "error_paper", "error_ours"), columns.tolist())


def _arrivals(result: PaperResult) -> str:
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


def _minima(result: PaperResult) -> str:
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


def _identified(result: PaperResult) -> str:
    rows = [
        (
            *(r.problem, r.method, len(r.truth), r.successes, r.seeds, r.largest_error),
            *(r.median_evaluations, r.median_seconds),
        )
        for r in result.records
    ]
    heading = ("problem", "method", "materials", "successes", "seeds", "largest_error")
    return _csv((*heading, "median_evaluations", "median_seconds"), rows)


def _certified(result: PaperResult) -> str:
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


def _independent_rays(result: PaperResult) -> str:
    rows = [asdict(row) for row in result.independent]
    return _csv(tuple(rows[0]), [tuple(row.values()) for row in rows])
