"""Predictions: any pair, any walls, with the uncertainty of the fit carried through."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from roomfit.base.bands import Bands, bands_between
from roomfit.base.errors import InputError
from roomfit.base.findings import Code
from roomfit.base.logit import logit
from roomfit.files.campaign import Campaign, read_campaign
from roomfit.files.questions import Wanted, question_of
from roomfit.files.results import read_result
from roomfit.files.rooms import read_room
from roomfit.fit.traced_room import scene_decay_s
from roomfit.predict.changes import read_change
from roomfit.predict.predict import predict
from roomfit.predict.prediction import Predicted
from roomfit.room.scene import Scene
from roomfit.signals.filters import statistical_bandwidth_hz
from roomfit.uncertainty.posterior import (
    AbsorptionPosterior,
    covariance_from_intervals,
    draw_absorption,
    plain_logit_covariance,
)
from small_campaign import ABSORPTION, run_command, write_campaign

BANDS = bands_between("octave", 500, 1000)
NAMES = tuple(ABSORPTION)


def posterior(sd: float = 0.05, bands: Bands = BANDS, names=NAMES) -> AbsorptionPosterior:
    """Return a posterior at the true absorption, materials independent."""
    a = np.array([[ABSORPTION.get(n, 0.3)] * len(bands) for n in names])
    width = 1.96 * sd
    low, high = (1.0 / (1.0 + np.exp(-(logit(a) + s * width))) for s in (-1, 1))
    covariance = np.stack([np.eye(len(names)) * sd**2] * len(bands))
    return AbsorptionPosterior(names, bands, a, low, high, covariance)


def predict_campaign(
    campaign: Campaign, absorption: AbsorptionPosterior, changes=(), *, pairs="all", n_draws: int
) -> Predicted:
    asked = question_of(campaign, absorption, changes, Wanted(pairs))
    return predict(replace(asked, settings=replace(asked.settings, n_draws=n_draws)))


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    return read_campaign(write_campaign(tmp_path_factory.mktemp("predict") / "campaign"))


@pytest.fixture(scope="module")
def predicted(campaign):
    return predict_campaign(campaign, posterior(), n_draws=32)


def values(p, name: str, what: str = "predicted") -> np.ndarray:
    return np.array([getattr(pair.parameters[name], what) for pair in p.pairs])


# ---------------------------------------------------------------- posterior and draws


def test_intervals_give_back_the_spread_they_were_made_of():
    sd = np.array([[0.1, 0.5], [1.2, 2.0]])
    a = np.array([[0.1, 0.5], [0.9, 0.03]])
    low, high = (1.0 / (1.0 + np.exp(-(logit(a) + s * 1.959964 * sd))) for s in (-1, 1))
    found = np.sqrt(np.diagonal(covariance_from_intervals(a, low, high), axis1=1, axis2=2)).T
    np.testing.assert_allclose(found, sd, rtol=1e-5)


def test_the_covariance_of_a_bounded_absorption_is_carried_over_by_its_slope():
    """The slope by a finite difference of a(u) = low + (high - low) / (1 + exp(-u))."""
    low, high, u, step = 0.1, 0.6, 0.4, 1e-5
    a = [low + (high - low) / (1.0 + np.exp(-x)) for x in (u - step, u, u + step)]
    slope = float((logit(np.array(a[2])) - logit(np.array(a[0]))) / (2 * step))
    found = plain_logit_covariance(
        np.array([[[0.04]]]), np.array([[a[1]]]), np.array([low]), np.array([high])
    )
    assert found[0, 0, 0] == pytest.approx(0.04 * slope**2, rel=1e-6)


# ---------------------------------------------------------------- what is predicted


@pytest.mark.slow
def test_every_source_meets_every_receiver_measured_or_not(campaign, tmp_path):
    text = campaign.path.read_text()
    more = text.replace("[[measurements]]", "[sources.LS2]\nposition = [3, 2.5, 1.4]\n"
                        "[[measurements]]", 1)  # fmt: skip
    other = campaign.path.with_name("more.toml")
    other.write_text(more)
    found = predict_campaign(read_campaign(other), posterior(), n_draws=4)
    uses = {(p.source, p.receiver): p.use for p in found.pairs}
    assert uses == {
        ("LS1", "MP1"): "fit",
        ("LS1", "MP2"): "fit",
        ("LS2", "MP1"): None,
        ("LS2", "MP2"): None,
    }
    table = found.pairs[-1].parameters["T20_s"]
    assert np.all(np.isnan(table.measured)) and np.all(np.isfinite(table.predicted))
    measured_only = predict_campaign(read_campaign(other), posterior(), pairs="campaign", n_draws=4)
    assert [p.source for p in measured_only.pairs] == ["LS1", "LS1"]


@pytest.mark.slow
def test_the_spread_is_the_slope_times_the_spread_of_the_absorption(campaign):
    """Slopes by predicting twice; 64 mirrored draws know a spread to 13 % (one sd): three sd."""
    sd = 0.02
    known = posterior(sd)
    one = np.zeros_like(known.logit_covariance)
    one[:, 0, 0] = sd**2
    found = predict_campaign(campaign, replace(known, logit_covariance=one), n_draws=64)
    at = {}
    for sign in (-1, 1):
        moved = known.absorption.copy()
        moved[0] = 1.0 / (1.0 + np.exp(-(logit(moved[0]) + sign * sd)))
        still = replace(known, absorption=moved, logit_covariance=0.0 * one)
        at[sign] = predict_campaign(campaign, still, n_draws=2)
    for name in ("T20_s", "T30_s", "EDT_s", "C50_dB", "C80_dB", "D50_percent", "TS_ms", "G_dB"):
        slope = np.abs(values(at[1], name) - values(at[-1], name)) / 2.0
        np.testing.assert_allclose(values(found, name, "sd_absorption"), slope, rtol=0.4)
        assert np.all(slope > 0.0)


@pytest.mark.slow
def test_what_is_not_absorption_is_the_noise_of_the_pair_and_the_error_of_the_model(campaign):
    """In a room that decays as Eyring says, known exactly: ISO 3382-2 and 5 % times 0.3.

    The standard's standard deviations hold for diffuse fields and whole decays: within a third.
    """
    text = campaign.path.read_text().replace("scattering = 0.0", "scattering = 0.9")
    path = campaign.path.with_name("noisy.toml")
    path.write_text(text)
    a = np.full((3, 2), 0.05)
    exact = AbsorptionPosterior(NAMES, BANDS, a, a, a, np.zeros((2, 3, 3)))
    found = predict_campaign(read_campaign(path), exact, n_draws=2)
    bandwidth_hz = statistical_bandwidth_hz(BANDS)
    for name, factor in (("T20_s", 0.88), ("T30_s", 0.55)):
        time_s = values(found, name)
        noise = np.sqrt(values(found, name, "sd_rest") ** 2 - (0.3 * 0.05 * time_s) ** 2)
        standard = factor * time_s / np.sqrt(bandwidth_hz * time_s)
        np.testing.assert_allclose(noise / standard, 1.0, atol=1.0 / 3.0)
        width = values(found, name, "upper95") - values(found, name, "lower95")
        np.testing.assert_allclose(width, 2 * 1.96 * values(found, name, "sd_rest"), rtol=0.1)


def test_the_noise_of_a_mean_falls_with_the_number_of_pairs_and_the_model_s_error_does_not(
    predicted,
):
    """Two pairs are independent: half the root of the sum of their squares."""
    for name, model in (("T20_s", 0.3 * 0.05), ("C80_dB", 0.3), ("TS_ms", 3.0)):
        mean = predicted.mean[name]
        size = values(predicted, name) if name == "T20_s" else np.ones((2, 2))
        noise = np.sqrt(values(predicted, name, "sd_rest") ** 2 - (model * size) ** 2)
        own = model * (mean.predicted if name == "T20_s" else 1.0)
        expected = np.hypot(0.5 * np.hypot(*noise), own)
        np.testing.assert_allclose(mean.sd_rest, expected, rtol=1e-9)
        assert np.all(noise > 0.2 * own)
        np.testing.assert_allclose(mean.predicted, values(predicted, name).mean(axis=0))


@pytest.mark.slow
def test_draws_of_more_absorption_move_every_value_the_way_it_goes(campaign):
    """All draws a tenth above the estimate: their intervals lie about what is predicted there."""
    known = posterior(0.02)
    higher = known.absorption + 0.1
    drawn = replace(known, draws=np.tile(higher, (4, 1, 1)))
    found = predict_campaign(campaign, drawn, n_draws=4)
    there = predict_campaign(campaign, replace(known, absorption=higher), n_draws=2)
    for name, rises in (("C80_dB", True), ("D50_percent", True), ("G_dB", False), ("TS_ms", False)):
        end = values(found, name, "upper95" if rises else "lower95")
        away = end - values(there, name)
        # the ends of the noise alone; rows are thinned for draws, which moves them a little
        reach = 1.96 * values(found, name, "sd_rest")
        if name == "D50_percent":  # no definition is above 100 %
            reach = np.minimum(reach, 100.0 - values(there, name))
        np.testing.assert_allclose(away if rises else -away, reach, rtol=0.35)


@pytest.mark.slow
def test_a_changed_material_is_predicted_as_if_it_had_been_found_so(campaign):
    known = posterior(0.0)
    other = known.absorption.copy()
    other[1], other[2] = 0.5 * other[1], (0.6, 0.7)
    direct = predict_campaign(campaign, replace(known, absorption=other), n_draws=2)
    changes = [read_change("carpet=x0.5"), read_change("tiles=0.6, 0.7")]
    found = predict_campaign(campaign, known, changes, n_draws=2)
    np.testing.assert_array_equal(found.absorption, other)
    for name in ("T20_s", "C80_dB", "G_dB"):
        np.testing.assert_allclose(values(found, name), values(direct, name), rtol=1e-12)
    assert found.changes == ("carpet=x0.5", "tiles=0.6,0.7")
    assert Code.MATERIALS_CHANGED in {f.code for f in found.findings}


def test_more_absorption_means_less_reverberation_and_level(campaign, predicted):
    more = predict_campaign(campaign, posterior(), [read_change("walls=0.5")], n_draws=4)
    for name in ("T20_s", "T30_s", "EDT_s", "TS_ms", "G_dB"):
        assert np.all(values(more, name) < values(predicted, name))
    for name in ("C50_dB", "C80_dB", "D50_percent"):
        assert np.all(values(more, name) > values(predicted, name))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("carpet", "not written"),
        ("carpet=0.3,heavy", "not written"),
        ("carpet=x2,0.3", "not written"),
        ("carpet=30", r"percentage"),
        ("carpet=0.1,0.2,0.3", "one value per band"),
        ("carpett=0.3", "did you mean 'carpet'"),
        ("carpet=carpet-on-underlai", "did you mean 'carpet-on-underlay'"),
    ],
)
def test_a_change_that_cannot_be_made_is_refused(campaign, text, words):
    with pytest.raises(InputError, match=words):
        predict_campaign(campaign, posterior(), [read_change(text)], n_draws=2)


@pytest.mark.slow
def test_another_room_takes_its_materials_by_name_and_names_the_missing(campaign, tmp_path):
    text = campaign.path.read_text().replace("[3.9, 3.1, 2.5]", "[4.9, 4.1, 2.9]")
    for name in ("LS1_MP1.wav", "LS1_MP2.wav"):
        text = text.replace(f'"{name}"', f'"{(campaign.path.parent / name).as_posix()}"')
    path = tmp_path / "other.toml"
    path.write_text(text)
    two = ("tiles", "walls")
    with pytest.raises(InputError, match="no carpet among"):
        predict_campaign(read_campaign(path), posterior(names=two), n_draws=2)
    path.write_text(text.replace("[materials.carpet]", "[materials.carpet]\nabsorption = 0.4"))
    larger = read_campaign(path)
    found = predict_campaign(larger, posterior(names=two), n_draws=2)
    np.testing.assert_allclose(found.absorption, posterior().absorption)
    whole = predict_campaign(larger, posterior(), n_draws=2)
    np.testing.assert_allclose(values(found, "T20_s"), values(whole, "T20_s"), rtol=1e-12)


def test_bands_without_absorption_are_left_out_with_a_finding(campaign):
    known = posterior(bands=bands_between("octave", 1000, 4000))
    found = predict_campaign(campaign, known, n_draws=2)
    assert found.bands.centres_hz.tolist() == [1000.0]
    assert Code.BAND_NOT_PREDICTED in {f.code for f in found.findings}
    with pytest.raises(InputError, match="other bands"):
        predict_campaign(campaign, posterior(bands=bands_between("octave", 125, 250)), n_draws=2)


def test_a_room_of_one_absorption_and_much_scattering_decays_as_eyring_says(campaign):
    """Low absorption in a diffuse room: 2 % by Kuttruff's correction, 3 % for 60,000 rays."""
    text = campaign.path.read_text().replace("scattering = 0.0", "scattering = 0.9")
    path = campaign.path.with_name("diffuse.toml")
    path.write_text(text)
    a = np.full((3, 2), 0.05)
    posterior = AbsorptionPosterior(NAMES, BANDS, a, a, a, np.zeros((2, 3, 3)))
    found = predict_campaign(read_campaign(path), posterior, n_draws=2)
    room, _ = read_room(campaign.room)
    scene = Scene(room, campaign.sources, campaign.receivers, np.array([[0, 0]]), campaign.air)
    np.testing.assert_allclose(
        values(found, "T30_s").mean(axis=0), scene_decay_s(scene, BANDS, a), rtol=0.05
    )


