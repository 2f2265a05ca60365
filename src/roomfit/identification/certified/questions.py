"""Problems of the objective layer as questions for a certified search."""

from __future__ import annotations

import math

import numpy as np
from scipy.sparse import csr_array

from roomfit.errors import InputError
from roomfit.identification.certified.question import Misfit, Question
from roomfit.objective.energy_problem import EnergyProblem, Observation
from roomfit.objective.parameters import Block, leaders, physical_values, to_free
from roomfit.objective.squares import SquaresProblem
from roomfit.response.rows import EnergyRows, window_of_rows
from roomfit.typing import FloatArray, IntArray

# Gains are searched within a factor of e**3, 13 dB, either side of where total energies agree.
LOG_REACH = 3.0


def squares_question(
    problem: SquaresProblem,
    misfit: Misfit = "squares",
    *,
    precision: FloatArray | None = None,
    upper: float = 1.0,
) -> Question:
    """Return the misfit of a problem without air and noise over all absorptions.

    Parameters
    ----------
    problem : SquaresProblem
    misfit : {"squares", "logarithms", "gamma"}
    precision : float array, shape (n_windows,), optional
        Weight of each window; 1 where left out, which with "squares" is the paper's equation (1).
    upper : float
        Largest absorption of any material, above 0, at most 1.

    Raises
    ------
    InputError
        See `Question`.
    """
    if not 0.0 < upper <= 1.0:
        raise InputError("largest absorption out of range", found=f"{upper:g}", needed="0 to 1")
    rows = problem.rows
    n = len(rows.materials)
    return Question(
        rows.materials,
        np.ones(n, dtype=np.bool_),
        misfit,
        rows.offsets,
        rows.weight_per_m2,
        rows.hits,
        problem.measured,
        np.ones(rows.n_windows) if precision is None else precision,
        np.full(n, math.log1p(-upper) if upper < 1.0 else -math.inf),
        np.zeros(n),
        np.zeros((n, 4)),
    )


def is_certifiable(problem: EnergyProblem) -> bool:
    """Whether `energy_question` accepts a problem: nothing unknown but absorption and gains."""
    parameters = problem.parameters
    names = {b.name for b in parameters.blocks}
    alone = names == {"absorption", "gain"} and parameters.joint is None
    return alone and problem.attenuation_per_m == 0.0


def energy_question(problem: EnergyProblem, vector: FloatArray) -> Question:
    """Return half the weighted squares of a band's window energies, and half those of its priors.

    The weights are those of the answer `vector`, held fixed: the cost that a fit's last round has
    minimised. Coordinates are the fitted absorptions, then the fitted gains.

    Parameters
    ----------
    problem : EnergyProblem
        Air in its rows (`in_air`).
    vector : float array, shape (n_free,)

    Raises
    ------
    InputError
        Energies are not all that is unknown or known: other blocks, a joint prior, air apart.
    """
    blocks = {b.name: b for b in problem.parameters.blocks}
    if set(blocks) != {"absorption", "gain"} or problem.parameters.joint is not None:
        raise InputError(
            "only energies under absorption and gains can be certified",
            found=", ".join(blocks),
            hint='fit with method = "certified" and model = "energy"',
        )
    if problem.attenuation_per_m != 0.0:
        raise InputError("the air's loss must stand in the rows", hint="use `in_air`")
    absorption, gain = blocks["absorption"], blocks["gain"]
    values, _ = physical_values(problem.parameters, vector)
    own = np.flatnonzero(absorption.fitted)
    free_gains = np.flatnonzero(gain.fitted)
    parts = [
        _window_rows(rows, seen, absorption, gain, values["gain"])
        for rows, seen in zip(problem.rows, problem.observations, strict=True)
    ]
    counts = np.concatenate([p[0] for p in parts])
    centre = np.log(gain.start[free_gains])
    spread = problem.variance(vector) * problem.counted_as_one()
    prior = np.zeros((own.size + free_gains.size, 4))
    prior[: own.size, 0] = 0.5 / absorption.prior_sd[own] ** 2
    prior[: own.size, 1] = absorption.prior_mean[own]
    prior[: own.size, 2] = 1.0 - absorption.lower[own]
    prior[: own.size, 3] = 1.0 - absorption.upper[own]
    with np.errstate(divide="ignore"):
        darkest = np.log1p(-absorption.upper[own])
    return Question(
        (
            *(absorption.labels[i] for i in own),
            *(f"gain of {gain.labels[i]}" for i in free_gains),
        ),
        np.arange(own.size + free_gains.size) < own.size,
        "squares",
        np.concatenate(([0], np.cumsum(counts))),
        np.concatenate([p[1] for p in parts]),
        np.concatenate([p[2] for p in parts]),
        problem.measured(),
        0.5 / spread,
        np.concatenate((darkest, centre - LOG_REACH)),
        np.concatenate((np.log1p(-absorption.lower[own]), centre + LOG_REACH)),
        prior,
    )


def free_vector(problem: EnergyProblem, place: FloatArray) -> FloatArray:
    """Return the free vector of a minimiser as certificates tell it: absorptions, then gains."""
    values = {}
    position = 0
    for name in ("absorption", "gain"):
        block = next(b for b in problem.parameters.blocks if b.name == name)
        physical = block.start.copy()
        n = int(np.count_nonzero(block.fitted))
        physical[block.fitted] = place[position : position + n]
        position += n
        values[name] = to_free(block, physical)[block.fitted]
    return np.concatenate([values[b.name] for b in problem.parameters.blocks])


def _window_rows(
    rows: EnergyRows, seen: Observation, absorption: Block, gain: Block, gains: FloatArray
) -> tuple[IntArray, FloatArray, IntArray]:
    """Return the rows of one observation's windows: counts, weights and exponents.

    Paths of equal hits become one row a window, with the share of each that the filter carries
    there. Known absorption goes into the weights, and so does noise, as a row without hits.
    """
    leader = leaders(absorption)
    own = np.flatnonzero(absorption.fitted)
    held = ~absorption.fitted[leader]
    factor = np.prod((1.0 - absorption.start[leader])[held] ** rows.hits[:, held], axis=1)
    hits = rows.hits.astype(np.int64) @ (leader[:, None] == own[None, :])
    patterns, which = np.unique(hits, axis=0, return_inverse=True)
    by_bin = csr_array(
        (rows.weight_per_m2 * factor, (window_of_rows(rows), which.reshape(-1))),
        shape=(rows.n_windows, len(patterns)),
    )
    # the filter's shares are positive but for the rounding of their table
    shares = seen.shares.maximum(0.0) if seen.shares.nnz else seen.shares
    merged = csr_array(shares[:, : rows.n_windows] @ by_bin)
    level = gains[seen.gain] if seen.gain >= 0 and not gain.fitted[seen.gain] else 1.0
    free_gains = np.flatnonzero(gain.fitted)
    n_windows = seen.energy.size
    window = np.repeat(np.arange(n_windows), np.diff(merged.indptr))
    exponents = np.zeros((merged.nnz, own.size + free_gains.size), dtype=np.int64)
    exponents[:, : own.size] = patterns[merged.indices]
    exponents[:, own.size :] = (free_gains == seen.gain)[None, :]
    weight = np.concatenate((level * merged.data, seen.noise))
    exponents = np.concatenate((exponents, np.zeros((n_windows, exponents.shape[1]), np.int64)))
    window = np.concatenate((window, np.arange(n_windows)))
    order = np.argsort(window, kind="stable")
    return np.bincount(window, minlength=n_windows), weight[order], exponents[order]
