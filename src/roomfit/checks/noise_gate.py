"""Whether noise was removed by a gate or by a noise reduction."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from roomfit.base.findings import About, Code, Finding
from roomfit.checks.evidence import Evidence, Law, file_name, pair_of
from roomfit.signals.measurement import MeasuredPair

# Runs of equal samples of a gate last so long at least; between them sound is louder than so
# many of the smallest steps.
_GAP_S, _GAP_STEPS, _FEWEST_GAPS = 2e-3, 8.0, 3

LAWS = {
    Code.NOISE_GATED: Law(
        "noise never stops before the file ends",
        "number of runs of equal samples after the peak that are followed by signal, from 3",
    )
}


def check(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding where responses resume after intervals of digital silence, as by a gate.

    A gate, and a noise reduction, leave equal samples wherever the sound falls below a threshold,
    and let it rise out of them again. A file that is padded with zeros has them once; where the
    steps of a converter are coarser than the noise, it never is louder than a few of them between.
    """
    fitted = [m for m in evidence.measured.responses if m.measurement.use == "fit"]
    gated = {m.measurement: n for m in fitted if (n := _gaps(m)) >= _FEWEST_GAPS}
    if not gated:
        return
    gaps = {file_name(m): n for m, n in gated.items()}
    names = ", ".join(list(gaps)[:3]) + (f" and {len(gaps) - 3} more" if len(gaps) > 3 else "")
    yield Finding(
        Code.NOISE_GATED,
        About(files=[m.where for m in gated], pairs=[pair_of(m) for m in gated]),
        f"The response resumes after intervals of digital silence in {names}: a noise gate or "
        "a noise reduction was left in. It shortens the late decay and hides the noise; no "
        "material is called identifiable. Export the files without.",
        {"gaps": gaps},
    )


def _gaps(m: MeasuredPair) -> int:
    """Count runs of equal samples after the peak that are followed by signal."""
    x = m.response.pressure
    steps = np.abs(np.diff(x))
    ends = np.flatnonzero(np.diff(np.concatenate(([0], (steps == 0.0).astype(np.int8), [0]))))
    first, last = ends[::2], ends[1::2]
    long = last - first >= _GAP_S * m.response.sampling_rate_hz
    long &= first > int(np.argmax(np.abs(x)))
    first, last = first[long], last[long]
    coarse = _GAP_STEPS * float(steps[steps > 0.0].min(initial=np.inf))
    return sum(
        float(np.abs(x[a : b + 1] - x[a]).max()) > coarse
        for a, b in zip(last[:-1], first[1:], strict=True)
    )
