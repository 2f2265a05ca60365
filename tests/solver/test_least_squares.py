"""Bounded least squares, where to start it, and how many minima there are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roomfit.base.typing import FloatArray
from roomfit.model.eyring import decay_rate_per_s, eyring_absorption, eyring_time_s
from roomfit.paper.search import SimplexSettings, downhill_simplex, simplex_around
from roomfit.paper.searches import (
    descend,
    fit_least_squares,
    grid_minima,
    landscape,
    minima_of_descents,
    starts,
)
from roomfit.solver import Ending

TIMES = np.linspace(0.0, 2.0, 20)


def decays(x: FloatArray) -> FloatArray:
    """Two decays of rates that depend on x in two ways."""
    return np.exp(-3.0 * x[0] * TIMES) + 0.5 * np.exp(-8.0 * x[1] * TIMES)


def decay_residuals(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Differences from the decays at (0.3, 0.8), with their exact derivative."""
    slopes = (
        -3.0 * TIMES * np.exp(-3.0 * x[0] * TIMES),
        -4.0 * TIMES * np.exp(-8.0 * x[1] * TIMES),
    )
    return decays(x) - decays(np.array([0.3, 0.8])), np.stack(slopes, axis=1)


def two_wells(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Residuals that vanish at x0 = 0.2; at x0 = 0.7 they are 0.1 more; a ridge between."""
    r = np.array([5.0 * (x[0] - 0.2) * (x[0] - 0.7), 0.2 * (x[0] - 0.2), x[1] - 0.5])
    return r, np.array([[5.0 * (2.0 * x[0] - 0.9), 0.0], [0.2, 0.0], [0.0, 1.0]])


def oblique_valley(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A straight narrow valley askew to any grid, falling slowly to its one minimum."""
    along, across = np.array([-0.45, 0.89]), np.array([0.89, 0.45])
    matrix = np.stack((0.1 * along, 20.0 * across))
    return matrix @ (x - np.array([0.65, 0.35])), matrix


def test_exact_data_are_explained_exactly_and_the_simplex_agrees() -> None:
    """To rounding for least squares; the simplex comes as near as its tolerance lets it."""
    fit = fit_least_squares(decay_residuals, np.array([[0.5, 0.5]]))
    np.testing.assert_allclose(fit.x, [0.3, 0.8], atol=1e-8)
    assert fit.ending is Ending.CONVERGED
    simplex = downhill_simplex(
        lambda x: float(np.sum(decay_residuals(x)[0] ** 2)),
        simplex_around(np.array([0.5, 0.5]), 0.2),
        SimplexSettings(tolerance=1e-12),
    )
    np.testing.assert_allclose(fit.x, simplex.x, atol=1e-4)


def test_cost_is_equation_1_and_every_call_is_counted() -> None:
    """The sum of squares, not half of it as scipy has it; one evaluation gives both arrays."""
    calls = 0

    def watched(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        nonlocal calls
        calls += 1
        return two_wells(x)

    fit = fit_least_squares(watched, np.array([[0.8, 0.1]]))
    assert fit.cost == pytest.approx(np.sum(two_wells(fit.x)[0] ** 2), rel=1e-12)
    assert fit.evaluations == calls == len(fit.trail)


def test_several_starts_keep_the_best_end() -> None:
    """From 0.8 alone the fit ends in the worse well near 0.7; a start at 0.3 saves it."""
    alone = fit_least_squares(two_wells, np.array([[0.8, 0.5]]))
    both = fit_least_squares(two_wells, np.array([[0.8, 0.5], [0.3, 0.5]]))
    assert alone.x[0] == pytest.approx(0.69, abs=0.02)
    np.testing.assert_allclose(both.x, [0.2, 0.5], atol=1e-8)
    assert both.evaluations > alone.evaluations


def test_an_exact_answer_ends_the_starts() -> None:
    """The second start is never tried once the first is good enough."""
    points = np.array([[0.3, 0.5], [0.8, 0.5]])
    first = fit_least_squares(two_wells, points[:1])
    stopped = fit_least_squares(two_wells, points, good_enough=1e-12)
    assert stopped.evaluations == first.evaluations


def test_a_minimum_outside_the_box_is_sought_on_its_wall() -> None:
    """Residual x - 1.3 in one unknown is least at the wall 1."""
    fit = fit_least_squares(
        lambda x: (np.array([x[0] - 1.3, x[1] - 0.5]), np.eye(2)), np.array([[0.5, 0.2]])
    )
    np.testing.assert_allclose(fit.x, [1.0, 0.5], atol=1e-4)


@given(rate=st.floats(5.0, 60.0), offset=st.floats(0.0, 0.02))
def test_the_rate_of_an_exponential_decay_is_read_exactly(rate: float, offset: float) -> None:
    """Window energies of exp(-k t) in closed form, long enough that nothing is cut off."""
    edges = offset + np.linspace(0.0, 40.0 / rate, 200)
    energy = -np.diff(np.exp(-rate * edges))
    # what lies behind the last window (1e-17) and rounding are all that is left out
    assert decay_rate_per_s(energy, edges) == pytest.approx(rate, rel=1e-6)


def test_a_response_that_does_not_decay_has_rate_zero() -> None:
    """A single late arrival: the energy that remains is level."""
    assert decay_rate_per_s(np.array([0.0, 0.0, 0.0, 1.0]), np.arange(5) / 10.0) == 0.0


@given(absorption=st.floats(0.03, 0.97), m=st.floats(0.0, 0.05))
def test_eyrings_rate_gives_eyrings_absorption_back(absorption: float, m: float) -> None:
    """T = 55.26 V / (c (4 m V - S ln(1 - a))), the textbook form, to its four digits."""
    volume, surface, c = 622.5, 464.6, 341.0
    t60 = 55.26 * volume / (c * (4.0 * m * volume - surface * np.log1p(-absorption)))
    found = eyring_absorption(6.0 * np.log(10.0) / t60, volume, surface, c, m)
    assert found == pytest.approx(absorption, rel=1e-3)
    # and the same formula solved for the time
    time_s = eyring_time_s(np.array(absorption), volume, surface, c, np.array(m))
    assert time_s == pytest.approx(t60, rel=1e-4)


def test_starts_begin_with_the_uniform_one() -> None:
    """Then come random points of the box."""
    points = starts(0.3, 4, 5, np.random.default_rng(0))
    assert points.shape == (6, 4)
    np.testing.assert_array_equal(points[0], 0.3)
    assert points.min() >= 0.0 and points.max() <= 1.0


def test_diagonal_neighbours_decide_between_four_and_eight() -> None:
    """The 2 in the middle lies below its four neighbours, but the 1 at its corner below it."""
    errors = np.array([[9.0, 9.0, 1.0], [9.0, 2.0, 9.0], [9.0, 9.0, 9.0]])
    grid = np.array([0.0, 0.5, 1.0])
    assert grid_minima(errors, grid, 4) == ((0.0, 1.0), (0.5, 0.5))
    assert grid_minima(errors, grid, 8) == ((0.0, 1.0),)


@pytest.mark.slow
def test_an_oblique_valley_has_false_minima_on_a_grid_and_one_in_truth() -> None:
    """What happens in Figure 5 of the paper, in closed form."""
    shape = landscape(lambda x: float(np.sum(oblique_valley(x)[0] ** 2)), oblique_valley)
    assert len(shape.four_neighbours) > 1
    np.testing.assert_allclose(shape.minima.x, [[0.65, 0.35]], atol=1e-8)
    assert shape.minima.descents == (441,)


def test_descents_do_not_leap_over_a_ridge() -> None:
    """Points on either side of the ridge near 0.45 end in their own well."""
    for x, well in ((0.44, 0.2), (0.05, 0.2), (0.48, 0.69), (0.95, 0.69)):
        end, _ = descend(two_wells, np.array([x, 0.9]))
        np.testing.assert_allclose(end, [well, 0.5], atol=0.02)


def test_both_wells_are_reported_with_the_better_first() -> None:
    """Starts spread evenly end in two places."""
    points = np.array([(a, b) for a in np.linspace(0, 1, 9) for b in (0.0, 1.0)])
    found = minima_of_descents(two_wells, points)
    assert found.x.shape == (2, 2)
    assert found.x[0, 0] == pytest.approx(0.2, abs=1e-6)
    assert found.error[0] < found.error[1]
    assert sum(found.descents) == len(points)
