"""Which recording can be used in which band, and why not: what is known before any fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from roomfit.base.bands import Bands
from roomfit.base.errors import InputError
from roomfit.base.findings import Code, Finding
from roomfit.base.table import Shown
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.checks import room
from roomfit.checks.arrivals import arrival_findings
from roomfit.checks.evidence import Recorded, about_files, files_in_words
from roomfit.checks.examine import BEFORE_THE_FIT, examine, recorded
from roomfit.fit.measurements import measured_scene, median_decay_s
from roomfit.model.eyring import schroeder_hz
from roomfit.model.patterns import Directivities
from roomfit.room.mesh import volume_m3
from roomfit.room.scene import Scene
from roomfit.settings import DECAY_RANGE_DB
from roomfit.signals.decay import ParameterName, evaluated_line
from roomfit.signals.iso3382 import MeasuredValues
from roomfit.signals.measurement import MeasuredPair, Measurement
from roomfit.signals.response import find_onset


@dataclass(frozen=True, slots=True, eq=False)
class CheckedRecordings(Shown):
    """Recordings by pair and band before a fit.

    Rows of arrays are recordings in their order; those that a fit refuses have NaN throughout.
    """

    described_in: ClassVar[str] = "check"
    drawn: ClassVar[str] = "recordings"
    measurements: tuple[Measurement, ...]
    pairs: tuple[MeasuredPair | None, ...]  # what is known of each; None: a fit refuses it
    bands: Bands
    decay_s: FloatArray  # (n_bands,), median reverberation time; NaN where none is known
    schroeder_hz: FloatArray  # (n_bands,)
    findings: tuple[Finding, ...]

    def _rows(self, of: Callable[[MeasuredPair], ArrayLike]) -> FloatArray:
        shape = len(self.pairs), len(self.bands)
        rows = [np.broadcast_to(np.nan if p is None else of(p), shape[1:]) for p in self.pairs]
        return np.array(rows, dtype=np.float64).reshape(shape)

    @property
    def onset_s(self) -> FloatArray:
        """Arrival of the direct sound after emission by the file's own clock, shape (n,)."""
        return self._rows(lambda p: find_onset(p.response, p.measurement.where))[:, 0]

    @property
    def travel_s(self) -> FloatArray:
        """The same by the geometry, shape (n,)."""
        return self._rows(lambda p: p.direct_s)[:, 0]

    @property
    def peak_to_noise_db(self) -> FloatArray:
        """Peak over noise, shape (n, n_bands)."""
        return self._rows(lambda p: p.noise.peak_to_noise_db)

    @property
    def decay_range_db(self) -> FloatArray:
        """Range in which the decay curve is reliable, shape (n, n_bands)."""
        return self._rows(lambda p: p.curve.usable_db)

    @property
    def usable(self) -> BoolArray:
        """Whether a decay rises above the noise, shape (n, n_bands)."""
        return self._rows(lambda p: p.noise.tail_time_constant_s) > 0.0

    @property
    def has_t20(self) -> BoolArray:
        """Whether it has the range for T20, shape (n, n_bands)."""
        return np.isfinite(self.parameter("T20_s"))

    def parameter(self, name: ParameterName) -> FloatArray:
        """Return a room parameter of every recording, NaN where not valid, shape (n, n_bands)."""
        return self._rows(lambda p: p.parameters.of(name))

    @property
    def curvature_percent(self) -> FloatArray:
        """By how much T30 is longer than T20, of ISO 3382-2:2008, B.3, shape (n, n_bands)."""
        return 100.0 * (self.parameter("T30_s") / self.parameter("T20_s") - 1.0)

    @property
    def nonlinearity_permille(self) -> FloatArray:
        """How bent the curves are that T30, or T20, is read from, shape (n, n_bands)."""

        def of(pair: MeasuredPair) -> list[float]:
            each = range(len(self.bands))
            lines = (evaluated_line(pair.curve, pair.parameters, band) for band in each)
            return [np.nan if line is None else line.nonlinearity_permille for line in lines]

        return self._rows(of)

    @property
    def in_doubt(self) -> bool:
        """Whether nothing would be identifiable, or a recording or a whole band is of no use."""
        used = [self.usable.any(axis=axis).all() for axis in (0, 1) if self.usable.size]
        return not all(used) or any(
            f.code.voids_identifiability or f.code is Code.RECORDING_UNUSABLE for f in self.findings
        )


