"""What the certified search computes, kernel by kernel, beside plain numpy and brute force."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from roomfit.certified import bounds, convex
from roomfit.certified.bounds import UNIT_ROUNDOFF, kappa_nodes, planes_over, powers

NODES = kappa_nodes()


def question(seed: int, n: int = 3, *, is_silent: bool = False) -> Any:
    """Return four windows of five rows each in the form of kernels; the last may have no path."""
    rng = np.random.default_rng(seed)
    weight, hits = rng.uniform(0.1, 1.0, 20), rng.integers(0, 5, (20, n))
    if is_silent:
        weight[15:] = 0.0
    measured = rng.uniform(0.2, 2.0, 4)
    prior = np.column_stack(
        (rng.uniform(0.5, 2.0, n), rng.normal(size=n), np.full(n, 0.99), np.full(n, 0.02))
    )
    prior[-1, 0] = 0.0
    offsets = np.arange(0, 21, 5, dtype=np.int64)
    own = (offsets, weight, hits.astype(np.uint16), measured, rng.uniform(0.5, 2.0, 4), prior)
    return (*own, np.ones(n, dtype=np.bool_))


def box_about(seed: int, n: int = 3, half: float = 0.1) -> Any:
    """Return lower and upper ends in g, centre and half widths."""
    centre = np.log(np.random.default_rng([seed, 1]).uniform(0.3, 0.9, n))
    widths = half * np.random.default_rng([seed, 2]).uniform(0.3, 1.0, n)
    return np.stack((centre - widths, centre + widths)), centre, widths


def by_hand(asked: Any, g: Any) -> Any:
    """Return row values, energies, mean exponents and covariances of exponents at a point."""
    _, weight, hits, *_ = asked
    values = (weight * np.exp(hits.astype(float) @ g)).reshape(4, 5)
    energy, hits = values.sum(axis=1), hits.astype(float).reshape(4, 5, -1)
    share = values / np.where(energy > 0.0, energy, 1.0)[:, None]
    mean = np.einsum("wk,wkm->wm", share, hits)
    off = hits - mean[:, None]
    return values.ravel(), energy, mean, np.einsum("wk,wka,wkb->wab", share, off, off)


def slopes(asked: Any, g: Any) -> Any:
    """Return row values, energies and slopes as kernels have them."""
    values, energy, slope = np.empty(20), np.empty(4), np.empty((4, len(g)))
    far = np.zeros(len(g), dtype=np.bool_)
    bounds.log_slopes(asked, powers(g, 4), far, values, energy, slope)
    return values, energy, slope


def costs(asked: Any, g: Any) -> float:
    """Return the misfit with its priors, written out."""
    *_, measured, precision, prior, _ = asked
    a = 1.0 - np.exp(g)
    lower, upper = 1.0 - prior[:, 2], 1.0 - prior[:, 3]
    known = prior[:, 0] > 0.0
    logit = np.log(((a - lower) / (upper - a))[known])
    off = by_hand(asked, g)[1] - measured
    return float(precision @ off**2 + prior[known, 0] @ (logit - prior[known, 1]) ** 2)


def gradient_of(f: Any, x: Any, h: float = 1e-6) -> Any:
    return np.array([(f(x + e) - f(x - e)) / (2.0 * h) for e in h * np.eye(len(x))])


def test_a_window_s_misfit_has_the_slopes_of_finite_differences_in_the_logarithm():
    """f of L = log R, first and second; without the residual's part where R is what it should."""
    m, c, level = 0.7, 1.3, -0.4

    def f(x):
        return c * (np.exp(x) - m) ** 2

    value, first, second = bounds.in_log(m, c, level)
    assert value == pytest.approx(f(level)) == bounds.misfit(m, c, np.exp(level))
    h = 1e-4
    assert first == pytest.approx((f(level + h) - f(level - h)) / (2 * h), rel=1e-6)
    assert second == pytest.approx((f(level + h) - 2 * f(level) + f(level - h)) / h**2, rel=1e-5)
    assert bounds.stiffness(c, m) == pytest.approx(bounds.in_log(m, c, np.log(m))[2])


