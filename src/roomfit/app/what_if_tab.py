"""What if: other materials, and what they would do to every pair."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from html import escape
from pathlib import Path
from typing import Any, ClassVar

from matplotlib.ticker import MaxNLocator
from nicegui import ui

from roomfit.app import project
from roomfit.app.elements import (
    BandSlider,
    FileDrop,
    Questions,
    emptied,
    file_address,
    findings,
    heading,
    markup,
    quiet_button,
    saying_errors,
    table_html,
)
from roomfit.app.jobs import Bench
from roomfit.app.treatment_form import TreatmentForm
from roomfit.base.errors import InputError
from roomfit.files.encoding import written_content
from roomfit.files.responses import RESPONSE_SUFFIXES
from roomfit.materials.catalogue import catalogue
from roomfit.report.wording import count, hertz, short_hertz

_TIMES = "T30_s"  # what decay times alone give
_LABELS = {
    _TIMES: "T30 in s",
    "T20_s": "T20 in s",
    "EDT_s": "EDT in s",
    "C80_dB": "C80 in dB",
    "D50_percent": "D50 in %",
    "STI": "STI",
}
_SOUNDING = ((0.0, "tracing"), (0.6, "scaling"))
_PREPARE_S = 900.0  # a change may need it, too, where the process was started again
_MOST = {"D50_percent": 100.0, "STI": 1.0}
_NO_STI = "STI takes all octaves from 125 Hz to 8 kHz: choose them in Identify. "
_SPEECH = "125 Hz to 8 kHz together"
_SOUND_HEADS = ("Pair", "Before", "After")
_WIDE, _HIGH, _LEFT, _BELOW = 320.0, 190.0, 44.0, 24.0


@dataclass(slots=True)
class Changes:
    """What materials are to become, and what was found of them."""

    bands_hz: Sequence[float] = ()
    found: Mapping[str, Sequence[float]] = field(default_factory=dict)  # absorption by material
    # by material a name of the catalogue, or absorption in each band
    chosen: dict[str, str | list[float]] = field(default_factory=dict)
    doubted: bool = False  # whether they are predicted also where the result is seriously doubted

    def take_result(self, bands_hz: Sequence[float], found: Mapping[str, Sequence[float]]) -> None:
        """Take another result; changes of what it does not have are forgotten."""
        others = list(bands_hz) != list(self.bands_hz)
        self.bands_hz, self.found = bands_hz, found
        for name, own in list(self.chosen.items()):
            if name not in found or (others and isinstance(own, list)):
                del self.chosen[name]

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
        entry = next(e for e in catalogue().entries if e.name == own)
        octaves = entry.absorption_by_hz
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
        texts = []
        for material, own in self.chosen.items():
            if isinstance(own, str):
                texts.append(f"{material}={own}")
                continue
            # a band that nobody has touched stays exactly as it was found
            factors = [
                1.0 if round(now, 3) == round(was, 3) else now / was
                for now, was in zip(own, self.found[material], strict=True)
            ]
            texts.append(f"{material}={','.join(f'x{f:.6g}' for f in factors)}")
        return texts


class WhatIfTab:
    """Changes of materials, and a chart of each room parameter that follows them."""

    name: ClassVar[str] = "What if"
    files: ClassVar[tuple[str, ...]] = (
        project.CAMPAIGN,
        *project.RESULTS,
        project.DECAY_TIMES,
        project.TREATMENT_QUESTION,
        project.TREATMENT,
        project.LISTENED,
        project.DRY,
    )

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.changes = Changes()
        self.worker = bench.what_if  # the process that has it ready
        self.room: dict[str, Any] = {}  # as it was prepared last
        self.predicted: dict[str, Any] | None = None  # of the changes; None: is being prepared
        self.is_busy = self.is_outdated = False  # evaluating, and what is evaluated is not the last
        with ui.element("div").classes("bar"):
            self.note = ui.label("").classes("soft")
        text = "Predict also where the result is seriously doubted"
        self.all_the_same = ui.checkbox(text, on_change=lambda e: self.take_doubted(e.value))
        self.all_the_same.set_visibility(False)
        self.both = ui.element("div").style("width: 100%")
        with self.both:
            self.controls = Controls(self.changes, self.evaluate, self.draw)
            with ui.element("div").classes("charts").style("margin: 0.75rem 0"):
                self.pictures = {name: markup("").classes("panel") for name in _LABELS}
            self.said = ui.element("div")
            text = "Every pair in numbers"
            self.pairs = ui.expansion(text, on_value_change=lambda: self.draw_pairs())
            with self.pairs.classes("panel"):
                self.numbers = markup("")
            self.sounds = Sounds(bench, self.changes)
        self.treatment = TreatmentForm(bench, lambda: self.changes.doubted)
        self.both.set_visibility(False)
        self.questions = Questions(self.both)

    async def refresh(self) -> None:
        """Prepare the room for changes, and show what those do that are chosen already."""
        self.predicted = None
        is_current = self.questions.put()
        # without paths to trace there is nothing that takes long: no process of its own
        self.worker = self.bench.reader
        if project.best_result(self.bench.folder) is not None:
            self.worker = self.bench.what_if
            text = "The room is traced for changes; this takes seconds, in a large room minutes."
        elif project.decay_times(self.bench.folder) is not None:
            text = "The decay times are read."
        else:
            text = "No answer yet: identify first, or give decay times in Measurements."
            self.note.set_text(text)
            self.both.set_visibility(False)
            self.treatment.place.set_visibility(False)
            return
        self.note.set_text(text)
        own = {"folder": str(self.bench.folder), "doubted": self.changes.doubted}
        try:
            found = await self.worker.ask("what_if_prepare", own, limit_s=_PREPARE_S)
        except InputError:
            self.note.set_text("The room could not be prepared.")
            raise
        if not is_current():
            return
        refused = found.get("refused")
        doubts = refused or found["left_out"] or self.changes.doubted
        self.all_the_same.set_visibility(bool(doubts))
        if refused:
            self.note.set_text(refused)
            self.both.set_visibility(False)
            self.treatment.place.set_visibility(False)
            return
        self.room = found
        self.changes.take_result(found["bands_hz"], found["absorption"])
        self.both.set_visibility(True)
        self.treatment.place.set_visibility(found["treatment"] is not None)
        if found["treatment"] is not None:
            self.treatment.show(found["treatment"])
        for of_pairs in (self.pairs, self.sounds.place):
            of_pairs.set_visibility(_TIMES not in found["mean"])
        self.sounds.show()
        self.controls.show([n for n in _LABELS if n in found["mean"]])
        self.predicted = found
        self.draw()
        if self.changes.chosen:
            await self.evaluate()

    async def take_doubted(self, wanted: bool) -> None:
        """Predict also where the result is seriously doubted, or there no more."""
        if wanted != self.changes.doubted:
            self.changes.doubted = wanted
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
                    self.is_outdated = False
                    own = {
                        "folder": str(self.bench.folder),
                        "changes": self.changes.written(),
                        "doubted": self.changes.doubted,
                    }
                    is_current = self.questions.since()
                    found = await self.worker.ask("what_if", own, limit_s=_PREPARE_S)
                    if self.both.is_deleted:  # the page was closed meanwhile
                        return
                    if is_current():  # the room is still the one that was asked about
                        self.predicted = found
                        self.draw()
        finally:
            self.is_busy = False

    def draw(self) -> None:
        """Draw what was predicted last, with the limits as they are now."""
        view = self.predicted
        if view is None:
            return
        bands_hz = self.room["bands_hz"]
        for name, picture in self.pictures.items():
            picture.set_visibility(name in view["mean"])
            if name in view["mean"]:
                limits = [x for x in self.room["limits"] if x["parameter"] == name]
                typed = self.controls.targets.get(name)
                if typed is not None:
                    limits.append({"value": typed, "bands_hz": bands_hz})
                picture.set_content(chart_svg(view, name, bands_hz, limits))
        self.draw_pairs()
        directions = [{"severity": "info", "sentence": view["directions"]}]
        if emptied(self.said, (view["findings"], directions)):
            with self.said:
                findings([*view["findings"], *(directions if view["directions"] else ())])
        changed = f"{count(len(self.changes.chosen), 'material')} changed. "
        if _TIMES in view["mean"]:
            text = (
                f"From decay times alone, {changed}Line: T30 of the room with its 95 % interval; "
            )
            self.note.set_text(f"{text}dashed: as it is now; red: limits.")
            return
        self.note.set_text(
            f"{count(len(view['pairs']), 'pair')}, {changed}"
            "Lines: mean over the pairs with its 95 % interval; dashed: the same as it is now; "
            f"thin: each pair; red: limits. {'' if 'STI' in view['mean'] else _NO_STI}"
            f"{self.room['left_out']}".rstrip()
        )

    def draw_pairs(self) -> None:
        """Write the table of all pairs, where it is open."""
        if self.pairs.value and self.predicted is not None:
            self.numbers.set_content(pairs_html(self.predicted, self.room["bands_hz"]))


class Controls:
    """Which material is changed, into what, and the targets that the charts show as lines."""

    def __init__(
        self,
        changes: Changes,
        on_changed: Callable[[], Awaitable[None]],
        on_target: Callable[[], None],
    ) -> None:
        self.changes = changes
        self.on_changed, self.on_target = on_changed, on_target
        self.targets: dict[str, float | None] = {}  # by parameter, as typed
        self.material = ""  # to which the sliders belong
        with ui.element("div").classes("panel"):
            self.choices = ui.element("div").classes("bar")
            self.sliders = ui.element("div")
            self.aims = ui.element("div")

    def show(self, parameters: Sequence[str]) -> None:
        """Draw everything for the materials of the changes, unless it is drawn already."""
        if self.material not in self.changes.found:
            self.material = next(iter(self.changes.found))
        own = (self.changes.bands_hz, self.changes.found, parameters)
        if emptied(self.choices, own):
            self.draw_choices()
            if emptied(self.aims, parameters):
                self.draw_aims(parameters)
            self.show_sliders()

    def draw_choices(self) -> None:
        """Draw the lists of materials and of the catalogue."""
        entries = {e.name: f"{e.name}: {e.description}" for e in catalogue().entries}
        with self.choices:
            self.of = (
                ui.select(
                    list(self.changes.found),
                    value=self.material,
                    label="Material",
                    on_change=lambda e: self.select(e.value),
                )
                .props("outlined dense")
                .style("width: 14rem")
            )
            self.becomes = (
                ui.select(
                    entries,
                    label="Becomes (search the catalogue)",
                    with_input=True,
                    clearable=True,
                    on_change=lambda e: self.choose_entry(e.value),
                )
                .props("outlined dense")
                .style("flex: 1 1 16rem")
            )
            quiet_button("Undo all changes", self.reset)

    def draw_aims(self, parameters: Sequence[str]) -> None:
        """Draw a field for the target of each parameter."""
        with self.aims:
            heading("Targets, as lines in the pictures")
            with ui.element("div").classes("bar"):
                for name in parameters:
                    ui.number(
                        _LABELS[name],
                        value=self.targets.get(name),
                        step=0.1,
                        on_change=lambda e, name=name: self.aim(name, e.value),
                    ).props("outlined dense clearable").style("width: 8rem")

    def show_sliders(self) -> None:
        """Bring the sliders to the material that is chosen; what is above them stays."""
        self.mark_changed()
        self.becomes.set_value(self.changes.entry(self.material))
        self.sliders.clear()
        with self.sliders:
            heading(f"Absorption of {self.material}")
            with ui.element("div").classes("sliders"):
                values = self.changes.spectrum(self.material)
                for band, centre_hz in enumerate(self.changes.bands_hz):
                    word = hertz(centre_hz)
                    label = f"Absorption of {self.material} at {word}"
                    BandSlider(word, label, values[band], partial(self.slide, band))

    def mark_changed(self) -> None:
        """Say in the list which materials are changed."""
        chosen = self.changes.chosen
        marked = {m: f"{m} (changed)" if m in chosen else m for m in self.changes.found}
        if self.of.options != marked:
            self.of.set_options(marked)

    def select(self, material: str) -> None:
        """Choose the material to which the sliders belong."""
        self.material = material
        self.show_sliders()

    def aim(self, parameter: str, value: float | None) -> None:
        """Set the target of a parameter; None: none."""
        self.targets[parameter] = value
        self.on_target()

    async def choose_entry(self, name: str | None) -> None:
        """Let the material become an entry of the catalogue; None: what it is."""
        if name == self.changes.entry(self.material):
            return  # said by the page itself, for another material was chosen
        if name is None:
            self.changes.chosen.pop(self.material, None)
        else:
            self.changes.chosen[self.material] = name
        self.show_sliders()
        await self.on_changed()

    async def slide(self, band: int, value: float) -> None:
        """Give the material another absorption in one band."""
        if self.changes.move(self.material, band, value):
            self.mark_changed()
            self.becomes.set_value(None)
            await self.on_changed()

    async def reset(self) -> None:
        """Take all changes back."""
        self.changes.chosen.clear()
        self.show_sliders()
        await self.on_changed()


class Sounds:
    """What the changes sound like, as responses or by a dry recording."""

    def __init__(self, bench: Bench, changes: Changes) -> None:
        self.bench = bench
        self.changes = changes
        self.dry = ""  # name of the recording; none: the responses themselves
        self.place = ui.element("div").classes("panel").style("margin-top: 0.75rem")

    def make(self) -> None:
        """Put the making of the sounds into the queue."""
        own = {
            "folder": str(self.bench.folder),
            "changes": self.changes.written(),
            "dry": self.dry,
            "doubted": self.changes.doubted,
        }
        self.bench.jobs.add("Before and after", "listen", own, _SOUNDING)

    def choose_dry(self, name: str | None) -> None:
        """Choose what is listened to."""
        self.dry = name or ""

    async def take_dry(self, names: list[str]) -> None:
        """Choose the last of the recordings that were sent."""
        self.dry = names[-1]
        self.show()

    def show(self) -> None:
        """Show what can be listened to, unless it is shown already."""
        folder = self.bench.folder / project.DRY
        known = sorted(p.name for p in folder.iterdir()) if folder.is_dir() else []
        made = self.bench.folder / project.LISTENED / "listen.json"
        if not emptied(self.place, (known, made.is_file() and file_address(made))):
            return
        own = {"": "the responses themselves", **{n: n for n in known if n[0] != "."}}
        with self.place:
            heading("Before and after, to listen to")
            text = "A dry recording of one channel:"
            FileDrop(text, project.DRY, RESPONSE_SUFFIXES, self.take_dry)
            with ui.element("div").classes("bar").style("margin: 0.5rem 0"):
                ui.select(
                    own,
                    label="What to listen to",
                    value=self.dry if self.dry in own else "",
                    on_change=lambda e: self.choose_dry(e.value),
                ).props("outlined dense").style("flex: 1 1 16rem")
                text = "Make the sounds of what is set above"
                quiet_button(text, self.make)
            if made.is_file():
                markup(sounds_html(made.parent))


def sounds_html(folder: Path) -> str:
    """Return what `roomfit listen` has written, before and after side by side."""
    content, _ = written_content(folder / "listen.json", "sounds")
    rows = []
    for own in content["responses"][:100]:
        name = f"{own['source']} to {own['receiver']}"
        for dry in ("dry_", "") if content["dry_factor"] else ("",):
            what = "recording" if dry else "response"
            cells = [f"{escape(name)}, {what}"]
            for kind in ("before", "after"):
                source = escape(file_address(folder / str(own["files"][f"{dry}{kind}"])))
                label = escape(f"{name}, {what} {kind}")
                cells.append(
                    f'<audio controls preload="none" src="{source}" aria-label="{label}"></audio>'
                )
            rows.append(cells)
    table = table_html("At one volume: nothing is normalised by itself", _SOUND_HEADS, rows)
    return f'<p class="soft">{escape("; ".join(content["changes"]))}</p>{table}'


@dataclass(frozen=True, slots=True)
class _Axes:
    """Where bands and values lie in a chart, in the units of its drawing."""

    words: Sequence[str]  # of the bands
    ticks: Sequence[float]  # from the lowest value to the highest

    def x(self, band: int) -> float:
        left = _LEFT if len(self.words) > 1 else 0.5 * (_WIDE + _LEFT) - 16.0
        return left + 16.0 + (_WIDE - left - 24.0) / max(len(self.words) - 1, 1) * band

    def y(self, value: float) -> float:
        low, high = self.ticks[0], self.ticks[-1]
        return float(10.0 + (_HIGH - 10.0 - _BELOW) * (high - value) / (high - low))

    def line(self, values: Sequence[float | None], style: str) -> str:
        """Return a line through values, those left out that are not known."""
        at = [(self.x(i), self.y(v)) for i, v in enumerate(values) if v is not None]
        if len(self.words) == 1:  # a line of one point is not seen
            at = [(px + dx, py) for px, py in at for dx in (-30.0, 30.0)]
        return f'<polyline points="{" ".join(f"{a:.1f},{b:.1f}" for a, b in at)}" {style}/>'

    def bars(
        self,
        lower: Sequence[float | None],
        upper: Sequence[float | None],
        style: str,
        beside: float = 0.0,
    ) -> list[str]:
        """Return an upright bar for each interval, cut off at the edges."""
        low, high = self.ticks[0], self.ticks[-1]
        return [
            f'<line x1="{self.x(i) + beside:.1f}" x2="{self.x(i) + beside:.1f}" '
            f'y1="{self.y(max(a, low)):.1f}" y2="{self.y(min(b, high)):.1f}" {style}/>'
            for i, (a, b) in enumerate(zip(lower, upper, strict=True))
            if a is not None and b is not None and a < high and b > low
        ]

    def grid(self) -> list[str]:
        """Return a line and a number for each tick, and a word for each band."""
        parts = [
            f'<line x1="{_LEFT}" x2="{_WIDE}" y1="{self.y(value):.1f}" y2="{self.y(value):.1f}" '
            f'stroke="var(--line)"/><text x="{_LEFT - 4}" y="{self.y(value) + 4:.1f}" '
            f'text-anchor="end">{value:.6g}</text>'
            for value in self.ticks
        ]
        if len(self.words) > 1:
            parts.append(f'<text x="{_LEFT - 4}" y="{_HIGH - 6}" text-anchor="end">Hz</text>')
        return parts + [
            f'<text x="{self.x(i):.1f}" y="{_HIGH - 6}" text-anchor="middle">{escape(word)}</text>'
            for i, word in enumerate(self.words)
        ]

    def limit(self, limit: Mapping[str, Any], bands_hz: Sequence[float]) -> str:
        """Return the line of a limit across the bands in which it holds."""
        at = [i for i, f in enumerate(bands_hz) if f in limit["bands_hz"]]
        left, right = _LEFT, _WIDE
        if at and len(self.words) > 1:
            left, right = self.x(min(at)) - 14.0, self.x(max(at)) + 14.0
        y = self.y(limit["value"])
        return (
            f'<line class="limit" x1="{left:.1f}" x2="{right:.1f}" y1="{y:.1f}" y2="{y:.1f}" '
            'stroke="var(--bad)" stroke-width="2" stroke-dasharray="9 3"/>'
        )


def _ticks(name: str, shown: Sequence[float], ends: Sequence[float]) -> list[float]:
    """Return the ticks of a parameter's chart, from all values that it shows, and interval ends.

    An interval may be endless: it ends at the edge then, and does not make all else small.
    """
    is_time = name.endswith("_s")
    wide = max(shown) - (0.0 if is_time else min(shown)) or 1.0
    low = 0.0 if is_time else max(min([*shown, *ends]), min(shown) - wide)
    high = min(max([*shown, *ends]), max(shown) + wide)
    drawn = map(float, MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high))
    most = _MOST.get(name)
    ticks = [t for t in drawn if most is None or 0.0 <= t <= most]
    return ticks if len(ticks) > 1 else [0.0, most or 1.0]


def chart_svg(
    view: Mapping[str, Any],
    name: str,
    bands_hz: Sequence[float],
    limits: Sequence[Mapping[str, Any]],
) -> str:
    """Return one room parameter over the bands as a drawing, in the colours of the page.

    By hand: `ui.echart` would add 1.7 MB of script, draws intervals only by a function in
    JavaScript, and takes neither the page's colours nor a text that says what is drawn.
    """
    label, mean = _LABELS[name], view["mean"][name]
    pairs = [pair[name]["predicted"] for pair in view["pairs"]]
    sure = [*mean["predicted"], *mean.get("before", []), *(v for p in pairs for v in p)]
    known = [v for v in (*sure, *(x["value"] for x in limits)) if v is not None]
    ends = [v for v in (*mean["lower95"], *mean["upper95"]) if v is not None]
    if not known:
        return f"<p>{escape(label)}: not known</p>"
    words = [_SPEECH] if name == "STI" else [short_hertz(f) for f in bands_hz]
    axes = _Axes(words, _ticks(name, known, ends))
    thin = 'fill="none" stroke="var(--soft)" stroke-width="0.6" opacity="0.6"'
    parts = [*axes.grid(), *(axes.line(p, thin) for p in pairs[:200])]
    if "before" in mean:
        dashed = 'fill="none" stroke="var(--ink)" stroke-dasharray="5 4"'
        before = 'stroke="var(--ink)" stroke-width="1.2"'
        parts.append(axes.line(mean["before"], dashed))
        parts += axes.bars(mean["before_lower95"], mean["before_upper95"], before, -5.0)
    wide = 'stroke="var(--accent)" stroke-width="5" opacity="0.45"'
    parts += axes.bars(mean["lower95"], mean["upper95"], wide)
    strong = 'fill="none" stroke="var(--accent)" stroke-width="2.4"'
    parts.append(axes.line(mean["predicted"], strong))
    parts += [axes.limit(limit, bands_hz) for limit in limits]
    means = ", ".join("unknown" if v is None else f"{v:.2f}" for v in mean["predicted"])
    lines = ", ".join(f"{limit['value']:.2f}" for limit in limits) or "none"
    of = "" if name == _TIMES else ", mean over the pairs"
    spoken = escape(f"{label}{of} by band: {means}; limits: {lines}")
    return (
        f"<h2>{escape(label)}</h2>"
        f'<svg viewBox="0 0 {_WIDE:.0f} {_HIGH:.0f}" role="img" font-size="13" fill="currentColor" '
        f'aria-label="{spoken}">{"".join(parts)}</svg>'
    )


def pairs_html(view: Mapping[str, Any], bands_hz: Sequence[float]) -> str:
    """Return every parameter of every pair as a table."""
    rows = []
    names = [n for n in _LABELS if n in view["mean"]]
    for pair in view["pairs"][:100]:
        for name in names:
            own = pair[name]
            cells = [f"{escape(pair['source'])} to {escape(pair['receiver'])}", _LABELS[name]]
            for value, low, high in zip(
                own["predicted"], own["lower95"], own["upper95"], strict=True
            ):
                if value is None:
                    cells.append("-")
                    continue
                ends = "" if low is None or high is None else f"{low:.2f}-{high:.2f}"
                cells.append(f'{value:.2f}<div class="small">{ends}</div>')
            cells += [""] * (2 + len(bands_hz) - len(cells))  # the index is of all bands together
            rows.append(cells)
    heads = ["Pair", "Parameter", *(hertz(f) for f in bands_hz)]
    return table_html("Where a measurement is expected, 95 of 100 times", heads, rows)
