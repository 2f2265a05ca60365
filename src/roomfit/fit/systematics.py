"""Systematic errors of a band that its noise model lacks, added to the covariance of its answer.

Windows share errors: the Monte-Carlo noise of the rays, which a ray between hard walls brings to
all receivers and late times at once (a jackknife over batches of rays, which are independent
traces); attenuation of air that changes within a band; coherence of images that are taken for
incoherent; and a rate of decay that is not that of the walls, because of what stands in the room
and of all that the model has wrong in late windows alike. And a band shares absorption that changes
within it with its neighbours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np

from roomfit.base.air import Air, pressure_decay_per_m, speed_of_sound_m_s
from roomfit.base.bands import Bands, steps_per_octave
from roomfit.base.typing import FloatArray, IntArray
from roomfit.materials.priors import MaterialPrior
from roomfit.model.energy import EnergyTerm, parts_of
from roomfit.model.parameters import Parameters, physical_values
from roomfit.model.problem import Objective
from roomfit.model.weighing import directed_rows, weigh
from roomfit.solver import BandFit
from roomfit.tracing.paths import Paths
from roomfit.uncertainty import gaussian
from roomfit.uncertainty.intervals import prior_logit_covariance, widened

_LEAST = 1e-9  # distance of an absorption from 0 and 1 in its logit
# Where absorption runs smoothly (as a raised cosine over octaves) from one band's centre to the
# next, these shares of the mean over a band belong to the band above and the one below: the
# integral of that weight over the squared magnitude of the octave filter.
ABOVE, BELOW = 0.144, 0.078
# Long enough for many independent values of eight responses, short enough to follow a decay.
SLOT_S = 0.04


def inflated_by_adjacent_bands(
    answers: Sequence[gaussian.BandEstimate | None], priors: tuple[MaterialPrior, ...] = ()
) -> tuple[gaussian.BandEstimate | None, ...]:
    """Return intervals that allow for absorption that changes within a band.

    A fit assumes one absorption throughout a band and finds a mean over it, which belongs in part
    to the neighbours. The difference of the mean from the value at the centre, if absorption runs
    smoothly between the fitted bands, is taken as one more standard deviation. The bands at either
    end lack a neighbour, and take the step to the other for it. Materials that are tied have one
    error, those of a product errors that are as alike as their absorptions.
    """
    out: list[gaussian.BandEstimate | None] = []
    neighbours = zip(answers, (None, *answers[:-1]), (*answers[1:], None), strict=True)
    for band, (answer, below, above) in enumerate(neighbours):
        if answer is None or (above is None and below is None):
            out.append(answer)
            continue
        if above is not None and below is not None:
            up, down = above.absorption - answer.absorption, below.absorption - answer.absorption
            step = ABOVE * up + BELOW * down
        else:
            only = cast(gaussian.BandEstimate, above or below)
            step = np.hypot(ABOVE, BELOW) * (only.absorption - answer.absorption)
        a = np.clip(answer.absorption, _LEAST, 1.0 - _LEAST)
        sd = np.abs(step) / (a * (1.0 - a))
        out.append(widened(answer, _likeness(priors, band, a.size) * np.outer(sd, sd)))
    return tuple(out)


def _likeness(priors: tuple[MaterialPrior, ...], band: int, n: int) -> FloatArray:
    """Return the prior correlation of n materials in a band, 1 between those that are tied."""
    if not priors:
        return np.eye(n)
    covariance = prior_logit_covariance(priors, band)
    sd = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(sd, sd))


def shared_errors(
    objective: Objective,
    fit: BandFit,
    sources: Sequence[int],
    relative: FloatArray,
) -> dict[str, FloatArray]:
    """Return the errors that a fit's windows share by name, (n_windows, n), one sd a column.

    Over the batches of rays, by one standard deviation of what `relative` holds; and, under
    "decay", by a rate of decay that is larger by a factor of 2: `with_errors_of_all_bands`
    gives it its size when all bands are fitted.

    Shapes: `relative` (n_windows, 2).
    """
    energies = cast(EnergyTerm, objective.as_energies(fit.vector))
    noise = np.concatenate([o.noise for o in energies.observations])
    signal = fit.expected[: noise.size] - noise
    return {
        "rays": batch_spread(energies, objective.parameters, fit.vector, sources),
        "air": (signal * relative[:, 0])[:, None],
        "scattering": (signal * relative[:, 1])[:, None],
        "decay": (signal * decay_error(energies, signal))[:, None],
    }


def effect_on_answer(
    objective: Objective,
    fit: BandFit,
    shared: Mapping[str, FloatArray],
    areas_m2: FloatArray,
) -> gaussian.SharedErrors:
    """Return what the errors that a fit's windows share do to its answer [1]_.

    Its shifts by these `shared_errors` (`roomfit.uncertainty.gaussian.answer_steps`), of the rate
    of decay kept apart; and how well the unknowns, and the mean of a room with such areas of its
    materials, were known without one term or the other.

    References
    ----------
    .. [1] B. Efron, "The Jackknife, the Bootstrap and Other Resampling Plans", SIAM (1982),
           section 3: the delete-one variance of an estimate, here linearised.
    """
    jacobian = objective.predict(fit.vector).jacobian
    rate = decay_rate(objective, fit, jacobian, shared["decay"])
    shared = {name: errors for name, errors in shared.items() if name != "decay"}
    costs = gaussian.costs_of_terms(objective, fit, jacobian, shared, areas_m2)
    steps = gaussian.answer_steps(
        objective, fit, jacobian, np.concatenate(list(shared.values()), axis=1)
    )
    return gaussian.SharedErrors(steps, *costs, rate)


def relative_errors(
    air: Air,
    bands: Bands,
    energies: EnergyTerm,
    paths: Paths,
    absorption: FloatArray,
    scattering: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Return the relative errors of all windows by air and scattering, shape (n_windows, 2).

    Shapes: `scattering` (n_materials, n_bands) and (n_materials,).
    """
    band = int(np.argmin(np.abs(bands.centres_hz - energies.centre_hz)))
    own = scattering[0][:, band], scattering[1]
    scattered = scattering_error(paths, energies, absorption, own)
    return np.stack((air_error(air, bands, band, energies), scattered), axis=1)


