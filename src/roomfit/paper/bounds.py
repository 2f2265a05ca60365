"""Bounds of equation (1) over a box of absorptions, and proof that it is convex there.

A box is the lower and upper ends of g = log(1 - absorption), shape (2, n); a lower end of minus
infinity is an absorption of 1, where rows that hit the material count as anything from 0 to their
value at the other end. Energies are sums of nonnegative rows and rise with every g, so that both
corners of a box bound them. The logarithm of a window's energy lies between two parallel planes:
above its tangent plane at the centre, as it is convex, and below the same plane lifted by the
largest distance at any vertex. What roundings may add is said in docs/the-paper.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.model.weighing import window_of_rows
from roomfit.paper.room import SquaresProblem

UNIT_ROUNDOFF = 2.0**-53
VANISHING = 1e-250  # far above the numbers that lose digits by being small (2.2e-308)
SUMMED = 1e-12  # of what is summed: a few hundred windows, each off by a few units of 1.1e-16
_BISECTIONS = 14


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Equation (1) as its bounds need it, with what is computed once."""

    weight: FloatArray  # (n_rows,)
    hits: IntArray  # (n_rows, n)
    window: IntArray  # (n_rows,)
    sums: csr_array  # (n_windows, n_rows), adds up the rows of each window
    measured: FloatArray  # (n_windows,)
    rounding: float  # more than the relative rounding error of any window's energy


def rows_of(problem: SquaresProblem) -> Rows:
    """Return what bounds need.

    A row is a product of N + n + 1 rounded factors at most, N its hits in all; a window a sum of K
    rows. All are nonnegative: relative errors add up to ``(K + 3 N + n + 1) u``.
    """
    rows = problem.rows
    hits, window = rows.hits.astype(np.int64), window_of_rows(rows)
    most_rows = int(np.diff(rows.offsets).max(initial=0))
    factors = most_rows + int(hits.sum(axis=1).max(initial=0)) + hits.shape[1] + 64
    sums = csr_array(
        (np.ones(len(window)), (window, np.arange(len(window)))), (rows.n_windows, len(window))
    )
    return Rows(
        rows.weight_per_m2, hits, window, sums, problem.measured, 4.0 * UNIT_ROUNDOFF * factors
    )


def row_values(rows: Rows, g: FloatArray) -> FloatArray:
    """Return the energy of every row; g may hold minus infinities."""
    most = int(rows.hits.max(initial=0))
    powers = np.tile(np.exp(g)[:, None], (1, most + 1))
    powers[:, 0] = 1.0
    powers = np.cumprod(powers, axis=1)
    values = np.array(rows.weight)
    for m, own in enumerate(powers):
        values *= own[rows.hits[:, m]]
    return values


def total_misfit(rows: Rows, g: FloatArray) -> float:
    """Return equation (1)."""
    off = rows.sums @ row_values(rows, g) - rows.measured
    return float(off @ off)


