"""Which recording can be used in which band, and why not: what is known before any fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

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
from roomfit.signals.decay import PARAMETER_NAMES
from roomfit.signals.iso3382 import MeasuredValues
from roomfit.signals.measurement import Measurement
from roomfit.signals.response import find_onset


@dataclass(frozen=True, slots=True, eq=False)
class CheckedRecordings(Shown):
    """Recordings by pair and band before a fit.

    Rows are recordings in their order; those that a fit refuses have NaN throughout.
    """

    described_in: ClassVar[str] = "check"
    measurements: tuple[Measurement, ...]
    bands: Bands
    onset_s: FloatArray  # (n,), arrival of the direct sound after emission by the file's own clock
    travel_s: FloatArray  # (n,), the same by the geometry
    peak_to_noise_db: FloatArray  # (n, n_bands)
    decay_range_db: FloatArray  # (n, n_bands), in which the decay curve is reliable
    usable: BoolArray  # (n, n_bands), whether a decay rises above the noise
    has_t20: BoolArray  # (n, n_bands), whether it has the range for T20
    decay_s: FloatArray  # (n_bands,), median reverberation time; NaN where none is known
    schroeder_hz: FloatArray  # (n_bands,)
    findings: tuple[Finding, ...]

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
    return _table(own, given, bands, found, tuple(findings))


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


def _table(
    scene: Scene,
    responses: Sequence[Measurement],
    bands: Bands,
    found: Recorded | None,
    findings: tuple[Finding, ...],
) -> CheckedRecordings:
    """Return the table of recordings."""
    pairs = {} if found is None else {p.measurement: p for p in found.measured.responses}
    n, shape = len(responses), (len(responses), len(bands))
    onset_s, travel_s = np.full((2, n), np.nan)
    noise_db, range_db = np.full((2, *shape), np.nan)
    usable, has_t20 = np.zeros((2, *shape), dtype=np.bool_)
    for i, m in enumerate(responses):
        pair = pairs.get(m)
        if pair is not None:
            onset_s[i], travel_s[i] = find_onset(pair.response, m.where), pair.direct_s
            noise_db[i], range_db[i] = pair.noise.peak_to_noise_db, pair.curve.usable_db
            usable[i] = pair.noise.tail_time_constant_s > 0.0
            has_t20[i] = pair.parameters.valid[PARAMETER_NAMES.index("T20_s")]
    decay_s = np.full(len(bands), np.nan)
    if found is not None:
        decay_s = median_decay_s(found.measured, bands.centres_hz)
    of_bands = decay_s, schroeder_hz(decay_s, volume_m3(scene.room.mesh))
    each = onset_s, travel_s, noise_db, range_db, usable, has_t20
    return CheckedRecordings(tuple(responses), bands, *each, *of_bands, findings)
