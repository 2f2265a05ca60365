"""Branch and bound: boxes that may hold misfits near the lowest, and proof for all others.

One box after the other is pruned, shaved, kept, or cut in two.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from enum import Enum

import numpy as np

from roomfit.base.typing import BoolArray, FloatArray
from roomfit.paper.bounds import kappa_nodes, planes_over, relative_rounding
from roomfit.paper.convex import (
    contract,
    descend,
    is_convex,
    least_of_convex,
    minimum_over,
    priors_over,
    total_misfit,
)
from roomfit.paper.question import Arrays, GlobalProblem, arrays

_ROUNDS = 8
# Shaving goes on while a round takes off so much of the volume.
_WORTH = 0.6
# A coordinate that reaches minus infinity is cut this far below its upper end.
FAR_CUT = 1.2


class BoxStatus(Enum):
    """What became of a box."""

    PRUNED = "pruned"
    KEPT = "kept"
    CONVEX = "convex"
    CUT = "cut"


@dataclass(frozen=True, slots=True, eq=False)
class Tools:
    """A global problem in the form that kernels take, with what is computed once."""

    data: Arrays
    is_absorption: BoolArray
    most: int
    nodes: FloatArray
    rounding: float
    values: FloatArray


@dataclass(slots=True)
class Incumbent:
    """The lowest misfit seen so far, and where in g."""

    value: float
    place: FloatArray

    def offer(self, value: float, place: FloatArray) -> None:
        """Take over a lower misfit."""
        if value < self.value:
            self.value, self.place = value, place


def tools_for(global_problem: GlobalProblem) -> Tools:
    """Return what working on the boxes of a global problem needs."""
    data = arrays(global_problem)
    return Tools(
        data,
        global_problem.is_absorption,
        int(global_problem.exponents.max(initial=0)),
        kappa_nodes(),
        relative_rounding(data),
        np.empty(len(global_problem.weight)),
    )


def examine(
    tools: Tools, box: FloatArray, incumbent: Incumbent, settings: SearchSettings
) -> tuple[BoxStatus, float, int]:
    """Work on one box: return what became of it, a lower bound of the misfit, and where to cut.

    Parameters
    ----------
    box : float array, shape (2, n)
        Lower and upper ends in g; shrunk in place to what was not proven to lie above the
        threshold.
    incumbent : Incumbent
        Lowered in place.
    """
    delta, width, narrowest = settings.delta, settings.width, settings.narrowest
    bound = -math.inf
    share = np.empty(0)
    for _ in range(_ROUNDS):
        bound, kept, share = _bounded(tools, box, incumbent, delta)
        if bound >= incumbent.value + delta:
            return BoxStatus.PRUNED, bound, 0
        if kept > _WORTH:
            break
    widths = widths_of(tools.is_absorption, box)
    if widths.max() <= narrowest or (widths.max() <= width and bound >= incumbent.value - delta):
        return BoxStatus.KEPT, bound, 0
    if is_convex(tools.data, box, tools.most, tools.values):
        place, value, least = least_of_convex(
            tools.data, box, 0.5 * (box[0] + box[1]), tools.most, tools.rounding
        )
        incumbent.offer(value, place)
        bound = max(bound, least)
        pruned = bound >= incumbent.value + delta
        return (BoxStatus.PRUNED if pruned else BoxStatus.CONVEX), bound, 0
    wide = widths > (width if widths.max() > width else 0.0)
    return BoxStatus.CUT, bound, int(np.argmax(np.where(wide, share, -1.0)))


def _bounded(
    tools: Tools, box: FloatArray, incumbent: Incumbent, delta: float
) -> tuple[float, float, FloatArray]:
    """Bound the misfit over a box and shave it; return bound, share kept, and shares of blame."""
    data, most = tools.data, tools.most
    threshold = incumbent.value + delta
    corners, apart, planes, centre, half = planes_over(
        data, box[0], box[1], most, tools.nodes, tools.rounding, threshold, tools.values
    )
    if corners >= threshold:
        return corners, 1.0, planes[4]
    separable = priors_over(data[5], box[0], box[1], centre, half)
    d: FloatArray = np.zeros(len(half))
    bound = apart + minimum_over(data, planes, separable, -half, half, threshold - apart, d, True)
    if bound >= threshold:
        return bound, 1.0, planes[4]
    # the misfit at the bound's lowest point, and where a descent from there within the box ends
    low = np.where(np.isfinite(box[0]), box[0], box[1] - 2.0 * FAR_CUT)
    inside = np.clip(centre + d, low, box[1])
    if total_misfit(data, inside, most) < incumbent.value:
        place, value = descend(data, inside, low, box[1], most)
        incumbent.offer(value, place)
    threshold = incumbent.value + delta
    if bound >= threshold:
        return bound, 1.0, planes[4]
    kept = contract(data, planes, separable, box, centre, half, threshold - apart, d)
    return bound, kept, planes[4]


def widths_of(is_absorption: BoolArray, box: FloatArray) -> FloatArray:
    """Return the widths of a box (..., 2, n): in absorption, and in the logarithm of a gain."""
    low, high = box[..., 0, :], box[..., 1, :]
    log_width = np.where(is_absorption, 1.0, high - np.where(is_absorption, 0.0, low))
    return np.where(is_absorption, np.exp(high) - np.exp(low), log_width)


def halves(box: FloatArray, m: int) -> FloatArray:
    """Return the two halves of a box cut at a coordinate, shape (2, 2, n); they share a face."""
    both = np.stack((box, box))
    far = not math.isfinite(box[0, m])
    place = box[1, m] - FAR_CUT if far else 0.5 * (box[0, m] + box[1, m])
    both[0, 1, m] = both[1, 0, m] = place
    return both


_TOGETHER = 64
_STARTS = 12
# To show that a cluster in which nothing comes near the lowest misfit is empty.
_NARROW, _MORE_BOXES = 1e-4, 2000
_EVEN = (0.05, 0.2, 0.5, 0.8)
# Where a descent may reach instead of minus infinity: an absorption of 1 - 1e-6.
ALMOST_BLACK = math.log(1e-6)


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """How far a certified search goes."""

    # every point whose misfit is within this of the lowest will be in a box that is left
    delta: float
    # boxes left over are no wider: in absorption, and in the logarithm of a gain
    width: float = 0.02
    # A box no wider than this is left over even where its bound lies more than `delta` below the
    # lowest misfit
    narrowest: float = 1e-5
    max_boxes: int = 1_000_000
    max_seconds: float = math.inf  # of the processor: what other programs take does not count


@dataclass(frozen=True, slots=True, eq=False)
class Searched:
    """Where a search stands when it ends."""

    value: float  # lowest misfit seen
    minimiser: FloatArray  # (n,), where, in g
    lower_bound: float  # no point of the whole domain has a lower misfit
    # (n_left, 2, n), lower and upper ends in g. Together they hold every point whose misfit is at
    # most ``value + delta``.
    boxes: FloatArray
    bounds: FloatArray  # (n_left,), lower bound of the misfit in each box
    n_open: int  # how many of the boxes were still to be worked on
    examined: int
    seconds: float
    delta: float


def search(global_problem: GlobalProblem, settings: SearchSettings) -> Searched:
    """Return every box that may hold a misfit within `delta` of the lowest.

    The box of lowest bound goes first, so that the lower bound rises all the time. Stopped by a
    cap, or by an interrupt from the keyboard, it returns what is open, too.
    """
    tools = tools_for(global_problem)
    incumbent = first_guess(global_problem, tools)
    queue, kept = _Boxes(len(global_problem.coordinates)), _Boxes(len(global_problem.coordinates))
    queue.add(np.stack((global_problem.least, global_problem.most))[None], -math.inf)
    # the first box may have to wait for kernels to be compiled: no part of the search
    examined = _work_on(tools, queue, kept, incumbent, settings)
    began, worked = time.perf_counter(), time.thread_time()
    while queue.n and examined < settings.max_boxes:
        if time.thread_time() - worked > settings.max_seconds:
            break
        try:
            examined += _work_on(tools, queue, kept, incumbent, settings)
        except KeyboardInterrupt:
            break
    boxes = np.concatenate([kept.boxes[: kept.n], queue.boxes[: queue.n]])
    bounds = np.concatenate([kept.bounds[: kept.n], queue.bounds[: queue.n]])
    near = bounds < incumbent.value + settings.delta
    return Searched(
        incumbent.value,
        incumbent.place,
        float(min(incumbent.value, bounds[near].min(initial=math.inf))),
        boxes[near],
        bounds[near],
        int(np.count_nonzero(queue.bounds[: queue.n] < incumbent.value + settings.delta)),
        examined,
        time.perf_counter() - began,
        settings.delta,
    )


def _work_on(
    tools: Tools, queue: _Boxes, kept: _Boxes, incumbent: Incumbent, settings: SearchSettings
) -> int:
    """Examine the boxes of lowest bounds; return how many. Interrupted, it loses none."""
    chosen, bounds = queue.lowest(_TOGETHER)
    for i, (box, parent_bound) in enumerate(zip(chosen, bounds, strict=True)):
        if parent_bound >= incumbent.value + settings.delta:
            continue
        try:
            box_status, bound, where = examine(tools, box, incumbent, settings)
        except KeyboardInterrupt:
            for rest, least in zip(chosen[i:], bounds[i:], strict=True):
                queue.add(rest[None], least)
            raise
        if box_status in (BoxStatus.KEPT, BoxStatus.CONVEX):
            kept.add(box[None], max(bound, parent_bound))
        elif box_status is BoxStatus.CUT:
            queue.add(halves(box, where), max(bound, parent_bound))
    return len(chosen)


def proven_empty(tools: Tools, found: Searched, boxes: FloatArray, bounds: FloatArray) -> bool:
    """Whether narrower boxes prove that no misfit within delta of the lowest lies in these boxes.

    For boxes that a search has kept as narrow enough, and in which no descent comes so low.

    Parameters
    ----------
    boxes, bounds : float arrays, shapes (n_boxes, 2, n) and (n_boxes,)
    """
    incumbent = Incumbent(found.value, found.minimiser)
    settings = SearchSettings(found.delta, width=_NARROW, narrowest=_NARROW)
    queue, kept = _Boxes(boxes.shape[2]), _Boxes(boxes.shape[2])
    for box, bound in zip(boxes, bounds, strict=True):
        queue.add(box[None], float(bound))
    examined = 0
    while queue.n and not kept.n and examined < _MORE_BOXES:
        examined += _work_on(tools, queue, kept, incumbent, settings)
    return not queue.n and not kept.n


def first_guess(global_problem: GlobalProblem, tools: Tools) -> Incumbent:
    """Return the lowest misfit that descents from a dozen points find, and where.

    Even absorptions first, then points drawn at random.
    """
    low, high = np.maximum(global_problem.least, ALMOST_BLACK), global_problem.most
    rng = np.random.default_rng(0)
    even = [np.clip(np.full(low.size, math.log(1.0 - a)), low, high) for a in _EVEN]
    share = rng.random((_STARTS - len(even), low.size))
    drawn = np.log(np.exp(low) + (np.exp(high) - np.exp(low)) * share)
    incumbent = Incumbent(math.inf, even[0])
    for start in (*even, *drawn):
        if math.isfinite(total_misfit(tools.data, start, tools.most)):
            place, value = descend(tools.data, start, low, high, tools.most)
            incumbent.offer(value, place)
    return incumbent


class _Boxes:
    """Open boxes with their bounds, in arrays that grow."""

    def __init__(self, n_coordinates: int) -> None:
        self.boxes = np.empty((256, 2, n_coordinates))
        self.bounds = np.empty(256)
        self.n = 0

    def add(self, boxes: FloatArray, bound: float) -> None:
        """Put boxes in, all with one bound."""
        end = self.n + len(boxes)
        if end > len(self.bounds):
            size = max(end, 2 * len(self.bounds))
            self.boxes = np.concatenate((self.boxes, np.empty((size, *self.boxes.shape[1:]))))
            self.bounds = np.concatenate((self.bounds, np.empty(size)))
        self.boxes[self.n : end], self.bounds[self.n : end] = boxes, bound
        self.n = end

    def lowest(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Take the boxes of lowest bounds out."""
        open_bounds = self.bounds[: self.n]
        few = self.n <= count
        order = np.arange(self.n) if few else np.argpartition(open_bounds, count)
        taken = self.boxes[order[:count]].copy(), open_bounds[order[:count]].copy()
        rest = order[count:]
        self.boxes[: len(rest)] = self.boxes[rest]
        self.bounds[: len(rest)] = self.bounds[rest]
        self.n = len(rest)
        return taken
