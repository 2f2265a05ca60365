"""Window energies of several beams of one receiver, whose errors are correlated in each window.

The beams of a window receive the same reflections, and what interferes in one interferes in others.
Their energies are therefore decorrelated, window by window, by the inverse root of their covariance
at a reference absorption; weighted squares remain. The reference is the answer of an earlier fit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from roomfit.base.arguments import read_only
from roomfit.base.typing import ComplexArray, FloatArray, IntArray
from roomfit.model.energy import (
    WINDOWS_PER_INDEPENDENT_ONE,
    EnergyTerm,
    Observation,
    noise_and_model_variance,
)
from roomfit.model.parameters import Block, Parameters
from roomfit.model.patterns import directed_rows
from roomfit.model.problem import DataTerm, Rows, Values
from roomfit.model.weighing import EnergyRows, window_of_rows
from roomfit.model.windows import squares_in_windows, with_squares

LEVELS = "beam level"
# Errors of late levels reach their full size so long after the direct sound.
LATE_S = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """What a receiver's beams make of sound from each direction, in one band."""

    # (n_directions, n_beams, n_beams), band means of the products of patterns
    cross: ComplexArray
    # one a pair: direction of every row's path among these, (n_rows,)
    direction: tuple[IntArray, ...]


def spread_covariance(
    rows: EnergyRows,
    observed: Observation,
    energy: FloatArray,
    direction: IntArray,
    cross: ComplexArray,
    bandwidth_hz: float,
) -> dict[str, FloatArray]:
    """Return the covariance of the beams' energies in a window by phases and by arrival times.

    With S the cross-spectra of the beams, summed over paths, and Q the same of the squares of
    single paths, energies of beams k and l have the covariance ``integral (|S_kl|**2 - Q_kl) dt /
    B``: a lone path interferes with nothing, and all beams receive it alike.

    Parameters
    ----------
    rows : EnergyRows
        Of one pair, unweighted by beams.
    energy : float array, shape (n_rows,)
        Of each path at the reference absorption, gain included.
    direction : int array, shape (n_rows,)
    cross : complex array, shape (n_directions, n_beams, n_beams)

    Returns
    -------
    dict of float arrays, shape (n_windows, n_beams, n_beams)
        ``interference`` and ``positions``, and ``coherence``: ``|S_kl|**2 / (S_kk S_ll)``.
    """
    n_beams, fine = cross.shape[1], observed.fine_edges_s
    last = observed.spreading.shape[1]
    window, image = window_of_rows(rows), rows.batch < 0
    first = np.searchsorted(fine, observed.edges_s[:-1])
    shape = (observed.energy.size, n_beams, n_beams)
    interference, positions, whole = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    power = np.einsum("dkk->dk", cross).real
    for k in range(n_beams):
        for m in range(k, n_beams):
            own = energy * cross[direction, k, m]
            squared = energy**2 * power[direction, k] * power[direction, m] * image
            re, im, sq = (
                np.bincount(window, x, last)[:last].astype(np.float64)
                for x in (own.real, own.imag, squared)
            )
            s_re, q = with_squares(observed.fine_spreading, re, sq)
            s_im = observed.fine_spreading @ im
            pieces = (s_re**2 + s_im**2 - q) / (bandwidth_hz * np.diff(fine))
            interference[:, k, m] = interference[:, m, k] = np.add.reduceat(pieces, first)
            moved = observed.timing_sd_s**2 * squares_in_windows(observed.slopes, sq)
            positions[:, k, m] = positions[:, m, k] = moved
            size = (observed.spreading @ re) ** 2 + (observed.spreading @ im) ** 2
            whole[:, k, m] = whole[:, m, k] = size
    root = np.sqrt(np.maximum(np.einsum("wkk->wk", whole), np.finfo(np.float64).tiny))
    return {
        "interference": interference,
        "positions": positions,
        "coherence": whole / (root[:, :, None] * root[:, None, :]),
    }


