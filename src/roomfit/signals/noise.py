"""The noise of a measured response and where its decay meets it, band by band."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from roomfit.base.bands import Bands
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.signals.filters import statistical_bandwidth_hz
from roomfit.signals.response import ImpulseResponse

_MOST_ROUNDS = 8
# Log likelihood ratios that decide between noise and a decay: of all bands, and of one alone.
_CLEAR, _CLEAR_ALONE = 4.0, 2.0
_FALLS = 4.0  # quarters of a file that differ so much are not the same noise
_LOUD = 16.0  # 12 dB above the noise is a sound, however short
_LEAST_ENERGY = 1e-300  # digital silence, so that it has a level
_TAIL_SHARE = 0.1  # of the file, from its end: the least that noise is estimated from
_RISE = 4.0  # an end that is 6 dB louder than the quietest tenth is no noise floor
_FAIR_VALUES = 16.0
# A zero-phase octave filter rings before a sound: so long, in units of 1 / B, until it is 60 dB
# down, and so many independent values make a fair mean (1.5 dB).
_RINGS, _FEW_VALUES = 4.0, 8.0


@dataclass(frozen=True, slots=True, eq=False)
class NoiseEstimate:
    """Noise and the decay just above it, one value a band."""

    # (n_bands,), mean square pressure. Where the file ends before noise is reached, that before the
    # direct sound, or 0 where this is too short.
    floor: FloatArray
    reached: BoolArray  # (n_bands,), whether the decay falls into the noise before the file ends
    # (n_bands,), time after emission where the decay meets the noise or the file ends; the onset
    # where no decay rises above the noise
    usable_end_s: FloatArray
    tail_energy: FloatArray  # (n_bands,), of the decay after `usable_end_s`, pressure squared s
    # (n_bands,), in which the energy just above the noise falls to 1/e; T is 13.8 times as long. 0
    # where no decay rises above the noise.
    tail_time_constant_s: FloatArray
    peak_to_noise_db: FloatArray  # (n_bands,), loudest block over the noise or the end of the file


def estimate_noise(
    bands: Bands, response: ImpulseResponse, filtered: FloatArray, onset_s: float
) -> NoiseEstimate:
    """Return the noise floor and the usable end of every band.

    `filtered`, shape (n_bands, n_samples): the response by `filter_pressure`. `onset_s`: arrival of
    the direct sound after emission; earlier samples are not used.

    Notes
    -----
    Lundeby's iteration [1]_: noise from the end of the file, a straight line through the levels
    above it, their crossing, noise again from behind the crossing, until it converges. Five things
    differ. The noise is subtracted before the line is fitted. The height of the line is set by its
    energy, since the mean of levels lies below the level of the mean. A crossing within the last
    tenth of the file counts as not reached: there the "noise" is the decay itself, and subtracting
    it would bend the curve. Neither is it reached where the sound behind the crossing still falls
    or is too short to decide, by all bands together: many files are cut while the room still rings.
    And an end of the file that is louder than what precedes it is left out.

    References
    ----------
    .. [1] A. Lundeby, T. E. Vigran, H. Bietz, M. Vorländer, "Uncertainties of measurements in room
           acoustics", Acustica 81, 344-355 (1995).
    """
    rate_hz = response.sampling_rate_hz
    start = max(0, round((onset_s + response.time_zero_s) * rate_hz))
    sounding = np.flatnonzero(response.pressure)  # a file padded with zeros ends before them
    end = int(sounding[-1]) + 1 if sounding.size else 0
    decays = [
        _band_decay(pressure[:end] ** 2, start, rate_hz, bandwidth_hz)
        for pressure, bandwidth_hz in zip(filtered, statistical_bandwidth_hz(bands), strict=True)
    ]
    # undecided bands follow the others: one file is cut in all of them, or in none
    evidence = sum(float(np.clip(h.evidence, -_CLEAR, _CLEAR)) for h in decays)
    start_s = start / rate_hz - response.time_zero_s
    floor, reached, length_s, tail, constant_s, peak_db = np.array(
        [_judged(h, evidence) for h in decays], dtype=np.float64
    ).T
    return NoiseEstimate(floor, reached > 0.0, start_s + length_s, tail, constant_s, peak_db)


class _BandDecay(NamedTuple):
    """Noise and decay of one band before it is decided whether the file's end is noise."""

    floor: float
    before: float  # mean square before the sound
    length_s: float = 0.0
    spreading_s: float = 0.0  # by which the filter spreads the end of the file
    times: FloatArray = np.zeros(0)
    blocks: FloatArray = np.zeros(0)
    line: tuple[float, float] | None = None  # height and time constant; None for no decay
    crossing_s: float = 0.0
    levels_out: bool = False
    evidence: float = 0.0


