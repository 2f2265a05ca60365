"""How the reflection coefficient of a material may run over frequency; splines."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy.interpolate import BSpline

from roomfit.errors import InputError
from roomfit.typing import ComplexArray, FloatArray, IntArray

_KNOTS_PER_OCTAVE = 4
_CLOSEST_KNOTS_HZ = 25.0


class Curve(Protocol):
    """R0 over frequency as a function of real numbers x."""

    @property
    def kind(self) -> str:
        """Name of the curve in a campaign."""

    @property
    def start(self) -> FloatArray:
        """Where to begin, shape (n,)."""

    @property
    def roughness(self) -> FloatArray:
        """Rows whose products with x are wanted small, shape (n_rows, n)."""

    @property
    def prior_sd(self) -> float:
        """Standard deviation of each x about its start, infinite where nothing is known."""

    def r0(self, x: FloatArray) -> ComplexArray:
        """Return R0, shape (n_frequencies,)."""

    def slope(self, x: FloatArray) -> ComplexArray:
        """Return the derivative of R0 by x, shape (n_frequencies, n)."""

    def at(self, chosen: IntArray) -> Curve:
        """Return the curve at some of its frequencies."""

    def between(self, x: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Return R0 and slope where it must be held passive, between the frequencies as well."""


@dataclass(frozen=True, slots=True, eq=False)
class Spline:
    """R0 as a combination of real functions of frequency: x holds real, then imaginary parts.

    Attributes
    ----------
    kind : str
        "spline", or "constant" where the one function is 1.
    basis : float array, shape (n_frequencies, n_functions)
    dense : float array, shape (n_places, n_functions)
        The functions on a finer grid, where R0 is held passive.
    start_r0 : complex
    """

    kind: str
    basis: FloatArray
    dense: FloatArray
    start_r0: complex = 0.8

    @property
    def start(self) -> FloatArray:
        n = self.basis.shape[1]
        return np.repeat(np.array([self.start_r0.real, self.start_r0.imag], np.float64), n)

    @property
    def roughness(self) -> FloatArray:
        n = self.basis.shape[1]
        if n < 3:
            return np.zeros((0, 2 * n))
        return np.asarray(np.kron(np.eye(2), np.diff(np.eye(n), 2, axis=0)), dtype=np.float64)

    @property
    def prior_sd(self) -> float:
        return math.inf

    def r0(self, x: FloatArray) -> ComplexArray:
        return _complex(self.basis, x)

    def slope(self, x: FloatArray) -> ComplexArray:  # noqa: ARG002 -- the same everywhere
        return np.hstack([self.basis, 1j * self.basis])

    def at(self, chosen: IntArray) -> Spline:
        return replace(self, basis=self.basis[chosen])

    def between(self, x: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        return _complex(self.dense, x), np.hstack([self.dense, 1j * self.dense])


def _complex(basis: FloatArray, x: FloatArray) -> ComplexArray:
    n = basis.shape[1]
    return np.asarray(basis @ (x[:n] + 1j * x[n:]))


def spline(frequency_hz: FloatArray, start_r0: complex = 0.8) -> Spline:
    """Return a cubic B-spline over the logarithm of frequency.

    Knots every quarter octave, but at least 25 Hz apart and no more than the frequencies allow; of
    fewer than four frequencies each is free.

    Raises
    ------
    InputError
        A start that is not passive.
    """
    _check_passive(start_r0)
    if len(frequency_hz) < 4:
        eye = np.eye(len(frequency_hz))
        return Spline("spline", eye, eye, start_r0)
    knots = _knots_hz(float(frequency_hz[0]), float(frequency_hz[-1]))
    if len(knots) + 2 > len(frequency_hz):
        knots = np.geomspace(frequency_hz[0], frequency_hz[-1], len(frequency_hz) - 2)
    t = np.log(np.concatenate(([knots[0]] * 3, knots, [knots[-1]] * 3)))
    fine = np.exp(np.linspace(t[0], t[-1], 8 * len(knots)))
    dense = np.concatenate([frequency_hz, fine])

    def at(f: FloatArray) -> FloatArray:
        inside = np.clip(np.log(f), t[0], t[-1])
        return np.asarray(BSpline.design_matrix(inside, t, 3).toarray())

    return Spline("spline", at(frequency_hz), at(dense), start_r0)


def constant(frequency_hz: FloatArray, start_r0: complex = 0.8) -> Spline:
    """Return a reflection coefficient that does not change with frequency."""
    _check_passive(start_r0)
    return Spline("constant", np.ones((len(frequency_hz), 1)), np.ones((1, 1)), start_r0)


def _check_passive(r0: complex) -> None:
    if not abs(r0) <= 1.0:
        raise InputError(
            "a wall cannot give back more than it gets",
            found=f"a start of |R0| = {abs(r0):.4g}",
            needed="|R0| <= 1",
        )


def _knots_hz(low: float, high: float) -> FloatArray:
    """Return knots from low to high, a quarter octave and at least 25 Hz apart."""
    knots = [low]
    while knots[-1] < high:
        knots.append(max(knots[-1] * 2.0 ** (1 / _KNOTS_PER_OCTAVE), knots[-1] + _CLOSEST_KNOTS_HZ))
    # drawn together, so that the last one ends where the data do
    shrink = math.log(high / low) / math.log(knots[-1] / low)
    return np.asarray(low * (np.array(knots) / low) ** shrink)
