"""What further cores are worth: seconds by the clock, processor seconds, memory, and equal answers.

    python benchmarks/cores.py [--threads 1 2] [--repeats 2] [--quick] [--campaign FILE]
        [--job identify|predict|treat|design]

The demo's campaign, or any, is identified by the command line without the cache, report and
pictures included, with each number of threads in turn; or what is found of the demo is predicted
with a curtain before its brick, treated, or asked what to measure next. Memory is what process and
copies have together at most, pages that they share counted once (PSS, every 50 ms). The serial
share is Amdahl's, by the clock: it means something only on a machine that has nothing else to do,
which the load before each run says. Processor seconds are those of all processes. Exit code 1
where what was written, its seconds apart, differs.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from newcomers import treatment_text
from roomfit.demo.boxes import demo_plan, write_measured_box

_EVERY_S = 0.05


class Run(NamedTuple):
    """One run of a command."""

    wall_s: float
    cpu_s: float
    memory_bytes: int
    load: float  # before it
    digest: str


def words_of(job: str, campaign: Path, folder: Path, *, quick: bool) -> list[str]:
    """Return the command of a job, without where it writes and its number of threads."""
    if job == "identify":
        return ["identify", str(campaign), *["--quick"] * quick]
    found = ["--absorption", str(folder / "fit" / "result.json")]
    if job == "predict":
        return ["predict", str(campaign), *found, "--set", "brick=curtain"]
    if job == "design":
        return ["design", str(campaign), "--result", found[1]]
    text = treatment_text(["brick", "panelling"], 0.7, [500, 1000])
    (folder / "treatment.toml").write_text(text, encoding="utf-8")
    return ["treat", str(campaign), str(folder / "treatment.toml"), *found]


def measured(words: list[str], out: Path, threads: int) -> Run:
    """Run a command in a process of its own."""
    command = [sys.executable, "-m", "roomfit", *words, "--out", str(out)]
    command += ["--overwrite", "--quiet", "--threads", str(threads)]
    load, before = os.getloadavg()[0], resource.getrusage(resource.RUSAGE_CHILDREN)
    began, most = time.perf_counter(), 0
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, start_new_session=True)
    while process.poll() is None:
        most = max(most, group_bytes(process.pid))
        time.sleep(_EVERY_S)
    wall_s, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    if process.returncode:
        raise SystemExit(f"roomfit ended with {process.returncode}")
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Run(wall_s, cpu_s, most, load, digest_of(out))


def group_bytes(group: int) -> int:
    """Return the memory of all processes of a group, what they share counted once."""
    found = 0
    for folder in Path("/proc").glob("[0-9]*"):
        # processes end while they are being looked at
        with suppress(OSError, ValueError):
            if os.getpgid(int(folder.name)) == group:
                lines = (folder / "smaps_rollup").read_text().splitlines()
                found += sum(1024 * int(x.split()[1]) for x in lines if x.startswith("Pss:"))
    return found


def digest_of(out: Path) -> str:
    """Return the digest of JSON files without their seconds, and of pictures and tables."""
    total = sha256()
    for file in sorted(out.iterdir()):
        if file.suffix == ".json":
            content = without_seconds(json.loads(file.read_text(encoding="utf-8")))
            total.update(json.dumps(content, sort_keys=True).encode())
        elif file.suffix in (".png", ".csv"):
            total.update(file.read_bytes())
    return total.hexdigest()


def without_seconds(content: Any) -> Any:
    """Return the content of a result without what says how long it took, and without its digest."""
    if isinstance(content, list):
        return [without_seconds(x) for x in content]
    if not isinstance(content, dict):
        return content
    left_out = ("seconds", "content_sha256")
    return {k: without_seconds(v) for k, v in content.items() if k not in left_out}


def main() -> int:
    """Print one row for each number of threads."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, nargs="+", default=(1, 2))
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--campaign", type=Path, help="another than the demo's, to be identified")
    jobs = ("identify", "predict", "treat", "design")
    parser.add_argument("--job", choices=jobs, default="identify")
    options = parser.parse_args()
    runs: dict[int, list[Run]] = {n: [] for n in options.threads}
    with tempfile.TemporaryDirectory() as name:
        campaign = options.campaign
        if campaign is None:
            (Path(name) / "campaign").mkdir()
            rng = np.random.default_rng(1)
            campaign = write_measured_box(demo_plan(), Path(name) / "campaign", rng)
        if options.job != "identify":
            fit = words_of("identify", campaign, Path(name), quick=True)
            measured(fit, Path(name) / "fit", max(options.threads))
        words = words_of(options.job, campaign, Path(name), quick=options.quick)
        # the first run compiles what is not on the disk yet
        measured(words, Path(name) / "first", 1)
        for _ in range(options.repeats):
            for n, own in runs.items():
                own.append(measured(words, Path(name) / f"{n}", n))
    heads = ("clock s", "CPU s", "memory MB", "load before", "serial share")
    print("threads  " + "".join(f"{h:>14s}" for h in heads))
    first = runs[options.threads[0]]
    for n, own in runs.items():
        # of runs beside other work the fastest says most
        wall_s, alone_s = (min(r.wall_s for r in x) for x in (own, first))
        serial = (n * wall_s / alone_s - 1.0) / (n - 1) if n > 1 else np.nan
        cpu_s, memory = min(r.cpu_s for r in own), max(r.memory_bytes for r in own)
        load = min(own, key=lambda r: r.wall_s).load
        row = wall_s, cpu_s, 1e-6 * memory, load, serial
        print(f"{n:7d}  " + "".join(f"{x:14.2f}" for x in row))
    alike = len({r.digest for own in runs.values() for r in own}) == 1
    print("all answers and pictures are alike" if alike else "ANSWERS DIFFER")
    return 0 if alike else 1


if __name__ == "__main__":
    sys.exit(main())
