"""Campaign files: what they may hold, and what is said when they hold something else."""

from __future__ import annotations

import re

import numpy as np
import pytest

from roomfit.base.errors import InputError
from roomfit.files.campaign import read_campaign
from roomfit.files.inputs import (
    identify_arguments,
    material_priors,
    project_details,
)
from roomfit.materials.catalogue import catalogue_prior
from roomfit.materials.priors import sampling_scattering
from small_campaign import small_responses, write_wav

GOOD = """
[room]
shoebox = [5.0, 4.0, 3.0]
[room.materials]
floor = "carpet"
[materials.carpet]
scattering = 0.2
[sources.LS1]
position = [1.0, 1.0, 1.0]
[receivers.MP1]
position = [3.0, 2.0, 1.5]
position_sd = 0.01
[[measurements]]
source = "LS1"
receiver = "MP1"
file = "a.wav"
"""


def campaign_from(tmp_path, text: str):
    path = tmp_path / "campaign.toml"
    path.write_text(text)
    return read_campaign(path)


def test_a_good_campaign_is_read_with_its_defaults(tmp_path):
    campaign = campaign_from(tmp_path, GOOD)
    assert campaign.bands.centres_hz.tolist() == [125, 250, 500, 1000, 2000, 4000]
    assert campaign.measurements[0].level == "per-source"
    assert campaign.measurements[0].response.path == tmp_path / "a.wav"
    assert campaign.receivers[0].position_sd_m == 0.01
    (carpet,) = material_priors(campaign, ("carpet",))
    assert sampling_scattering(carpet) == pytest.approx(0.2)
    assert carpet.known is None


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[room]", "[room", "not valid TOML"),
        ("scattering = 0.2", "scatering = 0.2", r"unknown key(?s:.*)materials.carpet"),
        ("scattering = 0.2", "scattering = 1.2", r"materials.carpet.scattering"),
        ("position = [1.0, 1.0, 1.0]", "position = [1.0, 1.0]", "sources.LS1.position"),
        ('source = "LS1"', 'source = "LS2"', r"not defined(?s:.*)did you mean 'LS1'"),
        ('receiver = "MP1"', "", "without a receiver"),
        ('file = "a.wav"', "", "exactly one kind of data"),
        ('file = "a.wav"', 'file = "a.wav"\nspectrum = "a.npz"', "exactly one kind of data"),
        ('file = "a.wav"', 'file = "a.wav"\nuse = "validate"', "none is left to fit"),
        ("shoebox = [5.0, 4.0, 3.0]", "", r"exactly one description(?s:.*)none"),
        ("shoebox = [5.0, 4.0, 3.0]", 'shoebox = [5.0, 4.0, 3.0]\nfile = "r.obj"', "exactly one"),
        ("[room]", "[identify]\nfrom_hz = 900\nto_hz = 300\n[room]", "at most to_hz"),
        ("[room]", "[identify]\nbands = [120, 240]\n[room]", "not a centre"),
        ("[room]", "[identify]\nmethod = 'posterior'\n[room]", r"'auto', 'simplex'"),
        ("[room]", "[identify]\nsmoothness_per_octave = 0.5\n[room]", r"unknown key"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_with_its_place(tmp_path, old, new, words):
    assert old in GOOD
    with pytest.raises(InputError, match=words):
        campaign_from(tmp_path, GOOD.replace(old, new, 1))


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("bounds = [0.9, 0.2]", r"lower bound is not below the upper(?s:.*)carpet"),
        ("absorption = [0.1, 0.2]", r"one value per band(?s:.*)6 values"),
        ("prior = {mean = 0.3, sd = 0.0}", r"prior.sd(?s:.*)what is known is fixed"),
        ("scattering = {centres_hz = [0, -5], values = [0.1, 0.2]}", r"centres_hz\[1\]"),
        ("prior = {mean = 0.3, sd = 0.1}\nbounds = [0.4, 0.9]", "outside of its bounds"),
        ("absorption = 0.3\nbounds = [0.4, 0.9]", "outside of its own bounds"),
        ("scattering = {centres_hz = [125, 250], values = [0.1]}", "as many values"),
        ('prior = "carpt"', "materials.carpet.prior"),
        ('same_absorption_as = "brick"', r"does not have(?s:.*)brick"),
    ],
)
def test_what_is_specified_of_a_material_is_checked(tmp_path, line, words):
    text = GOOD.replace("scattering = 0.2", line)
    with pytest.raises(InputError, match=words):
        material_priors(campaign_from(tmp_path, text), ("carpet", "other"))


