"""First-order sources whose directivity is not known: rows and images weighed anew, with slopes.

The amplitude in direction u is ``a = (1 + b . u) / sqrt(1 + |b|**2 / 3)``, the energy its square.
Pressures are linear in a, energies of paths that add quadratic: slopes are exact for both.
"""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from roomfit.compiled import kernel
from roomfit.response.coherent import BandGrid, ImagePaths, Times, image_energies
from roomfit.response.coherent_kernels import TABLE_STEPS, TAPS, window_products
from roomfit.response.rows import EnergyRows
from roomfit.typing import FloatArray, IntArray


def amplitude_and_slope(
    b: FloatArray, departure: NDArray[np.float32] | FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the amplitude a of every direction, (n,), and its derivative by b, (n, 3).

    Parameters
    ----------
    b : float array, shape (3,)
    departure : float array, shape (n, 3)
        Unit vectors away from the source.
    """
    u = departure.astype(np.float64)
    root = np.sqrt(1.0 + b @ b / 3.0)
    amplitude = (1.0 + u @ b) / root
    return np.asarray(amplitude), u / root - amplitude[:, None] * b / (3.0 * root**2)


def image_departure(images: ImagePaths) -> NDArray[np.float32]:
    """Return where every image path leaves its source, unit vectors, shape (n_paths, 3)."""
    toward = images.away_m / np.linalg.norm(images.away_m, axis=1)[:, None]
    u = np.einsum("nij,ni->nj", images.unfolding.reshape(-1, 3, 3), toward)
    return np.asarray(u, dtype=np.float32)


def directed_rows(rows: EnergyRows, factor: FloatArray) -> EnergyRows:
    """Return rows with every weight times a factor of its own, shape (n_rows,), of either sign."""
    return replace(rows, weight_per_m2=rows.weight_per_m2 * factor)


def directed_images(images: ImagePaths, amplitude: FloatArray) -> ImagePaths:
    """Return images whose pressures are multiplied by amplitudes of either sign, (n_paths,)."""
    return replace(images, weight=images.weight * amplitude**2, sign=np.sign(amplitude))


def coherent_slopes(
    images: ImagePaths,
    absorption: FloatArray,
    times: Times,
    grid: BandGrid,
    edges_s: tuple[FloatArray, ...],
    amplitude: FloatArray,
    slope: FloatArray,
) -> FloatArray:
    """Return the derivative of the energies of the coherent pressure by b of each own source.

    Parameters
    ----------
    images : ImagePaths
        With the weights of omnidirectional sources.
    absorption : float array, shape (n_materials,)
    times, grid, edges_s
        As for `roomfit.response.coherent.coherent_response`.
    amplitude, slope : float arrays, shapes (n_paths,) and (n_paths, 3)
        From `amplitude_and_slope`.

    Returns
    -------
    float array, shape (n_windows, 3)
        ``2 * integral of y dy/db`` over every window, observations end to end.
    """
    root = np.sqrt(image_energies(images, absorption) * images.coherence)
    heights = np.column_stack([amplitude, slope]) * root[:, None]
    trains = np.zeros((len(edges_s), 4, grid.n))
    arrivals = arrival_times_s(images, times)
    lay_spikes(images.offsets, arrivals, heights, grid.first_s, grid.rate_hz, grid.table, trains)
    pressure = fft.irfft(fft.rfft(trains, axis=-1, workers=2) * grid.filter, grid.n, workers=2)
    starts = np.concatenate(([0], np.cumsum([e.size for e in edges_s]))).astype(np.int64)
    edges = (np.concatenate(edges_s) - grid.first_s) * grid.rate_hz
    n_windows = int(starts[-1]) - len(edges_s)
    energy, slopes = np.zeros(n_windows), np.zeros((n_windows, 3))
    own, moved = (np.ascontiguousarray(p) for p in (pressure[:, 0], pressure[:, 1:]))
    window_products(starts, edges, own, moved, energy, slopes)
    return np.asarray(slopes / grid.rate_hz)


def arrival_times_s(images: ImagePaths, times: Times) -> FloatArray:
    """Return when every image path arrives, shape (n_paths,)."""
    counts = np.diff(images.offsets)
    shift = np.repeat(times.shifts_m, counts, axis=0)
    turned = np.einsum("nij,nj->ni", images.unfolding.reshape(-1, 3, 3), shift[:, :3])
    length = np.linalg.norm(images.away_m + shift[:, 3:] - turned, axis=1)
    late = np.repeat(times.latency_s, counts) + images.hits @ times.delays_s
    return np.asarray(length / times.speed_m_s + late)


@kernel(parallel=True)
def lay_spikes(
    offsets: IntArray,
    time_s: FloatArray,
    heights: FloatArray,
    first_s: float,
    rate_hz: float,
    table: FloatArray,
    trains: FloatArray,
) -> None:
    """Lay spikes of several heights at each path's time upon the grids of its observation.

    Parameters
    ----------
    offsets : shape (n_observations + 1,)
    time_s : shape (n_paths,)
    heights : shape (n_paths, n_columns)
    trains : shape (n_observations, n_columns, n_grid)
        Zeros; filled.
    """
    n_grid = trains.shape[2]
    for o in numba.prange(len(offsets) - 1):
        own = trains[o]
        for i in range(offsets[o], offsets[o + 1]):
            place = (time_s[i] - first_s) * rate_hz
            low = int(np.floor(place)) - TAPS // 2 + 1
            for tap in range(TAPS):
                distance = abs(low + tap - place) * TABLE_STEPS
                step = int(distance)
                height = table[step] + (distance - step) * (table[step + 1] - table[step])
                g = (low + tap) % n_grid
                for j in range(heights.shape[1]):
                    own[j, g] += height * heights[i, j]
