"""Fisher information of measurements that have not been made, by the noise model of the fit.

A pair's windows and noise are those that the fit would have. Information matrices of one band stand
for absorptions and gain first, then for the geometry: what sets arrival times, in multiples of its
prior standard deviations, so that its prior is the unit matrix. All bands of a pair share the
geometry, which is integrated out; pairs that share a gain inform together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeAlias

import numpy as np

from roomfit.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.bands import Bands
from roomfit.experiment_design.prior import PriorInformation, Unknowns
from roomfit.inversion.sequential import FIT_END_S
from roomfit.logit import Z95, expit
from roomfit.objective.coherent import (
    RINGING_PERIODS,
    CoherentTerm,
    coherent_term,
    with_coherence,
)
from roomfit.objective.energy import (
    EnergyTerm,
    Observation,
    fine_edges_s,
    first_windows,
    in_air,
)
from roomfit.objective.observation import absorption_block
from roomfit.objective.parameters import (
    GEOMETRY,
    Block,
    Geometry,
    Parameters,
    geometry_block,
    position_of,
    start_vector,
    whole_covariance,
)
from roomfit.objective.problem import Objective
from roomfit.objective.windows import window_edges_s
from roomfit.response.binned import BinnedPaths, bin_paths, in_band
from roomfit.response.coherent import ImagePaths, image_paths, images_of
from roomfit.response.energy import EnergyRows, first_rows, weigh
from roomfit.scene import Scene, distances_m, select_pairs
from roomfit.signals.filters import (
    SpreadingKernel,
    spreading_kernel,
    spreading_matrix,
    spreading_reach_s,
    spreading_slopes_per_s,
    statistical_bandwidth_hz,
)
from roomfit.tracing.paths import Paths, select
from roomfit.typing import BoolArray, FloatArray, IntArray, Progress

# As in a fit: a window is used down to where the decay stands 4 dB above the noise.
_CLEAR_OF_NOISE = 2.5
# The time constant of the late decay is read from 5 dB below the whole energy on.
_FROM_DB = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class BandFilter:
    """One band's filter with all that is computed of it once."""

    band: int
    centre_hz: float
    bandwidth_hz: float
    kernel: SpreadingKernel  # of all bands
    attenuation_per_m: float


def band_filters(bands: Bands, attenuation_per_m: FloatArray) -> tuple[BandFilter, ...]:
    """Return the filter of every band."""
    kernel = spreading_kernel(bands)
    found = []
    for band, centre_hz in enumerate(bands.centres_hz):
        alone = Bands(bands.kind, bands.centres_hz[band : band + 1])
        width_hz = float(statistical_bandwidth_hz(alone)[0])
        attenuation = float(attenuation_per_m[band])
        found.append(BandFilter(band, float(centre_hz), width_hz, kernel, attenuation))
    return tuple(found)


def expected_term(
    own: BandFilter,
    coarse: BinnedPaths,
    direct_s: float,
    absorption: Block,
    decay_range_db: float,
    timing_sd_s: float,
    *,
    periods: float,
) -> EnergyTerm:
    """Return the windows of one pair that has not been measured yet.

    Its noise stands where the expected decay, at the absorption the block starts with, has fallen
    by `decay_range_db`. The "measured" energy is that noise: only the variance of predictions is
    asked of them, not how well they fit.

    Parameters
    ----------
    coarse : BinnedPaths
        Of this pair alone, in the bins of this band.
    direct_s : float
        Travel time of the direct sound.
    timing_sd_s : float
        Of arrival times, from the positions.
    periods : float
        How short the windows may be, see `window_edges_s`.
    """
    rows = coarse.rows[0]
    usable_s, noise_per_s = expected_noise(own, coarse.edges_s, rows, absorption, decay_range_db)
    edges = window_edges_s(direct_s, usable_s, own.bandwidth_hz, periods=periods)
    fine = fine_edges_s(edges, own.bandwidth_hz)
    centres = 0.5 * (coarse.edges_s[1:] + coarse.edges_s[:-1])
    reach_s = spreading_reach_s(own.kernel, own.band)
    bin_centres_s = centres[: int(np.searchsorted(centres, edges[-1] + reach_s))]
    noise = noise_per_s * np.diff(edges)
    observed = Observation(
        0,
        edges,
        noise,
        noise,
        spreading_matrix(own.kernel, own.band, bin_centres_s, edges),
        fine,
        spreading_matrix(own.kernel, own.band, bin_centres_s, fine),
        spreading_slopes_per_s(own.kernel, own.band, bin_centres_s, edges),
        timing_sd_s,
        0,
    )
    rows = first_rows(rows, bin_centres_s.size)
    return in_air(
        EnergyTerm(
            own.centre_hz,
            own.bandwidth_hz,
            own.attenuation_per_m,
            (rows,),
            (observed,),
        )
    )


