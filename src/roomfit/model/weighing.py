"""The energy response: window energies by band of one pair, with their derivative by absorption.

The paths of a pair become rows, sorted into time windows, which are weighed for each absorption.
Every window is summed by one thread in the order of its rows: same bits for any number of threads.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, NamedTuple, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from roomfit.base.arguments import check_shape, float_array, read_only
from roomfit.base.kernels import in_threads, kernel
from roomfit.base.typing import FloatArray, IntArray
from roomfit.tracing.paths import Paths, losses


@dataclass(frozen=True, slots=True, eq=False)
class EnergyRows:
    """Paths of one pair as rows ``weight * exp(-m length) * product of (1 - a) ** hits``.

    The energy of a window is the sum of its rows. Arrays are not copied but set read-only.
    """

    materials: tuple[str, ...]
    n_windows: int
    offsets: IntArray  # int64 (n_windows + 1,), rows of window w: ``offsets[w]:offsets[w + 1]``
    weight_per_m2: FloatArray  # (n_rows,)
    hits: IntArray  # uint16 (n_rows, n_materials), see `roomfit.tracing.paths.losses`
    length_m: FloatArray  # (n_rows,)
    batch: IntArray  # int32 (n_rows,), independent Monte-Carlo batch; -1 for exact image paths
    n_batches: int = 0  # Of the trace, with rows or without; 0 where there were no rays
    path: IntArray | None = None  # int32 (n_rows,), of the trace; None where rows are merged paths
    max_hits: int = field(init=False)  # Largest entry of `hits`
    largest_batch: int = field(init=False)  # Largest entry of `batch`, -1 without rays

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
            check_shape(f"energy rows: {name}", array, shape)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        object.__setattr__(self, "max_hits", int(self.hits.max(initial=0)))
        object.__setattr__(self, "largest_batch", int(self.batch.max(initial=-1)))

    def __len__(self) -> int:
        return len(self.weight_per_m2)


def energy_rows(
    paths: Paths,
    pair: int,
    edges_s: FloatArray,
    speed_of_sound_m_s: float,
    own: IntArray | None = None,
) -> EnergyRows:
    """Return the rows of one pair, each in the window ``edges[w] <= length / c < edges[w + 1]``.

    Paths before the first edge or from the last on are left out. Within a window the rows keep the
    order of the paths. `own` are the paths of the pair where they are known.
    """
    edges = float_array("window edges", edges_s, (None,), unit="s")
    own = np.flatnonzero(paths.pair == pair) if own is None else own
    window = _windows(edges, paths.length_m[own] / speed_of_sound_m_s)
    kept = (window >= 0) & (window < edges.size - 1)
    own, window = own[kept], window[kept]
    # numbers of 16 bits are sorted thirty times as fast
    small = window.astype(np.uint16) if edges.size < 2**16 else window
    own = own[np.argsort(small, kind="stable")]
    return EnergyRows(
        paths.materials,
        edges.size - 1,
        _offsets(window, edges.size - 1),
        paths.weight_per_m2[own],
        losses(paths, own),
        paths.length_m[own],
        paths.batch[own],
        paths.n_batches,
        own.astype(np.int32),
    )


@kernel()
def _windows(edges: FloatArray, at: FloatArray) -> IntArray:
    """Return the window of each number; -1 before the first, n_windows from the last edge on."""
    found, n = np.empty(len(at), np.int64), len(edges) - 1
    per_window = n / (edges[n] - edges[0])
    for i in range(len(at)):
        w = min(max(int((at[i] - edges[0]) * per_window), 0), n - 1)  # of edges that are uniform
        while w >= 0 and at[i] < edges[w]:
            w -= 1
        while w < n and at[i] >= edges[w + 1]:
            w += 1
        found[i] = w
    return found


def merge_equal_rows(rows: EnergyRows) -> EnergyRows:
    """Return fewer rows with the same energies: those of equal window and hits become one.

    Exact without air, and after `rows_in_air`. With air, a merged row has the mean length of its
    parts; its energy is then too small by at most the fraction ``(m D)**2 / 8`` for lengths that
    differ by up to D (Jensen's inequality): 2e-6 for 0.01 per metre and a window of 1 ms. Merged
    rows belong to no batch.
    """
    window = window_of_rows(rows)
    keys = np.column_stack([window, rows.hits])
    order = np.lexsort(keys.T[::-1])
    if not order.size:
        return rows
    keys = keys[order]
    starts = np.flatnonzero(np.append(True, np.any(keys[1:] != keys[:-1], axis=1)))
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
        np.full(len(kept), -1, dtype=np.int32),
    )


def sharing(rows: EnergyRows, like: EnergyRows) -> EnergyRows:
    """Return the same rows with the arrays of other rows in place of those that are equal to them.

    States of the room have the paths of one trace: only their hits differ. Of longer arrays the
    beginning is compared, since what is read of a state may end earlier.
    """
    names = ("weight_per_m2", "length_m", "batch")
    theirs = {name: getattr(like, name)[: len(rows)] for name in names}
    same = {name: a for name, a in theirs.items() if np.array_equal(getattr(rows, name), a)}
    return replace(rows, **cast(Any, same))


def rows_in_air(rows: EnergyRows, attenuation_per_m: float) -> EnergyRows:
    """Return rows of one band with the air's ``exp(-m length)`` in the weights and lengths of 0."""
    return replace(
        rows,
        weight_per_m2=rows.weight_per_m2 * np.exp(-attenuation_per_m * rows.length_m),
        length_m=shared_zeros(len(rows)),
    )


def shared_zeros(n: int) -> FloatArray:
    """Return read-only zeros, the same memory for all who ask."""
    size = max(1 << max(n - 1, 0).bit_length(), 1)
    return _zeros_of_size(size)[:n]


@lru_cache(maxsize=4)
def _zeros_of_size(size: int) -> FloatArray:
    return np.asarray(read_only(np.zeros(size)))


def reweighed_rows(rows: EnergyRows, factors: FloatArray) -> EnergyRows:
    """Return the same rows with every weight times a factor of its path, (n_paths,)."""
    return replace(rows, weight_per_m2=rows.weight_per_m2 * factors[rows.path])


def regrouped_rows(rows: EnergyRows, first: IntArray) -> EnergyRows:
    """Return the same rows in coarser windows, each from one of the old ones up to the next."""
    return replace(
        rows, n_windows=first.size, offsets=rows.offsets[np.append(first, rows.n_windows)]
    )


def taken_rows(rows: EnergyRows, kept: IntArray) -> EnergyRows:
    """Return some rows in the windows in which they are, by rising index."""
    return replace(
        rows,
        offsets=np.searchsorted(kept, rows.offsets),
        weight_per_m2=rows.weight_per_m2[kept],
        hits=rows.hits[kept],
        # of rows with the air's loss in their weights all are 0, and there once
        length_m=rows.length_m[kept] if rows.length_m.any() else shared_zeros(kept.size),
        batch=rows.batch[kept],
        path=None if rows.path is None else rows.path[kept],
    )


def first_rows(rows: EnergyRows, n_windows: int) -> EnergyRows:
    """Return the rows of the first so many windows, without copies; later ones are left out."""
    n = min(n_windows, rows.n_windows)
    names = ("weight_per_m2", "hits", "length_m", "batch", "path")
    whole = {name: getattr(rows, name) for name in names}
    columns = {name: x[: int(rows.offsets[n])] for name, x in whole.items() if x is not None}
    return replace(rows, n_windows=n, offsets=rows.offsets[: n + 1], **cast(Any, columns))


def window_of_rows(rows: EnergyRows) -> IntArray:
    """Return the window of every row, shape (n_rows,)."""
    return np.repeat(np.arange(rows.n_windows), np.diff(rows.offsets))


def _offsets(window: IntArray, n_windows: int) -> IntArray:
    counts = np.bincount(window, minlength=n_windows)
    return np.concatenate(([0], np.cumsum(counts))).astype(np.int64)


def thinned_rows(rows: EnergyRows, most: int) -> EnergyRows:
    """Return at most about `most` rows: the earliest half of them, and every k-th of all others.

    The latter get k times their weight. Energies from thinned rows are noisy; their change with the
    absorption is much less so, because the same rows are weighed on both sides.
    """
    if len(rows) <= most:
        return rows
    whole = most // 2
    step = -(-(len(rows) - whole) // (most - whole))
    few = taken_rows(rows, np.concatenate((np.arange(whole), np.arange(whole, len(rows), step))))
    weight = few.weight_per_m2.copy()
    weight[whole:] *= step
    return replace(few, weight_per_m2=weight)


# Of at most so many rows sums are added up at a time.
_PIECE = 8192
# Below it the derivative is taken from the power table: e h / x loses its digits near x = 0.
_NEARLY_BLACK = 1e-6
# Two milliseconds of work: threads wake in microseconds, but a busy machine keeps the last of them
# waiting for milliseconds.
ROWS_WORTH_THREADS = 200_000


def power_table(reflected: FloatArray, max_hits: int) -> FloatArray:
    """Return ``x ** h`` for x = 1 - a and h = 0 to max_hits, (n_bands, n_materials, n_hits)."""
    return np.asarray(reflected[:, :, None] ** np.arange(max_hits + 1.0))


@kernel(allocates=False)
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


RowBasis: TypeAlias = NDArray[np.float32] | FloatArray
"""`pattern_basis` of where paths leave their source, (n_paths, 3)."""


@dataclass(frozen=True, slots=True, eq=False)
class RowPattern:
    """A directivity of rows: vector b, and `pattern_basis` of where the path of each leaves."""

    b: FloatArray  # (3,)
    basis: RowBasis  # (n_rows, 3)

    def factor(self) -> FloatArray:
        """Return the factor on the energy of every row, shape (n_rows,)."""
        return np.asarray((1.0 + self.basis @ self.b) ** 2 / (1.0 + self.b @ self.b / 3.0))


class EnergyParts(NamedTuple):
    """Energies of one band, and what their variance is made of, for a gain of 1."""

    energy: FloatArray  # (n_windows,), of all rows
    squares: FloatArray  # (n_windows,), sum of the squares of single image paths
    batches: FloatArray  # (n_batches, n_windows), energy of the rays of each batch
    # (n_windows, 2 + n_batches + n_materials + 3), all of these, then the derivative of the energy
    # by absorption and by b of the source; without the latter where none was asked for
    columns: FloatArray

    @property
    def by_absorption(self) -> FloatArray:
        """Derivative of the energy, exact at a = 0 and a = 1 too, (n_windows, n_materials)."""
        return self.columns[:, 2 + len(self.batches) : -3]


def weigh_parts(
    rows: EnergyRows,
    pattern: RowPattern | None,
    coefficients: FloatArray,
    attenuation_per_m: float,
    *,
    derivative: bool = False,
) -> EnergyParts:
    """Return energies of one band, squares of its image paths and its batches of rays in one pass.

    Rows are ``weight a**2 exp(-m length) product of (1 - a)**hits`` with the amplitude a of each
    direction. Rays have no squares. Same bits for any number of threads.
    """
    one = coefficients[:, None], np.array([attenuation_per_m])
    reflected, attenuation = _reflected_and_attenuation(rows, *one)
    return _parts(rows, pattern, reflected[0], float(attenuation[0]), derivative=derivative)


def _parts(
    rows: EnergyRows,
    pattern: RowPattern | None,
    reflected: FloatArray,
    attenuation: float,
    *,
    derivative: bool,
) -> EnergyParts:
    first = 2 + max(rows.n_batches, rows.largest_batch + 1)
    out = np.zeros((rows.n_windows, first + (reflected.size + 3 if derivative else 0)))
    # in single precision, as most directions are: one compiled form for both
    b, basis = np.zeros(3), cast(RowBasis, np.zeros((0, 3), np.float32))
    if pattern is not None:
        b, basis = np.array(pattern.b, dtype=np.float64), pattern.basis
    in_threads(
        _weigh_windows,
        rows.n_windows,
        rows.offsets,
        (rows.weight_per_m2, rows.length_m, rows.hits, basis, rows.batch),
        b,
        reflected,
        power_table(reflected[None], rows.max_hits)[0],
        attenuation,
        first,
        out,
        worth_it=len(rows) >= ROWS_WORTH_THREADS,
    )
    return EnergyParts(out[:, 0].copy(), out[:, 1].copy(), out[:, 2:first].T, out)


@kernel(allocates=False, inlined=True)
def _reflected(
    weight: float, hits: IntArray, r: int, powers: FloatArray
) -> tuple[float, int, int, int, int, int, int]:
    """Return a row's weight times its reflections, and its hits on the first six materials."""
    n, h3, h4, h5 = hits.shape[1], 0, 0, 0
    h0 = h1 = h2 = hits[r, 0]
    own = weight * powers[0, h0]
    if n > 1:
        h1 = hits[r, 1]
        own *= powers[1, h1]
    if n > 2:
        h2 = hits[r, 2]
        own *= powers[2, h2]
    if n > 3:
        h3 = hits[r, 3]
        own *= powers[3, h3]
    if n > 4:
        h4 = hits[r, 4]
        own *= powers[4, h4]
    if n > 5:
        h5 = hits[r, 5]
        own *= powers[5, h5]
    for m in range(6, n):
        own *= powers[m, hits[r, m]]
    return own, h0, h1, h2, h3, h4, h5


@kernel()
def _weigh_windows(
    first: int,
    last: int,
    offsets: IntArray,
    rows: tuple[Any, ...],
    b: FloatArray,
    reflected: FloatArray,
    powers: FloatArray,
    attenuation: float,
    slopes: int,
    every: FloatArray,
) -> None:
    """Fill the sums of some windows: energy, squares of image paths, every batch, and derivatives.

    The latter from column `slopes` on, by absorption and by b; `rows` are weight, length, hits,
    pattern basis and batch of every row. With q the pattern basis, N = 1 + b b / 3 and c = 1 + b q,
    the factor of a row is ``c**2 / N`` and its derivative by b ``2 c q / N - 2 c**2 b / (3 N**2)``.
    """
    weight, length, hits, basis, batch = rows
    norm = 1.0 + (b[0] * b[0] + b[1] * b[1] + b[2] * b[2]) / 3.0
    n, sums = hits.shape[1], np.empty(every.shape[1])
    with_slopes = sums.size > slopes
    for w in range(first, last):
        for start in range(offsets[w], offsets[w + 1], _PIECE):
            stop = min(start + _PIECE, offsets[w + 1])
            sums[:] = 0.0
            energy = squares = x = y = z = 0.0
            # sums of the first materials stay in registers, which halves the time
            by0 = by1 = by2 = by3 = by4 = by5 = 0.0
            for r in range(start, stop):
                own, h0, h1, h2, h3, h4, h5 = _reflected(weight[r], hits, r, powers)
                if attenuation != 0.0:
                    own *= math.exp(-attenuation * length[r])
                if len(basis):
                    c = 1.0 + b[0] * basis[r, 0] + b[1] * basis[r, 1] + b[2] * basis[r, 2]
                    once = c * own / norm
                    own = c * once
                    x += once * basis[r, 0]
                    y += once * basis[r, 1]
                    z += once * basis[r, 2]
                energy += own
                if batch[r] < 0:
                    squares += own * own
                else:
                    sums[2 + batch[r]] += own
                by0 -= own * h0
                by1 -= own * h1
                by2 -= own * h2
                by3 -= own * h3
                by4 -= own * h4
                by5 -= own * h5
                if with_slopes:
                    for m in range(6, n):
                        sums[slopes + m] -= own * hits[r, m]
            sums[0], sums[1] = energy, squares
            if with_slopes:
                first_six, turned = (by0, by1, by2, by3, by4, by5), energy / (3.0 * norm)
                for m in range(min(n, 6)):
                    sums[slopes + m] = first_six[m]
                sums[slopes + n] = 2.0 * (x - turned * b[0])
                sums[slopes + n + 1] = 2.0 * (y - turned * b[1])
                sums[slopes + n + 2] = 2.0 * (z - turned * b[2])
                own_slopes = sums[slopes : slopes + n]
                _slopes_by_absorption(
                    start, stop, rows, b, reflected, powers, attenuation, own_slopes
                )
            for k in range(sums.size):
                every[w, k] += sums[k]


@kernel()
def _slopes_by_absorption(
    start: int,
    stop: int,
    rows: tuple[Any, ...],
    b: FloatArray,
    reflected: FloatArray,
    powers: FloatArray,
    attenuation: float,
    sums: FloatArray,
) -> None:
    """Divide the sums of energy times hits by 1 - a; where that is nearly 0, sum up anew."""
    weight, length, hits, basis, _ = rows
    norm = 1.0 + (b[0] * b[0] + b[1] * b[1] + b[2] * b[2]) / 3.0
    for m in range(len(sums)):
        if reflected[m] >= _NEARLY_BLACK:
            sums[m] /= reflected[m]
            continue
        sums[m] = 0.0
        for r in range(start, stop):
            own = weight[r]
            if len(basis):
                c = 1.0 + b[0] * basis[r, 0] + b[1] * basis[r, 1] + b[2] * basis[r, 2]
                own *= c * c / norm
            sums[m] -= _slope_at_black(own, length[r], hits[r], powers, attenuation, m)


def directed_rows(rows: EnergyRows, factor: FloatArray) -> EnergyRows:
    """Return rows with every weight times a factor of its own, shape (n_rows,), of either sign."""
    return replace(rows, weight_per_m2=rows.weight_per_m2 * factor)


def weigh(rows: EnergyRows, coefficients: FloatArray, attenuation_per_m: FloatArray) -> FloatArray:
    """Return the window energies under an absorption, (n_bands, n_windows).

    In 1/m2: that of the direct sound at r metres is ``1 / (4 pi r**2)``. An `InputError` where a
    shape is wrong or a value out of range.

    Shapes: `coefficients` (n_materials, n_bands), `attenuation_per_m` (n_bands,).

    Examples
    --------
    A path without a hit, and one of half its weight with two hits on a wall that absorbs half:

    >>> rows = EnergyRows(
    ...     ("wall",), 1, np.array([0, 2]), np.array([1.0, 0.5]), np.array([[0], [2]]),
    ...     np.array([3.0, 5.0]), np.array([-1, -1]),
    ... )
    >>> weigh(rows, np.array([[0.5]]), np.array([0.0]))
    array([[1.125]])
    """
    reflected, attenuation = _reflected_and_attenuation(rows, coefficients, attenuation_per_m)
    each = zip(reflected, attenuation.tolist(), strict=True)
    return np.stack([_parts(rows, None, x, m, derivative=False).energy for x, m in each])


@kernel()
def _weigh_points(
    offsets: IntArray, weight: FloatArray, hits: IntArray, powers: FloatArray, energy: FloatArray
) -> None:
    """Add rows to energy (n_windows, n_points); powers (n_materials, max_hits + 1, n_points)."""
    e = np.empty(energy.shape[1])
    for w in range(len(offsets) - 1):
        for r in range(offsets[w], offsets[w + 1]):
            e[:] = weight[r]
            for m in range(hits.shape[1]):
                h = hits[r, m]
                if h > 0:
                    for p in range(len(e)):
                        e[p] *= powers[m, h, p]
            for p in range(len(e)):
                energy[w, p] += e[p]


def weigh_points(rows: EnergyRows, absorption: FloatArray) -> FloatArray:
    """Return the energies under many absorptions (n_points, n_materials), (n_points, n_windows)."""
    powers = np.ones((len(rows.materials), rows.max_hits + 1, len(absorption)))
    powers[:, 1:] = np.cumprod(
        np.broadcast_to((1.0 - absorption.T)[:, None], powers[:, 1:].shape), axis=1
    )
    energy = np.zeros((rows.n_windows, len(absorption)))
    _weigh_points(rows.offsets, rows.weight_per_m2, rows.hits, powers, energy)
    return np.ascontiguousarray(energy.T)


def _reflected_and_attenuation(
    rows: EnergyRows, coefficients: FloatArray, attenuation_per_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return reflected energy (n_bands, n_materials) and attenuation, both ready for kernels."""
    # copies, so that kernels always see writable, contiguous arrays: one compiled form
    attenuation = np.array(attenuation_per_m, dtype=np.float64)
    a = np.array(coefficients, dtype=np.float64)
    # tested on the spot, and named only where wrong: this is done at every evaluation of a fit
    shape = (len(rows.materials), attenuation.size)
    if (
        attenuation.ndim != 1
        or a.shape != shape
        or not (
            np.all(np.isfinite(attenuation) & (attenuation >= 0.0))
            and np.all((a >= 0.0) & (a <= 1.0))
        )
    ):
        float_array("air attenuation", attenuation, (None,), low=0.0, unit="1/m")
        float_array("absorption coefficient", a, shape, low=0.0, high=1.0)
    return np.array(1.0 - a.T, order="C"), attenuation
