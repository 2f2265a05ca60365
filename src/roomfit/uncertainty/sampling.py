"""The density of a band's posterior, and a law near to it under which walks cost no evaluation.

Arrival times are integrated out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from roomfit.base.kernels import kernel
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.model.parameters import (
    GEOMETRY,
    Parameters,
    absorption_of,
    physical_values,
    position_of,
    prior_residuals,
)
from roomfit.model.problem import Objective, Prediction
from roomfit.solver import BandFit

# An absorption this near to 1 or 0 can no longer be distinguished from it.
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
    """

    objective: Objective
    centre: FloatArray  # (n_free,), the fit's answer
    n_kept: int  # entries of the free vector, from its beginning, whose density this is
    follow: FloatArray  # (n_free - n_kept, n_kept), by how much arrival times follow the exponents
    inner: FloatArray  # (n_free - n_kept, n_free - n_kept), their information, given the others
    flattening: float  # max(phi, 1)
    # a fit whose weights are kept: energies keep its shapes, all other data its variances
    fixed_weights: BandFit | None = None

    def __call__(self, kept: FloatArray) -> float:
        """Return the log density at kept numbers, shape (n_kept,); minus infinity far outside."""
        if not np.all(np.abs(kept) < FARTHEST_FREE):
            return -np.inf
        vector = np.concatenate((kept, self.ridge(kept)))
        with_slopes = self.inner.size > 0 or self.fixed_weights is None
        found_there = self.objective.predict(vector) if with_slopes else None
        expected = self.objective.expected(vector) if found_there is None else found_there.expected
        variance = self._variance(vector, expected)
        neighbours = self.objective.correlation_length()
        each = self.objective.log_likelihood(expected, variance)
        prior, rows = prior_residuals(self.objective.parameters, vector)
        found = float(np.sum(each / neighbours)) / self.flattening - 0.5 * float(prior @ prior)
        if self.inner.size and found_there is not None:
            spread = neighbours * variance * self.flattening
            off = (self.objective.measured() - expected) / spread
            slope = (found_there.jacobian.T @ off - rows.T @ prior)[self.n_kept :]
            found += 0.5 * float(slope @ np.linalg.solve(self.inner, slope))
        return found if np.isfinite(found) else -np.inf

    def _variance(self, vector: FloatArray, expected: FloatArray) -> FloatArray:
        if self.fixed_weights is None:
            return self.objective.variance(vector)
        energies, before = self.objective.is_gamma(), self.fixed_weights.expected
        grown = np.where(energies, expected / np.where(energies, before, 1.0), 1.0)
        return np.asarray(self.fixed_weights.variance * grown**2)

    def ridge(self, kept: FloatArray) -> FloatArray:
        """Return where arrival times follow kept numbers, shape (n_free - n_kept,)."""
        parameters, centre = self.objective.parameters, self.centre[: self.n_kept]
        here, there = exponents(parameters, np.stack((centre, kept)))
        return np.asarray(self.centre[self.n_kept :] + self.follow @ (there - here))


def log_posterior(objective: Objective, fit: BandFit) -> LogPosterior:
    """Return the posterior of all unknowns of a band but its arrival times."""
    parameters, flattening = objective.parameters, max(fit.chi2_reduced, 1.0)
    n = fit.vector.size
    timed = any(b.name == GEOMETRY for b in parameters.blocks)
    kept = position_of(parameters, GEOMETRY) if timed else n
    prior = prior_information(parameters, fit.vector)
    # the data are flattened, the prior is not
    whole = (fit.information - prior) / flattening + prior
    inner = whole[kept:, kept:]
    follow = -np.linalg.solve(inner, whole[kept:, :kept]) if kept < n else np.zeros((0, kept))
    follow = follow / exponent_slopes(parameters, fit.vector)[:kept]
    return LogPosterior(objective, fit.vector, kept, np.asarray(follow), inner, flattening)


def prior_information(parameters: Parameters, vector: FloatArray) -> FloatArray:
    """Return the information of the prior, shape (n_free, n_free)."""
    _, rows = prior_residuals(parameters, vector)
    return np.asarray(rows.T @ rows)


def absorption_columns(parameters: Parameters) -> tuple[int, IntArray]:
    """Return where the fitted absorptions begin, and which entries of their block they are."""
    block = absorption_of(parameters)
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
    block = absorption_of(parameters)
    low, high = block.lower[columns], block.upper[columns]
    # 1 - a, without rounding where a comes near to 1
    less = (1.0 - high) + (high - low) * 0.5 * (1.0 - np.tanh(0.5 * kept[:, own]))
    out[:, own] = -np.log(np.maximum(less, LEAST_REFLECTED))
    return out


