"""The choice of scattering by likelihood, and when traced paths may serve another scattering."""

from __future__ import annotations

import numpy as np

from roomfit.base.typing import FloatArray
from roomfit.fit.scattering import GRID, choose_scattering


def bell(truth: FloatArray, width: float | FloatArray = 0.1):
    """Return a Gaussian log likelihood about a true table of coefficients, summed in each band."""

    def fit(coefficients: FloatArray) -> FloatArray:
        return -0.5 * np.sum(((coefficients - truth) / width) ** 2, axis=0)

    return fit


def test_the_most_likely_common_value_is_chosen_with_all_values_near_it():
    """By hand: 1.92 below the top of three Gaussians of width 0.1 lies 0.113 off the centre."""
    truth, tried = np.full((3, 1), 0.18), []

    def fit(coefficients: FloatArray) -> FloatArray:
        tried.append(coefficients[0, 0])
        return bell(truth)(coefficients)

    s, lower, upper = choose_scattering(fit, np.zeros((3, 1)), np.ones(3, dtype=bool))
    assert np.all(s == 0.2)
    # best is at 0.02 from the truth, 3 * 0.5 * 0.2 ** 2 = 0.06 below the top
    limit = 0.1 * np.sqrt(2.0 * (1.92 + 0.06) / 3.0)
    good = [s for s in GRID if abs(s - 0.18) <= limit]
    assert lower[0, 0] == min(good)
    assert upper[0, 0] == max(good)
    assert tried == list(GRID)


def test_the_sum_over_bands_decides():
    """All bands have one value, between those that they would have by themselves."""
    truth = np.array([[0.05, 0.3]] * 3)
    s, _, _ = choose_scattering(bell(truth), np.zeros((3, 2)), np.ones(3, dtype=bool))
    assert np.all(s == s[0, 0])
    assert 0.05 < s[0, 0] < 0.3


def test_each_material_has_its_own_value_where_asked_and_specified_ones_stay():
    """Coordinate by coordinate; a specified coefficient is never changed."""
    truth = np.array([[0.05], [0.5], [0.2]])
    start = np.array([[0.0], [0.0], [0.33]])
    fitted = np.array([True, True, False])
    s, lower, upper = choose_scattering(bell(truth), start, fitted, common=False)
    np.testing.assert_array_equal(s[:, 0], [0.05, 0.5, 0.33])
    assert lower[2, 0] == upper[2, 0] == 0.33
