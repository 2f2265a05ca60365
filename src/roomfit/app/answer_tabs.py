"""Identify and Report: a first answer, the full one, and what can be taken away of it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from html import escape
from pathlib import Path
from typing import Any, ClassVar
from urllib.parse import quote

from nicegui import ui

from roomfit.app import elements, project
from roomfit.app.jobs import Bench
from roomfit.base.bands import OCTAVES_HZ
from roomfit.report.wording import hertz

_NAMES = {
    project.FULL: ("full answer", "The report"),
    project.QUICK: ("first answer", "The report of the first answer"),
    project.MEAN: ("mean of the room, from decay times alone", "What the decay times say"),
}
_TIMES_ALONE = (
    "Decay times give the mean absorption of the room, and of no wall by itself: that takes "
    "recordings and positions, see Measurements."
)
_STALE = "The campaign has changed since this answer was made."
_OCTAVES = {f: hertz(f) for f in OCTAVES_HZ}
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
_CLIENT = {"client-pdf": "Two pages as PDF", "client-word": "The same as a Word file"}
_FILES = ("report.html", "absorption.csv", *project.MEAN_FILES)


class IdentifyTab(elements.Tab):
    """Bands, buttons that begin an identification, and the best answer that there is."""

    name: ClassVar[str] = "Identify"
    files: ClassVar[tuple[str, ...]] = (project.CAMPAIGN, *project.RESULTS, project.MEAN)

    def __init__(self, bench: Bench) -> None:
        super().__init__(bench)
        self.campaign_bands = (0.0, 0.0)  # as the campaign had them when it was read last
        self.bands: dict[str, Any] = {"low": 125.0, "high": 4000.0}
        with self.place:
            with ui.element("div").classes("bar panel"):
                with ui.element("div").classes("bar") as self.of_walls:
                    wide = "width: 9rem"
                    self.lowest = elements.field(
                        self.bands, "low", "Lowest octave", _OCTAVES, style=wide
                    )
                    self.highest = elements.field(
                        self.bands, "high", "Highest octave", _OCTAVES, style=wide
                    )
                    text = "First answer, then the full one"
                    both = partial(self._start, True, False)
                    ui.button(text, on_click=both).props("no-caps")
                    elements.quiet_button("First answer only", partial(self._start, True))
                    elements.quiet_button("Full answer only", partial(self._start, False))
                text = "Mean absorption from the decay times"
                self.times = elements.quiet_button(text, self.start_times)
                self.times_alone = ui.label(_TIMES_ALONE).classes("soft").style("flex: 1 1 20rem")
            with ui.element("div") as self.stale:
                elements.findings([{"severity": "warning", "sentence": _STALE}])
            self.stale.set_visibility(False)
            self.answer = ui.element("div").style("width: 100%")
            self.advice = elements.Advice(bench.folder)

    def _start(self, *quick: bool) -> None:
        folder = self.bench.folder
        with elements.saying_errors(self.answer):
            project.check_campaign_there(folder)
            project.set_bands(folder, self.bands["low"], self.bands["high"])
            for one in quick:
                self.bench.add("First answer" if one else "Full answer", "identify", quick=one)

    async def start_times(self) -> None:
        with elements.saying_errors(self.answer):
            await self.bench.ask("reverberation")
            await self.refresh()

    async def refresh(self) -> None:
        """Show the full answer, or else the first one, or else what decay times alone say."""
        folder = self.bench.folder
        if project.has_campaign(folder):  # at once: what is chosen while the answer is read stays
            bands = project.bands(folder)
            if set(bands) <= set(_OCTAVES) and self.campaign_bands != bands:
                self.campaign_bands = bands
                self.lowest.set_value(bands[0])
                self.highest.set_value(bands[1])
        found = project.best_result(folder)
        has_times = project.decay_times(folder) is not None
        is_all = project.decay_times(folder, alone=True) is not None
        self.times.set_visibility(has_times)
        self.times_alone.set_visibility(is_all)
        self.of_walls.set_visibility(not is_all)
        name = project.MEAN if has_times else project.FULL
        name = name if found is None else found.parent.name
        view = await self.newest(self.bench.ask("answer_view", name=name))
        if view is None:
            return
        self.stale.set_visibility(view.get("stale", False))
        self.advice.show(view.get("advised", []))
        made = view.get("made")
        if elements.emptied(self.answer, (name, made)):
            with self.answer:
                if made is None:
                    ui.label("No answer yet.").classes("soft")
                    return
                elements.heading(f"Absorption: {_NAMES[name][0]}")
                page = project.MEAN_FILES[0] if name == project.MEAN else "report.html"
                address = escape(f"files/{name}/{page}?{made:.0f}")
                elements.markup(f'<iframe class="report" title="Report" src="{address}"></iframe>')


class ReportTab(elements.Tab):
    """The files of the best answer, and exports that are made when they are asked for."""

    name: ClassVar[str] = "Report"
    files: ClassVar[tuple[str, ...]] = (*project.RESULTS, project.MEAN, project.TREATMENT)

    def __init__(self, bench: Bench) -> None:
        super().__init__(bench)
        with self.place:
            self.answer = ui.element("div").style("width: 100%")
            self.links = ui.element("div")
        self.exported: dict[str, str] = {}  # file by format, of the answer that is shown

    async def export(self, wanted: str) -> None:
        with elements.saying_errors(self.answer):
            file = self.exported[wanted] = await self.bench.ask("export", wanted=wanted)
            if self.answer.is_deleted:  # the page was closed meanwhile
                return
            with self.answer:  # what was clicked may have been drawn anew
                ui.navigate.to(f"/files/{quote(file)}?save=1")
            await self.refresh()

    async def refresh(self) -> None:
        """Show the files of the best answer."""
        mean = self.bench.folder / project.MEAN / project.MEAN_FILES[-1]
        found = project.best_result(self.bench.folder) or (mean if mean.is_file() else None)
        client = (self.bench.folder / project.TREATMENT / "client.html").is_file()
        if elements.emptied(self.answer, found and (found, found.stat().st_mtime_ns, client)):
            self.exported.clear()  # of the answer before
            with self.answer:
                self._show_answer(found)
        if elements.emptied(self.links, dict(self.exported)):
            with self.links:
                for file in self.exported.values():
                    elements.markup(
                        f'<a href="files/{escape(quote(file))}?save=1">{escape(file)}</a>'
                    )

    def _show_answer(self, found: Path | None) -> None:
        if found is None:
            ui.label("No answer yet: identify first.").classes("soft")
            return
        folder = found.parent.name
        elements.heading(_NAMES[folder][1])
        names = [n for n in _FILES if (found.parent / n).is_file()]
        links = [f'<a href="files/{folder}/{n}?save=1" download>Download {n}</a>' for n in names]
        text, how = "Open the report in a tab of its own", 'target="_blank" rel="noopener"'
        pages = [n for n in names if n.endswith(".html")]
        links += [f'<a href="files/{folder}/{n}" {how}>{text}</a>' for n in pages]
        elements.markup(f"<ul>{''.join(f'<li>{link}</li>' for link in links)}</ul>")
        if folder == project.MEAN:  # of no wall, so that there is nothing for other programs
            return
        self._show_buttons(_WHOLE)
        if (self.bench.folder / project.TREATMENT / "client.html").is_file():
            elements.heading("For the client: what to hang where")
            self._show_buttons(_CLIENT)
        elements.heading("Materials for other programs")
        self._show_buttons(_PROGRAMS)

    def _show_buttons(self, offered: Mapping[str, str]) -> None:
        with ui.element("div").classes("bar"):
            for wanted, text in offered.items():
                elements.quiet_button(text, partial(self.export, wanted))
