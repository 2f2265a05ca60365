"""Errors that all data of a band share, in the covariance of its answer.

Variances of single windows know how far each of them may be off, and not that all are off together.
Such errors hardly show in what a fit leaves over, for the answer follows them, and the sums that
data determine best, as the mean absorption of the room, are moved by them most of all.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roomfit.identification.reweighted import BandFit
from roomfit.objective.problem import BandProblem
from roomfit.typing import FloatArray


def answer_steps(problem: BandProblem, fit: BandFit, errors: FloatArray) -> FloatArray:
    """Return how far the answer moves if what is expected of the data is wrong by given errors.

    To first order ``H^-1 J^T W u`` for an error u, with H the information, J the Jacobian and W the
    weights of the data.

    Parameters
    ----------
    problem : BandProblem
    fit : BandFit
        Its answer.
    errors : float array, shape (n, n_errors)
        Of the first n data, in their unit.

    Returns
    -------
    float array, shape (n_free, n_errors)
    """
    n = errors.shape[0]
    weight = 1.0 / (problem.counted_as_one()[:n] * fit.variance[:n])
    jacobian = problem.predict(fit.vector).jacobian[:n]
    return np.asarray(np.linalg.solve(fit.information, jacobian.T @ (weight[:, None] * errors)))


def allowing_for(fit: BandFit, steps: FloatArray) -> BandFit:
    """Return a fit whose covariance has the outer products of steps of its answer added.

    Parameters
    ----------
    fit : BandFit
    steps : float array, shape (n_free, n_errors)
        One standard deviation each, independent of each other.
    """
    if not np.any(steps):
        return fit
    # misfit multiplies the covariance later on; these errors are as large as they are
    more = steps @ steps.T / max(fit.phi, 1.0)
    information = np.linalg.inv(np.linalg.inv(fit.information) + more)
    return replace(fit, information=0.5 * (information + information.T))
