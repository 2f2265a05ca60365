"""One file read by a library of others, in a process of its own that it may end or keep for ever.

Damaged files lead libraries (HDF5, scipy's reader of MAT, IFC, USD, SKP) into endless loops, and to
read and write where they must not. So they run where nothing can be lost: with limits of memory and
time, the file on standard input, and on standard output one line of JSON (what there is, or an
error), and behind it arrays of float64.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np

from roomfit.base.door import limit, too_many_numbers, unpacked_limit_bytes
from roomfit.base.errors import DAMAGE

_LIBRARIES_BYTES = 2**30
_LONGEST_HEAD = 2**26
_PATIENCE = 6.0  # of the clock: a busy machine gives a process a part of its time only
NextArray = Callable[[Any], np.ndarray[Any, Any]]


@contextlib.contextmanager
def isolated(read: str, content: bytes, library: str) -> Iterator[tuple[Any, NextArray]]:
    """Give what a function says of a file, as JSON, and what returns the next array of a shape.

    `read` is "MODULE:FUNCTION"; the function takes the content, the most bytes of numbers and a
    list whose first entry says where it is, and returns JSON and arrays. The process may have been
    led astray, so nothing is taken as is: whatever fails, also within the block, is a ValueError.
    """
    most_bytes = unpacked_limit_bytes(len(content))
    with tempfile.TemporaryFile() as answer:
        _run(read, content, library, most_bytes, answer)
        answer.seek(0)

        def array(wanted: Any) -> np.ndarray[Any, Any]:
            shape = [int(length) for length in wanted]
            size = math.prod(shape)
            if not 0 <= 8 * size <= most_bytes:
                raise ValueError("more numbers than it said")
            return np.frombuffer(answer.read(8 * size), dtype=np.float64).reshape(shape)

        try:
            head = json.loads(answer.readline(_LONGEST_HEAD))
            if "error" in head:
                raise ValueError(str(head["error"]))
            yield head, array
        except (LookupError, TypeError, AttributeError, RecursionError) as error:
            raise ValueError(f"{library} gave no answer ({type(error).__name__})") from error


def _run(read: str, content: bytes, library: str, most_bytes: float, answer: IO[bytes]) -> None:
    seconds = limit("reading_s")
    # the file, its numbers as they lie in it and as float64, and the libraries
    memory_bytes = 2 * len(content) + 3 * most_bytes + _LIBRARIES_BYTES
    arguments = [f"{number:.0f}" for number in (memory_bytes, max(seconds, 1.0), most_bytes)]
    no_end = f"{library} did not come to an end within {seconds:g} s"
    folders = [str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")]
    environment = {"PYTHONPATH": os.pathsep.join(filter(None, folders)), "OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-m", "roomfit.base.isolated", read, *arguments],
            input=content,
            stdout=answer,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **environment, "OPENBLAS_NUM_THREADS": "1"},
            timeout=_PATIENCE * seconds,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise ValueError(no_end) from None
    if done.returncode == -getattr(signal, "SIGXCPU", 0) != 0:
        raise ValueError(no_end)
    if done.returncode != 0:
        raise ValueError(f"{library} failed (exit status {done.returncode})")


def _serve(read: str, memory_bytes: float, seconds: float, most_bytes: float) -> None:
    """Read standard input and write what it holds to standard output: the other process."""
    content = sys.stdin.buffer.read()
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no answer
    _limit_this_process(int(memory_bytes), int(seconds))
    place = ["the file"]
    module, _, function = read.partition(":")
    try:
        head, arrays = getattr(importlib.import_module(module), function)(
            content, most_bytes, place
        )
        if sum(a.nbytes for a in arrays) > most_bytes:
            raise too_many_numbers(most_bytes)
        text = json.dumps(head)
    except DAMAGE as error:
        why = f"{type(error).__name__}: {error}"
        if isinstance(error, MemoryError):
            why = "more memory than a file of its size needs"
        text, arrays = json.dumps({"error": " ".join(f"{place[0]}: {why}".split())[:500]}), []
    out.write(text.encode("ascii") + b"\n")
    for values in arrays:
        out.write(np.ascontiguousarray(values, dtype=np.float64).tobytes())
    out.flush()
    # the library would tidy up, and may fail at that
    os._exit(0)


def _limit_this_process(memory_bytes: int, seconds: int) -> None:
    try:
        import resource
    except ImportError:  # Windows: the parent's clock alone
        return
    for kind, most in (
        (resource.RLIMIT_AS, memory_bytes),
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_FSIZE, memory_bytes),
    ):
        _, hard = resource.getrlimit(kind)
        least = most if hard == resource.RLIM_INFINITY else min(most, hard)
        try:
            resource.setrlimit(kind, (least, hard))
        except (ValueError, OSError):  # macOS has no limit of addresses
            continue


if __name__ == "__main__":
    _serve(sys.argv[1], *(float(a) for a in sys.argv[2:]))
