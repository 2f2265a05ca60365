"""Measured window energies of one band against the energies that traced paths predict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from scipy.sparse import csr_array

from roomfit.base.arguments import float_array
from roomfit.base.forks import count_evaluation
from roomfit.base.kernels import each_in_threads
from roomfit.base.typing import FloatArray
from roomfit.model import weighing
from roomfit.model.parameters import start_vector
from roomfit.model.problem import DataTerm, Objective, Rows, Values
from roomfit.model.windows import squares_in_windows, with_squares

_RINGING_S = 2e-3

# Key of the derivative by b of the source that each window receives, shape (n_windows, 3).
PATTERN = "pattern"

# Neighbours share what the band filter spreads. Residuals of measured and of simulated rooms count
# 1.0 to 1.7 windows as one: docs/decisions/0037-what-a-window-costs.md.
WINDOWS_PER_INDEPENDENT_ONE = 1.35


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """One measurement reduced to a band, and how the model is to be reduced to the same."""

    pair: int  # index of the pair in the scene
    edges_s: FloatArray  # (n_windows + 1,), time windows after emission
    # (n_windows,), measured energy of each window, noise included; unit of the record squared times
    # s
    energy: FloatArray
    noise: FloatArray  # (n_windows,), expected noise energy of each window
    # (n_windows, n_bins), share of the energy of each fine time bin that the band filter carries
    # into each window
    spreading: csr_array
    # (n_fine + 1,), the same windows cut into pieces that the band filter just resolves; see
    # `fine_edges_s`
    fine_edges_s: FloatArray
    fine_spreading: csr_array  # (n_fine, n_bins), as `shares`, for the pieces
    # (n_windows, n_bins), derivative of `shares` by the arrival time of each bin, 1/s
    slopes: csr_array
    timing_sd_s: float  # standard deviation of arrival times, from that of the positions
    gain: int  # which unknown gain applies; -1 where the level is absolute
    late_shares: FloatArray = field(init=False)  # (n_windows, n_windows), see `late_shares`

    def __post_init__(self) -> None:
        edges = float_array("window edges", self.edges_s, (None,), unit="s")
        n = len(edges) - 1
        object.__setattr__(self, "edges_s", edges)
        object.__setattr__(self, "late_shares", late_shares(edges))
        for name in ("energy", "noise"):
            values = float_array(f"window {name}", getattr(self, name), (n,), low=0.0)
            object.__setattr__(self, name, values)


@dataclass(frozen=True, slots=True, eq=False)
class EnergyTerm(DataTerm):
    """Windows of one band, explained by energies of paths that add: absorption and gains."""

    is_gamma: ClassVar[bool] = True
    centre_hz: float
    bandwidth_hz: float  # statistical bandwidth of the band filter
    attenuation_per_m: float  # energy attenuation of the air
    rows: tuple[weighing.EnergyRows, ...]  # paths of each observation's pair in fine time bins
    observations: tuple[Observation, ...]
    # relative standard deviation that the model may be wrong by in any window
    model_error: float = 0.2
    # share of the energy of each window that may come up to a few milliseconds late, because a real
    # loudspeaker rings and real walls scatter between the reflections that are modelled
    ringing_error: float = 0.1
    # of each observation's rows, None where its source is omnidirectional; empty: all are
    patterns: tuple[weighing.RowPattern | None, ...] = ()
    # what the last prediction weighed, by its absorption: the variance there takes no second pass
    _last: dict[bytes, tuple[Weighed, ...]] = field(default_factory=dict, init=False, repr=False)

    def measured(self) -> FloatArray:
        """Return the measured window energies, all observations end to end, (n_windows,)."""
        return np.concatenate([o.energy for o in self.observations])

    def predict(self, values: Values) -> Rows:
        """Return what the model expects in every window, by absorption, gains and b of sources."""
        count_evaluation()
        gains = np.append(values["gain"], 1.0)  # index -1: absolute level
        walls, air = values["absorption"], self.attenuation_per_m

        def weighed_windows(o: int) -> tuple[weighing.EnergyParts, FloatArray]:
            pattern = self.patterns[o] if self.patterns else None
            parts = weighing.weigh_parts(self.rows[o], pattern, walls, air, derivative=True)
            return parts, self.observations[o].spreading @ parts.columns

        signals, by_absorption, by_gain, by_pattern, paths = [], [], [], [], []
        each = each_in_threads(
            weighed_windows,
            len(self.observations),
            worth_it=sum(map(len, self.rows)) >= weighing.ROWS_WORTH_THREADS,
        )
        for observation, (parts, found) in zip(self.observations, each, strict=True):
            gain = gains[observation.gain]
            last = 2 + len(parts.batches)
            tracing = variance_of_batches(found[:, 2:last])
            paths.append(Weighed(parts.energy, parts.squares, tracing))
            signal = gain * found[:, 0]
            signals.append(signal)
            by_absorption.append(gain * found[:, last:-3])
            by_pattern.append(gain * found[:, -3:])
            per_gain = np.zeros((signal.size, values["gain"].size))
            if observation.gain >= 0:
                per_gain[:, observation.gain] = signal / gain
            by_gain.append(per_gain)
        self._last.clear()
        self._last[values["absorption"].tobytes()] = tuple(paths)
        signal = np.concatenate(signals)
        derivatives = {
            "absorption": np.concatenate(by_absorption),
            "gain": np.concatenate(by_gain),
        }
        if self.patterns:
            derivatives[PATTERN] = np.concatenate(by_pattern)
        return signal + np.concatenate([o.noise for o in self.observations]), signal, derivatives

    def expected(self, values: Values) -> FloatArray:
        """Return what the model expects in every window, shape (n_windows,)."""
        return self.predict(values)[0]

    def variance_parts(self, values: Values) -> dict[str, FloatArray]:
        """Return what the variance of every window is the sum of, by name, (n_windows,) each.

        Reflections interfere: the energy of a band of bandwidth B has the variance ``1 / B`` times
        the integral of P^2 - Q, where P is the sum of path energies spread by the filter and Q that
        of the squares of each single one. It may fall on either side of a window's edge where
        positions are a centimetre wrong. To this come background noise, its beat with the signal,
        rays and the model's error.
        """
        gains = np.append(values["gain"], 1.0)
        paths = weighed(self, values["absorption"])
        return end_to_end(
            [
                observation_variance(self, o, paths[o], float(gains[observed.gain]))
                for o, observed in enumerate(self.observations)
            ]
        )

    def correlation_length(self, _start: Values) -> FloatArray:
        """Return `WINDOWS_PER_INDEPENDENT_ONE` for every window."""
        return np.full(self.measured().size, WINDOWS_PER_INDEPENDENT_ONE)

    def as_energies(self, _values: Values) -> EnergyTerm:
        """Return the windows themselves."""
        return self

    def radiated(
        self, b: Sequence[FloatArray | None], basis: Sequence[weighing.RowBasis]
    ) -> EnergyTerm:
        """Return the windows with the directivity of each observation's source."""
        pairs = zip(b, basis, strict=True)
        patterns = tuple(None if own is None else weighing.RowPattern(own, at) for own, at in pairs)
        return replace(self, patterns=patterns)


