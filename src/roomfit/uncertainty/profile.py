"""Profile likelihood of one free number, all others fitted anew."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from roomfit.base.logit import Z95
from roomfit.base.typing import FloatArray
from roomfit.model.parameters import (
    Parameters,
    absorption_of,
    position_of,
    prior_residuals,
    to_physical,
)
from roomfit.model.problem import Objective, Prediction
from roomfit.solver import BandFit, MarquardtSettings, levenberg_marquardt

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
# A gain of this much by following is worth a second look at the point, so many times at most.
_FAR_FROM_FOLLOWING = 0.3
_MOST_CORRECTIONS = 8
# A step that is free of evaluations may be as long as energies stay numbers.
_LARGEST_LOG = 100.0
_FOLLOWING = MarquardtSettings(max_trials=30, longest_entry=3.0, gain=0.01)


class Profile(NamedTuple):
    """How far one unknown can go, all others re-fitted."""

    lower: float  # free number at which the cost has risen by 1.92, misfit taken out
    upper: float
    gaussian: bool  # whether the Gaussian interval was good enough; then its ends are these
    evaluations: int


def profile(
    objective: Objective, fit: BandFit, entry: int, answer: Prediction | None = None
) -> Profile:
    """Return how far one free number can go while all others follow, weights kept.

    First the cost is computed at the two ends of the Gaussian interval. Where it rises there by
    what a Gaussian promises, within a fifth, these ends are kept. Otherwise they are moved until it
    rises by 1.92 [1]_. Others follow along the fit's own curvature, and what one Newton step would
    still gain is taken off; where that is much, the step is made.

    References
    ----------
    .. [1] D. J. Venzon, S. H. Moolgavkar, "A method for computing profile-likelihood-based
           confidence intervals", Appl. Stat. 37, 87-94 (1988).
    """
    line = _Line(objective, fit, entry, objective.predict(fit.vector) if answer is None else answer)
    ends: list[float] = []
    found_bent = False
    for sign in (-1.0, 1.0):
        here = Z95 * line.sd
        rise, slope = line.rise(sign * here)
        if abs(rise / RISE95 - 1.0) > _GAUSSIAN_ENOUGH:
            found_bent = True
            bracket = [(0.0, 0.0, np.sqrt(0.5) / line.sd), (np.inf, np.inf, 0.0)]
            here, is_end = line.towards_end(sign, here, rise, slope, bracket)
            for _ in range(_MOST_POINTS - 1):
                if is_end:
                    break
                rise, slope = line.rise(sign * here)
                here, is_end = line.towards_end(sign, here, rise, slope, bracket)
        ends.append(sign * here)
    centre = float(fit.vector[entry])
    return Profile(centre + ends[0], centre + ends[1], not found_bent, line.evaluations)


def may_be_bent(fit: BandFit, entry: int) -> bool:
    """Whether a free number's posterior is so wide that it need not be Gaussian."""
    variance = np.linalg.inv(fit.information)[entry, entry] * max(fit.chi2_reduced, 1.0)
    return bool(np.sqrt(variance) > _NARROW)


class _Point(NamedTuple):
    """The cost at one point of a line, and its second-order expansion in all free numbers."""

    vector: FloatArray  # (n_free,)
    prediction: Prediction
    cost: float
    gradient: FloatArray  # (n_free,)
    hessian: FloatArray  # (n_free, n_free), Gauss and Newton's


