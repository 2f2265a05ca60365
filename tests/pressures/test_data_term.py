"""Scoring, carrying the geometry from band to band, spoiled files, and a whole small room."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from coherent_cases import (
    objective_of,
    small_geometry,
    small_scene,
    small_term,
    with_data,
)
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.model.parameters import (
    GEOMETRY,
    Block,
    Marginal,
    Parameters,
    start_vector,
)
from roomfit.model.problem import Prediction
from roomfit.pressures.data_term import with_coherence
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
