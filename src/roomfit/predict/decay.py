"""Predicted numbers of every pair with their draws and noise, and how changes carry them over."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from roomfit.base.typing import BoolArray, FloatArray
from roomfit.fit.traced_room import TracedRoom
from roomfit.model.reduced_rows import ReducedRows
from roomfit.model.room_parameters import model_sd
from roomfit.predict.prediction import PredictedDecay
from roomfit.signals.decay import FIT_RANGES_DB
from roomfit.signals.iso3382 import VALUE_NAMES
from roomfit.signals.speech import modulation_transfer, room_sti, room_sti_weights, sti_missing

_PICTURE_POINTS, _PICTURE_DRAWS = 160, 40
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


class BandNumbers(NamedTuple):
    """What the paths of a pair give in one band: all of them, and few for the draws."""

    absorptions: FloatArray  # (1 + n_draws, n_materials)
    values: FloatArray  # (n_names,), by all paths
    transfer: FloatArray  # (14,), modulation, likewise; empty where no speech index is asked for
    of_few: FloatArray  # (1 + n_draws, n_names)
    transfer_of_few: FloatArray  # (1 + n_draws, 14)
    levels_db: FloatArray  # (3, n_times), of the decay by all paths, and of its 95 % interval


def _band_numbers(
    room: TracedRoom, pair: int, rows: ReducedRows, absorptions: FloatArray, *, with_transfer: bool
) -> BandNumbers:
    """Return what a room of one band gives; `rows` are of that band, too."""
    curve, values = room.decay(pair, absorptions[0])
    times_s = _picture_times_s(room)
    energies = rows.energies(absorptions)
    shown = energies[: 1 + _PICTURE_DRAWS]
    shapes_db = np.array([rows.decay(e).levels_db(times_s)[0] for e in shown])
    middle_db = curve.levels_db(times_s)[0]
    ends_db = np.quantile(shapes_db[1:] - shapes_db[0], (0.025, 0.975), axis=0)
    nothing = np.empty((len(absorptions), 0))
    return BandNumbers(
        absorptions[:, :, 0],
        values[:, 0],
        modulation_transfer(curve)[0] if with_transfer else nothing[0],
        rows.values(energies)[:, :, 0],
        rows.modulation(energies[:, 0]) if with_transfer else nothing,
        np.stack((middle_db, middle_db + ends_db[0], middle_db + ends_db[1])),
    )


def _picture_times_s(room: TracedRoom) -> FloatArray:
    return np.linspace(0.0, float(room.edges_s[-1]), _PICTURE_POINTS)


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
    absorptions: FloatArray,
    speech_db: FloatArray | None = None,
    before: PairNumbers | None = None,
    latest: dict[int, BandNumbers] | None = None,
) -> PairNumbers:
    """Return the predictions for one pair of a room.

    By all paths under the first absorption; draws from there by what fewer tell: times by their
    ratio, all else by the difference. Noise is that of theory, or goes on from what it was `before`
    the walls changed. `latest` is what was found last, and is brought up to date.

    Shapes: `absorptions` (1 + n_draws, n_materials, n_bands), `speech_db` (2, 7).
    """
    with_sti, latest = not sti_missing(room.bands), {} if latest is None else latest
    for band in range(len(room.bands)):
        own, at = absorptions[:, :, band : band + 1], np.array([band])
        if band not in latest or not np.array_equal(latest[band].absorptions, own[:, :, 0]):
            one = room.in_bands(at), pair, rows.in_bands(at), own
            latest[band] = _band_numbers(*one, with_transfer=with_sti)
    bands = [latest[band] for band in range(len(room.bands))]
    values = np.stack([b.values for b in bands], axis=1)
    of_few = np.stack([b.of_few for b in bands], axis=2)
    levels_db = np.stack([b.levels_db for b in bands], axis=1)
    decay = PredictedDecay(_picture_times_s(room), *levels_db)
    numbers = _without_noise(values, moved(values, of_few[1:], of_few[0]), decay)
    weights = None
    if with_sti:
        at_listener = room.bands, np.stack([b.transfer for b in bands]), values[-1], speech_db
        index, weights = room_sti(*at_listener), room_sti_weights(*at_listener)
        transfer = np.stack([b.transfer_of_few for b in bands], axis=1)
        of_draws = room_sti(room.bands, transfer, of_few[:, -1], speech_db)
        drawn = np.clip(index + of_draws[1:] - of_draws[0], 0.0, 1.0).reshape(-1, 1, 1)
        numbers = replace(numbers, sti=_without_noise(index.reshape(1, 1), drawn, decay))
    if before is None:
        return _with_noise_of_theory(numbers, *room.scatter(pair, absorptions[0], weights))
    return _with_noise_before(numbers, before)


def _without_noise(values: FloatArray, draws: FloatArray, decay: PredictedDecay) -> PairNumbers:
    nothing = np.zeros_like(values)
    return PairNumbers(values, draws, nothing, decay, nothing, nothing, nothing)


def _with_noise_of_theory(
    numbers: PairNumbers, noise_sd: FloatArray, common: FloatArray
) -> PairNumbers:
    """Return numbers with their noise, (n_names + 1, n_bands), last of the speech index."""
    sti = numbers.sti
    if sti is not None:
        # bands scatter by themselves; one trace serves all
        sti = replace(
            _with_noise(sti, np.sqrt(np.sum(noise_sd[-1:] ** 2, keepdims=True)), common[-1:]),
            common_noise=common[-1:].sum(keepdims=True),
            shared_sd=model_sd("STI", np.zeros((1, 1))),
        )
    return replace(_with_noise(numbers, noise_sd[:-1], common[:-1]), sti=sti)


def _with_noise(numbers: PairNumbers, noise_sd: FloatArray, common: FloatArray) -> PairNumbers:
    return replace(numbers, noise_sd=noise_sd, scatter_sd=noise_sd, common_noise=common)


def _with_noise_before(numbers: PairNumbers, before: PairNumbers) -> PairNumbers:
    """Return numbers after a change with the noise before it.

    Interference goes with the number of its independent parts: the standard deviation of a time as
    its square root, see `value_covariances`; those of C50, C80, G and the speech transmission index
    stay, and that of D50 follows C50.
    """
    values, noise_sd = numbers.values, before.noise_sd.copy()
    times = [*np.flatnonzero(RELATIVE), VALUE_NAMES.index("TS_ms")]
    d50 = VALUE_NAMES.index("D50_percent")
    with np.errstate(divide="ignore", invalid="ignore"):  # unknown values
        ratio = values / before.values
        noise_sd[times] *= np.sqrt(ratio[times])
        noise_sd[d50] *= ratio[d50] * (100.0 - values[d50]) / (100.0 - before.values[d50])
    sti = before.sti
    if sti is not None and numbers.sti is not None:
        sti = replace(sti, values=numbers.sti.values, draws=numbers.sti.draws)
    own = replace(before, values=values, draws=numbers.draws, decay=numbers.decay)
    return replace(own, noise_sd=noise_sd, sti=sti)


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
