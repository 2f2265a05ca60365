"""The room: from a file or three lengths, its surfaces and their materials, its faults."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from functools import partial
from html import escape
from typing import Any, ClassVar

from nicegui import ui

from roomfit.app import elements, project
from roomfit.app.jobs import Bench
from roomfit.files.rooms import READERS
from roomfit.formats.model import METRES_PER_UNIT
from roomfit.materials.catalogue import catalogue, suggested_entries

_MOST_SURFACES = 500  # that are listed; all are drawn
_LENGTHS_M = {"Length x (m)": 6.0, "Width y (m)": 5.0, "Height z (m)": 3.0}
_DEMO = (
    "A box of 6.1 x 4.7 x 2.8 m with six materials, two sources and four receivers; its recordings "
    "are simulated, with noise and errors of position."
)


def catalogue_words() -> dict[str, str]:
    """Return what a choice among the entries of the catalogue shows, by their names."""
    return {e.name: f"{e.name}: {e.description}" for e in catalogue().entries}


class RoomTab(elements.Tab):
    """The room in three dimensions, its surfaces, and what the chosen one is made of."""

    name: ClassVar[str] = "Room"
    files: ClassVar[tuple[str, ...]] = (project.CAMPAIGN,)

    def __init__(self, bench: Bench) -> None:
        super().__init__(bench)
        self.room: dict[str, Any] = {}  # as it was read last
        self.chosen = -1  # number of the surface
        self.lines: list[ui.element] = []
        with self.place:
            self.start = RoomStart(bench, self.refresh)
            self.both = ui.element("div").classes("two")
        with self.both:
            with ui.element("div"):
                self.view = elements.RoomView(
                    "pick", lambda number: self.pick(int(number)), selected=-1
                )
                self.facts = ui.label().classes("soft")
                self.faults = ui.element("div")
            with ui.element("div").classes("panel"):
                self.surfaces = ui.element("div")
                self.details = ui.element("div")

    def pick(self, surface: int) -> None:
        """Choose a surface by its number."""
        self.chosen = surface
        self.view.tell(selected=surface, mark=None)
        self._show_surfaces()

    async def refresh(self) -> None:
        """Show the room, or how to begin where there is none."""
        if self.both.is_deleted:
            return
        has = project.has_campaign(self.bench.folder)
        self.both.set_visibility(has)
        self.start.show(has)
        if not has:
            return
        found = await self.newest(self.bench.ask("room_view"))
        if found is None:
            return
        names = [s["name"] for s in self.room.get("surfaces", ())]
        if [s["name"] for s in found["surfaces"]] != names:
            self.chosen = -1
            self.view.tell(selected=-1, mark=None)
        self.room = found
        self.view.tell(room={key: own for key, own in found.items() if key != "findings"})
        free = found["mean_free_path_m"]
        path = "" if free is None else f", mean free path {free:.2f} m"
        words = "can be traced" if found["traceable"] else "cannot be traced"
        size = f"{found['volume_m3']:.1f} m³, {found['surface_m2']:.1f} m²"
        self.facts.set_text(f"{size}{path}; {words}.")
        if elements.emptied(self.faults, found["findings"]):
            with self.faults:
                for finding in found["findings"]:
                    self._show_fault(finding)
        self._show_surfaces()

    def _show_fault(self, finding: dict[str, Any]) -> None:
        with ui.element("div").classes("bar"):
            own = elements.finding_html(finding["severity"], finding["sentence"])
            elements.markup(own).style("flex: 1 1 16rem")
            for place in finding["about"].get("points_m", [])[:3]:
                text = "Show " + ", ".join(f"{x:.2f}" for x in place)
                elements.quiet_button(text, partial(self.view.tell, selected=-1, mark=place)).props(
                    "dense"
                )

    def _show_surfaces(self) -> None:
        own = self.room["surfaces"][self.chosen] if self.chosen >= 0 else None
        colours = [m["colour"] for m in self.room["materials"]]
        listed = self.room["surfaces"][:_MOST_SURFACES]
        if elements.emptied(self.surfaces, (listed, colours)):
            self.lines.clear()
            with self.surfaces:
                elements.heading("Surfaces")
                group = ui.element("div").classes("surfaces")
                with group.props('role="group" aria-label="Surfaces"'):
                    for i, surface in enumerate(listed):
                        self._draw_line(i, surface, colours[surface["material_index"]])
        for i, line in enumerate(self.lines):
            line.props["aria-pressed"] = "true" if i == self.chosen else "false"
        material = {} if own is None else self.room["materials"][own["material_index"]]
        names = [m["name"] for m in self.room["materials"]]
        if elements.emptied(self.details, (own, names, material)):
            with self.details:
                if own is None:
                    text = "Choose a surface, here or in the picture, to say what it is made of."
                    ui.label(text).classes("soft").style("margin-top: 0.5rem")
                else:
                    self._draw_details(own, names, material)

    def _draw_line(self, number: int, surface: dict[str, Any], colour: str) -> None:
        line = ui.element("button").classes("surface").props('type="button"')
        line.on("click", lambda: self.pick(number))
        self.lines.append(line)
        with line:
            swatch = f'<span class="swatch" style="background:{escape(colour)}"></span>'
            elements.markup(f"{swatch}{escape(surface['name'])}")
            ui.label(f"{surface['material']}, {surface['area_m2']:.1f} m²").classes("right")

    def _draw_details(
        self, surface: dict[str, Any], names: list[str], material: dict[str, Any]
    ) -> None:
        folder, own = self.bench.folder, dict(surface)
        elements.heading(f"Surface {surface['name']}")
        label, wide = "Material (choose, or type a new name and Enter)", "width: 100%"
        elements.field(
            own, "material", label, names, style=f"{wide}; margin-bottom: 0.6rem",
            then=lambda: self._change(
                partial(project.set_surface_material, folder, own["name"], str(own["material"]))
            ),
            with_input=True, new_value_mode="add-unique",
        )  # fmt: skip
        entries = {e.name: e for e in catalogue().entries}
        first = [*suggested_entries(material["name"]), *catalogue().classes]
        words = {n: catalogue_words()[n] for n in dict.fromkeys([*first, *entries])}
        entry = entries.get(material["prior"])
        prior: dict[str, Any] = {"entry": None if entry is None else entry.name}
        label = f"What {material['name']} is (search the catalogue)"
        elements.field(
            prior, "entry", label, words, style=wide, with_input=True, clearable=True,
            then=lambda: self._change(
                partial(project.set_prior, folder, material["name"], prior["entry"])
            ),
        )  # fmt: skip
        if entry is not None:
            values = ", ".join(f"{a:.2f}" for a in entry.absorption)
            ui.label(f"Absorption of the catalogue, 63 to 8000 Hz: {values}").classes("small")

    async def _change(self, action: Callable[[], None]) -> None:
        with elements.saying_errors(self.both):
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
        # unit (None: as the file says) and room of the next file, and of one that waits for it
        self.asked: dict[str, Any] = {}
        self.file = ""  # that was sent last, whose unit may be in doubt
        self.place = ui.element("div").style("width: 100%")

    def show(self, has_campaign: bool) -> None:
        """Draw it, unless it is drawn for a project of this kind already."""
        if not elements.emptied(self.place, has_campaign):
            return
        self.asked, self.file = {"unit": None, "space": ""}, ""
        with self.place:
            if has_campaign:
                with ui.expansion("Another room").classes("panel").style("margin-bottom: 0.75rem"):
                    self._draw_file()
                    self._draw_lengths()
                return
            with ui.element("div").classes("two"):
                with ui.element("div").classes("panel"):
                    elements.heading("Begin with your room")
                    self._draw_file()
                    elements.heading("or type a box")
                    self._draw_lengths()
                with ui.element("div").classes("panel"):
                    elements.heading("or look around first")
                    ui.label(_DEMO)
                    demo = partial(self.bench.add, "Demo project", "demo")
                    ui.button("Open the demo project", on_click=demo).props("no-caps")

    def _draw_file(self) -> None:
        elements.file_drop("Room file, dropped here or chosen:", "room", READERS, self._use_file)
        units: dict[str | None, str] = {None: "as the file says", **{u: u for u in METRES_PER_UNIT}}
        with ui.element("div").classes("bar").style("margin: 0.5rem 0"):
            elements.field(
                self.asked, "unit", "Unit", units, style="width: 11rem", then=self._use_file
            )
            typed = {"space": ""}
            name = elements.field(typed, "space", "Which room, of several")
            elements.on_entered(name, lambda: self._choose_space(typed["space"].strip()))

    def _draw_lengths(self) -> None:
        lengths: dict[str, Any] = dict(_LENGTHS_M)
        with ui.element("div").classes("bar"):
            for name in lengths:
                elements.field(lengths, name, name, style="width: 8rem")
            box = ui.button(
                "Use this box",
                on_click=lambda: self._use(shoebox=[own or 0.0 for own in lengths.values()]),
            )
            box.props("no-caps")

    async def _choose_space(self, name: str) -> None:
        """Keep the name of a room for the next file, and for one that waits for it."""
        if name != self.asked["space"]:
            self.asked["space"] = name
            await self._use_file()

    async def _use_file(self, names: list[str] | None = None) -> None:
        """Give the project the last of the files that were sent, now or before."""
        self.file = names[-1] if names else self.file
        if self.file:
            await self._use(file=self.file)

    async def _use(self, **room: Any) -> None:
        with elements.saying_errors(self.place):
            await self.bench.ask("set_room", **self.asked, **room)
            await self.then()
