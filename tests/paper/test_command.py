"""``roomfit paper`` from end to end."""

from __future__ import annotations

import csv
import json
import signal
import subprocess
import sys
import time
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from roomfit.base.errors import InputError
from roomfit.base.workers import in_pool, worker_pool
from roomfit.paper.independent import (
    fit_with_other_rays,
    mean_measurement,
    measurement_part,
    summarise,
)
from roomfit.paper.repeat import METHODS, Run, problems_of, record, search_seeds
from roomfit.paper.room import SPECIFICATIONS, PaperProblem, paper_scene, trace_paper_room

COMMAND = (sys.executable, "-m", "roomfit", "paper", "--out")


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that one run with one seed leaves behind."""
    folder = tmp_path_factory.mktemp("paper") / "out"
    done = subprocess.run(
        [*COMMAND, str(folder), "--seeds", "1"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "reconstructed" in done.stdout
    assert "equally right" in done.stdout
    return folder


@pytest.fixture(scope="module")
def content(written: Path) -> dict[str, Any]:
    """paper.json of that run."""
    parsed: dict[str, Any] = json.loads((written / "paper.json").read_text())
    return parsed


@pytest.mark.slow
def test_paper_json_holds_what_the_paper_says(content: dict[str, Any]) -> None:
    """Arrivals and Table 2 beside the printed ones."""
    assert content["arrivals_ms"] == content["arrivals_ms_paper"]
    assert len(content["table2"]) == 20
    assert set(content["table2"][0]) == {"alpha1", "alpha2", "paper", "ours"}
    assert content["table2_max_relative_error"] <= 0.015


@pytest.mark.slow
def test_paper_json_holds_the_minima_of_the_grid_and_the_true_ones(content: dict[str, Any]) -> None:
    """One of either kind in the cases; each true one with its error."""
    for case in ("case1", "case2", "case3", "ill_defined"):
        assert content["grid_minima"][case]["eight_neighbours"] == 1
        ((alpha1, alpha2, error),) = content["minima"][case]
        assert (alpha1, alpha2) == pytest.approx((0.65, 0.35), abs=1e-5)
        assert error < 1e-9


@pytest.mark.slow
def test_paper_json_holds_every_problem_by_every_method(content: dict[str, Any]) -> None:
    """Annealing with simplex, and least squares, find all; sizes and counts are plausible."""
    found = {(r["problem"], r["method"]): r for r in content["identified"]}
    assert set(found) == {(p, m) for p in SPECIFICATIONS for m in METHODS}
    for (_, method), r in found.items():
        assert r["seeds"] == 1
        assert len(r["truth"]) == len(r["worst_found"]) == len(r["materials"])
        assert r["median_evaluations"] > 1 and r["median_seconds"] > 0.0
        if method in ("annealing+simplex", "least-squares"):
            assert r["successes"] == 1, r
            assert r["largest_error"] <= 0.005


@pytest.mark.slow
def test_other_rays_bring_errors_that_fall_with_their_number(content: dict[str, Any]) -> None:
    """Not in `identified`; the paper's two materials from three pairs, 1,000 against 300,000."""
    rows = content["independent_rays"]["rows"]
    assert {r["materials"] for r in rows} == {2, 3, 4, 5, 6, 7}
    assert {r["pairs"] for r in rows} == {1, 3}
    two = {r["rays"]: r["rms_error"] for r in rows if (r["materials"], r["pairs"]) == (2, 3)}
    assert two[300_000] < 0.005 < 0.05 < two[1_000]


@pytest.mark.slow
def test_the_two_answers_of_the_walls_taken_apart_are_reported(content: dict[str, Any]) -> None:
    """South and north exchanged, both without error."""
    first, second = (a["absorption"] for a in content["walls_apart"]["answers"])
    assert content["walls_apart"]["materials"][3:] == ["south", "north"]
    np.testing.assert_allclose(first[3:], second[:2:-1], atol=1e-5)


@pytest.mark.slow
def test_tables_and_pictures_lie_beside_it(written: Path, content: dict[str, Any]) -> None:
    """Tables can be read and agree with paper.json; every picture is a PNG of some size."""
    with (written / "identified.csv").open() as stream:
        assert len(list(csv.DictReader(stream))) == len(content["identified"])
    with (written / "grid_errors.csv").open() as stream:
        assert sum(row["problem"] == "case1" for row in csv.DictReader(stream)) == 441
    names = {p.name for p in written.iterdir()}
    pictures = {f"figure{i}.png" for i in (2, 3, 4, 5)}
    pictures |= {"search_paths.png", "methods.png", "independent_rays.png"}
    assert pictures <= names
    for name in pictures:
        data = (written / name).read_bytes()
        assert data[:8] == b"\x89PNG\r\n\x1a\n"
        assert len(data) > 20_000
    # the list of what roomfit wrote, by which it may be replaced
    assert [name for name in names if name.startswith(".")] == [".roomfit-files"]


