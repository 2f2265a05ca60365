"""What all fits of a room leave: the answer of every band, and records for the checks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from roomfit.base.typing import FloatArray
from roomfit.fit.directivity import SourceGain
from roomfit.model.directivity import DirectivityParameters, FittedDirectivity
from roomfit.signals.measurement import Measurement
from roomfit.uncertainty.gaussian import BandEstimate


class Freed(NamedTuple):
    """What is gained if something that the settings fix is fitted."""

    gain: float  # of the log-likelihood, over all bands
    n_unknowns: int  # each that explains nothing gains half a unit on average
    n_windows: int  # of all bands


@dataclass(frozen=True, slots=True, eq=False)
class CoherentTests:
    """What fits by pressures measured of the description on the way."""

    outliers: Mapping[Measurement, float] = field(default_factory=dict)  # ratio of misfits
    position_sd_scale: float = 1.0  # by which standard deviations of positions were inflated
    freed_delays: Freed | None = None  # None where they were fitted, or not asked for
    freed_positions: Freed | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Displacement:
    """What stands elsewhere than specified by more than its standard deviation allows."""

    kind: str  # the name of a group of positions, "length", or "wall": the one at the origin
    points: frozenset[str]  # sources and receivers of a group; empty for a length or a wall
    axis: int
    size_m: float  # along the axis, signed
    sd_m: float  # at most 10
    specified_sd_m: float
    gain: float  # of the log-likelihood
    walls: tuple[str, ...]  # a box's at both ends of the axis; none of another room
    # how much farther than specified each of these walls is from all positions, with its standard
    # deviation, where that is known; None where it was not asked
    farther_m: Mapping[str, tuple[float, float]] | None


@dataclass(frozen=True, slots=True, eq=False)
class BandFits:
    """The answer of every band, and what was measured of the description on the way.

    Records only: `roomfit.checks` judges them.
    """

    answers: tuple[BandEstimate, ...]
    geometry: FittedGeometry | None = None
    directivities: tuple[FittedDirectivity, ...] = ()  # one a source; empty where none was fitted
    unknown_sources: DirectivityParameters | None = None  # those of `directivities`
    contradicted: tuple[SourceGain, ...] = ()  # of the sources taken for omnidirectional
    tests: CoherentTests = field(default_factory=CoherentTests)
    displacement: Displacement | None = None  # beyond what is specified
    # by band, covariance of logits by offsets that are not exactly known, (n_materials,) square
    added: Mapping[int, FloatArray] = field(default_factory=dict)


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
    # how many of the last entries are offsets of groups and lengths, found by early energies
    n_offsets: int = 0