def expected_noise(
    own: BandFilter,
    edges_s: FloatArray,
    rows: EnergyRows,
    absorption: Block,
    decay_range_db: float,
) -> tuple[float, float]:
    """Return where the usable decay would end in s, and the energy of the noise per second.

    The decay is that of Schroeder's backward integral; the noise has the power that the decay has
    left after `decay_range_db`.
    """
    attenuation = np.array([own.attenuation_per_m])
    energy = weigh(rows, absorption.start[:, None], attenuation, derivative=False).energy[0]
    left = np.cumsum(energy[::-1])[::-1]
    levels_db = -10.0 * np.log10(np.maximum(left / left[0], 1e-30))
    late = int(np.searchsorted(levels_db, decay_range_db))
    late = min(late, edges_s.size - 2)
    early = min(int(np.searchsorted(levels_db, _FROM_DB)), late - 1)
    fallen = (levels_db[late] - levels_db[early]) * np.log(10.0) / 10.0
    constant_s = float(edges_s[late] - edges_s[early]) / max(float(fallen), 1e-6)
    end_s = float(edges_s[late]) - np.log(_CLEAR_OF_NOISE) * constant_s
    return end_s, float(left[0] * 10.0 ** (-0.1 * decay_range_db) / constant_s)


def _unit_gain() -> Block:
    """Return an unknown level without a prior."""
    one = np.ones(1)
    return Block(
        "gain",
        ("level",),
        "log",
        one,
        np.ones(1, dtype=np.bool_),
        0.0 * one,
        np.full(1, np.inf),
        0.0 * one,
        one,
    )


# Information about an absorption that keeps an inverse finite where a band is not affected by it.
_LEAST = 1e-6


def about_geometry(information: FloatArray, first: int) -> FloatArray:
    """Return a band's information on the geometry, its own absorptions and gain unknown."""
    own = information[:first, :first] + _LEAST * np.eye(first)
    cross = information[:first, first:]
    return np.asarray(information[first:, first:] - cross.T @ np.linalg.solve(own, cross))


def by_all_pairs(information: FloatArray, shared: BoolArray, n_others: int) -> FloatArray:
    """Return a pair's information on the geometry, with n others' on the part that all share."""
    own = ~shared
    cross = information[np.ix_(shared, own)]
    position_information = information[np.ix_(own, own)] + np.eye(int(own.sum()))
    out = information.copy()
    out[np.ix_(shared, shared)] += n_others * (
        information[np.ix_(shared, shared)] - cross @ np.linalg.solve(position_information, cross.T)
    )
    return np.asarray(out)


def without_geometry(
    found: list[FloatArray], first: int, shared: BoolArray, n_others: int
) -> FloatArray:
    """Integrate the geometry out of every band's information, under that of all bands on it.

    Parameters
    ----------
    found : list of float arrays, shape (first + n_geometry, first + n_geometry)
    shared : bool array, shape (n_geometry,)
        What all pairs have in common.
    n_others : int
        Other pairs that inform as much on the shared part.
    """
    geometry_information = [about_geometry(information, first) for information in found]
    n = geometry_information[0].shape[0]
    whole = by_all_pairs(sum(geometry_information, np.zeros((n, n))), shared, n_others)
    out = []
    for information, own in zip(found, geometry_information, strict=True):
        known = np.eye(n) + whole - own + information[first:, first:]
        cross = information[:first, first:]
        taken = cross @ np.linalg.solve(known, cross.T)
        out.append(information[:first, :first] - 0.5 * (taken + taken.T))
    return np.stack(out)


# Windows as short as the fit's: of energies, and of pressures.
_ENERGY_PERIODS, _PRESSURE_PERIODS = 1.5, 0.75
# What a fit of pressures assumes first of the model's errors: see `roomfit.inversion.sequential`.
_PRESSURE_MODEL_ERROR, _PRESSURE_RINGING_ERROR = 0.1, 0.0


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedMeasurement:
    """How the measurements to be planned will be made and fitted."""

    coherent: bool  # whether pressures of image sources will be added, or energies only
    n_pairs: int  # how many pairs will have been measured in the end
    decay_range_db: float  # how far a decay will be observed above the noise
    position_sd_m: float  # of every coordinate of source and receiver
    duration_s: float  # how long sound is followed
    geometry: Geometry  # what sets one pair's arrival times, each pair's its own
    shared: BoolArray  # which fitted entries of it all pairs have in common


