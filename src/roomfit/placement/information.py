"""What single measurements would tell of the absorption, and what several tell together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.checks import float_array, int_array, read_only
from roomfit.errors import InputError
from roomfit.typing import FloatArray, IntArray

_Z95 = 1.959963984540054  # standard normal, 97.5 %
# Of a gain: next to nothing, so that a pair that nobody hears does not divide by zero.
_LEAST_GAIN_INFORMATION = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """The absorptions that are to be found, and what is known of them before the choice.

    Everything is told for several draws of the absorption, since what a measurement tells depends
    on the absorption that is not known yet.

    Attributes
    ----------
    materials : tuple of str
    number : int array, shape (n_materials,)
        Which of the n unknowns is each material's absorption; -1 where it is known. Materials that
        share an absorption share a number.
    logit : float array, shape (n_draws, n_bands, n)
        Each unknown as ``log(s / (1 - s))`` with its share s of the way from lower to upper bound.
    information : float array, shape (n_draws, n_bands, n, n)
        Held already, of these free numbers: positive definite.
    lower, upper : float arrays, shape (n,)
        Bounds of each absorption.
    """

    materials: tuple[str, ...]
    number: IntArray
    logit: FloatArray
    information: FloatArray
    lower: FloatArray
    upper: FloatArray

    def __post_init__(self) -> None:
        n = len(np.unique(np.asarray(self.number)[np.asarray(self.number) >= 0]))
        if n == 0:
            raise InputError(
                "no absorption is left to be found",
                found="every material's absorption is given",
                hint="remove absorption = [...] where it is not sure",
            )
        number = int_array("unknown", self.number, (len(self.materials),), low=-1, high=n - 1)
        logit = float_array("logit absorption", self.logit, (None, None, n))
        shape = (*logit.shape, n)
        information = float_array("information", self.information, shape)
        object.__setattr__(self, "number", number)
        object.__setattr__(self, "logit", logit)
        object.__setattr__(self, "information", information)
        for name in ("lower", "upper"):
            bound = float_array(name, getattr(self, name), (n,), low=0.0, high=1.0)
            object.__setattr__(self, name, bound)


@dataclass(frozen=True, slots=True, eq=False)
class PairInformation:
    """What a measurement of each pair of source and receiver would tell, by itself.

    Attributes
    ----------
    matrices : float array, shape (n_pairs, n_draws, n_bands, n + 1, n + 1)
        Fisher information about the n unknowns and, last, the log of the gain. Whatever else is
        unknown of a pair has been eliminated.
    gain : int array, shape (n_pairs,)
        Pairs of one number share one unknown gain in each band; -1 where the level is known.
    """

    matrices: FloatArray
    gain: IntArray

    def __post_init__(self) -> None:
        matrices = np.array(self.matrices, dtype=np.float64)
        if matrices.ndim != 5 or matrices.shape[-1] != matrices.shape[-2]:
            raise InputError(
                "the information of pairs has the wrong shape",
                found=f"{matrices.shape}",
                needed="(n_pairs, n_draws, n_bands, n + 1, n + 1)",
            )
        object.__setattr__(self, "matrices", read_only(matrices))
        gain = int_array("gain", self.gain, (len(matrices),), low=-1)
        object.__setattr__(self, "gain", gain)


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

    Pairs that share a gain tell more together than the sum of what each tells alone. More pairs
    never tell less.

    Parameters
    ----------
    unknowns : Unknowns
    pairs : PairInformation
    chosen : list of int
        Indices of the pairs that are measured.
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

    Parameters
    ----------
    information : float array, shape (..., n_draws, n_bands, n, n)
    """
    covariance = np.linalg.inv(information)
    reach = _Z95 * np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    ends = [1.0 / (1.0 + np.exp(-unknowns.logit - sign * reach)) for sign in (1.0, -1.0)]
    width = (unknowns.upper - unknowns.lower) * (ends[0] - ends[1])
    return np.asarray(width.mean(axis=-3))


def material_widths(unknowns: Unknowns, widths: FloatArray) -> FloatArray:
    """Return the widths of every material, known ones 0, shape (n_materials, n_bands).

    Parameters
    ----------
    widths : float array, shape (n_bands, n)
    """
    padded = np.concatenate((widths, np.zeros((len(widths), 1))), axis=1)
    return np.asarray(padded[:, unknowns.number].T)
