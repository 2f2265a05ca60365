"""The answer of a certified search: value, proven bound, and where other minimisers could be."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from roomfit.identification.certified.boxes import Tools, tools_for
from roomfit.identification.certified.convexity import is_convex
from roomfit.identification.certified.descent import descend, total_misfit
from roomfit.identification.certified.question import Question, to_absorption
from roomfit.identification.certified.search import Searched, SearchSettings, proven_empty, search
from roomfit.typing import FloatArray, IntArray, Progress

Status = Literal["certified", "stopped", "unresolved"]

# Descents within a cluster: from its boxes of lowest bounds.
_DESCENTS = 24
# To show that a cluster in which nothing comes near the lowest misfit is empty.
_MORE_BOXES = 2000
_ALMOST_BLACK = math.log(1e-6)
# In g: far above the rounding of faces that were computed twice, far below any width.
_TOUCHING = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Cluster:
    """Boxes that touch each other, and the lowest misfit found in them.

    Attributes
    ----------
    lower, upper : float arrays, shape (n,)
        Smallest box round all of them: absorption of the materials, gains as factors.
    minimiser : float array, shape (n,)
    value : float
    unique : bool
        Whether the misfit is proven convex all over the box: then the cluster has one minimiser.
    n_boxes : int
    """

    lower: FloatArray
    upper: FloatArray
    minimiser: FloatArray
    value: float
    unique: bool
    n_boxes: int


@dataclass(frozen=True, slots=True, eq=False)
class Certificate:
    """What was proven of the lowest misfit.

    Attributes
    ----------
    status : {"certified", "stopped", "unresolved"}
        certified: the lowest misfit anywhere lies between `lower_bound` and `value`, which are
        within `delta`, and no point outside the clusters comes within `delta` of it.
        stopped: a cap or an interrupt ended the search; `lower_bound` and the clusters, open boxes
        included, are proven all the same.
        unresolved: all boxes are narrow, but some may hold a misfit lower than `value` by more
        than `delta`.
    sentence : str
    coordinates : tuple of str
    value : float
    lower_bound : float
    delta : float
    clusters : tuple of Cluster
        By value, the lowest first.
    n_open : int
        Boxes still to be worked on when the search stopped.
    boxes : int
        Boxes examined.
    seconds : float
    """

    status: Status
    sentence: str
    coordinates: tuple[str, ...]
    value: float
    lower_bound: float
    delta: float
    clusters: tuple[Cluster, ...]
    n_open: int
    boxes: int
    seconds: float


def certify(
    question: Question, settings: SearchSettings, *, progress: Progress | None = None
) -> Certificate:
    """Return a proof of how low the misfit can be, and where.

    Parameters
    ----------
    question : Question
    settings : SearchSettings
    progress : callable, optional
    """
    return certificate_of(question, search(question, settings, progress=progress))


def certificate_of(question: Question, found: Searched) -> Certificate:
    """Return what a search has proven, its boxes joined to clusters."""
    tools = tools_for(question)
    label = touching(found.boxes)
    clusters = []
    for number in range(int(label.max(initial=-1)) + 1):
        own = np.flatnonzero(label == number)
        cluster = _cluster(question, tools, found, own)
        empty = cluster.value > found.value + found.delta and proven_empty(
            question, found, found.boxes[own], found.bounds[own], _MORE_BOXES
        )
        if not empty:
            clusters.append(cluster)
    clusters.sort(key=lambda c: c.value)
    value = min([found.value, *(c.value for c in clusters)])
    bound = min(found.lower_bound, value)
    status: Status = "certified"
    if found.n_open:
        status = "stopped"
    elif value - bound > found.delta:
        status = "unresolved"
    return Certificate(
        status,
        _sentence(status, value, bound, found, len(clusters)),
        question.coordinates,
        value,
        bound,
        found.delta,
        tuple(clusters),
        found.n_open,
        found.examined,
        found.seconds,
    )


def touching(boxes: FloatArray) -> IntArray:
    """Return the number of the cluster of each box, shape (n_boxes,): closed boxes that meet.

    Parameters
    ----------
    boxes : float array, shape (n_boxes, 2, n)
    """
    label: IntArray = np.full(len(boxes), -1)
    number = 0
    for first in range(len(boxes)):
        if label[first] >= 0:
            continue
        label[first] = number
        waiting = [first]
        while waiting:
            box = boxes[waiting.pop()]
            free = np.flatnonzero(label < 0)
            meets = np.all(
                (boxes[free, 0] <= box[1] + _TOUCHING) & (boxes[free, 1] >= box[0] - _TOUCHING),
                axis=1,
            )
            label[free[meets]] = number
            waiting.extend(free[meets].tolist())
        number += 1
    return label


def _cluster(question: Question, tools: Tools, found: Searched, own: IntArray) -> Cluster:
    boxes = found.boxes[own]
    hull = np.stack((boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)))
    low = np.maximum(hull[0], np.minimum(_ALMOST_BLACK, hull[1] - 1e-3))
    order = np.argsort(found.bounds[own])[:_DESCENTS]
    starts = [0.5 * (np.maximum(boxes[i, 0], low) + boxes[i, 1]) for i in order]
    if np.all((found.minimiser >= hull[0]) & (found.minimiser <= hull[1])):
        starts.append(found.minimiser)
    ends = [descend(tools.kind, tools.data, start, low, hull[1], tools.most) for start in starts]
    place, value = min((_blackened(tools, hull, end) for end in ends), key=lambda end: end[1])
    ends_of_hull = to_absorption(question, hull)
    return Cluster(
        np.minimum(ends_of_hull[0], ends_of_hull[1]),
        np.maximum(ends_of_hull[0], ends_of_hull[1]),
        to_absorption(question, place),
        float(value),
        bool(is_convex(tools.kind, tools.data, hull, tools.most, tools.values)),
        len(own),
    )


def _blackened(
    tools: Tools, hull: FloatArray, end: tuple[FloatArray, float]
) -> tuple[FloatArray, float]:
    """Return a point with what a descent left all but black made black, where that is lower."""
    place, value = end
    black = np.where((place <= _ALMOST_BLACK + 1e-6) & np.isneginf(hull[0]), -math.inf, place)
    there = total_misfit(tools.kind, tools.data, black, tools.most)
    return (black, there) if there <= value else end


def _sentence(status: Status, value: float, bound: float, found: Searched, n: int) -> str:
    better = f"at best {value - bound:.3g} better"
    if status == "stopped":
        return (
            f"Stopped: the misfit found, {value:.6g}, could be {better}; {found.n_open} boxes are "
            f"open after {found.examined}."
        )
    if status == "unresolved":
        return (
            f"Not resolved: the misfit found, {value:.6g}, could be {better} within boxes too "
            "narrow to be cut."
        )
    where = "one place comes" if n == 1 else f"{n} places come"
    return (
        f"Certified: no absorption has a misfit below {bound:.6g}, {value:.6g} was found, and only "
        f"{where} within {found.delta:.3g} of it."
    )
