"""Intervals that know how few rays made the model: a jackknife over their batches.

A ray that stays between hard walls is caught again and again, by all receivers and at every later
time, and weighs in all bands alike. Variances of single windows know how far each of them may be
off, and not that all are off together. Batches of rays are independent traces: leaving one out
moves the answer by what its energies, weighed as the data are, say of the unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roomfit.identification.reweighted import BandFit
from roomfit.objective.energy_problem import EnergyProblem
from roomfit.objective.parameters import Parameters, physical_values
from roomfit.objective.problem import BandProblem
from roomfit.objective.window_kernels import in_windows
from roomfit.response.energy import batch_energies
from roomfit.typing import FloatArray
from roomfit.uncertainty.shared_errors import allowing_for, answer_steps


def with_tracing_noise(
    problem: BandProblem, energies: EnergyProblem, sources: Sequence[int], fit: BandFit
) -> BandFit:
    """Return a fit whose information allows for the Monte-Carlo noise that windows share.

    The spread of the answer's steps (`roomfit.uncertainty.shared_errors.answer_steps`) over the
    batches of rays [1]_ is added to the covariance.

    Parameters
    ----------
    problem : BandProblem
        What was fitted; the windows of `energies` are its first data.
    energies : EnergyProblem
    sources : sequence of int
        Source of each observation: rays of one are heard by all of its receivers.
    fit : BandFit

    References
    ----------
    .. [1] B. Efron, "The Jackknife, the Bootstrap and Other Resampling Plans", SIAM (1982),
           section 3: the delete-one variance of an estimate, here linearised.
    """
    spread = batch_spread(energies, problem.parameters, fit.vector, sources)
    if not spread.size:
        return fit
    return allowing_for(fit, answer_steps(problem, fit, spread))


def batch_spread(
    energies: EnergyProblem, parameters: Parameters, vector: FloatArray, sources: Sequence[int]
) -> FloatArray:
    """Return vectors whose outer products add up to the covariance of the traced energies.

    Returns
    -------
    float array, shape (n_windows, n_sources * n_batches)
        Without columns where there are no rays, or fewer than two batches of them.
    """
    values, _ = physical_values(parameters, vector)
    gains = np.append(values["gain"], 1.0)
    n_batches = min((rows.n_batches for rows in energies.rows), default=0)
    names = list(dict.fromkeys(sources))
    n_windows = sum(o.energy.size for o in energies.observations)
    if n_batches < 2 or not any(np.any(rows.batch >= 0) for rows in energies.rows):
        return np.zeros((n_windows, 0))
    out: FloatArray = np.zeros((n_windows, len(names), n_batches))
    first = 0
    for rows, seen, source in zip(energies.rows, energies.observations, sources, strict=True):
        batches = batch_energies(
            rows, values["absorption"][:, None], np.array([energies.attenuation_per_m])
        )[:, 0, :]
        windows = gains[seen.gain] * in_windows(seen.shares, batches)
        last = first + seen.energy.size
        out[first:last, names.index(source)] = windows - windows.mean(axis=1, keepdims=True)
        first = last
    return np.asarray(out.reshape(n_windows, -1) * np.sqrt(n_batches / (n_batches - 1.0)))
