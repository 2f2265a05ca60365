"""Predictions and measurements side by side: intervals from draws and noise, pairs, means."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from roomfit.app.predicting.pair import RELATIVE, PairNumbers
from roomfit.app.predicting.scene import Seen
from roomfit.app.values import MODEL_ERROR_JND
from roomfit.bands import Bands
from roomfit.scene.scene import Scene
from roomfit.signals.decay import DecayCurve, decay_curve_db
from roomfit.signals.jnd import in_jnd, jnd_of
from roomfit.signals.parameter_gradients import VALUE_NAMES, ValueName
from roomfit.typing import FloatArray
from roomfit.uncertainty.prediction import PredictedDecay, PredictedPair, PredictedValue

# Steps of equal probability by which noise widens every draw.
_STEPS = np.asarray(ndtri((np.arange(16) + 0.5) / 16.0))


@dataclass(frozen=True, slots=True, eq=False)
class _Spread:
    """Values and their draws, shape (n_draws, n_bands), with two kinds of noise, (n_bands,)."""

    values: FloatArray
    draws: FloatArray
    noise_sd: FloatArray
    model_sd: FloatArray


def predicted_pairs(
    scene: Scene, bands: Bands, numbers: Sequence[PairNumbers], seen: Sequence[Seen]
) -> tuple[PredictedPair, ...]:
    """Return every pair of the scene, once for each of its measurements, or once without."""
    found = []
    for (s, r), own in zip(scene.pairs, numbers, strict=True):
        names = (scene.sources[s].name, scene.receivers[r].name)
        measured = [m for m in seen if (m.source, m.receiver) == names]
        rows: list[Seen | None] = [*measured] or [None]
        for m in rows:
            table: dict[ValueName, PredictedValue] = {}
            for row, name in enumerate(VALUE_NAMES):
                others = [o.values[row] for o in seen if o.use == "fit" and o is not m]
                nothing = np.full(len(bands), np.nan)
                values = nothing if m is None else m.values[row]
                null = nothing if m is None else _mean(others, len(bands))
                table[name] = _value(name, _spread(own, row, name), values, null)
            use = None if m is None else m.use
            found.append(PredictedPair(*names, use, table, _decay(own, m)))
    return tuple(found)


def predicted_means(
    scene: Scene, bands: Bands, numbers: Sequence[PairNumbers], seen: Sequence[Seen]
) -> dict[ValueName, PredictedValue]:
    """Return means over the measured pairs of each band, over all where none was measured."""
    index = {
        (scene.sources[s].name, scene.receivers[r].name): i for i, (s, r) in enumerate(scene.pairs)
    }
    table: dict[ValueName, PredictedValue] = {}
    for row, name in enumerate(VALUE_NAMES):
        measured = np.full((len(numbers), len(bands)), np.nan)
        for i in range(len(numbers)):
            own = [m.values[row] for m in seen if index[m.source, m.receiver] == i]
            measured[i] = _mean(own, len(bands))
        spreads = [_spread(n, row, name) for n in numbers]
        chosen = np.isfinite(measured) & np.isfinite([s.values for s in spreads])
        chosen |= ~chosen.any(axis=0)
        weights = chosen / chosen.sum(axis=0)
        whole = _Spread(
            _weighted(weights, np.array([s.values for s in spreads])),
            _weighted(weights[:, None], np.array([s.draws for s in spreads])),
            np.sqrt(_weighted(weights**2, np.array([s.noise_sd for s in spreads]) ** 2)),
            # the model is wrong in the same way everywhere
            _weighted(weights, np.array([s.model_sd for s in spreads])),
        )
        observed = np.where(np.isfinite(measured).any(axis=0), _weighted(weights, measured), np.nan)
        table[name] = _value(name, whole, observed, np.full(len(bands), np.nan))
    return table


def _weighted(weights: FloatArray, values: FloatArray) -> FloatArray:
    """Sum over the first axis; what has no weight may be unknown."""
    return np.asarray(np.where(weights > 0.0, weights * values, 0.0).sum(axis=0))


def _spread(own: PairNumbers, row: int, name: ValueName) -> _Spread:
    values = own.values[row]
    return _Spread(
        values, own.draws[:, row], own.noise_sd[row], MODEL_ERROR_JND * jnd_of(name, values)
    )


def _value(
    name: ValueName, spread: _Spread, measured: FloatArray, null: FloatArray
) -> PredictedValue:
    """Return a prediction with its interval: the quantiles of all draws, each widened by noise."""
    rest = np.hypot(spread.noise_sd, spread.model_sd)
    wide = spread.draws[:, None, :] + _STEPS[:, None] * rest / np.std(_STEPS)
    low, high = np.quantile(wide.reshape(-1, rest.size), (0.025, 0.975), axis=0)
    if RELATIVE[VALUE_NAMES.index(name)]:
        low = np.maximum(low, 0.0)
    if name == "D50_percent":
        low, high = np.clip(low, 0.0, 100.0), np.clip(high, 0.0, 100.0)
    return PredictedValue(
        spread.values,
        low,
        high,
        np.std(spread.draws, axis=0),
        rest,
        measured,
        null,
        in_jnd(name, measured, spread.values),
    )


def _mean(rows: Sequence[FloatArray], n_bands: int) -> FloatArray:
    """Return the mean of what is known, NaN where nothing is."""
    stacked = np.ma.masked_invalid(np.array(rows).reshape(-1, n_bands))
    return np.asarray(np.ma.filled(stacked.mean(axis=0), np.nan), dtype=np.float64)


def _decay(own: PairNumbers, m: Seen | None) -> PredictedDecay:
    measured = None if m is None or m.curve is None else _at(own.time_s, m.curve)
    return PredictedDecay(own.time_s, own.decay_db, own.lower_db, own.upper_db, measured)


def _at(times: FloatArray, curve: DecayCurve) -> FloatArray:
    """Return measured levels at given times, NaN after their usable end."""
    levels = np.maximum(decay_curve_db(curve), -200.0)
    rows = [
        np.where(times <= end_s, np.interp(times, curve.time_s, row), np.nan)
        for row, end_s in zip(levels, curve.usable_end_s, strict=True)
    ]
    return np.stack(rows)