def test_a_line_lies_on_the_squares_from_below_and_touches_them_as_far_left_as_it_may():
    """The tangent through the left end; 14 bisections of log 2; none where nothing bends down."""
    m = 0.8
    bend = np.log(0.5 * m)
    for left in (bend - 3.0, bend - 1.0, bend - 0.1):
        tail = bounds.tail_of_squares(m, left)
        value, slope, _ = bounds.in_log(m, 1.0, tail)
        at = np.linspace(left, 1.0, 400)
        assert np.all(value + slope * (at - tail) <= (np.exp(at) - m) ** 2 + 1e-11)
        step = np.log(2.0) / 2**14
        nearer, steeper, _ = bounds.in_log(m, 1.0, tail - 1.01 * step)
        assert nearer + steeper * (left - tail + 1.01 * step) > (np.exp(left) - m) ** 2
    assert bounds.tail_of_squares(m, bend) == bend == bounds.tail_of_squares(m, 1.0)
    assert bounds.tail_of_squares(0.0, 1.0) == -np.inf


def test_the_lower_bound_of_a_window_is_the_least_over_its_levels_with_its_slopes():
    """By a grid of levels; beyond the tail on the line, whose slope is one number."""
    m, c, rest = 0.8, 1.7, 0.3
    for level in (-1.2, -0.6, -0.4, -0.1, 0.5):
        tail = -5.0
        value, first, second = bounds.lower_bound(m, c, level, rest, tail)
        assert value == pytest.approx(
            (c * (np.exp(np.linspace(level, level + rest, 3001)) - m) ** 2).min(), abs=1e-6
        )

        def f(x, order):
            return bounds.lower_bound(m, c, x, rest, -5.0)[order]

        h = 1e-5
        assert first == pytest.approx((f(level + h, 0) - f(level - h, 0)) / (2 * h), abs=1e-6)
        assert second == pytest.approx((f(level + h, 1) - f(level - h, 1)) / (2 * h), abs=1e-5)
    tail = -0.9
    on, slope, _ = bounds.in_log(m, c, tail)
    for level in (-1.3, -2.0):
        found = bounds.lower_bound(m, c, level, rest, tail)
        assert found == pytest.approx((on + slope * (level + rest - tail), slope, 0.0))
    assert bounds.lower_bound(0.0, c, -1.0, rest, -np.inf) == bounds.in_log(0.0, c, -1.0)


@pytest.mark.parametrize("n", [1, 3])
def test_energies_slopes_and_moments_of_windows_are_those_of_numpy(n):
    """Of rows that are left out for want of size or as black the energy at the upper corner."""
    asked = question(1, n)
    g = box_about(1, n)[1]
    values, energy, slope = slopes(asked, g)
    rows, sums, mean, covariance = by_hand(asked, g)
    np.testing.assert_allclose(values, rows, rtol=1e-13)
    np.testing.assert_allclose(energy, sums, rtol=1e-13)
    np.testing.assert_allclose(slope, mean, rtol=1e-12, atol=1e-14)
    each = np.empty(4)
    bounds.energies(asked, powers(g, 4), each)
    np.testing.assert_allclose(each, sums, rtol=1e-13)
    spread = np.full((n, n), 7.0)
    bounds._variances(asked, 2, values, energy[2], slope[2], spread)
    np.testing.assert_allclose(np.diag(spread), 0.5 * np.diag(covariance[2]), rtol=1e-11)
    far = np.arange(n) == 0
    bounds.log_slopes(asked, powers(g, 4), far, values, energy, slope)
    struck = asked[2][:, 0] > 0
    np.testing.assert_allclose(values, np.where(struck, 0.0, rows), rtol=1e-13)
    ghost = np.zeros(4)
    bounds._vanishing(asked, powers(g, 4), values, ghost)
    np.testing.assert_allclose(ghost, sums - values.reshape(4, 5).sum(axis=1), rtol=1e-12)
    small = (*asked[:1], np.where(np.arange(20) % 2, asked[1], 1e-260), *asked[2:])
    bounds.log_slopes(small, powers(g, 4), np.zeros(n, dtype=np.bool_), values, energy, slope)
    np.testing.assert_array_equal(values == 0.0, np.arange(20) % 2 == 0)


