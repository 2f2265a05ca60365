"""The coherent reader: two paths by hand, derivatives, and what coherence is on average."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coherent_cases import objective_of, small_geometry, small_term
from roomfit.base.bands import Bands
from roomfit.base.typing import FloatArray
from roomfit.model.parameters import start_vector
from roomfit.model.pulses import band_grid
from roomfit.pressures.data_term import with_coherence
from roomfit.pressures.geometry import whole_covariance
from roomfit.pressures.response import (
    ImagePaths,
    Times,
    coherent_response,
)
from roomfit.signals.filters import energy_bandwidth_hz, frequency_response

BANK = Bands("octave", np.array([500.0]))
SPEED = 340.0


def two_paths() -> ImagePaths:
    """Return a path with one hit of the first material and one with two of the second."""
    return ImagePaths(
        ("one", "two"),
        np.array([0, 2]),
        np.array([0.3, 0.2]),
        np.array([[1, 0], [0, 2]], dtype=np.uint16),
        np.array([[3.0, 1.0, 2.0], [4.0, 2.0, 1.3]]),
        np.tile(np.eye(3).ravel(), (2, 1)),
        np.array([0.9, 0.8]),
        np.arange(2, dtype=np.int32),
    )


def times(latency_s: float = 1e-4) -> Times:
    """Return times with delays on both materials."""
    return Times(np.zeros((1, 6)), SPEED, np.array([latency_s]), np.array([1e-4, -2e-4]))


def test_two_paths_interfere_as_their_autocorrelation_says() -> None:
    """All energy: e1 + e2 + 2 sqrt(e1 e2) r(t2 - t1), r the filter's autocorrelation."""
    paths, a = two_paths(), np.array([0.2, 0.4])
    grid = band_grid(BANK, 0.0, 0.1)
    found = coherent_response(paths, a, times(), grid, (np.array([-0.02, 0.09]),))
    e = paths.weight * paths.coherence * np.array([0.8, 0.6**2])
    lengths = np.linalg.norm(paths.image_to_receiver_m, axis=1)
    lag = float(np.diff(lengths / SPEED + np.array([1e-4, -4e-4]))[0])
    f = np.linspace(200.0, 1100.0, 100_001)
    squared = frequency_response(BANK, f)[0] ** 2
    r = np.trapezoid(squared * np.cos(2 * np.pi * f * lag), f) / np.trapezoid(squared, f)
    expected = e.sum() + 2.0 * np.sqrt(e[0] * e[1]) * r
    # spreading is exact to 1e-5 of an amplitude, the rest rings beyond the window: 1e-4
    assert found.energy[0] == pytest.approx(expected, rel=2e-4)


@pytest.mark.slow
def test_a_windows_energy_is_the_integral_of_the_squared_pressure() -> None:
    """Against the inverse Fourier integral of the filter, point by point."""
    paths, a = two_paths(), np.array([0.2, 0.4])
    edges = np.array([0.011, 0.0135, 0.016])
    found = coherent_response(paths, a, times(), band_grid(BANK, 0.0, 0.1), (edges,)).energy
    f = np.linspace(0.0, 1100.0, 4001)
    shape = frequency_response(BANK, f)[0] / np.sqrt(2.0 * energy_bandwidth_hz(BANK)[0])
    t = np.linspace(edges[0], edges[-1], 2001)
    arrival = (
        np.linalg.norm(paths.image_to_receiver_m, axis=1) / SPEED + 1e-4 + np.array([1e-4, -4e-4])
    )
    root = np.sqrt(paths.weight * paths.coherence * np.array([0.8, 0.36]))
    phase = 2.0 * np.pi * (t[:, None, None] - arrival[:, None]) * f
    y = 2.0 * np.trapezoid(shape * np.cos(phase), f, axis=2) @ root
    for w in range(2):
        inside = (t >= edges[w]) & (t <= edges[w + 1])
        expected = np.trapezoid(y[inside] ** 2, t[inside])
        # the edges cut grid samples of a quarter millisecond
        assert found[w] == pytest.approx(expected, rel=0.01)


