"""Damaged files of every format, each read in a process that is watched from outside.

    python tests/fuzz/fuzz.py --cases 100000
    python tests/fuzz/fuzz.py --cases 5000 --only response.sofa v73.mat --keep /tmp/found

Case k of a seed is the same file on every machine. A case fails that ends in anything but an
answer or a `RoomfitError`, kills its process, takes more than 5 s of processor time or 1 GB of
memory, writes to the terminal, or has an endless message. A worker reads many cases; it is killed
and replaced when it fails.
"""

from __future__ import annotations

import argparse
import json
import os
import select
import subprocess
import sys
import tempfile
import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "helpers")]

from corpus import corpus  # noqa: E402
from examples import examples  # noqa: E402
from mutations import damaged  # noqa: E402

MOST_SECONDS = 5.0
MOST_BYTES = 10**9
LONGEST_MESSAGE = 4000
# of the clock: on a busy machine a process gets little of its time
_PATIENCE_S = 120.0
_CASES_A_WORKER = 5000
_TICKS = os.sysconf("SC_CLK_TCK") if hasattr(os, "sysconf") else 100


def case(seed: int, number: int, names: list[str]) -> tuple[str, bytes]:
    """Return name and content of a case."""
    rng = Random(seed * 1_000_003 + number)
    name = names[number % len(names)]
    return name, damaged(name, examples()[name], rng)


def run(cases: Iterator[tuple[int, str, bytes]], keep: Path | None) -> Counter[tuple[str, str]]:
    """Read every case in a worker, print those that fail; return how many ended how, by name."""
    ends: Counter[tuple[str, str]] = Counter()
    worker: Worker | None = None
    try:
        for number, name, content in cases:
            if worker is None or worker.n_done >= _CASES_A_WORKER:
                if worker is not None:
                    worker.close()
                worker = Worker()
            answer = worker.ask(name, content)
            failed = answer["end"] not in ("read", "refused")
            ends[name, "failed" if failed else str(answer["end"])] += 1
            if not failed:
                continue
            print(f"--- case {number}, {name}: {answer['end']}", flush=True)
            if keep:
                keep.mkdir(parents=True, exist_ok=True)
                (keep / f"{number}--{name}").write_bytes(content)
            if not answer.get("alive"):
                worker.close()
                worker = None
    finally:
        if worker is not None:
            worker.close()
    return ends


class Worker:
    """A process that reads files, and a clock beside it."""

    def __init__(self) -> None:
        self.n_done = 0
        self._folder = tempfile.TemporaryDirectory(prefix="roomfit-fuzz-")
        environment = {**os.environ, "ROOMFIT_LIMITS": "reading_s=3"}
        environment |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
        self._process = subprocess.Popen(
            [sys.executable, str(Path(__file__).resolve()), "--worker", self._folder.name],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
        )
        # the first case of each kind pays for imports: they are warmed up here
        ready = self._answer(600.0)
        if ready is None or ready["end"] != "ready":
            raise RuntimeError(f"the worker did not start: {ready}")

    def ask(self, name: str, content: bytes) -> dict[str, Any]:
        """Return how a file was read."""
        self.n_done += 1
        assert self._process.stdin is not None
        head = json.dumps([name, len(content)]).encode() + b"\n"
        try:
            self._process.stdin.write(head + content)
            self._process.stdin.flush()
        except BrokenPipeError:
            return {"end": "its process has ended"}
        answer = self._answer(_PATIENCE_S)
        if answer is None:
            code = self._process.poll()
            end = f"no end within {MOST_SECONDS:g} s" if code is None else f"exit status {code}"
            return {"end": end}
        if answer["seconds"] > MOST_SECONDS:
            answer["end"] = f"{answer['seconds']:.1f} s"
        if answer["bytes"] > MOST_BYTES:
            # the highest that the process ever took: only a new one can tell again
            return {**answer, "end": f"{answer['bytes'] / 1e9:.2f} GB of memory"}
        return {**answer, "alive": True}

    def _answer(self, patience_s: float) -> dict[str, Any] | None:
        assert self._process.stdout is not None
        begin, used = time.monotonic(), self._seconds()
        while not select.select([self._process.stdout], [], [], 0.5)[0]:
            if self._process.poll() is not None or time.monotonic() - begin > patience_s:
                return None
            if patience_s == _PATIENCE_S and self._seconds() - used > MOST_SECONDS:
                return None
        line = self._process.stdout.readline()
        return dict(json.loads(line)) if line else None

    def _seconds(self) -> float:
        """Return the processor time of the worker so far, where the system tells."""
        try:
            fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return 0.0
        return sum(int(ticks) for ticks in fields[11:13]) / _TICKS

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                try:
                    stream.close()
                except BrokenPipeError:
                    continue
        self._folder.cleanup()


