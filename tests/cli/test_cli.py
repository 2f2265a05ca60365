"""The command line: what it prints, where it writes, and how it ends."""

from __future__ import annotations

import csv
import json
import re
import subprocess
import sys

import numpy as np
import pytest
import soundfile

import roomfit
from small_campaign import (
    STAGE_OR_FIRST_ANSWER,
    box_obj,
    run_command,
    write_campaign,
    write_wav,
)

HEAVY = ("numpy", "scipy", "numba", "matplotlib", "pydantic", "h5py", "soundfile", "trimesh")


def output_and_loaded(packages, *arguments):
    """Return what a command prints in a process of its own, and which of the packages it loaded."""
    program = (
        f"import sys; sys.path[:0] = {sys.path!r}\n"
        "from roomfit.cli import main\n"
        f"try: main({[str(a) for a in arguments]!r})\n"
        "except SystemExit: pass\n"
        f"print('LOADED', *[m for m in {packages} if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    output, _, loaded = done.stdout.rpartition("LOADED")
    return output + done.stderr, loaded.split()


@pytest.mark.parametrize(
    ("option", "words"), [("--help", "identify"), ("--version", roomfit.__version__)]
)
def test_help_and_version_load_nothing_heavy(option, words):
    """What makes them answer at once: none of the large packages is imported for them."""
    output, loaded = output_and_loaded(HEAVY, option)
    assert words in output and loaded == []


@pytest.mark.slow
def test_a_check_of_a_room_loads_no_pictures_and_no_statistics(tmp_path):
    """What makes it answer within a second or so: of the large packages only what a room needs."""
    room = tmp_path / "room.obj"
    room.write_text(box_obj())
    names = ("matplotlib", "scipy.signal", "scipy.stats", "roomfit.fit", "roomfit.predict")
    output, loaded = output_and_loaded(names, "check", room, "--unit", "m")
    assert "can be traced" in output and loaded == []


def test_an_export_waits_for_no_compiler(tmp_path):
    """A table written anew takes no kernel, and no package that only a fit needs."""
    table, out = tmp_path / "absorption.csv", tmp_path / "materials.txt"
    table.write_text(
        "material,band_hz,absorption,lower95,upper95,identifiable\ncarpet,500,0.3,0.25,0.36,true\n"
    )
    names = ("numba", "scipy", "matplotlib")
    _, loaded = output_and_loaded(names, "export", table, "--format", "catt", "--out", out)
    assert loaded == [] and out.is_file()


COMMANDS = ("app", "batch", "catalogue", "check", "compare", "demo",
            "design", "export", "identify", "impedance", "init", "listen", "measure", "paper",
            "predict", "reverberation", "schema", "treat")  # fmt: skip


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(monkeypatch, capsys, command):
    assert run_command(monkeypatch, command, "--help") == 0
    shown = capsys.readouterr()
    assert f"roomfit {command}" in re.sub(r"\s+", " ", shown.out)
    assert shown.err == ""


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("identify",), "required: campaign, --out"),
        (("identify", "a.toml"), "required: --out"),
        (("identify", "a.toml", "--out"), "--out: expected one argument"),
        (("identify", "a.toml", "b.toml", "--out", "c"), "unrecognized arguments: b.toml"),
        (("identify", "--ot", "c", "a.toml"), "did you mean '--out'?"),
        (("desing",), "did you mean 'design'?"),
        (("fly",), "try     roomfit --help"),
        (("demo", "--seed", "x"), "--seed: 'x' is not a whole number"),
        (("identify", "a", "--out", "b", "--bands", "low"), "--bands: 'low' is not a number"),
        (("paper", "--out", "b", "--seeds", "0"), "--seeds: 0 is less than 1"),
    ],
)
def test_a_wrong_call_ends_with_2_and_how_to_call(monkeypatch, capsys, arguments, words):
    assert run_command(monkeypatch, *arguments) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert words in shown.err
    assert "  needed  roomfit" in shown.err
    assert "Traceback" not in shown.err


def test_no_command_at_all_shows_the_help_and_ends_with_2(monkeypatch, capsys):
    assert run_command(monkeypatch) == 2
    assert capsys.readouterr().out.startswith("usage: roomfit")


