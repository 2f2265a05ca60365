"""What if: other materials, and what they would do to every pair."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from functools import partial
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import quote

from matplotlib.ticker import MaxNLocator
from nicegui import ui

from roomfit.app import project
from roomfit.app.elements import (
    BandSlider,
    FileDrop,
    emptied,
    heading,
    markup,
    said,
    table_html,
)
from roomfit.app.server import Bench
from roomfit.errors import InputError
from roomfit.io.door import json_content, read_text
from roomfit.io.responses import RESPONSE_SUFFIXES
from roomfit.materials.catalogue import catalogue
from roomfit.report.wording import count, short_hertz

_LABELS = {
    "T20_s": "T20 in s",
    "EDT_s": "EDT in s",
    "C80_dB": "C80 in dB",
    "D50_percent": "D50 in %",
    "STI": "STI",
}
_STAGES = ((0.0, "tracing"), (0.8, "searching"))
_SOUNDING = ((0.0, "tracing"), (0.6, "scaling"))
_PREPARE_S = 900.0  # a change may need it, too, where the process was started again
_MOST = {"D50_percent": 100.0, "STI": 1.0}
_SPEECH = "125 to 8k Hz together"
_SOUND_HEADS = ("Pair", "Before", "After")
_WIDE, _HIGH, _LEFT, _BELOW = 320.0, 190.0, 44.0, 24.0


def build(bench: Bench) -> Callable[[], Awaitable[None]]:
    """Draw the tab; return what draws it anew."""
    room: dict[str, Any] = {}
    # per material a name of the catalogue, or absorption per band
    changes: dict[str, str | list[float]] = {}
    targets: dict[str, float | None] = {}
    fields: dict[str, ui.select] = {}
    state: dict[str, Any] = {
        "busy": False,
        "again": False,
        "material": None,
        "last": None,
        "dry": "",
        "asked": 0,  # number of the view that was asked for last
    }

    with ui.element("div").classes("bar"):
        note = ui.label("").classes("soft")
    both = ui.element("div").style("width: 100%")
    with both:
        with ui.element("div").classes("panel"):
            choices = ui.element("div").classes("bar")
            sliders = ui.element("div")
            aims = ui.element("div")
        charts = ui.element("div").classes("charts").style("margin: 0.75rem 0")
        with charts:
            pictures = {name: markup("").classes("panel") for name in _LABELS}
        pairs = ui.expansion("Every pair in numbers", on_value_change=lambda: draw_pairs())
        with pairs.classes("panel"):
            numbers = markup("")
        sounds = ui.element("div").classes("panel").style("margin-top: 0.75rem")
        hung = ui.element("div").classes("panel").style("margin-top: 0.75rem")
    both.set_visibility(False)

    def hang() -> None:
        bench.jobs.add("What to hang where", "treat", {"folder": str(bench.folder)}, _STAGES)

    def show_hung() -> None:
        out = bench.folder / project.TREATMENT
        written_files = {f: _place(f) for f in (sorted(out.iterdir()) if out.is_dir() else ())}
        has_question = (bench.folder / "treatment.toml").is_file()
        if not emptied(hung, (has_question, written_files)):
            return
        with hung:
            heading("What to hang where")
            if not has_question:
                text = "Write products and targets into treatment.toml in the project's folder."
                ui.label(text).classes("soft")
                return
            ui.button("Search for the cheapest that meets the targets", on_click=hang).props(
                "no-caps outline color=quiet"
            )
            for file, place in written_files.items():
                if file.suffix == ".png":
                    markup(f'<img alt="{escape(file.stem)}" src="{escape(place)}" width="100%">')
                elif not file.name.startswith("."):
                    markup(f'<a href="{escape(place)}&save=1">{escape(file.name)}</a>')

    def hear() -> None:
        own = {"changes": written(changes, room["absorption"]), "dry": state["dry"] or ""}
        arguments = {"folder": str(bench.folder), **own}
        bench.jobs.add("Before and after", "listen", arguments, _SOUNDING)

    async def dry_sent(names: list[str]) -> None:
        state["dry"] = names[-1]
        show_sounds()

    def show_sounds() -> None:
        folder = bench.folder / project.DRY
        known = sorted(p.name for p in folder.iterdir()) if folder.is_dir() else []
        made = bench.folder / project.LISTENED / "listen.json"
        if not emptied(sounds, (known, made.is_file() and _place(made))):
            return
        with sounds:
            heading("Before and after, to listen to")
            own = {"": "the responses themselves", **{n: n for n in known if n[0] != "."}}
            FileDrop("A dry recording of one channel:", project.DRY, RESPONSE_SUFFIXES, dry_sent)
            with ui.element("div").classes("bar").style("margin: 0.5rem 0"):
                ui.select(
                    own,
                    label="What to listen to",
                    value=state["dry"] if state["dry"] in own else "",
                    on_change=lambda e: state.update(dry=e.value),
                ).props("outlined dense").style("flex: 1 1 16rem")
                ui.button("Make the sounds of what is set above", on_click=hear).props(
                    "no-caps outline color=quiet"
                )
            if made.is_file():
                markup(sounds_html(made.parent))

    async def evaluate() -> None:
        """Evaluate what is chosen now; while one is under way, the newest waits, no other."""
        if state["busy"]:
            state["again"] = True
            return
        state["busy"] = True
        try:
            while True:
                state["again"] = False
                own = {"folder": str(bench.folder), "changes": written(changes, room["absorption"])}
                asked = state["asked"]
                found = await bench.what_if.ask("what_if", own, limit_s=_PREPARE_S)
                if both.is_deleted:  # the page was closed meanwhile
                    return
                if asked == state["asked"]:  # the room is still the one that was asked about
                    state["last"] = found
                    draw()
                if not state["again"]:
                    break
        except InputError as error:
            said(error, both)
        finally:
            state["busy"] = False

    def draw() -> None:
        view = state["last"]
        if view is None:  # it is being prepared
            return
        for name, picture in pictures.items():
            picture.set_visibility(name in view["mean"])
            if name in view["mean"]:
                limits = [x for x in room["limits"] if x["parameter"] == name]
                typed = targets.get(name)
                if typed is not None:
                    limits.append({"value": typed, "bands_hz": room["bands_hz"]})
                picture.set_content(chart_svg(view, name, room["bands_hz"], limits))
        draw_pairs()
        note.set_text(
            f"{count(len(view['pairs']), 'pair')}, {count(len(changes), 'material')} changed. "
            "Lines: mean over the pairs with its 95 % interval; dashed: the same as it is now; "
            "thin: each pair; red: limits."
        )

    def draw_pairs() -> None:
        if pairs.value and state["last"] is not None:
            numbers.set_content(pairs_html(state["last"], room["bands_hz"]))

    async def choose_entry(value: str | None) -> None:
        now = changes.get(state["material"])
        if value == (now if isinstance(now, str) else None):
            return  # said by the page itself, for another material was chosen
        if value is None:
            changes.pop(state["material"], None)
        else:
            changes[state["material"]] = value
        show_controls()
        await evaluate()

    async def slide(band: int, value: float) -> None:
        material = state["material"]
        now = changes.get(material)
        values = list(now) if isinstance(now, list) else spectrum(material)
        if values[band] == value:
            return
        values[band] = value
        changes[material] = values
        mark_changed()
        fields["entry"].set_value(None)
        await evaluate()

    def spectrum(material: str) -> list[float]:
        now = changes.get(material)
        if isinstance(now, list):
            return now
        found = [round(a, 3) for a in room["absorption"][material]]
        if now is None:
            return found
        entry = next(e for e in catalogue().entries if e.name == now)
        octaves = dict(
            zip((63.0, 125.0, 250.0, 500.0, 1e3, 2e3, 4e3, 8e3), entry.absorption, strict=True)
        )
        return [
            round(float(octaves.get(f, a)), 3) for f, a in zip(room["bands_hz"], found, strict=True)
        ]

    async def reset() -> None:
        changes.clear()
        show_controls()
        await evaluate()

    def select(material: str) -> None:
        state["material"] = material
        show_controls()

    def aim(name: str, value: float | None) -> None:
        targets[name] = value
        draw()

    def build_controls() -> None:
        entries = {e.name: f"{e.name}: {e.description}" for e in catalogue().entries}
        with choices:
            fields["material"] = (
                ui.select(
                    list(room["absorption"]),
                    value=state["material"],
                    label="Material",
                    on_change=lambda e: select(e.value),
                )
                .props("outlined dense")
                .style("width: 14rem")
            )
            fields["entry"] = (
                ui.select(
                    entries,
                    label="Becomes (search the catalogue)",
                    with_input=True,
                    clearable=True,
                    on_change=lambda e: choose_entry(e.value),
                )
                .props("outlined dense")
                .style("flex: 1 1 16rem")
            )
            ui.button("Undo all changes", on_click=reset).props("no-caps outline color=quiet")
        if emptied(aims, room["names"]):
            with aims:
                heading("Targets")
                with ui.element("div").classes("bar"):
                    for name in room["names"]:
                        ui.number(
                            _LABELS[name],
                            value=targets.get(name),
                            step=0.1,
                            on_change=lambda e, name=name: aim(name, e.value),
                        ).props("outlined dense clearable").style("width: 8rem")

    def show_controls() -> None:
        """Bring the sliders to the material that is chosen; what is above them stays."""
        mark_changed()
        now = changes.get(state["material"])
        fields["entry"].set_value(now if isinstance(now, str) else None)
        sliders.clear()
        with sliders:
            heading(f"Absorption of {state['material']}")
            with ui.element("div").classes("sliders"):
                values = spectrum(state["material"])
                for band, centre_hz in enumerate(room["bands_hz"]):
                    word = f"{short_hertz(centre_hz)} Hz"
                    label = f"Absorption of {state['material']} at {word}"
                    BandSlider(word, label, values[band], partial(slide, band))

    def mark_changed() -> None:
        marked = {m: f"{m} (changed)" if m in changes else m for m in room["absorption"]}
        if fields["material"].options != marked:
            fields["material"].set_options(marked)

    async def refresh() -> None:
        if project.best_result(bench.folder) is None:
            note.set_text("No answer yet: identify first.")
            both.set_visibility(False)
            return
        note.set_text(
            "The room is traced for changes; this takes seconds, in a large room minutes."
        )
        state["last"] = None
        state["asked"] += 1
        asked = state["asked"]
        own = {"folder": str(bench.folder)}
        try:
            found = await bench.what_if.ask("what_if_prepare", own, limit_s=_PREPARE_S)
        except InputError:
            note.set_text("The room could not be prepared.")
            raise
        if both.is_deleted or asked != state["asked"]:  # the page was closed, or asked once more
            return
        room.update(found)
        room["names"] = [n for n in _LABELS if n in found["mean"]]
        for gone in [m for m in changes if m not in room["absorption"]]:
            del changes[gone]
        if state["material"] not in room["absorption"]:
            state["material"] = next(iter(room["absorption"]))
        both.set_visibility(True)
        show_hung()
        show_sounds()
        if emptied(choices, (room["bands_hz"], room["absorption"], room["names"])):
            build_controls()
            show_controls()
        state["last"] = found
        draw()
        if changes:
            await evaluate()

    return refresh


def written(
    changes: Mapping[str, str | list[float]], absorption: Mapping[str, Sequence[float]]
) -> list[str]:
    """Return changes as ``roomfit predict --set`` takes them.

    Absorption that was moved is a factor on what was found, which keeps what is not known of it.

    Examples
    --------
    >>> written({"wall": [0.2, 0.3], "floor": "carpet-on-underlay"}, {"wall": [0.1, 0.3]})
    ['wall=x2,x1', 'floor=carpet-on-underlay']
    """
    texts = []
    for material, own in changes.items():
        if isinstance(own, str):
            texts.append(f"{material}={own}")
            continue
        found = absorption[material]
        # a band that nobody has touched stays exactly as it was found
        factors = [
            1.0 if round(now, 3) == round(was, 3) else now / was
            for now, was in zip(own, found, strict=True)
        ]
        texts.append(f"{material}={','.join(f'x{f:.6g}' for f in factors)}")
    return texts


def _place(file: Path) -> str:
    """Return the address of a file of a result; another one when it is written anew."""
    return f"/files/{file.parent.name}/{quote(file.name)}?of={file.stat().st_mtime_ns}"


def sounds_html(folder: Path) -> str:
    """Return what `roomfit listen` has written, before and after side by side."""
    content = json_content(read_text(folder / "listen.json", "sounds"), "sounds")
    rows = []
    for own in content["responses"][:100]:
        name = f"{own['source']} to {own['receiver']}"
        for dry in ("dry_", "") if content["dry_factor"] else ("",):
            what = "recording" if dry else "response"
            cells = [f"{escape(name)}, {what}"]
            for kind in ("before", "after"):
                source = escape(_place(folder / str(own["files"][f"{dry}{kind}"])))
                label = escape(f"{name}, {what} {kind}")
                cells.append(
                    f'<audio controls preload="none" src="{source}" aria-label="{label}"></audio>'
                )
            rows.append(cells)
    table = table_html("At one volume: nothing is normalised by itself", _SOUND_HEADS, rows)
    return f'<p class="soft">{escape("; ".join(content["changes"]))}</p>{table}'


def chart_svg(
    view: Mapping[str, Any],
    name: str,
    bands_hz: Sequence[float],
    limits: Sequence[Mapping[str, Any]],
) -> str:
    """Return one room parameter over the bands as a drawing, in the colours of the page.

    Parameters
    ----------
    limits : sequence of mappings
        Each with a value and the bands in Hz across which it is drawn.
    """
    mean = view["mean"][name]
    words = [_SPEECH] if name == "STI" else [short_hertz(f) for f in bands_hz]
    pairs = [pair[name]["predicted"] for pair in view["pairs"]]
    sure = [*mean["predicted"], *mean.get("before", []), *(v for p in pairs for v in p)]
    known = [v for v in (*sure, *(x["value"] for x in limits)) if v is not None]
    ends = [v for v in (*mean["lower95"], *mean["upper95"]) if v is not None]
    if not known:
        return f"<p>{escape(_LABELS[name])}: not known</p>"
    # an interval may be endless: it ends at the edge then, and does not make all else small
    wide = max(known) - (0.0 if name.endswith("_s") else min(known)) or 1.0
    low = max(min(known + ends), min(known) - wide)
    high = min(max(known + ends), max(known) + wide)
    low = 0.0 if name.endswith("_s") else low
    drawn = map(float, MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high))
    most = _MOST.get(name)
    ticks = [t for t in drawn if most is None or 0.0 <= t <= most]
    ticks = ticks if len(ticks) > 1 else [0.0, most or 1.0]
    low, high = ticks[0], ticks[-1]
    left = _LEFT if len(words) > 1 else 0.5 * (_WIDE + _LEFT) - 16.0
    step = (_WIDE - left - 24.0) / max(len(words) - 1, 1)

    def x(band: int) -> float:
        return left + 16.0 + step * band

    def y(value: float) -> float:
        return float(10.0 + (_HIGH - 10.0 - _BELOW) * (high - value) / (high - low))

    def line(values: Sequence[float | None], style: str) -> str:
        at = [(x(i), y(v)) for i, v in enumerate(values) if v is not None]
        if len(words) == 1:  # a line of one point is not seen
            at = [(px + dx, py) for px, py in at for dx in (-30.0, 30.0)]
        return f'<polyline points="{" ".join(f"{a:.1f},{b:.1f}" for a, b in at)}" {style}/>'

    def bars(which: str, beside: float, style: str) -> list[str]:
        ends = enumerate(zip(mean[f"{which}lower95"], mean[f"{which}upper95"], strict=True))
        return [
            f'<line x1="{x(i) + beside:.1f}" x2="{x(i) + beside:.1f}" y1="{y(max(a, low)):.1f}" '
            f'y2="{y(min(b, high)):.1f}" {style}/>'
            for i, (a, b) in ends
            if a is not None and b is not None and a < high and b > low
        ]

    parts = []
    for value in ticks:
        parts.append(
            f'<line x1="{_LEFT}" x2="{_WIDE}" y1="{y(value):.1f}" y2="{y(value):.1f}" '
            f'stroke="var(--line)"/><text x="{_LEFT - 4}" y="{y(value) + 4:.1f}" '
            f'text-anchor="end">{value:.6g}</text>'
        )
    if len(words) > 1:
        parts.append(f'<text x="{_LEFT - 4}" y="{_HIGH - 6}" text-anchor="end">Hz</text>')
    for i, word in enumerate(words):
        parts.append(
            f'<text x="{x(i):.1f}" y="{_HIGH - 6}" text-anchor="middle">{escape(word)}</text>'
        )
    thin = 'fill="none" stroke="var(--soft)" stroke-width="0.6" opacity="0.6"'
    parts += [line(p, thin) for p in pairs[:200]]
    if "before" in mean:
        parts.append(line(mean["before"], 'fill="none" stroke="var(--ink)" stroke-dasharray="5 4"'))
        parts += bars("before_", -5.0, 'stroke="var(--ink)" stroke-width="1.2"')
    parts += bars("", 0.0, 'stroke="var(--accent)" stroke-width="5" opacity="0.45"')
    parts.append(line(mean["predicted"], 'fill="none" stroke="var(--accent)" stroke-width="2.4"'))
    for limit in limits:
        at = [i for i, f in enumerate(bands_hz) if f in limit["bands_hz"]]
        span = (x(min(at)) - 14.0, x(max(at)) + 14.0) if at and len(words) > 1 else (_LEFT, _WIDE)
        parts.append(
            f'<line class="limit" x1="{span[0]:.1f}" x2="{span[1]:.1f}" '
            f'y1="{y(limit["value"]):.1f}" y2="{y(limit["value"]):.1f}" '
            'stroke="var(--bad)" stroke-width="2" stroke-dasharray="9 3"/>'
        )
    label = _LABELS[name]
    means = ", ".join("unknown" if v is None else f"{v:.2f}" for v in mean["predicted"])
    lines = ", ".join(f"{limit['value']:.2f}" for limit in limits) or "none"
    spoken = escape(f"{label}, mean over the pairs by band: {means}; limits: {lines}")
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
    heads = ["Pair", "Parameter", *(f"{short_hertz(f)} Hz" for f in bands_hz)]
    return table_html("Where a measurement is expected, 95 of 100 times", heads, rows)
