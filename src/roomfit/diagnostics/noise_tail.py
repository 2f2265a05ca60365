"""Whether the background noise is stationary: it falls where a window was left in the files."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import fft

from roomfit.diagnostics.evidence import Evidence, Law
from roomfit.findings import About, Code, Finding
from roomfit.measurement import MeasuredPair
from roomfit.typing import FloatArray

_FEWEST_SDS = 4.0
# Noise is sought in the last two fifths of a file and until 3 ms before the direct sound, above
# 500 Hz; rates of its parts are alike within a quarter.
_TAIL_SHARE, _TAIL_BLOCKS, _TAIL_HZ, _RINGING_S = 0.4, 8, 500.0, 0.05
_EDGE_S, _BEFORE_S, _ALIKE, _FEWEST_FILES = 0.5e-3, 3e-3, 0.25, 3

LAWS = {
    Code.DECAY_BENT: Law(
        "background noise is stationary",
        "its decay rate within the end of the files and from before the direct sound to there: 4 "
        "standard deviations over the files, and alike",
    )
}


def check(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding where the background noise falls, as in files under an exponential window.

    Noise is stationary, unless a window was applied after it was recorded. Above 500 Hz its rate is
    taken twice: within the last two fifths of the files, and from before the direct sound to there.
    A room that still rings makes the first larger and the second smaller, sound before the direct
    sound (deconvolution leaves some) the second larger: only a window makes both the same, and the
    halves of the end as well. Three files at least must begin 4 ms before the direct sound.
    """
    measured = [m for m in evidence.measured.responses if m.measurement.use == "fit"]
    found = [(m, r) for m in measured if (r := _noise_rates(m)) is not None]
    if len(found) < _FEWEST_FILES:
        return
    rates = np.array([r for _, r in found])
    within, first, second, across = rates.mean(axis=0)
    sds = rates.std(axis=0, ddof=1) / np.sqrt(len(rates))
    rings = [1.0 / t for m in measured for t in m.noise.tail_time_constant_s if t > 0.0]
    alike = abs(within - across) < max(_ALIKE * within, 3.0 * float(np.hypot(sds[0], sds[3])))
    straight = abs(first - second) < max(_ALIKE * within, 3.0 * float(np.hypot(sds[1], sds[2])))
    clear = min(within / sds[0], across / sds[3]) > _FEWEST_SDS
    if not (alike and straight and clear and rings and within > 0.01 * float(np.median(rings))):
        return
    yield Finding(
        Code.DECAY_BENT,
        About(files=[m.measurement.where for m, _ in found]),
        f"The background noise falls by {10.0 * within / np.log(10.0):.0f} dB per second "
        "within the files, and as fast from before the direct sound to their end: an "
        f"exponential window of {2.0 / within:.2g} s (pressure) was left in them, by which "
        "every decay is too fast. No material is called identifiable; undo it, or export the "
        "files without.",
        {
            "rate_per_s": round(float(within), 3),
            "rate_sd_per_s": round(float(sds[0]), 3),
            "rate_from_before_per_s": round(float(across), 3),
            "files": len(rates),
        },
    )


def high_passed(x: FloatArray, from_hz: float, rate_hz: float) -> FloatArray:
    """Return a signal through a causal digital Butterworth filter of order 4, which rings after."""
    n = fft.next_fast_len(x.size + round(_RINGING_S * rate_hz), real=True)
    s = 1j * np.tan(np.pi * fft.rfftfreq(n)) / np.tan(np.pi * from_hz / rate_hz)
    poles = np.exp(0.125j * np.pi * np.arange(5, 13, 2))[:, None]
    gain = s**4 / np.prod(1.0 - poles * s, axis=0)
    return np.asarray(fft.irfft(fft.rfft(x, n) * gain, n)[: x.size])


def _noise_rates(m: MeasuredPair) -> tuple[float, float, float, float] | None:
    """Return rates of one file in 1/s: of its end, of this end's halves, and from before the sound.

    None where too little comes before the direct sound, or the file is too short.
    """
    x, rate_hz = m.response.pressure, m.response.sampling_rate_hz
    sounding = np.flatnonzero(x)
    begin, end = int(sounding[0]) + round(_EDGE_S * rate_hz), int(sounding[-1]) + 1
    direct = round((m.direct_s + m.response.time_zero_s) * rate_hz)
    before = slice(begin, direct - round(_BEFORE_S * rate_hz))
    size = round(_TAIL_SHARE * (end - direct)) // _TAIL_BLOCKS
    if before.stop - begin < 1e-3 * rate_hz or size < 2 or rate_hz < 2.5 * _TAIL_HZ:
        return None
    energy = high_passed(x, _TAIL_HZ, rate_hz) ** 2
    blocks = energy[end - _TAIL_BLOCKS * size : end].reshape(_TAIL_BLOCKS, size).mean(axis=1)
    early = float(energy[before].mean())
    if not (early > 0.0 and np.all(blocks > 0.0)):
        return None
    level, half = np.log(blocks), _TAIL_BLOCKS // 2
    time_s = size / rate_hz * np.arange(_TAIL_BLOCKS)
    within, first, second = (
        -float(np.polyfit(time_s[part], level[part], 1)[0])
        for part in (slice(None), slice(half), slice(half, None))
    )
    middle = end - 0.5 * _TAIL_BLOCKS * size - 0.5 * (begin + before.stop)
    return within, first, second, float(np.log(early) - level.mean()) * rate_hz / middle