class _Line:
    """The cost along one free number, and where it was computed."""

    def __init__(self, objective: Objective, fit: BandFit, entry: int, answer: Prediction) -> None:
        self.objective, self.fit, self.entry = objective, fit, entry
        self.others = np.flatnonzero(np.arange(fit.vector.size) != entry)
        self.weight = 1.0 / (objective.correlation_length() * fit.variance)
        self.energies = objective.is_gamma()
        kinds = [b.name for b in objective.parameters.blocks for _ in range(int(b.fitted.sum()))]
        self.factors = np.flatnonzero(np.isin(kinds, ("absorption", "gain")))
        self.flattening = max(fit.chi2_reduced, 1.0)
        at_answer = _Point(
            np.array(fit.vector), answer, fit.cost, np.zeros(fit.vector.size), fit.information
        )
        _, _, curvature = self._followed(at_answer)
        self.sd = float(np.sqrt(self.flattening / curvature))
        self.moves, self.points, self.evaluations = [0.0], [at_answer], 0

    def rise(self, move: float) -> tuple[float, float]:
        """Return the re-fitted cost at a distance, above that of the answer, and its slope.

        Followed from the nearest point towards the answer: others may have a second minimum, which
        is entered from farther out.
        """
        nearest = max(
            (i for i, m in enumerate(self.moves) if m * move >= 0.0 and abs(m) < abs(move)),
            key=lambda i: abs(self.moves[i]),
        )
        predict = self.objective.predict
        there = self._guess(self.points[nearest], move - self.moves[nearest])
        point = self._point(there, predict(there))
        for _ in range(_MOST_CORRECTIONS):
            if self._followed(point)[0] <= _FAR_FROM_FOLLOWING * self.flattening:
                break
            there = self._guess(point, 0.0)
            better = self._point(there, predict(there))
            if better.cost >= point.cost:
                there = point.vector + 0.3 * (there - point.vector)
                better = self._point(there, predict(there))
            if better.cost >= point.cost:
                break
            point = better
        gain, slope, _ = self._followed(point)
        rise = (point.cost - gain - self.fit.cost) / self.flattening
        self.moves.append(move)
        self.points.append(point)
        return rise, slope / self.flattening

    def towards_end(
        self, sign: float, here: float, rise: float, slope: float, bracket: _Bracket
    ) -> tuple[float, bool]:
        """Return a distance nearer to where the rise is 1.92, and whether that is near enough.

        By its root, which is nearly straight, and its slope; `bracket` is narrowed.
        """
        aim = float(np.sqrt(RISE95))
        far = max(_FARTHEST - sign * float(self.fit.vector[self.entry]), 1e-3)
        root = float(np.sqrt(max(rise, 0.0)))
        # a root that hardly rises says little of where it will
        steep = max(sign * slope / max(2.0 * root, 1e-12), 0.25 * aim / (Z95 * self.sd))
        if abs(rise / RISE95 - 1.0) < _NEAR:
            return min(here + (aim - root) / steep, far), True
        bracket[0 if root < aim else 1] = (here, root, steep)
        inside, outside = bracket
        if np.isfinite(outside[0]):
            here = _between(inside, outside, aim)
            alike = max(_ALIKE, _ALIKE_SHARE * self._apart(0.0, sign * outside[0]))
            is_end = self._apart(sign * inside[0], sign * outside[0]) < alike
        else:
            here += min((aim - root) / steep, Z95 * self.sd)
            is_end = False
        return min(here, far), is_end or here >= far

    def _apart(self, one: float, other: float) -> float:
        at = float(self.fit.vector[self.entry])
        return 0.5 * abs(float(np.tanh(0.5 * (at + one)) - np.tanh(0.5 * (at + other))))

    def _guess(self, point: _Point, by: float) -> FloatArray:
        """Return where the cost is least around a point, the own number so far away from there.

        If energies were exponentials of absorptions and log gains, and linear in all else: they are
        of hits that follow Poisson's distribution, and far nearer to it than to straight lines.
        """
        parameters, others, factors = self.objective.parameters, self.others, self.factors
        start = np.array(point.vector)
        start[self.entry] += by
        prediction, root = point.prediction, np.sqrt(self.weight)
        signal = np.maximum(prediction.signal, np.finfo(np.float64).tiny)
        base = np.where(self.energies, signal, 1.0)
        at, slope = _absorptions(parameters, point.vector)
        logs = prediction.jacobian[:, factors] / slope[factors] / base[:, None]
        linear = np.array(prediction.jacobian)
        linear[:, factors] = 0.0

        def residuals(free: FloatArray) -> tuple[FloatArray, FloatArray]:
            vector = np.array(start)
            vector[others] = free
            there, slope = _absorptions(parameters, vector)
            change = logs @ (there - at)[factors]
            grown = np.where(self.energies, np.exp(np.minimum(change, _LARGEST_LOG)), 1.0 + change)
            expected = prediction.expected + base * (grown - 1.0) + linear @ (there - at)
            jacobian = np.array(linear)
            rate = base * np.where(self.energies, grown, 1.0)
            jacobian[:, factors] = rate[:, None] * logs * slope[factors]
            prior, rows = prior_residuals(parameters, vector)
            off = np.concatenate((root * (self.objective.measured() - expected), prior))
            return off, np.concatenate((-root[:, None] * jacobian, rows))[:, others]

        start[others] = levenberg_marquardt(residuals, start[others], _FOLLOWING).x
        return start

    def _followed(self, point: _Point) -> tuple[float, float, float]:
        """Return what a Newton step of the others would gain, and slope and curvature after it."""
        others, entry = self.others, self.entry
        cross, uphill = point.hessian[others, entry], point.gradient[others]
        solved = np.linalg.solve(
            point.hessian[np.ix_(others, others)], np.stack((uphill, cross), axis=1)
        )
        slope = point.gradient[entry] - cross @ solved[:, 0]
        curvature = point.hessian[entry, entry] - cross @ solved[:, 1]
        return 0.5 * float(uphill @ solved[:, 0]), float(slope), float(curvature)

    def _point(self, vector: FloatArray, prediction: Prediction) -> _Point:
        self.evaluations += 1
        prior, rows = prior_residuals(self.objective.parameters, vector)
        off, jacobian = self.objective.measured() - prediction.expected, prediction.jacobian
        weighted = self.weight[:, None] * jacobian
        return _Point(
            vector,
            prediction,
            0.5 * float(off @ (self.weight * off) + prior @ prior),
            rows.T @ prior - weighted.T @ off,
            jacobian.T @ weighted + rows.T @ rows,
        )


