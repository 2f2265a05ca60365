"""Measured ISO 3382 values of one band against those of the energies that traced paths predict."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np

from roomfit.bands import Bands
from roomfit.checks import read_only
from roomfit.errors import InputError
from roomfit.objective.parameters import (
    Parameters,
    fitted_columns,
    physical_values,
    start_vector,
)
from roomfit.objective.problem import Prediction
from roomfit.objective.smearing import Smearing, before_smearing, smear, smear_squares
from roomfit.response.energy import batch_energies, weigh
from roomfit.response.rows import EnergyRows
from roomfit.signals.decay import echogram_decay_curve
from roomfit.signals.jnd import jnd_of
from roomfit.signals.parameter_gradients import ValueName, value_gradients
from roomfit.typing import BoolArray, FloatArray

# What is wrong about the decay, or about the early part, is wrong in all values read from it.
_FAMILY = {"EDT_s": 0, "T20_s": 0, "T30_s": 0, "G_dB": 2}
_EARLY_TO_LATE = 1


@dataclass(frozen=True, slots=True, eq=False)
class ValueObservation:
    """The measured values of one pair in one band.

    Attributes
    ----------
    pair : int
        Index of the pair in the scene.
    direct_s : float
        Travel time of the direct sound, from which early and late are counted.
    names : tuple of str
        Of `roomfit.signals.parameter_gradients.VALUE_NAMES`.
    measured : float array, shape (n_values,)
        In the units that the names tell.
    spread : float array, shape (n_values,)
        Stated standard deviation of each value, 0 where none was stated.
    """

    pair: int
    direct_s: float
    names: tuple[ValueName, ...]
    measured: FloatArray
    spread: FloatArray


@dataclass(frozen=True, eq=False)
class RoomValuesProblem:
    """One band: find the absorption under which the paths have the measured room parameters.

    Attributes
    ----------
    bands : Bands
        The one band.
    bandwidth_hz : float
        Statistical bandwidth of its filter.
    attenuation_per_m : float
        Energy attenuation of the air.
    edges_s : float array, shape (n_bins + 1,)
        Uniform bins of the rows.
    rows, lone_rows : tuples of EnergyRows
        Paths of each observation's pair, and what
        `roomfit.objective.energy_problem.lone_rows` makes of them.
    observations : tuple of ValueObservation
    smearing : Smearing
    parameters : Parameters
        Only the block "absorption" acts: room parameters know no unknown gain or delay.
    model_error_jnd : float
        Standard deviation by which the model may be wrong, in just noticeable differences.
    """

    bands: Bands
    bandwidth_hz: float
    attenuation_per_m: float
    edges_s: FloatArray
    rows: tuple[EnergyRows, ...]
    lone_rows: tuple[EnergyRows, ...]
    observations: tuple[ValueObservation, ...]
    smearing: Smearing
    parameters: Parameters
    model_error_jnd: float = 0.3

    def __post_init__(self) -> None:
        if not 0.0 <= self.model_error_jnd <= 100.0:
            raise InputError(
                "model error out of range",
                found=f"{self.model_error_jnd:g}",
                needed="0 to 100 just noticeable differences",
            )
        if not self.observations:
            raise InputError("no measured room parameter in a band")

    def measured(self) -> FloatArray:
        """Return the measured values, pair after pair, shape (n_values,)."""
        return np.concatenate([o.measured for o in self.observations])

    def predict(self, vector: FloatArray) -> Prediction:
        """Return the values that the paths predict, with exact derivatives."""
        values, slopes = physical_values(self.parameters, vector)
        found, by_absorption = [], []
        for i in range(len(self.observations)):
            response = weigh(
                self.rows[i], values["absorption"][:, None], np.array([self.attenuation_per_m])
            )
            predicted, gradients, _ = _values(self, i, response.energy)
            derivative = cast(FloatArray, response.derivative)[:, 0, :]
            found.append(predicted)
            by_absorption.append(before_smearing(self.smearing, gradients) @ derivative.T)
        signal = np.concatenate(found)
        jacobians = {name: np.zeros((signal.size, v.size)) for name, v in values.items()}
        jacobians["absorption"] = np.concatenate(by_absorption) * slopes["absorption"]
        return Prediction(signal, signal, fitted_columns(self.parameters, jacobians))

    def variance(self, vector: FloatArray) -> FloatArray:
        """Return the variance of every value about its prediction, shape (n_values,)."""
        return np.concatenate([np.diag(c) for c in value_covariances(self, vector)])

    def counted_as_one(self) -> FloatArray:
        """Return how many values of the same pair tell the same, shape (n_values,).

        T20 and T30 are read from one decay: the sum of the squared correlations of each value with
        all values of its pair, 1 where it stands alone. From where the fit starts.
        """
        return self._counted_as_one

    @cached_property
    def _counted_as_one(self) -> FloatArray:
        counts = []
        for covariance in value_covariances(self, start_vector(self.parameters)):
            sd = np.sqrt(np.diag(covariance))
            counts.append(np.sum((covariance / np.outer(sd, sd)) ** 2, axis=1))
        return read_only(np.concatenate(counts))

    def are_energies(self) -> BoolArray:
        """Return False for every value."""
        return np.zeros(self.measured().size, dtype=np.bool_)

    def log_likelihood(self, expected: FloatArray, variance: FloatArray) -> FloatArray:
        """Return the log of each value's Gaussian density, shape (n_values,)."""
        squares = (self.measured() - expected) ** 2 / variance
        return np.asarray(-0.5 * (squares + np.log(2.0 * np.pi * variance)))


