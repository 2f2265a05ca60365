"""A test that the misfit is convex all over a box, so that the box holds one minimum at most."""

from __future__ import annotations

import math

import numpy as np

from roomfit.compiled import kernel
from roomfit.identification.certified.priors import least_curvature
from roomfit.identification.certified.question import Arrays
from roomfit.identification.certified.rows import VANISHING, energies, log_slopes, powers
from roomfit.typing import FloatArray

# Rows may change their weight within a window by no more than this, or the test is not tried.
_MOST_CHANGE = 3.0
# What must be left of a whitened curvature of 1, far above the rounding of its parts.
_MARGIN = 1e-3
_SHARES = (1e-4, 1e-3, 1e-2, 0.03, 0.1, 0.25)


@kernel()
def is_convex(kind: int, question: Arrays, box: FloatArray, most: int, values: FloatArray) -> bool:
    """Return True only where the Hessian is positive definite at every point of the box.

    With f the misfit of a window as a function of its log energy, nbar the mean and C the
    covariance of its exponents, the Hessian is the sum of ``f'' nbar nbar' + f' C``. Over the box:
    f'' and f' lie above their least values between the energies of the two corners. The mean
    moves by y, and ``(x + y)(x + y)' >= (1 - t) x x' - (1 / t - 1) y y'`` for 0 < t < 1. A weight
    p_k becomes ``p_k exp(u_k) / Z`` with ``|u_k| <= rho_k`` and Z at least 1, so that C is at most
    the second moment with weights ``p_k exp(rho_k)``, and at least C at the centre times the least
    ratio. What these leave is compared in the basis in which it is the unit matrix at t = 0.
    """
    measured, prior = question[3], question[5]
    n, windows = box.shape[1], len(measured)
    centre, half = np.empty(n), np.empty(n)
    far = np.zeros(n, dtype=np.bool_)
    for m in range(n):
        if not math.isfinite(box[0, m]):
            return False
        centre[m] = 0.5 * (box[0, m] + box[1, m])
        half[m] = 0.5 * (box[1, m] - box[0, m]) * (1.0 + 1e-12) + 1e-14 * (1.0 + abs(centre[m]))
    energy, low, high = np.empty(windows), np.empty(windows), np.empty(windows)
    slope, stiff = np.empty((windows, n)), np.empty(windows)
    log_slopes(question, powers(centre, most), far, values, energy, slope)
    energies(question, powers(box[0], most), low)
    energies(question, powers(box[1], most), high)
    outer, whole = np.zeros((n, n)), np.zeros((n, n))
    for i in range(windows):
        if high[i] == 0.0:
            stiff[i] = 0.0  # no path at all: a constant
            continue
        if low[i] < VANISHING:
            return False
        stiff[i], pull = _least_slopes(
            *(kind, measured[i], question[4][i], low[i] * (1.0 - 1e-10), high[i] * (1.0 + 1e-10))
        )
        # a part that bends down is taken off in full: (x + y)(x + y)' <= 2 x x' + 2 y y'
        factor = stiff[i] if stiff[i] >= 0.0 else 2.0 * stiff[i]
        for a in range(n):
            for b in range(n):
                part = factor * slope[i, a] * slope[i, b]
                whole[a, b] += part
                outer[a, b] += max(stiff[i], 0.0) * slope[i, a] * slope[i, b]
        if not _add_covariance(question, i, values, energy[i], slope[i], half, pull, whole):
            return False
    for m in range(n):
        whole[m, m] += least_curvature(prior[m], centre[m] - half[m], centre[m] + half[m])
        if not math.isfinite(whole[m, m]):
            return False
    basis = _whitening(whole)
    if not math.isfinite(basis[0, 0]):
        return False
    moved = np.zeros(n)
    for i in range(windows):
        if high[i] > 0.0:
            _add_movement(question, i, values, energy[i], slope[i], half, basis, stiff[i], moved)
    return _stays_definite(basis, whole, outer, moved)


@kernel()
def _stays_definite(
    basis: FloatArray, whole: FloatArray, outer: FloatArray, moved: FloatArray
) -> bool:
    """Whether some t leaves ``whole - t outer - (1 / t - 1) y y'`` positive definite."""
    n = len(moved)
    white, size = _congruent(basis, whole)
    part, more = _congruent(basis, outer)
    trial = np.empty((n, n))
    for t in _SHARES:
        for a in range(n):
            for b in range(n):
                trial[a, b] = white[a, b] - t * part[a, b]
            trial[a, a] -= (1.0 / t - 1.0) * moved[a]
        # the eigenvalue is off by a few units of the sums behind it, far below the margin
        if np.linalg.eigvalsh(trial)[0] - 1e-12 * (size + more) > _MARGIN:
            return True
    return False


