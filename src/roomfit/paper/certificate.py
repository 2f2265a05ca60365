"""A band fitted with a proof that no other absorption does better.

The boxes that a search leaves are joined to clusters; their bounds and the lowest cost found make
the certificate. The proof holds for the weights of the answer, so that fit and proof take turns.
"""

from __future__ import annotations

import math

import numpy as np

from roomfit.base.typing import FloatArray, IntArray
from roomfit.paper.certificate_record import Certificate, Cluster, Status
from roomfit.paper.convex import descend, is_convex, total_misfit
from roomfit.paper.global_search import (
    ALMOST_BLACK,
    Searched,
    SearchSettings,
    Tools,
    proven_empty,
    search,
    tools_for,
)
from roomfit.paper.question import (
    GlobalProblem,
    to_absorption,
)

# Descents within a cluster: from its boxes of lowest bounds.
_DESCENTS = 24
# In g: far above the rounding of faces that were computed twice, far below any width.
_TOUCHING = 1e-9


def certify(global_problem: GlobalProblem, settings: SearchSettings) -> Certificate:
    """Return a proof of how low the misfit can be, and where: boxes left over, as clusters."""
    found = search(global_problem, settings)
    tools = tools_for(global_problem)
    label = touching(found.boxes)
    clusters = []
    for number in range(int(label.max(initial=-1)) + 1):
        own = np.flatnonzero(label == number)
        cluster = _cluster(global_problem, tools, found, own)
        empty = cluster.value > found.value + found.delta and proven_empty(
            tools, found, found.boxes[own], found.bounds[own]
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
        global_problem.coordinates,
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

    `boxes` has the shape (n_boxes, 2, n).
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


def _cluster(
    global_problem: GlobalProblem, tools: Tools, found: Searched, own: IntArray
) -> Cluster:
    boxes = found.boxes[own]
    hull = np.stack((boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)))
    low = np.maximum(hull[0], np.minimum(ALMOST_BLACK, hull[1] - 1e-3))
    order = np.argsort(found.bounds[own])[:_DESCENTS]
    starts = [0.5 * (np.maximum(boxes[i, 0], low) + boxes[i, 1]) for i in order]
    if np.all((found.minimiser >= hull[0]) & (found.minimiser <= hull[1])):
        starts.append(found.minimiser)
    ends = [descend(tools.data, start, low, hull[1], tools.most) for start in starts]
    place, value = min((_blackened(tools, hull, end) for end in ends), key=lambda end: end[1])
    ends_of_hull = to_absorption(global_problem, hull)
    return Cluster(
        np.minimum(ends_of_hull[0], ends_of_hull[1]),
        np.maximum(ends_of_hull[0], ends_of_hull[1]),
        to_absorption(global_problem, place),
        float(value),
        bool(is_convex(tools.data, hull, tools.most, tools.values)),
        len(own),
    )


def _blackened(
    tools: Tools, hull: FloatArray, end: tuple[FloatArray, float]
) -> tuple[FloatArray, float]:
    """Return a point with what a descent left all but black made black, where that is lower."""
    place, value = end
    black = np.where((place <= ALMOST_BLACK + 1e-6) & np.isneginf(hull[0]), -math.inf, place)
    there = total_misfit(tools.data, black, tools.most)
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
    where = "one minimum comes" if n == 1 else f"{n} minima come"
    return (
        f"Certified: no absorption has a misfit below {bound:.6g}, {value:.6g} was found, and only "
        f"{where} within {found.delta:.3g} of it."
    )
