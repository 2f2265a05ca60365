"""The choice of scattering by likelihood, and when traced paths may serve another scattering."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

import roomfit
from images_reference import box_room, scene_of
from rays_reference import with_scattering
from roomfit.air import attenuation_per_m
from roomfit.bands import Bands, bands_between
from roomfit.diagnostics.scattering import check
from roomfit.errors import InputError
from roomfit.findings import Code
from roomfit.inversion.measurements import collect_measurements
from roomfit.inversion.scattering import (
    GRID,
    Retracer,
    _sides,
    assumed_scattering,
    choose_scattering,
    level_and_upright,
    tried_scattering,
)
from roomfit.materials.priors import complete_priors, uniform_scattering
from roomfit.response.directivity import UnknownDirectivity
from roomfit.scene import with_states
from roomfit.synthetic.boxes import WALLS as BOX_SIDES
from roomfit.synthetic.boxes import (
    SyntheticBox,
    add_noise,
    diffuse_echogram,
    modulated_noise,
    pressure_response,
    specular_box,
)
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
        scattering = uniform_scattering(scene.room.materials, s)
        (rows,) = retracer.at(scattering).rows
        made.append(len(traced))
        paths = with_scattering(traced[serving].paths, scattering)
        np.testing.assert_array_equal(np.sort(rows.weight_per_m2), np.sort(paths.weight_per_m2))
    assert made == [1, 2, 2, 2, 3, 4, 4]


# level walls, an object, upright ones, and one that is specified
SIDES = np.array([1, 0, -1, -1, 0])


def angles(coefficients: FloatArray) -> FloatArray:
    return np.arcsin(np.sqrt(coefficients))


def parabola(level_more: float, height: float):
    """Return a likelihood that peaks where level walls are so far above upright ones, in angle."""

    def fit(coefficients: FloatArray) -> FloatArray:
        away = 0.5 * (angles(coefficients)[0] - angles(coefficients)[2]) - level_more
        return height * (1.0 - np.square(away / 0.1))

    return fit


@pytest.mark.parametrize(
    ("peak", "steps"),
    [(0.13, 1.3), (-0.17, -1.7), (0.08, 1.0), (0.4, 2.0)],
)
def test_level_and_upright_walls_part_where_a_parabola_peaks(peak, steps):
    """In closed form; not less than one step, nor more than two. The others stay."""
    common = np.array([[0.2], [0.3], [0.2], [0.2], [0.0]])
    found, gain = level_and_upright(parabola(peak, 6.0), common, SIDES)
    expected = np.sin(angles(common[:1, 0]) + 0.1 * steps * np.array([1.0, -1.0])) ** 2
    np.testing.assert_allclose(found[[0, 2], 0], expected, atol=0.00501)  # rounded to 0.01
    np.testing.assert_array_equal(found[[1, 4]], common[[1, 4]])
    assert found[2, 0] == found[3, 0]
    # by hand, of the height 6: (p / 0.1)^2 less ((|p| - 0.1) / 0.1)^2
    least = 6.0 * ((peak / 0.1) ** 2 - (abs(peak) / 0.1 - 1.0) ** 2)
    assert gain == pytest.approx(least, rel=1e-9)


def test_walls_keep_one_coefficient_where_two_gain_less_than_three():
    """All bands together; and where nothing scatters nothing is tried."""
    common = np.full((5, 2), 0.2)
    # two bands: twice 6 (1.3^2 - 0.3^2) / 6 = 3.2, and a little less
    for height, parts in ((1.0, True), (0.9, False)):
        found, gain = level_and_upright(parabola(0.13, height), common, SIDES)
        assert (gain > 0.0) is parts is not np.array_equal(found, common)

    def refused(_: FloatArray) -> FloatArray:
        raise AssertionError("tried")

    assert level_and_upright(refused, np.zeros((5, 2)), SIDES)[1] == 0.0


def mixed_box(level: float, upright: float, directivities: Mapping[str, UnknownDirectivity]):
    """Return what was measured in a box of hard upright walls, by `diffuse_echogram` and images."""
    lengths, rng = (6.2, 4.7, 2.9), np.random.default_rng(5)
    octaves = np.array([1000.0, 2000.0, 4000.0])
    air = attenuation_per_m(roomfit.Air(), Bands("octave", octaves))
    walls = np.array([upright] * 4 + [level] * 2)
    absorption = np.array([[0.06], [0.1], [0.08], [0.12], [0.3], [0.5]]) * np.ones(3)
    box = SyntheticBox(lengths, octaves, absorption, air, 343.2)
    source, places = np.array([1.3, 1.1, 1.2]), rng.uniform(0.7, np.array(lengths) - 0.7, (8, 3))
    heard = diffuse_echogram(box, walls, source, places, 0.35, rng, n_rays=40_000)
    flat, rate, measured = np.zeros(3), 16_000.0, []
    for i, (place, energy) in enumerate(zip(places, heard, strict=True)):
        images = pressure_response(specular_box(box, walls), source, place, 0.35, rate, flat)
        late = modulated_noise(energy, images.size, rate, octaves, flat, rng)
        samples = add_noise(images + late, -60.0, rng)
        measured.append(roomfit.Measurement("S", f"R{i}", samples, rate))
    names = dict(zip(BOX_SIDES, ("w", "e", "s", "n", "floor", "ceiling"), strict=True))
    room = roomfit.shoebox_room(lengths, names)
    scene = roomfit.scene_of(room, {"S": source}, {f"R{i}": p for i, p in enumerate(places)})
    bands = bands_between("octave", 1000, 4000)
    return collect_measurements(scene, measured, bands, directivities)


def assumed(found, n_rays=30_000):
    priors = complete_priors(found.scene.room.materials, (), found.bands)
    settings, trace_settings = roomfit.Settings(), TraceSettings(0.35, n_rays, 1000)
    return assumed_scattering(found, priors, settings, trace_settings, np.full(3, 0.15))


@pytest.mark.slow
def test_floor_and_ceiling_that_scatter_otherwise_get_a_coefficient_of_their_own():
    """Data of another tracer. Where a directivity is given, energies cannot say it."""
    priors, _, chosen = assumed(mixed_box(0.5, 0.05, {}))
    assert chosen.gain > 3.0
    assert chosen.value[4] == chosen.value[5] > 2.0 * chosen.value[0]
    for prior, value in zip(priors, chosen.value, strict=True):
        assert np.all(prior.scattering == value)
    directed = assumed(mixed_box(0.5, 0.05, {"S": UnknownDirectivity()}))[2]
    assert directed.gain == 0.0 and len(set(directed.value)) == 1


@pytest.mark.slow
def test_walls_that_scatter_alike_are_not_taken_for_smooth_nor_parted():
    """With the rays of a room; the noise of 8,000 is taken for walls that scatter by .05."""
    chosen = assumed(mixed_box(0.1, 0.1, {}), 60_000)[2]
    assert chosen.gain == 0.0
    assert set(chosen.value) == {0.1}
    assert set(chosen.upper) == {0.1}


def test_materials_are_level_or_upright_in_every_state_and_by_the_larger_area():
    """60 m2 of the plaster of a whole box are level, and 66 m2 upright."""
    room = roomfit.shoebox_room((6, 5, 3), {"walls": "plaster", "floor": "carpet"})
    room = with_states(room, {"prepared": {"north": "curtain", "floor": "parquet"}})
    sides = dict(zip(room.materials, _sides(room).tolist(), strict=True))
    level = ("carpet", "ceiling", "parquet")
    assert sides == {"plaster": -1, "curtain": -1, **dict.fromkeys(level, 1)}
    assert _sides(roomfit.shoebox_room((6, 5, 3), "plaster")).tolist() == [-1]