def test_how_far_a_window_rises_above_its_tangent_plane_is_that_of_the_highest_vertex():
    """Of all eight; infinite where a row may change by a factor beyond e**600."""
    asked, (_, centre, half) = question(2), box_about(2, half=0.5)
    values, energy, slope = slopes(asked, centre)
    product, sums = np.empty(8), np.empty(8)
    for i in range(4):
        own = (asked, i, values, energy[i], slope[i])
        off = asked[2].astype(float).reshape(4, 5, 3)[i] - slope[i]
        share = values.reshape(4, 5)[i] / energy[i]
        vertices = [
            share @ np.exp(off @ (half * np.array(signs)))
            for signs in itertools.product((-1.0, 1.0), repeat=3)
        ]
        found = bounds.vertex_remainder(*own, half, product, sums)
        assert found == pytest.approx(np.log(max(vertices)), rel=1e-9)
        reach = np.max(np.abs(off) @ half)
        for to, is_finite in ((599.0, True), (601.0, False)):
            far = bounds.vertex_remainder(*own, half * to / reach, product, sums)
            assert np.isfinite(far) == is_finite


def test_second_moments_of_a_window_are_weighed_by_what_an_exponential_may_add():
    """kappa never below ``(exp(rho) - 1 - rho) / rho**2``, and above by little."""
    rho = np.append(np.linspace(0.01, 15.9, 300), [15.99, 16.0, 40.0, 699.0])
    exact = (np.expm1(rho) - rho) / rho**2
    found = np.array([bounds.kappa(x, NODES) for x in rho])
    assert np.all(found >= exact * (1.0 - 1e-10))
    # a chord over 1/32 lies above by an eighth of the second derivative at most; beyond, by 1 + rho
    assert np.all(found <= exact * np.where(rho < 16.0, 1.001, 1.1))
    assert bounds.kappa(0.0, NODES) == pytest.approx(0.5, rel=1e-12)
    assert bounds.kappa(701.0, NODES) == np.inf
    asked, (_, centre, half) = question(3), box_about(3, half=0.4)
    values, energy, slope = slopes(asked, centre)
    for i in range(4):
        spread = np.full((3, 3), 9.0)
        whole = bounds.spread_of_window(
            asked, i, values, energy[i], slope[i], half, NODES, 0.01, spread
        )
        off = asked[2].astype(float).reshape(4, 5, 3)[i] - slope[i]
        kept = [bounds.kappa(x, NODES) for x in np.abs(off) @ half + 0.01]
        p = values.reshape(4, 5)[i] / energy[i] * kept
        assert whole == pytest.approx(p.sum(), rel=1e-12)
        np.testing.assert_allclose(spread, np.einsum("k,ka,kb->ab", p, off, off), rtol=1e-11)


@pytest.mark.parametrize("n", [1, 2, 4, 9])
def test_the_largest_form_over_a_box_is_that_of_its_best_vertex_or_of_absolute_values(n):
    """Above eight coordinates the sum; never too small, and rounded up by little."""
    rng = np.random.default_rng(n)
    root, half = rng.normal(size=(n, n)), rng.uniform(0.1, 1.0, n)
    spread = root @ root.T
    if n > 8:
        expected = half @ np.abs(spread) @ half
    else:
        signs = np.array(list(itertools.product((-1.0, 1.0), repeat=n))) * half
        expected = np.max(np.einsum("va,ab,vb->v", signs, spread, signs))
    found = bounds.largest_form(spread, half)
    assert expected * (1.0 - 1e-15) <= found <= expected * (1.0 + 1e-11)


