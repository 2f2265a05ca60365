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
from dataclasses import replace
from typing import cast

import numpy as np

from roomfit.base.air import Air, pressure_decay_per_m, speed_of_sound_m_s
from roomfit.base.bands import Bands, steps_per_octave
from roomfit.base.logit import Z95, expit, logit
from roomfit.base.typing import FloatArray, IntArray
from roomfit.materials.priors import MaterialPrior, prior_logit_law
from roomfit.model.energy import EnergyTerm, parts_of
from roomfit.model.parameters import Parameters, physical_values
from roomfit.model.patterns import directed_rows
from roomfit.model.problem import Objective, Prediction
from roomfit.model.weighing import weigh
from roomfit.model.windows import in_windows
from roomfit.solver import BandFit, DecayRate
from roomfit.tracing.paths import Paths
from roomfit.uncertainty.gaussian import (
    WIDEST_IDENTIFIABLE,
    BandEstimate,
    add_covariance,
    answer_steps,
    costs_of_terms,
    is_identifiable,
)

_LEAST = 1e-9  # distance of an absorption from 0 and 1 in its logit
# Where absorption runs smoothly (as a raised cosine over octaves) from one band's centre to the
# next, these shares of the mean over a band belong to the band above and the one below: the
# integral of that weight over the squared magnitude of the octave filter.
ABOVE, BELOW = 0.144, 0.078
# Prior of the rates of decay of a room over those of its model: with each probability a normal law
# about 1 of that standard deviation in every band. docs/decisions/0048-what-stands-in-the-room.md.
DECAY_PROBABILITIES, DECAY_SDS = np.array([0.75, 0.25]), np.array([0.01, 0.2])
# Long enough for many independent values of eight responses, short enough to follow a decay.
SLOT_S = 0.04


def inflated_by_adjacent_bands(
    answers: Sequence[BandEstimate | None], priors: tuple[MaterialPrior, ...] = ()
) -> tuple[BandEstimate | None, ...]:
    """Return intervals that allow for absorption that changes within a band.

    A fit assumes one absorption throughout a band and finds a mean over it, which belongs in part
    to the neighbours. The difference of the mean from the value at the centre, if absorption runs
    smoothly between the fitted bands, is taken as one more standard deviation. The bands at either
    end lack a neighbour, and take the step to the other for it. Materials that are tied have one
    error, those of a product errors that are as alike as their absorptions.
    """
    out: list[BandEstimate | None] = []
    neighbours = zip(answers, (None, *answers[:-1]), (*answers[1:], None), strict=True)
    for band, (answer, below, above) in enumerate(neighbours):
        if answer is None or (above is None and below is None):
            out.append(answer)
            continue
        if above is not None and below is not None:
            up, down = above.absorption - answer.absorption, below.absorption - answer.absorption
            step = ABOVE * up + BELOW * down
        else:
            only = cast(BandEstimate, above or below)
            step = np.hypot(ABOVE, BELOW) * (only.absorption - answer.absorption)
        a = np.clip(answer.absorption, _LEAST, 1.0 - _LEAST)
        sd = np.abs(step) / (a * (1.0 - a))
        out.append(widened(answer, _likeness(priors, band, a.size) * np.outer(sd, sd)))
    return tuple(out)


def _likeness(priors: tuple[MaterialPrior, ...], band: int, n: int) -> FloatArray:
    """Return the prior correlation of n materials in a band, 1 between those that are tied."""
    if not priors:
        return np.eye(n)
    covariance = _prior_covariance(priors, band)
    sd = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(sd, sd))


def _prior_covariance(priors: tuple[MaterialPrior, ...], band: int) -> FloatArray:
    """Return that of the logits of all materials, tied ones alike, (n_materials, n_materials)."""
    names = [k.name for k in priors]
    leader = [names.index(k.tied_to or k.name) for k in priors]
    return np.asarray(prior_logit_law(priors)[1][band][np.ix_(leader, leader)])


