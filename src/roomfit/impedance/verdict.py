"""Whether the walls were identified, cannot be, or are not what the model takes them for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from roomfit.impedance.fit import ImpedanceFit, reduced_chi2
from roomfit.impedance.intervals import MaterialAnswer
from roomfit.impedance.model import Nuisances, has_free_spectra
from roomfit.impedance.problem import Problem
from roomfit.typing import FloatArray

Word = Literal["identified", "not identifiable", "does not fit"]

# Of squares over what is expected; the allowance for the model's own error is a generous one, so
# that good fits come to between 0.2 and 1.2.
CHI2_LIMIT = 1.6
OCTAVE_CHI2_LIMIT = 2.5
# Share of frequencies at which a material must be identified.
ENOUGH_FREQUENCIES = 0.8
# A cause that frees very many numbers must lower the squares to this share of them.
_FAR_BETTER = 0.2
# Noise estimated from what a fit leaves: above this share of the level it does not fit.
LOUDEST_ESTIMATED_NOISE = 0.15


@dataclass(frozen=True, slots=True)
class Verdict:
    """How a fit is to be taken.

    Attributes
    ----------
    word : {"identified", "not identifiable", "does not fit"}
    cause : str
        "" where identified.
    sentence : str
    weaker : bool
        Whether noise was estimated from the residual, or phases were missing.
    """

    word: Word
    cause: str
    sentence: str
    weaker: bool


def chi2_by_octave(fit: ImpedanceFit) -> tuple[tuple[float, float, float], ...]:
    """Return lower and upper end (Hz) of each octave of the data, and its mean square residual."""
    f = fit.problem.observed.frequency_hz
    n_pairs = len(fit.problem.observed.pressure)
    square = np.reshape(fit.residual**2, (-1, n_pairs, len(f))).mean(axis=(0, 1))
    share = max(1.0 - fit.effective / len(fit.residual), 1e-3)
    edges = [float(f[0])]
    while edges[-1] < f[-1]:
        edges.append(2.0 * edges[-1])
    found = []
    for low, high in pairwise(edges):
        own = (f >= low) & (f <= high)
        if own.any():
            top = float(min(high, f[-1]))
            found.append((low, top, float(square[own].mean()) / share))
    return tuple(found)


def fits(fit: ImpedanceFit) -> bool:
    """Return whether a fit leaves no more than noise and the model's own error."""
    worst = max((c for _, _, c in chi2_by_octave(fit)), default=0.0)
    return reduced_chi2(fit) <= CHI2_LIMIT and worst <= OCTAVE_CHI2_LIMIT


def likely_cause(fit: ImpedanceFit, again: Callable[[Problem], ImpedanceFit]) -> str:
    """Return why a model does not fit, by what makes it fit.

    Parameters
    ----------
    fit : ImpedanceFit
    again : callable
        Fits a changed problem from its start.
    """
    octaves = chi2_by_octave(fit)
    if len(octaves) > 1 and octaves[0][2] > OCTAVE_CHI2_LIMIT:
        rest = [c for _, _, c in octaves[1:]]
        if max(rest) <= CHI2_LIMIT:
            return (
                f"low frequency: only below {octaves[0][1]:.0f} Hz, where image sources are a "
                "poor picture of waves"
            )
    told = fit.problem.nuisances
    before = reduced_chi2(fit)
    for cause, freed in (
        ("positions or the speed of sound", _free_geometry(told)),
        ("the gain", _free_gain(told)),
        ("positions and the gain", _free_gain(_free_geometry(told))),
    ):
        if freed == told:
            continue
        other = again(replace(fit.problem, nuisances=freed))
        after = reduced_chi2(other)
        if fits(other) or after < 0.1 * before:
            return f"{cause}: the residual falls from {before:.1f} to {after:.1f} with them free"
    if not has_free_spectra(told) and _spectra_can_be_told(fit.problem):
        spectra = replace(
            _free_geometry(told), gain="pair-spectrum" if told.gain == "pair" else "spectrum"
        )
        after = reduced_chi2(again(replace(fit.problem, nuisances=spectra)))
        # so many free numbers make any fit better
        if after < _FAR_BETTER * before:
            return (
                "sources whose spectra are not flat or not the ones told: the residual falls from "
                f"{before:.1f} to {after:.1f} with them free"
            )
    return (
        "walls that do not react locally (thick soft layers), patches, scattering, a loudspeaker "
        "that does not radiate alike in all directions, or another room than was described: "
        "neither positions nor gains explain it"
    )


def _spectra_can_be_told(problem: Problem) -> bool:
    """Whether each source has been heard at two places and more, phases and all."""
    counts = np.unique(problem.model.scene.pairs[:, 0], return_counts=True)[1]
    return problem.observed.has_phase and bool(counts.min() >= 2)


def _free_geometry(told: Nuisances) -> Nuisances:
    return replace(
        told,
        position_sd_m=max(told.position_sd_m, 0.02),
        least_position_sd_m=max(told.least_position_sd_m, 0.02),
        speed_sd=max(told.speed_sd, 0.01),
    )


def _free_gain(told: Nuisances) -> Nuisances:
    return replace(told, gain="source") if told.gain in ("known", "common") else told


def enough_identified(materials: tuple[MaterialAnswer, ...]) -> FloatArray:
    """Return the share of frequencies at which each material is identified."""
    return np.array([float(np.mean(m.identified)) for m in materials])
