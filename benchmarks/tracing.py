"""How fast rays are, against pyroomacoustics and Embree in the same run, and what they cost.

    python benchmarks/tracing.py            about two minutes

A segment is one flight of a ray from a wall (or the source) to the next wall. Speeds are millions
of segments per second of processor time, all threads together, best of three after a warm-up, so
that other programs on the machine disturb little. Ratios are printed and nothing is asserted: they
depend on the processor.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial

import numba
import numpy as np
import pyroomacoustics as pra
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from roomfit.materials.priors import uniform_scattering
from roomfit.paper.room import SPEED_OF_SOUND_M_S, paper_scene
from roomfit.room.mesh import corners_m
from roomfit.room.scene import Scene
from roomfit.tracing.bvh import WAITING, Walls, next_wall, walls_of
from roomfit.tracing.paths import TraceSettings
from roomfit.tracing.rays import fibonacci_directions, trace_rays
from simulated_rooms.hall import hall_room

REPEATS = 3


def processor_s(job: Callable[[], object]) -> float:
    """Return the processor time of a job, best of three after one to warm up."""
    job()
    best = np.inf
    for _ in range(REPEATS):
        start = time.process_time()
        job()
        best = min(best, time.process_time() - start)
    return float(best)


def paper_room_table() -> None:
    """Print segments per second in the paper's room: 7 planes, one pair, specular, 1 s."""
    scene = paper_scene()
    scene = Scene(scene.room, scene.sources[:1], scene.receivers[:1], np.array([[0, 0]]), scene.air)
    n_rays, duration_s = 20_000, 1.0
    settings = TraceSettings(
        duration_s, n_rays=n_rays, image_order=-1, directions="fibonacci", n_batches=1
    )
    room = _pra_room(scene, n_rays, duration_s)
    print(f"\n## The paper's room (reconstructed; 7 planes), {n_rays:,} rays for 1 s, one pair")
    print(
        "Counted: whole calls with receiver and recording. Rays end by time in both, so that both"
    )
    print("make the same number of segments, counted in roomfit (directions differ a little).")
    print("pyroomacoustics runs on one thread and cannot scatter without a shadow ray at each hit.")
    print("| tracer | threads | million segments | per CPU second | ratio |")
    print("|---|---|---|---|---|")
    theirs = 0.0
    for s in (0.0, 1.0):
        still = uniform_scattering(scene.room.materials, s)
        n_hits = trace_rays(scene, settings, still).n_hits
        segments = (n_hits + n_rays) / 1e6  # every ray has one flight more than hits
        if s == 0.0:
            theirs = segments / processor_s(room.ray_tracing)
            name = f"pyroomacoustics {pra.__version__}, specular"
            print(f"| {name} | 1 | {segments:.2f} | {theirs:.1f} | 1 |")
        for threads in (1, 2):
            ours = segments / _on_threads(threads, partial(trace_rays, scene, settings, still))
            name = "roomfit, " + ("diffuse" if s else "specular")
            print(f"| {name} | {threads} | {segments:.2f} | {ours:.1f} | {ours / theirs:.1f} |")


def _on_threads(threads: int, job: Callable[[], object]) -> float:
    before = numba.get_num_threads()
    numba.set_num_threads(min(threads, before))
    seconds = processor_s(job)
    numba.set_num_threads(before)
    return seconds


def _pra_room(scene: Scene, n_rays: int, duration_s: float) -> pra.Room:
    """Return the same room there.

    An absorption of 0.05 ends no ray by energy before its time is up (that would take 314 hits),
    but rids it soon of rays that single precision has caught in an edge.
    """
    mesh = scene.room.mesh
    walls = []
    for k in range(len(mesh.surfaces)):
        outline = _outline(mesh.triangles[mesh.triangle_surface == k])
        walls.append(pra.wall_factory(mesh.vertices_m[outline].T, [0.05], [0.0], f"wall {k}"))
    room = pra.Room(walls, fs=8000, max_order=0, ray_tracing=True, air_absorption=False)
    room.set_sound_speed(SPEED_OF_SOUND_M_S)
    room.set_ray_tracing(
        n_rays=n_rays, receiver_radius=0.5, energy_thres=1e-7, time_thres=duration_s
    )
    room.add_source(scene.sources[0].position_m)
    room.add_microphone(scene.receivers[0].position_m)
    room.ray_tracing()
    return room


