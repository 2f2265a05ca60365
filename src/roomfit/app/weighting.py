"""What paths weigh in each band: how walls scatter there, and how sources radiate."""

from __future__ import annotations

import numpy as np

from roomfit.bands import Bands
from roomfit.files.campaign.campaign import Campaign
from roomfit.files.campaign.directivity import campaign_directivities
from roomfit.findings import Finding
from roomfit.materials.knowledge import MaterialKnowledge
from roomfit.materials.scattering import Scattering
from roomfit.response.directivity import directivity_factors
from roomfit.response.scattering import (
    LEAST_SAMPLE_SHARE,
    effective_sample_size,
    scattering_weights,
)
from roomfit.scene.scene import Scene
from roomfit.tracing.paths import Paths
from roomfit.typing import FloatArray


def told_scattering(
    knowledge: tuple[MaterialKnowledge, ...], traced: FloatArray, n_bands: int
) -> FloatArray:
    """Return what each wall scatters in each band; where nothing is told, as it was traced."""
    rows = [
        np.full(n_bands, s0) if k.scattering is None else k.scattering
        for k, s0 in zip(knowledge, traced, strict=True)
    ]
    return np.stack(rows)


def band_factors(
    campaign: Campaign, scene: Scene, bands: Bands, paths: Paths, scattering: FloatArray
) -> tuple[FloatArray | None, tuple[Finding, ...]]:
    """Return the factor of every path in every band, shape (n_bands, n_paths).

    None where all are 1: walls scatter in every band as they did in the trace, and all sources
    are omnidirectional.

    Parameters
    ----------
    scattering : float array, shape (n_materials, n_bands)

    Raises
    ------
    InputError
        A directivity cannot be read, or a wall was traced smooth and is to scatter.
    """
    factors: FloatArray = np.ones((len(bands), len(paths)))
    findings: tuple[Finding, ...] = ()
    differs = np.any(scattering != paths.sampling_scattering[:, None])
    if differs:
        for band in range(len(bands)):
            wanted = Scattering(paths.materials, scattering[:, band])
            factors[band] = scattering_weights(paths, wanted)
        findings = _worn_findings(bands, paths, factors)
    sources = campaign_directivities(campaign, scene, bands)
    if any(s is not None for s in sources):
        for band in range(len(bands)):
            factors[band] *= directivity_factors(paths, sources, scene.pairs[:, 0].tolist(), band)
    elif not differs:
        return None, ()
    return factors, findings


def _worn_findings(bands: Bands, paths: Paths, factors: FloatArray) -> tuple[Finding, ...]:
    """Return a finding for bands in which few rays carry nearly all of the weight."""
    rays = paths.batch >= 0
    n = int(np.count_nonzero(rays))
    if n == 0:
        return ()
    shares = np.array([effective_sample_size(row[rays]) / n for row in factors])
    worn = np.flatnonzero(shares < LEAST_SAMPLE_SHARE)
    if not worn.size:
        return ()
    told = ", ".join(f"{bands.centres_hz[j]:g} Hz ({100 * shares[j]:.0f} %)" for j in worn)
    return (
        Finding(
            "scattering-far-from-traced",
            "warning",
            f"Scattering differs so much from its mean over the bands that few rays carry the "
            f"energy at {told} of them: predictions are noisy there. Fit these bands by "
            "themselves.",
            {"bands_hz": [float(bands.centres_hz[j]) for j in worn]},
        ),
    )
