"""`roomfit init`: a first campaign from file names, a room and positions, blanks where unknown."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from roomfit.base.errors import InputError
from roomfit.cli.init import draft_to_folder
from roomfit.files.campaign import FILL_IN, blanks, read_campaign
from roomfit.files.draft import (
    draft_campaign,
    likely_units,
    likely_up,
    plausible_units,
)
from roomfit.files.file_names import matching_files
from roomfit.files.rooms import read_model
from roomfit.files.schema import RoomSpec
from roomfit.files.values import read_positions
from roomfit.formats.model import METRES_PER_UNIT
from roomfit.materials.catalogue import catalogue
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
    assert "1 source, 2 receivers, ir/{source}_{receiver}.wav" in capsys.readouterr().out
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
    assert caught.value.needed == "a unit (--unit), one of m, ft"


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
    assert (
        '[materials."Moquette"]  # 12.1 m2: floor\n# prior = "carpet"  # or carpet-thin' in drafted
    )
    assert '# prior = "suspended-ceiling"' in drafted and '# prior = "..."' in drafted
    for name in catalogue().classes:  # what it asks for is what it takes, once the sign is gone
        said = drafted.replace('# prior = "..."', f'prior = "{name}"')
        assert name in drafted and tomllib.loads(said)["materials"]["walls"] == {"prior": name}
    assert tomllib.loads(drafted)["materials"] == {"walls": {}, "Moquette": {}, "Akustikdecke": {}}


def test_a_name_is_split_where_both_parts_are_known(tmp_path):
    """Else at the first place: names of sources and receivers may hold what stands between."""
    for name in ("s000_150_M.wav", "S030_150_M_2.wav", "other_one_M.wav"):
        (tmp_path / name).touch()
    known = ("S000_150", "S030_150", "M", "M_2")
    found = matching_files(tmp_path, "{source}_{receiver}.wav", known)
    assert found == {
        "s000_150_M.wav": ("S000_150", "M"),
        "S030_150_M_2.wav": ("S030_150", "M_2"),
        "other_one_M.wav": ("other", "one_M"),
    }
    apart = matching_files(tmp_path, "{source}_{receiver}.wav")
    assert apart["s000_150_M.wav"] == ("s000", "150_M")


@pytest.mark.parametrize("line", ["R2,1,2", "R2,1,x,3", "R1,1,2,3", "R2,nan,2,3"])
def test_a_line_of_positions_that_is_none_is_refused_with_its_number(tmp_path, line):
    file = tmp_path / "p.csv"
    file.write_text(f"R1,1,2,3\n{line}\n")
    with pytest.raises(InputError, match="line 2"):
        read_positions(file)


def names_of(folder: Path, *files: str) -> Path:
    for file in files:
        (folder / file).parent.mkdir(exist_ok=True)
        (folder / file).write_bytes(b"x")
    return folder


def test_what_macos_and_others_leave_among_recordings_is_passed_over(tmp_path):
    """A hidden twin, a sweep and a note do not spoil the shape that the others have."""
    names = ["LS1_MP1.wav", "LS1_MP2.wav", "LS1_MP3.wav"]
    names_of(tmp_path, *names, "._LS1_MP1.wav", "sweep.wav", "notes.docx", ".DS_Store")
    expected = {name: ("LS1", name[4:7]) for name in names}
    assert matching_files(tmp_path, None) == expected
    assert matching_files(tmp_path, "{source}_{receiver}.wav") == expected


def test_recordings_in_the_only_folder_below_are_found(tmp_path):
    names_of(tmp_path, "Messung 1/LS1_MP1.wav", "Messung 1/LS1_MP2.wav", "plan.pdf", "old/x.docx")
    found = matching_files(tmp_path, None)
    assert found["Messung 1/LS1_MP2.wav"] == ("LS1", "MP2")
    names_of(tmp_path, "Messung 2/LS1_MP1.wav")
    with pytest.raises(InputError, match=r"several folders(?s:.*)Messung 1 \(2 files\)"):
        matching_files(tmp_path, None)


@pytest.mark.parametrize(
    ("name", "pair"),
    [
        ("LS1_MP1.wav", ("LS1", "MP1")),
        ("2024-05-03 Saal LS1 - MP1 take2.wav", ("LS1", "MP1")),
        ("ls1-mp10.wav", ("LS1", "MP10")),  # not MP1
        ("Bu\N{COMBINING DIAERESIS}hne links_MP1.wav", ("B\u00fchne links", "MP1")),
        ("MP1.wav", None),
        ("LS1_MP1_MP10.wav", None),
    ],
)
def test_names_of_positions_are_found_in_names_of_files(tmp_path, name, pair):
    """As whole words, in either form of an umlaut, the source first; others are left out."""
    known = ["LS1", "MP1", "MP10", "B\u00fchne links"]
    names_of(tmp_path, name, "LS1 MP10 again.wav")
    found = matching_files(tmp_path, None, known)
    assert found["LS1 MP10 again.wav"] == ("LS1", "MP10")
    assert found.get(name) == pair


def test_decimal_commas_between_commas_are_refused_and_a_unit_is_read_from_any_column(tmp_path):
    """1,20,1,50,1,10 was read as x = 1, y = 20, z = 1."""
    path = tmp_path / "p.csv"
    path.write_text("name,x,y,z\nLS1,1,20,1,50,1,10\n")
    with pytest.raises(InputError, match="semicolons"):
        read_positions(path)
    path.write_text("name,x,y,z [cm]\nLS1,120,150,110\n")
    assert read_positions(path)[0] == {"LS1": (1.2, 1.5, 1.1)}


def test_init_says_what_it_left_out_and_what_may_be_missing(folder, monkeypatch, capsys):
    """A hall as a stranger has it: recordings below, a drawing and a table beside them."""
    monkeypatch.chdir(folder)
    (folder / "ir" / "sweep.wav").write_bytes(b"x")
    assert run_command(monkeypatch, "init", ".") == 0
    said = capsys.readouterr().out
    assert "left out, names that do not fit: ir/sweep.wav" in said
    assert "perhaps: roomfit init . --room room.obj --positions positions.csv --overwrite\n" in said
    (folder / "more.csv").write_text((folder / "positions.csv").read_text() + "\nMP9;1;1;1\n")
    room = ("--room", "room.obj", "--unit", "in")
    again = ("--positions", "more.csv", "--overwrite")
    assert run_command(monkeypatch, "init", ".", *room, *again) == 0
    said = capsys.readouterr().out
    assert "positions that no recording names: MP9" in said and "FILL" not in said
    assert blanks(tomllib.loads((folder / "campaign.toml").read_text())) == []


@pytest.mark.parametrize(
    ("files", "known", "pairs"),
    [
        (("S1R1", "S2R12"), (), (("S1", "R1"), ("S2", "R12"))),
        (("S1R1", "S2R12"), ("S1", "S2", "R1", "R12"), (("S1", "R1"), ("S2", "R12"))),
        (("LS1_MP01",), ("LS1", "MP1"), (("LS1", "MP1"),)),
        (("src 1 - mic 2",), ("src1", "mic2"), (("src1", "mic2"),)),
        (("R12S2",), ("S2", "R12"), (("S2", "R12"),)),
        (("R1", "R2"), ("S1", "S2", "R1", "R2"), ((FILL_IN, "R1"), (FILL_IN, "R2"))),
        (("S1_R11",), ("S1", "R1.1", "R11"), (("S1", "R11"),)),
        (("S1_R1-1",), ("S1", "R1", "R1_1", "R1-1"), (("S1", "R1-1"),)),
        (("S12_R01",), ("S1-2", "S12", "R1", "R01"), (("S12", "R01"),)),
        (("S1 2_R1",), ("S12", "S1-2", "R1"), (("S1-2", "R1"),)),
        (("S11",), ("S1", "1"), ((FILL_IN, "S11"),)),
        (("hall_S1", "hall_S2"), (), ((FILL_IN, "hall_S1"), (FILL_IN, "hall_S2"))),
    ],
)
def test_a_source_is_what_the_name_of_a_file_says_or_a_blank(tmp_path, files, known, pairs):
    names_of(tmp_path, *(f"{name}.wav" for name in files))
    assert tuple(matching_files(tmp_path, None, known).values()) == pairs


SOURCES, RECEIVERS = np.array([[1, 1, 1], [2, 1, 1.5]]), np.array([[3, 2, 1], [3, 1, 1.2]])


def write_sofa(
    path, corner=(0, 0, 0), lengths=(5, 4, 3), kelvin=294.15, sources=SOURCES, receivers=RECEIVERS
):
    """A SOFA file of so many receivers, and as many emitters as there are sources."""
    sofar = pytest.importorskip("sofar")
    n, r = len(sources), len(receivers)
    sofa = sofar.Sofa("SingleRoomMIMOSRIR")
    sofa.Data_IR = np.random.default_rng(1).normal(size=(1, r, 4800, n))
    sofa.Data_SamplingRate, sofa.Data_Delay = 48_000, np.zeros((1, r, n))
    sofa.ListenerPosition = sofa.SourcePosition = corner
    sofa.SourcePosition_Type, sofa.SourcePosition_Units = "cartesian", "metre"
    sofa.ReceiverPosition, sofa.EmitterPosition = receivers[..., None], sources[..., None]
    sofa.ReceiverPosition_Type = sofa.EmitterPosition_Type = "cartesian"
    sofa.ReceiverPosition_Units = sofa.EmitterPosition_Units = "metre"
    for end in ("Receiver", "Emitter"):
        for key in ("Descriptions", "View", "Up"):
            sofa.delete(end + key)
    sofa.RoomCornerA, sofa.RoomCornerB = corner, np.add(corner, lengths)
    sofa.RoomTemperature, sofa.RoomTemperature_Units = kelvin, "kelvin"
    sofar.write_sofa(str(path), sofa)


@pytest.mark.parametrize("corner", [(0.0, 0.0, 0.0), (10.0, -20.0, 1.0)])
def test_a_sofa_file_of_many_pairs_gives_measurements_positions_room_and_air(tmp_path, corner):
    """Wherever the corner of its room lies; sources are emitters, receivers those of a listener."""
    write_sofa(tmp_path / "room.sofa", corner)
    written = tomllib.loads(draft_to_folder(tmp_path, None))
    assert written["room"]["shoebox"] == [5, 4, 3] and written["air"]["temperature_c"] == 21.0
    assert [s["position"] for s in written["sources"].values()] == SOURCES.tolist()
    assert [r["position"] for r in written["receivers"].values()] == RECEIVERS.tolist()
    assert [(m["source"], m["receiver"]) for m in written["measurements"]] == [
        ("S1", "R1"), ("S2", "R1"), ("S1", "R2"), ("S2", "R2"),
    ]  # fmt: skip
    chosen = [(m["receiver_index"], m["emitter_index"]) for m in written["measurements"]]
    assert chosen == [(0, 0), (0, 1), (1, 0), (1, 1)]


def test_the_table_of_positions_decides_and_two_places_of_one_name_are_said(tmp_path):
    """Names of the table at the file's places, to 1 cm; else the place that the table has."""
    write_sofa(tmp_path / "S1_R1.sofa")
    table = tmp_path / "p.csv"
    table.write_text("name,x [m],y [m],z [m]\nLS,1.005,1,1\nS2,2,1,1.2\nMP,3,2,1\n")
    written = tomllib.loads(draft_to_folder(tmp_path, None, positions=table))
    named = [(m["source"], m["receiver"]) for m in written["measurements"]]
    assert named == [("LS", "MP"), ("S1", "MP"), ("LS", "R1"), ("S1", "R1")]
    assert written["sources"]["LS"]["position"] == [1.005, 1, 1]
    assert written["sources"]["S1"]["position"] == [2, 1, 1.5]
    (tmp_path / "S1_R1.sofa").unlink()
    for i in (0, 1):
        write_sofa(tmp_path / f"S2_R{i}.sofa", sources=SOURCES[i:][:1], receivers=RECEIVERS[i:][:1])
    with pytest.raises(InputError, match=r"S2 at \(2\.0.*S2_R1\.sofa, and at \(1\.0(.*\n)*.*--pos"):
        draft_to_folder(tmp_path, None, overwrite=True)
    text = draft_to_folder(tmp_path, None, positions=table, overwrite=True)
    assert tomllib.loads(text)["sources"]["S2"]["position"] == [2, 1, 1.2]
    assert text.count("in the table of positions, which applies") == 2


def test_defaults_of_a_convention_are_no_facts_and_a_given_room_has_its_own_axes(tmp_path):
    """A room of 1, 2, 3 m and 0 K; a box of another size does not stand at the file's corner."""
    write_sofa(tmp_path / "a.sofa", lengths=(1, 2, 3), kelvin=0.0)
    text = draft_to_folder(tmp_path, None)
    assert "In doubt: a.sofa: the room of 1 m x 2 m x 3 m is a default" in text
    assert "of 0 K is a default" in text and "air" not in tomllib.loads(text)
    assert FILL_IN in tomllib.loads(text)["room"]["shoebox"]
    write_sofa(tmp_path / "a.sofa", corner=(-1, -1, 0))
    for lengths, moved in (((5, 4, 3), 1.0), ((6, 5, 3), 0.0)):
        written = tomllib.loads(
            draft_to_folder(tmp_path, RoomSpec(shoebox=lengths), overwrite=True)
        )
        assert written["sources"]["S1"]["position"] == [0 + moved, 0 + moved, 1]
