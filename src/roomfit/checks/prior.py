"""Whether an answer is that of the data or that of the prior, and which priors were assumed."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from roomfit.base.bands import bands_in_words
from roomfit.base.findings import About, Code, Finding
from roomfit.checks.evidence import Evidence, Law
from roomfit.materials.catalogue import broad_prior_findings, product_findings
from roomfit.materials.priors import are_specified, prior_logits

# Of the prior's standard deviation: an answer that keeps more of it comes from the prior.
_PRIOR_DOMINATED = 0.9

LAWS = {
    Code.PRIOR_DOMINATED: Law(
        "the data determine a material better than its specified prior",
        "standard deviation of logit absorption over that of its prior, above 0.9",
    )
}


def check(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding for each material whose answer is nearly the prior that was specified.

    Under the default prior an answer that the data do not determine has a wide interval, which
    needs no finding; a specified prior makes it narrow.
    """
    bands, priors, answers = evidence.measured.bands, evidence.priors, evidence.fits.answers
    specified, sds = are_specified(priors), prior_logits(priors)[1]
    for i, own in enumerate(priors):
        if own.known is not None or own.tied_to is not None or not specified[i]:
            continue
        left = np.array([np.sqrt(a.logit_covariance[i, i]) for a in answers]) / sds[i]
        fitted = np.array([a.model != "prior" for a in answers])
        bad = np.flatnonzero(fitted & (left > _PRIOR_DOMINATED))
        if not bad.size:
            continue
        shares = [f"{100 * min(left[j], 1.0):.0f} %" for j in bad]
        yield Finding(
            Code.PRIOR_DOMINATED,
            About(materials=[own.name], bands_hz=bands.centres_hz[bad].tolist()),
            f"The absorption of {own.name} is nearly its prior, of whose standard deviation so "
            f"much is left: {bands_in_words(bands, bad, shares)}. The data add next to "
            "nothing; measure pairs whose sound strikes it more often.",
            {
                "material": own.name,
                "bands_hz": bands.centres_hz[bad].tolist(),
                "spread_left": [round(float(left[j]), 3) for j in bad],
            },
        )


def check_assumed(evidence: Evidence) -> Iterator[Finding]:
    """Yield what was assumed of materials: the broad prior, and that products are alike."""
    yield from broad_prior_findings(evidence.priors)
    yield from product_findings(evidence.priors)
