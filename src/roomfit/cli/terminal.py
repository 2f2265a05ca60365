"""Answers on standard output, messages on standard error."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from typing import TextIO


def say(text: object) -> None:
    """Write a paragraph of an answer to standard output.

    Names come from files: what would steer the terminal, or cannot be written there, becomes "?".
    """
    sys.stdout.write(f"{_writable(printable(str(text)), sys.stdout)}\n")


def warn(text: object) -> None:
    """Write a message to standard error, as `say` writes an answer; on a full disk, nothing."""
    try:
        sys.stderr.write(f"{_writable(printable(str(text)), sys.stderr)}\n")
        sys.stderr.flush()
    except OSError:
        with suppress(OSError):  # a stream without a file
            drop_output(sys.stderr)


def drop_output(stream: TextIO) -> None:
    """Let the interpreter flush a stream into nothing at its end: a failure sets the exit code."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


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
