"""What a campaign costs against its number of pairs: processor seconds and peak memory.

    python benchmarks/pairs.py [--pairs 8 25 50] [--from-hz 125] [--to-hz 4000] [--energy]
        [--rooms FOLDER] [--source DIR]

The walls and the length, width and height of the demo's box, sources and receivers drawn 0.6 m
clear of the walls and 1 m apart; every source with every receiver. Responses are those of the demo
(interfering pressures, position errors of a centimetre, an uneven loudspeaker, noise), 0.4 s at
16 kHz. `roomfit.identify` runs in a process of its own for each number of pairs, on one thread,
after a run of two pairs that compiles what is not compiled yet. Printed are processor seconds,
largest memory of the process, errors and coverage, and the exponent by which seconds and memory
above those of no pair grow from the first to the last number.

--rooms   where simulated responses are kept and found again; left out: nowhere
--source  another checkout's `src` to be timed in place of this one, for before and after
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
from pathlib import Path

import numpy as np
import soundfile

from roomfit.demo.boxes import (
    NOISE_DB,
    PLAN_BANDS,
    POSITION_ERROR_M,
    BoxPlan,
    add_noise,
    campaign_text,
    demo_plan,
    pressure_response,
    true_box,
)

RATE_HZ, DURATION_S = 16_000, 0.4
CLEAR_M, APART_M = 0.6, 1.0


def plan_of(n_pairs: int) -> BoxPlan:
    """Return the demo's box with as many sources and receivers as make so many pairs."""
    demo = demo_plan()
    n_sources = next(n for n in (10, 5, 2, 1) if n_pairs % n == 0 and n * n <= n_pairs)
    rng, high = np.random.default_rng(1), np.array(demo.lengths_m) - CLEAR_M
    sources = rng.uniform(CLEAR_M, high, (10, 3)).round(3)
    receivers: list[np.ndarray] = []
    while len(receivers) < n_pairs // n_sources:
        at = rng.uniform(CLEAR_M, high).round(3)
        if np.min(np.linalg.norm(sources - at, axis=1)) > APART_M:
            receivers.append(at)
    return BoxPlan(
        demo.lengths_m,
        demo.materials,
        demo.absorption,
        {f"S{i}": tuple(x.tolist()) for i, x in enumerate(sources[:n_sources])},
        {f"R{i}": tuple(x.tolist()) for i, x in enumerate(receivers)},
    )


def write_room(n_pairs: int, folder: Path, bands: tuple[int, int], more: str) -> Path:
    """Write a campaign of so many pairs and those of its responses that are not there."""
    plan = plan_of(n_pairs)
    rng = np.random.default_rng(2)
    levels_db = rng.normal(0.0, 3.0, (10, len(PLAN_BANDS)))
    everything = plan_of(200)
    synthetic, at = true_box(everything, POSITION_ERROR_M, rng)
    for i, s in enumerate(plan.sources_m):
        for r in plan.receivers_m:
            file = folder / f"{s}_{r}.wav"
            if file.exists():
                continue
            p = pressure_response(synthetic, at[s], at[r], DURATION_S, RATE_HZ, levels_db[i])
            noisy = add_noise(p, NOISE_DB, np.random.default_rng([i, int(r[1:])]))
            soundfile.write(file, noisy.astype(np.float32), RATE_HZ, subtype="FLOAT")
    pairs = [(s, r) for s in plan.sources_m for r in plan.receivers_m]
    text = campaign_text(plan, pairs, POSITION_ERROR_M)
    text = text.replace("from_hz = 125\nto_hz = 4000", f"from_hz = {bands[0]}\nto_hz = {bands[1]}")
    campaign = folder / f"campaign_{n_pairs}.toml"
    campaign.write_text(text + more)
    return campaign


def run_one(campaign: Path) -> None:
    """Identify one campaign and print what it took as JSON: the body of a process of its own."""
    import roomfit

    arguments = roomfit.load_campaign(campaign)
    began, wall = time.process_time(), time.perf_counter()
    result = roomfit.identify(**arguments)
    took, waited = time.process_time() - began, time.perf_counter() - wall
    plan = demo_plan()
    index = [PLAN_BANDS.centres_hz.tolist().index(f) for f in result.bands.centres_hz.tolist()]
    true = plan.absorption[:, index]
    error = np.abs(result.absorption - true)
    held = (result.lower95 <= true) & (true <= result.upper95)
    found = {
        "seconds": took,
        "waited": waited,
        "mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        "evaluations": int(result.evaluations),
        "median": float(np.median(error)),
        "largest": float(error.max()),
        "held": f"{held.sum()}/{held.size}",
        "identifiable": int(result.identifiable.sum()),
    }
    print(json.dumps(found))


def measured(campaign: Path, source: Path | None) -> dict[str, float]:
    """Return what `run_one` prints in a process with one thread."""
    names = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    threads = dict.fromkeys(names, "1")
    environment = {**os.environ, **threads}
    if source is not None:
        environment["PYTHONPATH"] = f"{source}:{environment.get('PYTHONPATH', '')}"
    command = [sys.executable, __file__, "--one", str(campaign)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        return {"seconds": np.nan, "said": done.stderr.strip().splitlines()[-1]}  # type: ignore[dict-item]
    return dict(json.loads(done.stdout.splitlines()[-1]))


def main() -> None:
    """Measure every number of pairs and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--pairs", type=int, nargs="+", default=[8, 25, 50])
    parser.add_argument("--from-hz", type=int, default=125)
    parser.add_argument("--to-hz", type=int, default=4000)
    parser.add_argument("--energy", action="store_true", help="windows as energies alone")
    parser.add_argument("--rooms", type=Path)
    parser.add_argument("--source", type=Path)
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.one is not None:
        run_one(asked.one)
        return
    with tempfile.TemporaryDirectory() as name:
        folder = asked.rooms or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        bands = (asked.from_hz, asked.to_hz)
        more = 'model = "energy"\n' if asked.energy else ""
        none = measured(write_room(2, folder, bands, more), asked.source)
        none = measured(write_room(2, folder, bands, more), asked.source)
        print(
            f"{'pairs':>5}  CPU s  wall s  evaluations  peak MB  error  largest  held  identified"
        )
        rows = []
        for n in asked.pairs:
            row = measured(write_room(n, folder, bands, more), asked.source)
            if "said" in row:
                print(f"{n:5d}  {row['said']}", flush=True)
                continue
            rows.append((n, row["seconds"], row["mb"] - none["mb"]))
            print(
                f"{n:5d}  {row['seconds']:5.1f}  {row['waited']:6.1f}  {row['evaluations']:11d}  "
                f"{row['mb']:7.0f}  {row['median']:.3f}  {row['largest']:7.3f}  {row['held']:>5}  "
                f"{row['identifiable']:10d}",
                flush=True,
            )
    if len(rows) > 1:
        (n, s, m), (last_n, last_s, last_m) = rows[0], rows[-1]
        grown = np.log(last_n / n)
        print(
            f"grows as pairs to the power of {np.log(last_s / s) / grown:.2f} (seconds) and "
            f"{np.log(last_m / m) / grown:.2f} (memory above the {none['mb']:.0f} MB of two pairs)"
        )


if __name__ == "__main__":
    main()
