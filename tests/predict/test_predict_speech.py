"""Predicted speech transmission: intervals by another way, levels, files, and what is missing."""

from __future__ import annotations

import numpy as np
import pytest

import roomfit
from roomfit.base.bands import bands_between
from roomfit.base.errors import InputError
from roomfit.base.logit import logit
from roomfit.files.campaign import read_campaign
from roomfit.files.questions import question_of
from roomfit.predict.changes import Change, read_change
from roomfit.predict.other_walls import numbers_at
from roomfit.predict.output import predicted_content
from roomfit.predict.predict import predict, predict_change, prepare
from roomfit.predict.question import Question
from roomfit.signals.decay import decay_curve
from roomfit.signals.filters import filter_pressure
from roomfit.signals.measurement import Measurement
from roomfit.signals.response import ImpulseResponse
from roomfit.signals.speech import modulation_transfer, speech_levels, speech_transmission
from roomfit.treat.arrangements import treat
from roomfit.treat.question import Product, Surface, Target, problem_of
from roomfit.treat.search import numbers_of
from roomfit.uncertainty.posterior import AbsorptionPosterior
from small_campaign import ABSORPTION, write_campaign

SPEECH = bands_between("octave", 125, 8000)
FEW = roomfit.Settings(n_rays=3000, n_draws=16)
RATE_HZ = 32000
NAMES = tuple(ABSORPTION)


def posterior(sd: float, bands=SPEECH, mean: float = 0.15) -> AbsorptionPosterior:
    a = np.full((1, len(bands)), mean)
    low, high = (1.0 / (1.0 + np.exp(-(logit(a) + s * 1.96 * sd))) for s in (-1, 1))
    covariance = np.full((len(bands), 1, 1), sd**2)
    scattering = np.full(a.shape, 0.4)
    return AbsorptionPosterior(("walls",), bands, a, low, high, covariance, scattering=scattering)


@pytest.fixture(scope="module")
def scene():
    room = roomfit.shoebox_room((6.0, 5.0, 3.0), "walls")
    points = {"S": (1.5, 1.2, 1.5)}, {"R": (4.0, 3.5, 1.2), "Q": (4.6, 1.4, 1.1)}
    return roomfit.scene_of(room, *points)


@pytest.fixture(scope="module")
def plain(scene):
    return predict(Question(scene, posterior(0.05), settings=FEW))


def gaussian_response(decay, rng) -> np.ndarray:
    """Return noise whose energy in every band decays as predicted, from the pictures' curves."""
    t = np.arange(int(RATE_HZ * decay.time_s[-1])) / RATE_HZ
    white = ImpulseResponse(rng.normal(size=t.size), RATE_HZ)
    pressure = np.zeros(t.size)
    for level, band in zip(decay.predicted_db, filter_pressure(SPEECH, white),
                           strict=True):  # fmt: skip
        left = 10.0 ** (0.1 * np.interp(t, decay.time_s, level))
        pressure += np.sqrt(np.maximum(-np.gradient(left), 0.0)) * band
    return pressure


@pytest.mark.slow
def test_the_index_and_its_scatter_are_those_of_gaussian_responses(scene, plain):
    """The interference alone: 30 responses of the predicted decay, a tenth off at one sd."""
    pair = plain.pairs[0]
    rng, found = np.random.default_rng(7), []
    onset_s = np.linalg.norm(np.subtract((1.5, 1.2, 1.5), (4.0, 3.5, 1.2))) / 343.0
    for _ in range(30):
        response = ImpulseResponse(gaussian_response(pair.decay, rng), RATE_HZ)
        curve = decay_curve(SPEECH, response, float(onset_s))
        found.append(float(speech_transmission(modulation_transfer(curve))))
    # 160 points of a curve in dB lose what is early by a jnd's third
    assert np.mean(found) == pytest.approx(float(pair.sti.predicted[0]), abs=0.015)
    model_sd = 0.3 * 0.03
    sd = np.sqrt(pair.sti.sd_rest[0] ** 2 - model_sd**2)
    assert 0.75 < np.std(found) / sd < 1.6


def test_intervals_widen_with_what_is_not_known_of_the_absorption(scene, plain):
    wide = predict(Question(scene, posterior(0.5), settings=FEW))
    for found in (*(p.sti for p in plain.pairs), plain.sti):
        assert 0.0 < found.lower95[0] < found.predicted[0] < found.upper95[0] < 1.0
    assert wide.sti.sd_absorption[0] > 5.0 * plain.sti.sd_absorption[0]


def test_absorption_raises_the_index_and_noise_lowers_it(scene, plain):
    changes = [Change("walls", "value", (0.4,) * 7, (0.0,) * 7)]
    speech_db = speech_levels(60.0, [50.0, 48.0, 45.0, 42.0, 40.0, 38.0, 35.0])
    quiet = predict(Question(scene, posterior(0.05), changes, settings=FEW))
    noisy = predict(Question(scene, posterior(0.05), settings=FEW, speech_db=speech_db))
    change = quiet.sti.change
    assert change.before == pytest.approx(plain.sti.predicted, abs=1e-12)
    assert change.change_lower95[0] > 0.05
    assert change.change == pytest.approx(quiet.sti.predicted - change.before, abs=1e-12)
    assert noisy.sti.predicted[0] < plain.sti.predicted[0] - 0.05
    text = str(quiet)
    assert "Speech transmission index" in text
    assert "expected before" in text.split("Speech transmission index")[1].split("By pair")[0]