def only_energies(objective: Objective) -> EnergyTerm | None:
    """Return the windows of an objective that has no other data and its own variances, or None."""
    first, *others = objective.terms
    if others or objective.inflation is not None:
        return None
    energies = objective.as_energies(start_vector(objective.parameters))
    # pressures, and unknown directivity, have other energies than themselves
    return energies if energies is first else None


def in_air(term: EnergyTerm) -> EnergyTerm:
    """Return the same term with the air's loss in the rows' weights: an exponential a row less."""
    m = term.attenuation_per_m
    return replace(
        term,
        rows=tuple(weighing.rows_in_air(rows, m) for rows in term.rows),
        attenuation_per_m=0.0,
    )


def first_windows(observed: Observation, end_s: float) -> Observation:
    """Return an observation of the windows that end by a time, one at least."""
    n = max(int(np.searchsorted(observed.edges_s, end_s + 1e-9, side="right")) - 1, 1)
    n_fine = int(np.searchsorted(observed.fine_edges_s, observed.edges_s[n]))
    return replace(
        observed,
        edges_s=observed.edges_s[: n + 1],
        energy=observed.energy[:n],
        noise=observed.noise[:n],
        spreading=_first_windows(observed.spreading, n),
        fine_edges_s=observed.fine_edges_s[: n_fine + 1],
        fine_spreading=_first_windows(observed.fine_spreading, n_fine),
        slopes=_first_windows(observed.slopes, n),
    )


def _first_windows(whole: csr_array, n: int) -> csr_array:
    """Return the first n rows of a sparse array without copying its entries."""
    last = whole.indptr[n]
    entries = (whole.data[:last], whole.indices[:last], whole.indptr[: n + 1])
    return csr_array(entries, shape=(n, whole.shape[1]), copy=False)


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """What the paths of one observation bring for a gain of 1."""

    # energy, squares: (n_bins,), of all paths, and of the squares of the single image paths
    energy: FloatArray
    squares: FloatArray
    tracing: FloatArray  # (n_windows,), monte-Carlo variance of each window's energy


def weighed(problem: EnergyTerm, absorption: FloatArray) -> tuple[Weighed, ...]:
    """Return what the variance of each observation is made of, absorption (n_materials,)."""
    known = problem._last.pop(absorption.tobytes(), None)
    if known is not None:
        return known
    found = []
    for o, observed in enumerate(problem.observations):
        parts = parts_of(problem, o, absorption)
        tracing = variance_of_batches(observed.spreading @ parts.batches.T)
        found.append(Weighed(parts.energy, parts.squares, tracing))
    return tuple(found)


