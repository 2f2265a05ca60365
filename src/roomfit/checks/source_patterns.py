"""Whether sources that are taken for omnidirectional are."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from roomfit.base.findings import About, Code, Finding
from roomfit.checks.evidence import Evidence, Law
from roomfit.room.scene import pair_names

LAWS = {
    code: Law(
        "a source radiates alike in all directions",
        "log-likelihood gained by a first-order directivity, its prior counted, over all bands",
    )
    for code in (Code.SOURCE_NOT_OMNIDIRECTIONAL, Code.SOURCE_PATTERN_FITTED)
}


def check(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding for each source taken for omnidirectional that the data contradict.

    Where its directivity was fitted for that reason, absorption need not compensate for it.
    """
    unknown = evidence.fits.unknown_sources
    fitted = () if unknown is None else unknown.sources
    for own in evidence.fits.contradicted:
        strongest = own.b[int(np.argmax(np.linalg.norm(own.b, axis=1)))]
        towards = ", ".join(f"{x:.1f}" for x in strongest / np.linalg.norm(strongest))
        pairs = [(p, r) for p, r, _ in pair_names(evidence.measured.scene) if p == own.source]
        is_fitted = own.source in fitted
        consequence = (
            'It was fitted together with the absorption, as by directivity = "fit"; specify it '
            "where it is known."
            if is_fitted
            else "Absorption compensates for it, so that no material is called identifiable. "
            'Specify the directivity, or have it fitted: directivity = "fit".'
        )
        yield Finding(
            Code.SOURCE_PATTERN_FITTED if is_fitted else Code.SOURCE_NOT_OMNIDIRECTIONAL,
            About(pairs=tuple(dict.fromkeys(pairs))),
            f"{own.source} was taken for omnidirectional, which the data contradict: a "
            f"first-order directivity that radiates more towards ({towards}) raises the "
            f"log-likelihood by {own.log_likelihood_gain:.0f}. {consequence}",
            {
                "source": own.source,
                "log_likelihood_gain": own.log_likelihood_gain,
                "b": own.b.tolist(),
            },
        )
