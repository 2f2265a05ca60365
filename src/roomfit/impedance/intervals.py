"""Everything told of a wall, with 95 % intervals, from the covariance of a fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.checks import read_only
from roomfit.geometry.measures import mean_free_path_m
from roomfit.impedance.fit import ImpedanceFit
from roomfit.impedance.laws import LawCurve
from roomfit.impedance.observed import model_error
from roomfit.materials.impedance_laws import absorption_normal, absorption_random, impedance_of_r0
from roomfit.typing import BoolArray, ComplexArray, FloatArray

_REACH = 1.959964
# R0 counts as identified where its interval is no wider, Z is shown where its is, relative.
WIDEST_R0 = 0.2
WIDEST_Z = 0.2
_STEP = 1e-6
# How far the image model's error moves a soft wall's R0, over what the residual shows of it: most
# probable for 26 boxes with walls at random, see docs/impedance.md.
_OFFSET = 2.4


@dataclass(frozen=True, slots=True, eq=False)
class MaterialAnswer:
    """What was found of one material, over frequency.

    Every pair of `_lower95` and `_upper95` is a 95 % interval of real numbers.

    Attributes
    ----------
    name, kind : str
        `kind` is the curve that was fitted: spline, miki, resonator, panel or constant.
    r0 : complex array, shape (n_frequencies,)
    r0_lower95, r0_upper95 : complex arrays
        Real and imaginary parts hold the limits of those of `r0`.
    absorption_normal, absorption_random : float arrays, shape (n_frequencies,)
        And their `_lower95` and `_upper95`.
    admittance, admittance_lower95, admittance_upper95 : complex arrays
    impedance, impedance_lower95, impedance_upper95 : complex arrays
        nan where `impedance_shown` is false.
    impedance_shown : bool array
        Where the interval of Z is no wider than a fifth of its size.
    identified : bool array
        Where the intervals of real and imaginary part of R0 are no wider than 0.2.
    parameters : tuple of (name, unit, value, lower95, upper95)
        Of a physical law; empty for a spline.
    """

    name: str
    kind: str
    r0: ComplexArray
    r0_lower95: ComplexArray
    r0_upper95: ComplexArray
    absorption_normal: FloatArray
    absorption_normal_lower95: FloatArray
    absorption_normal_upper95: FloatArray
    absorption_random: FloatArray
    absorption_random_lower95: FloatArray
    absorption_random_upper95: FloatArray
    admittance: ComplexArray
    admittance_lower95: ComplexArray
    admittance_upper95: ComplexArray
    impedance: ComplexArray
    impedance_lower95: ComplexArray
    impedance_upper95: ComplexArray
    impedance_shown: BoolArray
    identified: BoolArray
    parameters: tuple[tuple[str, str, float, float, float], ...] = ()

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if isinstance(value, np.ndarray):
                read_only(value)


def material_answers(fit: ImpedanceFit) -> tuple[MaterialAnswer, ...]:
    """Return what a fit tells of every material.

    Besides noise, the intervals hold what the image model itself gets wrong. That does not average
    out over frequencies and pairs. A wave front that is not plane strikes as if its angle were
    another by some ``1 / (k r)``, and R changes with the cosine as ``1 - R0**2``: R0 is taken to be
    off by ``|1 - R0**2|`` times 2.4 of the model's own error as it is found in the room, see
    `model_error`.
    """
    share = _model_share(fit)
    answers = []
    for i, name in enumerate(fit.problem.model.scene.room.materials):
        place, curve = fit.layout.curves[i], fit.problem.curves[i]
        own = fit.covariance[place, place]
        slope = curve.slope(fit.x[place])
        parts = np.stack([slope.real, slope.imag], axis=1)
        off = share * np.abs(1.0 - fit.r0[i] ** 2)
        spread = np.einsum("fai,ij,fbj->fab", parts, own, parts)
        spread = spread + 0.5 * (off**2)[:, None, None] * np.eye(2)
        parameters: tuple[tuple[str, str, float, float, float], ...] = ()
        if isinstance(curve, LawCurve):
            own = own + _off_law(parts, off, fit.problem.observed.frequency_hz)
            parameters = _law_parameters(curve, fit.x[place], own)
        answers.append(material_answer(name, curve.kind, fit.r0[i], spread, parameters))
    return tuple(answers)


def _model_share(fit: ImpedanceFit) -> FloatArray:
    problem = fit.problem
    model = problem.model
    return model_error(
        problem.observed.frequency_hz,
        mean_free_path_m(model.scene.room.mesh),
        model.speed_m_s,
        _OFFSET * fit.model_error,
    )


def _off_law(parts: FloatArray, off: FloatArray, frequency_hz: FloatArray) -> FloatArray:
    """Return the covariance of a law's numbers from errors of R0 that are alike over an octave."""
    n_f = len(frequency_hz)
    octaves = max(float(np.log2(frequency_hz[-1] / frequency_hz[0])), 1.0)
    inverse = np.linalg.pinv(parts.reshape(2 * n_f, -1))
    scaled = inverse * np.repeat(off, 2) * np.sqrt(0.5 * max(n_f / octaves, 1.0))
    return np.asarray(scaled @ scaled.T)


