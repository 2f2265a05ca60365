"""A batch over time: thousands of rooms that take no time, and rooms in fact whose workers die.

    python benchmarks/soak.py --rooms 10000                        # what the batch itself costs
    python benchmarks/soak.py --rooms 100 --real --kill-every 60   # a worker killed every minute

Without `--real` every room gets the answer of the first. Printed: time a room, memory of the
process that holds the scheduler (Linux), and how many answers were written more than once. The exit
code is 1 where a room has no answer, or more than one although no worker was killed.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from multiprocessing import active_children
from pathlib import Path
from threading import Event, Thread

from roomfit.base.workers import cluster_pool
from roomfit.batch.rooms import rooms as batch
from roomfit.identify import compile_kernels

ROOM = """
[room]
shoebox = [6, 5, 3]
materials = { walls = "felt", ceiling = "plaster" }
[sources.S]
position = [1.5, 1.2, 1.5]
[receivers.R]
position = [4.0, 3.5, 1.2]
[identify]
from_hz = 1000
to_hz = 1000
[[measurements]]
parameters = "measured.csv"
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rooms", type=int, default=10_000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--real", action="store_true", help="identify each room")
    parser.add_argument("--kill-every", type=float, default=0.0, help="s between two deaths")
    wanted = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        campaigns = [written(folder / "campaigns" / f"{n:05d}", n) for n in range(wanted.rooms)]
        real, log, answer = batch.identify_room, folder / "log.txt", None
        if not wanted.real:
            answer = folder / "answer"
            real(campaigns[0], answer)
        batch.identify_room = partial(noted, log, answer, real)
        killed, over, memory_mib = list[int](), Event(), [0.0]
        with cluster_pool(n_workers=wanted.workers, warm=compile_kernels) as pool:
            if wanted.kill_every:
                Thread(target=kill, args=(wanted.kill_every, over, killed), daemon=True).start()
            memory_mib, begin = [own_mib()], time.perf_counter()

            def progress(share: float) -> None:
                if 10.0 * share >= len(memory_mib):
                    memory_mib.append(own_mib())

            rows = batch.identify_rooms(campaigns, folder / "out", pool=pool, progress=progress)
            seconds = time.perf_counter() - begin
            over.set()
        print(f"{batch.counted(rows)} {len(killed)} workers were killed.")
        print(f"{seconds:.0f} s, {1e3 * seconds / len(rows):.1f} ms a room")
        print("MiB, also at every tenth:", " ".join(f"{m:.0f}" for m in memory_mib))
        begun = Counter(log.read_text().split())
        folders = {p.name for p in (folder / "out" / "rooms").iterdir()}
        more = sum(count > 1 for count in begun.values())
        print(f"{len(folders)} folders of results; {more} rooms were begun more than once")
        done = begun.keys() == folders and all(r.status == "done" for r in rows)
    sys.exit(0 if done and (killed or not more) else 1)


def written(folder: Path, number: int) -> Path:
    """Write a campaign whose measured decay time is its own."""
    folder.mkdir(parents=True)
    table = f"source,receiver,parameter,1000\nS,R,T30,{0.3 + 1e-5 * number:.5f}\n"
    (folder / "measured.csv").write_text(table)
    path = folder / "campaign.toml"
    path.write_text(ROOM)
    return path


def noted(
    log: Path,
    answer: Path | None,
    real: Callable[..., str],
    campaign: Path,
    folder: Path,
    *,
    quick: bool,
) -> str:
    """Note that a room is begun; identify it, or give it an answer that is there."""
    with log.open("a") as stream:
        stream.write(f"{folder.name}\n")
    if answer is None:
        return real(campaign, folder, quick=quick)
    aside = folder.with_name(f".{folder.name}-{os.getpid()}")
    aside.mkdir()
    os.link(answer / "result.json", aside / "result.json")
    aside.rename(folder)
    return ""


def kill(every_s: float, over: Event, killed: list[int]) -> None:
    """Kill one of the workers, chosen by chance, again and again."""
    rng = random.Random(1)
    while not over.wait(every_s):
        pids = sorted(c.pid for c in active_children() if c.pid is not None)
        if pids:
            killed.append(rng.choice(pids))
            os.kill(killed[-1], signal.SIGKILL)


def own_mib() -> float:
    """Return the resident memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


if __name__ == "__main__":
    main()
