"""Gaussian intervals by hand: what widens them, and what is called identifiable."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posterior_cases import absorption_block, linear_case
from roomfit.base.logit import expit
from roomfit.materials.priors import unknown_material
from roomfit.model.parameters import Parameters
from roomfit.solver import fit_band
from roomfit.uncertainty.gaussian import (
    absorption_intervals,
    answer_steps,
    fit_covariance,
    prior_only_band,
    weighted_mean_gradient,
)
from roomfit.uncertainty.intervals import identifiable_by_rule

VECTOR = np.array([-1.0, 0.4])
# correlated, far better determined than by the priors of 1.5
COVARIANCE = np.array([[0.04, 0.015], [0.015, 0.09]])


def intervals(misfit: float):
    parameters = Parameters((absorption_block(2),))
    return absorption_intervals(parameters, VECTOR, max(misfit, 1.0) * COVARIANCE, misfit)


@pytest.mark.parametrize(("misfit", "wider"), [(0.2, 1.0), (1.0, 1.0), (1.7, 1.7), (4.0, 4.0)])
def test_misfit_widens_an_interval_and_a_good_fit_does_not_narrow_it(misfit, wider):
    """1.96 roots of the variance times max(phi, 1), in the logit."""
    found = intervals(misfit)
    reach = 1.959964 * np.sqrt(wider * np.diag(COVARIANCE))
    np.testing.assert_allclose(found.lower95, expit(VECTOR - reach), rtol=1e-6)
    np.testing.assert_allclose(found.upper95, expit(VECTOR + reach), rtol=1e-6)


def test_the_mean_of_the_room_has_the_spread_of_draws():
    """Of 200,000 draws in the logit; what bends between them is below 3 % of the width."""
    parameters, weights = Parameters((absorption_block(2),)), np.array([0.7, 0.3])
    small = 0.04 * COVARIANCE
    gradient = weighted_mean_gradient(parameters, VECTOR, weights)
    reach = 1.959964 * np.sqrt(gradient @ small @ gradient)
    drawn = np.random.default_rng(1).multivariate_normal(VECTOR, small, 200_000)
    expected = np.quantile(expit(drawn) @ weights, (0.025, 0.975))
    mean = float(weights @ expit(VECTOR))
    np.testing.assert_allclose((-reach, reach), expected - mean, rtol=0.03)


def test_what_is_called_identifiable_and_what_is_not():
    """Each of the conditions alone fails it, just beyond its limit and not just before."""
    priors = (unknown_material("wall", 1),)  # of a spread of 1.5 in the logit
    just = replace(
        prior_only_band(priors, 0),
        lower95=np.array([0.2]),
        upper95=np.array([0.4 - 1e-9]),
        logit_covariance=np.array([[0.75**2]]),
        chi2_reduced=2.0,
    )
    beyond = {
        "chi2_reduced": 2.01,
        "chi2_beside": 2.01,
        "upper95": np.array([0.401]),
        "logit_covariance": np.array([[0.751**2]]),
    }
    assert identifiable_by_rule([just], priors).all()
    for name, value in beyond.items():
        assert not identifiable_by_rule([replace(just, **{name: value})], priors).any()


def test_an_error_that_all_data_share_moves_the_answer_as_stated_and_is_added_once():
    """By fitting data that are off by it; the misfit does not multiply what is added."""
    problem = linear_case(6)
    fit = fit_band(problem)
    error = np.linspace(0.1, 0.3, problem.observed.size)
    moved = fit_band(type(problem)(problem.matrix, problem.observed + error, problem.sd,
                                   problem.parameters))  # fmt: skip
    steps = answer_steps(problem, fit, problem.predict(fit.vector).jacobian, error[:, None])
    np.testing.assert_allclose(steps[:, 0], moved.vector - fit.vector, atol=1e-6)
    found = fit_covariance(fit, steps) - fit_covariance(fit)
    np.testing.assert_allclose(found, steps @ steps.T, rtol=1e-6, atol=1e-12)
