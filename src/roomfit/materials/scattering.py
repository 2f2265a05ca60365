"""The scattering coefficient of walls: what a trace must know, apart from absorption."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.checks import float_array, unique_names
from roomfit.errors import InputError
from roomfit.typing import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Scattering:
    """Sampling scattering coefficient of every material.

    A ray that strikes a material leaves it in a direction drawn from Lambert's law with
    probability s and specularly otherwise. Nothing is lost: after n hits a ray has the energy
    ``(1 - a) ** n`` for every s.

    Attributes
    ----------
    materials : tuple of str
    coefficients : float array, shape (n_materials,)
        0 <= s <= 1, dimensionless (ISO 17497-1: the share of reflected energy that does not leave
        specularly).
    """

    materials: tuple[str, ...]
    coefficients: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "materials", unique_names("material", self.materials))
        s = float_array(
            "scattering coefficient", self.coefficients, (len(self.materials),), low=0.0, high=1.0
        )
        object.__setattr__(self, "coefficients", s)


def uniform_scattering(materials: tuple[str, ...], coefficient: float) -> Scattering:
    """Return the same scattering coefficient for every material."""
    return Scattering(materials, [coefficient] * len(materials))  # type: ignore[arg-type]


def coefficients_in_order(scattering: Scattering, materials: tuple[str, ...]) -> FloatArray:
    """Return a copy of the coefficients in the order of a room's materials, shape (n_materials,).

    Raises
    ------
    InputError
        The two name different materials.
    """
    if set(scattering.materials) != set(materials):
        raise InputError(
            "scattering and room name different materials",
            found=", ".join(scattering.materials),
            needed=", ".join(materials),
        )
    order = [scattering.materials.index(m) for m in materials]
    return np.array(scattering.coefficients[order])
