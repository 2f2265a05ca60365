"""Score tests of a fit: nonlinearity of the measurement chain, windows, and fixed absorption.

Each is one more unknown that the fit does not have: the exponent of a compressor or an expander,
the saturation of a limiter or of clipping, the decay rate of a window that was left in the files,
the absorption of a material that the campaign fixes. How far the data ask for it follows from the
fit as it is, by the score test [1]_.

References
----------
.. [1] C. R. Rao, "Large sample tests of statistical hypotheses concerning several parameters",
       Proc. Cambridge Philos. Soc. 44, 50-57 (1948).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from roomfit.base.bands import Bands
from roomfit.base.logit import expit, logit
from roomfit.base.typing import FloatArray
from roomfit.materials.priors import MaterialPrior
from roomfit.model.energy import EnergyTerm
from roomfit.model.parameters import Parameters, prior_residuals
from roomfit.model.problem import Prediction
from roomfit.signals.filters import filter_pressure
from roomfit.signals.measurement import MeasuredPair
from roomfit.signals.response import times_s
from roomfit.solver.least_squares import BandFit

_FEWEST_BANDS = 2  # one value that all share
# Variance of a power, a loss and a window common to all bands in right rooms, in units of what the
# data leave: errors of the model that bands share (positions, patterns of interference) ask for
# them alike.
_COMMON_VARIANCE, _N_RIGHT_ROOMS = (3.6, 1.0, 3.0), 50


class FittedWindows(NamedTuple):
    """One band whose windows were fitted as pressures."""

    band: int
    parameters: Parameters
    there: Prediction  # of the fit, windows first
    by_wall: FloatArray  # (n_data, n_materials), by all absorptions; no rows where none is fixed
    neighbours: FloatArray  # (n_data,), how many share the information of each
    fit: BandFit
    energies: EnergyTerm  # the windows, for their edges and noise
    files: tuple[MeasuredPair, ...]  # one an observation
    shared: Mapping[str, FloatArray]  # (n_windows, n) each, errors of all windows, one sd a column
    decay_rate_per_s: float  # of energy, as measured


class Score(NamedTuple):
    """Score-test statistic of one additional parameter."""

    value: float
    sd: float
    n_free: float  # degrees of freedom of the standard deviation

    @property
    def gain(self) -> float:
        """Of the log-likelihood, if it is freed."""
        return 0.5 * (self.value / self.sd) ** 2


def scored(windows: FittedWindows, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the score of further unknowns at 0, and their information, all others fitted along.

    Parameters
    ----------
    columns : float array, shape (n, n_more)
        Derivative of the first n expected data by each of them.

    Returns
    -------
    score : float array, shape (n_more,)
    information : float array, shape (n_more, n_more)
        Its covariance where the model is right: the value of one unknown by itself is
        score / information, with the standard deviation information**-0.5.
    """
    fit, own = windows.fit, windows.there.jacobian
    # a misfit widens intervals, and makes further unknowns less certain by as much
    misfit = max(fit.chi2_reduced, 1.0)
    weight = 1.0 / (misfit * windows.neighbours * fit.variance)
    residual = fit.measured - fit.expected
    every = np.concatenate(list(windows.shared.values()), axis=1)
    shared, more = (np.zeros((residual.size, x.shape[1])) for x in (every, columns))
    shared[: len(every)] = every
    more[: len(columns)] = columns
    jacobian = np.concatenate((own, shared), axis=1)
    prior, rows = prior_residuals(windows.parameters, fit.vector)
    hessian = jacobian.T @ (weight[:, None] * jacobian)
    n = own.shape[1]
    hessian[:n, :n] += rows.T @ rows
    hessian[n:, n:] += np.eye(shared.shape[1])
    # what is left of the gradient: the last step is not taken to its end, nor for shared errors
    gradient = jacobian.T @ (weight * residual)
    gradient[:n] -= rows.T @ prior
    across = jacobian.T @ (weight[:, None] * more)
    solved = np.linalg.solve(hessian, np.column_stack((across, gradient)))
    score = more.T @ (weight * residual) - across.T @ solved[:, -1]
    information = more.T @ (weight[:, None] * more) - across.T @ solved[:, :-1]
    return np.asarray(score), np.asarray(information)


