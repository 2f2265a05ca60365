"""Whether the measurement chain was linear, and left the decay of early sound alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.special import chdtri, stdtrit

from roomfit.base.findings import About, Code, Finding
from roomfit.checks.evidence import UNDECIDED, Evidence, Law
from roomfit.pressures.score_tests import ChainScores, FreedAbsorption, Score

_LEVEL = 1e-3  # of power, loss and window together
# An exponent nearer to 1, a smaller loss at the peak, and a decay rate that is a smaller share of
# the room's own, do less to absorption than intervals allow for.
_LEAST_EXPONENT, _LEAST_LOSS, _LEAST_RATE = 0.04, 0.05, 0.05

LAWS = {
    Code.LEVELS_NOT_LINEAR: Law(
        "the chain is linear: exponent 1, no loss at the peak",
        "score of one value common to all bands, over the standard deviation that it has by the "
        "data, by errors of the model that bands share and by their scatter: Student's t",
        _LEVEL,
    ),
    Code.DECAY_BENT: Law(
        "no window was applied: its rate is 0",
        "score of one value common to all bands, over the standard deviation that it has by the "
        "data, by errors of the model that bands share and by their scatter: Student's t",
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
    is_directed = bool(evidence.fits.directivities)
    clearest = clearest_fault(scores, is_directed=is_directed)
    if clearest is None or _explained_by_walls(scores, evidence.fits.tests.freed_absorptions):
        return
    power, loss, window = scores.alone
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
    kind = "a compressor or limiter" if power.value < 0.0 else "an expander or gate"
    said = f"as by the power {1.0 + power.value:.2f} +- {power.sd:.2f} of the pressure"
    if clearest == 1:
        kind = "a limiter or an overdriven input"
        said = f"where they are loud, by {loss.value:.2f} +- {loss.sd:.2f} at the peak"
    text = (
        f"Levels are bent {said}, in all bands and over all distances alike: {kind} is "
        "in the chain, the files were processed, or a source that was taken for "
        "omnidirectional is none. Measure again without it; no material is called "
        "identifiable."
    )
    yield Finding(Code.LEVELS_NOT_LINEAR, about, text, numbers)


def clearest_fault(scores: ChainScores, *, is_directed: bool) -> int | None:
    """Return which of power, loss and window is clearest; None where none is clear and large."""
    sizes = [abs(s.value) / s.sd for s in scores.alone]
    least = (_LEAST_EXPONENT, _LEAST_LOSS, _LEAST_RATE * scores.decay_rate_per_s)
    clear = [
        _is_clear(s) and abs(s.value) > smallest
        for s, smallest in zip(scores.alone, least, strict=True)
    ]
    # nothing saturates by a gain
    clear[1] &= scores.alone[1].value > 0.0
    clear[:2] = [c and not is_directed for c in clear[:2]]
    clearest = int(np.argmax(np.where(clear, sizes, 0.0)))
    return clearest if clear[clearest] else None


def explained_by_the_chain(
    scores: ChainScores | None, freed: FreedAbsorption, *, is_directed: bool
) -> bool:
    """Return whether a fixed absorption is contradicted only for want of a chain that bends.

    Where the chain, fitted beside it, leaves less to be gained than chance does, and where the
    chain with its one unknown gains more than the material with one unknown a band, by 2 units.
    """
    if scores is None or not scores.beside_freed:
        return False
    clearest = clearest_fault(scores, is_directed=is_directed)
    if clearest is None:
        return False
    n, gain = len(freed.gains), sum(freed.gains.values())
    alone, beside = scores.alone[clearest], scores.beside_freed[clearest]
    left = gain + beside.gain - alone.gain
    return 2.0 * left <= float(chdtri(n, _LEVEL)) and alone.gain - 1.0 > gain - n + UNDECIDED


def _is_clear(score: Score) -> bool:
    """Return whether a value is none of chance, one of three that are looked at."""
    return abs(score.value) / score.sd > float(stdtrit(score.n_free, 1.0 - _LEVEL / 6.0))


def _explained_by_walls(scores: ChainScores, freed: Sequence[FreedAbsorption]) -> bool:
    """Return whether fixed absorptions, freed, leave nothing for a chain to explain.

    They are contradicted by themselves then; where they gain less than the chain, or no more than
    2 units of log-likelihood, one off for each unknown, both are named.
    """
    if not scores.beside_freed:
        return False
    clearest = int(np.argmax([s.gain for s in scores.alone]))
    if any(_is_clear(s) for s in scores.beside_freed):
        return False
    by_walls = max((sum(f.gains.values()) - len(f.gains) for f in freed), default=0.0)
    return by_walls > scores.alone[clearest].gain - 1.0 + UNDECIDED
