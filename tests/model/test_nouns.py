"""The nouns of `roomfit.core`: a room traced once, and an objective of a kind of data of one's own."""  # noqa: E501

from __future__ import annotations

import numpy as np
import pytest

from roomfit.base.air import attenuation_per_m
from roomfit.base.bands import bands_between
from roomfit.fit.traced_room import trace_room
from roomfit.room.scene import distances_m, scene_of, shoebox_room
from roomfit.settings import Settings
from roomfit.uncertainty.posterior import AbsorptionPosterior

NAMES = ("T20_s", "C80_dB", "G_dB")
BANDS = bands_between("octave", 500, 1000)


@pytest.fixture(scope="module")
def room():
    lengths, receivers = (5.0, 4.0, 3.0), {"R": (3.5, 2.8, 1.2), "Q": (4.1, 1.0, 1.5)}
    materials = {"floor": "carpet", "ceiling": "plaster", "walls": "plaster"}
    scene = scene_of(shoebox_room(lengths, materials), {"S": (1.2, 1.0, 1.5)}, receivers)
    a = np.array([[{"carpet": 0.4, "plaster": 0.2}[m]] * 2 for m in scene.room.materials])
    n = len(a)
    known = AbsorptionPosterior(
        scene.room.materials, BANDS, a, 0.9 * a, 1.1 * a, np.stack([0.01 * np.eye(n)] * 2),
        scattering=np.full((n, 2), 0.3),
    )  # fmt: skip
    return trace_room(scene, known, settings=Settings(n_rays=4000, seed=1)), a


def test_derivatives_of_room_parameters_are_those_of_their_differences(room):
    """Central differences over .002 in absorption; levels bend at every bin, where T20 has kinks."""  # noqa: E501
    traced, a = room
    values, slopes = traced.predict(a, NAMES)
    assert slopes.shape == (*values.shape, len(a))
    for material in range(len(a)):
        step = np.zeros_like(a)
        step[material] = 1e-3
        high, low = (traced.predict(a + sign * step, NAMES)[0] for sign in (1.0, -1.0))
        expected = (high - low) / 2e-3
        scale = np.abs(slopes).max(axis=(0, 2, 3))[:, None]
        assert np.all(np.abs(slopes[..., material] - expected) < [[0.01], [1e-4], [1e-4]] * scale)


def test_the_first_energy_of_a_pair_is_that_of_its_direct_sound(room):
    """``exp(-m r) / (4 pi r^2)``; the next sound comes a wall later."""
    traced, a = room
    energies = traced.energies(a)
    air = attenuation_per_m(traced.scene.air, BANDS)
    for pair, r in enumerate(distances_m(traced.scene)):
        first = energies[pair][:, np.argmax(energies[pair].any(axis=0))]
        np.testing.assert_allclose(first, np.exp(-air * r) / (4.0 * np.pi * r**2), rtol=1e-9)