def _band_decay(energy: FloatArray, start: int, rate_hz: float, bandwidth_hz: float) -> _BandDecay:
    """Return noise and decay of a filtered response squared, whose sound arrives at a sample."""
    before = level_before(energy[:start], rate_hz, bandwidth_hz)
    energy = energy[start:]
    energy = before_rise(energy, max(1.0, bandwidth_hz * len(energy) / rate_hz))
    length_s = len(energy) / rate_hz
    block_s = block_length_s(bandwidth_hz, length_s)
    if block_s < 1.5 / bandwidth_hz or length_s < 8.0 * block_s:
        return _BandDecay(0.0, before)
    # mid times and mean energies of equal blocks; an incomplete block at the end is left out
    size = max(1, round(block_s * rate_hz))
    n = len(energy) // size
    times = (np.arange(n, dtype=np.float64) + 0.5) * (size / rate_hz)
    blocks = np.maximum(energy[: n * size].reshape(n, size).mean(axis=1), _LEAST_ENERGY)
    floor, line = _floor_and_decay(energy, rate_hz, times, blocks)
    third, last = (part.mean() for part in np.array_split(energy, 4)[2:])
    # a last quarter 6 dB quieter than the third: no noise is reached there
    if line is None and third > _FALLS * max(last, _LEAST_ENERGY):
        line = decay_line(times, blocks, _LEAST_ENERGY, span_db=np.inf)
    elif line is None:
        line = _short_decay(times, blocks, floor)
    if line is None:
        return _BandDecay(floor, before, length_s)
    crossing_s = _crossing_s(*line, floor, length_s)
    # a last quarter as loud as the third, where the line falls by half or more
    fall = np.exp(-0.25 * length_s / line[1])
    levels_out = bool(fall < 0.5 and last > np.sqrt(fall) * third)
    # noise alone begins where the decay lies 10 dB below it
    behind = energy[round((crossing_s + np.log(10.0) * line[1]) * rate_hz) :]
    evidence = evidence_of_noise(behind, rate_hz, bandwidth_hz, line[1])
    spreading_s = 2.0 / bandwidth_hz
    return _BandDecay(
        floor, before, length_s, spreading_s, times, blocks, line, crossing_s, levels_out, evidence
    )


def block_length_s(bandwidth_hz: float, length_s: float) -> float:
    """Return the length of the blocks whose levels a line is put through.

    A block has four independent values, so that its level scatters by 2 dB; in a short file down
    to one and a half, for a line through less than eight blocks is worthless.
    """
    return max(0.01, min(4.0 / bandwidth_hz, length_s / 8.0))


