"""The clock of three new users: to a first number, to a report, and to what they came to ask.

    python benchmarks/newcomers.py [--to STEP] [--out DIR]

Each starts from a folder as strangers have it, made of the demo's room. The consultant has files
of 24 bits that all begin 40 samples too early, in a folder below, with a hidden twin and a sweep
among them, a drawing in centimetres and a table with decimal commas; follows what `roomfit init`
and `roomfit check` say, and nothing else; what would a curtain before the brick do? The researcher
has the same responses as arrays, and wants the walls in pyroomacoustics. The owner of a hall has
T30 values: how many square metres of absorber for a T30 of 1 s?

Printed are seconds of the clock and of the processor since the start, by command. ``--to check``
leaves out the fits, which take most of the time.
"""

from __future__ import annotations

import argparse
import json
import re
import resource
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import soundfile

import roomfit
from roomfit.demo.boxes import SAMPLING_RATE_HZ, WALLS, demo_plan, simulated_responses

LATE_SAMPLES = 40
QUADS = {
    "west": (0, 4, 6, 2), "east": (1, 3, 7, 5), "south": (0, 1, 5, 4), "north": (2, 6, 7, 3),
    "floor": (0, 2, 3, 1), "ceiling": (4, 5, 7, 6),
}  # fmt: skip


def treatment_text(surfaces: Sequence[str], at_most_s: float, bands_hz: Sequence[int]) -> str:
    """Return a treatment file: wool on surfaces for a T30 that is the mean of bands."""
    return "\n".join([
        *(f"[surfaces.{name}]" for name in surfaces),
        '[products."wool panel"]\ncatalogue = "mineral-wool-50-mm"\n[[targets]]',
        f'parameter = "T30_s"\nat_most = {at_most_s}\nbands_hz = {list(bands_hz)}',
        "mean_of_bands = true\n",
    ])  # fmt: skip


def late_responses() -> dict[tuple[str, str], np.ndarray]:
    """Return the demo's responses by source and receiver, late, with a peak of 0.5."""
    found = simulated_responses(demo_plan(), np.random.default_rng(1))
    peak = max(float(np.abs(samples).max()) for samples in found.values())
    return {k: 0.5 / peak * np.append(np.zeros(LATE_SAMPLES), v) for k, v in found.items()}


def write_folder(folder: Path) -> None:
    """Write the consultant's folder."""
    plan, recordings = demo_plan(), folder / "Messung 1"
    recordings.mkdir(parents=True)
    for (source, receiver), samples in late_responses().items():
        file = recordings / f"{source}_{receiver}.wav"
        soundfile.write(file, samples, int(SAMPLING_RATE_HZ), subtype="PCM_24")
    (recordings / "._LS1_MP1.wav").write_bytes(b"\0\5\26\7")
    (recordings / "sweep.wav").write_bytes((recordings / "LS1_MP1.wav").read_bytes())
    points = {**plan.sources_m, **plan.receivers_m}
    rows = [";".join([n, *(f"{100 * x:.1f}" for x in p)]) for n, p in points.items()]
    table = "\n".join(["Name;x [cm];y [cm];z [cm]", *(row.replace(".", ",") for row in rows)])
    (folder / "Positionen.csv").write_text(table, encoding="cp1252")
    x, y, z = (100.0 * length for length in plan.lengths_m)
    lines = [f"v {i * x:g} {j * y:g} {k * z:g}" for k in (0, 1) for j in (0, 1) for i in (0, 1)]
    for wall, material in zip(WALLS, plan.materials, strict=True):
        corners = " ".join(str(corner + 1) for corner in QUADS[wall])
        lines += [f"o {wall}", f"usemtl {material}", f"f {corners}"]
    (folder / "Saal.obj").write_text("\n".join(lines))


def _advised(said: str, word: str) -> list[str]:
    """Return the arguments of the command that a command proposes."""
    return shlex.split(re.findall(rf"{word}: roomfit (.*)", said)[0])


class Clock:
    """Prints what a step took."""

    def __init__(self, who: str) -> None:
        print(f"\n{who}")
        self._start_s, self._used_s = time.monotonic(), self._cpu_s()

    def _cpu_s(self) -> float:
        kinds = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
        return sum(u.ru_utime + u.ru_stime for u in map(resource.getrusage, kinds))

    def tell(self, step: str) -> None:
        wall_s, cpu_s = time.monotonic() - self._start_s, self._cpu_s() - self._used_s
        print(f"{wall_s:8.1f} s of the clock {cpu_s:8.1f} s of the processor  {step}", flush=True)

    def run(self, folder: Path, *words: str) -> str:
        """Run a command line and return what it printed."""
        done = subprocess.run(
            [sys.executable, "-m", "roomfit", *words],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
        )
        self.tell(f"roomfit {' '.join(words)}  (exit code {done.returncode})")
        return done.stdout + done.stderr


