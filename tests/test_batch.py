"""Many rooms: one table, nothing done twice, nothing stopped by another's failure."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from roomfit import batch
from roomfit.batch import (
    campaign_paths,
    identify_rooms,
    room_row,
    room_tasks,
    rooms_text,
    shard_of,
)
from roomfit.cli import main
from roomfit.errors import FolderInUseError, InputError, StoreError

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
    assert float(rows[1]["T_measured_s"]) == 0.4
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
def test_what_is_done_is_not_done_again_unless_something_changed(
    rooms: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    first = identify_rooms(rooms, out)
    done: list[Path] = []
    real = batch.identify_to_folder

    def watched(campaign: Path, folder: Path, **settings: object) -> object:
        done.append(campaign)
        return real(campaign, folder, **settings)  # type: ignore[arg-type]

    monkeypatch.setattr(batch, "identify_to_folder", watched)
    assert rooms_text(identify_rooms(rooms, out)) == rooms_text(first)
    assert done == []
    (rooms[1].parent / "measured.csv").write_text("source,receiver,parameter,1000\nS,R,T30,0.5\n")
    again = identify_rooms(rooms, out)
    assert done == [rooms[1]]
    assert again[1].decay_s[0] == 0.5


@pytest.mark.slow
def test_a_fault_of_the_program_in_one_room_is_a_row_of_the_table_and_tried_again(
    rooms: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = batch.identify_to_folder

    def faulty(campaign: Path, folder: Path, **settings: object) -> object:
        if campaign == rooms[0]:
            raise ZeroDivisionError("on purpose")
        return real(campaign, folder, **settings)  # type: ignore[arg-type]

    with monkeypatch.context() as patch:
        patch.setattr(batch, "identify_to_folder", faulty)
        rows = identify_rooms(rooms, tmp_path / "out")
    assert [r.status for r in rows] == ["failed", "done"]
    assert "ZeroDivisionError: on purpose" in rows[0].message
    assert [r.status for r in identify_rooms(rooms, tmp_path / "out")] == ["done", "done"]
    assert list((tmp_path / "out" / "failures").iterdir()) == []


@pytest.mark.parametrize("content", ["[]", "{", '{"status": "failed"}', "7"])
def test_a_damaged_record_of_a_failure_is_a_row_that_says_so(
    rooms: list[Path], tmp_path: Path, content: str
) -> None:
    out = tmp_path / "out"
    task = room_tasks(rooms[:1])[0]
    (out / "failures").mkdir(parents=True)
    (out / "failures" / f"{task.address}.json").write_text(content)
    row = room_row(out, task)
    assert row.status == "failed" and "record of a failure" in row.message


@pytest.mark.slow
def test_shards_together_do_every_room_once(rooms: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert [r.status for r in identify_rooms(rooms, out, shard=(2, 2))] == ["waiting", "done"]
    assert [r.status for r in identify_rooms(rooms, out, shard=(1, 2))] == ["done", "done"]
    tasks = room_tasks(rooms * 1)
    parts = [shard_of(tasks, (i, 3)) for i in (1, 2, 3)]
    assert sorted(t.name for part in parts for t in part) == ["a", "b"]
    for wrong in ((0, 3), (4, 3)):
        with pytest.raises(InputError, match="shard is out of range"):
            shard_of(tasks, wrong)


def test_a_pattern_that_matches_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no campaign file is called so"):
        campaign_paths([tmp_path / "*.toml"])


def test_rooms_of_one_folder_are_called_by_their_files(tmp_path: Path) -> None:
    first = write_room(tmp_path / "house")
    second = first.with_name("renovated.toml")
    second.write_text(ROOM)
    assert [t.name for t in room_tasks([first, second])] == ["campaign", "renovated"]


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


def test_rooms_are_called_by_what_differs_between_their_paths(tmp_path: Path) -> None:
    """By folders where all files have one name, else by files; a lone one by its own."""
    paths = [tmp_path / p for p in ("h/a/campaign.toml", "h/b/c/campaign.toml", "h/d.toml")]
    assert [t.name for t in room_tasks(paths[:2])] == ["a", "b/c"]
    assert [t.name for t in room_tasks(paths)] == ["a/campaign", "b/c/campaign", "d"]
    assert [t.name for t in room_tasks(paths[:1])] == ["campaign"]
    assert room_tasks([]) == ()
    assert all(not t.address and "campaign" in t.refusal for t in room_tasks(paths[:1]))


def test_a_job_ends_as_what_it_returns_or_raises_says() -> None:
    def raises(error: Exception) -> Callable[[], str]:
        def job() -> str:
            raise error

        return job

    assert batch._end(lambda: "") == ("done", "")
    assert batch._end(lambda: "why") == ("refused", "why")
    assert batch._end(raises(FolderInUseError("x")))[0] == "elsewhere"
    bad = InputError("what", found="a", needed="b", hint="c")
    assert batch._end(raises(bad)) == ("failed", str(bad))
    assert batch._end(raises(KeyError("x"))) == ("failed", "KeyError: 'x'")
    with pytest.raises(StoreError):
        batch._end(raises(StoreError("disk full")))
    jobs = [lambda: "", lambda: "why"]
    assert list(batch._ends(jobs, None)) == [(0, "done", ""), (1, "refused", "why")]


def test_a_row_says_why_a_room_has_no_answer_and_forgets_it_when_it_has_one(tmp_path: Path) -> None:
    out, task = tmp_path / "out", batch.RoomTask("a", tmp_path / "a.toml", "address")
    (out / "failures").mkdir(parents=True)
    assert (room_row(out, task).status, room_row(out, task).message) == ("waiting", "")
    for status in ("refused", "failed"):
        batch._note(out, task, status, "why")
        row = room_row(out, task)
        assert (row.name, row.status, row.message) == ("a", status, "why")
    batch._note(out, task, "elsewhere", "another")
    assert room_row(out, task).message == "why"
    batch._note(out, task, "done", "")
    assert room_row(out, task).status == "waiting"
    unread = batch.RoomTask("b", tmp_path / "b.toml", "", "cannot be read")
    assert (room_row(out, unread).status, room_row(out, unread).message) == (
        "refused", "cannot be read",
    )  # fmt: skip
    (out / "rooms" / "address").mkdir(parents=True)
    row = room_row(out, task)
    assert (
        row.status == "failed" and f"remove the folder {out / 'rooms' / 'address'}" in row.message
    )


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


def test_the_decay_of_a_room_is_the_mean_of_t20_of_fitted_pairs_or_of_the_next_that_is_known() -> (
    None
):
    """Where both were known, in the bands of the middle."""

    def pair(use: str, **rows: tuple[list[float | None], list[float | None]]) -> dict[str, object]:
        own = {k: {"measured": m, "predicted": p} for k, (m, p) in rows.items()}
        return {"use": use, "parameters": own}

    middle = np.array([False, True, True])
    t20 = pair("fit", T20_s=([9.0, 1.0, None], [9.0, 1.5, 8.0]), T30_s=([7.0] * 3, [7.0] * 3))
    other = pair("fit", T20_s=([9.0, 2.0, 4.0], [9.0, None, 4.5]))
    kept = pair("validate", T20_s=([6.0] * 3, [6.0] * 3))
    assert batch._decay_s([t20, other, kept], middle) == (2.5, 3.0)
    edt = pair(
        "fit", T20_s=([1.0, None, None], [1.0] * 3), EDT_s=([9.0, 1.0, 3.0], [9.0, 2.0, 4.0])
    )
    assert batch._decay_s([edt], middle) == (2.0, 3.0)
    assert np.isnan(batch._decay_s([kept], middle)).all()


def test_campaigns_are_found_by_patterns_each_once_and_in_order(tmp_path: Path) -> None:
    paths = [tmp_path / n for n in ("b.toml", "a.toml", "c[1].toml")]
    for path in paths:
        path.write_text("")
    given = [paths[0], str(tmp_path / "*.toml"), paths[2]]
    assert campaign_paths(given) == (paths[0], paths[1], paths[2])
    # what is there is no pattern, whatever letters it has
    assert campaign_paths([paths[2]]) == (paths[2],)
    assert campaign_paths([tmp_path / "none.toml"]) == (tmp_path / "none.toml",)


def test_a_row_of_an_answer_has_the_means_of_500_and_1000_hz_or_of_all_bands_where_neither_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def mean(hz: float, value: float) -> dict[str, object]:
        own = {"absorption": value, "lower95": value - 0.1, "upper95": value + 0.2}
        return {"kind": "mean", "band_hz": hz, **own}

    content: dict[str, object] = {
        "bands_hz": [500, 1000, 2000],
        "materials": {"a": {"identifiable": [True, False, 1]}, "b": {"identifiable": [True] * 3}},
        # of a band stated twice the first counts
        "combinations": [mean(500, 0.2), mean(1000, 0.4), mean(2000, 0.9), mean(500, 0.7),
                         {"kind": "sum", "band_hz": 1000, "absorption": 0.8}],
        "findings": [{"code": c, "severity": s} for c, s in
                     (("x", "warning"), ("y", "info"), ("z", "serious"), ("x", "warning"))],
        "pairs": [],
        "fit": {"phi": [1.5, None, 2.5], "seconds": 7},
    }  # fmt: skip
    monkeypatch.setattr(batch, "read_result_content", lambda _path: (content, None))
    row = batch._answered("a", Path("folder"), "rooms/a")
    assert (row.name, row.status, row.folder) == ("a", "done", "rooms/a")
    assert (row.identifiable, row.values, row.findings) == (5, 6, ("x", "z"))
    np.testing.assert_allclose(row.mean, [0.3, 0.2, 0.5])
    assert (row.chi2_reduced, row.seconds) == (2.5, 7.0)
    content["bands_hz"] = [2000, 4000]
    np.testing.assert_allclose(batch._answered("a", Path("f"), "r").mean, [0.9, 0.8, 1.1])
    content["bands_hz"], content["fit"] = [4000], {"phi": [None], "seconds": 7}
    row = batch._answered("a", Path("f"), "r")
    assert np.isnan(row.mean).all() and np.isnan(row.chi2_reduced)


def test_rows_are_written_with_their_reports_and_counted_by_how_they_ended() -> None:
    done = batch.RoomRow(
        "a", "done", "rooms/a b", identifiable=3, values=4, mean=(0.2, 0.1, 0.3),
        decay_s=(1.25, 1.5), chi2_reduced=1.1, findings=("x", "y"), seconds=2.0,
    )  # fmt: skip
    failed = batch.RoomRow("b", "failed", message="one\n  two")
    assert batch.counted([done, failed, done]) == "3 rooms: 2 done, 1 failed."
    numbers = (3, 4, 0.2, 0.1, 0.3, 1.25, 1.5, 1.1)
    assert batch._record(done) == ("a", "done", "rooms/a b/report.html", *numbers, "x y", 2.0, "")
    assert batch._record(failed)[2] == "" and batch._record(failed)[-1] == "one two"
    text = rooms_text([done, failed])
    (line,) = (x for x in text.splitlines() if x.startswith("a "))
    assert " ".join(line.split()) == "a done 3 of 4 0.20 (0.10 to 0.30) 1.25 s (1.50 s)"
    assert "2 rooms: 1 done, 1 failed." in text
    name, status, share, mean, measured, predicted, chi2, findings = batch._page_row(done)
    assert (name, share, measured, predicted, chi2) == ("a", "3 of 4", 1.25, 1.5, 1.1)
    assert status.link == "rooms/a%20b/report.html" and findings.small == ("x", "y")
    assert (mean.text, mean.small) == ("0.20", ("0.10 to 0.30",))
    _, status, share, mean, *_ = batch._page_row(failed)
    assert status.small == ("one", "  two") and status.link == "" and share == ""
    assert mean.small == ()
