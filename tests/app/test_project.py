"""The folder as state, what the tabs show, and the processes that work: no browser."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import struct
import time
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import soundfile

from roomfit.app import project, recordings, views
from roomfit.app.jobs import Job, Jobs, Worker
from roomfit.base.errors import InputError, located
from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import FloatArray
from roomfit.base.whole_files import write_json_atomically
from roomfit.files.campaign import read_campaign
from roomfit.files.draft import draft_campaign
from roomfit.files.edits import Edit, Preview, apply, can_undo, edited_text, preview, undo
from roomfit.files.rooms.model import RoomSpec
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
    view = views.room_view(nothing, str(box))
    assert [m["name"] for m in view["materials"]] == ["walls", "floor", "ceiling"]
    assert view["traceable"] and view["volume_m3"] == pytest.approx(90.0)
    assert len(view["faces"]) == 12 and len(view["edges"]) == 12
    json.dumps(view, allow_nan=False)


@pytest.mark.parametrize("name", ["room.json", "room.usdz"])
def test_a_scan_that_is_sent_is_the_room_of_the_command(tmp_path: Path, name: str) -> None:
    """Looked at as it waits, then taken, with what it knows of beds and sofas."""
    if name.endswith("usdz"):
        pytest.importorskip("pxr")
    things = [furniture("bed", (2.0, 3.0), (1.4, 0.4, 2.0))]
    sent = scan_usdz() if name.endswith("usdz") else json.dumps({**scan(), "objects": things})
    (tmp_path / name).write_bytes(sent if isinstance(sent, bytes) else sent.encode())
    views.look_at_upload(nothing, str(tmp_path), "room", name)
    views.set_room(nothing, str(tmp_path), file=name, unit=None, space="")
    content = project.campaign_content(tmp_path)
    drafted = draft_campaign(RoomSpec(file=tmp_path / name), {}, folder=tmp_path)
    keys = ("room", "materials", "objects")
    assert [content.get(k) for k in keys] == [tomllib.loads(drafted).get(k) for k in keys]
    assert views.room_view(nothing, str(tmp_path))["traceable"]
    if name.endswith("usdz"):
        return
    # of decay times it absorbs as its entry says; another room has no outlines of this one
    views.set_room(nothing, str(tmp_path), file=name, unit=None, space="")
    assert project.campaign_content(tmp_path)["objects"] == content["objects"]
    project.set_decay_times(tmp_path, "t.csv")
    bed = project.campaign_content(tmp_path)["objects"]["bed"]
    assert bed["absorption_area_m2"] == "seats-heavy-empty" and "prior" not in bed
    views.set_room(nothing, str(tmp_path), file=name, unit=None, space="")
    assert project.campaign_content(tmp_path)["objects"]["bed"] == bed
    views.set_room(nothing, str(tmp_path), shoebox=[5.0, 4.0, 3.0])
    assert "bed" not in project.campaign_content(tmp_path).get("objects", {})


def test_of_a_scan_of_several_rooms_one_is_named(tmp_path: Path) -> None:
    box = [(0, 0), (4, 0), (4, 3), (0, 3)]
    rooms = [scan(), {**scan(box), "sections": [{"label": "kitchen"}]}]
    (tmp_path / "flat.json").write_text(json.dumps({"rooms": rooms}))
    views.look_at_upload(nothing, str(tmp_path), "room", "flat.json")
    with pytest.raises(InputError, match="'livingRoom', 'kitchen'"):
        views.set_room(nothing, str(tmp_path), file="flat.json", unit=None, space="")
    views.set_room(nothing, str(tmp_path), file="flat.json", unit=None, space="kitchen")
    view = views.room_view(nothing, str(tmp_path))
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
    view = views.recordings_view(nothing, str(box))
    assert len(view["rows"]) == 2
    for row in view["rows"]:
        assert row["onset_ms"] == pytest.approx(row["travel_ms"], abs=0.07)


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
    recordings.name_recordings(box, {})
    view = views.recordings_view(nothing, str(box))
    assert [f["code"] for f in view["findings"]] == ["positions"]
    for name, place in places.items():
        project.set_position(box, "receivers", name, place)
    view = views.recordings_view(nothing, str(box))
    notes = [note["code"] for row in view["rows"] for note in row["notes"]]
    assert [f["code"] for f in view["findings"]].count("recordings-late") == 1
    assert len(view["rows"]) == 4 and "recordings-late" not in notes


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


def test_a_room_can_be_looked_at_before_its_positions_are_known(box: Path) -> None:
    file = project.campaign_file(box)
    blank = '\n[sources.LS1]\nposition = "FILL IN"\n[receivers.MP1]\nposition = [1, 1, 1]\n'
    rows = '[[measurements]]\nsource = "LS1"\nreceiver = "MP1"\nfile = "a.wav"\n'
    file.write_text(file.read_text() + blank + rows)
    view = views.room_view(nothing, str(box))
    assert [p["name"] for p in view["receivers"]] == ["MP1"] and not view["sources"]
    assert sorted(p.name for p in box.iterdir()) == ["campaign.toml"]


def test_a_fault_of_the_geometry_is_shown_where_it_is(tmp_path: Path) -> None:
    faces = ["1 2 3 4", "5 8 7 6", "1 5 6 2", "2 6 7 3", "3 7 8 4"]  # the last wall is missing
    corners = [
        (0, 0, 0),
        (0, 4, 0),
        (5, 4, 0),
        (5, 0, 0),
        (0, 0, 3),
        (0, 4, 3),
        (5, 4, 3),
        (5, 0, 3),
    ]
    text = "".join(f"v {x} {y} {z}\n" for x, y, z in corners)
    text += "".join(f"usemtl m{i}\nf {f}\n" for i, f in enumerate(faces))
    (tmp_path / "open.obj").write_text(text)
    project.set_room(tmp_path, file="open.obj", unit="m")
    view = views.room_view(nothing, str(tmp_path))
    assert not view["traceable"]
    serious = [f for f in view["findings"] if f["severity"] == "serious"]
    assert serious and any(f["about"].get("points_m") for f in serious)


def test_an_error_of_a_finding_has_its_points_also_where_a_file_is_put_before_it() -> None:
    doubt = Finding(Code.POSITION_OUTSIDE, About(points_m=[(1.0, 2.0, 9.0)]), "Near (7, 7, 7) m.")
    with pytest.raises(InputError) as caught, located("campaign.toml"):
        refuse([doubt])
    assert caught.value.points_m == ((1.0, 2.0, 9.0),)
    assert views.finding_of_error(caught.value)["about"] == {"points_m": [[1.0, 2.0, 9.0]]}
    assert views.finding_of_error(InputError("Near (7, 7, 7) m"))["about"] == {}


@pytest.mark.parametrize(
    ("about", "expected"),
    [
        (About(), []),
        (About(files=["a.wav"]), [0, 2]),
        (About(files=["one/a.wav"]), [0]),
        (About(files=["/project/two/a.wav[channel 2]"]), [2]),
        (About(files=["b.wav", "two/a.wav"]), [1, 2]),
        (About(files=["c.wav"]), []),
        (About(pairs=[("S1", "R1")]), [0, 1]),
        (About(files=["a.wav"], pairs=[("S1", "R1")]), [0]),
    ],
)
def test_a_finding_goes_to_the_recordings_whose_file_or_pair_it_is_about(
    about: About, expected: list[int]
) -> None:
    rows = [
        {"file": "one/a.wav", "source": "S1", "receiver": "R1"},
        {"file": "one/b.wav", "source": "S1", "receiver": "R1"},
        {"file": "two/a.wav", "source": "S2", "receiver": "R1"},
    ]
    assert [rows.index(row) for row in views.concerned_recordings(about, rows)] == expected


def test_a_table_that_was_spoilt_in_the_folder_is_told_and_files_are_named_once(box: Path) -> None:
    send(box, "LS1_MP1.wav")
    (box / "positions").mkdir()
    (box / "positions" / "p.csv").write_text("nothing")
    row = '[[measurements]]\nsource = "A"\nreceiver = "B"\nfile = "./recordings/LS1_MP1.wav"\n'
    points = "[sources.A]\nposition = [1, 1, 1]\n[receivers.B]\nposition = [2, 2, 2]\n"
    file = project.campaign_file(box)
    file.write_text(f"{file.read_text()}\n{points}{row}")
    assert shown(box)[1] == {"LS1_MP1.wav": ("A", "B")}
    said = views.recordings_view(nothing, str(box))["findings"]
    assert any("p.csv" in f["sentence"] for f in said)


def test_the_plan_names_the_walls_where_they_stand(box: Path) -> None:
    """Not floor and ceiling; a box of 6 x 5 m."""
    send(box, "LS1_MP1.wav")
    view = views.recordings_view(nothing, str(box))
    walls = {name: (x, y) for x, y, name in view["walls"]}
    assert walls == {
        "west": (0.0, 2.5),
        "east": (6.0, 2.5),
        "south": (3.0, 0.0),
        "north": (3.0, 5.0),
    }


def write_result(folder: Path, findings: list[dict[str, object]], usable: list[str]) -> None:
    own = {"absorption": [0.3], "lower95": [0.2], "upper95": [0.4]}
    own |= {"identifiable": [True], "area_m2": 12.0}
    content = {
        "format": "roomfit-result",
        "format_version": 1,
        "bands_hz": [1000.0],
        "materials": dict.fromkeys(("walls", "floor", "ceiling", "door", "glass"), own),
        "findings": findings,
        "fit": {},
        **({"usable": usable} if usable else {}),
    }
    (folder / "first").mkdir(exist_ok=True)
    write_json_atomically(folder / "first" / "result.json", content)


def test_a_finding_stands_at_the_materials_that_it_is_about_not_at_those_that_it_mentions(
    box: Path,
) -> None:
    """Files of an older version say of no finding what it is about."""
    own = {"code": "prior-dominated", "severity": "warning", "evidence": {"walls": 1}}
    own |= {"sentence": "The echoes of the walls and of the floor differ."}
    named = [["floor"], ["glass", "gone"], ["walls", "floor", "ceiling", "door"]]
    write_result(box, [own, *({**own, "about": {"materials": m}} for m in named)], [])
    view = views.result_view(nothing, str(box), "first")
    assert view is not None
    assert [f["beside"] for f in view["findings"]] == [[], ["floor"], ["glass"], []]


def test_what_remains_usable_is_shown_where_a_finding_voids_and_not_elsewhere(box: Path) -> None:
    own = {"severity": "serious", "sentence": "A doubt.", "evidence": {}}
    for code, expected in (
        (Code.DISPLACEMENT_DETECTED, ["The mean holds."]),
        (Code.PRIOR_DOMINATED, []),
    ):
        write_result(box, [{**own, "code": code.value}], ["The mean holds."])
        view = views.result_view(nothing, str(box), "first")
        assert view is not None and view["usable"] == expected
    write_result(box, [{**own, "code": "displacement-detected"}], [])
    view = views.result_view(nothing, str(box), "first")
    assert view is not None and view["usable"] == []


def send(folder: Path, *names: str) -> None:
    """Put recordings where uploads come to; they are not read here."""
    (folder / "recordings").mkdir(exist_ok=True)
    for file in names:
        (folder / "recordings" / file).write_bytes(b"RIFF")


def name_sent(folder: Path, table: str = "") -> None:
    """Do what the tab does after something was sent."""
    known, moved = views.table_positions(nothing, str(folder), table)
    recordings.name_recordings(folder, known, moved)


def shown(folder: Path) -> tuple[dict[str, list[float] | None], dict[str, tuple[str, str]]]:
    """Return what the tab shows: positions by name, and source and receiver by file."""
    view = views.recordings_view(nothing, str(folder))
    places = {p["name"]: p["position_m"] for p in view["positions"]}
    return places, {r["file"].split("/")[-1]: (r["source"], r["receiver"]) for r in view["rows"]}


TEMPLATE = "recordings/{source}-{receiver}.wav"


def test_names_become_sources_and_receivers_whose_places_are_asked_for(box: Path) -> None:
    send(box, "LS1_MP1.wav", "LS1_MP2.wav", "sweep.wav")
    name_sent(box)
    view = views.recordings_view(nothing, str(box))
    assert [(p["kind"], p["name"]) for p in view["positions"]] == [
        ("sources", "LS1"), ("receivers", "MP1"), ("receivers", "MP2"),
    ]  # fmt: skip
    said = [f["sentence"] for f in view["findings"]]
    assert any("LS1, MP1, MP2" in sentence for sentence in said)
    assert any("do not fit: recordings/sweep.wav" in sentence for sentence in said)
    before = project.campaign_file(box).read_bytes()
    for wrong in ("../{source}_{receiver}.wav", "/x/{source}_{receiver}.wav", "a.wav", TEMPLATE):
        with pytest.raises(InputError):
            recordings.set_template(box, wrong, {})
        assert project.campaign_file(box).read_bytes() == before


def test_a_template_stands_in_the_campaign_and_its_rows_are_there_without_typing_it(
    box: Path,
) -> None:
    """Also while no position is known, and when it is taken back."""
    send(box, "S_1-R_1.wav", "S_1-R_2.wav")
    name_sent(box)
    assert shown(box)[1] == {"S_1-R_1.wav": ("S", "1-R_1"), "S_1-R_2.wav": ("S", "1-R_2")}
    for kind, name in (("sources", "S"), ("receivers", "1-R_1"), ("receivers", "1-R_2")):
        project.set_position(box, kind, name, (1.0, 1.0, 1.0))
    recordings.set_template(box, TEMPLATE, {})
    for kind, name in (("sources", "S"), ("receivers", "1-R_1"), ("receivers", "1-R_2")):
        assert shown(box)[0][name] == [1.0, 1.0, 1.0]  # what was typed is not thrown away
        project.set_position(box, kind, name, None)
    expected = {"S_1-R_1.wav": ("S_1", "R_1"), "S_1-R_2.wav": ("S_1", "R_2")}
    places = dict.fromkeys(("S_1", "R_1", "R_2"))
    assert shown(box) == (places, expected)
    assert views.recordings_view(nothing, str(box))["template"] == TEMPLATE
    assert "measurements" not in project.campaign_content(box)
    recordings.set_template(box, "", {})
    assert shown(box)[1]["S_1-R_1.wav"] == ("S", "1-R_1")


def test_names_with_other_separators_are_split_by_a_table_of_positions(box: Path) -> None:
    """Whichever comes first; what was measured here or written by hand is left as it is."""
    send(box, "2024 LS1 - MP1 take2.wav", "ls1-mp2.wav", "sweep.wav")
    name_sent(box)
    assert shown(box)[1]["ls1-mp2.wav"] == ("S1", "ls1-mp2")  # as init does without a table
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
    views.set_room(nothing, str(tmp_path), shoebox=(6.0, 5.0, 3.0))
    assert shown(tmp_path)[0] == {"LS1": [1.0, 2.0, 1.5], "MP1": [3.0, 2.0, 1.2]}
    (measured,) = read_campaign(project.campaign_file(tmp_path), to_fit=False).measurements
    assert (measured.source, measured.receiver) == ("LS1", "MP1")
    said = views.recordings_view(nothing, str(tmp_path))["findings"]
    assert any("Positions that no recording names: MP9" in f["sentence"] for f in said)


def test_a_table_that_is_looked_at_says_what_where_found_needed_try(box: Path) -> None:
    """As the command line does, without the place where it waits; another unit is refused."""
    waiting = box / ".roomfit-upload-1"
    waiting.mkdir()
    file = waiting / "p.csv"
    for text, words in (
        ("name,x,y,z\nLS1,1,2,3\nMP1,a,2,3\n", "where   p.csv, line 3\n  found   'MP1,a,2,3'"),
        ("LS1,100,200,150\nMP1,300,200,120\n", "all of them in cm"),
    ):
        file.write_text(text)
        with pytest.raises(InputError) as caught:
            views.look_at_upload(nothing, str(box), "positions", f"{waiting.name}/p.csv")
        said = str(caught.value)
        assert words in said and "\n  try " in said and waiting.name not in said
    file.write_text("place;500\nA;never\n")
    with pytest.raises(InputError, match=r"p\.csv, line 2, column 2"):
        views.look_at_upload(nothing, str(box), "decay-times", f"{waiting.name}/p.csv")


@pytest.mark.slow
def test_the_demo_is_checked_recording_by_recording(tmp_path: Path) -> None:
    views.demo(nothing, str(tmp_path))
    view = views.recordings_view(nothing, str(tmp_path))
    assert len(view["rows"]) == 8 and all(len(r["usable"]) == 6 for r in view["rows"])
    assert any("T20" in n["sentence"] for n in view["rows"][0]["notes"])
    json.dumps(view, allow_nan=False)
    with pytest.raises(InputError):
        views.demo(nothing, str(tmp_path))  # nothing is written over


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
    views.demo(nothing, str(tmp_path))

    async def whole() -> None:
        jobs = Jobs()
        first = jobs.add("a", "identify", {"folder": str(tmp_path), "quick": True})
        assert jobs.add("a", "identify", {"folder": str(tmp_path), "quick": True}) is first
        second = jobs.add("b", "echo", {"text": "next"})
        while first.fraction < 0.01:
            await asyncio.sleep(0.1)
        assert first.state == "running" and second.state == "waiting"
        began = time.monotonic()
        await jobs.cancel(first)
        assert time.monotonic() - began < 2.0 and first.state == "cancelled"
        while second.state in ("waiting", "running"):
            await asyncio.sleep(0.1)
        await jobs.stop()

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
                own = {"folder": str(tmp_path), "file": name, "unit": "m"}
                await worker.ask("set_room", own, limit_s=60.0)
        process = await worker.started()
        os.kill(process.pid, 11)  # as a library would end that a file has led astray
        with pytest.raises(InputError, match="has ended"):
            await worker.ask("echo", {"text": "a"})
        assert await worker.ask("echo", {"text": "b"}) == "b"
        assert worker.starts == 2
        with pytest.raises(InputError, match="took too long"):
            await worker.ask("room_view", {"folder": str(tmp_path)}, limit_s=0.001)
        assert await worker.ask("echo", {"text": "c"}) == "c"
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
        await worker.ask("room_view", {"folder": str(tmp_path)}, limit_s=60.0)
        assert worker.starts == 1
        await worker.stop()

    asyncio.run(whole())


@pytest.mark.slow
def test_a_worker_has_no_more_memory_than_it_may_have(tmp_path: Path) -> None:
    async def whole() -> None:
        worker = Worker(256)  # less than the libraries themselves need
        with pytest.raises(InputError):
            await worker.ask("echo", {"text": "a"}, limit_s=60.0)
        await worker.stop()

    asyncio.run(whole())


def test_the_time_that_remains_is_stated_once_there_is_something_to_go_by() -> None:
    job = Job(1, "a", "echo", {}, stages=((0.0, "one"), (0.5, "two")))
    assert job.remaining_s is None and job.stage == "one"
    job.state, job.fraction, job.began_s = "running", 0.75, time.monotonic() - 30.0
    assert job.remaining_s == pytest.approx(10.0, abs=0.5) and job.stage == "two"


# Remedies.

WRITTEN = """# of my room
[room]
shoebox = [6, 5, 3]