def beam_windows(
    windows: EnergyTerm, beams: Beams, measured: Sequence[tuple[FloatArray, FloatArray]]
) -> EnergyTerm:
    """Return the windows of every beam in place of each observation's own, pair by pair.

    Parameters
    ----------
    windows : EnergyTerm
        Of an omnidirectional receiver: rows and windows.
    measured : sequence of float arrays, shape (n_beams, n_windows)
        Energies of one pair's windows, and their noise.
    """
    power = np.einsum("dkk->dk", beams.cross).real
    rows, observations = [], []
    each = zip(windows.rows, windows.observations, beams.direction, measured, strict=True)
    for own, observed, direction, (energy, noise) in each:
        for k in range(power.shape[1]):
            rows.append(directed_rows(own, power[direction, k]))
            observations.append(replace(observed, energy=energy[k], noise=noise[k]))
    return replace(windows, rows=tuple(rows), observations=tuple(observations))


def beam_levels(sd: FloatArray, late_sd: float, common_sd: float) -> Block:
    """Return the unknown log levels of the beams, 2 n_beams + 1, with their priors.

    Parameters
    ----------
    sd : float array, shape (n_beams,)
        Of each beam's level, as `_microphone_arrays.level_errors` has it.
    late_sd : float
        Of each beam's level of late sound, beside that.
    common_sd : float
        Of the level of late sound that all beams have in common.
    """
    n = sd.size
    labels = [f"beam {i}" for i in range(n)] + [f"beam {i}, late" for i in range(n)] + ["late"]
    zero, one = np.zeros(2 * n + 1), np.ones(2 * n + 1, dtype=np.bool_)
    spread = np.concatenate([sd, np.full(n, late_sd), [common_sd]])
    return Block(LEVELS, tuple(labels), "identity", zero, one, zero, spread, zero - 9.0, zero + 9.0)


@dataclass(frozen=True, slots=True, eq=False)
class BeamTerm(DataTerm):
    """Windows of beams, decorrelated within each window: absorption, gains and levels of beams."""

    is_gamma: ClassVar[bool] = False
    windows: EnergyTerm  # from `beam_windows`
    n_beams: int
    roots: tuple[FloatArray, ...]  # one a pair, (n_windows, n_beams, n_beams)
    parts: Mapping[str, FloatArray]  # of the variance of the decorrelated data, (n_data,) each
    late: FloatArray = field(init=False)  # (n_data,), share of late errors in each window

    def __post_init__(self) -> None:
        late = []
        for observed in self.windows.observations:
            middle = 0.5 * (observed.edges_s[1:] + observed.edges_s[:-1])
            late.append(np.clip((middle - middle[0]) / LATE_S, 0.0, 1.0))
        object.__setattr__(self, "late", read_only(np.concatenate(late)))

    def measured(self) -> FloatArray:
        """Return the decorrelated energies, shape (n_data,)."""
        return self.decorrelated(self.windows.measured())

    def predict(self, values: Values) -> Rows:
        """Return what the model expects of the decorrelated energies."""
        expected, signal, derivatives = self.windows.predict(values)
        factor = self._factor(values)
        by_level = np.zeros((signal.size, 2 * self.n_beams + 1))
        beam, rows = self._beam(), np.arange(signal.size)
        by_level[rows, beam] = factor * signal
        by_level[rows, self.n_beams + beam] = by_level[:, -1] = factor * signal * self.late
        by = {name: factor[:, None] * slope for name, slope in derivatives.items()} | {
            LEVELS: by_level
        }
        whole = expected + (factor - 1.0) * signal
        return (
            self.decorrelated(whole),
            self.decorrelated(factor * signal),
            {name: self.decorrelated(slope) for name, slope in by.items()},
        )

    def expected(self, values: Values) -> FloatArray:
        """Return the expected data alone, shape (n_data,)."""
        return self.predict(values)[0]

    def variance_parts(self, values: Values) -> dict[str, FloatArray]:  # noqa: ARG002
        """Return the parts at the reference, whose sum is 1; shape (n_data,) each."""
        return dict(self.parts)

    def correlation_length(self, start: Values) -> FloatArray:  # noqa: ARG002
        """Return `WINDOWS_PER_INDEPENDENT_ONE` for every datum."""
        return np.full(self.late.size, WINDOWS_PER_INDEPENDENT_ONE)

    def decorrelated(self, rows: FloatArray) -> FloatArray:
        """Return rows of all windows, (n_data, ...), multiplied by the roots of their windows."""
        out, first = [], 0
        for root in self.roots:
            last = first + root.shape[0] * self.n_beams
            own = rows[first:last].reshape(self.n_beams, root.shape[0], -1)
            out.append(np.einsum("wij,jwc->iwc", root, own).reshape(last - first, -1))
            first = last
        return np.concatenate(out).reshape(rows.shape)

    def _beam(self) -> IntArray:
        """Return the beam of each datum before they are decorrelated, shape (n_data,)."""
        sizes = [o.energy.size for o in self.windows.observations]
        return np.repeat(np.arange(len(sizes)) % self.n_beams, sizes)

    def _factor(self, values: Values) -> FloatArray:
        level, beam = values[LEVELS], self._beam()
        late = level[self.n_beams + beam] + level[-1]
        return np.asarray(np.exp(level[beam] + self.late * late))


