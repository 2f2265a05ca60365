"""The main job from end to end, on small campaigns whose truth is known and on measured rooms."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import roomfit.io.campaign
import roomfit.objective.energy
from roomfit._numba import at_most_threads
from roomfit.air import Air, attenuation_per_m, speed_of_sound_m_s
from roomfit.bands import bands_between
from roomfit.cache import json_text
from roomfit.commands import identify_to_folder
from roomfit.findings import About, Code, Finding
from roomfit.identification import combine, identify
from roomfit.io.campaign import input_files, read_campaign
from roomfit.io.inputs import identify_arguments, load_campaign
from roomfit.io.results import absorption_csv, result_content
from roomfit.results import Result
from roomfit.settings import Settings
from roomfit.synthetic.boxes import SyntheticBox, pressure_response
from small_campaign import (
    ABSORPTION,
    RATE_HZ,
    small_responses,
    write_campaign,
    write_wav,
)

SECOND_FILE = 'file = "LS1_MP2.wav"'
CARPET = "[materials.carpet]"
PARAMETERS = {"EDT_s", "T20_s", "T30_s", "C50_dB", "C80_dB", "D50_percent", "TS_ms"}


def answer_to(folder: Path, *changes: tuple[str, str]) -> Result:
    return identify(**load_campaign(write_campaign(folder, *changes)))


def codes(answer: Result) -> set[str]:
    return {finding.code for finding in answer.findings}


def assert_same_absorption(answer: Result, other: Result, tolerance: float) -> None:
    assert answer.materials == other.materials
    np.testing.assert_allclose(answer.absorption, other.absorption, rtol=0, atol=tolerance)


@pytest.fixture
def few_rays(monkeypatch):
    """Fewer rays than an answer deserves, where only what becomes of them is looked at."""
    monkeypatch.setattr(roomfit.io.campaign, "DEFAULTS", Settings(n_rays=4000))


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> Result:
    """The answer to the campaign as it stands."""
    return answer_to(tmp_path_factory.mktemp("plain"))


def test_the_mean_absorption_of_the_room_is_found(plain):
    """Two files of a box whose mean absorption is 0.23; two pairs cannot tell it any better."""
    areas = dict(zip(plain.materials, plain.areas_m2, strict=True))
    truth = sum(ABSORPTION[n] * a for n, a in areas.items()) / sum(areas.values())
    mean, lower, upper = plain.mean_absorption
    np.testing.assert_allclose(mean, truth, atol=0.08)
    assert np.all((lower < mean) & (mean < upper))


def test_a_first_answer_is_hardly_less_certain_and_says_what_was_not_looked_for(tmp_path, plain):
    arguments = load_campaign(write_campaign(tmp_path))
    arguments["settings"] = replace(arguments["settings"], quick=True)
    first = identify(**arguments)
    assert codes(first) - codes(plain) >= {Code.FIRST_ANSWER}
    assert first.evaluations < 0.7 * plain.evaluations
    width, full = (x.upper95 - x.lower95 for x in (first, plain))
    assert width.mean() < 1.5 * full.mean()
    # of the same data: the two differ by less than either may be wrong
    assert np.all(np.abs(first.absorption - plain.absorption) < 0.5 * np.maximum(width, full))
    assert set(np.ravel(first.interval_kinds)) <= {"gaussian", "profile", "none", "given"}


@pytest.mark.slow
@pytest.mark.parametrize("method", ["simplex", "annealing"])
def test_the_papers_methods_agree_with_least_squares_within_its_interval(tmp_path, plain, method):
    """Same squares, three ways down: what differs must be far smaller than the uncertainty."""
    one_band = ("to_hz = 1000", f'to_hz = 500\nmethod = "{method}"')
    answer = answer_to(tmp_path, one_band)
    assert answer.method == method
    assert answer.evaluations > 0
    width = (plain.upper95 - plain.lower95)[:, 0]
    apart = np.abs(answer.absorption[:, 0] - plain.absorption[:, 0])
    assert np.all(apart <= 0.25 * width + 0.002)


@pytest.mark.slow
def test_what_is_kept_for_validation_cannot_change_the_answer(tmp_path, few_rays):
    """Another file for the pair that is not fitted: the same numbers, and another comparison."""
    changes = ((SECOND_FILE, f'{SECOND_FILE}\nuse = "validate"'),)
    campaign = read_campaign(write_campaign(tmp_path, *changes))
    first = identify(**identify_arguments(campaign))
    # twice as quick a decay
    pressure = small_responses()["MP2"]
    write_wav(tmp_path / "LS1_MP2.wav", pressure * np.exp(-np.arange(pressure.size) / 400.0))
    second = identify(**identify_arguments(campaign))
    for name in ("absorption", "lower95", "upper95", "chi2_reduced"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    measured = [a.pairs[1].parameters["EDT_s"] for a in (first, second)]
    # a predicted decay ends where the measured one beside it does, which an EDT hardly sees
    np.testing.assert_allclose(measured[0].predicted, measured[1].predicted, rtol=1e-3)
    assert np.all(measured[0].measured > 1.2 * measured[1].measured)
    assert first.pairs[1].use == "validate"
    # the only other measurement is the fitted one
    fitted = first.pairs[0].parameters["EDT_s"].measured
    np.testing.assert_array_equal(measured[0].null, fitted)


@pytest.mark.slow
@pytest.mark.parametrize("level", ["per-source", "per-file"])
def test_a_louder_recording_gives_the_same_absorption(tmp_path, level):
    """All files 20 dB up: an unknown gain takes it; one file alone: only a gain per file does."""
    change = ('file = "LS1', f'level = "{level}"\nfile = "LS1')
    path = write_campaign(tmp_path, change)
    campaign = read_campaign(path)
    before = identify(**identify_arguments(campaign))
    louder = ["MP1", "MP2"] if level == "per-source" else ["MP2"]
    for name in louder:
        write_wav(tmp_path / f"LS1_{name}.wav", 10.0 * small_responses()[name])
    # float32 in the file rounds anew: 6e-8
    assert_same_absorption(before, identify(**identify_arguments(campaign)), 1e-4)


@pytest.mark.slow
def test_an_absolute_level_is_taken_at_its_word(tmp_path, plain):
    """The files hold pressure with a direct sound of 1/(4 pi r): knowing it costs nothing.

    6 dB less would mean more absorption; the direct sound's window then no longer fits.
    """
    change = ('file = "LS1', 'level = "absolute"\nfile = "LS1')
    campaign = read_campaign(write_campaign(tmp_path, change))
    reported = identify(**identify_arguments(campaign))
    np.testing.assert_allclose(reported.mean_absorption[0], plain.mean_absorption[0], atol=0.06)
    assert np.all(reported.chi2_reduced < 2.0)
    for name, pressure in small_responses().items():
        write_wav(tmp_path / f"LS1_{name}.wav", 0.5 * pressure)
    assert np.all(
        identify(**identify_arguments(campaign)).mean_absorption[0]
        > reported.mean_absorption[0] + 0.05
    )


@pytest.mark.slow
def test_latency_is_subtracted_exactly(tmp_path, plain):
    delayed = 40
    path = write_campaign(
        tmp_path, ('file = "LS1', f'latency_s = {delayed / RATE_HZ}\nfile = "LS1')
    )
    for name, pressure in small_responses().items():
        write_wav(tmp_path / f"LS1_{name}.wav", np.pad(pressure, (delayed, 0)))
    assert_same_absorption(plain, identify(**load_campaign(path)), 2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("time_zero", ["direct", "unknown"])
def test_a_file_without_a_clock_is_put_on_that_of_the_geometry(tmp_path, plain, time_zero):
    """The direct sound's onset is found within 3 samples, 13 cm at this low sampling rate."""
    path = write_campaign(tmp_path, ('file = "LS1', f'time_zero = "{time_zero}"\nfile = "LS1'))
    for name, pressure in small_responses().items():
        write_wav(tmp_path / f"LS1_{name}.wav", np.pad(pressure, (321, 0)))
    answer = identify(**load_campaign(path))
    np.testing.assert_allclose(answer.mean_absorption[0], plain.mean_absorption[0], atol=0.05)
    assert Code.TIME_ZERO_MISMATCH not in codes(answer)


