"""What one evaluation costs: against a new simulation in another program, and by size.

    python benchmarks/response.py

First the error function of the paper (equation (1), its room, 18,000 rays, two materials) with its
Jacobian against what a search without recorded paths must do instead: trace again. The other
program is pyroomacoustics; only its ray tracing itself is timed, with the paper's number of rays,
sphere and 0.2 s, not the building of its room. Then tables of time and memory, and a directed
source in one pass beside its rows weighed one derivative after the other. All in one run on
one machine; the least of several repetitions, threads as numba finds them.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numba
import numpy as np

from roomfit.materials.priors import uniform_scattering
from roomfit.model.patterns import (
    RowPattern,
    amplitude_and_slope,
    directed_rows,
    weigh_parts,
)
from roomfit.model.weighing import EnergyRows, energy_rows, weigh
from roomfit.paper.room import (
    DIVISIONS,
    DURATION_S,
    N_RAYS,
    RECEIVER_RADIUS_M,
    SPEED_OF_SOUND_M_S,
    TRUE_ABSORPTION,
    arrivals_ms,
    paper_scene,
    residuals,
    squares_problem,
    trace_paper_room,
    whole_windows_s,
)
from roomfit.room.mesh import corners_m
from roomfit.room.scene import Room, Scene
from roomfit.tracing.image_sources import trace_images

REPETITIONS = 7


def seconds(run: Callable[[], object], *, repetitions: int = REPETITIONS, inner: int = 1) -> float:
    """Return the least wall time of one call, after one call that warms up."""
    run()
    best = np.inf
    for _ in range(repetitions):
        start = time.perf_counter()
        for _ in range(inner):
            run()
        best = min(best, (time.perf_counter() - start) / inner)
    return best


def two_material_scene() -> Scene:
    """Return the paper's room with floor and ceilings as one material and the walls as another."""
    full = paper_scene()
    room = Room(full.room.mesh, DIVISIONS[2].materials, np.array(DIVISIONS[2].group))
    return Scene(room, full.sources[:1], full.receivers[:1], full.pairs[:1], full.air)


def random_rows(n_rows: int, n_materials: int, n_windows: int = 100) -> EnergyRows:
    """Return rows with some eight hits on each material, as a trace of a second has."""
    rng = np.random.default_rng(1)
    cuts = np.sort(rng.integers(0, n_rows, n_windows - 1))
    return EnergyRows(
        tuple(f"material {m}" for m in range(n_materials)),
        n_windows,
        np.concatenate(([0], cuts, [n_rows])),
        rng.random(n_rows),
        rng.poisson(8.0, (n_rows, n_materials)).astype(np.uint16),
        rng.uniform(0.0, 300.0, n_rows),
        np.zeros(n_rows, dtype=np.int32),
        1,
    )


def seconds_to_weigh(rows: EnergyRows, n_bands: int, *, derivative: bool = True) -> float:
    """Return the time of one evaluation in some bands, with air."""
    a = np.full((len(rows.materials), n_bands), 0.3)
    air = np.full(n_bands, 0.002)
    return seconds(lambda: weigh(rows, a, air, derivative=derivative))


def seconds_of_new_simulation(scene: Scene) -> float:
    """Return what pyroomacoustics takes to trace the same room, rays, sphere and duration."""
    import pyroomacoustics as pra

    group = DIVISIONS[2].group
    mesh = scene.room.mesh
    walls = [
        pra.wall_factory(triangle.T, [TRUE_ABSORPTION[group[surface]]], [0.0], str(i))
        for i, (triangle, surface) in enumerate(
            zip(corners_m(mesh), mesh.triangle_surface, strict=True)
        )
    ]
    room = pra.Room(walls, fs=16000, max_order=-1, ray_tracing=True, air_absorption=False)
    room.set_sound_speed(SPEED_OF_SOUND_M_S)
    room.set_ray_tracing(
        n_rays=N_RAYS,
        receiver_radius=RECEIVER_RADIUS_M,
        time_thres=DURATION_S,
        energy_thres=1e-30,
        hist_bin_size=0.001,
    )
    room.add_source(scene.sources[0].position_m)
    room.add_microphone(scene.receivers[0].position_m)

    def run() -> None:
        room.simulator_state["rt_done"] = False
        room.ray_tracing()

    return seconds(run, repetitions=3)


