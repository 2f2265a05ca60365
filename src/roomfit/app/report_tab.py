"""Report: what can be taken away."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from html import escape
from pathlib import Path
from typing import ClassVar
from urllib.parse import quote

from nicegui import ui

from roomfit.app import project
from roomfit.app.elements import emptied, heading, markup, quiet_button, saying_errors
from roomfit.app.jobs import Bench

_PROGRAMS = {
    "csv": "CSV",
    "catt": "CATT-Acoustic",
    "odeon": "ODEON",
    "isimpa": "I-Simpa",
    "pyroomacoustics": "pyroomacoustics",
}
_WHOLE = {
    "pdf": "The report as PDF",
    "word": "The report as a Word file",
    "excel": "All of it as an Excel workbook",
}
_FILES = ("report.html", "absorption.csv", *project.MEAN_FILES)
_HEADINGS = {
    project.FULL: "The report",
    project.QUICK: "The report of the first answer",
    project.MEAN: "What the decay times say",
}


class ReportTab:
    """The files of the best answer, and exports that are made when they are asked for."""

    name: ClassVar[str] = "Report"
    files: ClassVar[tuple[str, ...]] = (*project.RESULTS, project.MEAN)

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.answer = ui.element("div").style("width: 100%")
        self.links = ui.element("div")
        self.exported: dict[str, list[str]] = {}  # files by format, of the answer that is shown

    async def export(self, wanted: str) -> None:
        """Have an export made, and download it where it is one file."""
        with saying_errors(self.answer):
            files = self.exported[wanted] = await self.bench.ask("export", wanted=wanted)
            if self.answer.is_deleted:  # the page was closed meanwhile
                return
            if len(files) == 1:
                with self.answer:  # what was clicked may have been drawn anew
                    ui.navigate.to(f"/files/{quote(files[0])}?save=1")
            await self.refresh()

    async def refresh(self) -> None:
        """Show the files of the best answer."""
        mean = self.bench.folder / project.MEAN / project.MEAN_FILES[-1]
        found = project.best_result(self.bench.folder) or (mean if mean.is_file() else None)
        if emptied(self.answer, found and (found, found.stat().st_mtime_ns)):
            self.exported.clear()  # of the answer before
            with self.answer:
                self.show_answer(found)
        if emptied(self.links, dict(self.exported)):
            with self.links:
                for file in [file for files in self.exported.values() for file in files]:
                    markup(f'<a href="/files/{escape(quote(file))}?save=1">{escape(file)}</a>')

    def show_answer(self, found: Path | None) -> None:
        """Draw links to the files of an answer, and buttons for its exports."""
        if found is None:
            ui.label("No answer yet: identify first.").classes("soft")
            return
        folder = found.parent.name
        heading(_HEADINGS[folder])
        names = [n for n in _FILES if (found.parent / n).is_file()]
        pages = [n for n in names if n.endswith(".html")]
        markup(
            "<ul>"
            + "".join(
                f'<li><a href="/files/{folder}/{n}?save=1" download>Download {n}</a></li>'
                for n in names
            )
            + "".join(
                f'<li><a href="/files/{folder}/{n}" target="_blank" rel="noopener">'
                "Open the report in a tab of its own</a></li>"
                for n in pages
            )
            + "</ul>"
        )
        if folder == project.MEAN:  # of no wall, so that there is nothing for other programs
            return
        self.show_buttons(_WHOLE)
        heading("Materials for other programs")
        self.show_buttons(_PROGRAMS)

    def show_buttons(self, offered: Mapping[str, str]) -> None:
        """Draw a button for each export."""
        with ui.element("div").classes("bar"):
            for wanted, text in offered.items():
                quiet_button(text, partial(self.export, wanted))
