"""`roomfit init`: a first campaign from file names, a room and positions, blanks where unknown."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from roomfit.errors import InputError
from roomfit.io.campaign import FILL_IN, blanks, read_campaign
from roomfit.io.draft import (
    draft_campaign,
    likely_units,
    likely_up,
    matching_files,
    plausible_units,
    read_positions,
)
from roomfit.io.rooms import read_model
from roomfit.io.rooms.model import METRES_PER_UNIT, RoomSpec
from small_campaign import (
    LENGTHS_M,
    RECEIVERS_M,
    SOURCE_M,
    box_obj,
    run_command,
    small_responses,
    write_wav,
)


def scaled_obj(factor: float, *, y_up: bool = False, header: str = "", names: bool = True) -> str:
    """The box of 3.9 x 3.1 x 2.5 m with its coordinates in another unit, perhaps lying."""
    lines = []
    for line in box_obj().splitlines():
        if line.startswith("v "):
            x, y, z = (factor * float(word) for word in line.split()[1:])
            line = f"v {x} {z} {-y}" if y_up else f"v {x} {y} {z}"
        elif not names and line[:2] in ("g ", "us"):
            line = line.split()[0] + " part" + str(len(lines))
        lines.append(line)
    return header + "\n".join(lines) + "\n"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "ir").mkdir()
    for name, pressure in small_responses().items():
        write_wav(tmp_path / "ir" / f"LS1_{name}.wav", pressure)
    rows = {"LS1": SOURCE_M, **RECEIVERS_M}
    lines = [
        ";".join([n, *(f"{100 * x:.1f}".replace(".", ",") for x in at)]) for n, at in rows.items()
    ]
    (tmp_path / "positions.csv").write_text("\n".join(["name;x [cm];y [cm];z [cm]", *lines]))
    (tmp_path / "room.obj").write_text(scaled_obj(1 / 0.0254, y_up=True))
    return tmp_path


def test_files_a_drawing_in_inches_and_positions_in_centimetres_become_a_campaign(
    folder, monkeypatch, capsys
):
    """Nothing is left to fill in, and room and positions come back in metres with z up."""
    arguments = ("--recordings", "ir/{source}_{receiver}.wav", "--positions")
    assert run_command(
        monkeypatch, "init", folder, "--room", folder / "room.obj", "--unit", "in", *arguments,
        folder / "positions.csv",
    ) == 0  # fmt: skip
    assert "1 sources, 2 receivers, ir/{source}_{receiver}.wav" in capsys.readouterr().out
    campaign = read_campaign(folder / "campaign.toml")
    assert (campaign.room.unit, campaign.room.up) == ("in", "y")
    assert {p.name: tuple(p.position_m) for p in campaign.receivers} == RECEIVERS_M
    assert [m.response.path.name for m in campaign.measurements] == ["LS1_MP1.wav", "LS1_MP2.wav"]
    assert run_command(monkeypatch, "check", folder / "campaign.toml") == 1
    # the recordings have 8 kHz
    assert "4000 Hz, whose filter ends at 7943 Hz" in " ".join(capsys.readouterr().out.split())
    text = (folder / "campaign.toml").read_text()
    text = text.replace("from_hz = 125", "from_hz = 500").replace("to_hz = 4000", "to_hz = 1000")
    (folder / "campaign.toml").write_text(text)
    assert run_command(monkeypatch, "check", folder / "campaign.toml") == 0
    assert "30.22 m3" in capsys.readouterr().out


def test_what_is_not_known_is_a_blank_that_identify_lists(folder, monkeypatch, capsys):
    assert run_command(monkeypatch, "init", folder, "--shoebox", 3.9, 3.1, 2.5,
                       "--recordings", "ir/{source}_{receiver}.wav") == 0  # fmt: skip
    listed = "sources.LS1.position, receivers.MP1.position, receivers.MP2.position"
    assert f"to be filled in: {listed}" in capsys.readouterr().out
    assert run_command(monkeypatch, "identify", folder / "campaign.toml", "--out", "x") == 2
    assert f"found   {FILL_IN} for {listed}" in capsys.readouterr().err


def test_an_empty_folder_gives_a_campaign_of_blanks(tmp_path):
    text = draft_campaign(None, matching_files(tmp_path, None), folder=tmp_path)
    assert blanks(tomllib.loads(text)) == [
        "room.shoebox", "sources.S1.position", "receivers.R1.position", "measurements[1].file",
    ]  # fmt: skip


def test_a_campaign_that_is_there_is_kept_unless_overwriting_was_asked(folder, monkeypatch, capsys):
    file = folder / "campaign.toml"
    file.write_text("mine")
    assert run_command(monkeypatch, "init", folder) == 2
    assert "add --overwrite" in capsys.readouterr().err
    assert file.read_text() == "mine"
    assert run_command(monkeypatch, "init", folder, "--overwrite") == 0
    assert file.read_text() != "mine"


@pytest.mark.parametrize(
    ("header", "unit"),
    [("# File units = meters\n", "m"), ("# Units: inches\n", "in"), ("# unit cm\n", "cm")],
)
def test_a_header_that_states_the_unit_decides(tmp_path, header, unit):
    file = tmp_path / "room.obj"
    file.write_text(scaled_obj(1.0, header=header))
    assert likely_units(file) == {unit: "by the header of the file"}


@pytest.mark.parametrize("unit", METRES_PER_UNIT)
def test_the_true_unit_of_a_room_is_among_the_plausible_ones(unit):
    """From a studio to a concert hall, whatever its unit."""
    for lengths in ((2.5, 2.0, 2.2), LENGTHS_M, (12.0, 9.0, 4.0), (45.0, 25.0, 18.0)):
        assert unit in plausible_units(np.array(lengths) / METRES_PER_UNIT[unit])


def test_a_unit_in_doubt_is_refused_with_the_rooms_that_it_would_be(tmp_path):
    """20 x 16 x 9: a hall in metres, or a living room in feet."""
    (tmp_path / "room.obj").write_text(scaled_obj(3.7))
    with pytest.raises(InputError, match="unit of the room file is in doubt") as caught:
        draft_campaign(RoomSpec(file=tmp_path / "room.obj"), {}, folder=tmp_path)
    assert "m: the room is then 14.4 x 11.5 x 9.25 m; ft:" in str(caught.value.hint)
    assert caught.value.needed == "--unit, one of m, ft"


@pytest.mark.parametrize("names", [True, False])
@pytest.mark.parametrize("y_up", [True, False])
def test_floor_and_ceiling_are_level_or_else_a_room_is_the_least_high(tmp_path, names, y_up):
    file = tmp_path / "room.obj"
    file.write_text(scaled_obj(1.0, y_up=y_up, names=names))
    model, _ = read_model(RoomSpec(file=file))
    model.vertices[:, 0 if y_up else 1] *= 1.6  # a longer room
    if y_up:
        model.vertices[:, 2] *= 1.6
    assert likely_up(model)[0] == ("y" if y_up else "z")


def test_materials_are_listed_with_area_surfaces_and_an_entry_by_their_names(tmp_path):
    text = box_obj().replace("usemtl carpet", "usemtl Moquette").replace("tiles", "Akustikdecke")
    (tmp_path / "room.obj").write_text(text)
    spec = RoomSpec(file=tmp_path / "room.obj", unit="m")
    drafted = draft_campaign(spec, {}, folder=tmp_path)
    assert '[materials."Moquette"]  # 12.1 m2: floor\n# prior = "carpet-heavy-on' in drafted
    assert '# prior = "ceiling-tile-suspended"' in drafted
    assert tomllib.loads(drafted)["materials"] == {"walls": {}, "Moquette": {}, "Akustikdecke": {}}


@pytest.mark.parametrize(
    ("template", "words"),
    [
        ("ir/{source}.wav", "a template of recordings without source or receiver"),
        ("ir/{source}-{receiver}.wav", "LS1_MP1.wav, LS1_MP2.wav"),
        ("elsewhere/{source}_{receiver}.wav", "no recordings"),
    ],
)
def test_a_template_that_fits_nothing_says_what_is_there(folder, template, words):
    with pytest.raises(InputError) as caught:
        matching_files(folder, template)
    assert words in str(caught.value)


def test_other_text_and_several_separators_are_taken(tmp_path):
    for name in ("2024 hall S1 at R2 take3.wav", "2024 hall S1 at R3 take1.wav", "sweep.wav"):
        (tmp_path / name).touch()
    found = matching_files(tmp_path, "* hall {source} at {receiver} take*.wav")
    assert list(found.values()) == [("S1", "R2"), ("S1", "R3")]


@pytest.mark.parametrize("line", ["R2,1,2", "R2,1,x,3", "R1,1,2,3", "R2,nan,2,3"])
def test_a_line_of_positions_that_is_none_is_refused_with_its_number(tmp_path, line):
    file = tmp_path / "p.csv"
    file.write_text(f"R1,1,2,3\n{line}\n")
    with pytest.raises(InputError, match="line 2"):
        read_positions(file)
