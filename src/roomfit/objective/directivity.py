"""Sources that radiate as first-order patterns of unknown aim and strength.

The unknowns are one vector b a source: no angles, no bounds. Their block stands behind absorption
and gain and before the geometry, whose position at the end `marginal` relies on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from roomfit._checks import read_only
from roomfit.measurement import MeasuredPair
from roomfit.objective.coherent import CoherentProblem
from roomfit.objective.energy import EnergyProblem
from roomfit.objective.parameters import (
    GEOMETRY,
    Block,
    Parameters,
    physical_values,
    position_of,
    times_of,
)
from roomfit.objective.problem import BandProblem, Prediction
from roomfit.response.coherent import ImagePaths, image_energies
from roomfit.response.directivity import (
    amplitude_and_slope,
    coherent_slopes,
    directed_images,
    directed_rows,
    image_departure,
)
from roomfit.response.energy import EnergyRows, weigh
from roomfit.scene import Scene
from roomfit.tracing.paths import Paths
from roomfit.typing import BoolArray, FloatArray, IntArray

DIRECTIVITY = "directivity"


@dataclass(frozen=True, slots=True, eq=False)
class UnknownDirectivities:
    """Priors of the vectors b of some sources."""

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
        *(DIRECTIVITY, labels, "identity", np.zeros(n), np.ones(n, dtype=np.bool_)),
        *(np.zeros(n), np.ones(n), np.full(n, -1e6), np.full(n, 1e6)),
    )


def with_unknown(problem: EnergyProblem, unknown: UnknownDirectivities) -> EnergyProblem:
    """Return an energy problem whose parameters end with the sources' directivity.

    It does not depend on them yet: `DirectedProblem` makes it.
    """
    blocks = tuple(b for b in problem.parameters.blocks if b.name != DIRECTIVITY)
    return replace(problem, parameters=Parameters((*blocks, directivity_block(unknown))))


@dataclass(frozen=True, slots=True, eq=False)
class DirectedProblem:
    """A problem of energies or pressures, its paths weighed by its sources' directivity."""

    # with the weights of omnidirectional sources and a block "directivity"
    problem: EnergyProblem | CoherentProblem
    unknown: UnknownDirectivities
    # (n_observations,), which of the unknown sources each observation receives; -1 for one that is
    # known
    source: IntArray
    # (n_rows, 3), one an observation, where the path of each row leaves its source
    departure: tuple[NDArray[np.float32], ...]
    # image_departure, coherent_departure: (n_paths, 3), the same of the images of a coherent
    # problem, else empty; see `directed`
    image_departure: NDArray[np.float32]
    coherent_departure: NDArray[np.float32]

    @property
    def parameters(self) -> Parameters:
        """The unknowns of the problem."""
        return self.problem.parameters

    def measured(self) -> FloatArray:
        """Return the data, shape (n_data,)."""
        return self.problem.measured()

    def predict(self, vector: FloatArray) -> Prediction:
        """Return what the model expects in every window."""
        b = vectors_b(self, vector)
        found = _weighed(self, b, single=False).predict(vector)
        first = position_of(self.parameters, DIRECTIVITY)
        jacobian = np.array(found.jacobian)
        slopes = _slopes(self, b, vector) @ self.unknown.root
        jacobian[:, first : first + slopes.shape[1]] += slopes
        return Prediction(found.expected, found.signal, jacobian)

    def variance(self, vector: FloatArray) -> FloatArray:
        """Return how far every window may scatter, shape (n_windows,)."""
        return _weighed(self, vectors_b(self, vector), single=True).variance(vector)

    def correlation_length(self) -> FloatArray:
        """Return how many neighbours share the information of each datum, shape (n_data,)."""
        return self.problem.correlation_length()

    def is_gamma(self) -> BoolArray:
        """Return which data are energies, shape (n_data,)."""
        return self.problem.is_gamma()

    def log_likelihood(self, expected: FloatArray, variance: FloatArray) -> FloatArray:
        """Return the log density of each datum, shape (n_data,)."""
        return self.problem.log_likelihood(expected, variance)


