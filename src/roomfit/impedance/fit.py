"""From measured pressures to reflection coefficients: least squares, continuation, rounds.

Unknown gains of sources at each frequency are eliminated by variable projection [1]_ with
Kaufman's derivative [2]_.

Several starts each lead to a first minimum at few frequencies, in which R0 begins nearly constant
over frequency and is allowed to vary step by step. The lowest is polished: steps weigh short paths
with plane waves at the walls; the difference to all paths with spherical waves is computed between
them and fixed, round after round, until nothing moves. How rough each material may be follows from
its own marginal likelihood, so that a smooth wall takes no roughness from a resonator.

References
----------
.. [1] G. H. Golub, V. Pereyra, "The differentiation of pseudo-inverses and nonlinear least squares
       problems whose variables separate", SIAM J. Numer. Anal. 10, 413-432 (1973).
.. [2] L. Kaufman, "A variable projection method for solving separable nonlinear least squares
       problems", BIT 15, 49-57 (1975).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeAlias

import numpy as np

from roomfit.base.typing import ComplexArray, FloatArray, IntArray, Progress
from roomfit.impedance.data import MODEL_ERROR, Observed, complex_frequency_hz, deviation
from roomfit.impedance.laws import Curve
from roomfit.impedance.wave_model import (
    Nuisances,
    State,
    WaveModel,
    at_frequencies,
    gradients,
    predicted_pressure,
)
from roomfit.room.scene import Point
from roomfit.solver import Ending, MarquardtSettings, Minimum, levenberg_marquardt


class Moves(NamedTuple):
    """Coordinates of sources, or of receivers, that may move."""

    place: slice  # in the vector of all unknowns
    shift_m: FloatArray  # (n, n_points, 3), of all points by one unit of each coordinate


class Label(NamedTuple):
    """What an unknown of the measurement is, and how large one unit of it."""

    name: str  # such as "x of LS1" or "speed of sound"
    unit: str
    scale: float
    prior_sd: float = 1.0  # in units of its own


class Layout(NamedTuple):
    """Position of each unknown in the vector of all: of the curves first, then of the measurement.

    Shifts, speed and delays are in units of their prior standard deviations; gains are logarithms
    of each magnitude, and phases.
    """

    curves: tuple[slice, ...]  # one a material
    source: Moves
    receiver: Moves
    speed: slice
    factor: slice  # gains and delays
    exponent: ComplexArray  # (n_pairs, n_frequencies, n), of a pressure's factor by each of these
    labels: tuple[Label, ...]  # of all unknowns behind the curves
    size: int


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What is known of a measurement, and what is to be found."""

    model: WaveModel
    observed: Observed
    sd: FloatArray  # (n_pairs, n_frequencies), see `roomfit.impedance.data.deviation`
    curves: tuple[Curve, ...]  # one a material
    nuisances: Nuisances
    spherical: bool = True
    model_error: float = MODEL_ERROR  # with which `sd` was made
    layout: Layout = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "layout", layout_of(self))


def layout_of(problem: Problem) -> Layout:
    """Return the unknowns of curves and of what may be wrong about a measurement."""
    scene, nuisances, labels = problem.model.scene, problem.nuisances, list[Label]()
    at = 0

    def take(n: int) -> slice:
        nonlocal at
        at += n
        return slice(at - n, at)

    def moves(points: tuple[Point, ...], used: IntArray) -> Moves:
        specified = [p.position_sd_m for p in points]
        sd = np.array([nuisances.position_sd_m if s is None else s for s in specified])
        moving = [i for i in np.unique(used) if sd[i] > 0.0]
        for i in moving:
            labels.extend(Label(f"{axis} of {points[i].name}", "m", float(sd[i])) for axis in "xyz")
        shift_m = np.asarray(np.kron(np.diag(sd)[moving], np.eye(3)), dtype=np.float64)
        shift_m = shift_m.reshape(-1, len(sd), 3)
        return Moves(take(len(shift_m)), shift_m)

    curves = tuple(take(len(c.start())) for c in problem.curves)
    source = moves(scene.sources, scene.pairs[:, 0])
    receiver = moves(scene.receivers, scene.pairs[:, 1])
    if nuisances.speed_sd > 0.0:
        labels.append(Label("speed of sound", "m/s", nuisances.speed_sd * problem.model.speed_m_s))
    speed = take(1 if nuisances.speed_sd > 0.0 else 0)
    factors, exponent = _factors(problem)
    factor = take(len(factors))
    return Layout(curves, source, receiver, speed, factor, exponent, (*labels, *factors), at)


