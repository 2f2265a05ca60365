"""From measured pressures to reflection coefficients: a homotopy in smoothness, then rounds.

Each material's R0 begins nearly constant over frequency and is let loose step by step. Steps weigh
short paths with plane waves at the walls; what all paths with spherical waves have over those is
computed between them and held, round after round, until nothing moves. How rough each material may
be follows from its own evidence, so that a smooth wall lends no roughness from a resonator.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roomfit.impedance.layout import Layout, layout_of, r0_of, state_of
from roomfit.impedance.misfit import Whitened, evident_model_error, honest_covariance
from roomfit.impedance.model import State, frozen_correction, has_free_spectra
from roomfit.impedance.problem import Problem
from roomfit.impedance.rows import Linear, data_rows, prior_rows
from roomfit.impedance.solve import Minimum, levenberg_marquardt
from roomfit.typing import ComplexArray, FloatArray, Progress

# Standard deviations of second differences of spline coefficients: first nearly constant.
STAGES = (0.003, 0.01, 0.03)
_ROUGHEST, _SMOOTHEST = 1.0, 1e-4
_EVIDENCE_ROUNDS = 3
_MOST_ROUNDS = 8
# Where R0 moves by less than this (rms over frequency, worst material), the rounds end.
_SETTLED = 5e-4


@dataclass(frozen=True, slots=True, eq=False)
class ImpedanceFit:
    """What a fit found.

    Attributes
    ----------
    problem : Problem
    layout : Layout
    x : float array, shape (n_unknowns,)
    r0 : complex array, shape (n_materials, n_frequencies)
        Passive.
    state : State
    correction : complex array, shape (n_pairs, n_frequencies)
    roughness_sd : float array, shape (n_materials,)
    normal : float array, shape (n_unknowns, n_unknowns)
        ``J^T J`` of data and priors.
    residual : float array, shape (n_rows,)
        Of the data, in standard deviations.
    effective : float
        How many numbers the data determined.
    covariance : float array, shape (n_unknowns, n_unknowns)
        With the model's own error as it is in this room.
    model_error : float
        That error, see `roomfit.impedance.misfit.evident_model_error`.
    evaluations, rounds : int
    settled : bool
        Whether the rounds ended because nothing moved any more.
    """

    problem: Problem
    layout: Layout
    x: FloatArray
    r0: ComplexArray
    state: State
    correction: ComplexArray
    roughness_sd: FloatArray
    normal: FloatArray
    residual: FloatArray
    effective: float
    covariance: FloatArray
    model_error: float
    evaluations: int
    rounds: int
    settled: bool


def reduced_chi2(fit: ImpedanceFit) -> float:
    """Return the sum of squares of the data's residuals over what is expected, 1 for a good fit."""
    free = max(len(fit.residual) - fit.effective, 1.0)
    return float(fit.residual @ fit.residual) / free


def descend(
    problem: Problem,
    layout: Layout,
    x: FloatArray,
    roughness_sd: FloatArray,
    correction: ComplexArray,
    *,
    gain: float = 1e-4,
    walls_only: bool = False,
) -> Minimum:
    """Return the nearest minimum with smoothness and correction held.

    With `walls_only`, positions, speed of sound, gains and delays are held as well.
    """

    def rows(at: FloatArray) -> Linear:
        data = data_rows(problem, layout, at, correction)
        if walls_only:
            data.jacobian[:, layout.curves[-1].stop :] = 0.0
        prior = prior_rows(problem, layout, at, roughness_sd)
        return Linear(
            np.concatenate([data.residual, prior.residual]),
            np.vstack([data.jacobian, prior.jacobian]),
        )

    return levenberg_marquardt(rows, x, gain=gain)


def relaxed(
    problem: Problem,
    x: FloatArray,
    stages: Sequence[float] = STAGES[:2],
    *,
    gain: float = 1e-4,
) -> tuple[FloatArray, float, int]:
    """Return where the homotopy leads with plane waves and short paths alone.

    Returns
    -------
    x : float array
    cost : float
    evaluations : int
    """
    layout = layout_of(problem)
    nothing = np.zeros_like(problem.observed.pressure)
    rough = np.full(len(problem.curves), stages[0])
    # far from the truth, the speed of sound would leave for good before the walls have settled
    found = descend(problem, layout, x, rough, nothing, gain=1e-2, walls_only=True)
    x, cost, evaluations = found.x, found.cost, found.evaluations
    for stage in stages:
        rough = np.full(len(problem.curves), stage)
        found = descend(problem, layout, x, rough, nothing, gain=gain)
        x, cost, evaluations = found.x, found.cost, evaluations + found.evaluations
    return x, cost, evaluations


