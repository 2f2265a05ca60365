"""Least squares of pressures: the unknowns of a problem, weighted residuals, priors and Jacobians.

Besides, how wrong the image model is in the room at hand, by the residual of a fit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

import numpy as np

from roomfit.base.arguments import read_only
from roomfit.base.errors import InputError
from roomfit.base.typing import ComplexArray, FloatArray, IntArray
from roomfit.impedance.data import (
    MODEL_ERROR,
    Observed,
    complex_frequency_hz,
    standard_deviation,
)
from roomfit.impedance.laws import Curve
from roomfit.impedance.wave_model import (
    Gradients,
    Nuisances,
    State,
    WaveModel,
    at_rest,
    gradients,
    has_free_spectra,
)
from roomfit.room.mesh import mean_free_path_m
from roomfit.room.scene import Point, Scene


class Moves(NamedTuple):
    """Coordinates of sources, or of receivers, that may move."""

    point: IntArray  # (n,)
    axis: IntArray  # (n,), 0 to 2
    sd_m: FloatArray  # (n,)
    place: slice  # in the vector of all unknowns


class Layout(NamedTuple):
    """Position of each unknown in the vector of all.

    Shifts, speed and delays are in units of their prior standard deviations; gains are logarithms
    of all magnitudes, then all phases.
    """

    curves: tuple[slice, ...]  # one a material
    source: Moves
    receiver: Moves
    speed: slice
    gain: slice
    delay: slice
    gain_of_pair: IntArray  # (n_pairs,)
    delay_of_pair: IntArray  # (n_pairs,)
    size: int


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What is known of a measurement, and what is to be found."""

    model: WaveModel
    observed: Observed
    sd: FloatArray  # (n_pairs, n_frequencies), by `roomfit.impedance.data.standard_deviation`
    curves: tuple[Curve, ...]  # one a material
    nuisances: Nuisances
    spherical: bool = True
    model_error: float = MODEL_ERROR  # with which `sd` was made
    layout: Layout = field(init=False)

    def __post_init__(self) -> None:
        n_pairs, n_f = self.observed.pressure.shape
        scene = self.model.scene
        if n_pairs != len(scene.pairs) or n_f != len(self.model.frequency_hz):
            raise InputError(
                "pressures and model disagree",
                found=f"{n_pairs} pairs at {n_f} frequencies",
                needed=f"{len(scene.pairs)} pairs at {len(self.model.frequency_hz)}",
                hint="make the model of the pairs and frequencies that were measured",
            )
        if has_free_spectra(self.nuisances) and not self.observed.has_phase:
            raise InputError(
                "an unknown spectrum of the source needs pressures with phase",
                found="levels",
                needed="pressures with phase, or no unknown spectrum",
                hint="take one gain a source instead",
            )
        object.__setattr__(self, "sd", read_only(np.array(self.sd, dtype=np.float64)))
        object.__setattr__(self, "layout", _layout(scene, self.curves, self.nuisances))


def _layout(scene: Scene, fitted: tuple[Curve, ...], nuisances: Nuisances) -> Layout:
    at = 0

    def take(n: int) -> slice:
        nonlocal at
        at += n
        return slice(at - n, at)

    def moves(points: tuple[Point, ...], used: IntArray) -> Moves:
        specified = [p.position_sd_m for p in points]
        sd = np.array([nuisances.position_sd_m if s is None else s for s in specified])
        sd = np.maximum(sd, nuisances.least_position_sd_m)
        moving = np.array([i for i in np.unique(used) if sd[i] > 0.0], dtype=np.int64)
        axes = np.tile(np.arange(3), len(moving))
        return Moves(np.repeat(moving, 3), axes, np.repeat(sd[moving], 3), take(len(axes)))

    curves = tuple(take(len(c.start)) for c in fitted)
    source = moves(scene.sources, scene.pairs[:, 0])
    receiver = moves(scene.receivers, scene.pairs[:, 1])
    groups = {
        "common": np.zeros(len(scene.pairs), dtype=np.int64),
        "source": source_number(scene.pairs),
        "pair": np.arange(len(scene.pairs)),
    }
    by_pair = nuisances.gain in ("pair", "pair-spectrum")
    gains = groups.get("pair" if by_pair else nuisances.gain, np.zeros(0, dtype=np.int64))
    delays = groups[nuisances.delay]
    return Layout(
        curves=curves,
        source=source,
        receiver=receiver,
        speed=take(1 if nuisances.speed_sd > 0.0 else 0),
        gain=take(2 * len(np.unique(gains))),
        delay=take(len(np.unique(delays)) if nuisances.delay_sd_s > 0.0 else 0),
        gain_of_pair=gains,
        delay_of_pair=delays,
        size=at,
    )


