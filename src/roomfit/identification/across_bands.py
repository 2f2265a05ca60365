"""What bands say of each other where the same unknowns change smoothly from band to band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roomfit.identification.reweighted import BandFit
from roomfit.typing import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """What the data of one band alone say of some unknowns: a Gaussian likelihood.

    Attributes
    ----------
    information : float array, shape (n, n)
        Symmetric; of no size in directions of which the data say nothing.
    weighed : float array, shape (n,)
        Information times the most likely value.
    """

    information: FloatArray
    weighed: FloatArray


def told_by(fit: BandFit, first: int) -> Told:
    """Return what one band's data say of the last entries of its vector, all others unknown.

    Those entries have a unit normal prior, which is taken out; what the data say is divided by
    max(phi, 1), since data that the model misses tell less.

    Parameters
    ----------
    first : int
        Where the entries begin; they reach to the end of the vector.
    """
    whole = fit.information
    cross = whole[first:, :first]
    schur = whole[first:, first:] - cross @ np.linalg.solve(whole[:first, :first], cross.T)
    data = schur - np.eye(len(schur))
    misfit = max(fit.phi, 1.0)
    return Told(0.5 * (data + data.T) / misfit, schur @ fit.vector[first:] / misfit)


def others_say(
    told: Sequence[Told | None], octaves: FloatArray, correlation: float, n: int
) -> list[tuple[FloatArray, FloatArray]]:
    """Return mean and covariance of each band's unknowns from all other bands and the prior.

    Beforehand each unknown has a unit normal law in every band; between bands d octaves apart its
    values correlate by ``correlation ** d``.

    Parameters
    ----------
    told : sequence of Told or None, one a band
        None where a band has no data.
    octaves : float array, shape (n_bands,)
        Log2 of the bands' centres, in any unit.
    correlation : float
        From 0 to below 1.
    n : int
        Number of unknowns of a band.

    Returns
    -------
    list of (mean, covariance), one a band
        Shapes (n,) and (n, n).
    """
    apart = np.abs(octaves[:, None] - octaves[None, :])
    prior = np.linalg.inv(np.kron(correlation**apart, np.eye(n)))
    out = []
    for band in range(len(told)):
        information, weighed = prior.copy(), np.zeros(len(prior))
        for other, one in enumerate(told):
            if other != band and one is not None:
                own = slice(n * other, n * (other + 1))
                information[own, own] += one.information
                weighed[own] += one.weighed
        covariance = np.linalg.inv(information)
        own = slice(n * band, n * (band + 1))
        out.append((np.asarray((covariance @ weighed)[own]), np.asarray(covariance[own, own])))
    return out
