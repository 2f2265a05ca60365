"""Damaged files of every format, read by a process that watches its time and its memory.

    python tests/fuzz/fuzz.py --cases 100000
    python tests/fuzz/fuzz.py --cases 5000 --only response.sofa v73.mat --keep /tmp/found

Case k of a seed is the same file on every machine. A case fails that ends in anything but an
answer or a `RoomfitError`, takes more than 5 s of processor time or 1 GB of memory, writes to the
terminal, or has an endless message. One that kills the process, or keeps it, ends the run: its
file is the last one in the folder to keep.
"""

from __future__ import annotations

import argparse
import faulthandler
import logging
import os
import resource
import sys
import tempfile
import time
import traceback
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random
from typing import Any, BinaryIO

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "helpers")]

from corpus import corpus  # noqa: E402
from examples import examples  # noqa: E402
from mutations import damaged  # noqa: E402

MOST_SECONDS, MOST_BYTES, LONGEST_MESSAGE = 5.0, 10**9, 4000
# of the clock: on a busy machine a process gets little of its time
_PATIENCE_S = 120.0


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


def outcome(read: Callable[[Path], object], path: Path, terminal: BinaryIO) -> str:
    """Return "read", "refused", or what went wrong."""
    from roomfit.base.errors import RoomfitError

    terminal.truncate(0)
    before, begin = most_bytes(), time.process_time()
    try:
        read(path)
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
    if os.fstat(terminal.fileno()).st_size:
        terminal.seek(0)
        end = f"on the terminal: {terminal.read(500)!r}"
    if seconds > MOST_SECONDS:
        end = f"{seconds:.1f} s"
    # the highest that the process ever took: only a new one tells
    if most_bytes() > max(before, MOST_BYTES):
        end = f"{most_bytes() / 1e9:.2f} GB of memory"
    return end


def most_bytes() -> int:
    """Return the most memory that this process, or one that it started, ever took."""
    who = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return max(resource.getrusage(w).ru_maxrss for w in who) * 1024


def run(cases: Iterator[tuple[str, bytes]], folder: Path) -> Counter[tuple[str, str]]:
    """Read every case, print those that fail; return how many ended how, by name."""
    # what is logged of a file that is read, as that it bears no digest, is meant
    logging.getLogger("roomfit").addHandler(logging.NullHandler())
    answers = os.fdopen(os.dup(1), "w")
    terminal = (folder / "terminal").open("wb+", buffering=0)
    os.dup2(terminal.fileno(), 1)
    os.dup2(terminal.fileno(), 2)
    known, ends = readers(folder), Counter[tuple[str, str]]()
    for name, content in examples().items():  # the first of each kind pays for imports
        (folder / name).write_bytes(content)
        known[name](folder / name)
    size = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    # beyond, a mistake of the program would take the machine with it
    resource.setrlimit(resource.RLIMIT_AS, (size + 3 * MOST_BYTES, resource.RLIM_INFINITY))
    for number, (name, content) in enumerate(cases):
        path = folder / name
        path.write_bytes(content)
        faulthandler.dump_traceback_later(_PATIENCE_S, exit=True, file=answers)
        end = outcome(known[name], path, terminal)
        faulthandler.cancel_dump_traceback_later()
        failed = end not in ("read", "refused")
        ends[name, "failed" if failed else end] += 1
        if failed:
            print(f"--- case {number}, {name}: {end}", file=answers, flush=True)
            (folder / f"{number}--{name}").write_bytes(content)
    os.dup2(answers.fileno(), 1)
    return ends


def main() -> None:
    """Run the fuzzer from the command line; exit status 1 where a case failed."""
    os.environ |= {"ROOMFIT_LIMITS": "reading_s=3", "MPLBACKEND": "Agg"}
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="+", help="Examples, by name; all others are left out.")
    parser.add_argument("--files", nargs="+", type=Path, help="Files to read in place of cases.")
    parser.add_argument("--corpus", action="store_true", help="Read what once failed, too.")
    parser.add_argument("--keep", type=Path, help="New folder for the files that are read.")
    options = parser.parse_args()
    names = list(options.only or examples())

    def cases() -> Iterator[tuple[str, bytes]]:
        for path in options.files or ():
            yield path.name.rpartition("--")[2], path.read_bytes()
        for name, content in corpus().items() if options.corpus else ():
            yield name.rpartition("--")[2], content
        for number in () if options.files else range(options.cases):
            name = names[number % len(names)]
            rng = Random(options.seed * 1_000_003 + number)
            yield name, damaged(name, examples()[name], rng)

    with tempfile.TemporaryDirectory(prefix="roomfit-fuzz-") as made:
        folder = options.keep or Path(made)
        folder.mkdir(parents=True, exist_ok=True)
        ends = run(cases(), folder)
    together: Counter[str] = Counter()
    for (_, end), n in ends.items():
        together[end] += n
    print(f"{sum(ends.values())} cases: {dict(together)}")
    for name in sorted({name for name, _ in ends}):
        print(f"  {name:<20}", *(f"{end} {ends[name, end]:>6}  " for end in together))
    sys.exit(1 if together["failed"] else 0)


if __name__ == "__main__":
    main()