# ---------------------------------------------------------------- files and command


@pytest.mark.slow
def test_the_command_predicts_from_the_files_of_a_fit(tmp_path, monkeypatch, capsys):
    campaign = write_campaign(tmp_path / "campaign")
    fit, out = tmp_path / "fit", tmp_path / "out"
    assert run_command(monkeypatch, "identify", campaign, "--out", fit) == 0
    result = json.loads((fit / "result.json").read_text())
    reported = read_result(fit / "result.json")
    np.testing.assert_allclose(result["posterior"]["logit_mean"], logit(reported.absorption).T)
    # Gaussian intervals were made of the same variances, symmetric in logit absorption; where two
    # models disagree, variances reach as far as the side that reaches farther
    sd = np.sqrt(np.diagonal(reported.logit_covariance, axis1=1, axis2=2)).T
    kinds = np.array([result["materials"][name]["interval"] for name in reported.materials])
    inner = (reported.lower95 > 0.0) & (reported.upper95 < 1.0)
    middle = logit(reported.absorption)
    reach = np.maximum(logit(reported.upper95) - middle, middle - logit(reported.lower95))
    gaussian = inner & (kinds == "gaussian")
    assert np.count_nonzero(gaussian) >= 2
    np.testing.assert_allclose(reach[gaussian], (1.959964 * sd)[gaussian], rtol=1e-4)
    # what predictions draw from covers every interval, Gaussian or profile: a spread wrong by a
    # quarter, or a centre by as much, would leave three quarters of one
    draws = draw_absorption(reported, 4096, np.random.default_rng(1))
    low, high = np.quantile(draws, (0.025, 0.975), axis=0)
    shared = np.minimum(high, reported.upper95) - np.maximum(low, reported.lower95)
    assert {"gaussian", "profile"} <= set(kinds.flat)
    assert np.all(shared >= 0.77 * (reported.upper95 - reported.lower95))
    capsys.readouterr()
    arguments = ("predict", campaign, "--absorption", fit / "result.json", "--out", out)
    assert run_command(monkeypatch, *arguments, "--set", "carpet=0.5+-0.1") == 0
    shown = capsys.readouterr().out
    assert shown.startswith("With carpet=0.5+-0.1: T30 at mid frequencies")
    content = json.loads((out / "predicted.json").read_text())
    assert content["materials"]["carpet"]["absorption"] == [0.5, 0.5]
    assert [(p["source"], p["receiver"]) for p in content["pairs"]] == [
        ("LS1", "MP1"),
        ("LS1", "MP2"),
    ]
    for pair in content["pairs"]:
        for name, value in pair["parameters"].items():
            low, high = np.array(value["lower95"]), np.array(value["upper95"])
            assert np.all((low <= value["predicted"]) & (value["predicted"] <= high)), name
            assert (value["measured"][0] is None) == (name == "G_dB")
    with (out / "predicted.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 2 * 8 * 2
    first = content["pairs"][0]["parameters"][rows[0]["parameter"]]
    assert float(rows[0]["predicted"]) == pytest.approx(first["predicted"][0], abs=1e-4)
    assert len(list(out.glob("predicted_*.svg"))) == 2
    assert reported.prior_logit_sd is not None
    np.testing.assert_allclose(reported.prior_logit_sd, 1.5)
    np.testing.assert_allclose(reported.scattering, 0.0)
    # another room, where nothing was measured, with the materials of this one
    other = tmp_path / "other" / "campaign.toml"
    other.parent.mkdir()
    text = campaign.read_text()
    text = text[: text.index("[[measurements]]")].replace("[3.9, 3.1, 2.5]", "[5.1, 4.2, 2.8]")
    assert "5.1" in text
    other.write_text(text + "[identify]\nfrom_hz = 500\nto_hz = 1000\n")
    arguments = ("predict", other, "--absorption", fit / "result.json", "--out", tmp_path / "o")
    assert run_command(monkeypatch, *arguments) == 0
    there = json.loads((tmp_path / "o" / "predicted.json").read_text())
    assert [p["parameters"]["T20_s"]["measured"] for p in there["pairs"]] == [[None, None]] * 2
    assert there["mean"]["T20_s"]["predicted"][1] > content["mean"]["T20_s"]["predicted"][1]
    capsys.readouterr()
    # without pairs of other sources, and from the table of absorption alone
    arguments = ("predict", campaign, "--absorption", fit / "absorption.csv", "--out", out)
    assert run_command(monkeypatch, *arguments) == 2
    assert run_command(monkeypatch, *arguments, "--overwrite", "--pairs", "campaign") == 0
    again = json.loads((out / "predicted.json").read_text())
    assert again["changes"] == []
    assert run_command(monkeypatch, *arguments, "--overwrite", "--pairs", "some") == 2
    assert "all" in capsys.readouterr().err
