"""Every word that a client sees is in the table of the language; all else are names and numbers."""

from __future__ import annotations

import re
import tomllib
import zipfile
from html import unescape
from importlib.resources import files

import pytest

from report_cases import answer_of, finding, scene_of
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.cli.export import export_result
from roomfit.report.answer import report_html
from roomfit.report.doubts import serious_lines
from roomfit.report.wording import translator, translator_by
from small_campaign import run_command

TABLES = {
    language: tomllib.loads(
        files("roomfit.report").joinpath(f"templates/{language}.toml").read_text(encoding="utf-8")
    )
    for language in ("de", "fr")
}
every_language = pytest.mark.parametrize("language", TABLES)
HOLE = r"{\w+}"
# what is left of an entry when it is read backwards: what was put into it
# by lines, as drawings hold them
BACK = {
    language: {
        line: " ".join(re.findall(HOLE, line))
        for text in table.values()
        for line in (text, *text.split("\n"))
    }
    for language, table in TABLES.items()
}
UNITS = re.compile(
    r"\b(\d+k|Hz|kHz|k|s|ms|m|dB|m²|m³|kPa|C|JND|T20|T30|EDT|C50|C80|D50|TS|G|STI|x|y|z|L?M?H?)\b"
    r"|φ|\N{GREEK SMALL LETTER ALPHA}"
)
CAMPAIGN = """
[project]
title = "Musiksaal"
client = "Stadtschule"
author = "A. Nemo"
instruments = ["Mikrofon"]
language = "LANGUAGE"
[room]
shoebox = [8.0, 6.0, 3.0]
[room.materials]
floor = "floor"
ceiling = "ceiling"
west = "walls"
east = "walls"
south = "walls"
north = "walls"
[materials.floor]
prior = { mean = [0.1, 0.1], sd = [0.03, 0.03] }
[materials.ceiling]
prior = { mean = [0.1, 0.1], sd = [0.03, 0.03] }
[materials.walls]
prior = { mean = [0.1, 0.1], sd = [0.03, 0.03] }
[reverberation]
file = "t30.csv"
"""
TREATMENT = """
[surfaces.ceiling]
[products.panel]
catalogue = "mineral-wool-50-mm"
[[targets]]
parameter = "T30_s"
at_most = 0.8
bands_hz = [500, 1000]
"""
SENTENCES = (
    "a and b together 0.110 ± 0.005; their difference is not in the data.",
    "a, b and oak and ash together 0.2 ± 0.1; how it is shared among them is not in the data.",
    "the sum of a and b is not in the data; of a, b and oak and ash only one mean is in the data.",
    "a and b together 0.2 ± 0.1; of a, b and oak and ash only 2 means are in the data; a is not in"
    " the data.",
    "the difference of a and oak and ash is not in the data; a and b are not in the data.",
    "Predicted with a. Measured values beside it are those of the room as it was measured. At 95 %"
    " the mean of T30 falls at 125 Hz, has no determined direction at 250 Hz; of G rises at 1 kHz.",
    "T30 at most 0.6 s (mean of 500, 1000 Hz), a",
    "STI at least 0.6",
    "a stands 1.20 m from b (oak and ash), the nearest surface, and 0.90 m above the lowest point"
    " of the room.",
    "a is predicted as 0.50 s; measured 0.62 s at mid frequencies.",
    "error of predicted D50, mean of the fitted measurements; by the mean of the others 3.2 points",
)
NAMES = (
    "Musiksaal",
    "Stadtschule",
    "A. Nemo",
    "Mikrofon",
    "floor",
    "ceiling",
    "walls",
    "panel",
    *("Eyring", "Sabine", "Arau-Puchades", "Fitzroy", "identify", "roomfit"),
    "Vorhang",
)


