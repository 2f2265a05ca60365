"""From measured pressures to reflection coefficients: continuation in smoothness, then rounds.

Several starts each lead to a first minimum at few frequencies, in which R0 begins nearly constant
over frequency and is allowed to vary step by step. The lowest is polished: steps weigh short paths
with plane waves at the walls; the difference to all paths with spherical waves is computed between
them and fixed, round after round, until nothing moves. How rough each material may be follows from
its own marginal likelihood, so that a smooth wall takes no roughness from a resonator.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from roomfit.base.arguments import check_known
from roomfit.base.errors import InputError
from roomfit.base.typing import ComplexArray, FloatArray, Progress
from roomfit.impedance.laws import Curve
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

    Shapes: `x` (n_unknowns,), `roughness_sd` (n_materials,).
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


KINDS = ("spline", "constant")


@dataclass(frozen=True, slots=True, eq=False)
class WallModel:
    """How R0, the reflection coefficient of one material, is to depend on frequency.

    Parameters
    ----------
    kind : str
        "spline" (any smooth course of a passive, causal wall), or "constant".
    start_r0 : complex
        Where it starts, ``|start_r0| <= 1``.

    Raises
    ------
    InputError
        An unknown kind, or a start that is not passive.

    Examples
    --------
    >>> WallModel("constant").kind
    'constant'
    """

    kind: str = "spline"
    start_r0: complex = 0.8

    def __post_init__(self) -> None:
        check_known("unknown model of a wall", self.kind, KINDS)
        if not abs(self.start_r0) <= 1.0:
            raise InputError(
                "a wall cannot reflect more than it receives",
                found=f"a start of |R0| = {abs(self.start_r0):.4g}",
                needed="|R0| <= 1",
                hint="start from 0.8, or from what is known of the wall",
            )


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
    most = max((c.basis.shape[1] for c in problem.curves), default=n_f)
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
