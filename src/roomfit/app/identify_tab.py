"""Identify: a first answer, the full one, absorption with intervals, measured beside predicted."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any, ClassVar

from nicegui import ui

from roomfit.app import project
from roomfit.app.elements import (
    Questions,
    emptied,
    finding_html,
    findings,
    heading,
    markup,
    quiet_button,
    saying_errors,
    table_html,
)
from roomfit.app.jobs import Bench
from roomfit.app.remedies import Advice
from roomfit.base.bands import OCTAVES_HZ
from roomfit.base.errors import InputError
from roomfit.report.wording import hertz

_STAGES = ((0.0, "reading the files"), (1e-6, "tracing and fitting"), (0.95, "drawing"))
_NAMES = {
    project.FULL: "full answer",
    project.QUICK: "first answer",
    project.MEAN: "mean of the room, from decay times alone",
}
_TIMES_ALONE = (
    "Decay times give the mean absorption of the room in each of their bands, with its interval, "
    "and of no wall by itself: that takes recordings and positions, see Measurements. "
    "What other walls would do is in What if."
)
_OCTAVES = {f: hertz(f) for f in OCTAVES_HZ}


class IdentifyTab:
    """Bands, buttons that begin an identification, and the best answer that there is."""

    name: ClassVar[str] = "Identify"
    files: ClassVar[tuple[str, ...]] = (project.CAMPAIGN, *project.RESULTS, project.MEAN)

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.campaign_bands = (0.0, 0.0)  # as the campaign had them when it was read last
        with ui.element("div").classes("bar panel"):
            with ui.element("div").classes("bar") as self.of_walls:
                self.lowest = _octave("Lowest octave", 125.0)
                self.highest = _octave("Highest octave", 4000.0)
                text = "First answer, then the full one"
                ui.button(text, on_click=self.start_both).props("no-caps")
                quiet_button("First answer only", lambda: self.start(quick=True))
                quiet_button("Full answer only", lambda: self.start(quick=False))
            self.times = quiet_button("Mean absorption from the decay times", self.start_times)
            self.times_alone = ui.label(_TIMES_ALONE).classes("soft").style("flex: 1 1 20rem")
        with ui.element("div") as self.stale:
            text = "The campaign has changed since this answer was made."
            findings([{"severity": "warning", "sentence": text}])
        self.stale.set_visibility(False)
        self.advice = Advice(bench.folder)
        self.answer = ui.element("div").style("width: 100%")
        self.questions = Questions(self.answer)

    def start(self, *, quick: bool) -> None:
        """Put an identification in the chosen bands into the queue."""
        folder = self.bench.folder
        with saying_errors(self.answer):
            if not project.has_campaign(folder):
                what = "there is no project yet"
                needed, hint = "a room", "begin with the room"
                raise InputError(what, found="no campaign in the folder", needed=needed, hint=hint)
            project.set_bands(folder, self.lowest.value, self.highest.value)
            label = "First answer" if quick else "Full answer"
            self.bench.jobs.add(label, "identify", {"folder": str(folder), "quick": quick}, _STAGES)

    def start_both(self) -> None:
        """Put both answers into the queue, the quick one first."""
        self.start(quick=True)
        self.start(quick=False)

    async def start_times(self) -> None:
        """Find what decay times alone say, at once: it takes a tenth of a second."""
        with saying_errors(self.answer):
            await self.bench.ask("reverberation")
            await self.refresh()

    async def refresh(self) -> None:
        """Show the full answer, or else the first one, or else what decay times alone say."""
        self.show_bands()  # at once: what is chosen while the answer is read stays
        found = project.best_result(self.bench.folder)
        has_times = project.decay_times(self.bench.folder) is not None
        is_all = project.decay_times(self.bench.folder, alone=True) is not None
        self.times.set_visibility(has_times)
        self.times_alone.set_visibility(is_all)
        self.of_walls.set_visibility(not is_all)
        name = project.MEAN if has_times else project.FULL
        name = name if found is None else found.parent.name
        is_current = self.questions.put()
        view = await self.bench.ask("result_view", name=name)
        if not is_current():
            return
        self.stale.set_visibility(view is not None and view.pop("stale"))
        self.advice.show([] if view is None else view.pop("advised"))
        if emptied(self.answer, (name, view)):
            with self.answer:
                if view is None:
                    ui.label("No answer yet.").classes("soft")
                else:
                    _show_answer(name, view)

    def show_bands(self) -> None:
        """Choose the campaign's bands; what is chosen and not started stays while they do."""
        if not project.has_campaign(self.bench.folder):
            return
        low, high = project.bands(self.bench.folder)
        if low in _OCTAVES and high in _OCTAVES and self.campaign_bands != (low, high):
            self.campaign_bands = (low, high)
            self.lowest.set_value(low)
            self.highest.set_value(high)


