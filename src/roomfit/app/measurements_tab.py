"""Measurements: recordings, where sources and receivers stand, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from html import escape
from pathlib import Path
from typing import Any, ClassVar

from nicegui import ui

from roomfit.app import project, recordings
from roomfit.app.elements import (
    FileDrop,
    PlanView,
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
from roomfit.app.recordings import Positions
from roomfit.app.remedies import Advice
from roomfit.files.responses import RESPONSE_SUFFIXES
from roomfit.files.tables import TABLE_SUFFIXES
from roomfit.report.wording import hertz

_UNKNOWN = "-"
_EXAMPLE = "recordings/{source}_{receiver}.wav"
_HEIGHT_M = 1.2  # of what is dragged before its height is known


class MeasurementsTab:
    """A place for recordings, positions as fields and on a plan, and what is known of each file."""

    name: ClassVar[str] = "Measurements"
    files: ClassVar[tuple[str, ...]] = (project.CAMPAIGN, project.RECORDINGS, project.POSITIONS)

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.template = ""  # of the recordings' names, as the campaign has it
        self.positions: list[dict[str, Any]] = []  # as the campaign has them
        self.fields: dict[tuple[str, str], list[ui.number]] = {}  # x, y, z by kind and name
        with ui.element("div").classes("panel").style("margin-bottom: 0.75rem"):
            text = "Recordings, dropped here or chosen:"
            FileDrop(text, project.RECORDINGS, RESPONSE_SUFFIXES, self.name_recordings)
            with ui.element("div").classes("bar").style("margin: 0.5rem 0"):
                self.typed = ui.input("How they are named (left empty: by their names)")
                self.typed.props(f"outlined dense placeholder='{_EXAMPLE}'")
                self.typed.style("flex: 1 1 16rem")
                quiet_button("Use these names", self.use_template)
            text = "Table of positions (CSV, XLSX), dropped here or chosen:"
            words = "or paste positions: name, x, y, z"
            FileDrop(text, project.POSITIONS, TABLE_SUFFIXES, self.take_positions, words)
            with ui.expansion("Only decay times are known") as self.decay_times:
                text = "Table of decay times (CSV, XLSX), dropped here or chosen:"
                words = "or paste decay times: a line of octaves in Hz, a line for each position"
                FileDrop(text, project.DECAY_TIMES, TABLE_SUFFIXES, self.take_times, words)
        self.general = ui.element("div")
        self.advice = Advice(bench.folder)
        with ui.element("div").classes("panel two").style("margin: 0.75rem 0"):
            self.table = ui.element("div")
            with ui.element("div") as self.from_above:
                self.plan = PlanView(self.drop)
                text = "Drag what stands elsewhere. What has no place yet comes to "
                ui.label(f"{text}{_HEIGHT_M} m height.").classes("soft")
        self.listed = ui.element("div").classes("panel")
        self.questions = Questions(self.general)

    async def name_recordings(self, _: object = None) -> None:
        """Name recordings that were sent just now."""
        await self.write(recordings.name_recordings)

    async def use_template(self) -> None:
        """Name recordings by what is typed."""
        template = self.typed.value.strip()
        await self.write(lambda folder, known, _: recordings.set_template(folder, template, known))

    async def take_positions(self, names: list[str]) -> None:
        """Put what the table names where it says."""
        await self.write(recordings.name_recordings, names[-1])

    async def write(
        self, change: Callable[[Path, Positions, Positions], None], table: str = ""
    ) -> None:
        """Change the campaign by the tables of positions, and show what has become of it."""
        with saying_errors(self.general):
            known, moved = await self.bench.ask("table_positions", table=table)
            change(self.bench.folder, known, moved)
            await self.refresh()

    async def take_times(self, names: list[str]) -> None:
        """Have the mean absorption found from a table of decay times."""
        with saying_errors(self.general):
            project.set_decay_times(self.bench.folder, names[-1])
            await self.bench.ask("reverberation")
            await self.refresh()

    async def drop(self, kind: str, name: str, x: float, y: float) -> None:
        """Put a source or a receiver where it was dragged to; its height stays."""
        with saying_errors(self.general):
            before = self._position(kind, name)["position_m"]
            z = _HEIGHT_M if before is None else before[2]
            project.set_position(self.bench.folder, kind, name, (x, y, z))
            await self.refresh()

    async def type_position(self, kind: str, name: str) -> None:
        """Put a source or a receiver where its three fields say, once all are filled."""
        values = [field.value for field in self.fields[kind, name]]
        if any(value is None for value in values):
            return
        point = self._position(kind, name)
        if point["position_m"] is not None and list(map(float, point["position_m"])) == values:
            return
        with saying_errors(self.general):
            project.set_position(self.bench.folder, kind, name, values)
            point["position_m"] = [round(value, 4) for value in values]  # is not drawn anew
            await self.refresh()

    def _position(self, kind: str, name: str) -> dict[str, Any]:
        return next(p for p in self.positions if (p["kind"], p["name"]) == (kind, name))

    async def refresh(self) -> None:
        """Show positions, recordings, and what the check says of them."""
        is_current = self.questions.put()
        view = await self.bench.ask("recordings_view")
        if not is_current():
            return
        if emptied(self.general, view["findings"]):
            with self.general:
                findings(view["findings"])
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
        self.plan.show(view["plan"], self.positions, view["walls"])
        if not emptied(self.listed, (view["bands_hz"], view["rows"])):
            return
        with self.listed:
            heading("Recordings")
            if not view["rows"]:
                ui.label("None yet.").classes("soft")
            else:
                markup(recordings_html(view))

    def show_positions(self, positions: Sequence[dict[str, Any]]) -> None:
        """Draw the fields; while the names stay, only those of what has moved are written to."""
        stored = {(p["kind"], p["name"]): p["position_m"] for p in self.positions}
        typed = {key: [field.value for field in row] for key, row in self.fields.items()}
        self.positions = list(positions)
        named = [(p["kind"], p["name"]) for p in positions]
        if named != list(self.fields) or not named:
            self.draw_fields(named)
        for key, point in zip(named, positions, strict=True):
            place = point["position_m"]
            values = typed.get(key, [None] * 3) if place == stored.get(key) else place
            for field, value in zip(self.fields[key], values or [None] * 3, strict=True):
                field.set_value(value)

    def draw_fields(self, named: Sequence[tuple[str, str]]) -> None:
        """Draw three fields for each source and receiver, empty ones."""
        self.table.clear()
        self.fields.clear()
        with self.table:
            heading("Positions in m")
            if not named:
                ui.label("None yet: they come with the names of recordings.").classes("soft")
            with ui.element("div").classes("positions"):
                for kind, name in named:
                    ui.label(f"{kind[:-1]} {name}")
                    self.fields[kind, name] = [self._field(kind, name, word) for word in "xyz"]

    def _field(self, kind: str, name: str, word: str) -> ui.number:
        field = ui.number(word, step=0.01, format="%.3f").props("outlined dense")
        field.props["aria-label"] = f"{name} {word} in m"
        for event in ("blur", "keydown.enter"):
            field.on(event, partial(self.type_position, kind, name))
        return field


def recordings_html(view: Mapping[str, Any]) -> str:
    """Return what is known of each recording as a table, with its findings beside it."""
    bands = [hertz(f) for f in view["bands_hz"]]
    heads = ["Recording", "Source", "Receiver", "Onset (by geometry), ms"]
    heads += [*bands, *(["Findings"] if bands else [])]
    rows = []
    for row in view["rows"]:
        cells = [escape(row["file"]), escape(row["source"]), escape(row["receiver"])]
        if "range_db" not in row:
            rows.append(
                [*cells, _UNKNOWN, *[_UNKNOWN for _ in bands], *(["<div></div>"] if bands else [])]
            )
            continue
        cells.append(f"{_number(row['onset_ms'], 2)} ({_number(row['travel_ms'], 2)})")
        for range_db, noise_db, usable, t20 in zip(
            row["range_db"], row["noise_db"], row["usable"], row["has_t20"], strict=True
        ):
            word = "T20" if t20 else "usable" if usable else "of no use"
            cells.append(
                f"{_number(range_db, 0)} / {_number(noise_db, 0)}"
                f'<div class="{"small" if t20 else "small warning"}">{word}</div>'
            )
        notes = "".join(map(finding_html, row["notes"]))
        rows.append([*cells, f"<div>{notes}</div>"])
    caption = (
        "Per band: range of the decay / peak above the noise, in dB; what it is good for"
        if bands
        else "By name"
    )
    return table_html(caption, heads, rows)


def _number(value: float | None, decimals: int) -> str:
    return _UNKNOWN if value is None else f"{value:.{decimals}f}"
