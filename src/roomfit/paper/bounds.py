"""Log-affine bounds: every window's log energy between two parallel planes over a box.

The misfit of a window, ``f = c (exp(L) - M)**2``, is a function of L = log R, with derivatives f'
and f'', of what was measured (M) and of its precision (c). A box is `lo` and `hi` in g = log(1 -
absorption). A coordinate whose `lo` is minus infinity reaches an absorption of 1; rows that hit it
count as anything from 0 to their value at `hi`.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from roomfit.base.kernels import kernel
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.paper.question import Arrays

_BISECTIONS = 14


@kernel(allocates=False)
def misfit(m: float, c: float, r: float) -> float:
    """Return f at the energy r itself."""
    return c * (r - m) * (r - m)


@kernel(allocates=False)
def in_log(m: float, c: float, level: float) -> tuple[float, float, float]:
    """Return f, f' and f'' at L = level."""
    r = math.exp(level)
    return c * (r - m) * (r - m), 2.0 * c * r * (r - m), 2.0 * c * r * (2.0 * r - m)


@kernel(allocates=False)
def stiffness(c: float, r: float) -> float:
    """Return f'' without the part that the residual makes: what Gauss and Newton keep."""
    return 2.0 * c * r * r


@kernel(allocates=False)
def tail_of_squares(m: float, left: float) -> float:
    """Return where a straight line from `left` comes to lie on the squares from below.

    ``(exp(L) - m)**2`` bends down for L < log(m / 2). The tangent at the level returned lies below
    it from `left` on: at that level, because it bends up from there to the right; at `left`, which
    is tested; and between them, because it bends down. Where nothing bends down from `left` on,
    it is the bend: the line goes on to its left, where no value is needed.
    """
    if m <= 0.0:
        return -math.inf
    bend = math.log(0.5 * m)
    if left >= bend:
        return bend
    at_left = in_log(m, 1.0, left)[0]
    low, high = bend, math.log(m)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        value, slope, _ = in_log(m, 1.0, middle)
        # 1e-12 of what is subtracted covers the rounding of the test itself
        if value - slope * (middle - left) + 1e-12 * m * m <= at_left:
            high = middle
        else:
            low = middle
    return high


