"""Fewer rows of the same expected energies, for differences between many absorptions."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any, cast

import numpy as np

from roomfit.response.rows import EnergyRows, window_of_rows


def thinned_rows(rows: EnergyRows, most: int) -> EnergyRows:
    """Return at most about `most` rows: the earliest half of them whole, every k-th of the rest.

    The rest carries k times its weight, so that no energy is lost on average. Energies from thinned
    rows are noisy; how they change with the absorption is much less so, because the same rows are
    weighed on both sides.

    Parameters
    ----------
    rows : EnergyRows
    most : int
        2 or more.
    """
    if len(rows) <= most:
        return rows
    whole = most // 2
    step = -(-(len(rows) - whole) // (most - whole))
    kept = np.concatenate((np.arange(whole), np.arange(whole, len(rows), step)))
    counts = np.bincount(window_of_rows(rows)[kept], minlength=rows.n_windows)
    told = {f.name: getattr(rows, f.name) for f in fields(rows) if f.init and f.name != "offsets"}
    columns = {name: c[kept] for name, c in told.items() if isinstance(c, np.ndarray)}
    columns["weight_per_m2"][whole:] *= step
    return replace(rows, offsets=np.concatenate(([0], np.cumsum(counts))), **cast(Any, columns))