@pytest.mark.slow
def test_an_absorption_that_is_given_stays_exactly(tmp_path, few_rays):
    """Also where it is specified for each band, at 0 and at 1."""
    answer = answer_to(
        tmp_path,
        (CARPET, f"{CARPET}\nabsorption = [0.4, 0.41]"),
        ("[materials.tiles]", "[materials.tiles]\nabsorption = 0.3"),
    )
    given = {"carpet": [0.4, 0.41], "tiles": [0.3, 0.3]}
    for name, values in given.items():
        i = answer.materials.index(name)
        for array in (answer.absorption, answer.lower95, answer.upper95):
            np.testing.assert_array_equal(array[i], values)
    walls = answer.materials.index("walls")
    np.testing.assert_allclose(answer.absorption[walls], ABSORPTION["walls"], atol=0.06)


@pytest.fixture(scope="module")
def combined(tmp_path_factory):
    """What the bands of a fit with a given carpet are combined from, but for the findings."""
    given = []

    def keep(*arguments):
        given.append(arguments)
        return combine(*arguments)

    specified = (CARPET, f"{CARPET}\nabsorption = 0.4")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(roomfit.io.campaign, "DEFAULTS", Settings(n_rays=4000))
        patch.setattr("roomfit.identification.combine", keep)
        answer_to(tmp_path_factory.mktemp("combined"), specified)
    evidence, _ = given[0]
    return lambda *findings: combine(evidence, findings)


