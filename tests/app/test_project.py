"""The folder as state, what the tabs show, and the processes that work: no browser."""

from __future__ import annotations

import asyncio
import json
import os
import re
import shutil
import struct
import tempfile
import time
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import soundfile
from hypothesis import given, settings
from hypothesis import strategies as st

from roomfit.app import project, tasks, views
from roomfit.app.jobs import Bench, Worker
from roomfit.base.errors import InputError, located
from roomfit.base.findings import About, Code, Edit, Finding
from roomfit.base.typing import FloatArray
from roomfit.base.whole_files import write_json_atomically
from roomfit.cli.check import check_campaign_recordings
from roomfit.files.campaign import read_campaign
from roomfit.files.draft import draft_campaign
from roomfit.files.edits import apply, preview
from roomfit.files.schema import RoomSpec
from roomfit.files.values import read_parameters
from roomfit.room.mesh import refuse
from scans import HEIGHT_M, furniture, scan, scan_usdz


def nothing(_: float) -> None:
    """No progress is looked at."""


@pytest.fixture
def box(tmp_path: Path) -> Path:
    project.set_room(tmp_path, shoebox=(6.0, 5.0, 3.0))
    return tmp_path


def test_a_typed_box_is_a_campaign_that_the_command_line_reads(box: Path) -> None:
    campaign = read_campaign(project.campaign_file(box), to_fit=False)
    assert campaign.room.shoebox == (6.0, 5.0, 3.0)
    view = views.room_view(box)
    assert [m["name"] for m in view["materials"]] == ["walls", "floor", "ceiling"]
    assert view["traceable"] and view["volume_m3"] == pytest.approx(90.0)
    assert len(view["faces"]) == 12 and len(view["edges"]) == 12
    json.dumps(view, allow_nan=False)


NAMES = st.sampled_from(["carpet", "walls", "floor", "ceiling", "west", "my wall", "a.b", "Ä"])
PLACES = st.sampled_from([None, (1.0, 1.2, 1.3), (1.5, 1.1, 1.1)])
EDITS = st.one_of(
    st.tuples(st.just("box"), st.tuples(*[st.floats(2.0, 9.0)] * 3)),
    st.tuples(st.just("surface"), st.integers(0, 5), NAMES),
    st.tuples(st.just("prior"), st.integers(0, 5), st.sampled_from([None, "brick", "carpet"])),
    st.tuples(st.just("place"), st.sampled_from(["sources", "receivers"]), NAMES, PLACES),
    st.tuples(st.just("measured"), NAMES, NAMES),
    st.tuples(st.just("bands"), st.sampled_from([500.0, 4000.0])),
)


