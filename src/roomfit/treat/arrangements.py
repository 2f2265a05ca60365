"""What to hang where, so that a room meets its targets, and how likely it then does."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

from roomfit.base.arguments import check_range
from roomfit.base.bands import Bands
from roomfit.base.findings import About, Code, Finding
from roomfit.base.kernels import one_blas_thread
from roomfit.base.table import Shown
from roomfit.base.typing import BoolArray, FloatArray, Progress
from roomfit.predict.changes import Change, change_text
from roomfit.predict.diffuse import PreparedField, field_values, in_rows
from roomfit.predict.other_walls import numbers_at
from roomfit.predict.predict import ChangingRoom
from roomfit.predict.prediction import PredictedValue, named_values
from roomfit.predict.tables import predicted_means
from roomfit.result import result_doubts
from roomfit.room.scene import pair_names
from roomfit.signals.iso3382 import VALUE_NAMES, ValueName
from roomfit.treat import question
from roomfit.treat.search import MET, best_arrangement, excess

# Arrangements of which more of the area hangs alike are one, within the tolerance of products.
_SAME_SHARE = 0.8
_MARGIN_ROUNDS = 6  # a margin hangs on the arrangement, and that on the margin
# Means by parameter, and the speech transmission index.
_Means = tuple[dict[ValueName, PredictedValue], PredictedValue | None]


@dataclass(frozen=True, slots=True)
class Hung:
    """A product on a surface."""

    surface: str
    product: str
    area_m2: float
    share: float  # of the surface
    pieces: int
    cost: float
    change: str  # as `roomfit predict --set` takes it


@dataclass(frozen=True, slots=True, eq=False)
class Arrangement:
    """One answer, and what it does."""

    hung: tuple[Hung, ...]
    cost: float
    mean: Mapping[ValueName, PredictedValue]  # over all pairs, with what was before
    # (n_targets,), that a measurement after it meets the target in all its bands; and all targets
    probability: FloatArray
    before: FloatArray  # (n_targets,), the same without any treatment
    joint: float
    missed: tuple[str, ...]  # what the likeliest prediction misses, in words
    # what the spread of the least likely target is due to: share of its variance
    decisive: tuple[tuple[str, float], ...]
    sti: PredictedValue | None = None  # as `mean`, of shape (1,), where the bands give it

    @property
    def is_sure(self) -> bool:
        """Whether all targets are met with a probability of 95 %."""
        return self.joint >= 0.95


@dataclass(frozen=True, slots=True, eq=False)
class Treatment(Shown):
    """The best arrangements, cheapest first; or the one that misses least."""

    described_in: ClassVar[str] = "treated"
    drawn: ClassVar[str] = "treatment"
    bands: Bands
    targets: tuple[question.Target, ...]
    arrangements: tuple[Arrangement, ...]
    is_met: bool  # by the likeliest prediction; each as likely as asked for where that is above 0.5
    room: ChangingRoom
    findings: tuple[Finding, ...]
    # pairs to be measured for the absorption on which a target hangs, in words, by `roomfit.design`
    to_measure: tuple[str, ...] = ()
    before: str = "predicted before"  # what stands before in the means, in words
    asked: float = 0.5  # probability of each target in each band


@one_blas_thread
def treat(
    room: ChangingRoom,
    surfaces: Sequence[question.Surface],
    products: Sequence[question.Product],
    targets: Sequence[question.Target],
    *,
    number: int = 3,
    probability: float = 0.5,
    most_cost: float = np.inf,
    progress: Progress | None = None,
) -> Treatment:
    """Choose what to hang where.

    The cheapest arrangements of whole pieces, each of another set of products and surfaces, with
    which a measured mean over all pairs meets each target in each of its bands at least as likely
    as asked for.

    Parameters
    ----------
    room : PreparedRoom or PreparedField
        From `roomfit.prepare`, of any pairs; or, of T30 alone, of a diffuse field.
    surfaces, products, targets : sequences of Surface, Product and Target
    number : int
        How many arrangements.
    probability : float
        0.5 to 0.99: of each target in each band.
    most_cost : float
        What all of it may cost.

    Raises
    ------
    InputError
        See `problem_of`; or the probability is out of range.

    Notes
    -----
    A surface that is covered in part has the area-weighted mean of what covers it and of itself,
    wherever the pieces hang: in a diffuse field its energy. The probability is of a measurement
    after the treatment: over common draws of what is not known of the room and of the products,
    with interference, the number of rays and errors that pairs share, as `predict` has them.
    """
    check_range("the probability of meeting a target", probability, 0.5, 0.99)
    in_words = _before_in_words(room)
    problem = question.problem_of(room, surfaces, products, targets)
    known: dict[tuple[float, ...], _Outcome] = {}

    def best(margin: FloatArray, excluded: Sequence[BoolArray]) -> _Outcome:
        # margins go to and fro between two arrangements, and an alternative may be one of them
        found = best_arrangement(problem, margin, excluded, most_cost)
        key = tuple(found[0].tolist())
        known[key] = known.get(key) or _outcome(problem, *found, probability)
        return known[key]

    found, is_met = _cheapest(problem, best, number, probability, progress)
    first = found[0]
    found.sort(key=lambda one: one.cost)
    bare = 0.0 * problem.cost
    unlimited = np.zeros(len(problem.target))
    nothing = known.get(tuple(bare.tolist())) or _outcome(problem, bare, unlimited, probability)
    before, _ = _of_targets(problem, nothing.odds)
    arrangements = tuple(_arrangement(problem, one, before) for one in found)
    doubts = (
        *result_doubts(room.absorption, room.scene.room.findings),
        *_of_the_room(room, arrangements),
        *_findings(problem, arrangements, first, probability),
    )
    return Treatment(
        room.absorption.bands, problem.targets, arrangements, is_met, room, doubts,
        before=in_words, asked=probability,
    )  # fmt: skip


def _cheapest(
    problem: question.Problem,
    best: Callable[[FloatArray, Sequence[BoolArray]], _Outcome],
    number: int,
    probability: float,
    progress: Progress | None,
) -> tuple[list[_Outcome], bool]:
    """Return the best arrangements, first the best of all, and whether they meet the targets.

    `best` searches under margins, without some sets of products and surfaces.
    """
    margin = np.zeros(len(problem.target))
    tried = [best(margin, ())]
    for _ in range(_MARGIN_ROUNDS):
        if probability <= 0.5 and not tried[-1].missed:
            break
        margin = _margin(problem, tried[-1], probability)
        tried.append(best(margin, ()))
        if tried[-1] is tried[-2]:
            break
    met = [one for one in tried if not one.missed]
    first = min(met or tried[-1:], key=lambda one: one.cost)
    found, excluded = [first], list[BoolArray]()
    latest = first
    while met and first.pieces.any() and len(found) < number and len(excluded) < 4 * number:
        excluded.append(latest.pieces > 0)
        latest = best(margin, excluded)
        if latest.missed:  # what few paths let pass
            latest = best(_margin(problem, latest, probability), excluded)
        if latest.missed or any(np.array_equal(latest.pieces > 0, e) for e in excluded):
            break
        if any(_in_common(problem, latest.pieces, one.pieces) > _SAME_SHARE for one in found):
            continue
        found.append(latest)
        if progress is not None:
            progress(len(found) / number)
    return found, bool(met)


def _in_common(problem: question.Problem, one: FloatArray, other: FloatArray) -> float:
    """Return which share of the area two arrangements hang in the same places."""
    both, larger = (
        float(problem.piece_m2 @ pieces)
        for pieces in (np.minimum(one, other), np.maximum(one, other))
    )
    return both / larger


def _of_the_room(room: ChangingRoom, arrangements: Sequence[Arrangement]) -> tuple[Finding, ...]:
    """Return what is left out, and what the prior alone says of surfaces that are covered."""
    if isinstance(room, PreparedField):
        return room.findings
    covered = {h.surface for a in arrangements for h in a.hung}
    dominated = tuple(f for f in room.dominated if covered & set(f.about.materials))
    return tuple(f for f in room.absorption.findings if f.code is Code.RESULT_DOUBTED) + dominated


def _before_in_words(room: ChangingRoom) -> str:
    """Return what the mean of T30 before is: measured in every band and pair, in some, in none."""
    if isinstance(room, PreparedField):
        known = np.isfinite(room.measured_s)
    else:
        at = VALUE_NAMES.index("T30_s")
        found = {(o.source, o.receiver): np.isfinite(o.values[at]) for o in room.observed}
        nothing = np.zeros(len(room.absorption.bands), dtype=np.bool_)
        known = np.array([found.get(n[:2], nothing) for n in pair_names(room.scene)])
    if not known.any():
        return "predicted before"
    return "measured before" if known.all() else "before, measured where it was"


class _Outcome(NamedTuple):
    """What an arrangement does, evaluated once for search, verdict and display."""

    pieces: FloatArray  # (n_candidates,), how many of each hang
    searched: FloatArray  # (n_rows,), the likeliest numbers, by few paths
    numbers: FloatArray  # (n_rows,), as they are predicted
    cost: float
    means: _Means
    rows: FloatArray  # (n_draws, n_rows), as absorption was drawn
    together: FloatArray  # the same, bands off together, see `_together`
    odds: FloatArray  # of `together`, that each draw is measured within its limits
    missed: tuple[str, ...]  # in words


def _outcome(
    problem: question.Problem, pieces: FloatArray, searched: FloatArray, probability: float
) -> _Outcome:
    """Return what an arrangement does, with draws and odds of every row."""
    means, drawn = _means_and_draws(
        problem.room, question.treated(problem, pieces), question.treated_draws(problem, pieces)
    )
    rows, numbers = question.rows_of(problem, drawn), _numbers_of(problem, means)
    together = question.rows_of(problem, _together(drawn))
    odds = _odds(problem, means, numbers, together)
    missed = _missed(problem, numbers, odds.mean(axis=0), probability)
    cost = float(problem.cost @ pieces)
    return _Outcome(pieces, searched, numbers, cost, means, rows, together, odds, missed)


def _numbers_of(problem: question.Problem, means: _Means, kind: str = "predicted") -> FloatArray:
    """Return what a table of means has of every row: what is predicted, or another number of it."""
    table = named_values(*means)
    own = [getattr(table[problem.targets[t].parameter], kind) for t in problem.target]
    each = zip(problem.weights, own, strict=True)
    return np.array([np.sum(np.where(w > 0.0, w * x, 0.0)) for w, x in each])


def _together(drawn: FloatArray) -> FloatArray:
    """Return draws (n_draws, n_names, n_bands), in every band in the order of its decay time.

    The absorption of each band is drawn by itself, but what is wrong with a description is wrong in
    all bands: a mean of three bands is off as much as each of them.
    """
    order = np.argsort(drawn[:, VALUE_NAMES.index("T30_s")], axis=0)
    return np.asarray(np.take_along_axis(drawn, order[:, None], axis=0))


def _of_targets(problem: question.Problem, odds: FloatArray) -> tuple[FloatArray, float]:
    """Return the odds of each target in all its bands, (n_targets,), and of all targets."""
    n = len(problem.targets)
    each = [np.mean(np.prod(odds[:, problem.target == t], axis=1)) for t in range(n)]
    return np.array(each), float(np.mean(np.prod(odds, axis=1)))


def _odds(
    problem: question.Problem, means: _Means, numbers: FloatArray, rows: FloatArray
) -> FloatArray:
    """Return the probability that each draw is measured within its limits, as `rows`."""
    sd = _rest_sd(problem, means, numbers)
    drawn, low, high = (_in_logs(problem, x) for x in (rows, problem.low, problem.high))
    return np.asarray(np.nan_to_num(ndtr((high - drawn) / sd) - ndtr((low - drawn) / sd)))


def _in_logs(problem: question.Problem, rows: FloatArray) -> FloatArray:
    """Return decay times as logarithms, all else as it is: on this scale the rest is a sum."""
    return np.where(problem.is_time, np.log(np.maximum(rows, 1e-9)), rows)


def _means_and_draws(
    room: ChangingRoom, absorption: FloatArray, draws: FloatArray
) -> tuple[_Means, FloatArray]:
    """Return the means over all pairs, and draws of them, (n_draws, n_names + 1, n_bands)."""
    if isinstance(room, PreparedField):
        values, drawn_s = field_values(room, absorption, draws)
        drawn = in_rows(drawn_s)
        return (values, None), np.concatenate([drawn, np.full_like(drawn[:, :1], np.nan)], axis=1)
    after = numbers_at(room, absorption, draws)
    states = [after, room.before]
    own = room.observed, room.expected, room.sabine_ratio(absorption)
    means, sti, drawn = predicted_means(room.scene, states, *own)
    return (means, sti), drawn


def _rest_sd(problem: question.Problem, means: _Means, numbers: FloatArray) -> FloatArray:
    """Return of each row the spread that is not the absorption's, alike in all its bands.

    Of logarithms of decay times, as their intervals are widened: a time is never 0.
    """
    found = _numbers_of(problem, means, "sd_rest")
    share = np.divide(found, numbers, out=np.zeros_like(found), where=numbers > 0.0)
    found = np.where(problem.is_time, np.sqrt(np.log1p(share**2)), found)
    return np.asarray(np.maximum(found, 1e-9))


def _margin(problem: question.Problem, one: _Outcome, probability: float) -> FloatArray:
    """Return by how much each row must keep its limits to meet them with some probability.

    The quantile of what may be measured, beside the number of the search: draws are not symmetric
    about it. At a probability of one half the number that is predicted.
    """
    rows = one.together
    steps = np.asarray(ndtri((np.arange(16) + 0.5) / 16.0))
    sd = _rest_sd(problem, one.means, one.numbers)
    wide = _in_logs(problem, rows)[:, None] + (steps / np.std(steps))[:, None] * sd
    ends = np.quantile(wide.reshape(-1, rows.shape[1]), (1.0 - probability, probability), axis=0)
    ends = np.where(problem.is_time, np.exp(ends), ends)
    ends = ends if probability > 0.5 else np.stack((one.numbers, one.numbers))
    below, above = np.nan_to_num((one.searched - ends[0], ends[1] - one.searched))
    below = np.where(np.isfinite(problem.low), below, -np.inf)
    above = np.where(np.isfinite(problem.high), above, -np.inf)
    # what the search lets pass is made up for
    return np.asarray(np.maximum(below, above) + MET * problem.scale)


def _arrangement(problem: question.Problem, one: _Outcome, before: FloatArray) -> Arrangement:
    pieces, (odds, joint) = one.pieces, _of_targets(problem, one.odds)
    materials = problem.room.absorption.materials
    hung = []
    for c in np.flatnonzero(pieces):
        m, area = problem.surface[c], float(pieces[c] * problem.piece_m2[c])
        p, share = problem.products[problem.product[c]], area / float(problem.areas_m2[m])
        own = Change(materials[m], "value", tuple(p.absorption), tuple(p.sd), share=share)
        if p.entry:
            own = Change(materials[m], "catalogue", entry=p.entry, share=share)
        n, cost = int(pieces[c]), float(pieces[c] * problem.cost[c])
        hung.append(Hung(materials[m], p.name, area, share, n, cost, change_text(own)))
    return Arrangement(
        tuple(hung),
        one.cost,
        one.means[0],
        odds,
        before,
        joint,
        one.missed,
        _decisive(problem, pieces, one.rows[:, problem.target == np.argmin(odds)]),
        one.means[1],
    )


def _missed(
    problem: question.Problem, numbers: FloatArray, odds: FloatArray, probability: float
) -> tuple[str, ...]:
    """Return in words what the likeliest prediction misses, or what is less likely than asked."""
    low, high, short = problem.low, problem.high, odds < probability
    if probability <= 0.5:
        short = excess(problem, numbers, np.zeros(len(numbers))) > 0.0
    lines = []
    for r in np.flatnonzero(short):
        target = problem.targets[problem.target[r]]
        at = problem.room.absorption.bands.centres_hz[problem.weights[r] > 0.0]
        limit = low[r] if numbers[r] < low[r] or np.isinf(high[r]) else high[r]
        found, needed = apart(numbers[r], limit, 2)
        line = f"{target.parameter} at {', '.join(f'{f:g}' for f in at)} Hz is {found}, "
        if probability > 0.5:
            likely, asked = apart(100.0 * odds[r], 100.0 * probability, 0)
            line += f"met with a probability of {likely} %, {asked} % was needed"
        else:
            line += f"{needed} was needed"
        lines.append(line)
    return tuple(lines)


def apart(value: float, other: float, decimals: int) -> tuple[str, str]:
    """Return two numbers with so many decimals, or as many more as tell them apart, 4 at most."""
    for n in range(decimals, 4):
        if f"{value:.{n}f}" != f"{other:.{n}f}":
            return f"{value:.{n}f}", f"{other:.{n}f}"
    return f"{value:.4f}", f"{other:.4f}"


def _decisive(
    problem: question.Problem, pieces: FloatArray, rows: FloatArray
) -> tuple[tuple[str, float], ...]:
    """Return whose absorption goes with the draws of some rows: largest squared correlations."""
    room = problem.room
    used = np.unique(problem.product[pieces > 0]).tolist()
    names = [*room.absorption.materials, *(problem.products[p].name for p in used)]
    drawn = np.concatenate([room.draws, problem.drawn[:, used]], axis=1)
    y = np.asarray(np.nanmean(rows, axis=1))
    at = problem.weights.sum(axis=0) > 0.0
    best: dict[str, float] = {}
    for i, name in enumerate(names):  # a product that is a material of the room is one of them
        x = np.asarray(np.log(np.maximum(drawn[:, i][:, at], 1e-4)).mean(axis=1))
        spread = float(np.std(x) * np.std(y))
        if spread > 1e-12:
            share = float(np.mean((x - x.mean()) * (y - y.mean())) / spread) ** 2
            best[name] = max(share, best.get(name, 0.0))
    return tuple(sorted(best.items(), key=lambda pair: -pair[1])[:3])


def _findings(
    problem: question.Problem,
    arrangements: Sequence[Arrangement],
    first: _Outcome,
    probability: float,
) -> tuple[Finding, ...]:
    found = []
    if first.missed:
        used = float((first.pieces * problem.piece_m2).sum())
        missed = first.missed
        likely = f" with a probability of {100.0 * probability:g} %" if probability > 0.5 else ""
        free = sum(problem.free_m2.values())
        sentence = (
            f"The targets cannot be met{likely} with these products on {free:.4g} m2: "
            f"{'; '.join(missed[:4])}. The arrangement shown misses least, with {used:.4g} m2."
        )
        found.append(Finding(Code.TARGET_NOT_MET, About(), sentence, {"missed": list(missed)}))
    partly: dict[str, str] = {}  # each surface once, as in the first arrangement that covers it
    for h in (h for a in arrangements for h in a.hung if 0.02 < h.share < 0.98):
        partly.setdefault(h.surface, f"{h.surface} ({100 * h.share:.0f} %)")
    if partly:
        sentence = (
            f"Covered in part, as {', '.join(partly.values())}: predicted with the mean of "
            "its absorption by area, wherever on it the pieces hang. Pieces near a source or a "
            "receiver may do more early on; divide the surface in the model to see it."
        )
        found.append(
            Finding(Code.SURFACE_COVERED_IN_PART, About(), sentence, {"surfaces": [*partly]})
        )
    return tuple(found)
