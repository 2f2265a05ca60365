"""Fits whose weights follow the answer: where they settle, and after how many evaluations."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from posterior_cases import Linear, Posynomial, absorption_block, gain_block
from roomfit.base.typing import FloatArray
from roomfit.model.parameters import Parameters, prior_residuals, start_vector
from roomfit.solver import BandFit, Ending, fit_band, score_band


@dataclass(frozen=True, eq=False)
class Doubted(Posynomial):
    """Window energies whose relative variance falls with what is expected, as above a noise floor.

    The more one window is believed, the less others are: weights change by factors.
    """

    power: float = 2.0

    def variance(self, vector: FloatArray) -> FloatArray:
        expected = self.predict(vector).expected
        return np.asarray(expected**self.power / self.shape)


def room(seed: int, shape: float, power: float = 2.0, n: int = 3) -> Doubted:
    """Return 40 windows of 20 paths among walls of random absorption, a gain unknown."""
    rng = np.random.default_rng(seed)
    hits = np.stack([rng.multinomial(k // 2 + 1, np.full(n, 1 / n), 20) for k in range(40)])
    weight = rng.uniform(0.2, 2.0, (40, 20))
    truth = rng.uniform(0.05, 0.6, n)
    observed = (weight * np.exp(hits @ np.log1p(-truth))).sum(axis=1)
    observed = observed * rng.gamma(shape, 1.0 / shape, 40)
    blocks = Parameters((absorption_block(n), gain_block()))
    return Doubted(weight, hits.astype(float), observed, shape, blocks, power)


def by_whole_rounds(problem: Doubted, start: FloatArray, rounds: int) -> list[FloatArray]:
    """Return the answers of rounds under the weights of the answer before, by another program."""
    answers = [start]
    for _ in range(rounds):
        sd = np.sqrt(problem.variance(answers[-1]))

        def residuals(vector: FloatArray, sd: FloatArray = sd) -> FloatArray:
            off = (problem.observed - problem.expected(vector)) / sd
            return np.concatenate((off, prior_residuals(problem.parameters, vector)[0]))

        answers.append(least_squares(residuals, answers[-1], xtol=1e-12).x)
    return answers


def sd_of(fit: BandFit) -> FloatArray:
    return np.sqrt(np.diag(np.linalg.inv(fit.information)) * max(fit.chi2_reduced, 1.0))


@pytest.mark.parametrize("seed", range(6))
def test_where_whole_rounds_settle_single_steps_settle_too(seed: int) -> None:
    """Within .02 standard deviations of forty rounds solved by scipy to the end."""
    problem = room(seed, 20.0)
    fit = fit_band(problem)
    *_, before, last = by_whole_rounds(problem, fit.vector, 40)
    sd = sd_of(fit)
    assert np.all(np.abs(last - before) < 1e-3 * sd)
    assert fit.converged
    assert np.all(np.abs(fit.vector - last)[:3] < 0.02 * sd[:3])


@dataclass(frozen=True, slots=True, eq=False)
class Swinging(Linear):
    """Data of 1 and of -1; each answer makes those surer that contradict it.

    Answer x leads to ``-tanh(strength x)`` but for the prior.
    """

    strength: float = 2.0

    def variance(self, vector: FloatArray) -> FloatArray:
        return np.exp(self.strength * self.observed * float(vector[0]))


@pytest.mark.parametrize("strength", [0.5, 0.9, 1.5, 2.0, 3.0])
@pytest.mark.parametrize("start", [-0.8, 0.1, 0.4, 2.0])
def test_where_whole_rounds_swing_for_ever_single_steps_settle(
    strength: float, start: float
) -> None:
    """Where ``tanh(strength x) = -x``, at 0; above a strength of 1 whole rounds never get there.

    The prior moves it by a hundredth of a standard deviation.
    """
    block = absorption_block(1)
    prior = replace(block, prior_mean=np.zeros(1))
    data = np.repeat([1.0, -1.0], 1000)
    problem = Swinging(np.ones((2000, 1)), data, 1.0, Parameters((prior,)), strength)
    x = start
    for _ in range(100):
        x = -np.tanh(strength * x)
    assert (abs(x) > 0.5) == (strength > 1.0)
    fit = score_band(problem, np.array([start]))  # type: ignore[arg-type]
    assert fit.converged
    assert abs(fit.vector[0]) < 0.02 * sd_of(fit)[0]
    assert fit.evaluations <= 10


def test_too_few_rounds_say_so_and_tell_where_the_last_step_began() -> None:
    """No step is taken, then one."""
    problem = room(0, 20.0)
    start = start_vector(problem.parameters)
    none, one = (score_band(problem, start, max_rounds=n) for n in (0, 1))  # type: ignore[arg-type]
    assert none.ending is one.ending is Ending.OUT_OF_ROUNDS
    np.testing.assert_array_equal(none.vector, start)
    assert one.previous is not None
    np.testing.assert_array_equal(one.previous, start)
    assert (none.evaluations, one.evaluations) == (1, 2)
