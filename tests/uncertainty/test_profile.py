"""Profile likelihoods against other programs and against what 95 % promises."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq, least_squares
from scipy.stats import binom

from posterior_cases import (
    Linear,
    Posynomial,
    absorption_block,
    decay_case,
    exchangeable_case,
    linear_case,
)
from roomfit.model.parameters import Parameters, prior_residuals
from roomfit.solver import BandFit, fit_band
from roomfit.uncertainty.gaussian import (
    FittedBand,
    absorption_intervals,
    band_estimate,
    fit_covariance,
)
from roomfit.uncertainty.intervals import LEAST_SIDE, Refinement, profiled
from roomfit.uncertainty.profile import RISE95, may_be_bent, profile


def fitted(problem) -> BandFit:
    return fit_band(problem, settled_sd=1e-7)


def refitted_rise(problem, fit: BandFit, entry: int, at: float) -> float:
    """Return the cost with one entry held, all others fitted by scipy, weights as in the fit."""
    others = np.arange(fit.vector.size) != entry

    def residuals(x, held=at):
        vector = np.array(fit.vector)
        vector[others], vector[entry] = x, held
        off = (fit.measured - problem.predict(vector).expected) / np.sqrt(fit.variance)
        return np.concatenate((off, prior_residuals(problem.parameters, vector)[0]))

    if not others.any():
        return 0.5 * float(np.sum(residuals(np.zeros(0)) ** 2)) - fit.cost
    return float(least_squares(residuals, fit.vector[others], xtol=1e-12).cost) - fit.cost


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 3))
def test_ends_are_where_another_program_finds_a_rise_of_half_chi_square(seed, n):
    """8 % of the rise are allowed where an end is searched for, 20 % where a Gaussian is kept.

    What one Newton step of the others leaves is worth a few per cent more; an end in absorption is
    not looked for closer than 0.004.
    """
    rng = np.random.default_rng(seed)
    problem = decay_case(rng, rng.uniform(0.02, 0.7, n))
    fit = fitted(problem)
    flat = max(fit.chi2_reduced, 1.0)
    for entry in range(n):
        found = profile(problem, fit, entry)
        assert found.lower < fit.vector[entry] < found.upper
        for end in (found.lower, found.upper):
            rise = refitted_rise(problem, fit, entry, end) / flat
            slack = 0.25 if found.gaussian else 0.15
            if abs(rise / RISE95 - 1.0) <= slack or abs(end) > 13.9:
                continue
            line = lambda x, e=entry: refitted_rise(problem, fit, e, x) / flat - RISE95  # noqa: E731
            exact = brentq(line, fit.vector[entry], end + 3.0 * np.sign(end - fit.vector[entry]))
            apart = abs(np.tanh(0.5 * exact) - np.tanh(0.5 * end)) / 2.0
            assert apart < 0.03 * max(1.0, abs(rise)), (seed, entry, exact, end)


@given(st.integers(0, 10**6))
@settings(max_examples=20, deadline=None)
def test_the_profile_of_a_linear_problem_is_the_gaussian(seed):
    problem = linear_case(seed, n_geometry=2)
    fit = fitted(problem)
    sd = np.sqrt(np.diag(np.linalg.inv(fit.information))[0] * max(fit.chi2_reduced, 1.0))
    found = profile(problem, fit, 0)
    assert found.gaussian
    np.testing.assert_allclose(found.upper - fit.vector[0], 1.959964 * sd, rtol=1e-6)
    assert found.evaluations == 2
    assert may_be_bent(fit, 0) == (sd > 0.3)


@dataclass(frozen=True, eq=False)
class Dependent(Linear):
    """Data of which three count as one."""

    def correlation_length(self) -> np.ndarray:
        return np.full(self.observed.size, 3.0)


def test_windows_that_depend_on_each_other_count_once_in_a_profile():
    """The ends of normal equations written out, under a deviation that is stated too small."""
    plain = linear_case(11, n_geometry=2)
    dependent = Dependent(plain.matrix, plain.observed, 0.25, plain.parameters)
    fit = fitted(dependent)
    assert fit.chi2_reduced > 2.0
    mean = np.append(np.full(3, np.log(0.15 / 0.85)), np.zeros(2))
    prior = np.diag([1.5**-2] * 3 + [1.0] * 2)
    information = plain.matrix.T @ plain.matrix / (3.0 * 0.25**2) + prior
    pull = plain.matrix.T @ plain.observed / (3.0 * 0.25**2) + prior @ mean
    answer = np.linalg.solve(information, pull)
    sd = np.sqrt(np.diag(np.linalg.inv(information)) * fit.chi2_reduced)
    for entry in range(3):
        found = profile(dependent, fit, entry)
        ends = answer[entry] + 1.959964 * sd[entry] * np.array([-1.0, 1.0])
        np.testing.assert_allclose((found.lower, found.upper), ends, rtol=1e-6)


@pytest.mark.parametrize("neighbours", [1.0, 3.0])
def test_a_skew_profile_of_dependent_windows_ends_where_written_out(neighbours):
    """One hard wall: cost over absorption on a grid, each window's square over so many times."""
    problem = hard_wall_case(np.random.default_rng(12), 0.03)
    sharing = {"correlation_length": lambda _: np.full(20, neighbours)}
    dependent = type("Sharing", (Posynomial,), sharing)(**vars(problem))
    fit = fitted(dependent)
    found = profile(dependent, fit, 0)
    x = np.linspace(fit.vector[0] - 4.0, fit.vector[0] + 2.5, 40_001)
    a = 1.0 / (1.0 + np.exp(-x))
    expected = (1.0 - a)[:, None] ** problem.hits[:, 0, 0]
    squares = ((problem.observed - expected) ** 2 / fit.variance).sum(axis=1) / neighbours
    cost = 0.5 * (squares + ((x - np.log(0.15 / 0.85)) / 1.5) ** 2)
    rise = (cost - cost.min()) / max(fit.chi2_reduced, 1.0)
    inside = x[rise <= RISE95]
    # an end is looked for within 8 % of the rise, 4 % of a side
    np.testing.assert_allclose((found.lower, found.upper), inside[[0, -1]], atol=0.06)
    assert not found.gaussian


