"""The page: a bar with what is at work, five tabs, and a look at the folder twice a second."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from functools import partial
from pathlib import Path

from nicegui import ui

from roomfit.app import identify_tab, measurements_tab, report_tab, room_tab, what_if_tab
from roomfit.app.elements import emptied, heading, said
from roomfit.app.jobs import Job
from roomfit.app.server import Bench
from roomfit.errors import InputError

_STYLE = Path(__file__).with_name("style.css").read_text(encoding="utf-8")
_TABS: tuple[tuple[str, Callable[[Bench], Callable[[], Awaitable[None]]]], ...] = (
    ("Room", room_tab.build),
    ("Measurements", measurements_tab.build),
    ("Identify", identify_tab.build),
    ("What if", what_if_tab.build),
    ("Report", report_tab.build),
)
_LOOK_EVERY_S = 0.5


def build_page(bench: Bench) -> None:
    """Declare the page of a project."""

    @ui.page("/", title=f"{bench.folder.name} - roomfit")
    async def index() -> None:
        ui.add_css(_STYLE)
        ui.colors(primary="#17558a", negative="#8f1b17", positive="#1c6b30")
        dark = ui.dark_mode(None)
        with ui.element("header").classes("bar"):
            heading("roomfit", 1)
            ui.label(str(bench.folder)).classes("soft")
            ui.select(
                {"auto": "as the system", "light": "light", "dark": "dark"},
                value="auto",
                label="Colours",
                on_change=lambda e: dark.set_value({"light": False, "dark": True}.get(e.value)),
            ).props("dense outlined").style("margin-left:auto; min-width: 9rem")
        work = ui.element("section").props('aria-label="Work" role="status"').classes("bar")
        with ui.tabs().props("dense no-caps outside-arrows mobile-arrows align=left") as tabs:
            for name, _ in _TABS:
                ui.tab(name)
        refresh: dict[str, Callable[[], Awaitable[None]]] = {}
        with ui.tab_panels(tabs, value="Room", animated=False, keep_alive=True).classes("w-full"):
            for name, build in _TABS:
                with ui.tab_panel(name).style("padding: 0.5rem 0"):
                    refresh[name] = build(bench)
        shown: dict[str, tuple[float, ...]] = {}

        async def look(_: object = None) -> None:
            name, stamp = str(tabs.value), bench.stamp()
            if shown.get(name) == stamp:
                return
            shown[name] = stamp
            try:
                await refresh[name]()
            except InputError as error:
                said(error, work)

        tell: list[Callable[[], None]] = []

        def look_at_work() -> None:
            at_work = ("waiting", "running", "failed")
            now = [(j.number, j.state) for j in bench.jobs.listed if j.state in at_work]
            if emptied(work, now):
                with work:
                    tell[:] = _show_work(bench)
            for one in tell:
                one()

        tabs.on_value_change(look)
        ui.timer(_LOOK_EVERY_S, look_at_work)
        ui.timer(_LOOK_EVERY_S, look)  # of its own: a tab may take minutes to be ready


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
    """Return what a job does, how far it is and how long it will take, in words.

    Examples
    --------
    >>> job_text(Job(1, "Full answer", "identify", {}))
    'Full answer: waiting'
    """
    if job.state != "running":
        return f"{job.label}: {job.state}"
    text = f"{job.label}: {job.stage}, {100 * job.fraction:.0f} %, {job.seconds:.0f} s"
    left = job.remaining_s
    return text if left is None else f"{text}, about {left:.0f} s to go"
