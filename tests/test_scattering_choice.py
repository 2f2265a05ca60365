"""The choice of scattering by likelihood, and when traced paths may serve another scattering."""

from __future__ import annotations

import numpy as np
import pytest

from images_reference import box_room, scene_of
from roomfit.bands import bands_between
from roomfit.errors import InputError
from roomfit.findings import Code
from roomfit.inversion.scattering import (
    GRID,
    choose_scattering,
    scene_retracer,
    suspected_scattering,
)
from roomfit.materials.priors import uniform_scattering
from roomfit.tracing.paths import TraceSettings
from roomfit.typing import FloatArray

MATERIALS = ("a", "b", "c")


def bell(truth: FloatArray, width: float = 0.1):
    """Return a Gaussian log likelihood about a true table of coefficients, summed in each band."""

    def fit(coefficients: FloatArray) -> FloatArray:
        return -0.5 * np.sum(((coefficients - truth) / width) ** 2, axis=0)

    return fit


def test_the_most_likely_common_value_is_chosen_with_all_values_near_it():
    """By hand: 1.92 below the top of three Gaussians of width 0.1 lies 0.113 off the centre."""
    truth = np.full((3, 1), 0.18)
    choice = choose_scattering(bell(truth), np.zeros((3, 1)), np.ones(3, dtype=bool))
    assert np.all(choice.coefficients == 0.2)
    # best is at 0.02 from the truth, 3 * 0.5 * 0.2 ** 2 = 0.06 below the top
    limit = 0.1 * np.sqrt(2.0 * (1.92 + 0.06) / 3.0)
    good = [s for s in GRID if abs(s - 0.18) <= limit]
    assert choice.lower[0, 0] == min(good)
    assert choice.upper[0, 0] == max(good)
    assert choice.evaluations == len(GRID)


def test_every_band_may_have_a_value_of_its_own():
    """Or the sum over bands decides."""
    truth = np.array([[0.05, 0.3]] * 3)
    apart = choose_scattering(bell(truth), np.zeros((3, 2)), np.ones(3, dtype=bool), per_band=True)
    np.testing.assert_array_equal(apart.coefficients[0], [0.05, 0.3])
    together = choose_scattering(bell(truth), np.zeros((3, 2)), np.ones(3, dtype=bool))
    assert np.all(together.coefficients == together.coefficients[0, 0])
    assert 0.05 < together.coefficients[0, 0] < 0.3


def test_each_material_finds_its_own_where_asked_and_told_ones_stay():
    """Coordinate by coordinate; a coefficient that was told is never moved."""
    truth = np.array([[0.05], [0.5], [0.2]])
    start = np.array([[0.0], [0.0], [0.33]])
    choice = choose_scattering(bell(truth), start, np.array([True, True, False]), common=False)
    np.testing.assert_array_equal(choice.coefficients[:, 0], [0.05, 0.5, 0.33])
    assert choice.lower[2, 0] == choice.upper[2, 0] == 0.33
    fit = bell(truth)(choice.coefficients)
    np.testing.assert_allclose(choice.log_likelihood, fit)


def test_nothing_to_choose_and_impossible_values_are_refused():
    """Both are the caller's to change."""
    fit, start = bell(np.zeros((3, 1))), np.zeros((3, 1))
    with pytest.raises(InputError, match="no scattering is to be fitted"):
        choose_scattering(fit, start, np.zeros(3, dtype=bool))
    for grid in ((), (0.1, 1.2), (float("nan"),)):
        with pytest.raises(InputError, match="no such scattering"):
            choose_scattering(fit, start, np.ones(3, dtype=bool), grid=grid)


def test_smooth_walls_are_doubted_only_where_the_data_gain_much():
    """More than 5 in log likelihood; walls that scatter already are left alone."""
    smooth = np.zeros((3, 2))
    for truth, fires in ((0.15, True), (0.01, False)):
        fit = bell(np.full((3, 2), truth))
        findings = suspected_scattering(fit, MATERIALS, smooth, fit(smooth))
        assert [f.code for f in findings] == ([Code.SCATTERING_UNDERESTIMATED] if fires else [])
    # by hand: 0.1 gains 3 + 20 in one band and loses 1.5 (0.25^2 - 0.15^2) / 0.01 = 6 in the other
    fit = bell(np.tile([0.15, -0.15], (3, 1)))
    assert suspected_scattering(fit, MATERIALS, smooth, fit(smooth) - np.array([20.0, 0.0])) == ()
    fit = bell(np.full((3, 2), 0.15))
    partly = np.array([[0.0, 0.0], [0.15, 0.15], [0.15, 0.15]])
    (finding,) = suspected_scattering(fit, MATERIALS, partly, fit(partly) - 10.0)
    assert finding.evidence["materials"] == ["a"]
    assert suspected_scattering(fit, MATERIALS, np.full((3, 2), 0.3), fit(smooth)) == ()


def test_a_trace_serves_near_coefficients_and_is_made_again_for_far_ones():
    """And for a wall that was traced as smooth."""
    scene = scene_of(box_room(), [[1.2, 1.5, 1.1]], [[4.1, 2.9, 1.2]])
    bands = bands_between("octave", 500, 1000)
    retracer = scene_retracer(scene, bands, TraceSettings(0.05, 4096, 2, 0.5))
    asked = (0.0, 0.3, 0.32, 0.3, 0.9, 0.0)
    made = []
    for s in asked:
        scattering = uniform_scattering(scene.room.materials, s)
        traced = retracer.at(scattering)
        made.append(retracer.n_traces)
        np.testing.assert_array_equal(traced.paths.sampling_scattering, scattering.coefficients)
        rows = traced.binned.rows[0]
        np.testing.assert_array_equal(
            np.sort(rows.weight_per_m2), np.sort(traced.paths.weight_per_m2)
        )
    # the trace at 0 had to give way to that at 0.9: two are kept
    assert made == [1, 2, 2, 2, 3, 4]
