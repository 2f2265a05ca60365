"""Pressures of image sources whose sources radiate as patterns of few unknowns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from roomfit.base.kernels import in_threads, kernel
from roomfit.base.typing import FloatArray, IntArray
from roomfit.model.patterns import amplitude_and_slope, pattern_basis
from roomfit.model.pulses import TABLE_STEPS, TAPS, BandGrid
from roomfit.model.weighing import RowBasis
from roomfit.pressures.response import (
    ImagePaths,
    RealArray,
    Times,
    image_energies,
    integrated_products,
)


class DirectedImages(NamedTuple):
    """Image paths of omnidirectional sources, and a directivity of their sources."""

    images: ImagePaths
    amplitude: FloatArray  # (n_paths,), 1 where the directivity is known
    slope: FloatArray  # (n_paths, 3), its derivative by b of the path's own source


def image_departure(images: ImagePaths) -> NDArray[np.float32]:
    """Return where every image path leaves its source, unit vectors, shape (n_paths, 3)."""
    away_m = images.image_to_receiver_m
    toward = away_m / np.linalg.norm(away_m, axis=1)[:, None]
    u = np.einsum("nij,ni->nj", images.image_transform.reshape(-1, 3, 3), toward)
    return np.asarray(u[images.row], dtype=np.float32)


def directed_images(images: ImagePaths, amplitude: FloatArray) -> ImagePaths:
    """Return images whose pressures are multiplied by amplitudes of either sign, (n_paths,)."""
    return replace(images, weight=images.weight * amplitude**2, sign=np.sign(amplitude))


def image_basis(images: ImagePaths, aims: Sequence[FloatArray | None]) -> RowBasis:
    """Return `pattern_basis` of image paths, one aim or None an observation, (n_paths, 3)."""
    parts = np.split(image_departure(images), images.offsets[1:-1])
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
    impulses: Any = np.zeros((len(edges_s), 4, grid.n), dtype=grid.real)
    rows = images.image_to_receiver_m, images.image_transform, images.hits
    moved_by = times.shifts_m, times.speed_m_s, times.latency_s, times.delays_s
    onto = grid.first_s, grid.rate_hz, grid.table, impulses
    paths = images.offsets, images.row, *rows, heights
    in_threads(grid_directed_impulses, len(edges_s), *paths, *moved_by, *onto)
    workers = min(numba.get_num_threads(), 2)
    spectra = fft.rfft(impulses, axis=-1, workers=workers) * grid.filter.astype(grid.real)
    pressure = fft.irfft(spectra, grid.n, workers=workers)
    own, moved = (np.ascontiguousarray(p) for p in (pressure[:, 0], pressure[:, 1:]))
    return integrated_products(own, moved, grid, edges_s)[1]


@kernel(allocates=False)
def grid_directed_impulses(
    first: int,
    last: int,
    offsets: IntArray,
    row: IntArray,
    away: FloatArray,
    image_transform: RealArray,
    hits: IntArray,
    heights: FloatArray,
    shifts: FloatArray,
    speed: float,
    latency: FloatArray,
    delays: FloatArray,
    first_s: float,
    rate_hz: float,
    table: FloatArray,
    impulses: RealArray,
) -> None:
    """Add impulses of several heights at each path's time to the grids of some observations.

    Shapes: `heights` (n_paths, n_columns), `impulses` (n_observations, n_columns, n_grid).
    """
    n_grid = impulses.shape[2]
    for o in range(first, last):
        own, s = impulses[o], shifts[o]
        for i in range(offsets[o], offsets[o + 1]):
            at, square, late = row[i], 0.0, latency[o]
            for k in range(3):
                along = away[at, k] + s[3 + k]
                for j in range(3):
                    along -= image_transform[at, 3 * k + j] * s[j]
                square += along * along
            for m in range(hits.shape[1]):
                late += hits[at, m] * delays[m]
            place = (math.sqrt(square) / speed + late - first_s) * rate_hz
            behind = int(np.floor(place))
            share = (place - behind) * TABLE_STEPS
            step = int(share)
            share -= step
            for tap in range(TAPS):
                height = table[step, tap] + share * (table[step + 1, tap] - table[step, tap])
                g = (behind - TAPS // 2 + 1 + tap) % n_grid
                for j in range(heights.shape[1]):
                    own[j, g] += height * heights[i, j]
