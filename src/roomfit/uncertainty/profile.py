"""Profile likelihood of one free number, all others fitted anew."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from roomfit.logit import Z95
from roomfit.objective.parameters import prior_residuals
from roomfit.objective.problem import Objective, Prediction
from roomfit.solvers.least_squares import BandFit
from roomfit.typing import FloatArray

# Rise of half the weighted squares at the end of a 95 % interval: half of chi-square's 3.84.
RISE95 = 0.5 * Z95**2
# A Gaussian whose rise at its own ends is within this of what it promises is kept: its interval
# would change by less than a tenth.
_GAUSSIAN_ENOUGH = 0.2
# A straight posterior standard deviation below this has no room to bend.
_NARROW = 0.3
_MOST_POINTS = 6
# Of the rise: an end is found when it is this near, 4 % of half an interval.
_NEAR = 0.08
# Ends within this of each other, as the absorption of a logit, need not be distinguished; nor
# within this share of the whole side.
_ALIKE, _ALIKE_SHARE = 0.004, 0.03
# Logits beyond differ by less than a millionth in absorption.
_FARTHEST = 14.0
# A gain of this much by following is worth a second look at the point.
_FAR_FROM_FOLLOWING = 1.0
# Of a free number, a logit or a logarithm: where it is undetermined a step has no limit.
_LONGEST_STEP = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """The cost along one unknown, all others re-fitted at every point."""

    entry: int  # of the free vector
    # (n_points,), free numbers at which it was computed, rising; the answer is among them
    points: FloatArray
    # (n_points,), cost above that of the answer, misfit taken out: 1.92 at the end of a 95 %
    # interval
    rise: FloatArray
    # lower, upper: free numbers at which the rise is 1.92
    lower: float
    upper: float
    gaussian: bool  # whether the Gaussian interval was good enough; then its ends are these
    evaluations: int


def profile(objective: Objective, fit: BandFit, entry: int) -> Profile:
    """Return how far one free number can go while all others follow, weights kept.

    First the cost is computed at the two ends of the Gaussian interval. Where it rises there by
    what a Gaussian promises, within a fifth, these ends are kept. Otherwise they are moved until it
    rises by 1.92 [1]_. Others follow along the fit's own curvature, and what one Newton step would
    still gain is taken off; where that is much, the step is made.

    Parameters
    ----------
    fit : BandFit
        Its answer; its weights are kept.
    entry : int
        Of the free vector.

    References
    ----------
    .. [1] D. J. Venzon, S. H. Moolgavkar, "A method for computing profile-likelihood-based
           confidence intervals", Appl. Stat. 37, 87-94 (1988).
    """
    line = _Line(objective, fit, entry)
    sd = line.sd
    ends: list[float] = []
    found_bent = False
    for sign in (-1.0, 1.0):
        there = sign * Z95 * sd
        off = line.rise(there) / RISE95 - 1.0
        if abs(off) > _GAUSSIAN_ENOUGH:
            found_bent = True
            there = line.end(sign, there)
        ends.append(there)
    order = np.argsort(line.moves)
    centre = float(fit.vector[entry])
    return Profile(
        entry,
        centre + np.array(line.moves)[order],
        np.array(line.rises)[order],
        centre + ends[0],
        centre + ends[1],
        not found_bent,
        line.evaluations,
    )


def may_be_bent(fit: BandFit, entry: int) -> bool:
    """Whether a free number's posterior is so wide that it need not be Gaussian."""
    variance = np.linalg.inv(fit.information)[entry, entry] * max(fit.chi2_reduced, 1.0)
    return bool(np.sqrt(variance) > _NARROW)


