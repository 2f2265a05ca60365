"""The reduced chi-square of a fit with priors, pinned on linear problems worked out otherwise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from posterior_cases import Linear, linear_case
from roomfit.base.typing import FloatArray
from roomfit.model.parameters import prior_residuals, start_vector
from roomfit.solver import fit_band, marginal, score_band


@dataclass(frozen=True, eq=False)
class Dependent(Linear):
    """The same data where each shares its information with neighbours."""

    neighbours: float = 1.0

    def correlation_length(self) -> FloatArray:
        return np.full(self.observed.size, self.neighbours)


def dependent_case(seed: int, neighbours: float) -> Dependent:
    plain = linear_case(seed)
    return Dependent(plain.matrix, plain.observed, plain.sd, plain.parameters, neighbours)


def answer_by_rows(problem: Dependent, data: FloatArray) -> FloatArray:
    """Return the most likely vector: priors as further rows of one system of linear equations."""
    n = problem.matrix.shape[1]
    off, rows = prior_residuals(problem.parameters, np.zeros(n))
    scale = 1.0 / (problem.sd * np.sqrt(problem.neighbours))
    matrix = np.vstack((scale * problem.matrix, rows))
    return np.linalg.lstsq(matrix, np.concatenate((scale * data, -off)), rcond=None)[0]


@pytest.mark.parametrize("neighbours", [1.0, 3.0])
@pytest.mark.parametrize("seed", range(3))
def test_phi_counts_the_parameters_that_data_and_not_priors_determine(seed, neighbours):
    """Degrees of freedom: data less the sum of what each prediction moves with its own datum.

    Seven unknowns of thirty data; some of them are determined by their priors in part. By moving
    one datum after the other: exact in a linear problem.
    """
    problem = dependent_case(seed, neighbours)
    answer = answer_by_rows(problem, problem.observed)
    spent = 0.0
    for i in range(problem.observed.size):
        moved = np.array(problem.observed)
        moved[i] += 1.0
        spent += float(problem.matrix[i] @ (answer_by_rows(problem, moved) - answer))
    assert 1.0 < spent < 7.0
    squares = np.sum((problem.observed - problem.matrix @ answer) ** 2) / problem.sd**2
    expected = squares / (problem.observed.size - spent)
    for fit in (
        fit_band(problem, settled_sd=1e-7),
        score_band(problem, start_vector(problem.parameters), settled_sd=1e-7),
    ):
        np.testing.assert_allclose(fit.vector, answer, atol=1e-6)
        assert fit.chi2_reduced == pytest.approx(expected, rel=1e-6)


def test_phi_is_one_on_average_where_data_and_truth_follow_their_laws():
    """400 problems of five data and three unknowns; their mean has a standard error of about .04.

    Priors of unit variance hold the truth as often as they say. Undivided by what is spent, squares
    would come to about half of the data.
    """
    rng = np.random.default_rng(3)
    found = []
    for _ in range(400):
        plain = linear_case(0, n=1, n_geometry=2, n_data=5)
        matrix = rng.standard_normal((5, 3))
        block = plain.parameters.blocks[0]
        truth = np.array([block.prior_mean[0], 0.0, 0.0])
        truth += np.array([block.prior_sd[0], 1.0, 1.0]) * rng.standard_normal(3)
        data = matrix @ truth + 0.5 * rng.standard_normal(5)
        found.append(
            fit_band(Linear(matrix, data, 0.5, plain.parameters), settled_sd=1e-7).chi2_reduced
        )
    assert np.mean(found) == pytest.approx(1.0, abs=0.16)


def test_cost_and_information_are_those_of_the_weighted_squares():
    """Half of all weighted squares, priors included, and its second differences."""
    problem = dependent_case(5, 3.0)
    fit = fit_band(problem, settled_sd=1e-7)

    def cost(vector: FloatArray) -> float:
        off = (problem.observed - problem.matrix @ vector) ** 2
        prior, _ = prior_residuals(problem.parameters, vector)
        return float(0.5 * (np.sum(off) / (3.0 * problem.sd**2) + prior @ prior))

    assert fit.cost == pytest.approx(cost(fit.vector), rel=1e-9)
    unit = np.eye(fit.vector.size)
    second = [
        [cost(fit.vector + a + b) - cost(fit.vector + a) - cost(fit.vector + b) for b in unit]
        for a in unit
    ]
    np.testing.assert_allclose(fit.information, np.array(second) + fit.cost, atol=1e-8)


@pytest.mark.parametrize("misfit", [0.5, 4.0])
def test_what_one_band_says_to_the_next_is_weakened_by_its_misfit(misfit):
    """The information that data added to the prior, over phi where that is above 1."""
    fit = replace(fit_band(dependent_case(2, 1.0), settled_sd=1e-7), chi2_reduced=misfit)
    prior = np.eye(4)
    covariance = np.linalg.inv(fit.information)[3:, 3:]
    added = np.linalg.inv(covariance) - prior
    found = marginal(fit, 3, prior)
    np.testing.assert_allclose(found.information, prior + added / max(misfit, 1.0), rtol=1e-9)
    np.testing.assert_array_equal(found.mean, fit.vector[3:])
