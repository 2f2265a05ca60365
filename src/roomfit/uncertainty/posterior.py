"""Absorption as it is known after a fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from roomfit.bands import Bands
from roomfit.checks import float_array, unique_names
from roomfit.errors import InputError
from roomfit.materials.knowledge import DEFAULT_LOGIT_SD
from roomfit.typing import FloatArray

_Z95 = 1.959963984540054  # standard normal, 97.5 %
# Logits beyond +-14 mean an absorption within a millionth of 0 or 1.
_SMALLEST = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class AbsorptionPosterior:
    """Absorption of every material in every band, and how sure one can be of it.

    Attributes
    ----------
    materials : tuple of str
    bands : Bands
    absorption, lower95, upper95 : float arrays, shape (n_materials, n_bands)
        0 to 1.
    logit_covariance : float array, shape (n_bands, n_materials, n_materials)
        Of logit absorption. A material with a variance of 0 is held at its absorption.
    prior_logit_mean, prior_logit_sd : float arrays, shape (n_materials, n_bands), or None
        What was known of logit absorption beforehand; it tells the data's part of the covariance.
    scattering : float array, shape (n_materials, n_bands), or None
        What the walls were taken to scatter when the absorption was found.
    directivities : mapping of source to float array, shape (n_bands, 3), or None
        Vectors b of the sources whose first-order directivity was found along with it.
    """

    materials: tuple[str, ...]
    bands: Bands
    absorption: FloatArray
    lower95: FloatArray
    upper95: FloatArray
    logit_covariance: FloatArray
    prior_logit_mean: FloatArray | None = None
    prior_logit_sd: FloatArray | None = None
    scattering: FloatArray | None = None
    directivities: Mapping[str, FloatArray] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "materials", unique_names("material", self.materials))
        n, m = len(self.materials), len(self.bands)
        for name in ("absorption", "lower95", "upper95"):
            values = float_array(name, getattr(self, name), (n, m), low=0.0, high=1.0)
            object.__setattr__(self, name, values)
        limits = {"prior_logit_mean": -50.0, "prior_logit_sd": 0.0, "scattering": 0.0}
        for name, low in limits.items():
            told = getattr(self, name)
            if told is not None:
                high = 1.0 if name == "scattering" else 50.0
                object.__setattr__(self, name, float_array(name, told, (n, m), low=low, high=high))
        covariance = float_array("logit covariance", self.logit_covariance, (m, n, n))
        largest = np.abs(covariance).max(initial=0.0)
        # numbers that went through text or an inversion are symmetric but for rounding
        lowest = min((float(np.linalg.eigvalsh(c)[0]) for c in covariance), default=0.0)
        if not np.allclose(covariance, covariance.transpose(0, 2, 1), atol=1e-6 * largest) or (
            lowest < -1e-6 * max(largest, 1e-12)
        ):
            raise InputError(
                "the covariance of logit absorption is none",
                found=f"smallest eigenvalue {lowest:.3g}",
                needed="a symmetric matrix per band without negative eigenvalues",
            )
        object.__setattr__(self, "logit_covariance", covariance)
        found = {
            name: float_array(f"directivity of {name}", b, (m, 3), low=-1e3, high=1e3)
            for name, b in (self.directivities or {}).items()
        }
        object.__setattr__(self, "directivities", MappingProxyType(found))


def covariance_from_intervals(
    absorption: FloatArray, lower95: FloatArray, upper95: FloatArray
) -> FloatArray:
    """Return a covariance of logit absorption from 95 % intervals alone: independent materials.

    The sides of an interval are averaged in logit; a side at 0 or 1 says nothing. Where neither
    says anything, the spread of the broad prior, 1.5, stands. Without the correlation between
    materials, which a decay determines together, predictions come out less sure than they are.

    Parameters
    ----------
    absorption, lower95, upper95 : float arrays, shape (n_materials, n_bands)

    Returns
    -------
    float array, shape (n_bands, n_materials, n_materials)
    """
    middle = logit(absorption)
    sides = np.array([middle - logit(lower95), logit(upper95) - middle]) / _Z95
    # five digits in a table: what is written as 0.00000 may have been a small interval's end
    told = np.array([lower95 > 0.0, upper95 < 1.0])
    count = told.sum(axis=0)
    mean = np.where(told, sides, 0.0).sum(axis=0) / np.maximum(count, 1)
    sd = np.where(count > 0, np.maximum(mean, 0.0), DEFAULT_LOGIT_SD)
    sd = np.where(lower95 == upper95, 0.0, sd)
    return np.asarray(np.stack([np.diag(column**2) for column in sd.T]))


def logit(absorption: FloatArray) -> FloatArray:
    """Return ``log(a / (1 - a))``, a kept a millionth away from 0 and 1."""
    a = np.clip(absorption, _SMALLEST, 1.0 - _SMALLEST)
    return np.asarray(np.log(a) - np.log1p(-a))


def plain_logit_covariance(
    covariance: FloatArray, absorption: FloatArray, lower: FloatArray, upper: FloatArray
) -> FloatArray:
    """Return the covariance of logit absorption from that of a fit's free numbers.

    With bounds a fit's free number is the logit of ``(a - lower) / (upper - lower)``; to first
    order it is turned into that of absorption itself. Without bounds both are the same.

    Parameters
    ----------
    covariance : float array, shape (n_bands, n_materials, n_materials)
    absorption : float array, shape (n_materials, n_bands)
    lower, upper : float arrays, shape (n_materials,)
        Bounds of each absorption, its leader's where it is tied.
    """
    width = (upper - lower)[:, None]
    share = np.clip((absorption - lower[:, None]) / width, 0.0, 1.0)
    a = np.clip(absorption, _SMALLEST, 1.0 - _SMALLEST)
    plain = ((lower <= 0.0) & (upper >= 1.0))[:, None]
    slope = np.where(plain, 1.0, width * share * (1.0 - share) / (a * (1.0 - a))).T
    return np.asarray(covariance * slope[:, :, None] * slope[:, None, :])
