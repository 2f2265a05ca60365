"""Whether an absorption that is fixed can be true."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.special import chdtri

from roomfit.base.bands import bands_in_words
from roomfit.base.findings import About, Code, Finding
from roomfit.checks.evidence import Evidence, Law
from roomfit.checks.linearity import explained_by_the_chain
from roomfit.materials.priors import object_area_m2

# Log-likelihood that one more unknown must gain in some band, and the chance of all bands together:
# errors of the model that windows share gained 8 and 9 in two bands of 2 in 36 right rooms.
_LEAST_GAIN, _CHANCE = 2.0, 1e-5

LAWS = {
    Code.FIXED_ABSORPTION_CONTRADICTED: Law(
        "a fixed absorption is the true one",
        "score test of one absorption a band: twice the gains summed, chi-square",
        _CHANCE,  # of one material
    )
}


def check(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding for each material whose fixed absorption the data contradict.

    It is freed once, to first order: where the log-likelihood of some band gains 2 and more, and
    that of all bands together more than happens by chance once in 100,000 materials.
    """
    bands = evidence.measured.bands
    for freed in evidence.fits.tests.freed_absorptions:
        prior, gains = evidence.priors[freed.material], freed.gains
        known, clear = prior.known, [b for b, gain in gains.items() if gain >= _LEAST_GAIN]
        total = sum(gains.values())
        if known is None or not clear or 2.0 * total <= float(chdtri(len(gains), _CHANCE)):
            continue
        is_directed = bool(evidence.fits.directivities)
        if explained_by_the_chain(evidence.fits.tests.chain, freed, is_directed=is_directed):
            continue
        fixed, likelier = (np.array([x[b] for b in clear]) for x in (known, freed.absorption))
        what, unit = "absorption", ""
        if prior.object_volume_m3 is not None:
            what, unit = "absorption area", " m2"
            fixed, likelier = (object_area_m2(x, prior.object_volume_m3) for x in (fixed, likelier))
        each = zip(fixed, likelier, strict=True)
        notes = [f"{x:.2f} fixed, about {y:.2f}{unit} likelier" for x, y in each]
        yield Finding(
            Code.FIXED_ABSORPTION_CONTRADICTED,
            About(materials=[prior.name], bands_hz=bands.centres_hz[clear].tolist()),
            f"The data contradict the {what} that the campaign fixes for {prior.name}: "
            f"{bands_in_words(bands, clear, notes)}; freed, the log-likelihood rises by "
            f"{total:.0f}. All others compensate for it: none is called "
            "identifiable. State a prior in its place.",
            {
                "material": prior.name,
                "bands_hz": bands.centres_hz[clear].tolist(),
                "log_likelihood_gain": [round(gains[b], 2) for b in clear],
                "about": likelier.round(3).tolist(),
            },
        )
