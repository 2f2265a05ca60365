"""What every search hands back: where it ended, how much it cost, and how it ended."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from roomfit.checks import float_array
from roomfit.typing import FloatArray

ErrorFunction: TypeAlias = Callable[[FloatArray], float]
"""Error of one point of the unit box, shape (n,); lower is better."""


@dataclass(frozen=True, slots=True)
class Ending:
    """How a search ended.

    Attributes
    ----------
    code : str
        Short and stable, in kebab case, for programs.
    sentence : str
        For a person: what happened and, where it did not go well, what to do.
    converged : bool
        Whether the search met its own test; it may still sit in a local minimum.
    """

    code: str
    sentence: str
    converged: bool


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Where a search ended.

    Attributes
    ----------
    x : float array, shape (n,)
        Best point found, within the unit box.
    cost : float
        Error there.
    evaluations : int
        How often the error was computed, with or without its derivative.
    iterations : int
        Steps of the method, in its own sense.
    ending : Ending
    trail : float array, shape (n_visited, n)
        Points at which the search stood, in order; what "stood" means, each method says.
    trail_cost : float array, shape (n_visited,)
    """

    x: FloatArray
    cost: float
    evaluations: int
    iterations: int
    ending: Ending
    trail: FloatArray
    trail_cost: FloatArray

    def __post_init__(self) -> None:
        x = float_array("answer", self.x, (None,), low=0.0, high=1.0)
        object.__setattr__(self, "x", x)
        object.__setattr__(self, "trail", float_array("trail", self.trail, (None, x.size)))
        cost = float_array("errors of the trail", self.trail_cost, (len(self.trail),))
        object.__setattr__(self, "trail_cost", cost)


class Counted:
    """An error function that counts its calls and is infinite outside the unit box.

    A point outside costs nothing, because nothing is computed there.
    """

    def __init__(self, error: ErrorFunction) -> None:
        self._error = error
        self.evaluations = 0

    def __call__(self, x: FloatArray) -> float:
        if x.min() < 0.0 or x.max() > 1.0:
            return np.inf
        self.evaluations += 1
        return float(self._error(x))


def best_of(fits: Sequence[Fit]) -> Fit:
    """Return the fit of lowest cost with the work and the trails of all."""
    best = min(fits, key=lambda fit: fit.cost)
    return Fit(
        best.x,
        best.cost,
        sum(fit.evaluations for fit in fits),
        sum(fit.iterations for fit in fits),
        best.ending,
        np.concatenate([fit.trail for fit in fits]),
        np.concatenate([fit.trail_cost for fit in fits]),
    )
