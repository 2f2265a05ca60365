"""A proof of how low equation (1) can be, and where: branch and bound over all absorptions.

A box is the lower and upper ends of g = log(1 - absorption), shape (2, n); a lower end of minus
infinity is an absorption of 1. Energies are sums of nonnegative rows and rise with every g, so that
both corners of a box bound them; where the error is proven convex in a box, a tangent plane does.
The box of lowest bound goes first: it is dropped where its bound exceeds the threshold, kept where
it is narrow, and else cut in two. Boxes left over that touch are joined to clusters. What roundings
may add is said in docs/the-paper.md.
"""

from __future__ import annotations

import heapq
import itertools
import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import csr_array

from roomfit.base.typing import FloatArray, IntArray
from roomfit.model.weighing import window_of_rows
from roomfit.paper.room import SquaresProblem

# In the paper's unit of energy squared, where black walls err by hundreds: with the model's own
# rays the error is 0 at the truth.
DELTA = 1e-8
_NARROWEST = 1e-5  # a box no wider is left over whatever its bound
_FAR_CUT = 1.2  # a coordinate that reaches minus infinity is cut so far below its upper end
_STARTS, _EVEN = 12, (0.05, 0.2, 0.5, 0.8)
_DESCENTS = 24  # within a cluster: from its boxes of lowest bounds
# Where a descent may reach instead of minus infinity: an absorption of 1 - 1e-6.
_ALMOST_BLACK = math.log(1e-6)
_TOUCHING = 1e-9  # in g: far above the rounding of faces, far below any width

_UNIT_ROUNDOFF = 2.0**-53
_VANISHING = 1e-250  # far above the numbers that lose digits by being small (2.2e-308)
_SUMMED = 1e-12  # of what is summed: a few hundred windows, each off by a few units of 1.1e-16
# Rows may change their weight within a window by no more than this, or convexity is not tried.
_MOST_CHANGE = 3.0
# What must be left of a whitened curvature of 1, far above the rounding of its parts.
_MARGIN = 1e-3
_SHARES = (1e-4, 1e-3, 1e-2, 0.03, 0.1, 0.25)


class Cluster(NamedTuple):
    """Boxes that touch each other, and the lowest error found in them."""

    lower: FloatArray  # (n,), absorption: the smallest box round all of them
    upper: FloatArray
    minimiser: FloatArray  # (n,)
    value: float
    unique: bool  # whether the error is proven convex all over the box: it has one minimum


class Certificate(NamedTuple):
    """What was proven: no error anywhere is below `lower_bound`.

    Nor is any outside of the clusters within `delta` of `value`, the lowest found.
    """

    complete: bool  # no box is open, and the bound is within delta of the value
    materials: tuple[str, ...]
    value: float
    lower_bound: float
    delta: float
    clusters: tuple[Cluster, ...]  # by value, the lowest first
    boxes: int  # examined


