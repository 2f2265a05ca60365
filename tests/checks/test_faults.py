"""Whole fits of one box: silent where it is described rightly, and the one fault that is named."""

from __future__ import annotations

import numpy as np
import pytest

import roomfit
from roomfit.base.air import Air, attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import bands_between
from roomfit.base.findings import Code
from roomfit.demo.boxes import SyntheticBox, pressure_response

LENGTHS_M, RATE_HZ = (7.0, 5.5, 4.0), 16_000
WALLS = ("west", "east", "south", "north", "floor", "ceiling")
TRUE = np.array([0.15, 0.2, 0.2, 0.12, 0.3, 0.35])
BANDS = bands_between("octave", 500, 2000)
SOURCES = {"S1": (2.1, 2.2, 1.7), "S2": (2.6, 4.1, 2.4)}
RECEIVERS = {"R1": (4.9, 3.6, 1.9), "R2": (5.8, 2.4, 2.6), "R3": (3.3, 4.4, 1.6)}


def response(absorption, s, r, seed):
    """Return the pressure of a pair by image sources with phase, 60 dB above its noise."""
    wide, rng = bands_between("octave", 250, 4000), np.random.default_rng(seed)
    table, air = np.tile(absorption[:, None], len(wide)), attenuation_per_m(Air(), wide)
    box = SyntheticBox(LENGTHS_M, wide.centres_hz, table, air, speed_of_sound_m_s(Air()))
    ends = np.array(SOURCES[s]), np.array(RECEIVERS[r])
    p = pressure_response(box, *ends, 0.5, RATE_HZ, np.zeros(5))
    return p + 1e-3 * np.abs(p).max() * rng.standard_normal(p.size)


@pytest.fixture(scope="module")
def recordings():
    pairs = [(s, r) for s in SOURCES for r in RECEIVERS]
    return [
        roomfit.Measurement(s, r, response(TRUE, s, r, seed), RATE_HZ, level="per-file")
        for seed, (s, r) in enumerate(pairs)
    ]


def found(files, known=None, **settings):
    """Return the findings of a fit by energies, all walls fixed where they are known."""
    room = roomfit.shoebox_room(LENGTHS_M, dict(zip(WALLS, WALLS, strict=True)))
    scene = roomfit.scene_of(room, SOURCES, RECEIVERS)
    fixed = [None] * len(WALLS) if known is None else known
    materials = [
        roomfit.material_prior(name, BANDS, scattering=0.0, absorption=a)
        for name, a in zip(WALLS, fixed, strict=True)
    ]
    few = {"n_rays": 2000, "n_rays_beside_images": 1000, "n_scattering_rays": 1000}
    own = roomfit.Settings(model="energy", **few, **settings)
    return roomfit.identify(scene, files, materials, BANDS, settings=own).findings


@pytest.mark.slow
def test_a_box_described_rightly_raises_no_doubt(recordings):
    assert {f.code for f in found(recordings)} <= {
        Code.BROAD_PRIOR_ASSUMED,
        Code.POSITION_UNCERTAINTY_ASSUMED,
    }


@pytest.mark.slow
def test_one_step_of_a_fit_is_none_that_converged(recordings):
    (doubt,) = [f for f in found(recordings, max_rounds=1) if f.code is Code.FIT_NOT_CONVERGED]
    assert doubt.about.bands_hz == (500.0, 1000.0, 2000.0)


@pytest.mark.slow
def test_walls_that_are_fixed_too_soft_reproduce_no_decay_and_misfit_most_bands(recordings):
    doubts = {f.code: f for f in found(recordings, 1.6 * TRUE)}
    assert Code.MODEL_MISFIT_ALL_BANDS in doubts
    decay = doubts[Code.DECAY_NOT_REPRODUCED]
    assert decay.about.bands_hz == (500.0, 1000.0, 2000.0)
    # every decay predicted too short: exp(-rate t) with a rate about 1.6 times as large
    assert all(jnd < 0.0 for band in decay.evidence["jnd"] for jnd in band.values())
