"""What the data of a band determine where single materials are not: means over groups of them.

Groups whose absorptions can be exchanged without being noticed, the shares of the materials in the
room's absorption, and all of it in one sentence a band.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import TypeAlias

import numpy as np

from roomfit.base.arguments import float_array
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.forks import in_forks
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.materials.priors import symmetric_root
from roomfit.uncertainty.posterior import band_draws, prior_draws


def absorption_shares(
    areas_m2: FloatArray, absorption: FloatArray, draws: FloatArray
) -> FloatArray:
    """Return the share of each material in the sum of absorption areas, with its 95 % interval.

    ``A_i / sum A`` with ``A_i = alpha_i S_i``; the air is left out. Errors of two materials that
    the data determine only together are opposite, so that no interval can be had from those of
    the coefficients.

    Shape (3, n_materials). Shapes: `areas_m2` (n_materials,), `absorption` (n_materials,), `draws`
    (n_draws, n_materials).
    """
    n = len(areas_m2)
    areas = float_array("areas", areas_m2, (n,), low=0.0, unit="m2")
    a = float_array("absorption", absorption, (n,), low=0.0, high=1.0)
    shares = [area_shares(areas * x) for x in (a[None], np.asarray(draws))]
    low, high = np.quantile(shares[1], (0.025, 0.975), axis=0)
    value = shares[0][0]
    # a mode may lie outside of the quantiles of a skew law; a table that says so would be read as
    # a mistake
    return np.stack([value, np.minimum(low, value), np.maximum(high, value)])


def area_shares(parts: FloatArray) -> FloatArray:
    """Return absorption areas divided by their sum, each of shape (n_draws, n_materials)."""
    total = parts.sum(axis=1, keepdims=True)
    return np.asarray(np.divide(parts, total, out=np.zeros_like(parts), where=total > 0.0))


# A direction of which the data leave this share of the prior spread is not in the data.
OPEN_SHARE = 0.8
# Of a projector's entries: what a material must take part in a direction to be named with it.
_TAKES_PART = 0.1
_LOOSE_ENDS = 0.5


@dataclass(frozen=True, slots=True)
class Undetermined:
    """Materials whose absorptions can be exchanged for each other without effect on the data."""

    materials: tuple[int, ...]  # in rising order
    # how many independent ways there are to change them unnoticed: as many as materials where
    # nothing is known of any, one less where only one mean of all of them is known
    directions: int
    against: bool  # whether more of one is compensated by less of another

    @property
    def all_undetermined(self) -> bool:
        """Whether the data determine nothing of any of these materials."""
        return self.directions >= len(self.materials)


@dataclass(frozen=True, slots=True, eq=False)
class Difference:
    """The absorption of one material less that of another."""

    # (n_materials,), 1, -1 and zeros: the first is the one that absorbs more at the answer
    weights: FloatArray
    # value, lower95, upper95: -1 to 1; the value is not below 0
    value: float
    lower95: float
    upper95: float
    # whether the data at least halve its prior spread, and it is known within 10 %
    # of the larger of both
    determined: bool


def information_directions(
    covariance_logit: FloatArray, prior_logit_covariance: FloatArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return how much each direction is known, the best known first.

    In units of the prior's spread the posterior covariance of logit absorption is taken apart into
    its own directions: those of the Fisher information of the data.

    Shapes: `covariance_logit` (n_materials, n_materials), `prior_logit_covariance` (n_materials,
    n_materials), left (n_own,), directions (n_own, n_own), own (n_own,).
    """
    n = len(prior_logit_covariance)
    covariance = float_array("covariance of logit absorption", covariance_logit, (n, n))
    prior = float_array("prior covariance of logit absorption", prior_logit_covariance, (n, n))
    own = _own(covariance, prior)
    root = symmetric_root(prior[np.ix_(own, own)])
    scaled = root @ covariance[np.ix_(own, own)] @ root.T
    size, directions = np.linalg.eigh(0.5 * (scaled + scaled.T))
    return np.sqrt(np.maximum(size, 0.0)), directions, own


def undetermined_groups(
    covariance_logit: FloatArray, prior_logit_covariance: FloatArray
) -> tuple[Undetermined, ...]:
    """Return the groups of materials that the data leave open, each by itself.

    Directions that keep `OPEN_SHARE` of the prior's spread span what the data do not see. Where
    there are several their basis is arbitrary; what they span is not, so materials are put
    together that the projector onto it connects.

    Shapes: `covariance_logit, prior_logit_covariance` (n_materials, n_materials).
    """
    left, directions, own = information_directions(covariance_logit, prior_logit_covariance)
    undetermined = directions[:, left >= OPEN_SHARE]
    projector = undetermined @ undetermined.T
    found = []
    for members in _connected(np.abs(projector) > _TAKES_PART):
        part = projector[np.ix_(members, members)]
        count = int(np.floor(np.trace(part) + _LOOSE_ENDS))
        if count:
            against = bool(part.min() < -_TAKES_PART)
            found.append(Undetermined(tuple(int(i) for i in own[members]), count, against))
    return tuple(found)


