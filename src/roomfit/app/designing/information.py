"""What each pair would tell of the absorption if it were measured: by the fit's own noise model."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from roomfit.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.app.binning import bin_paths, in_band, paths_at
from roomfit.app.coherent.bands import FIT_END_S
from roomfit.app.coherent.problems import DELAY_SD_S, SPEED_SD, coherent_problem
from roomfit.app.designing.windows import BandFilter, band_filters, expected_problem
from roomfit.app.measuring import LATENCY_SD_S
from roomfit.app.problems import absorption_block
from roomfit.bands import Bands
from roomfit.materials.knowledge import MaterialKnowledge
from roomfit.objective.coherent_geometry import Geometry, whole_covariance
from roomfit.objective.coherent_problem import CoherentProblem, with_coherence
from roomfit.objective.energy_problem import EnergyProblem
from roomfit.objective.parameters import Block, Parameters, start_vector
from roomfit.placement.elimination import about_geometry, by_all_pairs, without_geometry
from roomfit.scene.scene import Scene, distances_m
from roomfit.tracing.paths import Paths, select
from roomfit.typing import BoolArray, FloatArray, Progress

# Windows as short as the fit's: of energies, and of pressures.
_ENERGY_PERIODS, _PRESSURE_PERIODS = 1.5, 0.75
# What a fit of pressures assumes first of the model's errors: see `roomfit.app.coherent.bands`.
_PRESSURE_MODEL_ERROR, _PRESSURE_RINGING_ERROR = 0.1, 0.0


@dataclass(frozen=True, slots=True, eq=False)
class DesignTrace:
    """Paths of candidates.

    Attributes
    ----------
    paths : Paths
    factors : float array, shape (n_bands, n_paths), or None
        On the weight of every path in every band.
    duration_s : float
        How long sound was followed.
    """

    paths: Paths
    factors: FloatArray | None
    duration_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Foreseen:
    """How the measurements to be planned will be made and fitted.

    Attributes
    ----------
    bands : Bands
    knowledge : tuple of MaterialKnowledge
    coherent : bool
        Whether pressures of image sources will be added, or energies only.
    n_pairs : int
        How many pairs will have been measured in the end.
    decay_range_db : float
        How far a decay will be heard above the noise.
    position_sd_m : float
        Of every coordinate of source and receiver.
    level_known : bool
        Whether levels will be absolute.
    wall_delays, positions_free : bool
        Whether the fit lets walls delay, and places move.
    speed_sd : float
        Relative standard deviation of the speed of sound.
    """

    bands: Bands
    knowledge: tuple[MaterialKnowledge, ...]
    coherent: bool
    n_pairs: int
    decay_range_db: float
    position_sd_m: float
    wall_delays: bool = True
    positions_free: bool = True
    speed_sd: float = SPEED_SD


def information_of_pairs(
    scene: Scene,
    traced: DesignTrace,
    foreseen: Foreseen,
    typical: FloatArray,
    draws: FloatArray,
    progress: Progress | None = None,
) -> FloatArray:
    """Return the information of every pair, (n_pairs, n_draws, n_bands, n + 1, n + 1).

    About the n unknown absorptions (as free numbers) and the log of the pair's gain.

    Parameters
    ----------
    scene : Scene
    traced : DesignTrace
        Paths of all pairs.
    foreseen : Foreseen
    typical : float array, shape (n_materials, n_bands)
        Absorption by which windows and noise are laid out.
    draws : float array, shape (n_draws, n_materials, n_bands)
        Absorptions at which to ask.
    """
    filters = band_filters(foreseen.bands, attenuation_per_m(scene.air, foreseen.bands))
    order = np.argsort(traced.paths.pair, kind="stable")
    ends = np.searchsorted(traced.paths.pair[order], np.arange(len(scene.pairs) + 1))
    found = []
    for pair in range(len(scene.pairs)):
        own = order[ends[pair] : ends[pair + 1]]
        paths = select(traced.paths, own)
        paths = replace(paths, n_pairs=1, pair=np.zeros_like(paths.pair))
        factors = None if traced.factors is None else traced.factors[:, own]
        alone = replace(scene, pairs=scene.pairs[pair : pair + 1])
        problems = _problems(
            alone, DesignTrace(paths, factors, traced.duration_s), filters, foreseen, typical
        )
        times = _settled_times(problems, foreseen, typical)
        settled = [_coherent(problem, times) for problem in problems]
        found.append(np.stack([_at_draw(settled, foreseen, draw, times) for draw in draws]))
        if progress is not None:
            progress((pair + 1) / len(scene.pairs))
    return np.stack(found)


def _problems(
    alone: Scene,
    traced: DesignTrace,
    filters: tuple[BandFilter, ...],
    foreseen: Foreseen,
    typical: FloatArray,
) -> list[EnergyProblem | CoherentProblem]:
    """Return the problem of every band for the only pair of a scene."""
    c = speed_of_sound_m_s(alone.air)
    direct_s = float(distances_m(alone)[0] / c)
    timing_sd_s = float(np.sqrt(2.0) * foreseen.position_sd_m / c)
    binned = bin_paths(alone, foreseen.bands, traced.paths, traced.duration_s, traced.factors)
    image = np.flatnonzero(traced.paths.batch < 0)
    images = select(traced.paths, image)
    weights = None if traced.factors is None else traced.factors[:, image]
    problems: list[EnergyProblem | CoherentProblem] = []
    for f in filters:
        energies = expected_problem(
            *(f, in_band(binned, f.centre_hz), direct_s),
            *(_absorption(foreseen, f.band, typical[:, f.band]), foreseen.decay_range_db),
            timing_sd_s,
            periods=_PRESSURE_PERIODS if foreseen.coherent else _ENERGY_PERIODS,
        )
        if not foreseen.coherent:
            problems.append(energies)
            continue
        energies = replace(
            energies, model_error=_PRESSURE_MODEL_ERROR, ringing_error=_PRESSURE_RINGING_ERROR
        )
        problems.append(
            coherent_problem(
                *(foreseen.bands, f.band, energies, f.attenuation_per_m),
                *(paths_at(images, weights, f.band), binned, _pair_geometry(foreseen, c)),
                *(None, FIT_END_S),
            )
        )
    return problems


def _at_draw(
    problems: list[EnergyProblem | CoherentProblem],
    foreseen: Foreseen,
    absorption: FloatArray,
    covariance: FloatArray | None,
) -> FloatArray:
    """Return the information of one pair at one absorption, shape (n_bands, n + 1, n + 1).

    Arrival times are integrated out of each band under what all other bands, and the other pairs,
    tell of them.

    Parameters
    ----------
    problems : list of problems, one a band
        As coherent as arrival times will be known.
    covariance : float array, or None
        Of the fitted arrival times, from `_settled_times`.
    """
    found = [_fisher(p, absorption[:, band]) for band, p in enumerate(problems)]
    if covariance is None:
        return np.stack(found)
    first = found[0].shape[0] - len(covariance)
    return without_geometry(found, first, _shared(foreseen), foreseen.n_pairs - 1)


def _settled_times(
    problems: list[EnergyProblem | CoherentProblem], foreseen: Foreseen, absorption: FloatArray
) -> FloatArray | None:
    """Return how uncertain arrival times are in the end: the covariance of their free numbers.

    Bands go from low to high, as in a fit: each is as coherent as the lower ones leave arrival
    times known. Of the speed of sound and of the walls' delays the other pairs tell as much as
    this one. None where energies are compared.
    """
    if isinstance(problems[0], EnergyProblem):
        return None
    first = len(start_vector(Parameters(problems[0].parameters.blocks[:2])))
    covariance: FloatArray | None = None
    for band, problem in enumerate(problems):
        information = _fisher(_coherent(problem, covariance), absorption[:, band])
        told = by_all_pairs(
            about_geometry(information, first), _shared(foreseen), foreseen.n_pairs - 1
        )
        known = np.eye(len(told)) if covariance is None else np.linalg.inv(covariance)
        inverse = np.linalg.inv(known + told)
        covariance = np.asarray(0.5 * (inverse + inverse.T))
    return covariance


def _coherent(
    problem: EnergyProblem | CoherentProblem, covariance: FloatArray | None
) -> EnergyProblem | CoherentProblem:
    """Return a band's problem as coherent as a covariance of arrival times allows."""
    if isinstance(problem, EnergyProblem):
        return problem
    return with_coherence(problem, whole_covariance(problem.geometry, covariance))