@kernel(allocates=False)
def _least_slopes(kind: int, m: float, c: float, low: float, high: float) -> tuple[float, float]:
    """Return the least f'' and the least f' for energies between low and high."""
    if kind == 0:
        at = min(max(low, 0.25 * m), high)
        turn = min(max(low, 0.5 * m), high)
        return 2.0 * c * at * (2.0 * at - m), 2.0 * c * turn * (turn - m)
    if kind == 1:
        return 2.0 * c, 2.0 * c * math.log(low / m)
    return 2.0 * c * m / high, 2.0 * c * (1.0 - m / low)


@kernel()
def _whitening(matrix: FloatArray) -> FloatArray:
    """Return a W with W' A W near the unit matrix, or infinities where A is not clearly definite.

    W need not be exact: what it makes of A is computed afterwards.
    """
    n = len(matrix)
    scaled, basis = np.empty((n, n)), np.empty((n, n))
    for a in range(n):
        if matrix[a, a] <= 0.0:
            basis[0, 0] = math.inf
            return basis
    for a in range(n):
        for b in range(n):
            scaled[a, b] = matrix[a, b] / math.sqrt(matrix[a, a] * matrix[b, b])
    values, vectors = np.linalg.eigh(scaled)
    for a in range(n):
        for b in range(n):
            basis[a, b] = vectors[a, b] / math.sqrt(max(values[b], 1e-300) * matrix[a, a])
    if values[0] < 1e-9:
        basis[0, 0] = math.inf
    return basis


@kernel(allocates=False)
def _add_covariance(
    question: Arrays,
    i: int,
    values: FloatArray,
    total: float,
    slope: FloatArray,
    half: FloatArray,
    pull: float,
    whole: FloatArray,
) -> bool:
    """Add the least that ``pull C`` may be; False where a row may change too much."""
    offsets, exponents = question[0], question[2]
    n = len(half)
    reach, partition = 0.0, 1.0
    for k in range(offsets[i], offsets[i + 1]):
        rho = _reach(exponents[k], slope, half)
        lost = values[k] == 0.0 and question[1][k] > 0.0
        if rho > _MOST_CHANGE or lost:
            return False
        reach = max(reach, rho)
        partition += values[k] / total * (math.exp(rho) - 1.0 - rho)
    least = math.exp(-reach) / partition * (1.0 - 1e-9)
    for k in range(offsets[i], offsets[i + 1]):
        p = pull * values[k] / total
        p *= least if pull > 0.0 else math.exp(_reach(exponents[k], slope, half)) * (1.0 + 1e-9)
        for a in range(n):
            of_a = p * (exponents[k, a] - slope[a])
            for b in range(n):
                whole[a, b] += of_a * (exponents[k, b] - slope[b])
    return True


@kernel()
def _add_movement(
    question: Arrays,
    i: int,
    values: FloatArray,
    total: float,
    slope: FloatArray,
    half: FloatArray,
    basis: FloatArray,
    stiff: float,
    moved: FloatArray,
) -> None:
    """Add a diagonal above ``f'' y y'`` in the basis: e_m sum(e) for ``|y_m| <= e_m`` dominates.

    A weight p_k moves by at most ``p_k max(exp(rho_k) - 1, 1 - exp(-rho_k) / Z)``.
    """
    offsets, exponents = question[0], question[2]
    n = len(half)
    change = np.zeros(n)
    partition = 1.0 + 1e-9
    for k in range(offsets[i], offsets[i + 1]):
        rho = _reach(exponents[k], slope, half)
        partition += values[k] / total * (math.exp(rho) - 1.0 - rho)
    for k in range(offsets[i], offsets[i + 1]):
        rho = _reach(exponents[k], slope, half) + 1e-9
        off = values[k] / total * max(math.exp(rho) - 1.0, 1.0 - math.exp(-rho) / partition)
        for b in range(n):
            white = 0.0
            for a in range(n):
                white += basis[a, b] * (exponents[k, a] - slope[a])
            change[b] += off * abs(white)
    together = 0.0
    for a in range(n):
        together += change[a]
    factor = stiff if stiff >= 0.0 else -2.0 * stiff
    for a in range(n):
        moved[a] += factor * change[a] * together


@kernel(allocates=False)
def _reach(exponents: FloatArray, slope: FloatArray, half: FloatArray) -> float:
    total = 0.0
    for m in range(len(half)):
        total += abs(exponents[m] - slope[m]) * half[m]
    return total


@kernel()
def _congruent(basis: FloatArray, matrix: FloatArray) -> tuple[FloatArray, float]:
    """Return ``basis' matrix basis`` and the largest sum of absolute terms behind an entry."""
    n = len(matrix)
    out, most = np.zeros((n, n)), 0.0
    for a in range(n):
        for b in range(n):
            size = 0.0
            for c in range(n):
                for d in range(n):
                    term = basis[c, a] * matrix[c, d] * basis[d, b]
                    out[a, b] += term
                    size += abs(term)
            most = max(most, size)
    return out, most
