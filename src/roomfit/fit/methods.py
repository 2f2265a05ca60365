"""Which method and which intervals were used, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roomfit.base.logit import Z95, expit
from roomfit.base.typing import FloatArray
from roomfit.materials.priors import MaterialPrior, prior_logits
from roomfit.uncertainty.gaussian import BandEstimate


def prior_intervals(priors: tuple[MaterialPrior, ...]) -> FloatArray:
    """Return the prior of absorption as its 95 % interval.

    Shape (3, n_materials, n_bands).
    """
    by_name = {k.name: k for k in priors}
    rows = []
    for prior, mean, sd in zip(priors, *prior_logits(priors), strict=True):
        own = by_name[prior.tied_to or prior.name]
        if own.known is not None:
            rows.append(np.tile(own.known, (3, 1)))
            continue
        free = mean + np.outer((0.0, -Z95, Z95), sd)
        rows.append(own.lower + (own.upper - own.lower) * expit(free))
    return np.stack(rows, axis=1)


def method_chosen(method: str) -> str:
    """Return what "auto" stands for; every other method is what was asked for."""
    return "least-squares" if method == "auto" else method


def interval_words(answers: Sequence[BandEstimate]) -> str:
    """Return how the intervals were made, in a few words."""
    kinds = {kind for a in answers for kind in a.kinds}
    words = ["profiles"] if "profile" in kinds else []
    if "gaussian" in kinds or not words:
        words.append("Gaussian, local" if not words else "else Gaussian")
    return ", ".join(words)


def reasons(method: str, answers: Sequence[BandEstimate]) -> tuple[str, ...]:
    """Return sentences on what was chosen and why."""
    sentences = []
    if method == "auto":
        sentences.append(
            "Least squares from the absorption that the decays suggest: it has exact derivatives, "
            "and the other searches compare the same squares."
        )
    tried = [a.starts for a in answers if a.starts is not None]
    if tried:
        sentences.append(
            f"Energies were fitted from {tried[0].number} further random starts in each of "
            f"{len(tried)} bands: {sum(s.agreeing for s in tried)} of "
            f"{sum(s.number for s in tried)} ended within the intervals of the answer."
        )
    kinds = [kind for a in answers for kind in a.kinds if kind in ("profile", "gaussian", "none")]
    if "profile" in kinds:
        sentences.append(
            f"Of {len(kinds)} intervals {sum(len(a.profiles) for a in answers)} are so wide that a "
            f"Gaussian may fail; {kinds.count('profile')} of them were skew and are those of the "
            "profile likelihood."
        )
    return tuple(sentences)
