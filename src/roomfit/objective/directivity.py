"""Sources that radiate as patterns of few unknowns: first order, or third about a known aim.

The unknowns are one vector b a pattern, which sources of one make share: no angles, no bounds.
Their block stands behind absorption and gain and before the geometry, whose position at the end
`marginal` relies on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from roomfit._checks import read_only
from roomfit.measurement import MeasuredPair
from roomfit.objective.coherent import CoherentTerm
from roomfit.objective.energy import PATTERN, EnergyTerm
from roomfit.objective.parameters import (
    GEOMETRY,
    Block,
    Parameters,
    times_of,
)
from roomfit.objective.problem import DataTerm, Objective, Rows, Values
from roomfit.response.binned import BinnedPaths
from roomfit.response.coherent import ImagePaths, image_energies
from roomfit.response.directivity import (
    Pattern,
    RowPattern,
    amplitude_and_slope,
    coherent_slopes,
    directed_images,
    image_departure,
    pattern_basis,
)
from roomfit.scene import Scene
from roomfit.tracing.paths import Paths
from roomfit.typing import FloatArray, IntArray

DIRECTIVITY = "directivity"


@dataclass(frozen=True, slots=True, eq=False)
class UnknownDirectivities:
    """Priors of the vectors b of some sources, or of loudspeakers that several sources are."""

    sources: tuple[str, ...]
    mean: FloatArray  # (3 * n_sources,), of b, source after source
    # (3 * n_sources, 3 * n_sources), ``b = mean + root z`` with z of a unit normal law: times its
    # transpose, the covariance
    root: FloatArray

    def __post_init__(self) -> None:
        for name in ("mean", "root"):
            object.__setattr__(self, name, read_only(np.array(getattr(self, name))))


def directivity_block(unknown: UnknownDirectivities) -> Block:
    """Return the block of the free numbers z, shape (3 * n_sources,)."""
    labels = tuple(f"directivity {s} {axis}" for s in unknown.sources for axis in "xyz")
    n = len(labels)
    return Block(
        DIRECTIVITY,
        labels,
        "identity",
        np.zeros(n),
        np.ones(n, dtype=np.bool_),
        np.zeros(n),
        np.ones(n),
        np.full(n, -1e6),
        np.full(n, 1e6),
    )


def with_directivities(parameters: Parameters, unknown: UnknownDirectivities) -> Parameters:
    """Return parameters that end with the sources' directivity."""
    blocks = tuple(b for b in parameters.blocks if b.name != DIRECTIVITY)
    return Parameters((*blocks, directivity_block(unknown)))


@dataclass(frozen=True, slots=True, eq=False)
class BandDirectivities:
    """Unknown directivities in one band, and where its rows leave the sources."""

    unknown: UnknownDirectivities
    # (n_observations,), which of the unknown sources each observation receives; -1 for one that is
    # known
    source: IntArray
    # (n_rows, 3), one an observation: `pattern_basis` of where the path of each row leaves
    basis: tuple[NDArray[np.float32] | FloatArray, ...]
    aims: tuple[FloatArray | None, ...]  # one an observation


