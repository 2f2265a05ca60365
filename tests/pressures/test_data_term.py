"""Scoring, carrying the geometry from band to band, spoiled files, and a whole small room."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from coherent_cases import (
    estimate_of,
    objective_of,
    small_geometry,
    small_paths,
    small_scene,
    small_term,
    with_data,
)
from roomfit.base.bands import Bands
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.fit.systematics import inflated_by_adjacent_bands
from roomfit.materials.priors import unknown_material
from roomfit.model.binned import BinnedPaths, bin_paths
from roomfit.model.parameters import (
    GEOMETRY,
    Block,
    Marginal,
    Parameters,
    prior_residuals,
    start_vector,
)
from roomfit.model.problem import Prediction
from roomfit.model.weighing import first_rows
from roomfit.pressures.data_term import cut_at, with_coherence
from roomfit.pressures.geometry import moved_scene, whole_covariance
from roomfit.pressures.sequential import cavity_prior
from roomfit.solver import marginal, score_band

N_OWN, N_SHARED = 2, 3


def _block(name: str, n: int, sd: float) -> Block:
    return Block(
        *(name, tuple(f"{name} {i}" for i in range(n)), "identity", np.zeros(n)),
        *(np.ones(n, dtype=np.bool_), np.zeros(n), np.full(n, sd)),
        *(np.full(n, -1e9), np.full(n, 1e9)),
    )


@dataclass(frozen=True)
class Linear:
    """A linear problem with unit variance: its exact posterior is known."""

    matrix: FloatArray
    data: FloatArray
    parameters: Parameters

    def measured(self) -> FloatArray:
        return self.data

    def predict(self, vector: FloatArray) -> Prediction:
        return Prediction(self.matrix @ vector, self.matrix @ vector, self.matrix)

    def variance(self, vector: FloatArray) -> FloatArray:
        return np.ones(self.data.size) + 0.0 * vector[0]

    def correlation_length(self) -> FloatArray:
        return np.ones(self.data.size)

    def is_gamma(self) -> BoolArray:
        return np.zeros(self.data.size, dtype=np.bool_)

    def log_likelihood(self, expected: FloatArray, variance: FloatArray) -> FloatArray:
        return np.asarray(-0.5 * (self.data - expected) ** 2 / variance)


def _bands(seed: int) -> list[tuple[FloatArray, FloatArray]]:
    """Return matrix and data of two bands; residuals small, so that phi stays below 1."""
    rng = np.random.default_rng(seed)
    out = []
    shared = rng.standard_normal(N_SHARED)
    for _ in range(2):
        matrix = rng.standard_normal((12, N_OWN + N_SHARED))
        truth = np.concatenate((rng.standard_normal(N_OWN), shared))
        out.append((matrix, matrix @ truth + 0.1 * rng.standard_normal(12)))
    return out


def _joint_answer(bands: list[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance of the shared unknowns with both bands' own in one system."""
    n = 2 * N_OWN + N_SHARED
    H, g = np.diag([1e-4] * (2 * N_OWN) + [1.0] * N_SHARED), np.zeros(n)
    for b, (matrix, data) in enumerate(bands):
        A = np.zeros((len(data), n))
        A[:, b * N_OWN : (b + 1) * N_OWN] = matrix[:, :N_OWN]
        A[:, 2 * N_OWN :] = matrix[:, N_OWN:]
        H += A.T @ A
        g += A.T @ data
    return np.linalg.solve(H, g), np.linalg.inv(H)


def _carried(bands: list[tuple[FloatArray, FloatArray]], joint: Marginal | None, b: int) -> Linear:
    blocks = (_block("absorption", N_OWN, 100.0), _block(GEOMETRY, N_SHARED, 1.0))
    return Linear(*bands[b], Parameters(blocks, joint))


@pytest.mark.parametrize("seed", range(3))
def test_what_is_carried_from_band_to_band_is_the_joint_answer(seed: int) -> None:
    """Two linear bands one after the other, against one system with all unknowns."""
    bands = _bands(seed)
    first = score_band(_carried(bands, None, 0), np.zeros(5), settled_sd=1e-7)
    reported = marginal(first, N_OWN, np.eye(N_SHARED))
    second = score_band(_carried(bands, reported, 1), np.zeros(5), settled_sd=1e-7)
    mean, covariance = _joint_answer(bands)
    own = slice(2 * N_OWN, None)
    np.testing.assert_allclose(second.vector[N_OWN:], mean[own], atol=1e-6)
    np.testing.assert_allclose(
        np.linalg.inv(second.information)[N_OWN:, N_OWN:], covariance[own, own], rtol=1e-8
    )


