"""The report as PDF, by WeasyPrint (the extra ``pdf``): no browser, and nothing but the page."""

from __future__ import annotations

import logging
import re
from importlib import import_module
from typing import Any

from roomfit.base.door import quiet
from roomfit.base.errors import InputError

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
        document = library.HTML(string=_plain(page), url_fetcher=fetcher)
        return bytes(document.write_pdf())


def _plain(page: str) -> str:
    """Return the page as a library reads it that applies no style sheet of a page to its drawings.

    Colours that are variables there become those that each use names, the light ones, and of the
    pairs whose curves lie over each other the one that is chosen stays.
    """
    chosen = _CHOSEN.search(page)

    def shown(curves: re.Match[str]) -> str:
        hidden = chosen is not None and curves[1] != chosen[1]
        return curves[0] + ' display="none"' * hidden

    return _CURVES.sub(shown, _VARIABLE.sub(r"\1", page))
