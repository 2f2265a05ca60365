"""The cheapest arrangements that meet the targets: a linear start, then exchanges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp

from roomfit.base.kernels import each_in_threads
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.predict.decay import extrapolated_sti, moved
from roomfit.predict.diffuse import PreparedField, field_times_s, in_rows
from roomfit.treat.question import ChangingRoom, Question, is_time, limits_of, rows_of, treated

_ROUNDS, _EXCHANGES = 5, 60
_TRIED_AT_ONCE = 48
_POINTS = 128
_MANY = 64
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
        n_names, n_bands = room.base.shape[1:]
        values = np.full((len(absorptions), n_names + 1, n_bands), np.nan)
        for a in range(0, len(absorptions), _POINTS):
            part = values[a : a + _POINTS]
            energies = few.energies(absorptions[a : a + _POINTS, :, at])
            there = few.values(energies)
            sti = few.sti(energies, there, room.speech_db)
            part[:, :-1, at] = moved(room.before[i].values[:, at], there, room.base[i][:, at])
            part[:, -1] = extrapolated_sti(room.before[i], sti, room.base_sti[i])[:, None]
        return values

    found = np.ma.masked_invalid(each_in_threads(own, len(room.few)))
    return np.asarray(np.ma.filled(found.mean(axis=0), np.nan))


def numbers_of(question: Question, pieces: FloatArray) -> FloatArray:
    """Return the number of every row for many arrangements, shape (n_points, n_rows)."""
    wanted = np.any(question.weights > 0.0, axis=0)
    return rows_of(question, mean_values(question.room, treated(question, pieces), wanted))


def excess(question: Question, numbers: FloatArray, margin: FloatArray) -> FloatArray:
    """Return by how much each row misses its limits, in their units over a scale, (..., n_rows).

    Times are scaled by their limit, all else by 20 just noticeable differences. NaN counts as 1.
    """
    low, high = limits_of(question)
    high, low = high - margin, low + margin
    scale = scale_of(question)
    missed = np.maximum(np.maximum(low - numbers, numbers - high), 0.0) / scale
    missed = np.where(missed * scale <= MET * scale, 0.0, missed)
    return np.asarray(np.where(np.isnan(numbers), 1.0, missed))


def scale_of(question: Question) -> FloatArray:
    """Return what misses of each row are measured by, see `excess`, (n_rows,)."""
    low, high = limits_of(question)
    finite = np.where(np.isfinite(high), high, low)
    others = {"D50_percent": 100.0, "TS_ms": 200.0, "STI": 0.6}
    whole = [others.get(question.targets[t].parameter, 20.0) for t in question.target]
    return np.where(is_time(question), np.abs(finite), whole)


def best_arrangement(
    question: Question,
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
    n = len(question.cost)
    here = np.zeros(n)
    numbers = numbers_of(question, here[None])[0]
    best = None if excluded else (here, numbers)
    step = question.most.copy()
    for _ in range(_ROUNDS):
        slopes = _slopes(question, here, numbers, step)
        found = _programme(question, here, numbers, slopes, margin, excluded, most_cost)
        if found is None:
            break
        is_new = np.any(found != here)
        here = found
        numbers = numbers_of(question, here[None])[0]
        if best is None or _worth(question, here, numbers, margin) < _worth(
            question, *best, margin
        ):
            best = (here, numbers)
        if not is_new:
            break
        step = np.maximum(np.floor(question.most / 8.0), 1.0)
    if best is None:
        return here, numbers
    return _exchanged(question, best, margin, excluded, most_cost)


def _worth(
    question: Question, pieces: FloatArray, numbers: FloatArray, margin: FloatArray
) -> tuple[float, float]:
    """Return what is compared of arrangements: what is missed, then the cost."""
    missed = float(excess(question, numbers, margin).sum())
    return round(missed, 9), float(question.cost @ pieces) + 1e-9 * float(pieces.sum())


def _linear(question: Question, numbers: FloatArray) -> FloatArray:
    return np.asarray(np.where(is_time(question), 1.0 / np.maximum(numbers, 1e-3), numbers))


def _slopes(
    question: Question, here: FloatArray, numbers: FloatArray, step: FloatArray
) -> FloatArray:
    """Return the change of each row for a piece more of each column, (n_rows, n_columns)."""
    moves = np.where(here + step <= question.most, step, -np.minimum(step, np.maximum(here, 1.0)))
    points = np.maximum(here + np.diag(moves), 0.0)
    change = _linear(question, numbers_of(question, points)) - _linear(question, numbers)
    return np.nan_to_num((change / moves[:, None]).T)


def _programme(
    question: Question,
    here: FloatArray,
    numbers: FloatArray,
    slopes: FloatArray,
    margin: FloatArray,
    excluded: Sequence[BoolArray],
    most_cost: float,
) -> FloatArray | None:
    """Return the pieces that solve the linear problem."""
    n, k = len(question.cost), len(question.target)
    low, high = limits_of(question)
    low, high = low + margin, high - margin
    times = is_time(question)
    with np.errstate(divide="ignore"):
        inverse = (
            1.0 / np.maximum(high, 1e-3),
            np.where(low > 0.0, 1.0 / np.maximum(low, 1e-9), np.inf),
        )
    low, high = np.where(times, inverse[0], low), np.where(times, inverse[1], high)
    linear = np.nan_to_num(_linear(question, numbers))
    scale = np.where(times, 1.0 / scale_of(question), scale_of(question))
    base = slopes @ here - linear
    slack = np.diag(scale)
    nothing = np.zeros((k, n))
    rows = [
        LinearConstraint(np.hstack([slopes, nothing, slack]), lb=low + base),
        LinearConstraint(np.hstack([slopes, nothing, -slack]), ub=high + base),
    ]
    used = np.hstack([np.eye(n), -np.diag(question.most), np.zeros((n, k))])
    some = np.hstack([np.eye(n), -np.eye(n), np.zeros((n, k))])
    rows += [LinearConstraint(used, ub=np.zeros(n)), LinearConstraint(some, lb=np.zeros(n))]
    for m, free in question.free_m2.items():
        own = np.where(np.array(question.surface) == m, question.piece_m2, 0.0)
        rows.append(LinearConstraint(np.concatenate([own, np.zeros(n + k)])[None], ub=free + 1e-6))
    if np.isfinite(most_cost):
        price = np.concatenate([question.cost, np.zeros(n + k)])
        rows.append(LinearConstraint(price[None], ub=most_cost))
    for used_before in excluded:
        cut = np.concatenate([np.zeros(n), np.where(used_before, -1.0, 1.0), np.zeros(k)])
        rows.append(LinearConstraint(cut[None], lb=1.0 - np.sum(used_before)))
    dearest = 1.0 + float(question.cost @ question.most)
    found = milp(
        np.concatenate(
            [question.cost, np.full(n, 1e-6 * dearest / n), np.full(k, 100.0 * dearest)]
        ),
        constraints=rows,
        integrality=np.concatenate([np.ones(2 * n), np.zeros(k)]),
        bounds=Bounds(0.0, np.concatenate([question.most, np.ones(n), np.full(k, np.inf)])),
        options={"time_limit": 2.0, "mip_rel_gap": 1e-4},
    )
    return None if found.x is None else np.round(found.x[:n])


def _exchanged(
    question: Question,
    best: tuple[FloatArray, FloatArray],
    margin: FloatArray,
    excluded: Sequence[BoolArray],
    most_cost: float,
) -> tuple[FloatArray, FloatArray]:
    """Return the best arrangement after pieces were taken, added and exchanged, one by one."""
    surface = np.array(question.surface)
    for k in range(_EXCHANGES):
        here, numbers = best
        # of hundreds of columns a slope costs more than what a newer one would tell
        if k == 0 or (len(here) <= _MANY and k % 4 == 0):
            slopes = _slopes(question, here, numbers, np.ones(len(here)))
        moves = _moves(question, here)
        trial = here + moves
        taken = np.array(
            [np.any(np.all((trial > 0) == e, axis=1)[:, None], axis=1) for e in excluded]
        )
        fits = np.all(trial <= question.most, axis=1) & (trial @ question.cost <= most_cost)
        for m, free in question.free_m2.items():
            fits &= trial[:, surface == m] @ question.piece_m2[surface == m] <= free + 1e-6
        if excluded:
            fits &= ~taken.any(axis=0)
        trial, moves = trial[fits], moves[fits]
        if not len(trial):
            break
        linear = _linear(question, numbers) + moves @ slopes.T
        likely = np.where(is_time(question), 1.0 / np.maximum(linear, 1e-3), linear)
        missed = excess(question, likely, margin).sum(axis=1)
        order = np.lexsort((trial @ question.cost, np.round(missed, 3)))[:_TRIED_AT_ONCE]
        found = numbers_of(question, trial[order])
        worths = [_worth(question, t, f, margin) for t, f in zip(trial[order], found, strict=True)]
        first = min(range(len(worths)), key=worths.__getitem__)
        if worths[first] >= _worth(question, here, numbers, margin):
            break
        best = (trial[order][first], found[first])
    return best


def _moves(question: Question, here: FloatArray) -> FloatArray:
    """Return changes by pieces: one or a quarter less, one more, and one or all of it exchanged."""
    n, one = len(here), np.eye(len(here))
    moves = list(one)
    for i in np.flatnonzero(here):
        for less in {1.0, float(np.ceil(here[i] / 4.0)), float(here[i])}:
            away = -less * one[i]
            moves.append(away)
            for j in range(n):
                if j != i:
                    ratio = question.piece_m2[i] / question.piece_m2[j]
                    for more in {max(1.0, float(np.floor(less * ratio))), 1.0}:
                        moves.append(away + more * one[j])
    return np.array(moves)
