"""What checks may look at; what each tests, and at which level, stands in `laws.toml`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from roomfit.base.findings import About, Edit, Finding, Remedy
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.fit.fits import BandFits
from roomfit.fit.measurements import Measurements
from roomfit.fit.paths import TracedPaths
from roomfit.materials.priors import MaterialPrior
from roomfit.result import ComparedPair
from roomfit.settings import Settings
from roomfit.signals.measurement import Measurement

# Of log-likelihood, unknowns counted: explanations that are no farther apart are both named.
UNDECIDED = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """What checks before a fit may look at."""

    measured: Measurements
    arrivals: tuple[Finding, ...]  # why direct sounds do not arrive when they should


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


def about_files(*measurements: Measurement) -> About:
    """Return what concerns recordings and their pairs."""
    return About(
        files=[m.where for m in measurements], pairs=[m.pair_name[:2] for m in measurements]
    )


def of_files(measurements: Sequence[Measurement], key: str, value: Any, **how: Any) -> Remedy:
    """Return that a key of some recordings is to be something; see `Edit`."""
    return Remedy([Edit(("measurements", m.where), key, value, **how) for m in measurements])


def file_name(m: Measurement) -> str:
    """Return a recording in words: its pair and its file."""
    return f"{m.source} to {m.receiver} ({m.name})"


def files_in_words(measurements: Sequence[Measurement], n_all: int) -> str:
    """Return which of so many files, four of them by their names."""
    names = ", ".join(m.name for m in measurements[:4])
    if len(measurements) == n_all:
        return f"all {n_all} files" if n_all > 1 else "the one file"
    more = f" and {len(measurements) - 4} more" if len(measurements) > 4 else ""
    return f"{len(measurements)} of {n_all} files ({names}{more})"
