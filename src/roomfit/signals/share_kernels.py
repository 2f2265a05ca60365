"""Compiled loop of the second front end: a tabulated function between the edges of windows."""

from __future__ import annotations

import math

from roomfit.compiled import kernel
from roomfit.typing import FloatArray, IntArray


@kernel()
def _looked_up(table: FloatArray, place: float) -> float:
    """Return the table between two entries by a straight line; beyond its ends, its ends."""
    last = len(table) - 1
    if place <= 0.0:
        return float(table[0])
    if place >= last:
        return float(table[last])
    step = math.floor(place)
    return float(table[step] + (place - step) * (table[step + 1] - table[step]))


@kernel()
def differences_over_windows(
    edges_s: FloatArray,
    delays_s: FloatArray,
    first: IntArray,
    pointers: IntArray,
    table: FloatArray,
    steps_per_s: float,
    values: FloatArray,
    columns: IntArray,
) -> None:
    """Fill the entries of a sparse matrix of windows and delays, row by row.

    An entry is the table at the window's end, less that at its beginning, both counted from the
    delay.

    Parameters
    ----------
    edges_s : shape (n_windows + 1,)
    delays_s : shape (n_delays,)
    first : shape (n_windows,)
        First delay of each window.
    pointers : shape (n_windows + 1,)
        Where the entries of each window begin; their number tells how many delays it has.
    table : shape (n_steps,)
        With time 0 in its middle.
    steps_per_s : float
        Steps of the table in a second.
    values, columns : shape (n_entries,)
        To be filled.
    """
    middle = 0.5 * (len(table) - 1)
    for w in range(len(first)):
        begin = edges_s[w] * steps_per_s + middle
        end = edges_s[w + 1] * steps_per_s + middle
        for e in range(pointers[w], pointers[w + 1]):
            d = first[w] + e - pointers[w]
            late = delays_s[d] * steps_per_s
            values[e] = _looked_up(table, end - late) - _looked_up(table, begin - late)
            columns[e] = d
