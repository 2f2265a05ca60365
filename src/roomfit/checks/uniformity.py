"""Whether surfaces absorb alike over their area, as a single absorption says."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from roomfit.base.findings import About, Code, Finding
from roomfit.checks.evidence import UNDECIDED, Evidence, Law
from roomfit.checks.linearity import clearest_fault
from roomfit.fit.fits import SurfaceScore

# By chance alone. What the model lacks is uneven as well: at 1e-3 two of 105 right rooms were
# named, of rays that lose energy and of an undescribed loudspeaker (e^10, e^18).
_LEVEL = 1e-8

LAWS = {
    Code.ABSORPTION_NOT_UNIFORM: Law(
        "every surface returns the same share of the sound at all of its places",
        "Bayes factor of a surface that varies, mean over all surfaces: by Markov's inequality "
        "above 1e8 in fewer than one room in 1e8, where the model lacks nothing",
        _LEVEL,
    )
}


def check(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding for the surface that absorbs otherwise at some places than at others.

    A Bayes factor has the mean 1 under the model in its denominator, and so has the mean of
    several: it exceeds 1e8 with a probability below 1e-8 (A. Wald, Sequential Analysis, 1947,
    section 3.2). Surfaces whose evidence is within 2 units of the best are named beside it.

    Where directivities were fitted, what is left of those that are not of first order changes with
    the place of a reflection as well (of third order, by a factor of e^13), and nothing is asked.
    """
    scores = () if evidence.fits.directivities else evidence.fits.surfaces
    best = most_uneven(scores)
    if best is None or _otherwise(evidence) - best.evidence > UNDECIDED:
        return
    others = [s for s in scores if s is not best and best.evidence - s.evidence < UNDECIDED]
    each = " Or: ".join(_in_words(s, evidence) for s in (best, *others))
    names = [evidence.materials[s.material] for s in (best, *others)]
    bands_hz = evidence.measured.bands.centres_hz[list(best.bands)].tolist()
    points = [s.cells_m[i] for s in (best, *others) for i in _extremes(s)[1:]]
    yield Finding(
        Code.ABSORPTION_NOT_UNIFORM,
        About(
            materials=list(dict.fromkeys(names)),
            bands_hz=bands_hz,
            points_m=[(float(x), float(y), float(z)) for x, y, z in points],
        ),
        f"{each} A part of it is of another material, stands open or is covered, or it is unlike "
        "other surfaces of its material. Its absorption is called identifiable nowhere: describe "
        "the parts as materials of their own.",
        {
            "surfaces": [s.name for s in (best, *others)],
            "log_bayes_factor": [round(s.evidence, 1) for s in (best, *others)],
            "bands_hz": bands_hz,
        },
    )


def most_uneven(scores: Sequence[SurfaceScore]) -> SurfaceScore | None:
    """Return the surface of the largest evidence; None where all may be chance."""
    if not scores:
        return None
    found = np.array([s.evidence for s in scores])
    mean = float(np.logaddexp.reduce(found) - np.log(found.size))
    return scores[int(np.argmax(found))] if mean > -np.log(_LEVEL) else None


def _otherwise(evidence: Evidence) -> float:
    """Return the largest gain in log-likelihood of a bent chain or a freed absorption.

    Less one for each of their unknowns; both leave some places too loud.
    """
    tests = evidence.fits.tests
    gains = [sum(f.gains.values()) - len(f.gains) for f in tests.freed_absorptions]
    if tests.chain is not None:
        clearest = clearest_fault(tests.chain, is_directed=False)
        gains += [] if clearest is None else [tests.chain.alone[clearest].gain - 1.0]
    return max(gains, default=-np.inf)


def _extremes(score: SurfaceScore) -> tuple[int, int, int]:
    """Return the band in which cells differ most, and its cells that return least and most."""
    band = int(np.argmax(np.ptp(score.returned, axis=1)))
    row = score.returned[band]
    return band, int(np.argmin(row)), int(np.argmax(row))


def _in_words(score: SurfaceScore, evidence: Evidence) -> str:
    material = evidence.materials[score.material]
    name = score.name if score.name == material else f"{score.name} ({material})"
    row, least, most = _extremes(score)
    band = score.bands[row]
    kept = 1.0 - float(evidence.absorption[score.material, band])
    low, high = (
        float(np.clip(1.0 - kept * np.exp(score.returned[row, i]), 0.0, 1.0)) for i in (most, least)
    )
    at = [", ".join(f"{x:.1f}" for x in score.cells_m[i]) for i in (most, least)]
    return (
        f"Reflections from {name} are not those of one absorption: at "
        f"{evidence.measured.bands.centres_hz[band]:g} Hz as of about {low:.2f} near ({at[0]}) m "
        f"and about {high:.2f} near ({at[1]}) m, which is more likely by a factor of "
        f"e^{score.evidence:.0f}."
    )
