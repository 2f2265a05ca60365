"""Random rooms as problems of equation (1), and their error worked out another way."""

from __future__ import annotations

import numpy as np

from roomfit.base.typing import FloatArray
from roomfit.model.weighing import EnergyRows
from roomfit.paper.room import SquaresProblem

_ORDER = 8
_SPEED_M_S = 340.0


def box_room(rng: np.random.Generator, n_materials: int, window_s: float) -> EnergyRows:
    """Return the image sources of a random box with its six walls divided among materials.

    An image at index i along an axis has hit the wall at 0 floor or ceil of |i| / 2 times and the
    opposite wall as often, once more or less (Allen and Berkley, 1979).
    """
    size = rng.uniform(2.0, 6.0, 3)
    source, receiver = rng.uniform(0.2, 0.8, (2, 3)) * size
    index = np.stack(np.meshgrid(*[np.arange(-_ORDER, _ORDER + 1)] * 3), axis=-1).reshape(-1, 3)
    image = np.where(index % 2 == 0, index * size + source, (index + 1) * size - source)
    length = np.linalg.norm(image - receiver, axis=1)
    far = (np.abs(index) + (index > 0)) // 2  # hits on the walls at `size`
    near = np.abs(index) - far
    wall_hits = np.concatenate((near, far), axis=1)
    group = np.concatenate((np.arange(n_materials), rng.integers(0, n_materials, 6 - n_materials)))
    hits = wall_hits @ (rng.permutation(group)[:, None] == np.arange(n_materials))
    n_windows = int(0.06 / window_s)
    window = np.floor(length / _SPEED_M_S / window_s).astype(int)
    kept = np.flatnonzero(window < n_windows)
    kept = kept[np.argsort(window[kept], kind="stable")]
    counts = np.bincount(window[kept], minlength=n_windows)
    rows = EnergyRows(
        tuple(f"material {i}" for i in range(n_materials)),
        n_windows,
        np.concatenate(([0], np.cumsum(counts))),
        1.0 / length[kept] ** 2,
        hits[kept].astype(np.uint16),
        length[kept],
        np.full(kept.size, -1),
    )
    return SquaresProblem(rows, np.zeros(n_windows)).rows


def energies_by_hand(rows: EnergyRows, absorption: FloatArray) -> FloatArray:
    """Return the window energies of points (n_points, n), from the formula."""
    each = rows.weight_per_m2 * np.prod(
        (1.0 - absorption)[:, None, :] ** rows.hits[None].astype(float), axis=2
    )
    return np.stack(
        [
            each[:, first:last].sum(axis=1)
            for first, last in zip(rows.offsets[:-1], rows.offsets[1:], strict=True)
        ],
        axis=1,
    )


def random_case(seed: int, n_materials: int) -> SquaresProblem:
    """Return a random room with noisy energies of windows of 10 ms."""
    rng = np.random.default_rng(seed)
    rows = box_room(rng, n_materials, 0.01)
    truth = rng.choice([0.05, 0.2, 0.5, 0.9, 0.9995], n_materials)
    energy = energies_by_hand(rows, truth[None])[0]
    return SquaresProblem(rows, energy * rng.gamma(25.0, 0.04, energy.size))


def errors_of(problem: SquaresProblem, absorption: FloatArray) -> FloatArray:
    """Return the error of many points (n_points, n), from its formula."""
    parts = np.array_split(absorption, max(len(absorption) // 2000, 1))
    off = [energies_by_hand(problem.rows, part) - problem.measured for part in parts]
    return np.concatenate([np.sum(own**2, axis=1) for own in off])
