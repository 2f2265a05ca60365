"""Equations (2) to (10) of Suh (2001) by hand, against scipy, and where the paper leaves room."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import minimize

from roomfit.base.typing import FloatArray
from roomfit.fit.simplex import (
    Fit,
    accepts,
    anneal,
    downhill_simplex,
    random_simplex,
    simplex_around,
)

VERTICES = np.array([[0.2, 0.2], [0.4, 0.2], [0.3, 0.5]])


def bowl(x: FloatArray) -> float:
    """An askew quadratic with its minimum 0.5 at (0.35, 0.6)."""
    a, b = x[0] - 0.35, x[1] - 0.6
    return float(0.5 + 3.0 * a * a + 2.0 * a * b + b * b)


def rosenbrock(x: FloatArray) -> float:
    """Rosenbrock's banana on [-2, 2]^2, brought into the unit box; minimum 0 at (0.75, 0.75)."""
    a, b = 4.0 * x - 2.0
    return float((1.0 - a) ** 2 + 100.0 * (b - a * a) ** 2)


@pytest.mark.parametrize("function", [bowl, rosenbrock])
@pytest.mark.parametrize("iterations", [1, 2, 5, 10, 20])
def test_it_visits_the_points_of_scipys_nelder_mead(
    function: Callable[[FloatArray], float], iterations: int
) -> None:
    """Move for move, as long as no contraction fails (there scipy drops the reflected point)."""
    start = np.array([[0.3, 0.4], [0.4, 0.4], [0.3, 0.5]])
    ours = downhill_simplex(function, start, tolerance=1e-300)
    # scipy counts its first simplex as an iteration
    options = {"initial_simplex": start, "maxiter": iterations + 1, "xatol": 0.0, "fatol": 0.0}
    theirs = minimize(function, start[0], method="Nelder-Mead", options=options)
    np.testing.assert_allclose(ours.trail[iterations], theirs.x, rtol=0, atol=1e-12)


@pytest.mark.parametrize("function", [bowl, rosenbrock])
def test_it_finds_the_minimum_of_known_functions(
    function: Callable[[FloatArray], float],
) -> None:
    """To 1e-3 in place: errors within 1e-10 leave sqrt(1e-10 / curvature) at most 1e-4 or so."""
    start = simplex_around(np.array([0.2, 0.3]), 0.1)
    fit = downhill_simplex(function, start, tolerance=1e-10)
    true = (0.35, 0.6) if function is bowl else (0.75, 0.75)
    np.testing.assert_allclose(fit.x, true, atol=1e-3)
    assert fit.ending.converged


def test_a_search_out_of_evaluations_says_so_and_what_to_do() -> None:
    """It ends within one move (at most n + 3 evaluations) of its limit."""
    fit = downhill_simplex(rosenbrock, VERTICES, max_evaluations=30)
    assert not fit.ending.converged
    assert "start again" in fit.ending.advice
    assert 30 <= fit.evaluations <= 35


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
    assert accepts(-1e-9, temperature, rng)


@pytest.mark.slow
def test_cooled_slowly_annealing_finds_the_lowest_of_many_minima_and_the_simplex_does_not() -> None:
    """Ten seeds each: all of the one, few of the other."""

    def found(x: FloatArray) -> bool:
        return bool(np.max(np.abs(x - TRUE)) < 1e-3)

    slowly = {"cooling": 0.96, "levels": 120, "trials_per_unknown": 50}
    seeds = [np.random.default_rng(s) for s in range(10)]
    annealed = [anneal(rastrigin, 2, rng, **slowly).x for rng in seeds]
    descended = [downhill_simplex(rastrigin, random_simplex(2, rng)).x for rng in seeds]
    assert sum(map(found, annealed)) == 10
    assert sum(map(found, descended)) <= 5


def test_nothing_is_evaluated_outside_the_unit_box_and_every_call_is_counted() -> None:
    """A slope whose minimum lies in a corner; the function counts for itself."""
    asked: list[FloatArray] = []

    def slope(x: FloatArray) -> float:
        asked.append(x.copy())
        return float(x[0] + 2.0 * x[1])

    def annealed() -> Fit:
        return anneal(slope, 2, np.random.default_rng(3))

    for search in (lambda: downhill_simplex(slope, VERTICES), annealed):
        fit = search()
        assert np.min(asked) >= 0.0 and np.max(asked) <= 1.0
        assert fit.evaluations == len(asked)
        np.testing.assert_allclose(fit.x, 0.0, atol=1e-4)
        asked.clear()
