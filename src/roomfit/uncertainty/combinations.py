"""What the data of a band determine where single materials are not: means over groups of them.

Groups whose absorptions can be exchanged without being noticed, the shares of the materials in the
room's absorption, and all of it in one sentence a band.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple, TypeAlias

import numpy as np
from scipy.sparse.csgraph import connected_components

from roomfit.base.findings import About, Code, Finding
from roomfit.base.forks import in_forks
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.materials.priors import symmetric_root
from roomfit.uncertainty.gaussian import LARGEST_CHI2_REDUCED
from roomfit.uncertainty.posterior import band_draws, prior_draws

# A direction of which the data leave this share of the prior spread is not in the data.
OPEN_SHARE = 0.8
# Of a projector's entries: what a material must take part in a direction to be named with it.
_TAKES_PART = 0.1
_LOOSE_ENDS = 0.5
# A combination counts as determined where its 95 % interval reaches this far to either side ...
WITHIN = 0.1
# ... and where the data, not the prior, make it so.
_SHARE_OF_PRIOR = 0.5
# Places the ends of an interval within a third of a percent of probability.
N_DRAWS = 2048
_ALIKE = 0.1
# All differences of more materials would be too long a list.
_MOST_APART = 4

Group: TypeAlias = tuple[int, ...]
"""Indices of materials."""


class Undetermined(NamedTuple):
    """Materials whose absorptions can be exchanged for each other without effect on the data."""

    materials: Group  # in rising order
    # how many independent ways there are to change them unnoticed: as many as materials where
    # nothing is known of any, one less where only one mean of all of them is known
    directions: int
    against: bool  # whether more of one is compensated by less of another

    @property
    def all_undetermined(self) -> bool:
        """Whether the data determine nothing of any of these materials."""
        return self.directions >= len(self.materials)


class Difference(NamedTuple):
    """The absorption of one material less that of another."""

    # (n_materials,), 1, -1 and zeros: the first is the one that absorbs more at the answer
    weights: FloatArray
    value: float  # 0 or more, and its 95 % interval
    lower95: float
    upper95: float
    # whether the data at least halve its prior spread, and it is known within 10 %
    # of the larger of both
    determined: bool


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


class Determined(NamedTuple):
    """What the data of one band determine of groups of walls."""

    combinations: tuple[Combination, ...]  # the mean of the whole room first
    sentence: str
    shares: FloatArray  # (3, n_materials), of the room's absorption, with 95 % bounds


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
    (value,), drawn = (area_shares(areas_m2 * x) for x in (absorption[None], draws))
    low, high = np.quantile(drawn, (0.025, 0.975), axis=0)
    # a mode may lie outside of the quantiles of a skew law; a table that says so would be read as
    # a mistake
    return np.stack([value, np.minimum(low, value), np.maximum(high, value)])


def area_shares(parts: FloatArray) -> FloatArray:
    """Return absorption areas divided by their sum, each of shape (n_draws, n_materials)."""
    total = parts.sum(axis=1, keepdims=True)
    return np.asarray(np.divide(parts, total, out=np.zeros_like(parts), where=total > 0.0))


def information_directions(
    covariance: FloatArray, prior: FloatArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return how much each direction is known, the best known first.

    In units of the prior's spread the posterior covariance of logit absorption is taken apart into
    its own directions: those of the Fisher information of the data.

    Shapes: `covariance, prior` (n_materials, n_materials), left (n_own,), directions (n_own,
    n_own), own (n_own,): the materials that vary, of those tied to each other the first.
    """
    own = np.flatnonzero(np.diag(covariance) > 0.0)
    for rows in (covariance, prior):
        _, first = np.unique(rows[own], axis=0, return_index=True)
        own = own[np.sort(first)]
    root = symmetric_root(prior[np.ix_(own, own)])
    scaled = root @ covariance[np.ix_(own, own)] @ root.T
    size, directions = np.linalg.eigh(0.5 * (scaled + scaled.T))
    return np.sqrt(np.maximum(size, 0.0)), directions, own


def undetermined_groups(covariance: FloatArray, prior: FloatArray) -> tuple[Undetermined, ...]:
    """Return the groups of materials that the data leave open, each by itself.

    Directions that keep `OPEN_SHARE` of the prior's spread span what the data do not see. Where
    there are several their basis is arbitrary; what they span is not, so materials are put
    together that the projector onto it connects.

    Shapes: `covariance, prior` (n_materials, n_materials), of logit absorption.
    """
    left, directions, own = information_directions(covariance, prior)
    undetermined = directions[:, left >= OPEN_SHARE]
    projector = undetermined @ undetermined.T
    takes_part = np.flatnonzero(np.diag(projector) > _TAKES_PART)
    linked = np.abs(projector[np.ix_(takes_part, takes_part)]) > _TAKES_PART
    found = []
    n_parts, part_of = connected_components(linked) if linked.size else (0, takes_part)
    for number in range(n_parts):
        members = takes_part[part_of == number]
        part = projector[np.ix_(members, members)]
        count = int(np.floor(np.trace(part) + _LOOSE_ENDS))
        if count:
            against = bool(part.min() < -_TAKES_PART)
            found.append(Undetermined(tuple(own[members].tolist()), count, against))
    return tuple(found)


