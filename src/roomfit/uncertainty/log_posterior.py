"""The posterior of one band's free numbers, what is not asked for integrated out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.identification.reweighted import BandFit
from roomfit.objective.coherent_geometry import GEOMETRY
from roomfit.objective.parameters import (
    Parameters,
    physical_values,
    position_of,
    prior_residuals,
)
from roomfit.objective.problem import BandProblem
from roomfit.typing import FloatArray, IntArray

# An absorption this near to 1 or 0 can no more be told from it: a wall beyond is none of sound.
FARTHEST_FREE = 40.0
# Least 1 - a of which a log is taken.
LEAST_REFLECTED = 1e-18


@dataclass(frozen=True, slots=True, eq=False)
class LogPosterior:
    """Log density of a band's absorptions, gains and directivity, up to a constant.

    The data count as the fit counts them: neighbours that share information once, and a misfit
    flattens their likelihood by phi. Their variances are those of each point, with every constant.

    Arrival times (dozens of unknowns, of which no number is asked for) are integrated out by
    Laplace's rule: they follow the other numbers along the fit's own ridge, and what one Newton
    step would still gain there is added. The fit's curvature is kept, so that its determinant
    is a constant. The ridge is straight in the exponents ``-log(1 - a)``, as the data are: one in
    logits leaves them where a wall is hard, and the step would promise what it does not gain.

    Attributes
    ----------
    problem : BandProblem
    centre : float array, shape (n_free,)
        The fit's answer.
    n_kept : int
        Entries of the free vector, from its beginning, whose density this is.
    follow : float array, shape (n_free - n_kept, n_kept)
        By how much arrival times follow the exponents.
    inner : float array, shape (n_free - n_kept, n_free - n_kept)
        Their information, given the others.
    flattening : float
        max(phi, 1).
    """

    problem: BandProblem
    centre: FloatArray
    n_kept: int
    follow: FloatArray
    inner: FloatArray
    flattening: float

    def __call__(self, kept: FloatArray) -> float:
        """Return the log density at kept numbers, shape (n_kept,); minus infinity far outside."""
        if not np.all(np.abs(kept) < FARTHEST_FREE):
            return -np.inf
        vector = np.concatenate((kept, self.ridge(kept)))
        prediction = self.problem.predict(vector)
        variance = self.problem.variance(vector)
        neighbours = self.problem.counted_as_one()
        each = self.problem.log_likelihood(prediction.expected, variance)
        prior, rows = prior_residuals(self.problem.parameters, vector)
        found = float(np.sum(each / neighbours)) / self.flattening - 0.5 * float(prior @ prior)
        if self.inner.size:
            spread = neighbours * variance * self.flattening
            off = (self.problem.measured() - prediction.expected) / spread
            slope = (prediction.jacobian.T @ off - rows.T @ prior)[self.n_kept :]
            found += 0.5 * float(slope @ np.linalg.solve(self.inner, slope))
        return found if np.isfinite(found) else -np.inf

    def ridge(self, kept: FloatArray) -> FloatArray:
        """Return where arrival times follow kept numbers, shape (n_free - n_kept,)."""
        parameters, centre = self.problem.parameters, self.centre[: self.n_kept]
        here, there = exponents(parameters, np.stack((centre, kept)))
        return np.asarray(self.centre[self.n_kept :] + self.follow @ (there - here))


def log_posterior(problem: BandProblem, fit: BandFit) -> LogPosterior:
    """Return the posterior of all unknowns of a band but its arrival times.

    Parameters
    ----------
    problem : BandProblem
    fit : BandFit
        Its answer.
    """
    parameters, flattening = problem.parameters, max(fit.phi, 1.0)
    n = fit.vector.size
    timed = any(b.name == GEOMETRY for b in parameters.blocks)
    kept = position_of(parameters, GEOMETRY) if timed else n
    prior = prior_information(parameters, fit.vector)
    # the data are flattened, what was known beforehand is not
    whole = (fit.information - prior) / flattening + prior
    inner = whole[kept:, kept:]
    follow = -np.linalg.solve(inner, whole[kept:, :kept]) if kept < n else np.zeros((0, kept))
    follow = follow / exponent_slopes(parameters, fit.vector)[:kept]
    return LogPosterior(problem, fit.vector, kept, np.asarray(follow), inner, flattening)


def prior_information(parameters: Parameters, vector: FloatArray) -> FloatArray:
    """Return the information of what was known beforehand, shape (n_free, n_free)."""
    _, rows = prior_residuals(parameters, vector)
    return np.asarray(rows.T @ rows)


def absorption_columns(parameters: Parameters) -> tuple[int, IntArray]:
    """Return where the fitted absorptions begin, and which entries of their block they are."""
    block = next(b for b in parameters.blocks if b.name == "absorption")
    return position_of(parameters, "absorption"), np.flatnonzero(block.fitted)


def exponent_slopes(parameters: Parameters, vector: FloatArray) -> FloatArray:
    """Return the derivative of each exponent by its free number, 1 where there is no exponent."""
    values, slopes = physical_values(parameters, vector)
    by_exponent = slopes["absorption"] / np.maximum(1.0 - values["absorption"], 1e-12)
    out = np.ones(vector.size)
    first, columns = absorption_columns(parameters)
    out[first : first + columns.size] = np.maximum(by_exponent[columns], 1e-9)
    return out


def exponents(parameters: Parameters, kept: FloatArray) -> FloatArray:
    """Return the exponents of absorptions, all other free numbers as they are, (n_points, n)."""
    out = np.array(kept)
    first, columns = absorption_columns(parameters)
    own = slice(first, first + columns.size)
    block = next(b for b in parameters.blocks if b.name == "absorption")
    low, high = block.lower[columns], block.upper[columns]
    # 1 - a, without rounding where a comes near to 1
    less = (1.0 - high) + (high - low) * 0.5 * (1.0 - np.tanh(0.5 * kept[:, own]))
    out[:, own] = -np.log(np.maximum(less, LEAST_REFLECTED))
    return out
