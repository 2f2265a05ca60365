"""Measured windows of one band against partly coherent image sources and energies of the rest.

Positions, speed of sound and times are unknowns; every path is as coherent as its arrival time is
known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, cast

import numpy as np

from roomfit.base.kernels import each_in_threads, in_threads
from roomfit.base.typing import FloatArray, IntArray
from roomfit.model.energy import (
    PATTERN,
    WINDOWS_PER_INDEPENDENT_ONE,
    EnergyTerm,
    Observation,
    Weighed,
    end_to_end,
    noise_and_model_variance,
    observation_variance,
    weighed,
)
from roomfit.model.parameters import GEOMETRY
from roomfit.model.problem import DataTerm, Rows, Values
from roomfit.model.pulses import BandGrid, band_grid
from roomfit.model.weighing import ROWS_WORTH_THREADS, RowBasis
from roomfit.model.windows import squares_in_windows, with_squares
from roomfit.pressures.geometry import Geometry, local_roots, times_of
from roomfit.pressures.response import (
    DirectedImages,
    ImagePaths,
    binned_energies,
    binned_shares,
    chosen_paths,
    coherent_response,
    coherent_slopes,
    directed_images,
    image_amplitudes,
    image_basis,
    image_energies,
    spread_squared,
)

# Of its centre: so much later an arrival does not ring into a window any more.
RINGING_PERIODS = 4.0
# A path less coherent than this is left to the energies.
_LEAST_COHERENCE = 1e-3
# Relative error of a travel time that no fitted parameter stands for.
_TIMING_SHARE = 1e-4
# The same of a position, per coordinate, in m.
_POSITION_SD_M = 0.5e-3


@dataclass(frozen=True, slots=True, eq=False)
class CoherentTerm(DataTerm):
    """Windows of one band, explained by partly coherent paths: absorption, gains and geometry.

    The expected energy of a window is what `energies` expects of all paths, less the coherent part
    gamma e of the image paths, plus the energy of their coherent pressure.
    """

    is_gamma: ClassVar[bool] = True
    energies: EnergyTerm  # all paths, as energies
    # the first windows of every observation, in which pressures add; later ones hold so many
    # reflections of so uncertain times that their energies add
    early: tuple[Observation, ...]
    geometry: Geometry
    images: ImagePaths  # all image paths of the observations with the coherence of each
    coherent: ImagePaths  # those of them that are coherent at all
    bins: IntArray  # (n_images,), fine time bin of each of `images`
    coherent_bins: IntArray  # of each of `coherent`
    grid: BandGrid
    basis: RowBasis | None = None  # (n_images, 3), `pattern_basis` of where `images` leave
    directed: DirectedImages | None = None  # `coherent` without directivity, where it has one
    # of the last prediction: energy of the coherent pressure in the windows' pieces, and the values
    # that it belongs to; the variance there costs no second response
    _last: dict[bytes, FloatArray] = field(default_factory=dict, init=False, repr=False)

    def measured(self) -> FloatArray:
        """Return the measured window energies, all observations end to end, (n_windows,)."""
        return np.concatenate([o.energy for o in self.energies.observations])

    def predict(self, values: Values) -> Rows:
        """Return what the model expects in every window, by absorption, gains and geometry."""
        expected, signal, derivatives = self.energies.predict(values)
        absorption = values["absorption"]
        times, edges_s = times_of(self.geometry, values[GEOMETRY]), self._edges_s()
        response = coherent_response(self.coherent, absorption, times, self.grid, edges_s)
        pieces = _first_pieces(self.early)
        energy, by_log, by_times = (
            np.add.reduceat(x, pieces)
            for x in (response.energy, response.by_log_reflected, response.by_times)
        )
        self._last.clear()
        self._last[_key(values)] = response.energy
        less, less_by_log = self._less(image_energies(self.coherent, absorption))
        # d ln(1 - a) = -da / (1 - a)
        by_absorption = -(by_log - less_by_log)
        by_absorption /= np.maximum(1.0 - absorption, 1e-12)
        by_geometry = np.zeros((less.size, self.geometry.sd.size))
        windows, first = self.early_windows(), 0
        for o, observed in enumerate(self.early):
            own = np.arange(first, first + observed.energy.size)
            columns = self.geometry.columns[o]
            np.add.at(by_geometry, (own[:, None], columns[None, :]), by_times[own])
            first += observed.energy.size
        gains = np.append(values["gain"], 1.0)
        gain_of_window = np.repeat(
            [o.gain for o in self.early], [o.energy.size for o in self.early]
        )
        gain, extra = gains[gain_of_window], energy - less
        expected[windows] += gain * extra
        signal[windows] += gain * extra
        derivatives["absorption"][windows] += gain[:, None] * by_absorption
        derivatives["gain"][windows] += (
            gain_of_window[:, None] == np.arange(values["gain"].size)
        ) * extra[:, None]
        derivatives[GEOMETRY] = np.zeros((expected.size, self.geometry.sd.size))
        derivatives[GEOMETRY][windows] = gain[:, None] * by_geometry * self.geometry.sd
        if self.directed is not None:
            derivatives[PATTERN][windows] += gain[:, None] * self._by_pattern(self.directed, values)
        return expected, signal, derivatives

    def _by_pattern(self, plain: DirectedImages, values: Values) -> FloatArray:
        """Return what coherence adds to the derivative by b at a gain of 1, (n_early_windows, 3).

        Of the source that each window receives.
        """
        images, amplitude, slope = plain
        pressures = coherent_slopes(
            plain,
            values["absorption"],
            times_of(self.geometry, values[GEOMETRY]),
            self.grid,
            tuple(o.edges_s for o in self.early),
        )
        energy = image_energies(images, values["absorption"]) * images.coherence
        less = 2.0 * (energy * amplitude)[:, None] * slope
        out = []
        for o, observed in enumerate(self.early):
            own = slice(images.offsets[o], images.offsets[o + 1])
            bins, n_bins = self.coherent_bins[own], observed.spreading.shape[1]
            binned = np.stack([np.bincount(bins, column, n_bins) for column in less[own].T])
            out.append(observed.spreading @ binned.T)
        return np.asarray(pressures - np.concatenate(out))

    def _less(self, energy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the energies of what is coherent in each early window, and by ln(1 - a)."""
        energy = energy * self.coherent.coherence

        def less(o: int) -> tuple[FloatArray, FloatArray]:
            observed = self.early[o]
            own = slice(self.coherent.offsets[o], self.coherent.offsets[o + 1])
            n_bins = observed.spreading.shape[1]
            total, hits = np.zeros(n_bins), np.zeros((self.coherent.hits.shape[1], n_bins))
            binned_energies(
                self.coherent_bins[own],
                self.coherent.row[own],
                self.coherent.hits,
                energy[own],
                total,
                hits,
            )
            return observed.spreading @ total, observed.spreading @ hits.T

        worth_it = energy.size * self.coherent.hits.shape[1] >= ROWS_WORTH_THREADS
        energies, by_hits = zip(
            *each_in_threads(less, len(self.early), worth_it=worth_it), strict=True
        )
        return np.concatenate(energies), np.concatenate(by_hits)

    def expected(self, values: Values) -> FloatArray:
        """Return what the model expects in every window, shape (n_windows,)."""
        expected = self.energies.expected(values)
        energy = np.add.reduceat(self._in_pieces(values), _first_pieces(self.early))
        less, _ = self._less(image_energies(self.coherent, values["absorption"]))
        gains = np.append(values["gain"], 1.0)
        gain = np.repeat([gains[o.gain] for o in self.early], [o.energy.size for o in self.early])
        expected[self.early_windows()] += gain * (energy - less)
        return expected

    def variance_parts(self, values: Values) -> dict[str, FloatArray]:
        """Return what the variance of every window is the sum of, by name, (n_windows,) each.

        With Y the energy per time of the coherent pressure and P that of what is not, the random
        part interferes with itself and with the coherent one: ``(P^2 + 2 P Y - Q) / B`` integrated
        over the window, where ``Q = sum of e_i^2 (1 - gamma_i^2)`` takes out what single arrivals
        cannot do, since a single arrival has its energy whatever its phase. Without coherence, and
        in late windows, this is the variance of the energies.
        """
        gains = np.append(values["gain"], 1.0)
        paths = weighed(self.energies, values["absorption"])
        intensity = self._last.get(_key(values))
        if intensity is None:
            intensity = self._in_pieces(values)
        ends = np.cumsum([0, *(o.fine_edges_s.size - 1 for o in self.early)])
        energy = image_energies(self.images, values["absorption"])
        parts = []
        for o, (early, observed) in enumerate(
            zip(self.early, self.energies.observations, strict=True)
        ):
            gain = float(gains[observed.gain])
            coherent = intensity[ends[o] : ends[o + 1]]
            own = _early_variance(self, o, paths[o], energy, coherent, gain)
            if early.energy.size < observed.energy.size:
                late = observation_variance(self.energies, o, paths[o], gain)
                n = early.energy.size
                own = {name: np.append(x, late[name][n:]) for name, x in own.items()}
            parts.append(own)
        return end_to_end(parts)

    def _in_pieces(self, values: Values) -> FloatArray:
        """Return the energy of the coherent pressure in the pieces of the early windows."""
        times, edges_s = times_of(self.geometry, values[GEOMETRY]), self._edges_s()
        return coherent_response(
            self.coherent, values["absorption"], times, self.grid, edges_s, derivative=False
        ).energy

    def _edges_s(self) -> tuple[FloatArray, ...]:
        return tuple(o.fine_edges_s for o in self.early)

    def correlation_length(self, _start: Values) -> FloatArray:
        """Return `WINDOWS_PER_INDEPENDENT_ONE` for every window."""
        return np.full(self.measured().size, WINDOWS_PER_INDEPENDENT_ONE)

    def as_energies(self, _values: Values) -> EnergyTerm:
        """Return the windows as energies of all paths."""
        return self.energies

    def aimed(self, aims: Sequence[FloatArray | None]) -> CoherentTerm:
        """Return the windows with where their images leave the sources, once for all."""
        return replace(self, basis=image_basis(self.images, aims))

    def radiated(self, b: Sequence[FloatArray | None], basis: Sequence[RowBasis]) -> CoherentTerm:
        """Return the windows with directivities as `EnergyTerm.radiated`."""
        amplitude, slope = image_amplitudes(self.images, b, cast(RowBasis, self.basis))
        own = self.images.coherence > 0.0
        directed = DirectedImages(self.coherent, amplitude[own], slope[own])
        return replace(
            self,
            energies=self.energies.radiated(b, basis),
            images=directed_images(self.images, amplitude),
            coherent=directed_images(self.coherent, directed.amplitude),
            directed=directed,
        )

    def early_windows(self) -> IntArray:
        """Return where the early windows stand among all."""
        first, found = 0, []
        for early, observed in zip(self.early, self.energies.observations, strict=True):
            found.append(np.arange(first, first + early.energy.size))
            first += observed.energy.size
        return np.concatenate(found)