def _octave(label: str, value_hz: float) -> ui.select:
    field = ui.select(_OCTAVES, label=label, value=value_hz)
    return field.props("outlined dense").style("width: 9rem")


def _show_answer(name: str, view: Mapping[str, Any]) -> None:
    heading(f"Absorption: {_NAMES[name]}")
    if view.get("mean"):
        markup(mean_html(view))
        _show_page(f"/files/{name}/{project.MEAN_FILES[0]}?{view['made']:.0f}")
        return
    with ui.element("div").classes("two").style("align-items: start"):
        with ui.element("div"):
            markup(absorption_html(view))
            understood = ui.expansion("The room as it was understood", value=True)
            with understood.classes("panel").style("margin-top: 0.75rem"):
                for sentence in view["plan"]:
                    ui.label(sentence)
        with ui.element("div"):
            if view["usable"]:
                markup(usable_html(view["usable"]))
            findings([f for f in view["findings"] if not f["beside"]])
    heading("Measured against predicted, and everything else")
    _show_page(f"/files/{name}/report.html?{view['made']:.0f}")


def _show_page(address: str) -> None:
    markup(f'<iframe class="report" title="Report" src="{escape(address)}"></iframe>')


def mean_html(view: Mapping[str, Any]) -> str:
    """Return the mean absorption of a room with its interval as a table."""
    cells = [
        f'{a:.2f}<div class="small">{low:.2f}-{high:.2f}</div>' for a, low, high in view["mean"]
    ]
    heads = ["", *(hertz(f) for f in view["bands_hz"])]
    return table_html("Mean absorption of the room, 95 % interval", heads, [["room mean", *cells]])


def usable_html(sentences: list[str]) -> str:
    """Return what still holds of an answer, some of which is void."""
    items = "".join(f"<li>{escape(sentence)}</li>" for sentence in sentences)
    return f'<section class="panel"><h2>What remains usable</h2><ul>{items}</ul></section>'


def absorption_html(view: Mapping[str, Any]) -> str:
    """Return absorption with its intervals as a table, findings beside their material."""
    heads = ["Material", *(hertz(f) for f in view["bands_hz"])]
    has_notes = any(f["beside"] for f in view["findings"])
    heads += ["Findings"] if has_notes else []
    rows = []
    for name, own in view["materials"].items():
        cells = [f'{escape(name)}<div class="small">{own["area_m2"]:.1f} m²</div>']
        for value, low, high, sure in zip(
            own["absorption"], own["lower95"], own["upper95"], own["identifiable"], strict=True
        ):
            number = f"{value:.2f}" if sure else f'<span class="unsure">{value:.2f} ?</span>'
            cells.append(f'{number}<div class="small">{low:.2f}-{high:.2f}</div>')
        notes = [f for f in view["findings"] if name in f["beside"]]
        cells += [f"<div>{''.join(map(finding_html, notes))}</div>"] if has_notes else []
        rows.append(cells)
    return table_html("Absorption with its 95 % interval; ? is not identifiable", heads, rows)
