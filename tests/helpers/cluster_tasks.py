"""Tasks for workers in processes of their own: they must be importable there."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np


def number_into(folder: Path, number: int, seconds: float = 0.0) -> int:
    """Write a number's own random numbers, aside first; return the number of the process."""
    time.sleep(seconds)
    text = " ".join(f"{x:.17g}" for x in np.random.default_rng(number).standard_normal(50).cumsum())
    aside = folder / f".{number}-{os.getpid()}"
    aside.write_text(text)
    aside.replace(folder / f"{number}.txt")
    return os.getpid()


def die_once(file: Path) -> None:
    """Kill the first process that calls it."""
    if not file.exists():
        file.write_text("once")
        die()
    file.write_text("once, and done")


def die() -> None:
    """Kill the process at every call."""
    os.kill(os.getpid(), signal.SIGKILL)