[sources.S1]
position = [1.5, 1.2, 1.5]  # by tape

# receivers, by laser
[receivers."R 1"]
position = [4.0, 3.5, 1.2]

[identify]
positions = "fixed"  # for now
"""


def remedied(folder: Path, text: str, *edits: Edit) -> Preview:
    project.campaign_file(folder).write_text(text)
    return preview(project.campaign_file(folder), edits)


def test_a_remedy_changes_its_keys_and_keeps_comments_and_order(tmp_path: Path) -> None:
    wanted = remedied(
        tmp_path,
        WRITTEN,
        Edit(("sources", "S1"), "directivity", "fit"),
        Edit(("receivers", "R 1"), "position", (4.0, 3.0, 1.25)),
        Edit(("identify",), "positions", "fit"),
        Edit(("materials", "walls"), "prior", "cork-tiles"),
        Edit(("materials", "walls"), "scattering", 0.1),
    )
    expected = WRITTEN.replace("# by tape\n", '# by tape\ndirectivity = "fit"\n')
    expected = expected.replace("[4.0, 3.5, 1.2]", "[4.0, 3.0, 1.25]")
    expected = expected.replace('"fixed"', '"fit"')
    expected += '\n[materials.walls]\nprior = "cork-tiles"\nscattering = 0.1\n'
    assert wanted.after == expected
    assert wanted.lines[:2] == (
        ("[sources.S1]", "not stated", 'directivity = "fit"'),
        ('[receivers."R 1"]', "position = [4.0, 3.5, 1.2]", "position = [4.0, 3.0, 1.25]"),
    )
    assert project.campaign_file(tmp_path).read_text() == WRITTEN, "a preview writes nothing"
    assert [p.name for p in tmp_path.iterdir()] == ["campaign.toml"]


def test_rows_of_measurements_are_changed_by_their_number_and_new_ones_come_last(
    tmp_path: Path,
) -> None:
    row = '\n[[measurements]]\nsource = "S1"\nreceiver = "R 1"\nfile = "{}.wav" # {}\n'
    text = WRITTEN + row.format("a", 1) + "\n# the other\n" + row.format("b", 2)
    new = {"source": "S1", "receiver": "R 1", "file": "c.wav", "level": "per-file"}
    wanted = remedied(
        tmp_path,
        text,
        Edit(("measurements", 1), "level", "per-file"),
        *[Edit(("measurements", 3), key, value) for key, value in new.items()],
    )
    added = "".join(f'{key} = "{value}"\n' for key, value in new.items())
    expected = text.replace("# 1\n", '# 1\nlevel = "per-file"\n')
    assert wanted.after == f"{expected}\n[[measurements]]\n{added}"
    assert wanted.lines[0] == ("[[measurements]], no. 1", "not stated", 'level = "per-file"')


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_ends_of_lines_stay_and_the_last_one_may_be_missing(tmp_path: Path, end: str) -> None:
    text = WRITTEN.rstrip("\n").replace("\n", end)
    after = edited_text(text, [Edit(("identify",), "wall_delays", True)])
    assert after == f"{text}{end}wall_delays = true{end}"


def test_a_campaign_that_cannot_be_edited_key_by_key_is_refused_and_stays(tmp_path: Path) -> None:
    text = WRITTEN + "[materials]\nwalls = {scattering = 0.1}\n"
    edit = Edit(("materials", "walls"), "prior", "cork-tiles")
    assert "cork-tiles" in remedied(tmp_path, text, edit).after
    edit = Edit(("materials", "floor"), "prior", "cork-tiles")
    inline = "materials = {walls = {scattering = 0.1}}\n" + WRITTEN
    assert '{prior = "cork-tiles"}' in remedied(tmp_path, inline, edit).after
    several = 'states = [\n  {name = "empty"},\n]\n' + WRITTEN
    with pytest.raises(InputError, match=r"cannot edit(?s:.*)\[\[states\]\]"):
        remedied(tmp_path, several, Edit(("states", 1), "name", "full"))
    assert project.campaign_file(tmp_path).read_text() == several


def test_a_remedy_that_the_campaign_does_not_allow_is_refused_before_it_is_written(
    tmp_path: Path,
) -> None:
    with pytest.raises(InputError, match="positions"):
        remedied(tmp_path, WRITTEN, Edit(("identify",), "positions", "somewhere"))
    assert [p.name for p in tmp_path.iterdir()] == ["campaign.toml"]
    assert project.campaign_file(tmp_path).read_text() == WRITTEN


def test_a_remedy_can_be_undone_byte_by_byte_and_only_while_nobody_edits(tmp_path: Path) -> None:
    file = project.campaign_file(tmp_path)
    assert not can_undo(project.campaign_file(tmp_path))
    wanted = remedied(tmp_path, WRITTEN, Edit(("identify",), "positions", "fit"))
    apply(project.campaign_file(tmp_path), wanted)
    assert file.read_text() == wanted.after and can_undo(project.campaign_file(tmp_path))
    undo(project.campaign_file(tmp_path))
    assert file.read_text() == WRITTEN and not can_undo(project.campaign_file(tmp_path))
    assert [p.name for p in tmp_path.iterdir()] == ["campaign.toml"]
    with pytest.raises(InputError, match="nothing can be undone"):
        undo(project.campaign_file(tmp_path))
    apply(project.campaign_file(tmp_path), wanted)
    file.write_text(wanted.after + "# mine\n")
    assert not can_undo(project.campaign_file(tmp_path))
    with pytest.raises(InputError, match="nothing can be undone"):
        undo(project.campaign_file(tmp_path))
    assert file.read_text() == wanted.after + "# mine\n"


def test_what_was_shown_is_not_written_over_what_somebody_else_has_written(tmp_path: Path) -> None:
    wanted = remedied(tmp_path, WRITTEN, Edit(("identify",), "positions", "fit"))
    project.campaign_file(tmp_path).write_text(WRITTEN + "# mine\n")
    with pytest.raises(InputError, match="has changed since"):
        apply(project.campaign_file(tmp_path), wanted)
    assert project.campaign_file(tmp_path).read_text() == WRITTEN + "# mine\n"


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the demo project, measured by simulation; to be copied."""
    folder = tmp_path_factory.mktemp("measured")
    views.demo(nothing, str(folder))
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
    view = views.recordings_view(nothing, str(folder))
    (entry,) = [a for a in view["advised"] if a["code"] == code.value]
    options = json.loads(json.dumps(entry["options"], allow_nan=False))
    edits = [Edit(tuple(e["table"]), e["key"], e["value"]) for e in options[0]["edits"]]
    apply(project.campaign_file(folder), preview(project.campaign_file(folder), edits))
    again = views.recordings_view(nothing, str(folder))
    said = [*again["findings"], *(note for row in again["rows"] for note in row["notes"])]
    assert code.value not in [f["code"] for f in said] and not again["advised"]