def hard_wall_case(rng: np.random.Generator, a: float) -> Posynomial:
    """One material of little absorption in twenty windows: many hits, much scatter."""
    hits = np.repeat(np.arange(1.0, 11.0), 2)[:, None, None]
    expected = (1.0 - a) ** hits[:, 0, 0]
    observed = expected * rng.gamma(8.0, 1.0 / 8.0, hits.shape[0])
    return Posynomial(np.ones((20, 1)), hits, observed, 8.0, Parameters((absorption_block(1),)))


def test_intervals_of_hard_walls_hold_the_truth_as_often_as_they_say():
    """Absorption drawn from the prior among hard walls, 120 rooms.

    The profile may be off 95 % by the shape of a law of 20 windows: 2.5 points are granted besides
    what 120 draws scatter once in 10,000 seeds. Intervals that are Gaussian in the logit are wider
    by a tenth in half of the rooms.
    """
    rng = np.random.default_rng(4)
    held, widths = [], []
    for _ in range(120):
        a = 0.2
        while a > 0.06:
            a = 1.0 / (1.0 + np.exp(1.7346 - 1.5 * rng.standard_normal()))
        problem = hard_wall_case(rng, a)
        fit = fitted(problem)
        found = profile(problem, fit, 0)
        how = fit_covariance(fit), fit.chi2_reduced
        gauss = absorption_intervals(problem.parameters, fit.vector, *how)
        ends = 1.0 / (1.0 + np.exp(-np.array([found.lower, found.upper])))
        held.append(ends[0] <= a <= ends[1])
        widths.append((ends[1] - ends[0], gauss.upper95[0] - gauss.lower95[0]))
    least, most = binom.ppf([5e-5, 1.0 - 5e-5], 120, 0.95) / 120
    assert least - 0.025 <= np.mean(held) <= most + 0.025, np.mean(held)
    assert np.median([p / g for p, g in widths]) < 0.95


def test_profiles_replace_gaussian_intervals_where_they_are_skew_and_are_named():
    rng = np.random.default_rng(1)
    problem = decay_case(rng, np.array([0.02, 0.5]))
    fit = fitted(problem)
    gauss = band_estimate(problem.parameters, fit, "energy")
    better = profiled(FittedBand(gauss, problem, fit))
    assert set(better.kinds) <= {"gaussian", "profile"}
    assert "profile" in better.kinds
    for i, kind in enumerate(better.kinds):
        same = better.lower95[i] == gauss.lower95[i] and better.upper95[i] == gauss.upper95[i]
        assert same == (kind == "gaussian")

    def sides(answer):
        free = np.log(answer.absorption) - np.log1p(-answer.absorption)
        ends = [np.log(x) - np.log1p(-x) for x in (answer.lower95, answer.upper95)]
        return np.array([free - ends[0], ends[1] - free])

    assert np.all(sides(better) >= LEAST_SIDE * sides(gauss) - 1e-9)
    assert np.all(better.absorption == gauss.absorption)


def skew_case():
    problem = decay_case(np.random.default_rng(1), np.array([0.02, 0.5]))
    fit = fitted(problem)
    return problem, fit, band_estimate(problem.parameters, fit, "energy")


def logits(a):
    return np.log(a) - np.log1p(-a)


def test_what_a_fit_does_not_know_of_widens_either_side_of_a_profile_by_itself():
    """Rays add 0.2 to the standard deviation of a logit: each side as a root of squares."""
    problem, fit, plain = skew_case()
    steps = 0.2 * np.eye(2, fit.vector.size).T
    more = replace(plain, logit_covariance=plain.logit_covariance + 0.04 * np.eye(2))
    found = profiled(FittedBand(more, problem, fit, steps))
    assert "profile" in found.kinds
    for own in np.flatnonzero(np.array(found.kinds) == "profile"):
        line, at = profile(problem, fit, int(own)), fit.vector[own]
        sides = np.array([at - line.lower, line.upper - at])
        assert abs(sides[0] / sides[1] - 1.0) > 0.1
        ends = logits(np.array([found.lower95[own], found.upper95[own]]))
        expected = np.hypot(sides, 1.959964 * 0.2)
        np.testing.assert_allclose(np.abs(ends - at), expected, rtol=1e-6)


def test_a_second_fit_from_the_exchanged_absorptions_is_as_likely():
    problem = exchangeable_case()
    fit = fitted(problem)
    answer = band_estimate(problem.parameters, fit, "energy")
    refined = Refinement(False, 1, (np.array([1, 0]),))(FittedBand(answer, problem, fit))
    (trial,) = refined.mirrors
    np.testing.assert_allclose(trial.absorption, answer.absorption[::-1], atol=0.02)
    assert abs(trial.gain) < 0.05
