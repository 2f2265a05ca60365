"""Pressures of image sources that add: the energy of their pulses after the filter of a band."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy import fft
from scipy.special import i0

from roomfit.base.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import BandKind, Bands
from roomfit.base.kernels import kernel
from roomfit.base.typing import BoolArray, ComplexArray, FloatArray, IntArray
from roomfit.model.binned import BinnedPaths, rows_at
from roomfit.model.observation import spread_over_time
from roomfit.model.weighing import EnergyRows, power_table, window_of_rows
from roomfit.room.scene import Scene
from roomfit.signals.filters import energy_bandwidth_hz, frequency_response

# Taps of the gridding kernel and steps of its table between two taps.
TAPS = 6
TABLE_STEPS = 2048
# The octave filter ends at twice its centre; pressures on a grid of eight samples a period of the
# centre have squares that the grid still resolves.
_SAMPLES_PER_PERIOD = 8.0
# A zero-phase octave filter has less than 1e-7 of its energy farther away.
_PADDING_PERIODS = 16.0
# Oversampling is 2: the shape parameter of Beatty, Nishimura and Pauly (2005), eq. 5.
_BETA = np.pi * np.sqrt((TAPS / 2.0) ** 2 * 1.5**2 - 0.8)


@dataclass(frozen=True, slots=True, eq=False)
class BandGrid:
    """The grid of times on which the pressures of one band are added."""

    first_s: float
    rate_hz: float
    n: int
    filter: FloatArray  # (n // 2 + 1,), transfer function from impulses to filtered pressure
    slope: ComplexArray  # (n // 2 + 1,), to minus its time derivative
    table: FloatArray  # (TABLE_STEPS + 2, TAPS), the gridding kernel
    band: Bands  # the one band
    real: Any = np.float32  # precision in which pressures are added


def band_grid(band: Bands, first_s: float, last_s: float) -> BandGrid:
    """Return the grid of a single band that contains the times from first to last.

    Impulses between grid points are spread over six points by a Kaiser-Bessel kernel, whose
    spectrum the filter divides out (P. J. Beatty, D. G. Nishimura, J. M. Pauly, IEEE Trans. Med.
    Imaging 24, 799 (2005)). The pressure is exact to 1e-5 of a path's amplitude.
    """
    return _band_grid(band.kind, float(band.centres_hz[0]), first_s, last_s)


# of the bands of a room: its pairs have the same
@lru_cache(maxsize=32)
def _band_grid(kind: BandKind, nominal_hz: float, first_s: float, last_s: float) -> BandGrid:
    band = Bands(kind, np.array([nominal_hz]))
    centre_hz = float(band.exact_centres_hz[0])
    top_hz = float(band.upper_hz[0] ** 2 / centre_hz)
    rate_hz = 0.5 * _SAMPLES_PER_PERIOD * top_hz
    padding_s = _PADDING_PERIODS / (top_hz - centre_hz)
    half = int(np.ceil(0.5 * (last_s - first_s + 2.0 * padding_s) * rate_hz))
    n = 2 * int(fft.next_fast_len(half, real=True))  # one more than a fast odd length may be slow
    frequencies = fft.rfftfreq(n, 1.0 / rate_hz)
    shape = frequency_response(band, frequencies)[0] / np.sqrt(2.0 * energy_bandwidth_hz(band)[0])
    used = shape > 0.0
    # the Fourier transform of the gridding kernel within its pass band, and its table in time
    argument = np.maximum(_BETA**2 - (np.pi * TAPS * (frequencies / rate_hz)) ** 2, 1e-12)
    argument = np.sqrt(argument)
    kernel = TAPS * np.sinh(argument) / (argument * i0(_BETA))
    behind = np.arange(TABLE_STEPS + 2)[:, None] / TABLE_STEPS
    x = behind + TAPS // 2 - 1 - np.arange(TAPS)
    inside = np.maximum(1.0 - (2.0 * x / TAPS) ** 2, 0.0)
    table = np.where(np.abs(x) <= TAPS / 2, i0(_BETA * np.sqrt(inside)) / i0(_BETA), 0.0)
    transfer = np.where(used, shape / np.where(used, kernel, 1.0), 0.0) * rate_hz
    slope = -2j * np.pi * frequencies * transfer
    return BandGrid(first_s - padding_s, rate_hz, n, transfer, slope, table, band)


def image_pulses(rows: EnergyRows, own: IntArray, absorption: FloatArray) -> FloatArray:
    """Return the pressure of some rows, the root of their energy, shape (n,); air left out."""
    powers = power_table(np.sqrt(1.0 - absorption)[None], rows.max_hits)[0]
    return _pulses(rows.weight_per_m2, rows.hits, own, powers)


@kernel()
def _pulses(weight: FloatArray, hits: IntArray, own: IntArray, powers: FloatArray) -> FloatArray:
    heights = np.empty(len(own))
    for i in range(len(own)):
        heights[i] = math.sqrt(weight[own[i]])
        for m in range(len(powers)):
            heights[i] *= powers[m, hits[own[i], m]]
    return heights


@kernel()
def _gridded(place: FloatArray, heights: FloatArray, table: FloatArray, n: int) -> FloatArray:
    """Return pulses on a grid of n points, each spread over the nearest."""
    out = np.zeros(n)
    for i in range(len(place)):
        behind = math.floor(place[i])
        share = (place[i] - behind) * TABLE_STEPS
        step = int(share)
        share -= step
        for tap in range(TAPS):
            weight = table[step, tap] + share * (table[step + 1, tap] - table[step, tap])
            out[(behind + tap + 1 - TAPS // 2) % n] += weight * heights[i]
    return out


def energy_of_pulses(
    at_s: FloatArray, heights: FloatArray, edges_s: FloatArray, band: Bands
) -> FloatArray:
    """Return the energy of the sum of filtered pulses in windows end to end, shape (n_windows,)."""
    grid = band_grid(band, float(edges_s[0]), float(edges_s[-1]))
    place = (at_s - grid.first_s) * grid.rate_hz
    impulses = _gridded(place, heights, grid.table, grid.n)
    pressure = fft.irfft(fft.rfft(impulses) * grid.filter, grid.n)
    # the square of every sample lasts half a step before and after it
    until = np.concatenate(([0.0], np.cumsum(pressure**2))) / grid.rate_hz
    edges = (edges_s - grid.first_s) * grid.rate_hz + 0.5
    return np.diff(np.interp(edges, np.arange(grid.n + 1.0), until))


def interference(
    scene: Scene,
    bands: Bands,
    binned: BinnedPaths,
    pair: int,
    absorption: FloatArray,
    chosen: BoolArray,
) -> FloatArray:
    """Return what the pressures of image sources add to their energies, shape (n_bands, n_bins).

    Over time as the filters show them; less than 0 where pressures cancel, and 0 in a band that is
    not chosen. Walls turn no phase. Rays, which stand for what has no image, add energies alone.
    """
    edges_s, found = binned.edges_s, np.zeros((len(bands), binned.edges_s.size - 1))
    speed_m_s, air_per_m = speed_of_sound_m_s(scene.air), attenuation_per_m(scene.air, bands)
    for band in np.flatnonzero(chosen):
        one = Bands(bands.kind, bands.centres_hz[band : band + 1])
        rows = rows_at(binned, bands.centres_hz[band])[pair]
        image = np.flatnonzero(rows.batch < 0)
        length_m = rows.length_m[image]
        heights = image_pulses(rows, image, absorption[:, band])
        heights *= np.exp(-0.5 * air_per_m[band] * length_m)
        together = energy_of_pulses(length_m / speed_m_s, heights, edges_s, one)
        alone = np.bincount(window_of_rows(rows)[image], heights**2, edges_s.size - 1).astype(float)
        found[band] = together - spread_over_time(one, alone[None])[0]
    return found
