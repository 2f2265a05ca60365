"""Measured window energies of one band against the energies that traced paths predict."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy.sparse import csr_array

from roomfit.checks import float_array
from roomfit.errors import InputError
from roomfit.objective.parameters import (
    Parameters,
    fitted_columns,
    physical_values,
)
from roomfit.response.energy import batch_energies, weigh
from roomfit.response.rows import EnergyRows
from roomfit.typing import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """What one measurement says in one band, and how the model is to be reduced to the same.

    Attributes
    ----------
    pair : int
        Index of the pair in the scene.
    edges_s : float array, shape (n_windows + 1,)
        Time windows after emission.
    energy : float array, shape (n_windows,)
        Measured energy of each window, noise included; unit of the record squared times s.
    noise : float array, shape (n_windows,)
        Expected noise energy of each window.
    shares : sparse array, shape (n_windows, n_bins)
        Share of the energy of each fine time bin that the band filter carries into each window.
    gain : int
        Which unknown gain applies; -1 where the level is absolute.
    """

    pair: int
    edges_s: FloatArray
    energy: FloatArray
    noise: FloatArray
    shares: csr_array
    gain: int

    def __post_init__(self) -> None:
        edges = float_array("window edges", self.edges_s, (None,), unit="s")
        n = len(edges) - 1
        object.__setattr__(self, "edges_s", edges)
        for name in ("energy", "noise"):
            values = float_array(f"window {name}", getattr(self, name), (n,), low=0.0)
            object.__setattr__(self, name, values)
        if self.shares.shape[0] != n:
            raise InputError(
                "shares and windows differ in number",
                found=f"{self.shares.shape[0]} and {n}",
            )


@dataclass(frozen=True, slots=True, eq=False)
class EnergyProblem:
    """One band: find absorption and gains under which the paths explain every window.

    Rows, hits and windows stand open, for methods that need more than a function to call.

    Attributes
    ----------
    centre_hz : float
    bandwidth_hz : float
        Statistical bandwidth of the band filter.
    attenuation_per_m : float
        Energy attenuation of the air.
    rows : tuple of EnergyRows
        Paths of each observation's pair in fine time bins.
    lone_rows : tuple of EnergyRows
        What `lone_rows` makes of each of them.
    observations : tuple of Observation
    parameters : Parameters
        Blocks "absorption" (one entry a material) and "gain" (one an unknown level).
    model_error : float
        Relative standard deviation that the model may be wrong by in any window.
    """

    centre_hz: float
    bandwidth_hz: float
    attenuation_per_m: float
    rows: tuple[EnergyRows, ...]
    lone_rows: tuple[EnergyRows, ...]
    observations: tuple[Observation, ...]
    parameters: Parameters
    model_error: float = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Expected window energies, all observations end to end, with derivatives.

    Attributes
    ----------
    expected : float array, shape (n_windows,)
        Gain times modelled energy plus noise.
    signal : float array, shape (n_windows,)
        The same without noise.
    jacobian : float array, shape (n_windows, n_free)
        Derivative of `expected` by the free vector.
    """

    expected: FloatArray
    signal: FloatArray
    jacobian: FloatArray


def measured_energies(problem: EnergyProblem) -> FloatArray:
    """Return the measured window energies, all observations end to end, shape (n_windows,)."""
    return np.concatenate([o.energy for o in problem.observations])


def window_observation(problem: EnergyProblem) -> IntArray:
    """Return which observation each window belongs to, shape (n_windows,)."""
    counts = [o.energy.size for o in problem.observations]
    return np.repeat(np.arange(len(counts)), counts)


