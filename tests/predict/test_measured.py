"""Predictions that begin with measurements: closed forms, and how often intervals hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import roomfit
from roomfit.base.bands import bands_between
from roomfit.base.typing import FloatArray
from roomfit.model.eyring import diffuse_values
from roomfit.predict.decay import PairNumbers
from roomfit.predict.measured import (
    anchored,
    anchors,
    from_units,
    given_others,
    in_units,
)
from roomfit.predict.prediction import PredictedDecay
from roomfit.room.scene import Scene, distances_m
from roomfit.signals.iso3382 import VALUE_NAMES, MeasuredValues
from roomfit.uncertainty.posterior import AbsorptionPosterior, FittedPair

BANDS = bands_between("octave", 250, 2000)
SHAPE = len(VALUE_NAMES), len(BANDS)
VOLUME_M3 = 150.0


def room(n_receivers: int) -> Scene:
    """Return a room with one source and receivers at random places."""
    rng = np.random.default_rng(5)
    places = rng.uniform((2.0, 1.0, 1.0), (9.0, 4.0, 2.0), (n_receivers, 3))
    receivers = {f"R{i}": tuple(p) for i, p in enumerate(places.tolist())}
    return roomfit.scene_of(
        roomfit.shoebox_room((10.0, 5.0, 3.0), "walls"), {"S": (1.0, 2.0, 1.5)}, receivers
    )


def numbers(values: FloatArray, noise: float) -> PairNumbers:
    """Return predictions of the model whose noise is so many noticeable differences."""
    unit = from_units(in_units(values) + noise) - values
    nothing = np.zeros((1, 1))
    decay = PredictedDecay(nothing[0], nothing, nothing, nothing)
    return PairNumbers(values, values[None], unit, decay, unit**2, 0.0 * unit, unit)


def posterior(fitted: tuple[FittedPair, ...]) -> AbsorptionPosterior:
    """Return an absorption that was found from some pairs."""
    ones = np.ones((1, len(BANDS)))
    covariance = np.zeros((len(BANDS), 1, 1))
    return AbsorptionPosterior(
        ("walls",), BANDS, 0.2 * ones, 0.1 * ones, 0.3 * ones, covariance, fitted=fitted
    )


def fitted(scene: Scene, measured: FloatArray, model: FloatArray) -> tuple[FittedPair, ...]:
    """Return the first pairs of a scene as fitted ones."""
    r = distances_m(scene)
    return tuple(
        FittedPair("S", f"R{i}", "", float(r[i]), y, f)
        for i, (y, f) in enumerate(zip(measured, model, strict=True))
    )


def plausible(n: int, rng: np.random.Generator) -> FloatArray:
    """Return room parameters of some places, (n, n_names, n_bands)."""
    law = diffuse_values(np.full(len(BANDS), 0.8), VOLUME_M3, rng.uniform(1.5, 6.0, n))
    return from_units(in_units(law) + rng.normal(0.0, 1.0, law.shape))


def test_the_law_of_a_diffuse_field_far_from_the_source_is_that_of_an_exponential_decay():
    """Without direct sound C80 is ``10 lg(exp(13.8 * .08 / T) - 1)``, and Ts is T / 13.8."""
    t = np.array([0.5, 1.0, 2.0])
    found = dict(zip(VALUE_NAMES, diffuse_values(t, 1e-6, np.array([1.0]))[0], strict=True))
    np.testing.assert_allclose(found["C80_dB"], 10 * np.log10(np.expm1(1.104 / t)), rtol=1e-4)
    np.testing.assert_allclose(found["TS_ms"], 1000.0 * t / 13.8, rtol=1e-4)
    np.testing.assert_allclose(found["D50_percent"], -100.0 * np.expm1(-0.69 / t), rtol=1e-4)
    # and in a room so large that no wall answers, the level of the free field
    free = diffuse_values(t, 1e12, np.array([5.0]))[0]
    np.testing.assert_allclose(free[VALUE_NAMES.index("G_dB")], 10 * np.log10(4.0), rtol=1e-4)


def test_a_result_has_each_pair_beside_a_diffuse_field_with_the_decay_of_the_others():
    scene, octave = room(3), bands_between("octave", 1000, 1000)
    given = [(0.8, 2.0), (0.9, 1.0), (1.0, 3.0)]
    tables = [
        MeasuredValues("S", f"R{i}", [1000.0], {"T30_s": [t], "C80_dB": [c]})
        for i, (t, c) in enumerate(given)
    ]
    few = roomfit.Settings(n_rays=2000, n_draws=8)
    result = roomfit.identify(scene, tables, bands=octave, settings=few)
    for i, (pair, r) in enumerate(zip(result.pairs, distances_m(scene).tolist(), strict=True)):
        t = np.mean([time for j, (time, _) in enumerate(given) if j != i])
        late = 31200.0 * t / VOLUME_M3 * np.exp(-0.04 * r / t) * np.exp(-1.104 / t)
        total = 100.0 / r**2 + late * np.exp(1.104 / t)
        found = pair.parameters["C80_dB"].diffuse
        np.testing.assert_allclose(found, 10 * np.log10(total / late - 1.0), rtol=1e-9)


def test_a_room_whose_fitted_states_it_does_not_have_is_predicted_all_the_same():
    """The state was named in another campaign; nothing is known of its surfaces here."""
    scene, rng = room(2), np.random.default_rng(8)
    unknown = [p._replace(state="elsewhere") for p in fitted(scene, *[plausible(2, rng)] * 2)]
    known, few = posterior(tuple(unknown)), roomfit.Settings(n_rays=500, n_draws=4)
    found = roomfit.predict(roomfit.Question(scene, known, settings=few))
    assert np.all(np.isfinite(found.mean["T30_s"].predicted))


def test_a_measured_pair_is_its_measurement_and_a_change_multiplies_it():
    rng, scene = np.random.default_rng(1), room(6)
    model, measured = plausible(6, rng), plausible(6, rng)
    known = posterior(fitted(scene, measured, model))
    own = [numbers(f, 0.5) for f in model]
    moves = anchors(known, scene, own)
    before = [anchored(n, n, a) for n, a in zip(own, moves, strict=True)]
    np.testing.assert_allclose([n.values for n in before], measured, rtol=1e-9)
    # where interference stays as it was, decay times change by the model's ratio
    after = [numbers(from_units(in_units(f) - 2.0), 0.5) for f in model]
    found = [anchored(n, b, a) for n, b, a in zip(after, own, moves, strict=True)]
    ratio = np.array([f.values[2] / y[2] for f, y in zip(found, measured, strict=True)])
    np.testing.assert_allclose(ratio, np.exp(-0.1), rtol=0.02)


def test_what_the_model_has_wrong_everywhere_is_in_no_prediction():
    rng, scene = np.random.default_rng(2), room(40)
    model = plausible(40, rng)
    measured = from_units(in_units(model) + 1.5)
    known = posterior(fitted(scene, measured[:39], model[:39]))
    own = [numbers(f, 0.1) for f in model]
    found = anchored(own[39], own[39], anchors(known, scene, own)[39])
    np.testing.assert_allclose(in_units(found.values), in_units(measured[39]), atol=0.1)


def test_a_model_that_tells_no_places_apart_gives_way_to_the_diffuse_field():
    rng, scene = np.random.default_rng(3), room(31)
    law = diffuse_values(np.full(len(BANDS), 0.8), VOLUME_M3, distances_m(scene))
    measured = from_units(in_units(law) + rng.normal(0.0, 0.2, law.shape))
    model = from_units(in_units(law) + rng.normal(0.0, 3.0, law.shape))
    known = posterior(fitted(scene, measured[:30], model[:30]))
    own = [numbers(f, 0.5) for f in model]
    found = anchored(own[30], own[30], anchors(known, scene, own)[30])
    off = np.abs(in_units(found.values) - in_units(law[30]))
    assert off.mean() < 0.5
    assert np.abs(in_units(model[30]) - in_units(law[30])).mean() > 1.5


@pytest.mark.parametrize("n", [2, 5, 20])
def test_intervals_hold_as_often_as_they_say(n: int) -> None:
    """Of 300 rooms' 32 values; the law of a binomial share is wider than its bounds by far.

    Scatter and shared error are drawn as theory has them, or twice as large. 92 to 98 % of values
    lie within 1.96 standard deviations, and these are at most 1.3 times the error where five pairs
    and more were fitted.
    """
    rng, scene = np.random.default_rng(4), room(n + 1)
    held, sds, errors = [], [], []
    for _ in range(300):
        model = plausible(n + 1, rng)
        size = rng.choice([1.0, 2.0])
        off = rng.normal(0.0, 0.5 * size, SHAPE) + rng.normal(0.0, 0.7 * size, model.shape)
        measured = from_units(in_units(model) + off)
        known = posterior(fitted(scene, measured[:n], model[:n]))
        own = [numbers(f, 0.7) for f in model]
        found = anchored(own[n], own[n], anchors(known, scene, own)[n])
        error = in_units(found.values) - in_units(measured[n])
        sd = np.hypot(found.noise_sd, found.shared_sd) / (in_units_slope(found.values))
        held.append(np.abs(error) < 1.96 * sd)
        sds.append(sd)
        errors.append(error)
    assert 0.9 < np.mean(held) < 0.985
    if n > 2:
        assert np.sqrt(np.mean(np.square(sds)) / np.mean(np.square(errors))) < 1.3


def test_draws_of_another_state_keep_what_the_fitted_states_leave_open():
    """Of logs a + b + c, with a and a + b known from two states, only c is left."""
    rng, shape = np.random.default_rng(6), (4000, *SHAPE)
    a, b, c = (rng.normal(0.0, sd, shape) for sd in (2.0, 1.0, 0.5))
    middle = plausible(1, rng)
    others = np.stack([np.concatenate((0.0 * a[:1], x)) for x in (a, a + b)]) + in_units(middle)
    own = replace(numbers(middle[0], 0.1), draws=from_units(in_units(middle) + a + b + c))
    found = in_units(given_others(own, from_units(others)).draws)
    well = np.flatnonzero(np.array(VALUE_NAMES) != "D50_percent")  # which ends at 0 and 100 %
    np.testing.assert_allclose(np.std(found, axis=0)[well], 0.5, rtol=0.08)
    np.testing.assert_allclose((np.mean(found, axis=0) - in_units(middle[0]))[well], 0, atol=0.2)


def in_units_slope(values: FloatArray) -> FloatArray:
    """Return how much of a parameter is one just noticeable difference."""
    return np.asarray(from_units(in_units(values) + 1e-6) - values) / 1e-6
