"""A large job: 20 materials, 24 third-octave bands, 50 pairs, 20,000 triangles; time and memory.

    python benchmarks/scale.py [--triangles N] [--sources N] [--receivers N] [--octaves]

A fan-shaped hall whose shell and blocks of seats have materials of their own, 5 sources and 10
receivers. The responses are noise with the decay of a trace with other rays, filtered band by band:
they cost little to make and say nothing of accuracy, which other benchmarks measure. What is timed
is `roomfit identify` as a user runs it, from reading the files to the finished folder.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import soundfile

from roomfit.base.air import Air, attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import BandKind, Bands, bands_between
from roomfit.materials.priors import uniform_scattering
from roomfit.model.weighing import energy_rows, weigh
from roomfit.room.mesh import Mesh, Surface, corners_m
from roomfit.room.scene import Point, Room, Scene
from roomfit.signals.filters import filter_pressure
from roomfit.signals.response import ImpulseResponse
from roomfit.tracing.paths import TraceSettings
from roomfit.tracing.trace import trace
from simulated_rooms.hall import hall_room

N_MATERIALS = 20
RATE_HZ = 32_000
DURATION_S = 1.6
STEP_S = 2e-3


def divided_hall(n_triangles: int) -> Room:
    """Return the hall with its seats in 15 materials from front to back, the shell in five."""
    hall = hall_room(n_triangles)
    mesh = hall.mesh
    shell = np.array([0, 0, 1, 1, 2, 2, 3, 3, 2, 2, 4, 4])  # floor, stage, sides, back, ceiling
    seats = np.arange(len(mesh.triangles) - shell.size)
    blocks = shell.max() + 1 + seats * (N_MATERIALS - 5) // seats.size
    names = tuple(f"m{i:02d}" for i in range(N_MATERIALS))
    owner = np.concatenate((shell, blocks))
    surfaces = tuple(Surface(name, None, name) for name in names)
    return Room(
        Mesh(mesh.vertices_m, mesh.triangles, owner, surfaces), names, np.arange(N_MATERIALS)
    )


def hall_scene(room: Room, n_sources: int, n_receivers: int) -> Scene:
    """Return sources on the stage and receivers above the seats, every pair of them."""
    rng = np.random.default_rng(1)
    sources = [
        Point(f"S{i}", rng.uniform((1.5, -5.0, 1.2), (4.5, 5.0, 1.8)), 0.02)
        for i in range(n_sources)
    ]
    receivers = [
        Point(f"R{i}", rng.uniform((8.0, -6.0, 5.0), (29.0, 6.0, 6.5)), 0.02)
        for i in range(n_receivers)
    ]
    pairs = [(s, r) for s in range(n_sources) for r in range(n_receivers)]
    return Scene(room, tuple(sources), tuple(receivers), np.array(pairs), Air())


def write_obj(room: Room, path: Path) -> None:
    """Write every triangle with its material."""
    lines = []
    for name, corners in zip(
        (room.materials[m] for m in room.mesh.triangle_surface), corners_m(room.mesh), strict=True
    ):
        lines.append(f"usemtl {name}")
        lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in corners]
        lines.append("f -3 -2 -1")
    path.write_text("\n".join(lines))


def write_responses(scene: Scene, bands: Bands, folder: Path) -> None:
    """Write noise that decays as a trace with other rays says, one WAV a pair."""
    rng = np.random.default_rng(2)
    settings = TraceSettings(DURATION_S, 20_000, 1, 1.0, seed=77)
    paths = trace(scene, settings, uniform_scattering(scene.room.materials, 0.2)).paths
    c = speed_of_sound_m_s(scene.air)
    coefficients = rng.uniform(0.05, 0.5, (N_MATERIALS, len(bands)))
    edges = np.arange(0.0, DURATION_S, STEP_S)
    n = round(DURATION_S * RATE_HZ)
    times = np.arange(n) / RATE_HZ
    for pair, (s, r) in enumerate(scene.pairs):
        rows = energy_rows(paths, pair, edges, c)
        energy = weigh(rows, coefficients, attenuation_per_m(scene.air, bands), derivative=False)
        noise = ImpulseResponse(rng.standard_normal(n), float(RATE_HZ))
        pressure = np.zeros(n)
        for filtered, found in zip(filter_pressure(bands, noise), energy.energy, strict=True):
            # a short window may catch no ray: smooth over a few
            smooth = np.convolve(found, np.ones(5) / 5.0, "same")
            pressure += filtered * np.sqrt(np.interp(times, edges[:-1] + 0.5 * STEP_S, smooth))
        pressure *= 0.5 / np.abs(pressure).max()
        pressure += 1e-6 * rng.standard_normal(n)
        name = f"{scene.sources[s].name}_{scene.receivers[r].name}.wav"
        soundfile.write(folder / name, pressure.astype(np.float32), RATE_HZ, subtype="FLOAT")


def campaign_text(scene: Scene, kind: str, bands: Bands) -> str:
    """Return the campaign file."""
    lines = ["[room]", 'file = "hall.obj"', 'unit = "m"']
    for name in scene.room.materials:
        lines += [f"[materials.{name}]", "scattering = 0.2"]
    for table, points in (("sources", scene.sources), ("receivers", scene.receivers)):
        for p in points:
            lines += [f"[{table}.{p.name}]", f"position = {p.position_m.tolist()}"]
            lines += ["position_sd = 0.02"]
    for s, r in scene.pairs:
        a, b = scene.sources[s].name, scene.receivers[r].name
        lines += ["[[measurements]]", f'source = "{a}"', f'receiver = "{b}"']
        lines += [f'file = "{a}_{b}.wav"']
    centres = bands.centres_hz
    lines += [
        "[identify]",
        f'bands = "{kind}"',
        f"from_hz = {centres[0]}",
        f"to_hz = {centres[-1]}",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Make the job, run it, and print what it took."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--triangles", type=int, default=20_012)
    parser.add_argument("--sources", type=int, default=5)
    parser.add_argument("--receivers", type=int, default=10)
    parser.add_argument("--octaves", action="store_true", help="8 octaves in place of 24 thirds")
    asked = parser.parse_args()
    kind: BandKind = "octave" if asked.octaves else "third-octave"
    bands = bands_between(kind, *((63, 8000) if asked.octaves else (50, 10_000)))
    room = divided_hall(asked.triangles)
    scene = hall_scene(room, asked.sources, asked.receivers)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_obj(room, folder / "hall.obj")
        write_responses(scene, bands, folder)
        (folder / "campaign.toml").write_text(campaign_text(scene, kind, bands))
        print(
            f"{len(room.mesh.triangles)} triangles, {N_MATERIALS} materials, {len(bands)} bands, "
            f"{len(scene.pairs)} pairs"
        )
        began = time.perf_counter()
        command = [sys.executable, "-m", "roomfit", "identify", str(folder / "campaign.toml")]
        done = subprocess.run([*command, "--out", str(folder / "out")], check=False)
        seconds = time.perf_counter() - began
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**20
    print(f"exit code {done.returncode}, {seconds:.0f} s, at most {peak:.2f} GiB")


if __name__ == "__main__":
    main()
