"""The progress of a long job: stage, share, remaining time; in one line, or in many.

Stages are messages of the logger ``roomfit`` (INFO; details are DEBUG), the share comes from the
functions that take ``progress``. Nothing is shown unless a job runs within `shown_progress`.
"""

from __future__ import annotations

import logging
import shutil
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # it needs numpy, which `roomfit --help` must not wait for
    from roomfit.base.typing import Progress

_EVERY_S = 0.5
# Before, a pace is that of what came first; and stages differ in theirs.
_LEAST_S, _LEAST_SHARE, _STEADY = 10.0, 0.05, 1.5


def remaining_s(reports: Sequence[tuple[float, float]], now_s: float) -> float | None:
    """Return how long a job is going to take from now on, or None where its pace does not say.

    The pace must be known from 10 s and 5 % of the job, and that since half of the time must be
    that of the whole time within a factor of 1.5.

    `reports` say when which fraction was done, in s since the job began; rising.

    Examples
    --------
    >>> remaining_s([(10.0 * i, 0.1 * i) for i in range(1, 6)], 50.0)
    50.0
    >>> remaining_s([(1.0, 0.5), (50.0, 0.55)], 50.0) is None
    True
    """
    done = reports[-1][1] if reports else 0.0
    if now_s < _LEAST_S or not _LEAST_SHARE <= done < 1.0:
        return None
    early = [report for report in reports if report[0] <= now_s / 2.0]
    before_s, before = early[-1] if early else (0.0, 0.0)
    pace, recent = done / now_s, (done - before) / (now_s - before_s)
    steady = 1.0 / _STEADY <= recent / pace <= _STEADY
    return round((1.0 - done) / recent, 6) if steady else None


def _in_words(seconds: float) -> str:
    if seconds < 60.0:
        return f"about {max(round(seconds, -1), 10.0):.0f} s left"
    if seconds < 5400.0:
        return f"about {seconds / 60.0:.0f} min left"
    return f"about {seconds / 3600.0:.1f} h left"


class _Stages(logging.Handler):
    """The state of a job, from what it logs and reports."""

    def __init__(self, description: str, *, lines: bool) -> None:
        super().__init__()
        self.description, self.lines, self.stage = description, lines, ""
        self.began, self.wrote_s = time.monotonic(), 0.0
        self.reports: list[tuple[float, float]] = [(0.0, 0.0)]

    def seconds(self) -> float:
        return time.monotonic() - self.began

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a stage; write it, and any detail, where no line is drawn again and again."""
        # names come from files, and could steer the terminal
        text = "".join(c if c.isprintable() else "?" for c in record.getMessage())
        if record.levelno == logging.INFO:
            self.stage = text
        if self.lines or record.levelno != logging.INFO:
            cleared = "" if self.lines else f"\r{'':{_width()}}\r"
            self.write(f"{cleared}{_clock(self.seconds())}  {text}\n")

    def write(self, text: str) -> None:
        """Write a text; one that nobody reads stops no job."""
        self.wrote_s = self.seconds()
        with suppress(OSError, ValueError):
            sys.stderr.write(text)
            sys.stderr.flush()

    def report(self, fraction: float) -> None:
        """Keep how much is done; in a log write it where no stage was written for a while."""
        if fraction > self.reports[-1][1]:
            self.reports.append((self.seconds(), min(fraction, 1.0)))
            if self.lines and self.seconds() - self.wrote_s >= _LEAST_S:
                self.write(f"{self.text()}\n")

    def text(self) -> str:
        now_s, done = self.seconds(), self.reports[-1][1]
        left_s = remaining_s(self.reports, now_s)
        left = "" if left_s is None else f", {_in_words(left_s)}"
        stage = f": {self.stage}" if self.stage else ""
        return f"{100 * done:3.0f} %  {_clock(now_s)}  {self.description}{stage}{left}"

    def draw(self, ended: threading.Event) -> None:
        """Draw again and again, by a thread, so that the clock moves during a long step, too."""
        while not ended.wait(_EVERY_S):
            self.write(f"\r{self.text()[: _width()]:<{_width()}}")
        self.write(f"\r{'':{_width()}}\r")


def _clock(seconds: float) -> str:
    minutes, rest = divmod(int(seconds), 60)
    return f"{minutes}:{rest:02d}"


def _width() -> int:
    return shutil.get_terminal_size().columns - 1


@contextmanager
def shown_progress(description: str) -> Iterator[Progress]:
    """Show the progress of the jobs within, and give the function that they report it to.

    On a terminal and in a notebook, one line on standard error that is drawn again and again;
    elsewhere a line of text for each stage, and of the share that is done where a stage is long.
    The level of the logger ``roomfit`` says how much: INFO where it is not set, DEBUG for details,
    above INFO nothing.

    Examples
    --------
    >>> with shown_progress("identifying") as progress:
    ...     progress(0.5)
    """
    logger = logging.getLogger("roomfit")
    before = logger.level
    if before == logging.NOTSET:
        logger.setLevel(logging.INFO)
    if not logger.isEnabledFor(logging.INFO):
        yield lambda _fraction: None
        return
    # a cell of a notebook: an IPython that has a kernel, not one on a terminal
    shell = sys.modules.get("IPython")
    cell = shell.get_ipython() if shell is not None else None
    notebook = getattr(cell, "kernel", None) is not None
    stages = _Stages(description, lines=not (notebook or sys.stderr.isatty()))
    ended = threading.Event()
    drawing = threading.Thread(target=stages.draw, args=(ended,), name="progress", daemon=True)
    if not stages.lines:
        drawing.start()
    logger.addHandler(stages)
    try:
        yield stages.report
    finally:
        logger.removeHandler(stages)
        logger.setLevel(before)
        ended.set()
        if not stages.lines:
            drawing.join()