@dataclass(frozen=True, slots=True, eq=False)
class DirectedTerm:
    """Windows as energies or pressures, their paths weighed by their sources' directivity."""

    is_gamma: ClassVar[bool] = True
    windows: EnergyTerm | CoherentTerm  # with the weights of omnidirectional sources
    directivity: BandDirectivities
    # image_basis, coherent_basis: (n_paths, 3), the same of the images of coherent windows, else
    # empty
    image_basis: FloatArray
    coherent_basis: FloatArray
    # of the last prediction, by its b: the windows with the weights of b, for the variance there
    _last: dict[bytes, EnergyTerm | CoherentTerm] = field(
        default_factory=dict, init=False, repr=False
    )

    @property
    def energies(self) -> EnergyTerm:
        """The windows as energies of omnidirectional sources."""
        return self.windows.energies if isinstance(self.windows, CoherentTerm) else self.windows

    def measured(self) -> FloatArray:
        """Return the measured window energies, shape (n_windows,)."""
        return self.windows.measured()

    def predict(self, values: Values) -> Rows:
        """Return what the model expects in every window."""
        b = vectors_of(self.directivity.unknown, values[DIRECTIVITY])
        own = self._weighed(b)
        expected, signal, derivatives = own.predict(values)
        self._last.clear()
        self._last[b.tobytes()] = own
        slopes = self._slopes(derivatives.pop(PATTERN), b, values) @ self.directivity.unknown.root
        return expected, signal, {**derivatives, DIRECTIVITY: slopes}

    def expected(self, values: Values) -> FloatArray:
        """Return what the model expects in every window, shape (n_windows,)."""
        b = vectors_of(self.directivity.unknown, values[DIRECTIVITY])
        return self._weighed(b).expected(values)

    def variance_parts(self, values: Values) -> dict[str, FloatArray]:
        """Return what the variance of every window is the sum of, by name, (n_windows,) each."""
        b = vectors_of(self.directivity.unknown, values[DIRECTIVITY])
        own = self._last.pop(b.tobytes(), None)
        return (self._weighed(b) if own is None else own).variance_parts(values)

    def correlation_length(self, start: Values) -> FloatArray:
        """Return how many neighbours share the information of each window, shape (n_windows,)."""
        return self.windows.correlation_length(start)

    def weighed(self, values: Values) -> EnergyTerm:
        """Return the windows as energies, with the weights that values give their paths."""
        b = vectors_of(self.directivity.unknown, values[DIRECTIVITY])
        found = self._weighed(b)
        return found.energies if isinstance(found, CoherentTerm) else found

    def _weighed(self, b: FloatArray) -> EnergyTerm | CoherentTerm:
        """Return the windows with the weights of b."""
        source = self.directivity.source
        patterns = tuple(
            None if s < 0 else RowPattern(b[s], basis)
            for s, basis in zip(source, self.directivity.basis, strict=True)
        )
        own = replace(self.energies, patterns=patterns)
        if not isinstance(self.windows, CoherentTerm):
            return own
        images, coherent = (
            directed_images(paths, _image_amplitudes(paths, source, basis, b)[0])
            for paths, basis in (
                (self.windows.images, self.image_basis),
                (self.windows.coherent, self.coherent_basis),
            )
        )
        return replace(self.windows, energies=own, images=images, coherent=coherent)

    def _slopes(self, by_pattern: FloatArray, b: FloatArray, values: Values) -> FloatArray:
        """Return the derivative of every window by all b, shape (n_windows, 3 * n_sources).

        Parameters
        ----------
        by_pattern : float array, shape (n_windows, 3)
            Of all paths as energies, by b of the source that each window receives.
        """
        gains = np.append(values["gain"], 1.0)
        out: FloatArray = np.zeros((len(by_pattern), b.size))
        added = self._coherent_slopes(b, values) if isinstance(self.windows, CoherentTerm) else ()
        first = 0
        for o, observed in enumerate(self.energies.observations):
            n, s = observed.energy.size, self.directivity.source[o]
            if s >= 0:
                slopes = by_pattern[first : first + n]
                if added:
                    slopes[: len(added[o])] += gains[observed.gain] * added[o]
                out[first : first + n, 3 * s : 3 * s + 3] = slopes
            first += n
        return out

    def _coherent_slopes(self, b: FloatArray, values: Values) -> tuple[FloatArray, ...]:
        """Return what coherence adds to the derivative by b in each observation's early windows.

        At a gain of 1, one array of the shape (n_early, 3) an observation.
        """
        plain = cast(CoherentTerm, self.windows)
        images, source = plain.coherent, self.directivity.source
        amplitude, slope = _image_amplitudes(images, source, self.coherent_basis, b)
        pressures = coherent_slopes(
            images,
            values["absorption"],
            times_of(plain.geometry, values[GEOMETRY]),
            plain.grid,
            tuple(o.edges_s for o in plain.early),
            amplitude,
            slope,
        )
        energy = image_energies(images, values["absorption"]) * images.coherence
        less = 2.0 * (energy * amplitude)[:, None] * slope
        out, first = [], 0
        for o, observed in enumerate(plain.early):
            own = slice(images.offsets[o], images.offsets[o + 1])
            bins, n_bins = plain.coherent_bins[own], observed.spreading.shape[1]
            binned = np.stack([np.bincount(bins, column, n_bins) for column in less[own].T])
            n = observed.energy.size
            out.append(np.asarray(pressures[first : first + n] - observed.spreading @ binned.T))
            first += n
        return tuple(out)


def directed(
    windows: EnergyTerm | CoherentTerm, directivity: BandDirectivities | None
) -> EnergyTerm | CoherentTerm | DirectedTerm:
    """Return windows weighed by their sources' directivity, or as they are without any."""
    if directivity is None:
        return windows
    images = coherent = np.zeros((0, 3))
    if isinstance(windows, CoherentTerm):
        images = _image_basis(windows.images, directivity.aims)
        coherent = _image_basis(windows.coherent, directivity.aims)
    return DirectedTerm(windows, directivity, images, coherent)


def _image_basis(images: ImagePaths, aims: tuple[FloatArray | None, ...]) -> FloatArray:
    departure = image_departure(images)
    parts = np.split(departure, images.offsets[1:-1])
    return np.concatenate([pattern_basis(p, aim) for p, aim in zip(parts, aims, strict=True)])


def energy_objective(
    windows: EnergyTerm,
    parameters: Parameters,
    directivity: BandDirectivities | None,
    values: DataTerm | None,
) -> Objective:
    """Return the objective of a band's windows as energies, and of its room parameters if any."""
    if directivity is not None:
        parameters = with_directivities(parameters, directivity.unknown)
    others = () if values is None else (values,)
    return Objective(parameters, (directed(windows, directivity), *others))


