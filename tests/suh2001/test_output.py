"""What `roomfit paper` draws and says: a made-up result, read back from pictures and tables."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from roomfit.errors import InputError
from roomfit.solvers.ending import Ending
from roomfit.solvers.search import Fit
from roomfit.suh2001 import output, repeat
from roomfit.suh2001.independent import IndependentRow
from roomfit.suh2001.output import _figures, _tables, paper_json, paper_text, run_paper
from roomfit.suh2001.repeat import METHODS, CaseResponse, PaperResult, Record, Run, Table2
from roomfit.suh2001.room import (
    CASES,
    DIVISIONS,
    MATERIAL_PROBLEMS,
    SPECIFICATIONS,
    TRUE_ABSORPTION,
)
from roomfit.suh2001.searches import Landscape, Minima, unit_grid
from roomfit.workers import worker_pool

RAYS = (1_000, 300_000)
TRUTH = np.array(TRUE_ABSORPTION)


def made_landscape(n_islands: int) -> Landscape:
    """Errors of up to 2000 around the truth, and so many minima of the grid by four neighbours."""
    grid = unit_grid()
    a, b = np.meshgrid(grid, grid, indexing="ij")
    islands = tuple((0.05 * i, 0.9) for i in range(n_islands))
    return Landscape(
        grid,
        0.2 + 1e3 * ((a - TRUTH[0]) ** 2 + 4.0 * (b - TRUTH[1]) ** 2),
        (*islands, (0.65, 0.35)),
        ((0.6, 0.4),),
        Minima(TRUTH[None], np.array([1e-12]), (441,)),
    )


def made_record(problem: str, method: str) -> Record:
    """Evaluations and successes that tell every search from the others."""
    n, m = list(SPECIFICATIONS).index(problem), list(METHODS).index(method)
    truth = np.array(SPECIFICATIONS[problem].division.true_absorption)
    return Record(problem, method, truth, truth + 0.01, 0.01, 10 * m + n, 50, 100.0 * m + n, 0.5)


@pytest.fixture(scope="module")
def result() -> PaperResult:
    responses = tuple(
        CaseResponse(
            name,
            11 + i,
            15 + i,
            np.arange(200.0) + i,
            1e-3 * np.arange(15 + i, 200, 5),
            10.0 + np.arange(np.arange(15 + i, 200, 5).size - 1.0),
        )
        for i, name in enumerate(CASES)
    )
    trail = np.array([[0.1, 0.2], [0.3, 0.3], [0.65, 0.35]])
    rows = [
        IndependentRow(rays, materials, pairs, 1, 1.0, 0.01 * pairs * materials * 1e3 / rays, 1, 1)
        for rays in RAYS
        for materials in DIVISIONS
        for pairs in (1, 3)
    ]
    cluster = SimpleNamespace(lower=[0.6], upper=[0.7], minimiser=[0.65], value=0.0, unique=True)
    proven, open_ = (
        SimpleNamespace(
            status=status, sentence="", coordinates=("a", "b"), value=3e-4, lower_bound=1e-4,
            delta=1e-8, clusters=(cluster, other), n_open=0, boxes=77, seconds=1.0,
        )
        for status, other in (("certified", cluster), ("stopped", cluster))
    )  # fmt: skip
    half = SimpleNamespace(**{**vars(cluster), "unique": False})
    partly = SimpleNamespace(**{**vars(proven), "clusters": (cluster, half)})
    return PaperResult(
        50,
        responses,
        Table2(
            np.array([[0.1, 0.2]]), np.array([20.0]), np.array([20.2]), common_factor=1.001,
            max_relative_error=0.01,
        ),
        {"case1": made_landscape(0), "case2": made_landscape(0), "case3": made_landscape(0),
         "ill_defined": made_landscape(6)},
        np.full((201, 201), 7.0) + np.arange(201.0),
        {
            name: Fit(trail[-1], 0.0, 30 + i, 3, Ending.CONVERGED, trail, np.array([9.0, 4.0, 0.0]))
            for i, name in enumerate(list(METHODS)[:4])
        },
        tuple(made_record(p, m) for p in SPECIFICATIONS for m in METHODS),
        Minima(
            np.array([[0.65, 0.35, 0.55, 0.1, 0.25], [0.65, 0.35, 0.55, 0.25, 0.1]]),
            np.array([1e-13, 2e-13]),
            (31, 29),
        ),
        0.123,
        456.7,
        {"case1": proven, "case2": partly, "walls_apart": open_},
        tuple(rows),
    )  # fmt: skip


@pytest.fixture(scope="module")
def figures(result: PaperResult) -> dict[str, Any]:
    drawn = _figures(result)
    for figure in drawn.values():
        figure.draw_without_rendering()
    return drawn


@pytest.mark.parametrize(("name", "width_ms"), [("figure2", 1), ("figure3", 5)])
def test_energies_stand_over_their_time_and_arrivals_are_marked(result, figures, name, width_ms):
    """Figures 2 and 3: bins of 1 ms from emission on, of 5 ms from the first reflection on."""
    panels = figures[name].axes
    assert len(panels) == len(result.responses) == 3
    for i, (axes, r) in enumerate(zip(panels, result.responses, strict=True)):
        (steps,) = axes.patches
        values, edges, _ = steps.get_data()
        if width_ms == 1:
            np.testing.assert_array_equal(values, r.fine)
            np.testing.assert_array_equal(edges, np.arange(201.0))
            marked = {f"direct sound at {11 + i} ms": 11 + i}
            marked |= {f"first reflection at {15 + i} ms": 15 + i}
        else:
            np.testing.assert_array_equal(values, r.windows)
            np.testing.assert_allclose(edges, 1e3 * r.edges_s)
            marked = {f"from the first reflection at {15 + i} ms": 15 + i}
        assert {line.get_label(): line.get_xdata()[0] for line in axes.get_lines()} == marked
        assert axes.get_legend().get_title().get_text() == f"Case {i + 1}"
        assert axes.get_xlim() == (0.0, 200.0) and axes.get_ylim()[0] == 0.0


def test_contours_have_the_minima_of_grid_and_descents_at_their_places(result, figures):
    """Figure 4 a panel a case; Figure 5 with and without the minima of the grid."""
    *four, bar = figures["figure4"].axes
    assert [axes.get_title() for axes in four] == ["Case 1", "Case 2", "Case 3"]
    assert four[0].get_ylabel() == "absorption of walls" and not four[1].get_ylabel()
    assert {axes.get_xlabel() for axes in four} == {"absorption of floor and ceilings"}
    coarse, fine, _ = figures["figure5"].axes
    assert "21 x 21: 6 minima that are none" in coarse.get_title()
    assert fine.get_title() == "201 x 201: one valley, true minima: 1"
    assert bar.get_ylabel() == "error (unit of the paper)"
    assert {np.log10(tick) for tick in bar.get_yticks()} <= {-1, 0, 1, 2, 3, 4, 5}
    for axes in (*four[:3], coarse, fine):
        assert (axes.get_xlim(), axes.get_ylim()) == ((0.0, 1.0), (0.0, 1.0))
    assert coarse.get_ylabel() == "absorption of walls" and not fine.get_ylabel()
    for axes, name in ((four[2], "case3"), (coarse, "ill_defined"), (fine, "ill_defined")):
        shape = result.landscapes[name]
        at = {line.get_label(): np.transpose(line.get_data()) for line in axes.get_lines()}
        true = at.pop("true minimum: end of descents")
        np.testing.assert_array_equal(true, shape.minima.x)
        if axes is fine:
            assert not at
            continue
        np.testing.assert_array_equal(
            at["minimum of the grid, 4 neighbours"], shape.four_neighbours
        )
        np.testing.assert_array_equal(
            at["minimum of the grid, 8 neighbours"], shape.eight_neighbours
        )


def test_each_search_has_its_trail_from_its_start_beside_the_truth(result, figures):
    panels = figures["search_paths"].axes
    assert len(panels) == 4
    for (method, fit), axes in zip(result.case1_searches.items(), panels, strict=True):
        assert axes.get_title() == f"{METHODS[method].label}: {fit.evaluations} evaluations"
        trail, start, true = axes.get_lines()
        np.testing.assert_array_equal(np.transpose(trail.get_data()), fit.trail)
        np.testing.assert_array_equal(np.ravel(start.get_data()), fit.trail[0])
        np.testing.assert_array_equal(np.ravel(true.get_data()), TRUTH)
        assert (start.get_label(), true.get_label()) == ("start", "true absorption")
        dots = axes.collections[-1]
        np.testing.assert_array_equal(dots.get_offsets(), fit.trail)
        np.testing.assert_array_equal(dots.get_array(), [0.0, 0.5, 1.0])  # dark first
    assert [bool(axes.get_xlabel()) for axes in panels] == [False, False, True, True]
    assert [bool(axes.get_ylabel()) for axes in panels] == [True, False, True, False]


def test_evaluations_and_rates_of_success_stand_over_the_number_of_materials(result, figures):
    """Bars of all methods side by side, centred on the number, 0.8 wide together."""
    left, right = figures["methods"].axes
    known = {(r.problem, r.method): r for r in result.records}
    lines, bars = left.get_lines(), right.containers
    assert left.get_yscale() == "log"
    assert left.get_xlabel() == right.get_xlabel() == "number of materials"
    assert left.get_ylabel() == "evaluations of the error (median)"
    assert right.get_ylabel() == "searches that found the truth (%)"
    named = [t.get_text() for t in figures["methods"].legends[0].get_texts()]
    assert named == [method.label for method in METHODS.values()]
    for (method, about), line, own in zip(METHODS.items(), lines, bars, strict=True):
        records = [known[p, method] for p in MATERIAL_PROBLEMS.values()]
        assert line.get_label() == about.label
        assert line.get_xdata().tolist() == list(MATERIAL_PROBLEMS)
        assert line.get_ydata().tolist() == [r.median_evaluations for r in records]
        np.testing.assert_allclose(
            [b.get_height() for b in own], [2.0 * r.successes for r in records]
        )
    for i, n in enumerate(MATERIAL_PROBLEMS):
        each = [own[i] for own in bars]
        edges = [each[0].get_x(), *(b.get_x() + b.get_width() for b in each)]
        np.testing.assert_allclose(edges, n + np.linspace(-0.4, 0.4, len(METHODS) + 1))


def test_errors_with_other_rays_stand_at_their_numbers_beside_the_paper_s_18_000(figures):
    """A line a number of materials in each of two panels; the label stands right of its line."""
    panels = figures["independent_rays"].axes
    assert [axes.get_title()[:9] for axes in panels] == ["one pair ", "three pai"]
    assert [axes.get_ylabel() for axes in panels] == ["rms error of the found absorption", ""]
    assert {axes.get_xlabel() for axes in panels} == {"rays of the model for each source"}
    for pairs, axes in zip((1, 3), panels, strict=True):
        *lines, paper = axes.get_lines()
        for materials, line in zip(DIVISIONS, lines, strict=True):
            assert line.get_label() == f"{materials} materials"
            assert tuple(line.get_xdata()) == RAYS
            np.testing.assert_allclose(
                line.get_ydata(), [0.01 * pairs * materials, 1e-4 * pairs * materials / 3.0]
            )
        assert set(paper.get_xdata()) == {18_000}
        (label,) = axes.texts
        box = label.get_window_extent().transformed(axes.transData.inverted())
        assert 18_000 < box.x0 < 20_000 and box.x1 < 40_000
        low, high = axes.get_ylim()
        assert low < box.y0 and box.y1 < high


def test_the_text_says_what_was_found(result):
    said = paper_text(result)
    assert max(map(len, said.splitlines())) <= 100
    for line in (
        "within 1.0 % of the paper, after one common factor",
        "case2  12 / 16 ms, paper 13 / 17 ms",
        "The islands of Figure 5 are 6 minima of the grid",
        "and 2 answers are equally right:",
        "south 0.250, north 0.100: error 2.0e-13",
        "mirrored one has the error 0.123, black walls 457:",
        "stopped: at best 2.0e-04 better",
        "1 of 2",
    ):
        assert line in said, line
    rows = [line.split() for line in said.splitlines()]
    assert ["case1", "2", "2", "77", "all"] in rows
    assert ["ill_defined", "7", "1", "true:", "1", "at", "(0.650,", "0.350)"] in rows
    n = list(SPECIFICATIONS).index("ill_defined")
    cells = [c for m in range(len(METHODS)) for c in (f"{10 * m + n}", f"({100 * m + n})")]
    assert ["ill_defined", *cells] in rows
    assert ["3,", "7", "0.210", "0.001"] in rows
    assert ["pairs,", "materials", "1,000", "300,000", "rays"] in rows


def test_tables_have_a_row_for_each_number(result):
    tables = {name: [tuple(r) for r in table.rows] for name, table in _tables(result).items()}
    assert tables["table2"] == [(0.1, 0.2, 20.0, 20.2)]
    assert tables["responses_1ms"][7] == (7, 7.0, 8.0, 9.0)
    assert tables["responses_5ms"][1] == ("case1", 20, 11.0)
    assert len(tables["grid_errors"]) == 4 * 441
    shape = result.landscapes["case1"]
    assert tables["grid_errors"][22] == ("case1", 0.05, 0.05, shape.errors[1, 1])
    assert tables["minima"][2] == ("case1", "true", *TRUTH, 441)
    assert tables["search_paths"][4] == ("simplex", 1, 0.3, 0.3, 4.0)
    assert tables["identified"][1][:5] == ("case1", "simplex", 2, 10, 50)
    single, both = tables["certified"][1][4], tables["certified"][0][4]
    assert (single, both) == (1, 2)
    assert tables["independent_rays"][0][:3] == (1_000, 2, 1)


def test_paper_json_has_the_numbers_under_their_names(result):
    content = paper_json(result)
    assert content["table2"] == [{"alpha1": 0.1, "alpha2": 0.2, "paper": 20.0, "ours": 20.2}]
    assert content["minima"]["case1"] == [[*TRUTH, 1e-12]]
    assert content["grid_minima"]["ill_defined"]["four_neighbours"] == 7
    assert content["walls_apart"]["answers"][1]["descents"] == 29
    assert content["certified"]["walls_apart"]["boxes"] == 77
    assert content["independent_rays"]["measurement_rays"] == 1_048_576
    (own,) = (
        r for r in content["identified"] if (r["problem"], r["method"]) == ("case1", "simplex")
    )
    assert (own["successes"], own["seeds"], own["found_within"]) == (10, 50, 0.005)


@pytest.mark.parametrize(("seeds", "n_sets"), [(3, 3), (50, 8)])
def test_progress_of_the_repetition_rises_from_part_to_part_to_the_whole(
    monkeypatch, seeds, n_sets
):
    """Other rays, landscapes, searches and certificates, each with its share; in this process."""
    problem = SimpleNamespace(
        squares=SimpleNamespace(
            measured=np.ones(2), rows=SimpleNamespace(materials=("a", "b"))
        ),
        true_absorption=TRUTH,
    )  # fmt: skip
    done: list[float] = []

    def independent(_pool, sets, progress):
        assert sets == n_sets
        progress(0.5)
        progress(1.0)

    def records(_pool, _seeds, problems, progress):
        assert list(problems) == ["case1", "ill_defined"]
        progress(0.5)
        progress(1.0)

    given = {
        "trace_paper_room": lambda _: "paths",
        "problems_of": lambda _: {"case1": problem, "ill_defined": problem},
        "_independent": independent,
        "problem_landscape": lambda _: "landscape",
        "_records": records,
        "walls_apart_problem": lambda *_, **__: problem,
        "squares_global_problem": lambda _: "global problem",
        "certify": lambda *_: "certificate",
        "exchanged_walls": lambda _: slice(None),
        "case_responses": lambda _: "responses",
        "table2": lambda _: "table",
        "grid_errors": lambda *_: "errors",
        "searches_of_table2": lambda _: "searches",
        "walls_apart": lambda *_: "apart",
        "error": lambda *_: 0.5,
    }
    for name, function in given.items():
        monkeypatch.setattr(repeat, name, function)
    found = repeat.repeat_paper(seeds, 1, progress=done.append)
    assert set(found.certificates) == {"case1", "ill_defined", "walls_apart"}
    np.testing.assert_allclose(
        done, [0.2, 0.4, 0.425, 0.45, 0.7, 0.95, 0.95 + 0.05 / 3, 0.95 + 0.1 / 3, 1.0]
    )


def test_a_folder_holds_every_table_and_picture_and_what_was_asked_for(
    tmp_path, monkeypatch, result
):
    """Seeds, workers and progress reach the repetition; a folder that holds something stays."""
    asked: list[tuple[int, int, object]] = []

    def repeated(seeds, workers, *, progress):
        asked.append((seeds, workers, progress))
        return result

    monkeypatch.setattr(output, "repeat_paper", repeated)
    monkeypatch.setattr(output, "_figures", lambda _: {"figure2": "drawn"})
    monkeypatch.setattr(output, "png", str.encode)
    assert run_paper(tmp_path / "own", seeds=7, workers=3, progress=print) is result
    run_paper(tmp_path / "usual")
    assert asked == [(7, 3, print), (50, 2, None)]
    for name, table in _tables(result).items():
        lines = (tmp_path / "own" / f"{name}.csv").read_text("utf-8").splitlines()
        assert len(lines) == 1 + len(list(table.rows)), name
    assert (tmp_path / "own" / "figure2.png").read_bytes() == b"drawn"
    written = json.loads((tmp_path / "own" / "paper.json").read_text("utf-8"))
    assert written.pop("content_sha256")
    assert written == json.loads(json.dumps(paper_json(result)))
    with pytest.raises(InputError, match="not empty"):
        run_paper(tmp_path / "own")
    run_paper(tmp_path / "own", overwrite=True)
    assert len(asked) == 3


def test_seeds_are_searched_in_chunks_of_ten_and_recorded_problem_by_problem(monkeypatch):
    """25 seeds, each once; the runs of a method of a problem make its record and no other."""
    problems = {name: SimpleNamespace(name=name, true_absorption=TRUTH) for name in ("b", "a")}
    chunks: list[range] = []
    numbers = {(p, m): 10 * i + j for i, p in enumerate(problems) for j, m in enumerate(METHODS)}

    def searched(problem, method, seeds):
        chunks.append(seeds)
        return [Run(TRUTH + 9e-4 * s, numbers[problem.name, method], 1.0 * s) for s in seeds]

    monkeypatch.setattr(repeat, "search_seeds", searched)
    done: list[float] = []
    with worker_pool(1) as pool:
        records = repeat._records(pool, 25, problems, done.append)
    assert chunks[:3] == [range(10), range(10, 20), range(20, 25)] == chunks[-3:]
    assert [(r.problem, r.method) for r in records] == list(numbers)
    assert [r.median_evaluations for r in records] == list(numbers.values())
    for r in records:
        assert (r.seeds, r.successes, r.median_seconds) == (25, 6, 12.0)
        np.testing.assert_allclose(r.worst_found, TRUTH + 0.0216)
    np.testing.assert_allclose(done, np.arange(1, 31) / 30)


def test_the_study_of_other_rays_fits_every_number_of_rays_as_often_to_one_measurement(monkeypatch):
    """Seeds 0 to 3 make the measurement; rows come by pairs, materials and rays."""
    parts: list[tuple[int, int]] = []
    begun: list[int] = []

    def measured(rays, seed):
        parts.append((rays, seed))
        return {(2, 3): np.array([float(seed)])}

    def fitted(rays, number, measurement):
        assert measurement[2, 3] == 1.5
        begun.append(rays)
        off = np.array([1e-6 * rays, 1e-9 * number])
        return dict.fromkeys(((3, 1), (2, 3), (2, 1)), (rays + number, off))

    monkeypatch.setattr(repeat, "measurement_part", measured)
    monkeypatch.setattr(repeat, "fit_with_other_rays", fitted)
    done: list[float] = []
    with worker_pool(1) as pool:
        rows = repeat._independent(pool, 8, done.append)
    assert parts == [(262_144, seed) for seed in range(4)]
    numbers = (1_000, 3_000, 10_000, 18_000, 30_000, 100_000, 300_000)
    expected = [(p, m, n) for p, m in ((1, 2), (1, 3), (3, 2)) for n in numbers]
    assert [(r.pairs, r.materials, r.rays) for r in rows] == expected
    # the longest first, so that no worker is left with one at the end
    assert begun == sorted(begun, reverse=True)
    for r in rows:
        assert (r.repeats, r.median_paths) == (8, r.rays + 3.5)
        assert r.worst_error == pytest.approx(1e-6 * r.rays)
    assert len(done) == 4 + 56
    np.testing.assert_allclose(done[:4], [0.0625, 0.125, 0.1875, 0.25])
    np.testing.assert_allclose(done[4:], 0.25 + 0.75 * np.arange(1, 57) / 56)


def test_every_picture_says_above_its_panels_that_the_room_is_a_reconstruction(figures):
    """Bars of energy are filled; nothing is drawn over the note."""
    for name, figure in figures.items():
        (note,) = (t for t in figure.texts if t.get_text() == output.RECONSTRUCTED)
        lowest = note.get_window_extent().y0
        for axes in figure.axes:
            assert axes.get_tightbbox().y1 < lowest, name
    for name in ("figure2", "figure3"):
        assert all(p.get_fill() for axes in figures[name].axes for p in axes.patches)
