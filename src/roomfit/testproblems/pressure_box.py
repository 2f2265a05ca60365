"""Impulse responses of a box from image sources that add as pressures, with phase and noise.

A road to data that shares nothing with the model that is fitted: no rays, no energies, no windows,
no filters of `roomfit.signals`, an own enumeration of the images, positions that differ from the
ones told, a loudspeaker whose gain varies over frequency, and background noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from roomfit.typing import BoolArray, ComplexArray, FloatArray

WALLS = ("west", "east", "south", "north", "floor", "ceiling")

# Images are laid on a grid so many times finer than the samples and brought down by the Fourier
# transform: at 16 times and 16 kHz, half a step is 2 microseconds, 0.05 rad at 4 kHz.
_OVERSAMPLING = 16
_NOTHING = 1e-30  # of energy


@dataclass(frozen=True, slots=True, eq=False)
class BoxTruth:
    """A box whose walls are known.

    Attributes
    ----------
    lengths_m : tuple of three floats
        In x, y, z; one corner at the origin.
    centres_hz : float array, shape (n_bands,)
        Centres of adjacent octaves or third octaves, rising; absorption holds at a centre and
        changes smoothly in between.
    absorption : float array, shape (6, n_bands)
        Energy absorption of west, east, south, north, floor, ceiling.
    attenuation_per_m : float array, shape (n_bands,)
        Energy attenuation of the air.
    speed_of_sound_m_s : float
    delays_s : tuple of six floats
        What each wall adds to the travel time at every reflection, in the order of absorption.
    """

    lengths_m: tuple[float, float, float]
    centres_hz: FloatArray
    absorption: FloatArray
    attenuation_per_m: FloatArray
    speed_of_sound_m_s: float
    delays_s: tuple[float, ...] = (0.0,) * 6


def pressure_response(
    truth: BoxTruth,
    source_m: FloatArray,
    receiver_m: FloatArray,
    duration_s: float,
    sampling_rate_hz: float,
    level_db: FloatArray,
    b: FloatArray | None = None,
) -> FloatArray:
    """Return the sound pressure at the receiver after an impulse at the source at time 0.

    Every image within the duration contributes ``1 / (4 pi r)`` at time r / c, times the root of
    what each wall reflects. What holds at the octaves' centres goes over smoothly in between. The
    loudspeaker's levels come with the phase that a causal filter of least delay has.

    Parameters
    ----------
    truth : BoxTruth
    source_m, receiver_m : float arrays, shape (3,)
    duration_s, sampling_rate_hz : float
    level_db : float array, shape (n_bands,)
        Level of the loudspeaker at each octave's centre.
    b : float array, shape (3,), optional
        The loudspeaker sends with the amplitude ``1 + b . u`` in direction u; left out: alike.

    Returns
    -------
    float array, shape (n_samples,)
        In the unit in which a unit source's direct sound is ``1 / (4 pi r)``, band-limited.
    """
    images = box_images(truth, source_m, receiver_m, duration_s)
    sent = None
    if b is not None:
        sent = 1.0 + box_departures(truth, source_m, receiver_m, duration_s) @ b
    return pressure_of_images(images, truth, duration_s, sampling_rate_hz, level_db, sent)


class WallTruth(Protocol):
    """What is true of walls and air, whatever the shape of the room; see `BoxTruth`."""

    @property
    def centres_hz(self) -> FloatArray: ...
    @property
    def absorption(self) -> FloatArray: ...
    @property
    def attenuation_per_m(self) -> FloatArray: ...
    @property
    def speed_of_sound_m_s(self) -> float: ...
    @property
    def delays_s(self) -> tuple[float, ...]: ...


def pressure_of_images(
    images: tuple[FloatArray, FloatArray],
    truth: WallTruth,
    duration_s: float,
    sampling_rate_hz: float,
    level_db: FloatArray,
    sent: FloatArray | None = None,
) -> FloatArray:
    """Return the sound pressure that images of one pair make together, see `pressure_response`.

    Parameters
    ----------
    images : tuple of float arrays
        Length (n_images,), and hits (n_images, n_walls) in the order of the truth's absorption.
    truth : WallTruth
    duration_s, sampling_rate_hz : float
    level_db : float array, shape (n_bands,)
    sent : float array, shape (n_images,), optional
        Amplitude, of either sign, with which the loudspeaker feeds each image; left out: 1.
    """
    lengths, hits = images
    factor = np.ones(lengths.size) if sent is None else sent
    n_samples = round(duration_s * sampling_rate_hz)
    fine_rate_hz = sampling_rate_hz * _OVERSAMPLING
    # padded to twice the length, so that the tails of the band-limited impulses do not wrap around
    n_fine = 2 * n_samples * _OVERSAMPLING
    times = lengths / truth.speed_of_sound_m_s + hits @ np.array(truth.delays_s)
    index = np.round(times * fine_rate_hz).astype(np.int64)
    frequencies = np.linspace(0.0, 0.5 * sampling_rate_hz, n_samples + 1)
    spectrum = np.zeros(frequencies.size, dtype=np.complex128)
    for band, share in enumerate(octave_shares(truth.centres_hz, frequencies)):
        # a wall of absorption 1 still lets a path pass that never strikes it: 0 times log 0 is 0
        left = np.log(np.maximum(1.0 - truth.absorption[:, band], _NOTHING))
        lost = hits @ left - truth.attenuation_per_m[band] * lengths
        amplitude = factor * np.exp(0.5 * lost) / (4.0 * np.pi * lengths)
        train = np.bincount(index, amplitude, n_fine)
        spectrum += share * np.fft.rfft(train)[: frequencies.size]
    spectrum *= loudspeaker(truth.centres_hz, level_db, frequencies)
    return np.asarray(np.fft.irfft(spectrum, 2 * n_samples)[:n_samples])


def box_images(
    truth: BoxTruth, source_m: FloatArray, receiver_m: FloatArray, duration_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return length (n_images,) and hits per wall (n_images, 6) of all images in time.

    J. B. Allen and D. A. Berkley, "Image method for efficiently simulating small-room acoustics",
    J. Acoust. Soc. Am. 65, 943-950 (1979): along each axis the images lie at 2 n L + s with |n|
    hits on either wall, and at 2 n L - s with |n - 1| on the wall at 0 and |n| on the other.
    """
    steps, hits, _ = box_lattice(truth, source_m, receiver_m, duration_s)
    return np.asarray(np.linalg.norm(steps, axis=0)), hits


