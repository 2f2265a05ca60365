"""Unknowns as blocks: transforms, held entries, priors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import gamma

from roomfit.base.errors import InputError
from roomfit.model.parameters import (
    Block,
    Parameters,
    fitted_columns,
    physical_values,
    prior_residuals,
    start_vector,
    to_free,
    to_physical,
)
from roomfit.model.problem import gamma_log_likelihood
from roomfit.uncertainty.gaussian import absorption_intervals, weighted_mean_gradient


def block(transform: str, n: int = 3, **changes) -> Block:
    settings = {
        "name": transform,
        "labels": tuple(f"m{i}" for i in range(n)),
        "transform": transform,
        "start": np.linspace(0.2, 0.4, n),
        "fitted": np.ones(n, dtype=bool),
        "prior_mean": np.zeros(n),
        "prior_sd": np.full(n, np.inf),
        "lower": np.full(n, 0.01),
        "upper": np.full(n, 0.99),
    }
    return Block(**{**settings, **changes})


@pytest.mark.parametrize("transform", ["identity", "log", "logit"])
@given(values=st.lists(st.floats(0.02, 0.98), min_size=3, max_size=3))
def test_a_transform_and_its_inverse_give_the_value_back(transform, values):
    b = block(transform)
    back, _ = to_physical(b, to_free(b, np.array(values)))
    # two exponentials and two logarithms, each rounded once, around values of order one
    np.testing.assert_allclose(back, values, rtol=1e-12)


@pytest.mark.parametrize("transform", ["identity", "log", "logit"])
@given(free=st.lists(st.floats(-6.0, 6.0), min_size=3, max_size=3))
def test_the_stated_slope_is_the_central_difference(transform, free):
    b = block(transform)
    x, h = np.array(free), 1e-5
    numeric = (to_physical(b, x + h)[0] - to_physical(b, x - h)[0]) / (2.0 * h)
    # truncation h^2/6 |f'''| <= 1e-10 |f| and cancellation 2^-52 / h, both relative to |f|
    scale = np.maximum(np.abs(to_physical(b, x)[0]), 1.0)
    np.testing.assert_allclose(to_physical(b, x)[1], numeric, rtol=1e-7, atol=1e-9 * scale.max())


def test_a_held_entry_keeps_its_exact_value_and_has_no_slope():
    b = block("logit", fitted=np.array([True, False, True]))
    p = Parameters((b,))
    values, slopes = physical_values(p, start_vector(p) + 1.0)
    assert values["logit"][1] == b.start[1]
    assert slopes["logit"][1] == 0.0
    assert np.all(slopes["logit"][[0, 2]] > 0.0)


def test_a_prior_without_end_adds_no_row():
    b = block("logit", prior_sd=np.array([1.5, np.inf, 2.0]), prior_mean=np.array([-1.0, 0.0, 1.0]))
    p = Parameters((b,))
    residuals, jacobian = prior_residuals(p, np.array([2.0, 5.0, 2.0]))
    np.testing.assert_allclose(residuals, [3.0 / 1.5, 0.5])
    np.testing.assert_allclose(jacobian, [[1.0 / 1.5, 0.0, 0.0], [0.0, 0.0, 0.5]])


def test_a_lower_bound_above_the_upper_is_refused_by_name():
    with pytest.raises(InputError, match=r"lower bound(?s:.)*'m1'"):
        block("logit", lower=np.array([0.0, 0.9, 0.0]), upper=np.array([1.0, 0.5, 1.0]))


def test_a_tied_entry_takes_its_leader_s_value_and_gives_it_its_derivatives():
    """f = 2 a0 + 3 a1 + 5 a2 with a2 tied to a0 changes by 7 for each unit of a0."""
    b = block("logit", fitted=np.array([True, True, False]), leader=np.array([0, 1, 0]))
    p = Parameters((b,))
    vector = np.array([0.3, -0.4])
    values, slopes = physical_values(p, vector)
    assert values["logit"][2] == values["logit"][0]
    factors = np.array([[2.0, 3.0, 5.0]])
    columns = fitted_columns(p, {"logit": factors * slopes["logit"]})
    own = to_physical(b, np.array([0.3, -0.4, 0.0]))[1]
    np.testing.assert_allclose(columns, [[7.0 * own[0], 3.0 * own[1]]], rtol=1e-14)


def test_a_tied_entry_has_its_leader_s_interval_and_counts_in_the_mean():
    b = block("logit", name="absorption", fitted=np.array([True, True, False]),
              leader=np.array([0, 1, 0]))  # fmt: skip
    p = Parameters((b,))
    vector, information = np.array([0.3, -0.4]), np.diag([400.0, 100.0])
    found = absorption_intervals(p, vector, np.linalg.inv(information), 1.0)
    for values in (found.absorption, found.lower95, found.upper95):
        assert values[2] == values[0]
    merged = Parameters((block("logit", 2, name="absorption"),))
    pooled = weighted_mean_gradient(merged, vector, np.array([0.7, 0.3]))
    apart = weighted_mean_gradient(p, vector, np.array([0.3, 0.3, 0.4]))
    np.testing.assert_allclose(apart, pooled, rtol=1e-12)


@pytest.mark.parametrize("leader", [[1, 2, 2], [0, 0, 1]])
def test_an_entry_that_follows_must_not_lead(leader):
    with pytest.raises(InputError, match="must not lead"):
        block("logit", fitted=np.array([True, False, False]), leader=np.array(leader))


def test_the_gamma_density_is_scipy_s_and_bears_an_empty_window():
    measured, mean, variance = np.array([0.3, 2.0]), np.array([0.5, 1.5]), np.array([0.1, 0.4])
    expected = gamma.logpdf(measured, mean**2 / variance, scale=variance / mean)
    np.testing.assert_allclose(gamma_log_likelihood(measured, mean, variance), expected)
    empty = gamma_log_likelihood(np.array([1.0, 0.0]), np.array([1.0, 0.0]), np.array([0.1, 0.0]))
    assert np.all(np.isfinite(empty))


@pytest.mark.parametrize(
    "prior_sd",
    [np.ones(2), np.ones((3, 1)), np.array([1.0, 0.0, 1.0]), np.array([1.0, np.nan, 1.0])],
)
def test_a_prior_needs_one_standard_deviation_above_zero_an_entry(prior_sd):
    """Wrong in shape alone, and in value alone; an infinite one, which says nothing, is taken."""
    with pytest.raises(InputError, match="needs a standard deviation above zero"):
        block("log", prior_sd=prior_sd)
    assert block("log", prior_sd=np.full(3, np.inf)).prior_sd.tolist() == 3 * [np.inf]


@pytest.mark.parametrize(
    ("fitted", "leader"),
    [([True, True, True], [0, 0, 2]), ([True, False, False], [0, 0, 1])],
)
def test_an_entry_that_follows_is_neither_fitted_nor_followed(fitted, leader):
    with pytest.raises(InputError, match="that follows another must not lead"):
        block("log", fitted=np.array(fitted), leader=np.array(leader))
    block("log", fitted=np.array([True, False, False]), leader=np.array([0, 0, 0]))
