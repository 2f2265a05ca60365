"""What a source sends into each direction, as a factor on the energy of paths.

Factors are relative to an omnidirectional source of the same sound power: their mean over all
directions is 1. So a level that is told as "absolute" is that of the sound power, not that on the
axis of the loudspeaker.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from roomfit.checks import float_array
from roomfit.errors import InputError
from roomfit.response.energy import weigh
from roomfit.response.measured_directivity import MeasuredDirectivity, measured_factor
from roomfit.response.rows import EnergyRows, reweighed_rows
from roomfit.tracing.paths import Paths
from roomfit.typing import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class FirstOrder:
    """A source with the amplitude ``1 + b . u`` in direction u, of unit sound power.

    Attributes
    ----------
    b : float array, shape (3,)
        Along the axis; length 0 is omnidirectional, 1 a cardioid, far above 1 a figure of eight.
        Aim and order in one: three unknowns without bounds and without angles.
    """

    b: FloatArray

    def __post_init__(self) -> None:
        b = float_array("first-order directivity", self.b, (3,), low=-1e3, high=1e3)
        object.__setattr__(self, "b", b)


@dataclass(frozen=True, slots=True, eq=False)
class FirstOrderBands:
    """A first-order source with a vector b of its own in every band, as a fit finds it.

    Attributes
    ----------
    b : float array, shape (n_bands, 3)
    """

    b: FloatArray

    def __post_init__(self) -> None:
        b = float_array("first-order directivity", self.b, (None, 3), low=-1e3, high=1e3)
        object.__setattr__(self, "b", b)


def aimed(aim: ArrayLike, b: float) -> FirstOrder:
    """Return the first-order directivity with an axis and a strength.

    Parameters
    ----------
    aim : array_like, shape (3,)
        Direction of the axis in the frame of the room, of any length but zero.
    b : float
        0 or more: the amplitude on the axis is 1 + b, behind it 1 - b.

    Raises
    ------
    InputError
        The axis has no length.
    """
    axis = float_array("aim", aim, (3,), low=-1e6, high=1e6)
    length = float(np.linalg.norm(axis))
    if length == 0.0:
        raise InputError("a source aims nowhere", found="aim of length 0", needed="a direction")
    return FirstOrder(b * axis / length)


def first_order_factor(source: FirstOrder, departure: FloatArray) -> FloatArray:
    """Return ``(1 + b . u)**2 / (1 + |b|**2 / 3)``, shape (n_paths,).

    Parameters
    ----------
    departure : float array, shape (n_paths, 3)
        Unit vectors u away from the source.
    """
    amplitude = 1.0 + departure.astype(np.float64) @ source.b
    return np.asarray(amplitude**2 / (1.0 + source.b @ source.b / 3.0))


def first_order_amplitude(source: FirstOrder, departure: FloatArray) -> FloatArray:
    """Return the root of `first_order_factor` with its sign, for pressures; shape (n_paths,)."""
    amplitude = 1.0 + departure.astype(np.float64) @ source.b
    return np.asarray(amplitude / np.sqrt(1.0 + source.b @ source.b / 3.0))


def first_order_slope(source: FirstOrder, departure: FloatArray) -> FloatArray:
    """Return the derivative of `first_order_factor` by b, shape (n_paths, 3)."""
    u = departure.astype(np.float64)
    amplitude = 1.0 + u @ source.b
    power = 1.0 + source.b @ source.b / 3.0
    direct = 2.0 * (amplitude / power)[:, None] * u
    return np.asarray(direct - ((amplitude / power) ** 2)[:, None] * (2.0 / 3.0) * source.b)


Directivity = FirstOrder | FirstOrderBands | MeasuredDirectivity


def directivity_factors(
    paths: Paths, sources: Sequence[Directivity | None], source_of_pair: Sequence[int], band: int
) -> FloatArray:
    """Return the factor of every path in one band, shape (n_paths,).

    Parameters
    ----------
    sources : sequence of Directivity or None
        Of each source of the scene; None is omnidirectional.
    source_of_pair : sequence of int
        First column of the scene's pairs.
    band : int
        Of `FirstOrderBands.b` and `MeasuredDirectivity.centres_hz`.
    """
    factors = np.ones(len(paths))
    source_of_path = np.asarray(source_of_pair)[paths.pair]
    for number, source in enumerate(sources):
        if source is None:
            continue
        own = np.flatnonzero(source_of_path == number)
        departure = paths.departure[own].astype(np.float64)
        if isinstance(source, FirstOrder | FirstOrderBands):
            one = source if isinstance(source, FirstOrder) else FirstOrder(source.b[band])
            factors[own] = first_order_factor(one, departure)
        else:
            factors[own] = measured_factor(source, departure, band)
    return factors


def with_directivity(
    paths: Paths, sources: Sequence[Directivity | None], source_of_pair: Sequence[int], band: int
) -> Paths:
    """Return the same paths with the weights that directional sources give them in one band."""
    factors = directivity_factors(paths, sources, source_of_pair, band)
    return replace(paths, weight_per_m2=paths.weight_per_m2 * factors)


def directivity_derivative(
    rows: EnergyRows,
    paths: Paths,
    source: FirstOrder,
    absorption: FloatArray,
    attenuation_per_m: FloatArray,
) -> FloatArray:
    """Return the derivative of window energies by b of the source of one pair.

    Parameters
    ----------
    rows : EnergyRows
        Of that pair, with the weights of an omnidirectional source.
    paths : Paths
        Those that the rows were made from.
    absorption : float array, shape (n_materials, n_bands)
    attenuation_per_m : float array, shape (n_bands,)

    Returns
    -------
    float array, shape (3, n_bands, n_windows)
    """
    slopes = np.zeros((3, len(paths)))
    if rows.path is not None:
        departure = paths.departure[rows.path].astype(np.float64)
        slopes[:, rows.path] = first_order_slope(source, departure).T
    return np.array(
        [
            weigh(
                reweighed_rows(rows, slope), absorption, attenuation_per_m, derivative=False
            ).energy
            for slope in slopes
        ]
    )