def value_covariances(problem: RoomValuesProblem, vector: FloatArray) -> tuple[FloatArray, ...]:
    """Return the covariance of the values of each pair about their prediction.

    Four parts: the stated spread; reflections that interfere; the number of rays; and the error of
    the model, which those read from the decay share, and those read from early against late.

    Returns
    -------
    tuple of float arrays, shape (n_values, n_values), one an observation

    Notes
    -----
    The energy of a band of bandwidth B scatters about the sum of the paths' energies like white
    noise of the spectral density ``(P^2 - Q) / B``, P the smeared power and Q that of lone
    reflections, which interfere with nothing. Carried through the derivatives of a value this is
    its variance to first order. For an exponential decay it gives the theory of [1]_, on which ISO
    354 and ISO 3382-2 build: ``0.55 T30 (B T30) ** -0.5`` for many averaged decays.

    References
    ----------
    .. [1] J. L. Davy, I. P. Dunn, P. Dubout, "The variance of decay rates in reverberation rooms",
           Acustica 43, 12-25 (1979).
    """
    values, _ = physical_values(problem.parameters, vector)
    covariances = []
    for i, seen in enumerate(problem.observations):
        energy = weigh(
            problem.rows[i],
            values["absorption"][:, None],
            np.array([problem.attenuation_per_m]),
            derivative=False,
        ).energy
        predicted, gradients, smeared = _values(problem, i, energy)
        spread = np.diag(seen.spread**2)
        interference = _interference(problem, i, values["absorption"], gradients, smeared)
        tracing = _tracing(problem, i, values["absorption"], gradients)
        covariances.append(spread + interference + tracing + _model(problem, seen, predicted))
    return tuple(covariances)


def _values(
    problem: RoomValuesProblem, i: int, energy: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return predicted values, derivatives by smeared energies, and these energies."""
    seen = problem.observations[i]
    smeared = smear(problem.smearing, energy)
    curve = echogram_decay_curve(problem.bands, smeared, problem.edges_s, seen.direct_s)
    return *value_gradients(curve, 0, seen.names), smeared[0]


def _interference(
    problem: RoomValuesProblem,
    i: int,
    absorption: FloatArray,
    gradients: FloatArray,
    smeared: FloatArray,
) -> FloatArray:
    attenuation = np.array([problem.attenuation_per_m])
    lone = weigh(problem.lone_rows[i], absorption[:, None], attenuation, derivative=False).energy[0]
    overlapping = np.maximum(smeared**2 - smear_squares(problem.smearing, lone), 0.0)
    variance = overlapping / (problem.bandwidth_hz * np.diff(problem.edges_s))
    return np.asarray((gradients * variance) @ gradients.T)


def _tracing(
    problem: RoomValuesProblem, i: int, absorption: FloatArray, gradients: FloatArray
) -> FloatArray:
    """Return the Monte-Carlo covariance, from independent batches of rays."""
    rows = problem.rows[i]
    n = gradients.shape[0]
    if rows.n_batches < 2:
        return np.zeros((n, n))
    batches = batch_energies(rows, absorption[:, None], np.array([problem.attenuation_per_m]))
    parts = batches[:, 0, :] @ before_smearing(problem.smearing, gradients).T
    return np.asarray(len(parts) * np.cov(parts.T, ddof=1).reshape(n, n))


def _model(problem: RoomValuesProblem, seen: ValueObservation, predicted: FloatArray) -> FloatArray:
    # the larger of both, so that a trial far off does not pass for a precise one
    units = [
        float(jnd_of(name, np.maximum(m, p)))
        for name, m, p in zip(seen.names, seen.measured, predicted, strict=True)
    ]
    sd = problem.model_error_jnd * np.array(units)
    family = np.array([_FAMILY.get(name, _EARLY_TO_LATE) for name in seen.names])
    return np.asarray(np.outer(sd, sd) * (family[:, None] == family[None, :]))
