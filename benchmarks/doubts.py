"""How often each doubt is raised where it should not be, and where it should: a confusion matrix.

    python benchmarks/doubts.py --out FILE [--seeds choose|second|...|fifth] [--right N]
        [--faults N] [--measured DATA] [--only PATTERN] [--jobs N]
    python benchmarks/doubts.py --summarise FILE ... [--only PATTERN]
    python benchmarks/doubts.py --list

Rooms that are described rightly (`_doubt_rooms.py`), N of each kind, and rooms with one fault at a
time (`_doubt_faults.py`), N for each fault. Rules are chosen on the rooms of ``--seeds choose``,
``second``, ``third`` and, of surfaces that are not uniform, ``fourth``; they are reported on those
of ``report``, ``fourth`` and ``fifth``: no room is in two sets. Every room is written as one line
of FILE as soon as it is done, and not run again where it stands there; the tables are printed last.
PATTERN is a regular expression over "group: name" as ``--list`` prints them. ``--jobs`` processes
take one thread each.

A *doubt* is a finding that is serious or that voids identifiability. *Outside*: a value called
identifiable whose true absorption its 95 % interval does not hold; *harmful* (harmf): one that it
misses by more than half its width. A fault is *found* where the room is refused, doubted, or its
cause named by a milder finding; *named* is the share of those found whose first doubt is the
fault's cause.
"""

from __future__ import annotations

import argparse
import json
import re
import time
import zlib
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np

import roomfit
from _doubt_faults import FAULTS, HARMLESS_CHANGES
from _doubt_rooms import RIGHT_ROOMS, measured_rooms
from _doubt_summary import Group, Raised, Record, record_of, summary
from hostile import Case, fixed, missed_by
from roomfit.base.errors import InputError, InsufficientDataError
from roomfit.base.findings import Code
from roomfit.result import Result

# Added to the seed of a room: rooms of all sets differ in everything. Sets that led to other rules
# when they were reported on are not reported on again: the second had 25 false alarms in 237 right
# rooms, the third 5 in 238, the fourth 3 in 105.
SETS = {"choose": 0, "second": 500, "third": 750, "report": 250, "fourth": 1000, "fifth": 1250}
MOST_ROOMS = 250  # of one kind and set


@dataclass(frozen=True)
class Room:
    """One room to be run: its case is made in the process that fits it."""

    group: Group
    name: str
    seed: int
    data: Path | None = None

    def case(self) -> tuple[Case, frozenset[str]]:
        """Return the room with the codes that are right of it."""
        if self.group == "fault":
            fault = FAULTS[self.name]
            return fault.make(self.seed), fault.causes
        kinds = {**RIGHT_ROOMS, **HARMLESS_CHANGES}
        if self.data is not None:
            kinds |= measured_rooms(self.data)
        return kinds[self.name].make(self.seed), kinds[self.name].expected


def planned(asked: argparse.Namespace) -> Iterator[Room]:
    """Yield what was asked for: a room of each kind, then the next of each."""
    kinds = {**RIGHT_ROOMS, **HARMLESS_CHANGES}
    yield from _rounds("right", {name: k.every for name, k in kinds.items()}, asked.right, asked)
    if asked.measured is not None:
        for name in measured_rooms(asked.measured):
            yield Room("measured", name, 0, asked.measured)
    yield from _rounds("fault", dict.fromkeys(FAULTS, 1), asked.faults, asked)


def _rounds(
    group: Group, every: Mapping[str, int], n: int, asked: argparse.Namespace
) -> Iterator[Room]:
    for i in range(min(n, MOST_ROOMS)):
        for name in (name for name, k in every.items() if i % k == 0):
            own = zlib.crc32(name.encode()) % 10**6 * 1000
            yield Room(group, name, own + SETS[asked.seeds] + i)


