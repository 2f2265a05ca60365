"""What tabs are made of: scripts that draw, a place for files, fields, findings and remedies."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from html import escape
from pathlib import Path
from typing import Any, ClassVar
from urllib.parse import quote
from weakref import WeakKeyDictionary

from nicegui import ui
from nicegui.element import Element

from roomfit.app import project
from roomfit.app.jobs import Bench
from roomfit.base.errors import InputError
from roomfit.base.findings import Edit
from roomfit.base.table import Table, Value, html_of
from roomfit.files import edits

_WORDS = {"serious": "Serious", "warning": "Warning", "info": "Note"}
_SHOWN: WeakKeyDictionary[Element, object] = WeakKeyDictionary()
Then = Callable[[], Any]


class Tab:
    """A tab: drawn where it is made, and drawn anew when one of its files has changed."""

    name: ClassVar[str]
    files: ClassVar[tuple[str, ...]]  # within the project's folder; folders, too

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.place = ui.element("div").style("width: 100%")
        self.n_asked = 0

    async def refresh(self) -> None:
        """Ask for what is to be shown now, and show it."""
        raise NotImplementedError

    async def newest(self, question: Awaitable[Any]) -> Any:
        """Return an answer; None where another question was put meanwhile, or the page closed."""
        self.n_asked += 1
        number = self.n_asked
        answer = await question
        return None if self.place.is_deleted or number != self.n_asked else answer


class Scripted(Element):
    """What a script of this folder draws: it sends one kind of event, and takes properties."""

    def __init__(
        self,
        event: str,
        on_event: Callable[[Any], Any],
        *,
        throttle: float = 0.0,
        **properties: Any,
    ) -> None:
        super().__init__()
        self.tell(**properties)
        self.on(event, lambda said: on_event(said.args), throttle=throttle)

    def tell(self, **properties: Any) -> None:
        """Draw with other properties, where they are others."""
        if any(
            key not in self.props or self.props[key] != value for key, value in properties.items()
        ):
            self.props.update(properties)
            self.update()


class RoomView(Scripted, component="room_view.js"):
    """The room in three dimensions; a surface is picked by a click."""


class PlanView(Scripted, component="plan_view.js"):
    """The room from above; sources and receivers are dragged."""


class Recorder(Scripted, component="recorder.js"):
    """Plays sweeps and records them; what was recorded is sent to ``/upload/measured``."""


class BandSlider(Scripted, component="band_slider.js"):
    """A slider from 0.01 to 0.99."""


class FileDrop(Scripted, component="file_drop.js"):
    """A place where files are dropped or chosen; they are sent to ``/upload/PLACE/NAME``."""


def file_drop(
    label: str,
    place: str,
    suffixes: Iterable[str],
    on_sent: Callable[[list[str]], Any],
    pasted: str = "",
) -> None:
    """Draw a place for files; with words in `pasted` also for a text, sent as ``pasted.csv``."""

    async def sent(said: Mapping[str, Any]) -> None:
        if said["taken"]:
            await on_sent([str(name) for name in said["taken"]])

    several, accept = place == "recordings", ",".join(suffixes)
    own: dict[str, Any] = {"label": label, "place": place, "accept": accept, "pasted": pasted}
    FileDrop("sent", sent, multiple=several, **own)


def field(
    table: dict[str, Any],
    key: str,
    label: str,
    options: Mapping[Any, str] | Sequence[str] | None = None,
    *,
    style: str = "",
    spoken: str = "",
    then: Then = lambda: None,
    **more: Any,
) -> Any:
    """Draw a field for a key of a table: a choice, a truth value, a text, or else a number."""
    value = table.get(key)
    is_number = options is None and not isinstance(value, bool | str)

    def changed(event: Any) -> Any:
        table[key] = typed(event.value) if is_number else event.value
        return then()

    made: Any
    if isinstance(value, bool):
        made = ui.checkbox(label, value=value, on_change=changed)
    else:
        more |= {"label": label, "value": value, "on_change": changed}
        if options is not None:
            options = dict(options) if isinstance(options, Mapping) else list(options)
            made = ui.select(options, multiple=isinstance(value, list), **more)
        else:
            # a browser's own field for numbers takes 5,42 for 542 where its language has a point
            checks = {"a number, as 5.42 or 5,42": lambda x: not isinstance(typed(x), str)}
            made = ui.input(validation=checks if is_number else None, **more)
        made.props("outlined dense" + " inputmode=decimal" * is_number).style(style)
    if spoken:
        made.props["aria-label"] = spoken
    return made


def typed(value: Any) -> Any:
    """Return what was typed as a number, its decimals after a comma or a point; None of nothing.

    A text that is no number stays one, which whoever takes it refuses.
    """
    if not isinstance(value, str):
        return value
    text = value.strip().replace("\N{MINUS SIGN}", "-").replace(",", ".")
    is_number = re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", text)
    return float(text) if is_number else value.strip() or None


def on_entered(made: Element, then: Then) -> None:
    """Do something when a field is left, or Enter is pressed in it."""
    for event in ("blur", "keydown.enter"):
        made.on(event, then)


def quiet_button(text: str, on_click: Then, spoken: str = "") -> ui.button:
    """Show a button that does not stand out."""
    made = ui.button(text, on_click=on_click).props("no-caps outline color=quiet")
    if spoken:
        made.props["aria-label"] = spoken
    return made


def file_address(file: Path) -> str:
    """Return the address of a file of a result; another one when it is written anew."""
    return f"files/{file.parent.name}/{quote(file.name)}?of={file.stat().st_mtime_ns}"


def markup(content: str) -> ui.html:
    """Show HTML whose texts have gone through `html.escape`: no other comes here."""
    return ui.html(content, sanitize=False)


def emptied(place: Element, content: object) -> bool:
    """Empty an element that shows other content, to be drawn anew; return whether it was.

    Where nothing has changed, the focus, what is half typed, what has been opened or plays, and a
    click that is under way stay.
    """
    if place in _SHOWN and _SHOWN[place] == content:
        return False
    _SHOWN[place] = content
    place.clear()
    return True


def heading(text: str, level: int = 2) -> None:
    """Show a heading."""
    markup(f"<h{level}>{escape(text)}</h{level}>")


def finding_html(severity: str, sentence: str) -> str:
    """Return a finding as HTML; its severity is a word, not a colour alone."""
    word = _WORDS.get(severity, severity)
    return f'<div class="finding {escape(severity)}"><b>{escape(word)}</b>{escape(sentence)}</div>'


def findings(found: Iterable[Mapping[str, Any]]) -> None:
    """Show findings, the serious ones first, and of many of one kind the first."""
    order = list(_WORDS)
    kinds: dict[str, list[str]] = {}
    for finding in sorted(found, key=lambda f: order.index(f["severity"])):
        kind, text = str(finding.get("code", finding["sentence"])), str(finding["sentence"])
        kinds.setdefault(kind, []).append(finding_html(str(finding["severity"]), text))
    for own in kinds.values():
        shown = 1 if len(own) > 2 else len(own)
        markup("".join(own[:shown]))
        if own[shown:]:
            more = f"and {len(own) - shown} more of this kind"
            markup(f"<details><summary>{more}</summary>{''.join(own[shown:])}</details>")


def show_table(caption: str, heads: Sequence[str], rows: Iterable[Sequence[Value]]) -> None:
    """Show a table that scrolls by itself where it is wider than the page."""
    table = html_of(Table(caption, heads, list(rows), kind="data"))
    region = f'role="region" aria-label="{escape(caption)}"'
    markup(f'<div class="scroll" tabindex="0" {region}>{table}</div>')


@contextlib.contextmanager
def saying_errors(page: Element) -> Iterator[None]:
    """Show what is wrong with the input until somebody closes it, unless the page has gone."""
    try:
        yield
    except InputError as error:
        # what NiceGUI says of a page that has gone
        with contextlib.suppress(RuntimeError), page.client:
            ui.notify(
                str(error),
                type="negative",
                multi_line=True,
                timeout=0,
                close_button="Close",
                classes="soft-break",
            )


class Advice:
    """The remedies of the findings of a tab; nothing is written before it was shown."""

    def __init__(self, folder: Path) -> None:
        self.file = project.campaign_file(folder)
        self.place = ui.element("section").props('aria-label="Remedies"').style("width: 100%")
        self.dialog = ui.dialog().props('aria-label="What is written"')
        self.is_open = False  # stays as it is where it is drawn anew

    def show(self, advised: Sequence[Mapping[str, Any]]) -> None:
        """Draw a button for each code of a finding, with a choice where there is one."""
        can_undo = edits.undoable(self.file) is not None
        if not emptied(self.place, (advised, can_undo)) or not (advised or can_undo):
            return
        with self.place, ui.expansion("What the findings advise").classes("panel remedies") as own:
            own.bind_value(self, "is_open")
            for entry in advised:
                self._show_entry(entry)
            if can_undo:
                with ui.element("div").classes("bar"):
                    quiet_button("Undo the last remedy", self._undo)

    def _show_entry(self, entry: Mapping[str, Any]) -> None:
        name, options = str(entry["code"]).replace("-", " "), list(entry["options"])
        text = f"{name[:1].upper()}{name[1:]}" + (f", {entry['n']} times" if entry["n"] > 1 else "")
        words = [str(option["words"]) for option in options]
        chosen: dict[str, Any] = {"number": 0}
        with ui.element("div").classes("bar"):
            markup(finding_html(entry["severity"], text))
            if len(options) == 1:
                quiet_button(f"Set {words[0]}", partial(self._ask, options[0]))
                return
            wide = "flex: 1 1 16rem; min-width: 0"
            field(chosen, "number", f"Set, of {name}", dict(enumerate(words)), style=wide)
            spoken = f"Set this, of {name}"
            quiet_button("Set this", lambda: self._ask(options[chosen["number"]]), spoken)

    def _ask(self, option: Mapping[str, Any]) -> None:
        with saying_errors(self.place):
            wanted = edits.preview(
                self.file,
                [Edit(tuple(e["table"]), e["key"], e["value"]) for e in option["edits"]],
            )
            lines = [
                f"<dt><code>{escape(table)}</code></dt>"
                f"<dd>now <code>{escape(now)}</code></dd><dd>then <code>{escape(then)}</code></dd>"
                for table, now, then in wanted.lines
            ]
            self.dialog.clear()
            with self.dialog, ui.card().classes("preview"):
                heading("What is written into campaign.toml")
                markup(f'<dl class="lines">{"".join(lines)}</dl>')
                with ui.element("div").classes("bar"):
                    apply = ui.button("Apply", on_click=partial(self._apply, wanted))
                    apply.props("no-caps autofocus")
                    quiet_button("Leave it as it is", self.dialog.close)
            self.dialog.open()

    def _apply(self, wanted: edits.Preview) -> None:
        self.dialog.close()
        with saying_errors(self.place):
            edits.apply(self.file, wanted)

    def _undo(self) -> None:
        with saying_errors(self.place):
            edits.undo(self.file)
