"""The acoustic impedance of a room's walls from measured pressures: from data to a verdict."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from roomfit.base.arguments import check_known, check_range
from roomfit.base.kernels import one_blas_thread
from roomfit.base.typing import FloatArray, Progress, part
from roomfit.impedance import verdict
from roomfit.impedance.data import (
    MODEL_ERROR,
    PLANE_MODEL_ERROR,
    Observed,
    complex_frequency_hz,
    deviation,
    level_at,
)
from roomfit.impedance.fit import (
    SAME_WITHIN,
    ImpedanceFit,
    Start,
    distance,
    distinct,
    multistart,
    polish,
    reduced_chi2,
)
from roomfit.impedance.laws import WallModel
from roomfit.impedance.problem import Problem, check_observed
from roomfit.impedance.result import ImpedanceResult
from roomfit.impedance.wave_model import Nuisances, wave_model
from roomfit.room.scene import Scene

_LOG = logging.getLogger("roomfit")

# Another minimum whose cost at first sight is at most this many times the lowest is followed, too.
_RIVAL = 1.5


@dataclass(frozen=True, slots=True)
class ImpedanceSettings:
    """How impedances are searched for, and with which image model.

    Examples
    --------
    >>> ImpedanceSettings(random_starts=10).spherical
    True
    """

    random_starts: int = 3  # random walls from which the search starts besides the usual ones
    spherical: bool = True  # False takes waves at the walls as plane, which errs 5 times as much
    # rms error of the image model itself, relative to the level, times wavenumber and mean free
    # path; None: 0.16, or 1.3 with plane waves, as measured against exact wave fields. Less only
    # for data that another image model made
    model_error: float | None = None

    def __post_init__(self) -> None:
        for name in ("random_starts", "model_error"):
            value = getattr(self, name)
            if value is not None:
                check_range(name, value, 0.0, np.inf)


@one_blas_thread
def identify_impedance(
    scene: Scene,
    observed: Observed,
    walls: Mapping[str, WallModel] | None = None,
    nuisances: Nuisances | None = None,
    *,
    rng: np.random.Generator,
    settings: ImpedanceSettings | None = None,
    progress: Progress | None = None,
) -> ImpedanceResult:
    """Return the reflection coefficient, absorption and impedance of every material of a room.

    Pressures of image sources with spherical waves at locally reacting walls are fitted to the
    measured ones by least squares, the reflection coefficient R0 of each material being a smooth
    curve over frequency; positions, speed of sound, gains and clocks are
    estimated with them. The method and its limits are described in docs/impedance.md.

    Parameters
    ----------
    scene : Scene
        Room, positions (m) and air; its pairs in the order of the pressures.
    observed : Observed
        Damped spectra, shape (n_pairs, n_frequencies); frequencies in Hz, pressures in any unit.
    walls : mapping of material to WallModel, optional
        Materials that are left out are splines.
    nuisances : Nuisances, optional
        What may be wrong about the measurement; left out: positions by 10 mm a coordinate unless
        the scene specifies less, the speed of sound by 1 %, gains known.
    rng : numpy Generator
        Draws starts; the same generator gives the same result.
    settings : ImpedanceSettings, optional
    progress : callable, optional
        Called with the fraction that is done, 0 to 1.

    Returns
    -------
    ImpedanceResult
        Of every material R0, absorption (0 to 1), admittance and impedance (relative to those of
        air), each with its 95 % interval, shape (n_frequencies,), and a verdict. Where the data
        cannot determine the unknowns, nothing is fitted and the verdict says so.

    Raises
    ------
    InputError
        Data, walls and scene do not belong together, or there are more paths than minutes suffice
        for.

    References
    ----------
    The spherical reflection is that of C. F. Chien, W. W. Soroka, J. Sound Vib. 43, 9-20 (1975);
    see `roomfit.impedance.wave_model`.

    Examples
    --------
    A box with one material of R0 = 0.6 at every frequency; pressures by the image model itself.

    >>> from roomfit.impedance.wave_model import at_rest, predicted_pressure, wave_model
    >>> from roomfit.room.scene import scene_of, shoebox_room
    >>> room = shoebox_room((5.0, 4.0, 3.0), "walls")
    >>> receivers = {"R1": (3.7, 2.8, 2.1), "R2": (1.0, 2.9, 0.8)}
    >>> scene = scene_of(room, {"S": (1.2, 1.1, 1.3)}, receivers)
    >>> f = np.arange(200.0, 301.0, 20.0)
    >>> model = wave_model(scene, f, 0.004)
    >>> p = predicted_pressure(model, np.full((1, 6), 0.6 + 0j), at_rest(model))
    >>> observed = Observed(f, 0.004, p, np.full(p.shape, 1e-4))
    >>> walls = {"walls": WallModel("constant")}
    >>> known, rng = Nuisances(position_sd_m=0.0, speed_sd=0.0), np.random.default_rng(1)
    >>> result = identify_impedance(scene, observed, walls, known, rng=rng)
    >>> result.verdict.word, bool(abs(result.materials[0].r0[0] - 0.6) < 0.01)
    ('identified', True)
    """
    began = time.perf_counter()
    problem = wave_problem(scene, observed, walls, nuisances, settings)
    findings = verdict.data_findings(problem)
    if findings:
        return verdict.result_without_fit(problem, findings)
    n_random = (settings or ImpedanceSettings()).random_starts
    _LOG.info("searching starts")
    starts = multistart(problem, n_random, rng, part(progress, 0.0, 0.3))
    _LOG.info("fitting impedances")
    fit = polish(problem, starts[0].x, progress=part(progress, 0.3, 0.6))
    rivals = _rivals(problem, starts, fit)
    if observed.noise is None:
        shown = replace(observed, noise=verdict.estimated_noise(fit))
        sd = _deviation(scene, shown, problem.model_error)
        fit = polish(replace(problem, observed=shown, sd=sd), fit.x, fit.roughness_sd)
    if progress is not None:
        progress(0.9)
    result = verdict.judged_result(fit, starts, rivals, observed)
    return replace(result, seconds=time.perf_counter() - began)


def wave_problem(
    scene: Scene,
    observed: Observed,
    walls: Mapping[str, WallModel] | None = None,
    nuisances: Nuisances | None = None,
    settings: ImpedanceSettings | None = None,
) -> Problem:
    """Return what `identify_impedance` solves first; arguments and errors as there."""
    settings, nuisances = settings or ImpedanceSettings(), nuisances or Nuisances()
    walls = walls or {}
    check_observed(scene, observed, nuisances)
    for name in walls:
        what = "a model is specified for a wall that does not exist"
        check_known(what, name, scene.room.materials)
    factor = MODEL_ERROR if settings.spherical else PLANE_MODEL_ERROR
    factor = factor if settings.model_error is None else settings.model_error
    f = complex_frequency_hz(observed)
    curves = tuple(walls.get(name, WallModel()).curve(f) for name in scene.room.materials)
    model = wave_model(scene, observed.frequency_hz, observed.tau_s)
    sd = _deviation(scene, observed, factor)
    return Problem(model, observed, sd, curves, nuisances, settings.spherical, factor)


def _deviation(scene: Scene, observed: Observed, factor: float) -> FloatArray:
    # exact data and an exact model: rounding, and images beyond the last
    return np.maximum(deviation(scene, observed, factor), 1e-4 * level_at(observed))


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
