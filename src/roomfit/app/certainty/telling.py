"""What the data of a band determine and what they leave open, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roomfit.uncertainty.combinations import Combination
from roomfit.uncertainty.undetermined import Undetermined


def band_sentence(
    materials: tuple[str, ...],
    combinations: Sequence[Combination],
    left_open: Sequence[Undetermined],
) -> str:
    """Return which means of materials are known and which of their changes are not in the data.

    "+-" stands before half of the 95 % interval.

    Parameters
    ----------
    materials : tuple of str
    combinations : sequence of Combination
        Of one band, the mean of the whole room first.
    left_open : sequence of Undetermined
        Of the same band.

    Returns
    -------
    str
        Empty where every material is determined by itself.
    """
    parts, told = [], set()
    for group in combinations[1:]:
        members = {int(i) for i in np.flatnonzero(group.weights > 0.0)}
        own = [u for u in left_open if set(u.materials) <= members]
        told |= set(own)
        words = f"{_names(materials, sorted(members))} together {_value(group)}"
        words_open = [_open_in(materials, u, members) for u in own if not u.nothing_known]
        alone = sorted(i for u in own if u.nothing_known for i in u.materials)
        words_alone = [_not_in_the_data(materials, alone)] if alone else []
        parts.append("; ".join([words, *words_open, *words_alone]))
    rest = [u for u in left_open if u not in told]
    parts += [_open_words(materials, u) for u in rest if not u.nothing_known]
    unknown = sorted(i for u in rest if u.nothing_known for i in u.materials)
    if unknown:
        parts.append(_not_in_the_data(materials, unknown))
    return "; ".join(parts)


def _open_in(materials: tuple[str, ...], left_open: Undetermined, members: set[int]) -> str:
    """Say what is open among materials that the sentence has just named."""
    if set(left_open.materials) != members or left_open.nothing_known or not left_open.against:
        return _open_words(materials, left_open)
    if len(members) == 2:
        return "their difference is not in the data"
    if left_open.directions == len(members) - 1:
        return "how it is shared among them is not in the data"
    return _open_words(materials, left_open)


def _open_words(materials: tuple[str, ...], left_open: Undetermined) -> str:
    names, n = _names(materials, left_open.materials), len(left_open.materials)
    if left_open.nothing_known:
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