def start_of(problem: Problem) -> FloatArray:
    """Return the unknowns with which a fit starts, shape (n_unknowns,)."""
    x = np.zeros(problem.layout.size)
    for place, curve in zip(problem.layout.curves, problem.curves, strict=True):
        x[place] = curve.start
    return x


def r0_of(problem: Problem, x: FloatArray) -> ComplexArray:
    """Return R0 of every material, shape (n_materials, n_frequencies)."""
    return np.array(
        [c.r0(x[place]) for c, place in zip(problem.curves, problem.layout.curves, strict=True)]
    )


def state_of(problem: Problem, x: FloatArray) -> State:
    """Return the shifts of sources and receivers and the change of the speed of sound."""
    layout, (source, receiver, _) = problem.layout, at_rest(problem.model)
    for shift, own in ((source, layout.source), (receiver, layout.receiver)):
        shift[own.point, own.axis] = x[own.place] * own.sd_m
    return State(source, receiver, float(np.sum(x[layout.speed])) * problem.nuisances.speed_sd)


def factor_of(problem: Problem, x: FloatArray) -> ComplexArray:
    """Return gain and delay as one factor, shape (n_pairs, n_frequencies)."""
    layout = problem.layout
    exponent = np.zeros(problem.observed.pressure.shape, dtype=np.complex128)
    if layout.gain.stop > layout.gain.start:
        size, phase = np.split(x[layout.gain], 2)
        exponent += (size + 1j * phase)[layout.gain_of_pair][:, None]
    if layout.delay.stop > layout.delay.start:
        exponent += by_delay(problem) * x[layout.delay][layout.delay_of_pair][:, None]
    return np.asarray(np.exp(exponent))


def source_number(pairs: IntArray) -> IntArray:
    return np.asarray(np.unique(pairs[:, 0], return_inverse=True)[1])


def by_delay(problem: Problem) -> ComplexArray:
    """Return the derivative of the logarithm of a pressure by a delay in its own unit."""
    f = complex_frequency_hz(problem.observed)
    return np.asarray(-2j * np.pi * f * problem.nuisances.delay_sd_s)


# Of 26 boxes with walls at random, at 40 dB, the error had this median, over what is allowed for
# it, and this spread of its logarithm: `scripts/bench impedance rooms`.
_MEDIAN, _LOG_SD = 0.5, 0.5
_GRID = np.geomspace(0.06, 6.0, 47)


class Whitened(NamedTuple):
    """A fit at its end, linearised: what its marginal likelihood needs."""

    residual: FloatArray  # (n_rows,), of the data, in standard deviations
    jacobian: FloatArray  # (n_rows, n_unknowns)
    normal: FloatArray  # (n_unknowns, n_unknowns), J^T J of data and priors


def marginal_likelihood_error(problem: Problem, fit: Whitened) -> float:
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
    if problem.model_error == 0.0:
        return 0.0
    hidden = has_free_spectra(problem.nuisances)
    grid = _GRID[_GRID >= _MEDIAN] if hidden else _GRID
    costs = [_cost(problem, fit, share) for share in grid]
    return float(grid[int(np.argmin(costs))]) * problem.model_error


def _cost(problem: Problem, fit: Whitened, share: float) -> float:
    """Return twice the negative logarithm of likelihood times prior, but for a constant."""
    variance = _relative_variance(problem, share * problem.model_error)
    weight = 1.0 / variance
    changed = fit.normal + fit.jacobian.T @ ((weight - 1.0)[:, None] * fit.jacobian)
    # at the minimum the slopes of data and priors cancel
    slope = fit.jacobian.T @ ((weight - 1.0) * fit.residual)
    tiny = 1e-12 * np.trace(changed) / len(changed)
    changed = changed + tiny * np.eye(len(changed))
    _, size = np.linalg.slogdet(changed)
    gained = float(slope @ np.linalg.solve(changed, slope))
    squares = float(weight @ fit.residual**2) - gained
    prior = (math.log(share / _MEDIAN) / _LOG_SD) ** 2
    # of the rows, unknown spectra of sources leave a share
    pairs = problem.model.scene.pairs
    taken = len(np.unique(pairs[:, 0])) / len(pairs) if has_free_spectra(problem.nuisances) else 0.0
    return (1.0 - taken) * float(np.sum(np.log(variance))) + float(size) + squares + prior