class _Line:
    """The cost along one free number, and where it was computed."""

    def __init__(self, objective: Objective, fit: BandFit, entry: int) -> None:
        self.objective, self.fit, self.entry = objective, fit, entry
        self.others = np.flatnonzero(np.arange(fit.vector.size) != entry)
        self.weight = 1.0 / (objective.correlation_length() * fit.variance)
        self.flattening = max(fit.chi2_reduced, 1.0)
        information = fit.information
        self.inner = information[np.ix_(self.others, self.others)]
        self.follow = -np.linalg.solve(self.inner, information[self.others, entry])
        schur = information[entry, entry] + information[entry, self.others] @ self.follow
        self.sd = float(np.sqrt(self.flattening / schur))
        self.moves, self.rises = [0.0], [0.0]
        self.vectors: list[FloatArray] = [np.array(fit.vector)]
        self.evaluations = 0

    def rise(self, move: float) -> float:
        """Return the re-fitted cost at a distance from the answer, above that of the answer."""
        vector = self._guess(move)
        cost, gain, step = self._evaluated(self.objective.predict(vector), vector)
        if gain > _FAR_FROM_FOLLOWING * self.flattening:
            trial = np.array(vector)
            trial[self.others] += _no_farther(step)
            there, more, _ = self._evaluated(self.objective.predict(trial), trial)
            if there < cost:
                vector, cost, gain = trial, there, more
        rise = (cost - gain - self.fit.cost) / self.flattening
        self.moves.append(move)
        self.rises.append(rise)
        self.vectors.append(vector)
        return rise

    def end(self, sign: float, first: float) -> float:
        """Return where the rise is 1.92, by secants of its root, which is nearly straight."""
        points = [(0.0, 0.0), (first, self._root(self.rises[-1]))]
        aim = self._root(RISE95)
        far = abs(self._limit(sign))
        here = first
        for _ in range(_MOST_POINTS):
            below = [p for p in points if p[1] < aim]
            above = [p for p in points if p[1] >= aim]
            low = max(below, key=lambda p: abs(p[0]))
            if above:
                high = min(above, key=lambda p: abs(p[0]))
                share = (aim - low[1]) / max(high[1] - low[1], 1e-12)
                here = low[0] + min(max(share, 0.1), 0.9) * (high[0] - low[0])
            else:
                slope = max(low[1] / max(abs(low[0]), 1e-12), 0.25 * aim / (Z95 * self.sd))
                step = min(max((aim - low[1]) / slope, 0.1 * self.sd), 2.0 * Z95 * self.sd)
                here = low[0] + sign * step
            if abs(here) >= far:
                return sign * far
            if above:
                alike = max(_ALIKE, _ALIKE_SHARE * self._apart(0.0, high[0]))
                if self._apart(low[0], high[0]) < alike:
                    return here
            rise = self.rise(here)
            if abs(rise / RISE95 - 1.0) < _NEAR:
                return here
            points.append((here, self._root(rise)))
        return self._between(points, aim)

    def _between(self, points: list[tuple[float, float]], aim: float) -> float:
        low = max((p for p in points if p[1] < aim), key=lambda p: abs(p[0]))
        above = [p for p in points if p[1] >= aim]
        if not above:
            return low[0]
        high = min(above, key=lambda p: abs(p[0]))
        return low[0] + (aim - low[1]) / max(high[1] - low[1], 1e-12) * (high[0] - low[0])

    def _apart(self, one: float, other: float) -> float:
        at = float(self.fit.vector[self.entry])
        return 0.5 * abs(float(np.tanh(0.5 * (at + one)) - np.tanh(0.5 * (at + other))))

    def _root(self, rise: float) -> float:
        return float(np.sqrt(max(rise, 0.0)))

    def _limit(self, sign: float) -> float:
        return max(_FARTHEST - sign * float(self.fit.vector[self.entry]), 1e-3)

    def _guess(self, move: float) -> FloatArray:
        """Return the point from the nearest one that was fitted, others following from there."""
        nearest = int(np.argmin([abs(m - move) for m in self.moves]))
        vector = np.array(self.vectors[nearest])
        by = move - self.moves[nearest]
        vector[self.entry] += by
        vector[self.others] += _no_farther(by * self.follow)
        return vector

    def _evaluated(
        self, prediction: Prediction, vector: FloatArray
    ) -> tuple[float, float, FloatArray]:
        """Return cost, what a Newton step of the others would still gain, and that step."""
        self.evaluations += 1
        prior, rows = prior_residuals(self.objective.parameters, vector)
        off = self.objective.measured() - prediction.expected
        cost = 0.5 * float(off @ (self.weight * off) + prior @ prior)
        jacobian = prediction.jacobian[:, self.others]
        downhill = jacobian.T @ (self.weight * off) - rows[:, self.others].T @ prior
        hessian = jacobian.T @ (self.weight[:, None] * jacobian)
        hessian += rows[:, self.others].T @ rows[:, self.others]
        step = np.linalg.solve(hessian, downhill)
        return cost, 0.5 * float(downhill @ step), np.asarray(step, dtype=np.float64)