# Standard deviations of the logarithm of an unknown gain: 20 dB, and any phase.
_GAIN_SD, _PHASE_SD = 2.3, 10.0


def _factors(problem: Problem) -> tuple[list[Label], ComplexArray]:
    """Return unknown gains and delays, and the logarithm of a pressure by each, see `Layout`."""
    scene, nuisances = problem.model.scene, problem.nuisances
    pairs, f = scene.pairs, complex_frequency_hz(problem.observed)
    groups = {
        "common": np.ones((len(pairs), 1)),
        "source": np.eye(len(pairs))[source_number(pairs)][:, : len(np.unique(pairs[:, 0]))],
        "pair": np.eye(len(pairs)),
    }
    by_pair = nuisances.gain in ("pair", "pair-spectrum")
    gain = groups.get("pair" if by_pair else nuisances.gain, np.zeros((len(pairs), 0)))
    labels = list[Label]()
    for n in range(1, gain.shape[1] + 1):
        labels.append(Label(f"gain {n}", "dB", 20.0 / np.log(10.0), _GAIN_SD))
        labels.append(Label(f"phase of gain {n}", "rad", 1.0, _PHASE_SD))
    both = np.stack((gain, 1j * gain), axis=2).reshape(len(pairs), 1, -1)
    parts = [np.asarray(both * np.ones((len(f), 1)), dtype=np.complex128)]
    if nuisances.delay_sd_s > 0.0:
        delay = groups[nuisances.delay]
        parts.append(-2j * np.pi * nuisances.delay_sd_s * delay[:, None] * f[:, None])
        for source, receiver in pairs[delay.argmax(axis=0)]:
            name = f"delay of {scene.sources[source].name}"
            if nuisances.delay == "pair":
                name += f" to {scene.receivers[receiver].name}"
            labels.append(Label(name, "s", nuisances.delay_sd_s))
    return labels, np.concatenate(parts, axis=2)


def start_of(problem: Problem) -> FloatArray:
    """Return the unknowns with which a fit starts, shape (n_unknowns,)."""
    x = np.zeros(problem.layout.size)
    for place, curve in zip(problem.layout.curves, problem.curves, strict=True):
        x[place] = curve.start()
    return x


def r0_of(problem: Problem, x: FloatArray) -> ComplexArray:
    """Return R0 of every material, shape (n_materials, n_frequencies)."""
    return np.array(
        [
            c.values(x[place])[0]
            for c, place in zip(problem.curves, problem.layout.curves, strict=True)
        ]
    )


def state_of(problem: Problem, x: FloatArray) -> State:
    """Return the shifts of sources and receivers and the change of the speed of sound."""
    layout, speed = problem.layout, float(np.sum(x[problem.layout.speed]))
    moves = (layout.source, layout.receiver)
    source_m, receiver_m = (np.tensordot(x[own.place], own.shift_m, 1) for own in moves)
    return State(source_m, receiver_m, speed * problem.nuisances.speed_sd)


def factor_of(problem: Problem, x: FloatArray) -> ComplexArray:
    """Return gain and delay as one factor, shape (n_pairs, n_frequencies)."""
    return np.asarray(np.exp(problem.layout.exponent @ x[problem.layout.factor]))


def source_number(pairs: IntArray) -> IntArray:
    """Return the number of each pair's source among those that are used."""
    return np.asarray(np.unique(pairs[:, 0], return_inverse=True)[1])


Rows: TypeAlias = tuple[FloatArray, FloatArray]
"""Weighted residuals of measured minus predicted, (n_rows,), and derivatives, (n_rows, n)."""


def data_rows(problem: Problem, x: FloatArray, correction: ComplexArray) -> Rows:
    """Return the residuals of the pressures in units of their standard deviation.

    Real parts first, then imaginary ones (levels: one row each). `correction`, of shape (n_pairs,
    n_frequencies), is added to the pressures of the short paths and fixed.
    """
    observed, weight = problem.observed, math.sqrt(2.0) / problem.sd
    predicted, slope = _predicted(problem, x, correction)
    if not observed.has_phase:
        size = np.abs(predicted)
        by = np.real(np.conj(predicted / size)[:, :, None] * slope)
        rows = weight * (np.abs(observed.pressure) - size)
        return rows.ravel(), -(weight[:, :, None] * by).reshape(rows.size, -1)
    model, turned = weight * predicted, weight[:, :, None] * slope
    missing = weight * observed.pressure
    if problem.nuisances.free_spectra:
        gain = _of_source(problem, model, missing[:, :, None])
        missing = missing - model * gain[:, :, 0]
        turned = turned * gain
        turned = turned - model[:, :, None] * _of_source(problem, model, turned)
    else:
        missing = missing - model
    by_all = turned.reshape(missing.size, -1)
    residual = np.concatenate([missing.real.ravel(), missing.imag.ravel()])
    return residual, -np.vstack([by_all.real, by_all.imag])