def _judged(decay: _BandDecay, evidence: float) -> tuple[float, bool, float, float, float, float]:
    """Return a band of `NoiseEstimate` under the evidence that the file's end is noise.

    The usable length counts from the onset.
    """
    line, floor, end_s, times = decay.line, decay.floor, decay.crossing_s, decay.times
    if line is None:
        return floor, decay.length_s > 0.0, 0.0, 0.0, 0.0, 0.0
    crosses = end_s < (1.0 - _TAIL_SHARE) * decay.length_s
    clear = abs(decay.evidence) > _CLEAR_ALONE
    reached = crosses and (decay.evidence > 0.0 if clear else evidence > _CLEAR)
    if not crosses and decay.levels_out:
        # a flutter that outlasts the diffuse decay bends the line: the noise itself is better
        reached, end_s = True, _masked_from_s(times, decay.blocks, floor)
    elif crosses and not reached:
        # the last part may be noise or still the decay: it ends where it is twice as high as what
        # may be noise, and nothing is subtracted
        end_s = max(end_s - np.log(2.0) * line[1], float(times[0]))
        used = times <= end_s
        line = decay_line(times[used], decay.blocks[used], _LEAST_ENERGY, span_db=np.inf) or line
    elif not crosses:
        end_s = decay.length_s - decay.spreading_s
    height, constant_s = line
    tail = float(height * constant_s * np.exp(-end_s / constant_s))
    peak_to_noise_db = float(10.0 * np.log10(decay.blocks.max() / floor))
    if not reached:
        floor = min(floor, decay.before)
    return floor, reached, end_s, tail, constant_s, peak_to_noise_db


def _short_decay(times: FloatArray, blocks: FloatArray, floor: float) -> tuple[float, float] | None:
    """Return height and time constant of a decay over within a few blocks, as in a dead room.

    From the loudest block to where the remaining sound has fallen into the noise; None where even
    the loudest is less than 12 dB above the noise.
    """
    peak = int(np.argmax(blocks))
    noise = max(floor, float(np.median(blocks)))  # most of such a file is noise
    drowned_s = _masked_from_s(times, blocks, noise)
    if blocks[peak] < _LOUD * noise or drowned_s <= times[peak]:
        return None
    constant_s = (drowned_s - float(times[peak])) / float(np.log(blocks[peak] / (2.0 * noise)))
    return float(blocks[peak] * np.exp(times[peak] / constant_s)), constant_s


def _mean_of_rest(blocks: FloatArray) -> FloatArray:
    return np.asarray(np.cumsum(blocks[::-1])[::-1] / np.arange(len(blocks), 0, -1))


def _masked_from_s(times: FloatArray, blocks: FloatArray, floor: float) -> float:
    """Return when the mean of all later blocks has fallen to twice the noise."""
    return float(times[np.argmax(_mean_of_rest(blocks) < 2.0 * floor)])


def _floor_and_decay(
    energy: FloatArray, rate_hz: float, times: FloatArray, blocks: FloatArray
) -> tuple[float, tuple[float, float] | None]:
    """Return the noise floor, and height and time constant of the decay above it if there is one.

    Noise and line are estimated in turn, each from the other, until they converge.
    """
    length_s = len(energy) / rate_hz
    latest_s = (1.0 - _TAIL_SHARE) * length_s

    def mean_from(start_s: float) -> float:
        return max(float(energy[int(start_s * rate_hz) :].mean()), _LEAST_ENERGY)

    floor = mean_from(latest_s)
    line = decay_line(times, blocks, floor, span_db=np.inf)
    if line is None:
        return floor, None
    for _ in range(_MOST_ROUNDS):
        crossing_s = _crossing_s(*line, floor, length_s)
        # noise begins where the decay lies 10 dB below it
        floor = mean_from(min(crossing_s + np.log(10.0) * line[1], latest_s))
        following = decay_line(times, blocks, floor, span_db=25.0)
        if following is None:
            break
        line = following
        if abs(_crossing_s(*line, floor, length_s) - crossing_s) < times[1] - times[0]:
            break
    return floor, line


