"""Measured against predicted pressures: weighted residuals, priors, and their Jacobians."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roomfit.impedance.layout import (
    Layout,
    by_delay,
    factor_of,
    r0_of,
    source_number,
    state_of,
)
from roomfit.impedance.model import Gradients, gradients, has_free_spectra
from roomfit.impedance.problem import Problem
from roomfit.typing import ComplexArray, FloatArray

# Standard deviations of the logarithm of an unknown gain: 20 dB, and any phase.
_GAIN_SD = 2.3
_PHASE_SD = 10.0
# |R0| above 1 weighs like a residual of its excess over this.
_PASSIVE_WITHIN = 1e-3


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
    if has_free_spectra(problem.nuisances):
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
        for n in range(layout.delay.stop - layout.delay.start):
            own = np.flatnonzero(layout.delay_of_pair == n)
            slope[own, :, layout.delay.start + n] = g.pressure[own] * by_delay(problem)
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