def paper_evaluation() -> None:
    """Print one evaluation of the paper's error function against one new simulation."""
    scene = two_material_scene()
    paths = trace_paper_room(scene)
    _, first_reflection_ms = arrivals_ms(paths, 0)
    rows = energy_rows(paths, 0, whole_windows_s(first_reflection_ms, 5), SPEED_OF_SOUND_M_S)
    truth = np.array(TRUE_ABSORPTION)
    measured = weigh(rows, truth[:, None], np.zeros(1)).energy[0]
    problem = squares_problem(rows, measured)
    start = np.array([0.3, 0.7])
    merged_s = seconds(lambda: residuals(problem, start), inner=200)
    plain_s = seconds(lambda: weigh(rows, start[:, None], np.zeros(1)), inner=200)
    own_trace_s = seconds(lambda: trace_paper_room(scene), repetitions=3)
    print(f"paper's error function: {N_RAYS} rays, 2 materials, {rows.n_windows} windows of 5 ms")
    print(f"  recorded rows {len(rows)}, after merging equal ones {len(problem.rows)}")
    print(f"  evaluation with Jacobian, rows merged      {1e3 * merged_s:9.4f} ms")
    print(f"  evaluation with Jacobian, rows as recorded {1e3 * plain_s:9.4f} ms")
    print(f"  new trace in roomfit                       {1e3 * own_trace_s:9.1f} ms")
    try:
        other_s = seconds_of_new_simulation(scene)
    except ImportError:
        print("  pyroomacoustics is not installed: pip install 'roomfit[bench]'")
        return
    print(f"  new simulation in pyroomacoustics          {1e3 * other_s:9.1f} ms")
    print(f"  ratio, rows merged {other_s / merged_s:.0f}, as recorded {other_s / plain_s:.0f}")


def cost_tables() -> None:
    """Print time and memory against rows, materials and bands."""
    print("\nrows (7 materials, 1 band): time with Jacobian, without, memory of the rows")
    for n in (10**3, 10**4, 10**5, 10**6, 5 * 10**6):
        rows = random_rows(n, 7)
        memory = n * (8 + 2 * 7 + 8 + 4) / 2**20
        both = [seconds_to_weigh(rows, 1, derivative=d) for d in (True, False)]
        print(f"  {n:>9} {1e3 * both[0]:9.3f} ms {1e3 * both[1]:9.3f} ms {memory:9.2f} MiB")
    print("\nmaterials (1,000,000 rows, 1 band): time with Jacobian, memory of the rows")
    for m in (2, 4, 8, 16, 32):
        memory = 10**6 * (20 + 2 * m) / 2**20
        print(
            f"  {m:>3} {1e3 * seconds_to_weigh(random_rows(10**6, m), 1):9.2f} ms {memory:9.2f} MiB"
        )
    print("\nbands in one pass (1,000,000 rows, 7 materials): time with Jacobian, and per band")
    rows = random_rows(10**6, 7)
    for b in (1, 2, 6, 12, 24):
        took = seconds_to_weigh(rows, b)
        print(f"  {b:>3} {1e3 * took:9.2f} ms {1e3 * took / b:9.2f} ms")


def directed_table() -> None:
    """Print a directed source's rows in one pass beside rows weighed once for each derivative."""
    rows, a, air = random_rows(100_000, 6), np.full(6, 0.3), 0.0
    basis = np.random.default_rng(2).standard_normal((len(rows), 3))
    pattern = RowPattern(np.array([0.5, -0.3, 0.2]), basis)

    def one_by_one() -> None:
        amplitude, slope = amplitude_and_slope(pattern.b, basis)
        weigh(directed_rows(rows, amplitude**2), a[:, None], np.array([air]))
        for column in (2.0 * amplitude[:, None] * slope).T:
            weigh(directed_rows(rows, column), a[:, None], np.array([air]), derivative=False)

    both = [
        seconds(lambda: weigh_parts(rows, pattern, a, air, derivative=True)),
        seconds(one_by_one),
    ]
    print("\ndirected source (100,000 rows, 6 materials): in one pass, row by row, ratio")
    print(f"  {1e3 * both[0]:9.2f} ms {1e3 * both[1]:9.2f} ms {both[1] / both[0]:6.1f}")


def image_tables() -> None:
    """Print what image sources of the paper's room cost by order."""
    scene = paper_scene()
    one = Scene(scene.room, scene.sources[:1], scene.receivers[:1], scene.pairs[:1], scene.air)
    still = uniform_scattering(scene.room.materials, 0.0)
    print("\nimage sources of the paper's room, one pair, no limit of length: images found, time")
    for order in range(1, 9):
        took = seconds(lambda: trace_images(one, order, 1.0, still), repetitions=3)  # noqa: B023
        print(
            f"  order {order} {len(trace_images(one, order, 1.0, still)):6d} {1e3 * took:9.2f} ms"
        )


if __name__ == "__main__":
    print(f"numba threads: {numba.get_num_threads()}")
    paper_evaluation()
    cost_tables()
    directed_table()
    image_tables()
