"""A proof of the lowest error holds at every point tried, and finds all minima that there are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from certified_cases import errors_of, random_case
from roomfit.base.typing import FloatArray
from roomfit.model.weighing import EnergyRows
from roomfit.paper.certificate import Certificate, certify, touching
from roomfit.paper.room import (
    DIVISIONS,
    PLANES,
    Division,
    division_rows,
    error,
    paper_problem,
    paper_scene,
    squares_problem,
    trace_paper_room,
    whole_windows_s,
    window_energies,
)
from roomfit.tracing.paths import Paths


def outside(proof: Certificate, points: FloatArray) -> FloatArray:
    """Return the points (n_points, n) that lie in no cluster."""
    held = [np.all((c.lower <= points) & (points <= c.upper), axis=1) for c in proof.clusters]
    return points[~np.any(held, axis=0)]


@pytest.mark.parametrize("seed", range(6))
def test_no_point_outside_of_the_clusters_comes_near_and_none_is_lower(seed: int) -> None:
    """4,000 points of the box and 4,000 about each minimiser, alphas up to 1; another search."""
    problem = random_case(seed, 2 + seed % 2)
    n, rng = len(problem.rows.materials), np.random.default_rng(seed)
    proof = certify(problem, delta=1e-3 * float(problem.measured @ problem.measured), width=0.2)
    assert proof.complete
    near = [c.minimiser + rng.normal(0.0, 0.05, (4000, n)) for c in proof.clusters]
    points = np.clip(np.concatenate((rng.random((4000, n)), *near)), 0.0, 1.0)
    errors = errors_of(problem, points)
    assert np.all(errors >= proof.lower_bound)
    assert not outside(proof, points[errors <= proof.value + proof.delta]).size
    simplex = minimize(
        lambda x: error(problem, np.clip(x, 0.0, 1.0)), rng.random(n), method="Nelder-Mead"
    )
    assert proof.lower_bound <= simplex.fun
    # and its own value is as low as the best of them, but for their last digits
    assert proof.value <= min(simplex.fun, errors.min()) * (1.0 + 1e-6) + 1e-12


def test_a_search_that_is_stopped_says_so_and_its_bound_still_holds() -> None:
    """After five boxes of many."""
    problem = random_case(4, 4)
    proof = certify(problem, delta=0.1, most_boxes=5)
    assert not proof.complete and proof.boxes == 5
    points = np.random.default_rng(1).random((5000, 4))
    errors = errors_of(problem, points)
    assert np.all(errors >= proof.lower_bound)
    assert not outside(proof, points[errors <= proof.value + 0.1]).size


def test_boxes_join_to_clusters_where_they_touch() -> None:
    """A chain through a shared corner is one; a gap makes two."""

    def cell(x: float, y: float) -> FloatArray:
        return np.array([[x, y], [x + 1.0, y + 1.0]])

    boxes = np.stack([cell(0, 0), cell(5, 5), cell(1, 1), cell(2, 1), cell(5, 6)])
    assert touching(boxes).tolist() == [0, 1, 0, 0, 1]


@pytest.fixture(scope="module")
def paths() -> Paths:
    """The 18,000 rays of the paper's room."""
    return trace_paper_room(paper_scene())


@pytest.mark.parametrize("name", ["case1", "ill_defined", "three_materials"])
def test_where_a_cluster_is_called_unique_chords_lie_above(name: str, paths: Paths) -> None:
    """Midpoints of random chords in log(1 - absorption), in which the error is then convex."""
    problem = paper_problem(name, paths)
    (only,) = certify(problem.squares).clusters
    assert only.unique
    low, high = np.log1p(-only.upper), np.log1p(-only.lower)
    ends = low + np.random.default_rng(1).random((2, 500, low.size)) * (high - low)
    middle = errors_of(problem.squares, -np.expm1(0.5 * (ends[0] + ends[1])))
    sides = [errors_of(problem.squares, -np.expm1(own)) for own in ends]
    assert np.all(middle <= 0.5 * (sides[0] + sides[1]) * (1.0 + 1e-9) + 1e-12)


def mirrored(rows: EnergyRows) -> EnergyRows:
    """Every path and its mirror image, with the hits on south and north exchanged, half each."""
    hits = np.stack((rows.hits, rows.hits[:, [0, 1, 2, 4, 3]]), axis=1)
    return replace(
        rows,
        offsets=2 * rows.offsets,
        weight_per_m2=0.5 * np.repeat(rows.weight_per_m2, 2),
        hits=hits.reshape(-1, 5),
        length_m=np.repeat(rows.length_m, 2),
        batch=np.repeat(rows.batch, 2),
        path=None,
    )


def test_case_1_with_its_walls_apart_has_exactly_two_minimisers(paths: Paths) -> None:
    """Source and receiver stand half way between south and north: exchanging them changes nothing.

    By rays that are mirror symmetric: the truth and its mirror image, each proven alone.
    """
    truth = np.array([0.65, 0.35, 0.55, 0.10, 0.25])
    materials = ("floor and ceilings", "west", "east", "south", "north")
    walls = Division(materials, (0, 0, 0, 1, 2, 3, 4), tuple(truth))
    rows = mirrored(division_rows(paths, 0, whole_windows_s(15, 5), walls))
    proof = certify(squares_problem(rows, window_energies(rows, truth)))
    assert proof.complete and len(proof.clusters) == 2
    assert all(c.unique for c in proof.clusters)
    for expected in (truth, truth[[0, 1, 2, 4, 3]]):
        off = min(np.abs(c.minimiser - expected).max() for c in proof.clusters)
        assert off < 1e-6


@pytest.mark.slow
def test_answers_far_apart_are_two_clusters(paths: Paths) -> None:
    """Four materials, 50 ms, other rays: one answer near the truth, one far off, no third."""
    four = Division(
        ("floor", "ceilings", "end walls", "side walls"),
        (0, 1, 1, 2, 2, 3, 3),
        (0.20, 0.65, 0.35, 0.50),
    )
    truth = np.array(four.true_absorption)
    other = trace_paper_room(paper_scene(), 18_000, "sobol", 5)
    own_rows, other_rows = (
        division_rows(p, 1, whole_windows_s(0, 50), four) for p in (paths, other)
    )
    problem = squares_problem(own_rows, window_energies(other_rows, truth))
    proof = certify(problem, delta=1e-6, width=0.05)
    assert proof.complete
    low = [c for c in proof.clusters if c.value <= proof.value + proof.delta]
    far, near = sorted(low, key=lambda c: -abs(c.minimiser[0] - truth[0]))
    assert np.abs(near.minimiser - truth).max() < 0.05
    assert np.abs(far.minimiser - truth).max() > 0.3


@pytest.mark.slow
def test_seven_materials_of_the_paper_room_are_certified(paths: Paths) -> None:
    """One cluster, which holds the truth and is proven to hold one minimiser."""
    rows = division_rows(paths, 2, whole_windows_s(22, 5), DIVISIONS[7])
    assert rows.materials == PLANES
    truth = np.array(DIVISIONS[7].true_absorption)
    proof = certify(squares_problem(rows, window_energies(rows, truth)), width=0.05)
    (only,) = proof.clusters
    assert proof.complete and only.unique
    assert np.all((only.lower <= truth) & (truth <= only.upper))
