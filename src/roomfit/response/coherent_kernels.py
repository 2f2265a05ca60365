"""Compiled loops of the coherent reader: spikes laid on a grid, products summed over windows."""

from __future__ import annotations

import math

import numba
import numpy as np

from roomfit.compiled import kernel
from roomfit.typing import FloatArray, IntArray

# Taps of the spreading kernel and steps of its table between two taps.
TAPS = 6
TABLE_STEPS = 2048


@kernel()
def root_energies(weight: FloatArray, hits: IntArray, powers: FloatArray) -> FloatArray:
    """Return ``sqrt(weight) * product of sqrt(x) ** hits`` of every path, shape (n,).

    `powers` is the table of ``sqrt(x) ** h``, shape (n_materials, max_hits + 1).
    """
    out = np.empty(len(weight))
    for i in range(len(weight)):
        root = math.sqrt(weight[i])
        for m in range(hits.shape[1]):
            root *= powers[m, hits[i, m]]
        out[i] = root
    return out


@kernel(parallel=True)
def lay_trains(
    offsets: IntArray,
    away: FloatArray,
    unfolding: FloatArray,
    hits: IntArray,
    root: FloatArray,
    shifts: FloatArray,
    speed: float,
    latency: FloatArray,
    delays: FloatArray,
    first_s: float,
    rate_hz: float,
    table: FloatArray,
    trains: FloatArray,
) -> None:
    """Lay every path's spike, times its derivatives, upon the grids of its observation.

    Parameters
    ----------
    offsets : shape (n_observations + 1,)
        Which paths belong to each observation.
    away : shape (n_paths, 3)
        From image to receiver, m.
    unfolding : shape (n_paths, 9)
        The product A of a path's reflections, row by row.
    shifts : shape (n_observations, 6)
        By how much source and receiver stand elsewhere, m.
    trains : shape (n_observations, n_grid, 8 + n_materials), or (n_observations, n_grid, 1)
        Zeros; filled with spikes of height s; hits s of every material; -dt/dsource s (3),
        dt/dreceiver s (3), and -dt/dln c s (1). A single column holds the first of them.
    """
    n_materials = hits.shape[1]
    n_grid, n_columns = trains.shape[1], trains.shape[2]
    half = TAPS // 2
    for o in numba.prange(len(offsets) - 1):
        values = np.empty(8 + n_materials)
        own = trains[o]
        for i in range(offsets[o], offsets[o + 1]):
            a = unfolding[i]
            v0 = away[i, 0] + shifts[o, 3]
            v1 = away[i, 1] + shifts[o, 4]
            v2 = away[i, 2] + shifts[o, 5]
            s0, s1, s2 = shifts[o, 0], shifts[o, 1], shifts[o, 2]
            v0 -= a[0] * s0 + a[1] * s1 + a[2] * s2
            v1 -= a[3] * s0 + a[4] * s1 + a[5] * s2
            v2 -= a[6] * s0 + a[7] * s1 + a[8] * s2
            d = math.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
            t = d / speed + latency[o]
            s = root[i]
            values[0] = s
            for m in range(n_materials):
                h = hits[i, m]
                t += h * delays[m]
                values[1 + m] = h * s
            if n_columns > 1:
                k = 1 + n_materials
                u = s / (speed * d)
                values[k] = u * (a[0] * v0 + a[3] * v1 + a[6] * v2)
                values[k + 1] = u * (a[1] * v0 + a[4] * v1 + a[7] * v2)
                values[k + 2] = u * (a[2] * v0 + a[5] * v1 + a[8] * v2)
                values[k + 3] = u * v0
                values[k + 4] = u * v1
                values[k + 5] = u * v2
                values[k + 6] = s * d / speed
            place = (t - first_s) * rate_hz
            low = math.floor(place) - half + 1
            inside = low >= 0 and low + TAPS <= n_grid
            for tap in range(TAPS):
                distance = (abs(low + tap - place)) * TABLE_STEPS
                step = int(distance)
                share = distance - step
                height = table[step] + share * (table[step + 1] - table[step])
                # a remainder costs as much as all the sums of a tap
                g = low + tap if inside else (low + tap) % n_grid
                row = own[g]
                for j in range(n_columns):
                    row[j] += height * values[j]