@pytest.mark.slow
def test_an_interrupt_ends_the_run_at_once_and_leaves_nothing(tmp_path: Path) -> None:
    """Control-C in the middle of the work: exit code 130, no folder, no traceback."""
    folder = tmp_path / "out"
    process = subprocess.Popen(
        [*COMMAND, str(folder)], stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    # its lock says that it is at work, however busy the machine; a whole run takes a minute or more
    while not list(tmp_path.iterdir()):
        assert process.poll() is None
        time.sleep(0.05)
    time.sleep(3.0)
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    # a machine may be busy; an interrupt that is lost ends in another exit code
    _, errors = process.communicate()
    assert process.returncode == 130, errors
    assert "interrupted" in errors and "Traceback" not in errors
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_folder_that_holds_something_is_left_alone(tmp_path: Path) -> None:
    """Exit code 2 and a message, before any work."""
    (tmp_path / "mine.txt").write_text("keep")
    done = subprocess.run([*COMMAND, str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "not empty" in done.stderr and "--overwrite" in done.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]


@pytest.fixture(scope="module")
def case1() -> PaperProblem:
    """The paper's first problem."""
    return problems_of(
        {
            "paper": trace_paper_room(paper_scene()),
            "disproportionate": trace_paper_room(paper_scene("disproportionate")),
        }
    )["case1"]


@pytest.mark.slow
def test_searches_give_the_same_answers_in_processes_as_here(case1: PaperProblem) -> None:
    """Bit by bit and in order, for any number of workers."""
    tasks = [partial(search_seeds, case1, method, range(2)) for method in METHODS]

    def found(pool: Executor) -> list[list[float]]:
        return [run.found.tolist() for runs in in_pool(pool, tasks) for run in runs]

    with worker_pool(1) as here, worker_pool(2) as processes:
        assert found(here) == found(processes)


def test_a_record_shows_the_worst_seed_and_counts_only_what_is_within_0_005(
    case1: PaperProblem,
) -> None:
    """Three made-up runs: right, nearly right, wrong."""
    runs = [
        Run(np.array([0.65, 0.35]), 10, 0.1),
        Run(np.array([0.654, 0.35]), 20, 0.3),
        Run(np.array([0.65, 0.41]), 90, 0.2),
    ]
    made = record(case1, "simplex", runs)
    assert (made.successes, made.seeds) == (2, 3)
    assert made.worst_found.tolist() == [0.65, 0.41]
    assert made.largest_error == pytest.approx(0.06)
    assert (made.median_evaluations, made.median_seconds) == (20.0, 0.2)


@pytest.mark.slow
def test_a_failing_task_is_reported_and_the_rest_dropped() -> None:
    """The error itself comes through, from a process as well."""
    with pytest.raises(InputError, match="trace setting"), worker_pool(2) as pool:
        in_pool(pool, [partial(measurement_part, -1, 0)])
    with pytest.raises(InputError, match="number of workers"), worker_pool(0):
        pass


def test_the_same_rays_find_the_truth_and_others_do_not() -> None:
    """A model of 3,000 rays against the mean of two other traces: off, by a reported amount."""
    parts = [measurement_part(4_096, seed) for seed in (1, 2)]
    measurement = mean_measurement(parts)
    for key, energies in measurement.items():
        np.testing.assert_allclose(energies, 0.5 * (parts[0][key] + parts[1][key]))
    fits = fit_with_other_rays(3_000, 0, measurement)
    assert set(fits) == set(measurement)
    for row in summarise(3_000, [fits]):
        assert 0.005 < row.rms_error <= row.worst_error <= 1.0


def test_a_row_of_repeats_is_its_statistics_written_out() -> None:
    """Errors (0.1, -0.2) and (0.3, 0): largest 0.2 and 0.3, mean square 0.14 / 4."""
    fits = [
        {(2, 1): (paths, np.array(off))} for paths, off in ((80, (0.1, -0.2)), (90, (0.3, 0.0)))
    ]
    (row,) = summarise(1000, fits)
    assert row.rms_error == pytest.approx((0.14 / 4.0) ** 0.5)
    assert (row.median_largest_error, row.worst_error) == pytest.approx((0.25, 0.3))
    assert (row.repeats, row.median_paths) == (2, 85.0)


@pytest.mark.slow
def test_every_problem_of_the_paper_is_certified(content: dict[str, Any]) -> None:
    """The truth lies in a cluster of each; case 1 with its walls apart has exactly two."""
    proven = content["certified"]
    assert set(proven) == {*SPECIFICATIONS, "walls_apart"}
    for name, wanted in SPECIFICATIONS.items():
        found = proven[name]
        assert found["status"] == "certified"
        truth = np.array(wanted.division.true_absorption)
        covered = [
            np.all((np.array(c["lower"]) <= truth) & (truth <= np.array(c["upper"])))
            for c in found["clusters"]
        ]
        assert any(covered)
    assert len(proven["walls_apart"]["clusters"]) == 2