def certify(
    problem: SquaresProblem, *, delta: float = DELTA, width: float = 1e-3, most_boxes: int = 20_000
) -> Certificate:
    """Return a proof of how low the error can be, and where it comes within `delta` of that.

    `width`: boxes left over are no wider, in absorption. `most_boxes`: after so many the search
    stops; what it says then is proven all the same.
    """
    error = _ErrorOverBoxes(problem)
    n, order = len(problem.rows.materials), itertools.count()
    value, place = _first_guess(error, n)
    waiting = [(-math.inf, next(order), np.stack((np.full(n, -math.inf), np.zeros(n))))]
    kept: list[tuple[float, FloatArray]] = []
    examined = 0
    while waiting and examined < most_boxes and waiting[0][0] < value + delta:
        before, _, box = heapq.heappop(waiting)
        examined += 1
        bound = max(before, error.least_by_corners(box))
        if bound >= value + delta:
            continue
        widths = np.exp(box[1]) - np.exp(box[0])
        convex = error.is_convex(box)
        if convex:
            found, lowest, least = error.least_of_convex(box)
            value, place = min((value, place), (lowest, found), key=lambda end: end[0])
            bound = max(bound, least)
        if widths.max() <= (width if convex or bound >= value - delta else _NARROWEST):
            kept.append((bound, box))
            continue
        for half in _halves(box, int(np.argmax(widths))):
            heapq.heappush(waiting, (bound, next(order), half))
    open_ = [(bound, box) for bound, _, box in waiting if bound < value + delta]
    left = [own for own in kept if own[0] < value + delta] + open_
    bounds = np.array([bound for bound, _ in left])
    boxes = np.array([box for _, box in left]).reshape(-1, 2, n)
    label = touching(boxes)
    clusters = [
        _cluster(error, boxes[label == own][np.argsort(bounds[label == own])], place)
        for own in range(int(label.max(initial=-1)) + 1)
    ]
    value = min([value, *(c.value for c in clusters)])
    bound = min(value, float(bounds.min(initial=math.inf)))
    return Certificate(
        not open_ and value - bound <= delta,
        problem.rows.materials,
        value,
        bound,
        delta,
        tuple(sorted(clusters, key=lambda cluster: cluster.value)),
        examined,
    )


def touching(boxes: FloatArray) -> IntArray:
    """Return the number of the cluster of each box (n_boxes, 2, n): closed boxes that meet."""
    label: IntArray = np.full(len(boxes), -1)
    for first in range(len(boxes)):
        if label[first] >= 0:
            continue
        waiting, number = [first], label.max() + 1
        label[first] = number
        while waiting:
            box = boxes[waiting.pop()]
            meets = (boxes[:, 0] <= box[1] + _TOUCHING) & (boxes[:, 1] >= box[0] - _TOUCHING)
            new = np.flatnonzero(meets.all(axis=1) & (label < 0))
            label[new] = number
            waiting.extend(new.tolist())
    return label


def _halves(box: FloatArray, m: int) -> tuple[FloatArray, FloatArray]:
    """Return the two halves of a box cut at a coordinate; they share a face."""
    first, second = box.copy(), box.copy()
    far = not math.isfinite(box[0, m])
    first[1, m] = second[0, m] = box[1, m] - _FAR_CUT if far else 0.5 * (box[0, m] + box[1, m])
    return first, second


def _first_guess(error: _ErrorOverBoxes, n: int) -> tuple[float, FloatArray]:
    """Return the lowest error that descents find, from even absorptions, then random ones."""
    rng = np.random.default_rng(0)
    low, high = np.full(n, _ALMOST_BLACK), np.zeros(n)
    share = rng.random((_STARTS - len(_EVEN), n))
    starts = [np.full(n, math.log(1.0 - a)) for a in _EVEN]
    starts += [*np.log(np.exp(low) + (1.0 - np.exp(low)) * share)]
    ends = [error.descend(start, low, high) for start in starts]
    return min(((error.at(g), g) for g in ends), key=lambda end: end[0])


def _cluster(error: _ErrorOverBoxes, boxes: FloatArray, place: FloatArray) -> Cluster:
    """Return the cluster of some boxes, lowest bound first; `place`: of the lowest error known."""
    hull = np.stack((boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)))
    low = np.maximum(hull[0], np.minimum(_ALMOST_BLACK, hull[1] - 1e-3))
    starts = [0.5 * (np.maximum(box[0], low) + box[1]) for box in boxes[:_DESCENTS]]
    ends = [error.descend(start, low, hull[1]) for start in starts]
    if np.all((place >= hull[0]) & (place <= hull[1])):
        ends.append(place)
    # what a descent left all but black, made black
    ends += [
        np.where((g <= _ALMOST_BLACK + 1e-4) & np.isneginf(hull[0]), -math.inf, g) for g in ends
    ]
    best = min(ends, key=error.at)
    upper, lower = -np.expm1(hull)
    return Cluster(lower, upper, -np.expm1(best), error.at(best), error.is_convex(hull))


