"""A law near to a band's posterior that costs nothing: what proposals are drawn from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.identification.reweighted import BandFit
from roomfit.objective.parameters import Parameters
from roomfit.objective.problem import BandProblem, Prediction
from roomfit.typing import BoolArray, FloatArray
from roomfit.uncertainty.log_posterior import (
    FARTHEST_FREE,
    LogPosterior,
    absorption_columns,
    exponent_slopes,
    exponents,
    prior_information,
)
from roomfit.uncertainty.walk_kernels import walk_points

# Of a free number, for second derivatives: large beside rounding, small beside what bends.
_STEP = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """Data whose expectation without noise is known to second order in the exponents.

    Of energies its log, a sum over paths of exponentials of the exponents: the mean and the
    covariance of their counts of hits are its first two derivatives.

    Attributes
    ----------
    measured, signal, noise : float arrays, shape (n_data,)
        `signal` at the centre; `noise` is what is expected besides.
    slopes : float array, shape (n_data, n_kept)
        Of the log of the signal by the exponents; of data that are no energies, of the signal.
    curvature : float array, shape (n_data, n_kept, n_kept)
        Second derivative of the same.
    weight : float array, shape (n_data,)
        Of energies the shape of their Gamma law, else one over the variance; neighbours that share
        information counted once, flattened by the misfit.
    energies : bool array, shape (n_data,)
    """

    measured: FloatArray
    signal: FloatArray
    noise: FloatArray
    slopes: FloatArray
    curvature: FloatArray
    weight: FloatArray
    energies: BoolArray

    def log_likelihood(self, away: FloatArray) -> FloatArray:
        """Return it, up to a constant, at exponents this far from the centre, (n_points, n)."""
        change = away @ self.slopes.T
        change += 0.5 * np.einsum("pi,wij,pj->pw", away, self.curvature, away, optimize=True)
        with np.errstate(over="ignore", invalid="ignore"):
            grown = self.signal * np.exp(np.where(self.energies, change, 0.0)) + self.noise
            ratio = self.measured / np.where(self.energies, grown, 1.0)
            gamma = -np.log(np.where(self.energies, grown, 1.0)) - ratio
            off = self.measured - self.noise - self.signal - change
            each = np.where(self.energies, gamma, -0.5 * off**2)
            found = each @ self.weight
        return np.where(np.isfinite(found), found, -np.inf)


@dataclass(frozen=True, slots=True, eq=False)
class Surrogate:
    """A law near to a posterior, with the fit's curvature.

    A path's energy is linear in the exponents ``-log(1 - a)``, and in the logs of gains. Where the
    data are windows alone, the log of each window's energy is taken as quadratic in them. Where
    arrival times are integrated out, so that windows hang together, the whole log-likelihood is
    taken as quadratic in them. Only the prior is Gaussian in the logits; see
    `roomfit.uncertainty.straight_draws`.

    Attributes
    ----------
    parameters : Parameters
    centre : float array, shape (n_kept,)
    windows : Windows or None
    data : float array, shape (n_kept, n_kept)
        Information of the data in the exponents; used without windows.
    pull : float array, shape (n_kept,)
        Slope of the data's log-likelihood at the centre; used without windows.
    prior : float array, shape (n_kept, n_kept)
    prior_mean : float array, shape (n_kept,)
    covariance : float array, shape (n_kept, n_kept)
        Of the free numbers, Gaussian at the centre.
    """

    parameters: Parameters
    centre: FloatArray
    windows: Windows | None
    data: FloatArray
    pull: FloatArray
    prior: FloatArray
    prior_mean: FloatArray
    covariance: FloatArray

    def log_density(self, kept: FloatArray) -> FloatArray:
        """Return the log density, up to a constant, of points of shape (n_points, n_kept)."""
        away = exponents(self.parameters, kept) - exponents(self.parameters, self.centre[None])
        off = kept - self.prior_mean
        found = -0.5 * np.einsum("pi,ij,pj->p", off, self.prior, off)
        if self.windows is not None:
            found += self.windows.log_likelihood(away)
        else:
            found += away @ self.pull - 0.5 * np.einsum("pi,ij,pj->p", away, self.data, away)
        return np.where(np.all(np.abs(kept) < FARTHEST_FREE, axis=1), found, -np.inf)

    @property
    def usual_steps(self) -> tuple[int, ...]:
        """Lengths of walks: a short one, and one that costs less than what it is weighed by.

        A random walk needs some 500 steps to forget its place under the skew laws of hard walls.
        """
        return (50, 4000) if self.windows is None else (50, 500)

    def walk(
        self, points: FloatArray, steps: int, rng: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Return points after Metropolis steps under this law, and their gain in log density.

        The walk is reversible under the law, so a proposal made by it is weighed by that gain
        alone [1]_.

        References
        ----------
        .. [1] J. S. Liu, Monte Carlo Strategies in Scientific Computing, 2001, section 9.4.3
               ("surrogate transition").
        """
        n = points.shape[1]
        root = 2.38 / np.sqrt(n) * np.linalg.cholesky(self.covariance)
        # drawn whatever the place, so that each step stays reversible; small ones still move along
        # narrow ridges
        sizes = np.exp(rng.uniform(np.log(0.1), np.log(2.0), steps))
        here = np.array(points, dtype=np.float64, order="C")
        first, columns = absorption_columns(self.parameters)
        block = next(b for b in self.parameters.blocks if b.name == "absorption")
        w = _no_windows(n) if self.windows is None else self.windows
        gain = walk_points(
            *(here, root, sizes, rng.standard_normal((steps, *here.shape))),
            *(np.log(rng.random((steps, len(here)))), FARTHEST_FREE, first),
            *(np.array(block.lower[columns]), np.array(block.upper[columns])),
            *(np.array(self.centre), np.array(self.prior), np.array(self.prior_mean)),
            *(np.array(self.data), np.array(self.pull)),
            *(np.array(w.measured), np.array(w.signal), np.array(w.noise), np.array(w.slopes)),
            *(np.array(w.curvature), np.array(w.weight)),
            np.array(w.energies),
        )
        return here, gain


