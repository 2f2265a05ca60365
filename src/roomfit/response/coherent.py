"""The partly coherent response: pressures of image sources added as far as times are known.

Sums of energies contain no interference of reflections. Where arrival times are known to a fraction
of a period, pressures can be added instead: ``y(t) = sum of sqrt(gamma_i e_i) f(t - t_i)`` with the
band filter's impulse response f and a coherence gamma_i of each path. The energy of a window is the
integral of y^2 and an incoherent part, the sum of ``(1 - gamma_i) e_i``. This module computes the
first part and its derivatives: impulses gridded in time, filtered, and their products summed over
windows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numba
import numpy as np
from scipy import fft
from scipy.special import i0

from roomfit._numba import kernel
from roomfit.errors import InputError
from roomfit.signals.filters import FilterBank, energy_bandwidth_hz, frequency_response
from roomfit.tracing.paths import Paths
from roomfit.typing import BoolArray, FloatArray, IntArray

# Taps of the gridding kernel and steps of its table between two taps.
TAPS = 6
TABLE_STEPS = 2048


@kernel()
def root_energies(weight: FloatArray, hits: IntArray, powers: FloatArray) -> FloatArray:
    """Return ``sqrt(weight) * product of sqrt(x) ** hits`` of every path, shape (n,).

    `powers` is the table of ``sqrt(x) ** h``, shape (n_materials, max_hits + 1).
    """
    out = np.empty(len(weight))
    for i in range(len(weight)):
        root = math.sqrt(weight[i])
        for m in range(hits.shape[1]):
            root *= powers[m, hits[i, m]]
        out[i] = root
    return out


@kernel(parallel=True)
def grid_impulses(
    offsets: IntArray,
    away: FloatArray,
    image_transform: FloatArray,
    hits: IntArray,
    root: FloatArray,
    shifts: FloatArray,
    speed: float,
    latency: FloatArray,
    delays: FloatArray,
    first_s: float,
    rate_hz: float,
    table: FloatArray,
    impulses: FloatArray,
) -> None:
    """Add every path's impulse, times its derivatives, to the grids of its observation.

    Parameters
    ----------
    offsets : shape (n_observations + 1,)
        Which paths belong to each observation.
    away : shape (n_paths, 3)
        From image to receiver, m.
    image_transform : shape (n_paths, 9)
        The product A of a path's reflections, row by row.
    shifts : shape (n_observations, 6)
        Displacement of source and receiver, m.
    impulses : shape (n_observations, n_grid, 8 + n_materials), or (n_observations, n_grid, 1)
        Zeros; filled with impulses of height s; hits s of every material; -dt/dsource s (3),
        dt/dreceiver s (3), and -dt/dln c s (1). A single column contains the first of them.
    """
    n_materials = hits.shape[1]
    n_grid, n_columns = impulses.shape[1], impulses.shape[2]
    half = TAPS // 2
    for o in numba.prange(len(offsets) - 1):
        values = np.empty(8 + n_materials)
        own = impulses[o]
        for i in range(offsets[o], offsets[o + 1]):
            a = image_transform[i]
            v0 = away[i, 0] + shifts[o, 3]
            v1 = away[i, 1] + shifts[o, 4]
            v2 = away[i, 2] + shifts[o, 5]
            s0, s1, s2 = shifts[o, 0], shifts[o, 1], shifts[o, 2]
            v0 -= a[0] * s0 + a[1] * s1 + a[2] * s2
            v1 -= a[3] * s0 + a[4] * s1 + a[5] * s2
            v2 -= a[6] * s0 + a[7] * s1 + a[8] * s2
            d = math.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
            t = d / speed + latency[o]
            s = root[i]
            values[0] = s
            for m in range(n_materials):
                h = hits[i, m]
                t += h * delays[m]
                values[1 + m] = h * s
            if n_columns > 1:
                k = 1 + n_materials
                u = s / (speed * d)
                values[k] = u * (a[0] * v0 + a[3] * v1 + a[6] * v2)
                values[k + 1] = u * (a[1] * v0 + a[4] * v1 + a[7] * v2)
                values[k + 2] = u * (a[2] * v0 + a[5] * v1 + a[8] * v2)
                values[k + 3] = u * v0
                values[k + 4] = u * v1
                values[k + 5] = u * v2
                values[k + 6] = s * d / speed
            place = (t - first_s) * rate_hz
            low = math.floor(place) - half + 1
            inside = low >= 0 and low + TAPS <= n_grid
            for tap in range(TAPS):
                distance = (abs(low + tap - place)) * TABLE_STEPS
                step = int(distance)
                share = distance - step
                height = table[step] + share * (table[step + 1] - table[step])
                # a remainder costs as much as all the sums of a tap
                g = low + tap if inside else (low + tap) % n_grid
                row = own[g]
                for j in range(n_columns):
                    row[j] += height * values[j]


@kernel(parallel=True)
def window_products(
    starts: IntArray,
    edges: FloatArray,
    pressure: FloatArray,
    derivatives: FloatArray,
    energy: FloatArray,
    slopes: FloatArray,
) -> None:
    """Integrate y^2 and 2 y dy over windows, in samples.

    Parameters
    ----------
    starts : shape (n_observations + 1,)
        Where each observation's edges begin; it has one window fewer than edges.
    edges : shape (n_edges,)
        In samples; sample k stands for the time from k - 1/2 to k + 1/2.
    pressure : shape (n_observations, n_grid)
    derivatives : shape (n_observations, n_columns, n_grid)
    energy : shape (n_windows,)
        Windows of all observations end to end.
    slopes : shape (n_windows, n_columns)
    """
    n_columns = derivatives.shape[1]
    for o in numba.prange(len(starts) - 1):
        y, dy = pressure[o], derivatives[o]
        weighed = np.empty(len(y))
        for e in range(starts[o], starts[o + 1] - 1):
            w = e - o
            low, high = edges[e] + 0.5, edges[e + 1] + 0.5
            first, last = max(math.floor(low), 0), min(math.floor(high), len(y) - 1)
            total = 0.0
            for k in range(first, last + 1):
                weighed[k] = (min(high, k + 1.0) - max(low, 1.0 * k)) * y[k]
                total += weighed[k] * y[k]
            energy[w] = total
            # four sums at a time need not wait for each other
            for j in range(0, n_columns - 3, 4):
                a, b, c, d = 0.0, 0.0, 0.0, 0.0
                for k in range(first, last + 1):
                    a += weighed[k] * dy[j, k]
                    b += weighed[k] * dy[j + 1, k]
                    c += weighed[k] * dy[j + 2, k]
                    d += weighed[k] * dy[j + 3, k]
                slopes[w, j], slopes[w, j + 1] = 2.0 * a, 2.0 * b
                slopes[w, j + 2], slopes[w, j + 3] = 2.0 * c, 2.0 * d
            for j in range(n_columns - n_columns % 4, n_columns):
                a = 0.0
                for k in range(first, last + 1):
                    a += weighed[k] * dy[j, k]
                slopes[w, j] = 2.0 * a


@kernel()
def binned_energies(
    bins: IntArray, hits: IntArray, energy: FloatArray, total: FloatArray, by_hits: FloatArray
) -> None:
    """Sum energies into bins, and energies times hits: (n_bins,) and (n_materials, n_bins)."""
    for i in range(len(bins)):
        total[bins[i]] += energy[i]
        for m in range(hits.shape[1]):
            by_hits[m, bins[i]] += hits[i, m] * energy[i]


@kernel()
def spread_squared(
    offsets: IntArray,
    toward: FloatArray,
    departure: FloatArray,
    travel: FloatArray,
    hits: IntArray,
    speed: float,
    roots: FloatArray,
    out: FloatArray,
) -> None:
    """Variance of arrival times: the squared length of each path's row D times a root of Cov.

    `roots` has the shape (n_observations, 8 + n_materials, k), entries in the order source (3),
    receiver (3), ln c, latency, delays.
    """
    n_materials = hits.shape[1]
    for o in range(len(offsets) - 1):
        root = roots[o]
        row = np.empty(8 + n_materials)
        for i in range(offsets[o], offsets[o + 1]):
            for axis in range(3):
                row[axis] = -departure[i, axis] / speed
                row[3 + axis] = toward[i, axis] / speed
            row[6] = -travel[i]
            row[7] = 1.0
            for m in range(n_materials):
                row[8 + m] = hits[i, m]
            total = 0.0
            for k in range(root.shape[1]):
                dot = 0.0
                for j in range(len(row)):
                    dot += row[j] * root[j, k]
                total += dot * dot
            out[i] = total


# The octave filter ends at twice its centre; pressures on a grid of eight samples a period of the
# centre have squares that the grid still resolves.
_SAMPLES_PER_PERIOD = 8.0
# A zero-phase octave filter has less than 1e-7 of its energy farther away.
_PADDING_PERIODS = 16.0
# Oversampling is 2: the shape parameter of Beatty, Nishimura and Pauly (2005), eq. 5.
_BETA = np.pi * np.sqrt((TAPS / 2.0) ** 2 * 1.5**2 - 0.8)


@dataclass(frozen=True, slots=True, eq=False)
class ImagePaths:
    """Image paths of several observations of one band, one observation after the other."""

    materials: tuple[str, ...]
    offsets: IntArray  # int64 (n_observations + 1,)
    weight: FloatArray  # (n_paths,), energy without absorption: spreading, scattering and air
    hits: IntArray  # uint16 (n_paths, n_materials)
    image_to_receiver_m: FloatArray  # (n_paths, 3)
    # (n_paths, 9), orthogonal matrix A of each path, row by row: a source that moves by x moves its
    # image by A x
    image_transform: FloatArray
    coherence: FloatArray  # (n_paths,), gamma, 0 to 1
    sign: FloatArray | None = None  # (n_paths,), of the source's pressure, 1 or -1; None for all 1


@dataclass(frozen=True, slots=True, eq=False)
class Times:
    """Parameters of the arrival times beside the specified geometry."""

    shifts_m: FloatArray  # (n_observations, 6): displacement of source and receiver
    speed_m_s: float
    latency_s: FloatArray  # (n_observations,)
    delays_s: FloatArray  # (n_materials,): delay that each reflection adds


@dataclass(frozen=True, slots=True, eq=False)
class BandGrid:
    """The grid of times on which the pressures of one band are added."""

    first_s: float
    rate_hz: float
    n: int
    filter: FloatArray  # (n // 2 + 1,), transfer function from impulses to filtered pressure
    slope: FloatArray  # (n // 2 + 1,), to minus its time derivative
    table: FloatArray  # the gridding kernel


@dataclass(frozen=True, slots=True, eq=False)
class CoherentResponse:
    """Energies of the coherent pressure, windows of all observations end to end."""

    energy: FloatArray  # (n_windows,), integral of y^2, in the unit of path energies
    by_log_reflected: FloatArray  # (n_windows, n_materials), derivative by ln(1 - alpha)
    # (n_windows, 8 + n_materials), derivative by source (3), receiver (3), ln c, latency and delays
    by_times: FloatArray


def image_paths(
    paths: Paths, pairs: IntArray, attenuation_per_m: float, longest_m: float = np.inf
) -> ImagePaths:
    """Return the image paths of each observation's pair, fully coherent.

    Parameters
    ----------
    paths : Paths
        Rays among them are left out.
    pairs : int array, shape (n_observations,)
    attenuation_per_m : float
        Energy attenuation of the air.
    longest_m : float
        Longer paths are left out.

    Notes
    -----
    Paths without `image_transform` get the reflection that turns the departure into the arrival in
    its place: right to first order in a source's displacement, and exact in a box.
    """
    image = (paths.batch < 0) & (paths.length_m <= longest_m)
    own = [np.flatnonzero(image & (paths.pair == pair)) for pair in pairs]
    chosen = np.concatenate([np.zeros(0, dtype=np.int64), *own])
    length = paths.length_m[chosen]
    arrival = paths.arrival[chosen].astype(np.float64)
    arrival /= np.sqrt(np.einsum("ni,ni->n", arrival, arrival))[:, None]
    departure = paths.departure[chosen].astype(np.float64)
    matrices = (
        _stand_in(departure, arrival)
        if paths.image_transform is None
        else paths.image_transform[chosen].astype(np.float64)
    )
    return ImagePaths(
        paths.materials,
        np.concatenate(([0], np.cumsum([o.size for o in own]))).astype(np.int64),
        paths.weight_per_m2[chosen] * np.exp(-attenuation_per_m * length),
        np.ascontiguousarray(paths.hits_specular[chosen] + paths.hits_diffuse[chosen]),
        arrival * length[:, None],
        matrices.reshape(-1, 9),
        np.ones(chosen.size),
    )


def chosen_paths(paths: ImagePaths, keep: BoolArray) -> ImagePaths:
    """Return the paths of a mask, shape (n_paths,), in their observations."""
    before = np.concatenate(([0], np.cumsum(keep)))
    return replace(
        paths,
        offsets=before[paths.offsets].astype(np.int64),
        weight=paths.weight[keep],
        hits=np.ascontiguousarray(paths.hits[keep]),
        image_to_receiver_m=paths.image_to_receiver_m[keep],
        image_transform=paths.image_transform[keep],
        coherence=paths.coherence[keep],
        sign=None if paths.sign is None else paths.sign[keep],
    )


def band_grid(bank: FilterBank, first_s: float, last_s: float) -> BandGrid:
    """Return a grid for the only band of a bank that contains the times from first to last.

    Notes
    -----
    Impulses between grid points are spread over six points by a Kaiser-Bessel kernel, whose
    spectrum the filter divides out [1]_. The pressure is exact to 1e-5 of a path's amplitude.

    References
    ----------
    .. [1] P. J. Beatty, D. G. Nishimura, J. M. Pauly, "Rapid gridding reconstruction with a
           minimal oversampling ratio", IEEE Trans. Med. Imaging 24, 799-808 (2005).
    """
    if len(bank.bands) != 1:
        raise InputError("a grid belongs to one band", found=f"{len(bank.bands)} bands")
    top_hz = float(bank.bands.upper_hz[0] ** 2 / bank.bands.exact_centres_hz[0])
    rate_hz = 0.5 * _SAMPLES_PER_PERIOD * top_hz
    padding_s = _PADDING_PERIODS / (top_hz - float(bank.bands.exact_centres_hz[0]))
    n = fft.next_fast_len(int(np.ceil((last_s - first_s + 2.0 * padding_s) * rate_hz)), real=True)
    n += n % 2
    frequencies = fft.rfftfreq(n, 1.0 / rate_hz)
    shape = frequency_response(bank, frequencies)[0]
    shape = shape / np.sqrt(2.0 * energy_bandwidth_hz(bank)[0])
    used = shape > 0.0
    # the Fourier transform of the gridding kernel within its pass band, and its table in time
    argument = np.maximum(_BETA**2 - (np.pi * TAPS * (frequencies / rate_hz)) ** 2, 1e-12)
    argument = np.sqrt(argument)
    kernel = TAPS * np.sinh(argument) / (argument * i0(_BETA))
    x = np.arange(TAPS // 2 * TABLE_STEPS + 2 * TABLE_STEPS) / TABLE_STEPS
    inside = np.maximum(1.0 - (2.0 * x / TAPS) ** 2, 0.0)
    table = np.where(x <= TAPS / 2, i0(_BETA * np.sqrt(inside)) / i0(_BETA), 0.0)
    transfer = np.where(used, shape / np.where(used, kernel, 1.0), 0.0) * rate_hz
    slope = -2j * np.pi * frequencies * transfer
    return BandGrid(first_s - padding_s, rate_hz, n, transfer, slope, table)


def coherent_response(
    paths: ImagePaths,
    absorption: FloatArray,
    times: Times,
    grid: BandGrid,
    edges_s: tuple[FloatArray, ...],
    *,
    derivative: bool = True,
) -> CoherentResponse:
    """Return the energy of the coherent pressure in every window, with its derivatives.

    Parameters
    ----------
    paths : ImagePaths
        Amplitudes are those of the specified geometry; only times move with `times`.
    absorption : float array, shape (n_materials,)
        Below 1.
    edges_s : tuple of float arrays, one an observation
        Window edges, not before the grid nor behind its last time.
    derivative : bool
        False leaves the derivatives zero.
    """
    n_columns = 8 + len(paths.materials) if derivative else 1
    impulses = np.zeros((len(edges_s), grid.n, n_columns))
    grid_impulses(
        paths.offsets,
        paths.image_to_receiver_m,
        paths.image_transform,
        paths.hits,
        _roots(paths, absorption),
        times.shifts_m,
        times.speed_m_s,
        times.latency_s,
        times.delays_s,
        grid.first_s,
        grid.rate_hz,
        grid.table,
        impulses,
    )
    n_materials = len(paths.materials)
    spectra = fft.rfft(np.ascontiguousarray(np.swapaxes(impulses, 1, 2)), axis=-1, workers=2)
    pressure = fft.irfft(spectra[:, 0] * grid.filter, grid.n, axis=-1, workers=2)
    if not derivative:
        energy, _ = integrated_products(
            pressure, np.zeros((len(edges_s), 0, grid.n)), grid, edges_s
        )
        n = energy.size
        return CoherentResponse(energy, np.zeros((n, n_materials)), np.zeros((n, 8 + n_materials)))
    level = fft.irfft(spectra[:, 1 : 1 + n_materials] * grid.filter, grid.n, workers=2)
    moved = fft.irfft(spectra * grid.slope, grid.n, axis=-1, workers=2)
    columns = np.concatenate((level, moved), axis=1)
    energy, slopes = integrated_products(pressure, columns, grid, edges_s)
    shifted = slopes[:, n_materials:]  # s, hits s, -source, receiver, -ln c
    first = 1 + n_materials
    by_times = np.zeros((energy.size, 8 + n_materials))
    by_times[:, 0:3] = -shifted[:, first : first + 3]
    by_times[:, 3:6] = shifted[:, first + 3 : first + 6]
    by_times[:, 6] = -shifted[:, first + 6]
    by_times[:, 7] = shifted[:, 0]
    by_times[:, 8:] = shifted[:, 1 : 1 + n_materials]
    return CoherentResponse(energy, 0.5 * slopes[:, :n_materials], by_times)


def integrated_products(
    pressure: FloatArray, derivatives: FloatArray, grid: BandGrid, edges_s: tuple[FloatArray, ...]
) -> tuple[FloatArray, FloatArray]:
    """Return the integrals of y^2, (n_windows,), and of 2 y dy, (n_windows, n_columns).

    Parameters
    ----------
    pressure : float array, shape (n_observations, n_grid)
    derivatives : float array, shape (n_observations, n_columns, n_grid)
    edges_s : tuple of float arrays, one an observation
        Window edges; the windows of all observations follow each other.
    """
    starts = np.concatenate(([0], np.cumsum([e.size for e in edges_s]))).astype(np.int64)
    edges = (np.concatenate(edges_s) - grid.first_s) * grid.rate_hz
    n_windows = int(starts[-1]) - len(edges_s)
    energy, slopes = np.zeros(n_windows), np.zeros((n_windows, derivatives.shape[1]))
    window_products(starts, edges, pressure, derivatives, energy, slopes)
    return energy / grid.rate_hz, slopes / grid.rate_hz


def image_energies(paths: ImagePaths, absorption: FloatArray) -> FloatArray:
    """Return the energy of every path, whatever its coherence, shape (n_paths,)."""
    return np.asarray(_roots(replace(paths, coherence=np.ones(paths.weight.size)), absorption) ** 2)


def _roots(paths: ImagePaths, absorption: FloatArray) -> FloatArray:
    a = np.asarray(absorption, dtype=np.float64)
    # on the spot: this is done at every evaluation of a fit
    if a.shape != (len(paths.materials),) or not np.all((a >= 0.0) & (a <= 1.0)):
        raise InputError(
            "absorption does not fit the paths or is out of range",
            found=str(absorption),
            needed=f"{len(paths.materials)} values from 0 to 1",
        )
    highest = int(paths.hits.max(initial=0))
    powers = np.sqrt(1.0 - a)[:, None] ** np.arange(highest + 1, dtype=np.float64)
    roots = root_energies(paths.weight * paths.coherence, paths.hits, np.asarray(powers))
    return roots if paths.sign is None else roots * paths.sign


def _stand_in(departure: FloatArray, arrival: FloatArray) -> FloatArray:
    """Return matrices that turn each departure into its arrival, (n, 3, 3).

    Signs on the diagonal where these do, as in a box; otherwise one reflection.
    """
    signs = np.where(departure * arrival < 0.0, -1.0, 1.0)
    out = signs[:, :, None] * np.eye(3)
    other = np.flatnonzero(np.abs(departure * signs - arrival).max(axis=1) > 1e-5)
    step = departure[other] - arrival[other]
    squared = np.einsum("ni,ni->n", step, step)[:, None, None]
    out[other] = np.eye(3) - 2.0 * step[:, :, None] * step[:, None, :] / squared
    return np.asarray(out)