VOIDS = (
    "decay-bent",
    "noise-gated",
    "displacement-detected",
    "levels-not-linear",
    "model-misfit-all-bands",
    "position-inconsistent",
    "recording-of-two-pairs",
    "recordings-late",
    "coordinates-scaled",
    "exchanged",
    "levels-apart",
    "reflection-delay-detected",
    "scattering-underestimated",
    "source-not-omnidirectional",
    "wall-position-mismatch",
)


@pytest.mark.parametrize("text", VOIDS)
def test_where_the_room_is_specified_wrong_only_what_is_held_is_identifiable(combined, text):
    """Whoever finds it; and the walls are not blamed for being inseparable."""
    sure, unsure = combined(), combined(Finding(Code(text), About(), "It is.", {}))
    held = np.array(unsure.materials) == "carpet"
    assert sure.identifiable[~held].any()
    assert not unsure.identifiable[~held].any()
    assert unsure.identifiable[held].all()
    assert Code.MATERIALS_NOT_SEPARABLE not in codes(unsure)
    np.testing.assert_array_equal(sure.absorption, unsure.absorption)


def test_no_other_finding_takes_anything_from_what_is_identifiable(combined):
    """All of them at once."""
    others = [
        Finding(c, About(), "It is.", {})
        for c in Code
        if not c.voids_identifiability and not c.voids_its_own
    ]
    np.testing.assert_array_equal(combined(*others).identifiable, combined().identifiable)


def test_a_fixed_absorption_that_is_contradicted_takes_its_own_material_with_it(combined):
    about = About(materials=["carpet"])
    doubted = combined(Finding(Code.FIXED_ABSORPTION_CONTRADICTED, about, "It is."))
    assert not doubted.identifiable.any()


