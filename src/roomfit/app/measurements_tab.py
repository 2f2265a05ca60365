"""Measurements: sweeps played here, recordings, positions, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from nicegui import ui

from roomfit.app import elements, project
from roomfit.app.jobs import Bench
from roomfit.files.draft import Positions
from roomfit.files.responses import RESPONSE_SUFFIXES
from roomfit.files.tables import TABLE_SUFFIXES
from roomfit.report.wording import hertz

_EXAMPLE = "recordings/{source}_{receiver}.wav"
_HEIGHT_M = 1.2  # of what is dragged before its height is known
_ASKED: dict[str, Any] = {
    "source": "S1",
    "receiver": "R1",
    "seconds": 6,
    "silence_s": 3,
    "repetitions": 3,
    "again": False,
}
_LABELS = {
    "source": "Source",
    "receiver": "Receiver",
    "seconds": "Sweep (s)",
    "silence_s": "Silence (s)",
    "repetitions": "Repetitions",
    "again": "Measure again: replace this pair's response",
}


class MeasureTab(elements.Tab):
    """Two names, how long, a recorder, and what the last response is good for."""

    name: ClassVar[str] = "Measure"
    files: ClassVar[tuple[str, ...]] = (project.RECORDINGS,)

    def __init__(self, bench: Bench) -> None:
        super().__init__(bench)
        self.asked = dict(_ASKED)
        with self.place:
            with ui.element("div").classes("panel"):
                elements.heading("Measure an impulse response")
                ui.label(
                    "Stand away, keep still, and set the loudspeaker as loud as it plays cleanly. "
                    "The response is written as recordings/SOURCE_RECEIVER.wav."
                ).classes("soft")
                with ui.element("div").classes("bar").style("margin: 0.5rem 0"):
                    for key, label in _LABELS.items():
                        elements.field(self.asked, key, label, style="width: 7rem", then=self._ask)
                self.recorder = elements.Recorder("measured", self.show, asked=dict(self.asked))
            self.quality = ui.element("div").style("margin: 0.75rem 0").props('role="status"')
            self.measured = ui.label().classes("soft")

    def _ask(self) -> None:
        self.recorder.tell(asked=dict(self.asked))

    async def show(self, quality: dict[str, Any]) -> None:
        """Show how good the response is that was measured just now."""
        if not elements.emptied(self.quality, quality):
            return
        with self.quality, ui.element("div").classes("panel"):
            elements.heading(f"{quality['source']} to {quality['receiver']}")
            doubts = [f"Measure again: {reason}." for reason in quality["again"]]
            doubts += [quality["not_named"]] if "not_named" in quality else []
            elements.findings({"severity": "warning", "sentence": sentence} for sentence in doubts)
            if not quality["again"]:
                ui.label("It suffices from 125 Hz to 4 kHz.")
            caption = (
                f"Peak {quality['peak_dbfs']:.1f} dBFS, {quality['n_clipped']} samples clipped, "
                f"background {quality['noise_dbfs']:.1f} dBFS"
            )
            columns = (quality[key] for key in ("bands_hz", "range_db", "suffices_for"))
            rows = [
                [hertz(f), f"{range_db:.0f} dB", good or "too short"]
                for f, range_db, good in zip(*columns, strict=True)
            ]
            elements.show_table(caption, ("Octave", "Range of the decay", "Suffices for"), rows)

    async def refresh(self) -> None:
        """Show which responses there are."""
        names = [p.name for p in project.listed(self.bench.folder, project.RECORDINGS)]
        self.measured.set_text(f"In recordings: {', '.join(names) or 'none yet'}")


class MeasurementsTab(elements.Tab):
    """A place for recordings, positions as fields and on a plan, and what is known of each file."""

    name: ClassVar[str] = "Measurements"
    files: ClassVar[tuple[str, ...]] = (project.CAMPAIGN, project.RECORDINGS, project.POSITIONS)

    def __init__(self, bench: Bench) -> None:
        super().__init__(bench)
        self.naming: dict[str, Any] = {"template": ""}
        self.template = ""  # of the recordings' names, as the campaign has it
        self.positions: list[dict[str, Any]] = []  # as the campaign has them
        self.fields: dict[tuple[str, str], list[ui.input]] = {}  # x, y, z by kind and name
        with self.place:
            with ui.element("div").classes("panel").style("margin-bottom: 0.75rem"):
                self._draw_files()
            self.general = ui.element("div")
            self.advice = elements.Advice(bench.folder)
            with ui.element("div").classes("panel two").style("margin: 0.75rem 0"):
                self.table = ui.element("div")
                with ui.element("div") as self.from_above:
                    nothing: dict[str, Any] = {"edges": [], "points": [], "walls": []}
                    self.plan = elements.PlanView("dropped", self._drop, plan=nothing)
                    text = "Drag what stands elsewhere. What has no place yet comes to "
                    ui.label(f"{text}{_HEIGHT_M} m height.").classes("soft")
            self.listed = ui.element("div").classes("panel")

    def _draw_files(self) -> None:
        text = "Recordings, dropped here or chosen:"
        elements.file_drop(text, project.RECORDINGS, RESPONSE_SUFFIXES, self._name_recordings)
        with ui.element("div").classes("bar").style("margin: 0.5rem 0"):
            text = "How they are named (left empty: by their names)"
            self.typed = elements.field(self.naming, "template", text, style="flex: 1 1 16rem")
            self.typed.props(f"placeholder='{_EXAMPLE}'")
            elements.quiet_button("Use these names", self._use_template)
        text = "Table of positions (CSV, XLSX), dropped here or chosen:"
        words = "or paste positions: name, x, y, z"
        elements.file_drop(text, project.POSITIONS, TABLE_SUFFIXES, self._take_positions, words)
        with ui.expansion("Only decay times are known") as self.decay_times:
            text = "Table of decay times (CSV, XLSX), dropped here or chosen:"
            words = "or paste decay times: a line of octaves in Hz, a line for each position"
            elements.file_drop(text, project.DECAY_TIMES, TABLE_SUFFIXES, self._take_times, words)

    async def _name_recordings(self, _: object = None) -> None:
        await self._write(project.name_recordings)

    async def _use_template(self) -> None:
        template = self.naming["template"].strip()
        await self._write(lambda folder, known, _: project.set_template(folder, template, known))

    async def _take_positions(self, names: list[str]) -> None:
        await self._write(project.name_recordings, names[-1])

    async def _write(
        self, change: Callable[[Path, Positions, Positions], None], table: str = ""
    ) -> None:
        """Change the campaign by the tables of positions, and show what has become of it."""
        with elements.saying_errors(self.general):
            known, moved = await self.bench.ask("table_positions", table=table)
            change(self.bench.folder, known, moved)
            await self.refresh()

    async def _take_times(self, names: list[str]) -> None:
        with elements.saying_errors(self.general):
            project.set_decay_times(self.bench.folder, names[-1])
            await self.bench.ask("reverberation")
            await self.refresh()

    async def _drop(self, said: Mapping[str, Any]) -> None:
        with elements.saying_errors(self.general):
            before = self._position(said["kind"], said["name"])["position_m"]
            place_m = (*map(float, said["at"]), _HEIGHT_M if before is None else before[2])
            project.set_position(self.bench.folder, said["kind"], said["name"], place_m)
            await self.refresh()

    async def type_position(self, kind: str, name: str) -> None:
        """Put a source or a receiver where its three fields say, once all are filled."""
        values = [elements.typed(one.value) for one in self.fields[kind, name]]
        point = self._position(kind, name)
        if None in values or point["position_m"] == values:
            return
        with elements.saying_errors(self.general):
            project.set_position(self.bench.folder, kind, name, values)
            point["position_m"] = [round(value, 4) for value in values]  # is not drawn anew
            await self.refresh()

    def _position(self, kind: str, name: str) -> dict[str, Any]:
        """Return what the campaign has of a source or a receiver."""
        return next(p for p in self.positions if (p["kind"], p["name"]) == (kind, name))

    async def refresh(self) -> None:
        """Show positions, recordings, and what the check says of them."""
        view = await self.newest(self.bench.ask("recordings_view"))
        if view is None:
            return
        if elements.emptied(self.general, view["findings"]):
            with self.general:
                elements.findings(view["findings"])
        self.advice.show(view["advised"])
        if view["template"] != self.template:  # what is half typed stays
            self.template = view["template"]
            self.typed.set_value(self.template)
        times = view["decay_times"]
        text = "A table of T30 in s, as from an older report, and a room; no position is needed."
        text = f"{times} is used; see Identify and What if." if times else text
        self.decay_times.props["caption"] = text
        self.show_positions(view["positions"])
        self.from_above.set_visibility(bool(view["plan"] and self.positions))
        points = [dict(point) for point in self.positions]  # what is typed changes them
        self.plan.tell(plan={"edges": view["plan"], "points": points, "walls": view["walls"]})
        if elements.emptied(self.listed, (view["page"], view["rows"])):
            with self.listed:
                elements.heading("Recordings")
                rows = [
                    [row[key] for key in ("file", "source", "receiver")] for row in view["rows"]
                ]
                if view["page"]:
                    page, table = (
                        view["page"],
                        f"files/{project.CHECKED}/room_parameters.csv?save=1",
                    )
                    elements.markup(f'<a href="{table}" download>Download room_parameters.csv</a>')
                    elements.markup(f'<iframe class="report" title="Decays" src="{page}"></iframe>')
                elif rows:
                    elements.show_table("By name", ("Recording", "Source", "Receiver"), rows)
                else:
                    ui.label("None yet.").classes("soft")

    def show_positions(self, positions: Sequence[dict[str, Any]]) -> None:
        """Draw the fields; while the names stay, only those of what has moved are written to."""
        stored = {(p["kind"], p["name"]): p["position_m"] for p in self.positions}
        typed = {key: [one.value for one in row] for key, row in self.fields.items()}
        self.positions = list(positions)
        named = [(p["kind"], p["name"]) for p in positions]
        if named != list(self.fields) or not named:
            self._draw_fields(named)
        for key, point in zip(named, positions, strict=True):
            place = point["position_m"]
            values = typed.get(key, [None] * 3) if place == stored.get(key) else place
            for one, value in zip(self.fields[key], values or [None] * 3, strict=True):
                one.set_value(value)

    def _draw_fields(self, named: Sequence[tuple[str, str]]) -> None:
        self.table.clear()
        self.fields.clear()
        with self.table:
            elements.heading("Positions in m")
            if not named:
                ui.label("None yet: they come with the names of recordings.").classes("soft")
            with ui.element("div").classes("positions"):
                for kind, name in named:
                    ui.label(f"{kind[:-1]} {name}")
                    row = self.fields[kind, name] = []
                    for word in "xyz":
                        spoken = f"{name} {word} in m"
                        row.append(elements.field({}, word, word, spoken=spoken))
                        elements.on_entered(row[-1], partial(self.type_position, kind, name))
