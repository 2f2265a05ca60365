"""Paths of every pair in fine time bins, with the weights and the bins of each band."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache, partial

import numba
import numpy as np

from roomfit.base.air import speed_of_sound_m_s
from roomfit.base.bands import Bands
from roomfit.base.kernels import each_in_threads
from roomfit.base.typing import FloatArray, IntArray
from roomfit.model import weighing
from roomfit.room.scene import Scene
from roomfit.tracing.paths import Paths, paths_of_pairs

BIN_S = 0.1e-3
_BINS_PER_TIME = 400.0


@dataclass(frozen=True, slots=True, eq=False)
class BinnedPaths:
    """Paths of every pair of the scene in fine time bins."""

    # (n_bins + 1,), uniform, from before emission, since a zero-phase filter rings before a sound
    edges_s: FloatArray
    rows: tuple[weighing.EnergyRows, ...]  # one a pair
    # by centre in Hz, where weights differ, because scattering or directivity does: same paths and
    # bins
    by_band: Mapping[float, tuple[weighing.EnergyRows, ...]] = field(default_factory=dict)


def rows_at(binned: BinnedPaths, centre_hz: float) -> tuple[weighing.EnergyRows, ...]:
    """Return the rows of every pair in one band."""
    return binned.by_band.get(float(centre_hz), binned.rows)


def regrouped(
    binned: BinnedPaths,
    edges_s: FloatArray,
    change: Callable[[weighing.EnergyRows], weighing.EnergyRows],
) -> BinnedPaths:
    """Return binned paths with every band's rows changed alike."""
    return BinnedPaths(
        edges_s,
        tuple(change(r) for r in binned.rows),
        {f: tuple(change(r) for r in rows) for f, rows in binned.by_band.items()},
    )


def pair_energies(
    binned: BinnedPaths,
    bands: Bands,
    pair: int,
    absorption: FloatArray,
    attenuation_per_m: FloatArray,
) -> FloatArray:
    """Return the energies of one pair in every band and bin, shape (n_bands, n_bins)."""
    if not binned.by_band:
        return weighing.weigh(binned.rows[pair], absorption, attenuation_per_m)
    found = []
    for band, centre_hz in enumerate(bands.centres_hz):
        rows, one = rows_at(binned, centre_hz)[pair], slice(band, band + 1)
        found.append(weighing.weigh(rows, absorption[:, one], attenuation_per_m[one]))
    return np.concatenate(found)


def bin_paths(
    scene: Scene, bands: Bands, paths: Paths, duration_s: float, factors: FloatArray | None = None
) -> BinnedPaths:
    """Sort the paths of every pair into bins of 0.1 ms, weighed by factors (n_bands, n_paths).

    The bins begin four periods of the lowest band before emission.
    """
    first = -int(np.ceil(4.0 / bands.centres_hz[0] / BIN_S))
    last = int(np.ceil(duration_s / BIN_S))
    edges = BIN_S * np.arange(first, last + 1, dtype=np.float64)
    c = speed_of_sound_m_s(scene.air)
    of_pair, worth_it = paths_of_pairs(paths), len(paths.pair) >= weighing.ROWS_WORTH_THREADS

    def rows(first: int, i: int) -> weighing.EnergyRows:
        return weighing.energy_rows(paths, first + i, edges, c, of_pair[first + i])

    def each() -> Iterator[weighing.EnergyRows]:
        """Give few pairs at a time: in memory until what states have in common is there once."""
        for first in range(0, len(of_pair), at_once := numba.get_num_threads()):
            n = min(at_once, len(of_pair) - first)
            yield from each_in_threads(partial(rows, first), n, worth_it=worth_it)

    return reweighed(scene, bands, BinnedPaths(edges, once(scene.pairs, each())), factors)


def reweighed(
    scene: Scene, bands: Bands, binned: BinnedPaths, factors: Iterable[FloatArray] | None
) -> BinnedPaths:
    """Return the same bins with a factor on the weight of every path of the trace in every band."""
    if factors is None:
        return BinnedPaths(binned.edges_s, binned.rows)
    by_band = {
        float(f): once(scene.pairs, (weighing.reweighed_rows(r, own) for r in binned.rows))
        for f, own in zip(bands.centres_hz, factors, strict=True)
    }
    return BinnedPaths(binned.edges_s, binned.rows, by_band)


def once(ends: IntArray, each: Iterable[weighing.EnergyRows]) -> tuple[weighing.EnergyRows, ...]:
    """Return rows, with what is alike in all states of the room there once."""
    found: dict[tuple[int, ...], weighing.EnergyRows] = {}
    both = zip(ends.tolist(), each, strict=True)
    return tuple(weighing.sharing(own, found.setdefault(tuple(at), own)) for at, own in both)


def in_band(binned: BinnedPaths, centre_hz: float) -> BinnedPaths:
    """Return the same paths in bins as coarse as a band permits.

    A sixteenth of a period, since a band of a filter does not resolve time finer than several
    periods, or a 400th of the time after emission, where windows have grown to 40 times that.
    """
    first = _bin_starts(binned.edges_s.tobytes(), centre_hz)
    edges_s = binned.edges_s[np.append(first, binned.edges_s.size - 1)]
    rows = tuple(weighing.regrouped_rows(rows, first) for rows in rows_at(binned, centre_hz))
    return BinnedPaths(edges_s, rows)


@lru_cache(maxsize=64)
def _bin_starts(edges_s: bytes, centre_hz: float) -> IntArray:
    least = max(int(1.0 / (16.0 * centre_hz * BIN_S)), 1)
    # a list: its numbers are read one by one, which an array does ten times more slowly
    edges = np.frombuffer(edges_s).tolist()
    starts = []
    at = 0
    while at < len(edges) - 1:
        starts.append(at)
        at += max(least, int(edges[at] / (_BINS_PER_TIME * BIN_S)))
    found = np.array(starts)
    found.setflags(write=False)
    return found
