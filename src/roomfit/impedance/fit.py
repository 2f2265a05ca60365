"""From measured pressures to reflection coefficients: continuation in smoothness, then rounds.

Several starts each lead to a first minimum at few frequencies, in which R0 begins nearly constant
over frequency and is allowed to vary step by step. The lowest is polished: steps weigh short paths
with plane waves at the walls; the difference to all paths with spherical waves is computed between
them and fixed, round after round, until nothing moves. How rough each material may be follows from
its own marginal likelihood, so that a smooth wall takes no roughness from a resonator. Physical
laws are fitted to the spline first, then to the data, then judged.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from roomfit.base.arguments import check_known
from roomfit.base.errors import InputError
from roomfit.base.typing import ComplexArray, FloatArray, Progress
from roomfit.impedance.data import complex_frequency_hz
from roomfit.impedance.laws import (
    LAWS,
    CausalCurve,
    Curve,
    LawCurve,
    Parameter,
    Spline,
    constant,
    law_curve,
)
from roomfit.impedance.problem import (
    Problem,
    Rows,
    Whitened,
    data_rows,
    marginal_likelihood_error,
    prior_rows,
    r0_of,
    robust_covariance,
    start_of,
    state_of,
)
from roomfit.impedance.wave_model import State, at_frequencies, frozen_correction, has_free_spectra
from roomfit.solver import Ending, MarquardtSettings, Minimum, levenberg_marquardt

# A step that lowers the cost by less than a share of it is the last one.
_SETTINGS = MarquardtSettings(
    max_trials=29,
    damping=1e-2,
    lowered=0.2,
    least_damping=1e-9,
    most_damping=8e9,
    ridge=1e-12,
)

# Standard deviations of second differences of spline coefficients: first nearly constant.
STAGES = (0.003, 0.01, 0.03)
_ROUGHEST, _SMOOTHEST = 1.0, 1e-4
_EVIDENCE_ROUNDS = 3
_MOST_ROUNDS = 8
# Where R0 moves by less than this (rms over frequency, worst material), the rounds end.
_SETTLED = 5e-4


@dataclass(frozen=True, slots=True, eq=False)
class ImpedanceFit:
    """What a fit found."""

    problem: Problem
    x: FloatArray  # (n_unknowns,)
    r0: ComplexArray  # (n_materials, n_frequencies), passive
    state: State
    correction: ComplexArray  # (n_pairs, n_frequencies)
    roughness_sd: FloatArray  # (n_materials,)
    normal: FloatArray  # (n_unknowns, n_unknowns), J^T J of data and priors
    residual: FloatArray  # (n_rows,), of the data, in standard deviations
    effective: float  # how many numbers the data determined
    covariance: FloatArray  # (n_unknowns, n_unknowns), with the model error as it is in this room
    model_error: float  # that error, see `roomfit.impedance.problem.marginal_likelihood_error`
    evaluations: int
    rounds: int
    ending: Ending  # converged where R0 moved no more from one round to the next


def reduced_chi2(fit: ImpedanceFit) -> float:
    """Return the sum of squares of the data's residuals over what is expected, 1 for a good fit."""
    free = max(len(fit.residual) - fit.effective, 1.0)
    return float(fit.residual @ fit.residual) / free


def descend(
    problem: Problem,
    x: FloatArray,
    roughness_sd: FloatArray,
    correction: ComplexArray,
    *,
    gain: float = 1e-4,
    walls_only: bool = False,
) -> Minimum:
    """Return the nearest minimum with smoothness and correction fixed.

    With `walls_only`, positions, speed of sound, gains and delays are fixed as well.
    """

    def rows(at: FloatArray) -> Rows:
        residual, jacobian = data_rows(problem, at, correction)
        if walls_only:
            jacobian[:, problem.layout.curves[-1].stop :] = 0.0
        prior, slope = prior_rows(problem, at, roughness_sd)
        return np.concatenate([residual, prior]), np.vstack([jacobian, slope])

    return levenberg_marquardt(rows, x, _ending_at(_SETTINGS, gain))


def _ending_at(settings: MarquardtSettings, gain: float) -> MarquardtSettings:
    """Return settings whose last step gains, or promises a hundredth of, a share of the cost."""
    return replace(settings, relative_gain=gain, least_promise=0.01 * gain)


