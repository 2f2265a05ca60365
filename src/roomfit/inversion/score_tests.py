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

from roomfit.bands import Bands
from roomfit.logit import expit, logit
from roomfit.materials.priors import MaterialPrior
from roomfit.measurement import MeasuredPair
from roomfit.objective.energy import EnergyTerm
from roomfit.objective.parameters import Parameters, prior_residuals
from roomfit.objective.problem import Prediction
from roomfit.signals.filters import filter_pressure
from roomfit.signals.response import times_s
from roomfit.solvers.least_squares import BandFit
from roomfit.typing import FloatArray

_FEWEST_BANDS = 2  # one value that all share


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
    """What the data ask of one more unknown, to first order."""

    value: float
    sd: float


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


def common(scores: FloatArray, information: FloatArray) -> Score:
    """Return the value that all bands have in common, with its standard deviation.

    Where bands scatter about it by more than they should, its standard deviation grows by as much
    [1]_: an error of the model differs from band to band, a chain does not.

    Parameters
    ----------
    scores, information : float arrays, shape (n_bands,)

    References
    ----------
    .. [1] R. T. Birge, "The calculation of errors by the method of least squares", Phys. Rev. 40,
           207-227 (1932).
    """
    value = float(scores.sum() / information.sum())
    scatter = float(np.sum(information * (scores / information - value) ** 2))
    ratio = max(scatter / max(len(scores) - 1, 1), 1.0)
    return Score(value, float(np.sqrt(ratio / information.sum())))


def _asked(fitted: Sequence[FittedWindows], relative: Sequence[FloatArray]) -> Score:
    """Return what all bands ask of one unknown, given its relative derivatives, (n_windows, 1)."""
    scores = []
    for w, own in zip(fitted, relative, strict=True):
        signal = w.there.signal[: len(own), None]
        scores.append([float(x.item()) for x in scored(w, signal * own)])
    return common(*np.array(scores).T)


class ChainScores(NamedTuple):
    """What all bands together ask of a chain that bends levels or decays."""

    power: Score  # exponent less 1
    loss: Score  # relative, at the peak
    window: Score  # decay rate of energy in 1/s
    decay_rate_per_s: float  # of energy, the median over the bands as measured
    bands: tuple[int, ...]  # those that were looked at


def chain_scores(bands: Bands, fitted: Sequence[FittedWindows]) -> ChainScores | None:
    """Return the scores of a power, a saturation and a window; None of fewer than two bands.

    Parameters
    ----------
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
    relative = [np.concatenate([slopes[w.band, i] for i in range(len(w.files))]) for w in fitted]
    power, loss, window = (_asked(fitted, [r[:, k : k + 1] for r in relative]) for k in range(3))
    rate_per_s = float(np.median([w.decay_rate_per_s for w in fitted]))
    return ChainScores(power, loss, window, rate_per_s, tuple(w.band for w in fitted))


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
        for w in fitted:
            own = float(np.clip(known[w.band], 1e-3, 1.0 - 1e-3))
            more, information = scored(w, own * (1.0 - own) * w.by_wall[:, [i]])
            if information[0, 0] <= 0.0:
                continue
            gains[w.band] = 0.5 * float(more[0] ** 2 / information[0, 0])
            step = float(np.clip(more[0] / information[0, 0], -3.0, 3.0))
            freed[w.band] = float(expit(logit(np.array([own])) + step)[0])
        found.append(FreedAbsorption(i, gains, freed))
    return tuple(found)
