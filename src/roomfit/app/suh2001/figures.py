"""The pictures of `roomfit paper`, from its result."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from roomfit.app.suh2001.independent import PAIRS
from roomfit.app.suh2001.repeat import PaperResult
from roomfit.app.suh2001.room import CaseResponse
from roomfit.app.suh2001.searches import LABELS, METHODS
from roomfit.report.paper_pictures import (
    Curve,
    ResponsePanel,
    contours_figure,
    ill_defined_figure,
    independent_figure,
    methods_figure,
    responses_figure,
    search_paths_figure,
)
from roomfit.testproblems.paper_problems import MATERIAL_PROBLEMS
from roomfit.testproblems.paper_room import CASES, DIVISIONS, RECONSTRUCTED, TRUE_ABSORPTION
from roomfit.typing import FloatArray

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
        "independent_rays.png": _independent(result),
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


def _independent(result: PaperResult) -> Figure:
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
