"""Unknowns as named blocks, each with its transform, its prior, and its part of a Jacobian.

An optimiser sees one vector of free numbers; a problem sees physical values. The transforms keep
absorption between its bounds and gains above zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from roomfit.base.arguments import float_array, read_only
from roomfit.base.logit import logit
from roomfit.base.typing import BoolArray, FloatArray, IntArray

Transform = Literal["identity", "log", "logit"]


GEOMETRY = "geometry"


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """One kind of unknown."""

    name: str  # "absorption", "gain", ..
    labels: tuple[str, ...]  # what each entry belongs to: a material, a source, ..
    # {"identity", "log", "logit"}, from physical value to free number. "logit" maps the open
    # interval (lower, upper).
    transform: Transform
    # (n,), physical values where a fit starts, or are fixed where `fitted` is false
    start: FloatArray
    fitted: BoolArray  # (n,)
    # prior_mean, prior_sd: (n,), Gaussian prior of the free number; an infinite sd is written as 0
    # in `prior_weight`
    prior_mean: FloatArray
    prior_sd: FloatArray
    # lower, upper: (n,), physical bounds, used by "logit"
    lower: FloatArray
    upper: FloatArray
    # (n,), entry whose value each entry takes, its own or another's; an entry that follows another
    # is not fitted itself. None where nothing is tied.
    leader: IntArray | None = None
    # (n, n), prior correlation of the free numbers, of finite sd; None where they are independent
    correlation: FloatArray | None = None

    def __post_init__(self) -> None:
        n = len(self.labels)
        for name in ("start", "prior_mean", "lower", "upper"):
            values = float_array(f"{self.name} {name}", getattr(self, name), (n,))
            object.__setattr__(self, name, values)
        for name in ("prior_sd", "fitted", "leader", "correlation"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, read_only(np.array(getattr(self, name))))


def unit_block(name: str, labels: tuple[str, ...], fitted: BoolArray) -> Block:
    """Return free numbers that are 0 at the start and of a unit normal law before any data."""
    n = len(labels)
    zeros, wide = np.zeros(n), np.full(n, 1e6)
    return Block(name, labels, "identity", zeros, fitted, zeros, np.ones(n), -wide, wide)


@dataclass(frozen=True, slots=True, eq=False)
class Marginal:
    """A Gaussian law of some entries, all others integrated out."""

    mean: FloatArray  # (n,), of free numbers
    information: FloatArray  # (n, n), inverse of their covariance: symmetric, positive definite


@dataclass(frozen=True, slots=True, eq=False)
class Parameters:
    """Blocks laid end to end; the free vector has the fitted entries only, in this order."""

    blocks: tuple[Block, ...]
    # of the last fitted entries, correlated, in place of their own priors
    joint: Marginal | None = None


def absorption_of(parameters: Parameters) -> Block:
    """Return the block of the absorptions, which every problem has."""
    return next(b for b in parameters.blocks if b.name == "absorption")


def leaders(block: Block) -> IntArray:
    """Return the entry whose value each entry takes, shape (n,)."""
    return np.arange(len(block.labels)) if block.leader is None else block.leader


def to_free(block: Block, values: FloatArray) -> FloatArray:
    """Return the free numbers of physical values, shape (n,)."""
    if block.transform == "log":
        return np.asarray(np.log(values))
    if block.transform == "logit":
        share = (values - block.lower) / (block.upper - block.lower)
        return logit(share, 1e-9)
    return np.array(values, dtype=np.float64)


def to_physical(block: Block, free: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return physical values and their derivative by the free numbers, both of shape (n,)."""
    if block.transform == "log":
        values = np.exp(free)
        return values, values
    if block.transform == "logit":
        # exp of a negative number only: no overflow on either side
        tail = np.exp(-np.abs(free))
        share = np.where(free >= 0.0, 1.0, tail) / (1.0 + tail)
        width = block.upper - block.lower
        return block.lower + width * share, width * tail / (1.0 + tail) ** 2
    return np.array(free, dtype=np.float64), np.ones_like(free)