def _outline(triangles: np.ndarray) -> list[int]:
    """Return the corners of a polygon in order from the triangles that fill it."""
    edges = [(int(t[i]), int(t[(i + 1) % 3])) for t in triangles for i in range(3)]
    after = dict(e for e in edges if e[::-1] not in edges)
    corners = [next(iter(after))]
    while len(corners) < len(after):
        corners.append(after[corners[-1]])
    return corners


def hall_table() -> None:
    """Print rays per second in halls with seats, for the very segments of a specular trace."""
    print(
        "\n## Closed hall with seats: the same segments (20,000 rays, 20 flights each) one by one"
    )
    print("Counted: finding the nearest triangle only; embreex is one call for all segments.")
    print("| triangles | tracer | million segments per CPU second | roomfit against it | lost |")
    print("|---|---|---|---|---|")
    for n_triangles in (1012, 12_012, 100_012):
        room = hall_room(n_triangles)
        walls = walls_of(room)
        starts, directions = _segments(walls)
        n = len(starts)
        lost = int(np.isinf(distances_m(walls, starts, directions)).sum())
        ours = n / processor_s(partial(distances_m, walls, starts, directions))
        print(f"| {n_triangles:,} | roomfit, float64 | {ours / 1e6:.2f} | | {lost} |")
        scene = EmbreeScene()
        TriangleMesh(scene, corners_m(room.mesh).astype(np.float32))
        start, direction = starts.astype(np.float32), directions.astype(np.float32)
        missed = int((scene.run(start + 1e-4 * direction, direction) < 0).sum())
        embree = partial(scene.run, start + 1e-4 * direction, direction)
        speed = n / processor_s(embree)
        print(f"| | embreex | {speed / 1e6:.3g} | {ours / speed:.2f} | {missed} |")


def _segments(walls: Walls) -> tuple[np.ndarray, np.ndarray]:
    """Return starts and directions of 20 flights of 20,000 specular rays, ray after ray."""
    directions = fibonacci_directions(20_000)
    starts = np.tile([3.0, 0.1, 1.5], (len(directions), 1))
    all_starts, all_directions = [], []
    for _ in range(20):
        all_starts.append(starts)
        all_directions.append(directions)
        flights, walls_met = _nearest(walls, starts, directions)
        normals = walls.normal[walls_met]
        starts = starts + flights[:, None] * directions
        across = np.einsum("ij,ij->i", directions, normals)
        directions = directions - 2.0 * across[:, None] * normals
    return (
        np.ascontiguousarray(np.stack(all_starts, axis=1).reshape(-1, 3)),
        np.ascontiguousarray(np.stack(all_directions, axis=1).reshape(-1, 3)),
    )


def distances_m(walls: Walls, starts: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return the distance to the nearest wall of each ray."""
    found: np.ndarray = _nearest(walls, starts, directions)[0]
    return found


@numba.njit(nogil=True, error_model="numpy")
def _nearest(walls, starts, directions):  # type: ignore[no-untyped-def]
    distance, wall = np.empty(len(starts)), np.empty(len(starts), np.int64)
    waiting = np.empty(WAITING, np.int32)
    for i in range(len(starts)):
        o = (starts[i, 0], starts[i, 1], starts[i, 2])
        d = (directions[i, 0], directions[i, 1], directions[i, 2])
        distance[i], wall[i] = next_wall(walls, o, d, -1, waiting)
    return distance, wall


def main() -> None:
    """Print all tables."""
    argparse.ArgumentParser(description="Speed and cost of tracing rays.").parse_args()
    paper_room_table()
    hall_table()


if __name__ == "__main__":
    main()
