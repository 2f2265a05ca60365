"""Measured against predicted pressures: unknowns in one row, weighted residuals and Jacobian."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from roomfit.checks import read_only
from roomfit.errors import InputError
from roomfit.impedance.curves import Curve
from roomfit.impedance.model import Gradients, Nuisances, State, WaveModel, at_rest, gradients
from roomfit.impedance.observed import MODEL_ERROR, Observed
from roomfit.typing import ComplexArray, FloatArray, IntArray

# Standard deviations of the logarithm of an unknown gain: 20 dB, and any phase.
_GAIN_SD = 2.3
_PHASE_SD = 10.0
# |R0| above 1 weighs like a residual of its excess over this.
_PASSIVE_WITHIN = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What is known of a measurement, and what is to be found.

    Attributes
    ----------
    model : WaveModel
    observed : Observed
    sd : float array, shape (n_pairs, n_frequencies)
        From `roomfit.impedance.observed.standard_deviation`.
    curves : tuple of Curve
        One a material.
    nuisances : Nuisances
    spherical : bool
    model_error : float
        With which `sd` was made.
    """

    model: WaveModel
    observed: Observed
    sd: FloatArray
    curves: tuple[Curve, ...]
    nuisances: Nuisances
    spherical: bool = True
    model_error: float = MODEL_ERROR

    def __post_init__(self) -> None:
        n_pairs, n_f = self.observed.pressure.shape
        scene = self.model.scene
        if n_pairs != len(scene.pairs) or n_f != len(self.model.frequency_hz):
            raise InputError(
                "pressures and model disagree",
                found=f"{n_pairs} pairs at {n_f} frequencies",
                needed=f"{len(scene.pairs)} pairs at {len(self.model.frequency_hz)}",
            )
        if len(self.curves) != len(scene.room.materials):
            raise InputError(
                "curves and materials disagree",
                found=f"{len(self.curves)} curves",
                needed=f"one for each of {', '.join(scene.room.materials)}",
            )
        if self.nuisances.gain == "spectrum" and not self.observed.has_phase:
            raise InputError(
                "an unknown spectrum of the source needs pressures with phase",
                found="levels",
                hint="take one gain a source instead",
            )
        object.__setattr__(self, "sd", read_only(np.array(self.sd, dtype=np.float64)))


class Layout(NamedTuple):
    """Where each unknown stands in the row of all.

    Attributes
    ----------
    curves : tuple of slice
        One a material.
    source, receiver : int arrays, shape (n, 2)
        Point and axis of each coordinate that may move.
    source_sd_m, receiver_sd_m : float arrays, shape (n,)
    moves_source, moves_receiver, speed, gain, delay : slice
        Moves, speed and delays in units of their standard deviations; gain: logarithms of all
        sizes, then all phases.
    gain_of_pair : int array, shape (n_pairs,)
    size : int
    """

    curves: tuple[slice, ...]
    source: IntArray
    receiver: IntArray
    source_sd_m: FloatArray
    receiver_sd_m: FloatArray
    moves_source: slice
    moves_receiver: slice
    speed: slice
    gain: slice
    delay: slice
    gain_of_pair: IntArray
    size: int


def layout_of(problem: Problem) -> Layout:
    """Return where each unknown of a problem stands."""
    scene, nuisances = problem.model.scene, problem.nuisances
    at = 0
    slices: list[slice] = []

    def take(n: int) -> slice:
        nonlocal at
        at += n
        return slice(at - n, at)

    slices = [take(len(c.start)) for c in problem.curves]
    axes: list[IntArray] = []
    sds: list[FloatArray] = []
    for points, used in ((scene.sources, scene.pairs[:, 0]), (scene.receivers, scene.pairs[:, 1])):
        told = [p.position_sd_m for p in points]
        sd = np.array([nuisances.position_sd_m if s is None else s for s in told])
        sd = np.maximum(sd, nuisances.least_position_sd_m)
        moving = [i for i in np.unique(used) if sd[i] > 0.0]
        axes.append(np.array([(i, a) for i in moving for a in range(3)], np.int64).reshape(-1, 2))
        sds.append(np.repeat(sd[moving], 3))
    sources, owner = np.unique(scene.pairs[:, 0], return_inverse=True)
    groups = {
        "common": np.zeros(len(scene.pairs), dtype=np.int64),
        "source": owner,
        "pair": np.arange(len(scene.pairs)),
    }.get(nuisances.gain, np.zeros(0, dtype=np.int64))
    moves = take(len(axes[0])), take(len(axes[1]))
    speed = take(1 if nuisances.speed_sd > 0.0 else 0)
    gain = take(2 * len(np.unique(groups)))
    delay = take(len(sources) if nuisances.delay_sd_s > 0.0 else 0)
    return Layout(
        tuple(slices), axes[0], axes[1], sds[0], sds[1], *moves, speed, gain, delay, groups, at
    )


