"""A kind of data that roomfit does not know, fitted with nothing but its term.

Here: equivalent absorption areas, measured while some of the surfaces were covered.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.optimize import minimize

from posterior_cases import absorption_block
from roomfit.base.forks import count_evaluation
from roomfit.base.logit import expit
from roomfit.base.typing import FloatArray
from roomfit.fit.bands import without_responses
from roomfit.materials.priors import unknown_material
from roomfit.model.parameters import Parameters, prior_residuals
from roomfit.model.problem import DataTerm, Objective, Rows, Values
from roomfit.solver import fit_band
from roomfit.uncertainty.gaussian import BandEstimate, FittedBand, band_estimate
from roomfit.uncertainty.intervals import Refinement

AREAS_M2 = np.array([40.0, 25.0])
TRUTH = np.array([0.1, 0.45])


@dataclass(frozen=True, slots=True, eq=False)
class AreaTerm(DataTerm):
    """Equivalent absorption areas in m2: the sum of bare areas times their absorption."""

    is_gamma: ClassVar[bool] = False
    bare_m2: FloatArray  # (n_data, n_materials)
    areas_m2: FloatArray  # (n_data,), as measured
    sd_m2: float

    def measured(self) -> FloatArray:
        """Return the measured areas."""
        return self.areas_m2

    def predict(self, values: Values) -> Rows:
        """Return the expected areas, and their derivative by absorption."""
        count_evaluation()
        expected = self.bare_m2 @ values["absorption"]
        return expected, expected, {"absorption": self.bare_m2}

    def expected(self, values: Values) -> FloatArray:
        """Return the expected areas."""
        return self.predict(values)[0]

    def variance_parts(self, _values: Values) -> dict[str, FloatArray]:
        """Return the variance of the measurement."""
        return {"repeatability": np.full(self.areas_m2.size, self.sd_m2**2)}

    def correlation_length(self, _start: Values) -> FloatArray:
        """Return 1: each area was measured by itself."""
        return np.ones(self.areas_m2.size)


def area_term(seed: int = 3) -> AreaTerm:
    """Return twelve measurements with either surface covered by a quarter, a half or not at all."""
    rng = np.random.default_rng(seed)
    bare = AREAS_M2 * rng.choice([0.5, 0.75, 1.0], (12, 2))
    return AreaTerm(bare, bare @ TRUTH + 0.3 * rng.standard_normal(12), 0.3)


def estimate(profiles: bool) -> BandEstimate:
    """Return what a band of nothing but areas gives with Gaussian intervals or profiles."""
    objective = Objective(Parameters((absorption_block(2),)), (area_term(),))
    fit = fit_band(objective)
    gaussian = band_estimate(objective.parameters, fit, "values")
    refine = Refinement(profiles, 1, n_draws=64)
    return refine(FittedBand(gaussian, objective, fit))


def test_a_term_of_five_methods_is_fitted_to_the_most_likely_absorption() -> None:
    """Against a minimiser that knows squares and the prior of the logits, and no objective."""
    term, parameters = area_term(), Parameters((absorption_block(2),))

    def half_squares(free: FloatArray) -> float:
        off = (term.areas_m2 - term.bare_m2 @ expit(free)) / term.sd_m2
        prior = prior_residuals(parameters, free)[0]
        return 0.5 * float(off @ off + prior @ prior)

    best = minimize(half_squares, np.array([-2.0, 0.0]), tol=1e-12)
    found = estimate(False)
    # a fit ends within .02 of a standard deviation of its answer
    sd = np.sqrt(np.diag(found.logit_covariance))
    np.testing.assert_array_less(np.abs(found.logit_mean - best.x), 0.02 * sd)
    np.testing.assert_allclose(found.cost, best.fun, atol=1e-3)


def test_every_method_of_intervals_takes_a_term_that_it_does_not_know() -> None:
    """Twelve areas determine both surfaces; intervals of all methods agree within a seventh."""
    plain, found = estimate(False), estimate(True)
    assert np.all((found.lower95 < TRUTH) & (found.upper95 > TRUTH))
    width = plain.upper95 - plain.lower95
    np.testing.assert_array_less(np.abs(found.lower95 - plain.lower95), width / 7.0)
    np.testing.assert_array_less(np.abs(found.upper95 - plain.upper95), width / 7.0)
    assert found.draws is not None
    assert found.draws.shape == (64, 2)


def test_a_band_without_responses_takes_terms_of_any_kind() -> None:
    """Two terms share the unknowns: their data stand end to end."""
    prior = (unknown_material("a", 1), unknown_material("b", 1))
    objective = without_responses((area_term(1), area_term(2)), prior, 0, np.full(1, 0.3))
    assert objective is not None
    assert objective.measured().size == 24
    assert objective.as_energies(np.zeros(2)) is None
    assert without_responses((), prior, 0, np.full(1, 0.3)) is None
