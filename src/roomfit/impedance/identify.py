"""The whole way: from a scene and measured pressures to impedances and a verdict."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from roomfit._numba import one_blas_thread
from roomfit.errors import InputError
from roomfit.geometry.mesh import mean_free_path_m
from roomfit.impedance.data import (
    MODEL_ERROR,
    PLANE_MODEL_ERROR,
    Observed,
    level_at,
    standard_deviation,
)
from roomfit.impedance.fit import (
    SAME_WITHIN,
    ImpedanceFit,
    Start,
    WallModel,
    continuation,
    distance,
    distinct,
    first_curves,
    multistart,
    polish,
    reduced_chi2,
    thinned,
    with_laws,
)
from roomfit.impedance.problem import Problem, start_of
from roomfit.impedance.result import (
    ImpedanceAnswer,
    answer_without_fit,
    data_findings,
    estimated_noise,
    judged_answer,
)
from roomfit.impedance.wave_model import Nuisances, WaveModel, model_without_paths, wave_model
from roomfit.scene import Scene
from roomfit.typing import FloatArray, Progress

N_RANDOM_STARTS = 3
# Another minimum whose cost at first sight is at most this many times the lowest is followed, too.
_RIVAL = 1.5


@one_blas_thread
def identify_impedance(
    scene: Scene,
    observed: Observed,
    walls: Mapping[str, WallModel] | None = None,
    nuisances: Nuisances | None = None,
    *,
    rng: np.random.Generator,
    spherical: bool = True,
    model_error: float | None = None,
    n_random_starts: int = N_RANDOM_STARTS,
    progress: Progress | None = None,
) -> ImpedanceAnswer:
    """Return the reflection coefficient, absorption and impedance of every material of a room.

    Parameters
    ----------
    scene : Scene
        Pairs in the order of the pressures.
    observed : Observed
    walls : mapping of material to WallModel, optional
        Materials that are left out are splines.
    nuisances : Nuisances, optional
        What may be wrong about the measurement; left out: positions by 10 mm a coordinate unless
        the scene tells more, the speed of sound by 1 %, gains known.
    rng : numpy Generator
        Draws starts.
    spherical : bool
        False takes waves at the walls for plane, which is 5 times as wrong: for comparison.
    model_error : float, optional
        Error of the image model itself, relative, times wavenumber and mean free path; left out:
        0.16, or 1.3 with plane waves, as measured against exact wave fields. Less only for data
        that another image model made.
    n_random_starts : int
    progress : callable, optional

    Raises
    ------
    InputError
        Data, walls and scene do not belong together.
    """
    began = time.perf_counter()
    models = {name: (walls or {}).get(name, WallModel()) for name in scene.room.materials}
    bare = model_without_paths(scene, observed.frequency_hz, observed.tau_s)
    problem = _problem(bare, observed, walls, nuisances, spherical, model_error)
    findings = data_findings(problem, models)
    if findings:
        return answer_without_fit(problem, findings, time.perf_counter() - began)
    problem = replace(problem, model=wave_model(scene, observed.frequency_hz, observed.tau_s))
    starts = multistart(problem, n_random_starts, rng, _part(progress, 0.0, 0.3))
    fit = polish(problem, starts[0].x, progress=_part(progress, 0.3, 0.6))
    rivals = _rivals(problem, starts, fit)
    if observed.noise is None:
        fit = _with_estimated_noise(fit)
    fit = with_laws(fit, models, rng).fit
    if progress is not None:
        progress(0.9)
    return judged_answer(fit, starts, rivals, observed, time.perf_counter() - began, _again)


def _check_names(scene: Scene, walls: Mapping[str, WallModel]) -> None:
    for name in walls:
        if name not in scene.room.materials:
            raise InputError(
                "a model is told for a wall that does not exist",
                found=repr(name),
                needed=", ".join(scene.room.materials),
            )


def _part(progress: Progress | None, low: float, high: float) -> Progress | None:
    if progress is None:
        return None
    return lambda share: progress(low + (high - low) * min(share, 1.0))


def wave_problem(
    scene: Scene,
    observed: Observed,
    walls: Mapping[str, WallModel] | None = None,
    nuisances: Nuisances | None = None,
    *,
    spherical: bool = True,
    model_error: float | None = None,
) -> Problem:
    """Return what `identify_impedance` solves first; arguments as there.

    Raises
    ------
    InputError
        Data, walls and scene do not belong together.
    """
    model = wave_model(scene, observed.frequency_hz, observed.tau_s)
    return _problem(model, observed, walls, nuisances, spherical, model_error)


def _problem(
    model: WaveModel,
    observed: Observed,
    walls: Mapping[str, WallModel] | None,
    nuisances: Nuisances | None,
    spherical: bool,
    model_error: float | None,
) -> Problem:
    scene = model.scene
    models = {name: (walls or {}).get(name, WallModel()) for name in scene.room.materials}
    _check_names(scene, walls or {})
    usual = MODEL_ERROR if spherical else PLANE_MODEL_ERROR
    factor = usual if model_error is None else model_error
    sd = _deviation(model, observed, factor)
    curves = tuple(first_curves(models, observed.frequency_hz))
    return Problem(model, observed, sd, curves, nuisances or Nuisances(), spherical, factor)


def _deviation(model: WaveModel, observed: Observed, factor: float) -> FloatArray:
    free_path_m = mean_free_path_m(model.scene.room.mesh)
    sd = standard_deviation(observed, free_path_m, model.speed_m_s, factor)
    # exact data and an exact model: rounding, and images beyond the last
    return np.maximum(sd, 1e-4 * level_at(observed))


def _rivals(
    problem: Problem, starts: tuple[Start, ...], fit: ImpedanceFit
) -> tuple[ImpedanceFit, ...]:
    """Return fits of other minima that explain the data as well as the lowest does."""
    found = []
    for start in distinct(starts)[1:]:
        if start.cost > _RIVAL * starts[0].cost:
            continue
        other = polish(problem, start.x)
        as_good = reduced_chi2(other) <= max(1.2 * reduced_chi2(fit), 1.0)
        if as_good and distance(other.r0, fit.r0) > 5.0 * SAME_WITHIN:
            found.append(other)
    return tuple(found)


def _with_estimated_noise(fit: ImpedanceFit) -> ImpedanceFit:
    """Return the fit with the noise that its own residual tells."""
    problem = fit.problem
    observed = replace(problem.observed, noise=estimated_noise(fit))
    sd = _deviation(problem.model, observed, problem.model_error)
    return polish(replace(problem, observed=observed, sd=sd), fit.x, fit.roughness_sd)


def _again(problem: Problem) -> ImpedanceFit:
    """Return the fit of a changed problem, from the start of its curves."""
    thin = thinned(problem)
    x, _, _ = continuation(thin, start_of(thin))
    return polish(problem, x)
