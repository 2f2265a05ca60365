"""Fisher information of measurements that have not been made, by the noise model of the fit.

A pair's windows and noise are those that the fit would have. Information matrices of one band stand
for absorptions and gain first, then for the geometry: what sets arrival times, in multiples of its
prior standard deviations, so that its prior is the unit matrix. All bands of a pair share the
geometry, which is integrated out; pairs that share a gain inform together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.base.logit import Z95, expit
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.design.expected import ExpectedFit, as_coherent
from roomfit.design.prior import PriorInformation, Unknowns
from roomfit.model.problem import Objective

# Information about an absorption that keeps an inverse finite where a band is not affected by it.
_LEAST = 1e-6


def about_geometry(information: FloatArray, first: int) -> FloatArray:
    """Return a band's information on the geometry, its own absorptions and gain unknown."""
    own = information[:first, :first] + _LEAST * np.eye(first)
    cross = information[:first, first:]
    return np.asarray(information[first:, first:] - cross.T @ np.linalg.solve(own, cross))


def by_all_pairs(information: FloatArray, shared: BoolArray, n_others: int) -> FloatArray:
    """Return a pair's information on the geometry, with n others' on the part that all share."""
    own = ~shared
    cross = information[np.ix_(shared, own)]
    position_information = information[np.ix_(own, own)] + np.eye(int(own.sum()))
    out = information.copy()
    out[np.ix_(shared, shared)] += n_others * (
        information[np.ix_(shared, shared)] - cross @ np.linalg.solve(position_information, cross.T)
    )
    return np.asarray(out)


def without_geometry(
    found: list[FloatArray], first: int, shared: BoolArray, n_others: int
) -> FloatArray:
    """Integrate the geometry out of every band's information, under that of all bands on it.

    Parameters
    ----------
    found : list of float arrays, shape (first + n_geometry, first + n_geometry)
    shared : bool array, shape (n_geometry,)
        What all pairs have in common.
    n_others : int
        Other pairs that inform as much on the shared part.
    """
    geometry_information = [about_geometry(information, first) for information in found]
    n = geometry_information[0].shape[0]
    whole = by_all_pairs(sum(geometry_information, np.zeros((n, n))), shared, n_others)
    out = []
    for information, own in zip(found, geometry_information, strict=True):
        known = np.eye(n) + whole - own + information[first:, first:]
        cross = information[:first, first:]
        taken = cross @ np.linalg.solve(known, cross.T)
        out.append(information[:first, :first] - 0.5 * (taken + taken.T))
    return np.stack(out)


def information_of_pair(
    objectives: list[Objective], fit: ExpectedFit, known: PriorInformation, n_others: int
) -> FloatArray:
    """Return the information of one pair, shape (n_draws, n_bands, n + 1, n + 1).

    About the n unknown absorptions (as free numbers) and the log of the pair's gain. Arrival times
    are integrated out of each band under the information that all other bands, and the other pairs,
    have on them.

    Parameters
    ----------
    objectives : list of Objective
        Of this pair, one a band.
    known : PriorInformation
        Its draws are asked at.
    n_others : int
        Pairs that will have been measured in the end beside this one.
    """
    times = None
    if fit.coherent:
        times = _information_on_times(objectives, fit.shared, known.typical, n_others)
        objectives = [as_coherent(objective, times) for objective in objectives]
    out = []
    for draw in known.draws:
        found = [o.information(draw[:, band]) for band, o in enumerate(objectives)]
        if times is None:
            out.append(np.stack(found))
            continue
        first = found[0].shape[0] - len(times)
        out.append(without_geometry(found, first, fit.shared, n_others))
    return np.stack(out)


def _information_on_times(
    objectives: list[Objective], shared: BoolArray, absorption: FloatArray, n_others: int
) -> FloatArray | None:
    """Return how uncertain arrival times are in the end: the covariance of their free numbers.

    Bands go from low to high, as in a fit: each is as coherent as the lower ones leave arrival
    times known. On the speed of sound and the walls' delays the other pairs inform as much as
    this one.
    """
    covariance: FloatArray | None = None
    for band, objective in enumerate(objectives):
        information = as_coherent(objective, covariance).information(absorption[:, band])
        first = len(information) - len(shared)
        from_pairs = by_all_pairs(about_geometry(information, first), shared, n_others)
        known = np.eye(len(from_pairs)) if covariance is None else np.linalg.inv(covariance)
        inverse = np.linalg.inv(known + from_pairs)
        covariance = np.asarray(0.5 * (inverse + inverse.T))
    return covariance


# Of a gain: next to nothing, so that a pair without energy does not divide by zero.
_LEAST_GAIN_INFORMATION = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class PairInformation:
    """Fisher information of a measurement of each pair of source and receiver, by itself."""

    # (n_pairs, n_draws, n_bands, n + 1, n + 1): of the n unknowns and, last, the log of the gain.
    # Whatever else is unknown of a pair has been eliminated.
    matrices: FloatArray
    # (n_pairs,): pairs of one number share one unknown gain in each band; -1: the level is known
    gain: IntArray


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

    Pairs that share a gain have more information together than the sum of each alone. More pairs
    never have less.

    `chosen`: indices of the pairs that are measured.
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

    The mean over the draws. An interval is symmetric in logit, as a fit's is.

    `information` has the shape (..., n_draws, n_bands, n, n).
    """
    covariance = np.linalg.inv(information)
    reach = Z95 * np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    ends = [expit(unknowns.logit + sign * reach) for sign in (1.0, -1.0)]
    width = (unknowns.upper - unknowns.lower) * (ends[0] - ends[1])
    return np.asarray(width.mean(axis=-3))


def material_widths(unknowns: Unknowns, widths: FloatArray) -> FloatArray:
    """Return the widths of every material, known ones 0, shape (n_materials, n_bands).

    `widths` has the shape (n_bands, n).
    """
    padded = np.concatenate((widths, np.zeros((len(widths), 1))), axis=1)
    return np.asarray(padded[:, unknowns.number].T)
