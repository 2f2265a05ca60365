"""What several tabs are made of: the room, a place for files, tables and findings."""

from __future__ import annotations

import contextlib
from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import quote
from weakref import WeakKeyDictionary

from nicegui import events, ui
from nicegui.element import Element

from roomfit.base.errors import InputError

_WORDS = {"serious": "Serious", "warning": "Warning", "info": "Note"}
_SHOWN: WeakKeyDictionary[Element, object] = WeakKeyDictionary()


class Questions:
    """Which of several questions is the newest: only the answer to that one is shown."""

    def __init__(self, place: Element) -> None:
        self._place = place
        self._n_put = 0

    def put(self) -> Callable[[], bool]:
        """Count a question; return whether its answer is to be shown, to be called then."""
        self._n_put += 1
        return self.since()

    def since(self) -> Callable[[], bool]:
        """Return what is true until the next question, or until the page is closed."""
        own = self._n_put
        return lambda: not self._place.is_deleted and own == self._n_put


class RoomView(Element, component="room_view.js"):
    """The room in three dimensions; a surface is picked by a click."""

    def __init__(self, on_pick: Callable[[int], Any]) -> None:
        super().__init__()
        self._props["selected"] = -1
        self.on("pick", lambda event: on_pick(int(event.args)))

    def show(self, room: Mapping[str, Any]) -> None:
        """Draw another room."""
        keys = ("vertices", "faces", "edges", "surfaces", "materials", "sources", "receivers")
        own = {key: room[key] for key in keys}
        if own != self._props.get("room"):
            self._props["room"] = own
            self.update()

    def point_at(self, selected: int, mark: Sequence[float] | None) -> None:
        """Make one surface, or one place in m, stand out."""
        self._props["selected"], self._props["mark"] = selected, mark
        self.update()


class PlanView(Element, component="plan_view.js"):
    """The room from above; sources and receivers are dragged."""

    def __init__(self, on_dropped: Callable[[str, str, float, float], Awaitable[None]]) -> None:
        super().__init__()
        self._props["plan"] = {"edges": [], "points": [], "walls": []}

        async def dropped(event: events.GenericEventArguments) -> None:
            x, y = event.args["at"]
            await on_dropped(event.args["kind"], event.args["name"], float(x), float(y))

        self.on("dropped", dropped)

    def show(
        self,
        edges: Sequence[Sequence[float]],
        points: Sequence[Mapping[str, Any]],
        walls: Sequence[Sequence[Any]],
    ) -> None:
        """Draw edges x, y to x, y in m, points by kind, name and position, and names of walls."""
        self._props["plan"] = {"edges": list(edges), "points": list(points), "walls": list(walls)}
        self.update()


class FileDrop(Element, component="file_drop.js"):
    """A place where files are dropped or chosen; they are sent to ``/upload/PLACE/NAME``.

    With words in `pasted` also a text can be pasted, and is sent as the file ``pasted.csv``.
    """

    def __init__(
        self,
        label: str,
        place: str,
        suffixes: Iterable[str],
        on_sent: Callable[[list[str]], Any],
        pasted: str = "",
    ) -> None:
        super().__init__()
        self._props["label"], self._props["place"] = label, place
        self._props["pasted"] = pasted
        self._props["accept"] = ",".join(suffixes)
        self._props["multiple"] = place == "recordings"

        async def sent(event: events.GenericEventArguments) -> None:
            taken = [str(name) for name in event.args["taken"]]
            if taken:
                await on_sent(taken)

        self.on("sent", sent)


class Recorder(Element, component="recorder.js"):
    """Plays sweeps and records them; what was recorded is sent to ``/upload/measured``."""

    def __init__(self, on_measured: Callable[[dict[str, Any]], Awaitable[None]]) -> None:
        super().__init__()
        self._props["asked"] = {}

        async def measured(event: events.GenericEventArguments) -> None:
            await on_measured(dict(event.args))

        self.on("measured", measured)

    def ask(self, asked: Mapping[str, Any]) -> None:
        """Say what is measured: source, receiver, seconds, silence_s, repetitions, again."""
        if asked != self._props["asked"]:
            self._props["asked"] = dict(asked)
            self.update()


class BandSlider(Element, component="band_slider.js"):
    """A slider from 0.01 to 0.99."""

    def __init__(
        self, word: str, label: str, start: float, on_moved: Callable[[float], Awaitable[None]]
    ) -> None:
        super().__init__()
        self._props["word"], self._props["label"], self._props["start"] = word, label, start

        async def moved(event: events.GenericEventArguments) -> None:
            await on_moved(float(event.args))

        self.on("moved", moved, throttle=0.05)


def file_address(file: Path) -> str:
    """Return the address of a file of a result; another one when it is written anew."""
    return f"/files/{file.parent.name}/{quote(file.name)}?of={file.stat().st_mtime_ns}"


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


def finding_html(finding: Mapping[str, Any]) -> str:
    """Return a finding as HTML; its severity is a word, not a colour alone."""
    severity = str(finding["severity"])
    word = _WORDS.get(severity, severity)
    return (
        f'<div class="finding {escape(severity)}"><b>{escape(word)}</b>'
        f"{escape(str(finding['sentence']))}</div>"
    )


def findings(found: Iterable[Mapping[str, Any]]) -> None:
    """Show findings, the serious ones first, and of many of one kind the first."""
    order = list(_WORDS)
    kinds: dict[str, list[str]] = {}
    for finding in sorted(found, key=lambda f: order.index(f["severity"])):
        kinds.setdefault(str(finding.get("code", finding["sentence"])), []).append(
            finding_html(finding)
        )
    parts = []
    for own in kinds.values():
        shown = 1 if len(own) > 2 else len(own)
        parts += own[:shown]
        if own[shown:]:
            more = f"and {len(own) - shown} more of this kind"
            parts.append(f"<details><summary>{more}</summary>{''.join(own[shown:])}</details>")
    if parts:
        markup("".join(parts))


def table_html(caption: str, heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table whose cells are HTML already; the first of a row is its heading."""
    rows = list(rows)
    texts = [any(row[i].startswith("<div") for row in rows) for i in range(1, len(heads))]
    head = "".join(
        f'<th scope="col"{" class=text" if text else ""}>{escape(h)}</th>'
        for h, text in zip(heads, (False, *texts), strict=True)
    )
    body = "".join(
        f'<tr><th scope="row">{row[0]}</th>'
        + "".join(
            f'<td class="text">{cell}</td>' if text else f"<td>{cell}</td>"
            for cell, text in zip(row[1:], texts, strict=True)
        )
        + "</tr>"
        for row in rows
    )
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(caption)}">'
        f'<table class="data"><caption><span>{escape(caption)}</span></caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


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


def quiet_button(text: str, on_click: Callable[[], Any]) -> ui.button:
    """Show a button that does not stand out."""
    return ui.button(text, on_click=on_click).props("no-caps outline color=quiet")