def readers(folder: Path) -> dict[str, Callable[[Path], object]]:
    """Return for every example what reads a file in its place."""
    import numpy as np

    from roomfit.base.bands import bands_between
    from roomfit.files.campaign import read_campaign
    from roomfit.files.directivity import read_directivity
    from roomfit.files.inputs import check_room, identify_arguments
    from roomfit.files.responses import read_response
    from roomfit.files.results import read_materials, read_result
    from roomfit.files.rooms import read_mesh
    from roomfit.files.schema import PolygonSpec, ResponseSpec, RoomSpec
    from roomfit.files.values import read_parameters
    from roomfit.impedance.campaign import read_spectrum

    bands = bands_between("octave", 500, 1000)
    good = folder / "good"
    good.mkdir()
    for name, content in examples().items():
        (good / name).write_bytes(content)

    def checked(spec: RoomSpec, path: Path) -> object:
        # rays that look for leaks take most of the time: one room in eight
        return (read_mesh if zlib.crc32(path.read_bytes()) % 8 else check_room)(spec)

    def room(path: Path) -> object:
        return checked(RoomSpec(file=path, unit="m"), path)

    def response(**keys: Any) -> Callable[[Path], object]:
        return lambda path: read_response(ResponseSpec(path, **keys))

    def tables(corners: Path, planes: Path) -> object:
        return checked(
            RoomSpec(polygons=PolygonSpec(corners=(corners,), planes=(planes,))), corners
        )

    def result(path: Path) -> object:
        return read_materials(path), read_result(path)

    def campaign(path: Path) -> object:
        place = good / "tried.toml"
        place.write_bytes(path.read_bytes())
        return identify_arguments(read_campaign(place))

    kinds = ("obj", "ply", "stl", "glb", "geo", "dxf")
    rooms = ["scan.json", *(name for name in examples() if name.endswith(kinds))]
    mat = response(variable="RIR", channel=0, sampling_rate_variable="Fs")
    return {
        **dict.fromkeys(rooms, room),
        "corners.csv": lambda path: tables(path, good / "planes.csv"),
        "planes.csv": lambda path: tables(good / "corners.csv", path),
        "response.wav": response(),
        "pcm.wav": response(channel=1),
        **dict.fromkeys(("response.flac", "response.aiff", "response.w64"), response()),
        "response.npy": response(sampling_rate_hz=48000.0),
        **dict.fromkeys(("packed.mat", "plain.mat", "v73.mat"), mat),
        "audio.ita": response(channel=1),
        "response.sofa": response(measurement=0, receiver_index=1),
        "directivity.sofa": lambda path: read_directivity(path, bands, np.array([0.0, 1.0, 0.0])),
        "rew.txt": response(),
        "spectrum.npz": read_spectrum,
        "parameters.csv": read_parameters,
        "result.json": result,
        "absorption.csv": result,
        "campaign.toml": campaign,
    }


def serve(folder: Path) -> None:
    """Read the files that come on standard input and say on standard output how it went."""
    import logging
    import resource
    import traceback

    from roomfit.base.errors import RoomfitError

    answers = os.fdopen(os.dup(1), "w")
    terminal = (folder / "terminal").open("wb+", buffering=0)
    os.dup2(terminal.fileno(), 1)
    os.dup2(terminal.fileno(), 2)
    # what is logged of a file that is read, as that it bears no digest, is meant
    logging.getLogger("roomfit").addHandler(logging.NullHandler())
    known = readers(folder)

    def read(name: str, content: bytes) -> dict[str, object]:
        path = folder / name
        path.write_bytes(content)
        terminal.truncate(0)
        begin = time.process_time()
        try:
            known[name](path)
            end = "read"
        except RoomfitError as error:
            end, text = "refused", str(error)
            if len(text) > LONGEST_MESSAGE:
                end = f"a message of {len(text)} letters: {text[:200]!r}"
            if "MemoryError" in text or "Unable to allocate" in text:
                end = f"asked for too much memory: {text[:300]!r}"
        except BaseException:  # noqa: BLE001 -- this is what is looked for
            end = traceback.format_exc(limit=-4)
        seconds = time.process_time() - begin
        sys.stdout.flush()
        sys.stderr.flush()
        said = os.fstat(terminal.fileno()).st_size
        if said and end in ("read", "refused"):
            terminal.seek(0)
            end = f"on the terminal: {terminal.read(500)!r}"
        who = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
        most = max(resource.getrusage(w).ru_maxrss for w in who) * 1024
        return {"end": end, "seconds": seconds, "bytes": most}

    for name, content in examples().items():
        warm = read(name, content)
        if warm["end"] != "read" and name not in ("text.ply", "little.ply", "big.ply"):
            answers.write(json.dumps({"end": f"{name}: {warm['end']}"}) + "\n")
            answers.flush()
            raise SystemExit(f"the example {name} is not read: {warm['end']}")
    with Path("/proc/self/statm").open() as status:
        size = int(status.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    # beyond, a mistake of the program would take the machine with it
    resource.setrlimit(resource.RLIMIT_AS, (size + 3 * MOST_BYTES, resource.RLIM_INFINITY))
    answers.write('{"end": "ready"}\n')
    answers.flush()
    while head := sys.stdin.buffer.readline():
        name, length = json.loads(head)
        answer = read(name, sys.stdin.buffer.read(length))
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def main() -> None:
    """Run the fuzzer from the command line; exit status 1 where a case failed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="+", help="Examples, by name; all others are left out.")
    parser.add_argument("--files", nargs="+", type=Path, help="Files to read in place of cases.")
    parser.add_argument("--corpus", action="store_true", help="Read what once failed, too.")
    parser.add_argument("--keep", type=Path, help="Folder for the files that failed.")
    parser.add_argument("--worker", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        serve(options.worker)
        return
    names = list(options.only or examples())

    def cases() -> Iterator[tuple[int, str, bytes]]:
        for path in options.files or ():
            yield -1, path.name.rpartition("--")[2], path.read_bytes()
        for name, content in corpus().items() if options.corpus else ():
            yield -1, name.rpartition("--")[2], content
        for number in () if options.files else range(options.cases):
            yield number, *case(options.seed, number, names)

    ends = run(cases(), options.keep)
    together: Counter[str] = Counter()
    for (_, end), n in ends.items():
        together[end] += n
    print(f"{sum(ends.values())} cases: {dict(together)}")
    for name in sorted({name for name, _ in ends}):
        print(f"  {name:<20}", *(f"{end} {ends[name, end]:>6}  " for end in together))
    sys.exit(1 if together["failed"] else 0)


if __name__ == "__main__":
    main()
