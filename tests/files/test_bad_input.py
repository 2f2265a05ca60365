"""Whatever is wrong with a campaign: exit code 2, one message that helps, and nothing written."""

from __future__ import annotations

import hashlib
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from roomfit.base.errors import InputError
from small_campaign import (
    MATERIALS,
    RATE_HZ,
    run_command,
    small_responses,
    write_campaign,
    write_wav,
)

CARPET = "[materials.carpet]"
AIR = "[air]\nhumidity_percent = 150\n[identify]"
SHOEBOX = "shoebox = [3.9, 3.1, 2.5]"
OBJ = 'file = "room.obj"\nunit = "m"'
FIRST_FILE = 'file = "LS1_MP1.wav"'
SOURCE = "position = [1.0, 1.2, 1.1]"


@pytest.fixture
def refusal(tmp_path, monkeypatch, capsys):
    """Run a campaign that must be refused, and return the one message that is shown."""

    def run(campaign: Path) -> str:
        before = sorted(tmp_path.rglob("*"))
        code = run_command(monkeypatch, "identify", campaign, "--out", tmp_path / "deep" / "out")
        shown = capsys.readouterr()
        assert code == 2, shown.err
        assert shown.out == ""
        assert sorted(tmp_path.rglob("*")) == before
        return one_message(shown.err)

    return run


def one_message(text: str) -> str:
    """Return the text after checking that it is a sentence and rows of what, where, found ..."""
    assert "Traceback" not in text
    text = re.sub(r"^\d+:\d\d  .*\n", "", text, flags=re.MULTILINE)  # the stages before it
    what, *rows = text.rstrip("\n").split("\n")
    assert what
    assert not what.startswith(" ")
    assert not what.endswith(".")
    keys = [row[:10].strip() for row in rows]
    order = ["where", "found", "needed", "try"]
    assert keys == [k for k in order if k in keys], text
    assert len(keys) >= 2, text
    assert all(row[10:].strip() for row in rows)
    return text


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        # the file itself
        (SHOEBOX, "shoebox = [3.9, 3.1]", r"too short(?s:.*)room.shoebox\n(?s:.*)3 values"),
        (SOURCE, "position = [1.0, 'a', 1.1]", r"sources.LS1.position\[2\](?s:.*)number"),
        ("position = [2.9, 2.2, 1.3]", "", r"lacks a key(?s:.*)receivers.MP1\n(?s:.*)'position'"),
        # names
        ("[receivers.MP1]", "[sources.LS1]\nposition = [1, 1, 1]\n[receivers.MP1]", "LS1.*twice"),
        ('"MP2"\nfile', '"MP22"\nfile', r"not defined(?s:.*)'MP22'(?s:.*)did you mean 'MP2'"),
        ('"LS1_MP2.wav"', '"LS1_MP1.wav"', r"two pairs have the same(?s:.*)LS1_MP1.wav"),
        ("[materials.carpet]", "[materials.carpit]", r"not have(?s:.*)mean 'carpet'"),
        ("floor = ", "flor = ", r"does not exist(?s:.*)'flor'(?s:.*)mean 'floor'"),
        # numbers
        (
            CARPET,
            f"{CARPET}\nabsorption = [0.1, -0.2]",
            r"carpet.absorption\[2\](?s:.*)-0.2(?s:.*)0 or more",
        ),
        (
            CARPET,
            f"{CARPET}\nabsorption = [0.1, 0.2, 0.3]",
            r"campaign.toml, materials.carpet.absorption(?s:.*)3 values(?s:.*)2 values",
        ),
        ("to_hz = 1000", "to_hz = 4000", r"above half the sampling rate(?s:.*)4000 Hz(?s:.*)to_hz"),
        ("to_hz = 1000", "to_hz = 1000\nseed = 1e30", r"identify.seed"),
        ("[identify]", AIR, r"campaign.toml, air(?s:.*)150"),
        # the room
        (SHOEBOX, f'{SHOEBOX}\nunit = "yard"', r"unknown unit(?s:.*)'yard'(?s:.*)mm"),
        # positions
        (SOURCE, "position = [1.0, 1.2, 11.0]", r"'LS1' stands outside the room(?s:.*)ceiling"),
        (SOURCE, "position = [0.002, 1.2, 1.1]", r"'LS1' stands in a wall(?s:.*)'west'"),
        (SOURCE, "position = [2.9, 2.2, 1.3]", r"'LS1' stands where receiver 'MP1' is"),
        # files
        (FIRST_FILE, 'file = "none.wav"', r"does not exist(?s:.*)none.wav(?s:.*)relative"),
        (FIRST_FILE, f"{FIRST_FILE}\nchannel = 3", r"no such channel(?s:.*)3(?s:.*)channel = 0"),
        (FIRST_FILE, f"{FIRST_FILE}\nlatency_s = 5.0", r"ends before the direct sound"),
    ],
)  # fmt: skip
def test_a_fault_in_the_campaign_is_reported_in_one_message(refusal, tmp_path, old, new, words):
    message = refusal(write_campaign(tmp_path / "campaign", (old, new)))
    assert re.search(words, message), message