def unknown(page, language, *names):
    """Return the texts of a page of which a word is neither in the table nor one of the names."""
    body = re.sub(r"<style.*?</style>", "", page, flags=re.DOTALL)
    left, back = set(), translator_by(BACK[language], names)
    for text in (
        unescape(x).strip().removeprefix("\N{EN DASH} ") for x in re.findall(r">([^<]+)<", body)
    ):
        said = back(text)
        for name in sorted(names, key=len, reverse=True):
            said = said.replace(name, "")
        if re.search(r"[^\W\d_]", UNITS.sub("", said)):
            left.add(text)
    return left


@every_language
def test_tables_have_the_same_keys_and_entries_the_holes_of_their_keys(language):
    table = TABLES[language]
    assert table.keys() == TABLES["de"].keys()
    for english, text in table.items():
        assert sorted(re.findall(HOLE, english)) == sorted(re.findall(HOLE, text)), english


def test_french_signs_have_a_space_before_them_that_does_not_break():
    for text in TABLES["fr"].values():
        assert not re.search(r"[^\N{NO-BREAK SPACE}][:;?!%»]|«[^\N{NO-BREAK SPACE}]", text), text


@pytest.fixture(scope="module", params=TABLES)
def made(request, tmp_path_factory):
    """The pages of a campaign, and their language."""
    folder, language = tmp_path_factory.mktemp("hall"), request.param
    (folder / "t30.csv").write_text("place,500,1000\na,1.1,1.1\nb,1.2,1.1\n")
    (folder / "campaign.toml").write_text(CAMPAIGN.replace("LANGUAGE", language))
    (folder / "treatment.toml").write_text(TREATMENT)
    with pytest.MonkeyPatch.context() as patch:
        files_ = [folder / "campaign.toml", folder / "treatment.toml"]
        variant = ("--set", "Vorhang|walls=curtain", "--set", "Vorhang|floor=carpet")
        assert (
            run_command(patch, "treat", *files_, *variant, "--png", "--out", folder / "treat") == 0
        )
        change = ("--set", "floor=carpet-on-underlay", *variant)
        assert run_command(patch, "predict", files_[0], *change, "--out", folder / "predict") == 0
        assert run_command(patch, "reverberation", files_[0], "--out", folder / "times") == 0
    return folder, language


@pytest.mark.parametrize(
    "page",
    [
        "treat/client.html",
        "treat/treatment.html",
        "predict/predicted.html",
        "times/reverberation.html",
    ],
)
def test_no_word_of_a_clients_page_is_missing_in_its_language(made, page):
    folder, language = made
    text = (folder / page).read_text(encoding="utf-8")
    assert f'<html lang="{language}">' in text
    codes = {code.value for code in Code}
    names = (*NAMES, "Eyring", "carpet-on-underlay", "predicted.csv", *codes)
    assert unknown(text, language, *names) == set()


@every_language
def test_no_word_of_a_report_is_missing_in_its_language(language):
    scene = scene_of(("Wand", "Boden"), ("S1", "S2"), ("R1",))
    kinds = ("serious", "serious", "warning", "info")
    serious = tuple(finding(kind, TABLES[language]["serious"]) for kind in kinds)
    own = {"language": language, "client": "Stadtschule", "author": "A. Nemo"}
    text = report_html(
        answer_of(scene, kept=(1,), findings=serious), scene, title="Musiksaal", campaign="c.toml",
        inputs_sha256={"a.wav": "00"}, project=own,
    )  # fmt: skip
    names = (*NAMES, "Wand", "Boden", "S1", "S2", "R1", "c.toml", "a.wav", "roomfit")
    walls = [s.name for s in scene.room.mesh.surfaces]
    names = (*names, *walls, "result.json", *(f.code.value for f in serious))
    assert unknown(text, language, *names) == set()
    assert ">0,85<" in text or re.search(r">0,\d\d<", text)  # a comma, in tables and on axes


