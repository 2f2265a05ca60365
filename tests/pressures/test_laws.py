"""A simulated box whose walls and loudspeaker are known, identified by pressures."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import roomfit
from roomfit.base.typing import FloatArray
from roomfit.model.patterns import UnknownDirectivity

SIZE_M, SPEED_M_S, RATE_HZ = np.array([3.9, 3.1, 2.5]), 343.99, 16_000
SOURCE_M = np.array([1.0, 1.2, 1.1])
PLACES_M = {
    "A": (2.9, 2.2, 1.3),
    "B": (3.1, 0.9, 1.6),
    "C": (0.7, 2.5, 1.7),
    "D": (2.2, 0.6, 0.8),
    "E": (3.4, 1.7, 2.0),
}
ABSORPTION = {"walls": 0.15, "carpet": 0.4, "tiles": 0.3}


def recording(place_m: tuple[float, ...], b: FloatArray) -> FloatArray:
    """Return 0.3 s of pressure, of a source with the amplitude 1 + b u in the direction u.

    Images of the source by parity and period of the box; noise at -60 dB of the peak.
    """
    n_samples, finer = 4800, 8
    walls, carpet, tiles = (1.0 - ABSORPTION[k] for k in ("walls", "carpet", "tiles"))
    pressure = np.zeros(n_samples * finer)
    reach = [int(SPEED_M_S * n_samples / RATE_HZ / size) + 2 for size in SIZE_M]
    n = np.stack(np.meshgrid(*(np.arange(-k, k + 1) for k in reach), indexing="ij"), axis=-1)
    for p in itertools.product((0, 1), repeat=3):
        mirrored = 1 - 2 * np.array(p)
        away = place_m - (mirrored * SOURCE_M + 2 * n * SIZE_M)
        r = np.linalg.norm(away, axis=-1)
        low, high = np.abs(n - p), np.abs(n)
        energy = walls ** (low + high)[..., :2].sum(axis=-1) * carpet ** low[..., 2]
        energy *= tiles ** high[..., 2]
        # each mirror turns one component of the direction in which sound leaves the source
        amplitude = 1.0 + (away * mirrored / r[..., None]) @ b
        at = np.round(r / SPEED_M_S * RATE_HZ * finer).astype(int)
        heard = at < pressure.size
        np.add.at(pressure, at[heard], (np.sqrt(energy) * amplitude / (4.0 * np.pi * r))[heard])
    sampled = np.fft.irfft(np.fft.rfft(pressure)[: n_samples // 2 + 1], n_samples)
    noise = np.random.default_rng(round(1e3 * sum(place_m))).standard_normal(sampled.size)
    return np.asarray(sampled + 1e-3 * np.abs(sampled).max() * noise)


def identified(b: FloatArray, places: str, **more: object) -> roomfit.Result:
    """Return what pressures say of the box from 250 Hz to 1 kHz, walls without delay."""
    materials = dict.fromkeys(("west", "east", "south", "north"), "walls")
    materials |= {"floor": "carpet", "ceiling": "tiles"}
    room = roomfit.shoebox_room(tuple(SIZE_M.tolist()), materials)
    own = {name: PLACES_M[name] for name in places}
    receivers = [roomfit.Point(name, np.array(place), 0.002) for name, place in own.items()]
    scene = roomfit.scene_of(room, [roomfit.Point("S", SOURCE_M, 0.002)], receivers)
    octaves = roomfit.bands_between("octave", 250.0, 1000.0)
    priors = [roomfit.material_prior(k, octaves, scattering=0.0) for k in ABSORPTION]
    measured = [
        roomfit.Measurement("S", name, recording(place, b), RATE_HZ) for name, place in own.items()
    ]
    settings = roomfit.Settings(model="coherent", quick=True, reflection_delays=False)
    return roomfit.identify(scene, measured, priors, octaves, settings=settings, **more)


@pytest.mark.slow
def test_pressures_find_the_absorption_of_a_simulated_box_within_two_hundredths():
    result = identified(np.zeros(3), "ABC")
    assert set(result.models) == {"coherent"}
    known = np.array([ABSORPTION[name] for name in result.materials])
    np.testing.assert_allclose(result.absorption, np.tile(known[:, None], 3), rtol=0, atol=0.02)


@pytest.mark.slow
def test_pressures_find_how_a_source_radiates_along_with_the_walls():
    """A source between omnidirectional and cardioid; five places tell b within a tenth."""
    b = np.array([0.5, -0.2, 0.1])
    result = identified(b, "ABCDE", directivities={"S": UnknownDirectivity()})
    (found,) = result.directivities
    np.testing.assert_allclose(found.b, np.tile(b, (3, 1)), rtol=0, atol=0.1)
    known = np.array([ABSORPTION[name] for name in result.materials])
    np.testing.assert_allclose(result.absorption, np.tile(known[:, None], 3), rtol=0, atol=0.05)