_Bracket: TypeAlias = list[tuple[float, float, float]]
"""Two points about an interval's end: distance from the answer, root of the rise, its slope."""


def _between(
    inside: tuple[float, float, float], outside: tuple[float, float, float], aim: float
) -> float:
    """Return where a rising cubic through two points, (x, y, slope), has a height; not at an end.

    Slopes are limited to three times that of the chord, so that it rises [1]_.

    References
    ----------
    .. [1] F. N. Fritsch, R. E. Carlson, "Monotone piecewise cubic interpolation", SIAM J. Numer.
           Anal. 17, 238-246 (1980).
    """
    (x0, y0, d0), (x1, y1, d1) = inside, outside
    chord, x, t = (y1 - y0) / (x1 - x0), np.linspace(x0, x1, 101), np.linspace(0.0, 1.0, 101)
    d0, d1 = min(d0, 3.0 * chord) - chord, min(d1, 3.0 * chord) - chord
    y = y0 + (x - x0) * (chord + (1.0 - t) * ((1.0 - t) * d0 - t * d1))
    return float(np.interp(aim, y, x, left=x[5], right=x[-6]).clip(x[5], x[-6]))


def _absorptions(parameters: Parameters, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a free vector with absorptions instead of their logits, and its derivative."""
    block, first = absorption_of(parameters), position_of(parameters, "absorption")
    own = slice(first, first + int(block.fitted.sum()))
    free = np.zeros(block.fitted.size)
    free[block.fitted] = vector[own]
    values, slopes = to_physical(block, free)
    out, slope = np.array(vector), np.ones(vector.size)
    out[own], slope[own] = values[block.fitted], np.maximum(slopes[block.fitted], 1e-12)
    return out, slope