def _fisher(problem: EnergyProblem | CoherentProblem, absorption: FloatArray) -> FloatArray:
    """Return the Fisher information of a band's data about its free numbers, without priors.

    At an absorption, shape (n_materials,), and at a gain of 1.
    """
    own, *others = problem.parameters.blocks
    problem = replace(problem, parameters=Parameters((replace(own, start=absorption), *others)))
    vector = start_vector(problem.parameters)
    jacobian = problem.predict(vector).jacobian
    spread = problem.counted_as_one() * problem.variance(vector)
    return np.asarray(jacobian.T @ (jacobian / spread[:, None]))


def _absorption(foreseen: Foreseen, band: int, absorption: FloatArray) -> Block:
    return replace(absorption_block(foreseen.knowledge, band, 0.2), start=absorption)


def _pair_geometry(foreseen: Foreseen, speed_m_s: float) -> Geometry:
    """Return the unknowns of one pair's arrival times, each pair's its own."""
    names = tuple(f"delay {k.name}" for k in foreseen.knowledge)
    told = [k.wall_delay_sd_s for k in foreseen.knowledge]
    delays = [DELAY_SD_S if sd is None else sd for sd in told]
    n = len(names)
    sd = [*(6 * [foreseen.position_sd_m]), foreseen.speed_sd, LATENCY_SD_S["emission"]]
    return Geometry(
        (*(f"{p} {x}" for p in ("source", "receiver") for x in "xyz"), "speed", "latency", *names),
        np.array([*sd, *(delays if foreseen.wall_delays else n * [0.0])]),
        np.array(8 * [foreseen.positions_free] + n * [foreseen.wall_delays]),
        speed_m_s,
        np.arange(8 + n)[None, :],
    )


def _shared(foreseen: Foreseen) -> BoolArray:
    """Return which fitted entries of `_pair_geometry` all pairs have in common."""
    geometry = _pair_geometry(foreseen, 1.0)
    common = np.array([label == "speed" or label.startswith("delay") for label in geometry.labels])
    return np.asarray(common[geometry.fitted & (geometry.sd > 0.0)])
