"""The page as a PDF, by WeasyPrint (the extra ``pdf``), or to be edited, by python-docx (``word``).

Headings, captions, lists and tables of the page become those of Word in the page's order, so that
the two cannot say different things. A drawing, which the page holds as SVG, becomes the picture
that was written beside it.
"""

from __future__ import annotations

import base64
import io
import logging
import re
import zipfile
from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Any

from roomfit.base.door import quiet
from roomfit.base.errors import InputError

OWN_PAGE = '<meta name="generator" content="roomfit">'
_VARIABLE = re.compile(r"var\(--[\w-]+,\s*(#\w+)\)")
_CHOSEN, _CURVES = re.compile(r'id="pick-(\d+)" checked'), re.compile(r'<g class="curve-(\d+)"')


def report_pdf(page: str) -> bytes:
    """Return a report that is an HTML page as PDF, on A4 as browsers print it, all of it unfolded.

    Nothing is fetched: what the page does not hold itself is left out.

    Raises
    ------
    InputError
        WeasyPrint is not installed, or lacks the system's library Pango.
    """
    # its logger sets itself up for standard error when it is first imported
    logging.getLogger("weasyprint").addHandler(logging.NullHandler())
    try:
        library: Any = import_module("weasyprint")
    except (ImportError, OSError) as error:
        raise InputError(
            "a PDF needs WeasyPrint",
            found=" ".join(str(error).split())[:200],
            needed="the package weasyprint and the system's library Pango",
            hint="pip install roomfit[pdf] and, say, apt install libpango-1.0-0 libpangoft2-1.0-0; "
            "or print report.html from a browser",
        ) from error

    fetcher = library.URLFetcher(allowed_protocols=("data",))
    with quiet("weasyprint", "fontTools"):
        document = library.HTML(string=_light(page), url_fetcher=fetcher)
        return bytes(document.write_pdf())


def _light(page: str) -> str:
    """Return the page as a library reads it that applies no style sheet of a page to its drawings.

    Colours that are variables there become those that each use names, the light ones, and of the
    pairs whose curves lie over each other the one that is chosen stays.
    """
    chosen = _CHOSEN.search(page)

    def shown(curves: re.Match[str]) -> str:
        hidden = chosen is not None and curves[1] != chosen[1]
        return curves[0] + ' display="none"' * hidden

    return _CURVES.sub(shown, _VARIABLE.sub(r"\1", page))


# ---------------------------------------------------------------- Word

_HEADINGS = {"h1": 0, "h2": 1, "h3": 2}
_LEFT_OUT = ("style", "nav", "svg", "input", "label")
_WIDTH_MM, _HEIGHT_MM, _MARGIN_MM = 210, 297, 20  # A4
_EARLIEST = (1980, 1, 1, 0, 0, 0)  # of an archive: equal reports are equal files


def report_word(page: str, pictures: Mapping[str, bytes]) -> bytes:
    """Return a report that is an HTML page as a Word file (.docx) on A4.

    Equal arguments give equal bytes: no date and no author is written.

    Parameters
    ----------
    page : str
        Of `roomfit.report.html.report_html`.
    pictures : mapping of str to bytes
        PNG by the names of the files beside the page, without their ending. Of decay curves the
        pair is shown that the page shows first. A drawing that has none is named with its title.

    Raises
    ------
    InputError
        python-docx is not installed, or a picture is damaged.
    """
    try:
        library: Any = import_module("docx")
        parser: Any = import_module("lxml.html")
    except ImportError as error:
        what = "a Word file needs python-docx"
        needed, hint = "the package python-docx", "pip install roomfit[word]; or write --format pdf"
        raise InputError(what, found=str(error), needed=needed, hint=hint) from error
    book = library.Document()
    millimetre = library.shared.Mm
    (section,) = book.sections
    section.page_width, section.page_height = millimetre(_WIDTH_MM), millimetre(_HEIGHT_MM)
    section.left_margin = section.right_margin = millimetre(_MARGIN_MM)
    section.top_margin = section.bottom_margin = millimetre(_MARGIN_MM)
    tree = parser.document_fromstring(page)
    for language in book.styles.element.xpath("//w:lang"):  # what spelling is checked by
        language.set(library.oxml.ns.qn("w:val"), tree.get("lang"))
    _append(book, tree.find("body"), pictures)
    about = book.core_properties
    about.title = _plain(tree.findtext(".//title") or "")
    about.author = about.comments = about.last_modified_by = ""
    for name in ("created", "modified"):
        for element in about._element.xpath(f"dcterms:{name}"):
            about._element.remove(element)
    stream = io.BytesIO()
    book.save(stream)
    return _undated(stream.getvalue())


def _append(book: Any, parent: Any, pictures: Mapping[str, bytes]) -> None:
    """Write what an element of the page holds, in its order."""
    for node in parent:
        kind = node.tag
        if not isinstance(kind, str) or kind in _LEFT_OUT:
            continue
        if kind in _HEADINGS:
            book.add_heading(_text(node), _HEADINGS[kind])
        elif kind == "summary":  # the words that unfold a part: its heading, and what is behind
            heading = next((h for h in node if h.tag in _HEADINGS), node)
            book.add_heading(_text(heading), _HEADINGS.get(heading.tag, 3))
            if heading is not node and _plain(heading.tail or ""):
                book.add_paragraph(_plain(heading.tail))
        elif kind == "p":
            style = "Subtitle" if node.get("class") == "lead" else None
            for line in node.findall("span") if node.get("class") == "project" else [node]:
                book.add_paragraph(_text(line), style=style)
        elif kind == "li":
            _append_item(book, node)
        elif kind == "dt":
            line = book.add_paragraph()
            line.add_run(f"{_text(node)} \N{EN DASH} ").bold = True
            line.add_run(_text(node.getnext()))
        elif kind == "table":
            _append_table(book, node)
        elif kind == "figure":
            _append_figure(book, node, pictures)
        elif kind == "img":
            _append_picture(book, base64.b64decode(node.get("src").partition(",")[2]), "", 40)
        elif kind != "dd":
            _append(book, node, pictures)


