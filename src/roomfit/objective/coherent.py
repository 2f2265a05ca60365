"""Measured windows of one band against partly coherent image sources and energies of the rest.

Positions, speed of sound and times are unknowns; every path is as coherent as its arrival time is
known.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from roomfit.air import speed_of_sound_m_s
from roomfit.bands import Bands
from roomfit.materials.priors import MaterialPrior
from roomfit.measurement import LATENCY_SD_S, MeasuredPair
from roomfit.objective.energy import (
    EnergyProblem,
    Observation,
    Weighed,
    first_windows,
    noise_and_model_variance,
    observation_variance,
    predict_windows,
    weighed,
)
from roomfit.objective.observation import DEFAULT_POSITION_SD_M
from roomfit.objective.parameters import (
    GEOMETRY,
    Geometry,
    Marginal,
    Parameters,
    fitted_columns,
    geometry_block,
    local_roots,
    physical_values,
    position_of,
    times_of,
)
from roomfit.objective.problem import Prediction, gamma_log_likelihood
from roomfit.objective.windows import in_windows
from roomfit.response.binned import BinnedPaths, in_band, regrouped
from roomfit.response.coherent import (
    BandGrid,
    ImagePaths,
    band_grid,
    binned_energies,
    chosen_paths,
    coherent_response,
    image_energies,
    image_paths,
    spread_squared,
)
from roomfit.response.energy import first_rows
from roomfit.scene import Scene
from roomfit.signals.filters import FilterBank
from roomfit.tracing.paths import Paths
from roomfit.typing import BoolArray, FloatArray, IntArray

# A path less coherent than this is left to the energies.
_LEAST_COHERENCE = 1e-3
# Relative error of a travel time that no fitted parameter stands for.
_TIMING_SHARE = 1e-4
# The same of a position, per coordinate, in m.
_POSITION_SD_M = 0.5e-3
# Windows share errors that no term of the covariance stands for, as a description that is a little
# off; see docs/decisions/0022-how-many-windows-count-as-one.md.
WINDOWS_PER_INDEPENDENT_ONE = 1.35


@dataclass(frozen=True, slots=True, eq=False)
class CoherentProblem:
    """One band: absorption, gains and geometry under which partly coherent paths explain it.

    The expected energy of a window is what `energies` expects of all paths, less the coherent part
    gamma e of the image paths, plus the energy of their coherent pressure.
    """

    energies: EnergyProblem  # all paths, as energies; its parameters are not used
    # the first windows of every observation, in which pressures add; later ones hold so many
    # reflections of so uncertain times that their energies add
    early: tuple[Observation, ...]
    parameters: Parameters  # blocks "absorption", "gain" and "geometry"
    geometry: Geometry
    images: ImagePaths  # all image paths of the observations with the coherence of each
    coherent: ImagePaths  # those of them that are coherent at all
    bins: IntArray  # (n_images,), fine time bin of each of `images`
    coherent_bins: IntArray  # of each of `coherent`
    grid: BandGrid
    centre_hz: float

    def measured(self) -> FloatArray:
        """Return the measured window energies, all observations end to end, (n_windows,)."""
        return self.energies.measured()

    def predict(self, vector: FloatArray) -> Prediction:
        """Return what the model expects in every window."""
        values, slopes = physical_values(self.parameters, vector)
        n_leading = position_of(self.parameters, GEOMETRY)
        leading = Parameters(tuple(b for b in self.parameters.blocks if b.name != GEOMETRY))
        # all paths as energies, with the unknowns that these have
        plain = predict_windows(replace(self.energies, parameters=leading), vector[:n_leading])
        extra, by_absorption, by_times = _correction(self, values)
        gains = np.append(values["gain"], 1.0)
        gain = gains[_gain_of_window(self)]
        columns = np.zeros((extra.size, values["gain"].size))
        for k in range(columns.shape[1]):
            columns[_gain_of_window(self) == k, k] = 1.0
        jacobians = {
            "absorption": gain[:, None] * by_absorption * slopes["absorption"],
            "gain": columns * extra[:, None] * slopes["gain"],
            GEOMETRY: gain[:, None] * by_times * slopes[GEOMETRY],
        }
        jacobian = fitted_columns(self.parameters, jacobians)
        jacobian[:, :n_leading] += plain.jacobian
        added = gain * extra
        return Prediction(plain.expected + added, plain.signal + added, jacobian)

    def variance(self, vector: FloatArray) -> FloatArray:
        """Return how far every window may scatter; see `coherent_variance`."""
        return coherent_variance(self, vector)

    def correlation_length(self) -> FloatArray:
        """Return `WINDOWS_PER_INDEPENDENT_ONE` for every window."""
        return np.full(self.measured().size, WINDOWS_PER_INDEPENDENT_ONE)

    def is_gamma(self) -> BoolArray:
        """Return True for every window."""
        return self.energies.is_gamma()

    def log_likelihood(self, expected: FloatArray, variance: FloatArray) -> FloatArray:
        """Return the log density of every window's energy."""
        return gamma_log_likelihood(self.measured(), expected, variance)


