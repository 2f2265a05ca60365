"""The certified search: what it proves is true of points drawn at random, and bugs are caught."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

from certified_cases import misfit_of, random_case, reaching_black
from roomfit.base.typing import FloatArray
from roomfit.paper.bounds import planes_over, powers
from roomfit.paper.certificate import certify, touching
from roomfit.paper.convex import (
    is_convex,
    least_curvature,
    least_prior,
    minimum_over,
    prior_at,
    priors_over,
)
from roomfit.paper.global_search import (
    Incumbent,
    Searched,
    SearchSettings,
    search,
    tools_for,
)
from roomfit.paper.question import GlobalProblem
from roomfit.paper.repeat import squares_global_problem
from roomfit.paper.room import (
    DIVISIONS,
    SquaresProblem,
    division_rows,
    paper_problem,
    paper_scene,
    residuals,
    squares_problem,
    trace_paper_room,
    walls_apart_problem,
    whole_windows_s,
    window_energies,
)
from roomfit.paper.searches import fit_least_squares
from roomfit.tracing.paths import Paths


def points_near_the_lowest(
    problem: SquaresProblem,
    global_problem: GlobalProblem,
    found: Searched,
    rng: np.random.Generator,
    n: int,
) -> tuple[FloatArray, FloatArray]:
    """Return points in alpha and their misfits: all over the domain, and a walk of small misfits.

    The walkers start from the lowest point, and go wherever the misfit stays within delta of it.
    """
    dim = len(global_problem.coordinates)
    lowest = 1.0 - np.exp(found.minimiser)
    limit = found.value + found.delta
    walkers = np.tile(lowest, (n // 10, 1))
    observed = [rng.random((n // 10, dim)) * 0.9995]
    step = 0.1 * np.ones((n // 10, 1))
    for _ in range(9):
        moved = walkers + step * rng.standard_normal((n // 10, dim)) * rng.random((n // 10, 1))
        # mirrored back into the domain
        moved = np.clip(np.abs(moved), 0.0, 0.9995)
        inside = misfit_of(problem, global_problem, moved) <= limit
        walkers = np.where(inside[:, None], moved, walkers)
        step = np.where(inside[:, None], 1.5 * step, 0.4 * step)
        observed.append(moved)
    points = np.concatenate(observed)
    return points, misfit_of(problem, global_problem, points)


def outside(found: Searched, points: FloatArray) -> FloatArray:
    """Return which points no box holds."""
    with np.errstate(divide="ignore"):
        g = np.log1p(-points)[:, None, :]
    # alpha and g are both rounded: 1e-13 is more than what that moves a point
    slack = 1e-13 * (1.0 + np.abs(g))
    held = np.zeros(len(points), dtype=bool)
    for box in found.boxes:
        held |= np.all(
            (g[:, 0] >= box[0] - slack[:, 0]) & (g[:, 0] <= box[1] + slack[:, 0]), axis=1
        )
    return ~held


def broken_promises(seeds: range, n_points: int) -> tuple[int, int]:
    """Search random rooms; count points below the threshold, and those that prove it wrong."""
    low, wrong = 0, 0
    for seed in seeds:
        problem, global_problem = random_case(seed, 2 + seed % 3)
        if seed % 2:
            global_problem = reaching_black(global_problem)
        first = search(global_problem, SearchSettings(1e-6, max_boxes=2))
        delta = 0.2 * first.value + 1e-6
        found = search(global_problem, SearchSettings(delta, width=0.05, max_boxes=500))
        rng = np.random.default_rng(1000 + seed)
        points, values = points_near_the_lowest(problem, global_problem, found, rng, n_points)
        below = values <= found.value + delta
        low += int(below.sum())
        wrong += int(np.count_nonzero(outside(found, points[below])))
        wrong += int(np.count_nonzero(values < found.lower_bound * (1.0 - 1e-9)))
    return low, wrong


@pytest.mark.slow
def test_no_point_below_the_threshold_lies_outside_the_cover() -> None:
    """Of 40,000 points in ten random rooms, none breaks the promise."""
    low, wrong = broken_promises(range(10), 4000)
    assert low > 5000
    assert wrong == 0


def random_boxes(
    global_problem: GlobalProblem, rng: np.random.Generator, n: int
) -> list[tuple[FloatArray, FloatArray]]:
    """Return boxes of every size in g, with 200 points of each: corners, faces and inside."""
    out = []
    for _ in range(n):
        dim = len(global_problem.coordinates)
        centre = np.log(rng.uniform(1e-3, 1.0, dim))
        half = rng.uniform(0.0, 1.0, dim) * 10.0 ** rng.uniform(-4.0, 0.3)
        box = np.stack((centre - half, np.minimum(centre + half, 0.0)))
        share = np.clip(rng.uniform(-0.3, 1.3, (200, dim)), 0.0, 1.0)
        out.append((box, box[0] + share * (box[1] - box[0])))
    return out


def bound_over(
    global_problem: GlobalProblem, box: FloatArray, planes: Any, threshold: float
) -> float:
    """Return the convex lower bound over one box, which no point below a threshold goes under."""
    tools = tools_for(global_problem)
    corners, apart, own, centre, half = planes(
        *(tools.data, box[0], box[1], tools.most, tools.nodes, tools.rounding),
        *(threshold, tools.values),
    )
    separable = priors_over(tools.data[5], box[0], box[1], centre, half)
    least = minimum_over(
        *(tools.data, own, separable, -half, half, threshold, np.zeros(half.size), True)
    )
    return min(max(corners, apart + least), threshold)


def bounds_broken(planes: Any, n_materials: int) -> tuple[int, float]:
    """Count the points whose misfit lies below the bound of their box; and how tight bounds are."""
    broken, tight = 0, []
    for seed in range(6):
        problem, global_problem = random_case(seed, n_materials)
        if seed % 2:
            # more energy than any absorption leaves: the upper planes decide
            problem = replace(problem, measured=1.8 * problem.measured)
            global_problem = replace(global_problem, measured=problem.measured)
        for box, points in random_boxes(global_problem, np.random.default_rng(seed), 30):
            values = misfit_of(problem, global_problem, 1.0 - np.exp(points))
            bound = bound_over(global_problem, box, planes, 1.001 * values.min() + 1e-12)
            # misfits by hand are rounded: energies by 1e-13 of themselves
            slack = 1e-9 * (values + 1e-9)
            broken += int(np.count_nonzero(values + slack < bound))
            tight.append(bound / values.min())
    return broken, float(np.median(tight))


def halved(*arguments: Any) -> Any:
    """Return planes with half of the remainder that they need: a bug."""
    corners, apart, planes, centre, half = planes_over(*arguments)
    level, slope, remainder, tail, share, planar = planes
    # the corner bound, which is sound, would hide the bug
    return 0.0 * corners, apart, (level, slope, 0.5 * remainder, tail, share, planar), centre, half


@pytest.mark.parametrize("n_materials", [1, 2, 5])
def test_the_bound_of_a_box_lies_below_every_misfit_in_it(n_materials: int) -> None:
    """36,000 points of boxes from 1e-4 to 2 wide; bounds that are not vacuous."""
    broken, tight = bounds_broken(planes_over, n_materials)
    assert broken == 0
    assert tight > 0.8


def test_half_a_remainder_is_caught_by_points_in_boxes() -> None:
    """The check above fails for planes with a planted bug: seen best with one material."""
    broken, _ = bounds_broken(halved, 1)
    assert broken > 0


@pytest.mark.parametrize("n_materials", [2, 4, 9])
def test_log_energies_lie_between_the_planes(n_materials: int) -> None:
    """Point by point and window by window, with vertices and, above eight, with moments."""
    rng = np.random.default_rng(n_materials)
    problem, global_problem = random_case(3, min(n_materials, 4))
    if n_materials > 4:
        hits = rng.poisson(0.7, (len(problem.rows), n_materials))
        global_problem = replace(
            global_problem,
            coordinates=tuple(f"m{i}" for i in range(n_materials)),
            is_absorption=np.ones(n_materials, dtype=bool),
            exponents=hits,
            least=np.full(n_materials, -7.0),
            most=np.zeros(n_materials),
            prior=np.zeros((n_materials, 4)),
        )
    tools = tools_for(global_problem)
    checked = 0
    for box, points in random_boxes(global_problem, rng, 60):
        corners, _, planes, centre, _ = planes_over(
            *(tools.data, box[0], box[1], tools.most, tools.nodes, tools.rounding),
            *(np.inf, tools.values),
        )
        assert np.isfinite(corners)
        level, slope, remainder, _, _, planar = planes
        each = global_problem.weight * np.exp(points @ global_problem.exponents.T.astype(float))
        for i in np.flatnonzero(planar):
            energy = each[:, global_problem.offsets[i] : global_problem.offsets[i + 1]].sum(axis=1)
            off = np.log(energy) - level[i] - (points - centre) @ slope[i]
            # numpy's own sums, exponentials and logarithms: 1e-12 of numbers below 100
            assert np.all(off >= -1e-10)
            assert np.all(off <= remainder[i] + 1e-10)
            checked += 1
    assert checked > 60


def test_where_a_box_is_called_convex_chords_lie_above() -> None:
    """Midpoints of random chords; and a good part of the small boxes near the lowest is convex."""
    convex = 0
    for seed in range(6):
        problem, global_problem = random_case(seed, 3)
        tools = tools_for(global_problem)
        rng = np.random.default_rng(seed)
        place = search(global_problem, SearchSettings(1e-6, max_boxes=2)).minimiser
        for _ in range(30):
            half = rng.uniform(0.2, 1.0, 3) * 10.0 ** rng.uniform(-3.0, 0.0)
            box = np.stack((place - half, place + half))
            if not is_convex(tools.data, box, tools.most, tools.values):
                continue
            convex += 1
            ends = box[0] + rng.random((2, 200, 3)) * (box[1] - box[0])
            one, two, middle = (
                misfit_of(problem, global_problem, 1.0 - np.exp(g))
                for g in (ends[0], ends[1], 0.5 * (ends[0] + ends[1]))
            )
            assert np.all(middle <= 0.5 * (one + two) * (1.0 + 1e-9) + 1e-12)
    assert convex >= 20


def test_no_other_method_goes_below_the_lower_bound() -> None:
    """Least squares from random starts and Nelder-Mead, six random rooms, alphas up to 1."""
    for seed in range(6):
        problem, global_problem = random_case(seed, 3)
        global_problem = replace(global_problem, precision=np.ones(global_problem.measured.size))
        settings = SearchSettings(1e-3 * problem.measured @ problem.measured, width=0.2)
        found = certify(reaching_black(global_problem), settings)
        assert found.status == "certified"
        rng = np.random.default_rng(seed)
        fit = fit_least_squares(partial(residuals, problem), rng.random((8, 3)))
        simplex = minimize(
            lambda x, p=problem, q=global_problem: float(
                misfit_of(p, q, np.clip(x, 0, 1)[None])[0]
            ),
            rng.random(3),
            method="Nelder-Mead",
        )
        assert found.lower_bound <= min(fit.cost, simplex.fun)
        # and its own value is as low as the best of them, but for their last digits
        assert found.value <= min(fit.cost, simplex.fun) * (1.0 + 1e-6) + 1e-12


def test_a_search_that_is_stopped_says_so_and_its_bound_still_holds() -> None:
    """After five boxes of many; the cover and the bound are proven all the same."""
    problem, global_problem = random_case(4, 4)
    stopped = search(global_problem, SearchSettings(0.1, max_boxes=5))
    found = certify(global_problem, SearchSettings(0.1, max_boxes=5))
    assert stopped.n_open > 0
    assert found.status == "stopped"
    assert f"{found.n_open} boxes are open" in found.sentence
    points = np.random.default_rng(1).random((5000, 4)) * 0.9995
    values = misfit_of(problem, global_problem, points)
    assert np.all(values >= stopped.lower_bound)
    assert not outside(stopped, points[values <= stopped.value + 0.1]).any()


def test_priors_lie_above_their_quadratics_and_add_to_the_misfit() -> None:
    """On intervals of every length, for means far below and above, with and without bounds."""
    rng = np.random.default_rng(0)
    for _ in range(300):
        lower, upper = (0.0, 1.0) if rng.random() < 0.5 else (0.05, 0.9)
        prior = np.array([[rng.uniform(0.1, 3.0), rng.uniform(-4.0, 4.0), 1 - lower, 1 - upper]])
        ends = np.sort(rng.uniform(lower + 1e-3, upper - 1e-3, 2))
        lo, hi = np.log1p(-ends[1:]), np.log1p(-ends[:1])
        centre, half = 0.5 * (lo + hi), 0.5 * (hi - lo)
        value, slope, curve = priors_over(prior, lo, hi, centre, half)
        d = np.linspace(-1.0, 1.0, 101) * half
        absorption = -np.expm1(centre + d)
        share = (absorption - lower) / (upper - lower)
        true = prior[0, 0] * (np.log(share / (1.0 - share)) - prior[0, 1]) ** 2
        assert curve[0] >= 0.0
        assert np.all(value + slope * d + 0.5 * curve * d**2 <= true * (1.0 + 1e-9) + 1e-9)


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


def test_case_1_with_its_walls_apart_has_exactly_two_minimisers(paths: Paths) -> None:
    """With mirror-symmetric rays: the truth, and south and north exchanged; each proven alone."""
    problem = walls_apart_problem(paths, mirrored=True)
    found = certify(squares_global_problem(problem.squares), SearchSettings(1e-8))
    assert found.status == "certified"
    assert len(found.clusters) == 2
    assert all(c.unique for c in found.clusters)
    mirrored = problem.true_absorption[[0, 1, 2, 4, 3]]
    for expected in (problem.true_absorption, mirrored):
        off = min(np.abs(c.minimiser - expected).max() for c in found.clusters)
        assert off < 1e-6


def test_answers_far_apart_are_two_clusters(paths: Paths) -> None:
    """Four materials, 50 ms, other rays: one answer near the truth, one far off, no third."""
    truth = np.array([0.20, 0.65, 0.35, 0.50])
    other = trace_paper_room(paper_scene(), 18_000, "sobol", 5)
    own_rows, other_rows = (
        division_rows(p, 1, whole_windows_s(0, 50), DIVISIONS[4]) for p in (paths, other)
    )
    problem = squares_problem(own_rows, window_energies(other_rows, truth))
    found = certify(squares_global_problem(problem), SearchSettings(1e-6, width=0.05))
    assert found.status == "certified"
    assert len(found.clusters) == 2
    far, near = sorted(found.clusters, key=lambda c: -abs(c.minimiser[0] - truth[0]))
    assert np.abs(near.minimiser - truth).max() < 0.05
    assert np.abs(far.minimiser - truth).max() > 0.3
    # both are what descents from random points end in
    rng = np.random.default_rng(0)
    ends = [fit_least_squares(partial(residuals, problem), x[None]) for x in rng.random((40, 4))]
    low = np.array([e.x for e in ends if e.cost < 1e-6])
    for cluster in found.clusters:
        assert np.abs(low - cluster.minimiser).max(axis=1).min() < 0.01
    inside = [any(np.all((c.lower <= x) & (x <= c.upper)) for c in found.clusters) for x in low]
    assert all(inside)


def test_seven_materials_of_the_paper_room_are_certified(paths: Paths) -> None:
    """One cluster, which holds the truth and is proven to hold one minimiser."""
    problem = paper_problem("seven_materials", paths)
    found = certify(squares_global_problem(problem.squares), SearchSettings(1e-8))
    assert found.status == "certified"
    (only,) = found.clusters
    assert only.unique
    assert np.all((only.lower <= problem.true_absorption) & (problem.true_absorption <= only.upper))
    assert found.boxes < 2000


def test_a_higher_misfit_is_no_incumbent_and_black_walls_have_no_energy() -> None:
    """Both as kernels and search rely on them."""
    lowest = Incumbent(1.0, np.zeros(2))
    lowest.offer(2.0, np.ones(2))
    assert lowest.value == 1.0
    assert powers(np.array([-np.inf]), 2).tolist() == [[1.0, 0.0, 0.0]]


def test_bounds_of_a_prior_hold_over_an_interval_and_are_exact_on_a_short_one():
    """Of the value and of the second derivative, against 200 points of the interval each.

    Derivatives at a point are those of central differences.
    """
    rng = np.random.default_rng(6)
    for _ in range(200):
        # a weight, a mean logit, and one less both bounds of the absorption
        p, mean, a, b = rng.uniform((0.1, -3.0, 0.8, 0.0), (2.0, 3.0, 1.0, 0.2))
        prior = np.array([p, mean, a, b])
        lo, hi = np.sort(np.log(rng.uniform(b + 0.02, a - 0.02, 2)))
        points = np.array([prior_at(prior, g) for g in np.linspace(lo, hi, 200)])
        assert least_prior(prior, lo, hi) <= points[:, 0].min() + 1e-12
        assert least_curvature(prior, lo, hi) <= points[:, 2].min()
        value, first, second = points[100]
        g, h = np.linspace(lo, hi, 200)[100], 1e-5
        below, above = prior_at(prior, g - h), prior_at(prior, g + h)
        assert first == pytest.approx((above[0] - below[0]) / (2 * h), rel=1e-5, abs=1e-6)
        assert second == pytest.approx((above[1] - below[1]) / (2 * h), rel=1e-5, abs=1e-6)
        assert least_prior(prior, g - 1e-10, g + 1e-10) == pytest.approx(value, rel=1e-6, abs=1e-7)
        # a billionth, as it says, of terms that may cancel; and 1e-10 of their own slopes
        short = least_curvature(prior, g - 1e-10, g + 1e-10)
        assert short == pytest.approx(
            second, abs=1e-5 * (abs(second) + 100.0 * p * (1 + abs(mean)))
        )


def test_a_quadratic_below_priors_is_below_them_everywhere_and_near_where_they_bend_little():
    """Weak priors, whose curvature is between 0 and 1, and strong ones."""
    rng = np.random.default_rng(7)
    touched = 0
    for _ in range(300):
        p, mean, a, b = rng.uniform((0.02, -3.0, 0.8, 0.0), (1.0, 3.0, 1.0, 0.2))
        prior = np.array([[p, mean, a, b]])
        middle = np.log(rng.uniform(b + 0.1, a - 0.1))
        half = rng.choice([0.01, 0.1, 0.3])
        centre, width = np.array([middle]), np.array([half])
        value, slope, curve = priors_over(prior, centre - half, centre + half, centre, width)
        away = np.linspace(-half, half, 101)
        bound = value + slope * away + 0.5 * curve * away**2
        exact = np.array([prior_at(prior[0], middle + d)[0] for d in away])
        assert np.all(bound <= exact)
        touched += bool(exact[50] - bound[50] <= 1e-6 * (1.0 + exact[50]))
    # nowhere else is the least value of the interval nearer
    assert touched > 60


def test_the_seconds_of_a_search_are_those_that_pass_during_it():
    _, global_problem = random_case(3, 2)
    began = time.perf_counter()
    found = search(global_problem, SearchSettings(1e-2, max_boxes=5))
    assert 0.0 < found.seconds <= time.perf_counter() - began