def _key(values: Values) -> bytes:
    return values["absorption"].tobytes() + values[GEOMETRY].tobytes()


def _first_pieces(early: tuple[Observation, ...]) -> IntArray:
    """Return where the first piece of each early window stands among those of all."""
    before = np.cumsum([0, *(o.fine_edges_s.size - 1 for o in early[:-1])])
    own = (np.searchsorted(o.fine_edges_s, o.edges_s[:-1]) for o in early)
    return np.concatenate([n + first for n, first in zip(before, own, strict=True)])


def with_coherence(
    term: CoherentTerm, covariance: FloatArray, phase_sd: float = 0.0
) -> CoherentTerm:
    """Return the windows with each path as coherent as its arrival time is known.

    ``gamma = exp(-w^2 var(t) - phase_sd^2 n)`` with w of the band's centre, n hits, and var(t) of
    the geometry's covariance, of positions to half a millimetre and of a share of 1e-4 of the time.

    Shapes: `covariance` (n, n).
    """
    images, c = term.images, term.geometry.speed_m_s
    spread = np.empty(images.weight.size)
    roots = local_roots(term.geometry, covariance)
    shared = (images.row, images.image_to_receiver_m, images.image_transform, images.hits)
    in_threads(spread_squared, len(roots), images.offsets, *shared, c, roots, spread)
    travel_s = images.lengths_m() / c
    spread += 2.0 * (_POSITION_SD_M / c) ** 2 + (_TIMING_SHARE * travel_s) ** 2
    phase = (2.0 * np.pi * term.energies.centre_hz) ** 2 * spread
    if phase_sd > 0.0:
        struck = images.hits.sum(axis=1) if images.reflections is None else images.reflections
        phase += phase_sd**2 * struck[images.row]
    known = _with_gamma(term, np.exp(-phase))
    # high bands know few times, all early: windows after them hold no pressure
    last_s = float(travel_s.max(where=known.images.coherence > 0.0, initial=0.0))
    last_s += RINGING_PERIODS / term.energies.centre_hz
    edges_s = np.array([o.edges_s[[0, -1]] for o in term.early])
    if last_s > 0.8 * edges_s.max():
        return known
    first_s = float(edges_s.min())  # where no arrival time is known, the windows begin after all
    grid = band_grid(term.grid.band, first_s, max(first_s, last_s))
    return replace(known, grid=replace(grid, real=term.grid.real))


