"""Levenberg-Marquardt: damped Gauss-Newton steps towards the least sum of squares."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from roomfit.base.typing import FloatArray
from roomfit.solver.ending import Ending

ResidualFunction: TypeAlias = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Residuals, shape (n_rows,), and their derivative, shape (n_rows, n), at a point, shape (n,)."""


@dataclass(frozen=True, slots=True)
class MarquardtSettings:
    """How steps are damped, and which step is the last.

    A step solves ``(H + damping diag(H)) step = -gradient`` with ``H = J^T J``. The first one that
    meets one of the three tests of convergence ends the descent; a test of 0 is never met.
    """

    max_trials: int = 40  # steps tried, whether they help or not
    damping: float = 1e-3  # of the first step
    lowered: float = 0.1  # factor on the damping after a step that helps
    raised: float = 8.0  # and after one that does not
    least_damping: float = 0.0
    most_damping: float = 1e10
    ridge: float = 0.0  # share of the mean of diag(H) added to it before it is damped
    longest_entry: float = math.inf  # a longer step is shortened, all entries alike
    # converged: ...
    length_sd: float = 0.0  # root of step' H step, a length in standard deviations, below this
    gain: float = 0.0  # the cost fell by less
    relative_gain: float = 0.0  # the cost fell by less than this share of it
    # a step that does not help is the last where it promised at most this share of the cost
    least_promise: float = 0.0


class Minimum(NamedTuple):
    """Where a descent ended, and how."""

    x: FloatArray  # (n,)
    cost: float  # half the sum of squares
    evaluations: int
    ending: Ending
    normal: FloatArray = np.empty((0, 0))  # J^T J at x, undamped; (0, 0) without derivative


def levenberg_marquardt(
    residuals: ResidualFunction, start: FloatArray, settings: MarquardtSettings
) -> Minimum:
    """Return a local minimum of the sum of squares [1]_.

    Running out of damping is convergence only where a Gauss-Newton step from there would pass the
    test of convergence: rounding then leaves nothing to gain. Otherwise the derivative is wrong.

    Shapes: `start` (n,).

    References
    ----------
    .. [1] D. W. Marquardt, "An algorithm for least-squares estimation of nonlinear parameters",
           J. Soc. Indust. Appl. Math. 11, 431-441 (1963).
    """
    x = np.array(start, dtype=np.float64)
    values, jacobian = residuals(x)
    cost, damping = 0.5 * float(values @ values), settings.damping
    gradient, normal = jacobian.T @ values, jacobian.T @ jacobian
    trials = 0

    def ended(ending: Ending) -> Minimum:
        return Minimum(x, cost, 1 + trials, ending, normal)

    if not x.size:
        return ended(Ending.CONVERGED)
    while trials < settings.max_trials:
        step = _damped_step(normal, gradient, damping, settings)
        values, jacobian = residuals(x + step)
        trials += 1
        there = 0.5 * float(values @ values)
        if there < cost:
            last = _is_last(step, normal, cost - there, cost, settings)
            x, cost = x + step, there
            gradient, normal = jacobian.T @ values, jacobian.T @ jacobian
            damping = max(settings.lowered * damping, settings.least_damping)
            if last:
                return ended(Ending.CONVERGED)
            continue
        damping *= settings.raised
        promises_little = -float(gradient @ step) <= settings.least_promise * cost
        if damping >= settings.most_damping or promises_little:
            newton = _damped_step(normal, gradient, settings.damping, settings)
            promised = -0.5 * float(gradient @ newton)
            exact = _is_last(newton, normal, promised, cost, settings)
            return ended(Ending.NO_MORE_PROGRESS if exact else Ending.OUT_OF_DAMPING)
    return ended(Ending.OUT_OF_STEPS)


def _damped_step(
    normal: FloatArray, gradient: FloatArray, damping: float, settings: MarquardtSettings
) -> FloatArray:
    scale = np.diag(normal)
    if settings.ridge:
        scale = scale + settings.ridge * np.trace(normal) / len(normal)
    step = -np.linalg.solve(normal + damping * np.diag(scale), gradient)
    if math.isfinite(settings.longest_entry):
        step *= min(1.0, settings.longest_entry / max(float(np.abs(step).max()), 1e-12))
    return np.asarray(step, dtype=np.float64)


def _is_last(
    step: FloatArray, normal: FloatArray, gain: float, cost: float, settings: MarquardtSettings
) -> bool:
    """Whether a step meets one of the tests of convergence."""
    if gain < settings.gain or gain < settings.relative_gain * cost:
        return True
    return float(step @ normal @ step) < settings.length_sd**2
