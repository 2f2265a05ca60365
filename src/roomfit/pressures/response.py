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
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeAlias

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from roomfit.base.errors import InputError
from roomfit.base.kernels import in_threads, kernel
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.model.patterns import amplitude_and_slope, pattern_basis
from roomfit.model.pulses import TABLE_STEPS, TAPS, BandGrid
from roomfit.model.weighing import ROWS_WORTH_THREADS, RowBasis
from roomfit.tracing.paths import Paths, hits, losses, paths_of_pairs

RealArray: TypeAlias = NDArray[np.floating[Any]]
"""Of single or double precision."""

# Columns of a grid are filled up to so many: a remainder costs as much as all the others.
_COLUMNS_AT_ONCE = 8


def root_energies(
    weight: FloatArray, row: IntArray, hits: IntArray, powers: FloatArray
) -> FloatArray:
    """Return ``sqrt(weight) * product of sqrt(x) ** hits`` of every path, shape (n,).

    Path i has the hits of `row[i]`. `powers` is the table of ``sqrt(x) ** h``, shape
    (n_materials, max_hits + 1).
    """
    n, out = len(weight), np.empty(len(weight))
    worth_it = n * hits.shape[1] >= ROWS_WORTH_THREADS
    in_threads(_root_energies, n, weight, row, hits, powers, out, worth_it=worth_it)
    return out


@kernel(allocates=False)
def _root_energies(
    first: int,
    last: int,
    weight: FloatArray,
    row: IntArray,
    hits: IntArray,
    powers: FloatArray,
    out: FloatArray,
) -> None:
    for i in range(first, last):
        root = math.sqrt(weight[i])
        for m in range(hits.shape[1]):
            root *= powers[m, hits[row[i], m]]
        out[i] = root


@kernel()
def grid_impulses(
    first: int,
    last: int,
    offsets: IntArray,
    images: tuple[Any, ...],
    heights: FloatArray,
    shifts: FloatArray,
    times: tuple[Any, ...],
    onto: tuple[Any, ...],
    impulses: RealArray,
) -> None:
    """Add every path's impulses to the grids of its observation; of some observations, for threads.

    Impulses of the given heights, then, where the grids have more columns and one height is given,
    of its derivatives: hits, source, receiver and ln c.

    Shapes: `offsets` (n_observations + 1,), `heights` (n_paths, n_heights), `shifts`
    (n_observations, 6), `impulses` (n_observations, n_grid, n_heights or 8 + n_materials or more).
    `images` are row (n_paths,), away (n_rows, 3), transform (n_rows, 9) and hits; `times` speed,
    latencies and delays; `onto` first time, rate and table (TABLE_STEPS + 2, TAPS) of the grid.
    """
    row, away, image_transform, hits = images
    speed, latency, delays = times
    first_s, rate_hz, table = onto
    n_materials, n_heights = hits.shape[1], heights.shape[1]
    n_grid, n_columns = impulses.shape[1], impulses.shape[2]
    slowness = 1.0 / speed
    for o in range(first, last):
        own = impulses[o]
        # in the precision of the grid: eight single numbers are added at a time
        values = np.zeros(max(n_columns, 8 + n_materials), own.dtype)
        height = np.empty(TAPS, own.dtype)
        for i in range(offsets[o], offsets[o + 1]):
            at = row[i]
            a = image_transform[at]
            s0, s1, s2 = shifts[o, 0], shifts[o, 1], shifts[o, 2]
            v0 = away[at, 0] + shifts[o, 3] - (a[0] * s0 + a[1] * s1 + a[2] * s2)
            v1 = away[at, 1] + shifts[o, 4] - (a[3] * s0 + a[4] * s1 + a[5] * s2)
            v2 = away[at, 2] + shifts[o, 5] - (a[6] * s0 + a[7] * s1 + a[8] * s2)
            square = v0 * v0 + v1 * v1 + v2 * v2
            d = math.sqrt(square)
            t = d * slowness + latency[o]
            for m in range(n_materials):
                t += hits[at, m] * delays[m]
            for j in range(n_heights):
                values[j] = heights[i, j]
            if n_columns > n_heights:
                for m in range(n_materials):
                    values[1 + m] = hits[at, m] * heights[i, 0]
                k = 1 + n_materials
                u = heights[i, 0] * slowness / d
                values[k + 6] = u * square
                v0, v1, v2 = u * v0, u * v1, u * v2
                values[k] = a[0] * v0 + a[3] * v1 + a[6] * v2
                values[k + 1] = a[1] * v0 + a[4] * v1 + a[7] * v2
                values[k + 2] = a[2] * v0 + a[5] * v1 + a[8] * v2
                values[k + 3], values[k + 4], values[k + 5] = v0, v1, v2
            place = (t - first_s) * rate_hz
            behind = math.floor(place)
            low = behind - TAPS // 2 + 1
            share = (place - behind) * TABLE_STEPS
            step = int(share)
            share -= step
            for tap in range(TAPS):
                height[tap] = table[step, tap] + share * (table[step + 1, tap] - table[step, tap])
            inside = low >= 0 and low + TAPS <= n_grid
            for tap in range(TAPS):
                g = low + tap if inside else (low + tap) % n_grid
                cell, times_height = own[g], height[tap]
                for j in range(n_columns):
                    cell[j] += times_height * values[j]