def position_of(parameters: Parameters, name: str) -> int:
    """Return where the fitted entries of a block begin in the free vector."""
    position = 0
    for block in parameters.blocks:
        if block.name == name:
            break
        position += int(np.count_nonzero(block.fitted))
    return position


def start_vector(parameters: Parameters) -> FloatArray:
    """Return the free vector at which a fit starts, shape (n_free,)."""
    return np.concatenate([to_free(b, b.start)[b.fitted] for b in parameters.blocks])


def physical_values(
    parameters: Parameters, vector: FloatArray
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Return every block's physical values, fixed ones included, and their derivatives.

    The derivative of a fixed entry is 0, so a chain rule may run over all entries.
    """
    values: dict[str, FloatArray] = {}
    slopes: dict[str, FloatArray] = {}
    position = 0
    for block in parameters.blocks:
        n = int(np.count_nonzero(block.fitted))
        free = np.zeros(block.fitted.size)
        free[block.fitted] = vector[position : position + n]
        position += n
        found, slope = to_physical(block, free)
        # a fixed value is exactly the one given, without a round trip through the transform
        own = np.where(block.fitted, found, block.start)
        own_slope = np.where(block.fitted, slope, 0.0)
        leader = leaders(block)
        values[block.name], slopes[block.name] = own[leader], own_slope[leader]
    return values, slopes


def fitted_columns(parameters: Parameters, jacobians: dict[str, FloatArray]) -> FloatArray:
    """Return the Jacobian by the free vector from the blocks' own, shape (n_rows, n_free).

    What is left out does not depend on that block.
    """
    n_rows = len(next(iter(jacobians.values())))
    columns = []
    for block in parameters.blocks:
        jacobian = jacobians.get(block.name, np.zeros((n_rows, len(block.labels))))
        if block.leader is not None:
            # what followers change, their leader changes
            jacobian = jacobian @ np.eye(len(block.labels))[block.leader]
        columns.append(jacobian[:, block.fitted])
    return np.concatenate(columns, axis=1)


def prior_covariance(block: Block) -> FloatArray:
    """Return the prior covariance of a block's fitted free numbers, shape (n_fitted, n_fitted)."""
    sd = block.prior_sd[block.fitted]
    if block.correlation is None:
        return np.diag(sd**2)
    return np.asarray(block.correlation[np.ix_(block.fitted, block.fitted)] * np.outer(sd, sd))


def prior_residuals(parameters: Parameters, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what every fitted entry with a finite prior is off its mean, and the Jacobian rows.

    In standard deviations, whitened by the inverse Cholesky root of a covariance where a block's
    are correlated; shapes (n_priors,) and (n_priors, n_free).
    """
    mean = np.concatenate([b.prior_mean[b.fitted] for b in parameters.blocks])
    sd = np.concatenate([b.prior_sd[b.fitted] for b in parameters.blocks])
    finite = np.isfinite(sd)
    whitening = np.diag(np.where(finite, 1.0 / np.where(finite, sd, 1.0), 0.0))
    off = (vector - mean) / sd
    for block in parameters.blocks:
        if block.correlation is None:
            continue
        first = position_of(parameters, block.name)
        own = slice(first, first + int(np.count_nonzero(block.fitted)))
        whitening[own, own] = np.linalg.inv(np.linalg.cholesky(prior_covariance(block)))
        off[own] = whitening[own, own] @ (vector - mean)[own]
    if parameters.joint is None:
        return off[finite], whitening[finite]
    joint = parameters.joint
    own = slice(vector.size - joint.mean.size, vector.size)
    finite[own] = False
    root = np.zeros((joint.mean.size, vector.size))
    root[:, own] = np.linalg.cholesky(joint.information).T
    correlated = root[:, own] @ (vector[own] - joint.mean)
    return np.concatenate((off[finite], correlated)), np.concatenate((whitening[finite], root))


def marginal_information(information: FloatArray, first: int) -> FloatArray:
    """Return the information about the last unknowns, all before `first` integrated out (Schur)."""
    cross = information[first:, :first]
    determined = np.linalg.solve(information[:first, :first], cross.T)
    return np.asarray(information[first:, first:] - cross @ determined)
