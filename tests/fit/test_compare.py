"""Decays by the pressures of image sources, and whether they explain responses better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import roomfit
from roomfit.base.air import Air, attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import Bands, bands_between
from roomfit.demo.boxes import SyntheticBox, pressure_response
from roomfit.fit.compare import compare_all, compare_pairs, compared_values
from roomfit.fit.measurements import Measurements, collect_measurements
from roomfit.fit.paths import TracedPaths, traced_paths
from roomfit.fit.traced_room import trace_room
from roomfit.materials.priors import complete_priors
from roomfit.model.binned import BinnedPaths
from roomfit.model.pulses import interference
from roomfit.model.weighing import EnergyRows
from roomfit.room.scene import Scene
from roomfit.settings import Settings
from roomfit.signals.decay import PARAMETER_NAMES
from roomfit.signals.filters import frequency_response
from roomfit.signals.iso3382 import VALUE_NAMES, MeasuredValues
from roomfit.uncertainty.posterior import AbsorptionPosterior

WALLS = ("west", "east", "south", "north", "floor", "ceiling")
LENGTHS_M, RATE_HZ = (5.2, 4.1, 2.7), 16_000
TRUE = np.array([0.1, 0.5, 0.15, 0.3, 0.6, 0.25])
BANDS = bands_between("octave", 500, 2000)
SOURCE_M, RECEIVERS_M = (1.1, 1.3, 1.2), ((3.9, 2.9, 1.6), (2.6, 1.9, 0.9), (4.3, 1.2, 1.9))
SETTINGS = Settings(n_rays=4000, n_rays_beside_images=4000, n_scattering_rays=500)


def the_scene() -> Scene:
    room = roomfit.shoebox_room(LENGTHS_M, dict(zip(WALLS, WALLS, strict=True)))
    return roomfit.scene_of(
        room, {"S": SOURCE_M}, {f"R{i}": at for i, at in enumerate(RECEIVERS_M)}
    )


def collected(responses: list[np.ndarray]) -> Measurements:
    measurements = [
        roomfit.Measurement("S", f"R{i}", p, RATE_HZ, level="per-file")
        for i, p in enumerate(responses)
    ]
    return collect_measurements(the_scene(), measurements, BANDS, {})


def traced(measured: Measurements) -> TracedPaths:
    materials = [roomfit.material_prior(n, BANDS, scattering=0.0) for n in WALLS]
    priors = complete_priors(measured.scene.room.materials, materials, BANDS)
    return traced_paths(measured, priors, SETTINGS, np.full(len(BANDS), 0.3), None)


@pytest.fixture(scope="module")
def by_images() -> tuple[Measurements, TracedPaths]:
    """Responses of a simulator in plain numpy that adds pressures of images, and the trace."""
    wide = bands_between("octave", 250, 4000)
    truth = SyntheticBox(
        LENGTHS_M, wide.centres_hz, np.tile(TRUE[:, None], len(wide)),
        attenuation_per_m(Air(), wide), speed_of_sound_m_s(Air()),
    )  # fmt: skip
    rng, responses = np.random.default_rng(5), []
    for at in RECEIVERS_M:
        p = pressure_response(
            truth, np.array(SOURCE_M), np.array(at), 0.4, RATE_HZ, np.zeros(len(wide))
        )
        responses.append(p + 1e-4 * np.abs(p).max() * rng.standard_normal(p.size))
    measured = collected(responses)
    return measured, traced(measured)


def off_jnd(measured: Measurements, paths: TracedPaths, added: np.ndarray | None) -> np.ndarray:
    """Return the mean error of room parameters in just noticeable differences, by band."""
    absorption = np.tile(TRUE[:, None], len(BANDS))
    scene = measured.scene
    pairs = compare_pairs(scene, BANDS, paths.binned, measured.responses, absorption, added)
    jnd = np.array([[c.jnd for c in p.parameters.values()] for p in pairs])
    return np.asarray(np.nanmean(np.abs(jnd), axis=(0, 1)))


def test_two_images_interfere_as_the_transform_of_the_filter_says():
    """The energy of a sum of two pulses exceeds that of both by twice the product of their heights
    times the autocorrelation of the filter at their distance in time."""
    c, lengths_m = speed_of_sound_m_s(Air()), np.array([3.0, 3.06])
    edges_s = 1e-4 * np.arange(-200, 400)
    bins = np.searchsorted(edges_s, lengths_m / c, side="right") - 1
    offsets = np.searchsorted(bins, np.arange(edges_s.size)).astype(np.int64)
    rows = EnergyRows(
        ("wall",), edges_s.size - 1, offsets, np.array([1.0, 1.0]), np.array([[0], [1]]),
        lengths_m, np.array([-1, -1]),
    )  # fmt: skip
    room = roomfit.shoebox_room((6.0, 5.0, 3.0), "wall")
    scene = roomfit.scene_of(room, {"S": (1.0, 1.0, 1.0)}, {"R": (4.0, 1.0, 1.0)})
    absorption, chosen = np.full((1, 2), 0.36), np.array([False, True])
    bands = bands_between("octave", 250, 500)
    air = attenuation_per_m(scene.air, bands)
    found = interference(scene, bands, BinnedPaths(edges_s, (rows,)), 0, absorption, chosen)
    assert np.all(found[0] == 0.0)
    one = Bands("octave", bands.centres_hz[1:])
    f = np.linspace(1.0, 2000.0, 20_000)
    power = frequency_response(one, f)[0] ** 2
    alike = power @ np.cos(2.0 * np.pi * f * (lengths_m[1] - lengths_m[0]) / c) / power.sum()
    heights = np.sqrt(1.0 - 0.36) * np.exp(-0.5 * air[1] * lengths_m.sum())
    assert found[1].sum() == pytest.approx(2.0 * heights * alike, rel=2e-3)


def test_pressures_of_the_true_walls_give_the_values_that_responses_have(by_images):
    """Half of a just noticeable difference or less, where energies are off by four times that."""
    everywhere = np.ones(len(BANDS), dtype=np.bool_)
    pressures, energies = (off_jnd(*by_images, added) for added in (everywhere, None))
    assert pressures.max() < 0.5
    assert np.all(energies > 4.0 * pressures)


def test_pressures_are_taken_where_they_explain_responses_better_and_only_where_they_were_fitted(
    by_images,
):
    measured, paths = by_images
    absorption = np.tile(TRUE[:, None], len(BANDS))
    fitted = np.array([True, False, True])
    _, chosen = compare_all(measured, paths.binned, absorption, fitted)
    assert chosen.tolist() == [True, False, True]
    kept = [
        replace(m, measurement=replace(m.measurement, use="validate")) for m in measured.responses
    ]
    unfitted = replace(measured, responses=tuple(kept))
    assert not compare_all(unfitted, paths.binned, absorption, fitted)[1].any()


def of_random_signs(rows: EnergyRows, rng: np.random.Generator) -> np.ndarray:
    """Return a response of the images among some rows, each a pulse up or down by chance."""
    at = rows.batch < 0
    heights = np.sqrt(rows.weight_per_m2[at] * np.prod((1.0 - TRUE) ** rows.hits[at], axis=1))
    heights *= rng.choice([-1.0, 1.0], heights.size)
    samples = np.rint(rows.length_m[at] / speed_of_sound_m_s(Air()) * RATE_HZ).astype(int)
    return np.asarray(np.bincount(samples, heights))


@pytest.mark.slow
def test_responses_whose_reflections_have_random_phases_are_explained_by_energies(by_images):
    """The same images, each up or down by chance: ten rooms of three responses, seeded. By chance
    pressures do better in some bands: in a quarter of them at most."""
    _, paths = by_images
    absorption = np.tile(TRUE[:, None], len(BANDS))
    every, taken = np.ones(len(BANDS), dtype=np.bool_), []
    for seed in range(10):
        rng, responses = np.random.default_rng((11, seed)), []
        for pair in range(len(RECEIVERS_M)):
            responses.append(of_random_signs(paths.binned.rows[pair], rng))
        own = collected(responses)
        taken.append(compare_all(own, paths.binned, absorption, every)[1])
    assert np.mean(taken) < 0.25


def known(by_pressures: list[bool] | None) -> AbsorptionPosterior:
    """Return the true walls, smooth, and in which bands pressures are to be added."""
    shape = (len(WALLS), len(BANDS))
    return AbsorptionPosterior(
        WALLS, BANDS, *(np.tile(TRUE[:, None], len(BANDS)),) * 3,
        np.zeros((len(BANDS), len(WALLS), len(WALLS))), scattering=np.zeros(shape),
        by_pressures=None if by_pressures is None else np.array(by_pressures),
    )  # fmt: skip


@pytest.mark.slow
def test_a_prediction_adds_pressures_where_those_of_the_fitted_pairs_do(by_images):
    """Decays and levels of the chosen band are those of responses; the others are of energies."""
    measured, _ = by_images
    absorption = np.tile(TRUE[:, None], len(BANDS))
    by, of = (
        trace_room(the_scene(), known(chosen), absorption, 0.0, SETTINGS)
        for chosen in ([False, True, False], None)
    )
    assert not of.by_pressures.any() and by.by_pressures.tolist() == [False, True, False]
    found = np.array([[room.decay(i, absorption)[1] for i in range(3)] for room in (by, of)])
    true = np.array([m.parameters.values for m in measured.responses])
    clarity = PARAMETER_NAMES.index("C80_dB")
    off = np.abs(found[:, :, clarity] - true[:, clarity]).mean(axis=1)
    assert off[0, 1] < 0.2 and off[0, 1] < 0.25 * off[1, 1]
    np.testing.assert_allclose(off[0, [0, 2]], off[1, [0, 2]], atol=0.3)
    strength = VALUE_NAMES.index("G_dB")
    energy = by.energies(absorption)[:, 1].sum(axis=1)
    added = [
        interference(by.scene, BANDS, by.binned, i, absorption, by.by_pressures)[1].sum()
        for i in range(3)
    ]
    gain_db = 10.0 * np.log10(1.0 + np.array(added) / energy)
    np.testing.assert_allclose(
        found[0, :, strength, 1] - found[1, :, strength, 1], gain_db, atol=0.2
    )


def test_the_baseline_of_a_value_is_the_mean_of_all_others_that_know_it():
    values = [
        MeasuredValues("S", r, BANDS.centres_hz, {"T20_s": row, **more})
        for r, row, more in (
            ("A", [1.0, np.nan, np.nan], {}),
            ("B", [2.0, 3.0, np.nan], {"C50_dB": [np.nan] * 3}),
            ("C", [6.0, 5.0, np.nan], {}),
        )
    ]
    predicted = [np.full((len(VALUE_NAMES), 3), x) for x in (1.5, 2.0, 3.0)]
    found = compared_values(values, predicted, values[:2], BANDS)
    assert [list(table) for table in found] == [["T20_s"]] * 3
    rows = [table["T20_s"] for table in found]
    np.testing.assert_array_equal(rows[0].null, [2.0, 3.0, np.nan])
    np.testing.assert_array_equal(rows[1].null, [1.0, np.nan, np.nan])
    np.testing.assert_array_equal(rows[2].null, [1.5, 3.0, np.nan])
    np.testing.assert_array_equal(rows[2].measured, [6.0, 5.0, np.nan])
    np.testing.assert_array_equal(rows[2].predicted, [3.0] * 3)
    # 5 % of T is a just noticeable difference
    np.testing.assert_allclose(rows[2].jnd[:2], [-0.5 / 0.05, -0.4 / 0.05])
