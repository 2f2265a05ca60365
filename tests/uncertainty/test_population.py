"""Draws from a band's posterior against quadrature, and of a posterior with two modes."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from posterior_cases import ExactValues, decay_case, exchangeable_case
from roomfit.solvers.least_squares import fit_band
from roomfit.uncertainty import population
from roomfit.uncertainty.gaussian import FittedBand, band_estimate
from roomfit.uncertainty.intervals import Refinement
from roomfit.uncertainty.population import (
    _led_to_posterior,
    _moved,
    _power_step,
    _resampled,
    _share,
    posterior_draws,
)
from roomfit.uncertainty.sampling import log_posterior


@pytest.mark.parametrize("kind", ["energies", "values"])
def test_draws_have_the_quantiles_of_a_quadrature(kind):
    """Two absorptions near 0 and in the middle, seen in twelve windows or as twelve values.

    Of 1024 draws, each point drawn from twice at most, a third count as independent: a cumulative
    probability of 2.5, 50 or 97.5 % is placed within 0.8 to 2.7 points (one sigma); four of them.
    """
    case = decay_case(np.random.default_rng(4), np.array([0.03, 0.4]), gain=False)
    if kind == "values":
        own = {n: getattr(case, n) for n in ("weight", "hits", "observed", "shape", "parameters")}
        case = ExactValues(**own, sd=0.3)
    fit = fit_band(case)
    law = replace(log_posterior(case, fit), fixed_weights=fit)
    found = posterior_draws(case, fit, 1024, np.random.default_rng(1))
    assert found.draws.shape == (1024, 2)
    assert found.moves >= 0.8
    axis, step = np.linspace(-9.0, 4.2, 45), 0.3
    density = np.array([[law(np.array([x, y])) for y in axis] for x in axis])
    density = np.exp(density - density.max())
    for entry, marginal in enumerate((density.sum(axis=1), density.sum(axis=0))):
        cumulative = np.cumsum(marginal) / marginal.sum()
        for quantile in (0.025, 0.5, 0.975):
            at = np.quantile(found.draws[:, entry], quantile)
            true = np.interp(at, axis + 0.5 * step, cumulative)
            sigma = np.sqrt(quantile * (1.0 - quantile) / (1024 / 3))
            assert abs(true - quantile) < 4.0 * sigma + 0.003, (entry, quantile, true)


def test_values_that_two_walls_explain_either_way_are_drawn_either_way():
    """A fit ends in 0.1 and 0.6, or in 0.6 and 0.1; both are as likely, and it knows of one.

    Of 128 points some 30 count as independent when the two modes part: the share of either
    scatters by 0.09, the mean over four seeds by 0.05; 0.2 is four of them.
    """
    case = exchangeable_case()
    own = {n: getattr(case, n) for n in ("weight", "hits", "observed", "shape", "parameters")}
    values = ExactValues(**own, sd=0.03)
    fit = fit_band(values, start=np.array([-2.0, 0.3]))
    assert fit.vector[0] < fit.vector[1] - 1.0
    shares = []
    for seed in range(4):
        draws = posterior_draws(values, fit, 128, np.random.default_rng(seed)).draws
        gap = draws[:, 0] - draws[:, 1]
        assert np.mean(np.abs(gap) > 1.0) > 0.95
        shares.append(np.mean(gap > 0.0))
    assert abs(np.mean(shares) - 0.5) < 0.2, shares


def test_equal_seeds_give_equal_draws():
    case = decay_case(np.random.default_rng(5), np.array([0.2, 0.4]))
    fit = fit_band(case)
    one, same, other = (
        posterior_draws(case, fit, 40, np.random.default_rng(seed)).draws for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, same)
    assert one.shape == (40, 3)
    assert not np.array_equal(one, other)


def test_draws_and_samples_are_those_of_the_seed():
    """Two seeds differ and one repeats itself, with draws for predictions and with samples."""
    case = decay_case(np.random.default_rng(4), np.array([0.2]), gain=False)
    fit = fit_band(case)
    answer = band_estimate(case.parameters, fit, "energy")
    band = FittedBand(answer, case, fit)
    drawn, samples = (
        [Refinement(way, seed, n_draws=16)(band) for seed in (1, 2, 2)]
        for way in ("gaussian", "posterior")
    )
    assert not np.array_equal(drawn[0].draws, drawn[1].draws)
    np.testing.assert_array_equal(drawn[1].draws, drawn[2].draws)
    chains = [s.sampling.draws for s in samples]
    assert not np.array_equal(chains[0], chains[1])
    np.testing.assert_array_equal(chains[1], chains[2])


WIDE = 2.0


def wide_walk(points, steps, rng):
    """Move under a normal law of standard deviation 2, with the gain of its log density."""
    keep = 0.8 if steps > 1 else 0.5
    there = keep * points + np.sqrt(1.0 - keep**2) * WIDE * rng.standard_normal(points.shape)
    return there, -0.5 * np.sum(there**2 - points**2, axis=1) / WIDE**2


NEAR = SimpleNamespace(
    walk=wide_walk, usual_steps=(1, 3), prior=np.eye(2) / WIDE**2, prior_mean=np.zeros(2)
)
MEAN = np.array([0.7, -0.4])


def log_target(points: np.ndarray) -> np.ndarray:
    """Return the log density of unit normal numbers about a mean."""
    return -0.5 * np.sum((points - MEAN) ** 2, axis=1)


def log_wide(points: np.ndarray) -> np.ndarray:
    return -0.5 * np.sum(points**2, axis=1) / WIDE**2


def check_target(points: np.ndarray, independent: int) -> None:
    """Four standard errors of mean and variance, of so many independent points."""
    assert np.abs(points.mean(axis=0) - MEAN).max() < 4.0 / np.sqrt(independent)
    assert np.abs(points.var(axis=0) - 1.0).max() < 4.0 * np.sqrt(2.0 / independent)


@pytest.mark.parametrize("from_prior", [False, True])
def test_moves_leave_draws_of_the_posterior_what_they_are(from_prior):
    """Walks under a law twice as wide, and differences of others; log densities follow them."""
    rng = np.random.default_rng(3)
    points = MEAN + rng.standard_normal((8000, 2))
    here = points, log_target(points), log_wide(points)
    for _ in range(3):
        here, moves, rounds = _moved(log_target, NEAR, here, rng, from_prior=from_prior)
        assert moves >= 0.8 and rounds <= 5
    moved, log_p, _ = here
    check_target(moved, 8000)
    assert np.mean(np.all(moved == points, axis=1)) < 0.2
    np.testing.assert_allclose(log_p, log_target(moved), atol=1e-9)


@pytest.mark.parametrize("from_prior", [False, True])
@pytest.mark.parametrize(("sd", "away"), [(1.0, 1.0), (0.1, 1.0), (1.0, 5.0)])
def test_points_of_the_first_law_become_points_of_the_posterior(from_prior, sd, away):
    """A law half as wide, a narrow one, one at nearly two deviations: moves at each power.

    Of 8000 points a thousand count as independent at least.
    """

    def log_p(points: np.ndarray) -> np.ndarray:
        return log_target(MEAN + (points - away * MEAN) / sd)

    rng = np.random.default_rng(4)
    points = WIDE * rng.standard_normal((8000, 2))
    here = points, log_p(points), log_wide(points)
    found, rounds = _led_to_posterior(log_p, NEAR, here, rng, from_prior=from_prior)
    assert 1 <= rounds <= 20
    check_target(MEAN + (found[0] - away * MEAN) / sd, 1000)
    np.testing.assert_allclose(found[1], log_p(found[0]), atol=1e-9)


def test_the_power_grows_until_half_of_the_population_counts():
    """Of weights 1 and 0 in equal parts a half counts; equal weights are taken at once."""
    assert _share(np.zeros(10), 1.0) == pytest.approx(1.0)
    assert _share(np.repeat([0.0, -1e3], 5), 1.0) == pytest.approx(0.5)
    assert _power_step(np.zeros(10), 0.7) == 0.7
    ratio = -0.5 * np.random.default_rng(0).normal(size=4000) ** 2 * 40.0
    step = _power_step(ratio, 1.0)
    assert 1e-3 < step < 1.0 and _share(ratio, step) == pytest.approx(0.5, abs=1e-6)
    # a step of a thousandth is made even where fewer count then
    assert _power_step(1e9 * ratio, 0.5) == pytest.approx(0.5e-3)


def test_points_are_drawn_as_often_as_their_weights_ask_for():
    """To the next whole number on either side, whatever the seed."""
    weights = np.array([0.05, 0.25, 0.1, 0.6])
    log_weight = np.log(np.tile(weights / 25.0, 25)) + 700.0
    counts = np.bincount(_resampled(log_weight, np.random.default_rng(6)), minlength=100)
    assert counts.sum() == 100
    assert np.all(np.abs(counts - 100.0 * np.tile(weights / 25.0, 25)) < 1.0)


def test_points_count_by_kish_and_one_that_outweighs_all_others_stops_no_way():
    """By Kish's number, (sum w)**2 / sum w**2; as far as asked where more would count."""
    ratio = 3.0 * np.random.default_rng(1).standard_normal(500)
    w = np.exp(0.3 * ratio)
    assert population._share(ratio, 0.3) == pytest.approx(w.sum() ** 2 / np.sum(w**2) / 500)
    assert population._share(ratio + 900.0, 0.3) == pytest.approx(population._share(ratio, 0.3))
    step = population._power_step(ratio, 1.0)
    assert 0.0 < step < 1.0
    assert population._share(ratio, step) == pytest.approx(0.5, abs=1e-6)
    assert population._power_step(ratio, 0.5 * step) == 0.5 * step
    assert population._power_step(0.01 * ratio, 1.0) == 1.0
    # a single point that outweighs all others may not stop the way
    assert population._power_step(np.append(np.zeros(9), 1e9), 0.8) == pytest.approx(8e-4)


