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
    moved_downhill,
    random_simplex,
    simplex_around,
)

VERTICES = np.array([[0.2, 0.2], [0.4, 0.2], [0.3, 0.5]])


ERRORS = np.array([1.0, 2.0, 3.0])


# the candidates of the first move, by (3), (4) and (5) on paper
REFLECTED, EXPANDED = (0.3, -0.1), (0.3, -0.4)
CONTRACTED, CONTRACTED_FROM_REFLECTED = (0.3, 0.35), (0.3, 0.05)


def table(**errors: float) -> tuple[Callable[[FloatArray], float], list[str]]:
    """Return an error function that knows the candidates by name, and the list of those asked."""
    names = {
        "reflected": REFLECTED,
        "expanded": EXPANDED,
        "contracted": CONTRACTED,
        "contracted_from_reflected": CONTRACTED_FROM_REFLECTED,
        "shrunk_second": (0.3, 0.2),
        "shrunk_highest": (0.25, 0.35),
        "shrunk_reflected": (0.25, 0.05),
    }
    asked: list[str] = []

    def error(x: FloatArray) -> float:
        name = next(n for n, point in names.items() if np.allclose(x, point, rtol=0, atol=1e-12))
        asked.append(name)
        return errors[name]

    return error, asked


def moved(**errors: float) -> tuple[FloatArray, list[str]]:
    """Return the vertices after one move, lowest first, and what was evaluated."""
    error, asked = table(**errors)
    return moved_downhill(VERTICES, ERRORS, error)[0], asked


def test_a_reflection_between_lowest_and_second_highest_is_taken_as_it_is() -> None:
    """Equation (3) with alpha = 1."""
    vertices, asked = moved(reflected=1.5)
    np.testing.assert_allclose(vertices, [[0.2, 0.2], REFLECTED, [0.4, 0.2]], atol=1e-12)
    assert asked == ["reflected"]


@pytest.mark.parametrize(("expanded", "kept"), [(0.1, EXPANDED), (0.7, REFLECTED)])
def test_nelder_and_mead_expand_where_the_reflection_is_the_best_so_far(
    expanded: float, kept: tuple[float, float]
) -> None:
    """Equation (4) with gamma = 2; the better of the two points stays."""
    vertices, asked = moved(reflected=0.5, expanded=expanded)
    np.testing.assert_allclose(vertices[0], kept, atol=1e-12)
    assert asked == ["reflected", "expanded"]


def test_nelder_and_mead_contract_from_the_better_of_highest_and_reflected() -> None:
    """A reflection that only beats the highest vertex takes its place before the contraction."""
    inside, _ = moved(reflected=4.0, contracted=2.5)
    np.testing.assert_allclose(inside[2], CONTRACTED, atol=1e-12)
    outside, _ = moved(reflected=2.8, contracted_from_reflected=2.5)
    np.testing.assert_allclose(outside[2], CONTRACTED_FROM_REFLECTED, atol=1e-12)


def test_after_a_failed_contraction_the_simplex_halves_towards_its_lowest_vertex() -> None:
    """The paper is silent here; Nelder and Mead (1965) shrink."""
    after = {"contracted": 6.0, "shrunk_second": 1.2, "shrunk_highest": 1.4}
    expected = [[0.2, 0.2], [0.3, 0.2], [0.25, 0.35]]
    vertices, _ = moved(reflected=4.0, **after)
    np.testing.assert_allclose(vertices, expected, atol=1e-12)


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