def air_error(air: Air, bands: Bands, band: int, energies: EnergyTerm) -> FloatArray:
    """Return the relative error of each window by air that attenuates unevenly within a band.

    The model has the attenuation at the band's centre. Its mean over the band differs from that as
    the walls' absorption does (`inflated_by_adjacent_bands`): at 4 kHz by a third, as much as by
    15 % of relative humidity. To first order in the attenuation.

    Shape (n_windows,).
    """
    centre = float(bands.exact_centres_hz[band])
    step = 2.0 ** (1.0 / steps_per_octave(bands.kind))
    below, own, above = 2.0 * pressure_decay_per_m(air, centre * np.array([1 / step, 1.0, step]))
    error = abs(ABOVE * (above - own) + BELOW * (below - own))
    return np.asarray(-error * speed_of_sound_m_s(air) * middles_s(energies))


def decay_error(energies: EnergyTerm, signal: FloatArray) -> FloatArray:
    """Return the relative change of each window if energy decayed at twice the rate, (n_windows,).

    ``-k t`` at the time t after emission, with k the median over the observations of the decay of
    the expected energy per time.

    Shapes: `signal` (n_windows,).
    """
    ends = np.cumsum([o.energy.size for o in energies.observations])[:-1]
    rates_per_s = [0.0]
    for observed, own in zip(energies.observations, np.split(signal, ends), strict=True):
        width_s = np.diff(observed.edges_s)
        used = (own > 0.0) & (np.arange(own.size) > 0)  # after the direct sound
        if np.count_nonzero(used) > 2:
            middle_s = 0.5 * (observed.edges_s[1:] + observed.edges_s[:-1])[used]
            level = np.log(own[used] / width_s[used])
            rates_per_s.append(-np.polyfit(middle_s, level, 1, w=np.sqrt(width_s[used]))[0])
    rate_per_s = float(np.median(rates_per_s[1:] or rates_per_s))
    return np.asarray(-max(rate_per_s, 0.0) * middles_s(energies))