def test_differences_of_other_points_keep_a_law_and_a_tempered_one_as_well():
    """4,000 points of a normal law of deviation 2; half tempered, its variance is 1 / (1/8 + 1/2).

    The prior is standard; a variance of 4,000 points is known to 2.2 %, and that of moved ones,
    of which few are new, to twice that.
    """
    rng = np.random.default_rng(3)
    near = SimpleNamespace(prior=np.eye(2), prior_mean=np.zeros(2))

    def log_p_at(points):
        return -0.125 * np.sum(points**2, axis=1)

    for tempered, variance in ((None, 4.0), ((near, 0.5), 1.0 / (0.125 + 0.5))):
        points = np.sqrt(variance) * rng.standard_normal((4000, 2))
        log_p = log_p_at(points)
        for _ in range(3):
            before = points
            points, log_p, taken = population._differed(log_p_at, points, log_p, rng, tempered)
            np.testing.assert_allclose(log_p, log_p_at(points))
            assert taken == pytest.approx(np.mean(np.any(points != before, axis=1)), abs=1e-12)
            assert 0.2 < taken < 0.8
        np.testing.assert_allclose(points.var(axis=0), variance, rtol=0.1)


def test_walks_are_weighed_by_what_the_surrogate_gains_less():
    """Of a surrogate of another deviation: taken with the ratio of both, at a power of it."""
    rng = np.random.default_rng(4)

    def walk(points, _steps, rng):
        there = 1.5 * rng.standard_normal(points.shape)
        return there, np.sum(points**2 - there**2, axis=1) / 4.5

    near = SimpleNamespace(walk=walk, usual_steps=(1, 2))

    def log_p_at(points):
        return -0.5 * np.sum(points**2, axis=1)

    for power in (1.0, 0.5):
        # between the surrogate, of variance 2.25, and the posterior
        variance = 1.0 / (power + (1.0 - power) / 2.25)
        points = np.sqrt(variance) * rng.standard_normal((4000, 2))
        here = points, log_p_at(points), -np.sum(points**2, axis=1) / 4.5
        for _ in range(3):
            found = population._walked(log_p_at, near, here, power, rng)
            here, taken = found[:3], found[3]
            np.testing.assert_allclose(here[1], log_p_at(here[0]))
            np.testing.assert_allclose(here[2], -np.sum(here[0] ** 2, axis=1) / 4.5)
            assert 0.4 < taken < 1.0
        np.testing.assert_allclose(here[0].var(axis=0), variance, rtol=0.1)