def information_of_pairs(
    scene: Scene,
    paths: Paths,
    factors: FloatArray | None,
    known: PriorInformation,
    expected: ExpectedMeasurement,
    progress: Progress | None = None,
) -> FloatArray:
    """Return the information of every pair, (n_pairs, n_draws, n_bands, n + 1, n + 1).

    About the n unknown absorptions (as free numbers) and the log of the pair's gain.

    Parameters
    ----------
    paths : Paths
        Of all pairs.
    factors : float array, shape (n_bands, n_paths), or None
        On the weight of every path in every band.
    known : PriorInformation
        Windows and noise are laid out by its typical absorption; its draws are asked at.
    """
    filters = band_filters(known.bands, attenuation_per_m(scene.air, known.bands))
    order = np.argsort(paths.pair, kind="stable")
    ends = np.searchsorted(paths.pair[order], np.arange(len(scene.pairs) + 1))
    found = []
    for pair in range(len(scene.pairs)):
        own = order[ends[pair] : ends[pair + 1]]
        caught = select(paths, own)
        caught = replace(caught, n_pairs=1, pair=np.zeros_like(caught.pair))
        weights = None if factors is None else factors[:, own]
        alone = select_pairs(scene, slice(pair, pair + 1))
        objectives = _objectives(alone, caught, weights, filters, known, expected)
        times = _covariance_of_times(objectives, expected, known.typical)
        coherent = [objective(times) for objective in objectives]
        found.append(np.stack([_at_draw(coherent, expected, draw, times) for draw in known.draws]))
        if progress is not None:
            progress((pair + 1) / len(scene.pairs))
    return np.stack(found)


ObjectiveOfTimes: TypeAlias = Callable[[FloatArray | None], Objective]
"""From a covariance of arrival times, None for the prior's, to a band's objective."""


def _of_energies(objective: Objective, _covariance: FloatArray | None) -> Objective:
    """Return the objective of energies, which no covariance of arrival times changes."""
    return objective


def _as_coherent_as_known(
    parameters: Parameters, term: CoherentTerm, covariance: FloatArray | None
) -> Objective:
    """Return the objective of windows as coherent as a covariance of arrival times allows."""
    coherent = with_coherence(term, whole_covariance(term.geometry, covariance))
    return Objective(parameters, (coherent,))


def _objectives(
    alone: Scene,
    paths: Paths,
    factors: FloatArray | None,
    filters: tuple[BandFilter, ...],
    known: PriorInformation,
    expected: ExpectedMeasurement,
) -> list[ObjectiveOfTimes]:
    """Return the objective of every band for the only pair of a scene."""
    c = speed_of_sound_m_s(alone.air)
    direct_s = float(distances_m(alone)[0] / c)
    timing_sd_s = float(np.sqrt(2.0) * expected.position_sd_m / c)
    binned = bin_paths(alone, known.bands, paths, expected.duration_s, factors)
    images: ImagePaths | None = None
    objectives: list[ObjectiveOfTimes] = []
    for f in filters:
        absorption = replace(
            absorption_block(known.priors, f.band, 0.2), start=known.typical[:, f.band]
        )
        parameters = Parameters((absorption, _unit_gain()))
        energies = expected_term(
            f,
            in_band(binned, f.centre_hz),
            direct_s,
            absorption,
            expected.decay_range_db,
            timing_sd_s,
            periods=_PRESSURE_PERIODS if expected.coherent else _ENERGY_PERIODS,
        )
        if not expected.coherent:
            objectives.append(partial(_of_energies, Objective(parameters, (energies,))))
            continue
        energies = replace(
            energies, model_error=_PRESSURE_MODEL_ERROR, ringing_error=_PRESSURE_RINGING_ERROR
        )
        if images is None:
            # those that any band adds as pressures, of which the lowest rings longest
            last_s = float(first_windows(energies.observations[0], FIT_END_S).edges_s[-1])
            last_s = max(last_s, FIT_END_S) + RINGING_PERIODS / f.centre_hz
            images = image_paths(paths, np.zeros(1, dtype=np.int64), 0.0, c * last_s)
        term = coherent_term(
            known.bands,
            f.band,
            energies,
            f.attenuation_per_m,
            images_of(
                images, np.zeros(1, dtype=np.int64), None if factors is None else factors[f.band]
            ),
            binned,
            expected.geometry,
            FIT_END_S,
        )
        parameters = Parameters((*parameters.blocks, geometry_block(expected.geometry)))
        objectives.append(partial(_as_coherent_as_known, parameters, term))
    return objectives


def _at_draw(
    objectives: list[Objective],
    expected: ExpectedMeasurement,
    absorption: FloatArray,
    covariance: FloatArray | None,
) -> FloatArray:
    """Return the information of one pair at one absorption, shape (n_bands, n + 1, n + 1).

    Arrival times, of the covariance that `_covariance_of_times` gives, are integrated out of each
    band under the information that all other bands, and the other pairs, have on them.
    """
    found = [_fisher(p, absorption[:, band]) for band, p in enumerate(objectives)]
    if covariance is None:
        return np.stack(found)
    first = found[0].shape[0] - len(covariance)
    return without_geometry(found, first, expected.shared, expected.n_pairs - 1)


