"""Draws from a band's posterior against quadrature, and of a posterior with two modes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posterior_cases import ExactValues, decay_case, exchangeable_case
from roomfit.solver import fit_band
from roomfit.uncertainty.gaussian import FittedBand, band_estimate
from roomfit.uncertainty.intervals import Refinement
from roomfit.uncertainty.population import (
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


def test_draws_for_predictions_are_those_of_the_seed():
    """Two seeds differ and one repeats itself."""
    case = decay_case(np.random.default_rng(4), np.array([0.2]), gain=False)
    fit = fit_band(case)
    band = FittedBand(band_estimate(case.parameters, fit, "values"), case, fit)
    one, two, again = (Refinement(False, seed, n_draws=16)(band) for seed in (1, 2, 2))
    assert not np.array_equal(one.draws, two.draws)
    np.testing.assert_array_equal(two.draws, again.draws)