@kernel(parallel=True)
def window_products(
    starts: IntArray,
    edges: FloatArray,
    pressure: FloatArray,
    derivatives: FloatArray,
    energy: FloatArray,
    slopes: FloatArray,
) -> None:
    """Integrate y^2 and 2 y dy over windows, in samples.

    Parameters
    ----------
    starts : shape (n_observations + 1,)
        Where each observation's edges begin; it has one window fewer than edges.
    edges : shape (n_edges,)
        In samples; sample k stands for the time from k - 1/2 to k + 1/2.
    pressure : shape (n_observations, n_grid)
    derivatives : shape (n_observations, n_columns, n_grid)
    energy : shape (n_windows,)
        Windows of all observations end to end.
    slopes : shape (n_windows, n_columns)
    """
    n_columns = derivatives.shape[1]
    for o in numba.prange(len(starts) - 1):
        y, dy = pressure[o], derivatives[o]
        weighed = np.empty(len(y))
        for e in range(starts[o], starts[o + 1] - 1):
            w = e - o
            low, high = edges[e] + 0.5, edges[e + 1] + 0.5
            first, last = max(math.floor(low), 0), min(math.floor(high), len(y) - 1)
            total = 0.0
            for k in range(first, last + 1):
                weighed[k] = (min(high, k + 1.0) - max(low, 1.0 * k)) * y[k]
                total += weighed[k] * y[k]
            energy[w] = total
            # four sums at a time need not wait for each other
            for j in range(0, n_columns - 3, 4):
                a, b, c, d = 0.0, 0.0, 0.0, 0.0
                for k in range(first, last + 1):
                    a += weighed[k] * dy[j, k]
                    b += weighed[k] * dy[j + 1, k]
                    c += weighed[k] * dy[j + 2, k]
                    d += weighed[k] * dy[j + 3, k]
                slopes[w, j], slopes[w, j + 1] = 2.0 * a, 2.0 * b
                slopes[w, j + 2], slopes[w, j + 3] = 2.0 * c, 2.0 * d
            for j in range(n_columns - n_columns % 4, n_columns):
                a = 0.0
                for k in range(first, last + 1):
                    a += weighed[k] * dy[j, k]
                slopes[w, j] = 2.0 * a


@kernel()
def binned_energies(
    bins: IntArray, hits: IntArray, energy: FloatArray, total: FloatArray, by_hits: FloatArray
) -> None:
    """Sum energies into bins, and energies times hits: (n_bins,) and (n_materials, n_bins)."""
    for i in range(len(bins)):
        total[bins[i]] += energy[i]
        for m in range(hits.shape[1]):
            by_hits[m, bins[i]] += hits[i, m] * energy[i]


@kernel()
def spread_squared(
    offsets: IntArray,
    toward: FloatArray,
    departure: FloatArray,
    travel: FloatArray,
    hits: IntArray,
    speed: float,
    roots: FloatArray,
    out: FloatArray,
) -> None:
    """Variance of arrival times: the squared length of each path's row D times a root of Cov.

    `roots` has the shape (n_observations, 8 + n_materials, k), entries in the order source (3),
    receiver (3), ln c, latency, delays.
    """
    n_materials = hits.shape[1]
    for o in range(len(offsets) - 1):
        root = roots[o]
        row = np.empty(8 + n_materials)
        for i in range(offsets[o], offsets[o + 1]):
            for axis in range(3):
                row[axis] = -departure[i, axis] / speed
                row[3 + axis] = toward[i, axis] / speed
            row[6] = -travel[i]
            row[7] = 1.0
            for m in range(n_materials):
                row[8 + m] = hits[i, m]
            total = 0.0
            for k in range(root.shape[1]):
                dot = 0.0
                for j in range(len(row)):
                    dot += row[j] * root[j, k]
                total += dot * dot
            out[i] = total
