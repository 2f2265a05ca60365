"""Output folders: at every moment the old result is there or the new one, and strangers' files."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import pytest

from roomfit.base.errors import InputError, StoreError
from roomfit.base.whole_files import sole_writer, whole_output_folder
from roomfit.files.results import check_disk_room
from small_campaign import run_command

# processes of these tests import their helpers, too
_PATHS = [str(Path(__file__).parent), str(Path(__file__).parent / "helpers")]
ENVIRONMENT = {
    **os.environ,
    "PYTHONPATH": os.pathsep.join([*_PATHS, os.environ.get("PYTHONPATH", "")]),
    "PYTHONDONTWRITEBYTECODE": "1",
}
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="signals and locks of POSIX")
FULL = pytest.mark.skipif(not Path("/dev/full").exists(), reason="no full device")
OLD = {"result.json": "old", "decay_1.png": "old", "decay_2.png": "old", "inner/table.csv": "old"}
NEW = {"result.json": "new", "decay_1.png": "new", "inner/table.csv": "new", "more.csv": "new"}
FOREIGN = {"decay_1_notes.png": "mine", "inner/notes.txt": "mine", "own/notes.txt": "mine"}


def fill(folder: Path, content: dict[str, str]) -> None:
    for name, text in content.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


def content_of(folder: Path) -> dict[str, str]:
    files = (p for p in folder.rglob("*") if p.is_file() and p.name != ".roomfit-files")
    return {p.relative_to(folder).as_posix(): p.read_text() for p in files}


def write(out: Path, content: dict[str, str]) -> None:
    """Write a result as a command does."""

    @sole_writer
    def command(out: Path) -> None:
        with whole_output_folder(out, overwrite=True) as folder:
            fill(folder, content)

    command(out)


PROGRAM = """
import os, signal, sys
from pathlib import Path
from test_output_folders import NEW, write

STEPS = ("open", "os.", "shutil.", "tempfile.", "ctypes.call_function", "ctypes.dlsym", "fcntl.")

def kill_at(step):
    left = step

    def watch(event, arguments):
        nonlocal left
        if event.startswith(STEPS):
            left -= 1
            if left == 0:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(watch)

for line in sys.stdin:
    step, out = line.split(maxsplit=1)
    child = os.fork()  # a hook cannot be taken away again
    if child == 0:
        kill_at(int(step))
        write(Path(out.strip()), NEW)
        sys.exit()
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


@pytest.mark.slow
@POSIX
@pytest.mark.parametrize("before", [OLD, {}], ids=["over a result", "new"])
def test_killed_at_any_step_the_old_result_is_there_or_the_new_one(tmp_path, before):
    """A process of its own is killed before its n-th touch of the disk, for every n."""
    found, ended = [], -signal.SIGKILL
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM],
        env=ENVIRONMENT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as parent:  # fmt: skip
        for step in range(1, 400):
            out = tmp_path / str(step) / "out"
            if before:
                write(out, before)
                fill(out, FOREIGN)
            else:
                out.parent.mkdir()
            parent.stdin.write(f"{step} {out}\n")
            parent.stdin.flush()
            ended = int(parent.stdout.readline())
            content = content_of(out)
            foreign = FOREIGN if before else {}
            assert content in (before | foreign, NEW | foreign), (step, content)
            found.append(content.get("result.json"))
            # the next run finds what is left, and removes it
            write(out, NEW)
            assert content_of(out) == NEW | foreign
            assert [p.name for p in out.parent.iterdir()] == ["out"]
            if ended != -signal.SIGKILL:
                break
    assert ended == 0
    assert len(found) > 10 and "new" in found[:-1] and found[0] == before.get("result.json")


def test_only_what_the_earlier_result_names_is_removed(tmp_path):
    write(tmp_path / "out", OLD)
    fill(tmp_path / "out", FOREIGN)
    write(tmp_path / "out", NEW)
    assert content_of(tmp_path / "out") == NEW | FOREIGN


def test_a_folder_without_a_list_loses_nothing(tmp_path):
    """As an earlier version, or somebody else, has written it."""
    fill(tmp_path / "out", {**OLD, **FOREIGN})
    write(tmp_path / "out", NEW)
    assert content_of(tmp_path / "out") == {**OLD, **FOREIGN, **NEW}


def test_the_current_folder_keeps_strangers_files(tmp_path, monkeypatch):
    out = tmp_path / "out"
    write(out, OLD)
    fill(out, FOREIGN)
    monkeypatch.chdir(out)
    write(Path(), NEW)
    assert content_of(out) == NEW | FOREIGN
    assert Path.cwd().samefile(out)


def test_what_a_killed_run_has_moved_away_is_put_back(tmp_path):
    """Killed between the two renames of a disk that exchanges nothing."""
    fill(tmp_path / ".out.old-abcdefgh", OLD)
    seen = []

    @sole_writer
    def command(out: Path) -> None:
        seen.append(content_of(out))

    command(tmp_path / "out")
    assert seen == [OLD]


def test_a_folder_in_the_place_of_a_new_file_is_not_lost(tmp_path):
    fill(tmp_path / "out", {"result.json/notes.txt": "mine"})
    with pytest.raises(StoreError, match="in the place of a file"):
        write(tmp_path / "out", NEW)
    assert content_of(tmp_path / "out") == {"result.json/notes.txt": "mine"}


def test_an_error_while_overwriting_removes_nothing(tmp_path):
    write(tmp_path / "out", OLD)
    with pytest.raises(RuntimeError), whole_output_folder(tmp_path / "out", overwrite=True):
        raise RuntimeError
    assert content_of(tmp_path / "out") == OLD
    with pytest.raises(InputError, match="not empty"), whole_output_folder(tmp_path / "out"):
        pass