def decay_line(
    times: FloatArray, blocks: FloatArray, floor: float, span_db: float
) -> tuple[float, float] | None:
    """Return height and time constant of the exponential above the noise, or None.

    Times are the middles of equal blocks after the onset, blocks their mean powers with the noise,
    shape (n_blocks,) each; the height is that of the line at time 0. Through the blocks from
    `span_db` above the lowest usable level, which lies 6 dB above the noise, down to that level;
    from the peak on where the decay is not that long. Quiet blocks with louder ones after them, as
    between direct sound and first reflection of a hall, are skipped.
    """
    if not len(blocks):
        return None
    peak = int(np.argmax(blocks))
    below = np.flatnonzero(np.maximum(blocks, _mean_of_rest(blocks))[peak:] < 4.0 * floor)
    stop = peak + int(below[0]) if below.size else len(blocks)
    above = np.flatnonzero(blocks[:stop] > 4.0 * floor * 10.0 ** (0.1 * span_db))
    start = max(peak, int(above[-1])) if above.size else peak
    if stop - start < 4:
        start = max(peak, stop - 4)
    loud = blocks[start:stop] > 2.0 * floor
    if np.count_nonzero(loud) < 3:
        return None
    chosen, net = times[start:stop][loud], blocks[start:stop][loud] - floor
    slope = float(np.polyfit(chosen, np.log(net), 1)[0])
    fallen = float(np.exp(slope * chosen).sum())
    # a line that has fallen to nothing before its first block has no height at time 0: sound that
    # begins hundreds of time constants after the onset does not decay from there
    if not slope < 0.0 or fallen < _LEAST_ENERGY:
        return None
    return float(net.sum()) / fallen, -1.0 / slope


def _crossing_s(height: float, constant_s: float, floor: float, length_s: float) -> float:
    """Return when the exponential has fallen to the noise, within the file."""
    return float(np.clip(constant_s * np.log(height / floor), 0.0, length_s))


def before_rise(energy: FloatArray, independent: float) -> FloatArray:
    """Return the energy without a louder end, which circular deconvolution leaves there.

    A tenth of the file is compared with another, or more where it would have fewer independent
    values (bandwidth times duration, `independent` in the whole file) than the comparison needs.
    """
    size = int(len(energy) * max(_TAIL_SHARE, min(1.0, _FAIR_VALUES / independent)))
    if size == 0:
        return energy
    cumulative = np.concatenate(([0.0], np.cumsum(energy)))
    of_span = cumulative[size:] - cumulative[:-size]
    quietest = int(np.argmin(of_span))
    return energy[: quietest + size] if of_span[-1] > _RISE * of_span[quietest] else energy


def level_before(energy: FloatArray, rate_hz: float, bandwidth_hz: float) -> float:
    """Return the mean square of filtered pressure before a sound; 0 where that part is too short.

    `energy`: pressure squared up to the arrival, by a filter of this statistical bandwidth.
    """
    edge = round(rate_hz / bandwidth_hz)
    quiet = energy[edge : max(len(energy) - round(_RINGS * edge), 0)]
    return float(quiet.mean()) if len(quiet) >= _FEW_VALUES * edge else 0.0


def evidence_of_noise(
    energy: FloatArray, rate_hz: float, bandwidth_hz: float, constant_s: float
) -> float:
    """Return how much likelier energy is noise than a decay, as a log likelihood ratio.

    Its halves are compared: noise has equal ones; of a decay that continues, be it at half the
    rate, the second is quieter. The logarithm of their ratio has the standard deviation
    ``2 / sqrt(B T)``. Near 0 where they are too short to decide.

    `constant_s`: in which the preceding decay fell to 1/e.
    """
    n = len(energy) // 2
    independent = bandwidth_hz * 2 * n / rate_hz
    if independent < 2.0:
        return 0.0
    fall = -0.5 * n / rate_hz / constant_s
    early, late = float(energy[:n].mean()), float(energy[n : 2 * n].mean())
    if not (early > 0.0 and late > 0.0):
        return 0.0
    ratio = float(np.log(late / early))
    return ((ratio - fall) ** 2 - ratio**2) * independent / 8.0