def run(room: Room) -> Record:
    """Return what became of a room."""
    case, expected = room.case()
    began = time.process_time()
    base = partial(Record, room.group, room.name, room.seed, tuple(sorted(expected)))
    try:
        answer = roomfit.identify(**case.arguments)
    except (InputError, InsufficientDataError) as refusal:
        return base(refused=refusal.what, cpu_s=time.process_time() - began)
    seconds = time.process_time() - began
    miss = missed_by(answer, case)
    width = answer.upper95 - answer.lower95
    free = ~fixed(case.arguments.get("materials", ())) if "materials" in case.arguments else True
    free = np.broadcast_to(np.asarray(free), answer.identifiable.shape)
    sure = answer.identifiable & free
    is_known = bool(np.isfinite(case.absorption).all())
    return base(
        findings=_raised(answer),
        n_pairs=len(case.files),
        n_values=int(free.sum()),
        n_identifiable=int(sure.sum()),
        n_outside=int((sure & (miss > 0.0)).sum()),
        n_harmful=int((sure & (miss > 0.5 * width)).sum()),
        n_taken_back=_taken_back(answer, free),
        error=float(np.median(np.abs(answer.absorption - case.absorption))) if is_known else 0.0,
        chi2=tuple(answer.chi2_reduced.round(2).tolist()),
        cpu_s=seconds,
    )


def _raised(answer: Result) -> tuple[Raised, ...]:
    return tuple(
        Raised(
            f.code.value, f.severity == "serious", f.code.voids_identifiability, f.sentence[:400]
        )
        for f in answer.findings
        if f.severity != "info"
    )


def _taken_back(answer: Result, free: np.ndarray) -> int:
    """Return how many values findings took back from the rule, -1 where that is not told."""
    by_rule = getattr(answer, "identifiable_by_rule", None)
    if by_rule is None:
        return -1
    return int((by_rule & ~answer.identifiable & free).sum())


def stored(files: list[Path]) -> dict[tuple[str, str, int], Record]:
    """Return the records of files, the last one of a room that stands there twice."""
    lines = (line for f in files if f.exists() for line in f.read_text().splitlines() if line)
    records = (record_of(json.loads(line)) for line in lines)
    return {r.key: r for r in records}


def doubt_codes() -> list[str]:
    """Return all codes that can be serious or void."""
    return [c.value for c in Code if "serious" in c.severities or c.voids_identifiability]


def run_all(rooms: list[Room], out: Path, jobs: int) -> None:
    """Run rooms and append each to the file as it is done."""

    def keep(record: Record, stream_path: Path = out) -> None:
        with stream_path.open("a") as stream:
            stream.write(json.dumps(record.to_json()) + "\n")
        shown = f"refused: {record.refused}" if record.refused else " ".join(record.false_alarms)
        harm = f"{record.n_identifiable:3d} {record.n_outside:3d} {record.n_harmful:3d}"
        print(f"{record.cpu_s:5.1f} s {harm}  {record.group}: {record.name}  {shown}", flush=True)

    if jobs == 1:
        for room in rooms:
            keep(run(room))
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        for record in pool.map(run, rooms):
            keep(record)


def main() -> None:
    """Run what was asked for and is not done, and print the tables of all that stands in FILE."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path)
    parser.add_argument("--seeds", choices=list(SETS), default="choose")
    parser.add_argument("--right", type=int, default=3, metavar="N")
    parser.add_argument("--faults", type=int, default=2, metavar="N")
    parser.add_argument("--measured", type=Path, metavar="DATA")
    parser.add_argument("--only", default="", metavar="PATTERN")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--summarise", type=Path, nargs="+", metavar="FILE")
    parser.add_argument("--list", action="store_true")
    asked = parser.parse_args()
    chosen = re.compile(asked.only)
    rooms = [r for r in planned(asked) if chosen.search(f"{r.group}: {r.name}")]
    if asked.list:
        print("\n".join(dict.fromkeys(f"{r.group}: {r.name}" for r in rooms)))
        return
    if asked.summarise:
        done = [
            r for r in stored(asked.summarise).values() if chosen.search(f"{r.group}: {r.name}")
        ]
        print(summary(done, doubt_codes()))
        return
    if asked.out is None:
        print("no --out FILE given: nothing to do")
        return
    have = stored([asked.out])
    run_all([r for r in rooms if (r.group, r.name, r.seed) not in have], asked.out, asked.jobs)
    wanted = {(r.group, r.name, r.seed) for r in rooms}
    print(summary([r for k, r in stored([asked.out]).items() if k in wanted], doubt_codes()))


if __name__ == "__main__":
    main()
