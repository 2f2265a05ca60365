"""How the sources of a prediction radiate, where the campaign leaves that to a fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roomfit.bands import Bands
from roomfit.files.campaign.campaign import Campaign
from roomfit.files.campaign.directivity import unknown_directivity
from roomfit.findings import Finding
from roomfit.response.directivity import FirstOrderBands
from roomfit.uncertainty.posterior import AbsorptionPosterior


def directed_as_found(
    campaign: Campaign, bands: Bands, absorption: AbsorptionPosterior
) -> tuple[Campaign, tuple[Finding, ...]]:
    """Return the campaign with unknown directivities as the fit of the absorption found them.

    Where that fit knew none, as told before it; or omnidirectional, with a finding.

    Parameters
    ----------
    bands : Bands
        Those to be predicted, all among the absorption's.
    """
    at = [int(np.flatnonzero(absorption.bands.centres_hz == f)[0]) for f in bands.centres_hz]
    found = absorption.directivities or {}
    known, untold = dict(campaign.directivities), []
    for name in campaign.directivities:
        asked = unknown_directivity(campaign, name)
        if asked is None:
            continue
        if name in found:
            known[name] = FirstOrderBands(found[name][at])
        elif asked.mean is not None:
            known[name] = FirstOrderBands(np.tile(asked.mean, (len(bands), 1)))
        else:
            known[name] = "omni"
            untold.append(name)
    return replace(campaign, directivities=known), _findings(untold)


def _findings(untold: list[str]) -> tuple[Finding, ...]:
    if not untold:
        return ()
    return (
        Finding(
            "directivity-not-known",
            "warning",
            f"The directivity of {', '.join(untold)} was to be fitted, and the absorption comes "
            "without it: predicted as omnidirectional.",
            {"sources": untold},
        ),
    )
