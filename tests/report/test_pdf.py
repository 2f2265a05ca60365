"""The report as PDF: as the page is printed, drawings in their colours, and nothing fetched."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import zlib

import numpy as np
import pytest

from roomfit.base.errors import InputError
from roomfit.cli.export import export_result
from roomfit.report.documents import report_pdf
from roomfit.report.figures import svg

PAGE = """<!doctype html><title>Absorption: hall</title>
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


def test_it_is_the_report_beside_the_result_that_is_exported(tmp_path):
    needs_weasyprint()
    (tmp_path / "report.html").write_text(PAGE.format(drawing=""))
    for name in ("result.json", "report.html"):
        out = tmp_path / f"{name}.pdf"
        assert export_result(tmp_path / name, "pdf", out).files == (out,)
        assert out.read_bytes().startswith(b"%PDF-")
    with pytest.raises(InputError, match="report does not exist"):
        export_result(tmp_path / "deep" / "result.json", "pdf", tmp_path / "b.pdf")


def test_without_weasyprint_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "weasyprint", None)
    (tmp_path / "report.html").write_text(PAGE.format(drawing=""))
    with pytest.raises(InputError, match=r"(?s)WeasyPrint.*roomfit\[pdf\].*Pango|roomfit\[pdf\]"):
        export_result(tmp_path / "result.json", "pdf", tmp_path / "b.pdf")
    assert not (tmp_path / "b.pdf").exists()