class Windows(NamedTuple):
    """Data whose expectation without noise is known to second order in the exponents.

    Of energies its log, a sum over paths of exponentials of the exponents: the mean and the
    covariance of their counts of hits are its first two derivatives.
    """

    # measured, signal, noise: (n_data,), `signal` at the centre; `noise` is what is expected
    # besides
    measured: FloatArray
    signal: FloatArray
    noise: FloatArray
    # (n_data, n_kept), of the log of the signal by the exponents; of data that are no energies, of
    # the signal
    slopes: FloatArray
    curvature: FloatArray  # (n_data, n_kept, n_kept), second derivative of the same
    # (n_data,), of energies the shape of their Gamma law, else one over the variance; neighbours
    # that share information counted once, flattened by the misfit
    weight: FloatArray
    energies: BoolArray  # (n_data,)


class _Law(NamedTuple):
    """What a density of free numbers is made of, in the words of `Surrogate`."""

    farthest: float  # no free number may be farther from zero
    first: int  # where the absorptions begin, whose bounds are `low` and `high`
    low: FloatArray
    high: FloatArray
    # (n,) and (n, n)
    centre: FloatArray
    prior: FloatArray
    prior_mean: FloatArray
    data: FloatArray
    pull: FloatArray
    windows: Windows  # of no data where `data` and `pull` suffice


@kernel()
def walk_points(
    points: FloatArray,
    root: FloatArray,
    sizes: FloatArray,
    noise: FloatArray,
    chances: FloatArray,
    law: _Law,
) -> FloatArray:
    """Move points by Metropolis steps under a law and return what each has gained, (n_points,).

    Shapes: `points` (n_points, n), `root` (n, n), `sizes, chances, noise` (n_steps,), (n_steps,
    n_points), (n_steps, n_points, n).
    """
    n = points.shape[1]
    zero = np.empty(n)
    _exponents(law.centre, law.first, law.low, law.high, zero)
    gain = np.empty(len(points))
    here, trial, away = np.empty(n), np.empty(n), np.empty(n)
    for p in range(len(points)):
        here[:] = points[p]
        now = start = _log_density(here, away, zero, law)
        for s in range(len(sizes)):
            for i in range(n):
                step = 0.0
                for j in range(i + 1):  # a Cholesky root is zero above its diagonal
                    step += root[i, j] * noise[s, p, j]
                trial[i] = here[i] + sizes[s] * step
            there = _log_density(trial, away, zero, law)
            if chances[s, p] < there - now:  # false where both are minus infinity, whose gap is nan
                now = there
                here[:] = trial
        points[p] = here
        gain[p] = now - start
    return gain


@kernel()
def _exponents(
    kept: FloatArray, first: int, low: FloatArray, high: FloatArray, out: FloatArray
) -> None:
    """Fill in ``-log(1 - a)`` of absorptions, all other free numbers as they are."""
    out[:] = kept
    for i in range(len(low)):
        share = 0.5 * (1.0 - math.tanh(0.5 * kept[first + i]))
        less = (1.0 - high[i]) + (high[i] - low[i]) * share
        out[first + i] = -math.log(max(less, LEAST_REFLECTED))


@kernel()
def _log_density(kept: FloatArray, away: FloatArray, zero: FloatArray, law: _Law) -> float:
    """Return the log density of a `Surrogate` at one point, up to a constant; `away` is scratch.

    Minus infinity far outside, and where a window's likelihood is no number.
    """
    farthest, first, low, high, _, prior, prior_mean, data, pull, windows = law
    measured, signal, background, slopes, curvature, weight, energies = windows
    n = len(kept)
    for i in range(n):
        if not abs(kept[i]) < farthest:
            return -math.inf
    _exponents(kept, first, low, high, away)
    total = 0.0
    for i in range(n):
        away[i] -= zero[i]
        of_prior = 0.0
        for j in range(n):
            of_prior += prior[i, j] * (kept[j] - prior_mean[j])
        total -= 0.5 * (kept[i] - prior_mean[i]) * of_prior
    if len(measured) == 0:
        for i in range(n):
            of_data = 0.0
            for j in range(n):
                of_data += data[i, j] * away[j]
            total += away[i] * (pull[i] - 0.5 * of_data)
        return total
    for w in range(len(measured)):
        change = 0.0
        for i in range(n):
            bend = 0.0
            for j in range(n):
                bend += curvature[w, i, j] * away[j]
            change += away[i] * (slopes[w, i] + 0.5 * bend)
        if energies[w]:
            grown = signal[w] * math.exp(change) + background[w]
            total += weight[w] * (-math.log(grown) - measured[w] / grown)
        else:
            off = measured[w] - background[w] - signal[w] - change
            total -= 0.5 * weight[w] * off * off
    return total if math.isfinite(total) else -math.inf