def test_two_seeds_give_two_answers(tmp_path, monkeypatch):
    """Walls that scatter, so that rays count, and no random number but those of the trace."""
    found = []
    for seed in (1, 2):
        few = Settings(n_rays=2000, n_rays_beside_images=500)
        monkeypatch.setattr(roomfit.io.campaign, "DEFAULTS", few)
        rough = ("scattering = 0.0", "scattering = 0.5")
        one = ("to_hz = 1000", f'to_hz = 500\nmodel = "energy"\nseed = {seed}')
        found.append(answer_to(tmp_path / str(seed), rough, one))
    assert [answer.seed for answer in found] == [1, 2]
    assert np.all(found[0].absorption != found[1].absorption)
    np.testing.assert_allclose(found[0].absorption, found[1].absorption, atol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["least-squares", "simplex", "annealing"])
def test_nothing_left_to_fit_is_a_prediction(tmp_path, few_rays, method):
    given = [
        (f"[materials.{name}]", f"[materials.{name}]\nabsorption = {value}")
        for name, value in ABSORPTION.items()
    ]
    answer = answer_to(
        tmp_path,
        *given,
        ('file = "LS1', 'level = "absolute"\nfile = "LS1'),
        ("to_hz = 1000", f'to_hz = 1000\nmethod = "{method}"'),
    )
    for name, value in ABSORPTION.items():
        np.testing.assert_array_equal(answer.absorption[answer.materials.index(name)], value)
    t20 = answer.pairs[0].parameters["T20_s"]
    np.testing.assert_allclose(t20.predicted, t20.measured, rtol=0.15)


@pytest.mark.slow
def test_more_surfaces_of_one_material_change_nothing(tmp_path, plain):
    """The four walls named one by one instead of as a group."""
    one_by_one = "\n".join(f'{w} = "walls"' for w in ("west", "east", "south", "north"))
    answer = answer_to(tmp_path, ('walls = "walls"', one_by_one))
    assert_same_absorption(plain, answer, 1e-12)


def test_a_material_that_no_sound_meets_is_not_determined(tmp_path):
    """A niche behind a closed sheet would be such; here its data are none: 0 to 1, and said so."""
    from roomfit.objective.parameters import Block, Parameters
    from roomfit.uncertainty.gaussian import absorption_intervals

    names, one = ("met", "never met"), np.ones(2)
    # the broad default, and a prior that was stated, of which a misfit takes nothing away
    for mean, sd, low, high in (
        (np.log(0.15 / 0.85), 1.5, 0.0, 1.0),
        (0.0, 0.5, 1.0 / (1.0 + np.exp(0.979982)), 1.0 / (1.0 + np.exp(-0.979982))),
    ):
        block = Block(
            "absorption", names, "logit", 0.15 * one, one > 0, mean * one, sd * one, 0 * one, one
        )
        information = np.diag([1.0 / sd**2 + 4000.0, 1.0 / sd**2])
        vector = np.array([-1.0, mean])
        found = absorption_intervals(Parameters((block,)), vector, information, 1.9)
        assert (found.lower95[1], found.upper95[1]) == pytest.approx((low, high), abs=1e-5)
        assert found.upper95[0] - found.lower95[0] < 0.05
        assert found.identifiable.tolist() == [True, False]


@pytest.mark.slow
def test_every_evaluation_that_was_made_is_counted(tmp_path, few_rays, monkeypatch):
    """In trials of scattering, first fits, rounds and profiles: a response alone is predicted."""
    original, calls = roomfit.objective.energy.EnergyTerm.predict, []

    def counting(term, values):
        calls.append(term)
        return original(term, values)

    monkeypatch.setattr("roomfit.objective.energy.EnergyTerm.predict", counting)
    with at_most_threads(1):  # a method that is patched here counts nothing in forked copies
        answer = identify(**load_campaign(write_campaign(tmp_path, ("scattering = 0.0", ""))))
    assert answer.evaluations == len(calls) > 100