def continuation(problem: Problem, x: FloatArray, *, gain: float = 1e-4) -> Minimum:
    """Return where the homotopy leads with plane waves and short paths alone.

    Its last minimum, with the evaluations of all.
    """
    nothing = np.zeros_like(problem.observed.pressure)
    first, *_ = roughness = [np.full(len(problem.curves), sd) for sd in STAGES[:2]]
    # far from the truth, the speed of sound would run away before the walls have converged
    found = descend(problem, x, first, nothing, gain=1e-2, walls_only=True)
    evaluations = found.evaluations
    for rough in roughness:
        found = descend(problem, found.x, rough, nothing, gain=gain)
        evaluations += found.evaluations
    return found._replace(evaluations=evaluations)


def polish(
    problem: Problem,
    x: FloatArray,
    roughness_sd: FloatArray | None = None,
    progress: Progress | None = None,
) -> ImpedanceFit:
    """Return the fit to which rounds of spherical correction lead from a coarse one.

    Parameters
    ----------
    x : float array, shape (n_unknowns,)
        From `continuation`, or of an earlier fit.
    roughness_sd : float array, shape (n_materials,), optional
        Where it is known already; else the last of the `STAGES`, then by its evidence.
    """
    rough = np.full(len(problem.curves), STAGES[-1]) if roughness_sd is None else roughness_sd
    correction = _correction(problem, x)
    r0, evaluations, rounds = r0_of(problem, x), 0, 0
    while True:
        rounds += 1
        found = descend(problem, x, rough, correction)
        x, evaluations = found.x, evaluations + found.evaluations
        before, r0 = r0, r0_of(problem, x)
        moved = float(np.sqrt(np.mean(np.abs(r0 - before) ** 2, axis=1)).max())
        converged = moved <= _SETTLED
        if progress is not None:
            progress(rounds / _MOST_ROUNDS)
        if rounds >= _MOST_ROUNDS or (converged and rounds > 1):
            break
        if rounds <= _EVIDENCE_ROUNDS:
            rough = _marginal_likelihood_roughness(problem, found, rough)
        correction = _correction(problem, x)
    ending = Ending.CONVERGED if converged else Ending.OUT_OF_ROUNDS
    if found.ending is Ending.OUT_OF_DAMPING:
        ending = found.ending
    residual, jacobian = data_rows(problem, x, correction)
    effective = float(
        np.trace(np.linalg.pinv(found.normal, hermitian=True) @ (jacobian.T @ jacobian))
    )
    if has_free_spectra(problem.nuisances):
        n_sources = len(np.unique(problem.model.scene.pairs[:, 0]))
        effective += 2.0 * n_sources * problem.observed.pressure.shape[1]
    linear = Whitened(residual, jacobian, found.normal)
    error = marginal_likelihood_error(problem, linear)
    return ImpedanceFit(
        problem=problem,
        x=x,
        r0=passive(r0),
        state=state_of(problem, x),
        correction=correction,
        roughness_sd=rough,
        normal=found.normal,
        residual=residual,
        effective=effective,
        covariance=robust_covariance(problem, linear, error, effective),
        model_error=error,
        evaluations=evaluations,
        rounds=rounds,
        ending=ending,
    )


def refit(problem: Problem) -> ImpedanceFit:
    """Return the fit of a changed problem, from the start of its curves."""
    thin = thinned(problem)
    return polish(problem, continuation(thin, start_of(thin)).x)


def _correction(problem: Problem, x: FloatArray) -> ComplexArray:
    return frozen_correction(
        problem.model,
        passive(r0_of(problem, x)),
        state_of(problem, x),
        spherical=problem.spherical,
    )


def passive(r0: ComplexArray) -> ComplexArray:
    """Return R0 drawn onto the unit circle where it lies outside."""
    return np.asarray(r0 / np.maximum(np.abs(r0), 1.0))


def _marginal_likelihood_roughness(
    problem: Problem, found: Minimum, rough: FloatArray
) -> FloatArray:
    """Return the roughness of each material under which what was found is most probable.

    MacKay's fixed point: the sum of squares of second differences over how many of them the data
    determine [1]_.

    References
    ----------
    .. [1] D. J. C. MacKay, "Bayesian interpolation", Neural Computation 4, 415-447 (1992).
    """
    covariance = np.linalg.pinv(found.normal, hermitian=True)
    new = rough.copy()
    for i, (curve, place) in enumerate(zip(problem.curves, problem.layout.curves, strict=True)):
        rows = curve.roughness
        if len(rows) == 0:
            continue
        differences = rows @ found.x[place]
        left_open = np.trace(rows @ covariance[place, place] @ rows.T) / rough[i] ** 2
        determined = max(len(rows) - float(left_open), 1e-3)
        new[i] = np.sqrt(float(differences @ differences) / determined)
    return np.clip(new, _SMOOTHEST, _ROUGHEST)