def find_combinations(
    areas_m2: FloatArray,
    absorption: FloatArray,
    covariance: FloatArray,
    prior_mean: FloatArray,
    prior: FloatArray,
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

    Shapes: `areas_m2, absorption` (n_materials,), `covariance` (n_materials, n_materials),
    `prior_mean` (n_materials,), `prior` (n_materials, n_materials), these three of logit
    absorption, `draws` (n_draws, n_materials).

    Intervals are quantiles of `roomfit.uncertainty.posterior.band_draws`, or of the draws given.
    """
    law = absorption, covariance, prior_mean, prior, N_DRAWS, rng
    drawn = band_draws(*law) if draws is None else draws
    before = prior_draws(*law)

    @functools.cache  # the same pairs of groups come up again while others are put together
    def combination_of(group: Group) -> Combination:
        weights = np.zeros(len(areas_m2))
        weights[list(group)] = areas_m2[list(group)] / areas_m2[list(group)].sum()
        mean, value = drawn @ weights, float(weights @ absorption)
        low, high = (float(q) for q in np.quantile(mean, (0.025, 0.975)))
        sd = float(np.std(mean))
        # a mode may lie outside of the quantiles of a skew law
        found = Combination(weights, value, min(low, value), max(high, value), sd)
        sharper = sd <= _SHARE_OF_PRIOR * float(np.std(before @ weights))
        return replace(found, determined=found.relative <= within and sharper)

    every: list[Group] = [(i,) for i in np.flatnonzero(areas_m2 > 0.0).tolist()]
    room = combination_of(tuple(g[0] for g in every))
    fixed = np.diag(covariance) <= 0.0
    loose = [g for g in every if not (fixed[g[0]] or combination_of(g).determined)]
    # a group that is nearly the whole room repeats it
    groups = (
        g for g in _joined(loose, combination_of) if np.abs(g.weights - room.weights).sum() > _ALIKE
    )
    kept = [room, *groups]
    open_pairs = _open_pairs(undetermined_groups(covariance, prior), absorption)
    for one, other in open_pairs:
        apart = drawn[:, one] - drawn[:, other]
        low, high = (float(q) for q in np.quantile(apart, (0.025, 0.975)))
        sharper = np.std(apart) <= _SHARE_OF_PRIOR * np.std(before[:, one] - before[:, other])
        weights = np.zeros(len(areas_m2))
        weights[[one, other]] = 1.0, -1.0
        known = bool(sharper and 0.5 * (high - low) <= within * absorption[one])
        value = float(absorption[one] - absorption[other])
        difference = Difference(weights, value, low, high, known)
        # to the smallest group that has both
        holding = [i for i, c in enumerate(kept) if np.all(c.weights[weights != 0.0] > 0.0)]
        if holding:
            at = min(holding, key=lambda i: int(np.count_nonzero(kept[i].weights)))
            kept[at] = replace(kept[at], differences=(*kept[at].differences, difference))
    return tuple(kept)


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


def _open_pairs(left_open: Sequence[Undetermined], absorption: FloatArray) -> list[tuple[int, int]]:
    """Return the pairs of materials that are left open together, the one that absorbs more first.

    Of many materials only the two which absorb most.
    """
    found: list[tuple[int, int]] = []
    for group in left_open:
        if group.against:
            members = sorted(group.materials, key=lambda i: -absorption[i])
            few = members if len(members) <= _MOST_APART else members[:2]
            found += combinations(few, 2)
    return found


def band_sentence(
    materials: tuple[str, ...],
    combinations: Sequence[Combination],
    left_open: Sequence[Undetermined],
) -> str:
    """Return which means of materials are known and which of their changes are not in the data.

    "±" stands before half of the 95 % interval.
    """

    def names(chosen: Sequence[int]) -> str:
        first = ", ".join(materials[i] for i in chosen[:-1])
        return f"{first} and {materials[chosen[-1]]}" if first else materials[chosen[-1]]

    def words(group: Undetermined, named: set[int]) -> str:
        """Return what is open among materials, of which the sentence may just have named all."""
        n, known = len(group.materials), len(group.materials) - group.directions
        if group.against and set(group.materials) == named and (n == 2 or known == 1):
            what = "their difference" if n == 2 else "how it is shared among them"
            return f"{what} is not in the data"
        if n == 2:
            what = "difference" if group.against else "sum"
            return f"the {what} of {names(group.materials)} is not in the data"
        means = "one mean is" if known == 1 else f"{known} means are"
        return f"of {names(group.materials)} only {means} in the data"

    def clauses(groups: Sequence[Undetermined], named: set[int]) -> list[str]:
        found = [words(u, named) for u in groups if not u.all_undetermined]
        alone = sorted(i for u in groups if u.all_undetermined for i in u.materials)
        if alone:
            found.append(f"{names(alone)} {'is' if len(alone) == 1 else 'are'} not in the data")
        return found

    parts, mentioned = list[str](), set[Undetermined]()
    for group in combinations[1:]:
        members = set(np.flatnonzero(group.weights > 0.0).tolist())
        own = [u for u in left_open if set(u.materials) <= members]
        mentioned |= set(own)
        half = 0.5 * (group.upper95 - group.lower95)
        digits = 3 if half < 0.01 else 2
        value = f"{group.value:.{digits}f} ± {half:.{digits}f}"
        parts += [f"{names(sorted(members))} together {value}", *clauses(own, members)]
    rest = [u for u in left_open if u not in mentioned]
    return "; ".join([*parts, *clauses(rest, set())])


def determined(
    materials: tuple[str, ...],
    absorption: FloatArray,
    logit_covariance: FloatArray,
    logit_prior: tuple[FloatArray, FloatArray],
    areas_m2: FloatArray,
    seed: int,
    specified: BoolArray | None = None,
    chi2_reduced: FloatArray | None = None,
) -> tuple[Determined, ...]:
    """Return what every band determines, where single materials may not be.

    Of a band that the model does not explain no mean is determined.

    Shapes: `absorption` (n_materials, n_bands), `logit_covariance` (n_bands, n_materials,
    n_materials), `logit_prior` (n_materials, n_bands), (n_bands, n_materials, n_materials),
    `areas_m2` (n_materials,), `specified` (n_materials,), `chi2_reduced` (n_bands,).
    """

    def of_band(band: int) -> Determined:
        a, covariance = absorption[:, band], logit_covariance[band]
        mean, prior = logit_prior[0][:, band], logit_prior[1][band]
        rng = np.random.default_rng(seed)
        drawn = band_draws(a, covariance, mean, prior, N_DRAWS, rng, specified=specified)
        rng = np.random.default_rng(seed)
        found = find_combinations(areas_m2, a, covariance, mean, prior, rng, draws=drawn)
        sentence = band_sentence(materials, found, undetermined_groups(covariance, prior))
        chi2 = 0.0 if chi2_reduced is None else float(chi2_reduced[band])
        if chi2 > LARGEST_CHI2_REDUCED:
            found = (replace(found[0], determined=False),)
            sentence = (
                f"the model does not explain the data (reduced chi-square {chi2:.1f}), not even "
                "the mean of the room is determined"
            )
        return Determined(found, sentence, absorption_shares(areas_m2, a, drawn))

    return tuple(in_forks(of_band, range(len(logit_covariance))))


def inseparable_findings(
    materials: tuple[str, ...],
    centres_hz: FloatArray,
    identifiable: BoolArray,
    found: Sequence[Sequence[Combination]],
) -> tuple[Finding, ...]:
    """Return a finding where no material is identifiable by itself but the room's mean is known.

    Shapes: `centres_hz` (n_bands,), `identifiable` (n_materials, n_bands).
    """
    means = np.array([c[0].relative for c in found])
    known = ~identifiable.any(axis=0) & (means <= WITHIN)
    known &= np.array([c[0].determined for c in found])
    if not known.any() or len(materials) < 2:
        return ()
    bands_hz = centres_hz[known].tolist()
    shares = zip(bands_hz, 100 * means[known], strict=True)
    listed = ", ".join(f"{f:g} Hz ({x:.0f} %)" for f, x in shares)
    return (
        Finding(
            Code.MATERIALS_NOT_SEPARABLE,
            About(bands_hz=bands_hz, materials=list(materials)),
            f"The data do not tell the {len(materials)} materials apart, only their mean "
            f"absorption by area, with its 95 % interval to either side, at {listed}. Which of "
            "them absorbs shows where one is changed and the room measured again, or where it is "
            "said what they are made of.",
            {"bands_hz": bands_hz, "materials": list(materials)},
        ),
    )