def decay_rate(
    objective: Objective, fit: BandFit, jacobian: FloatArray, error: FloatArray
) -> gaussian.DecayRate:
    """Return what data say of a relative change of the rate of decay, to first order.

    Shapes: `error` (n_windows, 1).
    """
    n, misfit = len(error), max(fit.chi2_reduced, 1.0)
    weighed = error[:, 0] / (objective.correlation_length()[:n] * fit.variance[:n])
    (step,) = gaussian.answer_steps(objective, fit, jacobian, error).T
    known = float(weighed @ error[:, 0] - (weighed @ jacobian[:n]) @ step)
    pull = float(weighed @ (fit.measured - fit.expected)[:n])
    return gaussian.DecayRate(max(known, 0.0) / misfit, pull / misfit, step)


def scattering_error(
    paths: Paths,
    energies: EnergyTerm,
    absorption: FloatArray,
    scattering: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Return the relative error of each window by scattering that is not exactly known.

    The weight of a path changes by ``d / s - n / (1 - s)`` per unit of the coefficient s, with d
    diffuse and n specular reflections: the derivative of the probability with which it is drawn.
    Directivity of sources is left out, since it is common to both sides of the ratio.

    Shape (n_windows,). Shapes: `absorption` (n_materials,), `scattering` (n_materials,).
    """
    s, sd = scattering
    own = (sd > 0.0) & (s > 0.0) & (s < 1.0)
    if not own.any():
        return np.zeros(sum(o.energy.size for o in energies.observations))
    found = []
    walls, air = absorption[:, None], np.array([energies.attenuation_per_m])
    for rows, observed in zip(energies.rows, energies.observations, strict=True):
        path = cast(IntArray, rows.path)
        factors = paths.hits_diffuse[path][:, own] @ (sd[own] / s[own])
        factors -= paths.hits_specular[path][:, own] @ (sd[own] / (1.0 - s[own]))
        energy, change = (
            observed.spreading @ weigh(r, walls, air)[0]
            for r in (rows, directed_rows(rows, factors))
        )
        found.append(np.divide(change, energy, out=np.zeros_like(energy), where=energy > 0.0))
    return np.concatenate(found)


def middles_s(energies: EnergyTerm) -> FloatArray:
    """Return the middle of every window, all observations end to end, shape (n_windows,)."""
    edges = [o.edges_s for o in energies.observations]
    return np.asarray(np.maximum(np.concatenate([0.5 * (e[1:] + e[:-1]) for e in edges]), 0.0))


def batch_spread(
    energies: EnergyTerm, parameters: Parameters, vector: FloatArray, sources: Sequence[int]
) -> FloatArray:
    """Return vectors whose outer products sum to the covariance of the traced energies.

    Shape (n_windows, n_sources * n_batches).
    """
    values, _ = physical_values(parameters, vector)
    gains = np.append(values["gain"], 1.0)
    n_batches = min((rows.n_batches for rows in energies.rows), default=0)
    names = list(dict.fromkeys(sources))
    n_windows = sum(o.energy.size for o in energies.observations)
    if n_batches < 2 or not any(rows.largest_batch >= 0 for rows in energies.rows):
        return np.zeros((n_windows, 0))
    out: FloatArray = np.zeros((n_windows, len(names), n_batches))
    first = 0
    each = zip(energies.observations, sources, strict=True)
    for number, (observed, source) in enumerate(each):
        batches = parts_of(energies, number, values["absorption"]).batches[:n_batches]
        windows = gains[observed.gain] * (observed.spreading @ batches.T)
        last = first + observed.energy.size
        out[first:last, names.index(source)] = windows - windows.mean(axis=1, keepdims=True)
        first = last
    return np.asarray(out.reshape(n_windows, -1) * np.sqrt(n_batches / (n_batches - 1.0)))
