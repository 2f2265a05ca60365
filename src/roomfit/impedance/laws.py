"""The impedance of locally reacting walls over frequency: smooth curves, and absorption.

Impedances are relative to that of air (rho c) and follow ``exp(+j w t)``. Frequencies may be
complex, ``f - j / (2 pi tau)``, for spectra behind an exponential window.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, TypeAlias, get_args

import numpy as np
from scipy.interpolate import BSpline

from roomfit.base.arguments import check_known
from roomfit.base.typing import ComplexArray, FloatArray, IntArray
from roomfit.impedance.wave_model import plane_reflection

START_R0 = 0.8 + 0.0j  # where a search begins: most walls are hard
_KNOTS_PER_OCTAVE = 4
_CLOSEST_KNOTS_HZ = 25.0
# Fewer frequencies than a cubic spline has coefficients are free, each for itself.
_LEAST_COUPLED = 4


@dataclass(frozen=True, slots=True, eq=False)
class Spline:
    """R0 as a combination of real functions of frequency: x holds real, then imaginary parts."""

    kind: str  # "spline", or "constant" where the one function is 1
    basis: FloatArray  # (n_frequencies, n_functions)
    prior_sd: ClassVar[float] = math.inf  # of each number about its start

    def start(self, r0: complex = START_R0) -> FloatArray:
        return np.repeat(np.array([r0.real, r0.imag]), self.basis.shape[1])

    @property
    def roughness(self) -> FloatArray:
        n = self.basis.shape[1]
        if n < 3:
            return np.zeros((0, 2 * n))
        return np.asarray(np.kron(np.eye(2), np.diff(np.eye(n), 2, axis=0)), dtype=np.float64)

    def values(self, x: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Return R0, (n_frequencies,), and its derivatives by x."""
        return _complex(self.basis, x), np.hstack([self.basis, 1j * self.basis])

    def at(self, chosen: IntArray) -> Spline:
        return replace(self, basis=self.basis[chosen])


def _complex(basis: FloatArray, x: FloatArray) -> ComplexArray:
    n = basis.shape[1]
    return np.asarray(basis @ (x[:n] + 1j * x[n:]))


def spline(frequency_hz: FloatArray) -> Spline:
    """Return a cubic B-spline over the logarithm of frequency.

    Knots every quarter octave, but at least 25 Hz apart and no more than the frequencies allow; of
    fewer than four frequencies each is free.
    """
    if len(frequency_hz) < _LEAST_COUPLED:
        return Spline("spline", np.eye(len(frequency_hz)))
    return Spline("spline", _design(_knots_hz(frequency_hz), frequency_hz)[0])


def _knots_hz(frequency_hz: FloatArray) -> FloatArray:
    """Return knots from the lowest to the highest frequency, as `spline` has them."""
    low, high = float(frequency_hz[0]), float(frequency_hz[-1])
    knots = [low]
    while knots[-1] < high:
        knots.append(max(knots[-1] * 2.0 ** (1 / _KNOTS_PER_OCTAVE), knots[-1] + _CLOSEST_KNOTS_HZ))
    if len(knots) + 2 > len(frequency_hz):
        return np.geomspace(low, high, len(frequency_hz) - 2)
    # drawn together, so that the last one ends where the data do
    shrink = math.log(high / low) / math.log(knots[-1] / low)
    return np.asarray(low * (np.array(knots) / low) ** shrink)


