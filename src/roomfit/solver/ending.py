"""How a fit or a search ended: the same few words for all of them, each with its advice."""

from __future__ import annotations

from enum import Enum


class Ending(Enum):
    """Why a minimisation stopped, whether that is convergence, and what to do about it.

    Converged says that the method met its own test; the minimum may still be a local one.
    """

    CONVERGED = (
        "converged",
        True,
        "The last step changed less than the tolerance. It may be a local minimum: start again "
        "elsewhere and compare.",
    )
    NO_MORE_PROGRESS = (
        "no-more-progress",
        True,
        "No step lowers the cost, and its curvature promises less than the tolerance: the answer "
        "is as exact as rounding permits.",
    )
    COLLAPSED = (
        "simplex-collapsed",
        True,
        "The simplex became too small to change before its test was met, as happens where the "
        "lowest error is 0; the point is as exact as numbers allow.",
    )
    OUT_OF_STEPS = (
        "steps-used-up",
        False,
        "The cost still fell when the steps allowed were used up: allow more, or fix parameters "
        "that the data do not determine.",
    )
    OUT_OF_ROUNDS = (
        "rounds-used-up",
        False,
        "The answer still moved after as many rounds of updated weights or corrections as are "
        "allowed: look for outliers, or fix parameters that the data do not determine.",
    )
    OUT_OF_EVALUATIONS = (
        "evaluations-used-up",
        False,
        "The search still moved when the evaluations allowed were used up: allow more, start again "
        "from its best point, or use least squares.",
    )
    OUT_OF_DAMPING = (
        "damping-used-up",
        False,
        "No step along the gradient lowers the cost, however short, although its curvature "
        "promises more than the tolerance: the derivative does not belong to the residuals, or "
        "they are not smooth here.",
    )

    def __init__(self, code: str, converged: bool, advice: str) -> None:
        self.code = code
        self.converged = converged
        self.advice = advice
