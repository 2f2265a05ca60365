"""The HTML report: it says what the answer says, needs no network, and a browser draws it."""

from __future__ import annotations

import base64
import dataclasses
import gzip
import json
import re

import numpy as np
import plotly.graph_objects
import plotly.offline
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.image import imread

from report_cases import (
    CHROMIUM,
    VALUES,
    answer_of,
    finding,
    look_at,
    page_data,
    read_page,
    scene_of,
)
from roomfit.air import attenuation_per_m
from roomfit.report.html import parts as wording
from roomfit.report.html import report_html
from roomfit.report.html.figures import outline_m
from roomfit.report.html.parts import DASH, page_json
from roomfit.results import Compared
from roomfit.signals.decay import in_jnd

HOSTILE = "<script>document.title='taken'</script><img src=x onerror=alert(1)> & \"quoted\" %{y}"
JND = {"T20_s": 0.05, "T30_s": 0.05, "EDT_s": 0.05, "C50_dB": 1.0, "C80_dB": 1.0,
       "D50_percent": 5.0, "TS_ms": 10.0}  # fmt: skip
FINDINGS = (
    finding("info", "Good to know."),
    finding("serious", "Do not use it."),
    finding("warning", "Look at it."),
    finding("warning", "Look at this as well."),
)


def number(text: str) -> float:
    return float(text.strip("()▲ ").replace("\N{MINUS SIGN}", "-"))


def table(page, caption: str):
    """Return the rows of the tables whose caption begins so, those in blocks joined."""
    found = [rows for name, rows in page.tables.items() if name.startswith(caption)]
    assert found, f"no table {caption!r} among {list(page.tables)}"
    return {head: [c for rows in found for c in rows[head]] for head in found[0]}


@pytest.fixture(scope="module")
def case():
    scene = scene_of(sources=("S1", "S2"), receivers=("R1", "R2", "R3"))
    answer = answer_of(scene, kept=(4,), findings=FINDINGS)
    text = report_html(answer, scene, title="A room", inputs_sha256={"a.wav": "ab" * 32})
    return answer, scene, text, read_page(text)


# It says what the answer says.


def test_absorption_and_intervals_are_those_of_the_answer(case):
    answer, _, _, page = case
    rows = table(page, "Absorption coefficient")
    for i, name in enumerate(answer.materials):
        for j, cell in enumerate(rows[name]):
            lower, upper = (number(t) for t in cell[1].split(DASH))
            told = [number(cell[0]), lower, upper]
            true = [answer.absorption[i, j], answer.lower95[i, j], answer.upper95[i, j]]
            np.testing.assert_allclose(told, true, atol=0.00501)
            sure = bool(answer.identifiable[i, j])
            assert (cell[0][0] == "(", "not identif." in cell) == (not sure, not sure)
    means = [number(cell[0]) for cell in rows["mean of the room"]]
    np.testing.assert_allclose(means, answer.mean_absorption[0], atol=0.00501)


def test_absorption_areas_add_up_with_the_air(case):
    answer, scene, _, page = case
    rows = table(page, "Equivalent absorption area")
    areas = answer.absorption * answer.areas_m2[:, None]
    air = 4.0 * attenuation_per_m(scene.air, answer.bands) * 6.0 * 4.0 * 3.0
    expected = {
        **dict(zip(answer.materials, areas, strict=True)),
        "all surfaces": areas.sum(axis=0),
        "air, 4mV": air,
        "total": areas.sum(axis=0) + air,
    }
    for name, values in expected.items():
        told = [number(cell[0]) for cell in rows[name][1:]]
        # two decimals below 10 m2, one above
        np.testing.assert_allclose(told, values, atol=0.0501)
    assert [number(rows[n][0][0]) for n in answer.materials] == [60.0, 24.0, 24.0]


def test_jnd_of_every_pair_and_of_the_null_model_are_recomputed_from_the_values(case):
    answer, _, _, page = case
    for pair in answer.pairs:
        rows = table(page, f"{pair.source} to {pair.receiver}")
        for key, unit in JND.items():
            c = pair.parameters[key]
            scale = unit * c.measured if key.endswith("_s") else unit
            cells = rows[key.split("_")[0]]
            told = [[number(x[0]), number(x[2].removeprefix("others "))] for x in cells]
            true = np.array([(c.predicted - c.measured) / scale, (c.null - c.measured) / scale]).T
            np.testing.assert_allclose(told, true, atol=0.0501)