def box_departures(
    truth: BoxTruth, source_m: FloatArray, receiver_m: FloatArray, duration_s: float
) -> FloatArray:
    """Return where the sound of each of `box_images` leaves the source, unit vectors (n_images, 3).

    From image to receiver, mirrored along the axes along which the image is.
    """
    steps, _, mirrored = box_lattice(truth, source_m, receiver_m, duration_s)
    away = -steps / np.linalg.norm(steps, axis=0)
    return np.asarray(np.where(mirrored, -away, away).T)


def box_lattice(
    truth: BoxTruth, source_m: FloatArray, receiver_m: FloatArray, duration_s: float
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return steps from receiver to all images in time (3, n), hits (n, 6), where mirrored (3, n).

    Hits count west, east, south, north, floor, ceiling.
    """
    reach_m = truth.speed_of_sound_m_s * duration_s
    offsets, low_hits, high_hits, turned = [], [], [], []
    for length, s, r in zip(truth.lengths_m, source_m, receiver_m, strict=True):
        n = np.arange(-int(reach_m / (2 * length)) - 2, int(reach_m / (2 * length)) + 3)
        offsets.append(np.concatenate((2 * n * length + s - r, 2 * n * length - s - r)))
        low_hits.append(np.concatenate((np.abs(n), np.abs(n - 1))))
        high_hits.append(np.concatenate((np.abs(n), np.abs(n))))
        turned.append(np.repeat([False, True], n.size))
    squares = [o**2 for o in offsets]
    whole = squares[0][:, None, None] + squares[1][:, None] + squares[2]
    chosen = np.nonzero(whole < (reach_m * (1.0 - 1e-9)) ** 2)
    steps = np.stack([offsets[axis][chosen[axis]] for axis in range(3)])
    hits = [h[chosen[axis]] for axis in range(3) for h in (low_hits[axis], high_hits[axis])]
    mirrored = np.stack([turned[axis][chosen[axis]] for axis in range(3)])
    return steps, np.stack(hits, axis=1), mirrored


def add_noise(pressure: FloatArray, level_db: float, rng: np.random.Generator) -> FloatArray:
    """Return the response with white Gaussian noise of a level relative to its peak."""
    sd = float(np.max(np.abs(pressure))) * 10.0 ** (level_db / 20.0)
    return np.asarray(pressure + sd * rng.standard_normal(pressure.size))


def loudspeaker(
    centres_hz: FloatArray, level_db: FloatArray, frequencies_hz: FloatArray
) -> ComplexArray:
    """Return the minimum-phase spectrum whose level runs smoothly through those at the centres.

    Its phase is the Hilbert transform of its log magnitude, by folding the cepstrum.
    A. V. Oppenheim, R. W. Schafer, Discrete-Time Signal Processing, 3rd ed., 2010, section 13.
    """
    steps = _per_octave(centres_hz) * np.log2(np.maximum(frequencies_hz, 1.0) / centres_hz[0])
    level = np.interp(steps, np.arange(centres_hz.size), level_db)
    cepstrum = np.fft.irfft(level * np.log(10.0) / 20.0)
    n = cepstrum.size
    cepstrum[1 : n // 2] *= 2.0
    cepstrum[n // 2 + 1 :] = 0.0
    return np.exp(np.fft.rfft(cepstrum))


def octave_shares(centres_hz: FloatArray, frequencies_hz: FloatArray) -> FloatArray:
    """Return the share of each band at each frequency; shares add to one inside the range.

    Octaves, or third octaves where the centres lie that near. A share falls from 1 at its own
    centre to 0 at its neighbours', so that walls and loudspeaker change smoothly over frequency;
    steps would ring for tens of milliseconds, as no wall does.
    """
    n = _per_octave(centres_hz)
    ends = centres_hz[0] * 2.0 ** (np.arange(-1, centres_hz.size) / n)
    steps = n * np.log2(np.maximum(frequencies_hz, 1e-3)[None, :] / ends[:, None])
    above = 0.5 * (1.0 - np.cos(np.pi * np.clip(steps, 0.0, 1.0)))
    return np.asarray(above[:-1] - above[1:])


def _per_octave(centres_hz: FloatArray) -> int:
    """Return how many bands make an octave; a single band is an octave."""
    return 1 if centres_hz.size < 2 else round(1.0 / float(np.log2(centres_hz[1] / centres_hz[0])))
