"""Predicted room parameters of every pair, with intervals, and measured ones beside them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from roomfit.bands import Bands
from roomfit.findings import Finding
from roomfit.signals.iso3382 import ValueName
from roomfit.typing import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PredictedValue:
    """One room parameter in every band; all arrays of shape (n_bands,), NaN where unknown.

    Attributes
    ----------
    predicted : float array
        At the most likely absorption.
    lower95, upper95 : float arrays
        Where a measurement is expected to lie, 95 of 100 times.
    sd_absorption : float array
        Part of the spread that comes from what is not known of the absorption.
    sd_rest : float array
        Part that comes from reflections that interfere, from the number of rays, and from the
        error that the model is granted.
    measured, null, jnd : float arrays
        What was measured; the mean over the other fitted measurements; predicted minus measured in
        just noticeable differences.
    """

    predicted: FloatArray
    lower95: FloatArray
    upper95: FloatArray
    sd_absorption: FloatArray
    sd_rest: FloatArray
    measured: FloatArray
    null: FloatArray
    jnd: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PredictedDecay:
    """Decay curves in dB relative to the whole, shape (n_bands, n_times).

    `lower_db` and `upper_db` hold 95 % of the draws of absorption; `measured_db` is None where
    nothing was measured, NaN beyond its usable part.
    """

    time_s: FloatArray
    predicted_db: FloatArray
    lower_db: FloatArray
    upper_db: FloatArray
    measured_db: FloatArray | None


@dataclass(frozen=True, slots=True, eq=False)
class PredictedPair:
    """What is predicted between one source and one receiver.

    `use` tells whether its measurement was marked "fit" or "validate", and is None where there is
    none. A pair that was measured twice stands here twice.
    """

    source: str
    receiver: str
    use: Literal["fit", "validate"] | None
    parameters: Mapping[ValueName, PredictedValue]
    decay: PredictedDecay


@dataclass(frozen=True, slots=True, eq=False)
class Predicted:
    """Predictions for a room under a given absorption.

    Attributes
    ----------
    bands : Bands
    materials : tuple of str
    absorption, lower95, upper95 : float arrays, shape (n_materials, n_bands)
        What was predicted with, changes included.
    changes : tuple of str
        What was changed, in words.
    pairs : tuple of PredictedPair
    mean : mapping from value name to PredictedValue
        Mean over the pairs, each counted once; what is measured is the mean over those measured.
    findings : tuple of Finding
    n_draws, seed : int
    seconds : float
    """

    bands: Bands
    materials: tuple[str, ...]
    absorption: FloatArray
    lower95: FloatArray
    upper95: FloatArray
    changes: tuple[str, ...]
    pairs: tuple[PredictedPair, ...]
    mean: Mapping[ValueName, PredictedValue]
    findings: tuple[Finding, ...]
    n_draws: int
    seed: int
    seconds: float
