"""The directivity of sources, measured or of few unknowns, as a factor on the energy of paths.

Factors are relative to an omnidirectional source of the same sound power: their mean over all
directions is 1, so that an "absolute" level is that of the sound power, not that on the axis of the
loudspeaker. A first-order source has the amplitude ``a = (1 + b . u) / sqrt(1 + |b|**2 / 3)`` in
direction u and its square as energy. Pressures are linear in a, energies of paths quadratic: slopes
by b are exact for both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roomfit.base.arguments import float_array, read_only
from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray
from roomfit.model.weighing import RowPattern
from roomfit.room.scene import Point
from roomfit.tracing.paths import Paths


def amplitude_and_slope(
    b: FloatArray, departure: NDArray[np.float32] | FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the amplitude a of every direction, (n,), and its derivative by b, (n, 3)."""
    b = np.asarray(b, dtype=np.float64)
    norm = 1.0 + b @ b / 3.0
    amplitude = (1.0 + departure @ b) / np.sqrt(norm)
    return amplitude, departure / np.sqrt(norm) - amplitude[:, None] * b / (3.0 * norm)


# A measured directivity is interpolated once to a grid of directions so fine, and then linearly.
_STEP_DEG = 2.5


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredDirectivity:
    """Measured energy of a loudspeaker in each direction, of unit sound power."""

    centres_hz: FloatArray  # (n_bands,)
    # (n_bands, n_polar, n_azimuth), on polar angles from 0 (the axis that the loudspeaker faces) to
    # pi and azimuths from 0 (left, from up across the axis) to 2 pi, both ends included
    factor: FloatArray
    axes: FloatArray  # (3, 3), rows: directions in the room of its front, left and top

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
    """Return unit vectors of front, left and top, rows of (3, 3); `up` may be oblique to `aim`."""
    front = float_array("aim", aim, (3,), low=-1e6, high=1e6)
    left = np.cross(float_array("up", up, (3,), low=-1e6, high=1e6), front)
    if not np.linalg.norm(left) > 1e-9 * np.linalg.norm(front):
        raise InputError(
            "aim and up of a loudspeaker do not determine its orientation",
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

    Between directions it is interpolated by radial functions through the nearest sixteen, exact at
    the measured directions, and never below 0.

    Shapes: `directions` (n_directions, 3), `energy` (n_directions, n_bands), `centres_hz`
    (n_bands,), `axes` (3, 3).
    """
    points = float_array("directions", directions, (None, 3), low=-1e6, high=1e6)
    length = np.linalg.norm(points, axis=1)
    values = float_array("energy", energy, (len(points), len(centres_hz)), low=0.0)
    if len(points) < 6 or not np.all(length > 0.0):
        what = "too few directions for a directivity"
        hint = "measure at least front, back, left, right, top and bottom"
        raise InputError(what, found=str(len(points)), needed="6 or more", hint=hint)
    points, first = np.unique(np.round(points / length[:, None], 6), axis=0, return_index=True)
    polar = np.linspace(0.0, np.pi, round(180.0 / _STEP_DEG) + 1)
    azimuth = np.linspace(0.0, 2.0 * np.pi, round(360.0 / _STEP_DEG) + 1)
    p, a = (x.ravel() for x in np.meshgrid(polar, azimuth, indexing="ij"))
    grid = np.stack([np.cos(p), np.sin(p) * np.cos(a), np.sin(p) * np.sin(a)], 1)
    if np.min(np.max(grid @ points.T, axis=1)) < 0.5:
        raise InputError(
            "the directions of a directivity leave a hole wider than 60 degrees",
            found="a hole",
            needed="directions all around the loudspeaker",
            hint="add directions in the hole",
        )
    neighbours = min(16, len(points))
    # linear radial functions in space: as smooth as few directions permit, exact at each of them
    from scipy.interpolate import RBFInterpolator  # heavy, for measured directivities alone

    smooth = RBFInterpolator(points, values[first], neighbors=neighbours, kernel="linear")
    factor = np.maximum(smooth(grid), 0.0).T.reshape(-1, polar.size, azimuth.size)
    mean = sphere_mean(factor)
    if not np.all(mean > 0.0):
        raise InputError(
            "a directivity has a band without energy",
            found="energy 0 in a band",
            needed="energy above 0 in every band",
            hint="leave the band out",
        )
    return MeasuredDirectivity(centres_hz, factor / mean[:, None, None], axes)


def sphere_mean(factor: FloatArray) -> FloatArray:
    """Return the mean over all directions of values on the grid, shape (n_bands,)."""
    polar = np.linspace(0.0, np.pi, factor.shape[1])
    # exact for what is linear in cos(polar) between grid lines
    edges = np.concatenate(([0.0], 0.5 * (polar[1:] + polar[:-1]), [np.pi]))
    share = -0.5 * np.diff(np.cos(edges))
    return np.asarray(factor[:, :, :-1].mean(axis=2) @ share)


def measured_factor(source: MeasuredDirectivity, departure: FloatArray, band: int) -> FloatArray:
    """Return the factor of one band for directions in the room, shape (n_paths,)."""
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


@dataclass(frozen=True, slots=True, eq=False)
class Pattern:
    """A source with the amplitude ``1 + b . u`` in direction u, of unit sound power.

    Where it is known where the source aims, the amplitude is ``1 + b . q`` instead, with q as
    `pattern_basis` returns it: of third order, and alike all around the aim.
    """

    # (3,), along the axis, or (n_bands, 3), as a fit finds it; length 0 is omnidirectional, 1 a
    # cardioid, far above 1 a figure of eight. Aim and order in one: three unknowns without bounds
    # and without angles.
    b: FloatArray
    aim: FloatArray | None = None  # (3,), unit vector; None: of first order, its axis that of b
    loudspeaker: str = ""  # whose pattern it is, where sources of one make share b

    def __post_init__(self) -> None:
        shape = (3,) if np.ndim(self.b) == 1 else (None, 3)
        b = float_array("directivity", self.b, shape, low=-1e3, high=1e3)
        object.__setattr__(self, "b", b)
        if self.aim is not None:
            object.__setattr__(self, "aim", unit_vector(self.aim))


def unit_vector(aim: ArrayLike) -> FloatArray:
    """Return a direction as a unit vector, shape (3,); an `InputError` where it has no length."""
    axis = float_array("aim", aim, (3,), low=-1e6, high=1e6)
    length = float(np.linalg.norm(axis))
    if length == 0.0:
        what = "the aim vector of a source has zero length"
        hint = "write aim = [1, 0, 0] for a loudspeaker that faces x"
        raise InputError(what, found="0, 0, 0", needed="a direction", hint=hint)
    return read_only(axis / length)


# Legendre polynomials of the orders 1 to 3, scaled to the mean square 1/3 over the sphere, that of
# the components of a unit vector: patterns of both kinds then have one formula.
_AXIAL_SCALE = np.sqrt((2.0 * np.arange(1, 4) + 1.0) / 3.0)


def pattern_basis(
    departure: NDArray[np.float32] | FloatArray, aim: FloatArray | None
) -> NDArray[np.float32] | FloatArray:
    """Return what the amplitude of a `Pattern` is linear in, shape (n, 3).

    The direction itself, or about a known aim Legendre polynomials of the cosine of the angle to
    it: a loudspeaker of one or two ways is alike all around its axis, and narrower than any of
    first order.
    """
    if aim is None:
        return departure
    cosine = np.clip(departure.astype(np.float64) @ aim, -1.0, 1.0)
    return np.asarray(np.polynomial.legendre.legvander(cosine, 3)[:, 1:] * _AXIAL_SCALE)


def aimed(aim: ArrayLike, b: float) -> Pattern:
    """Return the first-order directivity with an axis and a strength."""
    return Pattern(b * unit_vector(aim))


def axial_index_db(b: FloatArray) -> float:
    """Return by how much a pattern about an aim, b of shape (3,), is louder on its axis, dB."""
    on_axis = 1.0 + b @ _AXIAL_SCALE
    return float(10.0 * np.log10(max(on_axis**2, 1e-12) / (1.0 + b @ b / 3.0)))


Directivity = Pattern | MeasuredDirectivity


def directivity_factors(
    paths: Paths, sources: Sequence[Directivity | None], source_of_pair: Sequence[int], band: int
) -> FloatArray:
    """Return the factor of every path in one band, shape (n_paths,)."""
    factors = np.ones(len(paths))
    source_of_path = np.asarray(source_of_pair)[paths.pair]
    for number, source in enumerate(sources):
        if source is None:
            continue
        own = np.flatnonzero(source_of_path == number)
        departure = paths.departure[own].astype(np.float64)
        if isinstance(source, Pattern):
            b = source.b if source.b.ndim == 1 else source.b[band]
            factors[own] = RowPattern(b, pattern_basis(departure, source.aim)).factor()
        else:
            factors[own] = measured_factor(source, departure, band)
    return factors


@dataclass(frozen=True, slots=True, eq=False)
class UnknownDirectivity:
    """A directivity that is to be fitted, a `Pattern`, with the prior of its vector b."""

    mean: FloatArray | None = None  # shape (3,); None: unspecified
    sd: float | None = None  # of each component of b; None: unspecified
    aim: FloatArray | None = None  # (3,), unit vector: the pattern is of third order about it
    loudspeaker: str | None = None  # sources of one make share b; they need an aim each


# By source; a source that is not among them is omnidirectional.
Directivities = Mapping[str, Directivity | UnknownDirectivity]


def known_directivities(
    directivities: Directivities, sources: Sequence[Point]
) -> tuple[Directivity | None, ...]:
    """Return the directivity of every source; None is omnidirectional, or still to be fitted."""
    found = [directivities.get(s.name) for s in sources]
    return tuple(None if isinstance(d, UnknownDirectivity) else d for d in found)
