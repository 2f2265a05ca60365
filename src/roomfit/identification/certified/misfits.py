"""One window's misfit as a function of L = log R, and its convex lower bound, as kernels.

Written with f for the misfit, f' and f'' for its derivatives by L, and M, c for what was measured
and its precision. Kinds: 0 squares, 1 logarithms, 2 Gamma deviance.
"""

from __future__ import annotations

import math

from roomfit.compiled import kernel

_BISECTIONS = 14


@kernel(allocates=False)
def misfit(kind: int, m: float, c: float, r: float) -> float:
    """Return f at the energy r itself; infinite at 0 where logarithms are compared."""
    if kind == 0:
        return c * (r - m) * (r - m)
    if r <= 0.0:
        return math.inf
    if kind == 1:
        off = math.log(r / m)
        return c * off * off
    return 2.0 * c * (m / r - 1.0 + math.log(r / m))


@kernel(allocates=False)
def in_log(kind: int, m: float, c: float, level: float) -> tuple[float, float, float]:
    """Return f, f' and f'' at L = level."""
    if kind == 0:
        r = math.exp(level)
        return c * (r - m) * (r - m), 2.0 * c * r * (r - m), 2.0 * c * r * (2.0 * r - m)
    off = level - math.log(m)
    if kind == 1:
        return c * off * off, 2.0 * c * off, 2.0 * c
    ratio = math.exp(-off)
    return 2.0 * c * (ratio - 1.0 + off), 2.0 * c * (1.0 - ratio), 2.0 * c * ratio


@kernel(allocates=False)
def stiffness(kind: int, c: float, r: float) -> float:
    """Return f'' without the part that the residual makes: what Gauss and Newton keep."""
    if kind == 0:
        return 2.0 * c * r * r
    return 2.0 * c


@kernel(allocates=False)
def tail_of_squares(m: float, left: float) -> float:
    """Return where a straight line from `left` comes to lie on the squares from below.

    ``(exp(L) - m)**2`` bends down for L < log(m / 2). The tangent at the place returned lies below
    it from `left` on: at the place, because it bends up from there to the right; at `left`, which
    is tested; and between them, because it bends down. Where nothing bends down from `left` on,
    the place is where the bend is: the line goes on to its left, where nothing is asked.
    """
    if m <= 0.0:
        return -math.inf
    bend = math.log(0.5 * m)
    if left >= bend:
        return bend
    at_left = in_log(0, m, 1.0, left)[0]
    low, high = bend, math.log(m)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        value, slope, _ = in_log(0, m, 1.0, middle)
        # 1e-12 of what is subtracted covers the rounding of the test itself
        if value - slope * (middle - left) + 1e-12 * m * m <= at_left:
            high = middle
        else:
            low = middle
    return high


@kernel(allocates=False)
def lowered(
    kind: int, m: float, c: float, level: float, remainder: float, tail: float
) -> tuple[float, float, float]:
    """Return the least misfit for L in [level, level + remainder], convex in `level`, and slopes.

    Parameters
    ----------
    tail : float
        From `tail_of_squares`; to its left the line replaces the squares.
    """
    best = math.log(m) if m > 0.0 else -math.inf
    top = level + remainder
    if top < best:
        if kind == 0 and top < tail:
            value, slope, _ = in_log(kind, m, c, tail)
            return value + slope * (top - tail), slope, 0.0
        return in_log(kind, m, c, top)
    if level <= best:
        return 0.0, 0.0, 0.0
    return in_log(kind, m, c, level)