def _relative_variance(problem: Problem, factor: float) -> FloatArray:
    """Return the variance of each row for another model error, over that of its weight."""
    model = problem.model
    free_path_m = mean_free_path_m(model.scene.room.mesh)
    sd = standard_deviation(problem.observed, free_path_m, model.speed_m_s, factor)
    ratio = np.maximum((sd / problem.sd) ** 2, 1e-6).ravel()
    return np.tile(ratio, 2) if problem.observed.has_phase else np.asarray(ratio)


def robust_covariance(
    problem: Problem, fit: Whitened, factor: float, effective: float
) -> FloatArray:
    """Return the covariance of the unknowns for another model error than that of the weights.

    ``N^-1 (J^T V J + P^T P) N^-1`` [1]_, V the variance of the rows over that of their weights;
    wider where the data fit even worse than that.

    References
    ----------
    .. [1] H. White, "A heteroskedasticity-consistent covariance matrix estimator", Econometrica
           48, 817-838 (1980).
    """
    variance = _relative_variance(problem, factor)
    inverse = np.linalg.pinv(fit.normal, hermitian=True)
    spread = fit.normal + fit.jacobian.T @ ((variance - 1.0)[:, None] * fit.jacobian)
    free = max(len(fit.residual) - effective, 1.0)
    chi2 = float(np.sum(fit.residual**2 / variance)) / free
    return np.asarray(inverse @ spread @ inverse * max(chi2, 1.0))


# Standard deviations of the logarithm of an unknown gain: 20 dB, and any phase.
_GAIN_SD = 2.3
_PHASE_SD = 10.0
# |R0| above 1 weighs like a residual of its excess over this.
_PASSIVE_WITHIN = 1e-3


Rows: TypeAlias = tuple[FloatArray, FloatArray]
"""Weighted residuals of measured minus predicted, (n_rows,), and derivatives, (n_rows, n)."""


def data_rows(problem: Problem, x: FloatArray, correction: ComplexArray) -> Rows:
    """Return the residuals of the pressures in units of their standard deviation.

    Real parts first, then imaginary ones (levels: one row each). `correction`, of shape (n_pairs,
    n_frequencies), is added to the pressures of the short paths and fixed.
    """
    layout = problem.layout
    state = state_of(problem, x)
    moving = layout.delay.start > layout.curves[-1].stop
    g = gradients(problem.model, r0_of(problem, x), state, with_geometry=moving)
    pressure = g.pressure + correction
    slope = _slopes(problem, x, g._replace(pressure=pressure))
    factor = factor_of(problem, x)
    return _whitened(problem, factor * pressure, factor[:, :, None] * slope)


def _whitened(problem: Problem, predicted: ComplexArray, slope: ComplexArray) -> Rows:
    """Return residuals and Jacobian of predicted pressures, spectra of sources projected out."""
    observed = problem.observed
    weight = math.sqrt(2.0) / problem.sd
    if not observed.has_phase:
        size = np.abs(predicted)
        by = np.real(np.conj(predicted / size)[:, :, None] * slope)
        rows = weight * (np.abs(observed.pressure) - size)
        return rows.ravel(), -(weight[:, :, None] * by).reshape(rows.size, -1)
    missing = weight * observed.pressure
    model, turned = weight * predicted, weight[:, :, None] * slope
    if has_free_spectra(problem.nuisances):
        missing, turned = _without_spectra(problem, missing, model, turned)
    else:
        missing = missing - model
    rows = turned.reshape(missing.size, -1)
    residual = np.concatenate([missing.real.ravel(), missing.imag.ravel()])
    return residual, -np.vstack([rows.real, rows.imag])


def _without_spectra(
    problem: Problem, measured: ComplexArray, model: ComplexArray, slope: ComplexArray
) -> tuple[ComplexArray, ComplexArray]:
    """Return residuals and slopes with the best complex gain of each source and frequency.

    Variable projection [1]_ with Kaufman's derivative [2]_.

    References
    ----------
    .. [1] G. H. Golub, V. Pereyra, "The differentiation of pseudo-inverses and nonlinear least
           squares problems whose variables separate", SIAM J. Numer. Anal. 10, 413-432 (1973).
    .. [2] L. Kaufman, "A variable projection method for solving separable nonlinear least squares
           problems", BIT 15, 49-57 (1975).
    """
    residual, projected = np.empty_like(measured), np.empty_like(slope)
    owner = source_number(problem.model.scene.pairs)
    for source in range(owner.max() + 1):
        own = np.flatnonzero(owner == source)
        m = model[own]
        unit = m / np.sqrt(np.sum(np.abs(m) ** 2, axis=0))
        share = np.sum(np.conj(unit) * measured[own], axis=0)
        residual[own] = measured[own] - unit * share
        gain = share / np.sqrt(np.sum(np.abs(m) ** 2, axis=0))
        scaled = slope[own] * gain[None, :, None]
        along = np.einsum("pf,pfn->fn", np.conj(unit), scaled)
        projected[own] = scaled - unit[:, :, None] * along
    return residual, projected


