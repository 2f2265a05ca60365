"""A box of three known impedances, and pressures in it: exact waves, moved positions, noise."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from roomfit.base.air import Air
from roomfit.base.typing import ComplexArray, FloatArray
from roomfit.impedance.data import Observed, complex_frequency_hz
from roomfit.room.mesh import shoebox_mesh
from roomfit.room.scene import Point, Scene, room_from_mesh
from simulated_rooms.exact_box import damped_wavenumber_per_m, exact_box_pressure
from simulated_rooms.wall_impedances import miki_layer, r0_of_impedance, resonator

LENGTHS_M = (5.0, 4.0, 3.0)
SURFACES = ("west", "east", "south", "north", "floor", "ceiling")
SOURCES_M = ((1.2, 1.1, 1.3), (4.1, 0.9, 1.7))
RECEIVERS_M = (
    (3.7, 2.8, 2.1), (1.0, 2.9, 0.8), (4.2, 1.3, 0.6),
    (2.6, 1.9, 2.5), (2.1, 3.3, 2.4), (0.7, 0.8, 1.0),
)  # fmt: skip
PAIRS = ((0, 0), (1, 1), (0, 2), (1, 3), (0, 4), (1, 5))
WALLS: Mapping[str, str] = MappingProxyType({"ceiling": "wool", "west": "slots"})
SPEED_M_S = 343.0


def box_scene(
    walls: Mapping[str, str] = WALLS,
    *,
    move_m: float = 0.0,
    speed_m_s: float = SPEED_M_S,
    rng: np.random.Generator | None = None,
    n_pairs: int = len(PAIRS),
) -> Scene:
    """Return the box; surfaces that are not named are "plaster".

    With `rng`, every coordinate of sources and receivers is off by a normal `move_m`.
    """
    names = {s: walls.get(s, "plaster") for s in SURFACES}
    room = room_from_mesh(shoebox_mesh(LENGTHS_M), names, LENGTHS_M)

    def points(kind: str, places: tuple[tuple[float, float, float], ...]) -> tuple[Point, ...]:
        off = 0.0 if rng is None else rng.normal(scale=move_m, size=(len(places), 3))
        return tuple(Point(f"{kind}{i}", p) for i, p in enumerate(np.array(places) + off))

    air = Air(speed_of_sound_m_s=speed_m_s, attenuation="none")
    sources, receivers = points("S", SOURCES_M), points("R", RECEIVERS_M)
    return Scene(room, sources, receivers, np.array(PAIRS[:n_pairs]), air)


def true_r0(
    observed: Observed, materials: tuple[str, ...], speed_m_s: float = SPEED_M_S
) -> ComplexArray:
    """Return R0 of wool (Miki, 20 kPa s/m2, 40 mm), slots and plaster (Z about 70).

    Slots are resonators before 100 mm of 5 kPa s/m2, absorbing most at 260 Hz.
    """
    f = complex_frequency_hz(observed)
    z = {
        "wool": miki_layer(f, 20e3, 0.04, 0.0, speed_m_s),
        "slots": resonator(f, 0.2, 0.297, 0.1, 5e3, speed_m_s),
        "plaster": 70.0 - 30j * 200.0 / f,
    }
    return np.array([r0_of_impedance(z[m]) for m in materials])


def exact_pressure(
    frequency_hz: FloatArray, tau_s: float, r0: Mapping[str, ComplexArray]
) -> ComplexArray:
    """Return the exact damped spectra of the pairs, (n_pairs, n_frequencies), R0 by surface."""
    own = np.array([r0[s] for s in SURFACES])
    ends = np.array(PAIRS)
    return exact_box_pressure(
        LENGTHS_M,
        np.asarray((1.0 - own) / (1.0 + own)),
        damped_wavenumber_per_m(frequency_hz, tau_s, SPEED_M_S),
        np.array(SOURCES_M)[ends[:, 0]],
        np.array(RECEIVERS_M)[ends[:, 1]],
    )


def noisy(
    frequency_hz: FloatArray,
    tau_s: float,
    pressure: ComplexArray,
    snr_db: float,
    rng: np.random.Generator,
) -> Observed:
    """Return pressures with complex normal noise so far below their rms, and its sd."""
    rms = float(np.sqrt(np.mean(np.abs(pressure) ** 2))) * 10.0 ** (-snr_db / 20.0)
    noise = rng.normal(size=pressure.shape) + 1j * rng.normal(size=pressure.shape)
    return Observed(
        frequency_hz, tau_s, pressure + rms * noise / np.sqrt(2.0), np.full(pressure.shape, rms)
    )


def rms_by_material(
    error: ComplexArray | FloatArray,
    frequency_hz: FloatArray,
    low_hz: float = 200.0,
    high_hz: float = 1000.0,
) -> FloatArray:
    """Return the rms over some frequencies of the error of each material."""
    own = (frequency_hz >= low_hz) & (frequency_hz <= high_hz)
    return np.asarray(np.sqrt(np.mean(np.abs(error[:, own]) ** 2, axis=1)))
