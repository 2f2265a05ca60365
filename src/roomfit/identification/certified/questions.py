"""Problems of the objective layer as questions for a certified search."""

from __future__ import annotations

import math

import numpy as np

from roomfit.errors import InputError
from roomfit.identification.certified.question import Misfit, Question
from roomfit.objective.squares import SquaresProblem
from roomfit.typing import FloatArray


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
