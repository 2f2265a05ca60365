"""Downhill simplex, by equations (2) to (7) of Suh (2001).

Where that text is incomplete or unusual, this is what is done here:

- A failed contraction: the paper is silent. The simplex shrinks to half its size towards its lowest
  vertex, as Nelder and Mead (1965) have it.
- The order of operations: as printed, every reflection below the highest vertex is taken, and the
  expansion is tried only where the reflection has *failed*, which doubles a step in a direction
  that has just proved wrong. Nelder and Mead expand where the reflection is the best point so far,
  and contract where it is no better than the second highest. Both are offered; theirs is the
  default.
- Bounds: a point outside the unit box counts as infinitely bad and is not evaluated. Moving it to
  the wall instead would flatten the simplex into the wall, out of which no reflection leads.
- Test (7) asks for a small *relative* difference. Where the lowest error is 0, as with data made
  by the model itself, it is met only when rounding ends all differences; a simplex too small for
  further change in any coordinate therefore ends the search under either test.

References
----------
.. [1] J. S. Suh, "In-situ determination of absorption coefficients in a room" (2001).
.. [2] J. A. Nelder, R. Mead, "A simplex method for function minimization", Computer Journal 7,
       308-313 (1965).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from roomfit.checks import float_array
from roomfit.errors import InputError
from roomfit.identification.fit import Counted, Ending, ErrorFunction, Fit
from roomfit.typing import FloatArray

Order = Literal["nelder-mead", "as-printed"]
ConvergenceTest = Literal["spread", "fraction"]

# Below this extent the error no longer changes by more than its own rounding.
_COLLAPSED = 1e-11


@dataclass(frozen=True, slots=True)
class SimplexSettings:
    """How the simplex moves and when it stops.

    Attributes
    ----------
    order : {"nelder-mead", "as-printed"}
        Which operation is tried when; see the module's text.
    test : {"spread", "fraction"}
        Equation (6), root mean square difference from the error at the centroid, in the unit of
        the error (one more evaluation a step); or equation (7), relative difference of highest and
        lowest.
    tolerance : float
        tau of either test.
    reflection, expansion, contraction, shrinkage : float
        alpha in (0, 1], gamma > 1, beta in (0, 1), and the factor after a failed contraction.
    max_evaluations : int
    """

    order: Order = "nelder-mead"
    test: ConvergenceTest = "spread"
    tolerance: float = 1e-6
    reflection: float = 1.0
    expansion: float = 2.0
    contraction: float = 0.5
    shrinkage: float = 0.5
    max_evaluations: int = 20_000

    def __post_init__(self) -> None:
        if self.order not in ("nelder-mead", "as-printed"):
            raise InputError("unknown order of simplex operations", found=repr(self.order))
        if self.test not in ("spread", "fraction"):
            raise InputError("unknown convergence test", found=repr(self.test))
        ranges = (
            ("reflection", 0.0 < self.reflection <= 1.0, "above 0, at most 1"),
            ("expansion", self.expansion > 1.0, "above 1"),
            ("contraction", 0.0 < self.contraction < 1.0, "between 0 and 1"),
            ("shrinkage", 0.0 < self.shrinkage < 1.0, "between 0 and 1"),
            ("tolerance", self.tolerance > 0.0, "above 0"),
            ("max_evaluations", self.max_evaluations >= 1, "at least 1"),
        )
        for name, holds, needed in ranges:
            if not holds:
                raise InputError(
                    "simplex setting is out of range",
                    where=name,
                    found=f"{getattr(self, name):g}",
                    needed=needed,
                )


@dataclass(slots=True)
class Simplex:
    """The vertices and their errors, lowest first; the state of a search.

    Attributes
    ----------
    vertices : float array, shape (n + 1, n)
    errors : float array, shape (n + 1,)
    """

    vertices: FloatArray
    errors: FloatArray

    def sort(self) -> None:
        """Bring the lowest vertex to the front and the highest to the end."""
        order = np.argsort(self.errors, kind="stable")
        self.vertices, self.errors = self.vertices[order], self.errors[order]

    def replace_highest(self, x: FloatArray, error: float) -> None:
        """Put a new vertex in the place of the highest."""
        self.vertices[-1], self.errors[-1] = x, error


def downhill_simplex(
    error: ErrorFunction, start: FloatArray, settings: SimplexSettings | None = None
) -> Fit:
    """Move a simplex downhill until its vertices agree.

    Parameters
    ----------
    error : callable
        Takes a point of the unit box, shape (n,).
    start : float array, shape (n + 1, n)
        Vertices of the first simplex, within the unit box, not all in one plane.
    settings : SimplexSettings, optional

    Returns
    -------
    Fit
        The trail holds the lowest vertex of every simplex, as Table 2 of the paper does.
    """
    settings = SimplexSettings() if settings is None else settings
    n = np.shape(start)[-1]
    vertices = np.array(float_array("simplex", start, (n + 1, n), low=0.0, high=1.0))
    counted = Counted(error)
    state = Simplex(vertices, np.array([counted(v) for v in vertices]))
    state.sort()
    trail, costs = [state.vertices[0].copy()], [state.errors[0]]
    ending = _ending(state, counted, settings)
    while ending is None:
        move_once(state, counted, settings)
        trail.append(state.vertices[0].copy())
        costs.append(state.errors[0])
        ending = _ending(state, counted, settings)
    return Fit(
        state.vertices[0],
        float(state.errors[0]),
        counted.evaluations,
        len(trail) - 1,
        ending,
        np.array(trail),
        np.array(costs),
    )


def move_once(state: Simplex, error: ErrorFunction, settings: SimplexSettings) -> None:
    """Replace the highest vertex of a sorted simplex by a lower point, or shrink; sort again."""
    centroid = state.vertices[:-1].mean(axis=0)  # (2)
    if settings.order == "as-printed":
        _move_as_printed(state, error, settings, centroid)
    else:
        _move_nelder_mead(state, error, settings, centroid)
    state.sort()


def simplex_around(x: FloatArray, size: float) -> FloatArray:
    """Return a simplex with one vertex at `x` and its n edges along the axes.

    Parameters
    ----------
    x : float array, shape (n,)
        Within the unit box.
    size : float
        Length of each edge, at most 0.5; the edge points to the farther wall.

    Returns
    -------
    float array, shape (n + 1, n)
    """
    edges = np.diag(np.where(x <= 0.5, size, -size))
    return np.concatenate((x[None, :], x + edges))


def random_simplex(n: int, rng: np.random.Generator) -> FloatArray:
    """Return a simplex with edges of 0.3 at a place drawn evenly from the unit box, (n + 1, n)."""
    return simplex_around(rng.random(n), 0.3)


def _move_nelder_mead(
    state: Simplex, error: ErrorFunction, settings: SimplexSettings, centroid: FloatArray
) -> None:
    away = centroid - state.vertices[-1]
    x_r = centroid + settings.reflection * away  # (3)
    e_r = error(x_r)
    if e_r < state.errors[0]:
        x_e = centroid + settings.expansion * away  # (4)
        e_e = error(x_e)
        state.replace_highest(*((x_e, e_e) if e_e < e_r else (x_r, e_r)))
        return
    if e_r < state.errors[-2]:
        state.replace_highest(x_r, e_r)
        return
    if e_r < state.errors[-1]:
        state.replace_highest(x_r, e_r)
    _contract(state, error, settings, centroid)


def _move_as_printed(
    state: Simplex, error: ErrorFunction, settings: SimplexSettings, centroid: FloatArray
) -> None:
    away = centroid - state.vertices[-1]
    for factor in (settings.reflection, settings.expansion):  # (3), then (4)
        x = centroid + factor * away
        e = error(x)
        if e < state.errors[-1]:
            state.replace_highest(x, e)
            return
    _contract(state, error, settings, centroid)


def _contract(
    state: Simplex, error: ErrorFunction, settings: SimplexSettings, centroid: FloatArray
) -> None:
    x_c = centroid + settings.contraction * (state.vertices[-1] - centroid)  # (5)
    e_c = error(x_c)
    if e_c < state.errors[-1]:
        state.replace_highest(x_c, e_c)
        return
    lowest = state.vertices[0]
    state.vertices[1:] = lowest + settings.shrinkage * (state.vertices[1:] - lowest)
    state.errors[1:] = [error(v) for v in state.vertices[1:]]


def spread(state: Simplex, error: ErrorFunction) -> float:
    """Return the left side of equation (6): rms difference from the error at the centroid.

    The centroid tells a small simplex from one that lies evenly across a minimum.
    """
    at_centroid = error(state.vertices[:-1].mean(axis=0))
    return float(np.sqrt(np.mean((state.errors - at_centroid) ** 2)))


def fraction(state: Simplex) -> float:
    """Return the left side of equation (7): (highest - lowest) / highest; 0 where both are 0."""
    highest, lowest = float(state.errors[-1]), float(state.errors[0])
    return (highest - lowest) / highest if highest != lowest else 0.0


def _ending(state: Simplex, counted: Counted, settings: SimplexSettings) -> Ending | None:
    tests: dict[ConvergenceTest, Callable[[], float]] = {
        "spread": lambda: spread(state, counted),
        "fraction": lambda: fraction(state),
    }
    if tests[settings.test]() <= settings.tolerance:
        number = {"spread": 6, "fraction": 7}[settings.test]
        return Ending(
            "simplex-converged",
            f"The simplex met test ({number}) with tolerance {settings.tolerance:g}. It may be a "
            "local minimum: start again elsewhere and compare.",
            converged=True,
        )
    if np.ptp(state.vertices, axis=0).max() <= _COLLAPSED:
        return Ending(
            "simplex-collapsed",
            "The simplex became too small to change before the test was met, as happens with "
            "test (7) where the lowest error is 0; the point is as exact as numbers allow.",
            converged=True,
        )
    if counted.evaluations >= settings.max_evaluations:
        return Ending(
            "evaluations-used-up",
            f"The simplex still moved after {counted.evaluations} evaluations: start again from "
            "its best point with a fresh simplex, or use least squares.",
            converged=False,
        )
    return None
