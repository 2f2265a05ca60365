"""A campaign that two processes change keeps what both have written."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from roomfit.app import project
from roomfit.base.errors import FolderInUseError, InputError
from roomfit.base.findings import Edit
from roomfit.base.whole_files import (
    write_bytes_atomically,
    write_json_atomically,
    write_text_atomically,
)
from roomfit.files import edits
from roomfit.files.edits import sole_editor

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="locks of POSIX")


@pytest.fixture
def box(tmp_path: Path) -> Path:
    project.set_room(tmp_path, shoebox=(6.0, 5.0, 3.0))
    return tmp_path


def started(program: str, *arguments: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", program, *map(str, arguments)],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        stdout=subprocess.PIPE,
        text=True,
    )


def hidden(folder: Path) -> list[str]:
    return [p.name for p in folder.iterdir() if p.name.startswith(".")]


_WRITER = """
import sys
from pathlib import Path
from roomfit.app import project
folder, who = Path(sys.argv[1]), sys.argv[2]
print("ready", flush=True)
while not (folder / "go").exists():
    pass
for n in range(8):
    project.name_measured(folder, f"S{who}", f"{who}{n}")
    project.set_position(folder, "receivers", f"{who}{n}", (n, 1, 1))
"""


@pytest.mark.slow
def test_two_processes_that_write_many_times_lose_nothing(box: Path) -> None:
    """New keys of their own, and rows of one list, which are numbered by what is there."""
    both = [started(_WRITER, box, who) for who in "ab"]
    assert [one.stdout.readline() for one in both if one.stdout] == ["ready\n"] * 2
    (box / "go").touch()
    assert [one.wait(300) for one in both] == [0, 0]
    for one in both:
        assert one.stdout is not None
        one.stdout.close()
    content = project.campaign_content(box)
    wanted = {f"{who}{n}": [n, 1, 1] for who in "ab" for n in range(8)}
    assert {name: table["position"] for name, table in content["receivers"].items()} == wanted
    rows = [(row["source"], row["receiver"], row["file"]) for row in content["measurements"]]
    assert len(rows) == 16
    assert set(rows) == {(f"S{r[0]}", r, f"recordings/S{r[0]}_{r}.wav") for r in wanted}
    assert hidden(box) == []


@POSIX
def test_the_lock_of_a_killed_process_is_free(box: Path) -> None:
    """And that of one which lives is waited for, and then refused."""
    program = (
        "import sys, time; from pathlib import Path; from roomfit.files.edits import sole_editor\n"
        "with sole_editor(Path(sys.argv[1])):\n    print('in', flush=True); time.sleep(600)\n"
    )
    file = project.campaign_file(box)
    other = started(program, file)
    assert other.stdout is not None and other.stdout.readline() == "in\n"
    refused = pytest.raises(FolderInUseError, match=r"another run is writing[^§]*campaign\.toml")
    with refused, sole_editor(file, wait_s=0.1):
        pass
    os.kill(other.pid, signal.SIGKILL)
    other.wait()
    other.stdout.close()
    project.set_bands(box, 250.0, 1000.0)
    assert project.bands(box) == (250.0, 1000.0)
    assert hidden(box) == []


def edit_key(folder: Path) -> None:
    project.set_bands(folder, 250.0, 1000.0)


def name_rows(folder: Path) -> None:
    project.name_recordings(folder, {"S1": (1.0, 1.0, 1.0)})


CHANGES: dict[str, Callable[[Path], None]] = {
    "a key": edit_key,
    "names": name_rows,
    "a room": lambda folder: project.set_room(folder, shoebox=(5.0, 4.0, 3.0)),
    "materials": lambda folder: project.forget_unused_materials(folder, ["walls"]),
    "a measured pair": lambda folder: project.name_measured(folder, "S1", "R1"),
    "decay times": lambda folder: project.set_decay_times(folder, "t.csv"),
}


def while_held(file: Path, text: str, change: Callable[[], object]) -> None:
    """Begin a change while another holds the file, which writes a text before it lets go."""
    taken = threading.Event()

    def other() -> None:
        with sole_editor(file):
            taken.set()
            time.sleep(0.3)
            file.write_text(text)

    thread = threading.Thread(target=other)
    thread.start()
    taken.wait(30)
    try:
        change()
    finally:
        thread.join()


@POSIX
@pytest.mark.parametrize("name", CHANGES)
def test_what_another_writes_is_read_before_it_is_changed(box: Path, name: str) -> None:
    file = project.campaign_file(box)
    (box / "recordings").mkdir()
    (box / "recordings" / "S1_R1.wav").touch()
    before = file.read_text()
    text = edits.edited_text(before, [Edit(("air",), "temperature_c", 17.5)])
    text = edits.edited_text(text, [Edit(("materials", "gone"), "prior", "brick")])
    while_held(file, text, lambda: CHANGES[name](box))
    content = tomllib.loads(file.read_text())
    assert content["air"] == {"temperature_c": 17.5}
    assert file.read_text() != text
    CHANGES[name](box)
    assert tomllib.loads(file.read_text()) == content  # nothing was left to be done


@POSIX
def test_a_remedy_and_a_step_back_are_refused_where_another_has_written(box: Path) -> None:
    file = project.campaign_file(box)
    text = file.read_text() + "# of another\n"
    wanted = edits.preview(file, [Edit(("air",), "temperature_c", 17.5)])
    with pytest.raises(InputError, match="has changed since this was shown"):
        while_held(file, text, lambda: edits.apply(file, wanted))
    assert file.read_text() == text
    edits.apply(file, edits.preview(file, [Edit(("air",), "temperature_c", 17.5)]))
    with pytest.raises(InputError, match="nothing can be undone"):
        while_held(file, text, lambda: edits.undo(file))
    assert file.read_text() == text


def test_a_file_is_replaced_whole_and_nothing_is_left_beside_it(tmp_path):
    target = tmp_path / "a.txt"
    write_text_atomically(target, "old")
    write_bytes_atomically(target, b"new")
    assert target.read_text() == "new"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_who_has_the_old_file_open_or_under_another_name_keeps_it(tmp_path):
    path, other = tmp_path / "a.json", tmp_path / "b.json"
    path.write_bytes(b"old content")
    os.link(path, other)
    with path.open("rb") as reader:
        write_bytes_atomically(path, b"new")
        assert reader.read() == b"old content"
    assert other.read_bytes() == b"old content"
    assert path.read_bytes() == b"new"


def test_content_that_cannot_be_written_leaves_the_old_file(tmp_path):
    target = tmp_path / "a.json"
    write_json_atomically(target, {"x": 1})
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json_atomically(target, {"x": float("nan")})
    assert json.loads(target.read_text())["x"] == 1
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]
