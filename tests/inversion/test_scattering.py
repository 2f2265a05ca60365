"""The choice of scattering by likelihood, and when traced paths may serve another scattering."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from images_reference import box_room, scene_of
from rays_reference import with_scattering
from roomfit.bands import bands_between
from roomfit.diagnostics.scattering import check
from roomfit.errors import InputError
from roomfit.findings import Code
from roomfit.inversion import scattering
from roomfit.inversion.scattering import (
    GRID,
    Retracer,
    choose_scattering,
    tried_scattering,
)
from roomfit.materials.priors import uniform_scattering, unknown_material
from roomfit.settings import Settings
from roomfit.tracing.paths import TraceSettings
from roomfit.tracing.trace import trace
from roomfit.typing import FloatArray
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


def test_a_trace_serves_near_coefficients_and_is_made_again_for_far_ones(monkeypatch):
    """And for a wall that was traced as smooth. Weights are those of the coefficient asked for."""
    scene = scene_of(box_room(), [[1.2, 1.5, 1.1]], [[4.1, 2.9, 1.2]])
    bands, settings = bands_between("octave", 500, 1000), TraceSettings(0.05, 4096, 2, 0.5)
    traced = []

    def counted(*arguments, **options):
        traced.append(trace(*arguments, **options))
        return traced[-1]

    monkeypatch.setattr("roomfit.inversion.scattering.trace", counted)
    retracer, made = Retracer(scene, bands, settings), []
    # with the trace that serves each: that at 0 has to give way to that at 0.9, for two are kept
    each = ((0.0, 0), (0.3, 1), (0.32, 1), (0.3, 1), (0.9, 2), (0.0, 3), (0.9, 2))
    for s, serving in each:
        wanted = uniform_scattering(scene.room.materials, s)
        (rows,) = retracer.at(wanted).rows
        made.append(len(traced))
        paths = with_scattering(traced[serving].paths, wanted)
        np.testing.assert_array_equal(np.sort(rows.weight_per_m2), np.sort(paths.weight_per_m2))
    assert made == [1, 2, 2, 2, 3, 4, 4]
    # walls that scattered all have no mirrored path that could be weighed
    retracer, before = Retracer(scene, bands, settings), len(traced)
    for s, n in ((1.0, 1), (0.97, 2), (1.0, 2)):
        retracer.at(uniform_scattering(scene.room.materials, s))
        assert len(traced) - before == n


BANDS = bands_between("octave", 125, 8000)


def scattering_of(monkeypatch, function, priors, fit=None, settings=None):
    """Return what a function chooses, and what was asked of the fit of energies."""
    asked = []

    def energy_fit(measured, priors, settings, traced, start, chosen):
        asked.append((traced, chosen))
        return (
            None if fit is None else (fit, np.full((len(priors), chosen.stop - chosen.start), 0.33))
        )

    monkeypatch.setattr(scattering, "_energy_fit", energy_fit)
    traced = TraceSettings(0.9, 77_000, 3, keep_image_transforms=True)
    measured = SimpleNamespace(bands=BANDS)
    own = settings or Settings(default_scattering=0.1, n_scattering_rays=500)
    rest = () if function is not scattering.chosen_scattering else (None,)
    return function(measured, priors, own, traced, "start", *rest), asked


def walls(*given):
    return tuple(
        replace(unknown_material(n, len(BANDS)), **more)
        for n, more in zip("abcd", given, strict=False)
    )


@pytest.mark.parametrize(
    ("truth", "value", "low", "high"),
    [(0.07, 0.1, 0.05, 0.1), (0.35, 0.4, 0.4, 0.4), (0.0, 0.0, 0.0, 0.0), (0.1, 0.1, 0.1, 0.1)],
)
def test_unspecified_walls_share_the_likeliest_value_or_the_usual_one_where_that_is_as_likely(
    monkeypatch, truth, value, low, high
):
    """Of the middle bands, in a short trace of few rays; what is specified stays as it is."""
    specified = np.full(len(BANDS), 0.7)
    priors = walls({}, {"scattering": specified}, {"fit_scattering": True}, {})
    # two walls in two bands: 1.92 below the top lies 0.029 off
    fit = bell(np.array([[truth], [0.33], [0.33], [truth]]), 0.03)
    (known, sd, chosen), asked = scattering_of(
        monkeypatch, scattering.assumed_scattering, priors, fit
    )
    ((traced, middle),) = asked
    assert (traced.n_rays, traced.duration_s, traced.keep_image_transforms) == (8000, 0.2, False)
    assert (middle.start, middle.stop) == (2, 4)
    assert chosen == (("a", "d"), (value,) * 2, (low,) * 2, (high,) * 2, False, True)
    np.testing.assert_array_equal(known[0].scattering, np.full(len(BANDS), value))
    np.testing.assert_array_equal(known[1].scattering, specified)
    assert known[2].scattering is None
    grid = (0.0, 0.05, 0.1, 0.2, 0.4)
    own = scattering._grid_sd(grid, low, high)
    np.testing.assert_allclose(sd, [own, 0.0, 0.0, own])


def test_without_responses_the_usual_scattering_is_as_uncertain_as_it_is_large(monkeypatch):
    (known, sd, chosen), _ = scattering_of(
        monkeypatch, scattering.assumed_scattering, walls({}, {"fit_scattering": True})
    )
    assert chosen == (("a",), (0.1,), (0.1,), (0.1,), False, False)
    np.testing.assert_array_equal(sd, [0.1, 0.0])
    np.testing.assert_array_equal(known[0].scattering, np.full(len(BANDS), 0.1))
    all_known = walls({"fit_scattering": True}, {"scattering": np.zeros(len(BANDS))})
    (known, sd, chosen), asked = scattering_of(
        monkeypatch, scattering.assumed_scattering, all_known
    )
    assert known == all_known and chosen is None and not asked and sd.tolist() == [0.0, 0.0]


def test_walls_specified_as_smooth_are_tried_in_three_bands_up_to_4_khz(monkeypatch):
    """An object is no wall; walls that scatter a little, or of which nothing is said, are none."""
    smooth, rough = {"scattering": np.zeros(len(BANDS))}, {"scattering": np.eye(len(BANDS))[0]}
    trial = scattering.scattering_trial
    found, ((traced, chosen),) = scattering_of(monkeypatch, trial, walls(rough, smooth, {}))
    assert (traced.n_rays, traced.duration_s) == (500, 0.2) and found is None
    assert BANDS.centres_hz[chosen].tolist() == [1000.0, 2000.0, 4000.0]
    for others in ((rough, {}), ({**smooth, "object_volume_m3": 30.0}, {})):
        assert scattering_of(monkeypatch, trial, walls(*others)) == (None, [])


@pytest.mark.parametrize("n_fitted", [1, 2])
def test_scattering_that_is_fitted_is_told_with_a_quarter_of_the_range_that_is_as_likely(
    monkeypatch, n_fitted
):
    fitted, given = {"fit_scattering": True}, {"scattering": np.full(len(BANDS), 0.33)}
    priors = walls(fitted, given, *([fitted] * (n_fitted - 1)))
    fit = bell(np.array([[0.2], [0.33], [0.05]])[: len(priors)], 0.001)
    (known, sd, chosen), ((traced, every),) = scattering_of(
        monkeypatch, scattering.chosen_scattering, priors, fit
    )
    assert (traced.n_rays, traced.duration_s) == (500, 0.3)
    assert (every.start, every.stop) == (0, len(BANDS))
    wanted = (0.2, 0.05)[:n_fitted]
    assert chosen == (tuple("ac")[:n_fitted], wanted, wanted, wanted, True, True)
    np.testing.assert_array_equal(known[1].scattering, given["scattering"])
    own = [scattering._grid_sd(GRID, v, v) for v in wanted]
    np.testing.assert_allclose(sd, [own[0], 0.0, *own[1:]])
    with pytest.raises(InputError, match="without responses"):
        scattering_of(monkeypatch, scattering.chosen_scattering, priors)
    plain = walls(given)
    (known, sd, chosen), asked = scattering_of(
        monkeypatch, scattering.chosen_scattering, plain, fit
    )
    assert known == plain and sd.tolist() == [0.0] and chosen is None and not asked


def test_bands_in_which_few_rays_carry_the_energy_are_named_with_their_share():
    """Below a tenth of the rays; image paths do not count, nor do all rays alike."""
    n = 100
    batch = np.append(np.zeros(n), [-1, -1, -1]).astype(np.int32)
    paths = SimpleNamespace(batch=batch)
    one = np.append(np.eye(n)[0], np.ones(3))
    ten, eleven = (np.append(np.arange(n) < k, np.ones(3)).astype(float) for k in (10, 11))
    bands = bands_between("octave", 250, 2000)
    factors = np.stack([one, np.ones(n + 3), ten, eleven])
    (finding,) = scattering._degenerate_weight_findings(bands, paths, factors)
    assert finding.code is Code.IMPORTANCE_WEIGHTS_DEGENERATE
    assert finding.evidence == {"bands_hz": [250.0]} and list(finding.about.bands_hz) == [250.0]
    assert "250 Hz (1 %)" in finding.sentence
    assert scattering._degenerate_weight_findings(bands, paths, factors[1:]) == ()
    images = SimpleNamespace(batch=np.full(n + 3, -1))
    assert scattering._degenerate_weight_findings(bands, images, factors) == ()