def _of_source(problem: Problem, model: ComplexArray, values: ComplexArray) -> ComplexArray:
    """Return the complex gains by which a model comes nearest to values, one a source.

    Shapes: model (n_pairs, n_frequencies); values and result (n_pairs, n_frequencies, n).
    """
    owner = source_number(problem.model.scene.pairs)
    found = np.empty_like(values)
    for source in range(owner.max() + 1):
        own = np.flatnonzero(owner == source)
        along = np.einsum("pf,pfn->fn", np.conj(model[own]), values[own])
        found[own] = along / np.sum(np.abs(model[own]) ** 2, axis=0)[:, None]
    return found


def source_spectra(problem: Problem, predicted: ComplexArray) -> ComplexArray:
    """Return the best complex gain of each pair's source, shape (n_pairs, n_frequencies)."""
    measured = problem.observed.pressure / problem.sd
    gains = _of_source(problem, predicted / problem.sd, measured[:, :, None])
    return np.asarray(gains[:, :, 0])


def _predicted(
    problem: Problem, x: FloatArray, correction: ComplexArray
) -> tuple[ComplexArray, ComplexArray]:
    """Return pressures and their derivatives by every unknown, (n_pairs, n_frequencies, n)."""
    pairs, layout = problem.model.scene.pairs, problem.layout
    pressure, by_r0, by_source, by_receiver, by_speed = gradients(
        problem.model, r0_of(problem, x), state_of(problem, x)
    )
    pressure = pressure + correction
    slope = np.zeros((*pressure.shape, layout.size), dtype=np.complex128)
    for i, (curve, place) in enumerate(zip(problem.curves, layout.curves, strict=True)):
        slope[:, :, place] = by_r0[:, i, :, None] * curve.values(x[place])[1]
    ends = ((layout.source, by_source), (layout.receiver, by_receiver))
    for (moves, by), column in zip(ends, pairs.T, strict=True):
        slope[:, :, moves.place] = np.einsum("paf,npa->pfn", by, moves.shift_m[:, column])
    if layout.speed.stop > layout.speed.start:
        slope[:, :, layout.speed.start] = by_speed * problem.nuisances.speed_sd
    slope[:, :, layout.factor] = pressure[:, :, None] * layout.exponent
    factor = factor_of(problem, x)
    return factor * pressure, factor[:, :, None] * slope


# |R0| above 1 weighs like a residual of its excess over this.
_PASSIVE_WITHIN = 1e-3


def prior_rows(problem: Problem, x: FloatArray, roughness_sd: FloatArray) -> Rows:
    """Return the priors of the unknowns as residuals of unit variance.

    `roughness_sd`, shape (n_materials,): standard deviation of the second difference of a curve's
    coefficients.
    """
    layout = problem.layout
    blocks: list[tuple[slice, FloatArray, FloatArray]] = []  # where, rows and residuals
    for i, (curve, place) in enumerate(zip(problem.curves, layout.curves, strict=True)):
        own = curve.roughness / roughness_sd[i]
        blocks.append((place, own, own @ x[place]))
        if math.isfinite(curve.prior_sd):
            eye = np.eye(place.stop - place.start) / curve.prior_sd
            blocks.append((place, eye, eye @ (x[place] - curve.start())))
        r0, slope = curve.values(x[place])
        if curve.kind == "constant":
            r0, slope = r0[:1], slope[:1]
        size = np.abs(r0)
        over = size > 1.0
        by = np.real(np.conj(r0[over] / size[over])[:, None] * slope[over])
        blocks.append((place, by / _PASSIVE_WITHIN, (size[over] - 1.0) / _PASSIVE_WITHIN))
    weight = np.array([1.0 / label.prior_sd for label in layout.labels])
    behind = slice(layout.size - len(weight), layout.size)
    blocks.append((behind, np.diag(weight), weight * x[behind]))
    rows = np.zeros((sum(len(own) for _, own, _ in blocks), layout.size))
    at = 0
    for place, own, _ in blocks:
        rows[at : at + len(own), place] = own
        at += len(own)
    return np.concatenate([value for *_, value in blocks]), rows


# A step that lowers the cost by less than a share of it is the last one.
_SETTINGS = MarquardtSettings(
    max_trials=29, damping=1e-2, lowered=0.2, least_damping=1e-9, most_damping=8e9, ridge=1e-12
)

