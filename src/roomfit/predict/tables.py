"""Tables of a prediction: intervals, means, what a change does, what is measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy.special import ndtri

from roomfit.base.bands import Bands
from roomfit.base.findings import Finding
from roomfit.base.typing import FloatArray
from roomfit.fit.measurements import observe
from roomfit.predict.decay import PairNumbers
from roomfit.predict.prediction import PredictedDecay, PredictedPair, PredictedValue, ValueChange
from roomfit.room.scene import Scene, pair_names
from roomfit.signals.decay import FIT_RANGES_DB, DecayCurve, in_jnd
from roomfit.signals.iso3382 import VALUE_NAMES, MeasuredValues, ValueName
from roomfit.signals.measurement import Measurement, Use
from roomfit.signals.speech import modulation_transfer, room_sti, sti_missing

# Steps of equal probability by which noise widens every draw.
_STEPS = np.asarray(ndtri((np.arange(16) + 0.5) / 16.0))
_RATIO = "ratio"  # of decay times


@dataclass(frozen=True, slots=True, eq=False)
class ObservedPair:
    """What was measured of a pair."""

    source: str
    receiver: str
    use: Use
    values: FloatArray  # (n_names, n_bands), in the order of VALUE_NAMES, NaN where unknown
    sd: FloatArray  # (n_names, n_bands), stated with the values; 0 where none is
    curve: DecayCurve | None  # None where room parameters were measured and no response
    sti: float = np.nan


def observed_pairs(
    scene: Scene, measurements: Sequence[Measurement | MeasuredValues], bands: Bands
) -> tuple[tuple[ObservedPair, ...], tuple[Finding, ...]]:
    """Return what was measured, responses before tables of values."""
    measured, findings = observe(
        scene, [m for m in measurements if isinstance(m, Measurement)], bands
    )
    found = []
    for m in measured:
        # the level of a measurement is a question of its calibration: G is not read from responses
        values = np.vstack([m.parameters.values, np.full(len(bands), np.nan)])
        own = m.measurement
        found.append(ObservedPair(own.source, own.receiver, own.use, values, 0.0 * values, m.curve))
    for t in measurements:
        if isinstance(t, MeasuredValues):
            findings += t.findings
            values = np.stack([t.at(name, bands.centres_hz) for name in VALUE_NAMES])
            sds = np.nan_to_num([t.spread_at(name, bands.centres_hz) for name in VALUE_NAMES])
            found.append(ObservedPair(t.source, t.receiver, t.use, values, sds, None))
    return tuple(found), findings


def with_sti(
    scene: Scene,
    bands: Bands,
    observed: Sequence[ObservedPair],
    numbers: Sequence[PairNumbers],
    speech_db: FloatArray | None,
) -> tuple[ObservedPair, ...]:
    """Return what was measured with its speech transmission index, at the levels predicted."""
    if sti_missing(bands):
        return tuple(observed)
    pairs = [p[:2] for p in pair_names(scene)]
    found = []
    for o in observed:
        if o.curve is not None:
            strength_db = numbers[pairs.index((o.source, o.receiver))].values[-1]
            index = room_sti(bands, modulation_transfer(o.curve), strength_db, speech_db)
            o = replace(o, sti=float(index))
        found.append(o)
    return tuple(found)


def predicted_pairs(
    scene: Scene,
    bands: Bands,
    numbers: Sequence[Sequence[PairNumbers]],
    observed_pairs: Sequence[ObservedPair],
    expected: Sequence[PairNumbers],
    sabine: FloatArray,
) -> tuple[PredictedPair, ...]:
    """Return every pair of the scene, once for each of its measurements, or once without.

    `expected`: before a change, by other pairs; a measurement stands beside it. `sabine`,
    (n_bands,): `sabine_ratio`.
    """
    found = []
    nothing = np.full((len(VALUE_NAMES), len(bands)), np.nan)
    unknown = np.full((1, 1), np.nan)
    for i, (source, receiver, _) in enumerate(pair_names(scene)):
        states = [of_state[i] for of_state in numbers]
        measured = [m for m in observed_pairs if (m.source, m.receiver) == (source, receiver)]
        rows: list[ObservedPair | None] = [*measured] or [None]
        for m in rows:
            values, mean, index, mean_index = nothing, nothing, unknown, unknown
            if m is not None:
                others = [o for o in observed_pairs if o.use == "fit" and o is not m]
                values, mean = m.values, _mean([o.values for o in others], nothing.shape)
                index = np.full((1, 1), m.sti)
                mean_index = _mean([np.array(o.sti) for o in others], (1, 1))
            use = None if m is None else m.use
            decay = _decay(states[0], m)
            if len(states) > 1:
                decay = replace(decay, before_db=states[1].decay.predicted_db)
            table = _table(VALUE_NAMES, states, values, mean, expected[i].values, sabine)
            of_speech = [n.sti for n in states if n.sti is not None]
            sti = None
            if of_speech:
                own = index, mean_index, of_speech[-1].values, sabine
                sti = _table(("STI",), of_speech, *own)["STI"]
            found.append(PredictedPair(source, receiver, use, table, decay, sti))
    return tuple(found)


def predicted_means(
    scene: Scene,
    numbers: Sequence[Sequence[PairNumbers]],
    observed_pairs: Sequence[ObservedPair],
    expected: Sequence[PairNumbers],
    sabine: FloatArray,
) -> tuple[dict[ValueName, PredictedValue], PredictedValue | None, FloatArray]:
    """Return means over the measured pairs of each band, over all where none was measured.

    And draws of them after the last change, (n_draws, n_names + 1, n_bands): last stands the speech
    transmission index, alike in every band.
    """
    of_pairs = [
        [m for m in observed_pairs if (m.source, m.receiver) == p[:2]] for p in pair_names(scene)
    ]
    shape = numbers[0][0].values.shape
    measured = np.array([_mean([m.values for m in own], shape) for own in of_pairs])
    means, drawn = _mean_table(VALUE_NAMES, (*numbers, expected), measured, sabine)
    of_speech = [[n.sti for n in own if n.sti is not None] for own in (*numbers, expected)]
    sti, index_drawn = None, np.full((len(drawn), 1, 1), np.nan)
    if of_speech[0]:
        index = np.array([_mean([np.array(m.sti) for m in own], (1, 1)) for own in of_pairs])
        table, index_drawn = _mean_table(("STI",), of_speech, index, sabine)
        sti = table["STI"]
    index_drawn = np.broadcast_to(index_drawn, (len(drawn), 1, shape[1]))
    return means, sti, np.concatenate((drawn, index_drawn), axis=1)


def _mean_table(
    names: Sequence[N],
    numbers: Sequence[Sequence[PairNumbers]],
    measured: FloatArray,
    sabine: FloatArray,
) -> tuple[dict[N, PredictedValue], FloatArray]:
    """Return the means of some parameters, and draws; the last numbers are those expected before.

    Shapes: `measured` (n_pairs, n_names, n_bands).
    """
    chosen = np.isfinite(measured)
    for of_state in numbers:
        chosen &= np.isfinite([n.values for n in of_state])
    chosen |= ~chosen.any(axis=0)
    weights = chosen / chosen.sum(axis=0)
    observed = np.where(np.isfinite(measured).any(axis=0), _weighted(weights, measured), np.nan)
    *states, expected = [_mean_numbers(of_state, weights) for of_state in numbers]
    nothing = np.full_like(observed, np.nan)
    return _table(names, states, observed, nothing, expected.values, sabine), states[0].draws


def _mean_numbers(numbers: Sequence[PairNumbers], weights: FloatArray) -> PairNumbers:
    """Return the mean of some pairs: of the room, of which the measured places are a sample."""
    scatter_sd = np.sqrt(_weighted(weights**2, np.array([n.scatter_sd for n in numbers]) ** 2))
    return PairNumbers(
        _weighted(weights, np.array([n.values for n in numbers])),
        _weighted(weights[:, None], np.array([n.draws for n in numbers])),
        scatter_sd,
        numbers[0].decay,
        common_noise=_weighted(weights**2, np.array([n.common_noise for n in numbers])),
        shared_sd=_weighted(weights, np.array([n.shared_sd for n in numbers])),
        scatter_sd=scatter_sd,
    )


def _weighted(weights: FloatArray, values: FloatArray) -> FloatArray:
    """Sum over the first axis; what has no weight may be unknown."""
    return np.asarray(np.where(weights > 0.0, weights * values, 0.0).sum(axis=0))


N = TypeVar("N", bound=str)
K = TypeVar("K")
V = TypeVar("V", PredictedValue, PredictedValue | None)


def _table(
    names: Sequence[N],
    states: Sequence[PairNumbers],
    measured: FloatArray,
    mean_of_others: FloatArray,
    expected: FloatArray,
    sabine: FloatArray,
) -> dict[N, PredictedValue]:
    """Return predictions with their intervals, and what a change does where there are two states.

    Shapes: `measured, mean_of_others, expected` (n_names, n_bands).
    """
    after, table = states[0], {}
    for row, name in enumerate(names):
        rest_sd = np.hypot(after.noise_sd[row], after.shared_sd[row])
        table[name] = PredictedValue(
            after.values[row],
            *_interval(name, after.values[row], after.draws[:, row], rest_sd),
            np.std(after.draws[:, row], axis=0),
            rest_sd,
            measured[row],
            in_jnd(name, measured[row], expected[row]),
            mean_of_others[row],
            _change(name, row, states, sabine) if len(states) > 1 else None,
        )
    return table


def without_jnd(table: Mapping[K, V]) -> dict[K, V]:
    return {
        name: v if v is None else replace(v, jnd=np.full_like(v.jnd, np.nan))
        for name, v in table.items()
    }


def _change(name: str, row: int, states: Sequence[PairNumbers], sabine: FloatArray) -> ValueChange:
    """Return what a change does, draw by draw: what both states have in common is not in it.

    The change is that of a measured value: what interference of both states does not share,
    ``s^2 + t^2 - 2 r s t``, is in its interval.
    """
    (new, drawn_new, t), (old, drawn_old, s) = (
        (n.values[row], n.draws[:, row], n.scatter_sd[row]) for n in states
    )
    before, both = states[1], states[0].common_noise[row]
    with np.errstate(divide="ignore", invalid="ignore"):  # unknown values
        if name in FIT_RANGES_DB:
            kind, change, drawn = _RATIO, new / old, drawn_new / drawn_old
            s, t, both, scale = s / old, t / new, both / (old * new), change
        else:
            kind, change, drawn, scale = "difference", new - old, drawn_new - drawn_old, 1.0
        apart_sd = np.sqrt(np.maximum(s**2 + t**2 - 2.0 * both, 0.0)) * scale
    rest_sd = np.hypot(before.noise_sd[row], before.shared_sd[row])
    return ValueChange(
        old,
        *_interval(name, old, drawn_old, rest_sd),
        change,
        # no direction is said to be determined that the likeliest absorption contradicts
        *_interval(kind, change, drawn, apart_sd),
        old * sabine if name in FIT_RANGES_DB else np.full_like(old, np.nan),
    )


def _interval(
    name: str, likeliest: FloatArray, draws: FloatArray, rest_sd: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the quantiles of all draws, each widened by noise, of shape (n_bands,) each.

    Decay times, and ratios of them, are widened by factors, of the same relative variance: where
    few modes decay that is half of the value, and a sum would reach down to a time of 0.
    """
    steps = _STEPS[:, None] / np.std(_STEPS)
    if name in FIT_RANGES_DB or name == _RATIO:
        with np.errstate(divide="ignore", invalid="ignore"):  # unknown values
            relative = np.log1p((rest_sd / likeliest) ** 2)
        wide = draws[:, None, :] * np.exp(steps * np.sqrt(relative))
    else:
        wide = draws[:, None, :] + steps * rest_sd
    low, high = np.quantile(wide.reshape(-1, rest_sd.size), (0.025, 0.975), axis=0)
    # of several answers that explain the data alike the likeliest may lie aside of most
    low, high = np.minimum(low, likeliest), np.maximum(high, likeliest)
    return np.clip(low, *_range(name)), np.clip(high, *_range(name))


def _range(name: str) -> tuple[float, float]:
    """Return the least and the most that a room parameter can be."""
    most = {"D50_percent": 100.0, "STI": 1.0}.get(name, np.inf)
    return 0.0 if name in FIT_RANGES_DB or np.isfinite(most) else -np.inf, most


def _mean(rows: Sequence[FloatArray], shape: tuple[int, ...]) -> FloatArray:
    """Return the mean of what is known, NaN where nothing is."""
    stacked = np.array(rows, dtype=np.float64).reshape(-1, *shape)
    known = np.isfinite(stacked)
    with np.errstate(invalid="ignore"):  # nothing is known
        return np.asarray(np.where(known, stacked, 0.0).sum(axis=0) / known.sum(axis=0))


def _decay(own: PairNumbers, m: ObservedPair | None) -> PredictedDecay:
    if m is None or m.curve is None:
        return own.decay
    usable = own.decay.time_s <= m.curve.usable_end_s[:, None]
    measured = np.where(usable, m.curve.levels_db(own.decay.time_s), np.nan)
    return replace(own.decay, measured_db=measured)