def _log_slopes(
    rows: Rows, g: FloatArray, left_out: BoolArray | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return row values, energies, and slopes of log energy by g, (n_windows, n).

    Rows that are left out, and those too small to be rounded well, are 0.
    """
    values = row_values(rows, g)
    values[values < VANISHING] = 0.0
    if left_out is not None:
        values[left_out] = 0.0
    energy = rows.sums @ values
    slope = rows.sums @ (values[:, None] * rows.hits)
    return values, energy, slope / np.where(energy > 0.0, energy, 1.0)[:, None]


def misfit_slopes(rows: Rows, g: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Return equation (1), its gradient and its Gauss-Newton Hessian by g."""
    _, energy, slope = _log_slopes(rows, g)
    off = energy - rows.measured
    jacobian = energy[:, None] * slope
    return float(off @ off), 2.0 * off @ jacobian, 2.0 * jacobian.T @ jacobian


def sensitivity(rows: Rows, g: FloatArray, reach: float) -> float:
    """Return by how much error and tangent change for a relative change of every energy by 1.

    Of a misfit by ``|f'|``, of a tangent over a distance by ``(|f'| + |f''|)`` times the mean hits
    and the distance.
    """
    _, energy, slope = _log_slopes(rows, g)
    first, second = (
        2.0 * energy * (energy - rows.measured),
        2.0 * energy * (2.0 * energy - rows.measured),
    )
    return float((np.abs(first) + np.abs(second)) @ (1.0 + slope.sum(axis=1) * reach))


def _in_log(m: FloatArray, level: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return ``(exp(L) - m)**2`` and its two derivatives by L = level."""
    r = np.exp(level)
    return (r - m) ** 2, 2.0 * r * (r - m), 2.0 * r * (2.0 * r - m)


def _tail_of_squares(m: FloatArray, left: FloatArray) -> FloatArray:
    """Return where a straight line from `left` comes to lie on the squares from below.

    ``(exp(L) - m)**2`` bends down for L < log(m / 2). The tangent at the level returned lies below
    it from `left` on: at that level, because it bends up from there to the right; at `left`, which
    is tested; and between them, because it bends down. Where nothing bends down from `left` on it
    is the bend, and minus infinity where nothing was measured.
    """
    with np.errstate(divide="ignore"):
        bend, high = np.log(0.5 * m), np.log(m)
    bends = np.isfinite(bend) & (left < bend)
    low, start = np.where(bends, bend, 0.0), np.where(bends, left, 0.0)
    high = np.where(bends, high, 0.0)
    at_left = _in_log(m, start)[0]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        value, slope, _ = _in_log(m, middle)
        # 1e-12 of what is subtracted covers the rounding of the test itself
        lies_below = value - slope * (middle - start) + 1e-12 * m * m <= at_left
        low, high = np.where(lies_below, low, middle), np.where(lies_below, middle, high)
    return np.asarray(np.where(bends, high, bend))


@dataclass(frozen=True, slots=True, eq=False)
class Planes:
    """Windows over a box: ``log R(c + d)`` lies in ``level + slope . d + [0, remainder]``."""

    measured: FloatArray  # (n,) of the windows that have planes, as all but the last two
    level: FloatArray
    slope: FloatArray  # (n, n_materials)
    remainder: FloatArray
    tail: FloatArray  # to its left a line replaces the squares
    apart: float  # least misfit of the windows without planes
    share: FloatArray  # (n_materials,), of each in what the planes leave open


def corner_bounds(rows: Rows, box: FloatArray) -> FloatArray:
    """Return the least misfit of every window with its energy between both corners of a box."""
    low, high = (rows.sums @ row_values(rows, end) for end in box)
    least, most = low * (1.0 - rows.rounding), high * (1.0 + rows.rounding) + VANISHING
    return np.asarray(np.maximum(np.maximum(least - rows.measured, rows.measured - most), 0.0) ** 2)


def centre_of(box: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the centre of a box and half its widths, where it is finite; else the upper end."""
    low = np.where(np.isfinite(box[0]), box[0], box[1])
    centre = 0.5 * (low + box[1])
    # the centre is where the rounded exp of it lies: 4 u (1 + |c|) is more than the way there
    return centre, 0.5 * (box[1] - low) + 8.0 * UNIT_ROUNDOFF * (1.0 + np.abs(centre))


def planes_over(rows: Rows, box: FloatArray, each: FloatArray, threshold: float) -> Planes:
    """Return the planes of every window over a box.

    Parameters
    ----------
    each : float array, shape (n_windows,)
        From `corner_bounds`.
    threshold : float
        Planes are only valid where the whole misfit is no greater: a window may then lie below what
        was measured by no more than the root of what the others leave over.
    """
    far = ~np.isfinite(box[0])
    centre, half = centre_of(box)
    values, energy, slope = _log_slopes(rows, centre, np.any(rows.hits[:, far] > 0, axis=1))
    # rows that the planes leave out, at the upper corner
    ghost = rows.sums @ np.where(values == 0.0, row_values(rows, box[1]), 0.0)
    planar = energy > 0.0
    shares = values / np.where(planar, energy, 1.0)[rows.window]
    off = rows.hits - slope[rows.window]
    above = _above_tangent(rows, shares, off * half)
    variance = rows.sums @ (0.5 * shares[:, None] * off**2)

    measured, energy, slope, ghost = (x[planar] for x in (rows.measured, energy, slope, ghost))
    reach = slope @ half
    rounded = rows.rounding * (1.0 + 4.0 * reach)
    bare = np.log(energy)
    level = bare - rounded - 4.0 * UNIT_ROUNDOFF * np.abs(bare)
    # a row that may vanish adds to the logarithm at most this, where the others are least
    more = ghost * np.exp(reach + rounded) / energy * (1.0 + 4.0 * rows.rounding)
    remainder = (above[planar] + np.log1p(more)) * (1.0 + rows.rounding)
    remainder += 2.0 * rounded + 8.0 * UNIT_ROUNDOFF * np.abs(bare)
    share = (2.0 * energy**2) @ variance[planar] * half**2
    share[far] += (2.0 * (energy * (1.0 + more)) ** 2) @ np.log1p(more)
    left = level - reach + remainder
    rest = np.maximum(threshold - (each.sum() - each[planar]) * (1.0 - 1e-12), 0.0)
    least = measured - np.sqrt(rest) * (1.0 + 1e-12)
    with np.errstate(divide="ignore", invalid="ignore"):
        left = np.where(least > 0.0, np.maximum(left, np.log(least) - 1e-12), left)
    tail = _tail_of_squares(measured, left)
    return Planes(measured, level, slope, remainder, tail, float(each[~planar].sum()), share)


def _above_tangent(rows: Rows, shares: FloatArray, u: FloatArray) -> FloatArray:
    """Return how far each window's log energy rises above its tangent plane in a box, at most.

    The highest point of a convex function above a plane is a vertex; all 2**n are tried. Infinite
    where a row may change by a factor beyond e**600. `u`: changes of the rows' logarithms, (n_rows,
    n), by half a width of each coordinate.
    """
    reach = np.abs(u).sum(axis=1)
    wide = (reach > 600.0) & (shares > 0.0)
    product = np.where(wide, 0.0, shares)[:, None]
    for change in np.where((reach > 600.0)[:, None], 0.0, u).T:
        product = np.concatenate(
            (product * np.exp(change)[:, None], product * np.exp(-change)[:, None]), axis=1
        )
    highest = (rows.sums @ product).max(axis=1)
    # 1e-12: n exponentials of numbers below 600 rounded to 1 in 2**53, and the sums
    above = np.log(np.where(highest > 0.0, highest, 1.0)) + 1e-12
    return np.where(rows.sums @ wide.astype(float) > 0.0, math.inf, above)


def bound_at(planes: Planes, d: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Return the convex lower bound of the windows with planes at d, its gradient and a Hessian.

    Of each window the least misfit for any log energy in [level, level + remainder].
    """
    here = planes.level + planes.slope @ d
    with np.errstate(divide="ignore"):
        best = np.log(planes.measured)
    top = here + planes.remainder
    below, over = top < best, here > best
    on_line = below & (top < planes.tail)
    at = np.where(on_line, planes.tail, np.where(below, top, here))
    value, first, second = _in_log(planes.measured, np.where(below | over, at, 0.0))
    value = value + np.where(on_line, first * (np.where(on_line, top - at, 0.0)), 0.0)
    open_ = ~(below | over)
    value[open_], first[open_], second[open_ | on_line] = 0.0, 0.0, 0.0
    hessian = (planes.slope.T * second) @ planes.slope
    return float(value.sum()), first @ planes.slope, hessian


# Rows may change their weight within a window by no more than this, or the test is not tried.
_MOST_CHANGE = 3.0
# What must be left of a whitened curvature of 1, far above the rounding of its parts.
_MARGIN = 1e-3
_SHARES = (1e-4, 1e-3, 1e-2, 0.03, 0.1, 0.25)


def is_convex(rows: Rows, box: FloatArray) -> bool:
    """Return True only where the Hessian is positive definite at every point of the box.

    With f the misfit of a window as a function of its log energy, nbar the mean and C the
    covariance of its hits, the Hessian is the sum of ``f'' nbar nbar' + f' C``. Over the box: f''
    and f' lie above their least values between the energies of the two corners. The mean moves by
    y, and ``(x + y)(x + y)' >= (1 - t) x x' - (1 / t - 1) y y'`` for 0 < t < 1. A weight p_k turns
    into ``p_k exp(u_k) / Z`` with ``|u_k| <= rho_k`` and Z at least 1, so that C is at most the
    second moment with weights ``p_k exp(rho_k)``, and at least C at the centre times the least
    ratio. What these leave is compared in the basis in which it is the unit matrix at t = 0.
    """
    if not np.isfinite(box[0]).all():
        return False
    centre = 0.5 * (box[0] + box[1])
    half = 0.5 * (box[1] - box[0]) * (1.0 + 1e-12) + 1e-14 * (1.0 + np.abs(centre))
    values, energy, slope = _log_slopes(rows, centre)
    low, high = (rows.sums @ row_values(rows, end) for end in box)
    has_path = high > 0.0  # a window without is a constant
    off = rows.hits - slope[rows.window]
    rho = np.abs(off) @ half
    lost = (values == 0.0) & (rows.weight > 0.0)
    if np.any(has_path & (low < VANISHING)) or np.any((rho > _MOST_CHANGE) | lost):
        return False
    stiff, pull = _least_slopes(rows.measured, low * (1.0 - 1e-10), high * (1.0 + 1e-10))
    stiff = np.where(has_path, stiff, 0.0)
    # a part that bends down is taken off in full: (x + y)(x + y)' <= 2 x x' + 2 y y'
    whole = (slope.T * np.where(stiff >= 0.0, stiff, 2.0 * stiff)) @ slope
    outer = (slope.T * np.maximum(stiff, 0.0)) @ slope

    shares = values / np.where(energy > 0.0, energy, 1.0)[rows.window]
    partition = 1.0 + rows.sums @ (shares * (np.expm1(rho) - rho))
    reach = np.zeros(len(energy))
    np.maximum.at(reach, rows.window, rho)
    least = np.exp(-reach) / partition * (1.0 - 1e-9)
    ratio = np.where((pull > 0.0)[rows.window], least[rows.window], np.exp(rho) * (1.0 + 1e-9))
    whole += (off.T * (pull[rows.window] * shares * ratio)) @ off
    basis = _whitening(whole)
    if basis is None:
        return False
    # a weight moves by at most p_k max(exp(rho_k) - 1, 1 - exp(-rho_k) / Z)
    rho = rho + 1e-9
    moves = np.maximum(np.expm1(rho), 1.0 - np.exp(-rho) / (partition + 1e-9)[rows.window])
    change = rows.sums @ ((shares * moves)[:, None] * np.abs(off @ basis))
    # e_m sum(e) for |y_m| <= e_m dominates y y'
    factor = np.where(stiff >= 0.0, stiff, -2.0 * stiff)
    moved = (factor * change.sum(axis=1)) @ change
    white, part = (basis.T @ matrix @ basis for matrix in (whole, outer))
    size = sum(
        float((np.abs(basis).T @ np.abs(matrix) @ np.abs(basis)).max()) for matrix in (whole, outer)
    )
    trials = (white - t * part - (1.0 / t - 1.0) * np.diag(moved) for t in _SHARES)
    # the eigenvalue is off by a few units of the sums behind it, far below the margin
    return any(np.linalg.eigvalsh(trial)[0] - SUMMED * size > _MARGIN for trial in trials)


def _least_slopes(
    m: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the least f'' and the least f' for energies between low and high."""
    at = np.clip(0.25 * m, low, high)
    turn = np.clip(0.5 * m, low, high)
    return 2.0 * at * (2.0 * at - m), 2.0 * turn * (turn - m)


def _whitening(matrix: FloatArray) -> FloatArray | None:
    """Return a W with W' A W near the unit matrix, or None where A is not clearly definite.

    W need not be exact: what it makes of A is computed afterwards.
    """
    scale = np.diag(matrix)
    if np.any(scale <= 0.0):
        return None
    scale = np.sqrt(scale)
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    if values[0] < 1e-9:
        return None
    return np.asarray(vectors / np.sqrt(values) / scale[:, None])