def predict_windows(problem: EnergyProblem, vector: FloatArray) -> Prediction:
    """Return what the model expects in every window for a vector of free parameters."""
    values, slopes = physical_values(problem.parameters, vector)
    coefficients = values["absorption"][:, None]
    attenuation = np.array([problem.attenuation_per_m])
    gains = np.append(values["gain"], 1.0)  # index -1: absolute level
    signals, noises, by_absorption, by_gain = [], [], [], []
    for rows, observation in zip(problem.rows, problem.observations, strict=True):
        response = weigh(rows, coefficients, attenuation)
        gain = gains[observation.gain]
        signal = gain * (observation.shares @ response.energy[0])
        signals.append(signal)
        noises.append(observation.noise)
        derivative = cast(FloatArray, response.derivative)
        by_absorption.append(gain * (observation.shares @ derivative[:, 0, :].T))
        columns = np.zeros((signal.size, values["gain"].size))
        if observation.gain >= 0:
            columns[:, observation.gain] = signal / gain
        by_gain.append(columns)
    jacobians = {
        "absorption": np.concatenate(by_absorption) * slopes["absorption"],
        "gain": np.concatenate(by_gain) * slopes["gain"],
    }
    signal = np.concatenate(signals)
    return Prediction(
        signal + np.concatenate(noises), signal, fitted_columns(problem.parameters, jacobians)
    )


def window_variance(problem: EnergyProblem, vector: FloatArray) -> FloatArray:
    """Return the variance of every measured window energy about its expectation.

    Reflections interfere: where many overlap, the energy of a band of width B in a window of
    width T scatters by ``1 / (1 + B T)`` of its square, however finely one traces; a lone
    reflection carries no such noise. To this come background noise, its beat with the signal, the
    trace's own Monte-Carlo noise (from independent batches) and the error of the model.

    Returns
    -------
    float array, shape (n_windows,)
    """
    values, _ = physical_values(problem.parameters, vector)
    coefficients = values["absorption"][:, None]
    attenuation = np.array([problem.attenuation_per_m])
    gains = np.append(values["gain"], 1.0)
    variances = []
    for rows, lone, seen in zip(problem.rows, problem.lone_rows, problem.observations, strict=True):
        gain = gains[seen.gain]
        energy = weigh(rows, coefficients, attenuation, derivative=False).energy[0]
        signal = gain * (seen.shares @ energy)
        squares = weigh(lone, coefficients, attenuation, derivative=False).energy[0]
        lone_squares = gain**2 * (seen.shares.multiply(seen.shares) @ squares)
        tracing = gain**2 * _tracing_variance(rows, seen, coefficients, attenuation)
        freedom = 1.0 + problem.bandwidth_hz * np.diff(seen.edges_s)
        interference = np.maximum(signal**2 - lone_squares, 0.0) / freedom
        noise = seen.noise * (seen.noise + 2.0 * signal) / freedom
        variances.append(interference + noise + tracing + (problem.model_error * signal) ** 2)
    return np.concatenate(variances)


def lone_rows(rows: EnergyRows) -> EnergyRows:
    """Return rows whose weighed energies are the squared energies of the single image paths.

    ``(w exp(-m d) x**h)**2`` is the energy of a path with the weight squared and length and hits
    doubled. Rays are left out: they sample very many weak reflections, whose squares vanish.
    """
    image = rows.batch < 0
    kept = np.concatenate(([0], np.cumsum(image)))
    return EnergyRows(
        rows.materials,
        rows.n_windows,
        kept[rows.offsets],
        rows.weight_per_m2[image] ** 2,
        2 * rows.hits[image],
        2.0 * rows.length_m[image],
        rows.batch[image],
        rows.n_batches,
    )


def _tracing_variance(
    rows: EnergyRows, seen: Observation, coefficients: FloatArray, attenuation: FloatArray
) -> FloatArray:
    """Return the Monte-Carlo variance of each window's energy, from independent batches."""
    if rows.n_batches < 2:
        return np.zeros(seen.energy.size)
    batches = batch_energies(rows, coefficients, attenuation)[:, 0, :]
    windows = np.stack([seen.shares @ energies for energies in batches])
    return np.asarray(len(windows) * np.var(windows, axis=0, ddof=1))
