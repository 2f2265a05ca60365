"""What is sure where single materials are not: means over groups of them."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from roomfit.checks import float_array
from roomfit.errors import InputError
from roomfit.typing import FloatArray
from roomfit.uncertainty.draws import band_draws, prior_draws
from roomfit.uncertainty.undetermined import Difference, Undetermined, undetermined_groups

# A combination counts as determined where its 95 % interval reaches this far to either side ...
WITHIN = 0.1
# ... and where the data, not the prior, say so.
_SHARE_OF_PRIOR = 0.5
# Places the ends of an interval within a third of a percent of probability.
N_DRAWS = 2048
_ALIKE = 0.1
# All differences of more materials would be a list that nobody reads.
_MOST_APART = 4


@dataclass(frozen=True, slots=True, eq=False)
class Combination:
    """A mean of absorptions, weighed by area.

    Attributes
    ----------
    weights : float array, shape (n_materials,)
        0 or more, sum 1: the area of each material of the group over that of the group.
    value : float
        At the answer.
    lower95, upper95 : float
        Quantiles of the posterior, or the value where it lies outside of them.
    sd : float
        Standard deviation of the posterior.
    determined : bool
        Whether its interval is narrow and the data, not the prior, made it so.
    differences : tuple of Difference
        Between materials of this group, and of no smaller one, that the data leave open together.
    """

    weights: FloatArray
    value: float
    lower95: float
    upper95: float
    sd: float
    determined: bool = True
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
    prior_logit_sd: FloatArray,
    rng: np.random.Generator,
    *,
    within: float = WITHIN,
    draws: FloatArray | None = None,
) -> tuple[Combination, ...]:
    """Return the groups of materials whose mean absorption is known though their own is not.

    Always first: the mean over the whole room. Then materials that are not determined each by
    itself are put together, always the two groups whose common mean is then known best, until the
    mean of a group is determined: its 95 % interval within `within` of its value on either side,
    and its spread at most half of what it was beforehand. Groups that never get there are left
    out.

    Parameters
    ----------
    areas_m2 : float array, shape (n_materials,)
    absorption : float array, shape (n_materials,)
        The answer of one band.
    covariance_logit : float array, shape (n_materials, n_materials)
        Posterior covariance of logit absorption, positive semi-definite: zeros where it is held,
        equal rows where two materials are tied.
    prior_logit_mean, prior_logit_sd : float arrays, shape (n_materials,)
        Of logit absorption beforehand.
    rng : numpy.random.Generator
    within : float
        Above 0.
    draws : float array, shape (n_draws, n_materials), optional
        Of the posterior, where it was sampled.

    Raises
    ------
    InputError
        Shapes do not belong together, or a value out of range.

    Notes
    -----
    Intervals are quantiles of `roomfit.uncertainty.draws.band_draws`, or of the draws given.
    """
    n = len(areas_m2)
    areas = float_array("areas", areas_m2, (n,), low=0.0, unit="m2")
    a = float_array("absorption", absorption, (n,), low=0.0, high=1.0)
    covariance = float_array("covariance of logit absorption", covariance_logit, (n, n))
    prior_mean = float_array("prior mean of logit absorption", prior_logit_mean, (n,))
    prior_sd = float_array("prior sd of logit absorption", prior_logit_sd, (n,), low=0.0)
    if not (within > 0.0 and areas.sum() > 0.0):
        raise InputError("combinations need areas and a width above zero", found=f"{within:g}")
    held = np.diag(covariance) <= 0.0
    posterior = (a, covariance, prior_mean, prior_sd, N_DRAWS, rng)
    drawn = band_draws(*posterior) if draws is None else draws
    beforehand = prior_draws(*posterior)

    # the same pairs of groups come up again while others are put together
    @functools.cache
    def told(group: tuple[int, ...]) -> tuple[Combination, bool]:
        weights = np.zeros(n)
        weights[list(group)] = areas[list(group)] / areas[list(group)].sum()
        mean = drawn @ weights
        low, high = np.quantile(mean, (0.025, 0.975))
        sd = float(np.std(mean))
        value = float(weights @ a)
        # a mode may lie outside of the quantiles of a skew law
        found = Combination(weights, value, min(float(low), value), max(float(high), value), sd)
        sharper = sd <= _SHARE_OF_PRIOR * float(np.std(beforehand @ weights))
        known = found.relative <= within and sharper
        return replace(found, determined=known), known

    loose: list[tuple[int, ...]] = [(i,) for i in range(n) if areas[i] > 0.0]
    room = told(tuple(g[0] for g in loose))[0]
    loose = [g for g in loose if not (held[g[0]] or told(g)[1])]
    groups: list[Combination] = []
    while len(loose) > 1:
        one, other = min(
            combinations(loose, 2), key=lambda pair: told((*pair[0], *pair[1]))[0].relative
        )
        loose = [g for g in loose if g not in (one, other)]
        found, determined = told((*one, *other))
        if determined:
            groups.append(found)
        else:
            loose.append((*one, *other))
    # a group that is nearly the whole room says the same a second time
    kept = (room, *(g for g in groups if np.abs(g.weights - room.weights).sum() > _ALIKE))
    left_open = undetermined_groups(covariance, prior_sd)
    return _with_differences(kept, _differences(left_open, a, drawn, beforehand, within))


def _differences(
    left_open: Sequence[Undetermined],
    a: FloatArray,
    draws: FloatArray,
    beforehand: FloatArray,
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
            before = float(np.std(beforehand[:, one] - beforehand[:, other]))
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
    """Put each difference to the smallest group that holds both of its materials."""
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
