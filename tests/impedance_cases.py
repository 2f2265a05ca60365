"""The box of exact_M3.npz: walls, positions, truth; and measurements made from it."""

from __future__ import annotations

import numpy as np

from roomfit.air import Air
from roomfit.geometry.shoebox import shoebox_mesh
from roomfit.impedance.observed import Observed, complex_frequency_hz
from roomfit.materials.impedance_laws import miki_layer, r0_of_impedance, resonator
from roomfit.scene.rooms import room_from_mesh
from roomfit.scene.scene import Point, Scene

LENGTHS_M = (5.0, 4.0, 3.0)
SURFACES = ("west", "east", "south", "north", "floor", "ceiling")
SOURCES_M = ((1.2, 1.1, 1.3), (4.1, 0.9, 1.7))
RECEIVERS_M = (
    (3.7, 2.8, 2.1), (1.0, 2.9, 0.8), (4.2, 1.3, 0.6),
    (2.6, 1.9, 2.5), (2.1, 3.3, 2.4), (0.7, 0.8, 1.0),
)  # fmt: skip
PAIRS = ((0, 0), (1, 1), (0, 2), (1, 3), (0, 4), (1, 5))


def box_scene(walls=None, *, move_m=0.0, speed=343.0, rng=None, n_pairs=6):
    """The box with ceiling "wool", west "slots" and else "plaster", every coordinate moved."""
    walls = {"ceiling": "wool", "west": "slots"} if walls is None else walls
    names = {s: walls.get(s, "plaster") for s in SURFACES}
    room = room_from_mesh(shoebox_mesh(LENGTHS_M), names, LENGTHS_M)

    def points(kind, places):
        off = rng.normal(scale=move_m, size=(len(places), 3)) if move_m else 0.0
        moved = np.array(places) + off
        return tuple(Point(f"{kind}{i}", p) for i, p in enumerate(moved))

    air = Air(speed_of_sound_m_s=speed, attenuation="none")
    sources, receivers = points("S", SOURCES_M), points("R", RECEIVERS_M)
    return Scene(room, sources, receivers, np.array(PAIRS[:n_pairs]), air)


def true_r0(observed, materials, speed=343.0):
    """R0 of the materials of the data's README at the frequencies behind the window."""
    f = complex_frequency_hz(observed)
    z = {
        "wool": miki_layer(f, 20e3, 0.04, 0.0, speed),
        "slots": resonator(f, 0.2, 0.297, 0.1, 5e3, speed),
        "plaster": 70.0 - 30j * 200.0 / f,
    }
    return np.array([r0_of_impedance(z[m]) for m in materials])


def noisy(frequency_hz, tau_s, pressure, snr_db, rng):
    """Pressures with complex normal noise so far below their rms; the noise told."""
    rms = np.sqrt(np.mean(np.abs(pressure) ** 2)) * 10.0 ** (-snr_db / 20.0)
    noise = rng.normal(size=pressure.shape) + 1j * rng.normal(size=pressure.shape)
    return Observed(
        frequency_hz, tau_s, pressure + rms * noise / np.sqrt(2.0), np.full(pressure.shape, rms)
    )


def exact(data, name="exact_M3", snr_db=None, rng=None):
    """The exact fields of the data folder; without noise the noise is told to be none."""
    file = np.load(data / "impedance_exact" / f"{name}.npz")
    f, tau, p = file["f"], float(file["tau"]), file["p"].T
    if snr_db is None:
        return Observed(f, tau, p, np.zeros(p.shape))
    return noisy(f, tau, p, snr_db, rng)


def rms_by_material(error, frequency_hz, low=200.0, high=1000.0):
    own = (frequency_hz >= low) & (frequency_hz <= high)
    return np.sqrt(np.mean(np.abs(error[:, own]) ** 2, axis=1))