def start_of(problem: Problem) -> FloatArray:
    """Return the row of unknowns with which a fit begins."""
    layout = layout_of(problem)
    x = np.zeros(layout.size)
    for place, curve in zip(layout.curves, problem.curves, strict=True):
        x[place] = curve.start
    return x


def r0_of(problem: Problem, layout: Layout, x: FloatArray) -> ComplexArray:
    """Return R0 of every material, shape (n_materials, n_frequencies)."""
    return np.array(
        [c.r0(x[place]) for c, place in zip(problem.curves, layout.curves, strict=True)]
    )


def state_of(problem: Problem, layout: Layout, x: FloatArray) -> State:
    """Return where source and receivers are and how fast sound is."""
    rest = at_rest(problem.model)
    source, receiver = rest.source_m.copy(), rest.receiver_m.copy()
    source[tuple(layout.source.T)] = x[layout.moves_source] * layout.source_sd_m
    receiver[tuple(layout.receiver.T)] = x[layout.moves_receiver] * layout.receiver_sd_m
    return State(source, receiver, float(np.sum(x[layout.speed])) * problem.nuisances.speed_sd)


def factor_of(problem: Problem, layout: Layout, x: FloatArray) -> ComplexArray:
    """Return gain and delay as one factor, shape (n_pairs, n_frequencies)."""
    observed, scene = problem.observed, problem.model.scene
    exponent = np.zeros(observed.pressure.shape, dtype=np.complex128)
    if layout.gain.stop > layout.gain.start:
        size, phase = np.split(x[layout.gain], 2)
        exponent += (size + 1j * phase)[layout.gain_of_pair][:, None]
    if layout.delay.stop > layout.delay.start:
        exponent += _by_delay(problem) * x[layout.delay][_source_number(scene.pairs)][:, None]
    return np.asarray(np.exp(exponent))


def _source_number(pairs: IntArray) -> IntArray:
    return np.asarray(np.unique(pairs[:, 0], return_inverse=True)[1])


def _by_delay(problem: Problem) -> ComplexArray:
    """Return the derivative of the logarithm of a pressure by a delay in its own unit."""
    model = problem.model
    f = model.frequency_hz - 0.5j / (math.pi * model.tau_s)
    return np.asarray(-2j * np.pi * f * problem.nuisances.delay_sd_s)


class Linear(NamedTuple):
    """Weighted residuals of measured minus predicted, and their derivatives, real.

    Attributes
    ----------
    residual : float array, shape (n_rows,)
    jacobian : float array, shape (n_rows, n_unknowns)
    """

    residual: FloatArray
    jacobian: FloatArray


def data_rows(problem: Problem, layout: Layout, x: FloatArray, correction: ComplexArray) -> Linear:
    """Return the residuals of the pressures in units of their standard deviation.

    Real parts first, then imaginary ones (levels: one row each). `correction`, of shape (n_pairs,
    n_frequencies), is added to the pressures of the short paths and held.
    """
    state = state_of(problem, layout, x)
    moving = layout.delay.start > layout.curves[-1].stop
    g = gradients(problem.model, r0_of(problem, layout, x), state, with_geometry=moving)
    pressure = g.pressure + correction
    slope = _slopes(problem, layout, x, g._replace(pressure=pressure))
    factor = factor_of(problem, layout, x)
    return whitened(problem, factor * pressure, factor[:, :, None] * slope)


