"""Measured ISO 3382 values of one band against those of the energies that traced paths predict."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import ClassVar, NamedTuple

import numpy as np
from scipy import fft

from roomfit.base.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import Bands
from roomfit.base.forks import count_evaluation
from roomfit.base.typing import FloatArray
from roomfit.materials.priors import MaterialPrior
from roomfit.model import weighing, windows
from roomfit.model.binned import BinnedPaths, pair_energies, regrouped, rows_at
from roomfit.model.observation import absorption_block
from roomfit.model.parameters import Parameters
from roomfit.model.problem import DataTerm, Objective, Rows, Values
from roomfit.model.pulses import energy_of_pulses, image_pulses
from roomfit.room.mesh import box_of
from roomfit.room.scene import Scene, distances_m, pair_names
from roomfit.signals.decay import DecayCurve, echogram_decay_curve, jnd_of
from roomfit.signals.filters import statistical_bandwidth_hz
from roomfit.signals.iso3382 import (
    VALUE_NAMES,
    MeasuredValues,
    ValueName,
    value_gradients,
    values_of_bins,
)

# What is wrong about the decay, or about the early part, is wrong in all values read from it.
_FAMILY = {"EDT_s": 0, "T20_s": 0, "T30_s": 0, "G_dB": 2}


MODEL_ERROR_JND = 0.3
# Of each pair, from which values at many absorptions are taken.
_ROWS_OF_A_POINT = 30_000


@dataclass(frozen=True, slots=True, eq=False)
class ValueObservation:
    """The measured values of one pair in one band."""

    pair: int  # index of the pair in the scene
    direct_s: float  # travel time of the direct sound, from which early and late are counted
    names: tuple[ValueName, ...]  # of `roomfit.signals.iso3382.VALUE_NAMES`
    measured: FloatArray  # (n_values,), in the units of their names
    # (n_values,), stated standard deviation of each value, 0 where none was stated
    spread: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ValuesTerm(DataTerm):
    """Room parameters of one band, explained by paths: absorption, no unknown gain or delay."""

    is_gamma: ClassVar[bool] = False
    bands: Bands  # the one band
    bandwidth_hz: float  # statistical bandwidth of its filter
    attenuation_per_m: float  # energy attenuation of the air
    edges_s: FloatArray  # (n_bins + 1,), uniform bins of the rows
    rows: tuple[weighing.EnergyRows, ...]  # paths of each observation's pair
    observations: tuple[ValueObservation, ...]
    spreading: windows.Spreading
    # standard deviation by which the model may be wrong, in just noticeable differences
    model_error_jnd: float = MODEL_ERROR_JND
    # what the last prediction read, by its absorption: the variance there takes no second pass
    _last: dict[bytes, list[_Decay]] = field(default_factory=dict, init=False, repr=False)
    # correlation lengths by absorption: fits of a band begin at the same
    _shared: dict[bytes, FloatArray] = field(default_factory=dict, init=False, repr=False)

    def measured(self) -> FloatArray:
        """Return the measured values, pair after pair, shape (n_values,)."""
        return np.concatenate([o.measured for o in self.observations])

    def predict(self, values: Values) -> Rows:
        """Return the values that the paths predict, with exact derivatives."""
        count_evaluation()
        walls = values["absorption"]
        found = [
            _decay(self, i, walls, partial(value_gradients, band=0, names=o.names), derivative=True)
            for i, o in enumerate(self.observations)
        ]
        self._last.clear()
        self._last[walls.tobytes()] = found
        signal = np.concatenate([decay.values for decay in found])
        by_absorption = np.concatenate([decay.by_absorption for decay in found])
        return signal, signal, {"absorption": by_absorption}

    def expected(self, values: Values) -> FloatArray:
        """Return the values that the paths predict, shape (n_values,)."""
        count_evaluation()
        own = values["absorption"][:, None], np.array([self.attenuation_per_m])
        found = []
        for i, (rows, observed) in enumerate(zip(self.rows, self.observations, strict=True)):
            curve = _curve(self, i, weighing.weigh(rows, *own))[0]
            found.append(value_gradients(curve, 0, observed.names, derivative=False)[0])
        return np.concatenate(found)

    def variance_parts(self, values: Values) -> dict[str, FloatArray]:
        """Return the variance of every value about its prediction as one part, (n_values,)."""
        covariances = value_covariances(self, values["absorption"])
        return {"values": np.concatenate([np.diag(c) for c in covariances])}

    def correlation_length(self, start: Values) -> FloatArray:
        """Return how many values of the same pair share their information, shape (n_values,).

        T20 and T30 are read from one decay: the sum of the squared correlations of each value with
        all values of its pair, 1 where it stands alone. From where the fit starts.
        """
        key = start["absorption"].tobytes()
        if key not in self._shared:
            covariances = value_covariances(self, start["absorption"])
            squares = [c**2 / np.outer(np.diag(c), np.diag(c)) for c in covariances]
            self._shared[key] = np.concatenate([s.sum(axis=1) for s in squares])
        return self._shared[key]

    def at_points(self, values: Values) -> Callable[[FloatArray], FloatArray]:
        """Return what gives the values at many absorptions, see `approximated`."""
        return approximated(self, values["absorption"])


def approximated(term: ValuesTerm, absorption: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Return what gives the values of a term at many absorptions, in a tenth of their time each.

    Exact at one absorption, from which ratios of decay times and differences of all else are taken
    with fewer paths: within a tenth of a just noticeable difference where changes are 14 of them.
    """
    whole = fft.irfft(term.spreading.spectrum, term.spreading.length)
    # what is carried farther than this is a thousandth
    reach = int(np.argmax(whole[0] + 2.0 * np.cumsum(whole[1 : term.spreading.n_bins]) > 0.999)) + 1
    shares = np.concatenate((whole[-reach:], whole[: reach + 1]))
    few = [weighing.thinned_rows(rows, _ROWS_OF_A_POINT) for rows in term.rows]
    chosen = [[VALUE_NAMES.index(name) for name in o.names] for o in term.observations]
    by_ratio = np.concatenate([np.isin(c, [0, 1, 2]) for c in chosen])

    def plain(points: FloatArray) -> FloatArray:
        found = []
        for _ in points:
            count_evaluation()
        for rows, own, observed in zip(few, chosen, term.observations, strict=True):
            energies = weighing.weigh_points(rows, points)
            every = values_of_bins(energies, shares, term.edges_s, observed.direct_s)
            found.append(every[:, own])
        return np.concatenate(found, axis=1)

    exact, there = term.expected({"absorption": absorption}), plain(absorption[None])[0]

    def values(points: FloatArray) -> FloatArray:
        found = plain(points)
        return np.asarray(np.where(by_ratio, exact * found / there, exact + found - there))

    return values


