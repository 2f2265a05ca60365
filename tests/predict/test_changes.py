"""What a change makes of the absorption and of its draws, and what is said of it."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.base.bands import bands_between
from roomfit.materials.catalogue import catalogue_prior
from roomfit.predict.changes import Change, changed_draws
from roomfit.predict.prediction import PredictedValue, ValueChange, change_findings
from roomfit.uncertainty.posterior import AbsorptionPosterior

BANDS = bands_between("octave", 500, 1000)
NAMES = ("wall", "floor", "people")
N_DRAWS = 20_000


def drawn_with(*changes: Change):
    a = np.array([[0.2, 0.3], [0.1, 0.15], [0.05, 0.06]])
    known = AbsorptionPosterior(
        NAMES, BANDS, a, a, a, np.zeros((2, 3, 3)), objects={"people": 100.0}
    )
    draws = np.tile(a, (N_DRAWS, 1, 1)) * np.linspace(0.5, 1.5, N_DRAWS)[:, None, None]
    rng = np.random.default_rng(5)
    absorption, drawn, _ = changed_draws(known, draws, changes, rng)
    return a, absorption, draws, drawn


def test_an_entry_of_the_catalogue_stands_with_its_mean_and_spread():
    """Half of the draws are below the median, which lies near the mean; others stay."""
    mean, sd = catalogue_prior("plaster-on-masonry", BANDS)
    a, absorption, draws, drawn = drawn_with(
        Change("wall", "catalogue", entry="plaster-on-masonry")
    )
    np.testing.assert_array_equal(absorption[0], mean)
    np.testing.assert_array_equal(absorption[1:], a[1:])
    np.testing.assert_array_equal(drawn[:, 1:], draws[:, 1:])
    # four standard errors of a share of a half
    assert np.abs((drawn[:, 0] < mean).mean(axis=0) - 0.5).max() < 4 * 0.5 / np.sqrt(N_DRAWS)
    # the spread of the logit is that of the mean to first order
    spread = np.std(np.log(drawn[:, 0] / (1.0 - drawn[:, 0])), axis=0)
    np.testing.assert_allclose(spread, sd / (mean * (1.0 - mean)), rtol=0.05)


def test_another_material_of_the_room_is_taken_with_its_own_draws():
    a, absorption, draws, drawn = drawn_with(Change("wall", "catalogue", entry="floor"))
    np.testing.assert_array_equal(absorption[0], a[1])
    np.testing.assert_array_equal(drawn[:, 0], draws[:, 1])


def test_an_object_is_set_in_square_metres_as_the_absorption_they_stand_for():
    """In 100 m3 ten times the area is ten times the attenuation; the spread is that of the area."""
    _, absorption, _, drawn = drawn_with(Change("people", "value", (0.8,), (0.08,)))
    _, larger, _, _ = drawn_with(Change("people", "value", (8.0,)))
    np.testing.assert_allclose(np.log1p(-larger[2]) / np.log1p(-absorption[2]), 10.0, rtol=1e-9)
    assert np.all(absorption[2] > 0.0) and absorption[2][0] == absorption[2][1]
    relative = drawn[:, 2].std(axis=0) / absorption[2]
    np.testing.assert_allclose(relative, 0.1, rtol=0.05)


def value_of(low: float, high: float) -> PredictedValue:
    """Return a decay time whose change, after over before, lies between two numbers."""
    none, one = np.full(2, np.nan), np.ones(2)
    change = ValueChange(
        one, one, one, np.full(2, 0.5 * (low + high)), np.full(2, low), np.full(2, high),
        none, none, none,
    )  # fmt: skip
    return PredictedValue(one, one, one, none, none, none, none, none, change)


@pytest.mark.parametrize("is_measured", [False, True])
def test_what_is_measured_beside_a_change_is_said_to_be_of_the_room_before_it(is_measured):
    change = (Change("wall", "value", (0.3,)),)
    (finding, *_) = change_findings(change, is_measured, BANDS, {"T30_s": value_of(0.7, 0.9)})
    assert finding.sentence.startswith("Predicted with wall=0.3.")
    said = "Measured values beside it are those of the room as it was measured." in finding.sentence
    assert said is is_measured
    assert change_findings((), is_measured, BANDS, {}) == ()


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [
        (0.7, 0.9, "falls"),
        (1.1, 1.3, "rises"),
        (0.9, 1.1, "has no determined direction"),
    ],
)
def test_the_direction_of_a_change_is_that_of_its_whole_interval(low, high, words):
    """After over before of a decay time; below 1 it falls."""
    change = (Change("wall", "value", (0.3,)),)
    (finding,) = change_findings(change, False, BANDS, {"T30_s": value_of(low, high)})
    assert finding.sentence.endswith(f" At 95 % the mean of T30 {words} at 500, 1000 Hz.")
    assert finding.evidence["directions"] == {"T30_s": {words: [500.0, 1000.0]}}
