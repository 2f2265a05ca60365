"""Which absorptions are identifiable: by the rule for intervals, and by what findings void."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roomfit.base.bands import Bands
from roomfit.base.findings import Finding
from roomfit.base.typing import BoolArray
from roomfit.materials.priors import MaterialPrior


def judge(
    by_rule: BoolArray,
    findings: Sequence[Finding],
    priors: Sequence[MaterialPrior],
    bands: Bands,
) -> BoolArray:
    """Return which absorptions are identifiable.

    Those that the rule calls so (`roomfit.uncertainty.intervals.identifiable_by_rule`) and that no
    finding voids. What the campaign fixes stays.
    """
    identifiable = np.array(by_rule)
    fixed = np.array([[k.known is not None] for k in priors])
    for finding in findings:
        identifiable &= fixed | ~voided(finding, priors, bands)
    return np.asarray(identifiable)


def voided(finding: Finding, priors: Sequence[MaterialPrior], bands: Bands) -> BoolArray:
    """Return which absorptions a finding leaves in doubt, (n_materials, n_bands).

    All of them where it doubts the description of the room, otherwise what it is about.
    """
    code, shape = finding.code, (len(priors), len(bands))
    if code.voids_identifiability:
        return np.ones(shape, dtype=np.bool_)
    if not voids_walls(finding):
        return np.zeros(shape, dtype=np.bool_)
    concerns = finding.about.concerns
    return np.array([[concerns(k.name, f) for f in bands.centres_hz.tolist()] for k in priors])


def voids_walls(finding: Finding) -> bool:
    """Return whether a finding takes identifiability from any wall: from all, or from its own."""
    code = finding.code
    return code.voids_identifiability or (
        code.voids_its_own and finding.severity == code.severities[-1]
    )
