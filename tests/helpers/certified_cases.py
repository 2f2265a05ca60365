"""Random rooms as questions for a certified search, and their misfit worked out another way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roomfit.base.typing import FloatArray
from roomfit.model.weighing import EnergyRows
from roomfit.paper.question import GlobalProblem
from roomfit.paper.repeat import squares_global_problem
from roomfit.paper.room import SquaresProblem, squares_problem

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
    return squares_problem(rows, np.zeros(n_windows)).rows


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


def random_case(
    seed: int, n_materials: int, window_s: float = 0.01, noise: float = 0.2
) -> tuple[SquaresProblem, GlobalProblem]:
    """Return a random room with noisy data, alphas up to 0.9995, and the question of its misfit."""
    rng = np.random.default_rng(seed)
    rows = box_room(rng, n_materials, window_s)
    truth = rng.choice([0.05, 0.2, 0.5, 0.9, 0.9995], n_materials)
    energy = energies_by_hand(rows, truth[None])[0] if n_materials else np.zeros(0)
    measured = energy * rng.gamma(1.0 / noise**2, noise**2, energy.size)
    problem = SquaresProblem(rows, measured)
    precision = np.where(measured > 0.0, rng.uniform(0.5, 2.0, energy.size), 1.0)
    least = np.full(n_materials, np.log1p(-0.9995))
    return problem, replace(squares_global_problem(problem), precision=precision, least=least)


def reaching_black(global_problem: GlobalProblem) -> GlobalProblem:
    """Return the same question over absorptions up to 1."""
    return replace(global_problem, least=np.full(len(global_problem.coordinates), -np.inf))


def misfit_of(
    problem: SquaresProblem, global_problem: GlobalProblem, absorption: FloatArray
) -> FloatArray:
    """Return the misfit of many points (n_points, n), from its formula."""
    parts = np.array_split(absorption, max(len(absorption) // 2000, 1))
    return np.concatenate(
        [
            (energies_by_hand(problem.rows, part) - problem.measured) ** 2
            @ global_problem.precision
            for part in parts
        ]
    )