@settings(max_examples=15, deadline=None)
@given(st.lists(EDITS, max_size=12))
def test_whatever_the_page_has_written_it_reads(walk) -> None:
    """After any edits, by the functions that the page calls: no fault that an edit has made."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        views.set_room(folder, shoebox=(6.0, 5.0, 3.0))
        for kind, *own in walk:
            view = views.room_view(folder)
            if kind == "box":
                views.set_room(folder, shoebox=own[0])
            elif kind == "surface":
                surface = view["surfaces"][own[0]]["name"]
                project.set_surface_material(folder, surface, own[1])
            elif kind == "prior":
                material = view["materials"][own[0] % len(view["materials"])]["name"]
                project.set_prior(folder, material, own[1])
            elif kind == "place":
                project.set_position(folder, *own)
            elif kind == "measured":
                project.name_measured(folder, *own)
            else:
                project.set_bands(folder, 125.0, own[0])
            used = [m["name"] for m in views.room_view(folder)["materials"]]
            project.forget_unused_materials(folder, used)
            found = [
                *views.room_view(folder)["findings"],
                *views.recordings_view(folder)["findings"],
            ]
            assert [f for f in found if f["code"] == "input"] == []


@pytest.mark.parametrize("typed", [("5,42", 4.0, 3.0), (None, 4.0, 3.0), (5.0, 4.0)])
def test_lengths_that_are_no_numbers_are_refused(tmp_path: Path, typed) -> None:
    with pytest.raises(InputError, match="three numbers"):
        project.set_room(tmp_path, shoebox=typed)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["room.json", "room.usdz"])
def test_a_scan_that_is_sent_is_the_room_of_the_command(tmp_path: Path, name: str) -> None:
    """Looked at as it waits, then taken, with what it knows of beds and sofas."""
    if name.endswith("usdz"):
        pytest.importorskip("pxr")
    things = [furniture("bed", (2.0, 3.0), (1.4, 0.4, 2.0))]
    sent = scan_usdz() if name.endswith("usdz") else json.dumps({**scan(), "objects": things})
    (tmp_path / name).write_bytes(sent if isinstance(sent, bytes) else sent.encode())
    views.look_at_upload(tmp_path, "room", name)
    views.set_room(tmp_path, file=name, unit=None, space="")
    content = project.campaign_content(tmp_path)
    drafted = draft_campaign(RoomSpec(file=tmp_path / name), {}, folder=tmp_path)
    keys = ("room", "materials", "objects")
    assert [content.get(k) for k in keys] == [tomllib.loads(drafted).get(k) for k in keys]
    assert views.room_view(tmp_path)["traceable"]
    if name.endswith("usdz"):
        return
    # of decay times it absorbs as its entry says; another room has no outlines of this one
    views.set_room(tmp_path, file=name, unit=None, space="")
    assert project.campaign_content(tmp_path)["objects"] == content["objects"]
    project.set_decay_times(tmp_path, "t.csv")
    bed = project.campaign_content(tmp_path)["objects"]["bed"]
    assert bed["absorption_area_m2"] == "seats-heavy-empty" and "prior" not in bed
    views.set_room(tmp_path, file=name, unit=None, space="")
    assert project.campaign_content(tmp_path)["objects"]["bed"] == bed
    views.set_room(tmp_path, shoebox=[5.0, 4.0, 3.0])
    assert "bed" not in project.campaign_content(tmp_path).get("objects", {})


def test_of_a_scan_of_several_rooms_one_is_named(tmp_path: Path) -> None:
    box = [(0, 0), (4, 0), (4, 3), (0, 3)]
    rooms = [scan(), {**scan(box), "sections": [{"label": "kitchen"}]}]
    (tmp_path / "flat.json").write_text(json.dumps({"rooms": rooms}))
    views.look_at_upload(tmp_path, "room", "flat.json")
    with pytest.raises(InputError, match="'livingRoom', 'kitchen'"):
        views.set_room(tmp_path, file="flat.json", unit=None, space="")
    views.set_room(tmp_path, file="flat.json", unit=None, space="kitchen")
    view = views.room_view(tmp_path)
    assert view["volume_m3"] == pytest.approx(12.0 * HEIGHT_M, rel=1e-5)


def test_a_measured_pair_stands_in_the_campaign_once_and_without_a_common_clock(box: Path) -> None:
    file = project.campaign_file(box)
    file.write_text(file.read_text() + "\n# mine\n[air]\ntemperature_c = 21.5 # measured\n")
    project.set_position(box, "sources", "LS1", (1.0, 2.0, 1.5))
    for _ in range(2):
        project.name_measured(box, "LS1", "hall 2")
    text = file.read_text()
    assert "# mine" in text and "# measured" in text
    assert text.count("recordings/LS1_hall 2.wav") == 1 and text.count('"FILL IN"') == 1
    project.set_position(box, "receivers", "hall 2", (2.0, 2.0, 1.5))
    (measured,) = read_campaign(file, to_fit=False).measurements
    assert (measured.source, measured.receiver) == ("LS1", "hall 2")
    assert measured.response.time_zero == "direct"
    file.write_text('measurements = [\n{ source = "A", receiver = "B", file = "x.wav" },\n]\n')
    before = file.read_bytes()
    with pytest.raises(InputError, match="cannot edit"):
        project.name_measured(box, "LS1", "R1")
    assert file.read_bytes() == before


def test_files_that_devices_have_delayed_unlike_begin_where_the_geometry_says(box: Path) -> None:
    """5 and 60 ms, to three samples of an onset: one delay for both would be 27 ms off."""
    rng, t = np.random.default_rng(1), np.arange(24_000) / 48_000.0
    project.set_position(box, "sources", "S1", (1.0, 1.0, 1.2))
    (box / "recordings").mkdir()
    for name, x_m, delay_s in (("R1", 3.0, 0.005), ("R2", 5.0, 0.06)):
        project.set_position(box, "receivers", name, (x_m, 2.0, 1.3))
        travel_s = float(np.linalg.norm([x_m - 1.0, 1.0, 0.1])) / 343.2
        h = np.concatenate([[1.0], 0.1 * rng.normal(size=len(t)) * np.exp(-t / 0.04)])
        late = np.concatenate([np.zeros(round((travel_s + delay_s) * 48_000)), h])
        soundfile.write(box / "recordings" / f"S1_{name}.wav", late, 48_000, subtype="FLOAT")
        project.name_measured(box, "S1", name)
    checked = check_campaign_recordings(read_campaign(project.campaign_file(box)))
    assert len(views.recordings_view(box)["rows"]) == len(checked.onset_s) == 2
    assert checked.onset_s == pytest.approx(checked.travel_s, abs=0.7e-4)


def test_what_is_about_all_recordings_stands_once_and_what_is_missing_too(box: Path) -> None:
    """Four files that begin 5 ms late; before their places are known nothing else is said."""
    rng, t = np.random.default_rng(1), np.arange(24_000) / 48_000.0
    project.set_position(box, "sources", "S1", (1.0, 1.0, 1.2))
    (box / "recordings").mkdir()
    places = {f"R{i}": (1.5 + i, 2.0 + 0.3 * i, 1.3) for i in range(4)}
    for name, (x, y, _) in places.items():
        travel_s = float(np.linalg.norm([x - 1.0, y - 1.0, 0.1])) / 343.2
        h = np.concatenate([[1.0], 0.1 * rng.normal(size=len(t)) * np.exp(-t / 0.04)])
        late = np.concatenate([np.zeros(round((travel_s + 0.005) * 48_000)), h])
        soundfile.write(box / "recordings" / f"S1_{name}.wav", late, 48_000, subtype="FLOAT")
    project.name_recordings(box, {})
    view = views.recordings_view(box)
    assert [f["code"] for f in view["findings"]] == ["positions"]
    for name, place in places.items():
        project.set_position(box, "receivers", name, place)
    view = views.recordings_view(box)
    assert [f["code"] for f in view["findings"]].count("recordings-late") == 1
    assert view["page"].startswith("files/checked/recordings.html")
    page = (box / "checked/recordings.html").read_text()
    assert all(f"S1 to {name} (S1_{name}.wav)" in page for name in places)


def test_editing_keeps_comments_and_what_the_page_does_not_know(box: Path) -> None:
    file = project.campaign_file(box)
    file.write_text(file.read_text() + "\n# mine\n[air]\ntemperature_c = 21.5 # measured\n")
    project.set_surface_material(box, "east", "curtain")
    project.set_prior(box, "curtain", "curtain-heavy-draped")
    project.set_position(box, "sources", "LS1", (1.0, 2.0, 1.5))
    project.set_bands(box, 500.0, 1000.0)
    text = file.read_text()
    assert "# mine" in text and "# measured" in text
    campaign = read_campaign(file, to_fit=False)
    assert campaign.room.materials["east"] == "curtain"
    assert campaign.materials["curtain"].prior == "curtain-heavy-draped"
    assert campaign.air.temperature_c == 21.5
    assert campaign.sources[0].position_m.tolist() == [1.0, 2.0, 1.5]
    assert campaign.bands.centres_hz.tolist() == [500.0, 1000.0]
    project.set_prior(box, "curtain", None)
    project.set_position(box, "sources", "LS1", None)
    again = read_campaign(file, to_fit=False)
    assert again.materials["curtain"].prior is None and not again.sources


def test_another_room_keeps_positions_and_forgets_materials_it_does_not_have(box: Path) -> None:
    project.set_surface_material(box, "east", "curtain")
    project.set_prior(box, "curtain", "curtain-heavy-draped")
    project.set_position(box, "receivers", "MP1", (1.0, 2.0, 1.5))
    project.set_room(box, shoebox=(8.0, 5.0, 3.0))
    campaign = read_campaign(project.campaign_file(box), to_fit=False)
    assert campaign.room.shoebox == (8.0, 5.0, 3.0)
    assert [p.name for p in campaign.receivers] == ["MP1"] and "curtain" not in campaign.materials
    project.set_surface_material(box, "floor", "parquet")
    project.forget_unused_materials(box, ["walls", "parquet", "ceiling"])
    assert set(project.campaign_content(box)["materials"]) == {"walls", "ceiling"}


def test_a_room_can_be_looked_at_before_its_positions_are_known(box: Path) -> None:
    file = project.campaign_file(box)
    blank = '\n[sources.LS1]\nposition = "FILL IN"\n[receivers.MP1]\nposition = [1, 1, 1]\n'
    rows = '[[measurements]]\nsource = "LS1"\nreceiver = "MP1"\nfile = "a.wav"\n'
    file.write_text(file.read_text() + blank + rows)
    view = views.room_view(box)
    assert [p["name"] for p in view["receivers"]] == ["MP1"] and not view["sources"]
    assert sorted(p.name for p in box.iterdir()) == ["campaign.toml"]


def test_an_error_of_a_finding_has_its_points_also_where_a_file_is_put_before_it() -> None:
    doubt = Finding(Code.POSITION_OUTSIDE, About(points_m=[(1.0, 2.0, 9.0)]), "Near (7, 7, 7) m.")
    with pytest.raises(InputError) as caught, located("campaign.toml"):
        refuse([doubt])
    assert caught.value.points_m == ((1.0, 2.0, 9.0),)
    assert views.finding_of_error(caught.value)["about"] == {"points_m": [[1.0, 2.0, 9.0]]}
    assert views.finding_of_error(InputError("Near (7, 7, 7) m"))["about"] == {}


def test_a_table_that_was_spoilt_in_the_folder_is_told_and_files_are_named_once(box: Path) -> None:
    send(box, "LS1_MP1.wav")
    (box / "positions").mkdir()
    (box / "positions" / "p.csv").write_text("nothing")
    row = '[[measurements]]\nsource = "A"\nreceiver = "B"\nfile = "./recordings/LS1_MP1.wav"\n'
    points = "[sources.A]\nposition = [1, 1, 1]\n[receivers.B]\nposition = [2, 2, 2]\n"
    file = project.campaign_file(box)
    file.write_text(f"{file.read_text()}\n{points}{row}")
    assert shown(box)[1] == {"LS1_MP1.wav": ("A", "B")}
    said = views.recordings_view(box)["findings"]
    assert any("p.csv" in f["sentence"] for f in said)


def test_the_plan_names_the_walls_where_they_stand(box: Path) -> None:
    """Not floor and ceiling; a box of 6 x 5 m."""
    send(box, "LS1_MP1.wav")
    view = views.recordings_view(box)
    walls = {name: (x, y) for x, y, name in view["walls"]}
    assert walls == {
        "west": (0.0, 2.5),
        "east": (6.0, 2.5),
        "south": (3.0, 0.0),
        "north": (3.0, 5.0),
    }


def send(folder: Path, *names: str) -> None:
    """Put recordings where uploads come to; they are not read here."""
    (folder / "recordings").mkdir(exist_ok=True)
    for file in names:
        (folder / "recordings" / file).write_bytes(b"RIFF")


def name_sent(folder: Path, table: str = "") -> None:
    """Do what the tab does after something was sent."""
    known, moved = views.table_positions(folder, table)
    project.name_recordings(folder, known, moved)


def shown(folder: Path) -> tuple[dict[str, list[float] | None], dict[str, tuple[str, str]]]:
    """Return what the tab shows: positions by name, and source and receiver by file."""
    view = views.recordings_view(folder)
    places = {p["name"]: p["position_m"] for p in view["positions"]}
    return places, {r["file"].split("/")[-1]: (r["source"], r["receiver"]) for r in view["rows"]}


TEMPLATE = "recordings/{source}-{receiver}.wav"


def test_names_become_sources_and_receivers_whose_places_are_asked_for(box: Path) -> None:
    send(box, "LS1_MP1.wav", "LS1_MP2.wav", "sweep.wav")
    name_sent(box)
    view = views.recordings_view(box)
    assert [(p["kind"], p["name"]) for p in view["positions"]] == [
        ("sources", "LS1"), ("receivers", "MP1"), ("receivers", "MP2"),
    ]  # fmt: skip
    said = [f["sentence"] for f in view["findings"]]
    assert any("LS1, MP1, MP2" in sentence for sentence in said)
    assert any("do not fit: recordings/sweep.wav" in sentence for sentence in said)
    before = project.campaign_file(box).read_bytes()
    for wrong in ("../{source}_{receiver}.wav", "/x/{source}_{receiver}.wav", "a.wav", TEMPLATE):
        with pytest.raises(InputError):
            project.set_template(box, wrong, {})
        assert project.campaign_file(box).read_bytes() == before


def test_a_template_stands_in_the_campaign_and_its_rows_are_there_without_typing_it(
    box: Path,
) -> None:
    """Also while no position is known, and when it is taken back."""
    send(box, "A_1-B_1.wav", "A_1-B_2.wav")
    name_sent(box)
    assert shown(box)[1] == {"A_1-B_1.wav": ("A", "1-B_1"), "A_1-B_2.wav": ("A", "1-B_2")}
    for kind, name in (("sources", "A"), ("receivers", "1-B_1"), ("receivers", "1-B_2")):
        project.set_position(box, kind, name, (1.0, 1.0, 1.0))
    project.set_template(box, TEMPLATE, {})
    for kind, name in (("sources", "A"), ("receivers", "1-B_1"), ("receivers", "1-B_2")):
        assert shown(box)[0][name] == [1.0, 1.0, 1.0]  # what was typed is not thrown away
        project.set_position(box, kind, name, None)
    expected = {"A_1-B_1.wav": ("A_1", "B_1"), "A_1-B_2.wav": ("A_1", "B_2")}
    places = dict.fromkeys(("A_1", "B_1", "B_2"))
    assert shown(box) == (places, expected)
    assert views.recordings_view(box)["template"] == TEMPLATE
    assert "measurements" not in project.campaign_content(box)
    project.set_template(box, "", {})
    assert shown(box)[1]["A_1-B_1.wav"] == ("A", "1-B_1")


def test_names_with_other_separators_are_split_by_a_table_of_positions(box: Path) -> None:
    """Whichever comes first; what was measured here or written by hand is left as it is."""
    send(box, "2024 LS1 - MP1 take2.wav", "ls1-mp2.wav", "sweep.wav")
    name_sent(box)
    assert shown(box)[1]["ls1-mp2.wav"] == ("ls1", "mp2")  # as init does without a table
    project.name_measured(box, "X", "Y")
    send(box, "X_Y.wav")
    (box / "positions").mkdir()
    table = box / "positions" / "Positionen.csv"
    table.write_text("Name;x [cm];y;z\nLS1;100,5;200;150\nMP1;300;200;120\nMP2;400;200;120\n")
    name_sent(box, table.name)
    places, rows = shown(box)
    assert rows == {
        "2024 LS1 - MP1 take2.wav": ("LS1", "MP1"),
        "ls1-mp2.wav": ("LS1", "MP2"),
        "X_Y.wav": ("X", "Y"),
    }
    assert places == {"LS1": [1.005, 2.0, 1.5], "MP1": [3.0, 2.0, 1.2], "MP2": [4.0, 2.0, 1.2],
                      "X": None, "Y": None}  # fmt: skip
    assert 'time_zero = "direct"' in project.campaign_file(box).read_text()
    # what was dragged stays when more recordings come, and goes when a table is sent again
    project.set_position(box, "receivers", "MP1", (5.0, 1.0, 1.0))
    name_sent(box)
    assert shown(box)[0]["MP1"] == [5.0, 1.0, 1.0]
    name_sent(box, table.name)
    assert shown(box)[0]["MP1"] == [3.0, 2.0, 1.2]


def test_what_was_sent_before_there_was_a_room_is_named_when_it_comes(tmp_path: Path) -> None:
    send(tmp_path, "LS1-MP1.wav")
    (tmp_path / "positions").mkdir()
    (tmp_path / "positions" / "p.csv").write_text("LS1,1,2,1.5\nMP1,3,2,1.2\nMP9,1,1,1\n")
    name_sent(tmp_path, "p.csv")
    assert shown(tmp_path) == ({"LS1": None, "MP1": None}, {"LS1-MP1.wav": ("LS1", "MP1")})
    views.set_room(tmp_path, shoebox=(6.0, 5.0, 3.0))
    assert shown(tmp_path)[0] == {"LS1": [1.0, 2.0, 1.5], "MP1": [3.0, 2.0, 1.2]}
    (measured,) = read_campaign(project.campaign_file(tmp_path), to_fit=False).measurements
    assert (measured.source, measured.receiver) == ("LS1", "MP1")
    said = views.recordings_view(tmp_path)["findings"]
    assert any("Positions that no recording names: MP9" in f["sentence"] for f in said)


def test_a_table_that_is_looked_at_says_what_where_found_needed_try(box: Path) -> None:
    """As the command line does, without the place where it waits; another unit is refused."""
    waiting = box / ".roomfit-upload-1"
    waiting.mkdir()
    file = waiting / "p.csv"
    for text, words in (
        ("name,x,y,z\nLS1,1,2,3\nMP1,a,2,3\n", "where   p.csv, line 3\n  found   'a'"),
        (
            "LS1,100,200,150\nMP1,300,200,120\n",
            "all of them inside if they are taken as centimetres",
        ),
    ):
        file.write_text(text)
        with pytest.raises(InputError) as caught:
            views.look_at_upload(box, "positions", f"{waiting.name}/p.csv")
        said = str(caught.value)
        assert words in said and "\n  try " in said and waiting.name not in said
    file.write_text("place;500\nA;never\n")
    with pytest.raises(InputError, match=r"p\.csv, line 2, column 2"):
        views.look_at_upload(box, "decay-times", f"{waiting.name}/p.csv")


@pytest.mark.slow
def test_the_demo_is_checked_recording_by_recording(tmp_path: Path) -> None:
    tasks.demo(nothing, tmp_path)
    view = views.recordings_view(tmp_path)
    assert len(view["rows"]) == 8
    assert len(read_parameters(tmp_path / "checked/room_parameters.csv")[0]) == 8
    assert any("T20" in f["sentence"] for f in view["findings"])
    json.dumps(view, allow_nan=False)
    with pytest.raises(InputError):
        tasks.demo(nothing, tmp_path)  # nothing is written over


def test_exports_need_a_result_and_stay_in_the_project(box: Path) -> None:
    with pytest.raises(InputError):
        project.export(box, "csv")
    (box / "first").mkdir()
    (box / "first" / "result.json").write_text("{}")
    (box / "exports").symlink_to(box.parent)
    with pytest.raises(InputError):
        project.export(box, "csv")


@pytest.mark.parametrize("kind", ["sources", "receivers"])
def test_no_position_but_three_numbers_is_taken(box: Path, kind: str) -> None:
    for wrong in ((1.0, 2.0), (1.0, 2.0, float("nan")), (1.0, 2.0, float("inf"))):
        with pytest.raises(InputError):
            project.set_position(box, kind, "A", wrong)
    with pytest.raises(InputError):
        project.set_position(box, "room", "A", (1.0, 2.0, 3.0))


# The processes.


def gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return Path(f"/proc/{pid}/stat").read_text().split()[2] == "Z"


@pytest.mark.slow
def test_a_job_is_cancelled_within_two_seconds_and_the_next_one_begins(tmp_path: Path) -> None:
    tasks.demo(nothing, tmp_path)

    async def whole() -> None:
        bench = Bench(tmp_path)
        first = bench.add("a", "identify", quick=True)
        assert bench.add("a", "identify", quick=True) is first
        second = bench.add("b", "ready")
        while first.fraction < 0.01:
            await asyncio.sleep(0.1)
        assert first.state == "running" and second.text() == "b: waiting"
        assert re.fullmatch(
            r"a: tracing and fitting, \d+ %, \d+ s(, about \d+ s to go)?", first.text()
        )
        began = time.monotonic()
        await bench.cancel(first)
        assert time.monotonic() - began < 2.0 and first.state == "cancelled"
        while second.state in ("waiting", "running"):
            await asyncio.sleep(0.1)
        await bench.stop()

    asyncio.run(whole())
    assert not (tmp_path / "first" / "result.json").exists()
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".roomfit") and p.is_dir()]


@pytest.mark.slow
def test_what_a_hostile_file_does_ends_the_worker_and_not_its_owner(tmp_path: Path) -> None:
    project.set_room(tmp_path, shoebox=(6.0, 5.0, 3.0))
    hostile = {
        "many.stl": b"\0" * 80 + struct.pack("<I", 2**32 - 1),
        "deep.glb": b"glTF" + struct.pack("<II", 2, 2**31),
        "wide.obj": b"v 0 0 0\n" * 4 + b"f " + b"1 2 3 " * 200_000,
        "huge.ply": b"ply\nformat ascii 1.0\nelement vertex 99999999999\nend_header\n",
    }

    async def whole() -> None:
        worker = Worker(4096)
        for name, content in hostile.items():
            (tmp_path / name).write_bytes(content)
            with pytest.raises(InputError):
                await worker.ask("set_room", tmp_path, {"file": name, "unit": "m"}, limit_s=60.0)
        process = await worker.started()
        os.kill(process.pid, 11)  # as a library would end that a file has led astray
        with pytest.raises(InputError, match="has ended"):
            await worker.ask("ready", tmp_path, {})
        assert await worker.ask("ready", tmp_path, {}) == "ready"
        with pytest.raises(InputError, match="took too long"):
            await worker.ask("room_view", tmp_path, {}, limit_s=0.001)
        assert await worker.ask("ready", tmp_path, {}) == "ready"
        pid = (await worker.started()).pid
        await worker.stop()
        assert gone(pid)

    asyncio.run(whole())


@pytest.mark.slow
def test_a_folder_that_is_called_as_a_package_is_no_package_to_a_worker(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As that of ``roomfit coverage --out coverage``, which numba takes for a program of that name.

    Nor does a file of the user's run because it has the name of a library.
    """
    project.set_room(tmp_path, shoebox=(6.0, 5.0, 3.0))
    (tmp_path / "coverage").mkdir()
    (tmp_path / "numba.py").write_text("raise SystemExit(3)\n")
    monkeypatch.chdir(tmp_path)

    async def whole() -> None:
        worker = Worker(4096)
        await worker.ask("room_view", tmp_path, {}, limit_s=60.0)
        await worker.stop()

    asyncio.run(whole())


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="needs /proc")
def test_a_worker_that_reads_strangers_files_has_no_key_of_its_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    secret = ("CI_TOKEN", "aws_secret_access_key", "DB_PASSWORD", "SSH_AUTH_SOCK", "MY_API_KEY")
    for name in secret:
        monkeypatch.setenv(name, "s3cret")

    async def whole() -> None:
        worker = Worker(4096)
        environment = Path(f"/proc/{(await worker.started()).pid}/environ").read_bytes()
        assert b"PATH=" in environment and b"s3cret" not in environment
        await worker.stop()

    asyncio.run(whole())