class _ErrorOverBoxes:
    """Equation (1) as a function of g, at points and over boxes."""

    def __init__(self, problem: SquaresProblem) -> None:
        rows = problem.rows
        self.weight, self.measured = rows.weight_per_m2, problem.measured
        self.hits: IntArray = rows.hits.astype(np.int64)
        self.window = window_of_rows(rows)
        n = len(self.window)
        self.sums = csr_array((np.ones(n), (self.window, np.arange(n))), (rows.n_windows, n))
        # A row is a product of N + n + 1 rounded factors at most, N its hits in all; a window a sum
        # of K rows, all nonnegative: relative errors add up to (K + 3 N + n + 1) u.
        longest = int(np.diff(rows.offsets).max(initial=0))
        factors = longest + int(self.hits.sum(axis=1).max(initial=0)) + self.hits.shape[1] + 64
        self.rounding = 4.0 * _UNIT_ROUNDOFF * factors

    def row_values(self, g: FloatArray) -> FloatArray:
        """Return the energy of every row; g may hold minus infinities."""
        # not 0 times minus infinity where a row does not hit a black material
        powers = np.exp(g)[:, None] ** np.arange(int(self.hits.max(initial=0)) + 1)
        values = np.array(self.weight)
        for m, own in enumerate(powers):
            values *= own[self.hits[:, m]]
        return values

    def at(self, g: FloatArray) -> float:
        off = self.sums @ self.row_values(g) - self.measured
        return float(off @ off)

    def log_slopes(self, g: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return row values, energies, and slopes of log energy by g, (n_windows, n).

        Rows that are too small to be rounded well are 0.
        """
        values = self.row_values(g)
        values[values < _VANISHING] = 0.0
        energy = self.sums @ values
        slope = self.sums @ (values[:, None] * self.hits)
        return values, energy, slope / np.where(energy > 0.0, energy, 1.0)[:, None]

    def descend(self, start: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
        """Return where a search for the least squares within bounds ends."""

        def jacobian(g: FloatArray) -> FloatArray:
            _, energy, slope = self.log_slopes(g)
            return np.asarray(energy[:, None] * slope)

        found = least_squares(
            lambda g: self.sums @ self.row_values(g) - self.measured,
            np.clip(start, low, high),
            jacobian,
            (low, high),
            method="dogbox",
            ftol=1e-14,
            xtol=1e-14,
            gtol=1e-14,
        )
        return np.asarray(np.clip(found.x, low, high))

    def least_by_corners(self, box: FloatArray) -> float:
        """Return a bound: every window at its best between its energies at both corners."""
        low, high = (self.sums @ self.row_values(end) for end in box)
        least, most = low * (1.0 - self.rounding), high * (1.0 + self.rounding) + _VANISHING
        off = np.maximum(np.maximum(least - self.measured, self.measured - most), 0.0)
        return float(np.sum(off**2))

    def least_of_convex(self, box: FloatArray) -> tuple[FloatArray, float, float]:
        """Return the lowest point of a box on which the error is convex, the error, and a bound.

        The tangent plane at the point lies below a convex function. Taken off is what rounding may
        have added: of the error ``|f'|``, of the tangent over a distance ``(|f'| + |f''|)`` times
        the mean hits and the distance, for a relative change of every energy by 1.
        """
        place = self.descend(0.5 * (box[0] + box[1]), box[0], box[1])
        _, energy, slope = self.log_slopes(place)
        off = energy - self.measured
        here, gradient = float(off @ off), 2.0 * (off * energy) @ slope
        change = np.minimum(gradient * (box[0] - place), gradient * (box[1] - place)).sum()
        bound = here + float(change)
        first, second = 2.0 * energy * off, 2.0 * energy * (2.0 * energy - self.measured)
        reach = 1.0 + slope.sum(axis=1) * float((box[1] - box[0]).max())
        size = float((np.abs(first) + np.abs(second)) @ reach)
        rounded = 8.0 * self.rounding * size + _SUMMED * (here + abs(here - bound))
        return place, self.at(place), bound - rounded

    def is_convex(self, box: FloatArray) -> bool:
        """Return True only where the Hessian is positive definite at every point of the box.

        With f the misfit of a window as a function of its log energy, nbar the mean and C the
        covariance of its hits, the Hessian is the sum of ``f'' nbar nbar' + f' C``. Over the box:
        f'' and f' lie above their least values between the energies of the two corners. The mean
        moves by y, and ``(x + y)(x + y)' >= (1 - t) x x' - (1 / t - 1) y y'`` for 0 < t < 1. A
        weight p_k turns into ``p_k exp(u_k) / Z`` with ``|u_k| <= rho_k`` and Z at least 1, so that
        C is at most the second moment with weights ``p_k exp(rho_k)``, and at least C at the centre
        times the least ratio. What these leave is compared in the basis in which it is the unit
        matrix at t = 0.
        """
        if not np.isfinite(box[0]).all():
            return False
        centre = 0.5 * (box[0] + box[1])
        half = 0.5 * (box[1] - box[0]) * (1.0 + 1e-12) + 1e-14 * (1.0 + np.abs(centre))
        values, energy, slope = self.log_slopes(centre)
        low, high = (self.sums @ self.row_values(end) for end in box)
        off = self.hits - slope[self.window]
        rho = np.abs(off) @ half
        lost = (values == 0.0) & (self.weight > 0.0)
        has_path = high > 0.0  # a window without is a constant
        if np.any(has_path & (low < _VANISHING)) or np.any((rho > _MOST_CHANGE) | lost):
            return False
        low, high = low * (1.0 - 1e-10), high * (1.0 + 1e-10)
        at, turn = (np.clip(share * self.measured, low, high) for share in (0.25, 0.5))
        stiff = np.where(has_path, 2.0 * at * (2.0 * at - self.measured), 0.0)  # least f''
        pull = 2.0 * turn * (turn - self.measured)  # least f'
        # a part that bends down is taken off in full: (x + y)(x + y)' <= 2 x x' + 2 y y'
        whole = (slope.T * np.where(stiff >= 0.0, stiff, 2.0 * stiff)) @ slope
        outer = (slope.T * np.maximum(stiff, 0.0)) @ slope

        shares = values / np.where(energy > 0.0, energy, 1.0)[self.window]
        partition = 1.0 + self.sums @ (shares * (np.expm1(rho) - rho))
        farthest = np.zeros(len(energy))
        np.maximum.at(farthest, self.window, rho)
        least = (np.exp(-farthest) / partition * (1.0 - 1e-9))[self.window]
        ratio = np.where((pull > 0.0)[self.window], least, np.exp(rho) * (1.0 + 1e-9))
        whole += (off.T * (pull[self.window] * shares * ratio)) @ off
        basis = _whitening(whole)
        if basis is None:
            return False
        # a weight moves by at most p_k max(exp(rho_k) - 1, 1 - exp(-rho_k) / Z)
        rho = rho + 1e-9
        moves = np.maximum(np.expm1(rho), 1.0 - np.exp(-rho) / (partition + 1e-9)[self.window])
        change = self.sums @ ((shares * moves)[:, None] * np.abs(off @ basis))
        # e_m sum(e) for |y_m| <= e_m dominates y y'
        factor = np.where(stiff >= 0.0, stiff, -2.0 * stiff)
        moved = np.diag((factor * change.sum(axis=1)) @ change)
        white, part = (basis.T @ matrix @ basis for matrix in (whole, outer))
        size = sum(
            float((np.abs(basis).T @ np.abs(matrix) @ np.abs(basis)).max())
            for matrix in (whole, outer)
        )
        # the eigenvalue is off by a few units of the sums behind it, far below the margin
        return any(
            np.linalg.eigvalsh(white - t * part - (1.0 / t - 1.0) * moved)[0] - _SUMMED * size
            > _MARGIN
            for t in _SHARES
        )


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
