"""Whether the measurement chain was linear, and left the decay of early sound alone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from roomfit.diagnostics.evidence import Evidence, Law
from roomfit.findings import About, Code, Finding
from roomfit.inversion.score_tests import ChainScores

# In standard deviations; a right room exceeds 4 by chance once in 16,000, and clean rooms of
# another program and measured ones less than 3: docs/how-far-to-trust.md.
_FEWEST_SDS = 4.0
# An exponent nearer to 1, a smaller loss at the peak, and a decay rate that is a smaller share of
# the room's own, do less to absorption than intervals allow for.
_LEAST_EXPONENT, _LEAST_LOSS, _LEAST_RATE = 0.04, 0.05, 0.05

_LEVEL = 6e-5  # of 4 standard deviations to either side
LAWS = {
    Code.LEVELS_NOT_LINEAR: Law(
        "the chain is linear: exponent 1, no loss at the peak",
        "score of one value common to all bands, over its standard deviation",
        _LEVEL,
    ),
    Code.DECAY_BENT: Law(
        "no window was applied: its rate is 0",
        "score of one value common to all bands, over its standard deviation",
        _LEVEL,
    ),
}


def check(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding where levels were bent by a power or saturated, or the decay by a window.

    They look alike in a decay, but not over the distances of direct sound and reflections; the
    one that is clearest is named. One value is common to all bands.

    Where directivities were fitted, what is left of those that are not of first order bends levels
    as a chain does (of one measured room by the power 1.22), and no power or loss is asked for.
    """
    scores = evidence.fits.tests.chain
    if scores is None:
        return
    about = About(bands_hz=evidence.measured.bands.centres_hz[list(scores.bands)].tolist())
    clearest = clearest_fault(scores, is_directed=bool(evidence.fits.directivities))
    if clearest is None:
        return
    power, loss, window = scores.power, scores.loss, scores.window
    numbers = {
        "exponent": round(1.0 + power.value, 4),
        "exponent_sd": round(power.sd, 4),
        "loss_at_peak": round(loss.value, 4),
        "loss_at_peak_sd": round(loss.sd, 4),
        "rate_per_s": round(window.value, 3),
        "rate_sd_per_s": round(window.sd, 3),
        "bands_hz": list(about.bands_hz),
    }
    if clearest == 2:
        way = "fast" if window.value > 0.0 else "slowly"
        text = (
            f"The sound decays too {way} for its early reflections, by "
            f"{window.value:.1f} +- {window.sd:.1f} of energy per second alike in all bands "
            f"(the room's own: {scores.decay_rate_per_s:.0f}): an exponential window was left in "
            "the files, or something absorbs that is not described. No material is called "
            "identifiable."
        )
        yield Finding(Code.DECAY_BENT, about, text, numbers)
        return
    kind = "compressor or limiter" if power.value < 0.0 else "expander or gate"
    said = f"as by the power {1.0 + power.value:.2f} +- {power.sd:.2f} of the pressure"
    if clearest == 1:
        kind = "limiter or an overdriven input"
        said = f"where they are loud, by {loss.value:.2f} +- {loss.sd:.2f} at the peak"
    text = (
        f"Levels are bent {said}, in all bands and over all distances alike: a {kind} is "
        "in the chain, the files were processed, or a source that was taken for "
        "omnidirectional is none. Measure again without it; no material is called "
        "identifiable."
    )
    yield Finding(Code.LEVELS_NOT_LINEAR, about, text, numbers)


def clearest_fault(scores: ChainScores, *, is_directed: bool) -> int | None:
    """Return which of power, loss and window is clearest; None where none is clear and large."""
    three = (scores.power, scores.loss, scores.window)
    sizes = [abs(s.value) / s.sd for s in three]
    least = (_LEAST_EXPONENT, _LEAST_LOSS, _LEAST_RATE * scores.decay_rate_per_s)
    clear = [
        size > _FEWEST_SDS and abs(s.value) > smallest
        for s, size, smallest in zip(three, sizes, least, strict=True)
    ]
    # nothing saturates by a gain
    clear[1] &= scores.loss.value > 0.0
    clear[:2] = [c and not is_directed for c in clear[:2]]
    clearest = int(np.argmax(np.where(clear, sizes, 0.0)))
    return clearest if clear[clearest] else None
