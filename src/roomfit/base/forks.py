"""Work that runs beside this process, in copies of it.

Fits hold Python's lock for most of their time, so threads would wait for each other, and what they
read is too large to be handed to another process. A forked copy sees all of it as it is at that
moment, shares its memory, and sends back what its function returns. How many there are at once is
the number of threads of compiled kernels; the values are the same for any.
"""

from __future__ import annotations

import ctypes
import gc
import io
import logging
import os
import pickle
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from functools import partial
from multiprocessing import parent_process
from typing import Any, NoReturn, TypeVar

import numba

from roomfit.base.typing import Progress

T = TypeVar("T")
Item = TypeVar("Item")
_LOG = logging.getLogger("roomfit")

# Threads of ours that only wait, draw or listen: they hold nothing that a copy would wait for.
QUIET_THREADS = ("progress", "requests")
# A pipe holds 64 kB: numbers of items of four bytes, and some room.
_MOST_ITEMS = 10_000
_PR_SET_PDEATHSIG = 1

# How many predictions were made since `counted_evaluations` was entered; in a context of its own,
# because fits are made in trials, rounds, profiles and samples of many functions, and a count that
# passes through the signatures of all of them forgets some. Copies send theirs back.
_MADE: ContextVar[list[int]] = ContextVar("evaluations")


@contextmanager
def counted_evaluations() -> Iterator[list[int]]:
    """Give a list whose only entry counts the evaluations of data terms made within the block."""
    made = [0]
    token = _MADE.set(made)
    try:
        yield made
    finally:
        _MADE.reset(token)


def count_evaluation(n: int = 1) -> None:
    """Count one evaluation of one kind of data of a band, or n, where anyone counts."""
    made = _MADE.get(None)
    if made is not None:
        made[0] += n


def at_once() -> int:
    """Return how many processes work together, this one included.

    As many as compiled kernels may have threads; 1 where a fork is not safe: on systems other than
    Linux, and beside threads of others, whose locks a copy would find closed for ever.
    """
    others = {t.name for t in threading.enumerate() if t is not threading.current_thread()}
    is_safe = sys.platform == "linux" and others.issubset(QUIET_THREADS)
    return numba.get_num_threads() if is_safe else 1


def in_this_process(progress: Progress | None) -> Progress | None:
    """Return a progress function that copies of this process may call in vain."""
    if progress is None:
        return None
    here, report = os.getpid(), progress
    return lambda fraction: report(fraction) if os.getpid() == here else None


def in_forks(function: Callable[[Item], T], items: Sequence[Item]) -> list[T]:
    """Return what a function makes of every item, in their order, some of them in copies.

    Whoever is free takes the next item, so the longest should come first. Of errors, that of the
    first item is raised. Nothing of the copies is left, however this ends.

    `function`: of one item; what it changes beside its result is lost in copies. `items`: up to
    10,000; more are done one after the other.

    Examples
    --------
    >>> in_forks(lambda x: x * x, [3, 4])
    [9, 16]
    """
    n = min(at_once(), len(items))
    if n < 2 or len(items) > _MOST_ITEMS:
        return [function(item) for item in items]
    before, home = numba.get_num_threads(), os.getpid()
    # a pipe of the numbers of items, four bytes each: every reader takes the next one
    numbers, sending = os.pipe()
    os.write(sending, b"".join(i.to_bytes(4, "little") for i in range(len(items))))
    os.close(sending)
    share = partial(_share, function, items, numbers, home)
    with ExitStack() as stack:
        stack.callback(numba.set_num_threads, before)
        stack.callback(os.close, numbers)
        numba.set_num_threads(n)  # of which each copy takes one
        others = [stack.enter_context(beside(share)) for _ in range(n - 1)]
        found = share()
        for other in others:
            found |= other()
    for i in sorted(found):
        if (error := found[i][1]) is not None:
            raise error
    # what a copy had taken that was ended from outside
    return [found[i][0] if i in found else function(item) for i, item in enumerate(items)]


