"""Measurements: recordings, where sources and receivers stand, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from html import escape
from typing import Any

from nicegui import ui

from roomfit.app import project
from roomfit.app.elements import (
    FileDrop,
    PlanView,
    emptied,
    finding_html,
    findings,
    heading,
    markup,
    said,
    table_html,
)
from roomfit.app.server import Bench
from roomfit.errors import InputError
from roomfit.io.responses import RESPONSE_SUFFIXES
from roomfit.report.wording import short_hertz

_UNKNOWN = "-"
_HEIGHT_M = 1.2  # of what is dragged before its height is known


def build(bench: Bench) -> Callable[[], Awaitable[None]]:
    """Draw the tab; return what draws it anew."""
    shape = {"shape": f"{project.RECORDINGS}/{project.SHAPE}"}
    shown: list[Any] = []
    fields: dict[tuple[str, str], list[ui.number]] = {}
    latest = [0]  # number of the view that was asked for last

    async def sent(_: list[str]) -> None:
        await use_shape()

    async def use_shape() -> None:
        try:
            project.set_recordings(bench.folder, shape["shape"])
            await refresh()
        except InputError as error:
            said(error, general)

    with ui.element("div").classes("panel").style("margin-bottom: 0.75rem"):
        FileDrop("Recordings, dropped here or chosen:", "recordings", RESPONSE_SUFFIXES, sent)
        with ui.element("div").classes("bar").style("margin-top: 0.5rem"):
            ui.input(
                "How they are named",
                value=shape["shape"],
                on_change=lambda e: shape.update(shape=e.value),
            ).props("outlined dense").style("flex: 1 1 16rem")
            ui.button("Use these names", on_click=use_shape).props("no-caps outline color=quiet")
    general = ui.element("div")
    with ui.element("div").classes("panel two").style("margin: 0.75rem 0"):
        positions = ui.element("div")
        with ui.element("div"):
            plan = PlanView(lambda kind, name, x, y: dropped(kind, name, x, y))
            text = (
                f"Drag what stands elsewhere. What has no place yet comes to {_HEIGHT_M} m height."
            )
            ui.label(text).classes("soft")
    recordings = ui.element("div").classes("panel")

    async def dropped(kind: str, name: str, x: float, y: float) -> None:
        try:
            own = next(p for p in shown if p["kind"] == kind and p["name"] == name)
            z = _HEIGHT_M if own["position_m"] is None else own["position_m"][2]
            project.set_position(bench.folder, kind, name, (x, y, z))
            await refresh()
        except InputError as error:
            said(error, general)

    async def moved(kind: str, name: str) -> None:
        values = [field.value for field in fields[kind, name]]
        if any(value is None for value in values):
            return
        point = next(p for p in shown if p["kind"] == kind and p["name"] == name)
        if point["position_m"] is not None and list(map(float, point["position_m"])) == values:
            return
        try:
            project.set_position(bench.folder, kind, name, values)
            point["position_m"] = [round(value, 4) for value in values]  # is not drawn anew
            await refresh()
        except InputError as error:
            said(error, general)

    def show_positions(points: list[Any]) -> None:
        """Draw the fields; while the names stay, only those of what has moved are written to."""
        stored = {(p["kind"], p["name"]): p["position_m"] for p in shown}
        typed = {key: [field.value for field in row] for key, row in fields.items()}
        shown[:] = points
        named = [(p["kind"], p["name"]) for p in points]
        if named != list(fields) or not named:
            positions.clear()
            fields.clear()
            with positions:
                heading("Positions in m")
                if not named:
                    ui.label("None yet: they come with the names of recordings.").classes("soft")
                with ui.element("div").classes("positions"):
                    for key in named:
                        fields[key] = position_fields(*key)
        for key, point in zip(named, points, strict=True):
            place = point["position_m"]
            values = typed.get(key, [None] * 3) if place == stored.get(key) else place
            for field, value in zip(fields[key], values or [None] * 3, strict=True):
                field.set_value(value)

    def position_fields(kind: str, name: str) -> list[ui.number]:
        ui.label(f"{kind[:-1]} {name}")
        row = []
        for word in "xyz":
            field = ui.number(word, step=0.01, format="%.3f").props("outlined dense")
            field.props["aria-label"] = f"{name} {word} in m"
            for event in ("blur", "keydown.enter"):
                field.on(event, lambda: moved(kind, name))
            row.append(field)
        return row

    async def refresh() -> None:
        latest[0] += 1
        own = latest[0]
        view = await bench.ask("recordings_view", shape=shape["shape"])
        if general.is_deleted or own != latest[0]:  # the page was closed, or asked once more
            return
        if emptied(general, view["findings"]):
            with general:
                findings(view["findings"])
        show_positions(view["positions"])
        plan.set_visibility(bool(view["plan"] and shown))
        plan.show(view["plan"], shown)
        if not emptied(recordings, (view["bands_hz"], view["rows"])):
            return
        with recordings:
            heading("Recordings")
            if not view["rows"]:
                ui.label("None yet.").classes("soft")
            else:
                markup(recordings_html(view))

    return refresh


def recordings_html(view: Mapping[str, Any]) -> str:
    """Return what is known of each recording as a table, with its findings beside it."""
    bands = [short_hertz(f) for f in view["bands_hz"]]
    heads = ["Recording", "Source", "Receiver", "Onset (by geometry), ms"]
    heads += [f"{b} Hz" for b in bands] + (["Findings"] if bands else [])
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
