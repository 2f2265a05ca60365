"""The content of paper.json."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import roomfit
from roomfit.app.suh2001.repeat import PaperResult
from roomfit.app.suh2001.searches import FOUND_WITHIN, Record
from roomfit.files.results import certificate_content
from roomfit.identification.landscape import Landscape
from roomfit.testproblems.paper_problems import SPECIFICATIONS
from roomfit.testproblems.paper_room import (
    DIVISIONS,
    N_RAYS,
    PRINTED_ARRIVALS_MS,
    RECONSTRUCTED,
)


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
        "identified": [_identified(record) for record in result.records],
        "walls_apart": _walls_apart(result),
        "certified": {name: certificate_content(c) for name, c in result.certificates.items()},
        "independent_rays": _independent_rays(result),
    }


def _grid_minima(shape: Landscape) -> dict[str, Any]:
    return {
        "four_neighbours": len(shape.four_neighbours),
        "eight_neighbours": len(shape.eight_neighbours),
        "four_neighbours_at": [list(x) for x in shape.four_neighbours],
        "eight_neighbours_at": [list(x) for x in shape.eight_neighbours],
    }


def _identified(record: Record) -> dict[str, Any]:
    wanted = SPECIFICATIONS[record.problem]
    return {
        "problem": record.problem,
        "in_paper": wanted.in_paper,
        "method": record.method,
        "materials": list(wanted.division.materials),
        "truth": record.truth.tolist(),
        "worst_found": record.worst_found.tolist(),
        "largest_error": record.largest_error,
        "found_within": FOUND_WITHIN,
        "successes": record.successes,
        "seeds": record.seeds,
        "median_evaluations": record.median_evaluations,
        "median_seconds": record.median_seconds,
    }


def _walls_apart(result: PaperResult) -> dict[str, Any]:
    walls = result.walls_apart
    return {
        "problem": "case1",
        "materials": list(walls.materials),
        "truth": walls.truth.tolist(),
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


def _independent_rays(result: PaperResult) -> dict[str, Any]:
    settings = result.independent_settings
    return {
        "measurement_rays": settings.measurement_rays * settings.measurement_parts,
        "repeats": settings.repeats,
        "method": "least-squares",
        "sentence": "Measurement and model have different rays. With the same rays the error is "
        "exactly 0 at the truth, which says nothing about a real room.",
        "truth": {str(n): list(division.truth) for n, division in DIVISIONS.items()},
        "rows": [asdict(row) for row in result.independent],
    }