def _covariance_of_times(
    objectives: list[ObjectiveOfTimes],
    expected: ExpectedMeasurement,
    absorption: FloatArray,
) -> FloatArray | None:
    """Return how uncertain arrival times are in the end: the covariance of their free numbers.

    Bands go from low to high, as in a fit: each is as coherent as the lower ones leave arrival
    times known. On the speed of sound and the walls' delays the other pairs inform as much as
    this one. None where energies are compared.
    """
    if not expected.coherent:
        return None
    covariance: FloatArray | None = None
    for band, objective_of_times in enumerate(objectives):
        objective = objective_of_times(covariance)
        first = position_of(objective.parameters, GEOMETRY)
        information = _fisher(objective, absorption[:, band])
        from_pairs = by_all_pairs(
            about_geometry(information, first), expected.shared, expected.n_pairs - 1
        )
        known = np.eye(len(from_pairs)) if covariance is None else np.linalg.inv(covariance)
        inverse = np.linalg.inv(known + from_pairs)
        covariance = np.asarray(0.5 * (inverse + inverse.T))
    return covariance


def _fisher(objective: Objective, absorption: FloatArray) -> FloatArray:
    """Return the Fisher information of a band's data about its free numbers, without priors.

    At an absorption, shape (n_materials,), and at a gain of 1.
    """
    own, *others = objective.parameters.blocks
    parameters = Parameters((replace(own, start=absorption), *others))
    objective = replace(objective, parameters=parameters)
    vector = start_vector(parameters)
    jacobian = objective.predict(vector).jacobian
    spread = objective.correlation_length() * objective.variance(vector)
    return np.asarray(jacobian.T @ (jacobian / spread[:, None]))


# Of a gain: next to nothing, so that a pair without energy does not divide by zero.
_LEAST_GAIN_INFORMATION = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class PairInformation:
    """Fisher information of a measurement of each pair of source and receiver, by itself."""

    # (n_pairs, n_draws, n_bands, n + 1, n + 1): of the n unknowns and, last, the log of the gain.
    # Whatever else is unknown of a pair has been eliminated.
    matrices: FloatArray
    # (n_pairs,): pairs of one number share one unknown gain in each band; -1: the level is known
    gain: IntArray


def without_gain(matrices: FloatArray) -> FloatArray:
    """Return the information about the absorptions when the gain is found along with them.

    The Schur complement of the last row and column, shape (..., n, n) of (..., n + 1, n + 1).
    """
    cross = matrices[..., :-1, -1]
    own = matrices[..., -1, -1] + _LEAST_GAIN_INFORMATION
    taken = cross[..., :, None] * cross[..., None, :] / own[..., None, None]
    return np.asarray(matrices[..., :-1, :-1] - taken)


def information_of(
    unknowns: Unknowns, pairs: PairInformation, chosen: list[int] | IntArray
) -> FloatArray:
    """Return the information after some pairs are measured, (n_draws, n_bands, n, n).

    Pairs that share a gain have more information together than the sum of each alone. More pairs
    never have less.

    `chosen`: indices of the pairs that are measured.
    """
    total = unknowns.information.copy()
    picked = np.asarray(chosen, dtype=np.int64)
    gains = pairs.gain[picked]
    for gain in np.unique(gains):
        own = pairs.matrices[picked[gains == gain]].sum(axis=0)
        total += own[..., :-1, :-1] if gain < 0 else without_gain(own)
    return np.asarray(total)


def interval_widths(unknowns: Unknowns, information: FloatArray) -> FloatArray:
    """Return the expected width of each unknown's 95 % interval, shape (..., n_bands, n).

    The mean over the draws. An interval is symmetric in logit, as a fit's is.

    `information` has the shape (..., n_draws, n_bands, n, n).
    """
    covariance = np.linalg.inv(information)
    reach = Z95 * np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    ends = [expit(unknowns.logit + sign * reach) for sign in (1.0, -1.0)]
    width = (unknowns.upper - unknowns.lower) * (ends[0] - ends[1])
    return np.asarray(width.mean(axis=-3))


def material_widths(unknowns: Unknowns, widths: FloatArray) -> FloatArray:
    """Return the widths of every material, known ones 0, shape (n_materials, n_bands).

    `widths` has the shape (n_bands, n).
    """
    padded = np.concatenate((widths, np.zeros((len(widths), 1))), axis=1)
    return np.asarray(padded[:, unknowns.number].T)