def whitened(problem: Problem, predicted: ComplexArray, slope: ComplexArray) -> Linear:
    """Return residuals and Jacobian of predicted pressures, spectra of sources taken out."""
    observed = problem.observed
    weight = math.sqrt(2.0) / problem.sd
    if not observed.has_phase:
        size = np.abs(predicted)
        by = np.real(np.conj(predicted / size)[:, :, None] * slope)
        rows = weight * (np.abs(observed.pressure) - size)
        return Linear(rows.ravel(), -(weight[:, :, None] * by).reshape(rows.size, -1))
    missing = weight * observed.pressure
    model, turned = weight * predicted, weight[:, :, None] * slope
    if problem.nuisances.gain == "spectrum":
        missing, turned = _without_spectra(problem, missing, model, turned)
    else:
        missing = missing - model
    rows = turned.reshape(missing.size, -1)
    residual = np.concatenate([missing.real.ravel(), missing.imag.ravel()])
    return Linear(residual, -np.vstack([rows.real, rows.imag]))


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
    owner = _source_number(problem.model.scene.pairs)
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
    owner = _source_number(problem.model.scene.pairs)
    gain = np.empty_like(predicted)
    for source in range(owner.max() + 1):
        own = np.flatnonzero(owner == source)
        m, d = predicted[own] / problem.sd[own], problem.observed.pressure[own] / problem.sd[own]
        gain[own] = np.sum(np.conj(m) * d, axis=0) / np.sum(np.abs(m) ** 2, axis=0)
    return gain


def _slopes(problem: Problem, layout: Layout, x: FloatArray, g: Gradients) -> ComplexArray:
    """Return the derivative of the pressure by every unknown, (n_pairs, n_frequencies, n)."""
    pairs = problem.model.scene.pairs
    slope = np.zeros((*g.pressure.shape, layout.size), dtype=np.complex128)
    for i, (curve, place) in enumerate(zip(problem.curves, layout.curves, strict=True)):
        slope[:, :, place] = g.by_r0[:, i, :, None] * curve.slope(x[place])
    for moves, points, sd, column, by in (
        (layout.moves_source, layout.source, layout.source_sd_m, pairs[:, 0], g.by_source),
        (layout.moves_receiver, layout.receiver, layout.receiver_sd_m, pairs[:, 1], g.by_receiver),
    ):
        for n, (point, axis) in enumerate(points):
            own = np.flatnonzero(column == point)
            slope[own, :, moves.start + n] = by[own, axis] * sd[n]
    if layout.speed.stop > layout.speed.start:
        slope[:, :, layout.speed.start] = g.by_speed * problem.nuisances.speed_sd
    n_gains = (layout.gain.stop - layout.gain.start) // 2
    for n in range(n_gains):
        own = np.flatnonzero(layout.gain_of_pair == n)
        slope[own, :, layout.gain.start + n] = g.pressure[own]
        slope[own, :, layout.gain.start + n_gains + n] = 1j * g.pressure[own]
    if layout.delay.stop > layout.delay.start:
        number = _source_number(pairs)
        for n in range(layout.delay.stop - layout.delay.start):
            own = np.flatnonzero(number == n)
            slope[own, :, layout.delay.start + n] = g.pressure[own] * _by_delay(problem)
    return slope


def prior_rows(problem: Problem, layout: Layout, x: FloatArray, roughness_sd: FloatArray) -> Linear:
    """Return what is believed of the unknowns beforehand as residuals of unit variance.

    Parameters
    ----------
    roughness_sd : float array, shape (n_materials,)
        Standard deviation of the second difference of a curve's coefficients.
    """
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
    for place in (layout.moves_source, layout.moves_receiver, layout.speed, layout.delay):
        add(place, np.eye(place.stop - place.start), x[place])
    n = (layout.gain.stop - layout.gain.start) // 2
    scale = np.diag(np.repeat([1.0 / _GAIN_SD, 1.0 / _PHASE_SD], n))
    add(layout.gain, scale, scale @ x[layout.gain])
    return Linear(np.concatenate(values), np.vstack(rows))