def test_mean_errors_of_model_and_null_model_are_those_over_pairs(case):
    answer, _, _, page = case
    for use, words in (("fit", "5 pairs fitted"), ("validate", "1 pair not fitted")):
        rows = table(page, f"Mean error over {words}")
        pairs = [p for p in answer.pairs if p.use == use]
        for key in VALUES:
            c = [p.parameters[key] for p in pairs]
            measured = np.array([x.measured for x in c])
            scale = measured / 100.0 if key in ("T20_s", "T30_s", "EDT_s") else 1.0
            for which, at in (("predicted", 0), ("null", 1)):
                errors = np.abs(np.array([getattr(x, which) for x in c]) - measured) / scale
                told = [number(x[at].removeprefix("others ")) for x in rows[key.split("_")[0]]]
                expected = [*errors.mean(axis=0), errors.mean()]
                np.testing.assert_allclose(told, expected, atol=0.0501)


def test_a_model_worse_than_the_null_model_is_marked_as_such(case):
    page = case[3]
    marked = 0
    for row in table(page, "Mean error over 5 pairs fitted").values():
        for cell in row:
            if len(cell) == 2:
                worse = number(cell[0]) > number(cell[1].removeprefix("others "))
                assert cell[0].startswith("▲") == worse
                marked += worse
    assert marked > 0


def test_pictures_draw_the_numbers_of_the_answer(case):
    answer, scene, _, page = case
    plots = {p["name"]: p for p in page_data(page)["plots"]}
    points = [
        (t["xaxis"], x, y)
        for t in plots["absorption"]["data"]
        for x, y in zip(t["x"], t["y"], strict=True)
    ]
    axes = ["x", *(f"x{i}" for i in range(2, len(answer.materials) + 2))]
    rows = [*answer.absorption, answer.mean_absorption[0]]
    for axis, row in zip(axes, rows, strict=True):
        drawn = sorted((x, y) for a, x, y in points if a == axis)
        np.testing.assert_allclose([y for _, y in drawn], row, atol=5.1e-5)
    for kind, places in (("sources", scene.sources), ("receivers", scene.receivers)):
        trace = next(t for t in plots["room"]["data"] if t["name"] == kind)
        at = np.array([trace[axis] for axis in "xyz"]).T
        np.testing.assert_allclose(at, [p.position_m for p in places], atol=5.1e-4)
    assert plots["room"]["layout"]["scene"]["aspectmode"] == "data"


def test_decay_curves_follow_the_answer_where_they_are_shown(case):
    answer, _, _, page = case
    curves = page_data(page)["curves"]
    assert [c["title"].split(" (")[0] for c in curves] == [
        f"{p.source} to {p.receiver}" for p in answer.pairs
    ]
    for curve, pair in zip(curves, answer.pairs, strict=True):
        for name in ("measured", "predicted"):
            for row, true in zip(curve[name], getattr(pair.decay, f"{name}_db"), strict=True):
                drawn = [(t, y) for t, y in zip(curve["time"], row, strict=True) if y is not None]
                at = np.array(drawn)
                assert len(at) > 20
                expected = np.interp(at[:, 0], pair.decay.time_s, true)
                np.testing.assert_allclose(at[:, 1], expected, atol=0.0501)


def test_the_first_curve_shown_is_of_the_pair_that_is_furthest_off(case):
    answer, _, _, page = case
    off = [np.mean([np.abs(c.jnd) for c in p.parameters.values()]) for p in answer.pairs]
    chosen = [c["chosen"] for c in page_data(page)["curves"]]
    assert chosen == [i == int(np.argmax(off)) for i in range(len(off))]


def test_findings_come_first_with_the_most_serious_ahead(case):
    _, _, text, page = case
    told = ["Do not use it.", "Look at it.", "Look at this as well.", "Good to know."]
    places = [text.index(sentence) for sentence in told]
    assert places == sorted(places)
    assert page.headings[1] == "Findings"
    assert places[-1] < text.index("<h2>The room</h2>")


def test_the_summary_counts_what_can_be_told(case):
    answer, _, _, page = case
    words = " ".join("".join(page.words).split())
    n = int(answer.identifiable.sum())
    assert f"The data determine {n} of {answer.absorption.size} coefficients." in words
    assert "5 fitted measurements and 1 measurement kept for validation" in words
    assert "does not explain the data at 2 kHz to 4 kHz" in words  # phi: 0.8, 1.16, ..., 2.24, 2.6
    assert "1 serious finding, 2 warnings and 1 note" in words


def test_equal_arguments_give_equal_text(case):
    answer, scene, text, _ = case
    again = report_html(answer, scene, title="A room", inputs_sha256={"a.wav": "ab" * 32})
    assert again == text


# It needs nothing beside it.


def test_nothing_is_asked_of_any_network(case):
    _, _, text, page = case
    assert all(value[0] == "#" for _, _, value in page.references), page.references
    assert not {"link", "iframe", "base", "object"} & {tag for tag, _ in page.elements}
    style = "".join(page.raw["style"])
    assert "url(" not in style and "@import" not in style
    policy = next(a for tag, a in page.elements if a.get("http-equiv"))["content"]
    assert policy.startswith("default-src 'none'") and "http" not in policy
    own = page.raw["script"][-1]
    assert "http" not in own and 'plotlyServerURL: ""' in own
    assert len(text.encode()) <= 6e6


