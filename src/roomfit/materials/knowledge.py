"""What is known of a material before anything was measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.checks import float_array
from roomfit.errors import InputError
from roomfit.typing import FloatArray

# A broad prior of absorption: 95 % of it from 0.01 to 0.77.
DEFAULT_MEAN = 0.15
DEFAULT_LOGIT_SD = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class MaterialKnowledge:
    """Beforehand knowledge of one material in every fitted band.

    Attributes
    ----------
    name : str
    scattering : float or None
        Mean scattering coefficient; None where nothing was told.
    known : float array, shape (n_bands,), or None
        Absorption that is held fixed.
    prior_logit_mean, prior_logit_sd : float arrays, shape (n_bands,)
        Gaussian prior of logit absorption.
    lower, upper : float
        Absorption lies strictly between them.
    """

    name: str
    scattering: float | None
    known: FloatArray | None
    prior_logit_mean: FloatArray
    prior_logit_sd: FloatArray
    lower: float = 0.0
    upper: float = 1.0

    def __post_init__(self) -> None:
        where = f"materials.{self.name}"
        if not 0.0 <= self.lower < self.upper <= 1.0:
            raise InputError(
                "lower bound is not below the upper one",
                where=f"{where}.bounds",
                found=f"{self.lower:g} and {self.upper:g}",
                needed="0 <= lower < upper <= 1",
            )
        n = len(self.prior_logit_mean)
        for name in ("prior_logit_mean", "prior_logit_sd"):
            values = float_array(f"{where} {name}", getattr(self, name), (n,))
            object.__setattr__(self, name, values)
        if self.known is not None:
            known = float_array(f"{where}.absorption", self.known, (n,), low=0.0, high=1.0)
            object.__setattr__(self, "known", known)


def logit_prior(mean: FloatArray, sd: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and standard deviation of logit absorption from those of absorption.

    To first order: ``sd_logit = sd / (mean (1 - mean))``.

    Parameters
    ----------
    mean : float array
        0 < mean < 1.
    sd : float array
        Above 0, dimensionless.
    """
    return np.log(mean) - np.log1p(-mean), sd / (mean * (1.0 - mean))


def unknown_material(name: str, n_bands: int) -> MaterialKnowledge:
    """Return what is known of a material nobody told anything about: the broad prior."""
    mean, _ = logit_prior(np.full(n_bands, DEFAULT_MEAN), np.ones(n_bands))
    return MaterialKnowledge(name, None, None, mean, np.full(n_bands, DEFAULT_LOGIT_SD))
