"""Windows of one band with early image sources of a displaced geometry, all else kept.

To ask whether positions or lengths are specified wrongly takes many geometries. The image sources
of low orders are found anew for each, which takes milliseconds. All other paths, whose energy
hardly depends on where things stand exactly, are traced once, and follow absorption and directivity
as the mean path of their window does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.sparse import block_diag, csr_array

from roomfit.base.forks import count_evaluation
from roomfit.base.typing import FloatArray, IntArray
from roomfit.model.directivity import DIRECTIVITY, BandDirectivities, DirectedTerm, vectors_of
from roomfit.model.energy import EnergyTerm, model_variance, parts_of, variance_of_batches
from roomfit.model.patterns import amplitude_and_slope, pattern_basis
from roomfit.model.problem import DataTerm, Rows, Values
from roomfit.signals import filters
from roomfit.tracing.paths import Paths, losses

_LEAST = 1e-12
# These windows are half as long as the band's filter resolves; the thresholds of what counts as
# displaced were chosen with three of them as one.
EARLY_WINDOWS_PER_INDEPENDENT_ONE = 3.0
_TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True, slots=True, eq=False)
class FixedPaths:
    """The windows of a band and what paths that stay bring to them, linearised at one answer."""

    # without rows and their bases: what is linearised needs no path any more
    term: EnergyTerm
    directivity: BandDirectivities | None
    log_reflected: FloatArray  # (n_materials,), ln(1 - a) of that answer
    b: FloatArray  # (n_sources, 3), of that answer
    energy: FloatArray  # (n_windows,), at a gain of 1
    fine_energy: FloatArray  # (n_fine,), the same in the pieces of the windows
    tracing: FloatArray  # (n_windows,), Monte-Carlo variance
    mean_hits: FloatArray  # (n_windows, n_materials), weighed by energy
    log_slopes: FloatArray  # (n_windows, 3 * n_sources), of the energy's logarithm, by b
    observation: IntArray  # (n_windows,)
    noise: FloatArray  # (n_windows,)
    background: FloatArray  # (n_windows, 2), its variance: alone, and by its beat with the signal
    ringing: csr_array  # (n_windows, n_windows), see `late_shares`
    first_piece: IntArray  # (n_windows,), of the fine windows


@dataclass(frozen=True, slots=True, eq=False)
class DisplacedTerm(DataTerm):
    """The windows of one band, explained by image sources of one geometry and by kept paths."""

    is_gamma: ClassVar[bool] = True
    kept: FixedPaths
    observation: IntArray  # (n_images,), rising
    hits: FloatArray  # (n_images, n_materials)
    weight: FloatArray  # (n_images,), with the loss in air and known directivity
    basis: FloatArray  # (n_images, 3), `pattern_basis` where a directivity is unknown
    # (n_windows, n_images), share of each image in each window, in the pieces of the windows, the
    # latter squared, and the squared derivative of the first by the arrival time
    spreading: csr_array
    fine_spreading: csr_array
    squared_fine: csr_array
    squared_slopes: csr_array

    def measured(self) -> FloatArray:
        """Return the measured window energies, shape (n_windows,)."""
        return self.kept.term.measured()

    def predict(self, values: Values) -> Rows:
        """Return what is expected in every window, and its derivatives."""
        count_evaluation()
        kept = self.kept
        energy, by_b = self._images(values)
        rest, gain = self._rest(values), self._gain(values)
        signal = gain * (self.spreading @ energy + rest)
        reflected = np.maximum(1.0 - values["absorption"], _LEAST)
        by_hits = self.spreading @ (energy[:, None] * self.hits) + rest[:, None] * kept.mean_hits
        number = self._of_window([o.gain for o in kept.term.observations])
        derivatives = {
            "absorption": -gain[:, None] * by_hits / reflected,
            "gain": (number[:, None] == np.arange(values["gain"].size)) * (signal / gain)[:, None],
        }
        if kept.directivity is not None:
            source = kept.directivity.source[kept.observation]
            moved = self.spreading @ (energy[:, None] * by_b)
            slopes = rest[:, None] * kept.log_slopes
            for s in range(len(kept.b)):
                slopes[:, 3 * s : 3 * s + 3] += (source == s)[:, None] * moved
            derivatives[DIRECTIVITY] = gain[:, None] * slopes @ kept.directivity.unknown.root
        return signal + kept.noise, signal, derivatives

    def expected(self, values: Values) -> FloatArray:
        """Return what is expected in every window, shape (n_windows,)."""
        return self.signal(values) + self.kept.noise

    def signal(self, values: Values) -> FloatArray:
        """Return what is expected in every window without noise, shape (n_windows,)."""
        energy, _ = self._images(values)
        return np.asarray(self._gain(values) * (self.spreading @ energy + self._rest(values)))

    def variance_parts(self, values: Values) -> dict[str, FloatArray]:
        """Return the variance of every window as `EnergyTerm` has it, in parts, (n_windows,)."""
        kept, term = self.kept, self.kept.term
        energy, _ = self._images(values)
        rest, gain = self._rest(values), self._gain(values)
        signal = gain * (self.spreading @ energy + rest)
        ratio = rest / np.maximum(kept.energy, _TINY)
        n_pieces = np.diff(np.append(kept.first_piece, kept.fine_energy.size))
        fine = self.fine_spreading @ energy + kept.fine_energy * np.repeat(ratio, n_pieces)
        squares = energy**2
        overlapping = np.maximum(fine**2 - self.squared_fine @ squares, 0.0)
        widths_s = np.concatenate([np.diff(o.fine_edges_s) for o in term.observations])
        interference = np.add.reduceat(
            overlapping / (term.bandwidth_hz * widths_s), kept.first_piece
        )
        timing_s = self._of_window([o.timing_sd_s for o in term.observations])
        timing = timing_s**2 * (self.squared_slopes @ squares)
        noise = kept.background[:, 0] + kept.background[:, 1] * signal
        model = model_variance(term, term.measured() - kept.noise, signal, kept.ringing @ signal)
        own = interference + timing + ratio**2 * kept.tracing
        return {"reflections": gain**2 * own + noise, **model}

    def correlation_length(self, _start: Values) -> FloatArray:
        """Return how many neighbours share the information of each window, (n_windows,)."""
        return np.full(self.measured().size, EARLY_WINDOWS_PER_INDEPENDENT_ONE)

    def _images(self, values: Values) -> tuple[FloatArray, FloatArray]:
        """Return the energy of every image, (n,), and the derivative of its log by b, (n, 3)."""
        left = np.log(np.maximum(1.0 - values["absorption"], _LEAST))
        energy = self.weight * np.exp(self.hits @ left)
        by_b = np.zeros((energy.size, 3))
        if self.kept.directivity is not None:
            b = vectors_of(self.kept.directivity.unknown, values[DIRECTIVITY])
            source = self.kept.directivity.source[self.observation]
            for s in range(len(b)):
                at = np.flatnonzero(source == s)
                amplitude, slope = amplitude_and_slope(b[s], self.basis[at])
                energy[at] *= amplitude**2
                clear = np.where(amplitude < 0.0, -1.0, 1.0) * np.maximum(np.abs(amplitude), 1e-6)
                by_b[at] = 2.0 * slope / clear[:, None]
        return energy, by_b

    def _rest(self, values: Values) -> FloatArray:
        """Return the energy of kept paths in every window at a gain of 1, shape (n_windows,)."""
        kept = self.kept
        left = np.log(np.maximum(1.0 - values["absorption"], _LEAST))
        grown = kept.mean_hits @ (left - kept.log_reflected)
        if kept.directivity is not None:
            b = vectors_of(kept.directivity.unknown, values[DIRECTIVITY])
            grown = grown + kept.log_slopes @ (b - kept.b).ravel()
        # far from the answer the linearisation must not overflow
        return np.asarray(kept.energy * np.exp(np.clip(grown, -50.0, 5.0)))

    def _gain(self, values: Values) -> FloatArray:
        number = self._of_window([o.gain for o in self.kept.term.observations])
        return np.asarray(np.append(values["gain"], 1.0)[number])  # index -1: absolute level

    def _of_window(self, of_observation: Sequence[float]) -> FloatArray:
        return np.array(of_observation)[self.kept.observation]


def fixed_paths(
    term: EnergyTerm, directivity: BandDirectivities | None, absorption: FloatArray, b: FloatArray
) -> FixedPaths:
    """Return what stays of a band, linearised at an answer."""
    observations = term.observations
    n_gains = max((o.gain for o in observations), default=-1) + 1
    values: dict[str, FloatArray] = {"absorption": absorption, "gain": np.ones(n_gains)}
    weighed, log_slopes = term, np.zeros((term.measured().size, 0))
    if directivity is not None:
        unknown = directivity.unknown
        values[DIRECTIVITY] = np.asarray(np.linalg.solve(unknown.root, b.ravel() - unknown.mean))
        whole = DirectedTerm(term, directivity)
        weighed = whole.as_energies(values)
        _, energy, slopes = whole.predict(values)
        by_b = slopes[DIRECTIVITY] @ np.linalg.inv(unknown.root)
        log_slopes = by_b / np.maximum(energy, _TINY)[:, None]
    _, energy, slopes = weighed.predict(values)
    left = np.maximum(1.0 - absorption, _LEAST)
    fine, tracing, first, n_fine = [], [], [], 0
    for number, o in enumerate(observations):
        parts = parts_of(weighed, number, absorption)
        fine.append(o.fine_spreading @ parts.energy)
        tracing.append(variance_of_batches(o.spreading @ parts.batches.T))
        first.append(n_fine + np.searchsorted(o.fine_edges_s, o.edges_s[:-1]))
        n_fine += o.fine_edges_s.size - 1
    noise = np.concatenate([o.noise for o in observations])
    widths_s = np.concatenate([np.diff(o.edges_s) for o in observations])
    beat = noise / (term.bandwidth_hz * widths_s)
    return FixedPaths(
        replace(term, rows=()),
        None if directivity is None else replace(directivity, basis=()),
        np.log(left),
        b,
        energy,
        np.concatenate(fine),
        np.concatenate(tracing),
        -slopes["absorption"] * left / np.maximum(energy, _TINY)[:, None],
        log_slopes,
        np.repeat(np.arange(len(observations)), [o.energy.size for o in observations]),
        noise,
        np.stack([beat * noise, 2.0 * beat], axis=1),
        csr_array(block_diag([o.late_shares for o in observations])),
        np.concatenate(first),
    )


def displaced_term(
    kept: FixedPaths,
    images: Paths,
    times_s: FloatArray,
    weight: FloatArray,
    kernel: tuple[filters.SpreadingKernel, int],
) -> DisplacedTerm:
    """Return the windows with the image sources of one geometry.

    Shapes: `times_s` (n_observations, n_paths), `weight` (n_paths,).
    """
    observations = kept.term.observations
    # all observations one after the other on one axis of time, so that one call spreads them all
    reach_s = filters.spreading_reach_s(*kernel)
    low_s = min(float(o.edges_s[0]) for o in observations) - 2.0 * reach_s
    slot_s = max(float(o.edges_s[-1]) for o in observations) + 2.0 * reach_s - low_s
    index, number, delays_s = [], [], []
    for k, o in enumerate(observations):
        own = np.flatnonzero(images.pair == o.pair)
        at_s = times_s[k, own]
        order = np.argsort(at_s, kind="stable")
        order = order[(at_s[order] > low_s) & (at_s[order] < low_s + slot_s)]
        index.append(own[order])
        number.append(np.full(order.size, k))
        delays_s.append(at_s[order] + k * slot_s)
    own, observation = np.concatenate(index), np.concatenate(number)
    coarse_s, windows = _end_to_end([o.edges_s for o in observations], slot_s)
    fine_s, pieces = _end_to_end([o.fine_edges_s for o in observations], slot_s)
    basis = np.zeros((own.size, 3))
    if kept.directivity is not None:
        ends = np.cumsum([i.size for i in index])[:-1]
        aims = kept.directivity.aims
        parts = zip(np.split(images.departure[own], ends), aims, strict=True)
        basis = np.concatenate([pattern_basis(p, aim) for p, aim in parts])
    delays = np.concatenate(delays_s)
    fine = filters.spreading_matrix(*kernel, delays, fine_s)[pieces]
    return DisplacedTerm(
        kept,
        observation,
        losses(images, own).astype(np.float64),
        weight[own],
        basis,
        filters.spreading_matrix(*kernel, delays, coarse_s)[windows],
        fine,
        fine.power(2),
        filters.spreading_slopes_per_s(*kernel, delays, coarse_s)[windows].power(2),
    )


def _end_to_end(edges_s: Sequence[FloatArray], slot_s: float) -> tuple[FloatArray, IntArray]:
    """Return the edges of all observations in slots of time, and which windows are theirs."""
    joined = np.concatenate([e + k * slot_s for k, e in enumerate(edges_s)])
    own = np.ones(joined.size, dtype=np.bool_)
    own[np.cumsum([e.size for e in edges_s]) - 1] = False
    return joined, np.flatnonzero(own)
