"""Doubts that the fits of all bands leave."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roomfit.app.fitting import BandAnswer
from roomfit.bands import Bands
from roomfit.findings import Finding
from roomfit.typing import FloatArray
from roomfit.uncertainty.gaussian import LARGEST_PHI

_FEWEST_BANDS, _LARGEST_MEDIAN_PHI = 3, 1.5


def fit_findings(bands: Bands, answers: Sequence[BandAnswer]) -> tuple[Finding, ...]:
    """Return every doubt that the fits leave."""
    findings = []
    bad = [j for j, a in enumerate(answers) if a.phi > LARGEST_PHI]
    if bad:
        told = ", ".join(f"{bands.centres_hz[j]:g} Hz ({answers[j].phi:.1f})" for j in bad)
        findings.append(
            Finding(
                "model-does-not-fit",
                "warning",
                f"The model does not explain the measurement within its noise at {told}: nothing "
                "is called identifiable there, and intervals are widened by the misfit.",
                {"bands_hz": [float(bands.centres_hz[j]) for j in bad]},
            )
        )
    slow = [j for j, a in enumerate(answers) if not a.converged]
    if slow:
        told = ", ".join(f"{bands.centres_hz[j]:g} Hz" for j in slow)
        findings.append(
            Finding(
                "fit-not-settled",
                "warning",
                f"The fit was still moving by more than a tenth of its interval at {told}.",
                {"bands_hz": [float(bands.centres_hz[j]) for j in slow]},
            )
        )
    return tuple(findings)


def description_findings(answers: Sequence[BandAnswer]) -> tuple[Finding, ...]:
    """Return a finding where most bands are explained worse than their noise allows.

    One band that fits badly may have its own reason. Where the median over the bands is high, a
    fault is in what all of them share, the description of the room, and a band whose phi happens
    to be low is not to be trusted either. In simulated rooms described as they are the median was
    0.3 to 0.8, with a curtain or an open door forgotten 2.0, with loudspeakers of one direction
    taken for omnidirectional 1.2 to 1.6.

    Parameters
    ----------
    answers : sequence of BandAnswer, one a band
        Those of which nothing was heard are left out.
    """
    heard = [a.phi for a in answers if a.model in ("coherent", "energy")]
    if len(heard) < _FEWEST_BANDS or not np.median(heard) > _LARGEST_MEDIAN_PHI:
        return ()
    median = float(np.median(heard))
    return (
        Finding(
            "description-doubtful",
            "serious",
            f"In most bands the model does not explain the measurement within its noise (median "
            f"phi {median:.1f}): something in the description of the room is not so, as a "
            "material, an opening, scattering, a source or a place. Intervals are too narrow, and "
            "nothing is called identifiable.",
            {"median_phi": median},
        ),
    )


def schroeder_findings(bands: Bands, decay_s: FloatArray, volume_m3: float) -> tuple[Finding, ...]:
    """Return a finding for the bands that begin below the Schroeder frequency.

    There a room rings in single modes and energies that add are no model of it: in simulated
    boxes the 95 % intervals of such bands held the truth less often than those above.

    Parameters
    ----------
    bands : Bands
    decay_s : float array, shape (n_bands,)
        Reverberation time of each band; NaN where unknown.
    volume_m3 : float

    References
    ----------
    .. [1] M. R. Schroeder, "The 'Schroeder frequency' revisited", J. Acoust. Soc. Am. 99,
           3240-3241 (1996): ``2000 (T / V) ** 0.5`` in Hz, s and m3.
    """
    limit_hz = 2000.0 * np.sqrt(decay_s / volume_m3)
    low = np.flatnonzero(bands.lower_hz < limit_hz)
    if not low.size:
        return ()
    told = ", ".join(f"{bands.centres_hz[j]:g} Hz ({limit_hz[j]:.0f} Hz)" for j in low)
    return (
        Finding(
            "below-schroeder-frequency",
            "warning",
            f"Part of the band lies below the Schroeder frequency at {told}: single modes decide "
            "there, which the model does not have. Trust these intervals less.",
            {"bands_hz": [float(bands.centres_hz[j]) for j in low]},
        ),
    )
