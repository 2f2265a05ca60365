"""The directivity of a loudspeaker as measured around it, read for any direction in the room."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import RBFInterpolator

from roomfit.checks import float_array
from roomfit.errors import InputError
from roomfit.typing import FloatArray

# A measured directivity is laid on a grid of directions so fine once, and read from it linearly.
_STEP_DEG = 2.5
_NEIGHBOURS = 16


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredDirectivity:
    """Energy that a loudspeaker was measured to send into each direction, of unit sound power.

    Attributes
    ----------
    centres_hz : float array, shape (n_bands,)
    factor : float array, shape (n_bands, n_polar, n_azimuth)
        On polar angles from 0 (the axis that the loudspeaker faces) to pi and azimuths from 0
        (left, from up across the axis) to 2 pi, both ends included.
    axes : float array, shape (3, 3)
        Rows: where the loudspeaker's axis, its left and its top point in the room.
    """

    centres_hz: FloatArray
    factor: FloatArray
    axes: FloatArray

    def __post_init__(self) -> None:
        axes = float_array("axes of a loudspeaker", self.axes, (3, 3), low=-1.0, high=1.0)
        if not np.allclose(axes @ axes.T, np.eye(3), atol=1e-9):
            raise InputError("the axes of a loudspeaker are not perpendicular unit vectors")
        centres = float_array("centres", self.centres_hz, (None,), low=0.0, unit="Hz")
        factor = float_array("directivity", self.factor, (len(centres), None, None), low=0.0)
        object.__setattr__(self, "centres_hz", centres)
        object.__setattr__(self, "factor", factor)
        object.__setattr__(self, "axes", axes)


def loudspeaker_axes(aim: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> FloatArray:
    """Return unit vectors of front, left and top, rows of (3, 3); `up` need not be square to `aim`.

    Raises
    ------
    InputError
        `up` and `aim` are parallel, or one has no length.
    """
    front = float_array("aim", aim, (3,), low=-1e6, high=1e6)
    left = np.cross(float_array("up", up, (3,), low=-1e6, high=1e6), front)
    if not np.linalg.norm(left) > 1e-9 * np.linalg.norm(front):
        raise InputError(
            "aim and up of a loudspeaker do not tell how it stands",
            found=f"aim {np.array(aim).tolist()} and up {np.array(up).tolist()}",
            needed="two directions that are not parallel",
            hint="a loudspeaker that faces up needs another up",
        )
    front, left = front / np.linalg.norm(front), left / np.linalg.norm(left)
    return np.stack([front, left, np.cross(front, left)])


def measured_directivity(
    directions: FloatArray, energy: FloatArray, centres_hz: FloatArray, axes: FloatArray
) -> MeasuredDirectivity:
    """Return a directivity from energies measured in directions spread over the sphere.

    Between directions it is interpolated by radial functions through the nearest sixteen, which
    keeps the measured values, and never below 0.

    Parameters
    ----------
    directions : float array, shape (n_directions, 3)
        In the loudspeaker's own frame: x front, y left, z top; of any length.
    energy : float array, shape (n_directions, n_bands)
        In any unit: the mean over the sphere becomes 1.
    centres_hz : float array, shape (n_bands,)
    axes : float array, shape (3, 3)
        From `loudspeaker_axes`.

    Raises
    ------
    InputError
        Fewer than six directions, some hemisphere without any, or a band without energy.
    """
    points = float_array("directions", directions, (None, 3), low=-1e6, high=1e6)
    length = np.linalg.norm(points, axis=1)
    values = float_array("energy", energy, (len(points), len(centres_hz)), low=0.0)
    if len(points) < 6 or not np.all(length > 0.0):
        raise InputError(
            "too few directions for a directivity", found=str(len(points)), needed="6 or more"
        )
    points, first = np.unique(np.round(points / length[:, None], 6), axis=0, return_index=True)
    polar, azimuth, grid = _grid()
    if np.min(np.max(grid @ points.T, axis=1)) < 0.5:
        raise InputError(
            "the directions of a directivity leave a hole wider than 60 degrees",
            needed="directions all around the loudspeaker",
        )
    neighbours = min(_NEIGHBOURS, len(points))
    # linear radial functions in space: as smooth as few directions permit, exact at each of them
    smooth = RBFInterpolator(points, values[first], neighbors=neighbours, kernel="linear")
    factor = np.maximum(smooth(grid), 0.0).T.reshape(-1, polar.size, azimuth.size)
    mean = sphere_mean(factor)
    if not np.all(mean > 0.0):
        raise InputError("a directivity has a band without energy")
    return MeasuredDirectivity(centres_hz, factor / mean[:, None, None], axes)


def sphere_mean(factor: FloatArray) -> FloatArray:
    """Return the mean over all directions of values on the grid, shape (n_bands,)."""
    polar = np.linspace(0.0, np.pi, factor.shape[1])
    # exact for what is linear in cos(polar) between grid lines
    edges = np.concatenate(([0.0], 0.5 * (polar[1:] + polar[:-1]), [np.pi]))
    share = -0.5 * np.diff(np.cos(edges))
    return np.asarray(factor[:, :, :-1].mean(axis=2) @ share)


def measured_factor(source: MeasuredDirectivity, departure: FloatArray, band: int) -> FloatArray:
    """Return the factor of one band for directions in the room, shape (n_paths,).

    Parameters
    ----------
    departure : float array, shape (n_paths, 3)
        Unit vectors away from the source.
    band : int
    """
    front, left, top = (departure.astype(np.float64) @ axis for axis in source.axes)
    table = source.factor[band]
    polar = np.arctan2(np.hypot(left, top), front) / np.pi * (table.shape[0] - 1)
    azimuth = (np.arctan2(top, left) / (2.0 * np.pi) % 1.0) * (table.shape[1] - 1)
    i = np.minimum(polar.astype(np.int64), table.shape[0] - 2)
    j = np.minimum(azimuth.astype(np.int64), table.shape[1] - 2)
    x, y = polar - i, azimuth - j
    near = (1.0 - y) * table[i, j] + y * table[i, j + 1]
    far = (1.0 - y) * table[i + 1, j] + y * table[i + 1, j + 1]
    return np.asarray((1.0 - x) * near + x * far)


def _grid() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return polar angles, azimuths and all their unit vectors, polar angle slowest."""
    polar = np.linspace(0.0, np.pi, round(180.0 / _STEP_DEG) + 1)
    azimuth = np.linspace(0.0, 2.0 * np.pi, round(360.0 / _STEP_DEG) + 1)
    p, a = (x.ravel() for x in np.meshgrid(polar, azimuth, indexing="ij"))
    return polar, azimuth, np.stack([np.cos(p), np.sin(p) * np.cos(a), np.sin(p) * np.sin(a)], 1)
