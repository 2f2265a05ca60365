"""Every fit says how it ended, and running out of damping is not convergence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posterior_cases import Linear, linear_case
from roomfit.base.typing import FloatArray
from roomfit.model.problem import Prediction
from roomfit.solver import Ending, MarquardtSettings, fit_band, levenberg_marquardt, score_band


def decay_residuals(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Samples of 0.3 exp(-2 t) and their derivative by amplitude and rate, in units of 0.001."""
    t = np.linspace(0.0, 2.0, 30)
    e = np.exp(-x[1] * t)
    rows = np.stack((e, -x[0] * t * e), axis=1)
    return 1e3 * (x[0] * e - 0.3 * np.exp(-2.0 * t)) + np.cos(40.0 * t), 1e3 * rows


def test_every_evaluation_counts_and_too_few_steps_say_so() -> None:
    """One at the start, one a trial step."""
    calls = 0

    def watched(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        nonlocal calls
        calls += 1
        return decay_residuals(x)

    found = levenberg_marquardt(watched, np.array([0.5, 1.0]), MarquardtSettings(max_trials=2))
    assert found.ending is Ending.OUT_OF_STEPS
    assert found.evaluations == calls == 3


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