def check_recordings(
    scene: Scene,
    measurements: Sequence[Measurement | MeasuredValues],
    bands: Bands,
    directivities: Directivities | None = None,
    decay_range_db: float = DECAY_RANGE_DB,
) -> CheckedRecordings:
    """Examine everything that was measured on a scene; nothing is traced and nothing fitted.

    Onsets against the geometry, noise, decay range, clipping, gains, polarity, repeated and
    exchanged files, the Schroeder frequency. A fault that several recordings share is one finding,
    which comes first.

    Parameters
    ----------
    scene : Scene
    measurements : sequence of Measurement or MeasuredValues
    bands : Bands
        Those to be fitted.
    directivities : mapping, optional
        As of `roomfit.identify`.
    decay_range_db : float
        As of `roomfit.Settings`.

    Raises
    ------
    InputError
        Nothing was measured, a name is not in the scene, or a position is impossible. What is
        wrong with single recordings is a finding.

    Examples
    --------
    >>> import roomfit
    >>> scene = roomfit.scene_of(
    ...     roomfit.shoebox_room((6.0, 5.0, 3.0), "plaster"), {"S": (1, 1, 1)}, {"R": (4, 1, 1)}
    ... )
    >>> decay = np.random.default_rng(1).normal(size=24000) * np.exp(-np.arange(24000) / 2400)
    >>> late = roomfit.Measurement("S", "R", np.append(np.zeros(500), decay), 24000)
    >>> checked = check_recordings(scene, [late], roomfit.bands_between("octave", 500, 1000))
    >>> checked.usable.all(), checked.findings[0].sentence.split(": ")[1].split(" ms")[0]
    (np.True_, 'the direct sound arrives 12.10')
    """
    own = measured_scene(scene, measurements)
    given = [m for m in measurements if isinstance(m, Measurement)]
    causes = arrival_findings(own, given)
    values = [m for m in measurements if isinstance(m, MeasuredValues)]
    refused: dict[Measurement, InputError] = {}
    found: Recorded | None = None
    while found is None and len(refused) < len(measurements):
        kept = [m for m in given if m not in refused]
        try:
            found = recorded(scene, [*kept, *values], bands, directivities or {}, decay_range_db)
        except InputError as error:
            faulty = next((m for m in kept if m.where == error.where), None)
            if faulty is None:
                raise
            refused[faulty] = error
    said = " ".join(f.sentence for f in causes)
    findings = [*causes, *_unusable(refused, len(given), said)]
    if found is not None:
        known = {f.code for f in causes}
        findings += [f for f in examine(BEFORE_THE_FIT, found) if f.code not in known]
        findings += room.check_schroeder(found)
    pairs = {} if found is None else {p.measurement: p for p in found.measured.responses}
    decay_s = np.full(len(bands), np.nan)
    if found is not None:
        decay_s = median_decay_s(found.measured, bands.centres_hz)
    pair_of_each = tuple(map(pairs.get, given))
    schroeder = schroeder_hz(decay_s, volume_m3(scene.room.mesh))
    return CheckedRecordings(tuple(given), pair_of_each, bands, decay_s, schroeder, tuple(findings))


def _unusable(refused: dict[Measurement, InputError], n_all: int, said: str) -> list[Finding]:
    """Return a finding for each reason; `said` is the cause of all, which is not repeated."""
    by_reason: dict[str, list[Measurement]] = {}
    for m, error in refused.items():
        by_reason.setdefault(error.what, []).append(m)
    findings = []
    for what, files in by_reason.items():
        error = refused[files[0]]
        hint = "" if error.hint == said else f" Try: {error.hint}."
        text = f"Of {files_in_words(files, n_all)}: {what}: {error.found}.{hint}"
        numbers = {"files": [m.where for m in files]}
        findings.append(Finding(Code.RECORDING_UNUSABLE, about_files(*files), text, numbers))
    return findings
