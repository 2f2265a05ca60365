"""The share of intervals that hold over rooms, and how far errors are from what intervals say."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import beta

from calibration import Pooled, grouped_proportion, scaled_errors


def test_an_error_is_scaled_by_the_side_of_the_interval_on_which_the_truth_lies():
    """An interval from -1 to +3 standard units of the logit about its middle."""

    def expit(x):
        return 1.0 / (1.0 + np.exp(-x))

    true = np.array([-1.5, -0.5, 0.0, 1.5, 4.5]).reshape(5, 1, 1)
    ones = np.ones((5, 1, 1))
    found = Pooled(expit(true), 0.5 * ones, expit(-ones), expit(3.0 * ones), ones > 0.0, ones > 0.0)
    of_the_side = np.array([-1.5, -0.5, 0.0, 0.5, 1.5])  # below by 1, above by 3
    errors = scaled_errors(found, found.has_interval)
    np.testing.assert_allclose(errors, 1.959964 * of_the_side, rtol=1e-6)


def test_the_spread_of_groups_has_bessels_factor():
    """Of 5 groups of 8 values that are alike within: the effective number is 4 for 5 groups."""
    hit = np.repeat(np.array([1, 1, 1, 0, 0]) > 0, 8).reshape(5, 8)
    found = grouped_proportion(hit, np.ones_like(hit))
    n, k = 4.0, 4.0 * 0.6
    assert found.low == pytest.approx(beta.ppf(0.025, k, n - k + 1.0), rel=1e-9)
    assert found.high == pytest.approx(beta.ppf(0.975, k + 1.0, n - k), rel=1e-9)
    nothing = grouped_proportion(hit, hit & ~hit)
    assert (nothing.count, nothing.of, nothing.low, nothing.high) == (0, 0, 0.0, 1.0)
