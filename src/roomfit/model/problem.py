"""The objective of one band: its data terms, and the unknowns that all of them share.

A term is one kind of data, as window energies or ISO 3382 values, and predicts itself from physical
values. The objective turns one vector of free numbers into these values, lays the rows of its
terms end to end, and puts their derivatives into the columns of the vector.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Protocol, TypeAlias

import numpy as np
from scipy.special import gammaln

from roomfit.base.arguments import read_only
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.model.parameters import Parameters, fitted_columns, physical_values, start_vector

if TYPE_CHECKING:
    from roomfit.model.energy import EnergyTerm

Values: TypeAlias = Mapping[str, FloatArray]
"""Physical values of each block of unknowns by its name, fixed ones included."""

Rows: TypeAlias = tuple[FloatArray, FloatArray, dict[str, FloatArray]]
"""Expected data, (n,), the same without noise, (n,), and the derivative of the expected data by the
physical values of each block that they depend on, (n, n_values)."""


class DataTerm(Protocol):
    """One kind of data of a band, which takes the values it knows of and leaves the others.

    Five methods are enough for a fit and its intervals; those after them have a default. A new kind
    of data touches four files: its term's own, `roomfit.fit.measurements`, which takes the
    data, `roomfit.fit.bands`, which lays terms of a band together, and the reader in
    `roomfit.files`.
    """

    __slots__ = ()
    # energies, never negative and spread over decades, follow Gamma laws; all else normal laws
    is_gamma: ClassVar[bool]

    def measured(self) -> FloatArray:
        """Return the data, shape (n_data,)."""
        ...

    def predict(self, values: Values) -> Rows:
        """Return what values make the model expect, and count the evaluation."""
        ...

    def expected(self, values: Values) -> FloatArray:
        """Return the same expected data without derivatives, shape (n_data,)."""
        ...

    def variance_parts(self, values: Values) -> dict[str, FloatArray]:
        """Return what the variance of each datum is the sum of, by name, shape (n_data,) each."""
        ...

    def correlation_length(self, start: Values) -> FloatArray:
        """Return how many neighbours share the information of each datum, shape (n_data,)."""
        ...

    def as_energies(self, values: Values) -> EnergyTerm | None:  # noqa: ARG002
        """Return the data as window energies, their paths weighed as at values; else None."""
        return None

    def at_points(self, values: Values) -> Callable[[FloatArray], FloatArray] | None:  # noqa: ARG002
        """Return what approximates the expected data at many absorptions together, or None.

        From absorptions, (n_points, n_materials), to data, (n_points, n_data): exact at values,
        and much faster than one by one.
        """
        return None


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Expected data, all terms end to end, with derivatives."""

    expected: FloatArray  # (n_data,), what the model expects to be measured, noise included
    signal: FloatArray  # (n_data,), the same without noise
    jacobian: FloatArray  # (n_data, n_free), derivative of `expected` by the free vector


