"""The page: a bar with what is at work, six tabs, and a look at the folder twice a second."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import ClassVar, Protocol

from nicegui import ui

from roomfit.app.elements import emptied, heading, saying_errors
from roomfit.app.identify_tab import IdentifyTab
from roomfit.app.jobs import Bench, Job
from roomfit.app.measure_tab import MeasureTab
from roomfit.app.measurements_tab import MeasurementsTab
from roomfit.app.report_tab import ReportTab
from roomfit.app.room_tab import RoomTab
from roomfit.app.what_if_tab import WhatIfTab

_STYLE = Path(__file__).with_name("style.css").read_text(encoding="utf-8")
_LOOK_EVERY_S = 0.5


class Tab(Protocol):
    """A tab: drawn where it is made, and drawn anew when one of its files has changed."""

    name: ClassVar[str]
    files: ClassVar[tuple[str, ...]]  # within the project's folder; folders, too

    def __init__(self, bench: Bench) -> None: ...

    async def refresh(self) -> None:
        """Ask for what is to be shown now, and show it."""


TABS: tuple[type[Tab], ...] = (
    RoomTab,
    MeasureTab,
    MeasurementsTab,
    IdentifyTab,
    WhatIfTab,
    ReportTab,
)
"""A new tab is a class in a module of its own, a name here, and its questions in `views.TASKS`."""


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
        self.show_bar()
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
        self.names.on_value_change(self.look)
        ui.timer(_LOOK_EVERY_S, self.look_at_work)
        ui.timer(_LOOK_EVERY_S, self.look)  # of its own: a tab may take minutes to be ready

    def show_bar(self) -> None:
        """Draw the folder's name and the choice of colours."""
        dark = ui.dark_mode(None)
        with ui.element("header").classes("bar"):
            heading("roomfit", 1)
            ui.label(str(self.bench.folder)).classes("soft")
            ui.select(
                {"auto": "as the system", "light": "light", "dark": "dark"},
                value="auto",
                label="Colours",
                on_change=lambda e: dark.set_value({"light": False, "dark": True}.get(e.value)),
            ).props("dense outlined").style("margin-left:auto; min-width: 9rem")

    async def look(self, _: object = None) -> None:
        """Draw the open tab anew where its files have changed."""
        tab = self.tabs[str(self.names.value)]
        stamp = self.bench.stamp(tab.files)
        if self.shown.get(tab.name) == stamp:
            return
        self.shown[tab.name] = stamp
        with saying_errors(self.work):
            await tab.refresh()

    def look_at_work(self) -> None:
        """Show what is at work, and how far it is."""
        at_work = ("waiting", "running", "failed")
        now = [(j.number, j.state) for j in self.bench.jobs.listed if j.state in at_work]
        if emptied(self.work, now):
            with self.work:
                self.tell = _show_work(self.bench)
        for one in self.tell:
            one()


def _show_work(bench: Bench) -> list[Callable[[], None]]:
    """Draw what is at work; return what tells how far each is, without drawing it anew."""
    tell: list[Callable[[], None]] = []
    for job in [j for j in bench.jobs.listed if j.state in ("waiting", "running")]:
        with ui.element("div").classes("job panel"):
            text = ui.label(job_text(job))
            part = ui.linear_progress(show_value=False).style("width: 12rem")
            part.props["aria-label"] = job.label
            part.set_visibility(job.state == "running")
            tell.append(partial(_tell, job, text, part))
            ui.button("Cancel", on_click=lambda job=job: bench.jobs.cancel(job)).props(
                "outline dense no-caps color=quiet padding='2px 10px'"
            )
    for job in [j for j in bench.jobs.listed if j.state == "failed"][-1:]:
        with ui.element("div").classes("job panel serious"):
            ui.label(f"{job.label}: {job.error}").style("white-space: pre-wrap")
            ui.button("Close", on_click=lambda job=job: _forget(job)).props(
                "outline dense no-caps color=quiet"
            )
    return tell


def _tell(job: Job, text: ui.label, part: ui.linear_progress) -> None:
    text.set_text(job_text(job))
    part.set_value(round(job.fraction, 2))


def _forget(job: Job) -> None:
    job.state = "cancelled"


def job_text(job: Job) -> str:
    """Return what a job does, how far it is and how long it will take, in words."""
    if job.state != "running":
        return f"{job.label}: {job.state}"
    text = f"{job.label}: {job.stage}, {100 * job.fraction:.0f} %, {job.seconds:.0f} s"
    left = job.remaining_s
    return text if left is None else f"{text}, about {left:.0f} s to go"
