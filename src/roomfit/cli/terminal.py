"""Answers on standard output, the progress of long jobs on standard error."""

from __future__ import annotations

import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_EVERY_S = 0.5


def say(text: object) -> None:
    """Write a paragraph of an answer to standard output."""
    sys.stdout.write(f"{text}\n")


@contextmanager
def progress_line(description: str) -> Iterator[Callable[[float], None]]:
    """Give a function that takes the fraction done; nothing is drawn without a terminal."""
    if not sys.stderr.isatty():
        yield lambda _fraction: None
        return
    begin = time.monotonic()
    done = 0.0
    ended = threading.Event()

    def update(fraction: float) -> None:
        nonlocal done
        done = min(max(fraction, 0.0), 1.0)

    def draw() -> None:
        # by a thread, so that the clock moves during a long step, too
        while not ended.wait(_EVERY_S):
            minutes, seconds = divmod(int(time.monotonic() - begin), 60)
            line = f"{100 * done:3.0f} %  {minutes}:{seconds:02d}  {description}"
            width = shutil.get_terminal_size().columns - 1
            sys.stderr.write(f"\r{line[:width]:<{width}}")
            sys.stderr.flush()
        sys.stderr.write(f"\r{'':{shutil.get_terminal_size().columns - 1}}\r")
        sys.stderr.flush()

    drawing = threading.Thread(target=draw, daemon=True)
    drawing.start()
    try:
        yield update
    finally:
        ended.set()
        drawing.join()
