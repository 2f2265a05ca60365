"""What a global search has proven of the lowest cost, and what that leaves in doubt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from roomfit.base.typing import FloatArray

Status = Literal["certified", "stopped", "unresolved"]


@dataclass(frozen=True, slots=True, eq=False)
class Cluster:
    """Boxes that touch each other, and the lowest cost found in them."""

    # smallest box round all of them, (n,): absorption of the materials, gains as factors
    lower: FloatArray
    upper: FloatArray
    minimiser: FloatArray  # (n,)
    value: float
    unique: bool  # whether the cost is proven convex all over the box: then it has one minimiser
    n_boxes: int


@dataclass(frozen=True, slots=True, eq=False)
class Certificate:
    """What was proven of the lowest cost of energies, their weights fixed.

    certified: the lowest cost anywhere lies between `lower_bound` and `value`, which are within
    `delta`, and no point outside the clusters comes within `delta` of it.
    stopped: a cap or an interrupt ended the search; `lower_bound` and the clusters, open boxes
    included, are proven all the same.
    unresolved: all boxes are narrow, but some may hold a cost lower than `value` by more than
    `delta`.
    """

    status: Status
    sentence: str
    coordinates: tuple[str, ...]
    value: float
    lower_bound: float
    delta: float
    clusters: tuple[Cluster, ...]  # by value, the lowest first
    n_open: int  # boxes still to be examined when the search stopped
    boxes: int  # examined
    seconds: float
