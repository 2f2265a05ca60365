"""Passes over the rows: energies, their logarithms' slopes, and the sandwich over a box.

A box is `lo` and `hi` in g = log(1 - absorption). A coordinate whose `lo` is minus infinity reaches
an absorption of 1; rows that hit it count as anything from 0 to their value at `hi`.
"""

from __future__ import annotations

import math

import numpy as np

from roomfit.compiled import kernel
from roomfit.identification.certified.question import Arrays
from roomfit.typing import BoolArray, FloatArray

# Sums of nonnegative terms and products of nonnegative factors: relative errors only add up.
UNIT_ROUNDOFF = 2.0**-53
# Far above the numbers that lose digits by being small (2.2e-308).
VANISHING = 1e-250


@kernel()
def powers(g: FloatArray, most: int) -> FloatArray:
    """Return ``exp(g) ** n`` by repeated multiplication, shape (n_coordinates, most + 1)."""
    table = np.empty((len(g), most + 1))
    for m in range(len(g)):
        x = math.exp(g[m])
        table[m, 0] = 1.0
        for n in range(1, most + 1):
            table[m, n] = table[m, n - 1] * x
    return table


@kernel(allocates=False)
def energies(question: Arrays, table: FloatArray, energy: FloatArray) -> None:
    """Fill the energy of every window, shape (n_windows,)."""
    offsets, weight, exponents = question[0], question[1], question[2]
    n = exponents.shape[1]
    for i in range(len(offsets) - 1):
        total = 0.0
        for k in range(offsets[i], offsets[i + 1]):
            value = weight[k]
            for m in range(n):
                value *= table[m, exponents[k, m]]
            total += value
        energy[i] = total


@kernel(allocates=False)
def log_slopes(
    question: Arrays,
    table: FloatArray,
    far: BoolArray,
    values: FloatArray,
    energy: FloatArray,
    slope: FloatArray,
) -> None:
    """Fill row values, window energies and the slopes of log energy by g, (n_windows, n).

    Rows that hit a coordinate of `far`, and rows too small to be rounded well, are left out: their
    value is 0.
    """
    offsets, weight, exponents = question[0], question[1], question[2]
    n = exponents.shape[1]
    for i in range(len(offsets) - 1):
        total = 0.0
        for m in range(n):
            slope[i, m] = 0.0
        for k in range(offsets[i], offsets[i + 1]):
            value = weight[k]
            for m in range(n):
                value *= table[m, exponents[k, m]]
                if far[m] and exponents[k, m] > 0:
                    value = 0.0
            if value < VANISHING:
                value = 0.0
            values[k] = value
            total += value
            for m in range(n):
                slope[i, m] += value * exponents[k, m]
        energy[i] = total
        if total > 0.0:
            for m in range(n):
                slope[i, m] /= total


@kernel(allocates=False)
def vertex_remainder(
    question: Arrays,
    i: int,
    values: FloatArray,
    total: float,
    slope: FloatArray,
    half: FloatArray,
    product: FloatArray,
    sums: FloatArray,
) -> float:
    """Return how far one window's log energy rises above its tangent plane within a box, at most.

    The logarithm of a sum of exponentials is convex, so that the highest place above a plane is a
    vertex; all are tried. Infinite where a row may change by a factor beyond e**600.

    Parameters
    ----------
    product, sums : float arrays, shape (2 ** n,)
        Scratch.
    """
    offsets, exponents = question[0], question[2]
    n = exponents.shape[1]
    sums[:] = 0.0
    for k in range(offsets[i], offsets[i + 1]):
        if values[k] == 0.0:
            continue
        product[0] = values[k] / total
        reach, count = 0.0, 1
        for m in range(n):
            u = (exponents[k, m] - slope[m]) * half[m]
            reach += abs(u)
            up, down = math.exp(u), math.exp(-u)
            for v in range(count):
                product[count + v] = product[v] * up
                product[v] *= down
            count *= 2
        if not reach <= 600.0:
            return math.inf
        for v in range(count):
            sums[v] += product[v]
    # 1e-12: n exponentials of numbers below 600 rounded to 1 in 2**53, and the sums
    most = 0.0
    for v in range(1 << n):
        most = max(most, sums[v])
    return math.log(most) + 1e-12


@kernel(allocates=False)
def spread_of_window(
    question: Arrays,
    i: int,
    values: FloatArray,
    total: float,
    slope: FloatArray,
    half: FloatArray,
    nodes: FloatArray,
    wobble: float,
    spread: FloatArray,
) -> float:
    """Fill the weighted second moments of one window's exponents; return their total weight.

    ``spread[a, b] = sum_k p_k kappa(rho_k) (n_ka - nbar_a)(n_kb - nbar_b)`` with
    ``rho_k = sum_m |n_km - nbar_m| h_m + wobble``, for the remainder of the sandwich.

    Parameters
    ----------
    nodes : float array
        ``kappa(rho) = (exp(rho) - 1 - rho) / rho**2`` at every 1/32: a chord between two lies above
        it, for it bends up.
    wobble : float
        More than the rounding of rho.
    """
    offsets, exponents = question[0], question[2]
    n = exponents.shape[1]
    for a in range(n):
        for b in range(n):
            spread[a, b] = 0.0
    weight_of_all = 0.0
    for k in range(offsets[i], offsets[i + 1]):
        if values[k] == 0.0:
            continue
        rho = wobble
        for m in range(n):
            rho += abs(exponents[k, m] - slope[m]) * half[m]
        p = values[k] / total * kappa(rho, nodes)
        weight_of_all += p
        for a in range(n):
            of_a = p * (exponents[k, a] - slope[a])
            for b in range(a + 1):
                spread[a, b] += of_a * (exponents[k, b] - slope[b])
    for a in range(n):
        for b in range(a):
            spread[b, a] = spread[a, b]
    return weight_of_all


@kernel(allocates=False)
def kappa(rho: float, nodes: FloatArray) -> float:
    """Return a number no smaller than ``(exp(rho) - 1 - rho) / rho**2``."""
    place = 32.0 * rho
    if place >= len(nodes) - 1:
        return 1.000000001 * math.exp(rho) / (rho * rho) if rho < 700.0 else math.inf
    j = int(place)
    return float(nodes[j] + (place - j) * (nodes[j + 1] - nodes[j]))


@kernel(allocates=False)
def largest_form(spread: FloatArray, half: FloatArray) -> float:
    """Return no less than ``v' S v`` for any ``|v_m| <= h_m``: the best of all vertices.

    S is positive semidefinite, so that a vertex is best. Above eight coordinates the sum of
    absolute values serves.
    """
    n = len(half)
    every = 0.0
    for a in range(n):
        for b in range(n):
            every += abs(spread[a, b]) * half[a] * half[b]
    if n > 8:
        return every
    best = 0.0
    for code in range(1 << (n - 1)):
        form = 0.0
        for a in range(n):
            of_a = 0.0
            for b in range(n):
                of_b = spread[a, b] * half[b]
                of_a += -of_b if (code >> b) & 1 else of_b
            form += -half[a] * of_a if (code >> a) & 1 else half[a] * of_a
        best = max(best, form)
    # every rounding of the sums is at most 2 n**2 units of their absolute terms
    return min(every, best + 4.0 * n * n * UNIT_ROUNDOFF * every)
