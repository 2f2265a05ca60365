"""The page: a bar with what is at work, six tabs, and a look at the folder twice a second."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from nicegui import ui

from roomfit.app.answer_tabs import IdentifyTab, ReportTab
from roomfit.app.elements import Tab, emptied, field, heading, quiet_button, saying_errors
from roomfit.app.jobs import Bench, Job
from roomfit.app.measurements_tab import MeasurementsTab, MeasureTab
from roomfit.app.room_tab import RoomTab
from roomfit.app.what_if_tab import WhatIfTab

_STYLE = Path(__file__).with_name("style.css").read_text(encoding="utf-8")
_LOOK_EVERY_S = 0.5
_COLOURS = {"as the system": None, "light": False, "dark": True}
TABS: tuple[type[Tab], ...] = (
    RoomTab,
    MeasureTab,
    MeasurementsTab,
    IdentifyTab,
    WhatIfTab,
    ReportTab,
)
"""A new tab is a class in a module of its own, a name here, and its questions in `tasks.TASKS`."""


def build_page(bench: Bench) -> None:
    """Declare the page of a project."""

    @ui.page("/", title=f"{bench.folder.name} - roomfit")
    async def index() -> None:
        Page(bench)


class Page:
    """A visit: the bar, the work that is under way, and the tabs; it looks at both by itself."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.shown: dict[str, tuple[int, ...]] = {}  # stamp of a tab's files when it was drawn
        self.tell: list[Callable[[], None]] = []  # what says how far each job is
        ui.add_css(_STYLE)
        ui.colors(primary="#17558a", negative="#8f1b17", positive="#1c6b30")
        dark = ui.dark_mode(None)
        with ui.element("header").classes("bar"):
            heading("roomfit", 1)
            ui.label(str(bench.folder)).classes("soft")
            own: dict[str, str] = {"dark": "as the system"}
            style = "margin-left: auto; min-width: 9rem"
            field(
                own, "dark", "Colours", [*_COLOURS], style=style,
                then=lambda: dark.set_value(_COLOURS[own["dark"]]),
            )  # fmt: skip
        self.work = ui.element("section").props('aria-label="Work" role="status"').classes("bar")
        with ui.tabs().props("dense no-caps outside-arrows mobile-arrows align=left") as self.names:
            for tab in TABS:
                ui.tab(tab.name)
        self.tabs: dict[str, Tab] = {}
        panels = ui.tab_panels(self.names, value=TABS[0].name, animated=False, keep_alive=True)
        with panels.classes("w-full"):
            for tab in TABS:
                with ui.tab_panel(tab.name).style("padding: 0.5rem 0"):
                    self.tabs[tab.name] = tab(bench)
        self.names.on_value_change(self._look)
        ui.timer(_LOOK_EVERY_S, self._look_at_work)
        ui.timer(_LOOK_EVERY_S, self._look)  # of its own: a tab may take minutes to be ready

    async def _look(self, _: object = None) -> None:
        tab = self.tabs[str(self.names.value)]
        stamp = self.bench.stamp(tab.files)
        if self.shown.get(tab.name) == stamp:
            return
        self.shown[tab.name] = stamp
        with saying_errors(self.work):
            await tab.refresh()

    def _look_at_work(self) -> None:
        jobs = [j for j in self.bench.jobs if j.state in ("waiting", "running")]
        jobs += [j for j in self.bench.jobs if j.state == "failed"][-1:]
        if emptied(self.work, [(j, j.state) for j in jobs]):
            with self.work:
                self.tell = [self.show_job(job) for job in jobs]
        for one in self.tell:
            one()

    def show_job(self, job: Job) -> Callable[[], None]:
        """Draw a job; return what tells how far it is, without drawing it anew."""
        has_failed = job.state == "failed"
        with ui.element("div").classes("job panel" + (" serious" if has_failed else "")):
            text = ui.label().style("white-space: pre-wrap")
            part = ui.linear_progress(show_value=False).style("width: 12rem")
            part.props["aria-label"] = job.label
            part.set_visibility(job.state == "running")
            word = "Close" if has_failed else "Cancel"
            quiet_button(word, partial(self.bench.cancel, job)).props("dense padding='2px 10px'")

        def tell() -> None:
            text.set_text(f"{job.label}: {job.error}" if has_failed else job.text())
            part.set_value(round(job.fraction, 2))

        return tell
