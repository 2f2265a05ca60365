"""Report: what can be taken away."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from html import escape
from pathlib import Path
from urllib.parse import quote

from nicegui import ui

from roomfit.app import project
from roomfit.app.elements import emptied, heading, markup, said
from roomfit.app.server import Bench
from roomfit.errors import InputError

_PROGRAMS = {
    "csv": "CSV",
    "catt": "CATT-Acoustic",
    "odeon": "ODEON",
    "isimpa": "I-Simpa",
    "raven": "RAVEN",
    "gltf": "glTF",
    "pyroomacoustics": "pyroomacoustics",
}
_WHOLE = {"pdf": "The report as PDF", "excel": "All of it as an Excel workbook"}
_FILES = ("report.html", "absorption.csv", "result.json")


def build(bench: Bench) -> Callable[[], Awaitable[None]]:
    """Draw the tab; return what draws it anew."""
    whole = ui.element("div").style("width: 100%")
    links = ui.element("div")
    made: dict[str, list[str]] = {}

    async def export(wanted: str) -> None:
        try:
            made[wanted] = await bench.ask("export", wanted=wanted)
        except InputError as error:
            said(error, whole)
            return
        if whole.is_deleted:  # the page was closed meanwhile
            return
        if len(made[wanted]) == 1:
            with whole:  # what was clicked may have been drawn anew
                ui.navigate.to(f"/files/{quote(made[wanted][0])}?save=1")
        await refresh()

    async def refresh() -> None:
        found = project.best_result(bench.folder)
        if emptied(whole, found and (found, found.stat().st_mtime_ns)):
            made.clear()  # of the answer before
            with whole:
                show_answer(found)
        if emptied(links, dict(made)):
            with links:
                for file in [file for files in made.values() for file in files]:
                    markup(f'<a href="/files/{escape(quote(file))}?save=1">{escape(file)}</a>')

    def show_answer(found: Path | None) -> None:
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
        show_buttons(_WHOLE)
        heading("Materials for other programs")
        show_buttons(_PROGRAMS)

    def show_buttons(offered: Mapping[str, str]) -> None:
        with ui.element("div").classes("bar"):
            for wanted, text in offered.items():
                ui.button(text, on_click=lambda wanted=wanted: export(wanted)).props(
                    "no-caps outline color=quiet"
                )

    return refresh