def with_coherence(
    problem: CoherentProblem, covariance: FloatArray, phase_sd: float = 0.0
) -> CoherentProblem:
    """Return the problem with each path as coherent as its arrival time is known.

    ``gamma = exp(-w^2 var(t) - phase_sd^2 n)`` with w of the band's centre, n hits, and var(t) of
    the geometry's covariance, of positions to half a millimetre and of a share of 1e-4 of the time.

    Parameters
    ----------
    covariance : float array, shape (n, n)
        Of all entries of the geometry's free numbers, fixed ones zero.
    phase_sd : float
        Standard deviation of the phase that a reflection adds at random, rad.
    """
    images, c = problem.images, problem.geometry.speed_m_s
    length = np.linalg.norm(images.image_to_receiver_m, axis=1)
    toward = images.image_to_receiver_m / length[:, None]
    departure = np.einsum("nij,ni->nj", images.image_transform.reshape(-1, 3, 3), toward)
    spread = np.empty(length.size)
    roots = local_roots(problem.geometry, covariance)
    spread_squared(images.offsets, toward, departure, length / c, images.hits, c, roots, spread)
    spread += 2.0 * (_POSITION_SD_M / c) ** 2 + (_TIMING_SHARE * length / c) ** 2
    phase = (2.0 * np.pi * problem.centre_hz) ** 2 * spread
    phase += phase_sd**2 * images.hits.sum(axis=1)
    return _with_gamma(problem, np.exp(-phase))


def fully_coherent(problem: CoherentProblem) -> CoherentProblem:
    """Return the problem with every path as coherent as if its arrival time were known."""
    return _with_gamma(problem, np.ones(problem.bins.size))


def _with_gamma(problem: CoherentProblem, gamma: FloatArray) -> CoherentProblem:
    keep = (gamma > _LEAST_COHERENCE) & (problem.bins >= 0)
    images = replace(problem.images, coherence=np.where(keep, gamma, 0.0))
    return replace(
        problem,
        images=images,
        coherent=chosen_paths(images, keep),
        coherent_bins=problem.bins[keep],
    )


