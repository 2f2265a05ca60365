"""What an identification of impedances comes to."""

from __future__ import annotations

from dataclasses import dataclass

from roomfit.findings import Finding
from roomfit.impedance.intervals import MaterialAnswer
from roomfit.impedance.verdict import Verdict
from roomfit.typing import ComplexArray, FloatArray


@dataclass(frozen=True, slots=True)
class FoundNuisance:
    """Something about the measurement that was found together with the walls.

    Attributes
    ----------
    name : str
        Such as "x of LS1" or "speed of sound".
    unit : str
    value, lower95, upper95 : float
        With its 95 % interval; moves are from the told position.
    prior_sd : float
        What was allowed beforehand, in the same unit.
    """

    name: str
    unit: str
    value: float
    lower95: float
    upper95: float
    prior_sd: float


@dataclass(frozen=True, slots=True, eq=False)
class ImpedanceAnswer:
    """The walls of a room, and how far to trust what is said of them.

    Attributes
    ----------
    frequency_hz : float array, shape (n_frequencies,)
    tau_s : float
    materials : tuple of MaterialAnswer
    verdict : Verdict
    findings : tuple of Finding
    nuisances : tuple of FoundNuisance
    chi2 : float
        Sum of squared residuals over what noise and model error explain; 1 and less is good. nan
        where nothing was fitted.
    model_error : float
        rms error of the image model in this room by the residual, relative to the level, times
        wavenumber and mean free path. nan where nothing was fitted.
    condition : float
        Of the walls' unknowns: largest over smallest singular value of the weighted Jacobian, what
        nuisances explain taken out. nan where nothing was fitted.
    agreeing_starts, n_starts : int
        How many starts led to the lowest minimum, of how many.
    pairs : tuple of (source, receiver)
    measured, predicted : complex arrays, shape (n_pairs, n_frequencies)
        Gains and delays are in the prediction.
    expected_rms : float array, shape (n_pairs, n_frequencies)
        rms by which a perfect fit still misses: noise and the model's own error.
    ending : str
    evaluations, rounds : int
    seconds : float
    seed : int or None
    """

    frequency_hz: FloatArray
    tau_s: float
    materials: tuple[MaterialAnswer, ...]
    verdict: Verdict
    findings: tuple[Finding, ...]
    nuisances: tuple[FoundNuisance, ...]
    chi2: float
    model_error: float
    condition: float
    agreeing_starts: int
    n_starts: int
    pairs: tuple[tuple[str, str], ...]
    measured: ComplexArray
    predicted: ComplexArray
    expected_rms: FloatArray
    ending: str
    evaluations: int
    rounds: int
    seconds: float
    seed: int | None = None