KINDS = ("spline", "constant", *LAWS, "auto")
_DRAWN, _POLISHED = 400, 6
# No law is expected to hold better than this.
_LAW_ERROR = 0.005
# A law that misses the spline by more (mean square) is not tried on the data.
_WORTH_TRYING = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class WallModel:
    """How R0, the reflection coefficient of one material, is to depend on frequency.

    Parameters
    ----------
    kind : str
        "spline" (any smooth course), "constant", a physical law ("miki": porous layer before a
        rigid wall, "resonator": perforated plate before a cavity, "panel": mass on a spring of
        air), or "auto": the best of all by the data.
    start_r0 : complex
        Where a spline or a constant starts, ``|start_r0| <= 1``.
    parameters : mapping of name to Parameter
        Starts and bounds of a law that differ from those in `roomfit.impedance.laws.LAWS`.

    Raises
    ------
    InputError
        An unknown kind, or a start that is not passive.

    Examples
    --------
    >>> WallModel("miki").kind
    'miki'
    """

    kind: str = "spline"
    start_r0: complex = 0.8
    parameters: Mapping[str, Parameter] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_known("unknown model of a wall", self.kind, KINDS)
        if not abs(self.start_r0) <= 1.0:
            raise InputError(
                "a wall cannot reflect more than it receives",
                found=f"a start of |R0| = {abs(self.start_r0):.4g}",
                needed="|R0| <= 1",
                hint="start from 0.8, or from what is known of the wall",
            )
        object.__setattr__(self, "parameters", MappingProxyType(dict(self.parameters)))


def with_laws(
    fit: ImpedanceFit, walls: Mapping[str, WallModel], rng: np.random.Generator
) -> ImpedanceFit:
    """Return the fit with physical laws in place of splines, where wanted or better.

    Every law is first fitted to the spline's R0 from many starts. A law that was specified is then
    fitted to the data with the rest. Of "auto", the law nearest to the spline is, and stays where
    the misfit grows by less than the numbers that it saves are worth [1]_.

    References
    ----------
    .. [1] G. Schwarz, "Estimating the dimension of a model", Annals of Statistics 6, 461-464
           (1978).
    """
    with_law = {i: w for i, w in enumerate(walls.values()) if w.kind in LAWS}
    if with_law:
        curves = {i: _nearest_law(fit, i, [w.kind], w, rng)[0] for i, w in with_law.items()}
        fit = _replaced(fit, curves)
    for i, wall in enumerate(walls.values()):
        if wall.kind != "auto":
            continue
        curve, misfit = _nearest_law(fit, i, ["constant", *LAWS], wall, rng)
        if misfit > _WORTH_TRYING:
            continue
        other = _replaced(fit, {i: curve})
        if _schwarz(other) - _schwarz(fit) < 0.0:
            fit = other
    return fit


def _schwarz(fit: ImpedanceFit) -> float:
    squares = float(fit.residual @ fit.residual)
    return squares + fit.effective * math.log(len(fit.residual))


def _replaced(fit: ImpedanceFit, curves: Mapping[int, Curve]) -> ImpedanceFit:
    """Return the fit with other curves for some materials, from where it stands."""
    problem = fit.problem
    own = tuple(curves.get(i, c) for i, c in enumerate(problem.curves))
    other = replace(problem, curves=own)
    before, after = problem.layout.curves, other.layout.curves
    x = np.zeros(other.layout.size)
    for i, (old, new) in enumerate(zip(before, after, strict=True)):
        x[new] = own[i].start if i in curves else fit.x[old]
    x[after[-1].stop :] = fit.x[before[-1].stop :]
    return polish(other, x, fit.roughness_sd)


def _nearest_law(
    fit: ImpedanceFit,
    material: int,
    kinds: list[str],
    wall: WallModel,
    rng: np.random.Generator,
) -> tuple[Curve, float]:
    """Return the law that comes nearest to a spline, starting where it does, and its misfit.

    That is the mean square in standard deviations of the spline's R0 and of `_LAW_ERROR`.
    """
    problem, place = fit.problem, fit.problem.layout.curves[material]
    curve = problem.curves[material]
    slope = curve.slope(fit.x[place])
    own = fit.covariance[place, place]
    variance = np.real(np.einsum("fi,ij,fj->f", slope, own, slope.conj()))
    weight = 1.0 / np.sqrt(variance + _LAW_ERROR**2)
    fitted: list[tuple[Curve, float]] = []
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
        fitted.append((found, misfit))
    return min(fitted, key=lambda one: one[1])


