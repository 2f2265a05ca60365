"""What if: other materials, what they would do to every pair, and what to hang where."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from html import escape
from pathlib import Path
from typing import Any, ClassVar

from nicegui import ui

from roomfit.app import project
from roomfit.app.elements import (
    BandSlider,
    Tab,
    emptied,
    field,
    file_address,
    file_drop,
    findings,
    heading,
    markup,
    quiet_button,
    saying_errors,
)
from roomfit.app.jobs import Bench
from roomfit.app.room_tab import catalogue_words
from roomfit.base.errors import InputError
from roomfit.files.encoding import written_content
from roomfit.files.responses import RESPONSE_SUFFIXES
from roomfit.materials.catalogue import OCTAVES_HZ, find_material
from roomfit.report.wording import count, hertz, parameter

_PREPARE_S = 900.0  # a change may need it, too, where the process was started again
_MOST_ROWS = 100
_TIMES = "T30_s"  # what decay times alone give
_LABELS = {
    name: " in ".join(filter(None, (parameter(name).symbol, parameter(name).unit)))
    for name in (_TIMES, "T20_s", "EDT_s", "C80_dB", "D50_percent", "STI")
}
_HIDDEN = ("standard", "value", "tolerance")  # of a target: kept and stated, not edited
_ODDS = {p: f"{100 * p:.0f} %" for p in (0.5, 0.6, 0.7, 0.8, 0.9, 0.95)}
_FIELD = "width: 7.5rem"
_DOUBTED = "Predict also where the result is seriously doubted"


class Changes:
    """What materials are to become, and what was found of them."""

    def __init__(self, bands_hz: Sequence[float], found: Mapping[str, Sequence[float]]) -> None:
        # by material a name of the catalogue, or absorption in each band
        self.chosen: dict[str, str | list[float]] = {}
        self.bands_hz, self.found = bands_hz, found  # absorption by material

    def take_result(self, bands_hz: Sequence[float], found: Mapping[str, Sequence[float]]) -> None:
        """Take another result; changes of what it does not have are forgotten."""
        stays = (str, list) if list(bands_hz) == list(self.bands_hz) else str
        self.bands_hz, self.found = bands_hz, found
        own = self.chosen.items()
        self.chosen = {n: x for n, x in own if n in found and isinstance(x, stays)}

    def entry(self, material: str) -> str | None:
        """Return the entry of the catalogue that a material becomes, None: no entry."""
        own = self.chosen.get(material)
        return own if isinstance(own, str) else None

    def spectrum(self, material: str) -> list[float]:
        """Return the absorption that a material has after the changes, in each band."""
        own = self.chosen.get(material)
        if isinstance(own, list):
            return list(own)
        found = [round(a, 3) for a in self.found[material]]
        if own is None:
            return found
        octaves = dict(zip(OCTAVES_HZ, find_material(own).absorption.tolist(), strict=True))
        return [round(octaves.get(f, a), 3) for f, a in zip(self.bands_hz, found, strict=True)]

    def move(self, material: str, band: int, value: float) -> bool:
        """Give a material another absorption in one band; return whether it is another."""
        values = self.spectrum(material)
        if values[band] == value:
            return False
        values[band] = value
        self.chosen[material] = values
        return True

    def written(self) -> list[str]:
        """Return the changes as ``roomfit predict --set`` takes them.

        Absorption that was moved is a factor on what was found, which keeps what is not known of
        it.
        """

        def become(material: str, own: str | list[float]) -> str:
            if isinstance(own, str):
                return own
            # a band that nobody has touched stays exactly as it was found
            each = zip(own, self.found[material], strict=True)
            same = ((now, was, round(now, 3) == round(was, 3)) for now, was in each)
            return ",".join("x1" if equal else f"x{now / was:.6g}" for now, was, equal in same)

        return [f"{material}={become(material, own)}" for material, own in self.chosen.items()]


class WhatIfTab(Tab):
    """Changes of materials, and below them the answer, which follows them."""

    name: ClassVar[str] = "What if"
    files: ClassVar[tuple[str, ...]] = (
        project.CAMPAIGN,
        *project.RESULTS,
        project.DECAY_TIMES,
        project.TREATMENT_QUESTION,
        project.TREATMENT,
        project.VARIANTS,
        project.LISTENED,
        project.DRY,
    )

    def __init__(self, bench: Bench) -> None:
        super().__init__(bench)
        self.changes = Changes((), {})
        # also where the result is seriously doubted; to which material the sliders belong, and what
        # it becomes; what sounds, "" the responses themselves
        self.asked: dict[str, Any] = {"doubted": False, "material": "", "entry": None, "dry": ""}
        self.asked["variant"] = ""  # the name under which the changes are to be kept
        self.worker = bench.what_if  # the process that has the room ready
        self.room: dict[str, Any] = {}  # as it was prepared last
        self.predicted: dict[str, Any] | None = None  # of the changes; None: is being prepared
        self.is_busy = self.is_outdated = False  # evaluating, and what is evaluated is not the last
        with self.place:
            self.note = ui.label("").classes("soft")
            self.all_the_same = field(self.asked, "doubted", _DOUBTED, then=self.take_doubted)
            self.all_the_same.set_visibility(False)
            with ui.element("div").style("width: 100%") as self.both:
                with ui.element("div").classes("panel"):
                    self.choices = ui.element("div").classes("bar")
                    self.sliders = ui.element("div")
                self.shown = markup("").classes("panel answer").style("margin: 0.75rem 0")
                self.said = ui.element("div")
                self.kept = ui.element("div").classes("panel variants")
                self.sounds = ui.element("div").classes("panel").style("margin-top: 0.75rem")
            self.treatment = TreatmentForm(bench, lambda: bool(self.asked["doubted"]))
        self.both.set_visibility(False)

    async def refresh(self) -> None:
        """Prepare the room for changes, and show what those do that are chosen already."""
        self.predicted = None
        # without paths to trace there is nothing that takes long: no process of its own
        self.worker = self.bench.reader
        if project.best_result(self.bench.folder) is not None:
            self.worker = self.bench.what_if
            text = "The room is traced for changes; this takes seconds, in a large room minutes."
        elif project.decay_times(self.bench.folder) is not None:
            text = "The decay times are read."
        else:
            self._refuse("No answer yet: identify first, or give decay times in Measurements.")
            return
        self.note.set_text(text)
        try:
            found = await self.newest(self.ask("what_if_prepare"))
        except InputError:
            self.note.set_text("The room could not be prepared.")
            raise
        if found is None:
            return
        refused = found.get("refused")
        doubts = refused or found["left_out"] or self.asked["doubted"]
        self.all_the_same.set_visibility(bool(doubts))
        if refused:
            self._refuse(refused)
            return
        self.room = found
        self.changes.take_result(found["bands_hz"], found["absorption"])
        self.both.set_visibility(True)
        self.treatment.place.set_visibility(found["treatment"] is not None)
        if found["treatment"] is not None:
            self.treatment.show(found["treatment"])
        self.sounds.set_visibility(not found["from_times"])
        self._draw_sounds()
        self._draw_controls()
        self.predicted = found
        self.draw()
        self._draw_variants(found["variants"])
        if self.changes.chosen:
            await self.evaluate()

    def _refuse(self, why: str) -> None:
        self.n_asked += 1  # no answer that is under way is shown
        self.note.set_text(why)
        self.both.set_visibility(False)
        self.treatment.place.set_visibility(False)

    async def ask(self, task: str, **own: Any) -> Any:
        """Return the answer of a task about the room that is ready for changes."""
        own["doubted"] = self.asked["doubted"]
        return await self.worker.ask(task, self.bench.folder, own, limit_s=_PREPARE_S)

    async def take_doubted(self) -> None:
        """Predict also where the result is seriously doubted, or there no more."""
        with saying_errors(self.both):
            await self.refresh()

    async def evaluate(self) -> None:
        """Evaluate what is chosen now; while one is under way, the newest waits, no other."""
        if self.is_busy:
            self.is_outdated = True
            return
        self.is_busy = self.is_outdated = True
        try:
            with saying_errors(self.both):
                while self.is_outdated:
                    self.is_outdated, number = False, self.n_asked
                    found = await self.ask("what_if", changes=self.changes.written())
                    if self.both.is_deleted:  # the page was closed meanwhile
                        return
                    if number == self.n_asked:  # the room is still the one that was asked about
                        self.predicted = found
                        self.draw()
        finally:
            self.is_busy = False

    # Which material is changed, and into what.

    def _draw_controls(self) -> None:
        found = self.changes.found
        if self.asked["material"] not in found:
            self.asked["material"] = next(iter(found))
        if not emptied(self.choices, (self.changes.bands_hz, found)):
            return
        with self.choices:
            wide = "width: 14rem"
            self.of = field(
                self.asked, "material", "Material", [*found], style=wide, then=self._draw_sliders
            )
            label, wide = "Becomes (search the catalogue)", "flex: 1 1 16rem"
            self.becomes = field(
                self.asked, "entry", label, catalogue_words(), style=wide, then=self._choose_entry,
                with_input=True, clearable=True,
            )  # fmt: skip
            quiet_button("Undo all changes", self._reset)
        self._draw_sliders()

    def _draw_sliders(self) -> None:
        """Bring the sliders to the material that is chosen; what is above them stays."""
        self._mark_changed()
        material = self.asked["material"]
        self.becomes.set_value(self.changes.entry(material))
        self.sliders.clear()
        with self.sliders:
            heading(f"Absorption of {material}")
            with ui.element("div").classes("sliders"):
                values = self.changes.spectrum(material)
                for band, centre_hz in enumerate(self.changes.bands_hz):
                    word = hertz(centre_hz)
                    own = {"label": f"Absorption of {material} at {word}", "start": values[band]}
                    BandSlider("moved", partial(self.slide, band), throttle=0.05, word=word, **own)

    def _mark_changed(self) -> None:
        chosen = self.changes.chosen
        marked = {m: f"{m} (changed)" if m in chosen else m for m in self.changes.found}
        if self.of.options != marked:
            self.of.set_options(marked)

    async def _choose_entry(self) -> None:
        """Let the material become an entry of the catalogue; None: what it is."""
        material, name = self.asked["material"], self.asked["entry"]
        if name == self.changes.entry(material):
            return  # said by the page itself, for another material was chosen
        if name is None:
            self.changes.chosen.pop(material, None)
        else:
            self.changes.chosen[material] = name
        self._draw_sliders()
        await self.evaluate()

    async def slide(self, band: int, value: float) -> None:
        """Give the material another absorption in one band."""
        if self.changes.move(self.asked["material"], band, float(value)):
            self._mark_changed()
            self.becomes.set_value(None)
            await self.evaluate()

    async def _reset(self) -> None:
        self.changes.chosen.clear()
        self._draw_sliders()
        await self.evaluate()

    # Variants that are kept.

    def _draw_variants(self, view: Mapping[str, Any]) -> None:
        if not emptied(self.kept, view):
            return
        with self.kept:
            heading("Variants side by side")
            with ui.element("div").classes("bar"):
                label = "Name of what is set above, as curtain open"
                field(self.asked, "variant", label, style="flex: 1 1 16rem")
                quiet_button("Keep it", self._keep)
                for name in view["names"]:
                    quiet_button(f"Forget {name}", partial(self._keep, name))
            markup(view["shown"])

    def _keep(self, forgotten: str = "") -> None:
        """Keep what is set under a name, or forget a variant; the tab is drawn anew after it."""
        with saying_errors(self.both):
            changes = [] if forgotten else self.changes.written()
            if not (forgotten or changes):
                what, needed = "nothing is changed yet", "one change or more"
                hint = "choose a material and what it becomes"
                raise InputError(what, found="the room as it is", needed=needed, hint=hint)
            project.keep_variant(self.bench.folder, forgotten or self.asked["variant"], changes)

    # What was predicted.

    def draw(self) -> None:
        """Show what was predicted last."""
        view = self.predicted
        if view is None:
            return
        self.shown.set_content(view["shown"])
        said = [*view["findings"]]
        if view["directions"]:
            said.append({"severity": "info", "sentence": view["directions"]})
        if emptied(self.said, said):
            with self.said:
                findings(said)
        alone = "From decay times alone, " if self.room["from_times"] else ""
        changed = count(len(self.changes.chosen), "material")
        self.note.set_text(f"{alone}{changed} changed. {self.room['left_out']}".rstrip())

    # What the changes sound like, as responses or by a dry recording.

    def _make_sounds(self) -> None:
        own = {key: self.asked[key] for key in ("dry", "doubted")}
        self.bench.add("Before and after", "listen", changes=self.changes.written(), **own)

    async def _take_dry(self, names: list[str]) -> None:
        self.asked["dry"] = names[-1]
        self._draw_sounds()

    def _draw_sounds(self) -> None:
        known = [file.name for file in project.listed(self.bench.folder, project.DRY)]
        made = self.bench.folder / project.LISTENED / "listen.json"
        if not emptied(self.sounds, (known, made.is_file() and file_address(made))):
            return
        own = {"": "the responses themselves", **{name: name for name in known}}
        if self.asked["dry"] not in own:
            self.asked["dry"] = ""
        with self.sounds:
            heading("Before and after, to listen to")
            text = "A dry recording of one channel:"
            file_drop(text, project.DRY, RESPONSE_SUFFIXES, self._take_dry)
            with ui.element("div").classes("bar").style("margin: 0.5rem 0"):
                field(self.asked, "dry", "What to listen to", own, style="flex: 1 1 16rem")
                quiet_button("Make the sounds of what is set above", self._make_sounds)
            if made.is_file():
                _show_sounds(made.parent)


def _show_sounds(folder: Path) -> None:
    """Show what `roomfit listen` has written, before and after side by side."""
    content, _ = written_content(folder / "listen.json", "sounds")
    ui.label("; ".join(content["changes"])).classes("soft")
    ui.label("At one volume, before and after: nothing is normalised by itself.").classes("soft")
    for own in content["responses"][:_MOST_ROWS]:
        for dry in ("dry_", "") if content["dry_factor"] else ("",):
            name = f"{own['source']} to {own['receiver']}, {'recording' if dry else 'response'}"
            with ui.element("div").classes("bar"):
                ui.label(name).style("min-width: 12rem")
                for kind in ("before", "after"):
                    source = escape(file_address(folder / str(own["files"][f"{dry}{kind}"])))
                    spoken = escape(f"{name} {kind}")
                    player = f'<audio controls preload="none" src="{source}"'
                    markup(f'{player} aria-label="{spoken}"></audio>')


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
        self.fault.set_text(view["fault"])
        room = {key: view[key] for key in ("areas_m2", "bands_hz", "from_times")}
        question = view["question"]
        if room != self.room or question not in (self.read, self.written()):
            empty = {"surfaces": {}, "products": {}, "probability": 0.5}
            first = [] if question else [{"parameter": "T30_s"}]
            self.asked = {**empty, "targets": first, **copy.deepcopy(question)}
            self.room = room
            self.draw()
        self.read = question
        self._show_answer(view["sentence"])

    def written(self) -> dict[str, Any]:
        """Return what the fields hold as the file has it: empty ones are no keys."""

        def filled(table: Mapping[str, Any]) -> dict[str, Any]:
            # of all octaves together, as speech transmission is, there are no bands
            no_bands = ("bands_hz", "mean_of_bands") if table.get("parameter") == "STI" else ()
            known = {k: v for k, v in table.items() if k not in no_bands}
            return {k: v for k, v in known.items() if v is not None and v != []}

        own = {key: value for key, value in self.asked.items() if value is not None}
        for key in ("surfaces", "products"):
            own[key] = {name: filled(table) for name, table in own.get(key, {}).items()}
        own["targets"] = [filled(target) for target in own.get("targets", [])]
        if own.get("probability") == 0.5 and "probability" not in self.read:
            del own["probability"]
        return own

    async def search(self) -> None:
        with saying_errors(self.place):
            await self.bench.ask("ask_treatment", question=self.written())
            self.bench.add("What to hang where", "treat", doubted=self.is_doubted())

    def draw(self) -> None:
        """Draw all fields."""
        areas_m2, asked = self.room["areas_m2"], self.asked
        self.fields.clear()
        with self.fields:
            heading("Surfaces that may be covered", 3)
            with ui.element("div").classes("asked"):
                for name in dict.fromkeys([*areas_m2, *asked["surfaces"]]):
                    self._draw_surface(name, areas_m2.get(name))
            heading("Products", 3)
            self.products = ui.element("div").classes("asked")
            adding: dict[str, Any] = {"product": None}
            label, wide = "Add a product (search the catalogue)", "max-width: 34rem"
            self.catalogue = field(
                adding, "product", label, catalogue_words(), style=wide, with_input=True,
                then=lambda: self._add_product(adding["product"]),
            )  # fmt: skip
            heading("Targets", 3)
            self.targets = ui.element("div")
            with ui.element("div").classes("bar"):
                first = {"parameter": "T30_s"}
                quiet_button("Add a target", lambda: self.change_targets(add=dict(first)))
                odds = asked["probability"]
                words = {**_ODDS, odds: f"{100 * odds:g} %"}
                label = "Met with a probability of"
                field(asked, "probability", label, words, style="width: 13rem")
        self._draw_products()
        self._draw_targets()

    def _draw_surface(self, name: str, area_m2: float | None) -> None:
        text = f"{name}, " + ("not in this room" if area_m2 is None else f"{area_m2:.1f} m²")
        known = self.asked["surfaces"]
        kept, covered = known.get(name, {}), {"is": name in known}

        def cover() -> None:
            if covered["is"]:
                known[name] = kept
            else:
                known.pop(name, None)
            free.set_enabled(covered["is"])

        field(covered, "is", text, then=cover)
        free = field(kept, "free_m2", "Free m²", style=_FIELD, spoken=f"Free area of {name} in m²")
        free.set_enabled(covered["is"])

    def _draw_products(self) -> None:
        self.products.clear()
        with self.products:
            for name, product in self.asked["products"].items():
                entry = product.get("catalogue")
                ui.label(name if entry in (None, name) else f"{name}: {entry}")
                with ui.element("div").classes("bar"):
                    spoken = f"Cost of {name} per m²"
                    field(product, "cost_per_m2", "Cost per m²", style=_FIELD, spoken=spoken)
                    spoken = f"Piece of {name} in m²"
                    field(product, "piece_m2", "Piece, m²", style=_FIELD, spoken=spoken)
                    quiet_button("Remove", partial(self._remove_product, name), f"Remove {name}")

    def _add_product(self, name: str | None) -> None:
        if name:
            self.asked["products"].setdefault(name, {"catalogue": name})
            self.catalogue.set_value(None)
            self._draw_products()

    def _remove_product(self, name: str) -> None:
        del self.asked["products"][name]
        self._draw_products()

    def change_targets(self, remove: int | None = None, add: dict[str, Any] | None = None) -> None:
        """Take a target out, or another one in."""
        targets = self.asked["targets"]
        self.asked["targets"] = [t for i, t in enumerate(targets) if i != remove]
        self.asked["targets"] += [] if add is None else [add]
        self._draw_targets()

    def _draw_targets(self) -> None:
        self.targets.clear()
        with self.targets:
            for number, target in enumerate(self.asked["targets"], start=1):
                with ui.element("div").classes("bar").style("margin-bottom: 0.4rem"):
                    self._draw_target(number, target)
                    remove = partial(self.change_targets, number - 1)
                    quiet_button("Remove", remove, f"Remove target {number}")

    def _draw_target(self, number: int, target: dict[str, Any]) -> None:
        """Draw what is to be reached; of a standard, or about a value, as text."""
        stated = [f"{key} {target[key]}" for key in _HIDDEN if key in target]
        if stated:
            ui.label(", ".join([str(target.get("parameter", "")), *stated]).lstrip(", "))
            return
        own = target.setdefault("parameter", "T30_s")
        names = [_TIMES] if self.room["from_times"] else list(_LABELS)
        words = {name: _LABELS.get(name, name) for name in dict.fromkeys([*names, own])}
        field(target, "parameter", f"Target {number}", words, style="width: 9rem")
        for key, word in (("at_least", "At least"), ("at_most", "At most")):
            field(target, key, word, style=_FIELD, spoken=f"{word}, target {number}")
        chosen = target["bands_hz"] = [float(f) for f in target.get("bands_hz", [])]
        bands = {f: hertz(f) for f in sorted({*self.room["bands_hz"], *chosen})}
        label, spoken = "Bands (none: 500, 1000, 2000 Hz)", f"Bands of target {number}"
        wide = "flex: 0 1 18rem"
        field(target, "bands_hz", label, bands, style=wide, spoken=spoken).props("use-chips")
        mean = {"is": bool(target.get("mean_of_bands"))}
        spoken = f"Target {number} is of the mean of its bands"

        def take() -> None:
            target["mean_of_bands"] = mean["is"] or None

        field(mean, "is", "mean of the bands", spoken=spoken, then=take)

    def _show_answer(self, sentence: str) -> None:
        files = project.listed(self.bench.folder, project.TREATMENT)
        found = {file.name: escape(file_address(file)) for file in files}
        if not emptied(self.answer, (sentence, found)):
            return
        with self.answer:
            if "treatment.html" in found:
                address = found["treatment.html"]
                markup(f'<iframe class="report" title="Treatment" src="{address}"></iframe>')
            elif sentence:
                ui.label(sentence)
            links = (f'<a href="{x}&save=1">{escape(name)}</a>' for name, x in found.items())
            markup(", ".join(links))
