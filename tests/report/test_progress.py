"""Progress: what is shown, where, and what it says of the time that is left."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from pathlib import Path

import pytest

import roomfit
from roomfit.cli import main
from roomfit.report.progress import remaining_s, shown_progress
from small_campaign import write_campaign

LOG = logging.getLogger("roomfit")


def test_elsewhere_every_stage_is_a_line(capsys):
    with shown_progress("working") as report:
        LOG.info("tracing")
        report(0.5)
        LOG.debug("4 pairs")
        LOG.info("fitting")
    assert capsys.readouterr() == ("", "0:00  tracing\n0:00  fitting\n")
    assert LOG.handlers == []
    assert LOG.level == logging.NOTSET


@pytest.mark.parametrize(
    ("option", "shown", "hidden"),
    [
        ("-q", [], ["tracing"]),
        ("--verbose", ["tracing", "image sources to order"], []),
        (None, ["evaluating the measurements", "tracing", "predicting"], ["image sources to"]),
    ],
)
def test_a_command_shows_as_much_as_is_asked_for(tmp_path, capsys, option, shown, hidden):
    campaign = write_campaign(tmp_path / "campaign", ("to_hz = 1000", "to_hz = 500"))
    own = [option] if option else []
    main(["identify", str(campaign), "--out", str(tmp_path / "out"), "--quick", *own])
    out, err = capsys.readouterr()
    assert "carpet" in out  # the answer in any case
    assert all(text in err for text in shown)
    assert not any(text in err for text in hidden)
    assert bool(err) == (option != "-q")
    assert LOG.level == logging.NOTSET


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no full device")
def test_an_answer_that_nobody_reads_is_written_all_the_same(tmp_path):
    """To a pipe that is closed and to a full device; the exit code tells of both."""
    campaign = write_campaign(tmp_path / "campaign", ("to_hz = 1000", "to_hz = 500"))
    source = Path(roomfit.__file__).parents[1]
    program = (
        f"import sys; sys.path.insert(0, {str(source)!r}); from roomfit.cli import main; main()"
    )
    command = [sys.executable, "-c", program, "identify", campaign, "--quick", "-q"]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [*command, "--out", tmp_path / "full"], stdout=full, stderr=subprocess.PIPE, check=False
        )
    assert done.returncode == 2
    assert done.stderr.startswith(b"the disk is full")
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run([*command, "--out", tmp_path / "pipe"], stdout=write, check=False)
    os.close(write)
    assert done.returncode == 1
    for name in ("full", "pipe"):
        assert (tmp_path / name / "result.json").exists()


def test_remaining_time_of_a_steady_job_is_that_which_is_left():
    reports = [(0.37 * i, 0.01 * i) for i in range(1, 61)]
    assert remaining_s(reports, 22.2) == pytest.approx(0.4 * 37.0, rel=0.05)


@pytest.mark.parametrize(
    ("reports", "now_s"),
    [
        ([], 100.0),
        ([(1.0, 0.2)], 2.0),  # begun just now
        ([(20.0, 0.04)], 20.0),  # too little of it
        ([(1.0, 0.45), (60.0, 0.5)], 60.0),  # a quick stage, then a slow one
        ([(10.0 * i, 0.1 * i) for i in range(1, 6)], 150.0),  # nothing came for long
        ([(10.0 * i, 0.1 * i) for i in range(1, 11)], 100.0),  # done
    ],
)
def test_remaining_time_is_not_shown_where_the_pace_does_not_say(reports, now_s):
    assert remaining_s(reports, now_s) is None
