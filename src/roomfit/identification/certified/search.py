"""Branch and bound: the boxes that may hold misfits near the lowest, and proof for all others."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np

from roomfit.errors import InputError
from roomfit.identification.certified.boxes import (
    Fate,
    Lowest,
    Tools,
    examine,
    halves,
    tools_for,
)
from roomfit.identification.certified.descent import descend, total_misfit
from roomfit.identification.certified.question import Question
from roomfit.typing import FloatArray, Progress

_TOGETHER = 64
_STARTS = 12
_NARROW = 1e-4
_EVEN = (0.05, 0.2, 0.5, 0.8)
# Where a descent may go in place of minus infinity: an absorption of 1 - 1e-6.
_ALMOST_BLACK = math.log(1e-6)


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """How far a certified search goes.

    Attributes
    ----------
    delta : float
        Every point whose misfit is within this of the lowest will be in a box that is left.
    width : float
        Boxes left over are no wider: in absorption, and in the logarithm of a gain.
    narrowest : float
        A box no wider than this is left over even where its bound lies more than `delta` below
        the lowest misfit.
    max_boxes : int
    max_seconds : float
        Of the processor: what other programs take does not count.
    """

    delta: float
    width: float = 0.02
    narrowest: float = 1e-5
    max_boxes: int = 1_000_000
    max_seconds: float = math.inf

    def __post_init__(self) -> None:
        for name in ("delta", "width", "narrowest", "max_boxes", "max_seconds"):
            if not getattr(self, name) > 0.0:
                raise InputError(
                    f"certified search: {name} must be above zero", found=str(getattr(self, name))
                )


@dataclass(frozen=True, slots=True, eq=False)
class Searched:
    """Where a search stands when it ends.

    Attributes
    ----------
    value : float
        Lowest misfit seen.
    minimiser : float array, shape (n,)
        Where, in g.
    lower_bound : float
        No point of the whole domain has a lower misfit.
    boxes : float array, shape (n_left, 2, n)
        Lower and upper ends in g. Together they hold every point whose misfit is at most
        ``value + delta``.
    bounds : float array, shape (n_left,)
        Lower bound of the misfit in each box.
    n_open : int
        How many of the boxes were still to be worked on.
    examined : int
    seconds : float
    delta : float
    """

    value: float
    minimiser: FloatArray
    lower_bound: float
    boxes: FloatArray
    bounds: FloatArray
    n_open: int
    examined: int
    seconds: float
    delta: float


def search(
    question: Question, settings: SearchSettings, *, progress: Progress | None = None
) -> Searched:
    """Return every box that may hold a misfit within `delta` of the lowest.

    The box of lowest bound goes first, so that the lower bound rises all the time. Stopped by a
    cap, or by an interrupt from the keyboard, it returns what is open, too.
    """
    tools = tools_for(question)
    lowest = first_guess(question, tools)
    queue, kept = _Boxes(len(question.coordinates)), _Boxes(len(question.coordinates))
    queue.add(np.stack((question.least, question.most))[None], -math.inf)
    # the first box may have to wait for kernels to be compiled: no part of the search
    examined = _work_on(tools, queue, kept, lowest, settings)
    began, worked = time.perf_counter(), time.thread_time()
    while queue.n and examined < settings.max_boxes:
        if time.thread_time() - worked > settings.max_seconds:
            break
        try:
            examined += _work_on(tools, queue, kept, lowest, settings)
        except KeyboardInterrupt:
            break
        if progress is not None:
            progress(examined / (examined + 2.0 * queue.n))
    boxes = np.concatenate([kept.boxes[: kept.n], queue.boxes[: queue.n]])
    bounds = np.concatenate([kept.bounds[: kept.n], queue.bounds[: queue.n]])
    near = bounds < lowest.value + settings.delta
    return Searched(
        lowest.value,
        lowest.place,
        float(min(lowest.value, bounds[near].min(initial=math.inf))),
        boxes[near],
        bounds[near],
        int(np.count_nonzero(queue.bounds[: queue.n] < lowest.value + settings.delta)),
        examined,
        time.perf_counter() - began,
        settings.delta,
    )


def _work_on(
    tools: Tools, queue: _Boxes, kept: _Boxes, lowest: Lowest, settings: SearchSettings
) -> int:
    """Examine the boxes of lowest bounds; return how many. Interrupted, it loses none."""
    chosen, bounds = queue.lowest(_TOGETHER)
    for i, (box, before) in enumerate(zip(chosen, bounds, strict=True)):
        if before >= lowest.value + settings.delta:
            continue
        try:
            fate, bound, where = examine(
                tools, box, lowest, settings.delta, settings.width, settings.narrowest
            )
        except KeyboardInterrupt:
            for rest, least in zip(chosen[i:], bounds[i:], strict=True):
                queue.add(rest[None], least)
            raise
        if fate in (Fate.KEPT, Fate.CONVEX):
            kept.add(box[None], max(bound, before))
        elif fate is Fate.CUT:
            queue.add(halves(box, where), max(bound, before))
    return len(chosen)


def proven_empty(
    question: Question, found: Searched, boxes: FloatArray, bounds: FloatArray, max_boxes: int
) -> bool:
    """Whether narrower boxes prove that no misfit within delta of the lowest lies in these boxes.

    For boxes that a search has kept as narrow enough, and in which no descent comes so low.

    Parameters
    ----------
    boxes, bounds : float arrays, shapes (n_boxes, 2, n) and (n_boxes,)
    max_boxes : int
        How many may be examined.
    """
    tools = tools_for(question)
    lowest = Lowest(found.value, found.minimiser)
    settings = SearchSettings(found.delta, width=_NARROW, narrowest=_NARROW)
    queue, kept = _Boxes(boxes.shape[2]), _Boxes(boxes.shape[2])
    for box, bound in zip(boxes, bounds, strict=True):
        queue.add(box[None], float(bound))
    examined = 0
    while queue.n and not kept.n and examined < max_boxes:
        examined += _work_on(tools, queue, kept, lowest, settings)
    return not queue.n and not kept.n


def first_guess(question: Question, tools: Tools, seed: int = 0) -> Lowest:
    """Return the lowest misfit that descents from a dozen points find, and where.

    Even absorptions first, then points drawn at random.
    """
    low, high = np.maximum(question.least, _ALMOST_BLACK), question.most
    rng = np.random.default_rng(seed)
    even = [np.clip(np.full(low.size, math.log(1.0 - a)), low, high) for a in _EVEN]
    share = rng.random((_STARTS - len(even), low.size))
    drawn = np.log(np.exp(low) + (np.exp(high) - np.exp(low)) * share)
    lowest = Lowest(math.inf, even[0])
    for start in (*even, *drawn):
        if math.isfinite(total_misfit(tools.kind, tools.data, start, tools.most)):
            place, value = descend(tools.kind, tools.data, start, low, high, tools.most)
            lowest.offer(value, place)
    return lowest


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
