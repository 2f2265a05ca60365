"""One box of the search: pruned, shaved, kept, or cut in two."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from roomfit.identification.certified.convex import least_over
from roomfit.identification.certified.convexity import is_convex
from roomfit.identification.certified.descent import descend, least_of_convex, total_misfit
from roomfit.identification.certified.priors import priors_over
from roomfit.identification.certified.question import KINDS, Arrays, Question, arrays
from roomfit.identification.certified.sandwich import kappa_nodes, planes_over, relative_rounding
from roomfit.identification.certified.shaving import shave
from roomfit.typing import BoolArray, FloatArray

_ROUNDS = 8
# Shaving goes on while a round takes off so much of the volume.
_WORTH = 0.6
# A coordinate that reaches minus infinity is cut this far below its upper end.
FAR_CUT = 1.2


class Fate(Enum):
    """What became of a box."""

    PRUNED = "pruned"
    KEPT = "kept"
    CONVEX = "convex"
    CUT = "cut"


@dataclass(frozen=True, slots=True, eq=False)
class Tools:
    """A question in the form that kernels take, with what is worked out once."""

    kind: int
    data: Arrays
    is_absorption: BoolArray
    most: int
    nodes: FloatArray
    rounding: float
    values: FloatArray


@dataclass(slots=True)
class Lowest:
    """The lowest misfit seen so far, and where in g."""

    value: float
    place: FloatArray

    def offer(self, value: float, place: FloatArray) -> None:
        """Take over a lower misfit."""
        if value < self.value:
            self.value, self.place = value, place


def tools_for(question: Question) -> Tools:
    """Return what working on the boxes of a question needs."""
    data = arrays(question)
    return Tools(
        KINDS[question.misfit],
        data,
        question.is_absorption,
        int(question.exponents.max(initial=0)),
        kappa_nodes(),
        relative_rounding(data),
        np.empty(len(question.weight)),
    )


def examine(
    tools: Tools, box: FloatArray, lowest: Lowest, delta: float, width: float, narrowest: float
) -> tuple[Fate, float, int]:
    """Work on one box: return what became of it, a lower bound of the misfit, and where to cut.

    Parameters
    ----------
    box : float array, shape (2, n)
        Lower and upper ends in g; shrunk in place to what was not proven to lie above the
        threshold.
    lowest : Lowest
        Lowered in place.
    delta : float
        Points whose misfit exceeds the lowest by more are of no interest.
    width : float
        A box no wider is kept, if its bound reaches the lowest less `delta`.
    narrowest : float
        A box no wider is kept in any case.
    """
    bound = -math.inf
    share = np.empty(0)
    for _ in range(_ROUNDS):
        bound, kept, share = _bounded(tools, box, lowest, delta)
        if bound >= lowest.value + delta:
            return Fate.PRUNED, bound, 0
        if kept > _WORTH:
            break
    widths = widths_of(tools.is_absorption, box)
    if widths.max() <= narrowest or (widths.max() <= width and bound >= lowest.value - delta):
        return Fate.KEPT, bound, 0
    if is_convex(tools.kind, tools.data, box, tools.most, tools.values):
        bound = max(bound, _bound_of_convex(tools, box, lowest))
        pruned = bound >= lowest.value + delta
        return (Fate.PRUNED if pruned else Fate.CONVEX), bound, 0
    wide = widths > (width if widths.max() > width else 0.0)
    return Fate.CUT, bound, int(np.argmax(np.where(wide, share, -1.0)))


def _bounded(
    tools: Tools, box: FloatArray, lowest: Lowest, delta: float
) -> tuple[float, float, FloatArray]:
    """Bound the misfit over a box and shave it; return bound, share kept, and shares of blame."""
    kind, data, most = tools.kind, tools.data, tools.most
    threshold = lowest.value + delta
    corners, apart, planes, centre, half = planes_over(
        kind, data, box[0], box[1], most, tools.nodes, tools.rounding, threshold, tools.values
    )
    if corners >= threshold:
        return corners, 1.0, planes[4]
    separable = priors_over(data[5], box[0], box[1], centre, half)
    d: FloatArray = np.zeros(len(half))
    bound = apart + least_over(
        kind, data, planes, separable, -half, half, threshold - apart, d, True
    )
    if bound >= threshold:
        return bound, 1.0, planes[4]
    _try_point(tools, box, centre + d, lowest)
    threshold = lowest.value + delta
    if bound >= threshold:
        return bound, 1.0, planes[4]
    kept = shave(kind, data, planes, separable, box, centre, half, threshold - apart, d)
    return bound, kept, planes[4]


def _try_point(tools: Tools, box: FloatArray, g: FloatArray, lowest: Lowest) -> None:
    """Offer the misfit at a point, and that where a descent from there within the box ends."""
    low = np.where(np.isfinite(box[0]), box[0], box[1] - 2.0 * FAR_CUT)
    inside = np.clip(g, low, box[1])
    if total_misfit(tools.kind, tools.data, inside, tools.most) < lowest.value:
        place, value = descend(tools.kind, tools.data, inside, low, box[1], tools.most)
        lowest.offer(value, place)


def _bound_of_convex(tools: Tools, box: FloatArray, lowest: Lowest) -> float:
    middle = 0.5 * (box[0] + box[1])
    place, value, bound = least_of_convex(
        tools.kind, tools.data, box, middle, tools.most, tools.rounding
    )
    lowest.offer(value, place)
    return bound


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
