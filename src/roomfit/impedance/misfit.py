"""How wrong the image model is in the room at hand, by what a fit leaves."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roomfit.geometry.measures import mean_free_path_m
from roomfit.impedance.model import has_free_spectra
from roomfit.impedance.observed import standard_deviation
from roomfit.impedance.problem import Problem
from roomfit.typing import FloatArray

# Of 26 boxes with walls at random, at 40 dB, the error had this median, over what is allowed for
# it, and this spread of its logarithm: `scripts/bench impedance rooms`.
_MEDIAN, _LOG_SD = 0.5, 0.5
_GRID = np.geomspace(0.06, 6.0, 47)


class Whitened(NamedTuple):
    """A fit where it ended, linear: what its evidence needs.

    Attributes
    ----------
    residual : float array, shape (n_rows,)
        Of the data, in standard deviations.
    jacobian : float array, shape (n_rows, n_unknowns)
    normal : float array, shape (n_unknowns, n_unknowns)
        ``J^T J`` of data and priors.
    """

    residual: FloatArray
    jacobian: FloatArray
    normal: FloatArray


def evident_model_error(problem: Problem, fit: Whitened) -> float:
    """Return the factor of the model's own error that makes what was measured most probable.

    The restricted likelihood [1]_: unknowns of the fit integrated out, so that what they have taken
    from the residual is not missed, times a normal prior of the logarithm. Where noise hides the
    error, the prior is what remains. Where a spectrum of each source is free it takes up what the
    model gets wrong for all pairs alike, so that the residual shows too little: there the error is
    not taken to be less than the prior's median.

    Returns
    -------
    float
        Error relative to the level, times wavenumber and mean free path; see
        `roomfit.impedance.observed.model_error`.

    References
    ----------
    .. [1] H. D. Patterson, R. Thompson, "Recovery of inter-block information when block sizes are
           unequal", Biometrika 58, 545-554 (1971).
    """
    if problem.model_error == 0.0:
        return 0.0
    hidden = has_free_spectra(problem.nuisances)
    grid = _GRID[_GRID >= _MEDIAN] if hidden else _GRID
    costs = [_cost(problem, fit, share) for share in grid]
    return float(grid[int(np.argmin(costs))]) * problem.model_error


def _cost(problem: Problem, fit: Whitened, share: float) -> float:
    """Return twice the negative logarithm of likelihood times prior, but for a constant."""
    variance = relative_variance(problem, share * problem.model_error)
    weight = 1.0 / variance
    changed = fit.normal + fit.jacobian.T @ ((weight - 1.0)[:, None] * fit.jacobian)
    # at the minimum the slopes of data and priors cancel
    slope = fit.jacobian.T @ ((weight - 1.0) * fit.residual)
    tiny = 1e-12 * np.trace(changed) / len(changed)
    changed = changed + tiny * np.eye(len(changed))
    _, size = np.linalg.slogdet(changed)
    gained = float(slope @ np.linalg.solve(changed, slope))
    squares = float(weight @ fit.residual**2) - gained
    prior = (math.log(share / _MEDIAN) / _LOG_SD) ** 2
    return _free_share(problem) * float(np.sum(np.log(variance))) + float(size) + squares + prior


def _free_share(problem: Problem) -> float:
    """Return the share of the rows that unknown spectra of sources leave."""
    if not has_free_spectra(problem.nuisances):
        return 1.0
    pairs = problem.model.scene.pairs
    return 1.0 - len(np.unique(pairs[:, 0])) / len(pairs)


def relative_variance(problem: Problem, factor: float) -> FloatArray:
    """Return the variance of each row of data for another model error, (n_rows,).

    Relative to the variance with which the rows were weighed.
    """
    model = problem.model
    free_path_m = mean_free_path_m(model.scene.room.mesh)
    sd = standard_deviation(problem.observed, free_path_m, model.speed_m_s, factor)
    ratio = np.maximum((sd / problem.sd) ** 2, 1e-6).ravel()
    return np.tile(ratio, 2) if problem.observed.has_phase else np.asarray(ratio)


def honest_covariance(
    problem: Problem, fit: Whitened, factor: float, effective: float
) -> FloatArray:
    """Return the covariance of what a fit found where the model's error is another than weighed.

    ``N^-1 (J^T V J + P^T P) N^-1`` [1]_, V the variance of the rows over what they were weighed by;
    wider where the data fit even worse than that.

    References
    ----------
    .. [1] H. White, "A heteroskedasticity-consistent covariance matrix estimator", Econometrica
           48, 817-838 (1980).
    """
    variance = relative_variance(problem, factor)
    inverse = np.linalg.pinv(fit.normal, hermitian=True)
    spread = fit.normal + fit.jacobian.T @ ((variance - 1.0)[:, None] * fit.jacobian)
    free = max(len(fit.residual) - effective, 1.0)
    chi2 = float(np.sum(fit.residual**2 / variance)) / free
    return np.asarray(inverse @ spread @ inverse * max(chi2, 1.0))