def _correction(
    problem: CoherentProblem, values: dict[str, FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what coherence adds to each window at a gain of 1, by absorption and geometry."""
    absorption = values["absorption"]
    response = coherent_response(
        problem.coherent,
        absorption,
        times_of(problem.geometry, values[GEOMETRY]),
        problem.grid,
        tuple(o.edges_s for o in problem.early),
    )
    n_materials = absorption.size
    energy = image_energies(problem.coherent, absorption) * problem.coherent.coherence
    less, less_by_hits = [], []
    for o, observed in enumerate(problem.early):
        own = slice(problem.coherent.offsets[o], problem.coherent.offsets[o + 1])
        n_bins = observed.spreading.shape[1]
        total, by_hits = np.zeros(n_bins), np.zeros((n_materials, n_bins))
        binned_energies(
            problem.coherent_bins[own],
            problem.coherent.hits[own],
            energy[own],
            total,
            by_hits,
        )
        less.append(observed.spreading @ total)
        less_by_hits.append(in_windows(observed.spreading, by_hits))
    by_log = response.by_log_reflected - np.concatenate(less_by_hits)
    # d ln(1 - a) = -da / (1 - a)
    by_absorption = -by_log / np.maximum(1.0 - absorption, 1e-12)
    by_times = np.zeros((by_log.shape[0], problem.geometry.sd.size))
    for o, windows in enumerate(_windows(problem.early)):
        np.add.at(
            by_times,
            (windows[:, None], problem.geometry.columns[o][None, :]),
            response.by_times[windows],
        )
    return (
        _with_late_zeros(problem, response.energy - np.concatenate(less)),
        _with_late_zeros(problem, by_absorption),
        _with_late_zeros(problem, by_times * problem.geometry.sd),
    )


def _with_late_zeros(problem: CoherentProblem, early: FloatArray) -> FloatArray:
    """Return values of early windows among zeros for the late ones, first axis windows."""
    out: FloatArray = np.zeros((problem.measured().size, *early.shape[1:]))
    out[_early_windows(problem)] = early
    return out


def coherent_variance(problem: CoherentProblem, vector: FloatArray) -> FloatArray:
    """Return the variance of every measured window energy about its expectation.

    With Y the energy per time of the coherent pressure and P that of what is not, the random part
    interferes with itself and with the coherent one: ``(P^2 + 2 P Y - Q) / B`` integrated over the
    window, where ``Q = sum of e_i^2 (1 - gamma_i^2)`` takes out what single arrivals cannot do,
    since a single arrival has its energy whatever its phase. Without coherence, and in late
    windows, this is the variance of `roomfit.objective.energy.window_variance`.

    Returns
    -------
    float array, shape (n_windows,)
    """
    values, _ = physical_values(problem.parameters, vector)
    gains = np.append(values["gain"], 1.0)
    paths = weighed(problem.energies, values["absorption"])
    # the energy of the coherent pressure in the pieces of the windows
    intensity = coherent_response(
        problem.coherent,
        values["absorption"],
        times_of(problem.geometry, values[GEOMETRY]),
        problem.grid,
        tuple(o.fine_edges_s for o in problem.early),
        derivative=False,
    ).energy
    ends = np.cumsum([0, *(o.fine_edges_s.size - 1 for o in problem.early)])
    energy = image_energies(problem.images, values["absorption"])
    variances = []
    for o, (early, observed) in enumerate(
        zip(problem.early, problem.energies.observations, strict=True)
    ):
        gain = float(gains[observed.gain])
        coherent = intensity[ends[o] : ends[o + 1]]
        own = _early_variance(problem, o, paths[o], energy, coherent, gain)
        if early.energy.size < observed.energy.size:
            late = observation_variance(problem.energies, o, paths[o], gain)
            own = np.concatenate((own, late[own.size :]))
        variances.append(own)
    return np.concatenate(variances)


def _early_variance(
    problem: CoherentProblem,
    observation: int,
    paths: Weighed,
    energy: FloatArray,
    coherent: FloatArray,
    gain: float,
) -> FloatArray:
    """Return the variance of an observation's early windows.

    `energy` is that of all `problem.images`, `coherent` that of the coherent pressure in each of
    the windows' pieces.
    """
    observed, images = problem.early[observation], problem.images
    own = slice(images.offsets[observation], images.offsets[observation + 1])
    inside = problem.bins[own] >= 0
    bins, e, g = (x[own][inside] for x in (problem.bins, energy, images.coherence))
    n_bins = observed.spreading.shape[1]
    random = np.maximum(paths.energy - np.bincount(bins, g * e, n_bins), 0.0)
    single = np.bincount(bins, e**2 * (1.0 - g**2), n_bins)
    late = np.bincount(bins, (e * (1.0 - g)) ** 2, n_bins)
    spread = observed.fine_spreading @ random
    pieces = spread**2 + 2.0 * spread * coherent - observed.fine_spreading.power(2) @ single
    pieces = np.maximum(pieces, 0.0)
    pieces /= problem.energies.bandwidth_hz * np.diff(observed.fine_edges_s)
    first = np.searchsorted(observed.fine_edges_s, observed.edges_s[:-1])
    interference = np.add.reduceat(pieces, first)
    timing = observed.timing_sd_s**2 * (observed.slopes.power(2) @ late)
    tracing = paths.tracing[: observed.energy.size]
    signal = gain * (observed.spreading @ random + np.add.reduceat(coherent, first))
    rest = noise_and_model_variance(problem.energies, observed, signal)
    return np.asarray(gain**2 * (interference + timing + tracing) + rest)


def _windows(observed: tuple[Observation, ...]) -> list[IntArray]:
    """Return which windows belong to each observation."""
    ends = np.cumsum([0, *(o.energy.size for o in observed)])
    return [np.arange(low, high) for low, high in pairwise(ends)]


def _early_windows(problem: CoherentProblem) -> IntArray:
    """Return where the early windows stand among all."""
    every = _windows(problem.energies.observations)
    own = [w[: o.energy.size] for w, o in zip(every, problem.early, strict=True)]
    return np.concatenate(own)


def _gain_of_window(problem: CoherentProblem) -> IntArray:
    observed = problem.energies.observations
    return np.repeat([o.gain for o in observed], [o.energy.size for o in observed])


@dataclass(frozen=True, slots=True, eq=False)
class FittedGeometry:
    """What the bands together determine of arrival times; never a measurement of positions.

    Fitted positions absorb errors of the model as well.
    """

    # "source LS1 x", ..., "speed of sound", "latency LS1", "delay wool", ...
    labels: tuple[str, ...]
    change: FloatArray  # (n,), from the prior: m, 1 (of ln c), s, s
    # sd, prior_sd: (n,), posterior and prior, in the same units
    sd: FloatArray
    prior_sd: FloatArray
    speed_of_sound_m_s: float


# Prior standard deviations of unknowns that are unspecified.
SPEED_SD = 2e-3
DELAY_SD_S = 2e-4


def cut_at(binned: BinnedPaths, end_s: float) -> BinnedPaths:
    """Return the bins that end by a time, with their rows."""
    n = max(int(np.searchsorted(binned.edges_s, end_s + 1e-9, side="right")) - 1, 1)
    if n >= binned.edges_s.size - 1:
        return binned
    return regrouped(binned, binned.edges_s[: n + 1], lambda rows: first_rows(rows, n))


def campaign_geometry(
    scene: Scene,
    priors: tuple[MaterialPrior, ...],
    fitted: tuple[MeasuredPair, ...],
    *,
    positions: bool,
    delays: bool,
    speed_sd: float = SPEED_SD,
) -> Geometry:
    """Return the unknowns of arrival times of the fitted measurements.

    Parameters
    ----------
    fitted : tuple of MeasuredPair
        One an observation, in the order of the observations.
    positions : bool
        Whether positions, speed of sound and latencies may move.
    delays : bool
        Whether walls may delay.
    speed_sd : float
        Standard deviation of ln c.
    """
    labels: list[str] = []
    sd: list[float] = []
    position_columns = {}
    for kind, points in (("source", scene.sources), ("receiver", scene.receivers)):
        for i, point in enumerate(points):
            position_columns[kind, i] = len(labels)
            position_sd_m = point.position_sd_m
            labels += [f"{kind} {point.name} {axis}" for axis in "xyz"]
            sd += 3 * [DEFAULT_POSITION_SD_M if position_sd_m is None else position_sd_m]
    speed = len(labels)
    labels.append("speed of sound")
    sd.append(speed_sd)
    latency = {}
    for m in fitted:
        source = int(scene.pairs[m.pair][0])
        if source not in latency:
            latency[source] = len(labels)
            labels.append(f"latency {scene.sources[source].name}")
            assumed = LATENCY_SD_S[m.measurement.time_zero]
            sd.append(assumed if m.measurement.latency_sd_s is None else m.measurement.latency_sd_s)
    first_delay = len(labels)
    labels += [f"delay {k.name}" for k in priors]
    spreads = [DELAY_SD_S if k.wall_delay_sd_s is None else k.wall_delay_sd_s for k in priors]
    sds = np.array([*sd, *(spreads if delays else np.zeros(len(spreads)))])
    free = np.array([positions] * len(sd) + [delays] * len(spreads))
    columns = []
    for m in fitted:
        s, r = (int(i) for i in scene.pairs[m.pair])
        source_positions, receiver_positions = (
            position_columns["source", s],
            position_columns["receiver", r],
        )
        columns.append(
            [
                *range(source_positions, source_positions + 3),
                *range(receiver_positions, receiver_positions + 3),
                speed,
                latency[s],
                *range(first_delay, first_delay + len(priors)),
            ]
        )
    return Geometry(tuple(labels), sds, free, speed_of_sound_m_s(scene.air), np.array(columns))


def coherent_problem(
    bands: Bands,
    band: int,
    energies: EnergyProblem,
    attenuation_per_m: float,
    paths: Paths,
    binned: BinnedPaths,
    geometry: Geometry,
    end_s: float = np.inf,
) -> CoherentProblem:
    """Return the partly coherent problem of a band from its energy problem, not coherent yet.

    Parameters
    ----------
    energies : EnergyProblem
        Of the same paths and observations; its attenuation may be in its rows already.
    attenuation_per_m : float
        Energy attenuation of the air in the band.
    geometry : Geometry
        With one row of columns for each observation.
    end_s : float
        Pressures add in the windows that end by then.
    """
    observed = tuple(first_windows(o, end_s) for o in energies.observations)
    c = geometry.speed_m_s
    bank = FilterBank(Bands(bands.kind, bands.centres_hz[band : band + 1]))
    first = min(float(o.edges_s[0]) for o in observed)
    last = max(float(o.edges_s[-1]) for o in observed)
    grid = band_grid(bank, first, last)
    pairs = np.array([o.pair for o in observed])
    images = image_paths(paths, pairs, attenuation_per_m, c * (last + 4.0 / energies.centre_hz))
    travel = np.linalg.norm(images.image_to_receiver_m, axis=1) / c
    bin_edges_s = in_band(BinnedPaths(binned.edges_s, ()), energies.centre_hz).edges_s
    bins = np.searchsorted(bin_edges_s, travel, side="right") - 1
    n_bins = [o.spreading.shape[1] for o in observed]
    bins[bins >= np.repeat(n_bins, np.diff(images.offsets))] = -1
    parameters = Parameters((*energies.parameters.blocks, geometry_block(geometry)))
    nothing = chosen_paths(images, np.zeros(travel.size, dtype=np.bool_))
    return CoherentProblem(
        energies,
        observed,
        parameters,
        geometry,
        replace(images, coherence=np.zeros(travel.size)),
        nothing,
        bins,
        np.zeros(0, dtype=np.int64),
        grid,
        energies.centre_hz,
    )


def moved_scene(scene: Scene, geometry: Geometry, fitted: FloatArray) -> tuple[Scene, FloatArray]:
    """Return the scene with fitted positions, and these as free numbers of all entries.

    Parameters
    ----------
    fitted : float array, shape (n_fitted,)
        Free numbers of the fitted entries of the geometry.
    """
    values = np.zeros(geometry.sd.size)
    values[geometry.fitted & (geometry.sd > 0.0)] = fitted
    n_position_coordinates = 3 * (len(scene.sources) + len(scene.receivers))
    origin = np.where(np.arange(values.size) < n_position_coordinates, values, 0.0)
    steps = (geometry.sd * origin)[:n_position_coordinates].reshape(-1, 3)
    points = (*scene.sources, *scene.receivers)
    at = [replace(p, position_m=p.position_m + x) for p, x in zip(points, steps, strict=True)]
    n = len(scene.sources)
    return replace(scene, sources=tuple(at[:n]), receivers=tuple(at[n:])), origin


def fitted_geometry(geometry: Geometry, final: Marginal) -> FittedGeometry:
    """Return the geometry after the last band, with its standard deviations."""
    free = np.flatnonzero(geometry.fitted & (geometry.sd > 0.0))
    change, sd = np.zeros(geometry.sd.size), np.array(geometry.sd)
    change[free] = geometry.sd[free] * final.mean
    sd[free] = geometry.sd[free] * np.sqrt(np.diag(np.linalg.inv(final.information)))
    speed = geometry.labels.index("speed of sound")
    c = geometry.speed_m_s * float(np.exp(change[speed]))
    return FittedGeometry(geometry.labels, change, sd, geometry.sd, c)
