"""The rule of acceptance (10), the schedule, and landscapes with many minima."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roomfit.base.typing import FloatArray
from roomfit.model.parameters import Parameters
from roomfit.paper.search import (
    accepts,
    anneal,
    annealing_solver,
    downhill_simplex,
    random_simplex,
    simplex_solver,
)
from roomfit.solver import (
    Ending,
)

TRUE = np.array([0.62, 0.27])


def rastrigin(x: FloatArray) -> float:
    """Rastrigin's function on a box of 8 by 8 units: about 64 minima, the lowest 0 at TRUE."""
    y = 8.0 * (x - TRUE[: x.size])
    return float(np.sum(y * y + 10.0 * (1.0 - np.cos(2.0 * np.pi * y))))


@pytest.mark.parametrize(("change", "temperature"), [(0.1, 1.0), (2.0, 1.0), (5.0, 10.0)])
def test_a_rise_is_accepted_with_boltzmanns_probability(change: float, temperature: float) -> None:
    """Equation (10) accepts with exp(-change / T): binomial, 100,000 trials, 4.5 sigma.

    A right rule fails one run in 150,000; the seed is fixed.
    """
    rng = np.random.default_rng(20010226)
    n = 100_000
    hits = sum(accepts(change, temperature, rng) for _ in range(n))
    p = np.exp(-change / temperature)
    assert abs(hits - n * p) <= 4.5 * np.sqrt(n * p * (1.0 - p))


@given(change=st.floats(-1e6, -1e-9), temperature=st.floats(1e-6, 1e6), seed=st.integers(0, 2**32))
def test_a_fall_is_always_accepted(change: float, temperature: float, seed: int) -> None:
    """T log(random) is never above 0, which lies below -change."""
    assert accepts(change, temperature, np.random.default_rng(seed))


@pytest.mark.slow
def test_cooled_slowly_annealing_finds_the_lowest_of_many_minima_and_the_simplex_does_not() -> None:
    """Ten seeds each: all of the one, few of the other."""

    def found(x: FloatArray) -> bool:
        return bool(np.max(np.abs(x - TRUE)) < 1e-3)

    slowly = partial(anneal, rastrigin, 2, cooling=0.96, levels=120, trials_per_unknown=50)
    annealed = [slowly(np.random.default_rng(s)).x for s in range(10)]
    descended = [
        downhill_simplex(rastrigin, random_simplex(2, np.random.default_rng(s))).x
        for s in range(10)
    ]
    assert sum(map(found, annealed)) == 10
    assert sum(map(found, descended)) <= 5


def test_a_minimum_in_a_corner_is_found() -> None:
    """Steps are mirrored at the walls, so that corners are visited as often as the middle."""
    fit = anneal(lambda x: float(np.sum(x)), 3, np.random.default_rng(1))
    np.testing.assert_allclose(fit.x, 0.0, atol=1e-4)


def test_nothing_is_evaluated_outside_the_unit_box_and_every_call_is_counted() -> None:
    """The function asked counts for itself."""
    calls: list[FloatArray] = []

    def watched(x: FloatArray) -> float:
        calls.append(x)
        return rastrigin(x)

    fit = anneal(watched, 2, np.random.default_rng(3))
    assert np.min(calls) >= 0.0 and np.max(calls) <= 1.0
    assert fit.evaluations == len(calls)


def test_the_same_seed_takes_the_same_way() -> None:
    """Bit by bit, trail and all; another seed takes another way."""
    first, again, other = (
        anneal(rastrigin, 2, np.random.default_rng(seed)).trail for seed in (5, 5, 6)
    )
    np.testing.assert_array_equal(first, again)
    assert first.shape != other.shape or not np.array_equal(first, other)


def test_a_hot_walk_goes_up_and_down_and_a_cold_one_only_down() -> None:
    """States at the end of 20 temperatures, near 1e9 and near 1e-9."""
    hot, cold = (
        anneal(
            rastrigin,
            2,
            np.random.default_rng(2),
            start_temperature=temperature,
            cooling=0.99,
            levels=20,
        ).trail[:20]
        for temperature in (1e9, 1e-9)
    )
    hot, cold = ([rastrigin(x) for x in states] for states in (hot, cold))
    assert np.all(np.diff(cold) <= 1e-6)
    assert np.count_nonzero(np.diff(hot) > 0.0) >= 5


def test_a_cold_walk_takes_every_fall_it_meets() -> None:
    """On a plane half of all steps fall: of 120 trials enough to walk into the corner.

    From the lowest of 20 random points; a temperature far below any change of the error.
    """
    found = anneal(
        lambda x: 5.0 + float(np.sum(x)),
        2,
        np.random.default_rng(4),
        start_temperature=1e-9,
        levels=6,
    )
    errors = [5.0 + np.sum(x) for x in np.random.default_rng(4).random((20, 2))]
    assert 5.0 + np.sum(found.trail[5]) < 5.0 + 0.2 * (min(errors) - 5.0)


def test_a_schedule_is_sixty_temperatures_of_ten_trials_each_nine_tenths_as_high() -> None:
    """Bit by bit what these numbers give when stated; ten random points an unknown come first."""
    calls: list[FloatArray] = []

    def watched(x: FloatArray) -> float:
        calls.append(np.array(x))
        return rastrigin(x)

    usual = anneal(watched, 2, np.random.default_rng(5))
    stated = anneal(
        rastrigin, 2, np.random.default_rng(5), cooling=0.9, levels=60, trials_per_unknown=10
    )
    np.testing.assert_array_equal(usual.trail, stated.trail)
    assert usual.evaluations == stated.evaluations == len(calls)
    np.testing.assert_array_equal(calls[:20], np.random.default_rng(5).random((20, 2)))


def test_without_unknowns_there_is_nothing_to_search() -> None:
    """Neither a simplex nor annealing asks for an error."""
    nothing = Parameters(())
    for solver in (simplex_solver(nothing), annealing_solver(nothing, np.random.default_rng(1))):
        end = solver(lambda _: pytest.fail("nothing to evaluate"), np.zeros(0))
        assert (end.x.size, end.cost, end.evaluations) == (0, 0.0, 0)
        assert end.ending is Ending.CONVERGED
