"""What each band of an answer determines: means of materials, and shares of the absorption."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roomfit.app.certainty.telling import band_sentence
from roomfit.findings import Finding
from roomfit.typing import BoolArray, FloatArray
from roomfit.uncertainty.combinations import N_DRAWS, WITHIN, Combination, find_combinations
from roomfit.uncertainty.draws import band_draws
from roomfit.uncertainty.shares import absorption_shares
from roomfit.uncertainty.undetermined import undetermined_groups


@dataclass(frozen=True, slots=True, eq=False)
class Determined:
    """What the bands of an answer determine, where single materials may not be.

    Attributes
    ----------
    combinations : tuple of tuples of Combination, one a band
        That of the whole room first.
    sentences : tuple of str, one a band
        What is known of groups and what is left open; empty where every material is determined.
    shares : float array, shape (3, n_materials, n_bands)
        Share of each material in the room's absorption, its lower and its upper 95 % bound.
    """

    combinations: tuple[tuple[Combination, ...], ...]
    sentences: tuple[str, ...]
    shares: FloatArray


def determined(
    materials: tuple[str, ...],
    absorption: FloatArray,
    logit_covariance: FloatArray,
    logit_prior: FloatArray,
    areas_m2: FloatArray,
    seed: int,
    samples: Sequence[FloatArray | None] = (),
) -> Determined:
    """Return what every band determines.

    Parameters
    ----------
    materials : tuple of str
    absorption, logit_covariance, logit_prior, areas_m2, seed
        See `band_combinations`.
    samples : sequence of float array, shape (n_draws, n_materials), or None, one a band
        Draws of absorption where the posterior was sampled.
    """
    combinations, sentences, shares = [], [], []
    for band, covariance in enumerate(logit_covariance):
        a, prior = absorption[:, band], logit_prior[:, :, band]
        drawn = samples[band] if band < len(samples) else None
        if drawn is None:
            drawn = band_draws(
                a, covariance, prior[0], prior[1], N_DRAWS, np.random.default_rng(seed)
            )
        rng = np.random.default_rng(seed)
        found = find_combinations(areas_m2, a, covariance, prior[0], prior[1], rng, draws=drawn)
        combinations.append(found)
        left_open = undetermined_groups(covariance, prior[1])
        sentences.append(band_sentence(materials, found, left_open))
        shares.append(absorption_shares(areas_m2, a, drawn))
    return Determined(tuple(combinations), tuple(sentences), np.stack(shares, axis=-1))


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