@kernel()
def window_products(
    starts: IntArray,
    edges: FloatArray,
    pressure: RealArray,
    derivatives: RealArray,
    energy: FloatArray,
    slopes: FloatArray,
) -> None:
    """Integrate y^2 and 2 y dy over windows, in samples.

    Shapes: `starts` (n_observations + 1,), `edges` (n_edges,), `pressure` (n_observations, n_grid),
    `derivatives` (n_observations, n_columns, n_grid), `energy` (n_windows,), `slopes` (n_windows,
    n_columns).
    """
    n_columns = derivatives.shape[1]
    for o in range(len(starts) - 1):
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


@kernel(allocates=False)
def binned_energies(
    bins: IntArray,
    row: IntArray,
    hits: IntArray,
    energy: FloatArray,
    total: FloatArray,
    by_hits: FloatArray,
) -> None:
    """Sum energies into bins, and energies times hits: (n_bins,) and (n_materials, n_bins)."""
    for i in range(len(bins)):
        total[bins[i]] += energy[i]
        for m in range(hits.shape[1]):
            by_hits[m, bins[i]] += hits[row[i], m] * energy[i]


@kernel(allocates=False)
def binned_shares(
    bins: IntArray, energy: FloatArray, coherence: FloatArray, out: FloatArray
) -> None:
    """Add g e, e^2 (1 - g^2) and (e (1 - g))^2 of every path into bins, (3, n_bins); -1 is none."""
    for i in range(len(bins)):
        b, e, g = bins[i], energy[i], coherence[i]
        if b >= 0:
            out[0, b] += g * e
            out[1, b] += e * e * (1.0 - g * g)
            random = e * (1.0 - g)
            out[2, b] += random * random


@kernel()
def spread_squared(
    first: int,
    last: int,
    offsets: IntArray,
    row: IntArray,
    away: FloatArray,
    image_transform: RealArray,
    hits: IntArray,
    speed: float,
    roots: FloatArray,
    out: FloatArray,
) -> None:
    """Fill variances of arrival times: squared lengths of each path's slopes D times a root of Cov.

    Of the observations from `first` up to `last`.

    `roots` has the shape (n_observations, 8 + n_materials, k), entries in the order source (3),
    receiver (3), ln c, latency, delays; the other arrays are those of `grid_impulses`.
    """
    n_materials = hits.shape[1]
    for o in range(first, last):
        root = roots[o]
        slopes, along = np.empty(8 + n_materials), np.empty(root.shape[1])
        for i in range(offsets[o], offsets[o + 1]):
            v, a = away[row[i]], image_transform[row[i]]
            length = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
            for axis in range(3):
                turned = a[axis] * v[0] + a[3 + axis] * v[1] + a[6 + axis] * v[2]
                slopes[axis] = -turned / (length * speed)
                slopes[3 + axis] = v[axis] / (length * speed)
            slopes[6] = -length / speed
            slopes[7] = 1.0
            for m in range(n_materials):
                slopes[8 + m] = hits[row[i], m]
            # sums side by side need not wait for each other
            along[:] = 0.0
            for j in range(len(slopes)):
                slope = slopes[j]
                for k in range(root.shape[1]):
                    along[k] += slope * root[j, k]
            total = 0.0
            for k in range(len(along)):
                total += along[k] * along[k]
            out[i] = total


