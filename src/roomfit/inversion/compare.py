"""Predictions beside measurements and beside what one would guess without a model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roomfit.air import attenuation_per_m
from roomfit.bands import Bands
from roomfit.inversion.measurements import Measurements
from roomfit.measurement import MeasuredPair, Use
from roomfit.objective.observation import spread_over_time
from roomfit.objective.room_parameters import predicted_values
from roomfit.response.binned import BinnedPaths, pair_energies
from roomfit.results import Compared, ComparedPair, Decay
from roomfit.scene import pair_names
from roomfit.signals.decay import (
    PARAMETER_NAMES,
    DecayCurve,
    echogram_decay_curve,
    in_jnd,
    reduced_alike,
    room_parameters,
)
from roomfit.signals.iso3382 import VALUE_NAMES, MeasuredValues, ValueName
from roomfit.typing import FloatArray


def compared_values(
    measured: Sequence[MeasuredValues],
    predicted: Sequence[FloatArray],
    fitted: Sequence[MeasuredValues],
    bands: Bands,
    names: Sequence[ValueName] = VALUE_NAMES,
) -> tuple[dict[ValueName, Compared], ...]:
    """Return measured, predicted and null value of every pair; parameters never measured left out.

    Parameters
    ----------
    measured : sequence of MeasuredValues
    predicted : sequence of float arrays, shape (n_names, n_bands)
        Of the same pairs.
    fitted : sequence of MeasuredValues
        Whose mean, the pair itself left out, is the baseline.
    """
    tables = []
    for m, row in zip(measured, predicted, strict=True):
        table: dict[ValueName, Compared] = {}
        for name, values in zip(names, row, strict=True):
            found = m.at(name, bands.centres_hz)
            if not np.isfinite(found).any():
                continue
            others = np.array([o.at(name, bands.centres_hz) for o in fitted if o is not m])
            null = _mean_of_known(others.reshape(-1, len(bands)))
            table[name] = Compared(found, values, null, in_jnd(name, found, values))
        tables.append(table)
    return tuple(tables)


def _mean_of_known(values: FloatArray) -> FloatArray:
    known = np.isfinite(values)
    counts = known.sum(axis=0)
    sums = np.where(known, values, 0.0).sum(axis=0)
    return np.asarray(np.where(counts > 0, sums / np.maximum(counts, 1), np.nan))


_PICTURE_STEP_S = 2e-3


def compare_all(
    measurements: Measurements, binned: BinnedPaths, absorption: FloatArray
) -> tuple[ComparedPair, ...]:
    """Return measured against predicted for every response, then for every table's pairs.

    Parameters
    ----------
    absorption : float array, shape (n_materials, n_bands)
    """
    scene, bands = measurements.scene, measurements.bands
    attenuation = attenuation_per_m(scene.air, bands)
    observed = compare_pairs(bands, binned, measurements.responses, absorption, attenuation)
    tabulated = (*measurements.values, *measurements.kept_values)
    if not tabulated:
        return observed
    predicted = predicted_values(scene, bands, binned, absorption)
    pair_of = {name: i for i, name in enumerate(pair_names(scene))}
    rows = [predicted[pair_of[m.pair_name]] for m in tabulated]
    uses: list[Use] = ["fit" for _ in measurements.values]
    uses += ["validate" for _ in measurements.kept_values]
    tables = compared_values(tabulated, rows, measurements.values, bands)
    return observed + tuple(
        ComparedPair(
            m.source, m.receiver, use, {str(n): c for n, c in table.items()}, None, m.state
        )
        for m, use, table in zip(tabulated, uses, tables, strict=True)
    )


def compare_pairs(
    bands: Bands,
    binned: BinnedPaths,
    measured: tuple[MeasuredPair, ...],
    absorption: FloatArray,
    attenuation_per_m: FloatArray,
) -> tuple[ComparedPair, ...]:
    """Return measured against predicted for every measurement, fitted or kept for validation.

    Parameters
    ----------
    absorption : float array, shape (n_materials, n_bands)
    attenuation_per_m : float array, shape (n_bands,)
    """
    out = []
    for m in measured:
        curve = predicted_curve(bands, binned, m.pair, absorption, attenuation_per_m, m.direct_s)
        # the same reduction on both sides
        curve = reduced_alike(curve, m.curve)
        predicted = room_parameters(curve)
        others = [
            o.parameters
            for o in measured
            if o.measurement.use == "fit" and o.measurement.state == m.measurement.state
            if o is not m
        ]
        compared: dict[str, Compared] = {}
        for name in PARAMETER_NAMES:
            found, expected = m.parameters.of(name), predicted.of(name)
            null = _mean_of_known(np.array([o.of(name) for o in others]).reshape(-1, len(bands)))
            compared[name] = Compared(found, expected, null, in_jnd(name, found, expected))
        own = m.measurement
        decay = _decay(m.curve, curve)
        out.append(ComparedPair(own.source, own.receiver, own.use, compared, decay, own.state))
    return tuple(out)


def predicted_curve(
    bands: Bands,
    binned: BinnedPaths,
    pair: int,
    absorption: FloatArray,
    attenuation_per_m: FloatArray,
    direct_s: float,
) -> DecayCurve:
    """Return the decay curves that the paths of a pair predict, smeared as the filters would."""
    energy = pair_energies(binned, bands, pair, absorption, attenuation_per_m)
    return echogram_decay_curve(bands, spread_over_time(bands, energy), binned.edges_s, direct_s)


def _decay(measured: DecayCurve, predicted: DecayCurve) -> Decay:
    end_s = min(float(measured.usable_end_s.max()), float(predicted.time_s[-1]))
    times = np.arange(0.0, max(end_s, 2.0 * _PICTURE_STEP_S), _PICTURE_STEP_S)
    noise_db = np.where(measured.noise_reached, -measured.usable_db, np.nan)
    return Decay(times, _at(times, measured), _at(times, predicted), noise_db)


def _at(times: FloatArray, curve: DecayCurve) -> FloatArray:
    """Return the curves in dB at given times; NaN after their usable end."""
    return np.where(times <= curve.usable_end_s[:, None], curve.levels_db(times), np.nan)