def directed(
    problem: EnergyProblem | CoherentProblem,
    unknown: UnknownDirectivities,
    source: IntArray,
    departure: tuple[NDArray[np.float32], ...],
) -> DirectedProblem:
    """Return a problem weighed by its sources' directivity; see `DirectedProblem`."""
    images = coherent = np.zeros((0, 3), dtype=np.float32)
    if isinstance(problem, CoherentProblem):
        images, coherent = image_departure(problem.images), image_departure(problem.coherent)
    return DirectedProblem(problem, unknown, source, departure, images, coherent)


def vectors_b(problem: DirectedProblem, vector: FloatArray) -> FloatArray:
    """Return b of every unknown source, shape (n_sources, 3)."""
    unknown = problem.unknown
    first = position_of(problem.parameters, DIRECTIVITY)
    return vectors_of(unknown, vector[first : first + unknown.mean.size])


def vectors_of(unknown: UnknownDirectivities, free: FloatArray) -> FloatArray:
    """Return b of every unknown source for free numbers z, shape (n_sources, 3)."""
    return np.asarray((unknown.mean + unknown.root @ free).reshape(-1, 3))


def _weighed(
    problem: DirectedProblem, b: FloatArray, *, single: bool
) -> EnergyProblem | CoherentProblem:
    """Return the problem with the weights that b gives, single arrivals' rows only if needed."""
    plain = problem.problem
    own = plain.energies if isinstance(plain, CoherentProblem) else plain
    rows, squared_images = list(own.rows), list(own.squared_image_rows)
    for o, s in enumerate(problem.source):
        if s < 0:
            continue
        factor = amplitude_and_slope(b[s], problem.departure[o])[0] ** 2
        rows[o] = directed_rows(own.rows[o], factor)
        if single:
            squared_images[o] = directed_rows(
                own.squared_image_rows[o], factor[own.rows[o].batch < 0] ** 2
            )
    own = replace(own, rows=tuple(rows), squared_image_rows=tuple(squared_images))
    if not isinstance(plain, CoherentProblem):
        return own
    images = _images(plain.images, problem.source, problem.image_departure, b)
    coherent = _images(plain.coherent, problem.source, problem.coherent_departure, b)
    return replace(plain, energies=own, images=images, coherent=coherent)


def _images(
    images: ImagePaths, source: IntArray, departure: NDArray[np.float32], b: FloatArray
) -> ImagePaths:
    return directed_images(images, _image_amplitudes(images, source, departure, b)[0])