def test_identify_writes_every_file_and_prints_what_they_say(tmp_path, monkeypatch, capsys):
    campaign = write_campaign(tmp_path / "campaign", ('"LS1"', '"a/b"'), (".LS1]", '."a/b"]'))
    out = tmp_path / "new" / "out"
    assert run_command(monkeypatch, "identify", campaign, "--out", out) == 0
    shown = capsys.readouterr()
    # stages and the first answer, and nothing else
    assert all(STAGE_OR_FIRST_ANSWER.match(line) for line in shown.err.splitlines())
    assert (
        len(re.findall(r"\d:\d\d  so far, absorption in % and its 95 % interval;", shown.err)) == 1
    )
    assert str(out) in shown.out
    # a name that is no file name does not lead out of the folder
    assert sorted(p.name for p in out.iterdir()) == [
        ".roomfit-files",
        "absorption.csv",
        "absorption.svg",
        "decay_01_a_b_MP1.svg",
        "decay_02_a_b_MP2.svg",
        "decay_times.svg",
        "report.html",
        "result.json",
        "room.svg",
    ]
    assert [p.name for p in out.parent.iterdir()] == ["out"]
    # made aside, yet with the permissions of any other new folder
    assert out.stat().st_mode == out.parent.stat().st_mode
    result = json.loads((out / "result.json").read_text())
    with (out / "absorption.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    for row in rows:
        reported = result["materials"][row["material"]]
        band = result["bands_hz"].index(float(row["band_hz"]))
        assert float(row["absorption"]) == pytest.approx(reported["absorption"][band], abs=5e-6)
    table = next(line for line in shown.out.splitlines() if line.startswith("carpet"))
    assert f"{result['materials']['carpet']['absorption'][0]:.2f}"[1:] in table


@pytest.mark.slow
def test_overwriting_replaces_what_has_the_same_name_and_keeps_the_rest(tmp_path, monkeypatch):
    campaign = write_campaign(tmp_path / "campaign")
    out = tmp_path / "out"
    out.mkdir()
    (out / "result.json").write_text("old")
    (out / "notes.txt").write_text("mine")
    assert run_command(monkeypatch, "identify", campaign, "--out", out, "--overwrite") == 0
    assert json.loads((out / "result.json").read_text())["format"] == "roomfit-result"
    assert (out / "notes.txt").read_text() == "mine"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["campaign", "out"]


def test_the_schema_is_json_that_says_what_every_key_means(monkeypatch, capsys):
    """And takes a campaign that is good: every key of it is among the properties."""
    assert run_command(monkeypatch, "schema") == 0
    schema = json.loads(capsys.readouterr().out)
    tables = {"Campaign": schema, **schema["$defs"]}
    silent = [
        f"{name}.{key}"
        for name, table in tables.items()
        for key, own in table["properties"].items()
        if not own.get("description")
    ]
    assert silent == []
    assert {"room", "sources", "receivers", "measurements"} <= schema["properties"].keys()
    assert schema["additionalProperties"] is False
    latency = schema["$defs"]["MeasurementTable"]["properties"]["latency_s"]
    assert (latency["minimum"], latency["maximum"], latency["default"]) == (-10.0, 10.0, 0.0)


def test_check_tells_a_room_in_numbers_and_its_faults_in_words(tmp_path, monkeypatch, capsys):
    room = tmp_path / "room.obj"
    room.write_text(box_obj())
    assert run_command(monkeypatch, "check", room, "--unit", "m") == 0
    reported = capsys.readouterr().out
    # 3.9 * 3.1 * 2.5 and 2 (3.9 * 3.1 + (3.9 + 3.1) 2.5)
    assert "30.22 m3" in reported
    assert "59.18 m2" in reported
    assert "The room can be traced" in reported

    room.write_text(box_obj(without="ceiling"))
    assert run_command(monkeypatch, "check", room, "--unit", "m") == 2
    assert "Faults forbid tracing" in capsys.readouterr().out


def test_check_of_a_campaign_names_every_wrong_position_at_once(tmp_path, monkeypatch, capsys):
    good = write_campaign(tmp_path / "good")
    assert run_command(monkeypatch, "check", good) == 0
    assert "carpet" in capsys.readouterr().out
    bad = write_campaign(
        tmp_path / "bad",
        ("position = [1.0, 1.2, 1.1]", "position = [1.0, 0.001, 1.1]"),
        ("position = [2.9, 2.2, 1.3]", "position = [2.9, 22.0, 1.3]"),
    )
    assert run_command(monkeypatch, "check", bad) == 2
    reported = capsys.readouterr().out
    assert "source 'LS1' stands in a wall" in reported
    assert "receiver 'MP1' stands outside the room" in reported


def late_campaign(folder, samples=40):
    """The small campaign with a third position, all files late by so many samples of 8 kHz."""
    campaign = write_campaign(folder)
    for file in folder.glob("*.wav"):
        pressure, rate_hz = soundfile.read(file)
        write_wav(file, np.append(np.zeros(samples), pressure), rate_hz)
    return campaign


def test_check_of_a_campaign_shows_every_recording_by_band_and_draws_the_room(
    tmp_path, monkeypatch, capsys
):
    campaign = write_campaign(tmp_path / "campaign")
    out = tmp_path / "out"
    assert run_command(monkeypatch, "check", campaign, "--out", out) == 0
    shown = capsys.readouterr().out
    row = next(line for line in shown.splitlines() if line.startswith("LS1 to MP1"))
    # of 2.15 m; peak over noise, and the decay range at 500 and 1000 Hz
    assert re.fullmatch(r"LS1 to MP1 \(LS1_MP1.wav\) +5.9\d +6.27 +\d\d +4\d +4\d", row)
    assert "Schroeder frequency, Hz" in shown
    files = {f.name for f in out.iterdir()}
    assert {"room.svg", "room_parameters.csv", "recordings.html"} < files
    assert "recording_01_LS1_MP1.svg" in files
    assert run_command(monkeypatch, "check", campaign, "--out", out) == 2


def test_what_a_finding_advises_is_printed_written_and_taken_back(tmp_path, monkeypatch, capsys):
    """The lines that are shown are those that are written, and they leave no such finding."""
    campaign = late_campaign(tmp_path)
    text = campaign.read_text() + "# mine\n"
    campaign.write_text(text)
    assert run_command(monkeypatch, "check", campaign) == 1
    shown = capsys.readouterr().out
    lines = ["[defaults]", "latency_s = 0.005"]
    assert "".join(f"    {line}\n" for line in lines) in shown
    assert f"roomfit check {campaign} --remedy CODE" in shown
    assert run_command(monkeypatch, "check", campaign, "--remedy", "recordings-late") == 0
    said = capsys.readouterr().out
    assert all(line in said for line in lines) and "--undo" in said
    assert campaign.read_text() == f"{text}\n{lines[0]}\n{lines[1]}\n"
    assert run_command(monkeypatch, "check", campaign) == 0
    capsys.readouterr()
    assert run_command(monkeypatch, "check", campaign, "--undo") == 0
    assert campaign.read_text() == text
    capsys.readouterr()
    assert run_command(monkeypatch, "check", campaign, "--undo") == 2
    assert "nothing can be undone" in capsys.readouterr().err


@pytest.mark.slow
def test_what_an_answer_advises_is_written_by_its_code_and_number(tmp_path, monkeypatch, capsys):
    """On the terminal with details, and in the campaign the same; the report has no TOML."""
    campaign, out = write_campaign(tmp_path / "own"), tmp_path / "answer"
    assert run_command(monkeypatch, "identify", campaign, "--quick", "--details", "--out", out) == 0
    shown = capsys.readouterr().out
    line = re.search(r"# or (position-uncertainty-assumed:2), (position_sd = \S+) for", shown)
    assert line and line[2] not in (out / "report.html").read_text()
    assert f"--result {out} --remedy CODE" in shown
    for wanted, words in ((line[1][:-1] + "9", "no finding advises this"), ("none", "--result")):
        assert run_command(monkeypatch, "check", campaign, "--result", out, "--remedy", wanted) == 2
        assert words in capsys.readouterr().err
    before = campaign.read_text()
    assert run_command(monkeypatch, "check", campaign, "--result", out) == 2
    assert run_command(monkeypatch, "check", campaign, "--result", out, "--remedy", line[1]) == 0
    written = campaign.read_text()
    assert written.count(line[2]) == 3 and before.count(line[2]) == 0
    assert run_command(monkeypatch, "check", campaign, "--undo") == 0
    assert campaign.read_text() == before


def test_no_file_of_the_user_s_folder_is_run_as_a_module(tmp_path):
    """``python -m`` looks there first, and a stranger's folder may hold a numba.py."""
    (tmp_path / "numba.py").write_text('raise SystemExit("run")')
    (tmp_path / "coverage").mkdir()
    command = [sys.executable, "-m", "roomfit", "check", "campaign.toml"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "no such file" in done.stderr


@pytest.mark.parametrize(
    ("call", "words"),
    [
        ("check {campaign} --unit mm", "itself specifies"),
        ("check {folder}/r.obj --unit m --bands 1000", "and no bands"),
        ("check {folder}", "give the file in it: {campaign}"),
        ("compare {folder} {folder}", "give the file in it: {folder}/result.json"),
        ("demo --out {folder}", "exists and is not empty"),
        ("paper --out {folder}", "exists and is not empty"),
        ("check {folder}/other.toml", "did you mean 'carpet'"),
    ],
)
def test_what_cannot_be_meant_is_refused_before_anything_is_written(
    tmp_path, monkeypatch, capsys, call, words
):
    campaign = write_campaign(tmp_path)
    other = campaign.read_text().replace("[materials.carpet]", "[materials.carpets]")
    (tmp_path / "other.toml").write_text(other)
    (tmp_path / "r.obj").write_text(box_obj())
    (tmp_path / "result.json").write_text("{}")
    before = sorted(tmp_path.iterdir())
    named = {"campaign": campaign, "folder": tmp_path}
    assert run_command(monkeypatch, *call.format(**named).split()) == 2
    assert words.format(**named) in capsys.readouterr().err
    assert sorted(tmp_path.iterdir()) == before
