"""A problem some of whose data are trusted less than its noise model says."""

from __future__ import annotations

from dataclasses import dataclass

from roomfit.objective.parameters import Parameters
from roomfit.objective.problem import BandProblem, Prediction
from roomfit.typing import BoolArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class SoftenedProblem:
    """The same problem with variances enlarged.

    Attributes
    ----------
    problem : BandProblem
    factor : float array, shape (n_data,)
        By which each variance is multiplied, 1 or more.
    """

    problem: BandProblem
    factor: FloatArray

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

    def counted_as_one(self) -> FloatArray:
        """Return how many neighbours share the information of each datum, shape (n_data,)."""
        return self.problem.counted_as_one()

    def are_energies(self) -> BoolArray:
        """Return which data are energies, shape (n_data,)."""
        return self.problem.are_energies()

    def log_likelihood(self, expected: FloatArray, variance: FloatArray) -> FloatArray:
        """Return the log density of each datum, shape (n_data,)."""
        return self.problem.log_likelihood(expected, variance)