def test_every_link_leads_to_a_section_and_every_picture_has_words(case):
    page = case[3]
    names = {a["id"] for _, a in page.elements if "id" in a}
    assert {value[1:] for _, _, value in page.references} <= names
    for tag, attributes in page.elements:
        if tag in ("img", "svg") or attributes.get("class") == "plot":
            named = attributes.get("alt") or attributes.get("aria-label")
            assert named or attributes["aria-labelledby"] in names
    assert sum(tag == "table" for tag, _ in page.elements) == len(page.tables)


def test_plotly_knows_every_property_of_every_picture(case):
    for plot in page_data(case[3])["plots"]:
        made = plotly.graph_objects.Figure({"data": plot["data"], "layout": plot["layout"]})
        assert len(made.data) == len(plot["data"])


def test_the_script_that_draws_is_whole(case):
    """Unpacked by another program than a browser, it is what plotly ships."""
    packed = next(t for t in case[3].raw["script"] if len(t) > 1_000_000)
    assert gzip.decompress(base64.b64decode(packed)).decode() == plotly.offline.get_plotlyjs()


def test_forty_pairs_in_third_octaves_stay_below_six_megabytes():
    names = [f"material {i}" for i in range(3)]
    scene = scene_of(names, [f"S{i}" for i in range(4)], [f"R{i}" for i in range(10)])
    answer = answer_of(scene, kind="third-octave", low=100, high=10000)
    text = report_html(answer, scene, title="Many")
    assert len(answer.pairs) == 40
    assert len(text.encode()) <= 6e6
    page = read_page(text)
    assert len(table(page, "S3 to R9")["T20"]) == len(answer.bands) == 21
    assert len([c for c in page.tables if c.startswith("S3 to R9")]) == 3
    assert len(page_data(page)["plots"][-1]["data"]) == 2 * 21


# Answers of every kind.


def odd_cases():
    def with_pairs(scene, change, **more):
        answer = answer_of(scene, **more)
        return dataclasses.replace(answer, pairs=tuple(map(change, answer.pairs)))

    def without_t20(pair):
        kept = {k: v for k, v in pair.parameters.items() if k != "T20_s"}
        return dataclasses.replace(pair, parameters=kept)

    def nothing_known(pair):
        empty = np.full(6, np.nan)
        kept = {k: Compared(empty, empty, empty, empty) for k in pair.parameters}
        return dataclasses.replace(pair, parameters=kept, decay=None)

    def some_missing(pair):
        kept = {}
        for key, c in pair.parameters.items():
            measured, predicted, null = (np.array(v) for v in (c.measured, c.predicted, c.null))
            measured[0] = predicted[1] = null[2] = np.nan
            kept[key] = Compared(measured, predicted, null, in_jnd(key, measured, predicted))
        return dataclasses.replace(pair, parameters=kept)

    small, two = scene_of(("all",), receivers=("R",)), scene_of()
    no_pairs = dataclasses.replace(two, pairs=np.zeros((0, 2), dtype=int))
    hole = answer_of(two)
    gap = np.where(np.arange(6) == 1, np.nan, 1.0)
    hole = dataclasses.replace(
        hole,
        absorption=hole.absorption * gap, lower95=hole.lower95 * gap, upper95=hole.upper95 * gap,
        mean_absorption=hole.mean_absorption * gap, phi=hole.phi * gap, cost=float("nan"),
        identifiable=hole.identifiable & np.isfinite(gap),
    )  # fmt: skip
    held = answer_of(two)
    held = dataclasses.replace(
        held, lower95=held.absorption, upper95=held.absorption,
        identifiable=np.ones((3, 6), dtype=bool),
    )  # fmt: skip
    return {
        "one band, one material, one pair": (answer_of(small, low=1000, high=1000), small),
        "no pairs": (answer_of(no_pairs), no_pairs),
        "no T20": (with_pairs(two, without_t20), two),
        "nothing known of any pair": (with_pairs(two, nothing_known), two),
        "some values missing": (with_pairs(two, some_missing), two),
        "a band not determined": (hole, two),
        "everything given": (held, two),
        "all kept for validation": (answer_of(two, kept=(0, 1)), two),
    }


ODD = odd_cases()