def chain_slopes(
    bands: Bands, m: MeasuredPair, edges_s: Sequence[FloatArray], peak: float
) -> list[FloatArray]:
    """Return how a chain changes the logarithm of each window's energy, a band after the other.

    By the exponent p of sign(x) abs(x / peak)**p at p = 1, where the derivative of the samples is
    x ln abs(x / peak); by the loss c at the peak of x (1 - c (x / peak)**2), the first term of any
    saturation; and by the rate of exp(-rate t) on the energy, where it is -t.

    Parameters
    ----------
    bands : Bands
        Of the edges.
    edges_s : sequence of float arrays, shape (n_windows + 1,)
    peak : float
        Of all files of a campaign.

    Returns
    -------
    list of float array, shape (n_windows, 3)
    """
    size = np.abs(m.response.pressure)
    logs = np.log(np.where(size > 0.0, size / peak, 1.0))
    changes = [
        filter_pressure(bands, replace(m.response, pressure=m.response.pressure * factor))
        for factor in (logs, -((size / peak) ** 2))
    ]
    rate_hz = m.response.sampling_rate_hz
    boundaries_s = np.append(times_s(m.response), times_s(m.response)[-1] + 1.0 / rate_hz)
    boundaries_s -= 0.5 / rate_hz
    out = []
    for pressure, by_power, by_loss, own_s in zip(
        filter_pressure(bands, m.response), *changes, edges_s, strict=True
    ):
        whole, *parts = (
            np.diff(np.interp(own_s, boundaries_s, np.append(0.0, np.cumsum(x))))
            for x in (pressure**2, 2.0 * pressure * by_power, 2.0 * pressure * by_loss)
        )
        relative = np.divide(parts, whole, out=np.zeros_like(parts), where=whole > 0.0)
        out.append(np.stack((*relative, -0.5 * (own_s[1:] + own_s[:-1])), axis=1))
    return out


def common(scores: FloatArray, information: FloatArray, variance: float = 1.0) -> Score:
    """Return the value that all bands have in common, with its standard deviation.

    Where bands scatter about it by more than they should, the variance grows by as much [1]_: an
    error of the model differs from band to band, a chain does not. What is known from right rooms
    and what few bands scatter have a few degrees of freedom together [2]_.

    Parameters
    ----------
    scores, information : float arrays, shape (n_bands,)
    variance : float
        Of a common value in right rooms, in units of the inverse information.

    References
    ----------
    .. [1] R. T. Birge, "The calculation of errors by the method of least squares", Phys. Rev. 40,
           207-227 (1932).
    .. [2] F. E. Satterthwaite, "An approximate distribution of estimates of variance components",
           Biometrics Bull. 2, 110-114 (1946).
    """
    n_scatter = max(len(scores) - 1, 1)
    value = float(scores.sum() / information.sum())
    scatter = float(np.sum(information * (scores / information - value) ** 2))
    more = max(scatter / n_scatter - 1.0, 0.0)
    n_free = (variance + more) ** 2 / (variance**2 / _N_RIGHT_ROOMS + more**2 / n_scatter)
    return Score(value, float(np.sqrt((variance + more) / information.sum())), n_free)


class ChainScores(NamedTuple):
    """What all bands together ask of a chain that bends levels or decays."""

    # of a power (exponent less 1), a loss (relative, at the peak), a window (energy, in 1/s)
    alone: tuple[Score, ...]
    decay_rate_per_s: float  # of energy, the median over the bands as measured
    bands: tuple[int, ...]  # those that were looked at
    # the same with all fixed absorptions freed; empty where none is fixed
    beside_freed: tuple[Score, ...] = ()