def _design(knots_hz: FloatArray, at_hz: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the cubic B-splines at frequencies, (n, n_functions), and the knots of all."""
    t = np.log(np.concatenate(([knots_hz[0]] * 3, knots_hz, [knots_hz[-1]] * 3)))
    inside = np.clip(np.log(at_hz), t[0], t[-1])
    return np.asarray(BSpline.design_matrix(inside, t, 3).toarray()), t


# Standard deviation of the factor by which an admittance may leave those of passive, causal walls:
# models of materials are not quite causal themselves, Miki's layers by 0.5 % of R0.
_DEPARTURE = 0.03
# The density reaches so many octaves beyond the data on either side, with coarser knots.
_BEYOND_OCTAVES, _KNOTS_PER_OCTAVE_BEYOND = 3, 2
# One unit of a density's numbers is e^30, so that their prior of one unit says nothing.
_LOG_UNIT = 30.0
# Damping below which the density is not resolved any finer, 1/s: a width of 4 Hz.
_LEAST_DAMPING = 25.0
_STEEPEST = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class CausalCurve:
    """R0 of a wall that is passive and answers only after it was struck, and of any smooth course.

    A function of s = j w has a positive real part wherever s has one, which is what passivity and
    causality ask of an admittance, if and only if it is ``c s`` and an integral of
    ``2 s / (pi (s^2 + v^2))`` over a density of v that is nowhere negative [1]_. Its logarithm is a
    cubic spline, of which x holds the coefficients first; then come the real and imaginary parts of
    the logarithm of a factor that departs a little from such a wall.

    References
    ----------
    .. [1] W. Cauer, "The Poisson integral for functions with positive real part", Bull. Amer. Math.
           Soc. 38, 713-717 (1932).
    """

    kind: ClassVar[str] = "spline"
    kernel: ComplexArray  # (n_frequencies, n_points): admittance by the density at each point
    density: FloatArray  # (n_points, n_coefficients), the spline of its logarithm
    log_coefficients: FloatArray  # (n_coefficients,), logarithm of v over the middle of the band
    basis: FloatArray  # (n_frequencies, n_functions), of the departure
    prior_sd: ClassVar[float] = 1.0

    def start(self, r0: complex = START_R0) -> FloatArray:
        """A density that is a power of v gives an admittance of one phase at all frequencies."""
        admittance = (1.0 - r0) / (1.0 + r0 if abs(1.0 + r0) > 1e-3 else 1e-3)
        size = float(np.clip(abs(admittance), 1e-3, 1e3))
        power = float(np.clip(np.angle(admittance) / (0.5 * np.pi), -_STEEPEST, _STEEPEST))
        level = math.log(size * math.cos(0.5 * np.pi * power))
        log_density = level + power * self.log_coefficients
        return np.concatenate((log_density / _LOG_UNIT, np.zeros(2 * self.basis.shape[1])))

    @property
    def roughness(self) -> FloatArray:
        n = len(self.log_coefficients)
        rows = np.diff(np.eye(n), 2, axis=0)
        return np.hstack((rows, np.zeros((len(rows), 2 * self.basis.shape[1]))))

    def at(self, chosen: IntArray) -> CausalCurve:
        return replace(self, kernel=self.kernel[chosen], basis=self.basis[chosen])

    def values(self, x: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Return R0, (n_frequencies,), and its derivatives by x."""
        n = len(self.log_coefficients)
        # a trial step may lead anywhere
        density = np.exp(np.clip(_LOG_UNIT * (self.density @ x[:n]), -50.0, 15.0))
        departure = _DEPARTURE * _complex(self.basis, x[n:])
        factor = np.exp(np.clip(departure.real, -2.0, 2.0) + 1j * departure.imag)
        admittance = factor * (self.kernel @ density)
        by = -2.0 / (1.0 + admittance) ** 2
        by_log = (_DEPARTURE * by * admittance)[:, None] * self.basis
        by_density = self.kernel @ ((_LOG_UNIT * density)[:, None] * self.density)
        r0 = (1.0 - admittance) / (1.0 + admittance)
        return r0, np.hstack(((by * factor)[:, None] * by_density, by_log, 1j * by_log))


Curve: TypeAlias = Spline | CausalCurve
WallKind = Literal["spline", "constant"]  # any smooth course of a passive, causal wall; or none


def curve_of(kind: WallKind, frequency_hz: ComplexArray) -> Curve:
    """Return R0 at complex frequencies, shape (n_frequencies,), as a fit starts with it.

    Frequencies are those of `roomfit.impedance.data.complex_frequency_hz`.
    """
    check_known("unknown model of a wall", kind, get_args(WallKind))
    if kind == "constant":
        return Spline("constant", np.ones((len(frequency_hz), 1)))
    return causal_curve(frequency_hz)


def causal_curve(frequency_hz: ComplexArray) -> CausalCurve | Spline:
    """Return any smooth course of R0 that a passive, causal wall can have, or nearly so.

    The density has the knots of `spline` within the frequencies, two an octave over three octaves
    beyond, and is level farther out. Fewer than four frequencies are free, as those of `spline`.

    `frequency_hz`, shape (n_frequencies,): by `roomfit.impedance.data.complex_frequency_hz`.
    """
    f = np.asarray(frequency_hz.real)
    free = spline(f)
    if len(f) < _LEAST_COUPLED:
        return free
    low, high = float(f[0]), float(f[-1])
    steps = np.arange(1, _BEYOND_OCTAVES * _KNOTS_PER_OCTAVE_BEYOND + 1) / _KNOTS_PER_OCTAVE_BEYOND
    knots = np.concatenate((low * 2.0 ** -steps[::-1], _knots_hz(f), high * 2.0**steps))
    damping = max(-2.0 * np.pi * float(frequency_hz[0].imag), _LEAST_DAMPING)
    fine_hz = min(damping / (8.0 * np.pi), 0.1 * low)
    points = np.concatenate(
        (
            np.geomspace(knots[0], low, 20 * len(steps), endpoint=False),
            np.arange(low, high, fine_hz),
            np.geomspace(high, knots[-1], math.ceil(_BEYOND_OCTAVES * high / (2.0 * fine_hz))),
        )
    )
    s = (2j * np.pi * f + damping)[:, None]
    edges = np.concatenate((points[:1], 0.5 * (points[1:] + points[:-1]), points[-1:]))
    v = 2.0 * np.pi * points
    kernel = s / (s**2 + v**2) * (2.0 * np.pi * np.diff(edges))
    # the integrals below the first point and above the last, where the density is level
    kernel[:, 0] += np.arctan(v[0] / s[:, 0])
    kernel[:, -1] += 0.5 * np.pi - np.arctan(v[-1] / s[:, 0])
    density, t = _design(knots, points)
    # where a spline's coefficients are those of a straight line
    at = np.array([t[i + 1 : i + 4].mean() for i in range(density.shape[1])])
    return CausalCurve(
        np.asarray(2.0 / np.pi * kernel, dtype=np.complex128),
        density,
        at - 0.5 * math.log(low * high),
        free.basis,
    )


_ANGLES = 64


def impedance_of_r0(r0: ComplexArray) -> ComplexArray:
    """Return ``Z = (1 + R0) / (1 - R0)``; infinite where R0 is 1."""
    r = np.asarray(r0, dtype=np.complex128)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray((1.0 + r) / (1.0 - r))


def absorption_normal(r0: ComplexArray) -> FloatArray:
    """Return the absorption coefficient at normal incidence, ``1 - |R0|**2``."""
    return np.asarray(1.0 - np.abs(r0) ** 2)


def absorption_random(r0: ComplexArray) -> FloatArray:
    """Return the absorption for random incidence on an infinite wall, by Paris's integral [1]_.

    ``integral of (1 - |R(theta)|**2) sin(2 theta)`` over 0 to 90 degrees, by Gauss's rule in
    ``cos(theta)**2`` with 64 nodes in its root.

    References
    ----------
    .. [1] E. T. Paris, "On the coefficient of sound-absorption measured by the reverberation
           method", Phil. Mag. 5, 489-497 (1928).
    """
    node, weight = np.polynomial.legendre.leggauss(_ANGLES)
    cosine, weight = 0.5 * (node + 1.0), 0.5 * weight
    reflected = np.abs(plane_reflection(np.asarray(r0)[..., None], cosine)) ** 2
    return np.asarray(np.sum((1.0 - reflected) * 2.0 * cosine * weight, axis=-1))
