"""The speech transmission index of IEC 60268-16 from decay curves, with derivatives.

The indirect method: modulation transfer by Schroeder's formula from the energy of an impulse
response, the same function for measured and predicted energies.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roomfit.base.arguments import float_array
from roomfit.base.bands import Bands
from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray, IntArray
from roomfit.signals.decay import DecayCurve, tail_of
from roomfit.signals.iso3382 import tail_gradients

SPEECH_BANDS_HZ = (125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0)
MODULATIONS_HZ = np.array(
    [0.63, 0.8, 1.0, 1.25, 1.6, 2.0, 2.5, 3.15, 4.0, 5.0, 6.3, 8.0, 10.0, 12.5]
)
# IEC 60268-16:2020, table A.1: weights of bands, and of what neighbours have in common
_WEIGHT = np.array([0.085, 0.127, 0.230, 0.233, 0.309, 0.224, 0.173])
_REDUNDANCY = np.array([0.085, 0.078, 0.065, 0.011, 0.047, 0.095])
# A.4.3, dB: absolute reception threshold of speech
_THRESHOLD = 10.0 ** (0.1 * np.array([46.0, 27.0, 12.0, 6.5, 7.5, 8.0, 12.0]))
# A.4.2: level of the lower band from which a line holds, its slope and its height, all in dB
_MASKING = np.array(
    [[-np.inf, 0.5, -65.0], [63.0, 1.8, -146.9], [67.0, 0.5, -59.8], [100.0, 0.0, -10.0]]
)
# The fifth edition's one spectrum, dB relative to the A-weighted level
_SPECTRUM_DB = np.array([-2.5, 0.5, 0.0, -6.0, -12.0, -18.0, -24.0])
_MOST_DB = 15.0  # a modulation index counts between signal-to-noise ratios of -15 and 15 dB
_DB = 10.0 / np.log(10.0)
_LEAST_RANGE_DB = 20.0


def sti_missing(bands: Bands) -> str:
    """Return why bands give no speech transmission index, "" where they do.

    Examples
    --------
    >>> sti_missing(Bands("octave", np.array([500.0, 1000.0])))
    'it needs the octave bands from 125 Hz to 8 kHz, and 125, 250, 2000, 4000, 8000 Hz are missing'
    """
    missing = [f"{f:g}" for f in SPEECH_BANDS_HZ if f not in bands.centres_hz]
    why = f"{', '.join(missing)} Hz {'is' if len(missing) == 1 else 'are'} missing"
    if bands.kind != "octave":
        why = "the bands are third octaves"
    elif not missing:
        return ""
    return f"it needs the octave bands from 125 Hz to 8 kHz, and {why}"


def speech_bands(bands: Bands) -> IntArray:
    """Return where the octaves from 125 Hz to 8 kHz stand among bands that have them, (7,)."""
    return np.searchsorted(bands.centres_hz, SPEECH_BANDS_HZ)


def speech_levels(level_dba: float, noise_db: ArrayLike | None = None) -> FloatArray:
    """Return octave levels of speech, and those of noise below them, in dB, shape (2, 7).

    `level_dba`: A-weighted level of speech; 60 dB at 1 m is a normal vocal effort. `noise_db`,
    shape (7,): octave levels of noise, 125 Hz to 8 kHz; left out: none.
    """
    noise: FloatArray = np.full(7, -np.inf)
    if noise_db is not None:
        noise = float_array("noise levels", noise_db, (7,), unit="dB")
    return np.stack([level_dba + _SPECTRUM_DB, noise])


def modulation_transfer(curve: DecayCurve, least_range_db: float = 20.0) -> FloatArray:
    """Return the modulation transfer in every band, 0 to 1, shape (n_bands, 14).

    From `curve` to its usable end; what follows is the exponential that it is extrapolated by. NaN
    in bands whose curve is reliable over a smaller range: as of D50, a hundredth of the energy is
    extrapolated at most.

    Notes
    -----
    ``m(F) = |integral of p^2(t) exp(-2 pi i F t)| / integral of p^2(t)`` [1]_, at the 14 modulation
    frequencies of IEC 60268-16.

    References
    ----------
    .. [1] M. R. Schroeder, "Modulation transfer functions: definition and measurement", Acustica
           49, 179-182 (1981).
    """
    found = np.full((len(curve.bands), len(MODULATIONS_HZ)), np.nan)
    for band in np.flatnonzero(curve.usable_db >= least_range_db):
        left = curve.energy_left[band]
        if not left[0] > 0.0:
            what, needed = "a response without energy has no modulation transfer", "energy above 0"
            raise InputError(what, found="energy 0", needed=needed, hint="leave the response out")
        # a response ends where nothing is left of it, an echogram with its last bin
        n = int(np.flatnonzero(left)[-1]) + 1
        z, *_ = _spectrum(curve.time_s[:n], left[:n], float(curve.tail_time_constant_s[band]))
        found[band] = np.abs(z) / left[0]
    return found


def _spectrum(
    time_s: FloatArray, left: FloatArray, constant_s: float
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return the spectrum of the energy, (14,), and phases of the bins, (14, n_bins).

    Of the tail, whose energy is the last that is left, follow its phase at the beginning and what
    divides it, (14,) each.
    """
    omega = 2.0 * np.pi * MODULATIONS_HZ
    phase = np.exp(-1j * omega[:, None] * 0.5 * (time_s[1:] + time_s[:-1]))
    end, lag = np.exp(-1j * omega * time_s[-1]), 1.0 + 1j * omega * constant_s
    return phase @ -np.diff(left) + left[-1] * end / lag, phase, end, lag


