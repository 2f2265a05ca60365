"""Compiled loops over energy rows. Same bits for any number of threads.

Rows are summed in pieces of fixed length, each by one thread in row order, and the pieces in
order: how the threads share the pieces does not show in the result.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from roomfit.compiled import kernel
from roomfit.typing import FloatArray, IntArray

PIECE = 8192
# Rows of a block stay in the first-level cache while all bands pass over them.
_BLOCK = 256
# Below it the derivative is taken from the power table: e h / x loses its digits near x = 0.
_NEARLY_BLACK = 1e-6


@kernel()
def power_table(reflected: FloatArray, max_hits: int) -> FloatArray:
    """Return ``x ** h`` for h = 0 to max_hits, shape (n_bands, n_materials, max_hits + 1).

    Parameters
    ----------
    reflected : float array, shape (n_bands, n_materials)
        x = 1 - a. ``0 ** 0`` is 1.
    """
    n_bands, n_materials = reflected.shape
    table = np.empty((n_bands, n_materials, max_hits + 1))
    for b in range(n_bands):
        for m in range(n_materials):
            for h in range(max_hits + 1):
                table[b, m, h] = reflected[b, m] ** float(h)
    return table


@kernel()
def pieces_of(offsets: IntArray) -> IntArray:
    """Cut every window into pieces of at most `PIECE` rows: (window, first row, last + 1)."""
    n = 0
    for w in range(len(offsets) - 1):
        n += -(-(offsets[w + 1] - offsets[w]) // PIECE)
    pieces = np.empty((n, 3), dtype=np.int64)
    i = 0
    for w in range(len(offsets) - 1):
        for start in range(offsets[w], offsets[w + 1], PIECE):
            pieces[i, 0] = w
            pieces[i, 1] = start
            pieces[i, 2] = min(start + PIECE, offsets[w + 1])
            i += 1
    return pieces


@kernel()
def _row_energy(
    weight: float, length: float, row_hits: IntArray, powers: FloatArray, attenuation: float
) -> float:
    energy = weight
    if attenuation != 0.0:
        energy *= math.exp(-attenuation * length)
    for m in range(len(row_hits)):
        energy *= powers[m, row_hits[m]]
    return energy


@kernel()
def _slope_at_black(
    weight: float, length: float, row_hits: IntArray, powers: FloatArray, attenuation: float, m: int
) -> float:
    """Derivative of one row by x of material m from h x**(h - 1), right at x = 0 as well."""
    h = row_hits[m]
    if h == 0:
        return 0.0
    slope: float = weight * math.exp(-attenuation * length) * h * powers[m, h - 1]
    for k in range(len(row_hits)):
        if k != m:
            slope *= powers[k, row_hits[k]]
    return slope


@kernel()
def _weigh_piece(
    start: int,
    stop: int,
    weight: FloatArray,
    hits: IntArray,
    length: FloatArray,
    reflected: FloatArray,
    powers: FloatArray,
    attenuation: FloatArray,
    energy: FloatArray,
    slope: FloatArray,
) -> None:
    """Add rows start to stop into energy (n_bands,) and slope by x (n_bands, n_materials).

    A slope without materials, shape (n_bands, 0), asks for energies alone.
    """
    for low in range(start, stop, _BLOCK):
        high = min(low + _BLOCK, stop)
        for b in range(len(attenuation)):
            total = 0.0
            for r in range(low, high):
                e = _row_energy(weight[r], length[r], hits[r], powers[b], attenuation[b])
                total += e
                for m in range(slope.shape[1]):
                    slope[b, m] += e * hits[r, m]
            energy[b] += total
    for b in range(len(attenuation)):
        for m in range(slope.shape[1]):
            if reflected[b, m] >= _NEARLY_BLACK:
                slope[b, m] /= reflected[b, m]
                continue
            slope[b, m] = 0.0
            for r in range(start, stop):
                slope[b, m] += _slope_at_black(
                    weight[r], length[r], hits[r], powers[b], attenuation[b], m
                )


@kernel()
def weigh_serial(
    pieces: IntArray,
    weight: FloatArray,
    hits: IntArray,
    length: FloatArray,
    reflected: FloatArray,
    powers: FloatArray,
    attenuation: FloatArray,
    energies: FloatArray,
    slopes: FloatArray,
) -> None:
    """Fill energies (n_pieces, n_bands) and slopes by x (n_pieces, n_bands, n_materials or 0)."""
    for p in range(len(pieces)):
        _weigh_piece(
            *(pieces[p, 1], pieces[p, 2], weight, hits, length, reflected, powers, attenuation),
            *(energies[p], slopes[p]),
        )


@kernel(parallel=True)
def weigh_parallel(
    pieces: IntArray,
    weight: FloatArray,
    hits: IntArray,
    length: FloatArray,
    reflected: FloatArray,
    powers: FloatArray,
    attenuation: FloatArray,
    energies: FloatArray,
    slopes: FloatArray,
) -> None:
    """Do what `weigh_serial` does, the pieces spread over threads."""
    for p in numba.prange(len(pieces)):
        _weigh_piece(
            *(pieces[p, 1], pieces[p, 2], weight, hits, length, reflected, powers, attenuation),
            *(energies[p], slopes[p]),
        )


@kernel()
def sum_pieces(
    pieces: IntArray,
    energies: FloatArray,
    slopes: FloatArray,
    energy: FloatArray,
    derivative: FloatArray,
) -> None:
    """Add pieces to energy (n_bands, n_windows) and derivative (n_materials, n_bands, n_windows).

    The derivative is by absorption: x = 1 - a turns the sign.
    """
    for p in range(len(pieces)):
        w = pieces[p, 0]
        for b in range(energies.shape[1]):
            energy[b, w] += energies[p, b]
            for m in range(slopes.shape[2]):
                derivative[m, b, w] -= slopes[p, b, m]


@kernel()
def weigh_batches(
    offsets: IntArray,
    batch: IntArray,
    weight: FloatArray,
    hits: IntArray,
    length: FloatArray,
    powers: FloatArray,
    attenuation: FloatArray,
    energy: FloatArray,
) -> None:
    """Add the rows of rays to energy (n_batches, n_bands, n_windows), image rows left out."""
    for w in range(len(offsets) - 1):
        for r in range(offsets[w], offsets[w + 1]):
            if batch[r] >= 0:
                for b in range(len(attenuation)):
                    energy[batch[r], b, w] += _row_energy(
                        weight[r], length[r], hits[r], powers[b], attenuation[b]
                    )
