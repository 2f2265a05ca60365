"""What the certified search computes, kernel by kernel, beside plain numpy and brute force."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from roomfit.paper import bounds, convex
from roomfit.paper.bounds import UNIT_ROUNDOFF, kappa_nodes, planes_over, powers

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