def _own(covariance: FloatArray, prior: FloatArray) -> IntArray:
    """Return the materials that vary, of those tied to each other the first."""
    own = np.flatnonzero(np.diag(covariance) > 0.0)
    for rows in (covariance, prior):
        _, first = np.unique(rows[own], axis=0, return_index=True)
        own = own[np.sort(first)]
    return np.asarray(own)


def _connected(linked: BoolArray) -> list[list[int]]:
    """Return the connected parts of a symmetric relation, without what is not even its own."""
    todo = {int(i) for i in np.flatnonzero(np.diag(linked))}
    parts = []
    while todo:
        part, frontier = set(), {min(todo)}
        while frontier:
            part |= frontier
            near = np.flatnonzero(linked[sorted(frontier)].any(axis=0))
            frontier = {int(i) for i in near} & todo - part
        todo -= part
        parts.append(sorted(part))
    return parts


# A combination counts as determined where its 95 % interval reaches this far to either side ...
WITHIN = 0.1
# ... and where the data, not the prior, make it so.
_SHARE_OF_PRIOR = 0.5
# Places the ends of an interval within a third of a percent of probability.
N_DRAWS = 2048
_ALIKE = 0.1
# All differences of more materials would be too long a list.
_MOST_APART = 4


@dataclass(frozen=True, slots=True, eq=False)
class Combination:
    """A mean of absorptions, weighed by area."""

    # (n_materials,), 0 or more, sum 1: the area of each material of the group over that of the
    # group
    weights: FloatArray
    value: float  # at the answer
    # lower95, upper95: quantiles of the posterior, or the value where it lies outside of them
    lower95: float
    upper95: float
    sd: float  # standard deviation of the posterior
    # whether its interval is narrow and the data, not the prior, made it so
    determined: bool = True
    # between materials of this group, and of no smaller one, that the data leave open together
    differences: tuple[Difference, ...] = ()

    @property
    def relative(self) -> float:
        """Half the width of the interval over the value."""
        return 0.5 * (self.upper95 - self.lower95) / self.value if self.value > 0.0 else np.inf


def find_combinations(
    areas_m2: FloatArray,
    absorption: FloatArray,
    covariance_logit: FloatArray,
    prior_logit_mean: FloatArray,
    prior_logit_covariance: FloatArray,
    rng: np.random.Generator,
    *,
    within: float = WITHIN,
    draws: FloatArray | None = None,
) -> tuple[Combination, ...]:
    """Return the groups of materials whose mean absorption is known though their own is not.

    Always first: the mean over the whole room. Then materials that are not determined each by
    itself are put together, always the two groups whose common mean is then known best, until the
    mean of a group is determined: its 95 % interval within `within` of its value on either side,
    and its spread at most half of its prior. Groups that never get there are left
    out.

    Shapes: `areas_m2` (n_materials,), `absorption` (n_materials,), `covariance_logit` (n_materials,
    n_materials), `prior_logit_mean` (n_materials,), `prior_logit_covariance` (n_materials,
    n_materials), `draws` (n_draws, n_materials).

    Intervals are quantiles of `roomfit.uncertainty.posterior.band_draws`, or of the draws given.
    """
    n = len(areas_m2)
    areas = float_array("areas", areas_m2, (n,), low=0.0, unit="m2")
    a = float_array("absorption", absorption, (n,), low=0.0, high=1.0)
    covariance = float_array("covariance of logit absorption", covariance_logit, (n, n))
    prior_mean = float_array("prior mean of logit absorption", prior_logit_mean, (n,))
    before = float_array("prior covariance of logit absorption", prior_logit_covariance, (n, n))
    if not (within > 0.0 and areas.sum() > 0.0):
        raise InputError("combinations need areas and a width above zero", found=f"{within:g}")
    fixed = np.diag(covariance) <= 0.0
    posterior = (a, covariance, prior_mean, before, N_DRAWS, rng)
    drawn = band_draws(*posterior) if draws is None else draws
    drawn_before = prior_draws(*posterior)
    # the same pairs of groups come up again while others are put together
    combination_of = functools.cache(
        partial(_combination, areas=areas, a=a, laws=(drawn, drawn_before), within=within)
    )
    loose: list[Group] = [(i,) for i in range(n) if areas[i] > 0.0]
    room = combination_of(tuple(g[0] for g in loose))
    loose = [g for g in loose if not (fixed[g[0]] or combination_of(g).determined)]
    groups = _joined(loose, combination_of)
    # a group that is nearly the whole room repeats it
    kept = (room, *(g for g in groups if np.abs(g.weights - room.weights).sum() > _ALIKE))
    left_open = undetermined_groups(covariance, before)
    return _with_differences(kept, _differences(left_open, a, drawn, drawn_before, within))


