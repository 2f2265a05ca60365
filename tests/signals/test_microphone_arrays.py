"""Beams of arrays and ambisonics, against plane waves and against sums over the sphere."""

from __future__ import annotations

import numpy as np
import pytest

from _microphone_arrays import (
    BEAM_AXES,
    ambisonic_beams,
    array_beams,
    array_weights,
    beam_patterns,
    capsule_responses,
    cross_patterns,
    level_errors,
)
from roomfit.base.bands import Bands
from roomfit.base.errors import InputError
from roomfit.signals.filters import window_energies
from roomfit.signals.response import ImpulseResponse

RATE_HZ, C = 32_000.0, 343.0
CAPSULES_M = np.array(
    [[0, 0, 0], [0.047, 0, 0], [-0.047, 0, 0], [0, 0.033, 0.035], [0, -0.033, 0.035],
     [0, 0.033, -0.035], [0, -0.033, -0.035]]
)  # fmt: skip


def sphere(n: int) -> np.ndarray:
    """Return directions spread evenly by the golden angle, (n, 3)."""
    z = 1.0 - (2.0 * np.arange(n) + 1.0) / n
    azimuth = np.arange(n) * np.pi * (3.0 - np.sqrt(5.0))
    across = np.sqrt(1.0 - z**2)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), z], 1)


def plane_wave(u: np.ndarray, capsules_m: np.ndarray, n: int = 4096) -> np.ndarray:
    """Return an impulse from direction u at every capsule, early where it is nearer, (n_c, n)."""
    f = np.fft.rfftfreq(n, 1.0 / RATE_HZ)
    early_s = capsules_m @ u / C
    spectrum = np.exp(-2j * np.pi * f * (0.5 * n / RATE_HZ - early_s[:, None]))
    spectrum[:, -1] = 0.0
    return np.fft.irfft(spectrum, n)


@pytest.mark.parametrize("convention", ["ambix", "fuma"])
def test_beams_of_ambisonics_are_cardioids_about_the_axes_of_the_room(convention):
    """Encoded by the definition of each format, the microphone turned and tilted."""
    yaw, tilt = np.radians([30.0, 20.0])
    front = np.array([np.cos(tilt) * np.cos(yaw), np.cos(tilt) * np.sin(yaw), np.sin(tilt)])
    left = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    axes = np.stack([front, left, np.cross(front, left)])
    for u in sphere(20):
        x, y, z = axes @ u
        coded = [1.0, y, z, x] if convention == "ambix" else [np.sqrt(0.5), x, y, z]
        beams = ambisonic_beams(np.array(coded)[:, None], convention, axes)
        expected = [1.0, *(0.5 * (1.0 + a @ u) for a in BEAM_AXES)]
        np.testing.assert_allclose(beams[:, 0], expected, atol=1e-12)
        np.testing.assert_allclose(beam_patterns(u[None])[0], expected, atol=1e-12)


def test_other_formats_and_too_few_channels_are_refused():
    """With what was found and what is needed."""
    with pytest.raises(InputError, match="unknown format"):
        ambisonic_beams(np.zeros((4, 8)), "sn3d", np.eye(3))
    with pytest.raises(InputError, match="too few channels"):
        ambisonic_beams(np.zeros((3, 8)), "ambix", np.eye(3))
    with pytest.raises(InputError, match="differ in number"):
        array_beams(np.zeros((6, 8)), RATE_HZ, CAPSULES_M, C)


@pytest.mark.parametrize("frequency_hz", [200.0, 1000.0, 4000.0])
def test_weights_have_the_least_error_over_all_directions(frequency_hz):
    """Against least squares over 4,000 plane waves; a sum over so many has errors of 1e-4."""
    u, e = sphere(4000), 0.03
    pressures = np.exp(2j * np.pi * frequency_hz * u @ CAPSULES_M.T / C) / np.sqrt(len(u))
    wanted = beam_patterns(u) / np.sqrt(len(u))
    rows = np.vstack([pressures, e * np.eye(len(CAPSULES_M))])
    right = np.vstack([wanted, np.zeros((len(CAPSULES_M), wanted.shape[1]))])
    expected = np.linalg.lstsq(rows, right.astype(complex), rcond=None)[0].T
    (found,) = array_weights(CAPSULES_M, np.array([frequency_hz]), C, e)
    np.testing.assert_allclose(found, expected, atol=3e-3 * np.abs(expected).max())