@POSIX
def test_a_second_run_into_the_same_folder_is_refused_until_the_first_ends(tmp_path):
    """However the first ends: here it is killed."""
    program = (
        "import sys, time; from pathlib import Path\n"
        "from roomfit.base.whole_files import sole_writer\n"
        "@sole_writer\ndef command(out):\n    print('in', flush=True); time.sleep(600)\n"
        "command(Path(sys.argv[1]))"
    )
    first = subprocess.Popen(
        [sys.executable, "-c", program, str(tmp_path / "out")], stdout=subprocess.PIPE
    )
    assert first.stdout is not None and first.stdout.readline() == b"in\n"
    with pytest.raises(InputError, match="another run is writing"):
        write(tmp_path / "out", NEW)
    write(tmp_path / "other", NEW)
    first.kill()
    first.wait()
    first.stdout.close()
    write(tmp_path / "out", NEW)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["other", "out"]


def command(body: str, *arguments: object) -> subprocess.Popen:
    """Start a command line whose one command has this body."""
    program = (
        "import sys, time, roomfit.cli as cli; from pathlib import Path\n"
        "from roomfit.base.whole_files import whole_output_folder\n"
        f"def run():\n    {body}\n"
        "sys.modules['roomfit.cli.x'] = type('M', (), {'run': staticmethod(run)})\n"
        "cli._parsed = lambda _: cli.argparse.Namespace(call=('cli.x.run', '', ''))\n"
        "cli.main([])"
    )
    whole = [sys.executable, "-c", program, *map(str, arguments)]
    return subprocess.Popen(whole, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


@POSIX
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_request_to_end_leaves_nothing(tmp_path, number):
    run = command(
        "with whole_output_folder(Path(sys.argv[1])) as folder:\n"
        "        (folder / 'half').write_text('x'); print('in', flush=True); time.sleep(600)",
        tmp_path / "out",
    )
    assert run.stdout is not None and run.stdout.readline() == b"in\n"
    time.sleep(0.1)
    run.send_signal(number)
    _, said = run.communicate()
    assert run.returncode == 128 + number
    assert b"nothing half-written" in said
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@POSIX
def test_an_interrupt_that_falls_into_a_destructor_is_not_lost():
    """Python prints it as ignored and goes on; the command line asks again."""
    run = command(
        "class Slow:\n        def __del__(self):\n"
        "            print('in', flush=True); time.sleep(600)\n"
        "    Slow()\n    time.sleep(600)"
    )
    assert run.stdout is not None and run.stdout.readline() == b"in\n"
    run.send_signal(signal.SIGINT)
    _, said = run.communicate()
    assert run.returncode == 130
    assert said == b"interrupted; nothing half-written was left behind\n"


@pytest.mark.slow
@POSIX
@pytest.mark.parametrize("made", ["raise ValueError", "raise SystemError", "pass"])
def test_an_interrupt_that_a_library_makes_something_else_of_is_one(made):
    """As what draws does in its callbacks; and one that it swallows ends with the same code."""
    run = command(
        "try:\n        print('in', flush=True); time.sleep(600)\n"
        f"    except BaseException:\n        {made}"
    )
    assert run.stdout is not None and run.stdout.readline() == b"in\n"
    run.send_signal(signal.SIGINT)
    _, said = run.communicate()
    assert (run.returncode, said) == (130, b"interrupted; nothing half-written was left behind\n")


@POSIX
def test_an_interrupt_within_exec_ends_with_the_same_code():
    """Dataclasses are made by exec, and Python ends by a signal after an interrupt in one."""
    run = command("exec('raise KeyboardInterrupt')")
    _, said = run.communicate()
    assert run.returncode == 130
    assert said.startswith(b"interrupted")


@POSIX
def test_an_export_does_not_replace_what_is_no_file(tmp_path, monkeypatch, capsys):
    table = tmp_path / "absorption.csv"
    head = "material,band_hz,absorption,lower95,upper95,identifiable"
    table.write_text(f"{head}\ncarpet,500,0.3,0.25,0.36,true\n")
    os.mkfifo(tmp_path / "pipe")
    for more in ([], ["--overwrite"]):
        wanted = ["export", table, "--format", "isimpa", "--out", tmp_path / "pipe", *more]
        assert run_command(monkeypatch, *wanted) == 2
        assert "something else is in its place" in capsys.readouterr().err
    assert (tmp_path / "pipe").is_fifo()


@FULL
def test_output_to_a_full_device_is_reported(tmp_path):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "roomfit", "catalogue", "carpet"],
            stdout=full,
            stderr=subprocess.PIPE,
            check=False,
        )
    assert done.returncode == 2
    assert done.stderr.startswith(b"the disk is full") and b"Traceback" not in done.stderr


class Disk(NamedTuple):
    total: int
    free: int


def with_free(monkeypatch, disk: Disk) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _path: disk)


def test_the_room_that_a_result_needs_grows_with_pairs_and_results(tmp_path, monkeypatch):
    """To the byte on either side; a disk that tells nothing, or fails to, is not refused."""
    needed = 3 * 1_500_000 + 10 * 200_000
    with_free(monkeypatch, Disk(10**12, needed))
    check_disk_room(tmp_path / "new" / "out", 10, 3)
    with_free(monkeypatch, Disk(10**12, needed - 1))
    with pytest.raises(StoreError, match=r"(?s)6\.5 MB free.*about 6\.5 MB"):
        check_disk_room(tmp_path / "new" / "out", 10, 3)
    with_free(monkeypatch, Disk(0, 0))
    check_disk_room(tmp_path, 10)

    def fails(_path: object) -> Disk:
        raise OSError(38, "not implemented")

    monkeypatch.setattr(shutil, "disk_usage", fails)
    check_disk_room(tmp_path, 10)