def fully_coherent(term: CoherentTerm) -> CoherentTerm:
    """Return the windows with every path as coherent as if its arrival time were known."""
    return _with_gamma(term, np.ones(term.bins.size))


def _with_gamma(term: CoherentTerm, gamma: FloatArray) -> CoherentTerm:
    keep = (gamma > _LEAST_COHERENCE) & (term.bins >= 0)
    images = replace(term.images, coherence=np.where(keep, gamma, 0.0))
    return replace(
        term,
        images=images,
        coherent=chosen_paths(images, keep),
        coherent_bins=term.bins[keep],
    )


def _early_variance(
    term: CoherentTerm,
    observation: int,
    paths: Weighed,
    energy: FloatArray,
    coherent: FloatArray,
    gain: float,
) -> dict[str, FloatArray]:
    """Return the parts of the variance of an observation's early windows.

    `energy` is that of all `term.images`, `coherent` that of the coherent pressure in each of
    the windows' pieces.
    """
    observed, images = term.early[observation], term.images
    own = slice(images.offsets[observation], images.offsets[observation + 1])
    shares = np.zeros((3, observed.spreading.shape[1]))
    binned_shares(term.bins[own], energy[own], images.coherence[own], shares)
    pressures, single, late = shares
    random = np.maximum(paths.energy - pressures, 0.0)
    spread, squares = with_squares(observed.fine_spreading, random, single)
    pieces = spread**2 + 2.0 * spread * coherent
    pieces -= squares
    pieces = np.maximum(pieces, 0.0)
    pieces /= term.energies.bandwidth_hz * np.diff(observed.fine_edges_s)
    first = np.searchsorted(observed.fine_edges_s, observed.edges_s[:-1])
    interference = np.add.reduceat(pieces, first)
    timing = observed.timing_sd_s**2 * squares_in_windows(observed.slopes, late)
    tracing = paths.tracing[: observed.energy.size]
    signal = gain * (observed.spreading @ random + np.add.reduceat(coherent, first))
    return {
        "interference": gain**2 * interference,
        "positions": gain**2 * timing,
        "rays": gain**2 * tracing,
        **noise_and_model_variance(term.energies, observed, signal),
    }