def _fitted_law(
    law: LawCurve, r0: ComplexArray, weight: FloatArray, rng: np.random.Generator
) -> tuple[LawCurve, float]:
    """Return the law with parameters that come nearest to R0, from many starts."""

    def rows(x: FloatArray) -> Rows:
        off = weight * (law.r0(x) - r0)
        by = weight[:, None] * law.slope(x)
        weak = 1e-2 * np.eye(len(x))
        values = np.concatenate([off.real, off.imag, weak @ x])
        return values, np.vstack([by.real, by.imag, weak])

    n = len(law.parameters)
    drawn = np.vstack([law.start, rng.normal(scale=1.5, size=(_DRAWN, n))])
    costs = [float(np.sum(np.abs(weight * (law.r0(x) - r0)) ** 2)) for x in drawn]
    best = np.argsort(costs)[:_POLISHED]
    settings = _ending_at(replace(_SETTINGS, max_trials=59), 1e-6)
    ends = [levenberg_marquardt(rows, drawn[i], settings) for i in best]
    x = min(ends, key=lambda end: end.cost).x
    misfit = float(np.mean(np.abs(weight * (law.r0(x) - r0)) ** 2))
    values = law.values(np.clip(x, -4.0, 4.0))
    parameters = tuple(
        replace(p, start=float(v)) for p, v in zip(law.parameters, values, strict=True)
    )
    return replace(law, parameters=parameters), misfit


# Frequencies that a first look keeps for each function of the smoothest curve, about.
_PER_FUNCTION = 2
# Minima whose R0 differ by less (rms, worst material) are one.
SAME_WITHIN = 0.01
_LARGEST_START = 0.95


class Start(NamedTuple):
    """The minimum that one start led to, with plane waves, short paths and few frequencies."""

    x: FloatArray  # (n_unknowns,)
    r0: ComplexArray  # (n_materials, n_frequencies kept)
    cost: float


def multistart(
    problem: Problem,
    n_random: int,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> tuple[Start, ...]:
    """Return where the usual start and random ones lead, lowest cost first.

    The usual start is that of the curves (0.8 unless specified); random ones are even over the disc
    of passive walls, each material for itself. All at fewer frequencies, with plane waves.
    """
    thin = thinned(problem)
    found = []
    for number in range(1 + n_random):
        x = start_of(thin)
        if number > 0:
            for place, curve in zip(thin.layout.curves, thin.curves, strict=True):
                x[place] = _random_start(curve, rng)
        end = continuation(thin, x, gain=1e-5)
        found.append(Start(end.x, r0_of(thin, end.x), end.cost))
        if progress is not None:
            progress((number + 1) / (1 + n_random))
    return tuple(sorted(found, key=lambda s: s.cost))


def _random_start(curve: Curve, rng: np.random.Generator) -> FloatArray:
    if not isinstance(curve, Spline | CausalCurve):
        return np.asarray(curve.start + rng.normal(size=curve.start.shape))
    r0 = _LARGEST_START * np.sqrt(rng.random()) * np.exp(2j * np.pi * rng.random())
    return replace(curve, start_r0=complex(r0)).start


def distance(a: ComplexArray, b: ComplexArray) -> float:
    """Return the rms difference over frequency of the worst material."""
    return float(np.sqrt(np.mean(np.abs(a - b) ** 2, axis=1)).max())


def distinct(starts: tuple[Start, ...], within: float = SAME_WITHIN) -> tuple[Start, ...]:
    """Return one start for each minimum, lowest first."""
    kept: list[Start] = []
    for start in starts:
        if all(distance(start.r0, other.r0) > within for other in kept):
            kept.append(start)
    return tuple(kept)


def agreeing(starts: tuple[Start, ...]) -> int:
    """Return how many starts led to the lowest minimum."""
    return sum(distance(s.r0, starts[0].r0) <= SAME_WITHIN for s in starts)


def thinned(problem: Problem) -> Problem:
    """Return the problem at about as few frequencies as its curves allow."""
    n_f = len(problem.observed.frequency_hz)
    coupled = [c for c in problem.curves if isinstance(c, Spline | CausalCurve)]
    most = max((c.basis.shape[1] for c in coupled), default=n_f)
    every = max(n_f // (_PER_FUNCTION * most), 1)
    if every == 1:
        return problem
    chosen = np.arange(0, n_f, every)
    observed = problem.observed
    return replace(
        problem,
        model=at_frequencies(problem.model, chosen),
        observed=replace(
            observed,
            frequency_hz=observed.frequency_hz[chosen],
            pressure=observed.pressure[:, chosen],
            noise=None if observed.noise is None else observed.noise[:, chosen],
        ),
        sd=problem.sd[:, chosen],
        curves=tuple(c.at(chosen) for c in problem.curves),
    )
