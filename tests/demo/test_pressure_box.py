"""The simulator behind the demo, against closed forms."""

from __future__ import annotations

import numpy as np

from roomfit.demo.boxes import SyntheticBox, add_noise, box_images, loudspeaker, pressure_response

CENTRES = np.array([125.0, 250.0, 500.0, 1000.0, 2000.0])


def truth(absorption: float) -> SyntheticBox:
    return SyntheticBox((5.0, 4.0, 3.0), CENTRES, np.full((6, 5), absorption), np.zeros(5), 343.0)


def test_images_of_a_box_number_its_volume_into_the_sphere_they_fill():
    """Images fill space with one per room volume: 4/3 pi (c T)^3 / V of them within c T."""
    lengths, _ = box_images(truth(0.1), np.array([1.0, 1.5, 1.2]), np.array([4, 2.5, 1.7]), 0.2)
    expected = 4.0 / 3.0 * np.pi * (343.0 * 0.2) ** 3 / 60.0
    # lattice points of a sphere of radius R: the error is of the order of its surface, 3 a / R
    np.testing.assert_allclose(lengths.size, expected, rtol=3.0 * 4.0 / (343.0 * 0.2) / 4)


def test_first_order_images_are_the_mirror_points():
    """The six shortest paths with one hit are distances to the source mirrored in each wall."""
    s, r = np.array([1.0, 1.5, 1.2]), np.array([4.0, 2.5, 1.7])
    lengths, hits = box_images(truth(0.1), s, r, 0.1)
    for wall, (axis, plane) in enumerate(
        [(0, 0.0), (0, 5.0), (1, 0.0), (1, 4.0), (2, 0.0), (2, 3.0)]
    ):
        mirror = s.copy()
        mirror[axis] = 2.0 * plane - s[axis]
        only = (hits.sum(axis=1) == 1) & (hits[:, wall] == 1)
        np.testing.assert_allclose(lengths[only], np.linalg.norm(mirror - r), rtol=1e-12)


def test_the_direct_sound_of_black_walls_is_the_point_source():
    """With absorption 1 only 1 / (4 pi r) at r / c is left, here integrated over its pulse."""
    s, r = np.array([1.0, 1.5, 1.2]), np.array([4.0, 2.5, 1.7])
    distance = float(np.linalg.norm(s - r))
    p = pressure_response(truth(1.0), s, r, 0.1, 8000.0, np.zeros(5))
    assert abs(int(np.argmax(np.abs(p))) / 8000.0 - distance / 343.0) < 1.5 / 8000.0
    # of the 0 to 4000 Hz that an impulse of one sample fills, five octaves pass all from 125 to
    # 2000 Hz, and beyond, with f = f0 2**u, the integral of ((1 + cos(pi u)) / 2)**2
    u = np.linspace(0.0, 1.0, 2001)
    fade = (0.5 * (1.0 + np.cos(np.pi * u))) ** 2 * np.log(2.0)
    above = np.trapezoid(2000.0 * 2.0**u * fade, u)
    below = np.trapezoid(125.0 * 2.0**-u * fade, u)
    share = (2000.0 - 125.0 + above + below) / 4000.0
    np.testing.assert_allclose(np.sum(p**2), share / (4.0 * np.pi * distance) ** 2, rtol=0.02)


def test_noise_has_the_level_that_was_asked_for():
    p = np.zeros(200_000)
    p[10] = 2.0
    noise = add_noise(p, -40.0, np.random.default_rng(3)) - p
    # standard error of an rms over 200,000 samples is 0.16 %; 1 % is six of them
    np.testing.assert_allclose(np.std(noise), 0.02, rtol=0.01)


def test_a_loudspeaker_has_the_level_of_its_curve_at_every_frequency_and_nothing_before_zero():
    """Magnitude to rounding, from 0 Hz to half of the sampling rate; minimum phase is causal."""
    centres, level_db = 125.0 * 2.0 ** np.arange(5), np.array([3.0, -6.0, 0.0, 4.0, -2.0])
    f = np.linspace(0.0, 4000.0, 129)
    spectrum = loudspeaker(centres, level_db, f)
    wanted = np.interp(np.log2(np.maximum(f, 1.0)), np.log2(centres), level_db)
    np.testing.assert_allclose(20.0 * np.log10(np.abs(spectrum)), wanted, atol=1e-12)
    # of the logarithm, whose second half is that before zero
    angle = np.unwrap(np.angle(spectrum))
    cepstrum = np.fft.irfft(np.log(np.abs(spectrum)) + 1j * angle)
    assert np.abs(cepstrum[129:]).max() < 1e-12 < 1e-4 < np.abs(cepstrum[1:128]).max()


def test_the_sound_of_a_loudspeaker_is_that_of_a_flat_one_times_its_curve_at_every_frequency():
    """Black walls leave one pulse, far from either end of the response."""
    s, r, levels_db = np.array([1.0, 1.5, 1.2]), np.array([4.0, 2.5, 1.7]), np.zeros(5)
    levels_db[2:4] = 6.0, -4.0
    flat, own = (
        np.fft.rfft(pressure_response(truth(1.0), s, r, 0.2, 8000.0, x), 3200)
        for x in (np.zeros(5), levels_db)
    )
    f = np.linspace(0.0, 4000.0, 1601)
    heard = np.abs(flat) > 0.2 * np.abs(flat).max()
    curve = loudspeaker(CENTRES, levels_db, f)
    np.testing.assert_allclose(own[heard] / flat[heard], curve[heard], atol=0.03)
    assert np.ptp(np.abs(curve[heard])) > 1.0
