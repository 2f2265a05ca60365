"""What all windows of a band share beyond the noise of the rays: air, and lost coherence."""

from __future__ import annotations

import numpy as np

from roomfit.air import Air, pressure_decay_per_m, speed_of_sound_m_s
from roomfit.app.coherent.answers import ABOVE, BELOW
from roomfit.app.coherent.bands import CoherentBand
from roomfit.app.directing.unknown import made_directed
from roomfit.bands import Bands, steps_per_octave
from roomfit.identification.reweighted import BandFit
from roomfit.objective.coherent_problem import fully_coherent
from roomfit.objective.energy_problem import EnergyProblem
from roomfit.objective.problem import BandProblem
from roomfit.typing import FloatArray
from roomfit.uncertainty.shared_errors import answer_steps

# Long enough for many independent values of eight files, short enough to follow a decay.
_SLOT_S = 0.04


def shared_steps(
    problem: BandProblem,
    fit: BandFit,
    energies: EnergyProblem,
    air: FloatArray,
    coherent: CoherentBand | None = None,
) -> FloatArray:
    """Return how far the answer is moved by errors that all windows share, (n_free, n_errors).

    Each column is one standard deviation, by the air's attenuation, which changes within a band,
    and by reflections that interfere and are taken for energies that add.

    Parameters
    ----------
    problem : BandProblem
        What was fitted; the windows of `energies` are its first data.
    fit : BandFit
    energies : EnergyProblem
    air : float array, shape (n_windows,)
        See `air_error`; at a gain of 1.
    coherent : CoherentBand, optional
        The band with pressures, where these were fitted.
    """
    noise = np.concatenate([o.noise for o in energies.observations])
    signal = fit.expected[: noise.size] - noise
    columns = [signal * air]
    if coherent is not None:
        columns.append(signal * lost_coherence(coherent, fit))
    return answer_steps(problem, fit, np.stack(columns, axis=1))


def air_error(air: Air, bands: Bands, band: int, energies: EnergyProblem) -> FloatArray:
    """Return the relative error of each window by air that attenuates unevenly within a band.

    The attenuation of a band is that at its centre. Its mean over the band differs from that as
    the walls' absorption does (`roomfit.app.coherent.answers.widened_by_neighbours`); at 4 kHz by a
    third, as much as 15 % of relative humidity. To first order in the attenuation.

    Returns
    -------
    float array, shape (n_windows,)
        Negative or zero.
    """
    centre = float(bands.exact_centres_hz[band])
    step = 2.0 ** (1.0 / steps_per_octave(bands.kind))
    below, own, above = 2.0 * pressure_decay_per_m(air, centre * np.array([1 / step, 1.0, step]))
    error = abs(ABOVE * (above - own) + BELOW * (below - own))
    return np.asarray(-error * speed_of_sound_m_s(air) * _middle_s(energies))


def lost_coherence(band: CoherentBand, fit: BandFit) -> FloatArray:
    """Return by which share the expected energy would change if all images were coherent.

    What is not known to be coherent is expected to add as energies. Between smooth, parallel walls
    it does not: images on a lattice keep their order, and in boxes the late energy of an octave is
    10 to 25 % below the sum of their energies. Times that are off by little at every reflection
    change the phase of single paths, hardly this mean over all files, so that it is told by the
    images where they are thought to be. It is taken over slots of 40 ms; behind the last
    window in which pressures add, the last slot's stands.

    Returns
    -------
    float array, shape (n_windows,)
        0 where everything is coherent.
    """
    energies = band.energies
    noise = np.concatenate([o.noise for o in energies.observations])
    whole = made_directed(fully_coherent(band.problem), band.directed)
    expected = fit.expected[: noise.size]
    more, signal = whole.predict(fit.vector).expected - expected, expected - noise
    weight = signal / fit.variance[: noise.size]
    early = np.concatenate(
        [
            np.arange(seen.energy.size) < first.energy.size
            for seen, first in zip(energies.observations, band.problem.early, strict=True)
        ]
    )
    slot = np.floor(_middle_s(energies) / _SLOT_S).astype(np.int64)
    weight = np.where(early, weight, 0.0)
    top = np.bincount(slot, weight * more, slot.max() + 1)
    bottom = np.bincount(slot, weight * signal, slot.max() + 1)
    share = np.divide(top, bottom, out=np.zeros(top.size), where=bottom > 0.0)
    told = np.flatnonzero(bottom > 0.0)
    return np.asarray(share[np.minimum(slot, told[-1])])


def _middle_s(energies: EnergyProblem) -> FloatArray:
    """Return the middle of every window, all observations end to end."""
    edges = [o.edges_s for o in energies.observations]
    return np.asarray(np.maximum(np.concatenate([0.5 * (e[1:] + e[:-1]) for e in edges]), 0.0))