@pytest.mark.slow
def test_a_worker_has_no_more_memory_than_it_may_have(tmp_path: Path) -> None:
    async def whole() -> None:
        worker = Worker(256)  # less than the libraries themselves need
        with pytest.raises(InputError):
            await worker.ask("ready", tmp_path, {}, limit_s=60.0)
        await worker.stop()

    asyncio.run(whole())


# What findings advise.


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the demo project, measured by simulation; to be copied."""
    folder = tmp_path_factory.mktemp("measured")
    tasks.demo(nothing, folder)
    return folder


def _louder(folder: Path) -> None:
    change(folder / "LS1_MP3.wav", lambda x: 0.2 * x)


def _late(folder: Path) -> None:
    for file in folder.glob("*.wav"):
        change(file, lambda x: np.concatenate([np.zeros(240), x]))


def _one_late(folder: Path) -> None:
    change(folder / "LS2_MP4.wav", lambda x: np.concatenate([np.zeros(300), x]))


def _exchanged(folder: Path) -> None:
    one, other, aside = (folder / f"{n}.wav" for n in ("LS1_MP1", "LS1_MP4", "aside"))
    one.rename(aside)
    other.rename(one)
    aside.rename(other)


def change(file: Path, how: Callable[[FloatArray], FloatArray]) -> None:
    samples, rate_hz = soundfile.read(file)
    soundfile.write(file, how(samples), rate_hz, subtype="FLOAT")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spoil", "code"),
    [
        (_louder, Code.LEVELS_APART),
        (_late, Code.RECORDINGS_LATE),
        (_one_late, Code.TIME_ZERO_MISMATCH),
        (_exchanged, Code.EXCHANGED),
    ],
)
def test_what_a_finding_advises_resolves_it(
    measured: Path, tmp_path: Path, spoil: Callable[[Path], None], code: Code
) -> None:
    """Recordings of known faults are examined, the first remedy is made, and they are again."""
    folder = tmp_path / "project"
    shutil.copytree(measured, folder)
    spoil(folder)
    view = views.recordings_view(folder)
    (entry,) = [a for a in view["advised"] if a["code"] == code.value]
    options = json.loads(json.dumps(entry["options"], allow_nan=False))
    edits = [Edit(tuple(e["table"]), e["key"], e["value"]) for e in options[0]["edits"]]
    apply(project.campaign_file(folder), preview(project.campaign_file(folder), edits))
    again = views.recordings_view(folder)
    assert code.value not in [f["code"] for f in again["findings"]] and not again["advised"]


def test_a_result_advises_what_holds_of_the_campaign_now_and_nothing_once_it_was_edited(
    tmp_path: Path,
) -> None:
    file = project.campaign_file(tmp_path)
    file.write_text('[room]\nshoebox = [6, 5, 3]\n[identify]\npositions = "fixed"\n')
    own = {"severity": "serious", "sentence": "..."}

    def remedy(key: str, value: object, *, once: bool = False) -> dict[str, object]:
        edit = {"table": ["identify"], "key": key, "value": value}
        return {"edits": [edit], "words": "", "once": once}

    inflated = {"code": "position-uncertainty-inflated", "severity": "warning", "sentence": "..."}
    found = [
        {**own, "code": "position-inconsistent", "remedies": [remedy("positions", "fit")]},
        {**inflated, "remedies": [remedy("wall_delays", False, once=True)]},
    ]
    own = {"absorption": [0.3], "lower95": [0.2], "upper95": [0.4]}
    own |= {"identifiable": [True], "area_m2": 12.0}
    head = {"format": "roomfit-result", "format_version": 1, "fit": {}, "findings": found}
    file = tmp_path / "first" / "result.json"
    file.parent.mkdir()
    write_json_atomically(file, {**head, "bands_hz": [1000.0], "materials": {"walls": own}})

    def codes() -> list[str]:
        return [a["code"] for a in tasks.answer_view(tmp_path, "first")["advised"]]

    assert codes() == [f["code"] for f in found]
    content = json.loads(file.read_text())
    del content["content_sha256"]
    content["provenance"] = {"inputs_sha256": {"campaign.toml": "of another text"}}
    write_json_atomically(file, content)
    assert codes() == ["position-inconsistent"]
    file.write_text(file.read_text().replace("1000.0", "500.0"))
    assert codes() == []
