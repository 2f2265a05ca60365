"""The room: from a file or three lengths, its surfaces and their materials, its faults."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from html import escape
from typing import Any

from nicegui import ui

from roomfit.app import project
from roomfit.app.elements import (
    FileDrop,
    RoomView,
    emptied,
    finding_html,
    heading,
    markup,
    said,
)
from roomfit.app.server import Bench
from roomfit.errors import InputError
from roomfit.io.rooms import READERS
from roomfit.io.rooms.model import METRES_PER_UNIT
from roomfit.materials.catalogue import catalogue, suggested_entries


def build(bench: Bench) -> Callable[[], Awaitable[None]]:
    """Draw the tab; return what draws it anew."""
    room: dict[str, Any] = {}
    chosen = {"surface": -1}
    lines: list[ui.element] = []
    latest = [0]  # number of the view that was asked for last
    start = ui.element("div").style("width: 100%")

    def pick(surface: int) -> None:
        chosen["surface"] = surface
        view.point_at(surface, None)
        show_surfaces()

    both = ui.element("div").classes("two")
    with both:
        with ui.element("div"):
            view = RoomView(pick)
            facts = ui.label().classes("soft")
            faults = ui.element("div")
        with ui.element("div").classes("panel"):
            surfaces = ui.element("div")
            details = ui.element("div")

    def show_surfaces() -> None:
        colours = [m["colour"] for m in room["materials"]]
        if emptied(surfaces, (room["surfaces"][:500], colours)):
            lines.clear()
            with surfaces:
                heading("Surfaces")
                group = ui.element("div").classes("surfaces")
                with group.props('role="group" aria-label="Surfaces"'):
                    for i, own in enumerate(room["surfaces"][:500]):
                        lines.append(surface_line(i, own, colours[own["material_index"]]))
        for i, line in enumerate(lines):
            line.props["aria-pressed"] = "true" if i == chosen["surface"] else "false"
        own = room["surfaces"][chosen["surface"]] if chosen["surface"] >= 0 else None
        names = [m["name"] for m in room["materials"]]
        material: dict[str, Any] = next(
            (m for m in room["materials"] if own and m["name"] == own["material"]), {}
        )
        if emptied(details, (own, names, material)) and own:
            with details:
                show_details(own, names, material)

    def surface_line(i: int, own: dict[str, Any], colour: str) -> ui.element:
        line = ui.element("button").classes("surface").props('type="button"')
        line.on("click", lambda: pick(i))
        with line:
            markup(
                f'<span class="swatch" style="background:{escape(colour)}"></span>'
                f"{escape(own['name'])}"
            )
            ui.label(f"{own['material']}, {own['area_m2']:.1f} m²").classes("right")
        return line

    def show_details(surface: dict[str, Any], names: list[str], material: dict[str, Any]) -> None:
        heading(f"Surface {surface['name']}")
        ui.select(
            names,
            value=surface["material"],
            label="Material (choose, or type a new name and Enter)",
            with_input=True,
            new_value_mode="add-unique",
            on_change=lambda e: change(
                lambda: project.set_surface_material(bench.folder, surface["name"], str(e.value))
            ),
        ).props("outlined dense").style("width: 100%; margin-bottom: 0.6rem")
        entries = {e.name: f"{e.name}: {e.description}" for e in catalogue().entries}
        likely = [n for n in suggested_entries(material["name"]) if n in entries]
        ordered = {n: entries[n] for n in (*likely, *(n for n in entries if n not in likely))}
        with ui.element("div").style("width: 100%"):
            ui.select(
                ordered,
                value=material["prior"] if material["prior"] in entries else None,
                label=f"What {material['name']} is (search the catalogue)",
                with_input=True,
                clearable=True,
                on_change=lambda e: change(
                    lambda: project.set_prior(bench.folder, material["name"], e.value)
                ),
            ).props("outlined dense").style("width: 100%")
        if material["prior"] in entries:
            entry = next(e for e in catalogue().entries if e.name == material["prior"])
            values = ", ".join(f"{a:.2f}" for a in entry.absorption)
            ui.label(f"Absorption of the catalogue, 63 to 8000 Hz: {values}").classes("small")

    async def change(action: Callable[[], None]) -> None:
        try:
            action()
            found = await bench.ask("room_view")
            names = [m["name"] for m in found["materials"]]
            project.forget_unused_materials(bench.folder, names)
            await refresh()
        except InputError as error:
            said(error, both)

    def show_faults() -> None:
        with faults:
            for finding in room["findings"]:
                with ui.element("div").classes("bar"):
                    markup(finding_html(finding)).style("flex: 1 1 16rem")
                    for place in finding["points_m"][:3]:
                        text = "Show " + ", ".join(f"{x:.2f}" for x in place)
                        ui.button(
                            text, on_click=lambda place=place: view.point_at(-1, place)
                        ).props("outline dense no-caps color=quiet")

    async def refresh() -> None:
        if both.is_deleted:
            return
        has = project.has_campaign(bench.folder)
        both.set_visibility(has)
        if not start.default_slot.children or has != room.get("has"):
            start.clear()
            with start:
                _show_start(bench, start, refresh)
        room["has"] = has
        if not has:
            return
        latest[0] += 1
        own = latest[0]
        found = await bench.ask("room_view")
        if both.is_deleted or own != latest[0]:  # the page was closed, or asked once more
            return
        if [s["name"] for s in found["surfaces"]] != [s["name"] for s in room.get("surfaces", ())]:
            chosen["surface"] = -1
            view.point_at(-1, None)
        room.update(found)
        view.show(room)
        free = room["mean_free_path_m"]
        path = "" if free is None else f", mean free path {free:.2f} m"
        words = "can be traced" if room["traceable"] else "cannot be traced"
        facts.set_text(f"{room['volume_m3']:.1f} m³, {room['surface_m2']:.1f} m²{path}; {words}.")
        if emptied(faults, room["findings"]):
            show_faults()
        show_surfaces()

    return refresh


def _show_start(bench: Bench, start: ui.element, refresh: Callable[[], Awaitable[None]]) -> None:
    unit: dict[str, str | None] = {"unit": None}

    async def use(**given: Any) -> None:
        try:
            await bench.ask("set_room", unit=unit["unit"], **given)
            await refresh()
        except InputError as error:
            said(error, start)

    async def sent(names: list[str]) -> None:
        await use(file=names[-1])

    def demo() -> None:
        bench.jobs.add(
            "Demo project", "demo", {"folder": str(bench.folder)}, ((0.0, "simulating"),)
        )

    def shoebox() -> None:
        with ui.element("div").classes("bar"):
            boxes = [
                ui.number(f"{name} (m)", value=value, min=0.1, step=0.1)
                .props("outlined dense")
                .style("width: 8rem")
                for name, value in (("Length x", 6.0), ("Width y", 5.0), ("Height z", 3.0))
            ]
            ui.button(
                "Use this box", on_click=lambda: use(shoebox=[box.value or 0.0 for box in boxes])
            ).props("no-caps")

    def from_file() -> None:
        FileDrop("Room file, dropped here or chosen:", "room", READERS, sent)
        ui.select(
            {None: "as the file says", **{u: u for u in METRES_PER_UNIT}},
            value=None,
            label="Unit",
            on_change=lambda e: unit.update(unit=e.value),
        ).props("outlined dense").style("width: 11rem; margin: 0.5rem 0")

    if project.has_campaign(bench.folder):
        with ui.expansion("Another room").classes("panel").style("margin-bottom: 0.75rem"):
            from_file()
            shoebox()
        return
    with ui.element("div").classes("two"):
        with ui.element("div").classes("panel"):
            heading("Begin with your room")
            from_file()
            heading("or type a box")
            shoebox()
        with ui.element("div").classes("panel"):
            heading("or look around first")
            ui.label(
                "A box of 6.1 x 4.7 x 2.8 m with six materials, two sources and four receivers; "
                "its recordings are simulated, with noise and errors of position."
            )
            ui.button("Open the demo project", on_click=demo).props("no-caps")