@pytest.mark.parametrize("levels", [None, [50.0, 48.0, 45.0, 42.0, 40.0, 38.0, 35.0]])
def test_a_prepared_room_predicts_the_index_after_a_change_as_predict_does(scene, levels):
    """Within a third of a just noticeable difference, at every pair and over them."""
    speech_db = None if levels is None else speech_levels(60.0, levels)
    known = posterior(0.2)
    room = prepare(Question(scene, known, settings=FEW, speech_db=speech_db))
    for text, values in (("value", (0.4,) * 7), ("factor", (0.7,) * 7)):
        change = [Change("walls", text, values, (0.0,) * 7)]
        found = predict_change(room, change)
        exact = predict(Question(scene, known, change, settings=FEW, speech_db=speech_db))
        for own, one in ((found, exact), *zip(found.pairs, exact.pairs, strict=True)):
            assert abs(one.sti.predicted[0] - one.sti.change.before[0]) > 0.02
            # decays are followed as far as each needs
            assert own.sti.change.before[0] == pytest.approx(one.sti.change.before[0], abs=1e-4)
            for row in ("predicted", "lower95", "upper95"):
                assert getattr(own.sti, row)[0] == pytest.approx(getattr(one.sti, row)[0], abs=0.01)
            assert own.sti.change.change_lower95[0] == pytest.approx(
                one.sti.change.change_lower95[0], abs=0.01
            )


def test_an_index_is_reached_with_the_fewest_pieces(scene):
    """Pieces of one product, counted."""
    room = prepare(Question(scene, posterior(0.2), settings=FEW))
    hung, whole = Product("foam", np.full(7, 0.8), np.full(7, 0.05)), (Surface("walls"),)
    question = problem_of(room, whole, [hung], [Target("STI", low=0.75)])
    every = np.arange(question.most[0] + 1)[:, None]
    numbers = numbers_of(question, every)[:, 0]
    assert 0.3 < numbers[0] < 0.7
    found = treat(room, whole, [hung], [Target("STI", low=0.75)], number=1)
    (one,) = found.arrangements
    fewest = int(np.flatnonzero(numbers >= 0.75 - 0.003)[0])
    assert one.hung[0].area_m2 == pytest.approx(fewest)
    said = predict_change(room, [read_change(h.change) for h in one.hung])
    assert one.sti.predicted[0] == pytest.approx(said.sti.predicted[0], abs=1e-9)
    assert one.sti.predicted[0] == pytest.approx(numbers[fewest], abs=1e-3)  # by few paths
    assert one.sti.change.before[0] == pytest.approx(numbers[0], abs=1e-9)
    assert one.before[0] < 0.1 < one.probability[0]


def test_a_measured_response_stands_beside_its_prediction(scene, plain):
    pressure = gaussian_response(plain.pairs[0].decay, np.random.default_rng(3))
    measured = Measurement("S", "R", pressure, RATE_HZ, time_zero="emission")
    changes = [Change("walls", "factor", (1.5,) * 7, (0.0,) * 7)]
    found = predict(Question(scene, posterior(0.05), changes, [measured], settings=FEW))
    one, other = found.pairs
    assert one.sti.measured[0] == pytest.approx(one.sti.change.before[0], abs=0.05)
    assert np.isnan(other.sti.measured[0])
    # the mean is that over the measured pair
    assert found.sti.measured[0] == one.sti.measured[0]
    room = prepare(Question(scene, posterior(0.05), measurements=[measured], settings=FEW), [])
    after = numbers_at(room, found.absorption, room.draws)[0].sti
    assert after.values[0, 0] == pytest.approx(one.sti.predicted[0], abs=0.01)


def test_without_8_khz_there_is_none_and_the_reason_is_said(scene):
    few = bands_between("octave", 125, 4000)
    found = predict(Question(scene, posterior(0.05, few), settings=FEW))
    assert found.sti is None
    assert found.pairs[0].sti is None
    assert "STI is not predicted: it needs the octave bands" in str(found)
    content = predicted_content(found, ())
    assert content["sti"] is None
    assert "8000 Hz is missing" in content["sti_missing"]


def test_a_campaign_gives_the_levels(tmp_path):
    path = write_campaign(tmp_path / "campaign")
    text = path.read_text()
    assert read_campaign(path, to_fit=False).speech is None
    path.write_text(f"{text}\n[speech]\nlevel_dba = 60\nnoise_db = [45, 42, 40, 38, 36, 34, 32]\n")
    campaign = read_campaign(path, to_fit=False)
    a = np.full((len(NAMES), 2), 0.3)
    known = AbsorptionPosterior(
        NAMES, bands_between("octave", 500, 1000), a, a, a, np.zeros((2, len(NAMES), len(NAMES)))
    )
    np.testing.assert_array_equal(
        question_of(campaign, known).speech_db,
        speech_levels(60.0, [45, 42, 40, 38, 36, 34, 32]),
    )
    path.write_text(f"{text}\n[speech]\nlevel_dba = 60\nnoise_db = [45, 42]\n")
    with pytest.raises(InputError, match="noise_db"):
        read_campaign(path, to_fit=False)