@dataclass(frozen=True, eq=False)
class Objective:
    """Data of one band, one kind after the other, that a vector of free numbers explains."""

    parameters: Parameters  # blocks of unknowns, one of them "absorption", one entry a material
    terms: tuple[DataTerm, ...]  # at least one
    inflation: FloatArray | None = None  # (n_data,), factor on each variance, 1 or more

    def measured(self) -> FloatArray:
        """Return the data, shape (n_data,)."""
        return np.concatenate([term.measured() for term in self.terms])

    def predict(self, vector: FloatArray) -> Prediction:
        """Return what a free vector makes the model expect."""
        values, slopes = physical_values(self.parameters, vector)
        expected, signal, jacobian = [], [], []
        for term in self.terms:
            mean, quiet, derivatives = term.predict(values)
            by_free = {name: by * slopes[name] for name, by in derivatives.items()}
            expected.append(mean)
            signal.append(quiet)
            jacobian.append(fitted_columns(self.parameters, by_free))
        return Prediction(
            np.concatenate(expected), np.concatenate(signal), np.concatenate(jacobian)
        )

    def expected(self, vector: FloatArray) -> FloatArray:
        """Return the expected data alone, shape (n_data,): faster than `predict`."""
        values, _ = physical_values(self.parameters, vector)
        return np.concatenate([term.expected(values) for term in self.terms])

    def variance(self, vector: FloatArray) -> FloatArray:
        """Return the variance of each datum about its expectation, shape (n_data,)."""
        values, _ = physical_values(self.parameters, vector)
        own = np.concatenate([total(term.variance_parts(values)) for term in self.terms])
        return own if self.inflation is None else self.inflation * own

    def variance_parts(self, vector: FloatArray) -> dict[str, FloatArray]:
        """Return what `variance` is the sum of by name, 0 for data without it, (n_data,) each."""
        values, _ = physical_values(self.parameters, vector)
        each = [term.variance_parts(values) for term in self.terms]
        sizes = [term.measured().size for term in self.terms]
        factor = 1.0 if self.inflation is None else self.inflation
        return {
            name: factor
            * np.concatenate([p.get(name, np.zeros(n)) for p, n in zip(each, sizes, strict=True)])
            for name in dict.fromkeys(name for parts in each for name in parts)
        }

    def residual(self, vector: FloatArray) -> FloatArray:
        """Return measured minus expected data over their standard deviation, shape (n_data,)."""
        misfit = self.measured() - self.expected(vector)
        return np.asarray(misfit / np.sqrt(self.variance(vector)))

    def jacobian(self, vector: FloatArray) -> FloatArray:
        """Return the derivative of the expected data by the free vector, (n_data, n_free)."""
        return self.predict(vector).jacobian

    def logl(self, vector: FloatArray) -> float:
        """Return the log likelihood of the data with every constant, priors left out."""
        return float(self.log_likelihood(self.expected(vector), self.variance(vector)).sum())

    def information(self, absorption: FloatArray) -> FloatArray:
        """Return the Fisher information of the data on the free vector, without priors.

        Of shape (n_free, n_free), at an absorption of shape (n_materials,), all other unknowns
        where they start.
        """
        blocks = tuple(
            replace(b, start=absorption) if b.name == "absorption" else b
            for b in self.parameters.blocks
        )
        parameters = replace(self.parameters, blocks=blocks)
        there, vector = replace(self, parameters=parameters), start_vector(parameters)
        jacobian = there.jacobian(vector)
        spread = there.correlation_length() * there.variance(vector)
        return np.asarray(jacobian.T @ (jacobian / spread[:, None]))

    def correlation_length(self) -> FloatArray:
        """Return how many neighbours share the information of each datum, shape (n_data,)."""
        return self._correlation_length

    @cached_property
    def _correlation_length(self) -> FloatArray:
        start, _ = physical_values(self.parameters, start_vector(self.parameters))
        return read_only(np.concatenate([t.correlation_length(start) for t in self.terms]))

    def is_gamma(self) -> BoolArray:
        """Return which data follow Gamma laws, shape (n_data,)."""
        return np.repeat([t.is_gamma for t in self.terms], [t.measured().size for t in self.terms])

    def as_energies(self, vector: FloatArray) -> EnergyTerm | None:
        """Return the first term as window energies, their paths weighed as at a free vector."""
        return self.terms[0].as_energies(physical_values(self.parameters, vector)[0])

    def at_points(self, vector: FloatArray) -> Callable[[FloatArray], FloatArray] | None:
        """Return `DataTerm.at_points` of the only term, exact at a free vector; else None."""
        first, *others = self.terms
        return None if others else first.at_points(physical_values(self.parameters, vector)[0])

    def log_likelihood(self, expected: FloatArray, variance: FloatArray) -> FloatArray:
        """Return the log density of each datum with every constant, shape (n_data,).

        For choosing between models, whose variances differ: squares alone cannot compare them.
        """
        ends = np.cumsum([term.measured().size for term in self.terms])[:-1]
        split = zip(self.terms, np.split(expected, ends), np.split(variance, ends), strict=True)
        return np.concatenate(
            [
                (gamma_log_likelihood if term.is_gamma else normal_log_likelihood)(
                    term.measured(), mean, spread
                )
                for term, mean, spread in split
            ]
        )


def total(parts: Mapping[str, FloatArray]) -> FloatArray:
    """Return the sum of the parts of a variance, shape (n_data,)."""
    return np.asarray(np.sum(list(parts.values()), axis=0))


def normal_log_likelihood(
    measured: FloatArray, expected: FloatArray, variance: FloatArray
) -> FloatArray:
    """Return the log density of data that follow normal laws, shape (n,)."""
    squares = (measured - expected) ** 2 / variance
    return np.asarray(-0.5 * (squares + np.log(2.0 * np.pi * variance)))


def gamma_log_likelihood(
    measured: FloatArray, expected: FloatArray, variance: FloatArray
) -> FloatArray:
    """Return the log density of energies that follow Gamma laws of given mean and variance, (n,).

    A window's energy is a sum of squares of nearly Gaussian pressures: never negative, and skew.
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
