"""The HTML report: it says what the answer says, needs no network, and a browser draws it."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import html
import io
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib import rc_context
from matplotlib.image import imread

from report_cases import (
    CHROMIUM,
    VALUES,
    answer_of,
    drawing,
    finding,
    look_at,
    read_page,
    scene_of,
    with_bands,
)
from roomfit.base.air import attenuation_per_m
from roomfit.report import wording
from roomfit.report.answer import describe, report_html
from roomfit.report.figures import absorption_figure, decay_figure, svg
from roomfit.report.html import fragment
from roomfit.report.room_figure import MOST_FACES, drawn_faces, outline_m, room_figure
from roomfit.report.wording import DASH
from roomfit.result import Compared
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
            reported = [number(cell[0]), lower, upper]
            true = [answer.absorption[i, j], answer.lower95[i, j], answer.upper95[i, j]]
            np.testing.assert_allclose(reported, true, atol=0.00501)
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
        reported = [number(cell[0]) for cell in rows[name][1:]]
        # two decimals below 10 m2, one above
        np.testing.assert_allclose(reported, values, atol=0.0501)
    assert [number(rows[n][0][0]) for n in answer.materials] == [60.0, 24.0, 24.0]


def test_jnd_of_every_pair_and_of_the_null_model_are_recomputed_from_the_values(case):
    answer, _, _, page = case
    for pair in answer.pairs:
        rows = table(page, f"{pair.source} to {pair.receiver}")
        for key, unit in JND.items():
            c = pair.parameters[key]
            scale = unit * c.measured if key.endswith("_s") else unit
            cells = rows[key.split("_")[0]]
            reported = [[number(x[0]), number(x[2].removeprefix("others "))] for x in cells]
            true = np.array([(c.predicted - c.measured) / scale, (c.null - c.measured) / scale]).T
            np.testing.assert_allclose(reported, true, atol=0.0501)


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
                reported = [number(x[at].removeprefix("others ")) for x in rows[key.split("_")[0]]]
                expected = [*errors.mean(axis=0), errors.mean()]
                np.testing.assert_allclose(reported, expected, atol=0.0501)


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


def points_of(axes, colours=("#0072B2", "black")):
    """Return all marks of a panel, rising in x."""
    lines = [x for x in axes.lines if x.get_marker() in "osD" and x.get_color() in colours]
    at = np.concatenate([x.get_xydata() for x in lines])
    return at[np.argsort(at[:, 0])]


def test_the_figure_of_absorption_draws_the_numbers_of_the_answer(case):
    answer = case[0]
    panels = absorption_figure(answer).axes
    rows = [*answer.absorption, answer.mean_absorption[0]]
    ends = [*zip(answer.lower95, answer.upper95, strict=True), answer.mean_absorption[1:]]
    assert len(panels) >= len(rows)
    for axes, row, (low, high) in zip(panels, rows, ends, strict=False):
        expected = np.array([answer.bands.centres_hz, row]).T
        np.testing.assert_array_equal(points_of(axes), expected)
        bars = np.array(axes.collections[0].get_segments())[:, :, 1]
        np.testing.assert_allclose(bars, np.array([low, high]).T, rtol=1e-12)


def test_hollow_points_are_those_that_are_not_identifiable(case):
    answer = case[0]
    for i, axes in enumerate(absorption_figure(answer).axes[: len(answer.materials)]):
        hollow = [x for x in axes.lines if x.get_markerfacecolor() == "white"]
        (line,) = [x for x in hollow if x.get_label() == "not identifiable"]
        centres = answer.bands.centres_hz[~answer.identifiable[i]]
        np.testing.assert_array_equal(line.get_xdata(), centres)


def test_the_plan_and_the_side_views_show_where_everything_stands(case):
    scene = case[1]
    _, *views = room_figure(scene).axes
    for axes, at in zip(views, ([0, 1], [0, 2], [1, 2]), strict=True):
        for marker, points in (("o", scene.receivers), ("D", scene.sources)):
            (line,) = [x for x in axes.lines if x.get_marker() == marker]
            expected = [p.position_m[at] for p in points]
            np.testing.assert_array_equal(line.get_xydata(), expected)
        width, height = axes.get_window_extent().size
        (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
        assert width / (x1 - x0) == pytest.approx(height / (y1 - y0), rel=1e-9), "not to scale"


def test_of_a_box_in_space_the_floor_and_the_two_far_walls_are_drawn(case):
    """The viewer stands at low x and low y, above: ceiling, west and south walls are in front."""
    room = case[1].room
    faces = drawn_faces(room)
    names = {room.mesh.surfaces[k].name for k in room.mesh.triangle_surface[faces]}
    assert names == {"floor", "east", "north"}
    assert len(faces) == 6 < MOST_FACES


def test_decay_curves_follow_the_answer_where_they_are_shown(case):
    """Thinned or not, what is drawn lies on the curves, and each pair has its own group."""
    answer = case[0]
    for figure in (decay_figure(answer, *answer.pairs), decay_figure(answer, answer.pairs[2])):
        several = len(figure.axes[0].lines) > 2
        pairs = answer.pairs if several else answer.pairs[2:3]
        for j, axes in enumerate(figure.axes):
            for name, colour in (("measured", "black"), ("predicted", "#D55E00")):
                lines = [x for x in axes.lines if x.get_color() == colour]
                for i, (line, pair) in enumerate(zip(lines, pairs, strict=True)):
                    assert line.get_gid() == (f"class:curve-{i}" if several else None)
                    at, true = line.get_xydata(), getattr(pair.decay, f"{name}_db")[j]
                    assert len(at) > 20
                    on = np.interp(at[:, 0], pair.decay.time_s, true)
                    np.testing.assert_allclose(at[:, 1], on, atol=1e-9)


def test_a_choice_shows_the_curves_of_its_pair_and_the_worst_comes_first(case):
    answer, _, text, page = case
    off = [np.mean([np.abs(c.jnd) for c in p.parameters.values()]) for p in answer.pairs]
    inputs = [a for tag, a in page.elements if tag == "input"]
    assert [a["id"] for a in inputs] == [f"pick-{i}" for i in range(len(off))]
    assert ["checked" in a for a in inputs] == [i == int(np.argmax(off)) for i in range(len(off))]
    style = "".join(page.raw["style"])
    for i, pair in enumerate(answer.pairs):
        assert f"#pick-{i}:checked ~ figure .curve-{i} {{ display: inline; }}" in style
        label = text.split(f'<label for="pick-{i}">')[1].split("</label>")[0]
        assert label.startswith(f"{pair.source} to {pair.receiver}")
        # two curves, the evaluated range and the decay times in each of six bands
        assert drawing(text, "decay").count(f'<g class="curve-{i}">') == 1 + 4 * len(answer.bands)
    assert 'g[class^="curve-"] { display: none; }' in style


def test_findings_come_first_with_the_most_serious_ahead(case):
    _, _, text, page = case
    reported = ["Do not use it.", "Look at it.", "Look at this as well.", "Good to know."]
    places = [text.index(sentence) for sentence in reported]
    assert places == sorted(places)
    assert page.headings[1] == "Findings: 1 serious, 2 to look at, 1 to know"
    assert places[-1] < text.index("<h2>Absorption</h2>") < text.index("<h2>The room</h2>")
    # a serious one is open, warnings are a count that opens
    doubts = next(a for tag, a in page.elements if tag == "details")
    assert doubts == {"class": "doubts serious", "open": ""}


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
    assert "http://" not in text and "https://" not in text
    assert len(text.encode()) <= 1e6


def test_nothing_is_executed(case):
    _, _, text, page = case
    assert "script" not in {tag for tag, _ in page.elements}
    assert not [k for _, a in page.elements for k in a if k.lower().startswith("on")]
    policy = next(a for tag, a in page.elements if a.get("http-equiv"))["content"]
    assert re.fullmatch(r"default-src 'none'; style-src( 'sha256-[\w+/]{43}=')+", policy)
    for rules in re.findall("<style>(.*?)</style>", text, re.DOTALL):
        digest = base64.b64encode(hashlib.sha256(rules.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in policy
    assert not [tag for tag, a in page.elements if "style" in a]
    assert "javascript:" not in text


def test_every_link_leads_to_a_section_and_every_picture_has_words(case):
    page = case[3]
    names = {a["id"] for _, a in page.elements if "id" in a}
    assert {value[1:] for _, _, value in page.references} <= names
    for tag, attributes in page.elements:
        if tag == "svg" and "aria-hidden" not in attributes:
            assert attributes["role"] == "img"
            assert attributes["aria-labelledby"] in names
        assert tag != "img"
    assert sum(tag == "table" for tag, _ in page.elements) == len(page.tables)


def test_drawings_of_one_page_share_no_id_and_refer_only_to_their_own(case):
    text, page = case[2], case[3]
    ids = [a["id"] for _, a in page.elements if "id" in a]
    assert len(ids) == len(set(ids))
    for name in ("room", "absorption", "decay"):
        root = ET.fromstring(drawing(text, name))
        own = {e.attrib["id"] for e in root.iter() if "id" in e.attrib}
        assert own
        assert all(i.startswith(f"{name}-") for i in own)
        values = [v for e in root.iter() for v in e.attrib.values()]
        used = re.findall(r"(?:^|url\()#([\w-]+)", " ".join(values).replace(" #", "\n#"), re.M)
        assert used
        assert set(used) <= own
        classes = {e.attrib["class"] for e in root.iter() if "class" in e.attrib}
        rules = set(re.findall(r"\.([\w-]+)\{", root.find("style").text))
        assert {c for c in classes if not c.startswith("curve-")} == rules
        assert all(re.fullmatch(rf"{name}-(all|s\d+)", rule) for rule in rules)


def test_words_of_a_drawing_stay_words_in_the_type_of_the_page(case):
    answer, _, text, _ = case
    root = ET.fromstring(drawing(text, "absorption"))
    words = {e.text for e in root.iter("text")}
    assert {"absorption coefficient", "octave band centre (Hz)", *answer.materials} <= words
    style = root.find("style").text
    fonts = re.findall(r"font-family:([^;}]*)|font:([^;}]*)", style)
    assert fonts
    assert all(re.fullmatch(r"([\w. ]*px )?sans-serif", "".join(font)) for font in fonts)
    assert "DejaVu" not in drawing(text, "absorption")


def test_a_drawing_is_the_same_each_time_and_tells_no_date(case):
    answer = case[0]
    once, again = (svg(absorption_figure(answer), "a", "b") for _ in range(2))
    assert once == again
    assert "date" not in once
    assert once != svg(absorption_figure(answer), "c", "b")


@pytest.mark.slow
def test_forty_pairs_in_third_octaves_stay_below_two_and_a_half_megabytes():
    names = [f"material {i}" for i in range(3)]
    scene = scene_of(names, [f"S{i}" for i in range(4)], [f"R{i}" for i in range(10)])
    answer = answer_of(scene, kind="third-octave", low=100, high=10000)
    text = report_html(answer, scene, title="Many")
    assert len(answer.pairs) == 40
    assert len(text.encode()) <= 2.5e6
    page = read_page(text)
    assert len(table(page, "S3 to R9")["T20"]) == len(answer.bands) == 21
    assert len([c for c in page.tables if c.startswith("S3 to R9")]) == 3
    assert drawing(text, "decay").count('<g class="curve-39">') == 1 + 4 * 21


# Answers of every kind.


def odd_cases():
    def with_pairs(scene, change, **more):
        answer = answer_of(scene, **more)
        return dataclasses.replace(answer, pairs=tuple(map(change, answer.pairs)))

    def without_t20(pair):
        kept = {k: v for k, v in pair.parameters.items() if k != "T20_s"}
        return dataclasses.replace(pair, parameters=kept)

    def all_undetermined(pair):
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
    whole, gap = answer_of(two), np.where(np.arange(6) == 1, np.nan, 1.0)
    names = ("absorption", "lower95", "upper95", "chi2_reduced")
    hole = with_bands(whole, cost=gap, **{name: getattr(whole, name) * gap for name in names})
    (mean,) = whole.combinations[1]
    mean = dataclasses.replace(mean, value=np.nan, lower95=np.nan, upper95=np.nan)
    first, missing, *rest = whole.determined
    hole = dataclasses.replace(
        hole,
        determined=(first, missing._replace(combinations=(mean,)), *rest),
        identifiable=hole.identifiable & np.isfinite(gap),
    )
    held = dataclasses.replace(
        with_bands(whole, lower95=whole.absorption, upper95=whole.absorption),
        identifiable=np.ones((3, 6), dtype=bool),
    )
    return {
        "one band, one material, one pair": (answer_of(small, low=1000, high=1000), small),
        "no pairs": (answer_of(no_pairs), no_pairs),
        "no T20": (with_pairs(two, without_t20), two),
        "nothing known of any pair": (with_pairs(two, all_undetermined), two),
        "some values missing": (with_pairs(two, some_missing), two),
        "a band not determined": (hole, two),
        "everything given": (held, two),
        "all kept for validation": (answer_of(two, kept=(0, 1)), two),
    }


ODD = odd_cases()


@pytest.mark.slow
@pytest.mark.parametrize("name", ODD)
def test_an_odd_answer_makes_a_whole_page_without_nan(name):
    answer, scene = ODD[name]
    page = read_page(report_html(answer, scene, title=name))
    words = "".join(page.words)
    assert not re.search(r"\b(nan|inf|None)\b", words, re.IGNORECASE)
    for rows in page.tables.values():
        for cells in rows.values():
            assert all(len(cell) > 1 for cell in cells if cell[0] == DASH), "a dash without reason"


@pytest.mark.slow
def test_missing_values_are_reported_with_their_reason():
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
    assert "script" not in {tag for tag, _ in page.elements}
    assert not [a for _, a in page.elements if "onerror" in a]
    assert HOSTILE in "".join(page.words)
    assert "img" not in {tag for tag, _ in page.elements}


def test_a_notebook_shows_the_tables_of_the_terminal_and_obeys_no_name():
    answer = answer_of(scene_of((HOSTILE, "floor")))
    shown = read_page(fragment(describe(answer)))
    assert not {"script", "img"} & {tag for tag, _ in shown.elements}
    assert [tag for tag, _ in shown.elements].count("style") == 1  # ours, which no name enters
    rows = table(shown, "Absorption coefficient")
    assert [number(c[0]) for c in rows[HOSTILE]] == pytest.approx(answer.absorption[0], abs=5e-3)
    assert all(caption in str(answer) for caption in shown.tables)


@pytest.mark.slow
@pytest.mark.parametrize(
    "names", [("$a$ and $b$", "_hidden", "]]>"), ("\\frac{a}", "a  b", "--><b>")]
)
def test_a_name_is_drawn_letter_by_letter(names):
    """A formula, an entry left out of a legend, the end of a comment: all are only names."""
    scene = scene_of(names, names, ("R1",))
    text = report_html(answer_of(scene), scene, title="t")
    for drawn in ("room", "absorption"):
        root = ET.fromstring(drawing(text, drawn))
        words = [
            "".join(e.itertext()).replace("\N{ZERO WIDTH SPACE}", "") for e in root.iter("text")
        ]
        assert {" ".join(name.split()) for name in names} <= set(words), drawn
    read_page(text)
    # as a notebook shows it, by no writer of this project
    shown = io.StringIO()
    with rc_context({"svg.fonttype": "none"}):
        answer_of(scene).plot().savefig(shown, format="svg")
    assert html.escape(names[0], quote=False) in shown.getvalue()


@given(st.floats(), st.integers(0, 4), st.booleans())
def test_a_number_is_reported_to_its_last_digit_or_as_a_dash(value, decimals, signed):
    reported = wording.number(value, decimals, signed=signed)
    if not np.isfinite(value):
        assert reported == DASH
        return
    # half a unit of the last digit, and the rounding of the value itself
    assert abs(number(reported) - value) <= 0.5 * 10.0**-decimals + 1e-15 * abs(value)
    assert (reported[0] == "\N{MINUS SIGN}") == (number(reported) < 0.0)


def test_the_outline_of_a_box_is_its_twelve_edges():
    ends = outline_m(scene_of().room, 100)
    lengths = np.sort(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1))
    # the six diagonals between the triangles of one wall are left out
    assert lengths.tolist() == [3.0] * 4 + [4.0] * 4 + [6.0] * 4


# A browser draws it.


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")
def test_a_browser_draws_all_figures_and_logs_no_error(tmp_path):
    scene = scene_of((HOSTILE, "floor", "ceiling"), ("S<1>",), ("R1", "R2"))
    file = tmp_path / "report.html"
    text = report_html(answer_of(scene, findings=FINDINGS), scene, title="A drawn room")
    file.write_text(text, encoding="utf-8")
    picture, drawn, logged = look_at(file, tmp_path)
    assert logged == []
    assert "<title>A drawn room</title>" in drawn
    assert drawn.count('<svg role="img"') == 4
    grey = imread(picture)[..., :3].mean(axis=2)
    # words, lines and pale walls: a blank page has no dark and no middling pixels
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
