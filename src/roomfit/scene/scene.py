"""A room with sources, receivers and air: all that a simulation needs but the absorption."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.air import Air
from roomfit.checks import float_array, int_array, unique_names
from roomfit.scene.room import Room
from roomfit.typing import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Point:
    """A named position of a source or a receiver.

    Attributes
    ----------
    name : str
    position_m : float array, shape (3,)
    position_sd_m : float or None
        Standard deviation of each coordinate as told; None where nothing was told.
    """

    name: str
    position_m: FloatArray
    position_sd_m: float | None = None

    def __post_init__(self) -> None:
        position = float_array(
            f"position of {self.name}", self.position_m, (3,), low=-1e6, high=1e6, unit="m"
        )
        object.__setattr__(self, "position_m", position)


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Everything that directs the sound, and nothing that absorbs it at walls.

    Attributes
    ----------
    room : Room
    sources, receivers : tuple of Point
        Sources are omnidirectional with unit sound power.
    pairs : int32 array, shape (n_pairs, 2)
        Index of source and of receiver of each pair whose response is wanted.
    air : Air
    """

    room: Room
    sources: tuple[Point, ...]
    receivers: tuple[Point, ...]
    pairs: IntArray
    air: Air

    def __post_init__(self) -> None:
        unique_names("source", (s.name for s in self.sources))
        unique_names("receiver", (r.name for r in self.receivers))
        pairs = int_array("pairs", self.pairs, (None, 2), low=0)
        limits = (len(self.sources), len(self.receivers))
        for column, high in enumerate(limits):
            int_array("pair", pairs[:, column], (len(pairs),), low=0, high=high - 1)
        object.__setattr__(self, "sources", tuple(self.sources))
        object.__setattr__(self, "receivers", tuple(self.receivers))
        object.__setattr__(self, "pairs", pairs)


def distances_m(scene: Scene) -> FloatArray:
    """Return the straight distance of every pair, shape (n_pairs,)."""
    sources = np.array([s.position_m for s in scene.sources])
    receivers = np.array([r.position_m for r in scene.receivers])
    steps = receivers[scene.pairs[:, 1]] - sources[scene.pairs[:, 0]]
    return np.asarray(np.linalg.norm(steps, axis=1))