def widened(answer: BandEstimate, covariance: FloatArray) -> BandEstimate:
    """Return the answer with an error of its logits added, of a covariance (n_materials,) square.

    What is fixed stays.
    """
    fixed = answer.upper95 <= answer.lower95
    covariance = np.where(fixed[:, None] | fixed, 0.0, covariance)
    logit_sd = np.sqrt(np.diag(covariance))
    a = np.clip(answer.absorption, _LEAST, 1.0 - _LEAST)
    middle = logit(a, _LEAST)
    lower = middle - np.hypot(middle - logit(answer.lower95, _LEAST), Z95 * logit_sd)
    upper = middle + np.hypot(logit(answer.upper95, _LEAST) - middle, Z95 * logit_sd)
    lower95 = np.where(fixed, answer.lower95, np.minimum(expit(lower), answer.lower95))
    upper95 = np.where(fixed, answer.upper95, np.maximum(expit(upper), answer.upper95))
    narrow = (upper95 - lower95 <= WIDEST_IDENTIFIABLE) | fixed
    size, directions = np.linalg.eigh(covariance)
    root = directions * np.sqrt(np.maximum(size, 0.0))

    def moved(samples: FloatArray | None) -> FloatArray | None:
        if samples is None:
            return None
        noise = np.random.default_rng(1).standard_normal(samples.shape) @ root.T
        return np.where(logit_sd > 0.0, expit(logit(samples, _LEAST) + noise), samples)

    return replace(
        answer,
        lower95=lower95,
        upper95=upper95,
        draws=moved(answer.draws),
        identifiable=answer.identifiable & narrow,
        logit_covariance=answer.logit_covariance + covariance,
    )