def material_answer(
    name: str,
    kind: str,
    r0: ComplexArray,
    spread: FloatArray,
    parameters: tuple[tuple[str, str, float, float, float], ...] = (),
) -> MaterialAnswer:
    """Return all quantities of a material with their intervals.

    Parameters
    ----------
    r0 : complex array, shape (n_frequencies,)
        Passive.
    spread : float array, shape (n_frequencies, 2, 2)
        Covariance of real and imaginary part of R0.
    """
    reach = _reach(spread, np.ones(len(r0), dtype=np.complex128))
    normal = absorption_normal(r0)
    dn, below_normal = _normal_reach(spread, r0)
    random = absorption_random(r0)
    # inside the disc, so that the steps meet walls that absorb
    inner = r0 * (1.0 - 2.0 * _STEP)
    at = absorption_random(inner)
    by = [(absorption_random(inner + d) - at) / _STEP for d in (_STEP, 1j * _STEP)]
    dr = _real_reach(spread, np.stack(by, axis=1))
    below = np.where(np.abs(1.0 + r0) < 1e-9, 1e-9, 1.0 + r0)
    admittance = (1.0 - r0) / below
    da = _reach(spread, np.asarray(-2.0 / below**2))
    above = np.where(np.abs(1.0 - r0) < 1e-9, 1e-9, 1.0 - r0)
    dz = _reach(spread, np.asarray(2.0 / above**2))
    z = impedance_of_r0(r0)
    shown = 2.0 * np.maximum(dz.real, dz.imag) <= WIDEST_Z * np.abs(z)
    unknown = complex(np.nan, np.nan)
    return MaterialAnswer(
        name=name,
        kind=kind,
        r0=r0,
        r0_lower95=_box(r0 - reach, -1.0, 1.0),
        r0_upper95=_box(r0 + reach, -1.0, 1.0),
        absorption_normal=normal,
        absorption_normal_lower95=np.clip(normal - dn - below_normal, 0.0, 1.0),
        absorption_normal_upper95=np.clip(normal + dn, 0.0, 1.0),
        absorption_random=random,
        absorption_random_lower95=np.clip(random - dr, 0.0, 1.0),
        absorption_random_upper95=np.clip(random + dr, 0.0, 1.0),
        admittance=admittance,
        admittance_lower95=admittance - da,
        admittance_upper95=admittance + da,
        impedance=np.where(shown, z, unknown),
        impedance_lower95=np.where(shown, z - dz, unknown),
        impedance_upper95=np.where(shown, z + dz, unknown),
        impedance_shown=shown,
        identified=2.0 * np.maximum(reach.real, reach.imag) <= WIDEST_R0,
        parameters=parameters,
    )


def unknown_answer(name: str, kind: str, n_frequencies: int) -> MaterialAnswer:
    """Return the answer for a material of which nothing is known."""
    nothing = np.zeros(n_frequencies, dtype=np.complex128)
    return material_answer(name, kind, nothing, np.tile(1e6 * np.eye(2), (n_frequencies, 1, 1)))


def _reach(spread: FloatArray, by_r0: ComplexArray) -> ComplexArray:
    """Return half the interval of real and imaginary part of what changes by `by_r0` dR0."""
    real = np.stack([by_r0.real, -by_r0.imag], axis=1)
    imaginary = np.stack([by_r0.imag, by_r0.real], axis=1)
    return np.asarray(_real_reach(spread, real) + 1j * _real_reach(spread, imaginary))


def _real_reach(spread: FloatArray, by: FloatArray) -> FloatArray:
    variance = np.einsum("fa,fab,fb->f", by, spread, by)
    return np.asarray(_REACH * np.sqrt(np.maximum(variance, 0.0)))


def _normal_reach(spread: FloatArray, r0: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Return half the interval of ``1 - |R0|**2``, and how far its mean lies below the value.

    With the second order, without which a wall that is matched, R0 = 0, would be known exactly: of
    a normal R0 with mean r and covariance S the square has the variance
    ``4 r S r + 2 trace(S S)`` and a mean that is larger by ``trace(S)``.
    """
    parts = np.stack([r0.real, r0.imag], axis=1)
    first = np.einsum("fa,fab,fb->f", parts, spread, parts)
    second = np.einsum("fab,fba->f", spread, spread)
    reach = _REACH * np.sqrt(np.maximum(4.0 * first + 2.0 * second, 0.0))
    return np.asarray(reach), np.asarray(np.trace(spread, axis1=1, axis2=2))


def _box(value: ComplexArray, low: float, high: float) -> ComplexArray:
    return np.asarray(np.clip(value.real, low, high) + 1j * np.clip(value.imag, low, high))


def _law_parameters(
    curve: LawCurve, x: FloatArray, covariance: FloatArray
) -> tuple[tuple[str, str, float, float, float], ...]:
    reach = _REACH * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    value, lower, upper = (curve.values(at) for at in (x, x - reach, x + reach))
    return tuple(
        (p.name, p.unit, float(value[i]), float(lower[i]), float(upper[i]))
        for i, p in enumerate(curve.parameters)
    )