def source_spectra(problem: Problem, predicted: ComplexArray) -> ComplexArray:
    """Return the best complex gain of each pair's source, shape (n_pairs, n_frequencies)."""
    owner = source_number(problem.model.scene.pairs)
    gain = np.empty_like(predicted)
    for source in range(owner.max() + 1):
        own = np.flatnonzero(owner == source)
        m, d = predicted[own] / problem.sd[own], problem.observed.pressure[own] / problem.sd[own]
        gain[own] = np.sum(np.conj(m) * d, axis=0) / np.sum(np.abs(m) ** 2, axis=0)
    return gain


def _slopes(problem: Problem, x: FloatArray, g: Gradients) -> ComplexArray:
    """Return the derivative of the pressure by every unknown, (n_pairs, n_frequencies, n)."""
    pairs, layout = problem.model.scene.pairs, problem.layout
    slope = np.zeros((*g.pressure.shape, layout.size), dtype=np.complex128)
    for i, (curve, place) in enumerate(zip(problem.curves, layout.curves, strict=True)):
        slope[:, :, place] = g.by_r0[:, i, :, None] * curve.slope(x[place])
    for moves, column, by in (
        (layout.source, pairs[:, 0], g.by_source),
        (layout.receiver, pairs[:, 1], g.by_receiver),
    ):
        for n, (point, axis, sd) in enumerate(zip(*moves[:3], strict=True), moves.place.start):
            own = np.flatnonzero(column == point)
            slope[own, :, n] = by[own, axis] * sd
    if layout.speed.stop > layout.speed.start:
        slope[:, :, layout.speed.start] = g.by_speed * problem.nuisances.speed_sd
    n_gains = (layout.gain.stop - layout.gain.start) // 2
    for n in range(n_gains):
        own = np.flatnonzero(layout.gain_of_pair == n)
        slope[own, :, layout.gain.start + n] = g.pressure[own]
        slope[own, :, layout.gain.start + n_gains + n] = 1j * g.pressure[own]
    if layout.delay.stop > layout.delay.start:
        for n in range(layout.delay.stop - layout.delay.start):
            own = np.flatnonzero(layout.delay_of_pair == n)
            slope[own, :, layout.delay.start + n] = g.pressure[own] * by_delay(problem)
    return slope


def prior_rows(problem: Problem, x: FloatArray, roughness_sd: FloatArray) -> Rows:
    """Return the priors of the unknowns as residuals of unit variance.

    `roughness_sd`, shape (n_materials,): standard deviation of the second difference of a curve's
    coefficients.
    """
    layout = problem.layout
    rows: list[FloatArray] = []
    values: list[FloatArray] = []

    def add(place: slice, own: FloatArray, value: FloatArray) -> None:
        wide = np.zeros((len(own), layout.size))
        wide[:, place] = own
        rows.append(wide)
        values.append(value)

    for i, (curve, place) in enumerate(zip(problem.curves, layout.curves, strict=True)):
        own = curve.roughness / roughness_sd[i]
        add(place, own, own @ x[place])
        if math.isfinite(curve.prior_sd):
            eye = np.eye(len(curve.start)) / curve.prior_sd
            add(place, eye, eye @ (x[place] - curve.start))
        r0, slope = curve.between(x[place])
        size = np.abs(r0)
        over = size > 1.0
        by = np.real(np.conj(r0[over] / size[over])[:, None] * slope[over])
        add(place, by / _PASSIVE_WITHIN, (size[over] - 1.0) / _PASSIVE_WITHIN)
    for place in (layout.source.place, layout.receiver.place, layout.speed, layout.delay):
        add(place, np.eye(place.stop - place.start), x[place])
    n = (layout.gain.stop - layout.gain.start) // 2
    scale = np.diag(np.repeat([1.0 / _GAIN_SD, 1.0 / _PHASE_SD], n))
    add(layout.gain, scale, scale @ x[layout.gain])
    return np.concatenate(values), np.vstack(rows)