NAMED = GOOD + (
    '[products.p]\n[loudspeakers.l]\n[groups.g]\nmembers = ["*"]\nsd = 0.1\n'
    '[[states]]\nname = "s"\nmaterials = {north = "m"}\n'
)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"carpet"\n', '"car\\u001bpet"\n'),
        ("[sources.LS1]", '[sources."LS\\u00851"]'),
        ("[receivers.MP1]", '[receivers."MP\\u202e1"]'),
        ("[groups.g]", '[groups."\\t"]'),
        ('name = "s"', 'name = "\\u2028"'),
        ('north = "m"', 'north = "\\u007f"'),
    ],
)
def test_names_with_control_characters_are_refused(tmp_path, old, new):
    assert NAMED.count(old) == 1
    with pytest.raises(InputError, match=r"has a control character(?s:.*)U\+") as refusal:
        campaign_from(tmp_path, NAMED.replace(old, new))
    assert str(refusal.value).isascii()


@pytest.mark.parametrize("spelled", ["./a.wav", "../{folder}/a.wav", "{path}", "link.wav"])
def test_one_file_by_two_spellings_is_one_file(tmp_path, spelled):
    (tmp_path / "a.wav").write_bytes(b"x")
    (tmp_path / "link.wav").symlink_to("a.wav")
    other = spelled.format(folder=tmp_path.name, path=tmp_path / "a.wav")
    second = GOOD[GOOD.index("[[measurements]]") :].replace("MP1", "MP2").replace("a.wav", other)
    third = "channel = 0\n[receivers.MP2]\nposition = [3.0, 2.5, 1.5]\n"
    with pytest.raises(InputError, match="two pairs have the same response"):
        campaign_from(tmp_path, GOOD + second + third)


def test_a_prior_of_absorption_becomes_one_of_its_logit(tmp_path):
    text = GOOD.replace("scattering = 0.2", "prior = {mean = 0.5, sd = 0.05}")
    (carpet,) = material_priors(campaign_from(tmp_path, text), ("carpet",))
    np.testing.assert_allclose(carpet.prior_logit_mean, 0.0, atol=1e-12)
    # the slope of the logit at one half is 4
    np.testing.assert_allclose(carpet.prior_logit_sd, 0.2)
    assert carpet.specified


PANELS = GOOD.replace("scattering = 0.2", 'product = "panel"\nscattering = 0.2') + (
    '[materials.wall]\nproduct = "panel"\n[products.panel]\n'
)


