"""What a prediction answers: one sentence, a picture of the decay time, four figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from roomfit.base.bands import Bands
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.predict.tables import PredictedValue, is_undetermined
from roomfit.report.decay_times import (
    MID_HZ,
    Limit,
    Series,
    decay_time_figure,
    mid_words,
    with_interval,
)
from roomfit.report.wording import decay_time_key, number, parameter
from roomfit.signals.decay import jnd_of


@dataclass(frozen=True, slots=True, eq=False)
class DecayAnswer:
    """The decay time of a prediction, before and after a change or beside what was measured."""

    bands: Bands
    symbol: str  # T30, or what is known in its place
    before: Series | None  # as it is: measured, or by the model; None where neither is known
    after: Series  # predicted; of a change what was measured before, carried over
    is_changed: bool
    # why a change is not determined, as "prior alone"; "" where it is
    open_because: str = ""
    is_determined: bool = True  # whether it rises or falls, at 95 %

    @property
    def sentence(self) -> str:
        """The answer in a sentence, of the mean at mid frequencies."""
        centres = self.bands.centres_hz
        after = with_interval(*self.after.mid_s(centres))
        what = f"{self.symbol} at {mid_words(centres)}"
        if self.before is None:
            return f"{what} is predicted as {after}."
        value, low, high = self.before.mid_s(centres)
        label = self.before.label.removesuffix(" before")
        if not self.is_changed:
            return f"{what} is predicted as {after}; {label} {number(value, 2)} s."
        if np.isfinite([low, high]).all():
            label += f", {number(low, 2)} to {number(high, 2)}"
        if self.open_because:
            return (
                f"{what} is {number(value, 2)} s ({label}); what the change does to it is not "
                f"determined ({self.open_because})."
            )
        moved = self.after.mid_s(centres)[0] - value
        if abs(moved) < 0.005:
            return f"{what} stays at {number(value, 2)} s ({label}): {after} after the change."
        way = "falls" if moved < 0.0 else "rises"
        if self.is_determined:
            return f"{what} {way} from {number(value, 2)} s ({label}) to {after}."
        return (
            f"{what} is {number(value, 2)} s ({label}), and {after} is expected after the change; "
            f"whether it {way} is not determined."
        )

    @property
    def figures(self) -> list[tuple[str, str]]:
        """The time as it is, the time after, and by how much it moves."""
        centres = self.bands.centres_hz
        after = self.after.mid_s(centres)
        where = f"{self.symbol} at {mid_words(centres)}"
        if self.before is None:
            return [_figure(f"{where}, predicted", *after)]
        before = self.before.mid_s(centres)
        shown = [_figure(f"{where}, {self.before.label}", *before)]
        if self.open_because:
            return [*shown, ("not determined", f"{where}, {self.after.label}: {self.open_because}")]
        shown.append(_figure(f"{where}, {self.after.label}", *after))
        steps = (after[0] - before[0]) / float(jnd_of("T30_s", np.array(before[0])))
        change = f"{number(100.0 * (after[0] / before[0] - 1.0), 0, signed=True)} %"
        words = f"{number(abs(steps), 1)} just noticeable differences"
        return [
            *shown,
            (change, words if self.is_changed else f"beside what was measured: {words}"),
        ]

    def figure(self, limits: Sequence[Limit] = ()) -> Figure:
        """Return the decay time over frequency, with limits where there are some."""
        series = [s for s in (self.before, self.after) if s is not None]
        return decay_time_figure(self.bands.centres_hz, series, self.symbol, limits)


def _figure(words: str, value: float, low: float, high: float) -> tuple[str, str]:
    """Return a number, and what it is with its interval."""
    if np.isfinite([low, high]).all():
        words += f"; {number(low, 2)} to {number(high, 2)} s at 95 %"
    return f"{number(value, 2)} s", words


def decay_answer(
    bands: Bands,
    means: Mapping[str, PredictedValue],
    *,
    is_changed: bool,
    before: str = "",
    after: str = "after the change",
    open_for: Sequence[str] = (),
) -> DecayAnswer | None:
    """Return the answer of a table of means; None where it has no decay time."""
    known = [name for name, v in means.items() if np.isfinite(v.predicted).any()]
    # T30 is what a client asks for
    name = "T30_s" if "T30_s" in known else decay_time_key(known)
    if name is None:
        return None
    v, symbol = means[name], parameter(name).symbol
    measured, is_measured = v.measured, np.isfinite(v.measured)
    if not is_changed:
        own = Series("measured", measured) if is_measured.any() else None
        predicted = Series("predicted", v.predicted, v.lower95, v.upper95)
        return DecayAnswer(bands, symbol, own, predicted, is_changed)
    if v.change is None:
        later = Series(after, v.predicted, v.lower95, v.upper95)
        return DecayAnswer(bands, symbol, None, later, is_changed)
    c = v.change
    is_carried = np.isfinite(c.carried)
    values, low, high = (
        np.where(is_carried, own, model)
        for own, model in (
            (c.carried, v.predicted),
            (c.carried_lower95, v.lower95),
            (c.carried_upper95, v.upper95),
        )
    )
    # where a measured mean has an interval of its own, it stands in place of a model's
    is_alone = is_measured & (c.before != measured)
    first = "measured before" if is_measured.all() else "predicted before"
    if is_measured.any() and not is_measured.all():
        first = "before, measured where it was"
    earlier = Series(
        before or first,
        np.where(is_measured, measured, c.before),
        np.where(is_alone, np.nan, c.before_lower95),
        np.where(is_alone, np.nan, c.before_upper95),
    )
    why = _open_because(bands.centres_hz, is_undetermined(name, c), open_for)
    later = Series(after, values, low, high)
    _, least, most = Series("", c.change, c.change_lower95, c.change_upper95).mid_s(
        bands.centres_hz
    )
    # without an interval, the likeliest is all that is known
    return DecayAnswer(bands, symbol, earlier, later, is_changed, why, not least <= 1.0 <= most)


def _open_because(centres_hz: FloatArray, unknown: BoolArray, open_for: Sequence[str]) -> str:
    """Return why a change is not determined in a band that the mid frequencies are made of."""
    mid = np.isin(centres_hz, MID_HZ)
    each = zip(open_for, unknown & (mid if mid.any() else True), strict=False)
    return next((why for why, is_open in each if why and is_open), "")