def value_covariances(term: ValuesTerm, absorption: FloatArray) -> tuple[FloatArray, ...]:
    """Return the covariance of the values of each pair about their prediction.

    By the stated spread; reflections that interfere; in a box of smooth walls what their pressures
    add up to; the number of rays; and the error of the model, which values of a family share.

    The energy of a band of bandwidth B scatters like white noise of the spectral density ``(P^2 -
    Q) / B``, P the power spread by the filter and Q that of single reflections. Carried through the
    derivatives of a value this is its variance to first order; for an exponential decay the theory
    of J. L. Davy, I. P. Dunn, P. Dubout, Acustica 43, 12-25 (1979), on which ISO 354 and ISO 3382-2
    build.
    """
    covariances = []
    known = term._last.pop(absorption.tobytes(), None)
    for i, observed in enumerate(term.observations):
        read = partial(value_gradients, band=0, names=observed.names)
        decay = None if known is None else known[i]
        predicted, interference, added, tracing = scatter_parts(term, i, absorption, read, decay)
        spread = np.diag(observed.spread**2)
        scatter = spread + (interference + np.outer(added, added)) + tracing
        covariances.append(scatter + _model(term, observed, predicted))
    return tuple(covariances)


def scatter_parts(
    term: ValuesTerm,
    i: int,
    absorption: FloatArray,
    read: Callable[..., tuple[FloatArray, FloatArray]],
    decay: _Decay | None = None,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return numbers read from the decay of a pair, and how measured ones scatter about them."""
    own = _decay(term, i, absorption, read) if decay is None else decay
    single = windows.spread_squared_energy(term.spreading, own.squares)
    overlapping = np.maximum(own.spread**2 - single, 0.0)
    variance = overlapping / (term.bandwidth_hz * np.diff(term.edges_s))
    interference = np.asarray((own.gradients * variance) @ own.gradients.T)
    added = np.zeros_like(own.values)
    if term.rows[i].length_m.any():
        by_pressures = curve_by_pressures(term, i, absorption, own.energy[None])
        added = read(by_pressures, derivative=False)[0] - own.values
    n = len(own.batches)
    tracing = n * np.atleast_2d(np.cov(own.batches.T, ddof=1)) if n > 1 else 0.0 * interference
    return own.values, interference, added, tracing


class _Decay(NamedTuple):
    """What the paths of one pair bring, and n numbers read from their decay."""

    # energy, squares: (n_bins,), of all paths, and of the squares of the single image paths
    energy: FloatArray
    squares: FloatArray
    spread: FloatArray  # (n_bins,), the energy spread as by the filter
    values: FloatArray  # (n,)
    gradients: FloatArray  # (n, n_bins), by the spread energy
    # batches, by_absorption: the numbers to first order by the energy of each batch of rays,
    # (n_batches, n), and their derivatives, (n, n_materials), where these were asked for
    batches: FloatArray
    by_absorption: FloatArray


def _decay(
    term: ValuesTerm,
    i: int,
    absorption: FloatArray,
    read: Callable[..., tuple[FloatArray, FloatArray]],
    *,
    derivative: bool = False,
) -> _Decay:
    rows = term.rows[i]
    parts = weighing.weigh_parts(
        rows, None, absorption, term.attenuation_per_m, derivative=derivative
    )
    curve, spread = _curve(term, i, parts.energy[None])
    values, gradients = read(curve)
    before = windows.despread(term.spreading, gradients)
    by_absorption = before @ parts.by_absorption
    batches = parts.batches @ before.T
    return _Decay(parts.energy, parts.squares, spread, values, gradients, batches, by_absorption)


def _curve(term: ValuesTerm, i: int, energy: FloatArray) -> tuple[DecayCurve, FloatArray]:
    """Return the decay curve of a pair, and its energies spread as by the filter."""
    spread = windows.spread_energy(term.spreading, energy)
    direct_s = term.observations[i].direct_s
    return echogram_decay_curve(term.bands, spread, term.edges_s, direct_s), spread[0]


def curve_by_pressures(
    term: ValuesTerm, i: int, absorption: FloatArray, energy: FloatArray
) -> DecayCurve:
    """Return the decay curve of a pair if the images in a box of smooth walls add as pressures.

    Images on a lattice keep their order: between walls that differ much their pressures leave 3 to
    7 dB less than their energies 15 to 30 dB down the decay, at all positions alike.
    """
    rows, edges = term.rows[i], term.edges_s
    image = np.flatnonzero(rows.length_m > 0.0)
    observed = term.observations[i]
    at_s = rows.length_m[image] / rows.length_m[image].min() * observed.direct_s
    heights = image_pulses(rows, image, absorption)
    together = energy_of_pulses(at_s, heights, edges, term.bands)
    alone = np.bincount(weighing.window_of_rows(rows)[image], heights**2, edges.size - 1)
    rest = windows.spread_energy(term.spreading, np.maximum(energy - alone, 0.0))
    return echogram_decay_curve(term.bands, rest + together, edges, observed.direct_s)


def model_sd(name: str, values: FloatArray) -> FloatArray:
    """Return the standard deviation by which the model may be wrong, in the unit of a value."""
    return MODEL_ERROR_JND * jnd_of(name, values)


def _model(term: ValuesTerm, observed: ValueObservation, predicted: FloatArray) -> FloatArray:
    # the larger of both, so that a trial far off does not pass for a precise one
    units = [
        float(jnd_of(name, np.maximum(m, p)))
        for name, m, p in zip(observed.names, observed.measured, predicted, strict=True)
    ]
    sd = term.model_error_jnd * np.array(units)
    # 1: read from early against late
    family = np.array([_FAMILY.get(name, 1) for name in observed.names])
    return np.asarray(np.outer(sd, sd) * (family[:, None] == family[None, :]))


# Room parameters hardly depend on when within half a millisecond a path arrives: TS moves by a
# fortieth of a just noticeable difference at most, and all others by less.
_BINS_AS_ONE = 5


def value_terms(
    scene: Scene,
    bands: Bands,
    measured: Sequence[MeasuredValues],
    binned: BinnedPaths,
    *,
    names: Sequence[ValueName] = VALUE_NAMES,
) -> tuple[ValuesTerm | None, ...]:
    """Return the term of every band, over all given values; None where a band has none."""
    index = {name: i for i, name in enumerate(pair_names(scene))}
    coarse = coarser(binned, _BINS_AS_ONE)
    attenuation = attenuation_per_m(scene.air, bands)
    direct_s = distances_m(scene) / speed_of_sound_m_s(scene.air)
    in_lattice = box_of(scene.room.mesh) is not None
    terms: list[ValuesTerm | None] = []
    for band, centre_hz in enumerate(bands.centres_hz):
        observed = [_observation(index, direct_s, m, float(centre_hz), names) for m in measured]
        observations = tuple(o for o in observed if o.names)
        if not observations:
            terms.append(None)
            continue
        one = Bands(bands.kind, bands.centres_hz[band : band + 1])
        m = float(attenuation[band])
        fine_rows = rows_at(coarse, centre_hz)
        rows = {o.pair: _lattice_rows(fine_rows[o.pair], m, in_lattice) for o in observations}
        own = tuple(rows[o.pair] for o in observations)
        width_hz, edges_s = float(statistical_bandwidth_hz(one)[0]), coarse.edges_s
        spreading = _spreading(one, edges_s)
        terms.append(ValuesTerm(one, width_hz, 0.0, edges_s, own, observations, spreading))
    return tuple(terms)


def _lattice_rows(
    rows: weighing.EnergyRows, attenuation_per_m: float, in_lattice: bool
) -> weighing.EnergyRows:
    """Return rows in air; images in a box of smooth walls keep their lengths, all else has 0."""
    image = rows.batch < 0
    unscattered = rows.weight_per_m2 * 4.0 * np.pi * rows.length_m**2
    smooth = in_lattice and bool(np.all(unscattered[image] > 0.999))
    kept = np.where(image & smooth, rows.length_m, 0.0)
    return replace(weighing.rows_in_air(rows, attenuation_per_m), length_m=kept)


def without_responses(
    terms: tuple[DataTerm, ...], priors: tuple[MaterialPrior, ...], band: int, start: FloatArray
) -> Objective | None:
    """Return the objective of a band's data beside responses by themselves, None without any."""
    if not terms:
        return None
    absorption = absorption_block(priors, band, float(start[band]))
    return Objective(Parameters((absorption,)), terms)


def coarser(binned: BinnedPaths, n: int) -> BinnedPaths:
    """Return the same paths in bins of n times the width; bins left over at the end are dropped."""
    kept = (binned.edges_s.size - 1) // n

    def joined(fine: weighing.EnergyRows) -> weighing.EnergyRows:
        first = weighing.first_rows(fine, n * kept)
        return replace(first, n_windows=kept, offsets=first.offsets[::n], path=None)

    return regrouped(binned, binned.edges_s[: n * kept + 1 : n], joined)


def predicted_values(
    scene: Scene,
    bands: Bands,
    binned: BinnedPaths,
    absorption: FloatArray,
    names: Sequence[ValueName] = VALUE_NAMES,
) -> FloatArray:
    """Return the room parameters that the paths predict, shape (n_pairs, n_names, n_bands)."""
    air, coarse = attenuation_per_m(scene.air, bands), coarser(binned, _BINS_AS_ONE)
    direct_s = distances_m(scene) / speed_of_sound_m_s(scene.air)
    return np.stack(
        [
            _values_of(bands, coarse.edges_s, energies, float(direct_s[i]), names)
            for i in range(len(binned.rows))
            for energies in [pair_energies(coarse, bands, i, absorption, air)]
        ]
    )


def strengths_db(
    bands: Bands, edges_s: FloatArray, energies: FloatArray, direct_s: float
) -> FloatArray:
    """Return the strength G of fine energies of a pair as of `predicted_values`, (1, n_bands)."""
    kept = energies.shape[1] // _BINS_AS_ONE
    edges_s = edges_s[: _BINS_AS_ONE * kept + 1 : _BINS_AS_ONE]
    joined = energies[:, : _BINS_AS_ONE * kept].reshape(len(bands), kept, _BINS_AS_ONE).sum(axis=2)
    return _values_of(bands, edges_s, joined, direct_s, ("G_dB",))


def _values_of(
    bands: Bands,
    edges_s: FloatArray,
    energies: FloatArray,
    direct_s: float,
    names: Sequence[ValueName],
) -> FloatArray:
    found = np.empty((len(names), len(bands)))
    for band, energy in enumerate(energies):
        one = Bands(bands.kind, bands.centres_hz[band : band + 1])
        spread = windows.spread_energy(_spreading(one, edges_s), energy[None])
        curve = echogram_decay_curve(one, spread, edges_s, direct_s)
        found[:, band] = value_gradients(curve, 0, names, derivative=False)[0]
    return found


def _spreading(bands: Bands, edges_s: FloatArray) -> windows.Spreading:
    """Return the energy spreading of the first of some bands over uniform bins."""
    return windows.band_spreading(bands, edges_s.size - 1, float(edges_s[1] - edges_s[0]))


def _observation(
    index: Mapping[tuple[str, str, str], int],
    direct_s: FloatArray,
    m: MeasuredValues,
    centre_hz: float,
    names: Sequence[ValueName],
) -> ValueObservation:
    at = np.array([centre_hz])
    found = {n: float(m.at(n, at)[0]) for n in names}
    known = tuple(n for n in names if np.isfinite(found[n]))
    spread = [float(m.spread_at(n, at)[0]) for n in known]
    pair, values = index[m.pair_name], np.array([found[n] for n in known])
    spread_or_0 = np.where(np.isfinite(spread), spread, 0.0)
    return ValueObservation(pair, float(direct_s[pair]), known, values, spread_or_0)
