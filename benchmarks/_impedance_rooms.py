"""Boxes, walls and measurements at random with exact wave fields, for `benchmarks/impedance.py`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roomfit.base.air import Air
from roomfit.base.typing import ComplexArray, FloatArray
from roomfit.impedance.data import Observed, complex_frequency_hz
from roomfit.room.mesh import shoebox_mesh
from roomfit.room.scene import Point, Scene, room_from_mesh
from simulated_rooms.exact_box import damped_wavenumber_per_m, exact_box_pressure
from simulated_rooms.impedance_box import SURFACES, noisy
from simulated_rooms.wall_impedances import miki_layer, panel, r0_of_impedance, resonator

SPEED_M_S = 343.0
F_HZ = np.arange(100.0, 1001.0, 25.0)
TAU_S = 0.010
PLACES = 8  # two sources, six receivers


class Case(NamedTuple):
    """A room as specified, the measurement, and the truth.

    Attributes
    ----------
    scene : Scene
        With the specified positions and speed of sound: wrong by `move_m` and `speed`.
    observed : Observed
    r0 : complex array, shape (n_materials, n_frequencies)
    kinds : tuple of str
        Of the materials.
    snr_db, move_m, speed : float
    coloured : bool
        Whether each source has an unknown spectrum.
    """

    scene: Scene
    observed: Observed
    r0: ComplexArray
    kinds: tuple[str, ...]
    snr_db: float
    move_m: float
    speed: float
    coloured: bool


def random_wall(f: ComplexArray, rng: np.random.Generator) -> tuple[str, ComplexArray]:
    """Return a wall of any kind, and its R0."""
    kind = rng.integers(6)
    if kind == 0:
        sigma = 10.0 ** rng.uniform(3.7, 4.7)
        z = miki_layer(f, sigma, rng.uniform(0.02, 0.1), 0.0, SPEED_M_S)
        name = "layer"
    elif kind == 1:
        sigma = 10.0 ** rng.uniform(3.7, 4.7)
        z = miki_layer(f, sigma, rng.uniform(0.02, 0.06), rng.uniform(0.02, 0.2), SPEED_M_S)
        name = "gap"
    elif kind == 2:
        sigma = 10.0 ** rng.uniform(3.0, 4.0)
        losses, mass, depth = rng.uniform([0.1, 0.1, 0.04], [1.0, 0.6, 0.15])
        z = resonator(f, losses, mass, depth, sigma, SPEED_M_S)
        name = "resonator"
    elif kind == 3:
        losses, mass, depth = rng.uniform([0.3, 2.0, 0.03], [3.0, 8.0, 0.1])
        z = panel(f, losses, mass, depth, SPEED_M_S)
        name = "panel"
    else:
        z = 10.0 ** rng.uniform(1.0, 2.0) - 1j * rng.uniform(0.0, 20.0) * 200.0 / f
        name = "hard"
    return name, r0_of_impedance(z)


def _apart(positions_m: FloatArray, sides: FloatArray, pairs: FloatArray) -> bool:
    """Whether every pair stands far enough apart for a sum of modes."""
    steps = np.abs(positions_m[pairs[:, 0]] - positions_m[2 + pairs[:, 1]])
    near = np.linalg.norm(steps, axis=1).min()
    return bool(near > 0.8 and steps.max(axis=1).min() > 0.12 * sides.max())


def random_case(seed: int, n_materials: int | None = None, n_pairs: int | None = None) -> Case:
    """Return a box of 3 to 8 m with 1 to 6 materials and 1 to 6 pairs.

    At 20 or 40 dB; half of them with coordinates off by a normal 10 mm and the speed of sound by
    0.3 %; a third of those with 4 pairs and more with sources of unknown spectra. The pairs are at
    least as many as the materials, less one.
    """
    rng = np.random.default_rng(seed)
    sides = rng.uniform([3.5, 3.0, 2.4], [8.0, 6.0, 4.0])
    n = int(rng.integers(1, 7)) if n_materials is None else n_materials
    pairs_wanted = int(rng.integers(max(n - 1, 1), 7)) if n_pairs is None else n_pairs
    owner = np.concatenate([np.arange(n), rng.integers(0, n, size=6 - n)])
    names = ["abcdef"[i] for i in rng.permutation(owner)]
    f = complex_frequency_hz(Observed(F_HZ, TAU_S, np.ones((1, len(F_HZ)), dtype=complex)))
    walls = {m: random_wall(f, rng) for m in sorted(set(names))}
    pairs = np.array([(0, 0), (1, 1), (0, 2), (1, 3), (0, 4), (1, 5)][:pairs_wanted])
    positions_m = rng.uniform(0.1, 0.9, size=(PLACES, 3)) * sides
    while not _apart(positions_m, sides, pairs):
        positions_m = rng.uniform(0.1, 0.9, size=(PLACES, 3)) * sides
    own = np.array([walls[m][1] for m in names])
    lengths = (float(sides[0]), float(sides[1]), float(sides[2]))
    field = exact_box_pressure(
        lengths,
        np.asarray((1.0 - own) / (1.0 + own)),
        damped_wavenumber_per_m(F_HZ, TAU_S, SPEED_M_S),
        positions_m[pairs[:, 0]],
        positions_m[2 + pairs[:, 1]],
    )
    snr_db = float(rng.choice([20.0, 40.0]))
    move_m, speed = (0.01, 0.003 * rng.choice([-1.0, 1.0])) if rng.random() < 0.5 else (0.0, 0.0)
    room = room_from_mesh(shoebox_mesh(lengths), dict(zip(SURFACES, names, strict=True)), lengths)
    specified = positions_m + rng.normal(size=positions_m.shape) * move_m
    points = [Point(f"P{i}", p) for i, p in enumerate(specified)]
    air = Air(speed_of_sound_m_s=SPEED_M_S * (1.0 + speed), attenuation="none")
    scene = Scene(room, tuple(points[:2]), tuple(points[2:]), pairs, air)
    coloured = len(pairs) >= 4 and rng.random() < 1.0 / 3.0
    if coloured:
        size, phase = rng.normal(size=(2, 2, len(F_HZ)))
        field = field * np.exp(0.5 * size + 1j * phase)[pairs[:, 0]]
    observed = noisy(F_HZ, TAU_S, field, snr_db, rng)
    kinds = tuple(walls[m][0] for m in room.materials)
    true = np.array([walls[m][1] for m in room.materials])
    return Case(scene, observed, true, kinds, snr_db, move_m, float(speed), coloured)
