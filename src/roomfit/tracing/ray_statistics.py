"""What a trace tells of its room beside the paths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roomfit.checks import read_only
from roomfit.tracing.ray_kernels import ESCAPES_KEPT, Tally
from roomfit.typing import FloatArray

_ESCAPES_TOLD = 8


@dataclass(frozen=True, slots=True, eq=False)
class RayStatistics:
    """Counts of a trace.

    Free paths run from one wall to the next. Each that begins before a ray's time is up counts in
    full, even where it ends later: counting only those that fit would favour short ones.

    Attributes
    ----------
    n_rays, n_hits, n_escaped : int
        Rays of all sources; their wall hits; how many met no wall and were dropped.
    n_free_paths : int
    mean_free_path_m : float
        Mean length of the free paths; 0 where there is none.
    relative_variance : float
        Variance of the free paths over their squared mean, gamma squared in Kuttruff's formula; 0
        where there is no free path.
    escapes_from_m, escape_directions : float arrays, shape (n_told, 3)
        Where the first escaped rays began their last flight, and in which direction.
    """

    n_rays: int
    n_hits: int
    n_escaped: int
    n_free_paths: int
    mean_free_path_m: float
    relative_variance: float
    escapes_from_m: FloatArray
    escape_directions: FloatArray

    @property
    def escape_fraction(self) -> float:
        """Share of flights that met no wall."""
        return self.n_escaped / max(self.n_hits + self.n_escaped, 1)


def ray_statistics(n_rays: int, tallies: Sequence[Tally]) -> RayStatistics:
    """Return the sum of all chunks of all blocks."""
    hits = sum(int(t.hits.sum()) for t in tallies)
    escapes = sum(int(t.escapes.sum()) for t in tallies)
    n = sum(int(t.free_paths.sum()) for t in tallies)
    mean = sum(float(t.sum_m.sum()) for t in tallies) / max(n, 1)
    square = sum(float(t.sum_m2.sum()) for t in tallies) / max(n, 1)
    kept = [np.arange(ESCAPES_KEPT) < t.escapes[:, None] for t in tallies]
    starts = [t.escape_from_m[k] for t, k in zip(tallies, kept, strict=True)]
    directions = [t.escape_direction[k] for t, k in zip(tallies, kept, strict=True)]
    return RayStatistics(
        n_rays,
        hits,
        escapes,
        n,
        mean,
        max(square / mean**2 - 1.0, 0.0) if mean > 0.0 else 0.0,
        read_only(np.concatenate([np.empty((0, 3)), *starts])[:_ESCAPES_TOLD].copy()),
        read_only(np.concatenate([np.empty((0, 3)), *directions])[:_ESCAPES_TOLD].copy()),
    )
