"""Responses after a change: bit by bit where nothing changes, decays as predicted where it does."""

from __future__ import annotations

import json

import numpy as np
import pytest
import soundfile
from hypothesis import given, settings
from hypothesis import strategies as st

import roomfit
from roomfit.base.bands import bands_between
from roomfit.base.errors import InputError
from roomfit.base.logit import logit
from roomfit.predict.changes import Change
from roomfit.predict.listen import (
    convolved,
    energy_ratio,
    listen,
    scaled_response,
)
from roomfit.predict.predict import predict
from roomfit.predict.question import Question
from roomfit.signals.decay import decay_curve, room_parameters
from roomfit.signals.filters import filter_pressure
from roomfit.signals.measurement import Measurement
from roomfit.signals.noise import estimate_noise
from roomfit.signals.response import ImpulseResponse
from roomfit.uncertainty.posterior import AbsorptionPosterior
from small_campaign import ABSORPTION, run_command, write_campaign

BANDS = bands_between("octave", 250, 2000)
BANK = BANDS
RATE_HZ = 16000
TIMES = np.arange(24000) / RATE_HZ


def noise_decay(decay_s: float, floor_db: float, seed: int = 1) -> ImpulseResponse:
    """Return Gaussian noise that decays from 50 ms on, over a floor below its beginning."""
    rng = np.random.default_rng(seed)
    envelope = 10.0 ** (-3.0 * np.maximum(TIMES - 0.05, 0.0) / decay_s) * (TIMES > 0.05)
    floor = 10.0 ** (floor_db / 20.0) * rng.normal(size=TIMES.size)
    return ImpulseResponse(rng.normal(size=TIMES.size) * envelope + floor, RATE_HZ)


def times_of(response: ImpulseResponse, name: str = "T30_s") -> np.ndarray:
    return room_parameters(decay_curve(BANK, response, 0.05)).of(name)


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 1000), st.integers(200, 5000))
def test_ratios_of_one_give_the_response_back_bit_by_bit(seed, n):
    pressure = np.random.default_rng(seed).normal(size=n)
    response = ImpulseResponse(pressure, RATE_HZ)
    found = scaled_response(response, BANDS, np.arange(3.0), np.ones((4, 3)))
    assert found.tobytes() == pressure.tobytes()


def test_a_constant_ratio_scales_all_frequencies_alike():
    response = noise_decay(0.5, -60.0)
    found = scaled_response(response, BANDS, np.zeros(1), np.full((4, 1), 0.25))
    np.testing.assert_allclose(found, 0.5 * response.pressure, atol=1e-12)


@pytest.mark.parametrize(("before_s", "after_s"), [(0.6, 0.4), (0.4, 0.6)])
def test_exponential_decays_become_the_predicted_ones(before_s, after_s):
    """And the noise stays what it is, neither amplified nor bent into another slope."""
    response = noise_decay(before_s, -70.0)
    noise = estimate_noise(BANK, response, filter_pressure(BANK, response), 0.05)
    assert noise.reached.all()
    ratio = 10.0 ** (-6.0 * np.maximum(TIMES - 0.05, 0.0) * (1.0 / after_s - 1.0 / before_s))
    made = ImpulseResponse(
        scaled_response(response, BANDS, TIMES, np.tile(ratio, (4, 1)), noise), RATE_HZ
    )
    # the same realisation, so that how reflections interfere is the same
    expected = noise_decay(after_s, -70.0)
    np.testing.assert_allclose(times_of(made), times_of(expected), rtol=0.03)
    np.testing.assert_allclose(times_of(made, "EDT_s"), times_of(expected, "EDT_s"), rtol=0.05)
    tail = slice(int(1.2 * RATE_HZ), None)
    powers = [np.mean(x.pressure[tail] ** 2) for x in (response, made)]
    assert powers[1] == pytest.approx(powers[0], rel=0.1)
    again = estimate_noise(BANK, made, filter_pressure(BANK, made), 0.05)
    np.testing.assert_allclose(again.floor, noise.floor, rtol=0.3)


def test_a_longer_tail_than_the_noise_lets_be_measured_is_carried_by_the_noise():
    """Beyond the crossing the level is that of the predicted decay, within 3 dB over 25 dB."""
    response = noise_decay(0.4, -45.0)
    noise = estimate_noise(BANK, response, filter_pressure(BANK, response), 0.05)
    ratio = np.tile(10.0 ** (-6.0 * np.maximum(TIMES - 0.05, 0.0) * (1 / 0.8 - 1 / 0.4)), (4, 1))
    made = scaled_response(response, BANDS, TIMES, ratio, noise)
    truth = noise_decay(0.8, -45.0).pressure
    for begin_s in (0.4, 0.5, 0.6, 0.8, 1.2):
        at = slice(int(begin_s * RATE_HZ), int((begin_s + 0.1) * RATE_HZ))
        level = 10.0 * np.log10(np.mean(made[at] ** 2) / np.mean(truth[at] ** 2))
        assert abs(level) < 3.0, begin_s


