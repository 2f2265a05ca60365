"""What was known beforehand beside what the data say."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roomfit.app.fitting import BandAnswer
from roomfit.bands import Bands
from roomfit.findings import Finding
from roomfit.materials.knowledge import MaterialKnowledge, unknown_material
from roomfit.typing import FloatArray

_Z95 = 1.959963984540054
# Of the prior's standard deviation: what leaves more of it comes from the prior.
NEARLY_THE_PRIOR = 0.9


def prior_intervals(knowledge: tuple[MaterialKnowledge, ...]) -> FloatArray:
    """Return absorption as it was known beforehand with its 95 % interval.

    Returns
    -------
    float array, shape (3, n_materials, n_bands)
        Median, lower and upper bound; of what is held fixed three times its value. What is tied to
        another material has that one's.
    """
    by_name = {k.name: k for k in knowledge}
    rows = []
    for told in knowledge:
        own = by_name[told.tied_to or told.name]
        if own.known is not None:
            rows.append(np.tile(own.known, (3, 1)))
            continue
        free = own.prior_logit_mean + np.outer((0.0, -_Z95, _Z95), own.prior_logit_sd)
        rows.append(own.lower + (own.upper - own.lower) * 0.5 * (1.0 + np.tanh(0.5 * free)))
    return np.stack(rows, axis=1)


def prior_findings(
    bands: Bands, knowledge: tuple[MaterialKnowledge, ...], answers: Sequence[BandAnswer]
) -> tuple[Finding, ...]:
    """Return a finding for each material whose answer is nearly the prior that was given for it.

    Where nothing was given, an answer that the data do not tell is wide and says so by itself; a
    prior makes it narrow.
    """
    findings = []
    for i, own in enumerate(knowledge):
        if own.known is not None or own.tied_to is not None:
            continue
        plain = unknown_material(own.name, len(bands))
        given = (own.prior_logit_mean != plain.prior_logit_mean) | (
            own.prior_logit_sd != plain.prior_logit_sd
        )
        left = np.array([np.sqrt(a.logit_covariance[i, i]) for a in answers]) / own.prior_logit_sd
        fitted = np.array([a.model != "prior" for a in answers])
        bad = np.flatnonzero(given & fitted & (left > NEARLY_THE_PRIOR))
        if not bad.size:
            continue
        told = ", ".join(
            f"{bands.centres_hz[j]:g} Hz ({100 * min(left[j], 1.0):.0f} %)" for j in bad
        )
        findings.append(
            Finding(
                "only-the-prior",
                "warning",
                f"What is told of {own.name} is nearly the prior that was given for it, with so "
                f"much of its spread left: {told}. The data add next to nothing.",
                {
                    "material": own.name,
                    "bands_hz": [float(bands.centres_hz[j]) for j in bad],
                    "spread_left": [round(float(left[j]), 3) for j in bad],
                },
            )
        )
    return tuple(findings)
