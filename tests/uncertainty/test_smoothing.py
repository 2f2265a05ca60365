"""Smoothness over bands: limits, and the same numbers by dense algebra of another form."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.base.bands import Bands, bands_between
from roomfit.base.errors import InputError
from roomfit.uncertainty.smoothing import smooth_over_bands


def diagonal(sd: np.ndarray) -> np.ndarray:
    """Return the covariance of independent numbers, (n_bands, n, n) of (n_bands, n)."""
    return sd[:, :, None] ** 2 * np.eye(sd.shape[1])


class Case:
    """Data of each band about n materials, and the answers they give under separate priors."""

    def __init__(self, seed: int, bands: Bands, n: int) -> None:
        rng = np.random.default_rng(seed)
        self.n_bands, self.n = len(bands), n
        roots = rng.normal(size=(self.n_bands, n, n)) + 0.5 * np.eye(n)
        self.data = roots @ np.swapaxes(roots, 1, 2)  # information
        self.observed = rng.normal(size=(self.n_bands, n))
        self.prior_mean = rng.normal(size=(self.n_bands, n))
        self.prior_sd = rng.uniform(0.8, 2.0, (self.n_bands, n))
        alone = [np.diag(sd**-2.0) for sd in self.prior_sd]
        self.covariances = np.linalg.inv(self.data + alone)
        self.pull = np.einsum("bij,bj->bi", self.data, self.observed)
        pulls = self.pull + self.prior_mean / self.prior_sd**2
        self.means = np.einsum("bij,bj->bi", self.covariances, pulls)

    def smooth(self, sd: float, bands: Bands) -> tuple[np.ndarray, np.ndarray]:
        return smooth_over_bands(
            self.means, self.covariances, self.prior_mean, diagonal(self.prior_sd), sd, bands
        )


def test_the_answer_is_that_of_all_data_under_one_prior():
    """Its covariance written out: the product of the correlations between two bands."""
    bands = bands_between("third-octave", 100, 1000)
    case, sd = Case(1, bands, 3), 0.4
    octaves = np.diff(np.log2(bands.exact_centres_hz))
    n_bands, n = case.n_bands, case.n
    prior = np.zeros((n_bands, n, n_bands, n))
    for i in range(n):
        s = case.prior_sd[:, i]
        r = 1.0 - sd**2 * octaves / (2.0 * s[1:] * s[:-1])
        for p in range(n_bands):
            for q in range(p, n_bands):
                prior[p, i, q, i] = prior[q, i, p, i] = s[p] * s[q] * np.prod(r[p:q])
    prior = prior.reshape(n_bands * n, n_bands * n)
    data = np.zeros((n_bands, n, n_bands, n))
    for b in range(n_bands):
        data[b, :, b, :] = case.data[b]
    data = data.reshape(prior.shape)
    joint = np.linalg.inv(np.linalg.inv(prior) + data)
    right = np.linalg.solve(prior, case.prior_mean.ravel()) + case.pull.ravel()
    got_means, got_covariances = case.smooth(sd, bands)
    # Conditioning below 1e6 and 33 unknowns: 1e-8 leaves room for either way's rounding.
    np.testing.assert_allclose(got_means.ravel(), joint @ right, rtol=0, atol=1e-8)
    blocks = joint.reshape(n_bands, n, n_bands, n)
    for b in range(n_bands):
        np.testing.assert_allclose(got_covariances[b], blocks[b, :, b, :], rtol=0, atol=1e-8)


def test_a_walk_without_bounds_changes_nothing():
    bands = bands_between("octave", 125, 4000)
    case = Case(2, bands, 2)
    for sd in (3.0, 1e7, np.inf):
        got = case.smooth(sd, bands)
        np.testing.assert_allclose(got[0], case.means, rtol=0, atol=1e-10)
        np.testing.assert_allclose(got[1], case.covariances, rtol=0, atol=1e-10)


def test_a_walk_that_stands_still_holds_the_prior_once():
    """The precision of one unknown is the sum of all data's and of a single prior's."""
    bands = bands_between("octave", 125, 4000)
    case = Case(3, bands, 2)
    case.prior_mean[:] = case.prior_mean[0]
    case.prior_sd[:] = case.prior_sd[0]
    alone = np.diag(case.prior_sd[0] ** -2.0)
    case.covariances = np.linalg.inv(case.data + alone)
    pulls = case.pull + alone @ case.prior_mean[0]
    case.means = np.einsum("bij,bj->bi", case.covariances, pulls)
    pooled = np.linalg.inv(case.data.sum(axis=0) + alone)
    mean = pooled @ (case.pull.sum(axis=0) + alone @ case.prior_mean[0])
    got = case.smooth(1e-3, bands)
    # A step of 1e-3 an octave lets bands differ by some 1e-3**2 times their pull, a few tens.
    np.testing.assert_allclose(got[0], np.tile(mean, (len(bands), 1)), rtol=0, atol=1e-4)
    np.testing.assert_allclose(got[1], np.tile(pooled, (len(bands), 1, 1)), rtol=0, atol=1e-4)


def test_bands_without_data_take_what_their_neighbours_say_and_no_more():
    """Six answers that are their prior stay it: nothing is learnt from the same guess again."""
    bands = bands_between("octave", 125, 4000)
    mean, sd = np.full((6, 1), -1.7), np.full((6, 1), 1.5)
    got = smooth_over_bands(mean, (sd**2)[:, :, None], mean, diagonal(sd), 0.5, bands)
    np.testing.assert_allclose(got[0], mean, atol=1e-12)
    np.testing.assert_allclose(got[1], (sd**2)[:, :, None], rtol=1e-9)


def test_intervals_hold_where_walls_walk_as_specified():
    """Walls of the prior and the step, seen with noise: 95 % intervals hold 95 % of them.

    4800 values, six of a wall: a share off by four of its standard errors, were all of one wall
    one value, happens once in 16,000 seeds.
    """
    rng = np.random.default_rng(4)
    bands = bands_between("octave", 125, 4000)
    n_walls, step, spread = 800, 0.5, 1.5
    r = 1.0 - step**2 * np.diff(np.log2(bands.exact_centres_hz)) / (2.0 * spread**2)
    z = np.empty((6, n_walls))
    z[0] = rng.standard_normal(n_walls)
    for b, own in enumerate(r):
        z[b + 1] = own * z[b] + np.sqrt(1.0 - own**2) * rng.standard_normal(n_walls)
    truth = -1.7 + spread * z
    noise = rng.uniform(0.3, 6.0, truth.shape)
    observed = truth + noise * rng.standard_normal(truth.shape)
    variance = 1.0 / (1.0 / noise**2 + 1.0 / spread**2)
    alone = variance * (observed / noise**2 - 1.7 / spread**2)
    prior = np.full((6, 1), -1.7), diagonal(np.full((6, 1), spread))
    held = []
    for wall in range(n_walls):
        own = alone[:, [wall]], variance[:, wall, None, None]
        mean, covariance = smooth_over_bands(*own, *prior, step, bands)
        held.append(np.abs(truth[:, wall] - mean[:, 0]) <= 1.96 * np.sqrt(covariance[:, 0, 0]))
    assert abs(np.mean(held) - 0.95) < 4.0 * np.sqrt(0.95 * 0.05 / n_walls)


def test_a_held_material_stays_and_draws_its_neighbours():
    bands = bands_between("octave", 500, 1000)
    means = np.array([[0.0], [2.0]])
    covariances = np.array([[[0.0]], [[1.0]]])
    # the free band's prior is so broad that its answer is all data
    prior = np.zeros((2, 1)), np.full((2, 1, 1), 1e6)
    got_means, got_covariances = smooth_over_bands(means, covariances, *prior, 1.0, bands)
    # One octave apart with variance 1 each: the free band ends half way, with half the variance
    # (0.3 log2(10) = 0.9966 octaves by IEC 61260-1, hence not exactly).
    np.testing.assert_allclose(got_means.ravel(), [0.0, 1.0], rtol=0, atol=5e-3)
    np.testing.assert_allclose(got_covariances.ravel(), [0.0, 0.5], rtol=0, atol=5e-3)


def test_what_does_not_belong_together_is_refused():
    bands = Bands("octave", np.array([500.0, 1000.0]))
    means, covariances = np.zeros((2, 1)), np.ones((2, 1, 1))
    prior = means, np.ones((2, 1, 1))
    with pytest.raises(InputError, match="no spread"):
        smooth_over_bands(means, covariances, *prior, 0.0, bands)
    with pytest.raises(InputError, match="do not belong together"):
        smooth_over_bands(means[:1], covariances, *prior, 0.5, bands)
    with pytest.raises(InputError, match="do not belong together"):
        smooth_over_bands(means, covariances[:, 0], *prior, 0.5, bands)
    with pytest.raises(InputError, match="do not belong together"):
        smooth_over_bands(means, covariances, means, np.ones((2, 2)), 0.5, bands)
