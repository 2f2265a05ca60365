"""Which few of many possible measurements are most informative: greedily, then by exchanges."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from roomfit.base.errors import InputError
from roomfit.base.logit import Z95, expit
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.design.prior import Unknowns

Criterion = Literal["determinant", "mean", "worst"]
# The widest interval decides; among designs that leave it alike, the mean does.
_MEAN_BESIDE_WORST = 1e-3
# An exchange must better the criterion by more than rounding.
_LEAST_GAIN = 1e-9
_MOST_EXCHANGES = 100
_RANDOM_STARTS = 4
_TRIES = 100  # of random designs, before so many pairs are said to be impossible
# Of a gain: next to nothing, so that a pair without energy does not divide by zero.
_LEAST_GAIN_INFORMATION = 1e-9


class PairInformation(NamedTuple):
    """Fisher information of a measurement of each pair of source and receiver, by itself."""

    # (n_pairs, n_draws, n_bands, n + 1, n + 1): of the n unknowns and, last, the log of the gain
    matrices: FloatArray
    # (n_pairs,): pairs of one number share one unknown gain in each band; -1: the level is known
    gain: IntArray


class Rules(NamedTuple):
    """What may stand together in one design."""

    source: IntArray  # (n_pairs,), which source each pair has
    # (n_pairs, n_pairs), whether two pairs may both be measured; symmetric. No pair is compatible
    # with itself, and one that is compatible with none but allowed alone is still a candidate.
    compatible: BoolArray
    candidate: BoolArray  # (n_pairs,), False for what has been measured already
    fixed: tuple[int, ...] = ()  # pairs that have been measured and count
    most_sources: int | None = None  # how many different sources a design may have


def without_gain(matrices: FloatArray) -> FloatArray:
    """Return the information about the absorptions when the gain is found along with them.

    The Schur complement of the last row and column, shape (..., n, n) of (..., n + 1, n + 1).
    """
    cross = matrices[..., :-1, -1]
    own = matrices[..., -1, -1] + _LEAST_GAIN_INFORMATION
    taken = cross[..., :, None] * cross[..., None, :] / own[..., None, None]
    return np.asarray(matrices[..., :-1, :-1] - taken)


def information_of(
    unknowns: Unknowns, pairs: PairInformation, chosen: list[int] | IntArray
) -> FloatArray:
    """Return the information after some pairs are measured, (n_draws, n_bands, n, n).

    Pairs that share a gain have more information together than the sum of each alone.
    """
    total = unknowns.information.copy()
    picked = np.asarray(chosen, dtype=np.int64)
    gains = pairs.gain[picked]
    for gain in np.unique(gains):
        own = pairs.matrices[picked[gains == gain]].sum(axis=0)
        total += own[..., :-1, :-1] if gain < 0 else without_gain(own)
    return np.asarray(total)


def interval_widths(unknowns: Unknowns, information: FloatArray) -> FloatArray:
    """Return the expected width of each unknown's 95 % interval, shape (..., n_bands, n).

    The mean over the draws of information (..., n_draws, n_bands, n, n); symmetric in logit.
    """
    covariance = np.linalg.inv(information)
    reach = Z95 * np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    ends = [expit(unknowns.logit + sign * reach) for sign in (1.0, -1.0)]
    width = (unknowns.upper - unknowns.lower) * (ends[0] - ends[1])
    return np.asarray(width.mean(axis=-3))


def material_widths(unknowns: Unknowns, information: FloatArray) -> FloatArray:
    """Return `interval_widths` of every material, known ones 0, shape (n_materials, n_bands)."""
    widths = interval_widths(unknowns, information)
    padded = np.concatenate((widths, np.zeros((len(widths), 1))), axis=1)
    return np.asarray(padded[:, unknowns.number].T)


def allowed(rules: Rules, chosen: list[int]) -> BoolArray:
    """Return which pairs may be added to those that are chosen or fixed, shape (n_pairs,)."""
    mask = rules.candidate & rules.compatible[[*rules.fixed, *chosen]].all(axis=0)
    mask[chosen] = False
    sources = np.unique(rules.source[chosen])
    if rules.most_sources is not None and sources.size >= rules.most_sources:
        mask &= np.isin(rules.source, sources)
    return np.asarray(mask)


def score(unknowns: Unknowns, information: FloatArray, criterion: Criterion) -> FloatArray:
    """Return what a criterion makes of information (..., n_draws, n_bands, n, n); lower is better.

    "determinant": mean log determinant of the covariance of the logits (D-optimal); "mean": mean
    width of the 95 % intervals over materials and bands (A-optimal in absorption); "worst": the
    widest of them. All are means over the draws.
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