def test_rounding_is_counted_by_the_longest_window_the_most_hits_and_the_coordinates():
    """4 units for each, and 64 more; each window then keeps its distance from what was measured."""
    asked = question(4)
    hits = int(asked[2].sum(axis=1).max())
    rounding = bounds.relative_rounding(asked)
    assert rounding == 4.0 * UNIT_ROUNDOFF * (5 + hits + 3 + 64)
    measured = asked[3]
    low, high = measured * [0.5, 1.2, 0.4, 0.9], measured * [0.7, 1.5, 1.1, 0.95]
    each = np.empty(4)
    total = bounds.corner_bound(asked, low, high, 1e-3, each)
    nearest = [0.7 * 1.001, 1.2 * 0.999, 1.0, 0.95 * 1.001]
    expected = asked[4] * (measured * (1.0 - np.array(nearest))) ** 2
    np.testing.assert_allclose(each, expected, rtol=1e-9, atol=1e-15)
    assert total == pytest.approx(expected.sum())


def test_shares_of_coordinates_are_their_parts_of_the_remainders_by_stiffness():
    """2 c R**2 half the variance, times the half width squared; a black one has what may vanish."""
    asked, (box, centre, half) = question(5), box_about(5)
    _, energy, _, covariance = by_hand(asked, centre)
    _, _, planes, middle, widths = planes_over(
        asked, box[0], box[1], 4, NODES, 1e-13, np.inf, np.empty(20)
    )
    np.testing.assert_allclose(middle, centre, rtol=1e-14)
    np.testing.assert_allclose(widths, half, rtol=1e-12)
    variance = np.array([np.diag(own) for own in covariance])
    expected = (2.0 * asked[4] * energy**2) @ (0.5 * variance * half**2)
    np.testing.assert_allclose(planes[4], expected, rtol=1e-9)
    black = np.array([-np.inf, box[0, 1], box[0, 2]])
    _, _, planes, middle, widths = planes_over(
        asked, black, box[1], 4, NODES, 1e-13, np.inf, np.empty(20)
    )
    assert middle[0] == box[1, 0] and 0.0 < widths[0] < 1e-14
    values, weight, hits = by_hand(asked, middle)[0].reshape(4, 5), asked[1], asked[2]
    left = np.where(hits[:, 0].reshape(4, 5) == 0, values, 0.0)
    at_high = (weight * np.exp(hits.astype(float) @ box[1])).reshape(4, 5)
    ghost = np.where(left == 0.0, at_high, 0.0).sum(axis=1)
    own = left.sum(axis=1)
    mean = np.einsum("wk,wkm->wm", left, hits.astype(float).reshape(4, 5, 3)) / own[:, None]
    more = ghost * np.exp(mean @ widths) / own
    stiff = 2.0 * asked[4] * (own * (1.0 + more)) ** 2
    assert planes[4][0] == pytest.approx(stiff @ np.log1p(more), rel=1e-6)


def test_the_convex_bound_has_the_gradient_of_finite_differences_and_priors_of_their_own():
    """At points inside and at the planes' own level: the sum of windows, and of quadratics."""
    asked, (box, centre, half) = question(6), box_about(6)
    threshold = 3.0 * costs(asked, centre)
    _, _, planes, _, _ = planes_over(
        asked, box[0], box[1], 4, NODES, 1e-13, threshold, np.empty(20)
    )
    separable = (np.array([0.1, 0.2, 0.3]), np.array([-0.5, 0.4, 0.0]), np.array([2.0, 0.0, 1.0]))
    gradient, hessian = np.empty(3), np.empty((3, 3))
    level, slope, remainder, tail, *_ = planes

    def f(d):
        whole = sum(v + s * x + 0.5 * k * x * x for v, s, k, x in zip(*separable, d, strict=True))
        for i in range(4):
            at = level[i] + slope[i] @ d
            whole += bounds.lower_bound(asked[3][i], asked[4][i], at, remainder[i], tail[i])[0]
        return whole

    for d in (np.zeros(3), 0.5 * half, np.array([-0.3, 0.8, 0.1]) * half):
        found = convex.bound_at(asked, planes, separable, d, gradient, hessian)
        assert found == pytest.approx(f(d), rel=1e-12)
        np.testing.assert_allclose(gradient, gradient_of(f, d), rtol=1e-5, atol=1e-6)
        second = np.array([
            bounds.lower_bound(asked[3][i], asked[4][i], level[i] + slope[i] @ d, remainder[i],
                               tail[i])[2] for i in range(4)
        ])  # fmt: skip
        expected = np.einsum("w,wa,wb->ab", second, slope, slope) + np.diag(separable[2])
        np.testing.assert_allclose(hessian, expected, rtol=1e-11, atol=1e-12)
    plane = convex._tangent_bound(2.0, np.array([1.0, -2.0, 0.0]), np.zeros(3), -half, 2.0 * half)
    assert plane == pytest.approx(2.0 - half[0] - 4.0 * half[1], rel=1e-11)


