"""The rows of the energy response: the paths of one pair, sorted into time windows."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from roomfit.checks import float_array
from roomfit.errors import InputError
from roomfit.tracing.paths import Paths
from roomfit.typing import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class EnergyRows:
    """Paths of one pair as rows ``weight * exp(-m length) * product of (1 - a) ** hits``.

    The energy of a window is the sum of its rows. Arrays are kept as given and set read-only.

    Attributes
    ----------
    materials : tuple of str
    n_windows : int
    offsets : int64 array, shape (n_windows + 1,)
        Window w owns the rows ``offsets[w]:offsets[w + 1]``.
    weight_per_m2 : float array, shape (n_rows,)
    hits : uint16 array, shape (n_rows, n_materials)
        Specular and diffuse hits together.
    length_m : float array, shape (n_rows,)
    batch : int32 array, shape (n_rows,)
        Independent Monte-Carlo batch; -1 for image paths, which are exact.
    n_batches : int
        Batches of the trace, rows or not; 0 where there were no rays.
    path : int32 array, shape (n_rows,), or None
        Which path of the trace each row is, for weights that depend on more than hits and length:
        see `reweighed_rows`. None where rows are no single paths.
    max_hits : int
        Largest entry of `hits`, worked out once.
    """

    materials: tuple[str, ...]
    n_windows: int
    offsets: IntArray
    weight_per_m2: FloatArray
    hits: IntArray
    length_m: FloatArray
    batch: IntArray
    n_batches: int = 0
    path: IntArray | None = None
    max_hits: int = field(init=False)

    def __post_init__(self) -> None:
        n, m = len(self.weight_per_m2), len(self.materials)
        columns = {
            "offsets": (np.int64, (self.n_windows + 1,)),
            "weight_per_m2": (np.float64, (n,)),
            "hits": (np.uint16, (n, m)),
            "length_m": (np.float64, (n,)),
            "batch": (np.int32, (n,)),
        }
        if self.path is not None:
            columns["path"] = (np.int32, (n,))
        for name, (dtype, shape) in columns.items():
            array = np.ascontiguousarray(getattr(self, name), dtype=dtype)
            if array.shape != shape:
                raise InputError(
                    f"energy rows: {name} has the wrong shape",
                    found=f"{array.shape}",
                    needed=f"{shape}",
                )
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        object.__setattr__(self, "max_hits", int(self.hits.max(initial=0)))

    def __len__(self) -> int:
        return len(self.weight_per_m2)


def energy_rows(
    paths: Paths, pair: int, edges_s: FloatArray, speed_of_sound_m_s: float
) -> EnergyRows:
    """Return the rows of one pair, each in the window ``edges[w] <= length / c < edges[w + 1]``.

    Paths before the first edge or from the last on are left out. Within a window the rows keep
    the order of the paths.

    Parameters
    ----------
    paths : Paths
    pair : int
        Index of the pair in the scene.
    edges_s : float array, shape (n_windows + 1,)
        Strictly rising times after emission, s.
    speed_of_sound_m_s : float

    Raises
    ------
    InputError
        No such pair, or the edges do not rise.
    """
    if not 0 <= pair < paths.n_pairs:
        raise InputError(
            "no such pair of source and receiver",
            found=str(pair),
            needed=f"0 to {paths.n_pairs - 1}",
        )
    edges = float_array("window edges", edges_s, (None,), unit="s")
    if edges.size < 2 or np.any(np.diff(edges) <= 0.0):
        raise InputError("window edges must rise and there must be at least two")
    own = np.flatnonzero(paths.pair == pair)
    window = np.searchsorted(edges, paths.length_m[own] / speed_of_sound_m_s, side="right") - 1
    kept = (window >= 0) & (window < edges.size - 1)
    own, window = own[kept], window[kept]
    own = own[np.argsort(window, kind="stable")]
    return EnergyRows(
        paths.materials,
        edges.size - 1,
        _offsets(window, edges.size - 1),
        paths.weight_per_m2[own],
        paths.hits_specular[own] + paths.hits_diffuse[own],
        paths.length_m[own],
        paths.batch[own],
        paths.n_batches,
        own.astype(np.int32),
    )


def merge_equal_rows(rows: EnergyRows, *, keep_batches: bool = False) -> EnergyRows:
    """Return fewer rows with the same energies: those of equal window and hits become one.

    Helps in small rooms without scattering (2 to 12 times fewer rows), hardly elsewhere. Exact
    without air, and after `rows_in_air`. With air, a merged row has the mean length of its parts,
    weighed by their weights; its energy is then too small by at most the fraction ``(m D)**2 / 8``
    for lengths that differ by up to D (Jensen's inequality, second order): 2e-6 for 0.01 per metre
    and a window of 1 ms.

    Parameters
    ----------
    rows : EnergyRows
    keep_batches : bool
        Merge within a batch only, so that Monte-Carlo noise can still be told. Otherwise all
        rows come back as batch -1 and `n_batches` is 0.
    """
    window = window_of_rows(rows)
    batch = rows.batch if keep_batches else np.full(len(rows), -1, dtype=np.int32)
    keys = np.column_stack([window, batch, rows.hits])
    order = np.lexsort(keys.T[::-1])
    first = _first_of_each(keys[order])
    starts = np.flatnonzero(first)
    if not starts.size:
        return rows
    weight = np.add.reduceat(rows.weight_per_m2[order], starts)
    moment = np.add.reduceat((rows.weight_per_m2 * rows.length_m)[order], starts)
    kept = order[starts]
    # rows of no weight keep the length of one of them
    length = np.divide(moment, weight, out=rows.length_m[kept].copy(), where=weight > 0.0)
    return EnergyRows(
        rows.materials,
        rows.n_windows,
        _offsets(window[kept], rows.n_windows),
        weight,
        rows.hits[kept],
        length,
        batch[kept],
        rows.n_batches if keep_batches else 0,
    )


def rows_in_air(rows: EnergyRows, attenuation_per_m: float) -> EnergyRows:
    """Return rows of one band with the air's ``exp(-m length)`` put into the weights for good.

    Weigh them without attenuation; their lengths are 0, so that none can act again. Saves the
    exponentials where one band is weighed many times, and makes `merge_equal_rows` exact.

    Parameters
    ----------
    rows : EnergyRows
    attenuation_per_m : float
        Energy attenuation m of the band, 0 or more.
    """
    return replace(
        rows,
        weight_per_m2=rows.weight_per_m2 * np.exp(-attenuation_per_m * rows.length_m),
        length_m=np.zeros(len(rows)),
    )


def reweighed_rows(rows: EnergyRows, factors: FloatArray) -> EnergyRows:
    """Return the same rows with every weight times a factor of its path.

    Costs the memory of the weights; everything else is shared.

    Parameters
    ----------
    rows : EnergyRows
    factors : float array, shape (n_paths,)
        Of every path of the trace, of all pairs.

    Raises
    ------
    InputError
        The rows do not know which paths they are.
    """
    if rows.path is None:
        raise InputError(
            "rows that are no single paths cannot be weighed anew",
            needed="rows as `energy_rows` makes them",
            hint="weigh anew before merging equal rows",
        )
    return replace(rows, weight_per_m2=rows.weight_per_m2 * factors[rows.path])


def grouped_rows(rows: EnergyRows, n_together: int) -> EnergyRows:
    """Return the same rows in coarser windows, each of so many of the old ones.

    The last one holds what is left. No row is copied or moved.
    """
    return regrouped_rows(rows, np.arange(0, rows.n_windows, n_together))


def regrouped_rows(rows: EnergyRows, first: IntArray) -> EnergyRows:
    """Return the same rows in coarser windows, each from one of the old ones up to the next.

    Parameters
    ----------
    first : int array, shape (n_new,)
        Rising, from 0: the old window at which each new one begins. No row is copied or moved.
    """
    return replace(
        rows, n_windows=first.size, offsets=rows.offsets[np.append(first, rows.n_windows)]
    )


def first_rows(rows: EnergyRows, n_windows: int) -> EnergyRows:
    """Return the rows of the first so many windows; what comes later is left out."""
    n = min(n_windows, rows.n_windows)
    last = int(rows.offsets[n])
    return replace(
        rows,
        n_windows=n,
        offsets=rows.offsets[: n + 1],
        weight_per_m2=rows.weight_per_m2[:last],
        hits=rows.hits[:last],
        length_m=rows.length_m[:last],
        batch=rows.batch[:last],
        path=None if rows.path is None else rows.path[:last],
    )


def window_of_rows(rows: EnergyRows) -> IntArray:
    """Return the window of every row, shape (n_rows,)."""
    return np.repeat(np.arange(rows.n_windows), np.diff(rows.offsets))


def _offsets(window: IntArray, n_windows: int) -> IntArray:
    counts = np.bincount(window, minlength=n_windows)
    return np.concatenate(([0], np.cumsum(counts))).astype(np.int64)


def _first_of_each(sorted_keys: IntArray) -> BoolArray:
    first = np.ones(len(sorted_keys), dtype=np.bool_)
    first[1:] = np.any(sorted_keys[1:] != sorted_keys[:-1], axis=1)
    return first