Group: TypeAlias = tuple[int, ...]
"""Indices of materials."""


def _combination(
    group: Group,
    areas: FloatArray,
    a: FloatArray,
    laws: tuple[FloatArray, FloatArray],
    within: float,
) -> Combination:
    """Return the mean absorption of a group, of draws of the posterior and of the prior."""
    drawn, drawn_before = laws
    weights = np.zeros(len(areas))
    weights[list(group)] = areas[list(group)] / areas[list(group)].sum()
    mean = drawn @ weights
    low, high = np.quantile(mean, (0.025, 0.975))
    sd = float(np.std(mean))
    value = float(weights @ a)
    # a mode may lie outside of the quantiles of a skew law
    found = Combination(weights, value, min(float(low), value), max(float(high), value), sd)
    sharper = sd <= _SHARE_OF_PRIOR * float(np.std(drawn_before @ weights))
    return replace(found, determined=found.relative <= within and sharper)


def _joined(
    loose: list[Group], combination_of: Callable[[Group], Combination]
) -> list[Combination]:
    """Return determined groups, by always joining the two whose common mean is known best."""
    groups = []
    while len(loose) > 1:
        one, other = min(
            combinations(loose, 2),
            key=lambda pair: combination_of((*pair[0], *pair[1])).relative,
        )
        loose = [g for g in loose if g not in (one, other)]
        found = combination_of((*one, *other))
        if found.determined:
            groups.append(found)
        else:
            loose.append((*one, *other))
    return groups


def _differences(
    left_open: Sequence[Undetermined],
    a: FloatArray,
    draws: FloatArray,
    prior_draws_of_group: FloatArray,
    within: float,
) -> list[Difference]:
    """Return the differences of materials that are left open together, the larger less the other.

    Of many materials only that of the two which absorb most.
    """
    found = []
    for group in left_open:
        members = sorted(group.materials, key=lambda i: -a[i])
        pairs = combinations(members, 2)
        if len(members) > _MOST_APART:
            pairs = combinations(members[:2], 2)
        for one, other in pairs if group.against else ():
            apart = draws[:, one] - draws[:, other]
            low, high = np.quantile(apart, (0.025, 0.975))
            before = float(np.std(prior_draws_of_group[:, one] - prior_draws_of_group[:, other]))
            weights = np.zeros(a.size)
            weights[[one, other]] = 1.0, -1.0
            sharper = float(np.std(apart)) <= _SHARE_OF_PRIOR * before
            known = bool(sharper and 0.5 * (high - low) <= within * a[one])
            value = float(a[one] - a[other])
            found.append(Difference(weights, value, float(low), float(high), known))
    return found


def _with_differences(
    kept: tuple[Combination, ...], differences: list[Difference]
) -> tuple[Combination, ...]:
    """Assign each difference to the smallest group that has both of its materials."""
    out = list(kept)
    for difference in differences:
        holding = [
            i for i, c in enumerate(out) if np.all(c.weights[difference.weights != 0.0] > 0.0)
        ]
        if holding:
            smallest = min(holding, key=lambda i: int(np.count_nonzero(out[i].weights)))
            own = out[smallest]
            out[smallest] = replace(own, differences=(*own.differences, difference))
    return tuple(out)


def band_sentence(
    materials: tuple[str, ...],
    combinations: Sequence[Combination],
    left_open: Sequence[Undetermined],
) -> str:
    """Return which means of materials are known and which of their changes are not in the data.

    "+-" stands before half of the 95 % interval.
    """
    parts, mentioned = [], set()
    for group in combinations[1:]:
        members = {int(i) for i in np.flatnonzero(group.weights > 0.0)}
        own = [u for u in left_open if set(u.materials) <= members]
        mentioned |= set(own)
        words = f"{_names(materials, sorted(members))} together {_value(group)}"
        words_open = [_open_in(materials, u, members) for u in own if not u.all_undetermined]
        alone = sorted(i for u in own if u.all_undetermined for i in u.materials)
        words_alone = [_not_in_the_data(materials, alone)] if alone else []
        parts.append("; ".join([words, *words_open, *words_alone]))
    rest = [u for u in left_open if u not in mentioned]
    parts += [_open_words(materials, u) for u in rest if not u.all_undetermined]
    unknown = sorted(i for u in rest if u.all_undetermined for i in u.materials)
    if unknown:
        parts.append(_not_in_the_data(materials, unknown))
    return "; ".join(parts)