@kernel(allocates=False)
def lower_bound(
    m: float, c: float, level: float, remainder: float, tail: float
) -> tuple[float, float, float]:
    """Return the least misfit for L in [level, level + remainder], convex in `level`, and slopes.

    `tail`: from `tail_of_squares`; to its left the line replaces the squares.
    """
    best = math.log(m) if m > 0.0 else -math.inf
    top = level + remainder
    if top < best:
        if top < tail:
            value, slope, _ = in_log(m, c, tail)
            return value + slope * (top - tail), slope, 0.0
        return in_log(m, c, top)
    if level <= best:
        return 0.0, 0.0, 0.0
    return in_log(m, c, level)


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
def energies(global_problem: Arrays, table: FloatArray, energy: FloatArray) -> None:
    """Fill the energy of every window, shape (n_windows,)."""
    offsets, weight, exponents = global_problem[0], global_problem[1], global_problem[2]
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
    global_problem: Arrays,
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
    offsets, weight, exponents = global_problem[0], global_problem[1], global_problem[2]
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
    global_problem: Arrays,
    i: int,
    values: FloatArray,
    total: float,
    slope: FloatArray,
    half: FloatArray,
    product: FloatArray,
    sums: FloatArray,
) -> float:
    """Return how far one window's log energy rises above its tangent plane within a box, at most.

    The logarithm of a sum of exponentials is convex, so that the highest point above a plane is a
    vertex; all are tried. Infinite where a row may change by a factor beyond e**600.

    `product`, `sums`, shape (2 ** n,) each: scratch.
    """
    offsets, exponents = global_problem[0], global_problem[2]
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
    global_problem: Arrays,
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
    ``rho_k = sum_m |n_km - nbar_m| h_m + wobble``, for the remainder of the bounds.

    Parameters
    ----------
    nodes : float array
        ``kappa(rho) = (exp(rho) - 1 - rho) / rho**2`` at every 1/32: a chord between two lies above
        it, for it bends up.
    wobble : float
        More than the rounding of rho.
    """
    offsets, exponents = global_problem[0], global_problem[2]
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
def relative_rounding(global_problem: Arrays) -> float:
    """Return more than the relative rounding error of any window's energy.

    A row is a product of N + n + 1 rounded factors at most: N its hits in all, powers are made by
    multiplication, each with the 2 u of an exponential. A window is a sum of K rows. All are
    nonnegative, so that relative errors add up to ``(K + 3 N + n + 1) u``, and less than a
    hundredth more for their products; 4 u for each of these and 64 for what is done with the sum.
    """
    offsets, exponents = global_problem[0], global_problem[2]
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
    global_problem: Arrays,
    low: FloatArray,
    high: FloatArray,
    rounding: float,
    each: FloatArray,
) -> float:
    """Fill the least misfit of every window with its energy between two corners; return the sum."""
    measured, precision = global_problem[3], global_problem[4]
    total = 0.0
    for i in range(len(measured)):
        least, most = low[i] * (1.0 - rounding), high[i] * (1.0 + rounding) + VANISHING
        if least > measured[i]:
            each[i] = misfit(measured[i], precision[i], least)
        elif most < measured[i]:
            each[i] = misfit(measured[i], precision[i], most)
        else:
            each[i] = 0.0
        total += each[i]
    return total


@kernel()
def planes_over(
    global_problem: Arrays,
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

    `threshold`: planes are only valid where the whole misfit is no greater: a window of squares may
    then lie below what was measured by no more than the root of what the others leave over.
    """
    measured, precision = global_problem[3], global_problem[4]
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
    energies(global_problem, powers(lo, most), low)
    energies(global_problem, powers(hi, most), high)
    total = corner_bound(global_problem, low, high, rounding, each)
    level, remainder = np.empty(windows), np.empty(windows)
    tail, share = np.empty(windows), np.zeros(n)
    planar = np.empty(windows, dtype=np.bool_)
    found = (level, slope, remainder, tail, share, planar)
    apart = 0.0
    if total >= threshold:
        return total, apart, found, centre, half
    log_slopes(global_problem, powers(centre, most), far, values, energy, slope)
    spread = np.zeros((n, n))
    product, sums = np.empty(1 << min(n, MOST_VERTICES)), np.empty(1 << min(n, MOST_VERTICES))
    ghost = np.zeros(windows)
    _vanishing(global_problem, powers(hi, most), values, ghost)
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
            own = vertex_remainder(
                global_problem, i, values, energy[i], slope[i], half, product, sums
            )
            _variances(global_problem, i, values, energy[i], slope[i], spread)
        else:
            kept = spread_of_window(
                global_problem, i, values, energy[i], slope[i], half, nodes, off, spread
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
        _share(precision[i], energy[i], spread, half, share)
        if more > 0.0:
            stiff = stiffness(precision[i], energy[i] * (1.0 + more))
            _share_of_far(far, stiff * math.log1p(more), share)
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
    global_problem: Arrays,
    i: int,
    values: FloatArray,
    total: float,
    slope: FloatArray,
    spread: FloatArray,
) -> None:
    """Fill the diagonal with half the variance of one window's exponents."""
    offsets, exponents = global_problem[0], global_problem[2]
    for m in range(len(slope)):
        spread[m, m] = 0.0
    for k in range(offsets[i], offsets[i + 1]):
        p = 0.5 * values[k] / total
        for m in range(len(slope)):
            spread[m, m] += p * (exponents[k, m] - slope[m]) ** 2


@kernel(allocates=False)
def _vanishing(
    global_problem: Arrays, at_high: FloatArray, values: FloatArray, ghost: FloatArray
) -> None:
    """Fill the energy at the upper corner of the rows that the planes leave out."""
    offsets, weight, exponents = global_problem[0], global_problem[1], global_problem[2]
    for i in range(len(offsets) - 1):
        for k in range(offsets[i], offsets[i + 1]):
            if values[k] == 0.0:
                value = weight[k]
                for m in range(exponents.shape[1]):
                    value *= at_high[m, exponents[k, m]]
                ghost[i] += value


@kernel(allocates=False)
def _share(c: float, r: float, spread: FloatArray, half: FloatArray, share: FloatArray) -> None:
    """Add each coordinate's part of the remainder, weighed by how stiff the misfit is."""
    stiff = stiffness(c, r)
    for a in range(len(half)):
        for b in range(len(half)):
            share[a] += stiff * abs(spread[a, b]) * half[a] * half[b]


@kernel(allocates=False)
def _share_of_far(far: BoolArray, amount: float, share: FloatArray) -> None:
    for m in range(len(far)):
        if far[m]:
            share[m] += amount
