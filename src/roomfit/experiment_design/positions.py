"""Where sources and receivers may stand, and how far apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import qmc

from roomfit._checks import float_array
from roomfit.errors import InputError
from roomfit.geometry.inside import distance_to_walls_m, is_inside
from roomfit.scene import Room
from roomfit.typing import BoolArray, FloatArray

# Points that are tried before a region counts as too narrow.
_MOST_TRIES = 2**14
_SAME_POSITION_M = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """A box in the room's frame, and how far from all walls a position must be."""

    low_m: FloatArray  # (3,)
    high_m: FloatArray  # (3,)
    wall_distance_m: float = 1.0  # ISO 3382-2:2008, 4.3.3: a quarter of a wavelength, normally 1 m

    def __post_init__(self) -> None:
        for name in ("low_m", "high_m"):
            corner = float_array(f"corner of a region ({name})", getattr(self, name), (3,))
            object.__setattr__(self, name, corner)
        if np.any(self.low_m > self.high_m):
            raise InputError(
                "a region ends below its beginning",
                found=f"from {self.low_m.tolist()} to {self.high_m.tolist()} m",
                needed="the lower corner first",
            )


def region_of(
    room: Room,
    heights_m: tuple[float, float],
    wall_distance_m: float,
    box_m: tuple[ArrayLike, ArrayLike] | None = None,
) -> Region:
    """Return the region of a room between two heights above its lowest point, cut by a box."""
    vertices = room.mesh.vertices_m
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    floor = float(low[2])
    low = np.maximum(low, [*low[:2], floor + heights_m[0]])
    high = np.minimum(high, [*high[:2], floor + heights_m[1]])
    if box_m is not None:
        low, high = np.maximum(low, box_m[0]), np.minimum(high, box_m[1])
    return Region(low, high, wall_distance_m)


def spread_positions(room: Room, region: Region, n: int, seed: int) -> FloatArray:
    """Return n positions spread evenly over a region, shape (n, 3).

    Scrambled Sobol points of the box, those kept that are in the room and clear of its walls.

    Raises
    ------
    InputError
        Hardly any position in the region is allowed.
    """
    sampler = qmc.Sobol(3, scramble=True, rng=np.random.default_rng(seed))
    found = np.zeros((0, 3))
    tried = 0
    while len(found) < n and tried < _MOST_TRIES:
        points = sampler.random(max(256, 1 << (4 * n - 1).bit_length()))
        tried += len(points)
        positions = region.low_m + points * (region.high_m - region.low_m)
        found = np.concatenate((found, positions[_clear(room, region, positions)]))
    if len(found) < n:
        raise _too_narrow(region, len(found), n)
    return found[:n]


def grid_positions(room: Room, region: Region, spacing_m: float) -> FloatArray:
    """Return the positions of a grid in a region, shape (n, 3).

    The grid is centred in the region, with the same spacing in x, y and z; a region without height
    has one layer.

    Raises
    ------
    InputError
        No position is allowed.
    """
    axes = []
    for low, high in zip(region.low_m, region.high_m, strict=True):
        n = int((high - low) / spacing_m + 1e-9)
        axes.append(0.5 * (low + high) + spacing_m * (np.arange(n + 1) - 0.5 * n))
    positions = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    positions = positions[_clear(room, region, positions)]
    if not len(positions):
        raise _too_narrow(region, 0, 1)
    return positions


def least_source_distance_m(volume_m3: float, speed_m_s: float, decay_s: float) -> float:
    """Return how far from a source a receiver must be at least: ``2 sqrt(V / (c T))``.

    ISO 3382-1:2009, 4.3.2 and ISO 3382-2:2008, 4.3.3: nearer, direct sound is too strong for a
    decay to be read from.
    """
    return float(2.0 * np.sqrt(volume_m3 / (speed_m_s * decay_s)))


def compatible_positions(receivers_m: FloatArray, apart_m: float) -> BoolArray:
    """Return which receivers may stand in one design: far enough apart, or at one position.

    Parameters
    ----------
    receivers_m : float array, shape (n_pairs, 3)
        Of every pair.

    Returns
    -------
    bool array, shape (n_pairs, n_pairs)
        False on the diagonal.
    """
    steps = receivers_m[:, None, :] - receivers_m[None, :, :]
    distance = np.sqrt(np.sum(steps**2, axis=2))
    # the same position may be measured from several sources
    fine = (distance >= apart_m) | (distance < _SAME_POSITION_M)
    np.fill_diagonal(fine, False)
    return np.asarray(fine)


def _clear(room: Room, region: Region, positions_m: FloatArray) -> BoolArray:
    inside = is_inside(room.mesh, positions_m)
    inside[inside] = (
        distance_to_walls_m(room.mesh, positions_m[inside]) >= region.wall_distance_m - 1e-9
    )
    return np.asarray(inside)


def _too_narrow(region: Region, found: int, needed: int) -> InputError:
    return InputError(
        "the room leaves too little space for candidates",
        where=f"from {region.low_m.round(2).tolist()} to {region.high_m.round(2).tolist()} m",
        found=f"{found} positions at least {region.wall_distance_m:g} m from all walls",
        needed=f"{needed}",
        hint="lower wall_distance_m or widen the heights in [design]; furniture counts as walls",
    )
