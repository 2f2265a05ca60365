"""Every fit says how it ended, and running out of damping is not convergence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posterior_cases import Linear, linear_case
from roomfit.base.typing import FloatArray
from roomfit.model.problem import Prediction
from roomfit.solver import Ending, fit_band, score_band


class WrongSign(Linear):
    """A linear problem with a derivative of the wrong sign."""

    def predict(self, vector: FloatArray) -> Prediction:
        found = super().predict(vector)
        return replace(found, jacobian=-found.jacobian)


def test_a_band_with_a_wrong_derivative_is_not_called_converged() -> None:
    """Both ways to fit a band say that the damping ran out; with the right one they converge."""
    right = linear_case(0)
    wrong = WrongSign(right.matrix, right.observed, right.sd, right.parameters)
    start = np.zeros(right.matrix.shape[1])
    for problem, converged in ((right, True), (wrong, False)):
        fits = (fit_band(problem), score_band(problem, start, max_rounds=36))
        for fit in fits:
            assert fit.converged is converged
            if not converged:
                assert fit.ending is Ending.OUT_OF_DAMPING
