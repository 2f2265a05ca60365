"""The log-affine sandwich: every window's log energy between two parallel planes over a box."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from roomfit.compiled import kernel
from roomfit.identification.certified.misfits import misfit, stiffness, tail_of_squares
from roomfit.identification.certified.question import Arrays
from roomfit.identification.certified.rows import (
    UNIT_ROUNDOFF,
    VANISHING,
    energies,
    largest_form,
    log_slopes,
    powers,
    spread_of_window,
    vertex_remainder,
)
from roomfit.typing import BoolArray, FloatArray

# Beyond it the vertices of a box are too many; a bound by second moments serves.
MOST_VERTICES = 8

Planes: TypeAlias = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, BoolArray]
"""level (n_windows,), slope (n_windows, n), remainder (n_windows,), tail (n_windows,),
share of each coordinate in the remainders (n,), and which windows have planes (n_windows,)."""


def kappa_nodes() -> FloatArray:
    """Return ``(exp(rho) - 1 - rho) / rho**2`` at rho = 0, 1/32, ..., 16, never too small."""
    rho = np.arange(513) / 32.0
    term, total = np.full(rho.shape, 0.5), np.full(rho.shape, 0.5)
    for j in range(3, 120):
        term = term * rho / j
        total = total + term
    # 120 positive terms, each off by at most 240 roundings of 1.1e-16
    return np.asarray(total * (1.0 + 1e-13))


@kernel(allocates=False)
def relative_rounding(question: Arrays) -> float:
    """Return more than the relative rounding error of any window's energy.

    A row is a product of N + n + 1 rounded factors at most: N its hits in all, powers are made by
    multiplication, each with the 2 u of an exponential. A window is a sum of K rows. All are
    nonnegative, so that relative errors add up to ``(K + 3 N + n + 1) u``, and less than a
    hundredth more for their products; 4 u for each of these and 64 for what is done with the sum.
    """
    offsets, exponents = question[0], question[2]
    rows, hits = 0, 0
    for i in range(len(offsets) - 1):
        rows = max(rows, offsets[i + 1] - offsets[i])
    for k in range(len(exponents)):
        total = 0
        for m in range(exponents.shape[1]):
            total += exponents[k, m]
        hits = max(hits, total)
    return float(4.0 * UNIT_ROUNDOFF * (rows + hits + exponents.shape[1] + 64))


@kernel(allocates=False)
def corner_bound(
    kind: int,
    question: Arrays,
    low: FloatArray,
    high: FloatArray,
    rounding: float,
    each: FloatArray,
) -> float:
    """Fill the least misfit of every window with its energy between two corners; return the sum."""
    measured, precision = question[3], question[4]
    total = 0.0
    for i in range(len(measured)):
        least, most = low[i] * (1.0 - rounding), high[i] * (1.0 + rounding) + VANISHING
        if least > measured[i]:
            each[i] = misfit(kind, measured[i], precision[i], least)
        elif most < measured[i]:
            each[i] = misfit(kind, measured[i], precision[i], most)
        else:
            each[i] = 0.0
        total += each[i]
    return total


@kernel()
def planes_over(
    kind: int,
    question: Arrays,
    lo: FloatArray,
    hi: FloatArray,
    most: int,
    nodes: FloatArray,
    rounding: float,
    threshold: float,
    values: FloatArray,
) -> tuple[float, float, Planes, FloatArray, FloatArray]:
    """Return corner bound, misfit of windows without planes, planes, centre and half widths.

    ``log R_i(c + d)`` lies in ``level + slope . d + [0, remainder]`` for every d of the box. The
    lower side is Jensen's inequality. The upper side, with ``u_k = (n_k - nbar) . d``, which the
    weights p average to 0: ``exp(u) <= 1 + u + kappa(rho) u**2`` for ``|u| <= rho``, hence
    ``log(1 + max over the box of d' S d)`` with the second moments S of `spread_of_window`.

    Parameters
    ----------
    threshold : float
        Planes are only valid where the whole misfit is no greater: a window of squares may then
        lie below what was measured by no more than the root of what the others leave over.
    """
    measured, precision = question[3], question[4]
    n, windows = len(lo), len(measured)
    far = np.empty(n, dtype=np.bool_)
    centre, half, low_g = np.empty(n), np.empty(n), np.empty(n)
    for m in range(n):
        far[m] = not math.isfinite(lo[m])
        low_g[m] = hi[m] if far[m] else lo[m]
        centre[m] = 0.5 * (low_g[m] + hi[m])
        # the centre is where the rounded exp of it lies: 4 u (1 + |c|) is more than the way there
        half[m] = 0.5 * (hi[m] - low_g[m]) + 8.0 * UNIT_ROUNDOFF * (1.0 + abs(centre[m]))
    energy, low, high = np.empty(windows), np.empty(windows), np.empty(windows)
    each, slope = np.empty(windows), np.empty((windows, n))
    energies(question, powers(lo, most), low)
    energies(question, powers(hi, most), high)
    total = corner_bound(kind, question, low, high, rounding, each)
    level, remainder = np.empty(windows), np.empty(windows)
    tail, share = np.empty(windows), np.zeros(n)
    planar = np.empty(windows, dtype=np.bool_)
    found = (level, slope, remainder, tail, share, planar)
    apart = 0.0
    if total >= threshold:
        return total, apart, found, centre, half
    log_slopes(question, powers(centre, most), far, values, energy, slope)
    spread = np.zeros((n, n))
    product, sums = np.empty(1 << min(n, MOST_VERTICES)), np.empty(1 << min(n, MOST_VERTICES))
    ghost = np.zeros(windows)
    _vanishing(question, powers(hi, most), values, ghost)
    for i in range(windows):
        planar[i] = energy[i] > 0.0
        if not planar[i]:
            apart += each[i]
            continue
        reach, off = 0.0, 0.0
        for m in range(n):
            reach += slope[i, m] * half[m]
        off = rounding * (1.0 + 4.0 * reach)
        if n <= MOST_VERTICES:
            own = vertex_remainder(question, i, values, energy[i], slope[i], half, product, sums)
            _variances(question, i, values, energy[i], slope[i], spread)
        else:
            kept = spread_of_window(
                question, i, values, energy[i], slope[i], half, nodes, off, spread
            )
            form = largest_form(spread, half)
            form = (math.sqrt(form * (1.0 + rounding)) + off * math.sqrt(kept)) ** 2
            own = math.log1p(form * (1.0 + rounding))
        bare = math.log(energy[i])
        level[i] = bare - off - 4.0 * UNIT_ROUNDOFF * abs(bare)
        # a row that may vanish adds to the logarithm at most this, where the others are least
        more = ghost[i] * math.exp(reach + off) / energy[i] * (1.0 + 4.0 * rounding)
        above = own + math.log1p(more)
        remainder[i] = above * (1.0 + rounding) + 2.0 * off + 8.0 * UNIT_ROUNDOFF * abs(bare)
        _share(kind, precision[i], energy[i], spread, half, share)
        if more > 0.0:
            stiff = stiffness(kind, precision[i], energy[i] * (1.0 + more))
            _share_of_far(far, stiff * math.log1p(more), share)
        tail[i] = -math.inf
        if kind == 0:
            left = level[i] - reach + remainder[i]
            rest = max(threshold - (total - each[i]) * (1.0 - 1e-12), 0.0)
            if precision[i] > 0.0:
                least = measured[i] - math.sqrt(rest / precision[i]) * (1.0 + 1e-12)
                if least > 0.0:
                    left = max(left, math.log(least) - 1e-12)
            tail[i] = tail_of_squares(measured[i], left)
    return total, apart, found, centre, half


@kernel(allocates=False)
def _variances(
    question: Arrays,
    i: int,
    values: FloatArray,
    total: float,
    slope: FloatArray,
    spread: FloatArray,
) -> None:
    """Fill the diagonal with half the variance of one window's exponents."""
    offsets, exponents = question[0], question[2]
    for m in range(len(slope)):
        spread[m, m] = 0.0
    for k in range(offsets[i], offsets[i + 1]):
        p = 0.5 * values[k] / total
        for m in range(len(slope)):
            spread[m, m] += p * (exponents[k, m] - slope[m]) ** 2


@kernel(allocates=False)
def _vanishing(
    question: Arrays, at_high: FloatArray, values: FloatArray, ghost: FloatArray
) -> None:
    """Fill the energy at the upper corner of the rows that the planes leave out."""
    offsets, weight, exponents = question[0], question[1], question[2]
    for i in range(len(offsets) - 1):
        for k in range(offsets[i], offsets[i + 1]):
            if values[k] == 0.0:
                value = weight[k]
                for m in range(exponents.shape[1]):
                    value *= at_high[m, exponents[k, m]]
                ghost[i] += value


@kernel(allocates=False)
def _share(
    kind: int,
    c: float,
    r: float,
    spread: FloatArray,
    half: FloatArray,
    share: FloatArray,
) -> None:
    """Add each coordinate's part of the remainder, weighed by how stiff the misfit is."""
    stiff = stiffness(kind, c, r)
    for a in range(len(half)):
        for b in range(len(half)):
            share[a] += stiff * abs(spread[a, b]) * half[a] * half[b]


@kernel(allocates=False)
def _share_of_far(far: BoolArray, amount: float, share: FloatArray) -> None:
    for m in range(len(far)):
        if far[m]:
            share[m] += amount
