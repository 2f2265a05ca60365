"""What pyroomacoustics does with scattered energy: its images and rays together, against our rays.

    python benchmarks/other_scattering.py [--absorption 0.1] [--scattering 0.1] [--orders 3 20]

A box of 6 x 5 x 3 m with one absorption at all walls, two receivers. Energies of intervals of
time in dB over the same box with smooth walls: where walls are alike and absorb little, scattering
changes directions and takes no energy away. "Kept by its source" is what the source code keeps of
n = c t over the mean free path reflections: images (1 - s)^n, and of rays below the order of the
images only what their last wall scatters, s; from that order on rays keep all, and what walls
scatter comes on top, 1 + s.

Ours are rays that a wall scatters by Lambert's law with the probability s (`diffuse_echogram`) and
images that keep (1 - s) a reflection.
"""

from __future__ import annotations

import argparse

import numpy as np

from roomfit.base.typing import FloatArray
from roomfit.demo.boxes import ECHOGRAM_BIN_S, SyntheticBox, diffuse_echogram

LENGTHS_M = (6.0, 5.0, 3.0)
SOURCE_M, RECEIVERS_M = (1.5, 1.2, 1.4), ((4.6, 3.7, 1.7), (3.1, 4.1, 1.1))
SPEED_M_S, RATE_HZ, LATE_SAMPLES = 343.0, 16_000, 40
EDGES_S = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4)
MEAN_FREE_PATH_M = 4.0 * 90.0 / 126.0


def other(absorption: float, scattering: float, order: int, n_rays: int) -> FloatArray:
    """Return the energy of the other program's responses between the edges, mean over receivers."""
    import pyroomacoustics as pra

    np.random.seed(1)  # noqa: NPY002, which its rays are drawn with
    wall = pra.Material(energy_absorption=absorption, scattering=scattering or None)
    room = pra.ShoeBox(
        LENGTHS_M, fs=RATE_HZ, materials=wall, max_order=order, ray_tracing=n_rays > 0
    )
    room.set_sound_speed(SPEED_M_S)
    if n_rays:
        room.set_ray_tracing(n_rays=n_rays, receiver_radius=0.3, time_thres=0.6, energy_thres=1e-9)
    room.add_source(list(SOURCE_M))
    room.add_microphone_array(np.array(RECEIVERS_M).T)
    room.compute_rir()
    edges = LATE_SAMPLES + np.round(np.array(EDGES_S) * RATE_HZ).astype(int)
    energy = []
    for (response,) in room.rir:
        total = np.append(0.0, np.cumsum(np.pad(response, (0, RATE_HZ)) ** 2))
        energy.append(np.diff(total[edges]))
    return np.asarray(np.mean(energy, axis=0))


def ours(absorption: float, scattering: float) -> FloatArray:
    """Return the energy of images and of our rays between the edges, mean over receivers."""
    box = SyntheticBox(
        LENGTHS_M, np.array([1000.0]), np.full((6, 1), absorption), np.zeros(1), SPEED_M_S
    )
    receivers = np.array(RECEIVERS_M)
    total = np.zeros(len(EDGES_S) - 1)
    for at in receivers:
        places, hits = images(at)
        distance = np.linalg.norm(places - np.array(SOURCE_M), axis=1)
        keeps = ((1.0 - absorption) * (1.0 - scattering)) ** hits
        energy = keeps / (4.0 * np.pi * distance**2)
        total += np.histogram(distance / SPEED_M_S, EDGES_S, weights=energy)[0]
    if scattering:
        rays = diffuse_echogram(
            box,
            np.full(6, scattering),
            np.array(SOURCE_M),
            receivers,
            EDGES_S[-1],
            np.random.default_rng(1),
        )
        middle = (np.arange(rays.shape[2]) + 0.5) * ECHOGRAM_BIN_S
        for own in rays[:, 0]:
            total += np.histogram(middle, EDGES_S, weights=own)[0]
    return total / len(receivers)


def images(at_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the images of a point in the box, (n, 3), and how often each was reflected, (n,)."""
    reach = [int(SPEED_M_S * EDGES_S[-1] / side) + 2 for side in LENGTHS_M]
    axes = [np.arange(-n, n + 1) for n in reach]
    cells = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    sides = np.array(LENGTHS_M)
    odd = cells % 2 == 1
    return cells * sides + np.where(odd, sides - at_m, at_m), np.abs(cells).sum(axis=1)


def main() -> None:
    """Print energies over those of smooth walls, interval by interval."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--absorption", type=float, nargs="+", default=[0.01, 0.1, 0.3])
    parser.add_argument("--scattering", type=float, default=0.1)
    parser.add_argument("--orders", type=int, nargs="+", default=[3, 20])
    asked = parser.parse_args()
    s, middle = asked.scattering, 0.5 * (np.array(EDGES_S[1:]) + np.array(EDGES_S[:-1]))
    n = SPEED_M_S * middle / MEAN_FREE_PATH_M
    print("interval (ms)        " + "".join(f"{1e3 * a:7.0f}" for a in EDGES_S[:-1]))
    for absorption in asked.absorption:
        change = 10.0 * np.log10(ours(absorption, s) / ours(absorption, 0.0))
        print(line(f"a {absorption:g}, ours", change), flush=True)
        for order in asked.orders:
            smooth, rough = (other(absorption, x, order, 50_000) for x in (0.0, s))
            print(
                line(f"a {absorption:g}, order {order}", 10.0 * np.log10(rough / smooth)),
                flush=True,
            )
            kept = np.where(n < order, (1.0 - s) ** n + s, 1.0 + s)
            print(line("  kept by its source", 10.0 * np.log10(kept)))


def line(name: str, values_db: FloatArray) -> str:
    """Return one row of decibels."""
    return f"{name:<21}" + "".join(f"{v:7.2f}" for v in values_db)


if __name__ == "__main__":
    main()
