"""The form of what to hang where: surfaces, products, targets, the search, and its answer."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from functools import partial
from html import escape
from typing import Any

from nicegui import ui

from roomfit.app import project
from roomfit.app.elements import (
    emptied,
    file_address,
    heading,
    markup,
    quiet_button,
    saying_errors,
)
from roomfit.app.jobs import Bench
from roomfit.materials.catalogue import catalogue
from roomfit.report.wording import hertz

_STAGES = ((0.0, "tracing"), (0.8, "searching"))
_PARAMETERS = {
    "T30_s": "T30 in s",
    "T20_s": "T20 in s",
    "EDT_s": "EDT in s",
    "C80_dB": "C80 in dB",
    "D50_percent": "D50 in %",
    "STI": "STI",
}
_HIDDEN = ("standard", "value", "tolerance")  # of a target: kept and stated, not edited
_ODDS = {p: f"{100 * p:.0f} %" for p in (0.5, 0.6, 0.7, 0.8, 0.9, 0.95)}


class TreatmentForm:
    """Fields that are the project's treatment.toml, and below them the last answer."""

    def __init__(self, bench: Bench, is_doubted: Callable[[], bool]) -> None:
        self.bench = bench
        self.is_doubted = is_doubted  # whether also where the result is seriously doubted
        self.room: dict[str, Any] = {}  # its surfaces, and the bands of targets
        self.read: dict[str, Any] = {}  # what the file held last
        self.asked: dict[str, Any] = {}  # as the fields have it: what the file is to hold
        self.place = ui.element("div").classes("panel").style("margin-top: 0.75rem")
        with self.place:
            heading("What to hang where")
            self.fields = ui.element("div")
            text = "Search for the cheapest that meets the targets"
            quiet_button(text, self.search).style("margin-top: 0.5rem")
            self.fault = ui.label().classes("serious").style("white-space: pre-wrap")
            self.answer = ui.element("div").props('role="status"')
        self.place.set_visibility(False)

    def show(self, view: Mapping[str, Any]) -> None:
        """Show what the file asks, unless the fields have it already, and the last answer."""
        self.place.set_visibility(True)
        self.fault.set_text(view["fault"])
        room = {key: view[key] for key in ("areas_m2", "bands_hz", "from_times")}
        question = view["question"]
        if room != self.room or question not in (self.read, self.written()):
            self.asked = copy.deepcopy(question) or {"targets": [{"parameter": "T30_s"}]}
            self.asked.setdefault("targets", [])
            for key in ("surfaces", "products"):
                self.asked.setdefault(key, {})
            self.room = room
            self.draw()
        self.read = question
        self.show_answer(view["sentence"])

    def written(self) -> dict[str, Any]:
        """Return what the fields hold as the file has it: empty ones are no keys."""

        def filled(table: Mapping[str, Any]) -> dict[str, Any]:
            return {k: v for k, v in table.items() if v is not None and v != []}

        own = {key: value for key, value in self.asked.items() if value is not None}
        for key in ("surfaces", "products"):
            own[key] = {name: filled(table) for name, table in self.asked[key].items()}
        own["targets"] = [filled(target) for target in self.asked["targets"]]
        for target in own["targets"]:
            if target.get("parameter") == "STI":  # which is of all octaves together
                target.pop("bands_hz", None)
                target.pop("mean_of_bands", None)
        return own

    async def search(self) -> None:
        """Write the file, and put the search into the queue."""
        with saying_errors(self.place):
            await self.bench.ask("ask_treatment", question=self.written())
            own = {"folder": str(self.bench.folder), "doubted": self.is_doubted()}
            self.bench.jobs.add("What to hang where", "treat", own, _STAGES)

    def draw(self) -> None:
        """Draw all fields."""
        self.fields.clear()
        with self.fields:
            heading("Surfaces that may be covered", 3)
            with ui.element("div").classes("asked"):
                for name in dict.fromkeys([*self.room["areas_m2"], *self.asked["surfaces"]]):
                    self.draw_surface(name, self.room["areas_m2"].get(name))
            heading("Products", 3)
            self.products = ui.element("div").classes("asked")
            entries = {e.name: f"{e.name}: {e.description}" for e in catalogue().entries}
            choice = ui.select(
                entries,
                label="Add a product (search the catalogue)",
                with_input=True,
                on_change=lambda e: self.add_product(e.sender, e.value),
            )
            choice.props("outlined dense").style("max-width: 34rem")
            heading("Targets", 3)
            self.targets = ui.element("div")
            with ui.element("div").classes("bar"):
                quiet_button("Add a target", self.add_target)
                odds = self.asked.get("probability", 0.5)
                ui.select(
                    {**_ODDS, odds: f"{100 * odds:g} %"},
                    value=odds,
                    label="Met with a probability of",
                    on_change=lambda e: self.asked.update(probability=e.value),
                ).props("outlined dense").style("width: 13rem")
        self.draw_products()
        self.draw_targets()

    def draw_surface(self, name: str, area_m2: float | None) -> None:
        """Draw whether a surface may be covered, and how much of it."""
        text = f"{name}, " + ("not in this room" if area_m2 is None else f"{area_m2:.1f} m²")
        known = self.asked["surfaces"]
        kept: dict[str, Any] = known.get(name, {})

        def cover(wanted: bool) -> None:
            if wanted:
                known[name] = kept
            else:
                known.pop(name, None)
            field.set_enabled(wanted)

        ui.checkbox(text, value=name in known, on_change=lambda e: cover(e.value))
        field = _number(kept, "free_m2", "Free m²", f"Free area of {name} in m²")
        field.set_enabled(name in known)

    def draw_products(self) -> None:
        """Draw a row for each product."""
        self.products.clear()
        with self.products:
            for name, product in self.asked["products"].items():
                entry = product.get("catalogue")
                ui.label(name if entry in (None, name) else f"{name}: {entry}")
                with ui.element("div").classes("bar"):
                    _number(product, "cost_per_m2", "Cost per m²", f"Cost of {name} per m²")
                    _number(product, "piece_m2", "Piece, m²", f"Piece of {name} in m²")
                    button = quiet_button("Remove", partial(self.remove_product, name))
                    button.props["aria-label"] = f"Remove {name}"

    def add_product(self, field: ui.select, name: str | None) -> None:
        """Take an entry of the catalogue as a product."""
        if name:
            self.asked["products"].setdefault(name, {"catalogue": name})
            field.set_value(None)
            self.draw_products()

    def remove_product(self, name: str) -> None:
        """Take a product out."""
        del self.asked["products"][name]
        self.draw_products()

    def draw_targets(self) -> None:
        """Draw a row for each target."""
        self.targets.clear()
        with self.targets:
            for number, target in enumerate(self.asked["targets"], start=1):
                with ui.element("div").classes("bar").style("margin-bottom: 0.4rem"):
                    self.draw_target(number, target)
                    button = quiet_button("Remove", partial(self.remove_target, number - 1))
                    button.props["aria-label"] = f"Remove target {number}"

    def draw_target(self, number: int, target: dict[str, Any]) -> None:
        """Draw what is to be reached; of a standard, or about a value, as text."""
        stated = [f"{key} {target[key]}" for key in _HIDDEN if key in target]
        if stated:
            ui.label(", ".join([str(target.get("parameter", "")), *stated]).lstrip(", "))
            return
        own = target.setdefault("parameter", "T30_s")
        names = ["T30_s"] if self.room["from_times"] else list(_PARAMETERS)
        _choice(
            {name: _PARAMETERS.get(name, name) for name in dict.fromkeys([*names, own])},
            target, "parameter", f"Target {number}", own,
        ).style("width: 9rem")  # fmt: skip
        for key, word in (("at_least", "At least"), ("at_most", "At most")):
            _number(target, key, word, f"{word}, target {number}")
        bands_hz = sorted({*self.room["bands_hz"], *target.get("bands_hz", [])})
        words = {f: hertz(f) for f in bands_hz}
        chosen = [float(f) for f in target.get("bands_hz", [])]
        field = _choice(words, target, "bands_hz", "Bands (none: 500, 1000, 2000 Hz)", chosen)
        field.props("multiple use-chips").style("flex: 0 1 18rem")
        field.props["aria-label"] = f"Bands of target {number}"
        ui.checkbox(
            "mean of the bands",
            value=bool(target.get("mean_of_bands")),
            on_change=lambda e: target.update(mean_of_bands=e.value or None),
        ).props["aria-label"] = f"Target {number} is of the mean of its bands"

    def add_target(self) -> None:
        """Add an empty row."""
        self.asked["targets"].append({"parameter": "T30_s"})
        self.draw_targets()

    def remove_target(self, place: int) -> None:
        """Take a row out."""
        del self.asked["targets"][place]
        self.draw_targets()

    def show_answer(self, sentence: str) -> None:
        """Show the sentence of the answer, its picture and its files, unless they are shown."""
        out = self.bench.folder / project.TREATMENT
        found = {f: file_address(f) for f in (sorted(out.iterdir()) if out.is_dir() else ())}
        if not emptied(self.answer, (sentence, found)):
            return
        with self.answer:
            if sentence:
                heading("The cheapest that was found", 3)
                ui.label(sentence)
            for file, place in found.items():
                if file.suffix == ".svg":
                    markup(f'<img alt="{escape(file.stem)}" src="{escape(place)}" width="100%">')
            for file, place in found.items():
                if file.suffix != ".svg" and not file.name.startswith("."):
                    markup(f'<a href="{escape(place)}&save=1">{escape(file.name)}</a>')


def _number(table: dict[str, Any], key: str, label: str, spoken: str) -> ui.number:
    """Draw a field for a number of a table that may be left empty."""
    value = table.get(key)
    field = ui.number(label, value=value, on_change=lambda e: table.update({key: e.value}))
    field.props("outlined dense").style("width: 7.5rem")
    field.props["aria-label"] = spoken
    return field


def _choice(
    options: Mapping[Any, str], table: dict[str, Any], key: str, label: str, value: Any
) -> ui.select:
    """Draw a choice of a key of a table."""
    own: ui.select = ui.select(
        dict(options),
        value=value,
        label=label,
        multiple=isinstance(value, list),
        on_change=lambda e: table.update({key: e.value}),
    ).props("outlined dense")
    return own