@pytest.mark.parametrize("centre_hz", [250.0, 1000.0, 4000.0])
def test_a_plane_wave_has_the_energy_that_the_pattern_states(centre_hz):
    """Filtered in time against means over 24 frequencies: a hundredth of the beams' maximum."""
    bank = Bands("octave", np.array([centre_hz]))
    directions = sphere(25)
    (cross,) = cross_patterns(bank, directions, CAPSULES_M, C)
    for u, own in zip(directions, cross, strict=True):
        beams = array_beams(plane_wave(u, CAPSULES_M), RATE_HZ, CAPSULES_M, C)
        whole = np.array([0.0, 4096.0]) / RATE_HZ
        energy = [window_energies(bank, ImpulseResponse(b, RATE_HZ), whole)[0, 0] for b in beams]
        np.testing.assert_allclose(energy, np.diagonal(own).real, atol=0.01)


def test_beams_of_a_small_array_are_nearly_ideal_between_its_limits():
    """At 500 Hz within a hundredth of the maximum; at 4 kHz capsules stand too far apart."""
    u = sphere(500)
    bands = Bands("octave", np.array([500.0, 1000.0, 2000.0, 4000.0]))
    found, ideal = (cross_patterns(bands, u, *more) for more in ((CAPSULES_M, C), ()))
    off = np.sqrt(np.mean(np.abs(found - ideal) ** 2, axis=1)).max(axis=(1, 2))
    assert off[0] < 0.01
    assert off[3] > 0.1


def test_errors_of_capsules_make_the_errors_of_patterns_that_are_stated():
    """Two hundred arrays, 400 directions: the rms of 1400 errors is known to 2 %, 8 % is four."""
    rng, e, centre_hz = np.random.default_rng(1), 0.01, 1000.0
    bank = Bands("octave", np.array([centre_hz]))
    law = level_errors(bank, CAPSULES_M, C, e)[0]
    u = sphere(400)
    (own,) = array_weights(CAPSULES_M, np.array([centre_hz]), C, e)
    pressure = np.exp(2j * np.pi * centre_hz * u @ CAPSULES_M.T / C)
    errors = rng.standard_normal((200, 7)) + 1j * rng.standard_normal((200, 7))
    off = np.einsum("dm,nm,bm->nbd", pressure, e * np.sqrt(0.5) * errors, own)
    power = np.mean(np.abs(pressure @ own.T) ** 2, axis=0)
    scatter = np.sqrt(np.mean(np.abs(off) ** 2, axis=(0, 2)) / power)
    np.testing.assert_allclose(2.0 * scatter, law, rtol=0.08)


def test_responses_of_capsules_are_found_from_direct_sounds_of_known_directions():
    """Planted levels and delays, 24 directions; a residual where one sound differs.

    A source in 1,000 km stands for a plane wave: distances are rounded to 1e-10 m.
    """
    azimuth = np.radians(np.arange(0, 360, 15))
    u = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)], 1)
    direct = np.array([plane_wave(d, CAPSULES_M, 512) for d in u])
    f = np.fft.rfftfreq(512, 1.0 / RATE_HZ)
    level = np.array([1.0, 0.4, 0.5, 0.3, 0.35, 0.4, 0.45])
    late_s = 1e-6 * np.array([0.0, 3.0, -4.0, 8.0, 2.0, -6.0, 1.0])
    planted = level[:, None] * np.exp(-2j * np.pi * f * late_s[:, None])
    recorded = np.fft.irfft(np.fft.rfft(direct, axis=2) * planted, 512, axis=2)
    found, residual = capsule_responses(recorded, RATE_HZ, u, CAPSULES_M, C)
    inside = (f > 100.0) & (f < 10_000.0)
    np.testing.assert_allclose(found[:, inside], planted[:, inside], atol=1e-6)
    assert residual[:, inside].max() < 1e-6
    recorded[3, 2] *= 1.24  # one sound of 24, by .24: .24 / sqrt(24) of the whole
    _, residual = capsule_responses(recorded, RATE_HZ, u, CAPSULES_M, C)
    np.testing.assert_allclose(residual[2, inside], 0.24 / np.sqrt(24.0), rtol=0.05)
    # and beams of the corrected channels are those of equal capsules
    wave = plane_wave(u[5], CAPSULES_M, 512)
    coloured = np.fft.irfft(np.fft.rfft(wave, axis=1) * planted, 512, axis=1)
    right, equal = (
        array_beams(x, RATE_HZ, CAPSULES_M, C, responses=r)
        for x, r in ((coloured, planted), (wave, None))
    )
    np.testing.assert_allclose(right, equal, atol=2e-3 * np.abs(equal).max())