def _share(
    function: Callable[[Item], T], items: Sequence[Item], numbers: int, home: int
) -> dict[int, tuple[Any, Exception | None]]:
    """Return values, or errors, of the items that this process could take, by their number."""
    found: dict[int, tuple[Any, Exception | None]] = {}
    while token := os.read(numbers, 4):
        i = int.from_bytes(token, "little")
        try:
            found[i] = function(items[i]), None
        except Exception as error:
            if isinstance(error.__cause__, KeyboardInterrupt):  # it fell into a compiled kernel
                raise
            found[i] = None, error if os.getpid() == home else _with_its_place(error)
            while os.read(numbers, 4):  # nobody begins another
                pass
    return found


def _with_its_place(error: Exception) -> Exception:
    """Return an error that says where it was raised: its traceback does not leave a process."""
    error.add_note(f"in a process beside:\n{traceback.format_exc()}")
    return error


@contextmanager
def beside(function: Callable[[], T]) -> Iterator[Callable[[], T]]:
    """Let a function run beside the block; give a function that waits for its result.

    Where there is one process only, it runs when it is asked for. An error of it is raised there as
    well. A copy that was ended from outside is replaced by this process. When the block is left,
    nothing of the copy is left.
    """
    n, found = at_once(), list[T]()
    pid, receiving, sending = 0, -1, -1
    if n > 1:
        numba.set_num_threads(n - 1)
        receiving, sending = os.pipe()
        home = os.getpid()
        with interrupts_deferred(), warnings.catch_warnings():
            # threads of compiled kernels, which wait, and which no copy needs
            warnings.simplefilter("ignore", DeprecationWarning)
            with suppress(OSError):  # where no memory or no process is left, this one does it
                pid = os.fork()
                if pid == 0:
                    _send(function, sending, home)
        os.close(sending)

    def result() -> T:
        nonlocal pid
        if not found and pid > 0:
            with os.fdopen(os.dup(receiving), "rb") as pipe:
                content = pipe.read()
            _, status = os.waitpid(pid, 0)
            pid = 0
            numba.set_num_threads(n)  # the copy's core is free again
            if status == 0:
                made, value, error = pickle.loads(content)
                count_evaluation(made)
                if error is not None:
                    raise error
                found.append(value)
            else:
                _LOG.warning(
                    "a process that fitted beside this one was ended from outside; "
                    "its part is done again"
                )
        if not found:
            found.append(function())
        return found[0]

    try:
        yield result
    finally:
        if n > 1:
            numba.set_num_threads(n)
            if pid > 0:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
            os.close(receiving)


@contextmanager
def interrupts_deferred() -> Iterator[None]:
    """Hold interrupts until the block ends; processes that start within it never get any.

    Control-C reaches the whole group, also workers that still load and would print a traceback.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end_with_parent(parent: int | None = None) -> None:
    """End this process when the one that has started it is gone, whatever it is doing then.

    `parent` is the number of that one, where it is known: it may be gone already. On Linux the
    system sees to it. Elsewhere a thread watches, which a call that lets no other thread run keeps
    waiting.
    """
    parent = os.getppid() if parent is None else parent
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it was gone before
            os._exit(1)
    elif (starter := parent_process()) is not None:

        def watch() -> None:
            starter.join()
            os._exit(1)

        threading.Thread(target=watch, daemon=True).start()


def _send(function: Callable[[], object], sending: int, home: int) -> NoReturn:
    """Call a function in a copy, send count, value and error, and end."""
    status = 1
    try:
        for number in (signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        end_with_parent(home)
        gc.freeze()  # what the parent has let go of is not for a copy to close
        logging.disable()
        sys.stdout = sys.stderr = io.StringIO()
        numba.set_num_threads(1)
        value, error = None, None
        with counted_evaluations() as made:
            try:
                value = function()
            except Exception as own:  # noqa: BLE001 -- raised in the parent
                error = _with_its_place(own)
        content = pickle.dumps((made[0], value, error), pickle.HIGHEST_PROTOCOL)
        with os.fdopen(sending, "wb") as pipe:
            pipe.write(content)
        status = 0
    finally:
        os._exit(status)