def test_a_single_reflection_is_scaled_by_its_own_ratio():
    """The direct sound stays, the reflection 8 ms later has half of its pressure."""
    edges_s = np.arange(0.0, 0.1, 1e-4)
    before, after = np.zeros((1, edges_s.size - 1)), np.zeros((1, edges_s.size - 1))
    before[0, [100, 180, 400]] = 1.0, 0.5, 0.1
    after[0, [100, 180, 400]] = 1.0, 0.125, 0.1
    ratio = energy_ratio(before, after, edges_s, 0.01)
    np.testing.assert_allclose(ratio[0, [100, 180]], [1.0, 0.25])


def test_a_ratio_goes_on_as_it_fell_where_nothing_is_predicted():
    edges_s = np.arange(0.0, 2.0, 1e-3)
    middle = 0.5 * (edges_s[1:] + edges_s[:-1])
    before, after = (
        np.where(middle < 0.5, 10.0 ** (-6.0 * middle / t), 0.0)[None] for t in (0.6, 0.4)
    )
    ratio = energy_ratio(before, after, edges_s, 0.0)[0]
    expected = -60.0 * middle * (1.0 / 0.4 - 1.0 / 0.6)
    # means over 20 ms, and their beginning
    assert np.abs(10.0 * np.log10(ratio) - expected)[middle < 1.5].max() < 0.6


@pytest.fixture(scope="module")
def room():
    sides = ("west", "east", "south", "north", "ceiling")
    shoebox = roomfit.shoebox_room(
        (6.0, 5.0, 3.0), dict.fromkeys(sides, "walls") | {"floor": "floor"}
    )
    scene = roomfit.scene_of(shoebox, {"S": (1.5, 1.2, 1.5)}, {"R": (4.0, 3.5, 1.2)})
    a = np.full((2, len(BANDS)), 0.15)
    low, high = (1.0 / (1.0 + np.exp(-(logit(a) + s * 0.2))) for s in (-1, 1))
    known = AbsorptionPosterior(
        shoebox.materials, BANDS, a, low, high, np.tile(np.eye(2) * 0.01, (len(BANDS), 1, 1)),
        scattering=np.full(a.shape, 0.4),
    )  # fmt: skip
    return scene, known


def gaussian_response(decay) -> np.ndarray:
    """Return noise whose energy in every band decays as predicted."""
    rng = np.random.default_rng(5)
    white = ImpulseResponse(rng.normal(size=TIMES.size), RATE_HZ)
    pressure = 1e-4 * rng.normal(size=TIMES.size)
    for level, band in zip(decay.predicted_db, filter_pressure(BANK, white), strict=True):
        left = 10.0 ** (0.1 * np.interp(TIMES, decay.time_s, level))
        pressure += np.sqrt(RATE_HZ * np.maximum(-np.gradient(left), 0.0)) * band
    return pressure


FEW = roomfit.Settings(n_rays=4000, n_draws=4)


@pytest.mark.parametrize("floor", [0.4, 0.08])
def test_what_is_made_has_the_room_parameters_that_are_predicted(room, floor):
    """Beside the same noise under the decay that is predicted: a just noticeable difference."""
    scene, known = room
    plain = predict(Question(scene, known, settings=FEW))
    response = gaussian_response(plain.pairs[0].decay)
    measured = Measurement("S", "R", response, RATE_HZ)
    change = Change("floor", "value", (floor,))
    made, _ = listen(Question(scene, known, [change], [measured], settings=FEW))
    assert made[0].samples.shape == response.shape
    changed = predict(Question(scene, known, [change], settings=FEW)).pairs[0].decay
    truth = Measurement("S", "R", gaussian_response(changed), RATE_HZ)
    again = Measurement("S", "R", made[0].samples, RATE_HZ)
    found, expected = (
        predict(Question(scene, known, (), [m], settings=FEW)).pairs[0].parameters
        for m in (again, truth)
    )
    for name in ("T20_s", "T30_s", "EDT_s"):
        np.testing.assert_allclose(
            found[name].measured, expected[name].measured, rtol=0.05, err_msg=name
        )
    np.testing.assert_allclose(found["C50_dB"].measured, expected["C50_dB"].measured, atol=1.0)
    # the direct sound is no wall's
    first = int(RATE_HZ * np.linalg.norm([2.5, 2.3, 0.3]) / 343.0)
    assert np.all(made[0].samples[: first - 20] == response[: first - 20])


def test_an_empty_change_gives_the_response_back(room):
    scene, known = room
    pressure = noise_decay(0.4, -60.0).pressure
    measured = Measurement("S", "R", pressure, RATE_HZ, time_zero="direct")
    made, _ = listen(Question(scene, known, (), [measured], settings=FEW))
    assert made[0].samples.tobytes() == pressure.tobytes()


def test_nothing_is_made_without_a_response_or_of_unknown_walls(room):
    scene, known = room
    with pytest.raises(InputError, match="no measured response"):
        listen(Question(scene, known, (), []))


def test_a_convolution_is_the_sum_of_shifted_responses():
    dry, response = np.array([1.0, 0.0, -2.0]), np.array([1.0, 0.5])
    np.testing.assert_allclose(convolved(dry, response), [1.0, 0.5, -2.0, -1.0], atol=1e-15)


