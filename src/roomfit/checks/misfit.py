"""Whether the model explains the data within their noise, in a band and in most of them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from roomfit.base.bands import bands_in_words
from roomfit.base.findings import About, Code, Finding
from roomfit.checks.evidence import Evidence, Law
from roomfit.uncertainty.gaussian import LARGEST_CHI2_REDUCED

_FEWEST_BANDS, _LARGEST_MEDIAN_CHI2 = 2, 1.5

_NULL = "residuals scatter as the noise model says"
LAWS = {
    Code.MODEL_DOES_NOT_FIT: Law(_NULL, "reduced chi-square of a band, above 2"),
    Code.MODEL_MISFIT_ALL_BANDS: Law(
        _NULL, "median over bands of the reduced chi-square; of two bands the smaller, above 1.5"
    ),
}


def check_bands(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding for the bands that the model misfits."""
    bands, answers = evidence.measured.bands, evidence.fits.answers
    bad = [j for j, a in enumerate(answers) if a.chi2_reduced > LARGEST_CHI2_REDUCED]
    if bad:
        values = [f"{answers[j].chi2_reduced:.1f}" for j in bad]
        yield Finding(
            Code.MODEL_DOES_NOT_FIT,
            About(bands_hz=bands.centres_hz[bad].tolist()),
            "The model does not explain the data within their noise; the reduced chi-square is "
            f"{bands_in_words(bands, bad, values)}. No material is called identifiable there, "
            "and intervals are widened by the misfit.",
            {"bands_hz": bands.centres_hz[bad].tolist()},
        )


def check(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding where the model misfits most bands.

    One band that fits badly may have its own reason. Where the median of the reduced chi-square
    over the bands is high, a fault is in what all of them share, the description of the room, and a
    band whose own value happens to be low is not to be trusted either. In simulated rooms that were
    described correctly the median was 0.3 to 0.8, with a curtain or an open door forgotten 2.0,
    with directional loudspeakers taken for omnidirectional 1.2 to 1.6.

    Of two bands both must exceed what the median of three says of two at least: the mean of both
    would be high for the reasons of one.

    Bands of room parameters alone, and those without data, are left out.
    """
    chi2_of_bands = [
        a.chi2_reduced for a in evidence.fits.answers if a.model in ("coherent", "energy")
    ]
    if len(chi2_of_bands) < _FEWEST_BANDS:
        return
    n = len(chi2_of_bands)
    median = float(np.median(chi2_of_bands) if n > 2 else min(chi2_of_bands))
    if not median > _LARGEST_MEDIAN_CHI2:
        return
    most = (
        f"In most bands the model does not explain the data within their noise (median of the "
        f"reduced chi-square {median:.1f})"
        if n > 2
        else "In both bands the model does not explain the data within their noise (reduced "
        f"chi-square {median:.1f} or more)"
    )
    yield Finding(
        Code.MODEL_MISFIT_ALL_BANDS,
        About(),
        f"{most}: the description of the room is wrong in a "
        "material, an opening, scattering, a source or a position. Intervals are too narrow, "
        "and no material is called identifiable.",
        {"median_phi": median},
    )
