"""Progress: what is shown, where, and what it says of the time that is left."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

import roomfit
from roomfit.cli import main
from roomfit.report import progress
from roomfit.report.progress import remaining_s, shown_progress
from small_campaign import write_campaign

LOG = logging.getLogger("roomfit")


def wait_for(there) -> None:
    """Until the thread that draws has drawn, however busy the machine."""
    until = time.monotonic() + 60.0
    while not there():
        assert time.monotonic() < until
        time.sleep(0.001)


def on_a_terminal(monkeypatch) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setattr(progress, "_EVERY_S", 0.001)
    monkeypatch.setenv("COLUMNS", "60")


def test_a_terminal_has_one_line_that_is_cleared_at_the_end(monkeypatch, capsys):
    on_a_terminal(monkeypatch)
    with shown_progress("working") as report:
        LOG.info("tracing")
        report(0.5)
        report(0.4)  # never back
        wait_for(lambda: " 50 %" in sys.stderr.getvalue())
    drawn = capsys.readouterr().err.split("\r")
    assert f"{' 50 %  0:00  working: tracing':<59}" in drawn
    assert drawn[-2:] == [" " * 59, ""]


def test_details_stand_above_the_line_and_steer_no_terminal(monkeypatch, capsys):
    on_a_terminal(monkeypatch)
    LOG.setLevel(logging.DEBUG)
    try:
        with shown_progress("working"):
            LOG.debug("a\x1b[31mb")
    finally:
        LOG.setLevel(logging.NOTSET)
    assert "\r0:00  a?[31mb\n" in capsys.readouterr().err


def test_elsewhere_every_stage_is_a_line(capsys):
    with shown_progress("working") as report:
        LOG.info("tracing")
        report(0.5)
        LOG.debug("4 pairs")
        LOG.info("fitting")
    assert capsys.readouterr() == ("", "0:00  tracing\n0:00  fitting\n")
    assert LOG.handlers == []
    assert LOG.level == logging.NOTSET


def test_a_log_says_the_share_of_a_long_stage(monkeypatch, capsys):
    """At most every 10 s, and not where a stage was just written."""
    clock = iter(range(0, 10_000, 4))
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    now = [0.0]
    with shown_progress("identifying impedances") as report:
        for step in range(1, 9):
            now[0] = float(next(clock))
            report(step / 10)
    written = capsys.readouterr().err.splitlines()
    assert written == [
        " 40 %  0:12  identifying impedances, about 20 s left",
        " 70 %  0:24  identifying impedances, about 10 s left",
    ]


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


def test_the_answer_is_printed_before_the_report_is_drawn(tmp_path, monkeypatch, capsys):
    campaign = write_campaign(tmp_path / "campaign", ("to_hz = 1000", "to_hz = 500"))

    def drawn(*_, **__):
        printed.append(capsys.readouterr().out)
        return "page"

    printed: list[str] = []
    monkeypatch.setattr("roomfit.report.html.report_html", drawn)
    main(["identify", str(campaign), "--out", str(tmp_path / "out"), "--quick", "-q"])
    assert len(printed) == 1
    assert "carpet" in printed[0] and "Findings" in printed[0]
    assert capsys.readouterr().out.startswith("\nreport.html, result.json")
    assert (tmp_path / "out" / "report.html").read_text() == "page"


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


def test_quiet_still_shows_errors(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["identify", str(tmp_path / "none.toml"), "--out", str(tmp_path / "o"), "--quiet"])
    assert "does not exist" in capsys.readouterr().err


@pytest.mark.slow
def test_a_library_prints_nothing(tmp_path):
    write_campaign(tmp_path / "campaign", ("to_hz = 1000", "to_hz = 500"))
    program = (
        "from pathlib import Path; from roomfit.commands import identify_to_folder as f; "
        "f(Path('campaign/campaign.toml'), Path('out'), quick=True, progress=lambda _: None)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert (done.stdout, done.stderr) == ("", "")


@pytest.mark.parametrize("with_widgets", [True, False])
def test_a_notebook_has_a_bar_or_without_widgets_a_line(monkeypatch, capsys, with_widgets):
    """The parts of IPython and ipywidgets that are used, as they are documented."""
    shown, bars = [], []

    class FloatProgress:
        def __init__(self, value: float, **_: object) -> None:
            self.value, self.description, self.closed = value, "", False
            bars.append(self)

        def close(self) -> None:
            self.closed = True

    own = ModuleType("IPython")
    own.get_ipython = lambda: SimpleNamespace(kernel=object())
    display = ModuleType("IPython.display")
    display.display = shown.append
    widgets = ModuleType("ipywidgets")
    widgets.FloatProgress, widgets.Layout = FloatProgress, dict
    monkeypatch.setitem(sys.modules, "IPython", own)
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    monkeypatch.setitem(sys.modules, "ipywidgets", widgets if with_widgets else None)
    monkeypatch.setattr(progress, "_EVERY_S", 0.001)
    with shown_progress("working") as report:
        LOG.info("tracing")
        report(0.25)
        if with_widgets:
            wait_for(lambda: bars[0].value == 0.25 and "tracing" in bars[0].description)
        else:
            wait_for(lambda: " 25 %  0:00  working: tracing" in sys.stderr.getvalue())
    assert [b.closed for b in bars] == [True] * with_widgets
    assert shown == bars
    assert (capsys.readouterr().err == "") == with_widgets


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


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(3.0, "10 s"), (44.0, "40 s"), (119.0, "2 min"), (7200.0, "2.0 h")],
)
def test_times_are_round(seconds, words):
    assert progress._in_words(seconds) == f"about {words} left"