def _no_farther(step: FloatArray) -> FloatArray:
    """Return a step shortened to where a Newton step may still mean something."""
    return step * min(1.0, _LONGEST_STEP / max(float(np.abs(step).max(initial=0.0)), 1e-300))


def profile_curve(found: Profile, n_points: int = 200) -> tuple[FloatArray, FloatArray]:
    """Return free numbers and rises of a smooth curve through the points of a profile.

    The signed root of the rise, straight where the likelihood is Gaussian, is interpolated
    without overshooting.

    Returns
    -------
    free, rise : float arrays, shape (n_points,)
    """
    rise = np.maximum(found.rise, 0.0)
    bottom = int(np.argmin(rise))
    root = np.sqrt(rise) * np.where(np.arange(rise.size) < bottom, -1.0, 1.0)
    free = np.linspace(found.points[0], found.points[-1], n_points)
    points, first = np.unique(found.points, return_index=True)
    return free, np.asarray(PchipInterpolator(points, root[first])(free) ** 2)


_N_POINTS = 2001
# Beyond its points a profile goes on as straight as between its last two, so many times as far.
_BEYOND = 3.0


def profile_under(
    found: Profile, sides: tuple[float, float], mean: float, information: float
) -> tuple[float, float]:
    """Return the ends of a 95 % interval by a profile and a Gaussian of the same number.

    The profile's rise and the Gaussian's half square are added; the ends are where the sum has
    risen by 1.92 from its lowest. Exact for one unknown; of several it takes what the others
    determine of this one for Gaussian.

    Parameters
    ----------
    sides : tuple of two floats
        Lengths below and above the profile's centre that its interval has by now; the curve is
        stretched to them.
    mean, information : float
        Of the Gaussian, in the profile's free number; an information of 0: none.

    Returns
    -------
    lower, upper : float
        Free numbers.
    """
    free, rise = profile_curve(found, _N_POINTS)
    centre = float(free[int(np.argmin(rise))])
    below = sides[0] / max(centre - found.lower, 1e-12)
    above = sides[1] / max(found.upper - centre, 1e-12)
    away = free - centre
    x = centre + np.where(away < 0.0, below, above) * away
    reach = _BEYOND * (sides[0] + sides[1])
    grid = np.linspace(x[0] - reach, x[-1] + reach, 4 * _N_POINTS)
    root = np.sqrt(np.maximum(rise, 0.0)) * np.where(away < 0.0, -1.0, 1.0)
    whole = _carried_on(grid, x, root) ** 2 + 0.5 * information * (grid - mean) ** 2
    inside = np.flatnonzero(whole - whole.min() <= RISE95)
    return float(grid[inside[0]]), float(grid[inside[-1]])


def _carried_on(grid: FloatArray, x: FloatArray, root: FloatArray) -> FloatArray:
    """Return a line through points, straight on beyond both of its ends."""
    inner = np.interp(grid, x, root)
    first = (root[1] - root[0]) / max(x[1] - x[0], 1e-12)
    last = (root[-1] - root[-2]) / max(x[-1] - x[-2], 1e-12)
    inner = np.where(grid < x[0], root[0] + first * (grid - x[0]), inner)
    return np.asarray(np.where(grid > x[-1], root[-1] + last * (grid - x[-1]), inner))
