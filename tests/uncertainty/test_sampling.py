"""The density of a posterior and its surrogate against closed forms."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from posterior_cases import Linear, decay_case, linear_case, surrogate_log_density
from roomfit.model.parameters import Parameters, prior_residuals
from roomfit.model.problem import Prediction
from roomfit.solver import fit_band
from roomfit.uncertainty.sampling import (
    exponent_slopes,
    exponents,
    log_posterior,
    prior_information,
    surrogate,
)


def fitted(problem):
    return fit_band(problem, settled_sd=1e-7)


def test_arrival_times_are_integrated_out_exactly_where_all_is_linear():
    """The marginal of a Gaussian: its information is the Schur complement."""
    problem = linear_case(5)
    fit = fitted(problem)
    law = log_posterior(problem, fit)
    assert law.n_kept == 3
    flat = max(fit.chi2_reduced, 1.0)
    matrix, kept = problem.matrix, slice(0, 3)
    _, rows = prior_residuals(problem.parameters, fit.vector)
    whole = matrix.T @ matrix / (problem.sd**2 * flat) + rows.T @ rows
    schur = np.linalg.inv(np.linalg.inv(whole)[kept, kept])
    # with the data flattened, the maximum moves
    means = np.concatenate([b.prior_mean for b in problem.parameters.blocks])
    weighed = matrix.T @ problem.observed / (problem.sd**2 * flat) + rows.T @ rows @ means
    top = np.linalg.solve(whole, weighed)[kept]
    rng = np.random.default_rng(2)
    points = top + rng.standard_normal((6, 3))
    expected = [-0.5 * (p - top) @ schur @ (p - top) for p in points]
    found = np.array([law(p) for p in points])
    np.testing.assert_allclose(found - found[0], np.array(expected) - expected[0], rtol=1e-8)
    assert law(np.full(3, 1e3)) == -np.inf


@dataclass(frozen=True, eq=False)
class StraightInExponents(Linear):
    """Gaussian data that are linear in ``-log(1 - a)`` of 3 absorptions, and in a geometry."""

    def predict(self, vector):
        share = 1.0 / (1.0 + np.exp(-vector[:3]))
        expected = self.matrix @ np.concatenate((-np.log1p(-share), vector[3:]))
        jacobian = self.matrix * np.concatenate((share, np.ones(vector.size - 3)))
        return Prediction(expected, expected, jacobian)


def test_arrival_times_follow_to_the_best_ones_where_data_are_straight_in_the_exponents():
    """The conditional optimum of a linear problem, by its normal equations: however far away."""
    linear = linear_case(7)
    problem = StraightInExponents(linear.matrix, linear.observed, linear.sd, linear.parameters)
    fit = fitted(problem)
    law = log_posterior(problem, replace(fit, chi2_reduced=1.0))
    of_data = problem.matrix[:, 3:] / problem.sd
    for kept in (np.array([-6.0, 1.0, -1.0]), np.array([2.0, -5.0, 0.5])):
        exponent = np.log1p(np.exp(kept))
        left = (problem.observed - problem.matrix[:, :3] @ exponent) / problem.sd
        best = np.linalg.solve(of_data.T @ of_data + np.eye(4), of_data.T @ left)
        np.testing.assert_allclose(law.ridge(kept), best, atol=1e-4)


def test_the_surrogate_has_the_posteriors_slope_and_curvature_at_the_fit():
    """By finite differences; the posterior's own curvature differs by the residuals' part."""
    problem = decay_case(np.random.default_rng(3), np.array([0.3, 0.5]))
    fit = fitted(problem)
    law = log_posterior(problem, fit)
    near = surrogate(law, fit)
    h, n = 1e-3, fit.vector.size
    steps = h * np.concatenate((np.eye(n), -np.eye(n)))
    ours = surrogate_log_density(near, fit.vector + steps) - surrogate_log_density(
        near, fit.vector[None]
    )
    true = np.array([law(fit.vector + s) for s in steps]) - law(fit.vector)
    np.testing.assert_allclose(ours[:n] - ours[n:], true[:n] - true[n:], atol=2e-3 * h)
    np.testing.assert_allclose(ours[:n] + ours[n:], true[:n] + true[n:], rtol=0.02)


@pytest.mark.parametrize("seed", range(3))
def test_where_arrival_times_are_integrated_out_the_surrogate_has_the_marginal_covariance(seed):
    """Of a linear problem: the part of the inverse of the whole information, not of that alone.

    A millionth is added to the information, so that a direction without any can be inverted.
    """
    problem = linear_case(seed)
    fit = fitted(problem)
    law = log_posterior(problem, fit)
    near, n = surrogate(law, fit), law.n_kept
    assert 0 < n < fit.vector.size
    data = problem.matrix.T @ problem.matrix / problem.sd**2
    prior = prior_information(problem.parameters, fit.vector)
    marginal = np.linalg.inv(data / law.flattening + prior)[:n, :n]
    np.testing.assert_allclose(near.covariance, marginal, rtol=1e-4, atol=1e-8)
    alone = np.linalg.inv((data / law.flattening + prior)[:n, :n])
    assert np.abs(marginal / alone - 1.0).max() > 0.1


def test_a_walk_gains_what_it_says_and_stays_under_its_law():
    """20,000 walkers drawn from a Gaussian law (a linear problem) keep mean and spread.

    A mean of 20,000 has a standard error of 0.7 % of a spread, a variance of 1 %; four of each.
    """
    problem = linear_case(6, n_geometry=0)
    fit = fitted(problem)
    near = surrogate(
        log_posterior(problem, replace(fit, chi2_reduced=1.0)), replace(fit, chi2_reduced=1.0)
    )
    near = replace(near, windows=None, data=np.zeros((3, 3)), pull=np.zeros(3))
    rng = np.random.default_rng(1)
    root = np.linalg.cholesky(np.linalg.inv(near.prior))
    points = near.prior_mean + rng.standard_normal((20_000, 3)) @ root.T
    there, gain = near.walk(points, 5, rng)
    np.testing.assert_allclose(
        gain, surrogate_log_density(near, there) - surrogate_log_density(near, points), atol=1e-9
    )
    scaled = (there - near.prior_mean) @ np.linalg.inv(root).T
    assert np.abs(scaled.mean(axis=0)).max() < 0.028
    assert np.abs(scaled.var(axis=0) - 1.0).max() < 0.04
    assert np.mean(there != points) > 0.5


def test_a_compiled_walk_gains_what_the_readable_law_says():
    """Energies of windows, data that are no energies, and a geometry that is integrated out."""
    for problem in (
        decay_case(np.random.default_rng(3), np.array([0.02, 0.5])),
        linear_case(6, n_geometry=0),
        linear_case(6),
    ):
        fit = fitted(problem)
        near = surrogate(log_posterior(problem, fit), fit)
        rng = np.random.default_rng(1)
        points = near.centre + rng.standard_normal((50, near.centre.size))
        # one walker stands where the law is nothing: it leaves with its first step, or stays
        points[0, 0] = 50.0
        there, gain = near.walk(points, 30, rng)
        expected = surrogate_log_density(near, there[1:]) - surrogate_log_density(near, points[1:])
        np.testing.assert_allclose(gain[1:], expected, rtol=1e-9, atol=1e-9)
        assert gain[0] == np.inf or there[0, 0] == 50.0
        assert np.mean(there != points) > 0.5


def test_a_fit_of_a_band_is_half_done_when_its_logarithms_are():
    told: list[float] = []
    problem = linear_case(5)
    fit = fit_band(problem, progress=told.append, settled_sd=1e-7)
    assert told == [0.5, 1.0] and fit.evaluations == fitted(problem).evaluations


def bounded(problem):
    """Return a problem whose absorptions lie between bounds of their own."""
    block, *others = problem.parameters.blocks
    n = len(block.labels)
    own = replace(block, lower=0.1 * np.arange(n) / n + 0.02, upper=0.9 - 0.1 * np.arange(n))
    return replace(problem, parameters=Parameters((own, *others)))


def test_exponents_of_bounded_absorptions_and_their_slopes_are_those_of_the_formula():
    """-log(1 - a) of a between bounds; all other free numbers stay; slopes by differences."""
    parameters = bounded(linear_case(2)).parameters
    block = parameters.blocks[0]
    points = np.random.default_rng(1).normal(size=(4, 7))
    found = exponents(parameters, points)
    a = block.lower + (block.upper - block.lower) / (1.0 + np.exp(-points[:, :3]))
    np.testing.assert_allclose(found[:, :3], -np.log1p(-a), rtol=1e-12)
    np.testing.assert_array_equal(found[:, 3:], points[:, 3:])
    step = 1e-6 * np.eye(7)
    slope = [(exponents(parameters, points[:1] + s) - exponents(parameters, points[:1] - s))[0, i]
             for i, s in enumerate(step)]  # fmt: skip
    np.testing.assert_allclose(exponent_slopes(parameters, points[0]), np.array(slope) / 2e-6,
                               rtol=1e-6)  # fmt: skip


def test_a_walk_between_bounds_gains_what_the_readable_law_says():
    """With and without windows; nothing is farther from zero than forty."""
    for problem in (bounded(linear_case(6, n_geometry=0)), bounded(linear_case(6))):
        fit = fitted(problem)
        law = log_posterior(problem, fit)
        near = surrogate(law, fit)
        assert near.usual_steps == ((50, 4000) if near.windows is None else (50, 500))
        points = near.centre + np.random.default_rng(2).standard_normal((20, near.centre.size))
        there, gain = near.walk(points, 20, np.random.default_rng(3))
        expected = surrogate_log_density(near, there) - surrogate_log_density(near, points)
        np.testing.assert_allclose(gain, expected, rtol=1e-9, atol=1e-9)
        edge = np.array(near.centre)
        edge[0] = 39.9
        assert np.isfinite(law(edge))
        edge[0] = -40.0
        assert law(edge) == -np.inf
