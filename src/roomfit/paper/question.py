"""What a certified search minimises: squares of sums of products of powers, and priors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.sparse import csr_array

from roomfit.base.errors import InputError
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.model.energy import EnergyTerm, Observation
from roomfit.model.parameters import Block, Parameters, leaders, physical_values, to_free
from roomfit.model.problem import total
from roomfit.model.weighing import EnergyRows, window_of_rows

Arrays: TypeAlias = tuple[
    IntArray, FloatArray, IntArray, FloatArray, FloatArray, FloatArray, BoolArray
]
"""offsets, weight, exponents, measured, precision, prior, is_absorption: what kernels take."""


@dataclass(frozen=True, slots=True, eq=False)
class GlobalProblem:
    """One band's misfit as a function of log factors g, to be minimised over a box.

    The misfit is the sum of ``c (R - M)**2`` over windows, and of the priors. Window i is expected
    to have the energy ``R_i = sum over its rows of w prod exp(n_m g_m)``. The first coordinates are
    materials, g = log(1 - absorption); others are log gains.
    """

    coordinates: tuple[str, ...]
    is_absorption: BoolArray  # (n,)
    offsets: IntArray  # (n_windows + 1,), window i owns the rows ``offsets[i]:offsets[i + 1]``
    weight: FloatArray  # (n_rows,), 0 or more
    exponents: IntArray  # (n_rows, n)
    measured: FloatArray  # (n_windows,), M; 0 or more
    precision: FloatArray  # (n_windows,), c; 0 or more
    # least, most: (n,), bounds of g. `least` may be minus infinity, an absorption of 1.
    least: FloatArray
    most: FloatArray
    # (n, 4), adds ``p (logit - mean)**2`` for each material, with the logit of its absorption
    # between bounds: columns p, mean, 1 - lower bound, 1 - upper bound. p = 0 adds nothing.
    prior: FloatArray


def arrays(global_problem: GlobalProblem) -> Arrays:
    """Return what the kernels take, writable copies of one contiguous form."""
    return (
        np.array(global_problem.offsets, dtype=np.int64),
        np.array(global_problem.weight),
        np.array(global_problem.exponents, dtype=np.uint16),
        np.array(global_problem.measured),
        np.array(global_problem.precision),
        np.array(global_problem.prior),
        np.array(global_problem.is_absorption),
    )


def to_absorption(global_problem: GlobalProblem, g: FloatArray) -> FloatArray:
    """Return what log factors mean: absorption for materials, the gain itself for gains."""
    return np.where(global_problem.is_absorption, -np.expm1(g), np.exp(g))


# Gains are searched within a factor of e**3, 13 dB, either side of where total energies agree.
LOG_REACH = 3.0


def is_certifiable(energies: EnergyTerm, parameters: Parameters) -> bool:
    """Whether `energy_global_problem` accepts them: unknown are absorption and gains alone."""
    names = {b.name for b in parameters.blocks}
    alone = names == {"absorption", "gain"} and parameters.joint is None
    return alone and energies.attenuation_per_m == 0.0 and _independent(parameters)


def _independent(parameters: Parameters) -> bool:
    """Whether the prior is a sum over unknowns, as bounds of it over boxes are."""
    return all(b.correlation is None for b in parameters.blocks)


def _energy_blocks(parameters: Parameters) -> tuple[Block, Block]:
    """Return the blocks of absorptions and gains, and refuse what has no bounds."""
    blocks = {b.name: b for b in parameters.blocks}
    if set(blocks) != {"absorption", "gain"} or parameters.joint is not None:
        what = "only energies under absorption and gains can be certified"
        hint = 'fit with method = "certified" and model = "energy"'
        raise InputError(what, found=", ".join(blocks), needed="absorptions and gains", hint=hint)
    if not _independent(parameters):
        raise InputError(
            "no bounds of a prior that materials share",
            found="materials of one product",
            needed="materials with priors of their own",
            hint='leave out the product, or use method = "least-squares"',
        )
    return blocks["absorption"], blocks["gain"]


def energy_global_problem(
    energies: EnergyTerm, parameters: Parameters, vector: FloatArray
) -> GlobalProblem:
    """Return half the weighted squares of a band's window energies, and half those of its priors.

    The weights are those of the answer `vector`: the cost that a fit's last round has
    minimised. Coordinates are the fitted absorptions, then the fitted gains.

    Parameters
    ----------
    energies : EnergyTerm
        Air in its rows (`in_air`).
    vector : float array, shape (n_free,)

    Raises
    ------
    InputError
        Energies are not all that is unknown or known: other blocks, a joint prior, or materials
        of one product.
    """
    absorption, gain = _energy_blocks(parameters)
    values, _ = physical_values(parameters, vector)
    own = np.flatnonzero(absorption.fitted)
    free_gains = np.flatnonzero(gain.fitted)
    parts = [
        _window_rows(rows, observed, absorption, gain, values["gain"])
        for rows, observed in zip(energies.rows, energies.observations, strict=True)
    ]
    counts = np.concatenate([p[0] for p in parts])
    centre = np.log(gain.start[free_gains])
    spread = total(energies.variance_parts(values)) * energies.correlation_length(values)
    prior = np.zeros((own.size + free_gains.size, 4))
    prior[: own.size, 0] = 0.5 / absorption.prior_sd[own] ** 2
    prior[: own.size, 1] = absorption.prior_mean[own]
    prior[: own.size, 2] = 1.0 - absorption.lower[own]
    prior[: own.size, 3] = 1.0 - absorption.upper[own]
    with np.errstate(divide="ignore"):
        darkest = np.log1p(-absorption.upper[own])
    return GlobalProblem(
        (
            *(absorption.labels[i] for i in own),
            *(f"gain of {gain.labels[i]}" for i in free_gains),
        ),
        np.arange(own.size + free_gains.size) < own.size,
        np.concatenate(([0], np.cumsum(counts))),
        np.concatenate([p[1] for p in parts]),
        np.concatenate([p[2] for p in parts]),
        energies.measured(),
        0.5 / spread,
        np.concatenate((darkest, centre - LOG_REACH)),
        np.concatenate((np.log1p(-absorption.lower[own]), centre + LOG_REACH)),
        prior,
    )


def free_vector(parameters: Parameters, place: FloatArray) -> FloatArray:
    """Return the free vector of a minimiser as certificates give it: absorptions, then gains."""
    values = {}
    position = 0
    for name in ("absorption", "gain"):
        block = next(b for b in parameters.blocks if b.name == name)
        physical = block.start.copy()
        n = int(np.count_nonzero(block.fitted))
        physical[block.fitted] = place[position : position + n]
        position += n
        values[name] = to_free(block, physical)[block.fitted]
    return np.concatenate([values[b.name] for b in parameters.blocks])


def _window_rows(
    rows: EnergyRows, observed: Observation, absorption: Block, gain: Block, gains: FloatArray
) -> tuple[IntArray, FloatArray, IntArray]:
    """Return the rows of one observation's windows: counts, weights and exponents.

    Paths of equal hits become one row a window, with the share of each that the filter carries
    there. Known absorption goes into the weights, and so does noise, as a row without hits.
    """
    leader = leaders(absorption)
    own = np.flatnonzero(absorption.fitted)
    fixed = ~absorption.fitted[leader]
    factor = np.prod((1.0 - absorption.start[leader])[fixed] ** rows.hits[:, fixed], axis=1)
    hits = rows.hits.astype(np.int64) @ (leader[:, None] == own[None, :])
    patterns, which = np.unique(hits, axis=0, return_inverse=True)
    by_bin = csr_array(
        (rows.weight_per_m2 * factor, (window_of_rows(rows), which.reshape(-1))),
        shape=(rows.n_windows, len(patterns)),
    )
    # the filter's shares are positive but for the rounding of their table
    spreading = observed.spreading.maximum(0.0) if observed.spreading.nnz else observed.spreading
    merged = csr_array(spreading[:, : rows.n_windows] @ by_bin)
    level = gains[observed.gain] if observed.gain >= 0 and not gain.fitted[observed.gain] else 1.0
    free_gains = np.flatnonzero(gain.fitted)
    n_windows = observed.energy.size
    window = np.repeat(np.arange(n_windows), np.diff(merged.indptr))
    exponents = np.zeros((merged.nnz, own.size + free_gains.size), dtype=np.int64)
    exponents[:, : own.size] = patterns[merged.indices]
    exponents[:, own.size :] = (free_gains == observed.gain)[None, :]
    weight = np.concatenate((level * merged.data, observed.noise))
    exponents = np.concatenate((exponents, np.zeros((n_windows, exponents.shape[1]), np.int64)))
    window = np.concatenate((window, np.arange(n_windows)))
    order = np.argsort(window, kind="stable")
    return np.bincount(window, minlength=n_windows), weight[order], exponents[order]
