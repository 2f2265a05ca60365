"""Whether sources that are taken for omnidirectional are."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from roomfit.diagnostics.evidence import Evidence, Law
from roomfit.findings import About, Code, Finding
from roomfit.scene import pair_names

# Larger gains, so much for each band and so much besides, contradict an omnidirectional source: 20
# in six bands, where chance gives 9. With three windows counted as one, all gains and limits 0.45
# times as large, six omnidirectional sources in three boxes of another program
# (benchmarks/other_boxes.py) gained 2 to 4 in all; of six with |b| = 0.5 one gained 4, the others
# 21 to 52.
_GAIN_PER_BAND, _GAIN = 1.1, 13.4

LAWS = {
    Code.SOURCE_NOT_OMNIDIRECTIONAL: Law(
        "a source radiates alike in all directions",
        "log-likelihood gained by a first-order directivity, its prior counted, over all bands",
    )
}


def check(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding for each source taken for omnidirectional that the data contradict."""
    scores, sources = evidence.fits.source_scores, evidence.fits.tested_sources
    if not scores:
        return
    scene = evidence.measured.scene
    least = _GAIN_PER_BAND * len(scores) + _GAIN
    total = np.sum([gain for gain, _ in scores.values()], axis=0)
    for s, name in enumerate(sources):
        if total[s] <= least:
            continue
        b = np.array([scores[band][1][s] for band in sorted(scores)])
        strongest = b[int(np.argmax(np.linalg.norm(b, axis=1)))]
        towards = ", ".join(f"{x:.1f}" for x in strongest / np.linalg.norm(strongest))
        pairs = [(p, r) for p, r, _ in pair_names(scene) if p == name]
        yield Finding(
            Code.SOURCE_NOT_OMNIDIRECTIONAL,
            About(pairs=tuple(dict.fromkeys(pairs))),
            f"{name} was taken for omnidirectional, which the data contradict: a first-order "
            f"directivity that radiates more towards ({towards}) raises the log-likelihood by "
            f"{total[s]:.0f}. Absorption compensates for it, so that no material is called "
            'identifiable. Specify the directivity, or have it fitted: directivity = "fit".',
            {"source": name, "log_likelihood_gain": float(total[s]), "b": b.tolist()},
        )
