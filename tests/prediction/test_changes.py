"""What a change makes of the absorption and of its draws, and what is said of it."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from roomfit.bands import bands_between
from roomfit.errors import InputError, InsufficientDataError
from roomfit.findings import About, Code, Finding
from roomfit.materials.catalogue import catalogue_prior
from roomfit.prediction import campaign
from roomfit.prediction.changes import Change, changed_draws
from roomfit.prediction.predict import change_findings
from roomfit.prediction.tables import PredictedValue, ValueChange
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


@dataclass(frozen=True)
class Pairs:
    """What a scene says of its pairs."""

    pairs: tuple[int, ...]
    pair_state: object = None


def test_all_pairs_are_predicted_in_the_state_that_is_asked_for():
    """The room as described is number 0, the campaign's own follow in their order."""
    scene = Pairs((1, 2, 3))
    own = SimpleNamespace(states=("open", "closed", "full"), path="campaign.toml")
    assert campaign._at_state(scene, own, "") is scene
    for number, name in enumerate(own.states, start=1):
        assert campaign._at_state(scene, own, name).pair_state.tolist() == [number] * 3
    with pytest.raises(InputError, match="does not define this state"):
        campaign._at_state(scene, own, "empty")
    assert [campaign.pair_choice(n) for n in ("all", "campaign")] == ["all", "campaign"]
    with pytest.raises(InputError, match="unknown choice of pairs"):
        campaign.pair_choice("some")


def test_other_walls_are_predicted_only_in_bands_in_which_no_finding_doubts_all_walls():
    """Of changes, and of states that were not fitted; values of those bands alone are kept."""
    bands = bands_between("octave", 500, 2000)
    fault = Finding(Code.DISPLACEMENT_DETECTED, About(bands_hz=[1000.0]), "moved")
    named = Finding(Code.DISPLACEMENT_DETECTED, About(materials=["wall"]), "moved")
    changes = (Change("wall", "value", (0.1, 0.2, 0.3), (0.01, 0.02, 0.03)),
               Change("floor", "value", (0.4,)))  # fmt: skip

    def known(*findings, states=("",)):
        return SimpleNamespace(result_findings=findings, fitted_states=states)

    assert campaign.undoubted(known(named), bands, changes, "") == (bands, changes, ())
    assert campaign.undoubted(known(fault), bands, (), "") == (bands, (), ())
    assert campaign.undoubted(known(fault, states=None), bands, (), "open") == (bands, (), ())
    for own, state in ((changes, ""), ((), "open")):
        kept, less, (finding,) = campaign.undoubted(known(fault), bands, own, state)
        assert kept.centres_hz.tolist() == [500.0, 2000.0] and kept.kind == "octave"
        assert finding.code is Code.RESULT_DOUBTED and list(finding.about.bands_hz) == [1000.0]
        assert (
            "at 1000 Hz" in finding.sentence
            and Code.DISPLACEMENT_DETECTED.value in finding.sentence
        )
        assert len(less) == len(own)
        if own:
            assert less[0].values == (0.1, 0.3) and less[0].sds == (0.01, 0.03)
            assert less[1] is changes[1]
    every = Finding(Code.DISPLACEMENT_DETECTED, About(), "moved")
    with pytest.raises(InsufficientDataError, match="seriously doubted"):
        campaign.undoubted(known(every), bands, changes, "")
