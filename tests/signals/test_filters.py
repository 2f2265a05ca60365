"""The filter bank: its two front ends speak of the same energies."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from roomfit.base.bands import BandKind, Bands, bands_between
from roomfit.signals.filters import (
    energy_bandwidth_hz,
    energy_share,
    filter_pressure,
    frequency_response,
    spreading_kernel,
    spreading_matrix,
    spreading_slopes_per_s,
    statistical_bandwidth_hz,
    window_energies,
)
from roomfit.signals.response import ImpulseResponse

KINDS: tuple[BandKind, ...] = ("octave", "third-octave")
RATE_HZ = 48_000.0


def bank(kind: BandKind = "octave", from_hz: float = 63.0, to_hz: float = 8000.0) -> Bands:
    return bands_between(kind, from_hz, to_hz)


def lone_sample(n: int, at: int) -> ImpulseResponse:
    pressure = np.zeros(n)
    pressure[at] = 1.0
    return ImpulseResponse(pressure, RATE_HZ)


@pytest.mark.parametrize("kind", KINDS)
def test_squared_magnitudes_of_all_bands_add_up_to_one_between_the_outer_centres(kind):
    """Nothing is lost and nothing counted twice, at any frequency."""
    b = bank(kind)
    f = np.geomspace(b.exact_centres_hz[0], b.exact_centres_hz[-1], 5000)
    np.testing.assert_allclose((frequency_response(b, f) ** 2).sum(axis=0), 1.0, rtol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_magnitudes_meet_class_1_of_iec_61260(kind):
    """Table 1 of IEC 61260-1:2014; third octaves by its rule for fractional octaves."""
    b = bank(kind, 1000.0, 1000.0)
    steps = {"octave": 1.0, "third-octave": 3.0}[kind]
    octave_ratio = 10.0**0.3
    for exponent, least_db, most_db in (
        (0.0, -0.4, 0.4),
        (1 / 8, -0.4, 0.5),
        (1 / 4, -0.4, 0.7),
        (3 / 8, -0.4, 1.4),
        (1 / 2, 1.6, 5.3),
        (1.0, 16.6, np.inf),
        (2.0, 40.5, np.inf),
        (3.0, 60.0, np.inf),
        (4.0, 70.0, np.inf),
    ):
        of_octave = octave_ratio**exponent
        edge = (octave_ratio ** (0.5 / steps) - 1.0) / (octave_ratio**0.5 - 1.0)
        ratio = 1.0 + edge * (of_octave - 1.0)
        for f in (1000.0 * ratio, 1000.0 / ratio):
            with np.errstate(divide="ignore"):
                loss_db = -20.0 * np.log10(frequency_response(b, [f])[0, 0])
            assert least_db <= loss_db <= most_db, (exponent, f)


@pytest.mark.parametrize("kind", KINDS)
def test_the_bands_of_an_impulse_are_centred_on_it_without_delay(kind):
    """The delay of every band is the same, zero: each filtered impulse is symmetric about it."""
    at = 40_000
    filtered = filter_pressure(bank(kind), lone_sample(80_001, at))
    np.testing.assert_allclose(filtered, filtered[:, ::-1], atol=1e-12 * filtered.max())
    assert np.all(np.argmax(filtered, axis=1) == at)


@pytest.mark.parametrize("kind", KINDS)
def test_the_smearing_kernel_is_the_squared_filtered_impulse(kind):
    """The table of the second front end, recomputed by filtering an impulse with the first."""
    b = bank(kind, 125.0, 4000.0)
    kernel = spreading_kernel(b)
    at = 60_000
    filtered = filter_pressure(b, lone_sample(120_001, at))
    edges = (np.array([-at, -2000.0, -50.0, -7.0, 0.0, 3.0, 40.0, 900.0, at]) - 0.5) / RATE_HZ
    for band, p in enumerate(filtered):
        share = energy_share(kernel, band, [0.0], edges)[0]
        bounds = np.round(edges * RATE_HZ + 0.5).astype(int) + at
        energy = [np.sum(p[i:j] ** 2) for i, j in itertools.pairwise(bounds)]
        # A sample stands for its surroundings: the sum is a midpoint rule, good to
        # (pi f / rate)^2 / 3 = 8 % of the curvature in the 4 kHz band, 1e-3 of the energy below.
        np.testing.assert_allclose(share, np.array(energy) / np.sum(p**2), atol=2e-2)


@pytest.mark.slow
def test_measured_and_predicted_window_energies_agree_on_average():
    """Impulses of random sign through the first front end give the second one's sum.

    With random signs the cross terms vanish on average. 250 draws of a decay of 200 impulses; the
    mean of each window must lie within 5 of its own standard errors. With 5 bands x 7 windows and
    normal errors the chance of a false alarm is 35 * 5.7e-7 = 2.0e-5.
    """
    rng, rate_hz = np.random.default_rng(2024), 0.5 * RATE_HZ
    b = bank("octave", 125.0, 2000.0)
    edges = np.array([-0.05, 0.004, 0.01, 0.02, 0.04, 0.08, 0.16, 0.4])
    samples = np.sort(rng.choice(np.arange(50, 4800), 200, replace=False))
    delays = samples / rate_hz
    amplitude = np.exp(-delays / 0.05) * rng.uniform(0.2, 1.0, 200)

    draws = []
    for _ in range(250):
        pressure = np.zeros(10_000)
        pressure[samples] = amplitude * rng.choice([-1.0, 1.0], 200)
        draws.append(window_energies(b, ImpulseResponse(pressure, rate_hz), edges))
    measured = np.mean(draws, axis=0)
    standard_error = np.std(draws, axis=0, ddof=1) / np.sqrt(len(draws))

    kernel = spreading_kernel(b)
    predicted = np.array(
        [amplitude**2 @ energy_share(kernel, i, delays, edges) for i in range(len(b))]
    )
    # the midpoint rule of the test above allows 1e-3 of a window's energy besides
    assert np.all(np.abs(measured - predicted) < 5.0 * standard_error + 1e-3 * predicted)


def test_statistical_bandwidth_is_what_the_spread_of_noise_energy_shows():
    """The relative variance of band energy of white noise over T is 1 / (B T).

    600 blocks of 0.5 s; the estimate of a variance from n values has a relative standard error of
    sqrt(2 / n) = 5.8 %; 4 of them allowed in 5 bands: false alarm 5 * 6.3e-5 = 3e-4.
    """
    rng = np.random.default_rng(11)
    b = bank("octave", 125.0, 2000.0)
    rate_hz, block, n_blocks = 8000.0, 4000, 600
    noise = ImpulseResponse(rng.standard_normal(block * n_blocks), rate_hz)
    energy = (filter_pressure(b, noise) ** 2).reshape(len(b), n_blocks, block).sum(axis=2)
    relative_variance = energy.var(axis=1) / energy.mean(axis=1) ** 2
    np.testing.assert_allclose(
        relative_variance * statistical_bandwidth_hz(b) * block / rate_hz, 1.0, rtol=0.24
    )


def test_energy_bandwidth_is_half_the_energy_that_a_lone_sample_leaves_per_sampling_rate():
    """A sample of height one has the two-sided spectral density one: Parseval."""
    b = bank()
    filtered = filter_pressure(b, lone_sample(200_001, 100_000))
    np.testing.assert_allclose(
        (filtered**2).sum(axis=1) * RATE_HZ, 2.0 * energy_bandwidth_hz(b), rtol=1e-6
    )


@pytest.mark.parametrize("band", [0, 3, 5])
def test_shares_of_many_impulses_are_those_of_each(band):
    """The sparse matrix holds `energy_share` to 1e-7, its slopes those of the cumulative share."""
    kernel = spreading_kernel(bands_between("octave", 125, 4000))
    edges = np.sort(np.random.default_rng(band).uniform(0.0, 0.35, 12))
    delays = np.arange(-0.03, 0.4, 1e-4)
    dense = energy_share(kernel, band, delays, edges).T
    found = spreading_matrix(kernel, band, delays, edges)
    np.testing.assert_allclose(found.toarray(), dense, atol=2e-7)
    # hundreds of responses have thousands of these: 64 bits would be a third more memory
    assert found.indices.dtype == found.indptr.dtype == np.int32
    # half a step of the table to either side: the derivative that the table itself has there
    h = 0.5 / 256 / kernel.centres_hz[band]
    later, earlier = (energy_share(kernel, band, delays + s * h, edges).T for s in (1, -1))
    slopes = spreading_slopes_per_s(kernel, band, delays, edges).toarray()
    np.testing.assert_allclose(
        slopes, (later - earlier) / (2 * h), atol=0.01 * np.abs(slopes).max()
    )
