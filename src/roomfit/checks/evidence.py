"""What a check may look at, and what it states of itself: its null hypothesis and its level."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from roomfit.base.findings import Finding
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.fit.fits import BandFits
from roomfit.fit.measurements import Measurements
from roomfit.fit.paths import TracedPaths
from roomfit.materials.priors import MaterialPrior
from roomfit.result import ComparedPair
from roomfit.settings import Settings
from roomfit.signals.measurement import Measurement


@dataclass(frozen=True, slots=True)
class Law:
    """The test behind a finding.

    How often a finding was raised in rooms where it should not have been stands in
    docs/findings.md.
    """

    null: str  # what holds in a room of which it is not raised
    statistic: str  # what is compared with what
    # probability by theory that it is raised where the null hypothesis holds, once a campaign; None
    # where the limit was chosen on rooms, or where nothing random is compared
    level: float | None = None


@dataclass(frozen=True, slots=True)
class ClockCorrection:
    """By how much the clock of some recordings is to be corrected."""

    files: tuple[str, ...]  # as `Measurement.where`
    late_s: float = 0.0  # to be added to their latency
    time_zero: Literal["direct"] | None = None  # to be set in place of "emission"


@dataclass(frozen=True, slots=True)
class ArrivalVerdict:
    """One cause of arrivals that contradict the geometry, and what corrects it where that is known.

    See `roomfit.checks.arrivals.arrival_verdicts`.
    """

    finding: Finding
    correction: ClockCorrection | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """What checks before a fit may look at."""

    measured: Measurements
    arrivals: tuple[ArrivalVerdict, ...]  # why direct sounds do not arrive when they should


@dataclass(frozen=True, slots=True, eq=False)
class Evidence(Recorded):
    """What checks after a fit may look at, quantities that several of them need derived once."""

    settings: Settings
    priors: tuple[MaterialPrior, ...]
    traced: TracedPaths
    fits: BandFits
    pairs: tuple[ComparedPair, ...]  # measured against predicted
    by_pressures: BoolArray  # (n_bands,), where these follow from pressures of image sources
    absorption: FloatArray  # (n_materials, n_bands)
    lower95: FloatArray  # (n_materials, n_bands)
    upper95: FloatArray  # (n_materials, n_bands)
    logit_covariance: FloatArray  # (n_bands, n_materials, n_materials), 0 where fixed
    eyring: FloatArray  # (n_bands,), mean absorption by Eyring's formula from the measured decay

    @property
    def materials(self) -> tuple[str, ...]:
        """The names of the room's materials."""
        return self.measured.scene.room.materials


def file_name(m: Measurement) -> str:
    """Return a recording in words: its pair and its file."""
    return f"{m.source} to {m.receiver} ({m.name})"


# Of log-likelihood, unknowns counted: explanations that are no farther apart are both named.
UNDECIDED = 2.0


def pair_of(m: Measurement) -> tuple[str, str]:
    """Return the source and the receiver of a recording, as findings name them."""
    return m.source, m.receiver