def test_materials_of_a_product_have_the_prior_that_is_stated_once(tmp_path):
    lines = "sd = 0.2\nprior = {mean = 0.5, sd = 0.05}\nbounds = [0.0, 0.9]\n"
    campaign = campaign_from(tmp_path, PANELS + lines)
    carpet, wall, other = material_priors(campaign, ("carpet", "wall", "other"))
    for own in (carpet, wall):
        assert (own.product, own.product_sd, own.upper, own.specified) == ("panel", 0.2, 0.9, True)
        np.testing.assert_array_equal(own.prior_logit_sd, carpet.prior_logit_sd)
    assert sampling_scattering(carpet) == pytest.approx(0.2)
    assert other.product is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("[products.panel]", "[products.panels]"), r"not defined(?s:.*)did you mean 'panels'"),
        (("[products.panel]", ""), r"not defined(?s:.*)add \[products.panel\]"),
        (("[products.panel]", "[products.panel]\nsd = 0.0"), r"products.panel.sd"),
        (("[products.panel]", "[products.panel]\nspread = 0.3"), "unknown key"),
        (("scattering = 0.2", "prior = {mean = 0.3, sd = 0.1}"), "prior of its own"),
        (("scattering = 0.2", "bounds = [0.0, 0.5]"), "bounds of its own"),
        (("scattering = 0.2", 'same_absorption_as = "wall"'), "same_absorption_as of its own"),
    ],
)
def test_what_is_specified_of_a_product_is_checked(tmp_path, change, words):
    with pytest.raises(InputError, match=words):
        campaign_from(tmp_path, PANELS.replace(*change))


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('[[states]]\nname = ""\nmaterials = {north = "x"}', r"states\[1\].name(?s:.*)at least 1 "),
        (
            '[[states]]\nname = "a"\nmaterials = {}',
            r"states\[1\].materials(?s:.*)at least 1 item\n",
        ),
        (
            '[[states]]\nname = "a"\nmaterials = {north = "x"}\n' * 2,
            "two states have the same name",
        ),
        ('[states.a]\nmaterials = {north = "x"}', r"states\n(?s:.*)a valid list"),
        ("[groups.g]\nmembers = []\nsd = 0.1", r"groups.g.members(?s:.*)at least 1 item\n"),
        (
            '[groups.g]\nmembers = ["*"]\nsd = "x"',
            r"groups.g.sd(?s:.*)number, or a valid list\n",
        ),
        ('[groups.""]\nmembers = ["*"]\nsd = 0.1', r"group without a name(?s:.*)toml, \[groups\]"),
        ('[products.""]\nsd = 0.1', r"product without a name(?s:.*)campaign.toml, \[products\]"),
    ],
)
def test_what_is_wrong_with_states_and_groups_is_reported_in_words(tmp_path, line, words):
    with pytest.raises(InputError, match=words) as refusal:
        campaign_from(tmp_path, f"{GOOD}\n{line}\n")
    assert not re.search("String|Dictionary|validation|instance", str(refusal.value))


# What the report says of itself.


def details(campaign):
    return project_details(campaign.project, campaign.path.parent)


def with_project(tmp_path, keys: str):
    return campaign_from(tmp_path, f"[project]\n{keys}\n{GOOD}")


def test_a_project_is_read_as_the_report_takes_it(tmp_path):
    (tmp_path / "logo.png").write_bytes(b"\x89PNG\r\n\x1a\n123")
    keys = 'title = "Hall"\nclient = "City"\ndate = 2026-11-22\ninstruments = ["A", "B"]\n'
    found = details(with_project(tmp_path, keys + 'logo = "logo.png"\nlanguage = "de"'))
    assert found.pop("logo") == "data:image/png;base64,iVBORw0KGgoxMjM="
    assert found == {
        "title": "Hall", "client": "City", "date": "2026-11-22", "instruments": "A, B",
        "language": "de",
    }  # fmt: skip
    assert details(campaign_from(tmp_path, GOOD)) == {"language": "en"}


# What is said once: defaults of measurements, recordings by their names.


PATTERN = """
recordings = "{source}_{receiver}.wav"
[room]
shoebox = [6, 5, 3]
[defaults]
latency_s = 0.0008
level = "per-file"
[sources.LS_1]
position = [1, 1, 1]
[receivers.MP1]
position = [4, 3, 1]
[receivers.MP2]
position = [4, 2, 1]
"""


def test_recordings_are_found_by_their_names_and_have_the_defaults(tmp_path):
    """Names hold separators themselves; a pair without a file is no measurement."""
    for name in ("LS_1_MP1.wav", "LS_1_MP2.wav", "notes.txt"):
        (tmp_path / name).touch()
    campaign = campaign_from(tmp_path, PATTERN)
    assert [(m.source, m.receiver, m.response.path.name) for m in campaign.measurements] == [
        ("LS_1", "MP1", "LS_1_MP1.wav"),
        ("LS_1", "MP2", "LS_1_MP2.wav"),
    ]
    assert {(m.response.latency_s, m.level, m.use) for m in campaign.measurements} == {
        (0.0008, "per-file", "fit")
    }
    assert campaign.findings == ()