def test_every_column_of_the_jacobian_is_the_slope_of_the_prediction() -> None:
    """Central differences by every absorption, gain, coordinate, ln c, latency and delay."""
    problem = objective_of(with_coherence(small_term(), 0.04 * whole_covariance(small_geometry())))
    rng = np.random.default_rng(1)
    vector = start_vector(problem.parameters)
    vector[4:] = 0.3 * rng.standard_normal(vector.size - 4)
    jacobian = problem.predict(vector).jacobian
    for k in range(vector.size):
        step = np.zeros(vector.size)
        step[k] = 2e-2
        ahead, behind = (problem.predict(vector + s * step).expected for s in (1, -1))
        slope = (ahead - behind) / 4e-2
        # third derivatives and the table of the spreading kernel, both below 1e-3 of the largest
        np.testing.assert_allclose(
            jacobian[:, k], slope, rtol=0, atol=2e-3 * np.abs(slope).max(), err_msg=str(k)
        )


def test_without_coherence_it_is_the_energy_reader() -> None:
    """Prediction, derivative and variance, to rounding."""
    problem, energies = objective_of(small_term()), objective_of(small_term().energies)
    vector = start_vector(problem.parameters)
    vector[:3] += 0.3
    found = problem.predict(vector)
    plain = energies.predict(vector[:4])
    np.testing.assert_allclose(found.expected, plain.expected, rtol=1e-12)
    np.testing.assert_allclose(found.jacobian[:, :4], plain.jacobian, rtol=1e-12)
    assert not found.jacobian[:, 4:].any()
    variance = energies.variance(vector[:4])
    np.testing.assert_allclose(problem.variance(vector), variance, rtol=1e-9)


def test_random_places_have_the_energies_on_average_and_the_variance_stated() -> None:
    """Fully coherent pressures at 400 random geometries, against the partly coherent law.

    The mean of a window has a standard error of sd / 20; over some 30 correlated windows a bound
    of 4.5 of them is missed by chance in less than one of 5,000 seeds. The variance law takes the
    filtered pressure for Gaussian and interference for local: within a factor 2 in the sum.
    """
    rng = np.random.default_rng(5)
    geometry = small_geometry()
    bare = small_term()
    # places alone move, by 2 cm: a tenth of a radian to a radian at 250 Hz and both ends
    moved = np.zeros(geometry.sd.size)
    moved[:9] = 2.0
    law = objective_of(with_coherence(bare, np.diag(moved**2)))
    exact = with_coherence(bare, np.zeros((moved.size, moved.size)))
    exact = replace(
        exact,
        coherent=replace(exact.coherent, coherence=np.ones(exact.coherent.weight.size)),
        images=replace(exact.images, coherence=np.ones(exact.images.weight.size)),
    )
    fixed = objective_of(exact)
    vector = start_vector(fixed.parameters)
    draws = []
    for _ in range(400):
        at = vector.copy()
        at[4:] = moved * rng.standard_normal(moved.size)
        draws.append(fixed.predict(at).expected)
    mean, variance = np.mean(draws, axis=0), np.var(draws, axis=0, ddof=1)
    expected = law.predict(vector).expected
    error = np.sqrt(variance / 400)
    # the law takes the band's centre for all its frequencies and each window's timing for exact
    allowed = 4.5 * error + 0.03 * expected + 0.02 * expected.mean()
    assert np.all(np.abs(mean - expected) <= allowed)
    assert 0.5 < law.variance(vector).sum() / variance.sum() < 2.0