def _image_amplitudes(
    images: ImagePaths, source: IntArray, departure: NDArray[np.float32], b: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return amplitude (n,) and slope (n, 3) of every image: 1 and 0 where b is known."""
    amplitude, slope = np.ones(len(departure)), np.zeros((len(departure), 3))
    for o, s in enumerate(source):
        if s >= 0:
            own = slice(images.offsets[o], images.offsets[o + 1])
            amplitude[own], slope[own] = amplitude_and_slope(b[s], departure[own])
    return amplitude, slope


def _slopes(problem: DirectedProblem, b: FloatArray, vector: FloatArray) -> FloatArray:
    """Return the derivative of every window by b, shape (n_windows, 3 * n_sources)."""
    plain = problem.problem
    own = plain.energies if isinstance(plain, CoherentProblem) else plain
    values, _ = physical_values(plain.parameters, vector)
    gains = np.append(values["gain"], 1.0)
    coefficients, air = values["absorption"][:, None], np.array([own.attenuation_per_m])
    out: FloatArray = np.zeros((plain.measured().size, b.size))
    added = _coherent_slopes(problem, b, values) if isinstance(plain, CoherentProblem) else ()
    first = 0
    for o, (s, observed) in enumerate(zip(problem.source, own.observations, strict=True)):
        n = observed.energy.size
        if s >= 0:
            moved = _row_slopes(own.rows[o], b[s], problem.departure[o], coefficients, air)
            slopes = observed.spreading @ moved.T
            if added:
                slopes[: len(added[o])] += added[o]
            out[first : first + n, 3 * s : 3 * s + 3] = gains[observed.gain] * slopes
        first += n
    return out


def _row_slopes(
    rows: EnergyRows,
    b: FloatArray,
    departure: NDArray[np.float32],
    coefficients: FloatArray,
    air: FloatArray,
) -> FloatArray:
    """Return the derivative of every bin's energy by b, shape (3, n_bins)."""
    amplitude, slope = amplitude_and_slope(b, departure)
    by_b = 2.0 * amplitude[:, None] * slope
    return np.stack(
        [
            weigh(directed_rows(rows, column), coefficients, air, derivative=False).energy[0]
            for column in by_b.T
        ]
    )


def _coherent_slopes(
    problem: DirectedProblem, b: FloatArray, values: dict[str, FloatArray]
) -> tuple[FloatArray, ...]:
    """Return what coherence adds to the derivative by b in the early windows of each observation.

    At a gain of 1, one array of the shape (n_early, 3) an observation.
    """
    plain = cast(CoherentProblem, problem.problem)
    images = plain.coherent
    amplitude, slope = _image_amplitudes(images, problem.source, problem.coherent_departure, b)
    pressures = coherent_slopes(
        *(images, values["absorption"], times_of(plain.geometry, values[GEOMETRY]), plain.grid),
        *(tuple(o.edges_s for o in plain.early), amplitude, slope),
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


# Of each component of b, where it is unspecified: an omnidirectional source and a cardioid are both
# within reach.
DEFAULT_B_SD = 0.5
# Between bands an octave apart: a loudspeaker keeps its aim, and becomes narrower by and by.
CORRELATION_PER_OCTAVE = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class DirectivityParameters:
    """Sources whose directivity is to be found."""

    sources: tuple[str, ...]
    number: IntArray  # (n_sources,), of each of them in the scene
    # mean, sd: (n_sources, 3) and (n_sources,), prior of the vectors b, the same in all bands
    mean: FloatArray
    sd: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class BandDirectivities:
    """Unknown directivities in one band, and where its rows leave the sources."""

    unknown: UnknownDirectivities
    source: IntArray  # (n_observations,)
    # one an observation, see `roomfit.objective.directivity.DirectedProblem`
    departure: tuple[NDArray[np.float32], ...]


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


def directed_band(
    directivity_parameters: DirectivityParameters,
    scene: Scene,
    paths: Paths,
    problem: EnergyProblem,
    files: Sequence[MeasuredPair],
) -> BandDirectivities:
    """Return where the rows of a band's problem leave the sources, nothing known of these yet."""
    unknown_of = {int(n): i for i, n in enumerate(directivity_parameters.number)}
    source = np.array([unknown_of.get(int(scene.pairs[m.pair][0]), -1) for m in files])
    departure = tuple(
        paths.departure[rows.path] if s >= 0 else np.zeros((0, 3), dtype=np.float32)
        for s, rows in zip(source, problem.rows, strict=True)
    )
    return BandDirectivities(directivity_prior(directivity_parameters), source, departure)


def with_directivity_unknown(
    problem: EnergyProblem | CoherentProblem, directivity: BandDirectivities | None
) -> BandProblem:
    """Return the problem with directivity unknown, or as it is where there is none."""
    if directivity is None:
        return problem
    return directed(problem, directivity.unknown, directivity.source, directivity.departure)


@dataclass(frozen=True, slots=True, eq=False)
class FittedDirectivity:
    """What was found of how one source radiates, as a first-order pattern."""

    source: str
    # b, sd: (n_bands, 3), amplitude ``1 + b . u`` in direction u: along the axis, of length 0 where
    # the source is omnidirectional; and the standard deviation of each component, misfit included.
    b: FloatArray
    sd: FloatArray
