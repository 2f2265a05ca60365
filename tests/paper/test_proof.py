"""A proof of the lowest error holds at every point tried, and finds all minima that there are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from certified_cases import errors_of, random_case
from roomfit.base.typing import FloatArray
from roomfit.paper.proof import Certificate, certify
from roomfit.paper.room import (
    Division,
    SquaresProblem,
    division_rows,
    error,
    paper_problem,
    paper_scene,
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


@pytest.fixture(scope="module")
def paths() -> Paths:
    """The 18,000 rays of the paper's room."""
    return trace_paper_room(paper_scene())


@pytest.mark.parametrize("name", ["case1", "ill_defined", "three_materials"])
def test_where_a_cluster_is_called_unique_chords_lie_above(name: str, paths: Paths) -> None:
    """Midpoints of random chords in log(1 - absorption), in which the error is then convex."""
    problem = paper_problem(name, paths)
    (only,) = certify(problem).clusters
    assert only.unique
    low, high = np.log1p(-only.upper), np.log1p(-only.lower)
    ends = low + np.random.default_rng(1).random((2, 500, low.size)) * (high - low)
    middle = errors_of(problem, -np.expm1(0.5 * (ends[0] + ends[1])))
    sides = [errors_of(problem, -np.expm1(own)) for own in ends]
    assert np.all(middle <= 0.5 * (sides[0] + sides[1]) * (1.0 + 1e-9) + 1e-12)


def test_a_mirror_symmetric_case_1_has_exactly_two_minimisers(paths: Paths) -> None:
    """Source and receiver stand half way between south and north: exchanging them changes nothing.

    By rays that are mirror symmetric: the truth and its mirror image, each proven alone.
    """
    truth = np.array([0.65, 0.10, 0.25])
    walls = Division(("all others", "south", "north"), (0, 0, 0, 0, 0, 1, 2), tuple(truth))
    rows = division_rows(paths, 0, whole_windows_s(15, 5), walls)
    hits = np.stack((rows.hits, rows.hits[:, [0, 2, 1]]), axis=1)
    rows = replace(
        rows,
        offsets=2 * rows.offsets,
        weight_per_m2=0.5 * np.repeat(rows.weight_per_m2, 2),
        hits=hits.reshape(-1, 3),
        length_m=np.repeat(rows.length_m, 2),
        batch=np.repeat(rows.batch, 2),
        path=None,
    )
    proof = certify(SquaresProblem(rows, window_energies(rows, truth)))
    assert proof.complete and len(proof.clusters) == 2
    assert all(c.unique for c in proof.clusters)
    for expected in (truth, truth[[0, 2, 1]]):
        off = min(np.abs(c.minimiser - expected).max() for c in proof.clusters)
        assert off < 1e-6