def test_a_bands_own_say_is_taken_out_before_it_is_fitted_again() -> None:
    """The second visit of the first band has the joint answer's covariance, not a narrower one."""
    bands = _bands(7)
    first = score_band(_carried(bands, None, 0), np.zeros(5), settled_sd=1e-7)
    after_first = marginal(first, N_OWN, np.eye(N_SHARED))
    second = score_band(_carried(bands, after_first, 1), np.zeros(5), settled_sd=1e-7)
    final = marginal(second, N_OWN, after_first.information)
    again = score_band(
        _carried(bands, cavity_prior(final, after_first, np.eye(N_SHARED)), 0), np.zeros(5)
    )
    _, covariance = _joint_answer(bands)
    whole = np.linalg.inv(again.information)
    np.testing.assert_allclose(whole[N_OWN:, N_OWN:], covariance[4:, 4:], rtol=1e-8)
    np.testing.assert_allclose(whole[:N_OWN, :N_OWN], covariance[:N_OWN, :N_OWN], rtol=1e-8)


def test_a_joint_prior_costs_its_mahalanobis_distance() -> None:
    """Sum of squared prior residuals against d' information d; rows are its derivative."""
    rng = np.random.default_rng(3)
    root = rng.standard_normal((3, 3))
    joint = Marginal(rng.standard_normal(3), root @ root.T + np.eye(3))
    parameters = Parameters((_block("absorption", 2, 2.0), _block(GEOMETRY, 3, 1.0)), joint)
    vector = rng.standard_normal(5)
    residuals, rows = prior_residuals(parameters, vector)
    d = vector[2:] - joint.mean
    expected = np.sum((vector[:2] / 2.0) ** 2) + d @ joint.information @ d
    assert residuals @ residuals == pytest.approx(expected, rel=1e-12)
    moved, _ = prior_residuals(parameters, vector + 1e-3)
    np.testing.assert_allclose(moved - residuals, rows @ np.full(5, 1e-3), atol=1e-12)


def test_the_geometry_is_found_from_exact_data() -> None:
    """Absorption and places of noise-free windows come back from a start beside them."""
    term = with_coherence(small_term(), 0.09 * whole_covariance(small_geometry()))
    problem = objective_of(term)
    truth = start_vector(problem.parameters)
    truth[:3] += np.array([0.4, -0.5, 0.3])
    truth[4:] = 0.2 * np.random.default_rng(2).standard_normal(truth.size - 4)
    problem = objective_of(with_data(term, problem.predict(truth).expected))
    fit = score_band(problem, start_vector(problem.parameters), max_rounds=36, settled_sd=1e-7)
    # what the prior draws towards itself is far inside the stated deviation
    sd = np.sqrt(np.diag(np.linalg.inv(fit.information)))
    assert np.all(np.abs(fit.vector - truth) <= 1.0 * sd)
    start = start_vector(problem.parameters)
    assert np.abs(fit.vector[:3] - truth[:3]).max() < 0.5 * np.abs(start[:3] - truth[:3]).max()


def test_softened_data_have_larger_variances_and_nothing_else() -> None:
    """Factor by factor."""
    problem = objective_of(small_term())
    factor = np.linspace(1.0, 3.0, problem.measured().size)
    soft = replace(problem, inflation=factor)
    vector = start_vector(problem.parameters)
    np.testing.assert_allclose(soft.variance(vector), factor * problem.variance(vector))
    np.testing.assert_array_equal(soft.predict(vector).expected, problem.predict(vector).expected)


def test_absorption_that_jumps_between_bands_has_wider_intervals() -> None:
    """A material alike in all bands keeps its interval; one that jumps loses identifiability."""
    bands = [
        estimate_of([0.3, 0.1], 0.02),
        estimate_of([0.3, 0.2], 0.02),
        estimate_of([0.3, 0.95], 0.02),
    ]
    wide = inflated_by_adjacent_bands(bands)
    middle = wide[1]
    assert middle is not None
    np.testing.assert_allclose((middle.lower95[0], middle.upper95[0]), (0.28, 0.32), atol=1e-9)
    # 0.144 of 0.75 above less 0.078 of 0.1 below, times 1.96: about a fifth on either side
    assert middle.upper95[1] - middle.lower95[1] > 0.3
    assert inflated_by_adjacent_bands([bands[0], None, None])[0] is bands[0]