@dataclass(frozen=True, slots=True, eq=False)
class ImagePaths:
    """Image paths of several observations of one band, one observation after the other.

    Hits, places and transforms are those of rows that all bands share; only what differs between
    bands is there once a band.
    """

    materials: tuple[str, ...]
    offsets: IntArray  # int64 (n_observations + 1,)
    weight: FloatArray  # (n_paths,), energy without absorption: spreading, scattering and air
    hits: IntArray  # uint16 (n_rows, n_materials)
    image_to_receiver_m: FloatArray  # (n_rows, 3)
    # (n_rows, 9), orthogonal matrix A of each path, row by row: a source that moves by x moves its
    # image by A x
    image_transform: RealArray
    coherence: FloatArray  # (n_paths,), gamma, 0 to 1
    row: IntArray  # int32 (n_paths,), of each path
    sign: FloatArray | None = None  # (n_paths,), of the source's pressure, 1 or -1; None for all 1
    path: IntArray | None = None  # int32 (n_rows,), of the trace
    reflections: IntArray | None = None  # (n_rows,), on walls; None for all of `hits`

    def lengths_m(self) -> FloatArray:
        """Return the length of every path, shape (n_paths,)."""
        squares = np.einsum("ij,ij->i", self.image_to_receiver_m, self.image_to_receiver_m)
        return np.asarray(np.sqrt(squares)[self.row])


@dataclass(frozen=True, slots=True, eq=False)
class Times:
    """Parameters of the arrival times beside the specified geometry."""

    shifts_m: FloatArray  # (n_observations, 6): displacement of source and receiver
    speed_m_s: float
    latency_s: FloatArray  # (n_observations,)
    delays_s: FloatArray  # (n_materials,): delay that each reflection adds


@dataclass(frozen=True, slots=True, eq=False)
class CoherentResponse:
    """Energies of the coherent pressure, windows of all observations end to end."""

    energy: FloatArray  # (n_windows,), integral of y^2, in the unit of path energies
    by_log_reflected: FloatArray  # (n_windows, n_materials), derivative by ln(1 - alpha)
    # (n_windows, 8 + n_materials), derivative by source (3), receiver (3), ln c, latency and delays
    by_times: FloatArray


def image_paths(
    paths: Paths,
    pairs: IntArray,
    attenuation_per_m: float,
    longest_m: float = np.inf,
    of_pair: Sequence[IntArray] | None = None,
) -> ImagePaths:
    """Return the image paths of each observation's pair, fully coherent.

    Shapes: `pairs` (n_observations,).

    Paths without `image_transform` get the reflection that turns the departure into the arrival in
    its place: right to first order in a source's displacement, and exact in a box.
    """
    of_pair = paths_of_pairs(paths) if of_pair is None else of_pair
    every = [of_pair[pair] for pair in pairs.tolist()]
    own = [o[(paths.batch[o] < 0) & (paths.length_m[o] <= longest_m)] for o in every]
    chosen = np.concatenate([np.zeros(0, dtype=np.int64), *own])
    length = paths.length_m[chosen]
    arrival = paths.arrival.take(chosen, axis=0).astype(np.float64)
    arrival /= np.sqrt(np.einsum("ni,ni->n", arrival, arrival))[:, None]
    departure = paths.departure.take(chosen, axis=0).astype(np.float64)
    matrices = (
        _stand_in(departure, arrival)
        if paths.image_transform is None
        else paths.image_transform.take(chosen, axis=0)
    )
    return ImagePaths(
        paths.materials,
        np.concatenate(([0], np.cumsum([o.size for o in own]))).astype(np.int64),
        paths.weight_per_m2[chosen] * np.exp(-attenuation_per_m * length),
        np.ascontiguousarray(losses(paths, chosen)),
        arrival * length[:, None],
        matrices.reshape(-1, 9),
        np.ones(chosen.size),
        np.arange(chosen.size, dtype=np.int32),
        path=chosen.astype(np.int32),
        reflections=None if paths.objects is None else hits(paths).take(chosen, axis=0).sum(axis=1),
    )


