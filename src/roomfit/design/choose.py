"""Which few of many possible measurements are most informative: greedily, then by exchanges."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from roomfit.base.errors import InputError
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.design.information import (
    PairInformation,
    information_of,
    interval_widths,
    without_gain,
)
from roomfit.design.prior import Unknowns

Criterion = Literal["determinant", "mean", "worst"]
# The widest interval decides; among designs that leave it alike, the mean does.
_MEAN_BESIDE_WORST = 1e-3
# An exchange must better the criterion by more than rounding.
_LEAST_GAIN = 1e-9
_MOST_EXCHANGES = 100
_RANDOM_STARTS = 4
_TRIES = 100  # of random designs, before so many pairs are said to be impossible


@dataclass(frozen=True, slots=True, eq=False)
class Rules:
    """What may stand together in one design."""

    source: IntArray  # (n_pairs,), which source each pair has
    # (n_pairs, n_pairs), whether two pairs may both be measured; symmetric. No pair is compatible
    # with itself, and one that is compatible with none but allowed alone is still a candidate.
    compatible: BoolArray
    candidate: BoolArray  # (n_pairs,), False for what has been measured already
    fixed: tuple[int, ...] = ()  # pairs that have been measured and count
    most_sources: int | None = None  # how many different sources a design may have


def allowed(rules: Rules, chosen: list[int]) -> BoolArray:
    """Return which pairs may be added to those that are chosen or fixed, shape (n_pairs,)."""
    mask = rules.candidate & rules.compatible[[*rules.fixed, *chosen]].all(axis=0)
    mask[chosen] = False
    sources = np.unique(rules.source[chosen])
    if rules.most_sources is not None and sources.size >= rules.most_sources:
        mask &= np.isin(rules.source, sources)
    return np.asarray(mask)


def score(unknowns: Unknowns, information: FloatArray, criterion: Criterion) -> FloatArray:
    """Return what a criterion makes of some information, the lower the better, shape (...).

    Parameters
    ----------
    information : float array, shape (..., n_draws, n_bands, n, n)
    criterion : {"determinant", "mean", "worst"}
        Mean log determinant of the covariance of the logits (D-optimal); mean width of the 95 %
        intervals over materials and bands (A-optimal in absorption); the widest of them. All are
        means over the draws.
    """
    if criterion == "determinant":
        return np.asarray(-np.linalg.slogdet(information)[1].mean(axis=(-1, -2)))
    widths = interval_widths(unknowns, information)
    own = unknowns.number[unknowns.number >= 0]
    share = np.bincount(own, minlength=widths.shape[-1]) / own.size
    mean = (widths @ share).mean(axis=-1)
    if criterion == "mean":
        return np.asarray(mean)
    return np.asarray(widths.max(axis=(-1, -2)) + _MEAN_BESIDE_WORST * mean)


def scores_of_additions(
    unknowns: Unknowns, pairs: PairInformation, chosen: list[int], criterion: Criterion
) -> FloatArray:
    """Return the score of a design with each of the pairs added in turn, shape (n_pairs,)."""
    total = np.empty(pairs.matrices.shape[:3] + unknowns.information.shape[-2:])
    picked = np.array(chosen, dtype=np.int64)
    for gain in np.unique(pairs.gain):
        own = np.flatnonzero(pairs.gain == gain)
        sharing = pairs.gain[picked] == gain
        rest = information_of(unknowns, pairs, picked[~sharing])
        together = pairs.matrices[own] + pairs.matrices[picked[sharing]].sum(axis=0)
        total[own] = rest + (together[..., :-1, :-1] if gain < 0 else without_gain(together))
    return score(unknowns, total, criterion)


def choose(
    unknowns: Unknowns,
    pairs: PairInformation,
    rules: Rules,
    n: int,
    criterion: Criterion = "determinant",
    *,
    rng: np.random.Generator,
) -> tuple[int, ...]:
    """Return the pairs to measure, the most informative first.

    Greedily one after the other; then each is exchanged for the best other one, as long as that
    helps [1]_. Pairs that share a gain help each other, which neither step looks ahead for: so
    random designs are bettered by exchanges as well, and the best of all is taken. At last its
    pairs are put in order, greedily again.

    Parameters
    ----------
    n : int
        How many, 1 or more.
    criterion : {"determinant", "mean", "worst"}
        See `score`.
    rng : numpy.random.Generator
        Draws the random designs.

    Raises
    ------
    InputError
        The rules do not allow so many.

    References
    ----------
    .. [1] V. V. Fedorov, Theory of Optimal Experiments, Academic Press, 1972; one exchange at a
           time as in R. D. Cook, C. J. Nachtsheim, "A comparison of algorithms for constructing
           exact D-optimal designs", Technometrics 22, 315-324 (1980).
    """

    def best_addition(chosen: list[int], mask: BoolArray) -> tuple[float, int]:
        together = [*rules.fixed, *chosen]
        scores = scores_of_additions(unknowns, pairs, together, criterion)
        scores = np.where(mask, scores, np.inf)
        at = int(np.argmin(scores))
        return float(scores[at]), at

    greedy = _greedy(rules, n, best_addition)
    designs = [greedy if len(greedy) == n else possible_design(rules, n)]
    for _ in range(_RANDOM_STARTS if n > 1 else 0):
        drawn = random_design(rules, n, rng)
        if len(drawn) == n:
            designs.append(list(drawn))
    found = []
    for chosen in designs:
        information = information_of(unknowns, pairs, [*rules.fixed, *chosen])
        now = float(score(unknowns, information, criterion))
        found.append(_exchanged(rules, chosen, now, best_addition))
    _, best = min(found, key=lambda one: one[0])
    order: list[int] = []
    while len(order) < n:
        mask = np.zeros(len(pairs.gain), dtype=np.bool_)
        mask[[c for c in best if c not in order]] = True
        order.append(best_addition(order, mask)[1])
    return tuple(order)


BestAddition: TypeAlias = Callable[[list[int], BoolArray], tuple[float, int]]
"""Of chosen pairs, and those allowed: the lowest score that an addition reaches, and which."""


def _greedy(rules: Rules, n: int, best_addition: BestAddition) -> list[int]:
    """Return the best pair, the best beside it, ...; fewer than n where none is left to add."""
    chosen: list[int] = []
    for _ in range(n):
        mask = allowed(rules, chosen)
        if not mask.any():
            break
        chosen.append(best_addition(chosen, mask)[1])
    return chosen


def possible_design(rules: Rules, n: int) -> list[int]:
    """Return some design that the rules allow, without any information: in no time.

    Raises
    ------
    InputError
        None of a hundred random designs has as many pairs.
    """
    rng, most = np.random.default_rng(1), 0
    for _ in range(_TRIES):
        found = random_design(rules, n, rng)
        if len(found) == n:
            return list(found)
        most = max(most, len(found))
    raise InputError(
        "the rules leave no position for another measurement",
        found=f"{most} of {n}",
        needed=f"{n} positions that keep the rules",
        hint="choose fewer, give more candidates, or lower the least distances in [design]",
    )


def _exchanged(
    rules: Rules, chosen: list[int], now: float, best_addition: BestAddition
) -> tuple[float, list[int]]:
    """Return score and design after single exchanges, the best first, until none helps."""
    for _ in range(_MOST_EXCHANGES):
        found = []
        for i in range(len(chosen)):
            rest = chosen[:i] + chosen[i + 1 :]
            found.append((*best_addition(rest, allowed(rules, rest)), i))
        best, at, index = min(found)
        if best > now - _LEAST_GAIN:
            break
        chosen, now = [*chosen[:index], at, *chosen[index + 1 :]], best
    return now, chosen


def random_design(rules: Rules, n: int, rng: np.random.Generator) -> tuple[int, ...]:
    """Return pairs drawn one after the other, each evenly from those that the rules still allow.

    Fewer than n where the rules allow no further one.
    """
    chosen: list[int] = []
    for _ in range(n):
        open_ = np.flatnonzero(allowed(rules, chosen))
        if not open_.size:
            break
        chosen.append(int(rng.choice(open_)))
    return tuple(chosen)
