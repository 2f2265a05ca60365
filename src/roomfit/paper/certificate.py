"""A proof of how low equation (1) can be, and where: branch and bound over all absorptions.

The box of lowest bound goes first. It is pruned where its bound exceeds the threshold, shaved by
the slices where it does, kept where it is narrow or the error is convex in it, or cut in two. Boxes
left over that touch are joined to clusters.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from roomfit.base.typing import FloatArray, IntArray
from roomfit.paper.bounds import (
    SUMMED,
    Planes,
    Rows,
    bound_at,
    centre_of,
    corner_bounds,
    is_convex,
    misfit_slopes,
    planes_over,
    rows_of,
    sensitivity,
    total_misfit,
)
from roomfit.paper.room import SquaresProblem

# In the paper's unit of energy squared, where black walls err by hundreds: with the model's own
# rays the error is 0 at the truth.
DELTA = 1e-8
_NARROWEST = 1e-5  # a box no wider is left over whatever its bound
_MOST_BOXES = 20_000
_ROUNDS = 8
_WORTH = 0.6  # shaving goes on while a round leaves no more of the volume
_FAR_CUT = 1.2  # a coordinate that reaches minus infinity is cut so far below its upper end
_SLICES = (0.5, 0.25, 0.125)  # of a box's width, tried at each face
_CONVEX_STEPS, _ARMIJO = 12, 1e-4
_DESCENT_STEPS = 60
_STARTS, _EVEN = 12, (0.05, 0.2, 0.5, 0.8)
_DESCENTS = 24  # within a cluster: from its boxes of lowest bounds
# Where a descent may reach instead of minus infinity: an absorption of 1 - 1e-6.
_ALMOST_BLACK = math.log(1e-6)
_TOUCHING = 1e-9  # in g: far above the rounding of faces, far below any width


@dataclass(frozen=True, slots=True, eq=False)
class Cluster:
    """Boxes that touch each other, and the lowest error found in them."""

    lower: FloatArray  # (n,), absorption: the smallest box round all of them
    upper: FloatArray
    minimiser: FloatArray  # (n,)
    value: float
    unique: bool  # whether the error is proven convex all over the box: it has one minimum


@dataclass(frozen=True, slots=True, eq=False)
class Certificate:
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
    problem: SquaresProblem,
    *,
    delta: float = DELTA,
    width: float = 0.02,
    most_boxes: int = _MOST_BOXES,
) -> Certificate:
    """Return a proof of how low the error can be, and where it comes within `delta` of that.

    Parameters
    ----------
    width : float
        Boxes left over are no wider, in absorption, unless the error is convex in them.
    most_boxes : int
        After so many the search stops; what it says then is proven all the same.
    """
    rows = rows_of(problem)
    n = rows.hits.shape[1]
    incumbent = _first_guess(rows, n)
    order = itertools.count()
    waiting = [(-math.inf, next(order), np.stack((np.full(n, -math.inf), np.zeros(n))))]
    kept: list[tuple[float, FloatArray]] = []
    examined = 0
    while waiting and examined < most_boxes:
        before, _, box = heapq.heappop(waiting)
        if before >= incumbent.value + delta:
            break
        found = _examined(rows, box, incumbent, delta, width)
        examined += 1
        bound = max(found.bound, before)
        if found.cut is not None:
            for half in _halves(box, found.cut):
                heapq.heappush(waiting, (bound, next(order), half))
        elif not found.pruned:
            kept.append((bound, box))
    threshold = incumbent.value + delta
    open_ = [(bound, box) for bound, _, box in waiting if bound < threshold]
    left = [own for own in kept if own[0] < threshold] + open_
    bounds = np.array([bound for bound, _ in left])
    boxes = np.array([box for _, box in left]).reshape(-1, 2, n)
    label = touching(boxes)
    numbers = range(int(label.max(initial=-1)) + 1)
    chosen = (label == number for number in numbers)
    clusters = sorted(
        (_cluster(rows, boxes[own], bounds[own], incumbent) for own in chosen),
        key=lambda cluster: cluster.value,
    )
    value = min([incumbent.value, *(c.value for c in clusters)])
    bound = min(value, float(bounds.min(initial=math.inf)))
    complete = not open_ and value - bound <= delta
    materials = problem.rows.materials
    return Certificate(complete, materials, value, bound, delta, tuple(clusters), examined)


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


@dataclass(slots=True)
class _Incumbent:
    """The lowest error seen so far, and where in g."""

    value: float
    place: FloatArray

    def offer(self, place: FloatArray, value: float) -> None:
        if value < self.value:
            self.value, self.place = value, place


@dataclass(frozen=True, slots=True)
class _Examined:
    """What became of a box: pruned, to be cut at a coordinate, or kept."""

    bound: float
    pruned: bool = False
    cut: int | None = None


def _examined(
    rows: Rows, box: FloatArray, incumbent: _Incumbent, delta: float, width: float
) -> _Examined:
    """Work on one box, which is shrunk in place to what is not proven to lie above."""
    for _ in range(_ROUNDS):
        bound, kept, share = _bounded(rows, box, incumbent, delta)
        if bound >= incumbent.value + delta:
            return _Examined(bound, pruned=True)
        if kept > _WORTH:
            break
    widths = np.exp(box[1]) - np.exp(box[0])
    narrow = widths.max() <= width and bound >= incumbent.value - delta
    if narrow or widths.max() <= _NARROWEST:
        return _Examined(bound)
    if is_convex(rows, box):
        place, value, least = _least_of_convex(rows, box)
        incumbent.offer(place, value)
        bound = max(bound, least)
        return _Examined(bound, pruned=bound >= incumbent.value + delta)
    wide = widths > (width if widths.max() > width else 0.0)
    return _Examined(bound, cut=int(np.argmax(np.where(wide, share, -1.0))))


def _bounded(
    rows: Rows, box: FloatArray, incumbent: _Incumbent, delta: float
) -> tuple[float, float, FloatArray]:
    """Bound the error over a box and shave it; return bound, share kept, and shares of blame."""
    n = box.shape[1]
    threshold = incumbent.value + delta
    each = corner_bounds(rows, box)
    if each.sum() >= threshold:
        return float(each.sum()), 1.0, np.zeros(n)
    planes = planes_over(rows, box, each, threshold)
    centre, half = centre_of(box)
    bound, d = _minimum_over(planes, -half, half, threshold - planes.apart, np.zeros(n), True)
    bound += planes.apart
    if bound >= threshold:
        return bound, 1.0, planes.share
    # the error at the bound's lowest point, and where a descent from there within the box ends
    low = np.where(np.isfinite(box[0]), box[0], box[1] - 2.0 * _FAR_CUT)
    inside = np.clip(centre + d, low, box[1])
    if total_misfit(rows, inside) < incumbent.value:
        incumbent.offer(*_descend(rows, inside, low, box[1]))
    threshold = incumbent.value + delta
    if bound >= threshold:
        return bound, 1.0, planes.share
    return bound, _shaved(planes, box, threshold - planes.apart, d), planes.share


def _shaved(planes: Planes, box: FloatArray, threshold: float, lowest: FloatArray) -> float:
    """Cut slices off a box in place where the convex bound reaches the threshold.

    Return the share of its volume that is kept. `lowest`: where, from the centre, the bound is
    lowest over the whole box.
    """
    centre, half = centre_of(box)
    ends = np.stack((-half, half))
    kept = 1.0
    for m, side in _faces(box):
        for share in _SLICES:
            step = share * (ends[1, m] - ends[0, m])
            edge = ends[0, m] + step if side == 0 else ends[1, m] - step
            part = ends.copy()
            part[1 - side, m] = edge
            if _minimum_over(planes, part[0], part[1], threshold, lowest, False)[0] < threshold:
                continue
            ends[side, m] = edge
            # more than the rounding of the sum, and of the centre's exponential
            slack = 2e-15 * (1.0 + abs(centre[m]) + abs(edge))
            if side == 0:
                box[0, m] = max(box[0, m], centre[m] + edge - slack)
            else:
                box[1, m] = min(box[1, m], centre[m] + edge + slack)
            kept *= 1.0 - share
            break
    return kept


def _faces(box: FloatArray) -> Iterator[tuple[int, int]]:
    """Yield coordinate and side of every face; those of coordinates that reach infinity stay."""
    return itertools.product(np.flatnonzero(np.isfinite(box[0])).tolist(), (0, 1))


def _minimum_over(
    planes: Planes,
    low: FloatArray,
    high: FloatArray,
    threshold: float,
    start: FloatArray,
    thorough: bool,
) -> tuple[float, FloatArray]:
    """Return a number that the convex bound exceeds all over ``low <= d <= high``, and a low d.

    At any d the tangent plane lies below a convex function: its least value over the box is a
    bound, however far d is from the minimum. Projected Newton steps bring d near it. They end when
    the bound reaches the threshold, or, unless `thorough`, when the function is seen below it.
    """
    d = np.clip(start, low, high)
    here, gradient, hessian = bound_at(planes, d)
    best = -math.inf
    for _ in range(_CONVEX_STEPS):
        best = max(best, _tangent_bound(here, gradient, d, low, high))
        if best >= threshold or (here < threshold and not thorough):
            break
        if here - best <= 1e-3 * abs(threshold - best):
            break
        step = _newton_step(gradient, hessian, d, low, high)
        for size in 0.35 ** np.arange(12):
            other = np.clip(d + size * step, low, high)
            there = bound_at(planes, other)
            if there[0] <= here + _ARMIJO * float(gradient @ (other - d)) and there[0] < here:
                break
        else:
            break
        d, (here, gradient, hessian) = other, there
    return max(best, _tangent_bound(here, gradient, d, low, high)), d


def _tangent_bound(
    here: float, gradient: FloatArray, d: FloatArray, low: FloatArray, high: FloatArray
) -> float:
    """Return the least value of the tangent plane over the box, less what rounding may cost."""
    change = np.minimum(gradient * (low - d), gradient * (high - d))
    return float(here + change.sum() - SUMMED * (abs(here) + np.abs(change).sum()))


def _newton_step(
    gradient: FloatArray, hessian: FloatArray, at: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    """Return a descent step in which coordinates held by a face of the box do not move."""
    free = ~(((at <= low) & (gradient > 0.0)) | ((at >= high) & (gradient < 0.0)))
    ridge = 1e-9 * float(np.trace(hessian)) + 1e-200
    matrix = hessian[np.ix_(free, free)] + ridge * np.eye(int(free.sum()))
    step = np.zeros_like(at)
    step[free] = -np.linalg.solve(matrix, gradient[free])
    return step


def _descend(
    rows: Rows, start: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, float]:
    """Return where damped Gauss-Newton steps within bounds end, and the error there."""
    g = np.clip(start, low, high)
    here, gradient, hessian = misfit_slopes(rows, g)
    damping = 1e-3
    for _ in range(_DESCENT_STEPS):
        damped = hessian + damping * np.diag(np.diag(hessian))
        other = np.clip(g + _newton_step(gradient, damped, g, low, high), low, high)
        there = total_misfit(rows, other)
        if not there < here:
            damping *= 8.0
            if damping > 1e8:
                break
            continue
        done = here - there <= 1e-13 * here
        g, damping = other, max(damping * 0.2, 1e-12)
        here, gradient, hessian = misfit_slopes(rows, g)
        if done:
            break
    return g, total_misfit(rows, g)


def _least_of_convex(rows: Rows, box: FloatArray) -> tuple[FloatArray, float, float]:
    """Return the lowest point of a box on which the error is convex, the error, and a bound.

    The tangent plane at the point lies below a convex function. Taken off is what rounding may have
    added.
    """
    place, value = _descend(rows, 0.5 * (box[0] + box[1]), box[0], box[1])
    here, gradient, _ = misfit_slopes(rows, place)
    bound = here + float(np.minimum(gradient * (box[0] - place), gradient * (box[1] - place)).sum())
    size = sensitivity(rows, place, float((box[1] - box[0]).max()))
    rounded = 8.0 * rows.rounding * size + SUMMED * (here + abs(here - bound))
    return place, value, bound - rounded


def _halves(box: FloatArray, m: int) -> tuple[FloatArray, FloatArray]:
    """Return the two halves of a box cut at a coordinate; they share a face."""
    first, second = box.copy(), box.copy()
    far = not math.isfinite(box[0, m])
    first[1, m] = second[0, m] = box[1, m] - _FAR_CUT if far else 0.5 * (box[0, m] + box[1, m])
    return first, second


def _first_guess(rows: Rows, n: int) -> _Incumbent:
    """Return the lowest error that descents find, from even absorptions, then random ones."""
    rng = np.random.default_rng(0)
    low, high = np.full(n, _ALMOST_BLACK), np.zeros(n)
    even = [np.full(n, math.log(1.0 - a)) for a in _EVEN]
    share = rng.random((_STARTS - len(even), n))
    incumbent = _Incumbent(math.inf, even[0])
    for start in (*even, *np.log(np.exp(low) + (1.0 - np.exp(low)) * share)):
        incumbent.offer(*_descend(rows, start, low, high))
    return incumbent


def _cluster(rows: Rows, boxes: FloatArray, bounds: FloatArray, incumbent: _Incumbent) -> Cluster:
    hull = np.stack((boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)))
    low = np.maximum(hull[0], np.minimum(_ALMOST_BLACK, hull[1] - 1e-3))
    order = np.argsort(bounds)[:_DESCENTS]
    starts = [0.5 * (np.maximum(boxes[i, 0], low) + boxes[i, 1]) for i in order]
    if np.all((incumbent.place >= hull[0]) & (incumbent.place <= hull[1])):
        starts.append(incumbent.place)
    ends = [_descend(rows, start, low, hull[1]) for start in starts]
    # what a descent left all but black, made black
    for place, _ in tuple(ends):
        black = np.where((place <= _ALMOST_BLACK + 1e-6) & np.isneginf(hull[0]), -math.inf, place)
        ends.append((black, total_misfit(rows, black)))
    place, value = min(ends, key=lambda end: end[1])
    upper, lower = -np.expm1(hull)
    return Cluster(lower, upper, -np.expm1(place), value, is_convex(rows, hull))
