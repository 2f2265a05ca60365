"""Many rooms: one table, nothing done twice, nothing stopped by another's failure."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from roomfit.base.errors import InputError
from roomfit.batch import rooms as batch
from roomfit.batch.rooms import campaign_paths, identify_rooms, room_tasks, shard_of
from roomfit.cli import main

ROOM = """
[room]
shoebox = [6, 5, 3]
materials = { walls = "felt", ceiling = "plaster" }
[sources.S]
position = [1.5, 1.2, 1.5]
[receivers.R]
position = [4.0, 3.5, 1.2]
[identify]
from_hz = 1000
to_hz = 1000
[settings]
n_rays = 2000
[[measurements]]
parameters = "measured.csv"
"""


def write_room(folder: Path, decay_s: float = 0.3) -> Path:
    folder.mkdir(parents=True)
    table = f"source,receiver,parameter,1000\nS,R,T30,{decay_s}\n"
    (folder / "measured.csv").write_text(table)
    path = folder / "campaign.toml"
    path.write_text(ROOM)
    return path


@pytest.fixture
def rooms(tmp_path: Path) -> list[Path]:
    return [write_room(tmp_path / "rooms" / name, t) for name, t in (("a", 0.3), ("b", 0.4))]


def table(out: Path) -> list[dict[str, str]]:
    with (out / "rooms.csv").open(newline="") as stream:
        return list(csv.DictReader(stream))


def results(out: Path) -> dict[str, object]:
    """The answers, without how long they took."""
    found = {}
    for path in sorted((out / "rooms").glob("*/result.json")):
        content = json.loads(path.read_text())
        del content["fit"]["seconds"], content["content_sha256"]
        content["provenance"] = {}
        found[path.parent.name] = content
    return found


def test_a_room_that_fails_stops_no_other_and_the_table_says_why(
    rooms: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (rooms[0].parent / "measured.csv").write_text("source,receiver,parameter,1000\nS,R,T30,-1\n")
    broken = write_room(tmp_path / "rooms" / "c <script>")
    broken.write_text("[room\n")
    with pytest.raises(SystemExit) as ended:
        main(["batch", str(tmp_path / "rooms/*/campaign.toml"), "--out", str(tmp_path / "out")])
    assert ended.value.code == 2
    rows = table(tmp_path / "out")
    assert [(r["room"], r["status"]) for r in rows] == [
        ("a", "refused"),
        ("b", "done"),
        ("c <script>", "refused"),
    ]
    assert "-1" in rows[0]["message"]
    page = (tmp_path / "out" / "rooms.html").read_text()
    assert "<script>" not in page
    link = rows[1]["result"]
    assert f'href="{link}"' in page
    assert (tmp_path / "out" / link).is_file()
    assert rows[1]["decay_time"] == "T30" and float(rows[1]["T_measured_s"]) == 0.4
    assert float(rows[1]["T_predicted_s"]) == pytest.approx(0.4, rel=0.05)
    content = json.loads((tmp_path / "out" / link).with_name("result.json").read_text())
    mean = content["combinations"][0]
    assert float(rows[1]["room_mean_absorption"]) == pytest.approx(mean["absorption"], abs=1e-4)
    assert "3 rooms: 1 done, 2 refused." in capsys.readouterr().out


def test_a_first_answer_is_never_taken_for_a_full_one(rooms: list[Path], tmp_path: Path) -> None:
    """Of the same room in the same folder: both are made, and the table shows the one asked for."""
    out = tmp_path / "out"
    for options, is_quick in ((("--quick",), True), ((), False)):
        main(["batch", str(rooms[0]), "--out", str(out), *options])
        (row,) = table(out)
        assert row["status"] == "done"
        content = json.loads((out / row["result"]).with_name("result.json").read_text())
        codes = [f["code"] for f in content["findings"]]
        assert ("first-answer" in codes) == is_quick
    assert len(list((out / "rooms").iterdir())) == 2


@pytest.mark.slow
def test_shards_together_do_every_room_once(rooms: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert [r.status for r in identify_rooms(rooms, out, shard=(2, 2))] == ["waiting", "done"]
    assert [r.status for r in identify_rooms(rooms, out, shard=(1, 2))] == ["done", "done"]


@pytest.mark.slow
def test_a_cluster_gives_the_same_bits_after_its_client_was_killed(
    rooms: list[Path], tmp_path: Path
) -> None:
    """The first client goes without a word; what its workers do goes on, or is done again."""
    command = [sys.executable, "-m", "roomfit", "batch", *map(str, rooms)]
    there = tmp_path / "there"
    cluster = [*command, "--out", str(there), "--workers", "2"]
    client = subprocess.Popen(cluster, start_new_session=True, stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 300.0
    while not list(there.glob("rooms/*")) and client.poll() is None:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    os.killpg(client.pid, signal.SIGKILL)
    client.wait()
    again = subprocess.run(cluster, capture_output=True, text=True, timeout=600, check=False)
    assert again.returncode == 0, again.stderr
    identify_rooms(rooms, tmp_path / "here")
    assert len(results(there)) == 2
    assert results(there) == results(tmp_path / "here")


@pytest.mark.slow
def test_an_interrupted_batch_leaves_no_lock_and_no_half_of_a_room(
    rooms: list[Path], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-m", "roomfit", "batch", *map(str, rooms), "--out", str(out)]
    run = subprocess.Popen(
        [*command, "--workers", "2"],
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 300.0
    while not list(out.glob("rooms/.*")):
        assert time.monotonic() < deadline and run.poll() is None
        time.sleep(0.01)
    os.killpg(run.pid, signal.SIGINT)
    _, said = run.communicate(timeout=20)
    assert run.returncode == 130 and "Traceback" not in said
    assert not list(out.glob("rooms/.*"))


def test_rooms_are_called_by_what_differs_between_their_paths(tmp_path: Path) -> None:
    """By folders where all files have one name, else by files; a lone one by its own."""
    paths = [tmp_path / p for p in ("h/a/campaign.toml", "h/b/c/campaign.toml", "h/d.toml")]
    assert [t.name for t in room_tasks(paths[:2])] == ["a", "b/c"]
    assert [t.name for t in room_tasks(paths)] == ["a/campaign", "b/c/campaign", "d"]
    assert [t.name for t in room_tasks(paths[:1])] == ["campaign"]
    assert room_tasks([]) == ()
    assert all(not t.address and "campaign" in t.refusal for t in room_tasks(paths[:1]))


def test_a_shard_is_every_nth_room_from_the_ith_on() -> None:
    tasks = [batch.RoomTask(n, Path(n), n) for n in "abcdefg"]
    assert ["".join(t.name for t in shard_of(tasks, (i, 3))) for i in (1, 2, 3)] == [
        "adg",
        "be",
        "cf",
    ]
    assert shard_of(tasks, (1, 1)) == tuple(tasks)
    for wrong in ((0, 3), (4, 3), (1, 0), (-1, 2)):
        with pytest.raises(InputError, match=r"shard is out of range(.|\n)*1 <= i <= n"):
            shard_of(tasks, wrong)


def test_campaigns_are_found_by_patterns_each_once_and_in_order(tmp_path: Path) -> None:
    paths = [tmp_path / n for n in ("b.toml", "a.toml", "c[1].toml")]
    for path in paths:
        path.write_text("")
    given = [paths[0], str(tmp_path / "*.toml"), paths[2]]
    assert campaign_paths(given) == (paths[0], paths[1], paths[2])
    # what is there is no pattern, whatever letters it has
    assert campaign_paths([paths[2]]) == (paths[2],)
    assert campaign_paths([tmp_path / "none.toml"]) == (tmp_path / "none.toml",)
    with pytest.raises(InputError, match="no campaign file is called so"):
        campaign_paths([tmp_path / "*.none"])