def test_the_command_writes_comparable_files(tmp_path, monkeypatch, capsys):
    """Same rate, length and level; without a change the file before is the file after."""
    campaign = write_campaign(tmp_path / "campaign")
    table = "material,band_hz,absorption,lower95,upper95,identifiable\n" + "".join(
        f"{name},{f},{a},{0.8 * a},{1.2 * a},true\n"
        for name, a in ABSORPTION.items()
        for f in (500, 1000)
    )
    result = tmp_path / "absorption.csv"
    result.write_text(table)
    name = next(iter(ABSORPTION))
    call = ["listen", str(campaign), "--absorption", str(result), "--out"]
    assert run_command(monkeypatch, *call, tmp_path / "same") == 0
    content = json.loads((tmp_path / "same" / "listen.json").read_text())
    files = content["responses"][0]["files"]
    same = [soundfile.read(tmp_path / "same" / files[k], dtype="float32") for k in files]
    assert same[0][0].tobytes() == same[1][0].tobytes()
    rate = same[0][1]
    dry = tmp_path / "dry.wav"
    soundfile.write(dry, np.random.default_rng(1).normal(size=rate) * 0.1, rate, subtype="FLOAT")
    made = (tmp_path / "made", "--set", f"{name}=0.9", "--dry", dry)
    assert run_command(monkeypatch, *call, *made) == 0
    content = json.loads((tmp_path / "made" / "listen.json").read_text())
    peaks = []
    for row in content["responses"]:
        read = {k: soundfile.read(tmp_path / "made" / f)[0] for k, f in row["files"].items()}
        assert read["before"].shape == read["after"].shape
        assert np.sum(read["after"] ** 2) < np.sum(read["before"] ** 2)
        peaks += [np.abs(read[k]).max() for k in ("dry_before", "dry_after")]
        assert len(row["noise_from_s"]) == len(content["bands_hz"])
    assert max(peaks) == pytest.approx(0.5, rel=1e-6)
    assert content["dry_factor"] > 0.0
    soundfile.write(
        dry, np.random.default_rng(1).normal(size=rate) * 0.1, 2 * rate, subtype="FLOAT"
    )
    assert run_command(monkeypatch, *call, tmp_path / "other", "--dry", dry) == 2
    assert "another sampling rate" in capsys.readouterr().err


AFTER = (0.12, 0.2, 0.25, 0.35, 0.45, 0.5)


@pytest.mark.slow
def test_measured_responses_become_what_is_predicted_of_them(real_data):
    """Six of R3VIVAL's, whose reflecting walls get the absorption of its panels, or about that.

    `benchmarks/listen.py` fits both states; what is made must follow whatever is predicted. In the
    mean over the pairs as carried over: decay times within a just noticeable difference, C50
    within 1 dB, from 250 Hz up. EDT, which few reflections decide, of six pairs within three: it is
    the ratio of two EDTs that carries it over, and the response has its own.
    """
    from known_changes import BANDS as OCTAVES
    from known_changes import r3vival

    scene, measured, _ = r3vival(real_data, "000", 60, ["200"])
    materials = scene.room.materials
    a = np.full((len(materials), len(OCTAVES)), 0.2)
    none = np.zeros((len(OCTAVES), len(materials), len(materials)))

    def uniform(a):
        return AbsorptionPosterior(
            materials, OCTAVES, a, a, a, none, scattering=np.full(a.shape, 0.2)
        )

    for _ in range(3):
        # so absorbing that the model decays as the room does, by Eyring's formula
        mean = predict(Question(scene, uniform(a), (), measured, settings=FEW)).mean["T30_s"]
        a = 1.0 - (1.0 - a) ** (mean.predicted / mean.measured)
    known = uniform(a)
    changes = [Change(w, "value", AFTER) for w in materials if w not in ("floor", "ceiling")]
    made, _ = listen(Question(scene, known, changes, measured, settings=FEW))
    predicted = predict(Question(scene, known, changes, measured, settings=FEW))
    again = [
        Measurement(m.source, m.receiver, c.samples, m.sampling_rate_hz, time_zero="unknown")
        for m, c in zip(measured, made, strict=True)
    ]
    found = predict(Question(scene, known, (), again, settings=FEW))
    for name, limit in (("T20_s", 0.05), ("T30_s", 0.05), ("EDT_s", 0.15)):
        mean = predicted.mean[name]
        wanted = (mean.measured * mean.change.change)[1:]
        ratio = found.mean[name].measured[1:] / wanted
        np.testing.assert_allclose(ratio, 1.0, atol=limit, err_msg=name)
        # and not because little was asked for
        assert np.all(wanted[1:] < 0.8 * mean.measured[2:])
    before = predicted.mean["C50_dB"]
    c50 = found.mean["C50_dB"].measured - (before.measured + before.change.change)
    assert np.abs(c50[1:]).max() < 1.0
    # from when on noise carries the tail is said of every band whose noise is reached
    assert np.isfinite([c.noise_from_s for c in made]).any(axis=0).sum() >= 4, made