def refined(
    problem: Problem,
    x: FloatArray,
    roughness_sd: FloatArray | None = None,
    progress: Progress | None = None,
) -> ImpedanceFit:
    """Return the fit to which rounds of spherical correction lead from a coarse one.

    Parameters
    ----------
    problem : Problem
    x : float array, shape (n_unknowns,)
        From `relaxed`, or of an earlier fit.
    roughness_sd : float array, shape (n_materials,), optional
        Where it is known already; else the last of the `STAGES`, then by its evidence.
    progress : callable, optional
    """
    layout = layout_of(problem)
    rough = np.full(len(problem.curves), STAGES[-1]) if roughness_sd is None else roughness_sd
    correction = _correction(problem, layout, x)
    r0, evaluations, settled, rounds = r0_of(problem, layout, x), 0, False, 0
    while True:
        rounds += 1
        found = descend(problem, layout, x, rough, correction)
        x, evaluations = found.x, evaluations + found.evaluations
        before, r0 = r0, r0_of(problem, layout, x)
        moved = float(np.sqrt(np.mean(np.abs(r0 - before) ** 2, axis=1)).max())
        settled = moved <= _SETTLED
        if progress is not None:
            progress(rounds / _MOST_ROUNDS)
        if rounds >= _MOST_ROUNDS or (settled and rounds > 1):
            break
        if rounds <= _EVIDENCE_ROUNDS:
            rough = _evident_roughness(problem, layout, found, rough)
        correction = _correction(problem, layout, x)
    return _fit(problem, layout, found, correction, rough, (evaluations, rounds, settled))


def _correction(problem: Problem, layout: Layout, x: FloatArray) -> ComplexArray:
    return frozen_correction(
        problem.model,
        passive(r0_of(problem, layout, x)),
        state_of(problem, layout, x),
        spherical=problem.spherical,
    )


def passive(r0: ComplexArray) -> ComplexArray:
    """Return R0 drawn onto the unit circle where it lies outside."""
    return np.asarray(r0 / np.maximum(np.abs(r0), 1.0))


def _evident_roughness(
    problem: Problem, layout: Layout, found: Minimum, rough: FloatArray
) -> FloatArray:
    """Return the roughness of each material under which what was found is most probable.

    MacKay's fixed point: the sum of squares of second differences over how many of them the data
    determine [1]_.

    References
    ----------
    .. [1] D. J. C. MacKay, "Bayesian interpolation", Neural Computation 4, 415-447 (1992).
    """
    covariance = np.linalg.pinv(found.normal, hermitian=True)
    new = rough.copy()
    for i, (curve, place) in enumerate(zip(problem.curves, layout.curves, strict=True)):
        rows = curve.roughness
        if len(rows) == 0:
            continue
        differences = rows @ found.x[place]
        left_open = np.trace(rows @ covariance[place, place] @ rows.T) / rough[i] ** 2
        determined = max(len(rows) - float(left_open), 1e-3)
        new[i] = np.sqrt(float(differences @ differences) / determined)
    return np.clip(new, _SMOOTHEST, _ROUGHEST)


def _fit(
    problem: Problem,
    layout: Layout,
    found: Minimum,
    correction: ComplexArray,
    rough: FloatArray,
    ended: tuple[int, int, bool],
) -> ImpedanceFit:
    data = data_rows(problem, layout, found.x, correction)
    own = data.jacobian.T @ data.jacobian
    effective = float(np.trace(np.linalg.pinv(found.normal, hermitian=True) @ own))
    if has_free_spectra(problem.nuisances):
        n_sources = len(np.unique(problem.model.scene.pairs[:, 0]))
        effective += 2.0 * n_sources * problem.observed.pressure.shape[1]
    linear = Whitened(data.residual, data.jacobian, found.normal)
    error = evident_model_error(problem, linear)
    return ImpedanceFit(
        problem,
        layout,
        found.x,
        passive(r0_of(problem, layout, found.x)),
        state_of(problem, layout, found.x),
        correction,
        rough,
        found.normal,
        data.residual,
        effective,
        honest_covariance(problem, linear, error, effective),
        error,
        *ended,
    )
