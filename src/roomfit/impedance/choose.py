"""From splines to physical laws: fitted to the spline first, then to the data, then judged."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from roomfit.errors import InputError
from roomfit.impedance.curves import Curve, constant, spline
from roomfit.impedance.fit import ImpedanceFit, refined
from roomfit.impedance.laws import LAWS, LawCurve, Parameter, law_curve
from roomfit.impedance.layout import layout_of
from roomfit.impedance.observed import complex_frequency_hz
from roomfit.impedance.rows import Linear
from roomfit.impedance.solve import levenberg_marquardt
from roomfit.typing import ComplexArray, FloatArray

KINDS = ("spline", "constant", *LAWS, "auto")
_DRAWN, _POLISHED = 400, 6
# No law is expected to hold better than this.
_LAW_ERROR = 0.005
# A law that misses the spline by more (mean square) is not tried on the data.
_WORTH_TRYING = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class WallModel:
    """How R0 of one material is to run over frequency.

    Attributes
    ----------
    kind : str
        spline, constant, miki, resonator, panel, or auto: the best of all by the data.
    start_r0 : complex
        Where a spline or a constant begins.
    parameters : mapping of name to Parameter
        Starts and bounds of a law that differ from the usual ones.
    """

    kind: str = "spline"
    start_r0: complex = 0.8
    parameters: Mapping[str, Parameter] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(
                "unknown model of a wall", found=repr(self.kind), needed=", ".join(KINDS)
            )
        if not abs(self.start_r0) <= 1.0:
            raise InputError(
                "a wall cannot give back more than it gets",
                found=f"a start of |R0| = {abs(self.start_r0):.4g}",
                needed="|R0| <= 1",
            )
        object.__setattr__(self, "parameters", MappingProxyType(dict(self.parameters)))


def first_curves(problem_walls: Mapping[str, WallModel], frequency_hz: FloatArray) -> list[Curve]:
    """Return the curves with which a search begins: a spline for everything but a constant."""
    curves: list[Curve] = []
    for wall in problem_walls.values():
        make = constant if wall.kind == "constant" else spline
        curves.append(make(frequency_hz, wall.start_r0))
    return curves


class Chosen(NamedTuple):
    """A fit, and for each material that was to be chosen, what each law came to.

    Attributes
    ----------
    fit : ImpedanceFit
    tried : mapping of material to mapping of kind to float
        Twice the negative logarithm of the probability over that of the spline, by Schwarz; below
        0 is better than the spline. Only of laws tried on the data.
    """

    fit: ImpedanceFit
    tried: Mapping[str, Mapping[str, float]]


def with_laws(
    fit: ImpedanceFit, walls: Mapping[str, WallModel], rng: np.random.Generator
) -> Chosen:
    """Return the fit with physical laws in place of splines, where wanted or better.

    Every law is first fitted to the spline's R0 from many starts. A law that was asked for is then
    fitted to the data with the rest. Of "auto", the law nearest to the spline is, and stays where
    the misfit grows by less than the numbers that it saves are worth [1]_.

    References
    ----------
    .. [1] G. Schwarz, "Estimating the dimension of a model", Annals of Statistics 6, 461-464
           (1978).
    """
    told = {i: w for i, w in enumerate(walls.values()) if w.kind in LAWS}
    if told:
        curves = {i: _nearest_law(fit, i, [w.kind], w, rng)[0] for i, w in told.items()}
        fit = _replaced(fit, curves)
    tried: dict[str, dict[str, float]] = {}
    for i, (name, wall) in enumerate(walls.items()):
        if wall.kind != "auto":
            continue
        curve, misfit = _nearest_law(fit, i, ["constant", *LAWS], wall, rng)
        tried[name] = {}
        if misfit > _WORTH_TRYING:
            continue
        other = _replaced(fit, {i: curve})
        tried[name][curve.kind] = _schwarz(other) - _schwarz(fit)
        if tried[name][curve.kind] < 0.0:
            fit = other
    return Chosen(fit, tried)


def _schwarz(fit: ImpedanceFit) -> float:
    squares = float(fit.residual @ fit.residual)
    return squares + fit.effective * math.log(len(fit.residual))


def _replaced(fit: ImpedanceFit, curves: Mapping[int, Curve]) -> ImpedanceFit:
    """Return the fit with other curves for some materials, from where it stands."""
    problem = fit.problem
    own = tuple(curves.get(i, c) for i, c in enumerate(problem.curves))
    other = replace(problem, curves=own)
    layout = layout_of(other)
    x = np.zeros(layout.size)
    for i, (new, old) in enumerate(zip(layout.curves, fit.layout.curves, strict=True)):
        x[new] = own[i].start if i in curves else fit.x[old]
    x[layout.curves[-1].stop :] = fit.x[fit.layout.curves[-1].stop :]
    return refined(other, x, fit.roughness_sd)


def _nearest_law(
    fit: ImpedanceFit,
    material: int,
    kinds: list[str],
    wall: WallModel,
    rng: np.random.Generator,
) -> tuple[Curve, float]:
    """Return the law that comes nearest to a spline, starting where it does, and its misfit.

    The misfit is the mean square in standard deviations of the spline's R0 and of `_LAW_ERROR`.
    """
    problem, place = fit.problem, fit.layout.curves[material]
    curve = problem.curves[material]
    slope = curve.slope(fit.x[place])
    own = fit.covariance[place, place]
    variance = np.real(np.einsum("fi,ij,fj->f", slope, own, slope.conj()))
    weight = 1.0 / np.sqrt(variance + _LAW_ERROR**2)
    best: tuple[Curve, float] | None = None
    for kind in kinds:
        if kind == "constant":
            mean = complex(np.sum(weight**2 * fit.r0[material]) / np.sum(weight**2))
            frequency_hz = problem.observed.frequency_hz
            found: Curve = constant(frequency_hz, mean / max(abs(mean), 1.0))
            off = weight * (mean - fit.r0[material])
            misfit = float(np.mean(np.abs(off) ** 2))
        else:
            law = law_curve(
                kind,
                complex_frequency_hz(problem.observed),
                problem.model.speed_m_s,
                wall.parameters if wall.kind != "auto" else None,
            )
            found, misfit = _fitted_law(law, fit.r0[material], weight, rng)
        if best is None or misfit < best[1]:
            best = found, misfit
    if best is None:
        raise ValueError("no law to fit")
    return best


def _fitted_law(
    law: LawCurve, r0: ComplexArray, weight: FloatArray, rng: np.random.Generator
) -> tuple[LawCurve, float]:
    """Return the law with parameters that come nearest to R0, from many starts."""

    def rows(x: FloatArray) -> Linear:
        off = weight * (law.r0(x) - r0)
        by = weight[:, None] * law.slope(x)
        weak = 1e-2 * np.eye(len(x))
        return Linear(
            np.concatenate([off.real, off.imag, weak @ x]), np.vstack([by.real, by.imag, weak])
        )

    n = len(law.parameters)
    drawn = np.vstack([law.start, rng.normal(scale=1.5, size=(_DRAWN, n))])
    costs = [float(np.sum(np.abs(weight * (law.r0(x) - r0)) ** 2)) for x in drawn]
    best = np.argsort(costs)[:_POLISHED]
    ends = [levenberg_marquardt(rows, drawn[i], most=60, gain=1e-6) for i in best]
    x = min(ends, key=lambda end: end.cost).x
    misfit = float(np.mean(np.abs(weight * (law.r0(x) - r0)) ** 2))
    values = law.values(np.clip(x, -4.0, 4.0))
    parameters = tuple(
        replace(p, start=float(v)) for p, v in zip(law.parameters, values, strict=True)
    )
    return replace(law, parameters=parameters), misfit