def test_a_newton_step_solves_for_what_no_face_of_the_box_holds():
    """A coordinate at its lower end with a slope upwards stays, and at its upper end likewise."""
    rng = np.random.default_rng(7)
    root = rng.normal(size=(4, 4))
    hessian, gradient = root @ root.T + np.eye(4), np.array([1.0, -2.0, 0.5, -0.3])
    low, high = -np.ones(4), np.ones(4)
    for at, held in (
        (np.zeros(4), []),
        (np.array([-1.0, 0.0, 0.0, 1.0]), [0, 3]),
        (np.array([1.0, -1.0, -1.0, 0.0]), [2]),
    ):
        free = [a for a in range(4) if a not in held]
        expected = np.zeros(4)
        expected[free] = -np.linalg.solve(hessian[np.ix_(free, free)], gradient[free])
        found = convex.newton_step(gradient, hessian, at, low, high)
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)


def test_the_misfit_and_its_slopes_are_those_written_out_priors_included():
    """Gradient by finite differences; the Hessian is Gauss's and Newton's, priors' where convex."""
    asked, g = question(8, is_silent=True), box_about(8)[1]
    gradient, hessian = np.empty(3), np.empty((3, 3))
    found = convex.misfit_slopes(asked, g, 4, gradient, hessian)
    assert found == pytest.approx(costs(asked, g), rel=1e-12)
    assert convex.total_misfit(asked, g, 4) == pytest.approx(costs(asked, g), rel=1e-12)
    np.testing.assert_allclose(gradient, gradient_of(lambda x: costs(asked, x), g), rtol=1e-6)
    _, energy, mean, _ = by_hand(asked, g)
    expected = np.einsum("w,wa,wb->ab", 2.0 * asked[4] * energy**2, mean, mean)
    own = [max(convex.prior_at(p, x)[2], 0.0) for p, x in zip(asked[5], g, strict=True)]
    np.testing.assert_allclose(hessian, expected + np.diag(own), rtol=1e-10)
    # how much a relative error of every energy may change, over a way of 0.3
    _, first, second = np.array(
        [bounds.in_log(m, c, np.log(r)) for m, c, r in zip(*asked[3:5], energy, strict=True) if r]
    ).T
    hits = mean[energy > 0.0].sum(axis=1)
    size = np.sum((np.abs(first) + np.abs(second)) * (1.0 + 0.3 * hits))
    assert convex._sensitivity(asked, g, 4, 0.3) == pytest.approx(size, rel=1e-10)


def test_least_slopes_of_a_window_are_the_least_between_its_energies():
    """By a grid, where the least lies inside, and at either end."""
    m, c = 0.8, 1.3
    for low, high in ((0.1, 0.9), (0.25, 0.35), (0.5, 0.9), (0.05, 0.15)):
        r = np.linspace(low, high, 20_001)
        stiff, pull = convex._least_slopes(m, c, low, high)
        assert stiff == pytest.approx((2.0 * c * r * (2.0 * r - m)).min(), abs=1e-7)
        assert pull == pytest.approx((2.0 * c * r * (r - m)).min(), abs=1e-7)