def _open_in(materials: tuple[str, ...], left_open: Undetermined, members: set[int]) -> str:
    """Say what is open among materials that the sentence has just named."""
    if set(left_open.materials) != members or left_open.all_undetermined or not left_open.against:
        return _open_words(materials, left_open)
    if len(members) == 2:
        return "their difference is not in the data"
    if left_open.directions == len(members) - 1:
        return "how it is shared among them is not in the data"
    return _open_words(materials, left_open)


def _open_words(materials: tuple[str, ...], left_open: Undetermined) -> str:
    names, n = _names(materials, left_open.materials), len(left_open.materials)
    if left_open.all_undetermined:
        return _not_in_the_data(materials, left_open.materials)
    if n == 2:
        what = "difference" if left_open.against else "sum"
        return f"the {what} of {names} is not in the data"
    known = n - left_open.directions
    means = "one mean" if known == 1 else f"{known} means"
    return f"of {names} only {means} {'is' if known == 1 else 'are'} in the data"


def _not_in_the_data(materials: tuple[str, ...], chosen: Sequence[int]) -> str:
    names = _names(materials, chosen)
    return f"{names} {'is' if len(chosen) == 1 else 'are'} not in the data"


def _value(group: Combination) -> str:
    half = 0.5 * (group.upper95 - group.lower95)
    digits = 3 if half < 0.01 else 2
    return f"{group.value:.{digits}f} +- {half:.{digits}f}"


def _names(materials: tuple[str, ...], chosen: Sequence[int]) -> str:
    names = [materials[i] for i in chosen]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def determined(
    materials: tuple[str, ...],
    absorption: FloatArray,
    logit_covariance: FloatArray,
    logit_prior: tuple[FloatArray, FloatArray],
    areas_m2: FloatArray,
    seed: int,
    specified: BoolArray | None = None,
) -> tuple[tuple[tuple[Combination, ...], ...], tuple[str, ...], FloatArray]:
    """Return what every band determines, where single materials may not be.

    Shapes: `absorption` (n_materials, n_bands), `logit_covariance` (n_bands, n_materials,
    n_materials), `logit_prior` (n_materials, n_bands), (n_bands, n_materials, n_materials),
    `areas_m2` (n_materials,), `specified` (n_materials,), shares (3, n_materials, n_bands).
    """

    def of_band(band: int) -> tuple[tuple[Combination, ...], str, FloatArray]:
        covariance = logit_covariance[band]
        a, prior = absorption[:, band], (logit_prior[0][:, band], logit_prior[1][band])
        rng = np.random.default_rng(seed)
        drawn = band_draws(a, covariance, prior[0], prior[1], N_DRAWS, rng, specified=specified)
        rng = np.random.default_rng(seed)
        found = find_combinations(areas_m2, a, covariance, prior[0], prior[1], rng, draws=drawn)
        sentence = band_sentence(materials, found, undetermined_groups(covariance, prior[1]))
        return found, sentence, absorption_shares(areas_m2, a, drawn)

    bands = in_forks(of_band, range(len(logit_covariance)))
    combinations, sentences, shares = zip(*bands, strict=True)
    return combinations, sentences, np.stack(shares, axis=-1)


def inseparable_findings(
    materials: tuple[str, ...],
    centres_hz: FloatArray,
    identifiable: BoolArray,
    found: Sequence[tuple[Combination, ...]],
) -> tuple[Finding, ...]:
    """Return a finding where no material is identifiable by itself but the room's mean is known.

    Shapes: `centres_hz` (n_bands,), `identifiable` (n_materials, n_bands).
    """
    bands = [
        band
        for band, group in enumerate(found)
        if not identifiable[:, band].any() and group[0].relative <= WITHIN
    ]
    if not bands or len(materials) < 2:
        return ()
    listed = ", ".join(f"{centres_hz[b]:g} Hz ({100 * found[b][0].relative:.0f} %)" for b in bands)
    return (
        Finding(
            Code.MATERIALS_NOT_SEPARABLE,
            About(bands_hz=[float(centres_hz[b]) for b in bands], materials=list(materials)),
            f"The data do not tell the {len(materials)} materials apart, only their mean "
            f"absorption by area, with its 95 % interval to either side, at {listed}.",
            {"bands_hz": [float(centres_hz[b]) for b in bands], "materials": list(materials)},
        ),
    )
