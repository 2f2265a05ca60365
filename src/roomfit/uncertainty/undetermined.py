"""What the data of a band leave open: groups of materials that can change without being noticed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.checks import float_array
from roomfit.typing import BoolArray, FloatArray, IntArray

# A direction of which the data leave this share of what was beforehand is not in the data.
OPEN_SHARE = 0.8
# Of a projector's entries: what a material must take part in a direction to be named with it.
_TAKES_PART = 0.1
_LOOSE_ENDS = 0.5


@dataclass(frozen=True, slots=True)
class Undetermined:
    """Materials whose absorptions can be exchanged for each other as far as the data can tell.

    Attributes
    ----------
    materials : tuple of int
        In rising order.
    directions : int
        How many independent ways there are to change them unnoticed: as many as materials where
        nothing is known of any, one less where only one mean of all of them is known.
    against : bool
        Whether more of one goes with less of another.
    """

    materials: tuple[int, ...]
    directions: int
    against: bool

    @property
    def nothing_known(self) -> bool:
        """Whether the data say nothing of any of these materials."""
        return self.directions >= len(self.materials)


@dataclass(frozen=True, slots=True, eq=False)
class Difference:
    """The absorption of one material less that of another.

    Attributes
    ----------
    weights : float array, shape (n_materials,)
        1, -1 and zeros: the first is the one that absorbs more at the answer.
    value, lower95, upper95 : float
        -1 to 1; the value is not below 0.
    determined : bool
        Whether the data at least halve what was unknown of it beforehand, and it is known within
        10 % of the larger of both.
    """

    weights: FloatArray
    value: float
    lower95: float
    upper95: float
    determined: bool


def information_directions(
    covariance_logit: FloatArray, prior_logit_sd: FloatArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return how much each direction is known, the best known first.

    In units of the prior's spread the posterior covariance of logit absorption is taken apart into
    its own directions: those of the Fisher information of the data.

    Parameters
    ----------
    covariance_logit : float array, shape (n_materials, n_materials)
        Zeros where an absorption is held, equal rows where two are tied.
    prior_logit_sd : float array, shape (n_materials,)

    Returns
    -------
    left : float array, shape (n_own,)
        Standard deviation along each direction over that of the prior: 0 known, 1 not in the data.
    directions : float array, shape (n_own, n_own)
        In columns, of unit length, in units of the prior's spread.
    own : int array, shape (n_own,)
        The materials that vary, of those tied to each other the first.
    """
    n = len(prior_logit_sd)
    covariance = float_array("covariance of logit absorption", covariance_logit, (n, n))
    sd = float_array("prior sd of logit absorption", prior_logit_sd, (n,), low=0.0)
    own = _own(covariance)
    scaled = covariance[np.ix_(own, own)] / np.outer(sd[own], sd[own])
    size, directions = np.linalg.eigh(0.5 * (scaled + scaled.T))
    return np.sqrt(np.maximum(size, 0.0)), directions, own


def undetermined_groups(
    covariance_logit: FloatArray, prior_logit_sd: FloatArray
) -> tuple[Undetermined, ...]:
    """Return the groups of materials that the data leave open, each by itself.

    Directions that keep `OPEN_SHARE` of the prior's spread span what the data do not see. Where
    there are several their basis is arbitrary; what they span is not, so materials are put
    together that the projector onto it connects.

    Parameters
    ----------
    covariance_logit : float array, shape (n_materials, n_materials)
    prior_logit_sd : float array, shape (n_materials,)
        See `information_directions`.
    """
    left, directions, own = information_directions(covariance_logit, prior_logit_sd)
    unseen = directions[:, left >= OPEN_SHARE]
    projector = unseen @ unseen.T
    found = []
    for members in _connected(np.abs(projector) > _TAKES_PART):
        part = projector[np.ix_(members, members)]
        count = int(np.floor(np.trace(part) + _LOOSE_ENDS))
        if count:
            against = bool(part.min() < -_TAKES_PART)
            found.append(Undetermined(tuple(int(i) for i in own[members]), count, against))
    return tuple(found)


def _own(covariance: FloatArray) -> IntArray:
    """Return the materials that vary, of those tied to each other the first."""
    free = np.flatnonzero(np.diag(covariance) > 0.0)
    _, first = np.unique(covariance[free], axis=0, return_index=True)
    return np.asarray(free[np.sort(first)])


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
