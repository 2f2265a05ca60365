"""Answers on standard output, the progress of long jobs on standard error."""

from __future__ import annotations

import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TextIO

_EVERY_S = 0.5


def say(text: object) -> None:
    """Write a paragraph of an answer to standard output.

    Names come from files: what would steer the terminal, or cannot be written there, becomes "?".
    """
    sys.stdout.write(f"{_writable(printable(str(text)), sys.stdout)}\n")


def warn(text: object) -> None:
    """Write a message to standard error, as `say` writes an answer; on a full disk, nothing."""
    with suppress(OSError):
        sys.stderr.write(f"{_writable(printable(str(text)), sys.stderr)}\n")
        sys.stderr.flush()


def _writable(text: str, stream: TextIO) -> str:
    encoding = stream.encoding or "utf-8"
    return text.encode(encoding, errors="replace").decode(encoding)


def printable(text: str) -> str:
    """Return a text without letters that steer a terminal or cannot be written; ? instead.

    Examples
    --------
    >>> printable("a\\x1b[31mb")
    'a?[31mb'
    """
    return "".join(c if c == "\n" or c.isprintable() else "?" for c in text.expandtabs())


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