# Of a free number, for second derivatives: large beside rounding, small beside what bends.
_STEP = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Surrogate:
    """A law near to a posterior, with the fit's curvature.

    A path's energy is linear in the exponents ``-log(1 - a)``, and in the logs of gains. Where the
    data are windows alone, the log of each window's energy is taken as quadratic in them. Where
    arrival times are integrated out, so that windows hang together, the whole log-likelihood is
    taken as quadratic in them. Only the prior is Gaussian in the logits; see
    `roomfit.uncertainty.posterior`.
    """

    parameters: Parameters
    centre: FloatArray  # (n_kept,)
    windows: Windows | None
    # (n_kept, n_kept), information of the data in the exponents; used without windows
    data: FloatArray
    # (n_kept,), slope of the data's log-likelihood at the centre; used without windows
    pull: FloatArray
    prior: FloatArray  # (n_kept, n_kept)
    prior_mean: FloatArray  # (n_kept,)
    covariance: FloatArray  # (n_kept, n_kept), of the free numbers, Gaussian at the centre

    @property
    def usual_steps(self) -> tuple[int, ...]:
        """Lengths of walks: a short one, and one that costs less than what it is weighed by.

        A random walk needs some 500 steps to forget its start under the skew laws of hard walls.
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
        # drawn whatever the point, so that each step stays reversible; small ones still move along
        # narrow ridges
        sizes = np.exp(rng.uniform(np.log(0.1), np.log(2.0), steps))
        here = np.array(points, dtype=np.float64, order="C")
        first, columns = absorption_columns(self.parameters)
        block = absorption_of(self.parameters)
        windows = self.windows
        if windows is None:
            none: FloatArray = np.zeros(0)
            no_curvature, no_flags = np.zeros((0, n, n)), np.zeros(0, dtype=np.bool_)
            windows = Windows(none, none, none, np.zeros((0, n)), no_curvature, none, no_flags)
        law = _Law(
            FARTHEST_FREE,
            first,
            np.array(block.lower[columns]),
            np.array(block.upper[columns]),
            np.array(self.centre),
            np.array(self.prior),
            np.array(self.prior_mean),
            np.array(self.data),
            np.array(self.pull),
            Windows._make(np.array(column) for column in windows),
        )
        gain = walk_points(
            here,
            root,
            sizes,
            rng.standard_normal((steps, *here.shape)),
            np.log(rng.random((steps, len(here)))),
            law,
        )
        return here, gain


def surrogate(posterior: LogPosterior, fit: BandFit, *, windows: bool = True) -> Surrogate:
    """Return the law that proposals for a band's posterior are drawn from.

    Without `windows` the log-likelihood as a whole is taken as quadratic, which costs no
    prediction.
    """
    parameters, n = posterior.objective.parameters, posterior.n_kept
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
        parameters,
        np.array(fit.vector[:n]),
        _windows(posterior, fit) if windows and not inner.size else None,
        data / np.outer(slope, slope),
        pull,
        prior,
        means,
        np.asarray(np.linalg.inv(free)),
    )


def _windows(posterior: LogPosterior, fit: BandFit) -> Windows:
    objective = posterior.objective
    found, energies = objective.predict(fit.vector), objective.is_gamma()
    count = objective.correlation_length() * posterior.flattening
    variance = np.maximum(fit.variance, np.where(energies, (1e-3 * fit.expected) ** 2, 0.0))
    slopes = _signal_slopes(objective, found, fit.vector)
    weight = np.where(energies, found.expected**2, 1.0) / (variance * count)
    return Windows(
        objective.measured(),
        found.signal,
        found.expected - found.signal,
        slopes,
        _curvature(objective, slopes, fit.vector),
        weight,
        energies,
    )


def _signal_slopes(objective: Objective, found: Prediction, vector: FloatArray) -> FloatArray:
    """Return the slopes of `Windows` at a point."""
    by_exponent = found.jacobian / exponent_slopes(objective.parameters, vector)
    least = 1e-9 * float(found.signal.max(initial=0.0)) + np.finfo(np.float64).tiny
    scale = np.where(objective.is_gamma(), np.maximum(found.signal, least), 1.0)
    return np.asarray(by_exponent / scale[:, None])


def _curvature(objective: Objective, slopes: FloatArray, vector: FloatArray) -> FloatArray:
    """Return the curvature of `Windows` from one more prediction an unknown."""
    out = np.empty((*slopes.shape, vector.size))
    for k in range(vector.size):
        moved = np.array(vector)
        moved[k] += _STEP
        step = exponents(objective.parameters, np.stack((vector, moved)))
        there = _signal_slopes(objective, objective.predict(moved), moved)
        out[:, :, k] = (there - slopes) / max(float(step[1, k] - step[0, k]), 1e-12)
    return 0.5 * (out + out.transpose(0, 2, 1))
