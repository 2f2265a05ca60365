"""The cheapest arrangements that meet the targets: a linear start, then exchanges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp

from roomfit.base.kernels import each_in_threads
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.predict.decay import moved
from roomfit.predict.diffuse import PreparedField, field_times_s, in_rows
from roomfit.predict.predict import ChangingRoom
from roomfit.treat.question import Problem, rows_of, treated

_ROUNDS, _EXCHANGES, _TRIED_AT_ONCE, _MANY = 5, 60, 48, 64
_POINTS = 128
# A tenth of a just noticeable difference of a time counts as met.
MET = 0.005


def mean_values(
    room: ChangingRoom, absorptions: FloatArray, wanted: BoolArray | None = None
) -> FloatArray:
    """Return the means over all pairs under many absorptions, (n_points, n_names + 1, n_bands).

    Last stands the speech transmission index, alike in every band; NaN where it is not predicted.

    Shapes: `absorptions` (n_points, n_materials, n_bands), `wanted` (n_bands,).
    """
    if isinstance(room, PreparedField):
        values = in_rows(field_times_s(room, absorptions))
        return np.concatenate([values, np.full_like(values[:, :1], np.nan)], axis=1)
    at = np.flatnonzero(np.ones(absorptions.shape[2], dtype=np.bool_) if wanted is None else wanted)

    def own(i: int) -> FloatArray:
        few = room.few[i].in_bands(at)
        before, first = room.before[i], room.absorption.absorption[None]
        values = np.full((len(absorptions), len(before.values) + 1, absorptions.shape[2]), np.nan)
        index = np.nan if before.sti is None else before.sti.values[0, 0]
        for a in range(0, len(absorptions), _POINTS):
            part = values[a : a + _POINTS]
            points = np.concatenate((first, absorptions[a : a + _POINTS]))
            energies = few.energies(points[:, :, at])
            there = few.values(energies)
            sti = few.sti(energies, there, room.speech_db)
            part[:, :-1, at] = moved(before.values[:, at], there[1:], there[0])
            part[:, -1] = np.clip(index + sti[1:] - sti[0], 0.0, 1.0)[:, None]
        return values

    found = np.ma.masked_invalid(each_in_threads(own, len(room.few)))
    return np.asarray(np.ma.filled(found.mean(axis=0), np.nan))


def numbers_of(problem: Problem, pieces: FloatArray) -> FloatArray:
    """Return the number of every row for many arrangements, shape (n_points, n_rows)."""
    wanted = np.any(problem.weights > 0.0, axis=0)
    return rows_of(problem, mean_values(problem.room, treated(problem, pieces), wanted))


def excess(problem: Problem, numbers: FloatArray, margin: FloatArray) -> FloatArray:
    """Return by how much each row misses its limits over its scale, (..., n_rows); of NaN 1."""
    beyond = np.maximum(problem.low + margin - numbers, numbers - problem.high + margin)
    missed = np.maximum(beyond, 0.0) / problem.scale
    return np.asarray(np.where(np.isnan(numbers), 1.0, np.where(missed <= MET, 0.0, missed)))


def best_arrangement(
    problem: Problem,
    margin: FloatArray,
    excluded: Sequence[BoolArray] = (),
    most_cost: float = np.inf,
) -> tuple[FloatArray, FloatArray]:
    """Return the pieces of the cheapest arrangement that meets all limits, and its numbers.

    A mixed-integer programme on inverse times and plain other parameters, linear about the last
    answer, then exchanges of pieces with exact numbers. Where none meets them, the one that misses
    least.

    Shapes: `margin` (n_rows,), `excluded` (n_columns,).
    """
    here = np.zeros(len(problem.cost))
    numbers = numbers_of(problem, here[None])[0]
    best, step = None if excluded else (here, numbers), problem.most
    for _ in range(_ROUNDS):
        slopes = _slopes(problem, here, numbers, step)
        found = _programme(problem, here, numbers, slopes, margin, excluded, most_cost)
        if found is None:
            break
        is_new = np.any(found != here)
        here, numbers = found, numbers_of(problem, found[None])[0]
        if best is None or _worth(problem, here, numbers, margin) < _worth(problem, *best, margin):
            best = (here, numbers)
        if not is_new:
            break
        step = np.maximum(np.floor(problem.most / 8.0), 1.0)
    if best is None:
        return here, numbers
    return _exchanged(problem, best, margin, excluded, most_cost)


def _worth(
    problem: Problem, pieces: FloatArray, numbers: FloatArray, margin: FloatArray
) -> tuple[float, float]:
    """Return what is compared of arrangements: what is missed, then the cost."""
    missed = float(excess(problem, numbers, margin).sum())
    return round(missed, 9), float(problem.cost @ pieces) + 1e-9 * float(pieces.sum())


def _linear(problem: Problem, numbers: FloatArray) -> FloatArray:
    """Return inverse times, all else as it is; the same turns them back."""
    return np.asarray(np.where(problem.is_time, 1.0 / np.maximum(numbers, 1e-3), numbers))


def _slopes(
    problem: Problem, here: FloatArray, numbers: FloatArray, step: FloatArray
) -> FloatArray:
    """Return the change of each row for a piece more of each column, (n_rows, n_columns)."""
    moves = np.where(here + step <= problem.most, step, -np.minimum(step, np.maximum(here, 1.0)))
    points = np.maximum(here + np.diag(moves), 0.0)
    change = _linear(problem, numbers_of(problem, points)) - _linear(problem, numbers)
    return np.nan_to_num((change / moves[:, None]).T)


def _programme(
    problem: Problem,
    here: FloatArray,
    numbers: FloatArray,
    slopes: FloatArray,
    margin: FloatArray,
    excluded: Sequence[BoolArray],
    most_cost: float,
) -> FloatArray | None:
    """Return the pieces that solve the linear problem."""
    n, k, times = len(problem.cost), len(problem.target), problem.is_time
    low, high = problem.low + margin, problem.high - margin
    slowest = 1.0 / np.maximum(high, 1e-3)
    fastest = np.where(low > 0.0, 1.0 / np.maximum(low, 1e-9), np.inf)
    low, high = np.where(times, slowest, low), np.where(times, fastest, high)
    base = slopes @ here - np.nan_to_num(_linear(problem, numbers))
    slack = np.diag(np.where(times, 1.0 / problem.scale, problem.scale))
    nothing, one, away = np.zeros((k, n)), np.eye(n), np.zeros((n, k))
    # unknown are the pieces of each column, whether it is used, and by how much a row is missed
    rows = [
        LinearConstraint(np.hstack([slopes, nothing, slack]), lb=low + base),
        LinearConstraint(np.hstack([slopes, nothing, -slack]), ub=high + base),
        LinearConstraint(np.hstack([one, -np.diag(problem.most), away]), ub=np.zeros(n)),
        LinearConstraint(np.hstack([one, -one, away]), lb=np.zeros(n)),
    ]
    for m, free in problem.free_m2.items():
        own = np.where(problem.surface == m, problem.piece_m2, 0.0)
        rows.append(LinearConstraint(np.concatenate([own, np.zeros(n + k)])[None], ub=free + 1e-6))
    if np.isfinite(most_cost):
        price = np.concatenate([problem.cost, np.zeros(n + k)])
        rows.append(LinearConstraint(price[None], ub=most_cost))
    for used_before in excluded:
        cut = np.concatenate([np.zeros(n), np.where(used_before, -1.0, 1.0), np.zeros(k)])
        rows.append(LinearConstraint(cut[None], lb=1.0 - np.sum(used_before)))
    dearest = 1.0 + float(problem.cost @ problem.most)
    found = milp(
        np.concatenate([problem.cost, np.full(n, 1e-6 * dearest / n), np.full(k, 100.0 * dearest)]),
        constraints=rows,
        integrality=np.concatenate([np.ones(2 * n), np.zeros(k)]),
        bounds=Bounds(0.0, np.concatenate([problem.most, np.ones(n), np.full(k, np.inf)])),
        options={"time_limit": 2.0, "mip_rel_gap": 1e-4},
    )
    return None if found.x is None else np.round(found.x[:n])


def _exchanged(
    problem: Problem,
    best: tuple[FloatArray, FloatArray],
    margin: FloatArray,
    excluded: Sequence[BoolArray],
    most_cost: float,
) -> tuple[FloatArray, FloatArray]:
    """Return the best arrangement after pieces were taken, added and exchanged, one by one."""
    for k in range(_EXCHANGES):
        here, numbers = best
        # of hundreds of columns a slope costs more than what a newer one would tell
        if k == 0 or (len(here) <= _MANY and k % 4 == 0):
            slopes = _slopes(problem, here, numbers, np.ones(len(here)))
        moves = _moves(problem, here)
        trial = here + moves
        fits = np.all(trial <= problem.most, axis=1) & (trial @ problem.cost <= most_cost)
        for m, free in problem.free_m2.items():
            on_it = problem.surface == m
            fits &= trial[:, on_it] @ problem.piece_m2[on_it] <= free + 1e-6
        for used_before in excluded:
            fits &= np.any((trial > 0) != used_before, axis=1)
        trial, moves = trial[fits], moves[fits]
        if not len(trial):
            break
        likely = _linear(problem, _linear(problem, numbers) + moves @ slopes.T)
        missed = excess(problem, likely, margin).sum(axis=1)
        order = np.lexsort((trial @ problem.cost, np.round(missed, 3)))[:_TRIED_AT_ONCE]
        found = numbers_of(problem, trial[order])
        worths = [_worth(problem, t, f, margin) for t, f in zip(trial[order], found, strict=True)]
        first = min(range(len(worths)), key=worths.__getitem__)
        if worths[first] >= _worth(problem, here, numbers, margin):
            break
        best = (trial[order][first], found[first])
    return best


def _moves(problem: Problem, here: FloatArray) -> FloatArray:
    """Return changes by pieces: one or a quarter less, one more, and one or all of it exchanged."""
    n, one = len(here), np.eye(len(here))
    moves = list(one)
    for i in np.flatnonzero(here):
        for less in {1.0, float(np.ceil(here[i] / 4.0)), float(here[i])}:
            away = -less * one[i]
            moves.append(away)
            for j in range(n):
                if j != i:
                    ratio = problem.piece_m2[i] / problem.piece_m2[j]
                    for more in {max(1.0, float(np.floor(less * ratio))), 1.0}:
                        moves.append(away + more * one[j])
    return np.array(moves)
