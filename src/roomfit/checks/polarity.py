"""Whether recordings of one source have one polarity."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import FloatArray
from roomfit.checks.arrivals import files_in_words
from roomfit.checks.evidence import Law, Recorded, pair_of
from roomfit.signals.measurement import MeasuredPair, Measurement
from roomfit.signals.response import find_onset, times_s

_FEWEST = 3
_DIRECT_S, _BEFORE_S = 1.5e-3, 0.3e-3
_LIKENESS = 0.6  # of two direct sounds, whose sign it decides

LAWS = {
    Code.POLARITY_DIFFERS: Law(
        "recordings of one source have one polarity",
        "the sign of the largest correlation of direct sounds, where that exceeds 0.6",
    )
}


def check(evidence: Recorded) -> Iterator[Finding]:
    """Yield a finding where some recordings have the opposite polarity of the others.

    By the sign of the largest correlation of direct sounds of one source. Fits by energies, and by
    pressures whose sign is free, are not affected; a cable or a channel is other than supposed.
    """
    measured = evidence.measured.responses
    by_source: dict[str, list[MeasuredPair]] = {}
    for m in measured:
        by_source.setdefault(m.measurement.source, []).append(m)
    inverted: list[Measurement] = []
    for group in by_source.values():
        sounds = [direct_sound(m) for m in group]
        strongest = int(np.argmax([float(np.max(np.abs(s), initial=0.0)) for s in sounds]))
        signs = np.array([_sign(s, sounds[strongest]) for s in sounds])
        if np.count_nonzero(signs) >= _FEWEST:
            odd = 1 if np.sum(signs) < 0 else -1
            minority = [m.measurement for m, s in zip(group, signs, strict=True) if s == odd]
            inverted += minority if 2 * len(minority) < np.count_nonzero(signs) else []
    if not inverted:
        return
    who = files_in_words(inverted, len(measured))
    text = (
        f"{who[0].upper()}{who[1:]} have the opposite polarity of the others of their source: a "
        "cable, a channel or a microphone differs. The fit does not depend on it."
    )
    about = About(files=[m.where for m in inverted], pairs=[pair_of(m) for m in inverted])
    yield Finding(Code.POLARITY_DIFFERS, about, text, {"files": [m.where for m in inverted]})


def _sign(sound: FloatArray, reference: FloatArray) -> int:
    """Return the sign of the largest correlation, 0 where the two are not alike."""
    norm = float(np.linalg.norm(sound) * np.linalg.norm(reference))
    if norm == 0.0:
        return 0
    likeness = np.correlate(sound, reference, mode="full") / norm
    best = float(likeness[int(np.argmax(np.abs(likeness)))])
    return 0 if abs(best) < _LIKENESS else int(np.sign(best))


def direct_sound(m: MeasuredPair) -> FloatArray:
    """Return the samples about the onset, as measured."""
    onset_s = find_onset(m.response, m.measurement.where)
    since_s = times_s(m.response) - onset_s
    chosen = (since_s >= -_BEFORE_S) & (since_s <= _DIRECT_S)
    return np.asarray(m.response.pressure[chosen])