def cut(seconds: float) -> np.ndarray:
    return small_responses()["MP1"][: int(seconds * RATE_HZ)]


def sweep() -> np.ndarray:
    """An exponential sweep from 50 Hz to 3 kHz within 0.5 s."""
    share = np.arange(RATE_HZ // 2) / (RATE_HZ // 2)
    return 0.5 * np.sin(2 * np.pi * 50 * 0.5 / np.log(60) * (60.0**share - 1.0))


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no folder that takes no file")
def test_an_output_folder_where_none_can_be_made_is_refused_without_names_of_ours(
    tmp_path, monkeypatch, capsys
):
    campaign = write_campaign(tmp_path / "campaign")
    assert run_command(monkeypatch, "identify", campaign, "--out", "/proc/out") == 2
    message = one_message(capsys.readouterr().err)
    assert "the output folder cannot be made\n  where   /proc/out\n" in message
    assert ".roomfit" not in message and "\n  try " in message


def test_a_response_shorter_than_the_travel_of_its_direct_sound_is_refused(refusal, tmp_path):
    """From one end to the other of a hall of 60 m sound takes 170 ms; the file lasts 100 ms."""
    campaign = write_campaign(
        tmp_path / "campaign",
        (SHOEBOX, "shoebox = [60.0, 20.0, 10.0]"),
        ("position = [2.9, 2.2, 1.3]", "position = [59.0, 2.2, 1.3]"),
    )
    write_wav(tmp_path / "campaign" / "LS1_MP1.wav", cut(0.1))
    message = refusal(campaign)
    assert "ends before the direct sound arrives" in message
    assert "100.0 ms after emission" in message
    assert "168.6 ms" in message


@pytest.mark.slow
def test_as_a_program_of_its_own_the_message_is_all_that_is_shown(tmp_path):
    """In a process of its own: no warning of any library stands beside the message."""
    campaign = write_campaign(tmp_path / "campaign")
    write_wav(tmp_path / "campaign" / "LS1_MP1.wav", np.zeros(4000))
    done = subprocess.run(
        [sys.executable, "-m", "roomfit", "identify", campaign, "--out", tmp_path / "out"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert "silent" in one_message(done.stderr)
    assert not (tmp_path / "out").exists()


def test_all_files_that_are_missing_are_reported_at_once_before_one_is_read(refusal, tmp_path):
    campaign = write_campaign(
        tmp_path / "campaign",
        (FIRST_FILE, 'file = "none.wav"'),
        (SOURCE, f'{SOURCE}\ndirectivity = "/dev/zero"'),
        (SHOEBOX, OBJ),
        (MATERIALS, ""),
    )
    (tmp_path / "campaign" / "LS1_MP2.wav").write_bytes(b"")
    message = refusal(campaign)
    for part in ("4 files", "room.obj does not", "none.wav does", "MP2.wav is empty", "a device"):
        assert part in message


def test_a_file_that_changes_between_two_readings_is_refused(tmp_path):
    from roomfit.base.door import files_read, read_bytes, reading_noted

    file = tmp_path / "a.wav"
    with reading_noted():
        for content in (b"one", b"one", b"two"):
            file.write_bytes(content)
            if content == b"two":
                with pytest.raises(InputError, match="changed while it was in use"):
                    read_bytes(file, "response file")
            else:
                assert read_bytes(file, "response file") == content
        assert files_read() == {file: hashlib.sha256(b"one").hexdigest()}
    assert files_read() == {}
