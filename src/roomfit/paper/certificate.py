"""A band fitted with a proof that no other absorption does better.

The boxes that a search leaves are joined to clusters; their bounds and the lowest cost found make
the certificate. The proof holds for the weights of the answer, so that fit and proof take turns.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray, IntArray, Progress
from roomfit.model.energy import EnergyTerm, only_energies, weighed
from roomfit.model.parameters import Parameters, physical_values
from roomfit.model.problem import Objective
from roomfit.paper.certificate_record import Certificate, Cluster, Status
from roomfit.paper.convex import descend, is_convex, total_misfit
from roomfit.paper.global_search import (
    ALMOST_BLACK,
    Searched,
    SearchSettings,
    Tools,
    proven_empty,
    search,
    tools_for,
)
from roomfit.paper.question import (
    GlobalProblem,
    energy_global_problem,
    free_vector,
    is_certifiable,
    to_absorption,
)
from roomfit.solver.ending import Ending
from roomfit.solver.least_squares import BandFit, Solver, fit_band
from roomfit.solver.levenberg_marquardt import Minimum, ResidualFunction

# Descents within a cluster: from its boxes of lowest bounds.
_DESCENTS = 24
# In g: far above the rounding of faces that were computed twice, far below any width.
_TOUCHING = 1e-9


def certify(global_problem: GlobalProblem, settings: SearchSettings) -> Certificate:
    """Return a proof of how low the misfit can be, and where: boxes left over, as clusters."""
    found = search(global_problem, settings)
    tools = tools_for(global_problem)
    label = touching(found.boxes)
    clusters = []
    for number in range(int(label.max(initial=-1)) + 1):
        own = np.flatnonzero(label == number)
        cluster = _cluster(global_problem, tools, found, own)
        empty = cluster.value > found.value + found.delta and proven_empty(
            tools, found, found.boxes[own], found.bounds[own]
        )
        if not empty:
            clusters.append(cluster)
    clusters.sort(key=lambda c: c.value)
    value = min([found.value, *(c.value for c in clusters)])
    bound = min(found.lower_bound, value)
    status: Status = "certified"
    if found.n_open:
        status = "stopped"
    elif value - bound > found.delta:
        status = "unresolved"
    return Certificate(
        status,
        _sentence(status, value, bound, found, len(clusters)),
        global_problem.coordinates,
        value,
        bound,
        found.delta,
        tuple(clusters),
        found.n_open,
        found.examined,
        found.seconds,
    )


def touching(boxes: FloatArray) -> IntArray:
    """Return the number of the cluster of each box, shape (n_boxes,): closed boxes that meet.

    `boxes` has the shape (n_boxes, 2, n).
    """
    label: IntArray = np.full(len(boxes), -1)
    number = 0
    for first in range(len(boxes)):
        if label[first] >= 0:
            continue
        label[first] = number
        waiting = [first]
        while waiting:
            box = boxes[waiting.pop()]
            free = np.flatnonzero(label < 0)
            meets = np.all(
                (boxes[free, 0] <= box[1] + _TOUCHING) & (boxes[free, 1] >= box[0] - _TOUCHING),
                axis=1,
            )
            label[free[meets]] = number
            waiting.extend(free[meets].tolist())
        number += 1
    return label


def _cluster(
    global_problem: GlobalProblem, tools: Tools, found: Searched, own: IntArray
) -> Cluster:
    boxes = found.boxes[own]
    hull = np.stack((boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)))
    low = np.maximum(hull[0], np.minimum(ALMOST_BLACK, hull[1] - 1e-3))
    order = np.argsort(found.bounds[own])[:_DESCENTS]
    starts = [0.5 * (np.maximum(boxes[i, 0], low) + boxes[i, 1]) for i in order]
    if np.all((found.minimiser >= hull[0]) & (found.minimiser <= hull[1])):
        starts.append(found.minimiser)
    ends = [descend(tools.data, start, low, hull[1], tools.most) for start in starts]
    place, value = min((_blackened(tools, hull, end) for end in ends), key=lambda end: end[1])
    ends_of_hull = to_absorption(global_problem, hull)
    return Cluster(
        np.minimum(ends_of_hull[0], ends_of_hull[1]),
        np.maximum(ends_of_hull[0], ends_of_hull[1]),
        to_absorption(global_problem, place),
        float(value),
        bool(is_convex(tools.data, hull, tools.most, tools.values)),
        len(own),
    )


def _blackened(
    tools: Tools, hull: FloatArray, end: tuple[FloatArray, float]
) -> tuple[FloatArray, float]:
    """Return a point with what a descent left all but black made black, where that is lower."""
    place, value = end
    black = np.where((place <= ALMOST_BLACK + 1e-6) & np.isneginf(hull[0]), -math.inf, place)
    there = total_misfit(tools.data, black, tools.most)
    return (black, there) if there <= value else end


def _sentence(status: Status, value: float, bound: float, found: Searched, n: int) -> str:
    better = f"at best {value - bound:.3g} better"
    if status == "stopped":
        return (
            f"Stopped: the misfit found, {value:.6g}, could be {better}; {found.n_open} boxes are "
            f"open after {found.examined}."
        )
    if status == "unresolved":
        return (
            f"Not resolved: the misfit found, {value:.6g}, could be {better} within boxes too "
            "narrow to be cut."
        )
    where = "one minimum comes" if n == 1 else f"{n} minima come"
    return (
        f"Certified: no absorption has a misfit below {bound:.6g}, {value:.6g} was found, and only "
        f"{where} within {found.delta:.3g} of it."
    )


# Of half the weighted squares: one standard deviation costs 0.5.
_LEAST_DELTA = 0.02
# Of boxes left over; narrower ones would locate minima better, and take longer.
_WIDTH = 0.25
# Weights change with the answer: certify, fit again from the best minimum, certify again.
_ROUNDS = 2
# What one band may cost; rows of all windows, paths of equal hits as one.
_MOST_BOXES, _MOST_SECONDS, MOST_ROWS = 200_000, 60.0, 400_000

# What a proof that was not asked for may cost. With more unknowns it took a minute.
_AFFORDABLE_BOXES, _AFFORDABLE_SECONDS, _AFFORDABLE_ROWS = 3_000, 2.0, 60_000
_AFFORDABLE_UNKNOWNS = 3
# Half of what one standard deviation costs: finer proofs take many times as many boxes.
_AFFORDABLE_DELTA = 0.25


def certified_fit(
    objective: Objective, *, progress: Progress | None = None
) -> tuple[BandFit, Certificate | None]:
    """Fit one band by least squares, and prove how low its cost can be.

    Where the search finds a lower minimum, the fit starts again from there, and the proof is made
    again with the weights of the new answer. There is none where nothing is unknown.

    Raises
    ------
    InputError
        The band holds other data than energies, or too many rows.
    """
    energies, parameters = only_energies(objective), objective.parameters
    if energies is None:
        raise InputError(
            "only energies can be certified",
            found="room parameters, or pressures that are added",
            needed='impulse responses alone, method = "certified" and model = "energy" or "auto"',
            hint='use method = "least-squares"',
        )
    fit = fit_band(objective)
    if not fit.vector.size:
        return fit, None
    for number in range(_ROUNDS):
        global_problem = energy_global_problem(energies, parameters, fit.vector)
        if len(global_problem.weight) > MOST_ROWS:
            raise InputError(
                "too many rows for a certificate",
                found=f"{len(global_problem.weight)} at {energies.centre_hz:g} Hz",
                needed=f"at most {MOST_ROWS}",
                hint='fewer materials, fewer pairs, or method = "least-squares"',
            )
        delta = tracing_delta(energies, parameters, fit.vector, global_problem.precision)
        settings = SearchSettings(
            delta, width=_WIDTH, max_boxes=_MOST_BOXES, max_seconds=_MOST_SECONDS
        )
        certificate = certify(global_problem, settings)
        if progress is not None:
            progress((number + 1) / _ROUNDS)
        if fit.cost <= certificate.value + 1e-3 + 0.01 * delta:
            break
        place, before = free_vector(parameters, certificate.clusters[0].minimiser), fit.evaluations
        fit = fit_band(objective, _staying_at(place))
        fit = replace(fit, evaluations=before + fit.evaluations)
    return fit, certificate


def affordable_certificate(objective: Objective, vector: FloatArray) -> Certificate | None:
    """Return what is proven of a band's energies near a fit, where that takes two seconds at most.

    None where other data are fitted, more than three numbers are unknown, there are too many rows,
    or the search is not complete after two seconds.

    `vector`, shape (n_free,): the fit; its weights are kept.
    """
    few = 0 < vector.size <= _AFFORDABLE_UNKNOWNS
    energies, parameters = only_energies(objective), objective.parameters
    if not few or energies is None or not is_certifiable(energies, parameters):
        return None
    global_problem = energy_global_problem(energies, parameters, vector)
    if len(global_problem.weight) > _AFFORDABLE_ROWS:
        return None
    delta = tracing_delta(energies, parameters, vector, global_problem.precision)
    settings = SearchSettings(
        max(delta, _AFFORDABLE_DELTA),
        width=_WIDTH,
        max_boxes=_AFFORDABLE_BOXES,
        max_seconds=_AFFORDABLE_SECONDS,
    )
    certificate = certify(global_problem, settings)
    return certificate if certificate.status == "certified" else None


def _staying_at(place: FloatArray) -> Solver:
    def stay(residuals: ResidualFunction, _start: FloatArray) -> Minimum:
        values, _ = residuals(place)
        return Minimum(place, 0.5 * float(values @ values), 1, Ending.CONVERGED)

    return stay


def tracing_delta(
    energies: EnergyTerm, parameters: Parameters, vector: FloatArray, precision: FloatArray
) -> float:
    """Return how much of a cost may be due to the rays: less cannot be distinguished.

    Other rays change window energies by errors e of variance v, and the cost ``sum c (r + e)**2``
    by ``sum c v`` on average, give or take twice ``(sum (2 c r)**2 v) ** 0.5``.

    Parameters
    ----------
    vector : float array, shape (n_free,)
    precision : float array, shape (n_windows,)
        c.

    Returns
    -------
    float
        Not below 0.02, a 25th of what one standard deviation costs.
    """
    values, _ = physical_values(parameters, vector)
    gains = np.append(values["gain"], 1.0)
    paths = zip(energies.observations, weighed(energies, values["absorption"]), strict=True)
    variance = np.concatenate([gains[o.gain] ** 2 * found.tracing for o, found in paths])
    off = energies.predict(values)[0] - energies.measured()
    linear = float(np.sqrt(np.sum((2.0 * precision * off) ** 2 * variance)))
    return max(float(np.sum(precision * variance)) + 2.0 * linear, _LEAST_DELTA)