def test_a_material_that_is_held_stays_held() -> None:
    """No interval grows about a given absorption."""
    held = replace(estimate_of([0.3, 0.1], 0.02), lower95=np.array([0.3, 0.1]))
    held = replace(held, upper95=held.lower95)
    wide = inflated_by_adjacent_bands([held, estimate_of([0.6, 0.7], 0.02)])[0]
    assert wide is not None
    np.testing.assert_array_equal(wide.lower95, wide.upper95)


def test_tied_walls_jump_together_and_those_of_a_product_nearly() -> None:
    """The tie stays in the covariance, and the mean knows that their errors do not average."""
    names = ("one", "two", "panel_a", "panel_b")
    priors = tuple(unknown_material(n, 2) for n in names)
    tied = (
        priors[0],
        replace(priors[1], tied_to="one"),
        *(replace(k, product="panel", product_sd=0.3) for k in priors[2:]),
    )
    bands = [estimate_of([0.3] * 4, 0.02), estimate_of([0.8] * 4, 0.02)]
    apart, alike = (inflated_by_adjacent_bands(bands, k)[0] for k in (priors, tied))
    assert apart is not None and alike is not None
    np.testing.assert_allclose(alike.lower95, apart.lower95)
    more = alike.logit_covariance - bands[0].logit_covariance
    assert more[0, 1] == pytest.approx(more[0, 0])
    assert more[2, 3] == pytest.approx(more[2, 2] * 1.5**2 / (1.5**2 + 0.3**2))
    assert more[0, 2] == 0.0
    # equal walls of equal areas: the variance of their mean goes with the sum of all entries
    assert alike.logit_covariance.sum() > 1.15**2 * apart.logit_covariance.sum()


@pytest.mark.parametrize(
    ("end_s", "n"),
    [
        (0.002, 2),
        (0.001 + 0.001, 2),
        (0.1 * 0.02, 2),
        (0.0025, 2),
        (0.0005, 1),
        (0.004, 4),
        (9.0, 4),
    ],
)
def test_bins_are_cut_at_the_last_edge_that_is_not_after_the_time(end_s, n):
    """An edge in another rounding is the same edge; one bin is always kept."""
    scene, paths = small_paths()
    bands = Bands("octave", np.array([1000.0]))
    binned = bin_paths(scene, bands, paths, 0.3)
    edges_s = 1e-3 * np.arange(5)
    four = BinnedPaths(edges_s, tuple(first_rows(rows, 4) for rows in binned.rows))
    assert cut_at(four, end_s).edges_s.tolist() == edges_s[: n + 1].tolist()
    assert all(rows.n_windows == n for rows in cut_at(four, end_s).rows)


def test_a_scene_moves_to_the_fitted_positions_and_keeps_what_is_known():
    """Steps are free numbers times standard deviations; a coordinate of none, and one unfitted,
    stay, and so does whatever comes behind the positions."""
    scene = small_scene()
    geometry = small_geometry()
    n = 3 * (len(scene.sources) + len(scene.receivers))
    sd = np.array(geometry.sd)
    sd[1], fitted = 0.0, np.array(geometry.fitted)
    fitted[2] = False
    moved_by = replace(geometry, sd=sd, fitted=fitted)
    free = np.flatnonzero(fitted & (sd > 0.0))
    numbers = 0.5 + np.arange(free.size)
    found, origin = moved_scene(scene, moved_by, numbers)
    expected = np.zeros(sd.size)
    expected[free] = numbers
    expected[n:] = 0.0
    np.testing.assert_array_equal(origin, expected)
    for points, moved, first in (
        (scene.sources, found.sources, 0),
        (scene.receivers, found.receivers, 3 * len(scene.sources)),
    ):
        for i, (before, after) in enumerate(zip(points, moved, strict=True)):
            own = slice(first + 3 * i, first + 3 * i + 3)
            np.testing.assert_allclose(
                after.position_m, before.position_m + sd[own] * expected[own], rtol=1e-12
            )
            assert after.name == before.name
    assert np.any(expected[:n]) and np.any(fitted[n:])
