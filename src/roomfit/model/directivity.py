"""Sources that radiate as patterns of few unknowns: first order, or third about a known aim.

The unknowns are one vector b a pattern, which sources of one make share: no angles, no bounds.
Their block stands behind absorption and gain and before the geometry, whose position at the end
`marginal` relies on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Protocol

import numpy as np

from roomfit.base.arguments import read_only
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.model.binned import BinnedPaths
from roomfit.model.energy import PATTERN, EnergyTerm
from roomfit.model.parameters import Block, Parameters, unit_block
from roomfit.model.patterns import Pattern, pattern_basis
from roomfit.model.problem import DataTerm, Objective, Rows, Values
from roomfit.model.weighing import RowBasis
from roomfit.room.scene import Scene
from roomfit.signals.measurement import MeasuredPair
from roomfit.tracing.paths import Paths

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
    return unit_block(DIRECTIVITY, labels, np.ones(len(labels), dtype=np.bool_))


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
    basis: tuple[RowBasis, ...]
    aims: tuple[FloatArray | None, ...]  # one an observation


class Windows(DataTerm, Protocol):
    """Windows of a band that can be weighed by their sources' directivity."""

    __slots__ = ()

    def as_energies(self, values: Values) -> EnergyTerm:
        """Return the windows as energies, their paths weighed as at values."""
        ...

    def radiated(self, b: Sequence[FloatArray | None], basis: Sequence[RowBasis]) -> Windows:
        """Return the windows with the directivity of each observation's source."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class DirectedTerm(DataTerm):
    """Windows, their paths weighed by their sources' directivity."""

    is_gamma: ClassVar[bool] = True
    windows: Windows  # with the weights of omnidirectional sources
    directivity: BandDirectivities
    # of the last prediction, by its b: the windows with the weights of b, for the variance there
    _last: dict[bytes, Windows] = field(default_factory=dict, init=False, repr=False)

    def measured(self) -> FloatArray:
        """Return the measured window energies, shape (n_windows,)."""
        return self.windows.measured()

    def predict(self, values: Values) -> Rows:
        """Return what the model expects in every window."""
        b = vectors_of(self.directivity.unknown, values[DIRECTIVITY])
        own = self._radiated(b)
        expected, signal, derivatives = own.predict(values)
        self._last.clear()
        self._last[b.tobytes()] = own
        by_pattern = derivatives.pop(PATTERN)
        slopes = np.zeros((len(by_pattern), b.size))
        first = 0
        for s, observed in zip(
            self.directivity.source, own.as_energies(values).observations, strict=True
        ):
            n = observed.energy.size
            if s >= 0:
                slopes[first : first + n, 3 * s : 3 * s + 3] = by_pattern[first : first + n]
            first += n
        by_free = slopes @ self.directivity.unknown.root
        return expected, signal, {**derivatives, DIRECTIVITY: by_free}

    def expected(self, values: Values) -> FloatArray:
        """Return what the model expects in every window, shape (n_windows,)."""
        return self.radiated(values).expected(values)

    def variance_parts(self, values: Values) -> dict[str, FloatArray]:
        """Return what the variance of every window is the sum of, by name, (n_windows,) each."""
        b = vectors_of(self.directivity.unknown, values[DIRECTIVITY])
        own = self._last.pop(b.tobytes(), None)
        return (self._radiated(b) if own is None else own).variance_parts(values)

    def correlation_length(self, start: Values) -> FloatArray:
        """Return how many neighbours share the information of each window, shape (n_windows,)."""
        return self.windows.correlation_length(start)

    def as_energies(self, values: Values) -> EnergyTerm:
        """Return the windows as energies, with the weights that values give their paths."""
        return self.radiated(values).as_energies(values)

    def radiated(self, values: Values) -> Windows:
        """Return the windows with the weights that values give their paths."""
        return self._radiated(vectors_of(self.directivity.unknown, values[DIRECTIVITY]))

    def _radiated(self, b: FloatArray) -> Windows:
        """Return the windows with the weights of b."""
        each = [None if s < 0 else b[s] for s in self.directivity.source]
        return self.windows.radiated(each, self.directivity.basis)


def directed(windows: Windows, directivity: BandDirectivities | None) -> Windows | DirectedTerm:
    """Return windows weighed by their sources' directivity, or as they are without any."""
    return windows if directivity is None else DirectedTerm(windows, directivity)


def energy_objective(
    windows: EnergyTerm,
    parameters: Parameters,
    directivity: BandDirectivities | None,
    others: Sequence[DataTerm] = (),
) -> Objective:
    """Return the objective of a band's windows as energies, and of its other data if any."""
    if directivity is not None:
        parameters = with_directivities(parameters, directivity.unknown)
    return Objective(parameters, (directed(windows, directivity), *others))


def vectors_of(unknown: UnknownDirectivities, free: FloatArray) -> FloatArray:
    """Return b of every unknown source for free numbers z, shape (n_sources, 3)."""
    return np.asarray((unknown.mean + unknown.root @ free).reshape(-1, 3))


# Of each component of b, where it is unspecified: an omnidirectional source and a cardioid are both
# within reach.
DEFAULT_B_SD = 0.5
# Between bands an octave apart: a loudspeaker keeps its aim, and becomes narrower by and by.
CORRELATION_PER_OCTAVE = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class DirectivityParameters:
    """Sources whose directivity is to be found, or the loudspeakers that several of them are."""

    prior: UnknownDirectivities  # the same in all bands; of loudspeakers where those are shared
    of_source: IntArray  # (n_scene_sources,), which of them a source of the scene is; -1: none
    aims: tuple[FloatArray | None, ...]  # of every source of the scene; None: not known


def row_bases(
    directivity_parameters: DirectivityParameters,
    scene: Scene,
    paths: Paths,
    binned: BinnedPaths,
    kept: BoolArray | None = None,
) -> tuple[RowBasis, ...]:
    """Return `pattern_basis` of the rows of every pair, once for all bands and states."""
    aims = directivity_parameters.aims
    found: dict[tuple[int, int], RowBasis] = {}
    bases = []
    for rows, (source, receiver) in zip(binned.rows, scene.pairs.tolist(), strict=True):
        basis: RowBasis = np.zeros((0, 3))
        if directivity_parameters.of_source[source] >= 0 and rows.path is not None:
            path = rows.path if kept is None else rows.path[kept[rows.path]]
            basis = pattern_basis(paths.departure[path], aims[source])
        like = found.setdefault((source, receiver), basis)
        bases.append(like if np.array_equal(basis, like) else basis)
    return tuple(bases)


def directed_band(
    directivity_parameters: DirectivityParameters,
    scene: Scene,
    bases: Sequence[RowBasis],
    energies: EnergyTerm,
    files: Sequence[MeasuredPair],
) -> BandDirectivities:
    """Return where the rows of a band leave the sources, nothing known of these yet."""
    number = [int(scene.pairs[m.pair][0]) for m in files]
    source = directivity_parameters.of_source[number]
    basis = tuple(bases[m.pair][: len(rows)] for rows, m in zip(energies.rows, files, strict=True))
    aims = tuple(directivity_parameters.aims[i] for i in number)
    return BandDirectivities(directivity_parameters.prior, source, basis, aims)


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
        return {
            name: Pattern(self.b, aim, "" if aim is None else self.source)
            for name, aim in aims.items()
        }