def _no_windows(n: int) -> Windows:
    """Return what stands for no windows of n exponents."""
    none: FloatArray = np.zeros(0)
    flags = np.zeros(0, dtype=np.bool_)
    return Windows(none, none, none, np.zeros((0, n)), np.zeros((0, n, n)), none, flags)


def surrogate(posterior: LogPosterior, fit: BandFit) -> Surrogate:
    """Return the law that proposals for a band's posterior are drawn from."""
    parameters, n = posterior.problem.parameters, posterior.n_kept
    whole = prior_information(parameters, fit.vector)
    prior = whole[:n, :n]
    inner = posterior.inner
    data = (fit.information - whole)[:n, :n] / posterior.flattening
    slope = exponent_slopes(parameters, fit.vector)[:n]
    if inner.size:
        follow = posterior.follow * slope
        data = data - follow.T @ inner @ follow
    means = np.concatenate([b.prior_mean[b.fitted] for b in parameters.blocks])[:n]
    pull = prior @ (fit.vector[:n] - means) / slope
    size, directions = np.linalg.eigh(0.5 * (data + data.T))
    data = (directions * np.maximum(size, 0.0)) @ directions.T
    free = data + prior + 1e-6 * np.eye(n)
    return Surrogate(
        *(parameters, np.array(fit.vector[:n]), None if inner.size else _windows(posterior, fit)),
        *(data / np.outer(slope, slope), pull, prior, means, np.asarray(np.linalg.inv(free))),
    )


def _windows(posterior: LogPosterior, fit: BandFit) -> Windows:
    problem = posterior.problem
    found, energies = problem.predict(fit.vector), problem.are_energies()
    count = problem.counted_as_one() * posterior.flattening
    variance = np.maximum(fit.variance, np.where(energies, (1e-3 * fit.expected) ** 2, 0.0))
    slopes = _signal_slopes(problem, found, fit.vector)
    weight = np.where(energies, found.expected**2, 1.0) / (variance * count)
    return Windows(
        *(problem.measured(), found.signal, found.expected - found.signal, slopes),
        *(_curvature(problem, slopes, fit.vector), weight, energies),
    )


def _signal_slopes(problem: BandProblem, found: Prediction, vector: FloatArray) -> FloatArray:
    """Return the slopes of `Windows` at a point."""
    by_exponent = found.jacobian / exponent_slopes(problem.parameters, vector)
    least = 1e-9 * float(found.signal.max(initial=0.0)) + np.finfo(np.float64).tiny
    scale = np.where(problem.are_energies(), np.maximum(found.signal, least), 1.0)
    return np.asarray(by_exponent / scale[:, None])


def _curvature(problem: BandProblem, slopes: FloatArray, vector: FloatArray) -> FloatArray:
    """Return the curvature of `Windows` from one more prediction an unknown."""
    out = np.empty((*slopes.shape, vector.size))
    for k in range(vector.size):
        moved = np.array(vector)
        moved[k] += _STEP
        step = exponents(problem.parameters, np.stack((vector, moved)))
        there = _signal_slopes(problem, problem.predict(moved), moved)
        out[:, :, k] = (there - slopes) / max(float(step[1, k] - step[0, k]), 1e-12)
    return 0.5 * (out + out.transpose(0, 2, 1))
