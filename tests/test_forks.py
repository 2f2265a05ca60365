"""Copies of this process do what it would have done itself, and leave nothing behind."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numba
import pytest

from roomfit.base.errors import InputError
from roomfit.base.forks import (
    at_once,
    beside,
    count_evaluation,
    counted_evaluations,
    in_forks,
    in_this_process,
)
from roomfit.base.kernels import at_most_threads, each_in_threads
from roomfit.cli import main

HERE = os.getpid()

pytestmark = pytest.mark.skipif(
    sys.platform != "linux" or numba.config.NUMBA_NUM_THREADS < 2,
    reason="copies are made on Linux, where there are two threads or more",
)


def slow_square(x: int) -> tuple[int, int]:
    """Return a square and who has made it."""
    time.sleep(0.05)
    return x * x, os.getpid()


def test_items_keep_their_order_and_two_processes_share_them() -> None:
    found = in_forks(slow_square, range(7))
    assert [x for x, _ in found] == [x * x for x in range(7)]
    assert len({pid for _, pid in found}) == 2


def test_each_copy_has_one_thread_and_makes_no_copies_of_its_own() -> None:
    assert in_forks(lambda _: (time.sleep(0.05), at_once())[1], range(4)) == [1] * 4


def failing(x: int) -> int:
    """Fail for 1 and 2, as a door of the house does."""
    time.sleep(0.05)
    if x in (1, 2):
        raise InputError(f"item {x}", where="there", found="this", needed="that", hint="another")
    return x


def test_the_first_error_arrives_as_it_would_in_sequence() -> None:
    for _ in range(3):  # whichever process takes it
        with pytest.raises(InputError) as error:
            in_forks(failing, range(6))
        expected = InputError("item 1", where="there", found="this", needed="that", hint="another")
        assert str(error.value) == str(expected)
        assert vars(error.value).items() >= vars(expected).items()


def test_an_error_of_a_copy_says_where_it_was_raised() -> None:
    with pytest.raises(ZeroDivisionError) as error, beside(lambda: 1 // 0) as never:
        never()
    assert "in <lambda>" in error.value.__notes__[0]

    def only_in_a_copy(x: int) -> None:
        time.sleep(0.05)
        if os.getpid() != HERE:
            raise ValueError(x)

    with pytest.raises(ValueError, match=r"\d") as error:
        in_forks(only_in_a_copy, range(4))
    assert "in only_in_a_copy" in error.value.__notes__[0]


def test_what_a_killed_copy_had_taken_is_done_again_with_a_warning(caplog) -> None:
    def dies(x: int) -> int:
        time.sleep(0.05)
        if os.getpid() != HERE:
            os.kill(os.getpid(), signal.SIGKILL)
        return -x

    with caplog.at_level(logging.WARNING, logger="roomfit"):
        assert in_forks(dies, range(5)) == [0, -1, -2, -3, -4]
        with beside(lambda: dies(3)) as one:
            assert one() == -3
    assert [r.getMessage().count("ended from outside") for r in caplog.records] == [1, 1]


def test_evaluations_of_copies_are_counted() -> None:
    def count(n: int) -> None:
        time.sleep(0.02)
        count_evaluation(n)

    with counted_evaluations() as made:
        in_forks(count, range(6))
        with beside(lambda: count(100)) as last:
            last()
    assert made == [115]


def test_copies_report_no_progress_and_write_nothing(capfd) -> None:
    reports: list[float] = []
    progress = in_this_process(reports.append)
    assert progress is not None and in_this_process(None) is None

    def loud(x: int) -> int:
        time.sleep(0.05)
        progress(x)
        if os.getpid() != HERE:
            sys.stdout.write("noise")
            logging.getLogger("roomfit").error("noise")
        return os.getpid()

    own = [x for x, pid in enumerate(in_forks(loud, range(4))) if pid == HERE]
    assert reports == own
    assert capfd.readouterr() == ("", "")


def test_a_block_that_is_left_ends_the_copy() -> None:
    began = time.perf_counter()
    with pytest.raises(KeyError), beside(lambda: time.sleep(60.0)):
        raise KeyError
    assert time.perf_counter() - began < 2.0
    with beside(lambda: 7) as soon:
        assert numba.get_num_threads() == 1  # the other is the copy's
        assert soon() == 7 and soon() == 7


_WAITING = """
import os, sys, time
import numba
from roomfit.base.forks import in_forks
numba.set_num_threads(2)
def wait(x):
    os.write(1, b"%d\\n" % os.getpid())
    time.sleep(60.0)
in_forks(wait, range(4))
"""


@pytest.mark.parametrize("number", (signal.SIGINT, signal.SIGKILL))
def test_an_interrupt_or_a_death_ends_all_within_two_seconds(number: int) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", _WAITING],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    assert process.stdout is not None
    pids: set[int] = set()
    while len(pids) < 2:
        pids.add(int(process.stdout.readline()))
    began = time.perf_counter()
    os.kill(process.pid, number)
    process.wait(10.0)
    (copy,) = pids - {process.pid}
    while Path(f"/proc/{copy}/stat").exists() and state(copy) != "Z":
        assert time.perf_counter() - began < 2.0
        time.sleep(0.01)
    process.stdout.close()


def state(pid: int) -> str:
    """Return the state of a process in one letter."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return "Z"


@pytest.mark.parametrize("said", ("", "2", "64", "none", "0", "1.5"))
def test_the_environment_says_how_many_threads_and_no_more_than_there_are(
    said: str, monkeypatch, capsys
) -> None:
    monkeypatch.setenv("ROOMFIT_THREADS", said)
    most = numba.config.NUMBA_NUM_THREADS
    if said in ("none", "0", "1.5"):
        with pytest.raises(InputError, match="no whole number from 1 up"), at_most_threads():
            pass
        with pytest.raises(SystemExit) as left:
            main(["identify", "campaign.toml", "--out", "x"])
        assert left.value.code == 2 and "ROOMFIT_THREADS" in capsys.readouterr().err
        return
    with at_most_threads():
        assert numba.get_num_threads() == min(int(said or 2), most)
    with at_most_threads(1):  # an argument is nearer
        assert numba.get_num_threads() == 1


def test_threads_over_observations_give_their_order_and_have_one_each() -> None:
    def square(i: int) -> tuple[int, int, int]:
        time.sleep(0.01)
        return i * i, numba.get_num_threads(), threading.get_ident()

    found = each_in_threads(square, 6)
    assert [x for x, _, _ in found] == [i * i for i in range(6)]
    assert {n for _, n, _ in found} == {1} and len({t for _, _, t in found}) == 2
    alone = each_in_threads(square, 6, worth_it=False)
    assert {t for _, _, t in alone} == {threading.get_ident()}