def chain_scores(
    bands: Bands, priors: Sequence[MaterialPrior], fitted: Sequence[FittedWindows]
) -> ChainScores | None:
    """Return the scores of a power, a saturation and a window; None of fewer than two bands.

    Parameters
    ----------
    priors : sequence of MaterialPrior
        A fixed absorption that is wrong bends levels and decays as a chain does.
    fitted : sequence of FittedWindows
        Bands in which pressures explain the data better than energies: where energies add, how
        far smooth walls' late sound lies below their sum is not known well enough.
    """
    if len(fitted) < _FEWEST_BANDS:
        return None
    peak = max(float(np.abs(m.response.pressure).max()) for w in fitted for m in w.files)
    slopes: dict[tuple[int, int], FloatArray] = {}
    for m in dict.fromkeys(m for w in fitted for m in w.files):
        reached = [w for w in fitted if m in w.files]
        chosen = Bands(bands.kind, bands.centres_hz[[w.band for w in reached]])
        edges_s = [w.energies.observations[w.files.index(m)].edges_s for w in reached]
        for w, own in zip(reached, chain_slopes(chosen, m, edges_s, peak), strict=True):
            slopes[w.band, w.files.index(m)] = own
    alone, beside = [], []
    for w in fitted:
        relative = np.concatenate([slopes[w.band, i] for i in range(len(w.files))])
        columns = w.there.signal[: len(relative), None] * relative
        alone.append(scored(w, columns))
        beside.append(_beside(w, columns, priors))
    return ChainScores(
        _common_to_bands(alone),
        float(np.median([w.decay_rate_per_s for w in fitted])),
        tuple(w.band for w in fitted),
        _common_to_bands(beside) if any(p.known is not None for p in priors) else (),
    )


def _common_to_bands(found: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[Score, ...]:
    """Return the common value of each of three unknowns by itself."""
    scores = np.array([score for score, _ in found])
    information = np.array([np.diag(i) for _, i in found])
    return tuple(
        common(scores[:, k], information[:, k], variance)
        for k, variance in enumerate(_COMMON_VARIANCE)
    )


def _beside(
    windows: FittedWindows, columns: FloatArray, priors: Sequence[MaterialPrior]
) -> tuple[FloatArray, FloatArray]:
    """Return score and information of further unknowns, all fixed absorptions freed."""
    walls = [i for i, p in enumerate(priors) if p.known is not None]
    rows: FloatArray = np.zeros((max(len(columns), len(windows.by_wall)), columns.shape[1]))
    rows[: len(columns)] = columns
    freed = np.zeros((len(rows), len(walls)))
    freed[: len(windows.by_wall)] = windows.by_wall[:, walls]
    score, information = scored(windows, np.concatenate((rows, freed), axis=1))
    n = columns.shape[1]
    # a wall that no window hears has no information
    solved = information[:n, n:] @ np.linalg.pinv(information[n:, n:], hermitian=True)
    return score[:n] - solved @ score[n:], information[:n, :n] - solved @ information[n:, :n]


class FreedAbsorption(NamedTuple):
    """What bands gain if the fixed absorption of one material is freed, to first order."""

    material: int
    gains: dict[int, float]  # by band, of the log-likelihood
    absorption: dict[int, float]  # by band, if freed


def freed_absorptions(
    priors: tuple[MaterialPrior, ...], fitted: Sequence[FittedWindows]
) -> tuple[FreedAbsorption, ...]:
    """Return what freeing each fixed material gains; bands that do not hear it are left out."""
    found = []
    for i, prior in enumerate(priors):
        known, gains, freed = prior.known, dict[int, float](), dict[int, float]()
        if known is None:
            continue
        least = 1e-3 if prior.object_volume_m3 is None else 1e-6  # of a step past an object
        for w in fitted:
            own = float(np.clip(known[w.band], least, 1.0 - 1e-3))
            more, information = scored(w, own * (1.0 - own) * w.by_wall[:, [i]])
            if information[0, 0] <= 0.0:
                continue
            gains[w.band] = 0.5 * float(more[0] ** 2 / information[0, 0])
            step = float(np.clip(more[0] / information[0, 0], -3.0, 3.0))
            freed[w.band] = float(expit(logit(np.array([own])) + step)[0])
        found.append(FreedAbsorption(i, gains, freed))
    return tuple(found)
