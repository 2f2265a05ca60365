"""Use case: what would be measured in a room, between any two points, with any walls.

Predictions and measurements side by side: intervals from draws and noise, pairs, means.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from roomfit._numba import one_blas_thread
from roomfit.bands import Bands
from roomfit.cache import Cache, cached
from roomfit.findings import Code, Finding
from roomfit.io.campaign import Campaign
from roomfit.io.materials import material_priors
from roomfit.io.rooms import read_room
from roomfit.materials.priors import in_bands
from roomfit.objective.room_parameters import MODEL_ERROR_JND
from roomfit.prediction.pair import RELATIVE, PairNumbers, pair_numbers
from roomfit.prediction.prediction import Predicted, PredictedDecay, PredictedPair, PredictedValue
from roomfit.prediction.setup import (
    Change,
    ObservedPair,
    PairChoice,
    change_text,
    changed_draws,
    directed_as_found,
    follow_decay,
    observed_pairs,
    predicted_bands,
    prediction_scene,
    room_posterior,
    with_fitted_scattering,
)
from roomfit.scene import Scene
from roomfit.signals.decay import DecayCurve, decay_curve_db, in_jnd, jnd_of
from roomfit.signals.iso3382 import VALUE_NAMES, ValueName
from roomfit.typing import FloatArray, Progress, part
from roomfit.uncertainty.posterior import AbsorptionPosterior, draw_absorption

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
    scene: Scene,
    bands: Bands,
    numbers: Sequence[PairNumbers],
    observed_pairs: Sequence[ObservedPair],
) -> tuple[PredictedPair, ...]:
    """Return every pair of the scene, once for each of its measurements, or once without."""
    found = []
    for (s, r), own in zip(scene.pairs, numbers, strict=True):
        names = (scene.sources[s].name, scene.receivers[r].name)
        measured = [m for m in observed_pairs if (m.source, m.receiver) == names]
        rows: list[ObservedPair | None] = [*measured] or [None]
        for m in rows:
            table: dict[ValueName, PredictedValue] = {}
            for row, name in enumerate(VALUE_NAMES):
                others = [o.values[row] for o in observed_pairs if o.use == "fit" and o is not m]
                nothing = np.full(len(bands), np.nan)
                values = nothing if m is None else m.values[row]
                null = nothing if m is None else _mean(others, len(bands))
                table[name] = _value(name, _spread(own, row, name), values, null)
            use = None if m is None else m.use
            found.append(PredictedPair(*names, use, table, _decay(own, m)))
    return tuple(found)


def predicted_means(
    scene: Scene,
    bands: Bands,
    numbers: Sequence[PairNumbers],
    observed_pairs: Sequence[ObservedPair],
) -> dict[ValueName, PredictedValue]:
    """Return means over the measured pairs of each band, over all where none was measured."""
    index = {
        (scene.sources[s].name, scene.receivers[r].name): i for i, (s, r) in enumerate(scene.pairs)
    }
    table: dict[ValueName, PredictedValue] = {}
    for row, name in enumerate(VALUE_NAMES):
        measured = np.full((len(numbers), len(bands)), np.nan)
        for i in range(len(numbers)):
            own = [m.values[row] for m in observed_pairs if index[m.source, m.receiver] == i]
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


def _decay(own: PairNumbers, m: ObservedPair | None) -> PredictedDecay:
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


N_DRAWS = 128


@one_blas_thread
def predict_campaign(
    campaign: Campaign,
    absorption: AbsorptionPosterior,
    changes: Sequence[Change] = (),
    *,
    pairs: PairChoice = "all",
    n_draws: int = N_DRAWS,
    cache: Cache | None = None,
    progress: Progress | None = None,
) -> Predicted:
    """Predict the room parameters of every pair, with 95 % intervals.

    The room is traced once; draws of the absorption weigh the same paths. An interval is where a
    measurement is expected: it holds what is not known of the absorption, reflections that
    interfere, the number of rays, and half a just noticeable difference for the model. It holds no
    error of positions or of the geometry, and no spread of scattering or of the air.

    Parameters
    ----------
    campaign : Campaign
        Of the room to predict, which need not be the room in which the absorption was found.
        Nothing in it is fitted.
    absorption : AbsorptionPosterior
        From `roomfit.io.results.read_result`; materials are matched by name.
    changes : sequence of Change
        What if: materials with another absorption.
    pairs : {"all", "campaign"}
        Every source with every receiver, or those that were measured.
    n_draws : int
    cache : Cache, optional
        Keeps the trace and the numbers of every finished pair.
    progress : callable, optional

    Raises
    ------
    InputError
        Materials without absorption, no common band, a change that cannot be made, positions in
        walls, or files that cannot be read.
    """
    began = time.perf_counter()
    room, findings = read_room(campaign.room)
    bands, doubts = predicted_bands(campaign, absorption.bands)
    campaign, sources = directed_as_found(campaign, bands, absorption)
    band_indices = np.flatnonzero(np.isin(campaign.bands.centres_hz, bands.centres_hz))
    specified_priors = in_bands(material_priors(campaign, room.materials), band_indices)
    priors = with_fitted_scattering(specified_priors, bands, absorption)
    replaced = [c.material for c in changes if c.kind != "factor"]
    posterior = room_posterior(campaign, priors, bands, absorption, replaced)
    rng = np.random.default_rng(campaign.seed)
    drawn = draw_absorption(posterior, n_draws, rng)
    expected, drawn, clipped = changed_draws(posterior, drawn, changes, rng)
    scene = prediction_scene(campaign, room, pairs)
    observed, measured_findings = observed_pairs(campaign, bands, scene)
    followed = follow_decay(
        *(campaign, scene, bands, priors, expected, _longest_s(observed)),
        *(cache, part(progress, 0.02, 0.5)),
    )
    numbers: list[PairNumbers] = []
    cache_findings: list[Finding] = []
    for i in range(len(scene.pairs)):
        one = cached(
            cache,
            "pair",
            (scene, followed.settings, followed.weighing, bands, i, expected, drawn),
            lambda i=i: pair_numbers(scene, bands, followed.binned, i, expected, drawn),  # type: ignore[misc]
            (PairNumbers,),
        )
        numbers.append(one.value)
        cache_findings += one.findings
        if progress is not None:
            progress(0.5 + 0.5 * (i + 1) / len(scene.pairs))
    changed = [c.material for c in changes]
    lower, upper = _absorption_interval(posterior, drawn, changed)
    return Predicted(
        bands,
        room.materials,
        expected,
        lower,
        upper,
        tuple(change_text(c) for c in changes),
        predicted_pairs(scene, bands, numbers, observed),
        predicted_means(scene, bands, numbers, observed),
        (
            *(*findings, *doubts, *sources, *clipped, *measured_findings, *followed.findings),
            *(*cache_findings, *_what_if(changes, observed)),
        ),
        len(drawn),
        campaign.seed,
        time.perf_counter() - began,
    )


def _longest_s(observed: Sequence[ObservedPair]) -> float:
    """Return the longest measured decay time, T20 or T30, 0 where none is known."""
    rows = [VALUE_NAMES.index("T20_s"), VALUE_NAMES.index("T30_s")]
    known = [s.values[rows][np.isfinite(s.values[rows])] for s in observed]
    return max((float(k.max()) for k in known if k.size), default=0.0)


def _absorption_interval(
    posterior: AbsorptionPosterior, drawn: FloatArray, changed: Sequence[str]
) -> tuple[FloatArray, FloatArray]:
    lower, upper = posterior.lower95.copy(), posterior.upper95.copy()
    rows = [posterior.materials.index(name) for name in changed]
    lower[rows], upper[rows] = np.quantile(drawn[:, rows], (0.025, 0.975), axis=0)
    return lower, upper


def _what_if(changes: Sequence[Change], observed: Sequence[ObservedPair]) -> tuple[Finding, ...]:
    if not changes:
        return ()
    listed = ", ".join(change_text(c) for c in changes)
    beside = (
        " Measured values beside it are those of the room as it was measured." if observed else ""
    )
    return (
        Finding(
            Code.MATERIALS_CHANGED,
            f"Predicted with {listed}.{beside}",
            {"changes": [change_text(c) for c in changes]},
        ),
    )
