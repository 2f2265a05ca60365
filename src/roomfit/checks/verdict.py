"""Which absorptions are identifiable, and what findings leave of a result.

By the rule for intervals, and by what findings void; the mean absorption of the room may hold all
the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roomfit.base.bands import Bands
from roomfit.base.findings import Code, Finding
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.checks.decay import DECAY_SCATTER, mean_miss
from roomfit.materials.priors import MaterialPrior
from roomfit.result import Result
from roomfit.uncertainty.gaussian import LARGEST_CHI2_REDUCED

# The recorded decay itself, or the size of the room, is then another: neither the fit nor a
# formula of a diffuse field has a mean to give.
VOID_ANY_MEAN = frozenset({Code.DECAY_BENT, Code.NOISE_GATED, Code.COORDINATES_SCALED})
WIDEST_MEAN = 0.25  # half an interval over the value
_LARGEST_MISS_JND, _MISS_SDS = 2.0, 2.0
_MISS_AT_MOST_JND = 3.0  # however few pairs, and however much they scatter


def judge(
    by_rule: BoolArray,
    findings: Sequence[Finding],
    priors: Sequence[MaterialPrior],
    bands: Bands,
) -> BoolArray:
    """Return which absorptions are identifiable: by the rule, and where no finding voids them.

    What the campaign fixes stays.
    """
    fixed = np.array([[k.known is not None] for k in priors])
    voids = [voided(finding, priors, bands) for finding in findings]
    return np.asarray(by_rule & (fixed | ~np.any([np.zeros_like(by_rule), *voids], axis=0)))


def voided(finding: Finding, priors: Sequence[MaterialPrior], bands: Bands) -> BoolArray:
    """Return which absorptions a finding leaves in doubt, (n_materials, n_bands).

    All of them where it doubts the description of the room, otherwise what it is about.
    """
    if finding.code.voids_identifiability or not voids_walls(finding):
        return np.full((len(priors), len(bands)), finding.code.voids_identifiability)
    concerns = finding.about.concerns
    return np.array([[concerns(k.name, f) for f in bands.centres_hz.tolist()] for k in priors])


def voids_walls(finding: Finding) -> bool:
    """Return whether a finding takes identifiability from any wall: from all, or from its own."""
    code = finding.code
    return code.voids_identifiability or (
        code.voids_its_own and finding.severity == code.severities[-1]
    )


@dataclass(frozen=True, slots=True, eq=False)
class Remaining:
    """What may be used of a result of which findings void walls."""

    voids: tuple[Finding, ...]  # that take all walls away, one a code; none: not all are
    codes: tuple[Code, ...]  # of all findings that take some away, these included
    taken: int  # absorptions that the rule alone calls identifiable, and the findings do not
    wanted: int  # absorptions that were not fixed
    mean_usable: BoolArray  # (n_bands,), whether the mean of the room and its interval hold
    # (n_bands,), predicted over measured less 1, median over pairs, of the decay time that most
    # pairs have; NaN where none is known
    decay_error: FloatArray
    decay_name: str  # of that decay time, as T20_s; "" where none is known


def what_remains(result: Result) -> Remaining:
    """Return what findings leave of a result.

    The mean of the room is usable in a band where no finding doubts the recorded decay or the size
    of the room, the decay of the fitted pairs is reproduced, the reduced chi-square is at most 2,
    and half the interval is at most a quarter of the value. Elsewhere it stands beside Eyring's.
    """
    findings, by_rule = result.findings, result.identifiable_by_rule
    fixed = result.lower95 == result.upper95
    name, error, reproduced = _decays(result)
    mean, lower, upper = result.mean_absorption
    doubts = [f for f in findings if f.code in VOID_ANY_MEAN or f.code is Code.DECAY_NOT_REPRODUCED]
    centres_hz = result.bands.centres_hz.tolist()
    doubted = np.array([any(f.about.in_band(hz) for f in doubts) for hz in centres_hz])
    narrow = upper - lower <= 2.0 * WIDEST_MEAN * mean
    usable = ~doubted & reproduced & narrow & (result.chi2_reduced <= LARGEST_CHI2_REDUCED)
    taken = int((by_rule & ~result.identifiable & ~fixed).sum())
    codes = tuple(dict.fromkeys(f.code for f in findings if voids_walls(f)))
    first = {f.code: f for f in reversed(findings) if f.code.voids_identifiability}
    voids = tuple(first[code] for code in codes if code in first)
    return Remaining(voids, codes, taken, int((~fixed).sum()), usable, error, name)


def _decays(result: Result) -> tuple[str, FloatArray, BoolArray]:
    """Return name and median relative error of the decay time, and where it is reproduced.

    As `roomfit.checks.decay.decay_misses` judges it, but stricter.
    """
    n = len(result.bands)
    width_hz = result.bands.upper_hz - result.bands.lower_hz
    fitted = [p for p in result.pairs if p.use == "fit"] or list(result.pairs)
    name = next((k for k in DECAY_SCATTER if any(k in p.parameters for p in fitted)), "")
    error, reproduced = np.full(n, np.nan), np.zeros(n, dtype=np.bool_)
    rows = [p.parameters[name] for p in fitted if name in p.parameters]
    for band in range(n) if rows else ():
        both = np.array([(c.measured[band], c.predicted[band]) for c in rows])
        measured_s, predicted_s = both[np.isfinite(both).all(axis=1)].T
        if measured_s.size:
            relative = predicted_s / measured_s - 1.0
            scatter = DECAY_SCATTER[name] / np.sqrt(width_hz[band] * measured_s)
            miss, sd = mean_miss(relative / 0.05, scatter)
            tolerated = min(max(_LARGEST_MISS_JND, _MISS_SDS * sd), _MISS_AT_MOST_JND)
            error[band], reproduced[band] = np.median(relative), abs(miss) <= tolerated
    return name, error, reproduced
