"""All unknowns of a problem in one row, and what they stand for."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roomfit.impedance.model import State, at_rest
from roomfit.impedance.problem import Problem
from roomfit.typing import ComplexArray, FloatArray, IntArray


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
    gain_of_pair, delay_of_pair : int arrays, shape (n_pairs,)
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
    delay_of_pair: IntArray
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
    groups = {
        "common": np.zeros(len(scene.pairs), dtype=np.int64),
        "source": source_number(scene.pairs),
        "pair": np.arange(len(scene.pairs)),
    }
    by_pair = nuisances.gain in ("pair", "pair-spectrum")
    gains = groups.get("pair" if by_pair else nuisances.gain, np.zeros(0, dtype=np.int64))
    delays = groups[nuisances.delay]
    moves = take(len(axes[0])), take(len(axes[1]))
    speed = take(1 if nuisances.speed_sd > 0.0 else 0)
    gain = take(2 * len(np.unique(gains)))
    delay = take(len(np.unique(delays)) if nuisances.delay_sd_s > 0.0 else 0)
    places = axes[0], axes[1], sds[0], sds[1]
    return Layout(tuple(slices), *places, *moves, speed, gain, delay, gains, delays, at)


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
    model = problem.model
    f = model.frequency_hz - 0.5j / (math.pi * model.tau_s)
    return np.asarray(-2j * np.pi * f * problem.nuisances.delay_sd_s)
