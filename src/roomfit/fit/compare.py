"""Predictions beside measurements and beside what one would guess without a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from roomfit.base.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import Bands
from roomfit.base.forks import in_forks
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.fit.measurements import Measurements
from roomfit.model.binned import BinnedPaths, pair_energies
from roomfit.model.eyring import diffuse_values
from roomfit.model.observation import spread_over_time
from roomfit.model.pulses import interference
from roomfit.model.room_parameters import predicted_values
from roomfit.result import Compared, ComparedPair, Decay
from roomfit.room.mesh import volume_m3
from roomfit.room.scene import Scene, distances_m, pair_names
from roomfit.signals import decay
from roomfit.signals.iso3382 import VALUE_NAMES, MeasuredValues, ValueName
from roomfit.signals.measurement import MeasuredPair


def compared_values(
    measured: Sequence[MeasuredValues],
    predicted: Sequence[FloatArray],
    fitted: Sequence[MeasuredValues],
    bands: Bands,
    names: Sequence[ValueName] = VALUE_NAMES,
) -> tuple[dict[str, Compared], ...]:
    """Return measured, predicted and null value of every pair, of parameters that were measured."""
    tables = []
    for m, row in zip(measured, predicted, strict=True):
        table: dict[str, Compared] = {}
        for name, values in zip(names, row, strict=True):
            found = m.at(name, bands.centres_hz)
            if not np.isfinite(found).any():
                continue
            others = np.array([o.at(name, bands.centres_hz) for o in fitted if o is not m])
            null = _mean_of_known(others.reshape(-1, len(bands)))
            table[name] = Compared(found, values, null, decay.in_jnd(name, found, values))
        tables.append(table)
    return tuple(tables)


def _mean_of_known(values: FloatArray) -> FloatArray:
    known = np.isfinite(values)
    counts = known.sum(axis=0)
    sums = np.where(known, values, 0.0).sum(axis=0)
    return np.asarray(np.where(counts > 0, sums / np.maximum(counts, 1), np.nan))


_PICTURE_STEP_S = 2e-3


def compare_all(
    measurements: Measurements,
    binned: BinnedPaths,
    absorption: FloatArray,
    candidates: BoolArray | None = None,
) -> tuple[tuple[ComparedPair, ...], BoolArray]:
    """Return measured against predicted for every response, then for every table's pairs.

    And in which candidate bands pressures of image sources explain the fitted responses better than
    energies do, by the mean error in just noticeable differences: there they are added.
    """
    scene, bands = measurements.scene, measurements.bands
    compared = partial(compare_pairs, scene, bands, binned, measurements.responses, absorption)
    observed, chosen = compared(), np.zeros(len(bands), dtype=np.bool_)
    if candidates is not None and candidates.any():
        added = compared(candidates)
        both = [(x, y) for x, y in zip(added, observed, strict=True) if x.use == "fit"]
        off = [(x.parameters[n].jnd, y.parameters[n].jnd) for x, y in both for n in x.parameters]
        sizes = np.abs(np.array(off).reshape(-1, 2, len(bands)))
        known = np.isfinite(sizes).all(axis=1, keepdims=True)
        by_pressures, by_energies = np.where(known, sizes, 0.0).sum(axis=0)
        chosen = np.asarray(candidates & (by_pressures < by_energies))
        if chosen.any():
            observed = added if np.array_equal(chosen, candidates) else compared(chosen)
    tabulated = (*measurements.values, *measurements.kept_values)
    if not tabulated:
        return _beside_diffuse(scene, observed), chosen
    predicted = predicted_values(scene, bands, binned, absorption)
    pair_of = {name: i for i, name in enumerate(pair_names(scene))}
    at = [pair_of[m.pair_name] for m in tabulated]
    rows, lengths_m = [predicted[i] for i in at], distances_m(scene)[at].tolist()
    tables = compared_values(tabulated, rows, measurements.values, bands)
    of_tables = tuple(
        ComparedPair(m.source, m.receiver, m.use, table, None, m.state, length_m)
        for m, table, length_m in zip(tabulated, tables, lengths_m, strict=True)
    )
    return _beside_diffuse(scene, observed + of_tables), chosen


def _beside_diffuse(scene: Scene, pairs: tuple[ComparedPair, ...]) -> tuple[ComparedPair, ...]:
    """Return pairs beside a diffuse field with the decay time of the other fitted ones."""
    volume, found = volume_m3(scene.room.mesh), []
    for pair in pairs:
        own = pair.parameters
        times = [own[n].null for n in ("T30_s", "T20_s", "EDT_s") if n in own]
        decay_s = next((t for t in times if np.isfinite(t).any()), None)
        if decay_s is not None:
            (values,) = diffuse_values(decay_s, volume, np.array([pair.distance_m]))
            by_name = dict(zip(VALUE_NAMES, values, strict=True))
            own = {n: c._replace(diffuse=by_name[n]) for n, c in own.items()}
            pair = replace(pair, parameters=own)
        found.append(pair)
    return tuple(found)


def compare_pairs(
    scene: Scene,
    bands: Bands,
    binned: BinnedPaths,
    measured: tuple[MeasuredPair, ...],
    absorption: FloatArray,
    by_pressures: BoolArray | None = None,
) -> tuple[ComparedPair, ...]:
    """Return measured against predicted for every measurement, fitted or kept for validation."""

    lengths_m = distances_m(scene).tolist()

    def at(times_s: FloatArray, curve: decay.DecayCurve) -> FloatArray:
        """Return a curve in dB; NaN after its usable end."""
        return np.where(times_s <= curve.usable_end_s[:, None], curve.levels_db(times_s), np.nan)

    def compared(m: MeasuredPair) -> ComparedPair:
        # the same reduction on both sides
        own, curve = (
            m.measurement,
            predicted_curve(scene, bands, binned, m.pair, absorption, by_pressures),
        )
        curve = decay.reduced_alike(curve, m.curve)
        predicted, parameters = decay.room_parameters(curve), dict[str, Compared]()
        fitted = [o for o in measured if o.measurement.use == "fit" and o is not m]
        others = [o.parameters for o in fitted if o.measurement.state == own.state]
        for name in decay.PARAMETER_NAMES:
            found, expected = m.parameters.of(name), predicted.of(name)
            null = _mean_of_known(np.array([o.of(name) for o in others]).reshape(-1, len(bands)))
            parameters[name] = Compared(found, expected, null, decay.in_jnd(name, found, expected))
        end_s = min(float(m.curve.usable_end_s.max()), float(curve.time_s[-1]))
        times_s = np.arange(0.0, max(end_s, 2.0 * _PICTURE_STEP_S), _PICTURE_STEP_S)
        noise_db = np.where(m.curve.noise_reached, -m.curve.usable_db, np.nan)
        curves = Decay(times_s, at(times_s, m.curve), at(times_s, curve), noise_db)
        place = own.state, lengths_m[m.pair]
        return ComparedPair(own.source, own.receiver, own.use, parameters, curves, *place)

    return tuple(in_forks(compared, measured))


def predicted_curve(
    scene: Scene,
    bands: Bands,
    binned: BinnedPaths,
    pair: int,
    absorption: FloatArray,
    by_pressures: BoolArray | None = None,
) -> decay.DecayCurve:
    """Return the decay curves that the paths of a pair predict, smeared as the filters would."""
    energy = pair_energies(binned, bands, pair, absorption, attenuation_per_m(scene.air, bands))
    return curve_of(scene, bands, binned, pair, absorption, energy, by_pressures)


def curve_of(
    scene: Scene,
    bands: Bands,
    binned: BinnedPaths,
    pair: int,
    absorption: FloatArray,
    energy: FloatArray,
    by_pressures: BoolArray | None = None,
) -> decay.DecayCurve:
    """Return the curves of `predicted_curve`, of energies (n_bands, n_bins) of `pair_energies`."""
    energy = spread_over_time(bands, energy)
    if by_pressures is not None and by_pressures.any():
        added = interference(scene, bands, binned, pair, absorption, by_pressures)
        energy = np.maximum(energy + added, 0.0)
    direct_s = float(distances_m(scene)[pair]) / speed_of_sound_m_s(scene.air)
    return decay.echogram_decay_curve(bands, energy, binned.edges_s, direct_s)
