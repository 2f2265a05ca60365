"""Predicted room parameters of every pair, with intervals, and measured ones beside them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from roomfit.bands import Bands
from roomfit.findings import Finding
from roomfit.signals.iso3382 import ValueName
from roomfit.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Use = Literal["fit", "validate"]


@dataclass(frozen=True, slots=True, eq=False)
class PredictedValue:
    """One room parameter in every band; all arrays of shape (n_bands,), NaN where unknown."""

    predicted: FloatArray  # at the most likely absorption
    lower95: FloatArray  # a measurement is expected between these two, 95 of 100 times
    upper95: FloatArray
    sd_absorption: FloatArray  # part of the spread, from what is not known of the absorption
    # part of the spread, from reflections that interfere, from the number of rays, and from the
    # error that the model is granted
    sd_rest: FloatArray
    measured: FloatArray
    mean_of_others: FloatArray  # over the other fitted measurements: a baseline
    jnd: FloatArray  # predicted minus measured in just noticeable differences


@dataclass(frozen=True, slots=True, eq=False)
class PredictedDecay:
    """Decay curves in dB relative to the whole energy, shape (n_bands, n_times)."""

    time_s: FloatArray  # (n_times,), after emission
    predicted_db: FloatArray
    lower_db: FloatArray  # 95 % of the draws of absorption lie between these two
    upper_db: FloatArray
    measured_db: FloatArray | None  # NaN beyond its usable part


@dataclass(frozen=True, slots=True, eq=False)
class PredictedPair:
    """What is predicted between one source and one receiver; twice where it was measured twice."""

    source: str
    receiver: str
    use: Use | None  # of its measurement; None where there is none
    parameters: Mapping[ValueName, PredictedValue]
    decay: PredictedDecay


@dataclass(frozen=True, slots=True, eq=False)
class Predicted:
    """Predictions for a room under a given absorption."""

    bands: Bands
    materials: tuple[str, ...]
    absorption: FloatArray  # (n_materials, n_bands), changes included, as the two bounds
    lower95: FloatArray
    upper95: FloatArray
    changes: tuple[str, ...]  # in words
    pairs: tuple[PredictedPair, ...]
    # over the pairs, each counted once; over those measured, where some are
    mean: Mapping[ValueName, PredictedValue]
    findings: tuple[Finding, ...]
    n_draws: int
    seed: int
    seconds: float

    def __str__(self) -> str:
        """Return the mean over the pairs, every pair, and all findings."""
        from roomfit.prediction.output import predict_text

        return predict_text(self)

    def _repr_html_(self) -> str:
        """Return the mean over the pairs and all findings in HTML, for notebooks."""
        from roomfit.prediction.output import predicted_html

        return predicted_html(self)

    def plot(self, pair: int = 0) -> Figure:
        """Return the energy decay curves of one pair, predicted and measured, in every band.

        Parameters
        ----------
        pair : int
            Index into `pairs`.
        """
        from roomfit.prediction.output import predicted_decay_figure

        return predicted_decay_figure(self, self.pairs[pair])

    def to_dataframe(self) -> Any:
        """Return a pandas data frame of one row a pair, parameter and band, as predicted.csv.

        Raises
        ------
        InputError
            pandas, on which roomfit does not depend, is not installed.
        """
        from roomfit.prediction.output import COLUMNS, predicted_rows
        from roomfit.report.frames import data_frame

        rows = ((*texts, *values) for texts, values in predicted_rows(self))
        return data_frame(COLUMNS, rows, "predicted.csv")
