"""The independent box with scattering walls: energy kept, Lambert's law, levels of its noise."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from roomfit.base.typing import FloatArray
from roomfit.demo.boxes import SyntheticBox, box_images
from simulated_rooms.scattering_box import ECHOGRAM_BIN_S, diffuse_echogram

LENGTHS_M = (5.1, 4.2, 2.9)
C = 340.0
VOLUME_M3 = float(np.prod(LENGTHS_M))
DURATION_S = 0.12
PLACES = np.random.default_rng(8).uniform(0.4, np.array(LENGTHS_M) - 0.4, (24, 3))


def truth(alpha: float, attenuation: float = 0.0) -> SyntheticBox:
    """One octave at 1 kHz, every wall alike."""
    return SyntheticBox(
        LENGTHS_M, np.array([1000.0]), np.full((6, 1), alpha), np.array([attenuation]), C
    )


def specular_energy(box: SyntheticBox, s: float, receiver: FloatArray, edges_s: FloatArray):
    """Return the energy of thinned images in windows."""
    lengths, hits = box_images(box, np.array([1.2, 1.5, 1.1]), receiver, DURATION_S)
    kept = (1.0 - box.absorption[:, 0]) * (1.0 - s)
    energy = np.prod(kept**hits, axis=1) / (4.0 * np.pi * lengths**2)
    return np.histogram(lengths / C, edges_s, weights=energy)[0]


@pytest.mark.parametrize("s", [0.15, 0.6, 1.0])
def test_without_absorption_the_energy_in_the_room_stays(s):
    """Thinned images and scattered rays together arrive at the rate c / V, whatever s.

    A mean over 24 receivers at random; five of its standard errors are allowed, each about 1 %.
    """
    rng = np.random.default_rng(1)
    source = np.array([1.2, 1.5, 1.1])
    found = diffuse_echogram(
        truth(0.0), np.full(6, s), source, PLACES, DURATION_S, rng, n_rays=4000
    )
    edges = np.array([0.04, 0.08, 0.12])
    for low, high in pairwise(edges):
        bins = slice(round(low / ECHOGRAM_BIN_S), round(high / ECHOGRAM_BIN_S))
        diffuse = found[:, 0, bins].sum(axis=1)
        specular = [specular_energy(truth(0.0), s, p, np.array([low, high]))[0] for p in PLACES]
        total = diffuse + specular
        error = total.std(ddof=1) / np.sqrt(len(PLACES))
        assert error < 0.04 * total.mean()
        assert total.mean() == pytest.approx(C * (high - low) / VOLUME_M3, abs=5.0 * error)


def test_every_hit_takes_the_same_share_in_a_room_of_even_walls():
    """The decay of a fully scattering box is Eyring's for small absorption, air included.

    Within 3 %: Eyring's own law is right to 2 % at alpha = 0.05 in a box of ordinary shape.
    """
    rng = np.random.default_rng(2)
    box = truth(0.05, attenuation=0.002)
    found = diffuse_echogram(
        box, np.ones(6), np.array([1.2, 1.5, 1.1]), PLACES[:8], 0.4, rng, n_rays=6000
    )
    energy = found[:, 0].sum(axis=0).reshape(-1, 40).sum(axis=1)  # 20 ms
    late = np.arange(3, energy.size)
    rate = -np.polyfit(0.02 * late, np.log(energy[late]), 1)[0]
    surface = 2.0 * sum(VOLUME_M3 / length for length in LENGTHS_M)
    expected = C * (-surface * np.log(0.95) / (4.0 * VOLUME_M3) + 0.002)
    assert rate == pytest.approx(expected, rel=0.03)