@pytest.mark.parametrize("observation", [0, 1])
def test_gamma_of_a_path_is_the_squared_mean_of_its_phasor(observation: int) -> None:
    """Direct sound, one reflection, two of one wall: arrivals moved by draws of the unknowns.

    The energy of a mean pressure is |E exp(i w t)|^2. Both ends move exactly, the source's image by
    its mirror; each path reads its own latency and the delay of its wall. What no unknown stands
    for, half a millimetre at both ends and 1e-4 of the time, comes as one more draw. Of 200,000
    draws the mean is known to .002; the curvature of lengths is below that for millimetres.
    """
    geometry, term, n = small_geometry(), small_term(2000.0), 200_000
    rng = np.random.default_rng(8)
    root = 0.4 * rng.standard_normal((geometry.sd.size, geometry.sd.size))
    root[11:] *= 0.1  # delays of walls are ten times what a radian takes
    found = with_coherence(term, root @ root.T).images
    free = rng.standard_normal((n, geometry.sd.size)) @ root.T
    own = np.arange(*found.offsets[observation : observation + 2])
    hits, per_wall = found.hits[found.row].sum(axis=1), found.hits[found.row]
    columns = geometry.columns[observation]
    w = 2.0 * np.pi * term.energies.centre_hz
    twice = np.flatnonzero((per_wall[own] == 2).any(axis=1))
    for path in (own[hits[own] == 0][0], own[hits[own] == 1][0], own[twice[0]]):
        row = found.row[path]
        image = found.image_transform[row].reshape(3, 3)
        moved = free * geometry.sd
        step = moved[:, columns[3:6]] - moved[:, columns[:3]] @ image.T
        length = np.linalg.norm(found.image_to_receiver_m[row] + step, axis=1)
        arrival = length / (SPEED * np.exp(moved[:, columns[6]])) + moved[:, columns[7]]
        arrival += moved[:, columns[8:]] @ found.hits[row]
        still = np.linalg.norm(found.image_to_receiver_m[row])
        rest = np.hypot(np.sqrt(2.0) * 0.5e-3, 1e-4 * still) / SPEED
        arrival += rest * rng.standard_normal(n)
        expected = np.abs(np.mean(np.exp(1j * w * arrival))) ** 2
        assert 0.1 < expected < 0.9
        assert found.coherence[path] == pytest.approx(expected, abs=0.01)


def many_paths(n_observations: int) -> tuple[ImagePaths, Times, tuple[FloatArray, ...]]:
    """Return images drawn at random, times of their own and windows for so many observations."""
    rng, n = np.random.default_rng(11), 40
    size = n * n_observations
    paths = ImagePaths(
        ("one", "two"),
        np.arange(0, size + 1, n),
        rng.uniform(0.1, 1.0, size),
        rng.integers(0, 4, (size, 2)).astype(np.uint16),
        rng.uniform(1.0, 12.0, (size, 3)),
        np.tile(np.eye(3).ravel(), (size, 1)),
        rng.uniform(0.2, 1.0, size),
        np.arange(size, dtype=np.int32),
    )
    moved = Times(
        rng.normal(0.0, 0.01, (n_observations, 6)),
        SPEED,
        rng.normal(0.0, 1e-5, n_observations),
        np.array([1e-4, -2e-4]),
    )
    return paths, moved, tuple(np.linspace(0.0, 0.07, 12) for _ in range(n_observations))


def test_single_precision_is_finer_than_the_grid() -> None:
    """Energies and derivatives to 1e-6 of the largest; the grid is exact to 1e-5."""
    paths, moved, edges = many_paths(5)
    grid, a = band_grid(BANK, 0.0, 0.1), np.array([0.2, 0.4])
    single, double = (
        coherent_response(paths, a, moved, replace(grid, real=d), edges)
        for d in (np.float32, np.float64)
    )
    for name in ("energy", "by_log_reflected", "by_times"):
        found, expected = getattr(single, name), getattr(double, name)
        np.testing.assert_allclose(found, expected, atol=2e-6 * np.abs(expected).max(), rtol=0.0)
        assert np.any(found != expected)
