"""A project and its work in processes of their own: answers at once, and a queue for the long."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from roomfit.base.errors import InputError

_LONGEST_ANSWER = 2**27  # bytes of one line
_GRACE_S = 1.0  # in which a process that is to end may clean up
READING_MIB, READING_S = 4096, 120.0
"""Address space and time of a worker that reads what somebody has sent."""


class Worker:
    """A process that carries out one task after another, and is started again when it has died."""

    def __init__(self, most_mib: int = 0) -> None:
        self._most_mib = most_mib
        self._process: asyncio.subprocess.Process | None = None
        self._turn = asyncio.Lock()
        self.starts = 0

    async def ask(
        self,
        task: str,
        arguments: dict[str, Any],
        *,
        limit_s: float | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> Any:
        """Return the answer of a task of `roomfit.app.views.TASKS`."""
        async with self._turn:
            try:
                return await asyncio.wait_for(self._answer(task, arguments, progress), limit_s)
            except TimeoutError:
                await self.stop()
                raise InputError(
                    "this took too long and was stopped",
                    found=f"more than {limit_s:g} s",
                    needed=f"at most {limit_s:g} s",
                    hint="send a smaller file, or give it to roomfit check",
                ) from None
            except asyncio.CancelledError:
                await self.stop()
                raise

    async def _answer(
        self, task: str, arguments: dict[str, Any], progress: Callable[[float], None] | None
    ) -> Any:
        process = await self.started()
        request = json.dumps({"task": task, "arguments": arguments})
        try:
            if process.stdin is None or process.stdout is None:
                raise BrokenPipeError
            process.stdin.write(f"{request}\n".encode())
            await process.stdin.drain()
            while line := await process.stdout.readline():
                said = json.loads(line)
                if "progress" in said and progress is not None:
                    progress(said["progress"])
                if "error" in said:
                    raise InputError(said["error"])
                if "answer" in said:
                    return said["answer"]
        except (BrokenPipeError, ConnectionResetError, ValueError):
            pass
        await self.stop()
        raise InputError(
            "the process that did this has ended",
            found="its end: it ran out of memory, or a library failed on the file",
            needed="an answer",
            hint="take the file out again; nothing else is lost",
        )

    async def started(self) -> asyncio.subprocess.Process:
        """Return the process, a new one where there is none."""
        if self._process is None or self._process.returncode is not None:
            self.starts += 1
            self._process = await asyncio.create_subprocess_exec(
                sys.executable,
                "-Pm",  # a folder of the user's that is called as a package is none
                "roomfit.app.worker",
                str(self._most_mib),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                limit=_LONGEST_ANSWER,
                start_new_session=True,
                # no name of this machine's shell or its keys for what reads strangers' files
                env={k: v for k, v in os.environ.items() if "TOKEN" not in k} | _threads(),
            )
        return self._process

    async def initialise(self) -> None:
        """Wait until a process has imported all that its tasks need, or failed to."""
        with contextlib.suppress(InputError):
            await self.ask("echo", {"text": ""}, limit_s=READING_S)

    async def stop(self) -> None:
        """End the process and all that it has started, within a second."""
        process, self._process = self._process, None
        if process is None:
            return
        for number in (signal.SIGTERM, signal.SIGKILL):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, number)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(process.wait(), _GRACE_S)
        with contextlib.suppress(ProcessLookupError):  # what it left behind
            os.killpg(process.pid, signal.SIGKILL)
        if process.stdin is not None:
            process.stdin.close()
            with contextlib.suppress(OSError):
                await process.stdin.wait_closed()


def _threads() -> dict[str, str]:
    """Return what lets a process have as many threads as the environment says, if it does."""
    said = os.environ.get("ROOMFIT_THREADS")
    return {"NUMBA_NUM_THREADS": str(min(int(said), os.cpu_count() or 1))} if said else {}


State = Literal["waiting", "running", "done", "failed", "cancelled"]


@dataclass(slots=True)
class Job:
    """One piece of long work."""

    number: int
    label: str
    task: str
    arguments: dict[str, Any]
    state: State = "waiting"
    fraction: float = 0.0
    began_s: float = 0.0
    ended_s: float = 0.0
    error: str = ""
    answer: Any = None
    stages: tuple[tuple[float, str], ...] = ()  # from which fraction on, and its name

    @property
    def stage(self) -> str:
        """What is being done."""
        return next((n for f, n in reversed(self.stages) if self.fraction >= f), "starting")

    @property
    def seconds(self) -> float:
        """How long it has been at work."""
        if self.state == "waiting":
            return 0.0
        return (self.ended_s or time.monotonic()) - self.began_s

    @property
    def remaining_s(self) -> float | None:
        """How long it will take, as far as it has gone; None while that is not known."""
        if self.state != "running" or self.fraction < 0.03:
            return None
        return self.seconds * (1.0 - self.fraction) / self.fraction


@dataclass(slots=True)
class Jobs:
    """Long work, one piece at a time, in the order in which it was asked for."""

    listed: list[Job] = field(default_factory=list)
    _running: asyncio.Task[None] | None = None
    _ready: Worker | None = None  # for the next piece, its imports done
    _preparing: asyncio.Task[None] | None = None  # None: nothing is prepared
    _numbers: itertools.count[int] = field(default_factory=lambda: itertools.count(1))

    def add(
        self,
        label: str,
        task: str,
        arguments: dict[str, Any],
        stages: tuple[tuple[float, str], ...] = (),
    ) -> Job:
        """Put a task of `roomfit.app.views.TASKS` into the queue, unless it waits there already."""
        for job in self.listed:
            if job.state in ("waiting", "running") and (job.task, job.arguments) == (
                task,
                arguments,
            ):
                return job
        job = Job(next(self._numbers), label, task, arguments, stages=stages)
        self.listed.append(job)
        del self.listed[:-50]
        self._go_on()
        return job

    def _go_on(self) -> None:
        if self._running is None or self._running.done():
            waiting = next((j for j in self.listed if j.state == "waiting"), None)
            if waiting is not None:
                self._running = asyncio.create_task(self._carry_out(waiting))
            elif self._preparing is not None:
                self.prepare()

    def prepare(self) -> None:
        """Start the process of the next piece, whose imports take longer than much of the work.

        From now on another is started whenever all work is done.
        """
        if self._ready is None:
            self._ready = Worker()
            self._preparing = asyncio.create_task(self._ready.initialise())

    async def _carry_out(self, job: Job) -> None:
        # a process for each: what it took of memory is free again
        worker, self._ready = self._ready or Worker(), None
        job.state, job.began_s = "running", time.monotonic()

        def note(fraction: float) -> None:
            job.fraction = max(job.fraction, fraction)

        try:
            job.answer = await worker.ask(job.task, job.arguments, progress=note)
            job.state, job.fraction = "done", 1.0
        except InputError as error:
            job.state, job.error = "failed", str(error)
        except asyncio.CancelledError:
            job.state = "cancelled"
        finally:
            job.ended_s = time.monotonic()
            await worker.stop()
            asyncio.get_running_loop().call_soon(self._go_on)

    async def cancel(self, job: Job) -> None:
        """Take a job out of the queue, or end it within two seconds."""
        if job.state == "waiting":
            job.state = "cancelled"
        elif job.state == "running" and self._running is not None:
            self._running.cancel()
            await asyncio.wait([self._running], timeout=5.0)

    async def stop(self) -> None:
        """End all work."""
        for job in [j for j in self.listed if j.state == "waiting"]:
            await self.cancel(job)
        self._preparing = None
        for job in [j for j in self.listed if j.state == "running"]:
            await self.cancel(job)
        if self._ready is not None:
            await self._ready.stop()


@dataclass(slots=True)
class Bench:
    """One project and the processes that work for it."""

    folder: Path
    reader: Worker = field(default_factory=lambda: Worker(READING_MIB))
    what_if: Worker = field(default_factory=Worker)
    jobs: Jobs = field(default_factory=Jobs)

    async def ask(self, task: str, **arguments: Any) -> Any:
        """Return the answer of a task about the folder that takes seconds at most."""
        own = {"folder": str(self.folder), **arguments}
        return await self.reader.ask(task, own, limit_s=READING_S)

    def stamp(self, names: Iterable[str]) -> tuple[int, ...]:
        """Return what changes whenever one of these files or folders does, whoever changes it."""
        paths = [self.folder / name for name in names]
        return tuple(p.stat().st_mtime_ns if p.exists() else 0 for p in paths)

    async def start(self) -> None:
        """Start what reads, and then, while somebody looks and types, what the first work needs."""
        await self.reader.initialise()
        self.jobs.prepare()

    async def stop(self) -> None:
        """End all processes."""
        await self.jobs.stop()
        await self.reader.stop()
        await self.what_if.stop()
