"""Unknowns as blocks: transforms, held entries, priors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import gamma

from roomfit.model.parameters import (
    Block,
    Parameters,
    fitted_columns,
    physical_values,
    to_free,
    to_physical,
)
from roomfit.model.problem import gamma_log_likelihood


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


def test_the_gamma_density_is_scipy_s_and_bears_an_empty_window():
    measured, mean, variance = np.array([0.3, 2.0]), np.array([0.5, 1.5]), np.array([0.1, 0.4])
    expected = gamma.logpdf(measured, mean**2 / variance, scale=variance / mean)
    np.testing.assert_allclose(gamma_log_likelihood(measured, mean, variance), expected)
    empty = gamma_log_likelihood(np.array([1.0, 0.0]), np.array([1.0, 0.0]), np.array([0.1, 0.0]))
    assert np.all(np.isfinite(empty))