def test_a_remedy_that_counts_from_old_values_is_none_of_a_campaign_that_was_changed(
    tmp_path: Path,
) -> None:
    file = project.campaign_file(tmp_path)
    file.write_text(WRITTEN)
    campaign = read_campaign(file, to_fit=False)
    found = [
        Finding(Code.POSITION_INCONSISTENT, About(), "..."),
        Finding(Code.POSITION_UNCERTAINTY_INFLATED, About(), "...", {"stretch": 2.0}),
    ]
    assert [a["code"] for a in views.advice_view(found, campaign)] == [f.code.value for f in found]
    left = views.advice_view(found, campaign, changed=True)
    assert [a["code"] for a in left] == ["position-inconsistent"]


def test_a_result_advises_what_holds_of_the_campaign_now_and_nothing_once_it_was_edited(
    tmp_path: Path,
) -> None:
    project.campaign_file(tmp_path).write_text(WRITTEN)
    own = {"severity": "serious", "sentence": "..."}
    inflated = {"code": "position-uncertainty-inflated", "severity": "warning", "sentence": "..."}
    found = [
        {**own, "code": "position-inconsistent", "evidence": {}},
        {**inflated, "evidence": {"stretch": 2.0}},
    ]
    write_result(tmp_path, found, [])
    file = tmp_path / "first" / "result.json"

    def codes() -> list[str]:
        view = views.result_view(nothing, str(tmp_path), "first")
        assert view is not None
        return [a["code"] for a in view["advised"]]

    assert codes() == [f["code"] for f in found]
    content = json.loads(file.read_text())
    del content["content_sha256"]
    content["provenance"] = {"inputs_sha256": {"campaign.toml": "of another text"}}
    write_json_atomically(file, content)
    assert codes() == ["position-inconsistent"]
    file.write_text(file.read_text().replace("1000.0", "500.0"))
    assert codes() == []


def test_findings_of_one_code_are_one_choice_of_all_of_them_first(tmp_path: Path) -> None:
    row = '\n[[measurements]]\nsource = "S1"\nreceiver = "R 1"\nfile = "{}.wav"\n'
    project.campaign_file(tmp_path).write_text(WRITTEN + row.format("a") + row.format("b"))
    campaign = read_campaign(project.campaign_file(tmp_path), to_fit=False)
    found = [
        Finding(Code.TIME_ZERO_MISMATCH, About(files=[f"{name}.wav"]), "...", graded=severity)
        for name, severity in (("a", "warning"), ("b", "serious"))
    ]
    (entry,) = views.advice_view(found, campaign)
    assert [o["words"] for o in entry["options"]] == [
        f'time_zero = "direct" for {which}' for which in ("all 2 recordings", "a.wav", "b.wav")
    ]
    assert (entry["n"], entry["severity"]) == (2, "serious")