@every_language
def test_every_serious_kind_of_an_answer_is_said_with_its_cure_in_the_language(language):
    """All but those of recordings, rooms and positions that end a fit before there is an answer."""
    never = (
        "unusable cross leak volume planar material outside wall receiver misread data impedance"
    )
    codes = [
        c for c in Code if "serious" in c.severities and not any(x in c for x in never.split())
    ]
    assert len(codes) > 15
    found = [Finding(code, About(), "", graded="serious") for code in codes]
    shape = re.escape(TABLES[language]["Serious: {what}. Cure: {cure}."])
    for line in serious_lines(found):
        said = re.fullmatch(re.sub(r"\\{\w+\\}", "(.+)", shape), translator(language)(line))
        assert said is not None and "Findings" not in line
        assert not {*re.split(r"Serious: |\. Cure: |\.$", line)[1:3]} & {*said.groups()}


@every_language
@pytest.mark.parametrize("sentence", SENTENCES)
def test_what_data_determine_together_is_said_whole_in_the_language(sentence, language):
    say = translator(language, frozenset({"a", "b", "oak and ash"}))
    said = say(sentence).replace("oak and", "")
    english = r"\b(the|of|and|is|are|not|in the data|together|falls|rises|at|by|mean|mid)\b"
    assert re.search(rf"\d\.\d|{english}", said) is None


def test_names_stay_as_they_are_though_they_are_words_or_numbers_of_the_table():
    walls, ends = ("all", "wood and glass", "energy"), ("no", "1.5", "at home, to rest", "a; b")
    scene, own = scene_of(walls, ends[:1], ends[1:]), {"client": "source", "date": "12.2026"}
    found = finding("warning", "no to 1.5 (air at 2.wav): all and wood and glass.")
    page = report_html(
        answer_of(scene, findings=(found,)), scene, title="The room",
        inputs_sha256={"air at 2.wav": "1.5"}, project=own | {"language": "de"},
    )  # fmt: skip
    texts = [unescape(x).strip() for x in re.findall(r">([^<]+)<", page)]
    pairs = [f"no nach {name}" for name in ends[1:]]
    assert {*walls, *ends, *own.values(), *pairs, "The room", "air at 2.wav"} <= set(texts)
    changed = ("wood und", "nein nach", "nach 1,5", "bis rest", "bei home", "bei 2.", "12,2026")
    assert not [words for words in changed if words in " ".join(texts)]


def test_a_text_without_an_entry_stays_and_numbers_get_their_comma():
    say = translator("de")
    assert say("brick") == "brick" and say("1.25 s") == "1,25 s"
    assert say("3 of 6 bands") == "3 von 6 Bändern"
    assert say("0.31 (0.29 to 0.34)") == "0,31 (0,29 bis 0,34)"
    assert translator("fr")("12.5 %") == "12,5\N{NO-BREAK SPACE}%"
    assert translator("en")("0.5 of it") == "0.5 of it"
    with pytest.raises(InputError, match="no words of this language"):
        translator("it")


@pytest.mark.slow
def test_a_client_gets_two_pages_and_the_report_of_eight_pairs_has_eight_at_most(made):
    """As PDF, in the languages with longer words; of the client's page a Word file as well."""
    weasyprint, (folder, language) = pytest.importorskip("weasyprint"), made
    sources, receivers = ("S1", "S2"), ("R1", "R2", "R3", "R4")
    scene = scene_of([f"Wand {i}" for i in range(6)], sources, receivers)
    report = report_html(answer_of(scene), scene, title="Saal", project={"language": language})
    client = (folder / "treat" / "client.html").read_text(encoding="utf-8")
    for text, most in ((report, 8), (client, 2)):
        assert len(weasyprint.HTML(string=text).render().pages) <= most
    pytest.importorskip("docx")
    out = folder / "client.docx"
    assert export_result(folder / "treat" / "client.html", "word", out) == ()
    assert zipfile.ZipFile(out).testzip() is None
    pictures = [n for n in zipfile.ZipFile(out).namelist() if n.startswith("word/media/")]
    assert len(pictures) == 2