def parts_of(problem: EnergyTerm, observation: int, absorption: FloatArray) -> weighing.EnergyParts:
    """Return energies, squares and batches of one observation's bins, for a gain of 1."""
    pattern = problem.patterns[observation] if problem.patterns else None
    return weighing.weigh_parts(
        problem.rows[observation], pattern, absorption, problem.attenuation_per_m
    )


def observation_variance(
    problem: EnergyTerm, observation: int, paths: Weighed, gain: float
) -> dict[str, FloatArray]:
    """Return the parts of `EnergyTerm.variance` of one observation by name, (n_windows,) each."""
    observed = problem.observations[observation]
    positions = observed.timing_sd_s**2 * squares_in_windows(observed.slopes, paths.squares)
    spread, squares = with_squares(observed.fine_spreading, paths.energy, paths.squares)
    pieces = np.maximum(spread**2 - squares, 0.0)
    pieces = pieces / (problem.bandwidth_hz * np.diff(observed.fine_edges_s))
    first = np.searchsorted(observed.fine_edges_s, observed.edges_s[:-1])
    interference = np.add.reduceat(pieces, first)
    return {
        "interference": gain**2 * interference,
        "positions": gain**2 * positions,
        "rays": gain**2 * paths.tracing,
        **noise_and_model_variance(problem, observed, gain * (observed.spreading @ paths.energy)),
    }


def noise_and_model_variance(
    problem: EnergyTerm, observed: Observation, signal: FloatArray
) -> dict[str, FloatArray]:
    """Return the variance of each window by background noise and by the errors of the model."""
    noise = observed.noise * (observed.noise + 2.0 * signal)
    noise /= problem.bandwidth_hz * np.diff(observed.edges_s)
    ringing = observed.late_shares @ signal
    return {
        "noise": noise,
        **model_variance(problem, observed.energy - observed.noise, signal, ringing),
    }


def model_variance(
    problem: EnergyTerm, measured: FloatArray, signal: FloatArray, ringing: FloatArray
) -> dict[str, FloatArray]:
    """Return the variance of each window by the errors of the model, (n_windows,) each."""
    # where the measurement is far above, its own size bounds the certainty: a window that a
    # trial absorption leaves empty must not outweigh all others
    scale = np.maximum(signal, 0.5 * measured)
    return {
        "model": (problem.model_error * scale) ** 2,
        "ringing": (problem.ringing_error * ringing) ** 2,
    }


def end_to_end(parts: Sequence[Mapping[str, FloatArray]]) -> dict[str, FloatArray]:
    """Return the parts of the variance of several observations, one after the other."""
    return {name: np.concatenate([p[name] for p in parts]) for name in parts[0]}


def squared_image_rows(rows: weighing.EnergyRows) -> weighing.EnergyRows:
    """Return rows whose weighed energies are the squared energies of the single image paths.

    Rays are left out: they sample very many weak reflections, whose squares vanish.
    """
    few = weighing.taken_rows(rows, np.flatnonzero(rows.batch < 0))
    return replace(
        few,
        weight_per_m2=few.weight_per_m2**2,
        hits=2 * few.hits,
        length_m=2.0 * few.length_m,
        path=None,
    )


def fine_edges_s(edges_s: FloatArray, bandwidth_hz: float) -> FloatArray:
    """Return the edges of windows cut into up to eight pieces of at least half of 1 / B each."""
    counts = np.clip(np.ceil(2.0 * bandwidth_hz * np.diff(edges_s)), 1, 8).astype(np.int64)
    pieces = [
        np.linspace(low, high, n, endpoint=False)
        for low, high, n in zip(edges_s[:-1], edges_s[1:], counts, strict=True)
    ]
    return np.concatenate((*pieces, edges_s[-1:]))


def late_shares(edges_s: FloatArray) -> FloatArray:
    """Return which share of each window's energy every later one gets if it rings for 2 ms.

    Without it a window between two reflections would be expected to be empty, with certainty. Shape
    (n_windows, n_windows), of the window that gets it and that which gives it.
    """
    middle_s = 0.5 * (edges_s[1:] + edges_s[:-1])
    late_s = np.maximum(edges_s[:, None] - middle_s[None, :], 0.0)
    arrived = 1.0 - np.exp(-late_s / _RINGING_S)
    return np.asarray(np.tril(np.diff(arrived, axis=0), -1))


def variance_of_batches(windows: FloatArray) -> FloatArray:
    """Return the Monte-Carlo variance of windows from the energies of batches, (n_windows, n)."""
    n = windows.shape[1]
    if n < 2:
        return np.zeros(len(windows))
    off = windows - windows.sum(axis=1, keepdims=True) / n
    return np.asarray(n / (n - 1.0) * np.einsum("ij,ij->i", off, off))
