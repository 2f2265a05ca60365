"""What every fit of one band needs to know of its data, whatever kind of data they are.

Window energies, partly coherent windows and ISO 3382 values each predict themselves from one vector
of free parameters. A joint problem lays several of them end to end; an inflated variance gives less
weight to data than their noise model does.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.special import gammaln

from roomfit.errors import InputError
from roomfit.objective.parameters import Parameters
from roomfit.typing import BoolArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Expected data, all observations end to end, with derivatives."""

    expected: FloatArray  # (n_data,), what the model expects to be measured, noise included
    signal: FloatArray  # (n_data,), the same without noise
    jacobian: FloatArray  # (n_data, n_free), derivative of `expected` by the free vector


# How many predictions were made since `counted_evaluations` was entered; in a context of its own,
# because fits are made in trials, rounds, profiles and samples of many functions, and a count that
# passes through the signatures of all of them forgets some.
_MADE: ContextVar[list[int]] = ContextVar("evaluations")


@contextmanager
def counted_evaluations() -> Iterator[list[int]]:
    """Give a list whose only entry counts the evaluations of data terms made within the block."""
    made = [0]
    token = _MADE.set(made)
    try:
        yield made
    finally:
        _MADE.reset(token)


def count_evaluation() -> None:
    """Count one evaluation of one kind of data of a band, where anyone counts."""
    made = _MADE.get(None)
    if made is not None:
        made[0] += 1


class BandProblem(Protocol):
    """Data of one band that a vector of free parameters explains.

    Attributes
    ----------
    parameters : Parameters
        Blocks of unknowns, one of them "absorption" with one entry a material.
    """

    @property
    def parameters(self) -> Parameters: ...

    def measured(self) -> FloatArray:
        """Return the data, shape (n_data,)."""
        ...

    def predict(self, vector: FloatArray) -> Prediction:
        """Return what a free vector makes the model expect."""
        ...

    def variance(self, vector: FloatArray) -> FloatArray:
        """Return the variance of each datum about its expectation, shape (n_data,)."""
        ...

    def correlation_length(self) -> FloatArray:
        """Return how many neighbours share the information of each datum, shape (n_data,)."""
        ...

    def is_gamma(self) -> BoolArray:
        """Return which data are energies, never negative and spread over decades, (n_data,)."""
        ...

    def log_likelihood(self, expected: FloatArray, variance: FloatArray) -> FloatArray:
        """Return the log density of each datum with every constant, shape (n_data,).

        For choosing between models, whose variances differ: squares alone cannot compare them.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class JointProblem:
    """Several kinds of data of one band with the same unknowns, one after the other."""

    parts: tuple[BandProblem, ...]  # at least one; all have one and the same `parameters`

    def __post_init__(self) -> None:
        if any(p.parameters is not self.parts[0].parameters for p in self.parts):
            raise InputError("the parts of a joint problem have different unknowns")

    @property
    def parameters(self) -> Parameters:
        """The unknowns of every part."""
        return self.parts[0].parameters

    def measured(self) -> FloatArray:
        """Return the data of all parts, shape (n_data,)."""
        return np.concatenate([p.measured() for p in self.parts])

    def predict(self, vector: FloatArray) -> Prediction:
        """Return the predictions of all parts."""
        found = [p.predict(vector) for p in self.parts]
        return Prediction(
            np.concatenate([f.expected for f in found]),
            np.concatenate([f.signal for f in found]),
            np.concatenate([f.jacobian for f in found]),
        )

    def variance(self, vector: FloatArray) -> FloatArray:
        """Return the variances of all parts, shape (n_data,)."""
        return np.concatenate([p.variance(vector) for p in self.parts])

    def correlation_length(self) -> FloatArray:
        """Return every part's count of neighbours, shape (n_data,)."""
        return np.concatenate([p.correlation_length() for p in self.parts])

    def is_gamma(self) -> BoolArray:
        """Return which data of any part are energies, shape (n_data,)."""
        return np.concatenate([p.is_gamma() for p in self.parts])

    def log_likelihood(self, expected: FloatArray, variance: FloatArray) -> FloatArray:
        """Return the log density of each datum of all parts, shape (n_data,)."""
        ends = np.cumsum([p.measured().size for p in self.parts])[:-1]
        split = zip(self.parts, np.split(expected, ends), np.split(variance, ends), strict=True)
        return np.concatenate([p.log_likelihood(e, v) for p, e, v in split])


def gamma_log_likelihood(
    measured: FloatArray, expected: FloatArray, variance: FloatArray
) -> FloatArray:
    """Return the log density of energies that follow Gamma laws of given mean and variance.

    A window's energy is a sum of squares of nearly Gaussian pressures: never negative, skew, with
    a standard deviation that grows with its mean.

    Parameters
    ----------
    measured, expected, variance : float arrays, shape (n,)
        A measured 0 counts as a millionth of what was expected; an expected 0, where neither a path
        nor noise reaches, as a billionth of the largest.

    Returns
    -------
    float array, shape (n,)
        Log of a density per unit of energy.
    """
    least = 1e-9 * float(expected.max(initial=0.0)) + np.finfo(np.float64).tiny
    expected = np.maximum(expected, least)
    variance = np.maximum(variance, (1e-3 * expected) ** 2)
    shape = expected**2 / variance
    scale = variance / expected
    floored = np.maximum(measured, 1e-6 * expected)
    return np.asarray(
        (shape - 1.0) * np.log(floored / scale) - floored / scale - gammaln(shape) - np.log(scale)
    )


@dataclass(frozen=True, slots=True, eq=False)
class InflatedVariance:
    """The same problem with variances enlarged."""

    problem: BandProblem
    factor: FloatArray  # (n_data,), by which each variance is multiplied, 1 or more

    @property
    def parameters(self) -> Parameters:
        """The unknowns of the problem."""
        return self.problem.parameters

    def measured(self) -> FloatArray:
        """Return the data, shape (n_data,)."""
        return self.problem.measured()

    def predict(self, vector: FloatArray) -> Prediction:
        """Return what a free vector makes the model expect."""
        return self.problem.predict(vector)

    def variance(self, vector: FloatArray) -> FloatArray:
        """Return the enlarged variances, shape (n_data,)."""
        return self.factor * self.problem.variance(vector)

    def correlation_length(self) -> FloatArray:
        """Return how many neighbours share the information of each datum, shape (n_data,)."""
        return self.problem.correlation_length()

    def is_gamma(self) -> BoolArray:
        """Return which data are energies, shape (n_data,)."""
        return self.problem.is_gamma()

    def log_likelihood(self, expected: FloatArray, variance: FloatArray) -> FloatArray:
        """Return the log density of each datum, shape (n_data,)."""
        return self.problem.log_likelihood(expected, variance)
