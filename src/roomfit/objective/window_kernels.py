"""Compiled loop that carries many rows of bin energies into windows."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from roomfit.compiled import kernel
from roomfit.typing import FloatArray, IntArray


def in_windows(shares: csr_array, rows: FloatArray) -> FloatArray:
    """Return ``shares @ rows.T`` without turning the rows round in memory.

    Parameters
    ----------
    shares : sparse array, shape (n_windows, n_bins)
    rows : float array, shape (n_rows, n_bins)

    Returns
    -------
    float array, shape (n_windows, n_rows)
    """
    out = np.zeros((shares.shape[0], len(rows)))
    _add_up(shares.indptr, shares.indices, shares.data, np.ascontiguousarray(rows), out)
    return out


@kernel()
def _add_up(
    pointers: IntArray, bins: IntArray, shares: FloatArray, rows: FloatArray, out: FloatArray
) -> None:
    for w in range(len(pointers) - 1):
        for r in range(len(rows)):
            total = 0.0
            for e in range(pointers[w], pointers[w + 1]):
                total += shares[e] * rows[r, bins[e]]
            out[w, r] = total
