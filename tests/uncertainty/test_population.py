"""Draws from a band's posterior against quadrature, and of a posterior with two modes."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from posterior_cases import ExactValues, decay_case, exchangeable_case
from roomfit.solvers.least_squares import fit_band
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