@pytest.mark.parametrize("pull", [1.5, -1.5])
def test_what_is_kept_of_a_covariance_is_less_than_it_anywhere_in_the_box(pull):
    """And all of it on a point; too wide a box, or a row that was left out, is not answered."""
    for seed in range(5):
        asked, (box, centre, half) = question(seed), box_about(seed)
        values, energy, slope = slopes(asked, centre)
        for i in range(4):
            whole = np.zeros((3, 3))
            own = (asked, i, values, energy[i], slope[i])
            assert convex._add_covariance(*own, half, pull, whole)
            points = np.random.default_rng(seed).uniform(*box, (20, 3))
            for g in points:
                left = pull * by_hand(asked, g)[3][i] - whole
                assert np.linalg.eigvalsh(left).min() > -1e-12
            exact = np.full((3, 3), 0.5)
            assert convex._add_covariance(*own, np.zeros(3), pull, exact)
            np.testing.assert_allclose(exact - 0.5, pull * by_hand(asked, centre)[3][i], rtol=1e-7)
            reach = np.max(np.abs(asked[2].astype(float).reshape(4, 5, 3)[i] - slope[i]) @ half)
            for to, is_answered in ((2.999, True), (3.001, False)):
                wide = half * to / reach
                assert convex._add_covariance(*own, wide, pull, whole) == is_answered
            gone = np.where(np.arange(20) == 5 * i + 1, 0.0, values)
            assert not convex._add_covariance(
                asked, i, gone, energy[i], slope[i], half, pull, whole
            )


def test_what_the_mean_of_a_window_moves_is_covered_in_any_basis():
    """``W' f'' y y' W`` below the diagonal at every point of the box; on a point nothing moves."""
    for seed in range(5):
        asked, (box, centre, half) = question(seed), box_about(seed)
        values, energy, slope = slopes(asked, centre)
        basis = np.random.default_rng([seed, 3]).normal(size=(3, 3))
        for i, stiff in itertools.product(range(4), (2.0, -1.0)):
            own = (asked, i, values, energy[i], slope[i])
            moved, still = np.zeros(3), np.full(3, 0.25)
            convex._add_movement(*own, half, basis, stiff, moved)
            convex._add_movement(*own, np.zeros(3), basis, stiff, still)
            np.testing.assert_allclose(still, 0.25, atol=1e-12)
            size = 2.0 if stiff > 0.0 else 2.0 * 1.0
            largest = 0.0
            for g in np.random.default_rng(seed).uniform(*box, (50, 3)):
                y = basis.T @ (by_hand(asked, g)[2][i] - slope[i])
                left = np.diag(moved) - size * np.outer(y, y)
                assert np.linalg.eigvalsh(left).min() > -1e-12
                largest = max(largest, float(size * y @ y))
            # of second order in the widths, as what it covers
            assert moved.sum() < 200.0 * largest


def test_a_matrix_is_whitened_where_it_is_clearly_definite():
    """W' A W is the unit matrix, and so is what `_congruent` makes of it, with its largest sum."""
    root = np.random.default_rng(9).normal(size=(3, 3))
    matrix = root @ root.T + 0.1 * np.eye(3)
    basis = convex._whitening(matrix)
    np.testing.assert_allclose(basis.T @ matrix @ basis, np.eye(3), atol=1e-10)
    found, most = convex._congruent(basis, matrix)
    np.testing.assert_allclose(found, basis.T @ matrix @ basis, atol=1e-12)
    terms = np.abs(basis).T @ np.abs(matrix) @ np.abs(basis)
    assert most == pytest.approx(terms.max(), rel=1e-12)
    for bad in (np.diag([1.0, 0.0, 1.0]), np.ones((3, 3)), -np.eye(3)):
        assert convex._whitening(bad)[0, 0] == np.inf
    assert np.isfinite(convex._whitening(np.diag([1e-12, 1.0, 1e9]))).all()


def test_a_curvature_stays_definite_where_some_share_leaves_more_than_a_thousandth():
    """``1 - t p - (1 / t - 1) y`` of a coordinate, at the best of six shares; of two, the worst."""
    shares = np.array([1e-4, 1e-3, 1e-2, 0.03, 0.1, 0.25])
    one, results = np.eye(1), set[bool]()
    for part, moved in itertools.product((0.0, 0.5, 3.0, 20.0), (0.0, 1e-4, 5e-3, 0.05, 0.33, 0.4)):
        left = np.max(1.0 - shares * part - (1.0 / shares - 1.0) * moved)
        expected = bool(left > 1e-3)
        found = convex._stays_definite(one, one, part * one, np.array([moved]))
        assert found == expected
        both = (np.eye(2), np.eye(2), np.diag([part, 0.0]), np.array([moved, 0.0]))
        assert convex._stays_definite(*both) == expected
        results.add(expected)
    assert results == {True, False}