# Standard deviations of second differences of spline coefficients: first nearly constant.
STAGES = (0.003, 0.01, 0.03)
_ROUGHEST, _SMOOTHEST = 1.0, 1e-4
_EVIDENCE_ROUNDS = 3
_MOST_ROUNDS = 8
# Where R0 moves by less than this (rms over frequency, worst material), the rounds end.
_SETTLED = 5e-4


class ImpedanceFit(NamedTuple):
    """What a fit found."""

    problem: Problem
    x: FloatArray  # (n_unknowns,)
    r0: ComplexArray  # (n_materials, n_frequencies), passive
    correction: ComplexArray  # (n_pairs, n_frequencies)
    roughness_sd: FloatArray  # (n_materials,)
    residual: FloatArray  # (n_rows,), of the data, in standard deviations
    jacobian: FloatArray  # (n_rows, n_unknowns), of the data
    normal: FloatArray  # (n_unknowns, n_unknowns), J^T J of data and priors
    effective: float  # how many numbers the data determined
    evaluations: int
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

    With `walls_only`, positions, speed of sound, gains and delays are fixed as well. The last step
    gains, or promises a hundredth of, a share `gain` of the cost.
    """

    def rows(at: FloatArray) -> Rows:
        residual, jacobian = data_rows(problem, at, correction)
        if walls_only:
            jacobian[:, problem.layout.curves[-1].stop :] = 0.0
        prior, slope = prior_rows(problem, at, roughness_sd)
        return np.concatenate([residual, prior]), np.vstack([jacobian, slope])

    settings = replace(_SETTINGS, relative_gain=gain, least_promise=0.01 * gain)
    return levenberg_marquardt(rows, x, settings)


def continuation(problem: Problem, x: FloatArray, *, gain: float = 1e-4) -> Minimum:
    """Return where the homotopy leads with plane waves and short paths alone.

    Its last minimum, with the evaluations of all.
    """
    nothing = np.zeros_like(problem.observed.pressure)
    first, second = (np.full(len(problem.curves), sd) for sd in STAGES[:2])
    # far from the truth, the speed of sound would run away before the walls have converged
    walls = descend(problem, x, first, nothing, gain=1e-2, walls_only=True)
    smooth = descend(problem, walls.x, first, nothing, gain=gain)
    found = descend(problem, smooth.x, second, nothing, gain=gain)
    evaluations = walls.evaluations + smooth.evaluations + found.evaluations
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
        converged = distance(r0, before) <= _SETTLED
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
    inverse = np.linalg.pinv(found.normal, hermitian=True)
    effective = float(np.trace(inverse @ (jacobian.T @ jacobian)))
    if problem.nuisances.free_spectra:
        n_sources = len(np.unique(problem.model.scene.pairs[:, 0]))
        effective += 2.0 * n_sources * problem.observed.pressure.shape[1]
    return ImpedanceFit(
        problem, x, passive(r0), correction, rough,
        residual, jacobian, found.normal, effective,
        evaluations, ending,
    )  # fmt: skip


def _correction(problem: Problem, x: FloatArray) -> ComplexArray:
    """Return all images with spherical waves minus the short paths with plane waves."""
    model, r0, state = problem.model, passive(r0_of(problem, x)), state_of(problem, x)
    whole = predicted_pressure(model, r0, state, spherical=problem.spherical)
    return np.asarray(whole - predicted_pressure(model, r0, state, spherical=False, short=True))


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


# Of 26 boxes with walls at random, at 40 dB, the error had this median, over what is allowed for
# it, and this spread of its logarithm: `scripts/bench impedance rooms`.
_MEDIAN, _LOG_SD = 0.5, 0.5
_GRID = np.geomspace(0.06, 6.0, 47)


def marginal_likelihood_error(fit: ImpedanceFit) -> float:
    """Return the factor of the model's own error under which the data are most probable.

    The restricted likelihood [1]_: unknowns of the fit integrated out, which accounts for what they
    have taken from the residual, times a normal prior of the logarithm. Where noise hides the
    error, the prior is what remains. Where a spectrum of each source is free it takes up what the
    model gets wrong for all pairs alike, so that the residual shows too little: there the error is
    not taken to be less than the prior's median.

    References
    ----------
    .. [1] H. D. Patterson, R. Thompson, "Recovery of inter-block information when block sizes are
           unequal", Biometrika 58, 545-554 (1971).
    """
    problem = fit.problem
    if problem.model_error == 0.0:
        return 0.0
    grid = _GRID[_GRID >= _MEDIAN] if problem.nuisances.free_spectra else _GRID
    costs = [_cost(fit, share) for share in grid]
    return float(grid[int(np.argmin(costs))]) * problem.model_error


def _cost(fit: ImpedanceFit, share: float) -> float:
    """Return twice the negative logarithm of likelihood times prior, but for a constant."""
    problem = fit.problem
    variance = _relative_variance(problem, share * problem.model_error)
    weight = 1.0 / variance
    changed = fit.normal + fit.jacobian.T @ ((weight - 1.0)[:, None] * fit.jacobian)
    # at the minimum the slopes of data and priors cancel
    slope = fit.jacobian.T @ ((weight - 1.0) * fit.residual)
    tiny = 1e-12 * np.trace(changed) / len(changed)
    changed = changed + tiny * np.eye(len(changed))
    _, size = np.linalg.slogdet(changed)
    squares = float(weight @ fit.residual**2) - float(slope @ np.linalg.solve(changed, slope))
    prior = (math.log(share / _MEDIAN) / _LOG_SD) ** 2
    # of the rows, unknown spectra of sources leave a share
    pairs = problem.model.scene.pairs
    taken = len(np.unique(pairs[:, 0])) / len(pairs) if problem.nuisances.free_spectra else 0.0
    return (1.0 - taken) * float(np.sum(np.log(variance))) + float(size) + squares + prior


def _relative_variance(problem: Problem, factor: float) -> FloatArray:
    """Return the variance of each row for another model error, over that of its weight."""
    sd = deviation(problem.model.scene, problem.observed, factor)
    ratio = np.maximum((sd / problem.sd) ** 2, 1e-6).ravel()
    return np.tile(ratio, 2) if problem.observed.has_phase else np.asarray(ratio)


def robust_covariance(fit: ImpedanceFit, factor: float) -> FloatArray:
    """Return the covariance of the unknowns for another model error than that of the weights.

    ``N^-1 (J^T V J + P^T P) N^-1`` [1]_, V the variance of the rows over that of their weights;
    wider where the data fit even worse than that.

    References
    ----------
    .. [1] H. White, "A heteroskedasticity-consistent covariance matrix estimator", Econometrica
           48, 817-838 (1980).
    """
    variance = _relative_variance(fit.problem, factor)
    inverse = np.linalg.pinv(fit.normal, hermitian=True)
    spread = fit.normal + fit.jacobian.T @ ((variance - 1.0)[:, None] * fit.jacobian)
    free = max(len(fit.residual) - fit.effective, 1.0)
    chi2 = float(np.sum(fit.residual**2 / variance)) / free
    return np.asarray(inverse @ spread @ inverse * max(chi2, 1.0))


# Minima whose R0 differ by less (rms, worst material) are one.
SAME_WITHIN = 0.01
_LARGEST_START = 0.95


class Start(NamedTuple):
    """The minimum that one start led to, with plane waves, short paths and few frequencies."""

    x: FloatArray  # (n_unknowns,)
    r0: ComplexArray  # (n_materials, n_frequencies kept)
    cost: float


def multistart(
    problem: Problem, n_random: int, rng: np.random.Generator, progress: Progress | None = None
) -> tuple[Start, ...]:
    """Return where the usual start and random ones lead, lowest cost first.

    The usual start is R0 = 0.8; random ones are even over the disc of passive walls, each material
    for itself. All at fewer frequencies, with plane waves.
    """
    thin = thinned(problem)
    found = []
    for number in range(1 + n_random):
        x = start_of(thin)
        if number > 0:
            for place, curve in zip(thin.layout.curves, thin.curves, strict=True):
                r0 = _LARGEST_START * np.sqrt(rng.random()) * np.exp(2j * np.pi * rng.random())
                x[place] = curve.start(complex(r0))
        end = continuation(thin, x, gain=1e-5)
        found.append(Start(end.x, r0_of(thin, end.x), end.cost))
        if progress is not None:
            progress((number + 1) / (1 + n_random))
    return tuple(sorted(found, key=lambda s: s.cost))


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


def thinned(problem: Problem) -> Problem:
    """Return the problem at about as few frequencies as its curves allow."""
    n_f = len(problem.observed.frequency_hz)
    most = max((c.basis.shape[1] for c in problem.curves), default=n_f)
    every = max(n_f // (2 * most), 1)  # two for each function of the smoothest curve
    if every == 1:
        return problem
    chosen, whole = np.arange(0, n_f, every), problem.observed
    f, pressure = whole.frequency_hz[chosen], whole.pressure[:, chosen]
    return replace(
        problem,
        model=at_frequencies(problem.model, chosen),
        observed=Observed(f, whole.tau_s, pressure, has_phase=whole.has_phase),
        sd=problem.sd[:, chosen],
        curves=tuple(c.at(chosen) for c in problem.curves),
    )
