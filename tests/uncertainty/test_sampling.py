"""Draws from a band's posterior by values against quadrature, and of a posterior with two modes."""

from __future__ import annotations

import numpy as np

from posterior_cases import decay_case, exact_values, exchangeable_case
from roomfit.model.parameters import prior_residuals
from roomfit.solver import fit_band
from roomfit.uncertainty.gaussian import FittedBand, band_estimate
from roomfit.uncertainty.intervals import Refinement
from roomfit.uncertainty.sampling import posterior_draws


def test_draws_have_the_quantiles_of_a_quadrature():
    """Two absorptions near 0 and in the middle, seen in twelve values with normal errors.

    Of 1024 draws, each point drawn from twice at most, a third count as independent: a cumulative
    probability of 2.5, 50 or 97.5 % is placed within 0.8 to 2.7 points (one sigma); four of them.
    """
    values = exact_values(
        decay_case(np.random.default_rng(4), np.array([0.03, 0.4]), gain=False), 0.3
    )
    fit = fit_band(values)
    draws, _ = posterior_draws(values, fit, 1024, np.random.default_rng(1))
    assert draws.shape == (1024, 2)

    def log_density(point):
        off = (values.observed - values.expected(point)) / values.sd
        prior, _ = prior_residuals(values.parameters, point)
        return -0.5 * (off @ off / max(fit.chi2_reduced, 1.0) + prior @ prior)

    axis, step = np.linspace(-9.0, 4.2, 45), 0.3
    density = np.array([[log_density(np.array([x, y])) for y in axis] for x in axis])
    density = np.exp(density - density.max())
    for entry, marginal in enumerate((density.sum(axis=1), density.sum(axis=0))):
        cumulative = np.cumsum(marginal) / marginal.sum()
        for quantile in (0.025, 0.5, 0.975):
            at = np.quantile(draws[:, entry], quantile)
            true = np.interp(at, axis + 0.5 * step, cumulative)
            sigma = np.sqrt(quantile * (1.0 - quantile) / (1024 / 3))
            assert abs(true - quantile) < 4.0 * sigma + 0.003, (entry, quantile, true)


def test_values_that_two_walls_explain_either_way_are_drawn_either_way():
    """A fit ends in 0.1 and 0.6, or in 0.6 and 0.1; both are as likely, and it knows of one.

    Of 128 points some 30 count as independent when the two modes part: the share of either
    scatters by 0.09, the mean over four seeds by 0.05; 0.2 is four of them.
    """
    values = exact_values(exchangeable_case(), 0.03)
    fit = fit_band(values, start=np.array([-2.0, 0.3]))
    assert fit.vector[0] < fit.vector[1] - 1.0
    shares = []
    for seed in range(4):
        draws, _ = posterior_draws(values, fit, 128, np.random.default_rng(seed))
        gap = draws[:, 0] - draws[:, 1]
        assert np.mean(np.abs(gap) > 1.0) > 0.95
        shares.append(np.mean(gap > 0.0))
    assert abs(np.mean(shares) - 0.5) < 0.2, shares


def test_draws_for_predictions_are_those_of_the_seed():
    """Two seeds differ and one repeats itself."""
    case = exact_values(decay_case(np.random.default_rng(4), np.array([0.2, 0.4]), gain=False), 0.3)
    fit = fit_band(case)
    band = FittedBand(band_estimate(case.parameters, fit, "values"), case, fit)
    one, two, again = (Refinement(False, seed, n_draws=16)(band) for seed in (1, 2, 2))
    assert one.draws.shape == (16, 2)
    assert not np.array_equal(one.draws, two.draws)
    np.testing.assert_array_equal(two.draws, again.draws)