def test_a_box_is_shaved_by_the_share_it_says_and_loses_no_point_below_the_threshold():
    """Volume kept is the product of the sides kept; 800 points of each box, some cut off."""
    shaved = 0
    for seed in range(5):
        asked = question(seed)
        free = (*asked[:5], np.zeros((3, 4)), asked[6])
        box, centre, _ = box_about(seed, half=0.4)
        low = convex.descend(free, centre, box[0], box[1], 4)[1]
        threshold = low + 0.02
        planes = planes_over(free, box[0], box[1], 4, NODES, 1e-13, threshold, np.empty(20))
        _, apart, own, middle, half = planes
        none = (np.zeros(3), np.zeros(3), np.zeros(3))
        left, d = box.copy(), np.zeros(3)
        convex.minimum_over(free, own, none, -half, half, threshold, d, True)
        kept = convex.contract(free, own, none, left, middle, half, threshold - apart, d)
        sides = np.diff(left, axis=0) / np.diff(box, axis=0)
        assert kept == pytest.approx(float(np.prod(sides)), rel=1e-9)
        points = np.random.default_rng(seed).uniform(*box, (800, 3))
        outside = np.any((points < left[0]) | (points > left[1]), axis=1)
        assert all(costs_free(free, g) >= threshold - 1e-12 for g in points[outside])
        shaved += bool(kept < 1.0)
    assert shaved >= 2


def costs_free(asked: Any, g: Any) -> float:
    """Return the misfit without priors."""
    return float(asked[4] @ (by_hand(asked, g)[1] - asked[3]) ** 2)


def test_the_lowest_point_of_a_convex_box_has_a_bound_next_to_its_misfit():
    """A box so narrow that the misfit is convex: nothing in it is lower, and little between."""
    for seed in range(5):
        asked, (box, centre, _) = question(seed), box_about(seed, half=0.02)
        place, value, least = convex.least_of_convex(asked, box, centre, 4, 1e-13)
        assert value == pytest.approx(costs(asked, place), rel=1e-12)
        points = np.random.default_rng(seed).uniform(*box, (300, 3))
        lowest = min(costs(asked, g) for g in points)
        assert least <= value <= lowest * (1.0 + 1e-9)
        slope = gradient_of(lambda x, asked=asked: costs(asked, x), place)
        reach = np.minimum(slope * (box[0] - place), slope * (box[1] - place)).sum()
        assert least == pytest.approx(value + reach, abs=1e-6)


def test_a_box_is_called_convex_only_where_every_hessian_in_it_is_definite():
    """By finite differences at its corners and middle; never one that reaches an absorption of 1.

    Nor where a window's energy is lost to rounding; one without any path is a constant.
    """
    called = 0
    for seed in range(30):
        asked = question(seed, 2, is_silent=seed % 2 == 0)
        _, centre, _ = box_about(seed, 2)
        if seed % 3:
            centre, _ = convex.descend(asked, centre, centre - 0.2, centre + 0.2, 4)
        half = 0.02 * np.ones(2)
        box = np.stack((centre - half, centre + half))
        black = np.stack((np.array([-np.inf, centre[1] - 0.02]), box[1]))
        assert convex.is_convex(asked, black, 4, np.empty(20)) is False
        if not convex.is_convex(asked, box, 4, np.empty(20)):
            continue
        called += 1
        for g in (centre, *itertools.product(*box.T)):
            hessian = gradient_of(
                lambda x, a=asked: gradient_of(lambda y: costs(a, y), x, 1e-4), np.array(g), 1e-4
            )
            assert np.linalg.eigvalsh(0.5 * (hessian + hessian.T)).min() > 0.0
    assert called >= 8
    asked = question(1, 2)
    faint = (asked[0], 1e-251 * asked[1], *asked[2:])
    box = box_about(1, 2, half=1e-6)[0]
    assert convex.is_convex(faint, box, 4, np.empty(20)) is False