def transfer_of_bins(energies: FloatArray, edges_s: FloatArray) -> FloatArray:
    """Return the modulation transfer of many echograms, shape (..., 14).

    As `modulation_transfer` of their decay curves, at any range.

    `energies`, shape (..., n_bins): some energy in each row. `edges_s`, shape (n_bins + 1,).
    """
    rows = energies.reshape(-1, energies.shape[-1])
    left = np.cumsum(rows[:, ::-1], axis=1)[:, ::-1]
    tail, _, constant_s = tail_of(np.pad(left, ((0, 0), (0, 1))), edges_s)
    omega = 2.0 * np.pi * MODULATIONS_HZ
    angle = 0.5 * (edges_s[1:] + edges_s[:-1])[:, None] * omega
    z = rows @ np.cos(angle) - 1j * (rows @ np.sin(angle))
    end = np.exp(-1j * omega * edges_s[-1]) / (1.0 + 1j * omega * constant_s[:, None])
    found = np.abs(z + tail[:, None] * end) / (left[:, :1] + tail[:, None])
    return np.asarray(found.reshape(*energies.shape[:-1], len(omega)))


def sti_of_decay(bands: Bands, time_s: FloatArray, levels_db: FloatArray) -> float:
    """Return the speech transmission index of a room by decay curves, without noise or level.

    NaN where the bands are not the seven, or one falls by less than 20 dB.

    `time_s`, shape (n_times,): rising, a hundredth of a second apart at most. `levels_db`, shape
    (n_bands, n_times): energy still to come relative to the whole; NaN beyond the usable part, from
    where its last third goes on as a straight line.
    """
    if sti_missing(bands):
        return float("nan")
    found = []
    for centre in SPEECH_BANDS_HZ:
        levels = levels_db[bands.centres_hz.tolist().index(centre)]
        levels = levels[np.isfinite(levels)]
        if len(levels) < 4 or levels[-1] > -_LEAST_RANGE_DB:
            return float("nan")
        times, left = time_s[: len(levels)], 10.0 ** (0.1 * levels)
        late = np.flatnonzero(levels <= levels[-1] * 2.0 / 3.0)
        slope = np.polyfit(times[late], levels[late], 1)[0] if len(late) > 1 else -np.inf
        found.append(np.abs(_spectrum(times, left, _DB / max(-slope, 1e-9))[0]) / left[0])
    return float(speech_transmission(np.array(found)))