def _append_item(book: Any, node: Any, style: str = "List Bullet") -> None:
    """Write an item of a list; those folded within it follow, one step further in."""
    book.add_paragraph(_plain("".join(_words(node, without="details"))), style=style)
    for item in node.iterfind("details/ul/li"):
        _append_item(book, item, "List Bullet 2")


def _append_table(book: Any, node: Any) -> None:
    """Write a table with its caption above; its heading is repeated on every page."""
    caption = book.add_paragraph(_text(node.find("caption")), style="Caption")
    caption.paragraph_format.keep_with_next = True
    (head,), body = node.iterfind("thead/tr"), node.findall("tbody/tr")
    shown = book.add_table(1 + len(body), len(head), style="Light List Accent 1")
    for row, elements in zip(shown.rows, (head, *body), strict=True):
        cells = row.cells
        for i, (cell, element) in enumerate(zip(cells, elements, strict=False)):
            _fill(cell, element, at_right=i > 0 and element.get("class") != "words")
        if len(elements) < len(cells):
            cells[0].merge(cells[-1])
    first = shown.rows[0]._tr.get_or_add_trPr()
    first.append(import_module("docx.oxml").OxmlElement("w:tblHeader"))
    book.add_paragraph()


def _fill(cell: Any, element: Any, *, at_right: bool) -> None:
    """Write a cell: its text, and smaller lines below; what is not determined in grey."""
    shared = import_module("docx.shared")
    (paragraph,) = cell.paragraphs
    paragraph.paragraph_format.space_after = shared.Pt(0)
    if at_right:
        paragraph.alignment = import_module("docx.enum.text").WD_ALIGN_PARAGRAPH.RIGHT
    lines = [_plain("".join(_words(element, without="small"))), *map(_text, element.iter("small"))]
    for i, line in enumerate(lines):
        run = paragraph.add_run()
        if i:
            run.add_break()
        run.add_text(line)
        run.font.size = shared.Pt(7 if i else 8)
        if element.get("class") == "unsure":
            run.font.color.rgb = shared.RGBColor.from_string("6B6B6B")


def _append_figure(book: Any, node: Any, pictures: Mapping[str, bytes]) -> None:
    """Write a drawing as its picture, with its caption; the title is what is read aloud."""
    svg = next(node.iter("svg"))
    name, title = svg.get("aria-labelledby", "").removesuffix("-title"), _text(svg.find("title"))
    pattern = r"decay_\d+_.*" if name == "decay" else re.escape(name.replace("-", "_"))
    found = sorted(stem for stem in pictures if re.fullmatch(pattern, stem))
    choices = node.getparent().xpath("input")
    chosen = next((i for i, one in enumerate(choices) if one.get("checked") is not None), 0)
    if choices:
        label = node.getparent().xpath("label")[chosen]
        book.add_paragraph().add_run(_text(label)).bold = True
    if chosen < len(found):
        _append_picture(book, pictures[found[chosen]], title, _WIDTH_MM - 2 * _MARGIN_MM)
    else:
        book.add_paragraph(f"[{title}]")
    book.add_paragraph(_text(node.find("figcaption")), style="Caption")


def _append_picture(book: Any, content: bytes, title: str, width_mm: int) -> None:
    shared, known = import_module("docx.shared"), import_module("docx.image.exceptions")
    line = book.add_paragraph()
    line.paragraph_format.keep_with_next = True
    try:
        shown = line.add_run().add_picture(io.BytesIO(content), width=shared.Mm(width_mm))
    except (known.UnrecognizedImageError, known.UnexpectedEndOfFileError) as error:
        what, found = "a picture of the report is damaged", f"{len(content)} bytes that are no PNG"
        needed, hint = "a whole PNG", "identify again, or remove the picture beside the report"
        where = title[:80]
        raise InputError(what, where=where, found=found, needed=needed, hint=hint) from error
    shown._inline.docPr.set("descr", title)


def _text(node: Any) -> str:
    return _plain("".join(node.itertext()))


def _words(node: Any, without: str) -> Iterator[str]:
    """Yield the texts of an element and of those in it, but of one kind."""
    yield node.text or ""
    for part in node:
        if part.tag not in (without, "svg"):
            yield from _words(part, without)
        yield part.tail or ""


def _plain(text: str) -> str:
    """Return a text on one line; letters that steer, which no document may hold, as ``?``."""
    text = re.sub(r"[^\S\N{NO-BREAK SPACE}]+", " ", text).strip()
    return "".join(c if c.isprintable() or c.isspace() else "?" for c in text)


def _undated(archive: bytes) -> bytes:
    """Return an archive with its files as they are, none of them with a date."""
    stream = io.BytesIO()
    with (
        zipfile.ZipFile(io.BytesIO(archive)) as old,
        zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as new,
    ):
        for name in old.namelist():
            new.writestr(zipfile.ZipInfo(name, _EARLIEST), old.read(name), zipfile.ZIP_DEFLATED)
    return stream.getvalue()
