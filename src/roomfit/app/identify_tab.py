"""Identify: a first answer, the full one, absorption with intervals, measured beside predicted."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from html import escape
from typing import Any

from nicegui import ui

from roomfit.app import project
from roomfit.app.elements import (
    emptied,
    finding_html,
    findings,
    heading,
    markup,
    said,
    table_html,
)
from roomfit.app.server import Bench
from roomfit.bands import OCTAVES_HZ
from roomfit.errors import InputError
from roomfit.report.wording import short_hertz

_STAGES = ((0.0, "reading the files"), (1e-6, "tracing and fitting"), (0.95, "drawing"))
_NAMES = {project.FULL: "full answer", project.QUICK: "first answer"}


def build(bench: Bench) -> Callable[[], Awaitable[None]]:
    """Draw the tab; return what draws it anew."""
    read = [(0.0, 0.0)]  # what the campaign said of them last
    latest = [0]  # number of the view that was asked for last

    def start(*, quick: bool) -> None:
        try:
            if not project.has_campaign(bench.folder):
                raise InputError("there is no project yet", hint="begin with the room")
            project.set_bands(bench.folder, fields[0].value, fields[1].value)
        except InputError as error:
            said(error, answer)
            return
        own = {"folder": str(bench.folder), "quick": quick}
        label = "First answer" if quick else "Full answer"
        bench.jobs.add(label, "identify", own, _STAGES)

    def both() -> None:
        start(quick=True)
        start(quick=False)

    octaves = {f: f"{short_hertz(f)} Hz" for f in OCTAVES_HZ}
    with ui.element("div").classes("bar panel"):
        fields = [
            ui.select(octaves, label=word, value=value).props("outlined dense").style("width: 9rem")
            for word, value in (("Lowest octave", 125.0), ("Highest octave", 4000.0))
        ]
        ui.button("First answer, then the full one", on_click=both).props("no-caps")
        ui.button("First answer only", on_click=lambda: start(quick=True)).props(
            "no-caps outline color=quiet"
        )
        ui.button("Full answer only", on_click=lambda: start(quick=False)).props(
            "no-caps outline color=quiet"
        )
    with ui.element("div") as stale:
        text = "The campaign has changed since this answer was made."
        findings([{"severity": "warning", "sentence": text}])
    stale.set_visibility(False)
    answer = ui.element("div").style("width: 100%")

    async def refresh() -> None:
        found = project.best_result(bench.folder)
        name = project.FULL if found is None else found.parent.name
        latest[0] += 1
        own = latest[0]
        view = await bench.ask("result_view", name=name)
        if answer.is_deleted or own != latest[0]:  # the page was closed, or asked once more
            return
        if project.has_campaign(bench.folder):
            low, high = project.bands(bench.folder)
            # what is chosen and not started yet stays while the campaign's bands do
            if low in octaves and high in octaves and read[0] != (low, high):
                read[0] = (low, high)
                for field, value in zip(fields, (low, high), strict=True):
                    field.set_value(value)
        stale.set_visibility(view is not None and view.pop("stale"))
        if not emptied(answer, (name, view)):
            return
        with answer:
            if view is None:
                ui.label("No answer yet.").classes("soft")
                return
            heading(f"Absorption: {_NAMES[name]}")
            with ui.element("div").classes("two").style("align-items: start"):
                with ui.element("div"):
                    markup(absorption_html(view))
                    understood = ui.expansion("The room as it was understood", value=True)
                    with understood.classes("panel").style("margin-top: 0.75rem"):
                        for sentence in view["plan"]:
                            ui.label(sentence)
                with ui.element("div"):
                    findings([f for f in view["findings"] if not f["materials"]])
            heading("Measured against predicted, and everything else")
            src = f"/files/{name}/report.html?{view['made']:.0f}"
            markup(f'<iframe class="report" title="Report" src="{escape(src)}"></iframe>')

    return refresh


def absorption_html(view: Mapping[str, Any]) -> str:
    """Return absorption with its intervals as a table, findings beside their material."""
    heads = ["Material", *(f"{short_hertz(f)} Hz" for f in view["bands_hz"])]
    has_notes = any(f["materials"] for f in view["findings"])
    heads += ["Findings"] if has_notes else []
    rows = []
    for name, own in view["materials"].items():
        cells = [f'{escape(name)}<div class="small">{own["area_m2"]:.1f} m²</div>']
        for value, low, high, sure in zip(
            own["absorption"], own["lower95"], own["upper95"], own["identifiable"], strict=True
        ):
            number = f"{value:.2f}" if sure else f'<span class="unsure">{value:.2f} ?</span>'
            cells.append(f'{number}<div class="small">{low:.2f}-{high:.2f}</div>')
        notes = [f for f in view["findings"] if name in f["materials"]]
        cells += [f"<div>{''.join(map(finding_html, notes))}</div>"] if has_notes else []
        rows.append(cells)
    return table_html("Absorption with its 95 % interval; ? is not identifiable", heads, rows)
