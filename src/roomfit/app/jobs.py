"""A project and its work in processes of their own: answers at once, and a queue for the long.

Files come from strangers: one may take memory or time, or end its process, and the page stays. The
process takes a line of JSON and answers in lines, through a descriptor of their own, so that
nothing that prints can disturb them.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import queue
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from roomfit.base.errors import InputError, RoomfitError
from roomfit.cli.terminal import warn

_SECRET = re.compile("TOKEN|SECRET|PASSW|KEY|CREDENTIAL|AUTH", re.IGNORECASE)
_LONGEST_ANSWER = 2**27  # bytes of one line
_GRACE_S = 1.0  # in which a process that is to end may clean up
READING_MIB, READING_S = 4096, 120.0
"""Address space and time of a worker that reads what somebody has sent."""
_MOST_LISTED = 50
_STAGES = {
    "identify": ((0.0, "reading the files"), (1e-6, "tracing and fitting"), (0.95, "drawing")),
    "demo": ((0.0, "simulating"),),
    "treat": ((0.0, "tracing"), (0.8, "searching")),
    "listen": ((0.0, "tracing"), (0.6, "scaling")),
}  # by task, from which fraction on, and its name


class Worker:
    """A process that carries out one task after another, and is started again when it has died."""

    def __init__(self, most_mib: int = 0) -> None:
        self._most_mib = most_mib
        self._process: asyncio.subprocess.Process | None = None
        self._turn = asyncio.Lock()

    async def ask(
        self,
        task: str,
        folder: Path,
        arguments: dict[str, Any],
        *,
        limit_s: float | None = None,
        progress: Callable[[float], None] = lambda _: None,
    ) -> Any:
        """Return the answer of a task of `roomfit.app.tasks` about a project."""
        request = json.dumps({"task": task, "folder": str(folder), "arguments": arguments})
        async with self._turn:
            try:
                return await asyncio.wait_for(self._answer(request, progress), limit_s)
            except TimeoutError:
                await self.stop()
                what, found = "this took too long and was stopped", f"more than {limit_s:g} s"
                needed, hint = f"at most {limit_s:g} s", "send a smaller file, or use roomfit check"
                raise InputError(what, found=found, needed=needed, hint=hint) from None
            except asyncio.CancelledError:
                await self.stop()
                raise

    async def _answer(self, request: str, progress: Callable[[float], None]) -> Any:
        process = await self.started()
        try:
            if process.stdin is None or process.stdout is None:
                raise BrokenPipeError
            process.stdin.write(f"{request}\n".encode())
            await process.stdin.drain()
            while line := await process.stdout.readline():
                said = json.loads(line)
                if "progress" in said:
                    progress(said["progress"])
                if "error" in said:
                    raise InputError(said["error"])
                if "answer" in said:
                    return said["answer"]
        except (BrokenPipeError, ConnectionResetError, ValueError):
            pass
        await self.stop()
        what = "the process that did this has ended"
        found = "its end: it ran out of memory, or a library failed on the file"
        hint = "take the file out again; nothing else is lost"
        raise InputError(what, found=found, needed="an answer", hint=hint)

    async def started(self) -> asyncio.subprocess.Process:
        """Return the process, a new one where there is none."""
        if self._process is None or self._process.returncode is not None:
            # nothing that opens other doors for what reads strangers' files
            environment = {k: v for k, v in os.environ.items() if not _SECRET.search(k)}
            if threads := os.environ.get("ROOMFIT_THREADS"):
                environment["NUMBA_NUM_THREADS"] = str(min(int(threads), os.cpu_count() or 1))
            self._process = await asyncio.create_subprocess_exec(
                sys.executable,
                "-Pm",  # a folder of the user's that is called as a package is none
                "roomfit.app.jobs",
                str(self._most_mib),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                limit=_LONGEST_ANSWER,
                start_new_session=True,
                env=environment,
            )
        return self._process

    async def initialise(self) -> None:
        """Wait until a process has imported all that its tasks need, or failed to."""
        with contextlib.suppress(InputError):
            await self.ask("ready", Path(), {}, limit_s=READING_S)

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


@dataclass(slots=True, eq=False)
class Job:
    """One piece of long work."""

    label: str
    task: str
    arguments: dict[str, Any]
    state: Literal["waiting", "running", "done", "failed", "cancelled"] = "waiting"
    fraction: float = 0.0
    began_s: float = 0.0
    error: str = ""

    def text(self) -> str:
        """Return what is done, how far it is and how long it will take, in words."""
        if self.state != "running":
            return f"{self.label}: {self.state}"
        stages = reversed(_STAGES.get(self.task, ()))
        stage = next((name for start, name in stages if self.fraction >= start), "starting")
        seconds = time.monotonic() - self.began_s
        text = f"{self.label}: {stage}, {100 * self.fraction:.0f} %, {seconds:.0f} s"
        if self.fraction < 0.03:  # nothing to go by yet
            return text
        return f"{text}, about {seconds * (1.0 - self.fraction) / self.fraction:.0f} s to go"


@dataclass(slots=True)
class Bench:
    """One project, the processes that work for it, and its long work, one piece at a time."""

    folder: Path
    reader: Worker = field(default_factory=lambda: Worker(READING_MIB))
    what_if: Worker = field(default_factory=Worker)  # has a room ready for changes
    jobs: list[Job] = field(default_factory=list)
    _running: asyncio.Task[None] | None = None
    _next: Worker | None = None  # for the next piece, its imports done
    _preparing: asyncio.Task[None] | None = None  # None: nothing is prepared

    async def ask(self, task: str, **arguments: Any) -> Any:
        """Return the answer of a task that takes seconds at most."""
        return await self.reader.ask(task, self.folder, arguments, limit_s=READING_S)

    def stamp(self, names: Iterable[str]) -> tuple[int, ...]:
        """Return what changes whenever one of these files or folders does, whoever changes it."""
        paths = [self.folder / name for name in names]
        return tuple(p.stat().st_mtime_ns if p.exists() else 0 for p in paths)

    async def start(self) -> None:
        """Start what reads, and then, while somebody looks and types, what the first work needs."""
        await self.reader.initialise()
        self._prepare()

    def add(self, label: str, task: str, **arguments: Any) -> Job:
        """Put a task of `roomfit.app.tasks` into the queue, unless it waits there already."""
        for job in self.jobs:
            at_work = job.state in ("waiting", "running")
            if at_work and (job.task, job.arguments) == (task, arguments):
                return job
        job = Job(label, task, arguments)
        self.jobs.append(job)
        del self.jobs[:-_MOST_LISTED]
        self._go_on()
        return job

    def _go_on(self) -> None:
        if self._running is None or self._running.done():
            waiting = next((j for j in self.jobs if j.state == "waiting"), None)
            if waiting is not None:
                self._running = asyncio.create_task(self._carry_out(waiting))
            elif self._preparing is not None:
                self._prepare()

    def _prepare(self) -> None:
        """Start the process of the next piece, whose imports take longer than much of the work."""
        if self._next is None:
            self._next = Worker()
            self._preparing = asyncio.create_task(self._next.initialise())

    async def _carry_out(self, job: Job) -> None:
        # a process for each: what it took of memory is free again
        worker, self._next = self._next or Worker(), None
        job.state, job.began_s = "running", time.monotonic()

        def note(fraction: float) -> None:
            job.fraction = max(job.fraction, fraction)

        try:
            await worker.ask(job.task, self.folder, job.arguments, progress=note)
            job.state = "done"
        except InputError as error:
            job.state, job.error = "failed", str(error)
        except asyncio.CancelledError:
            job.state = "cancelled"
        finally:
            await worker.stop()
            asyncio.get_running_loop().call_soon(self._go_on)

    async def cancel(self, job: Job) -> None:
        """Take a job out of the queue, or end it within two seconds; forget one that failed."""
        if job.state == "running" and self._running is not None:
            self._running.cancel()
            await asyncio.wait([self._running], timeout=5.0)
        elif job.state in ("waiting", "failed"):
            job.state = "cancelled"

    async def stop(self) -> None:
        """End all work and all processes."""
        self._preparing = None
        for state in ("waiting", "running"):
            for job in [j for j in self.jobs if j.state == state]:
                await self.cancel(job)
        for worker in (self._next, self.reader, self.what_if):
            if worker is not None:
                await worker.stop()


def serve_folder(folder: Path, *, host: str, port: int | None, no_browser: bool) -> None:
    """Show a project in the browser until somebody interrupts, as ``roomfit app`` does."""
    if host not in ("127.0.0.1", "localhost", "::1"):
        warn(
            f"warning: {host} can be reached from other machines. Whoever has the address with its "
            "key reads and changes this project, and can have this machine compute; what is sent "
            "is not encrypted."
        )

    async def served() -> None:
        bench = Bench(folder.resolve())
        await bench.reader.started()  # imports its libraries while the page does
        try:
            from roomfit.app.server import serve  # which needs packages of the extra ``app``

            await serve(bench, host=host, port=port, open_browser=not no_browser)
        finally:
            await bench.stop()

    asyncio.run(served())


def main() -> None:
    """Carry out tasks ``{"task", "folder", "arguments"}`` until standard input ends."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    most_bytes = int(sys.argv[1]) * 2**20
    if most_bytes:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (most_bytes, most_bytes))
    requests: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(requests,), name="requests", daemon=True).start()

    from roomfit.app.tasks import carry_out  # after the limit, which the import needs not much of
    from roomfit.base.forks import end_with_parent

    end_with_parent()  # the thread that listens has no turn while compiled code runs

    def send(**content: Any) -> None:
        answers.write(json.dumps(content, allow_nan=False) + "\n")
        answers.flush()

    send(ready=True)
    while True:
        request = requests.get()
        try:
            send(answer=carry_out(lambda part: send(progress=part), **request))
        except RoomfitError as error:
            send(error=str(error))
        except MemoryError:
            send(error="this needs more memory than it may have")
        except Exception as error:  # noqa: BLE001 -- the page must hear of it, and goes on
            sys.excepthook(type(error), error, error.__traceback__)
            send(error=f"a fault of roomfit: {type(error).__name__}: {error}"[:500])


def _listen(requests: queue.SimpleQueue[dict[str, Any]]) -> None:
    """Take requests; when the page has gone, end at once with all own processes."""
    for line in sys.stdin:
        requests.put(json.loads(line))
    os.killpg(os.getpgid(0), signal.SIGKILL)


if __name__ == "__main__":
    main()
