"""The room: from a file or three lengths, its surfaces and their materials, its faults."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from html import escape
from typing import Any, ClassVar

from nicegui import ui

from roomfit.app import project
from roomfit.app.elements import (
    FileDrop,
    Questions,
    RoomView,
    emptied,
    finding_html,
    heading,
    markup,
    saying_errors,
)
from roomfit.app.jobs import Bench
from roomfit.files.rooms import READERS
from roomfit.formats.model import METRES_PER_UNIT
from roomfit.materials.catalogue import catalogue, suggested_entries

_MOST_SURFACES = 500  # that are listed; all are drawn


class RoomTab:
    """The room in three dimensions, its surfaces, and what the chosen one is made of."""

    name: ClassVar[str] = "Room"
    files: ClassVar[tuple[str, ...]] = (project.CAMPAIGN,)

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.room: dict[str, Any] = {}  # as it was read last
        self.chosen = -1  # number of the surface
        self.lines: list[ui.element] = []
        self.start = RoomStart(bench, self.refresh)
        self.both = ui.element("div").classes("two")
        with self.both:
            with ui.element("div"):
                self.view = RoomView(self.pick)
                self.facts = ui.label().classes("soft")
                self.faults = ui.element("div")
            with ui.element("div").classes("panel"):
                self.surfaces = ui.element("div")
                self.details = ui.element("div")
        self.questions = Questions(self.both)

    def pick(self, surface: int) -> None:
        """Choose a surface by its number."""
        self.chosen = surface
        self.view.point_at(surface, None)
        self.show_surfaces()

    async def refresh(self) -> None:
        """Show the room, or how to begin where there is none."""
        if self.both.is_deleted:
            return
        has = project.has_campaign(self.bench.folder)
        self.both.set_visibility(has)
        self.start.show(has)
        if not has:
            return
        is_current = self.questions.put()
        found = await self.bench.ask("room_view")
        if not is_current():
            return
        names = [s["name"] for s in self.room.get("surfaces", ())]
        if [s["name"] for s in found["surfaces"]] != names:
            self.chosen = -1
            self.view.point_at(-1, None)
        self.room = found
        self.view.show(found)
        free = found["mean_free_path_m"]
        path = "" if free is None else f", mean free path {free:.2f} m"
        words = "can be traced" if found["traceable"] else "cannot be traced"
        size = f"{found['volume_m3']:.1f} m³, {found['surface_m2']:.1f} m²"
        self.facts.set_text(f"{size}{path}; {words}.")
        if emptied(self.faults, found["findings"]):
            self.show_faults()
        self.show_surfaces()

    def show_faults(self) -> None:
        """List what is doubtful, each with buttons that show the first places of it."""
        with self.faults:
            for finding in self.room["findings"]:
                with ui.element("div").classes("bar"):
                    markup(finding_html(finding)).style("flex: 1 1 16rem")
                    for place in finding["about"].get("points_m", [])[:3]:
                        text = "Show " + ", ".join(f"{x:.2f}" for x in place)
                        ui.button(text, on_click=partial(self.view.point_at, -1, place)).props(
                            "outline dense no-caps color=quiet"
                        )

    def show_surfaces(self) -> None:
        """List the surfaces, and show the one that is chosen."""
        own = self.room["surfaces"][self.chosen] if self.chosen >= 0 else None
        materials = {m["name"]: m for m in self.room["materials"]}
        colours = [m["colour"] for m in self.room["materials"]]
        listed = self.room["surfaces"][:_MOST_SURFACES]
        if emptied(self.surfaces, (listed, colours)):
            self.lines.clear()
            with self.surfaces:
                heading("Surfaces")
                group = ui.element("div").classes("surfaces")
                with group.props('role="group" aria-label="Surfaces"'):
                    for i, surface in enumerate(listed):
                        colour = colours[surface["material_index"]]
                        self.lines.append(self.surface_line(i, surface, colour))
        for i, line in enumerate(self.lines):
            line.props["aria-pressed"] = "true" if i == self.chosen else "false"
        material = {} if own is None else materials.get(own["material"], {})
        if emptied(self.details, (own, list(materials), material)):
            with self.details:
                if own is not None:
                    self.show_details(own, list(materials), material)
                    return
                text = "Choose a surface, here or in the picture, to say what it is made of."
                ui.label(text).classes("soft").style("margin-top: 0.5rem")

    def surface_line(self, number: int, surface: dict[str, Any], colour: str) -> ui.element:
        """Draw a surface as a line of the list, a button."""
        line = ui.element("button").classes("surface").props('type="button"')
        line.on("click", lambda: self.pick(number))
        with line:
            markup(
                f'<span class="swatch" style="background:{escape(colour)}"></span>'
                f"{escape(surface['name'])}"
            )
            ui.label(f"{surface['material']}, {surface['area_m2']:.1f} m²").classes("right")
        return line

    def show_details(
        self, surface: dict[str, Any], names: Sequence[str], material: dict[str, Any]
    ) -> None:
        """Draw the material of a surface, and what the catalogue has for it, both to be chosen."""
        folder = self.bench.folder
        heading(f"Surface {surface['name']}")
        ui.select(
            list(names),
            value=surface["material"],
            label="Material (choose, or type a new name and Enter)",
            with_input=True,
            new_value_mode="add-unique",
            on_change=lambda e: self.change(
                lambda: project.set_surface_material(folder, surface["name"], str(e.value))
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
                on_change=lambda e: self.change(
                    lambda: project.set_prior(folder, material["name"], e.value)
                ),
            ).props("outlined dense").style("width: 100%")
        if material["prior"] in entries:
            entry = next(e for e in catalogue().entries if e.name == material["prior"])
            values = ", ".join(f"{a:.2f}" for a in entry.absorption)
            ui.label(f"Absorption of the catalogue, 63 to 8000 Hz: {values}").classes("small")

    async def change(self, action: Callable[[], None]) -> None:
        """Change the campaign, and show what has become of the room."""
        with saying_errors(self.both):
            action()
            found = await self.bench.ask("room_view")
            names = [m["name"] for m in found["materials"]]
            project.forget_unused_materials(self.bench.folder, names)
            await self.refresh()


class RoomStart:
    """How a project gets its room, or another one: a file, three lengths, or the demo project."""

    def __init__(self, bench: Bench, then: Callable[[], Awaitable[None]]) -> None:
        self.bench = bench
        self.then = then  # what shows the room
        self.unit: str | None = None  # of the file; None: as it says
        self.space = ""  # which room of it
        self.file = ""  # that was sent last, whose unit may be in doubt
        self.place = ui.element("div").style("width: 100%")

    def show(self, has_campaign: bool) -> None:
        """Draw it, unless it is drawn for a project of this kind already."""
        if not emptied(self.place, has_campaign):
            return
        self.unit, self.space, self.file = None, "", ""
        with self.place:
            if has_campaign:
                with ui.expansion("Another room").classes("panel").style("margin-bottom: 0.75rem"):
                    self.from_file()
                    self.from_lengths()
                return
            with ui.element("div").classes("two"):
                with ui.element("div").classes("panel"):
                    heading("Begin with your room")
                    self.from_file()
                    heading("or type a box")
                    self.from_lengths()
                with ui.element("div").classes("panel"):
                    heading("or look around first")
                    ui.label(
                        "A box of 6.1 x 4.7 x 2.8 m with six materials, two sources and four "
                        "receivers; its recordings are simulated, with noise and errors of "
                        "position."
                    )
                    ui.button("Open the demo project", on_click=self.demo).props("no-caps")

    def from_file(self) -> None:
        """Draw a place for a room file, and its unit."""
        FileDrop("Room file, dropped here or chosen:", "room", READERS, self.use_file)
        with ui.element("div").classes("bar").style("margin: 0.5rem 0"):
            ui.select(
                {None: "as the file says", **{u: u for u in METRES_PER_UNIT}},
                value=None,
                label="Unit",
                on_change=self.choose_unit,
            ).props("outlined dense").style("width: 11rem")
            name = ui.input("Which room, of several").props("outlined dense")
            for event in ("blur", "keydown.enter"):
                name.on(event, lambda: self.choose_space(name.value))

    def from_lengths(self) -> None:
        """Draw three fields for the lengths of a box."""
        with ui.element("div").classes("bar"):
            fields = [
                ui.number(f"{name} (m)", value=value, min=0.1, step=0.1)
                .props("outlined dense")
                .style("width: 8rem")
                for name, value in (("Length x", 6.0), ("Width y", 5.0), ("Height z", 3.0))
            ]
            ui.button(
                "Use this box", on_click=lambda: self.use(shoebox=[f.value or 0.0 for f in fields])
            ).props("no-caps")

    async def choose_unit(self, event: Any) -> None:
        """Keep the unit for the next file, and for one that waits for it."""
        self.unit = event.value
        if self.file:
            await self.use(file=self.file)

    async def choose_space(self, name: str) -> None:
        """Keep the name of a room for the next file, and for one that waits for it."""
        if name.strip() != self.space:
            self.space = name.strip()
            if self.file:
                await self.use(file=self.file)

    async def use_file(self, names: list[str]) -> None:
        """Give the project the last of the files that were sent."""
        self.file = names[-1]
        await self.use(file=self.file)

    async def use(self, **room: Any) -> None:
        """Give the project a room, see `project.set_room`, and show it."""
        with saying_errors(self.place):
            own = {"unit": self.unit, "space": self.space, **room}
            await self.bench.ask("set_room", **own)
            await self.then()

    def demo(self) -> None:
        """Have the demo project simulated into the folder."""
        own = {"folder": str(self.bench.folder)}
        self.bench.jobs.add("Demo project", "demo", own, ((0.0, "simulating"),))