def modulation_gradients(curve: DecayCurve, band: int) -> tuple[FloatArray, FloatArray]:
    """Return the modulation transfer of an echogram, and its derivatives by its energies.

    `curve`: from `roomfit.signals.decay.echogram_decay_curve`.

    `values` has the shape (14,). `gradients` has the shape (14, n_bins): exact, including the
    energy that is added for the time after the echogram.
    """
    left, constant_s = curve.energy_left[band], float(curve.tail_time_constant_s[band])
    z, phase, end, lag = _spectrum(curve.time_s, left, constant_s)
    by_tail, by_moment = tail_gradients(curve, band)
    # the moment of the tail is its energy times its time constant
    by_constant = by_moment - constant_s * by_tail
    omega = 2.0 * np.pi * MODULATIONS_HZ[:, None]
    by_energy = phase + (end / lag)[:, None] * by_tail
    by_energy -= 1j * omega * (end / lag**2)[:, None] * by_constant
    m, total = np.abs(z) / left[0], float(left[0])
    turned = np.real(np.conj(z)[:, None] * by_energy) / np.maximum(np.abs(z), 1e-300)[:, None]
    return m, (turned - m[:, None] * (1.0 + by_tail)) / total


def speech_transmission(transfer: FloatArray, levels_db: FloatArray | None = None) -> FloatArray:
    """Return the speech transmission index, 0 to 1, of the shape (...).

    `transfer`, shape (..., 7, 14): modulation transfer of the octave bands from 125 Hz to 8 kHz,
    without noise; NaN gives NaN. `levels_db`, shape (..., 2, 7): at the listener: of speech and of
    noise, as of `speech_levels`. Left out: no noise, and neither auditory masking nor the threshold
    of reception.

    Notes
    -----
    IEC 60268-16:2020, annex A: each modulation index is multiplied by the intensity of the speech
    over that of speech, noise, masking by the next lower band and the threshold of reception
    together; masking depends on the level, noise included, of that lower band. As the standard
    subtracts what bands have in common, the index of one band may rise and the whole fall, where
    its neighbours' are far larger; and of seven indices it may exceed 1, which is then taken.

    Examples
    --------
    A signal-to-noise ratio of 0 dB in every band halves the modulation, the middle of the scale:

    >>> round(float(speech_transmission(np.full((7, 14), 0.5))), 6)
    0.5
    """
    return _by_band(transfer, levels_db)[0]


