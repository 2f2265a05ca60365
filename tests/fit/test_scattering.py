"""The choice of scattering by likelihood, and when traced paths may serve another scattering."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roomfit.base.bands import bands_between
from roomfit.base.errors import InputError
from roomfit.base.findings import Code
from roomfit.base.typing import FloatArray
from roomfit.checks.scattering import check
from roomfit.fit.scattering import (
    GRID,
    choose_scattering,
    tried_scattering,
)
from roomfit.materials.priors import unknown_material
from seen import of_scattering_trial

MATERIALS = ("a", "b", "c")


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


def test_nothing_to_choose_and_impossible_values_are_refused():
    """Both are the caller's to change."""
    fit, start = bell(np.zeros((3, 1))), np.zeros((3, 1))
    with pytest.raises(InputError, match="no scattering is to be fitted"):
        choose_scattering(fit, start, np.zeros(3, dtype=bool))
    for grid in ((), (0.1, 1.2), (float("nan"),)):
        with pytest.raises(InputError, match="no such scattering"):
            choose_scattering(fit, start, np.ones(3, dtype=bool), grid=grid)


def suspected(fit, assumed):
    trial = tried_scattering(fit, MATERIALS, assumed)
    (found, of_another) = (list(check(of_scattering_trial(trial, k))) for k in ((), ("LS1",)))
    assert not of_another  # a source that is not omnidirectional, as both of the models have it
    return found


def test_smooth_walls_are_doubted_only_where_the_data_gain_much():
    """More than 5 in log likelihood; walls that scatter already are left alone."""
    smooth = np.zeros((3, 2))
    for truth, fires in ((0.15, True), (0.01, False)):
        findings = suspected(bell(np.full((3, 2), truth)), smooth)
        assert [f.code for f in findings] == ([Code.SCATTERING_UNDERESTIMATED] if fires else [])
    # by hand: 0.15 gains 1.5 (0.15 / 0.03)^2 = 37 in one band and loses
    # 1.5 (0.30^2 - 0.15^2) / 0.01 = 10 in the other
    fit = bell(np.tile([0.15, -0.15], (3, 1)), np.array([0.03, 0.1]))
    assert suspected(fit, smooth) == []
    # 0.5 (0.15 / 0.05)^2 = 4.5 in each of two bands
    fit = bell(np.full((3, 2), 0.15), 0.05)
    partly = np.array([[0.0, 0.0], [0.15, 0.15], [0.15, 0.15]])
    (finding,) = suspected(fit, partly)
    assert finding.evidence["materials"] == ["a"]
    assert suspected(fit, np.full((3, 2), 0.3)) == []


BANDS = bands_between("octave", 125, 8000)


def walls(*given):
    return tuple(
        replace(unknown_material(n, len(BANDS)), **more)
        for n, more in zip("abcd", given, strict=False)
    )
