"""The numbers of one predicted pair: values, how they move with the absorption, and their noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from roomfit.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.bands import Bands
from roomfit.inversion.compare import predicted_curve
from roomfit.materials.priors import MaterialPrior, unknown_material
from roomfit.objective.parameters import start_vector
from roomfit.objective.room_parameters import predicted_values, value_covariances, value_problems
from roomfit.response.binned import BinnedPaths, pair_energies, regrouped
from roomfit.response.energy import grouped_rows, thinned_rows
from roomfit.scene import Scene, distances_m
from roomfit.signals.decay import DecayCurve, decay_curve_db, echogram_decay_curve, room_parameters
from roomfit.signals.iso3382 import VALUE_NAMES, MeasuredValues, value_gradients
from roomfit.typing import BoolArray, FloatArray

# Differences between absorptions are read from so many rows, in bins of a millisecond.
_ROWS_OF_A_DRAW = 30_000
_BINS_TOGETHER = 10
_PICTURE_POINTS = 160
_LOWEST_DB = -200.0
# Times are compared by their ratio, all else by the difference.
RELATIVE: BoolArray = np.array([name in ("EDT_s", "T20_s", "T30_s") for name in VALUE_NAMES])


@dataclass(frozen=True, slots=True, eq=False)
class PairNumbers:
    """Predictions for one pair.

    Attributes
    ----------
    values : float array, shape (n_names, n_bands)
        In the order of `VALUE_NAMES`; NaN where the trace does not follow the decay far enough.
    draws : float array, shape (n_draws, n_names, n_bands)
        The same under each draw of the absorption.
    noise_sd : float array, shape (n_names, n_bands)
        Of interfering reflections and of the number of rays.
    time_s : float array, shape (n_times,)
    decay_db, lower_db, upper_db : float arrays, shape (n_bands, n_times)
    """

    values: FloatArray
    draws: FloatArray
    noise_sd: FloatArray
    time_s: FloatArray
    decay_db: FloatArray
    lower_db: FloatArray
    upper_db: FloatArray


def pair_numbers(
    scene: Scene,
    bands: Bands,
    binned: BinnedPaths,
    pair: int,
    absorption: FloatArray,
    draws: FloatArray,
) -> PairNumbers:
    """Return the predictions for one pair of the scene.

    Parameters
    ----------
    absorption : float array, shape (n_materials, n_bands)
    draws : float array, shape (n_draws, n_materials, n_bands)
    """
    alone = replace(scene, pairs=scene.pairs[pair : pair + 1])
    bands_of = {f: (rows[pair],) for f, rows in binned.by_band.items()}
    own = BinnedPaths(binned.edges_s, (binned.rows[pair],), bands_of)
    direct_s = float(distances_m(alone)[0] / speed_of_sound_m_s(scene.air))
    attenuation = attenuation_per_m(scene.air, bands)
    curve = predicted_curve(bands, own, 0, absorption, attenuation, direct_s)
    values = np.vstack(
        [
            room_parameters(curve).values,
            predicted_values(alone, bands, own, absorption, ("G_dB",))[0],
        ]
    )
    times = np.linspace(0.0, float(curve.time_s[-1]), _PICTURE_POINTS)
    moved, shapes = _draws(bands, own, direct_s, np.stack([absorption, *draws]), attenuation, times)
    ratio = np.divide(moved[1:], moved[0], out=np.ones_like(moved[1:]), where=moved[0] != 0.0)
    drawn = np.where(RELATIVE[:, None], values * ratio, values + (moved[1:] - moved[0]))
    decay_db = _levels(curve, times)
    low, high = np.quantile(shapes[1:] - shapes[0], (0.025, 0.975), axis=0)
    return PairNumbers(
        values,
        drawn,
        _noise_sd(alone, bands, own, absorption),
        times,
        decay_db,
        decay_db + low,
        decay_db + high,
    )


def _draws(
    bands: Bands,
    own: BinnedPaths,
    direct_s: float,
    absorptions: FloatArray,
    attenuation: FloatArray,
    times: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return values and decay levels under several absorptions, from fewer rows and wider bins."""
    edges_s = np.append(own.edges_s[:-1][::_BINS_TOGETHER], own.edges_s[-1])
    few = regrouped(
        own, edges_s, lambda r: grouped_rows(thinned_rows(r, _ROWS_OF_A_DRAW), _BINS_TOGETHER)
    )
    values = np.empty((len(absorptions), len(VALUE_NAMES), len(bands)))
    shapes = np.empty((len(absorptions), len(bands), times.size))
    for i, absorption in enumerate(absorptions):
        energy = pair_energies(few, bands, 0, absorption, attenuation)
        # a wall that swallows all leaves later bins empty: too little to matter, but not nothing
        energy = np.maximum(energy, 1e-30 * energy.sum(axis=1, keepdims=True))
        curve = echogram_decay_curve(bands, energy, edges_s, direct_s)
        for band in range(len(bands)):
            values[i, :, band] = value_gradients(curve, band, VALUE_NAMES)[0]
        shapes[i] = _levels(curve, times)
    return values, shapes


def _levels(curve: DecayCurve, times: FloatArray) -> FloatArray:
    levels = np.maximum(decay_curve_db(curve), _LOWEST_DB)
    return np.stack([np.interp(times, curve.time_s, row) for row in levels])


def _noise_sd(alone: Scene, bands: Bands, own: BinnedPaths, absorption: FloatArray) -> FloatArray:
    """Return by how much values scatter though the absorption is known, (n_names, n_bands)."""
    source, receiver = alone.pairs[0]
    sd = np.empty((len(VALUE_NAMES), len(bands)))
    for band in range(len(bands)):
        one = Bands(bands.kind, bands.centres_hz[band : band + 1])
        chosen = absorption[:, band : band + 1]
        expected = predicted_values(alone, one, own, chosen)[0]
        as_measured = MeasuredValues(
            alone.sources[source].name,
            alone.receivers[receiver].name,
            one.centres_hz,
            dict(zip(VALUE_NAMES, expected, strict=True)),
            {},
        )
        (problem,) = value_problems(
            alone,
            one,
            _fixed_materials(alone.room.materials, chosen),
            (as_measured,),
            own,
            np.array([0.5]),
        )
        if problem is None or problem.observations[0].names != VALUE_NAMES:
            sd[:, band] = np.nan
            continue
        (covariance,) = value_covariances(
            replace(problem, model_error_jnd=0.0), start_vector(problem.parameters)
        )
        sd[:, band] = np.sqrt(np.diag(covariance))
    return sd


def _fixed_materials(
    materials: tuple[str, ...], absorption: FloatArray
) -> tuple[MaterialPrior, ...]:
    return tuple(
        replace(unknown_material(name, 1), known=row)
        for name, row in zip(materials, absorption, strict=True)
    )