def test_what_a_measurement_says_itself_stands_before_defaults_and_patterns(tmp_path):
    for name in ("LS_1_MP1.wav", "LS_1_MP2.wav"):
        (tmp_path / name).touch()
    own = """[[measurements]]
source = "LS_1"
receiver = "MP2"
file = "./LS_1_MP2.wav"
latency_s = 0.0
use = "validate"
"""
    campaign = campaign_from(tmp_path, PATTERN + own)
    assert [(m.receiver, m.use, m.response.latency_s) for m in campaign.measurements] == [
        ("MP2", "validate", 0.0),
        ("MP1", "fit", 0.0008),
    ]


def test_recordings_of_unknown_names_are_reported_and_none_at_all_refused(tmp_path):
    (tmp_path / "LS_1_MP1.wav").touch()
    (tmp_path / "LS_1_MP7.wav").touch()
    (finding,) = campaign_from(tmp_path, PATTERN).findings
    assert finding.evidence["files"] == ["LS_1_MP7.wav"]
    (tmp_path / "LS_1_MP1.wav").unlink()
    with pytest.raises(InputError, match="LS_1_MP7") as caught:
        campaign_from(tmp_path, PATTERN)
    assert "receivers MP1, MP2" in str(caught.value.needed)


# Absorption and priors at frequencies of their own, and bands of the command line.


def priors_between(tmp_path, line: str, between_hz=None):
    campaign = campaign_from(
        tmp_path,
        PATTERN.replace("[room]", '[room]\nmaterials = {floor = "carpet"}')
        + f"[materials.carpet]\n{line}\n[identify]\nfrom_hz = 250\nto_hz = 1000\n",
    )
    return campaign, identify_arguments(campaign, between_hz)


@pytest.fixture
def decays(tmp_path):
    for name in ("LS_1_MP1.wav", "LS_1_MP2.wav"):
        write_wav(tmp_path / name, small_responses()["MP1"])


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("absorption = {centres_hz = [125, 500, 2000], values = [0.1, 0.3, 0.5]}", [0.2, 0.3, 0.4]),
        ('absorption = "carpet-heavy-on-concrete"', None),
        ("absorption = [0.2, 0.3, 0.4]", [0.2, 0.3, 0.4]),
    ],
)
@pytest.mark.usefixtures("decays")
def test_known_absorption_may_stand_at_any_frequencies(tmp_path, line, expected):
    """Halfway in octaves is halfway in value; an entry of the catalogue is taken at its mean."""
    campaign, arguments = priors_between(tmp_path, line)
    known = next(k.known for k in arguments["materials"] if k.name == "carpet")
    if expected is None:
        expected, _ = catalogue_prior("carpet-heavy-on-concrete", campaign.bands)
    np.testing.assert_allclose(known, expected, rtol=1e-12)


@pytest.mark.usefixtures("decays")
def test_a_prior_at_frequencies_of_its_own_is_that_of_the_bands(tmp_path):
    line = "prior = {centres_hz = [125, 500, 2000], mean = [0.1, 0.3, 0.5], sd = 0.05}"
    same = "prior = {mean = [0.2, 0.3, 0.4], sd = 0.05}"
    found, expected = (
        next(k for k in priors_between(tmp_path, own)[1]["materials"] if k.name == "carpet")
        for own in (line, same)
    )
    np.testing.assert_allclose(found.prior_logit_mean, expected.prior_logit_mean, rtol=1e-12)
    np.testing.assert_allclose(found.prior_logit_sd, expected.prior_logit_sd, rtol=1e-12)


@pytest.mark.usefixtures("decays")
def test_bands_of_the_command_line_keep_the_values_of_the_campaign_s(tmp_path):
    _, arguments = priors_between(tmp_path, "absorption = [0.2, 0.3, 0.4]", (500, 1000))
    assert arguments["bands"].centres_hz.tolist() == [500.0, 1000.0]
    carpet = next(k for k in arguments["materials"] if k.name == "carpet")
    assert carpet.known.tolist() == [0.3, 0.4]
    with pytest.raises(InputError, match="one value per band"):
        priors_between(tmp_path, "absorption = [0.2, 0.3, 0.4]", (500, 2000))
    with pytest.raises(InputError, match="centres"):
        priors_between(tmp_path, "absorption = {centres_hz = [500], values = [0.1, 0.2]}")
