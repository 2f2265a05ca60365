"""Gaussian intervals of a fit, in the free numbers, carried over to physical values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.objective.parameters import (
    Block,
    Parameters,
    leaders,
    physical_values,
    position_of,
    to_physical,
)
from roomfit.typing import BoolArray, FloatArray

_Z95 = 1.959963984540054  # standard normal, 97.5 %
WIDEST_IDENTIFIABLE = 0.2
LARGEST_PHI = 2.0
# Data whose information is below this share of the prior's narrow its interval by less than 5 %.
_TOLD_SHARE = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class AbsorptionIntervals:
    """Absorption of every material in one band with its 95 % interval.

    Attributes
    ----------
    absorption, lower95, upper95 : float arrays, shape (n_materials,)
    identifiable : bool array, shape (n_materials,)
        phi at most 2, interval no wider than 0.2, and a standard deviation at most half the
        prior's. A material that was given and held fixed counts as identifiable with a width of 0.
    covariance : float array, shape (n_free, n_free)
        Of the free vector, misfit included.
    """

    absorption: FloatArray
    lower95: FloatArray
    upper95: FloatArray
    identifiable: BoolArray
    covariance: FloatArray


def absorption_intervals(
    parameters: Parameters, vector: FloatArray, information: FloatArray, phi: float
) -> AbsorptionIntervals:
    """Return symmetric intervals of logit absorption, mapped to absorption.

    The covariance is the inverse information times max(phi, 1): a misfit widens every interval.
    These are local, Gaussian intervals: they know nothing of a second minimum, and near absorption
    0 or 1 their true coverage is not 95 %. A material of which the data tell nothing, even if all
    others were known, has the interval 0 to 1.
    """
    covariance = np.linalg.inv(information) * max(phi, 1.0)
    block = next(b for b in parameters.blocks if b.name == "absorption")
    n = int(np.count_nonzero(block.fitted))
    first = position_of(parameters, "absorption")
    sd: FloatArray = np.zeros(len(block.labels))
    sd[block.fitted] = np.sqrt(np.diag(covariance)[first : first + n])
    free = _free_values(block, vector[first : first + n])
    values, _ = physical_values(parameters, vector)
    absorption = values["absorption"]
    lower, upper = (
        np.asarray(np.where(block.fitted, to_physical(block, free + z * sd)[0], absorption))
        for z in (-_Z95, _Z95)
    )
    untold = _told_nothing(block, np.diag(information)[first : first + n])
    lower, upper = np.where(untold, 0.0, lower), np.where(untold, 1.0, upper)
    sure = (
        (phi <= LARGEST_PHI) & (upper - lower <= WIDEST_IDENTIFIABLE) & (sd <= 0.5 * block.prior_sd)
    )
    leader = leaders(block)
    return AbsorptionIntervals(
        absorption,
        lower[leader],
        upper[leader],
        (sure | ~block.fitted)[leader],
        np.asarray(covariance, dtype=np.float64),
    )


def weighted_mean_interval(
    parameters: Parameters, vector: FloatArray, covariance: FloatArray, weights: FloatArray
) -> tuple[float, float, float]:
    """Return a weighted mean of the absorptions and its 95 % interval, clipped to 0 and 1.

    Parameters
    ----------
    weights : float array, shape (n_materials,)
        Sum 1; areas over the whole area give the mean absorption of the room.

    Returns
    -------
    mean, lower95, upper95 : float
    """
    values, slopes = physical_values(parameters, vector)
    mean = float(weights @ values["absorption"])
    block = next(b for b in parameters.blocks if b.name == "absorption")
    n = int(np.count_nonzero(block.fitted))
    first = position_of(parameters, "absorption")
    whole = np.bincount(leaders(block), weights * slopes["absorption"], len(block.labels))
    gradient = whole[block.fitted]
    part = covariance[first : first + n, first : first + n]
    sd = float(np.sqrt(gradient @ part @ gradient))
    return mean, max(mean - _Z95 * sd, 0.0), min(mean + _Z95 * sd, 1.0)


def _told_nothing(block: Block, information: FloatArray) -> BoolArray:
    """Whether nearly all information about an absorption, given the others, is the prior's."""
    told = np.full(len(block.labels), np.inf)
    prior = 1.0 / block.prior_sd[block.fitted] ** 2
    told[block.fitted] = information - prior - _TOLD_SHARE * prior
    return np.asarray(told <= 0.0)


def _free_values(block: Block, fitted: FloatArray) -> FloatArray:
    free = np.zeros(len(block.labels))
    free[block.fitted] = fitted
    return free