def sti_gradients(
    transfer: FloatArray, levels_db: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of `speech_transmission` by the transfer and by the speech's levels.

    `by_transfer` has the shape (7, 14). `by_level` has the shape (7,): per dB, 0 without levels.
    """
    _, m, mti, inside = _by_band(transfer, levels_db)
    root = np.sqrt(np.maximum(mti, 1e-12))
    by_mti = _WEIGHT.copy()
    by_mti[:-1] -= 0.5 * _REDUNDANCY * root[1:] / root[:-1]
    by_mti[1:] -= 0.5 * _REDUNDANCY * root[:-1] / root[1:]
    slope = _DB / (2.0 * _MOST_DB * len(MODULATIONS_HZ)) / (m * (1.0 - m))
    by_index = by_mti[:, None] * np.where(inside, slope, 0.0)
    if levels_db is None:
        return by_index, np.zeros(7)
    share, by_own, by_lower = _speech_shares(levels_db)
    by_share = np.sum(by_index * transfer, axis=1)
    by_level = by_share * by_own
    by_level[:-1] += by_share[1:] * by_lower[1:]
    return by_index * share[:, None], by_level


def room_sti(
    bands: Bands, transfer: FloatArray, strength_db: FloatArray, speech_db: FloatArray | None
) -> FloatArray:
    """Return the speech transmission index at a place of known strength, shape (...).

    `bands`: with the octaves from 125 Hz to 8 kHz among them, see `sti_missing`. `transfer`, shape
    (..., n_bands, 14). `strength_db`, shape (..., n_bands): G at the listener. `speech_db`, shape
    (2, 7): speech at 1 m in the free field, 20 dB above what G refers to, and noise at the
    listener; None as without levels in `speech_transmission`.
    """
    at = speech_bands(bands)
    levels_db = levels_at_listener(speech_db, strength_db[..., at])
    return speech_transmission(transfer[..., at, :], levels_db)


def room_sti_weights(
    bands: Bands, transfer: FloatArray, strength_db: FloatArray, speech_db: FloatArray | None
) -> FloatArray:
    """Return the derivatives of `room_sti` of one place, shape (n_bands, 14 + 1).

    By the modulation transfers, and last by the strength; 0 in bands that do not count.
    """
    at = speech_bands(bands)
    levels_db = levels_at_listener(speech_db, strength_db[at])
    weights = np.zeros((len(bands), len(MODULATIONS_HZ) + 1))
    weights[at, :-1], weights[at, -1] = sti_gradients(transfer[at], levels_db)
    return weights


def levels_at_listener(speech_db: FloatArray | None, strength_db: FloatArray) -> FloatArray | None:
    """Return levels of speech and noise where the strength G is known, shape (..., 2, 7)."""
    if speech_db is None:
        return None
    speech = speech_db[0] - 20.0 + strength_db
    return np.stack([speech, np.broadcast_to(speech_db[1], speech.shape)], axis=-2)


def _by_band(
    transfer: FloatArray, levels_db: FloatArray | None
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the index, modulation indices, their mean by band, and which count as they are."""
    m = np.asarray(transfer, dtype=np.float64)
    if m.shape[-2:] != (7, 14):
        what = "a speech transmission index needs seven octaves and 14 modulation frequencies"
        needed = "(..., 7, 14)"
        hint = "take it from modulation_transfer of bands from 125 Hz to 8 kHz"
        raise InputError(what, found=f"a transfer of shape {m.shape}", needed=needed, hint=hint)
    if levels_db is not None:
        m = m * _speech_shares(levels_db)[0][..., None]
    m = np.clip(m, 1e-9, 1.0 - 1e-9)
    level = _DB * np.log(m / (1.0 - m))
    mti = np.mean((np.clip(level, -_MOST_DB, _MOST_DB) + _MOST_DB) / (2.0 * _MOST_DB), axis=-1)
    common = np.sqrt(mti[..., :-1] * mti[..., 1:]) @ _REDUNDANCY
    found = np.minimum(mti @ _WEIGHT - common, 1.0)
    return np.asarray(found), m, mti, np.asarray(np.abs(level) < _MOST_DB)


def _speech_shares(levels_db: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the share of the speech in what is audible, and its derivatives per dB.

    By the level of the speech in the own band, and in the next lower one; (..., 7) each.
    """
    speech, noise = np.moveaxis(10.0 ** (0.1 * np.asarray(levels_db)), -2, 0)
    lower = np.maximum((speech + noise)[..., :-1], 1e-30)
    level = _DB * np.log(lower)
    piece = np.searchsorted(_MASKING[:, 0], level, side="right") - 1
    slope, height = _MASKING[piece, 1], _MASKING[piece, 2]
    factor = 10.0 ** (0.1 * (slope * level + height))
    nothing = np.zeros_like(speech[..., :1])
    masking = np.concatenate([nothing, lower * factor], axis=-1)
    audible = speech + noise + masking + _THRESHOLD
    share = speech / audible
    by_lower = np.concatenate([nothing, (1.0 + slope) * factor * speech[..., :-1]], axis=-1)
    return share, share * (1.0 - share) / _DB, -share / audible * by_lower / _DB
