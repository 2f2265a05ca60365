"""What a tab draws when answers come late, twice, or to a page that was closed; no browser."""

from __future__ import annotations

import asyncio
import copy
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("nicegui", reason="the workbench needs the extra app")

from nicegui import Client, ui
from nicegui.page import page

from roomfit.app import jobs, project, tasks, views
from roomfit.app import page as own_page
from roomfit.app.answer_tabs import IdentifyTab, ReportTab
from roomfit.app.elements import Advice, typed
from roomfit.app.measurements_tab import MeasurementsTab, MeasureTab
from roomfit.app.room_tab import RoomTab
from roomfit.app.what_if_tab import Changes, WhatIfTab
from roomfit.base.bands import bands_between
from roomfit.files.responses.sweep import SweepResponse
from roomfit.signals.response import ImpulseResponse

ASKING = {tab.name: tab for tab in own_page.TABS if tab not in (MeasureTab, ReportTab)}


class Bench:
    """A project whose answers come when the test gives them."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.what_if, self.reader = folder, self, self
        self.asked: list[asyncio.Future[Any]] = []
        self.arguments: list[tuple[Any, ...]] = []  # of every question

    async def ask(self, _: str, *arguments: Any, **__: Any) -> Any:
        self.arguments.append(arguments)
        self.asked.append(asyncio.get_running_loop().create_future())
        return await self.asked[-1]


def _value(number: float) -> dict[str, list[float]]:
    return {key: [number] for key in ("predicted", "lower95", "upper95")}


def answers(name: str, folder: Path) -> tuple[dict[str, Any], dict[str, Any], str]:
    """Return an old answer, a new one, and a text that only the new one leads to."""
    if name == "Room":
        old = views.room_view(folder)
        return old, {**old, "volume_m3": 777.0}, "777.0 m³"
    if name == "Measurements":
        old = views.recordings_view(folder)
        finding = {"code": "x", "severity": "info", "sentence": "It is new.", "about": {}}
        return old, {**old, "findings": [finding]}, "It is new."
    if name == "Identify":
        old = {"made": 1.0, "stale": False, "advised": []}
        return old, {**old, "made": 2.0}, "report.html?2"
    room = {"bands_hz": [1000.0], "shown": "<p>T30</p>", "from_times": False}
    room |= {"left_out": "", "findings": [], "directions": ""}
    room["variants"] = {"names": [], "shown": ""}
    room["treatment"] = tasks.treatment_view(folder, [1000.0])
    old = {**room, "absorption": {"brick": [0.1]}}
    return old, {**room, "absorption": {"plaster": [0.2]}}, "Absorption of plaster"


def shown(client: Client) -> str:
    """Return every text of a page."""
    parts = [getattr(e, "text", "") or getattr(e, "content", "") for e in client.elements.values()]
    return "\n".join(map(str, parts))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    views.set_room(tmp_path, shoebox=[5.0, 4.0, 3.0])
    project.set_position(tmp_path, "receivers", "MP1", (1.0, 1.0, 1.2))
    (tmp_path / project.FULL).mkdir()
    (tmp_path / project.FULL / "result.json").write_text("{}")
    return tmp_path


async def ask(bench: Bench, tab: own_page.Tab) -> tuple[asyncio.Future[Any], asyncio.Future[None]]:
    """Let a tab ask; return its question, still open, and the tab that waits for it."""
    waiting = asyncio.ensure_future(tab.refresh())
    n_asked = len(bench.asked)
    while len(bench.asked) == n_asked:
        await asyncio.sleep(0)
    return bench.asked[-1], waiting


@pytest.mark.parametrize("name", ASKING)
def test_an_older_answer_never_replaces_a_newer_one(name: str, folder: Path) -> None:
    old, new, word = answers(name, folder)

    async def late() -> None:
        client, bench = Client(page("/")), Bench(folder)
        with client:
            tab = ASKING[name](bench)  # type: ignore[arg-type]
        asked_first, first = await ask(bench, tab)
        asked_last, last = await ask(bench, tab)
        asked_last.set_result(copy.deepcopy(new))
        await last
        assert word in shown(client)
        asked_first.set_result(copy.deepcopy(old))
        await first
        assert word in shown(client)

    asyncio.run(late())


@pytest.mark.parametrize("name", ASKING)
def test_an_equal_answer_leaves_everything_where_it_is(name: str, folder: Path) -> None:
    """What stays keeps the focus, what is half typed or open, and a click under way."""
    _, new, word = answers(name, folder)

    async def twice() -> None:
        client, bench = Client(page("/")), Bench(folder)
        with client:
            tab = ASKING[name](bench)  # type: ignore[arg-type]
        drawn = []
        for _ in range(2):
            asked, waiting = await ask(bench, tab)
            asked.set_result(copy.deepcopy(new))
            await waiting
            drawn.append(set(client.elements))
        assert word in shown(client) and drawn[0] == drawn[1]

    asyncio.run(twice())


@pytest.mark.parametrize("name", ASKING)
def test_an_answer_to_a_page_that_was_closed_disturbs_nobody(name: str, folder: Path) -> None:
    _, new, _ = answers(name, folder)

    async def closed() -> None:
        client, bench = Client(page("/")), Bench(folder)
        with client:
            tab = ASKING[name](bench)  # type: ignore[arg-type]
        asked, waiting = await ask(bench, tab)
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
            tab = IdentifyTab(bench)  # type: ignore[arg-type]

        async def lowest() -> Any:
            asked, waiting = await ask(bench, tab)
            asked.set_result(copy.deepcopy(new))
            await waiting
            return tab.lowest.value

        assert await lowest() == 125.0
        tab.lowest.set_value(500.0)
        project.set_position(folder, "receivers", "MP1", (2.0, 1.0, 1.2))
        assert await lowest() == 500.0
        project.set_bands(folder, 250.0, 4000.0)
        assert await lowest() == 250.0
        # what is chosen while an answer is under way stays as well
        project.set_bands(folder, 125.0, 4000.0)
        asked, waiting = await ask(bench, tab)
        tab.lowest.set_value(1000.0)
        asked.set_result(copy.deepcopy(new))
        await waiting
        assert tab.lowest.value == 1000.0

    asyncio.run(chosen())


# Each tab alone.


def tab_of(kind: type[own_page.Tab], folder: Path) -> tuple[Any, Bench, Client]:
    """Return a tab on a page of its own."""
    client, bench = Client(page("/")), Bench(folder)
    with client:
        return kind(bench), bench, client  # type: ignore[arg-type]


async def answer(bench: Bench, tab: own_page.Tab, view: Any) -> None:
    """Let a tab ask, and answer it."""
    asked, waiting = await ask(bench, tab)
    asked.set_result(view)
    await waiting


def test_changes_are_factors_on_what_was_found_and_forget_materials_that_are_gone() -> None:
    changes = Changes((500.0, 1000.0), {"wall": [0.1, 0.3], "floor": [0.2, 0.2]})
    assert changes.move("wall", 0, 0.2) and not changes.move("wall", 1, 0.3)
    changes.chosen["floor"] = "carpet-on-underlay"
    assert changes.written() == ["wall=x2,x1", "floor=carpet-on-underlay"]
    # from an entry of the catalogue on, a slider moves that entry's values
    entry = changes.spectrum("floor")
    assert entry != [0.2, 0.2] and changes.move("floor", 0, 0.5)
    assert changes.spectrum("floor") == [0.5, entry[1]] and changes.entry("floor") is None
    changes.take_result((500.0, 1000.0), {"floor": [0.2, 0.2]})
    assert list(changes.chosen) == ["floor"]
    # moves of sliders belong to their bands
    changes.take_result((500.0,), {"floor": [0.2]})
    assert not changes.chosen


def test_changes_from_a_doubted_result_are_offered_and_not_made(folder: Path) -> None:
    _, new, _ = answers("What if", folder)

    async def whole() -> None:
        tab, bench, _ = tab_of(WhatIfTab, folder)
        await answer(bench, tab, {"refused": "The walls are seriously doubted."})
        assert "seriously doubted" in tab.note.text
        assert tab.all_the_same.visible and not tab.both.visible
        tab.asked["doubted"] = True
        asking = asyncio.ensure_future(tab.take_doubted())
        for _ in range(5):
            await asyncio.sleep(0)
        assert bench.arguments[-1][-1]["doubted"]
        bench.asked[-1].set_result(copy.deepcopy(new))
        await asking
        # it stays, so that it can be taken back
        assert tab.both.visible and tab.all_the_same.visible
        tab.asked["doubted"] = False
        left_out = "Nothing is predicted at 500 Hz."
        await answer(bench, tab, {**new, "left_out": left_out})
        assert tab.all_the_same.visible and left_out in tab.note.text
        await answer(bench, tab, copy.deepcopy(new))
        assert not tab.all_the_same.visible

    asyncio.run(whole())


def test_while_a_change_is_evaluated_only_the_newest_waits(folder: Path) -> None:
    _, new, _ = answers("What if", folder)

    async def whole() -> None:
        tab, bench, _ = tab_of(WhatIfTab, folder)
        await answer(bench, tab, copy.deepcopy(new))
        moving = [asyncio.ensure_future(tab.slide(0, a)) for a in (0.3, 0.4, 0.5)]
        for _ in range(5):
            await asyncio.sleep(0)
        assert len(bench.asked) == 2  # the room, and the first move
        bench.asked[-1].set_result({**new, "shown": "<p>T30 again</p>"})
        for _ in range(5):
            await asyncio.sleep(0)
        assert len(bench.asked) == 3 and tab.changes.spectrum("plaster") == [0.5]
        bench.asked[-1].set_result({**new, "shown": "<p>T30 again</p>"})
        await asyncio.gather(*moving)
        assert len(bench.asked) == 3 and "1 material changed" in tab.note.text
        assert "T30 again" in tab.shown.content

    asyncio.run(whole())


# What findings advise.


ANSWER = {"made": 1.0, "stale": False, "advised": []}
ADVISED = {
    "code": "position-inconsistent",
    "severity": "serious",
    "n": 1,
    "options": [
        {
            "words": 'positions = "fit"',
            "edits": [{"table": ["identify"], "key": "positions", "value": "fit"}],
        }
    ],
}


def button(client: Client, text: str) -> ui.button:
    """Return the button of a page that says so."""
    (found,) = [e for e in client.elements.values() if isinstance(e, ui.button) and e.text == text]
    return found


async def press(own: ui.button) -> None:
    """Do what the server does when a button is clicked."""
    (clicked,) = [e for e in own._event_listeners.values() if e.type == "click"]
    own._handle_event({"listener_id": clicked.id, "args": {}})
    await asyncio.sleep(0)


def test_a_remedy_is_shown_then_written_then_undone(folder: Path) -> None:
    before = project.campaign_file(folder).read_text()

    async def whole() -> None:
        tab, bench, client = tab_of(IdentifyTab, folder)
        view = {**ANSWER, "advised": [ADVISED]}
        await answer(bench, tab, copy.deepcopy(view))
        assert "Position inconsistent" in shown(client) and "Undo" not in shown(client)
        await press(button(client, 'Set positions = "fit"'))
        text = shown(client)
        assert "[identify]" in text and "not stated" in text and tab.advice.dialog.value
        assert project.campaign_file(folder).read_text() == before
        await press(button(client, "Apply"))
        assert not tab.advice.dialog.value
        after = before.replace("to_hz = 4000\n", 'to_hz = 4000\npositions = "fit"\n')
        assert project.campaign_file(folder).read_text() == after != before
        await answer(bench, tab, {**ANSWER, "stale": True})
        await press(button(client, "Undo the last remedy"))
        assert project.campaign_file(folder).read_text() == before
        await answer(bench, tab, dict(ANSWER))
        assert "What the findings advise" not in shown(client)

    asyncio.run(whole())


def test_of_several_remedies_the_one_that_was_chosen_is_shown(folder: Path) -> None:
    options = [
        {
            "words": f'prior = "{entry}" for <floor>',
            "edits": [{"table": ["materials", "<floor>"], "key": "prior", "value": entry}],
        }
        for entry in ("cork-tiles", "carpet-on-underlay")
    ]
    entry = {"code": "broad-prior-assumed", "severity": "info", "n": 1, "options": options}

    async def whole() -> None:
        client = Client(page("/"))
        with client:
            Advice(folder).show([entry])
        (choice,) = [e for e in client.elements.values() if isinstance(e, ui.select)]
        choice.set_value(1)
        await press(button(client, "Set this"))
        text = shown(client)
        assert "carpet-on-underlay" in text and "cork-tiles" not in text
        assert "&lt;floor&gt;" in text and "<floor>" not in text

    asyncio.run(whole())


# A tab and the processes that answer it.


def walk(
    kind: type[own_page.Tab], folder: Path, way: Callable[[Any, Client], Awaitable[None]]
) -> None:
    """Show a tab of a project to who goes this way."""

    async def whole() -> None:
        client, bench = Client(page("/")), jobs.Bench(folder)
        with client:
            tab = kind(bench)
        try:
            await tab.refresh()
            await way(tab, client)
        finally:
            await bench.stop()

    asyncio.run(whole())


@pytest.mark.slow
def test_a_finding_is_shown_by_its_points_and_a_surface_that_is_picked_with_its_material(
    folder: Path,
) -> None:
    project.set_position(folder, "sources", "LS1", (2.0, 2.0, 1.5))
    project.set_position(folder, "receivers", "(7, 7, 7) m", (4.0, 9.0, 0.5))

    async def way(tab: Any, client: Client) -> None:
        places = [e.text for e in client.elements.values() if isinstance(e, ui.button)]
        assert "(7, 7, 7) m" in shown(client) and "Show 4.00, 9.00, 0.50" in places
        assert not any("7.00" in text for text in places)
        names = [s["name"] for s in tab.room["surfaces"]]
        assert "Surface floor" not in shown(client)
        tab.pick(names.index("floor"))
        assert "Surface floor" in shown(client) and "What floor is" in str(
            [e.props.get("label") for e in client.elements.values()]
        )
        pressed = [line.props["aria-pressed"] for line in tab.lines]
        assert pressed.count("true") == 1 and pressed[names.index("floor")] == "true"

    walk(RoomTab, folder, way)


@given(st.floats(-1e4, 1e4), st.sampled_from(".,"), st.sampled_from(["", " "]))
def test_a_number_is_what_it_is_with_a_comma_and_with_a_point(number, mark, around) -> None:
    """And what has both, or a unit, is none: 1.234,5 may be either."""
    text = f"{around}{number:.4f}{around}".replace(".", mark)
    assert typed(text) == round(number, 4)
    assert typed(f"1,{text.strip()} m") == f"1,{text.strip()} m"
    assert (typed(""), typed(number), typed("1.234,5")) == (None, number, "1.234,5")


@pytest.mark.slow
def test_a_position_is_stored_once_all_three_numbers_are_typed(folder: Path) -> None:
    project.name_measured(folder, "LS1", "MP1")

    async def way(tab: Any, _: Client) -> None:
        fields, before = tab.fields["sources", "LS1"], project.campaign_file(folder).read_text()
        for field, value in zip(fields[:2], (1.0, 2.0), strict=True):
            field.set_value(value)
        await tab.type_position("sources", "LS1")
        assert project.campaign_file(folder).read_text() == before
        fields[2].set_value("1,5 m")  # no number, which the field says
        await tab.type_position("sources", "LS1")
        assert project.campaign_file(folder).read_text() == before and fields[2].error
        fields[2].set_value("1,5")
        await tab.type_position("sources", "LS1")
        assert "position = [1.0, 2.0, 1.5]" in project.campaign_file(folder).read_text()
        assert [typed(field.value) for field in tab.fields["sources", "LS1"]] == [1.0, 2.0, 1.5]

    walk(MeasurementsTab, folder, way)


def test_a_response_is_shown_with_its_range_and_why_to_measure_again(folder: Path) -> None:
    bands, range_db = bands_between("octave", 125.0, 250.0), np.array([31.0, 47.0])
    again = "noise hides the decay in 125 Hz"
    found = SweepResponse(
        ImpulseResponse(np.ones(9), 48_000.0), -9.0, 0, -70.0, bands, range_db, (again,)
    ).content()
    found |= {"source": "<S>", "receiver": "R1"}

    async def way(tab: Any, client: Client) -> None:
        await tab.show(found)
        text = shown(client)
        assert "Measure again: noise hides the decay in 125 Hz." in text
        assert "31 dB" in text and "too short" in text and "&lt;S&gt; to R1" in text
        assert "It suffices" not in text
        await tab.show({**found, "again": [], "not_named": "The response is not in the campaign."})
        text = shown(client)
        assert "It suffices" in text and "not in the campaign" in text
        assert "again: noise" not in text
        (folder / project.RECORDINGS).mkdir()
        (folder / project.RECORDINGS / "S1_R1.wav").touch()
        await tab.refresh()
        assert "In recordings: S1_R1.wav" in shown(client)

    walk(MeasureTab, folder, way)
