"""Small problems whose posteriors can be worked out another way: no room, no file, no trace."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.base.typing import BoolArray, FloatArray
from roomfit.model.parameters import GEOMETRY, Block, Parameters, fitted_columns, physical_values
from roomfit.model.problem import Prediction, gamma_log_likelihood


def absorption_block(n: int, mean: float = 0.15, sd: float = 1.5) -> Block:
    """Return unknown absorptions with the broad prior."""
    names = tuple(f"material {i}" for i in range(n))
    middle = np.full(n, np.log(mean / (1.0 - mean)))
    return Block(
        *("absorption", names, "logit", np.full(n, 0.2), np.ones(n, dtype=np.bool_)),
        *(middle, np.full(n, sd), np.zeros(n), np.ones(n)),
    )


def gain_block() -> Block:
    """Return one unknown gain without a prior."""
    one = np.ones(1)
    return Block(
        *("gain", ("S",), "log", one, one > 0.0, 0.0 * one, np.inf * one, 1e-9 * one, 1e9 * one)
    )


@dataclass(frozen=True, eq=False)
class Posynomial:
    """Energies of windows that follow Gamma laws: sums over paths of products of what walls leave.

    `weight` has shape (n_windows, n_paths), `hits` (n_windows, n_paths, n_materials), `seen`
    (n_windows,); `shape` is the shape of the Gamma law of every window.
    """

    weight: FloatArray
    hits: FloatArray
    observed: FloatArray
    shape: float
    parameters: Parameters

    def measured(self) -> FloatArray:
        return self.observed

    def predict(self, vector: FloatArray) -> Prediction:
        values, slopes = physical_values(self.parameters, vector)
        left = np.maximum(1.0 - values["absorption"], 1e-300)
        each = self.weight * np.exp(self.hits @ np.log(left))
        gain = values["gain"][0] if "gain" in values else 1.0
        signal = gain * each.sum(axis=1)
        by_log = -gain * np.einsum("wk,wkm->wm", each, self.hits) / left
        jacobians = {"absorption": by_log * slopes["absorption"]}
        if "gain" in values:
            jacobians["gain"] = signal[:, None] / gain * slopes["gain"]
        return Prediction(signal, signal, fitted_columns(self.parameters, jacobians))

    def expected(self, vector: FloatArray) -> FloatArray:
        return self.predict(vector).expected

    def variance(self, vector: FloatArray) -> FloatArray:
        return np.asarray(self.predict(vector).expected ** 2 / self.shape)

    def correlation_length(self) -> FloatArray:
        return np.ones(self.observed.size)

    def is_gamma(self) -> BoolArray:
        return np.ones(self.observed.size, dtype=np.bool_)

    def at_points(self, _vector: FloatArray) -> None:
        """Say that points are evaluated one by one."""

    def log_likelihood(self, expected: FloatArray, variance: FloatArray) -> FloatArray:
        return gamma_log_likelihood(self.observed, expected, variance)


@dataclass(frozen=True, eq=False)
class Linear:
    """Gaussian data that are linear in all free numbers, the last of them a geometry's."""

    matrix: FloatArray
    observed: FloatArray
    sd: float
    parameters: Parameters

    def measured(self) -> FloatArray:
        return self.observed

    def predict(self, vector: FloatArray) -> Prediction:
        return Prediction(self.matrix @ vector, self.matrix @ vector, self.matrix)

    def variance(self, _vector: FloatArray) -> FloatArray:
        return np.full(self.observed.size, self.sd**2)

    def correlation_length(self) -> FloatArray:
        return np.ones(self.observed.size)

    def is_gamma(self) -> BoolArray:
        return np.zeros(self.observed.size, dtype=np.bool_)

    def log_likelihood(self, expected: FloatArray, variance: FloatArray) -> FloatArray:
        return np.asarray(
            -0.5 * (self.observed - expected) ** 2 / variance - 0.5 * np.log(variance)
        )


def linear_case(seed: int, n: int = 3, n_geometry: int = 4, n_data: int = 30) -> Linear:
    """Return a linear problem of absorptions and, where asked, of a geometry."""
    rng = np.random.default_rng(seed)
    blocks = [absorption_block(n)]
    if n_geometry:
        blocks.append(
            Block(
                *(GEOMETRY, tuple(f"g{i}" for i in range(n_geometry)), "identity"),
                *(np.zeros(n_geometry), np.ones(n_geometry, dtype=np.bool_), np.zeros(n_geometry)),
                *(np.ones(n_geometry), np.full(n_geometry, -1e6), np.full(n_geometry, 1e6)),
            )
        )
    matrix = rng.standard_normal((n_data, n + n_geometry))
    observed = matrix @ rng.standard_normal(n + n_geometry) + 0.5 * rng.standard_normal(n_data)
    return Linear(matrix, observed, 0.5, Parameters(tuple(blocks)))


def decay_case(
    rng: np.random.Generator, truth: FloatArray, *, gain: bool = True, n_windows: int = 12
) -> Posynomial:
    """Return windows of a decay in which paths have hit materials at random, more and more."""
    n, n_paths = len(truth), 6
    order = np.arange(n_windows)[:, None, None] * np.ones((1, n_paths, n))
    hits = rng.poisson(0.3 + 0.5 * order * rng.uniform(0.3, 1.7, (1, 1, n))).astype(float)
    weight = rng.uniform(0.5, 1.5, (n_windows, n_paths))
    blocks = (absorption_block(n), gain_block()) if gain else (absorption_block(n),)
    expected = (weight * np.exp(hits @ np.log1p(-np.asarray(truth)))).sum(axis=1)
    shape = 8.0
    observed = expected * rng.gamma(shape, 1.0 / shape, n_windows)
    return Posynomial(weight, hits, observed, shape, Parameters(blocks))


def exchangeable_case() -> Posynomial:
    """Return exact energies of two materials that can be exchanged: 0.1 and 0.6, or 0.6 and 0.1."""
    hits = np.array([[[1.0, 1.0], [1.0, 1.0]], [[3.0, 0.0], [0.0, 3.0]], [[2.0, 1.0], [1.0, 2.0]]])
    hits = np.repeat(hits, 4, axis=0)
    left = np.log1p(-np.array([0.1, 0.6]))
    observed = np.exp(hits @ left).sum(axis=1)
    return Posynomial(
        np.ones(hits.shape[:2]), hits, observed, 60.0, Parameters((absorption_block(2, 0.3),))
    )


@dataclass(frozen=True, eq=False)
class ExactValues(Posynomial):
    """The same numbers as values with normal errors of a known standard deviation."""

    sd: float = 0.02

    def variance(self, _vector: FloatArray) -> FloatArray:
        return np.full(self.observed.size, self.sd**2)

    def is_gamma(self) -> BoolArray:
        return np.zeros(self.observed.size, dtype=np.bool_)

    def log_likelihood(self, expected: FloatArray, variance: FloatArray) -> FloatArray:
        return np.asarray(-0.5 * (self.observed - expected) ** 2 / variance)


def exact_values(case: Posynomial, sd: float) -> ExactValues:
    """Return the same numbers as values with normal errors of this standard deviation."""
    own = (case.weight, case.hits, case.observed, case.shape, case.parameters)
    return ExactValues(*own, sd=sd)
