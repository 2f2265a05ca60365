"""The means over groups of materials that each band of an answer determines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roomfit.findings import Finding
from roomfit.typing import BoolArray, FloatArray
from roomfit.uncertainty.combinations import WITHIN, Combination, find_combinations


def band_combinations(
    absorption: FloatArray,
    logit_covariance: FloatArray,
    logit_prior: FloatArray,
    areas_m2: FloatArray,
    seed: int,
) -> tuple[tuple[Combination, ...], ...]:
    """Return the combinations of every band, that of the whole room first; see `find_combinations`.

    Parameters
    ----------
    absorption : float array, shape (n_materials, n_bands)
    logit_covariance : float array, shape (n_bands, n_materials, n_materials)
        Of logit absorption between 0 and 1, whatever the bounds of the fit; see
        `roomfit.uncertainty.posterior.plain_logit_covariance`.
    logit_prior : float array, shape (2, n_materials, n_bands)
        Mean and standard deviation of logit absorption beforehand.
    areas_m2 : float array, shape (n_materials,)
    seed : int
    """
    return tuple(
        find_combinations(
            areas_m2,
            absorption[:, band],
            covariance,
            logit_prior[0, :, band],
            logit_prior[1, :, band],
            np.random.default_rng(seed),
        )
        for band, covariance in enumerate(logit_covariance)
    )


def inseparable_findings(
    materials: tuple[str, ...],
    centres_hz: FloatArray,
    identifiable: BoolArray,
    found: Sequence[tuple[Combination, ...]],
) -> tuple[Finding, ...]:
    """Return a finding where no material is identifiable by itself but the room's mean is known.

    Parameters
    ----------
    materials : tuple of str
    centres_hz : float array, shape (n_bands,)
    identifiable : bool array, shape (n_materials, n_bands)
    found : sequence of tuple of Combination
        From `band_combinations`.
    """
    bands = [
        band
        for band, group in enumerate(found)
        if not identifiable[:, band].any() and group[0].relative <= WITHIN
    ]
    if not bands or len(materials) < 2:
        return ()
    told = ", ".join(f"{centres_hz[b]:g} Hz ({100 * found[b][0].relative:.0f} %)" for b in bands)
    return (
        Finding(
            "materials-not-separable",
            "warning",
            f"The data do not tell the {len(materials)} materials apart, only their mean "
            f"absorption by area, with its 95 % interval to either side, at {told}.",
            {"bands_hz": [float(centres_hz[b]) for b in bands], "materials": list(materials)},
        ),
    )
