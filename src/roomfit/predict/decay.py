"""Predicted numbers of every pair with their draws and noise, and how changes carry them over."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from roomfit.base.typing import BoolArray, FloatArray
from roomfit.fit.traced_room import TracedRoom
from roomfit.model.reduced_rows import ReducedRows
from roomfit.model.room_parameters import model_sd
from roomfit.predict.prediction import PredictedDecay
from roomfit.signals.decay import FIT_RANGES_DB
from roomfit.signals.iso3382 import VALUE_NAMES
from roomfit.signals.speech import modulation_transfer, room_sti, room_sti_weights, sti_missing

_PICTURE_POINTS = 160
# Times are compared by their ratio, all else by the difference.
RELATIVE = np.array([name in FIT_RANGES_DB for name in VALUE_NAMES])


@dataclass(frozen=True, slots=True, eq=False)
class PairNumbers:
    """Predictions for one pair, names in the order of `VALUE_NAMES`."""

    values: FloatArray  # (n_names, n_bands); NaN where the decay is not followed far enough
    draws: FloatArray  # (n_draws, n_names, n_bands), under each draw of the absorption
    noise_sd: FloatArray  # (n_names, n_bands), of interfering reflections and the number of rays
    decay: PredictedDecay
    # (n_names, n_bands), variance of the noise that no change of walls alters, of pressures beside
    # their energies and of the number of rays; after a change, covariance with the noise before
    common_noise: FloatArray
    # (n_names, n_bands), of an error that all pairs of a room share
    shared_sd: FloatArray
    scatter_sd: FloatArray  # as `noise_sd`, of a place at which nothing was measured
    # the speech transmission index as one name in one band, where the bands give it
    sti: PairNumbers | None = None


# By band the absorptions that were weighed last, (n_points, n_materials), and what they gave: room
# parameters (n_points, n_names) and modulation transfers. Of a slider that moves, one band is new.
LatestBands = dict[int, tuple[FloatArray, FloatArray, FloatArray]]


def _latest_values(
    rows: ReducedRows, absorptions: FloatArray, latest: LatestBands, *, with_transfer: bool
) -> tuple[FloatArray, FloatArray]:
    """Return room parameters and modulation transfers, of bands that have not changed from memory.

    Shapes: `values` (n_points, n_names, n_bands), `transfer` (n_points, n_bands, 14).
    """
    found = []
    for band in range(len(rows.by_band)):
        own, known = absorptions[:, :, band].copy(), latest.get(band)
        if known is None or not np.array_equal(known[0], own):
            energies = rows.band_energies(band, own)
            transfer = rows.modulation(energies) if with_transfer else np.empty((len(own), 0))
            known = latest[band] = (own, rows.band_values(band, energies), transfer)
        found.append(known)
    return np.stack([f[1] for f in found], axis=2), np.stack([f[2] for f in found], axis=1)


def extrapolated_sti(before: PairNumbers, there: FloatArray, base: FloatArray) -> FloatArray:
    """Return the index before, carried over by the difference, (n,); NaN where it has none."""
    index = np.nan if before.sti is None else before.sti.values[0, 0]
    return np.asarray(np.clip(index + there - base, 0.0, 1.0))


def moved(values: FloatArray, there: FloatArray, base: FloatArray) -> FloatArray:
    """Extrapolate values to other absorptions by differences computed from the reduced rows.

    Times by their ratio, all else by the difference. Shapes (..., n_names, n_bands).
    """
    ratio = np.divide(there, base, out=np.ones_like(there), where=base != 0.0)
    return np.asarray(np.where(RELATIVE[:, None], values * ratio, values + (there - base)))


def pair_numbers(
    room: TracedRoom,
    pair: int,
    rows: ReducedRows,
    absorption: FloatArray,
    draws: FloatArray,
    speech_db: FloatArray | None = None,
) -> PairNumbers:
    """Return the predictions for one pair of a room.

    Shapes: `absorption` (n_materials, n_bands), `draws` (n_draws, n_materials, n_bands),
    `speech_db` (2, 7).
    """
    curve, values = room.decay(pair, absorption)
    times = np.linspace(0.0, float(curve.time_s[-1]), _PICTURE_POINTS)
    energies = rows.energies(np.stack([absorption, *draws]))
    found = rows.values(energies)
    shapes = np.stack([rows.decay(energy).levels_db(times) for energy in energies])
    decay_db = curve.levels_db(times)
    low, high = np.quantile(shapes[1:] - shapes[0], (0.025, 0.975), axis=0)
    drawn = moved(values, found[1:], found[0])
    decay = PredictedDecay(times, decay_db, decay_db + low, decay_db + high)
    if sti_missing(room.bands):
        noise_sd, common = room.scatter(pair, absorption)
        return PairNumbers(
            values, drawn, noise_sd[:-1], decay, common[:-1], 0.0 * values, noise_sd[:-1]
        )
    at_listener = (room.bands, modulation_transfer(curve), values[-1], speech_db)
    index = room_sti(*at_listener)
    of_draws = rows.sti(energies, found, speech_db)
    noise_sd, common = room.scatter(pair, absorption, room_sti_weights(*at_listener))
    # bands scatter by themselves; one trace serves all
    sti_sd = np.sqrt(np.sum(noise_sd[-1] ** 2, keepdims=True))[:, None]
    sti = PairNumbers(
        index.reshape(1, 1),
        np.clip(index + of_draws[1:] - of_draws[0], 0.0, 1.0).reshape(-1, 1, 1),
        sti_sd,
        decay,
        common[-1:].sum(keepdims=True),
        model_sd("STI", np.zeros((1, 1))),
        sti_sd,
    )
    return PairNumbers(
        values, drawn, noise_sd[:-1], decay, common[:-1], 0.0 * values, noise_sd[:-1], sti
    )


def changed_numbers(
    before: PairNumbers,
    rows: ReducedRows,
    absorptions: FloatArray,
    base: tuple[FloatArray, FloatArray],
    speech_db: FloatArray | None,
    latest: LatestBands,
) -> PairNumbers:
    """Return the predictions for one pair after its walls have changed, in milliseconds.

    Carried over from those before by what fewer paths tell, as draws are: for times by their ratio,
    for all else by the difference. Interference goes with the number of its independent parts: the
    standard deviation of a time as its square root, see `value_covariances`; those of C50, C80, G
    and the speech transmission index stay, and that of D50 follows C50. The picture of the decay is
    that before.

    Shapes: `absorptions` (1 + n_draws, n_materials, n_bands), `base` (n_names, n_bands),
    `speech_db` (2, 7).
    """
    sti = before.sti
    there, transfer = _latest_values(rows, absorptions, latest, with_transfer=sti is not None)
    values = moved(before.values, there, base[0])
    noise_sd, d50 = before.noise_sd.copy(), VALUE_NAMES.index("D50_percent")
    times = [*np.flatnonzero(RELATIVE), VALUE_NAMES.index("TS_ms")]
    with np.errstate(divide="ignore", invalid="ignore"):  # unknown values
        ratio = values[0] / before.values
        noise_sd[times] *= np.sqrt(ratio[times])
        noise_sd[d50] *= ratio[d50] * (100.0 - values[0, d50]) / (100.0 - before.values[d50])
    if sti is not None:
        now = room_sti(rows.bands, transfer, there[:, -1], speech_db)
        index = extrapolated_sti(before, now, base[1])
        sti = replace(sti, values=index[:1, None], draws=index[1:, None, None])
    return replace(before, values=values[0], draws=values[1:], noise_sd=noise_sd, sti=sti)


def with_common_noise(
    after: PairNumbers,
    before: PairNumbers,
    rows: ReducedRows,
    absorption: FloatArray,
    changed: FloatArray,
    exchanged: BoolArray,
) -> PairNumbers:
    """Return the numbers of a pair after a change with what its noise has in common with before.

    Shapes: `absorption, changed` (n_materials, n_bands); which are exchanged (n_materials,).
    """
    alike = rows.scatter_correlation(absorption, changed, exchanged)
    sti = after.sti
    if sti is not None and before.sti is not None:
        # early against late energy, too, over all octaves
        of_speech = alike[[VALUE_NAMES.index("D50_percent")]].mean(keepdims=True)
        sti = replace(sti, common_noise=_common(before.sti, sti, of_speech))
    return replace(after, common_noise=_common(before, after, alike), sti=sti)


def _common(before: PairNumbers, after: PairNumbers, alike: FloatArray) -> FloatArray:
    """Return the covariance of the noise of two states whose interference is alike."""
    variance = before.noise_sd**2
    steady = np.divide(
        before.common_noise, variance, out=np.zeros_like(variance), where=variance > 0.0
    )
    return (steady + (1.0 - steady) * alike) * before.noise_sd * after.noise_sd
