"""What a fit found besides the walls, and what it predicts."""

from __future__ import annotations

import numpy as np

from roomfit.impedance.answer import FoundNuisance
from roomfit.impedance.fit import ImpedanceFit
from roomfit.impedance.layout import factor_of
from roomfit.impedance.model import gradients, has_free_spectra
from roomfit.impedance.rows import data_rows, source_spectra
from roomfit.typing import ComplexArray, FloatArray

_REACH = 1.959964
_AXES = "xyz"
_DB = 20.0 / np.log(10.0)


def found_nuisances(fit: ImpedanceFit) -> tuple[FoundNuisance, ...]:
    """Return every nuisance of a fit with its interval, in the order of the unknowns."""
    problem, layout, x = fit.problem, fit.layout, fit.x
    sd = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    scene, told = problem.model.scene, problem.nuisances
    found: list[FoundNuisance] = []

    def add(name: str, unit: str, at: int, scale: float, middle: float = 0.0) -> None:
        value, reach = middle + x[at] * scale, _REACH * sd[at] * scale
        found.append(FoundNuisance(name, unit, value, value - reach, value + reach, scale))

    for moves, places, sds, points in (
        (layout.moves_source, layout.source, layout.source_sd_m, scene.sources),
        (layout.moves_receiver, layout.receiver, layout.receiver_sd_m, scene.receivers),
    ):
        for n, (point, axis) in enumerate(places):
            add(f"{_AXES[axis]} of {points[point].name}", "m", moves.start + n, float(sds[n]))
    if layout.speed.stop > layout.speed.start:
        speed = problem.model.speed_m_s
        add("speed of sound", "m/s", layout.speed.start, told.speed_sd * speed, speed)
    n_gains = (layout.gain.stop - layout.gain.start) // 2
    for n in range(n_gains):
        add(f"gain {n + 1}", "dB", layout.gain.start + n, _DB)
        add(f"phase of gain {n + 1}", "rad", layout.gain.start + n_gains + n, 1.0)
    for n in range(layout.delay.stop - layout.delay.start):
        source, receiver = scene.pairs[np.flatnonzero(layout.delay_of_pair == n)[0]]
        name = scene.sources[source].name
        if told.delay == "pair":
            name += f" to {scene.receivers[receiver].name}"
        add(f"delay of {name}", "s", layout.delay.start + n, told.delay_sd_s)
    return tuple(found)


def predicted_pairs(fit: ImpedanceFit) -> ComplexArray:
    """Return the predicted pressures with gains and delays, (n_pairs, n_frequencies)."""
    problem = fit.problem
    short = gradients(problem.model, fit.r0, fit.state, with_geometry=False).pressure
    predicted = factor_of(problem, fit.layout, fit.x) * (short + fit.correction)
    if has_free_spectra(problem.nuisances):
        return np.asarray(predicted * source_spectra(problem, predicted))
    return np.asarray(predicted)


def wall_condition(fit: ImpedanceFit) -> float:
    """Return how unequally the data determine the walls: 1 is equally well, infinite not at all.

    Largest over smallest singular value of the weighted Jacobian by the walls' numbers, without
    priors of theirs, after what the other unknowns can explain.
    """
    jacobian = data_rows(fit.problem, fit.layout, fit.x, fit.correction).jacobian
    n = fit.layout.curves[-1].stop
    own, other = jacobian[:, :n], jacobian[:, n:]
    if other.shape[1]:
        weak: FloatArray = np.eye(other.shape[1])
        held = np.linalg.solve(other.T @ other + weak, other.T @ own)
        own = own - other @ held
    singular = np.linalg.svd(own, compute_uv=False)
    return float(singular[0] / max(singular[-1], 1e-300))
