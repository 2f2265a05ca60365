"""What a tab draws when answers come late, twice, or to a page that was closed; no browser."""

from __future__ import annotations

import asyncio
import copy
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("nicegui", reason="the workbench needs the extra app")

from nicegui import Client, ui
from nicegui.page import page

from roomfit.app import (
    elements,
    identify_tab,
    measurements_tab,
    project,
    room_tab,
    views,
    what_if_tab,
)
from roomfit.app.jobs import Jobs
from roomfit.errors import InputError

BUILD = {
    "Room": room_tab.build,
    "Measurements": measurements_tab.build,
    "Identify": identify_tab.build,
    "What if": what_if_tab.build,
}


class Bench:
    """A project whose answers come when the test gives them."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.jobs, self.what_if = folder, Jobs(), self
        self.asked: list[asyncio.Future[Any]] = []

    async def ask(self, *_: Any, **__: Any) -> Any:
        self.asked.append(asyncio.get_running_loop().create_future())
        return await self.asked[-1]


def _value(number: float) -> dict[str, list[float]]:
    return {key: [number] for key in ("predicted", "lower95", "upper95")}


def answers(name: str, folder: Path) -> tuple[dict[str, Any], dict[str, Any], str]:
    """Return an old answer, a new one, and a text that only the new one leads to."""
    if name == "Room":
        old = views.room_view(lambda _: None, str(folder))
        return old, {**old, "volume_m3": 777.0}, "777.0 m³"
    if name == "Measurements":
        old = views.recordings_view(lambda _: None, str(folder), project.SHAPE)
        finding = {"code": "x", "severity": "info", "sentence": "It is new."}
        return old, {**old, "findings": [finding]}, "It is new."
    if name == "Identify":
        table = {"bands_hz": [1000.0], "materials": {}, "findings": [], "stale": False}
        return (
            {**table, "plan": ["old"], "made": 1.0},
            {**table, "plan": ["new"], "made": 2.0},
            "new",
        )
    room = {"bands_hz": [1000.0], "limits": [], "pairs": [], "mean": {"T20_s": _value(0.5)}}
    old = {**room, "absorption": {"brick": [0.1]}}
    return old, {**room, "absorption": {"plaster": [0.2]}}, "Absorption of plaster"


def shown(client: Client) -> str:
    """Return every text of a page."""
    parts = [getattr(e, "text", "") or getattr(e, "content", "") for e in client.elements.values()]
    return "\n".join(map(str, parts))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    views.set_room(lambda _: None, str(tmp_path), shoebox=[5.0, 4.0, 3.0])
    project.set_position(tmp_path, "receivers", "MP1", (1.0, 1.0, 1.2))
    (tmp_path / project.FULL).mkdir()
    (tmp_path / project.FULL / "result.json").write_text("{}")
    return tmp_path


async def ask(
    bench: Bench, refresh: Callable[[], Awaitable[None]]
) -> tuple[asyncio.Future[Any], asyncio.Future[None]]:
    """Let a tab ask; return its question, still open, and the tab that waits for it."""
    waiting = asyncio.ensure_future(refresh())
    n_asked = len(bench.asked)
    while len(bench.asked) == n_asked:
        await asyncio.sleep(0)
    return bench.asked[-1], waiting


@pytest.mark.parametrize("name", BUILD)
def test_an_older_answer_never_replaces_a_newer_one(name: str, folder: Path) -> None:
    old, new, word = answers(name, folder)

    async def late() -> None:
        client, bench = Client(page("/")), Bench(folder)
        with client:
            refresh = BUILD[name](bench)  # type: ignore[arg-type]
        asked_first, first = await ask(bench, refresh)
        asked_last, last = await ask(bench, refresh)
        asked_last.set_result(copy.deepcopy(new))
        await last
        assert word in shown(client)
        asked_first.set_result(copy.deepcopy(old))
        await first
        assert word in shown(client)

    asyncio.run(late())


@pytest.mark.parametrize("name", BUILD)
def test_an_equal_answer_leaves_everything_where_it_is(name: str, folder: Path) -> None:
    """What stays keeps the focus, what is half typed or open, and a click under way."""
    _, new, word = answers(name, folder)

    async def twice() -> None:
        client, bench = Client(page("/")), Bench(folder)
        with client:
            refresh = BUILD[name](bench)  # type: ignore[arg-type]
        drawn = []
        for _ in range(2):
            asked, waiting = await ask(bench, refresh)
            asked.set_result(copy.deepcopy(new))
            await waiting
            drawn.append(set(client.elements))
        assert word in shown(client) and drawn[0] == drawn[1]

    asyncio.run(twice())


@pytest.mark.parametrize("name", BUILD)
def test_an_answer_to_a_page_that_was_closed_disturbs_nobody(name: str, folder: Path) -> None:
    _, new, _ = answers(name, folder)

    async def closed() -> None:
        client, bench = Client(page("/")), Bench(folder)
        with client:
            refresh = BUILD[name](bench)  # type: ignore[arg-type]
        asked, waiting = await ask(bench, refresh)
        client.remove_all_elements()
        asked.set_result(copy.deepcopy(new))
        await waiting
        assert not client.elements

    asyncio.run(closed())


def test_bands_that_are_chosen_stay_until_the_campaign_says_others(folder: Path) -> None:
    _, new, _ = answers("Identify", folder)

    async def chosen() -> None:
        client, bench = Client(page("/")), Bench(folder)
        with client:
            refresh = identify_tab.build(bench)  # type: ignore[arg-type]

        async def lowest() -> Any:
            asked, waiting = await ask(bench, refresh)
            asked.set_result(copy.deepcopy(new))
            await waiting
            return field.value

        field = next(
            e
            for e in client.elements.values()
            if isinstance(e, ui.select) and e.props.get("label") == "Lowest octave"
        )
        assert await lowest() == 125.0
        field.set_value(500.0)
        project.set_position(folder, "receivers", "MP1", (2.0, 1.0, 1.2))
        assert await lowest() == 500.0
        project.set_bands(folder, 250.0, 4000.0)
        assert await lowest() == 250.0

    asyncio.run(chosen())


def test_an_error_is_shown_though_what_was_clicked_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    messages: list[str] = []
    # as NiceGUI's own it fails where the page of what was clicked cannot be found
    monkeypatch.setattr(
        ui, "notify", lambda text, **_: messages.append(f"{text}{ui.context.client.id[:0]}")
    )

    async def fail() -> None:
        client = Client(page("/"))
        with client:
            place = ui.element("div")
            with place:
                box = ui.element("div")
        slot = box.default_slot
        place.clear()
        del box
        with slot:
            elements.said(InputError("no such thing"), place)

    asyncio.run(fail())
    assert messages == ["no such thing"]
