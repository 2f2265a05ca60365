"""Least squares of pressures: unknowns of a problem, weighted residuals, priors and Jacobians.

Gains are eliminated by variable projection [1]_ with Kaufman's derivative [2]_.

References
----------
.. [1] G. H. Golub, V. Pereyra, "The differentiation of pseudo-inverses and nonlinear least squares
       problems whose variables separate", SIAM J. Numer. Anal. 10, 413-432 (1973).
.. [2] L. Kaufman, "A variable projection method for solving separable nonlinear least squares
       problems", BIT 15, 49-57 (1975).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

import numpy as np

from roomfit.base.arguments import check_shape
from roomfit.base.errors import InputError
from roomfit.base.typing import ComplexArray, FloatArray, IntArray
from roomfit.impedance.data import MODEL_ERROR, Observed, complex_frequency_hz
from roomfit.impedance.laws import Curve
from roomfit.impedance.wave_model import Gradients, Nuisances, State, WaveModel, at_rest, gradients
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
    sd: FloatArray  # (n_pairs, n_frequencies), see `roomfit.impedance.data.deviation`
    curves: tuple[Curve, ...]  # one a material
    nuisances: Nuisances
    spherical: bool = True
    model_error: float = MODEL_ERROR  # with which `sd` was made
    layout: Layout = field(init=False)

    def __post_init__(self) -> None:
        layout = layout_of(self.model.scene, self.curves, self.nuisances)
        object.__setattr__(self, "layout", layout)


def check_observed(scene: Scene, observed: Observed, nuisances: Nuisances) -> None:
    """Refuse pressures of other pairs, and levels where phases are needed."""
    check_shape("pressures of the pairs of the scene", observed.pressure, (len(scene.pairs), None))
    if nuisances.free_spectra and not observed.has_phase:
        what = "an unknown spectrum of the source needs pressures with phase"
        needed, hint = "pressures with phase", "take one gain a source instead"
        raise InputError(what, found="levels", needed=needed, hint=hint)


def layout_of(scene: Scene, fitted: tuple[Curve, ...], nuisances: Nuisances) -> Layout:
    """Return the unknowns of curves and of what may be wrong about a measurement."""
    at = 0

    def take(n: int) -> slice:
        nonlocal at
        at += n
        return slice(at - n, at)

    def moves(points: tuple[Point, ...], used: IntArray) -> Moves:
        specified = [p.position_sd_m for p in points]
        sd = np.array([nuisances.position_sd_m if s is None else s for s in specified])
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
        [
            c.values(x[place])[0]
            for c, place in zip(problem.curves, problem.layout.curves, strict=True)
        ]
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
    """Return the number of each pair's source among those that are used."""
    return np.asarray(np.unique(pairs[:, 0], return_inverse=True)[1])


def by_delay(problem: Problem) -> ComplexArray:
    """Return the derivative of the logarithm of a pressure by a delay in its own unit."""
    f = complex_frequency_hz(problem.observed)
    return np.asarray(-2j * np.pi * f * problem.nuisances.delay_sd_s)


Rows: TypeAlias = tuple[FloatArray, FloatArray]
"""Weighted residuals of measured minus predicted, (n_rows,), and derivatives, (n_rows, n)."""


def data_rows(problem: Problem, x: FloatArray, correction: ComplexArray) -> Rows:
    """Return the residuals of the pressures in units of their standard deviation.

    Real parts first, then imaginary ones (levels: one row each). `correction`, of shape (n_pairs,
    n_frequencies), is added to the pressures of the short paths and fixed.
    """
    observed = problem.observed
    g = gradients(problem.model, r0_of(problem, x), state_of(problem, x))
    g = g._replace(pressure=g.pressure + correction)
    factor = factor_of(problem, x)
    weight = math.sqrt(2.0) / problem.sd
    predicted, slope = factor * g.pressure, factor[:, :, None] * _slopes(problem, x, g)
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


def _slopes(problem: Problem, x: FloatArray, g: Gradients) -> ComplexArray:
    """Return the derivative of the pressure by every unknown, (n_pairs, n_frequencies, n)."""
    pairs, layout = problem.model.scene.pairs, problem.layout
    slope = np.zeros((*g.pressure.shape, layout.size), dtype=np.complex128)
    for i, (curve, place) in enumerate(zip(problem.curves, layout.curves, strict=True)):
        slope[:, :, place] = g.by_r0[:, i, :, None] * curve.values(x[place])[1]
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
    for n in range(layout.delay.stop - layout.delay.start):
        own = np.flatnonzero(layout.delay_of_pair == n)
        slope[own, :, layout.delay.start + n] = g.pressure[own] * by_delay(problem)
    return slope


# Standard deviations of the logarithm of an unknown gain: 20 dB, and any phase.
_GAIN_SD, _PHASE_SD = 2.3, 10.0
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
            eye = np.eye(len(curve.start)) / curve.prior_sd
            blocks.append((place, eye, eye @ (x[place] - curve.start)))
        r0, slope = curve.values(x[place])
        if curve.kind == "constant":
            r0, slope = r0[:1], slope[:1]
        size = np.abs(r0)
        over = size > 1.0
        by = np.real(np.conj(r0[over] / size[over])[:, None] * slope[over])
        blocks.append((place, by / _PASSIVE_WITHIN, (size[over] - 1.0) / _PASSIVE_WITHIN))
    for place in (layout.source.place, layout.receiver.place, layout.speed, layout.delay):
        blocks.append((place, np.eye(place.stop - place.start), x[place]))
    n = (layout.gain.stop - layout.gain.start) // 2
    scale = np.diag(np.repeat([1.0 / _GAIN_SD, 1.0 / _PHASE_SD], n))
    blocks.append((layout.gain, scale, scale @ x[layout.gain]))
    rows = np.zeros((sum(len(own) for _, own, _ in blocks), layout.size))
    at = 0
    for place, own, _ in blocks:
        rows[at : at + len(own), place] = own
        at += len(own)
    return np.concatenate([value for *_, value in blocks]), rows