def beam_term(omni: EnergyTerm, beams: Beams, windows: EnergyTerm, values: Values) -> BeamTerm:
    """Return the windows of beams, decorrelated by their covariance at reference values.

    Errors of the model and by ringing are shared by the beams of a window as they share its sound.
    Monte-Carlo errors of rays are left to what windows share: a jackknife over batches of rays, for
    which each beam has its own rows (`roomfit.fit.systematics.batch_spread`).

    Parameters
    ----------
    omni : EnergyTerm
        Rows unweighted by beams.
    windows : EnergyTerm
        From `beam_windows` of these.
    values : Values
        Absorption and gains at the reference.
    """
    gains = np.append(values["gain"], 1.0)
    left = np.log(np.maximum(1.0 - values["absorption"], 1e-30))
    n_beams = beams.cross.shape[1]
    roots, parts = [], []
    for o, (rows, observed) in enumerate(zip(omni.rows, omni.observations, strict=True)):
        gain = float(gains[observed.gain])
        energy = gain * rows.weight_per_m2 * np.exp(rows.hits @ left)
        covariance = spread_covariance(
            rows, observed, energy, beams.direction[o], beams.cross, omni.bandwidth_hz
        )
        shared = covariance.pop("coherence")
        of_beam = []
        for k in range(n_beams):
            own = windows.observations[o * n_beams + k]
            power = energy * beams.cross[beams.direction[o], k, k].real
            bins = np.bincount(window_of_rows(rows), power, rows.n_windows)
            signal = own.spreading @ bins[: own.spreading.shape[1]]
            of_beam.append(noise_and_model_variance(windows, own, signal))
        for name in of_beam[0]:
            sd = np.sqrt(np.stack([parts_k[name] for parts_k in of_beam], axis=1))
            alike = np.eye(n_beams) if name == "noise" else shared
            covariance[name] = alike * sd[:, :, None] * sd[:, None, :]
        root = inverse_root(np.sum(list(covariance.values()), axis=0))
        roots.append(root)
        own_parts = {
            n: np.einsum("wij,wjk,wik->iw", root, c, root).ravel() for n, c in covariance.items()
        }
        # where the covariance was raised, as it vanishes between beams that hear the same
        own_parts["interference"] += 1.0 - np.sum(list(own_parts.values()), axis=0)
        parts.append(own_parts)
    together = {name: np.concatenate([p[name] for p in parts]) for name in parts[0]}
    return BeamTerm(windows, n_beams, tuple(roots), together)


def inverse_root(covariance: FloatArray) -> FloatArray:
    """Return W of each matrix with ``W C W^T = 1``, shape (n, m, m).

    Directions in which a matrix is below a thousandth of its largest are given that thousandth.
    """
    size, directions = np.linalg.eigh(covariance)
    least = np.maximum(1e-3 * size[:, -1:], np.finfo(np.float64).tiny)
    return np.asarray((directions / np.sqrt(np.maximum(size, least))[:, None, :]).swapaxes(1, 2))


def with_levels(parameters: Parameters, levels: Block) -> Parameters:
    """Return parameters that end with the levels of the beams."""
    return Parameters((*(b for b in parameters.blocks if b.name != LEVELS), levels))
