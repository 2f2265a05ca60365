"""What is known of a measurement, and what is to be found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.checks import read_only
from roomfit.errors import InputError
from roomfit.impedance.curves import Curve
from roomfit.impedance.model import Nuisances, WaveModel, has_free_spectra
from roomfit.impedance.observed import MODEL_ERROR, Observed
from roomfit.typing import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What is known of a measurement, and what is to be found.

    Attributes
    ----------
    model : WaveModel
    observed : Observed
    sd : float array, shape (n_pairs, n_frequencies)
        From `roomfit.impedance.observed.standard_deviation`.
    curves : tuple of Curve
        One a material.
    nuisances : Nuisances
    spherical : bool
    model_error : float
        With which `sd` was made.
    """

    model: WaveModel
    observed: Observed
    sd: FloatArray
    curves: tuple[Curve, ...]
    nuisances: Nuisances
    spherical: bool = True
    model_error: float = MODEL_ERROR

    def __post_init__(self) -> None:
        n_pairs, n_f = self.observed.pressure.shape
        scene = self.model.scene
        if n_pairs != len(scene.pairs) or n_f != len(self.model.frequency_hz):
            raise InputError(
                "pressures and model disagree",
                found=f"{n_pairs} pairs at {n_f} frequencies",
                needed=f"{len(scene.pairs)} pairs at {len(self.model.frequency_hz)}",
            )
        if len(self.curves) != len(scene.room.materials):
            raise InputError(
                "curves and materials disagree",
                found=f"{len(self.curves)} curves",
                needed=f"one for each of {', '.join(scene.room.materials)}",
            )
        if has_free_spectra(self.nuisances) and not self.observed.has_phase:
            raise InputError(
                "an unknown spectrum of the source needs pressures with phase",
                found="levels",
                hint="take one gain a source instead",
            )
        object.__setattr__(self, "sd", read_only(np.array(self.sd, dtype=np.float64)))