def shared_errors(
    objective: Objective,
    fit: BandFit,
    sources: Sequence[int],
    relative: FloatArray,
) -> dict[str, FloatArray]:
    """Return the errors that a fit's windows share by name, (n_windows, n), one sd a column.

    Over the batches of rays, by one standard deviation of what `relative` holds; and, under
    "decay", by a rate of decay that is larger by a factor of 2: `with_decay_errors` gives it its
    size when all bands are fitted.

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


def with_shared_errors(
    objective: Objective,
    fit: BandFit,
    shared: Mapping[str, FloatArray],
    there: Prediction | None = None,
    areas_m2: FloatArray | None = None,
) -> BandFit:
    """Return a fit whose information allows for the errors that its windows share.

    The covariance of the answer's shifts (`roomfit.uncertainty.gaussian.answer_steps`) by these
    `shared_errors` is added [1]_, of the rate of decay kept apart. `costs` of the fit says how well
    the unknowns were known without one term or the other, and `mean_costs`, with `areas_m2` of all
    materials, the mean of the room. `there` is the fit's prediction, where it is known.

    References
    ----------
    .. [1] B. Efron, "The Jackknife, the Bootstrap and Other Resampling Plans", SIAM (1982),
           section 3: the delete-one variance of an estimate, here linearised.
    """
    jacobian = (objective.predict(fit.vector) if there is None else there).jacobian
    rate = decay_rate(objective, fit, jacobian, shared["decay"])
    shared = {name: errors for name, errors in shared.items() if name != "decay"}
    costs = costs_of_terms(objective, fit, jacobian, shared, areas_m2)
    mean = {} if areas_m2 is None else {name: float(sd[-1]) for name, sd in costs.items()}
    costs = {name: sd[: fit.vector.size] for name, sd in costs.items()}
    steps = answer_steps(objective, fit, jacobian, np.concatenate(list(shared.values()), axis=1))
    return replace(add_covariance(fit, steps), costs=costs, mean_costs=mean, decay=rate)


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
) -> DecayRate:
    """Return what data say of a relative change of the rate of decay, to first order.

    Shapes: `error` (n_windows, 1).
    """
    n, misfit = len(error), max(fit.chi2_reduced, 1.0)
    weighed = error[:, 0] / (objective.correlation_length()[:n] * fit.variance[:n])
    (step,) = answer_steps(objective, fit, jacobian, error).T
    known = float(weighed @ error[:, 0] - (weighed @ jacobian[:n]) @ step)
    pull = float(weighed @ (fit.measured - fit.expected)[:n])
    return DecayRate(max(known, 0.0) / misfit, pull / misfit, step)


def decay_error_sds(rates: Sequence[DecayRate]) -> FloatArray:
    """Return how far, relatively, each band's rate of decay may be from that of its walls.

    Shape (n_bands,): the root mean square about 0 of the changes after the data. Their prior is a
    mixture: of rooms that decay as their model does in every band, and of such that do not. All
    bands together say which, so that one band that prefers another rate by chance does not; data
    that contradict the walls' rate widen their intervals, and data that determine it hardly do.
    The answer is not moved: what data prefer is made by anything that early and late windows
    disagree about. No law is taken beyond its own width either: a preferred change of several of
    these is an extrapolation of first order, and says that something else is wrong.
    """
    information, score = (np.array([r[i] for r in rates])[:, None] for i in (0, 1))
    # of each law: its variance and mean after the data, and how well it predicted them
    variance = 1.0 / (information + DECAY_SDS**-2)
    log_evidence = 0.5 * np.sum(variance * score**2 + np.log(variance / DECAY_SDS**2), axis=0)
    weight = DECAY_PROBABILITIES * np.exp(log_evidence - log_evidence.max())
    square = np.minimum(variance + (variance * score) ** 2, DECAY_SDS**2)
    return np.sqrt(np.asarray(square @ weight / weight.sum(), dtype=np.float64))


def with_decay_errors(
    answers: Sequence[BandEstimate], areas_m2: FloatArray, priors: tuple[MaterialPrior, ...]
) -> tuple[BandEstimate, ...]:
    """Return intervals that allow for a rate of decay that is not that of the walls.

    Walls move along the shift of their answer by such a change, all together: in absorption, of
    which the rate determines a sum. Its first order in a logit would exaggerate what hardly
    absorbs.

    Shapes: `areas_m2` (n_materials,).
    """
    rates = [a.decay for a in answers if a.decay is not None]
    sds = iter(decay_error_sds(rates) if rates else ())
    return tuple(
        a
        if a.decay is None
        else _moved_along(a, next(sds) * a.decay.step, areas_m2, _prior_covariance(priors, band))
        for band, a in enumerate(answers)
    )


def _moved_along(
    answer: BandEstimate, step: FloatArray, areas_m2: FloatArray, prior: FloatArray
) -> BandEstimate:
    """Return an answer with one error of all absorptions added, of that standard deviation."""
    a = np.clip(answer.absorption, _LEAST, 1.0 - _LEAST)
    nearer_half = np.where(a < 0.5, a + np.abs(step), a - np.abs(step))
    logit_step = np.sign(step) * np.abs(logit(nearer_half, _LEAST) - logit(a, _LEAST))
    mean_sd = float(np.abs(areas_m2 @ step) / areas_m2.sum())
    wider = widened(answer, np.outer(logit_step, logit_step))
    sd = np.sqrt(np.diag(wider.logit_covariance))
    prior_sd = np.sqrt(np.diag(prior))
    sure = is_identifiable(wider.chi2_reduced, wider.lower95, wider.upper95, sd, prior_sd)
    costs = {name: np.hypot(own, logit_step) for name, own in answer.costs.items()}
    of_mean = {name: float(np.hypot(own, mean_sd)) for name, own in answer.mean_costs.items()}
    if answer.costs:
        costs["decay"] = answer.costs[""]
    if answer.mean_costs:
        of_mean["decay"] = answer.mean_costs[""]
    sure = wider.identifiable & (sure | (sd == 0.0))
    return replace(wider, costs=costs, mean_costs=of_mean, identifiable=sure)


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
            observed.spreading @ weigh(r, walls, air, derivative=False).energy[0]
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
        windows = gains[observed.gain] * in_windows(observed.spreading, batches.T)
        last = first + observed.energy.size
        out[first:last, names.index(source)] = windows - windows.mean(axis=1, keepdims=True)
        first = last
    return np.asarray(out.reshape(n_windows, -1) * np.sqrt(n_batches / (n_batches - 1.0)))
