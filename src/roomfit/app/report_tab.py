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
    "raven": "RAVEN",
    "gltf": "glTF",
    "pyroomacoustics": "pyroomacoustics",
}
_WHOLE = {
    "pdf": "The report as PDF",
    "word": "The report as a Word file",
    "excel": "All of it as an Excel workbook",
}
_FILES = ("report.html", "absorption.csv", "result.json")


class ReportTab:
    """The files of the best answer, and exports that are made when they are asked for."""

    name: ClassVar[str] = "Report"
    files: ClassVar[tuple[str, ...]] = project.RESULTS

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
        found = project.best_result(self.bench.folder)
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
        heading("The report" if folder == project.FULL else "The report of the first answer")
        names = [n for n in _FILES if (found.parent / n).is_file()]
        markup(
            "<ul>"
            + "".join(
                f'<li><a href="/files/{folder}/{n}?save=1" download>Download {n}</a></li>'
                for n in names
            )
            + f'<li><a href="/files/{folder}/report.html" target="_blank" rel="noopener">'
            "Open the report in a tab of its own</a></li></ul>"
        )
        self.show_buttons(_WHOLE)
        heading("Materials for other programs")
        self.show_buttons(_PROGRAMS)

    def show_buttons(self, offered: Mapping[str, str]) -> None:
        """Draw a button for each export."""
        with ui.element("div").classes("bar"):
            for wanted, text in offered.items():
                quiet_button(text, partial(self.export, wanted))
