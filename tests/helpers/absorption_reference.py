"""The energy absorption coefficient, defined once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.base.arguments import read_only, unique_names
from roomfit.base.bands import Bands
from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Absorption:
    """Energy absorption coefficients of every material in every band.

    Absorption is energy: a wall of absorption a reflects the fraction 1 - a of the energy and
    ``sqrt(1 - a)`` of the pressure amplitude.

    Attributes
    ----------
    materials : tuple of str
    bands : Bands
    coefficients : float array, shape (n_materials, n_bands)
        0 <= a <= 1, dimensionless.
    """

    materials: tuple[str, ...]
    bands: Bands
    coefficients: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "materials", unique_names("material", self.materials))
        a = np.array(self.coefficients, dtype=np.float64)
        expected = (len(self.materials), len(self.bands))
        if a.shape != expected:
            raise InputError(
                "absorption table has the wrong shape",
                found=f"{a.shape}",
                needed=f"{expected}: one row per material, one column per band",
                hint="transpose the table, or name the missing materials",
            )
        bad = np.argwhere(~((a >= 0.0) & (a <= 1.0)))  # written so that nan is bad, too
        if bad.size:
            material, band = (int(i) for i in bad[0])
            raise InputError(
                "absorption coefficient out of range",
                found=f"{a[material, band]:g} for material {self.materials[material]!r} "
                f"at {self.bands.centres_hz[band]:g} Hz",
                needed="0 <= a <= 1 (energy, dimensionless)",
                hint="if these are percentages, divide by 100",
            )
        object.__setattr__(self, "coefficients", read_only(a))


def amplitude_reflection(coefficients: FloatArray) -> FloatArray:
    """Return the pressure amplitude ``sqrt(1 - a)`` that walls of absorption a reflect.

    Examples
    --------
    >>> float(amplitude_reflection(np.array(0.75)))
    0.5
    """
    return np.asarray(np.sqrt(1.0 - np.asarray(coefficients, dtype=np.float64)))


def surviving_energy(hits: IntArray, coefficients: FloatArray) -> FloatArray:
    """Return the fraction of each path's energy left after all its wall hits.

    The readable form of what the compiled kernels of `roomfit.model` do; they are tested
    against it. Air and spherical spreading are separate factors.

    Parameters
    ----------
    hits : int array, shape (n_paths, n_materials)
        How often each path strikes each material.
    coefficients : float array, shape (n_materials, n_bands)
        Energy absorption, 0 to 1.

    Returns
    -------
    float array, shape (n_paths, n_bands)
        Dimensionless, 0 to 1: ``(1 - a) ** hits`` multiplied over materials [1]_.

    References
    ----------
    .. [1] C. F. Eyring, "Reverberation time in 'dead' rooms", J. Acoust. Soc. Am. 1,
           217-241 (1930).

    Examples
    --------
    Two hits on a wall that swallows half leave a quarter.

    >>> surviving_energy(np.array([[2]]), np.array([[0.5]]))
    array([[0.25]])
    """
    # a = 1 leaves nothing after one hit and everything after none: 0 ** 0 is 1 here
    return np.asarray(np.prod((1.0 - coefficients) ** hits[:, :, None], axis=1))