class Choice(NamedTuple):
    """What is chosen from, and by which criterion."""

    unknowns: Unknowns
    pairs: PairInformation
    rules: Rules
    criterion: Criterion = "determinant"

    def best_addition(self, chosen: list[int], mask: BoolArray) -> tuple[float, int]:
        """Return the lowest score that the addition of an allowed pair reaches, and which."""
        pairs, picked = self.pairs, np.array([*self.rules.fixed, *chosen], dtype=np.int64)
        total = np.empty(pairs.matrices.shape[:3] + self.unknowns.information.shape[-2:])
        for gain in np.unique(pairs.gain):
            own = np.flatnonzero(pairs.gain == gain)
            sharing = pairs.gain[picked] == gain
            rest = information_of(self.unknowns, pairs, picked[~sharing])
            together = pairs.matrices[own] + pairs.matrices[picked[sharing]].sum(axis=0)
            total[own] = rest + (together[..., :-1, :-1] if gain < 0 else without_gain(together))
        scores = np.where(mask, score(self.unknowns, total, self.criterion), np.inf)
        at = int(np.argmin(scores))
        return float(scores[at]), at

    def greedy(self, n: int) -> list[int]:
        """Return the best pair, the best beside it, ...; fewer than n where none can be added."""
        chosen: list[int] = []
        while len(chosen) < n and (mask := allowed(self.rules, chosen)).any():
            chosen.append(self.best_addition(chosen, mask)[1])
        return chosen

    def exchanged(self, chosen: list[int]) -> tuple[float, list[int]]:
        """Return score and design after single exchanges, the best first, until none helps."""
        information = information_of(self.unknowns, self.pairs, [*self.rules.fixed, *chosen])
        now = float(score(self.unknowns, information, self.criterion))
        for _ in range(_MOST_EXCHANGES):
            found = []
            for i in range(len(chosen)):
                rest = chosen[:i] + chosen[i + 1 :]
                found.append((*self.best_addition(rest, allowed(self.rules, rest)), i))
            best, at, index = min(found)
            if best > now - _LEAST_GAIN:
                break
            chosen, now = [*chosen[:index], at, *chosen[index + 1 :]], best
        return now, chosen


def choose(choice: Choice, n: int, *, rng: np.random.Generator) -> tuple[int, ...]:
    """Return n pairs to measure, the most informative first; refuse more than the rules allow.

    Greedily one after the other; then each is exchanged for the best other one, as long as that
    helps [1]_. Pairs that share a gain help each other, which neither step looks ahead for: so
    random designs are bettered by exchanges as well, and the best of all is taken. At last its
    pairs are put in order, greedily again.

    References
    ----------
    .. [1] V. V. Fedorov, Theory of Optimal Experiments, Academic Press, 1972; one exchange at a
           time as in R. D. Cook, C. J. Nachtsheim, "A comparison of algorithms for constructing
           exact D-optimal designs", Technometrics 22, 315-324 (1980).
    """
    rules, greedy = choice.rules, choice.greedy(n)
    designs = [greedy if len(greedy) == n else possible_design(rules, n)]
    for _ in range(_RANDOM_STARTS if n > 1 else 0):
        drawn = random_design(rules, n, rng)
        if len(drawn) == n:
            designs.append(list(drawn))
    _, best = min((choice.exchanged(chosen) for chosen in designs), key=lambda one: one[0])
    order: list[int] = []
    while len(order) < n:
        mask = np.zeros(len(rules.source), dtype=np.bool_)
        mask[[c for c in best if c not in order]] = True
        order.append(choice.best_addition(order, mask)[1])
    return tuple(order)


def possible_design(rules: Rules, n: int) -> list[int]:
    """Return some design that the rules allow, without any information: in no time."""
    rng, most = np.random.default_rng(1), 0
    for _ in range(_TRIES):
        found = random_design(rules, n, rng)
        if len(found) == n:
            return list(found)
        most = max(most, len(found))
    what = "the rules leave no position for another measurement"
    needed = f"{n} positions that keep the rules"
    hint = "choose fewer, give more candidates, or lower the least distances in [design]"
    raise InputError(what, found=f"{most} of {n}", needed=needed, hint=hint)


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