@pytest.mark.parametrize("name", ODD)
def test_an_odd_answer_makes_a_whole_page_without_nan(name):
    answer, scene = ODD[name]
    page = read_page(report_html(answer, scene, title=name))
    words = "".join(page.words)
    assert not re.search(r"\b(nan|inf|None)\b", words, re.IGNORECASE)
    for plot in page_data(page)["plots"]:
        plotly.graph_objects.Figure({"data": plot["data"], "layout": plot["layout"]})
    for rows in page.tables.values():
        for cells in rows.values():
            assert all(len(cell) > 1 for cell in cells if cell[0] == DASH), "a dash without reason"


def test_missing_values_are_told_with_their_reason():
    answer, scene = ODD["some values missing"]
    page = read_page(report_html(answer, scene, title="t"))
    cells = table(page, "S1 to R1")["C80"]
    assert [cell[0] == DASH for cell in cells] == [True, True, False, False, False, False]
    assert (cells[0][1], cells[1][1], cells[2][2]) == ("not measured", "not predicted", "no others")
    missing = table(read_page(report_html(*ODD["no T20"], title="t")), "S1 to R1")
    assert "T20" not in missing and "T30" in missing


def test_a_parameter_that_only_one_pair_has_is_not_given_for_the_others():
    answer, scene = answer_of(scene := scene_of()), scene
    first = {k: v for k, v in answer.pairs[0].parameters.items() if k != "T20_s"}
    pairs = (dataclasses.replace(answer.pairs[0], parameters=first), answer.pairs[1])
    text = report_html(dataclasses.replace(answer, pairs=pairs), scene, title="t")
    assert table(read_page(text), "S1 to R1")["T20"] == [[DASH, "not given"]] * 6


def test_names_are_shown_and_never_obeyed():
    scene = scene_of((HOSTILE, "floor"), (HOSTILE,), ("<b>R</b>",))
    answer = answer_of(scene, findings=[finding("warning", HOSTILE)])
    page = read_page(
        report_html(answer, scene, title=HOSTILE, campaign=HOSTILE, inputs_sha256={HOSTILE: "0"})
    )
    assert sum(tag == "script" for tag, _ in page.elements) == 3
    assert not [a for _, a in page.elements if "onerror" in a]
    assert HOSTILE in "".join(page.words)
    drawn = json.dumps(page_data(page)["plots"])
    assert "&lt;script&gt;" in drawn and "<script" not in drawn


@given(st.recursive(st.text(), lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner)))
def test_what_a_page_holds_for_its_script_comes_back_whole_and_opens_no_element(value):
    text = str(page_json(value))
    assert json.loads(text) == value
    assert not set("<>&\u2028\u2029") & set(text)


@given(st.floats(), st.integers(0, 4), st.booleans())
def test_a_number_is_told_to_its_last_digit_or_as_a_dash(value, decimals, signed):
    told = wording.number(value, decimals, signed=signed)
    if not np.isfinite(value):
        assert told == DASH
        return
    # half a unit of the last digit, and the rounding of the value itself
    assert abs(number(told) - value) <= 0.5 * 10.0**-decimals + 1e-15 * abs(value)
    assert (told[0] == "\N{MINUS SIGN}") == (number(told) < 0.0)


def test_the_outline_of_a_box_is_its_twelve_edges():
    ends = outline_m(scene_of().room, 100)
    lengths = np.sort(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1))
    # the six diagonals between the triangles of one wall are left out
    assert lengths.tolist() == [3.0] * 4 + [4.0] * 4 + [6.0] * 4


# A browser draws it.


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")
def test_a_browser_draws_all_pictures_and_logs_no_error(tmp_path):
    scene = scene_of((HOSTILE, "floor", "ceiling"), ("S<1>",), ("R1", "R2"))
    file = tmp_path / "report.html"
    text = report_html(answer_of(scene, findings=FINDINGS), scene, title="A drawn room")
    file.write_text(text, encoding="utf-8")
    picture, drawn, logged = look_at(file, tmp_path)
    assert logged == []
    assert "<title>A drawn room</title>" in drawn
    assert 'data-ready="yes"' in drawn
    # room, absorption, widths of intervals, decays
    assert len(re.findall(r'class="printed"[^>]* src="data:image', drawn)) == 4
    grey = imread(picture)[..., :3].mean(axis=2)
    # words, lines and half-transparent walls: a blank page has no dark and no middling pixels
    assert (grey < 0.3).mean() > 0.005
    assert ((grey > 0.3) & (grey < 0.9)).mean() > 0.02


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")
def test_the_browser_check_sees_errors_and_forbidden_requests(tmp_path):
    file = tmp_path / "broken.html"
    file.write_text(
        """<!DOCTYPE html><meta http-equiv="Content-Security-Policy" content="default-src 'none';
        script-src 'unsafe-inline'"><img src="http://localhost:9/a.png">
        <script>throw new Error("broken")</script>"""
    )
    logged = " ".join(look_at(file, tmp_path)[2])
    assert "broken" in logged and "Content Security Policy" in logged