def vectors_of(unknown: UnknownDirectivities, free: FloatArray) -> FloatArray:
    """Return b of every unknown source for free numbers z, shape (n_sources, 3)."""
    return np.asarray((unknown.mean + unknown.root @ free).reshape(-1, 3))


def _image_amplitudes(
    images: ImagePaths, source: IntArray, basis: FloatArray, b: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return amplitude (n,) and slope (n, 3) of every image: 1 and 0 where b is known."""
    amplitude, slope = np.ones(len(basis)), np.zeros((len(basis), 3))
    for o, s in enumerate(source):
        if s >= 0:
            own = slice(images.offsets[o], images.offsets[o + 1])
            amplitude[own], slope[own] = amplitude_and_slope(b[s], basis[own])
    return amplitude, slope


# Of each component of b, where it is unspecified: an omnidirectional source and a cardioid are both
# within reach.
DEFAULT_B_SD = 0.5
# Between bands an octave apart: a loudspeaker keeps its aim, and becomes narrower by and by.
CORRELATION_PER_OCTAVE = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class DirectivityParameters:
    """Sources whose directivity is to be found, or the loudspeakers that several of them are."""

    sources: tuple[str, ...]  # names, of loudspeakers where those are shared
    of_source: IntArray  # (n_scene_sources,), which of them a source of the scene is; -1: none
    # mean, sd: (n_sources, 3) and (n_sources,), prior of the vectors b, the same in all bands
    mean: FloatArray
    sd: FloatArray
    aims: tuple[FloatArray | None, ...] = ()  # of every source of the scene; empty: none is known


def directivity_prior(directivity_parameters: DirectivityParameters) -> UnknownDirectivities:
    """Return what is known of every source before any data."""
    root = np.diag(np.repeat(directivity_parameters.sd, 3))
    return UnknownDirectivities(
        directivity_parameters.sources, directivity_parameters.mean.ravel(), root
    )


def with_cavity_prior(
    directivity_parameters: DirectivityParameters, mean: FloatArray, covariance: FloatArray
) -> UnknownDirectivities:
    """Return the unknowns under what other bands determine of the free numbers."""
    start = directivity_prior(directivity_parameters)
    root = start.root @ np.linalg.cholesky(covariance)
    return UnknownDirectivities(
        directivity_parameters.sources, start.mean + start.root @ mean, root
    )


def row_bases(
    directivity_parameters: DirectivityParameters, scene: Scene, paths: Paths, binned: BinnedPaths
) -> tuple[NDArray[np.float32] | FloatArray, ...]:
    """Return `pattern_basis` of the rows of every pair, once for all bands; empty where known."""
    aims = directivity_parameters.aims or (None,) * len(scene.sources)
    return tuple(
        pattern_basis(paths.departure[rows.path], aims[source])
        if directivity_parameters.of_source[source] >= 0
        else np.zeros((0, 3))
        for rows, source in zip(binned.rows, scene.pairs[:, 0].tolist(), strict=True)
    )


def directed_band(
    directivity_parameters: DirectivityParameters,
    scene: Scene,
    bases: Sequence[NDArray[np.float32] | FloatArray],
    energies: EnergyTerm,
    files: Sequence[MeasuredPair],
) -> BandDirectivities:
    """Return where the rows of a band leave the sources, nothing known of these yet.

    Parameters
    ----------
    bases : sequence of float arrays, shape (n_rows, 3)
        `row_bases` of the same binned paths: a band has the first rows of each pair.
    """
    number = [int(scene.pairs[m.pair][0]) for m in files]
    source = directivity_parameters.of_source[number]
    known = directivity_parameters.aims or (None,) * len(scene.sources)
    basis = tuple(bases[m.pair][: len(rows)] for rows, m in zip(energies.rows, files, strict=True))
    unknown, aims = directivity_prior(directivity_parameters), tuple(known[i] for i in number)
    return BandDirectivities(unknown, source, basis, aims)


@dataclass(frozen=True, slots=True, eq=False)
class FittedDirectivity:
    """What was found of how one source radiates, or a loudspeaker that several sources are."""

    source: str  # or the name of the loudspeaker
    # b, sd: (n_bands, 3), amplitude ``1 + b . u`` in direction u: along the axis, of length 0 where
    # the source is omnidirectional; and the standard deviation of each component, misfit included.
    b: FloatArray
    sd: FloatArray
    # aim of each source that shares the pattern, which then is of third order; None where it is of
    # first order and its axis unknown
    aims: Mapping[str, FloatArray | None] = field(default_factory=dict)

    def patterns(self) -> dict[str, Pattern]:
        """Return the directivity of each source that has it."""
        aims = self.aims or {self.source: None}
        return {name: Pattern(self.b, aim) for name, aim in aims.items()}
