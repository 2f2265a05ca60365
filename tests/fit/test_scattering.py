"""The choice of scattering by likelihood, and when traced paths may serve another scattering."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.base.typing import FloatArray
from roomfit.fit.scattering import choose_scattering


def bell(truth: FloatArray, width: float | FloatArray = 0.1):
    """Return a Gaussian log likelihood about a true table of coefficients, summed in each band."""

    def fit(coefficients: FloatArray) -> FloatArray:
        return -0.5 * np.sum(((coefficients - truth) / width) ** 2, axis=0)

    return fit


def test_the_mean_by_evidence_is_that_of_the_posterior_law():
    """By hand: of two values the ratio of weights is that of law and likelihood."""
    tried = []

    def fit(coefficients: FloatArray) -> FloatArray:
        tried.append(float(coefficients[0, 0]))
        return np.array([1.7 if coefficients[0, 0] > 0.2 else 0.0])

    s, sd = choose_scattering(fit, np.zeros((3, 1)), np.ones(3, dtype=bool), grid=(0.1, 0.4))
    assert tried == [0.1, 0.4] and np.all(s == s[0, 0])
    z = np.log(np.array([0.1, 0.4]) / 0.15) / np.log(2.2)
    odds = np.exp(-0.5 * (z[1] ** 2 - z[0] ** 2) + 0.45 * 1.7)
    weight = odds / (1.0 + odds)
    assert s[0, 0] == pytest.approx(0.1 + 0.3 * weight)
    between, within = 0.09 * weight * (1.0 - weight), 0.3**2 / 12.0
    assert sd[0, 0] == pytest.approx(np.sqrt(between + within))


@pytest.mark.parametrize(("gain", "chosen"), [(-30.0, 0.0), (30.0, 0.2)])
def test_walls_are_smooth_unless_what_scatters_is_the_likelier(gain, chosen):
    def fit(coefficients: FloatArray) -> FloatArray:
        s = coefficients[0, 0]
        return np.array([gain * (s == 0.2) - 5.0 * (s not in (0.0, 0.2))])

    s, sd = choose_scattering(
        fit, np.full((2, 1), 0.33), np.array([True, False]), grid=(0.0, 0.05, 0.1, 0.2, 0.4)
    )
    assert s[0, 0] == pytest.approx(chosen, abs=0.01)
    assert 0.0 < sd[0, 0] < 0.1
    assert s[1, 0] == 0.33 and sd[1, 0] == 0.0


def test_the_sum_over_bands_decides():
    """All bands have one value, between those that they would have by themselves."""
    truth = np.array([[0.05, 0.3]] * 3)
    s, _ = choose_scattering(bell(truth), np.zeros((3, 2)), np.ones(3, dtype=bool))
    assert np.all(s == s[0, 0])
    assert 0.05 < s[0, 0] < 0.3


def test_each_material_has_its_own_value_where_asked_and_specified_ones_stay():
    """Coordinate by coordinate; a specified coefficient is never changed."""
    truth = np.array([[0.05], [0.5], [0.2]])
    start = np.array([[0.0], [0.0], [0.33]])
    fitted = np.array([True, True, False])
    s, sd = choose_scattering(bell(truth, 0.01), start, fitted, common=False)
    np.testing.assert_allclose(s[:, 0], [0.05, 0.5, 0.33], atol=1e-3)
    assert np.all(sd[:2] > 0.0) and sd[2, 0] == 0.0
