"""The report as PDF and as a Word file: what the page says, nothing fetched, nobody named."""

from __future__ import annotations

import io
import json
import re
import shutil
import subprocess
import sys
import zipfile
import zlib
from html import escape

import numpy as np
import pytest

from report_cases import answer_of, read_page, scene_of
from roomfit.base.errors import InputError
from roomfit.cli.export import export_result
from roomfit.cli.identify import identify_to_folder
from roomfit.report.answer import report_html
from roomfit.report.documents import report_pdf, report_word
from roomfit.report.figures import png, svg
from roomfit.report.room_figure import room_figure
from roomfit.report.wording import DASH
from small_campaign import write_campaign

docx = pytest.importorskip("docx")


PAGE = """<!doctype html><meta name="generator" content="roomfit"><title>Absorption: hall</title>
<style>:root {{ --ink: #222 }} body {{ color: var(--ink) }}</style>
<details><summary>folded</summary><p>within</p></details>{drawing}"""


def drawing() -> str:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4, 3))
    figure.subplots().plot([0, 1], [0, 1])
    return svg(figure, "a", "A line")


def needs_weasyprint() -> None:
    try:
        import weasyprint  # noqa: F401
    except (ImportError, OSError):
        pytest.skip("WeasyPrint is not here")


@pytest.fixture(scope="module")
def made() -> bytes:
    needs_weasyprint()
    return report_pdf(PAGE.format(drawing=drawing()))


def test_a_page_becomes_a_pdf_of_a4_with_its_title_and_quietly(made, capfd):
    report_pdf(PAGE.format(drawing=drawing()))
    assert capfd.readouterr() == ("", "")
    assert made.startswith(b"%PDF-")
    found = re.findall(rb"FlateDecode.*?stream\r?\n(.*?)\r?\nendstream", made, re.DOTALL)
    text = made + b"".join(zlib.decompress(s) for s in found)
    for part in (b"595.2", b"841.8", b"Absorption: hall"):
        assert part in text


def test_drawings_are_not_black(made, tmp_path):
    """Most of the paper is white, within the drawing, too."""
    if shutil.which("pdftoppm") is None:
        pytest.skip("pdftoppm is not here")
    (tmp_path / "a.pdf").write_bytes(made)
    subprocess.run(
        ["pdftoppm", "-r", "30", "-gray", str(tmp_path / "a.pdf"), str(tmp_path / "p")], check=True
    )
    (page,) = tmp_path.glob("p*.pgm")
    content = page.read_bytes()
    width, height = re.match(rb"P5\s(\d+) (\d+)\s255\s", content).groups()
    shades = np.frombuffer(content[-int(width) * int(height) :], dtype=np.uint8)
    assert (shades > 200).mean() > 0.95
    assert (shades < 160).any()


def test_nothing_is_fetched(tmp_path):
    needs_weasyprint()
    (tmp_path / "style.css").write_text("body { color: red }")
    page = f'<title>t</title><link rel="stylesheet" href="file://{tmp_path}/style.css"><p>x</p>'
    assert len(report_pdf(page)) == len(report_pdf(page.replace(str(tmp_path), "/" + "x" * 40)))


@pytest.mark.parametrize(
    ("wanted", "library", "words"),
    [
        ("pdf", "weasyprint", r"(?s)WeasyPrint.*roomfit\[pdf\].*Pango|roomfit\[pdf\]"),
        ("word", "docx", r"(?s)python-docx.*roomfit\[word\]"),
    ],
)
def test_without_its_library_it_says_what_to_install(tmp_path, monkeypatch, wanted, library, words):
    monkeypatch.setitem(sys.modules, library, None)
    (tmp_path / "report.html").write_text(PAGE.format(drawing=""))
    with pytest.raises(InputError, match=words):
        export_result(tmp_path / "report.html", wanted, tmp_path / "a")
    assert not (tmp_path / "a").exists()


