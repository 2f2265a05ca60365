"""What a prediction answers: values with their intervals, pair by pair and in the mean."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from roomfit.base.bands import Bands
from roomfit.base.findings import About, Code, Finding
from roomfit.base.table import Shown
from roomfit.base.typing import BoolArray, FloatArray, ValueName
from roomfit.predict.changes import Change, change_text
from roomfit.signals.decay import FIT_RANGES_DB
from roomfit.signals.measurement import Use

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, eq=False)
class PredictedDecay:
    """Decay curves in dB relative to the whole energy, shape (n_bands, n_times)."""

    time_s: FloatArray  # (n_times,), after emission
    predicted_db: FloatArray
    lower_db: FloatArray  # 95 % of the draws of absorption lie between these two
    upper_db: FloatArray
    measured_db: FloatArray | None = None  # NaN beyond its usable part
    before_db: FloatArray | None = None  # before a change of materials


@dataclass(frozen=True, slots=True, eq=False)
class ValueChange:
    """One room parameter before a change, and what the change does; all of shape (n_bands,)."""

    before: FloatArray  # at the most likely absorption as it was found
    before_lower95: FloatArray  # where a measurement before the change is expected
    before_upper95: FloatArray
    # after over before of EDT, T20 and T30, after minus before of all else; the interval is that of
    # the absorption alone, in which what is common to both cancels
    change: FloatArray
    change_lower95: FloatArray
    change_upper95: FloatArray
    sabine: FloatArray  # a baseline: a decay time after it by Sabine's formula, NaN of all else


# Of an energy: what is known of a level no better than by a factor of 2.
_FACTOR, _FACTOR_DB = 2.0, 3.0103


def is_undetermined(name: str, change: ValueChange) -> BoolArray:
    """Return in which bands not even the sign of a change, or its size by a factor of 2, is known.

    Of decay times, and of levels in dB; of others there is no factor, and nothing is said.
    """
    low, high = change.change_lower95, change.change_upper95
    if name in FIT_RANGES_DB:
        return np.asarray((low < 1.0) & (high > 1.0) & (high > _FACTOR * low))
    return np.asarray((low < 0.0) & (high > 0.0) & (high > low + _FACTOR_DB) & name.endswith("_dB"))


@dataclass(frozen=True, slots=True, eq=False)
class PredictedValue:
    """One room parameter in every band; all arrays of shape (n_bands,), NaN where unknown."""

    predicted: FloatArray  # at the most likely absorption; the interval reaches to it at least
    lower95: FloatArray  # a measurement is expected between these two, 95 of 100 times
    upper95: FloatArray
    sd_absorption: FloatArray  # part of the spread, from what is not known of the absorption
    # part of the spread, from reflections that interfere, from the number of rays, and from the
    # error that the model is granted
    sd_rest: FloatArray
    measured: FloatArray
    # predicted minus measured in just noticeable differences; of a changed room what was predicted
    # before the change, NaN where that is not known
    jnd: FloatArray
    mean_of_others: FloatArray  # over the other fitted measurements: a baseline
    change: ValueChange | None = None  # where materials were changed


@dataclass(frozen=True, slots=True, eq=False)
class PredictedPair:
    """What is predicted between one source and one receiver; twice where it was measured twice."""

    source: str
    receiver: str
    use: Use | None  # of its measurement; None where there is none
    parameters: Mapping[ValueName, PredictedValue]
    decay: PredictedDecay
    sti: PredictedValue | None = None  # shape (1,), where the bands give it


def named_values(
    table: Mapping[ValueName, PredictedValue], sti: PredictedValue | None
) -> dict[str, PredictedValue]:
    """Return parameters by name, the speech transmission index last."""
    named: dict[str, PredictedValue] = {str(name): v for name, v in table.items()}
    return named | ({} if sti is None else {"STI": sti})


@dataclass(frozen=True, slots=True, eq=False)
class Predicted(Shown):
    """Predictions for a room under a given absorption."""

    described_in: ClassVar[str] = "predicted"
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
    sti: PredictedValue | None = None  # as `mean`, of shape (1,), where the bands give it
    # by object, (3, n_bands): equivalent absorption area in m2 and its bounds, changes included
    objects_m2: Mapping[str, FloatArray] = field(default_factory=dict)
    # of the same room, by their names, each with its own changes alone
    variants: Mapping[str, Predicted] = field(default_factory=dict)

    @property
    def compares_states(self) -> bool:
        """Whether the room before the change was predicted, too."""
        return any(v.change is not None for v in self.mean.values())

    def plot(self, pair: int = 0) -> Figure:
        """Return the energy decay curves of one pair, predicted and measured, in every band."""
        chosen = self.pairs[pair]
        figure: Figure = self._called("prediction_figures", "predicted_decay_figure", self, chosen)
        return figure

    def to_dataframe(self) -> Any:
        """Return a pandas data frame of one row a pair, parameter and band, as predicted.csv."""
        from roomfit.base.table import data_frame
        from roomfit.predict.output import predicted_records

        return data_frame(predicted_records(self), "predicted.csv")


# Of a mean one decay time, and the parameters by which a change is described.
_SUMMARY: tuple[tuple[ValueName, ...], ...] = (("T30_s", "T20_s", "EDT_s"), ("C80_dB",), ("G_dB",))


def change_findings(
    changes: Sequence[Change],
    is_measured: bool,
    bands: Bands,
    means: Mapping[ValueName, PredictedValue],
) -> tuple[Finding, ...]:
    """Return what was changed, and in which bands the direction of its effect is determined."""
    if not changes:
        return ()
    sentence = f"Predicted with {', '.join(change_text(c) for c in changes)}."
    if is_measured:
        sentence += " Measured values beside it are those of the room as it was measured."
    directions, in_words = change_directions(bands, means)
    sentence = f"{sentence} {in_words}".rstrip()
    evidence = {"changes": [change_text(c) for c in changes], "directions": directions}
    about = About(materials=[c.material for c in changes])
    return (Finding(Code.MATERIALS_CHANGED, about, sentence, evidence),)


def change_directions(
    bands: Bands, means: Mapping[ValueName, PredictedValue]
) -> tuple[dict[str, dict[str, list[float]]], str]:
    """Return in which bands, Hz, means rise, fall or are not determined, and the same in words."""
    directions: dict[str, dict[str, list[float]]] = {}
    for names in _SUMMARY:
        known = [n for n in names if n in means and np.isfinite(means[n].predicted).any()]
        change = means[known[0]].change if known else None
        if change is not None:
            directions[known[0]] = _directions(bands, change, known[0])
    phrases = [
        f"{name.split('_')[0]} "
        + ", ".join(f"{way} at {', '.join(f'{f:g}' for f in at)} Hz" for way, at in ways.items())
        for name, ways in directions.items()
    ]
    return directions, f"At 95 % the mean of {'; of '.join(phrases)}." if phrases else ""


def _directions(bands: Bands, change: ValueChange, name: ValueName) -> dict[str, list[float]]:
    """Return in which bands a value rises and falls at 95 %, and in which none of it is known."""
    none = 1.0 if name in FIT_RANGES_DB else 0.0
    rises, falls = change.change_lower95 > none, change.change_upper95 < none
    ways = {"rises": rises, "falls": falls, "has no determined direction": ~(rises | falls)}
    known = np.isfinite(change.change)
    found = {way: bands.centres_hz[at & known].tolist() for way, at in ways.items()}
    return {way: at for way, at in found.items() if at}