def consultant(folder: Path, *, fit: bool) -> None:
    """Go by what the commands say: the drawing and the table, the unit, the latency."""
    write_folder(folder)
    clock = Clock("consultant: WAV files that begin 40 samples too early, a drawing, positions")
    said = clock.run(folder, "init", ".")
    words = _advised(said, "perhaps")
    said = clock.run(folder, *words)
    if "(--unit), one of" in said:
        said = clock.run(folder, *words, "--unit", "cm")
    said = " ".join(clock.run(folder, "check", "campaign.toml").split())
    latency = re.findall(r"set (latency_s = [\d.]+)", said)[0]
    file = folder / "campaign.toml"
    file.write_text(re.sub(r"# latency_s = .*", latency, file.read_text()))
    said = clock.run(folder, "check", "campaign.toml")
    print(f"{'':45}{'nothing serious' if '- serious' not in said else 'still serious'}")
    if fit:
        said = clock.run(folder, "identify", "campaign.toml", "--quick", "--out", "first")
        clock.tell(f"report: {(folder / 'first' / 'report.html').stat().st_size} bytes")
        print("\n".join(said[said.find("Absorption, 95 %") :].split("\n")[:9]))
        answer = ("--absorption", "first/result.json", "--out", "curtain")
        change = "brick=curtain-heavy-draped"
        said = clock.run(folder, "predict", "campaign.toml", *answer, "--set", change)
        clock.tell(f"answer: {said.splitlines()[0]}")


def researcher(*, fit: bool) -> None:
    """Arrays in memory: what is wrong with them, then an answer."""
    plan, responses = demo_plan(), late_responses()
    clock = Clock("researcher: arrays")
    room = roomfit.shoebox_room(plan.lengths_m, dict(zip(WALLS, plan.materials, strict=True)))
    scene = roomfit.scene_of(room, plan.sources_m, plan.receivers_m)
    bands = roomfit.bands_between("octave", 500, 1000)

    def measured(latency_s: float) -> list[roomfit.Measurement]:
        return [
            roomfit.Measurement(*pair, samples, SAMPLING_RATE_HZ, latency_s=latency_s)
            for pair, samples in responses.items()
        ]

    (late,) = roomfit.check_recordings(scene, measured(0.0), bands).findings
    clock.tell(f"check_recordings: {late.sentence}")
    if fit:
        latency_s = float(str(late.evidence["latency_s"]))
        result = roomfit.identify(scene, measured(latency_s), bands=bands)
        clock.tell("identify, 500 and 1000 Hz")
        page = roomfit.report_html(result, scene, title="demo")
        clock.tell(f"report_html: {len(page)} letters")
        with tempfile.TemporaryDirectory() as temporary:
            file = Path(temporary) / "materials.json"
            roomfit.export_result(result, "pyroomacoustics", file)
            walls = json.loads(file.read_text(encoding="utf-8"))
        clock.tell(f"answer: export_result, {len(walls)} entries")


def owner(folder: Path) -> None:
    """T30 values of an older report."""
    folder.mkdir(parents=True)
    (folder / "T30.csv").write_text("place;125 Hz;500 Hz;2 kHz\nstalls;1,9;1,5;1,3\n")
    clock = Clock("owner of a hall: T30 values")
    box = ("--shoebox", "20", "14", "7")
    said = clock.run(folder, "init", ".", *box)
    said = clock.run(folder, *_advised(said, "perhaps"))
    print(clock.run(folder, *_advised(said, "then"), "--out", "mean").split("\n\n")[0])
    clock.tell(f"report: {(folder / 'mean' / 'reverberation.html').stat().st_size} bytes")
    (folder / "treatment.toml").write_text(treatment_text(["ceiling"], 1.0, [500, 2000]))
    said = clock.run(folder, "treat", "campaign.toml", "treatment.toml", "--out", "treated")
    clock.tell(f"answer: {said.splitlines()[0]}")


def main() -> None:
    """Run the three and print their clocks."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--to", choices=("check", "answer"), default="answer")
    parser.add_argument("--out", type=Path, help="A new folder, which is kept.")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        out: Path = options.out or Path(temporary)
        owner(out / "hall of an owner")
        consultant(out / "Großer Saal", fit=options.to == "answer")
        researcher(fit=options.to == "answer")


if __name__ == "__main__":
    main()