def images_of(images: ImagePaths, observations: IntArray, factors: FloatArray | None) -> ImagePaths:
    """Return the images of some observations with every weight times a factor; rows are shared.

    Shapes: `factors` (n_paths of the trace,).
    """
    kept = np.zeros(images.offsets.size - 1, dtype=np.bool_)
    kept[observations] = True
    counts = np.diff(images.offsets)
    own = images if kept.all() else chosen_paths(images, np.repeat(kept, counts))
    offsets = np.concatenate(([0], np.cumsum(counts[kept]))).astype(np.int64)
    if factors is None or own.path is None:
        return replace(own, offsets=offsets)
    return replace(own, offsets=offsets, weight=own.weight * factors[own.path[own.row]])


def chosen_paths(paths: ImagePaths, keep: BoolArray) -> ImagePaths:
    """Return the paths of a mask, shape (n_paths,), in their observations."""
    before = np.concatenate(([0], np.cumsum(keep)))
    return replace(
        paths,
        offsets=before[paths.offsets].astype(np.int64),
        weight=paths.weight[keep],
        coherence=paths.coherence[keep],
        row=paths.row[keep],
        sign=None if paths.sign is None else paths.sign[keep],
    )


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

    Pressures are added and filtered in single precision, unless the grid is double: exact to 1e-6
    of the largest, finer than the grid. Energies are summed in double precision.

    Shapes: `absorption` (n_materials,).
    """
    n_materials = len(paths.materials)
    powers, weight = _root_powers(paths, absorption), paths.weight * paths.coherence
    roots = root_energies(weight, paths.row, paths.hits, powers)
    if paths.sign is not None:
        roots *= paths.sign
    n_products, parts = 8 + 2 * n_materials if derivative else 0, []
    # few enough for their grids to stay in memory that is at hand: new pages cost as much as sums
    at_once = max(numba.get_num_threads(), 2)
    for o in range(0, len(edges_s), at_once):
        own = edges_s[o : o + at_once]
        if paths.offsets[o] == paths.offsets[o + len(own)]:  # nothing is coherent
            n_windows = sum(e.size - 1 for e in own)
            parts.append((np.zeros(n_windows), np.zeros((n_windows, n_products))))
            continue
        observations = slice(o, o + len(own))
        pressures = _pressures(paths, observations, roots, times, grid, derivative=derivative)
        parts.append(integrated_products(*pressures, grid, own))
    energy, slopes = (np.concatenate(column) for column in zip(*parts, strict=True))
    by_times = np.zeros((energy.size, 8 + n_materials))
    if not derivative:
        return CoherentResponse(energy, by_times[:, 8:], by_times)
    shifted = slopes[:, n_materials:]  # s, hits s, -source, receiver, -ln c
    first = 1 + n_materials
    by_times[:, 0:3] = -shifted[:, first : first + 3]
    by_times[:, 3:6] = shifted[:, first + 3 : first + 6]
    by_times[:, 6] = -shifted[:, first + 6]
    by_times[:, 7] = shifted[:, 0]
    by_times[:, 8:] = shifted[:, 1 : 1 + n_materials]
    return CoherentResponse(energy, 0.5 * slopes[:, :n_materials], by_times)


def _pressures(
    paths: ImagePaths,
    observations: slice,
    roots: FloatArray,
    times: Times,
    grid: BandGrid,
    *,
    derivative: bool,
) -> tuple[RealArray, RealArray]:
    """Return coherent pressures of some observations, (n, n_grid), and their derivatives.

    The latter by ln(1 - a) of each material and by what moves the times of paths, (n, n_columns,
    n_grid); no columns without.
    """
    n_materials = len(paths.materials)
    n_columns = 8 + n_materials if derivative else 1
    filled = -(-n_columns // _COLUMNS_AT_ONCE) * _COLUMNS_AT_ONCE if derivative else 1
    columns = _gridded(paths, observations, roots[:, None], times, grid, filled)[:, :n_columns]
    workers = min(numba.get_num_threads(), 2)
    transfer = grid.filter.astype(grid.real)
    slope = grid.slope.astype(np.result_type(grid.real, np.complex64))
    spectra = fft.rfft(np.ascontiguousarray(columns), axis=-1, workers=workers)
    pressure = fft.irfft(spectra[:, 0] * transfer, grid.n, axis=-1, workers=workers)
    if not derivative:
        return pressure, np.zeros((len(pressure), 0, grid.n), dtype=grid.real)
    level = fft.irfft(spectra[:, 1 : 1 + n_materials] * transfer, grid.n, workers=workers)
    moved = fft.irfft(spectra * slope, grid.n, axis=-1, workers=workers)
    return pressure, np.concatenate((level, moved), axis=1)


def _gridded(
    paths: ImagePaths,
    observations: slice,
    heights: FloatArray,
    times: Times,
    grid: BandGrid,
    n_columns: int,
) -> RealArray:
    """Return the impulses of some observations on the grid, (n, n_columns, n_grid)."""
    first, last = observations.start, observations.stop
    impulses: Any = np.zeros((last - first, grid.n, n_columns), dtype=grid.real)
    in_threads(
        grid_impulses,
        last - first,
        paths.offsets[first : last + 1],
        (paths.row, paths.image_to_receiver_m, paths.image_transform, paths.hits),
        heights,
        times.shifts_m[observations],
        (times.speed_m_s, times.latency_s[observations], times.delays_s),
        (grid.first_s, grid.rate_hz, grid.table),
        impulses,
    )
    return np.asarray(np.swapaxes(impulses, 1, 2))


def integrated_products(
    pressure: RealArray,
    derivatives: RealArray,
    grid: BandGrid,
    edges_s: tuple[FloatArray, ...],
) -> tuple[FloatArray, FloatArray]:
    """Return the integrals of y^2, (n_windows,), and of 2 y dy, (n_windows, n_columns).

    Shapes: `pressure` (n_observations, n_grid), `derivatives` (n_observations, n_columns, n_grid).
    """
    starts = np.concatenate(([0], np.cumsum([e.size for e in edges_s]))).astype(np.int64)
    edges = (np.concatenate(edges_s) - grid.first_s) * grid.rate_hz
    n_windows = int(starts[-1]) - len(edges_s)
    energy, slopes = np.zeros(n_windows), np.zeros((n_windows, derivatives.shape[1]))
    window_products(starts, edges, pressure, derivatives, energy, slopes)
    return energy / grid.rate_hz, slopes / grid.rate_hz


def image_energies(paths: ImagePaths, absorption: FloatArray) -> FloatArray:
    """Return the energy of every path, whatever its coherence, shape (n_paths,)."""
    powers = _root_powers(paths, absorption)
    return np.square(root_energies(paths.weight, paths.row, paths.hits, powers))


def _root_powers(paths: ImagePaths, absorption: FloatArray) -> FloatArray:
    """Return the table of `root_energies`, of absorption that is checked."""
    a = np.asarray(absorption, dtype=np.float64)
    # on the spot: this is done at every evaluation of a fit
    if a.shape != (len(paths.materials),) or not np.all((a >= 0.0) & (a <= 1.0)):
        raise InputError(
            "absorption does not fit the paths or is out of range",
            found=str(absorption),
            needed=f"{len(paths.materials)} values from 0 to 1",
        )
    highest = int(paths.hits.max(initial=0))
    return np.asarray(np.sqrt(1.0 - a)[:, None] ** np.arange(highest + 1, dtype=np.float64))


def _stand_in(departure: FloatArray, arrival: FloatArray) -> NDArray[np.float32]:
    """Return matrices that turn each departure into its arrival, (n, 3, 3).

    Signs on the diagonal where these do, as in a box; otherwise one reflection.
    """
    signs = np.where(departure * arrival < 0.0, -1.0, 1.0)
    out = signs[:, :, None].astype(np.float32) * np.eye(3, dtype=np.float32)
    other = np.flatnonzero(np.abs(departure * signs - arrival).max(axis=1) > 1e-5)
    step = departure[other] - arrival[other]
    squared = np.einsum("ni,ni->n", step, step)[:, None, None]
    out[other] = np.eye(3) - 2.0 * step[:, :, None] * step[:, None, :] / squared
    return out


class DirectedImages(NamedTuple):
    """Image paths of omnidirectional sources, and a directivity of their sources."""

    images: ImagePaths
    amplitude: FloatArray  # (n_paths,), 1 where the directivity is known
    slope: FloatArray  # (n_paths, 3), its derivative by b of the path's own source


def directed_images(images: ImagePaths, amplitude: FloatArray) -> ImagePaths:
    """Return images whose pressures are multiplied by amplitudes of either sign, (n_paths,)."""
    return replace(images, weight=images.weight * amplitude**2, sign=np.sign(amplitude))


def image_basis(images: ImagePaths, aims: Sequence[FloatArray | None]) -> RowBasis:
    """Return `pattern_basis` of image paths, one aim or None an observation, (n_paths, 3)."""
    toward = images.image_to_receiver_m
    toward = toward / np.linalg.norm(toward, axis=1)[:, None]
    departure = np.einsum("nij,ni->nj", images.image_transform.reshape(-1, 3, 3), toward)
    parts = np.split(departure[images.row].astype(np.float32), images.offsets[1:-1])
    return np.concatenate([pattern_basis(p, aim) for p, aim in zip(parts, aims, strict=True)])


def image_amplitudes(
    images: ImagePaths, b: Sequence[FloatArray | None], basis: RowBasis
) -> tuple[FloatArray, FloatArray]:
    """Return amplitude (n,) and slope (n, 3) of every image: 1 and 0 where b is known."""
    amplitude, slope = np.ones(len(basis)), np.zeros((len(basis), 3))
    for o, own_b in enumerate(b):
        if own_b is not None:
            own = slice(images.offsets[o], images.offsets[o + 1])
            amplitude[own], slope[own] = amplitude_and_slope(own_b, basis[own])
    return amplitude, slope


def coherent_slopes(
    directed: DirectedImages,
    absorption: FloatArray,
    times: Times,
    grid: BandGrid,
    edges_s: tuple[FloatArray, ...],
) -> FloatArray:
    """Return the derivative of the energies of the coherent pressure by b of each own source.

    Shape (n_windows, 3). Shapes: `absorption` (n_materials,).
    """
    images, amplitude, slope = directed
    root = np.sqrt(image_energies(images, absorption) * images.coherence)
    heights = np.column_stack([amplitude, slope]) * root[:, None]
    impulses = _gridded(images, slice(0, len(edges_s)), heights, times, grid, 4)
    workers = min(numba.get_num_threads(), 2)
    spectra = fft.rfft(impulses, axis=-1, workers=workers) * grid.filter.astype(grid.real)
    pressure = fft.irfft(spectra, grid.n, workers=workers)
    own, moved = (np.ascontiguousarray(p) for p in (pressure[:, 0], pressure[:, 1:]))
    return integrated_products(own, moved, grid, edges_s)[1]