@pytest.mark.slow
def test_result_and_table_keep_the_contract(tmp_path, few_rays):
    campaign = write_campaign(
        tmp_path / "c",
        (SECOND_FILE, f'{SECOND_FILE}\nuse = "validate"'),
        ("scattering = 0.0", ""),
    )
    answer = identify_to_folder(campaign, tmp_path / "out")
    text = (tmp_path / "out" / "result.json").read_text()
    result = json.loads(text, parse_constant=_refuse)
    assert result["format"] == "roomfit-result"
    assert result["format_version"] == 1
    assert result["bands_hz"] == [500, 1000]
    assert set(result) == {
        *("format", "format_version", "bands_hz", "materials", "combinations", "pairs"),
        *("findings", "fit", "geometry", "posterior", "settings", "trace", "provenance", "plan"),
        *("sd_without", "mean_sd_without", "files_sha256", "content_sha256"),
    }
    assert result["trace"].pop("duration_s") > 0.1
    # rays as stated, the radius as it follows a small room
    used = {"n_rays": 4000, "receiver_radius_m": 0.5, "scattering_groups": 1}
    assert result["trace"] == used
    for material in result["materials"].values():
        for lower, value, upper in zip(
            material["lower95"], material["absorption"], material["upper95"], strict=True
        ):
            assert 0.0 <= lower <= value <= upper <= 1.0
        assert len(material["absorption"]) == len(material["identifiable"]) == 2
        assert all(isinstance(reported, bool) for reported in material["identifiable"])
    # 3.9 * 3.1 of carpet
    assert result["materials"]["carpet"]["area_m2"] == pytest.approx(12.09)
    for combination in result["combinations"]:
        assert sum(combination["weights"].values()) == pytest.approx(1.0, abs=1e-5)
        assert combination["lower95"] <= combination["absorption"] <= combination["upper95"]
    assert [p["use"] for p in result["pairs"]] == ["fit", "validate"]
    for pair in result["pairs"]:
        assert set(pair["parameters"]) == PARAMETERS
        for row in pair["parameters"].values():
            assert all(len(values) == 2 for values in row.values())
            assert {"measured", "predicted", "jnd"} <= set(row)
    t20 = result["pairs"][0]["parameters"]["T20_s"]
    signed = (t20["predicted"][0] / t20["measured"][0] - 1.0) / 0.05
    assert t20["jnd"][0] == pytest.approx(signed)
    assert "scattering-assumed" in {f["code"] for f in result["findings"]}
    fit = result["fit"]
    assert fit["method"] == "least-squares"
    assert fit["seed"] == 1
    assert len(fit["phi"]) == 2
    assert set(result["provenance"]["inputs_sha256"]) == {
        *("campaign.toml", "LS1_MP1.wav", "LS1_MP2.wav")
    }
    assert _nulls_outside(result, "pairs") == ["fit.certified"]

    with (tmp_path / "out" / "absorption.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    columns = ["material", "band_hz", "absorption", "lower95", "upper95", "identifiable"]
    assert list(rows[0]) == columns
    assert len(rows) == len(answer.materials) * 2
    assert {row["identifiable"] for row in rows} <= {"true", "false"}


def _refuse(constant: str) -> None:
    raise AssertionError(f"{constant} is no JSON")


def _nulls_outside(value: object, key: str, place: str = "") -> list[str]:
    if isinstance(value, dict):
        parts = [(f"{place}.{k}".lstrip("."), v) for k, v in value.items() if k != key]
    elif isinstance(value, list):
        parts = [(f"{place}[{i}]", v) for i, v in enumerate(value)]
    else:
        return [place] if value is None else []
    return [found for name, part in parts for found in _nulls_outside(part, key, name)]


def test_any_evidence_of_a_finding_can_be_written(tmp_path, plain):
    """Numbers as numpy makes them, also such as JSON does not know."""
    evidence = {"count": np.int64(3), "ratio": np.nan, "places": (np.array([1.0, 2.5]), "floor")}
    doubted = replace(plain, findings=(Finding(Code.DC_OFFSET, About(), "A doubt.", evidence),))
    text = json_text(result_content(doubted, ()))
    (finding,) = json.loads(text)["findings"]
    assert finding["evidence"] == {"count": 3, "ratio": "nan", "places": [[1.0, 2.5], "floor"]}


def test_equal_names_in_two_folders_are_two_inputs(tmp_path, plain):
    """Measurements are often called alike, a folder each."""
    campaign = write_campaign(
        tmp_path, ("LS1_MP1.wav", "first/ir.wav"), ("LS1_MP2.wav", "second/ir.wav")
    )
    for folder, name in (("first", "MP1"), ("second", "MP2")):
        (tmp_path / folder).mkdir()
        (tmp_path / f"LS1_{name}.wav").rename(tmp_path / folder / "ir.wav")
    read = read_campaign(campaign)
    content = result_content(plain, input_files(read))
    digests = content["provenance"]["inputs_sha256"]
    assert set(digests) == {"campaign.toml", "first/ir.wav", "second/ir.wav"}
    assert len(set(digests.values())) == 3


def test_the_same_seed_gives_the_same_bytes(tmp_path, few_rays):
    """With scattering, so that rays are drawn; only the seconds may differ."""
    path = write_campaign(tmp_path, ("scattering = 0.0", "scattering = 0.2"))
    campaign = read_campaign(path)
    answers = [identify(**identify_arguments(campaign)), identify(**identify_arguments(campaign))]
    assert absorption_csv(answers[0]) == absorption_csv(answers[1])
    contents = [result_content(a, input_files(campaign)) for a in answers]
    for content in contents:
        del content["fit"]["seconds"]
    assert json_text(contents[0]) == json_text(contents[1])


@pytest.mark.slow
def test_a_file_that_drowns_in_one_band_is_left_out_of_that_band_only(tmp_path, few_rays):
    """A loud hum-like noise around 500 Hz in one of two files with a gain of its own."""
    campaign = write_campaign(tmp_path, ('file = "LS1', 'level = "per-file"\nfile = "LS1'))
    pressure = small_responses()["MP1"]
    rng = np.random.default_rng(3)
    spectrum = np.fft.rfft(rng.standard_normal(pressure.size))
    frequency = np.fft.rfftfreq(pressure.size, 1 / RATE_HZ)
    hum = np.fft.irfft(spectrum * ((frequency > 420) & (frequency < 600)), pressure.size)
    write_wav(tmp_path / "LS1_MP1.wav", pressure + 0.3 * np.abs(pressure).max() * hum)
    answer = identify(**load_campaign(campaign))
    left_out = [f for f in answer.findings if f.code == Code.RECORDING_BELOW_NOISE]
    assert [f.evidence["bands_hz"] for f in left_out] == [[500.0]]
    assert "LS1_MP1.wav" in left_out[0].sentence
    assert np.all(np.isfinite(answer.absorption))


def test_a_hall_is_read_although_silence_comes_before_its_first_reflection(tmp_path, few_rays):
    """A box of 40 x 25 x 15 m heard 2 m from the source: nearly all energy in the first 10 ms.

    Neither is that a recorded excitation, nor is the gap of 30 ms the end of the decay; and where
    the file holds no noise, windows of the gap hold no energy at all.
    """
    bands, air = bands_between("octave", 250, 2000), Air()
    truth = SyntheticBox(
        (40.0, 25.0, 15.0),
        bands.centres_hz,
        np.full((6, len(bands)), 0.4),
        attenuation_per_m(air, bands),
        speed_of_sound_m_s(air),
    )
    path = write_campaign(
        tmp_path,
        ("[3.9, 3.1, 2.5]", "[40.0, 25.0, 15.0]"),
        ("[1.0, 1.2, 1.1]", "[20.0, 12.0, 7.0]"),
        ("[2.9, 2.2, 1.3]", "[21.9, 12.2, 7.3]"),
        ("[3.1, 0.9, 1.6]", "[23.1, 12.9, 7.6]"),
    )
    source, flat = np.array([20.0, 12.0, 7.0]), np.zeros(len(bands))
    for name, at in (("MP1", (21.9, 12.2, 7.3)), ("MP2", (23.1, 12.9, 7.6))):
        pressure = pressure_response(truth, source, np.array(at), 1.2, RATE_HZ, flat)
        write_wav(tmp_path / f"LS1_{name}.wav", pressure)
    answer = identify(**load_campaign(path))
    # a decay of few reflections near a source tells the mean to a tenth or so
    np.testing.assert_allclose(answer.mean_absorption[0], 0.4, atol=0.1)


@pytest.mark.slow
def test_intervals_of_energies_alone_allow_for_what_windows_share(tmp_path, few_rays, monkeypatch):
    """The noise of the rays and the air move the answer as a whole: intervals only widen."""
    reported = ("[identify]", '[identify]\nmodel = "energy"')
    allowing = answer_to(tmp_path / "allowing", reported)
    monkeypatch.setattr(
        "roomfit.inversion.solve.shared_error_covariance", lambda *_: lambda _n, _p, fit: fit
    )
    sure = answer_to(tmp_path / "sure", reported)
    np.testing.assert_array_equal(allowing.absorption, sure.absorption)
    more, less = allowing.upper95 - allowing.lower95, sure.upper95 - sure.lower95
    assert np.all(more >= less - 1e-9)
    assert np.any(more > 1.01 * less)


@pytest.mark.slow
def test_smoothness_over_bands_keeps_what_is_held_and_tied(tmp_path, few_rays):
    """Absorption held at 0 and 1 stays; tied materials stay equal; nothing is lost on the way."""
    reported = [
        ("[identify]", "[identify]\nsmoothness_per_octave = 0.5"),
        (CARPET, f"{CARPET}\nabsorption = [0.0, 1.0]"),
        ("[materials.tiles]", '[materials.tiles]\nsame_absorption_as = "walls"'),
    ]
    answer = answer_to(tmp_path, *reported)
    row = {name: i for i, name in enumerate(answer.materials)}
    np.testing.assert_array_equal(answer.absorption[row["carpet"]], [0.0, 1.0])
    for array in (answer.absorption, answer.lower95, answer.upper95):
        assert np.all(np.isfinite(array))
        np.testing.assert_array_equal(array[row["tiles"]], array[row["walls"]])
    assert np.all(answer.upper95[row["walls"]] > answer.lower95[row["walls"]])


def test_what_voids_the_answer_is_said_before_the_minutes_that_a_fit_may_last(monkeypatch, caplog):
    """Of two findings the one that calls nothing identifiable; the other stands in the answer."""
    void = Finding(Code.LEVELS_NOT_LINEAR, About(bands_hz=[500]), "Levels are bent.")
    other = Finding(Code.FIRST_ANSWER, About(), "It is a first one.")
    assert void.code.voids_identifiability and not other.code.voids_identifiability
    monkeypatch.setattr("roomfit.identification.examine", lambda *_: (other, void))

    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("roomfit.identification.complete_priors", stop)
    scene = roomfit.scene_of(
        roomfit.shoebox_room((6.0, 5.0, 3.0), "plaster"), {"S": (1.5, 1.2, 1.5)}, {"R": (4, 3.5, 1)}
    )
    measured = roomfit.MeasuredValues("S", "R", [1000.0], {"T20_s": [0.8]})
    with pytest.raises(KeyboardInterrupt):
        roomfit.identify(scene, [measured], bands=roomfit.bands_between("octave", 1000, 1000))
    said = [r.getMessage() for r in caplog.records if r.levelname == "WARNING"]
    assert said[0].endswith("Levels are bent.") and "stop it with Ctrl-C" in said[1]
    assert len(said) == 2
