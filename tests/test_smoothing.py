"""Smoothness over bands: limits, and the same numbers by dense algebra of another form."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.bands import Bands, bands_between
from roomfit.errors import InputError
from roomfit.uncertainty.smoothing import smooth_over_bands


def _answers(rng: np.random.Generator, n_bands: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    roots = rng.normal(size=(n_bands, n, n)) + 0.5 * np.eye(n)
    return rng.normal(size=(n_bands, n)), roots @ np.swapaxes(roots, 1, 2)


def test_the_information_form_gives_the_same_posterior():
    """Precisions add: those of the bands, and the walk's on every pair of neighbours."""
    bands = bands_between("third-octave", 100, 1000)
    n_bands, n, sd = len(bands), 3, 0.4
    means, covariances = _answers(np.random.default_rng(1), n_bands, n)
    precision = np.zeros((n_bands, n, n_bands, n))
    vector = np.zeros((n_bands, n))
    for b in range(n_bands):
        precision[b, :, b, :] += np.linalg.inv(covariances[b])
        vector[b] = np.linalg.inv(covariances[b]) @ means[b]
    centres = bands.exact_centres_hz
    for b in range(n_bands - 1):
        w = np.eye(n) / (sd**2 * np.log2(centres[b + 1] / centres[b]))
        for p, q, sign in ((b, b, 1), (b + 1, b + 1, 1), (b, b + 1, -1), (b + 1, b, -1)):
            precision[p, :, q, :] += sign * w
    joint = np.linalg.inv(precision.reshape(n_bands * n, n_bands * n))
    got_means, got_covariances = smooth_over_bands(means, covariances, sd, bands)
    # Conditioning below 1e5 and 30 unknowns: 1e-9 leaves room for either way's rounding.
    np.testing.assert_allclose(got_means.ravel(), joint @ vector.ravel(), rtol=0, atol=1e-9)
    blocks = joint.reshape(n_bands, n, n_bands, n)
    for b in range(n_bands):
        np.testing.assert_allclose(got_covariances[b], blocks[b, :, b, :], rtol=0, atol=1e-9)


def test_a_walk_without_bounds_changes_nothing():
    bands = bands_between("octave", 125, 4000)
    means, covariances = _answers(np.random.default_rng(2), len(bands), 2)
    for sd in (1e7, np.inf):
        got = smooth_over_bands(means, covariances, sd, bands)
        np.testing.assert_allclose(got[0], means, rtol=0, atol=1e-10)
        np.testing.assert_allclose(got[1], covariances, rtol=0, atol=1e-10)


def test_a_walk_that_stands_still_gives_the_mean_weighed_by_precision():
    bands = bands_between("octave", 125, 4000)
    means, covariances = _answers(np.random.default_rng(3), len(bands), 2)
    precisions = np.linalg.inv(covariances)
    pooled = np.linalg.inv(precisions.sum(axis=0))
    mean = pooled @ np.einsum("bij,bj->i", precisions, means)
    got = smooth_over_bands(means, covariances, 1e-5, bands)
    # A step of 1e-5 an octave lets bands differ by some 1e-5 times their pull.
    np.testing.assert_allclose(got[0], np.tile(mean, (len(bands), 1)), rtol=0, atol=1e-6)
    np.testing.assert_allclose(got[1], np.tile(pooled, (len(bands), 1, 1)), rtol=0, atol=1e-6)


def test_a_held_material_stays_and_draws_its_neighbours():
    bands = bands_between("octave", 500, 1000)
    means = np.array([[0.0], [2.0]])
    covariances = np.array([[[0.0]], [[1.0]]])
    got_means, got_covariances = smooth_over_bands(means, covariances, 1.0, bands)
    # One octave apart with variance 1 each: the free band ends half way, with half the variance
    # (0.3 log2(10) = 0.9966 octaves by IEC 61260-1, hence not exactly).
    np.testing.assert_allclose(got_means.ravel(), [0.0, 1.0], rtol=0, atol=5e-3)
    np.testing.assert_allclose(got_covariances.ravel(), [0.0, 0.5], rtol=0, atol=5e-3)


def test_what_does_not_belong_together_is_refused():
    bands = Bands("octave", np.array([500.0, 1000.0]))
    means, covariances = np.zeros((2, 1)), np.ones((2, 1, 1))
    with pytest.raises(InputError, match="no spread"):
        smooth_over_bands(means, covariances, 0.0, bands)
    with pytest.raises(InputError, match="do not belong together"):
        smooth_over_bands(means[:1], covariances, 0.5, bands)
    with pytest.raises(InputError, match="do not belong together"):
        smooth_over_bands(means, covariances[:, 0], 0.5, bands)