# Word.


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Return the folder of a small result, as `identify` leaves it, and its report in Word."""
    folder = tmp_path_factory.mktemp("word")
    titled = ("[room]\n", '[project]\ntitle = "Hall ü"\n[room]\n')
    campaign = write_campaign(folder / "campaign", titled)
    identify_to_folder(campaign, folder / "result", png=True)
    export_result(folder / "result" / "result.json", "word", folder / "report.docx")
    return folder / "result"


@pytest.fixture(scope="module")
def book(written):
    return docx.Document(str(written.with_name("report.docx")))


def tables(book) -> dict[str, list[list[str]]]:
    """Return rows of cells by the caption that stands before each table."""
    found, caption = {}, ""
    for block in book.iter_inner_content():
        if isinstance(block, docx.table.Table):
            found[caption] = [[cell.text for cell in row.cells] for row in block.rows]
        elif block.style.name == "Caption":
            caption = block.text
    return found


def number(text: str) -> float:
    return float(text.strip("()▲ ").replace("\N{MINUS SIGN}", "-"))


@pytest.mark.slow
def test_absorption_and_intervals_are_those_of_the_result(written, book):
    result = json.loads((written / "result.json").read_text())
    shown = {}
    for caption, (_, *rows) in tables(book).items():
        if caption.startswith("Absorption coefficient"):
            for head, *cells in rows:
                shown.setdefault(head.split("\n")[0], []).extend(cells)
    assert set(result["materials"]) == set(shown) - {"mean of the room"}
    for name, found in result["materials"].items():
        for i, cell in enumerate(shown[name]):
            value, interval, *marks = cell.split("\n")
            lower, upper = map(number, interval.split(DASH))
            expected = [found[key][i] for key in ("absorption", "lower95", "upper95")]
            # two decimals, three where it is small
            np.testing.assert_allclose([number(value), lower, upper], expected, atol=0.00501)
            assert ("not identif." in marks) != found["identifiable"][i]
            before = [number(x) for x in marks[-1].removeprefix("before ").split(DASH)]
            prior = [found["prior"][key][i] for key in ("lower95", "upper95")]
            np.testing.assert_allclose(before, prior, atol=0.00501)


@pytest.mark.slow
def test_room_parameters_are_those_of_the_result(written, book):
    result = json.loads((written / "result.json").read_text())
    for pair in result["pairs"]:
        (rows,) = (own for name, own in tables(book).items() if "in JND: mean" in name)
        cells = next(r for r in rows if r[0].startswith(f"{pair['source']} to {pair['receiver']}"))
        measured, predicted = map(number, cells[rows[0].index("T20")].split("\n")[2].split("→"))
        values = pair["parameters"]["T20_s"]
        both = np.array([values["measured"], values["predicted"]], dtype=float)
        worst = np.nanargmax(np.abs(both[1] / both[0] - 1.0))
        np.testing.assert_allclose([measured, predicted], both[:, worst], atol=0.00501)


@pytest.mark.slow
def test_headings_tables_and_findings_are_those_of_the_page_in_its_order(written, book):
    text = (written / "report.html").read_text(encoding="utf-8")
    headings = re.findall(r"<h[12]>(.*?)</h[12]>", text)
    styles = ("Title", "Heading 1")
    assert headings == [escape(p.text) for p in book.paragraphs if p.style.name in styles]
    page, shown = read_page(text).tables, tables(book)
    assert len(page) > 8
    assert set(shown) == set(page)
    for caption, rows in page.items():
        assert len(rows) == len(shown[caption]), caption
    said = [p.text for p in book.paragraphs if p.style.name.startswith("List Bullet")]
    result = json.loads((written / "result.json").read_text())
    for one in result["findings"]:
        assert sum(one["sentence"] in line for line in said) == 1


@pytest.mark.slow
def test_pictures_are_those_beside_the_report_with_words_for_those_who_do_not_see(written, book):
    parts = book.part.related_parts.values()
    held = {part.blob for part in parts if part.content_type == "image/png"}
    names = ("absorption", "room", "decay_times")
    assert {(written / f"{name}.png").read_bytes() for name in names} <= held
    words = book.element.xpath("//wp:inline/wp:docPr/@descr")
    assert len(words) == len(book.inline_shapes) == len(held) and all(words)
    assert not any(p.text.startswith("[") for p in book.paragraphs)


@pytest.mark.slow
def test_it_is_the_same_file_whenever_it_is_written_and_names_nobody(written):
    text = (written / "report.html").read_text(encoding="utf-8")
    content = report_word(text, {})
    assert content == report_word(text, {})
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        core = archive.read("docProps/core.xml").decode()
    assert "<dc:title>Hall ü</dc:title>" in core
    assert not re.search(r"20\d\d-|python-docx", core)


@pytest.mark.slow
def test_names_of_any_letters_are_written_as_text():
    scene = scene_of(("</table>&<b>", "floor", "ceiling"))
    named = answer_of(scene)
    shown = docx.Document(io.BytesIO(report_word(report_html(named, scene, title="a"), {})))
    heads = {cells[0].split("\n")[0] for rows in tables(shown).values() for cells in rows}
    assert "</table>&<b>" in heads


@pytest.mark.parametrize("wanted", ["pdf", "word"])
def test_a_page_of_another_program_is_refused(tmp_path, wanted):
    (tmp_path / "a.html").write_text("<html><body><table><tr><td>x</td></tr></table><img>")
    with pytest.raises(InputError, match=r"(?s)no page of roomfit.*a\.html.*report\.html"):
        export_result(tmp_path / "a.html", wanted, tmp_path / "b")
    assert not (tmp_path / "b").exists()


@pytest.mark.slow
def test_a_damaged_picture_and_a_changed_result_are_refused(written, tmp_path):
    text = (written / "report.html").read_text(encoding="utf-8")
    with pytest.raises(InputError, match="picture of the report is damaged"):
        report_word(text, {"absorption": b"no picture"})
    whole = png(room_figure(scene_of()))
    with pytest.raises(InputError, match="picture of the report is damaged"):
        report_word(text, {"absorption": whole[:20]})
    changed = (written / "result.json").read_text().replace('"seed": ', '"seed": 1')
    (tmp_path / "result.json").write_text(changed)
    (tmp_path / "report.html").write_text(text)
    with pytest.raises(InputError, match="changed after roomfit wrote it"):
        export_result(tmp_path / "result.json", "word", tmp_path / "b.docx")
    assert not (tmp_path / "b.docx").exists()
