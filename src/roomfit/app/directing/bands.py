"""The vectors b of every band, each under what the other bands say of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from roomfit.app.directing.unknown import (
    CORRELATION_PER_OCTAVE,
    Directed,
    Directing,
    after_others,
    before,
)
from roomfit.app.fitting import BandAnswer
from roomfit.bands import Bands
from roomfit.identification.across_bands import Told, others_say, told_by
from roomfit.identification.reweighted import BandFit
from roomfit.objective.directed_problem import DIRECTIVITY, UnknownDirectivities, vectors_of
from roomfit.objective.parameters import Parameters, position_of
from roomfit.typing import FloatArray
from roomfit.uncertainty.answer import FittedDirectivity


@dataclass(frozen=True, slots=True, eq=False)
class FoundDirectivities:
    """The vectors b of the unknown sources in one band.

    Attributes
    ----------
    sources : tuple of str
    b, sd : float arrays, shape (n_sources, 3)
        Most likely values and their standard deviations, misfit included.
    """

    sources: tuple[str, ...]
    b: FloatArray
    sd: FloatArray


def first_of_directivity(parameters: Parameters) -> int:
    """Return where the directivity begins in the free vector, which it must end."""
    return position_of(parameters, DIRECTIVITY)


def hows_after_others(
    directing: Directing,
    bands: Bands,
    hows: Sequence[Directed | None],
    fits: Sequence[BandFit | None],
    parameters: Sequence[Parameters | None],
) -> tuple[Directed | None, ...]:
    """Return what is known of the sources in each band once the others have been fitted.

    Parameters
    ----------
    hows, fits, parameters : one a band
        With nothing known yet but what the campaign says.
    """
    told: list[Told | None] = [
        None if f is None or p is None else told_by(f, first_of_directivity(p))
        for f, p in zip(fits, parameters, strict=True)
    ]
    octaves = np.log2(bands.centres_hz)
    said = others_say(told, octaves, CORRELATION_PER_OCTAVE, directing.mean.size)
    return tuple(
        None if how is None else replace(how, unknown=after_others(directing, *other))
        for how, other in zip(hows, said, strict=True)
    )


def moved_start(fit: BandFit, old: UnknownDirectivities, new: UnknownDirectivities) -> FloatArray:
    """Return the vector of a fit in the free numbers of another prior, the same b."""
    first = fit.vector.size - old.mean.size
    b = old.mean + old.root @ fit.vector[first:]
    return np.concatenate((fit.vector[:first], np.linalg.solve(new.root, b - new.mean)))


def found_directivities(
    unknown: UnknownDirectivities, free: FloatArray, covariance: FloatArray
) -> FoundDirectivities:
    """Return the vectors b of free numbers with their covariance."""
    variance = np.einsum("ij,jk,ik->i", unknown.root, covariance, unknown.root)
    sd = np.sqrt(np.maximum(variance, 0.0))
    return FoundDirectivities(unknown.sources, vectors_of(unknown, free), sd.reshape(-1, 3))


def fitted_directivities(found: Sequence[FoundDirectivities]) -> tuple[FittedDirectivity, ...]:
    """Return what was found in all bands, source by source."""
    if not found:
        return ()
    return tuple(
        FittedDirectivity(
            name, np.stack([f.b[s] for f in found]), np.stack([f.sd[s] for f in found])
        )
        for s, name in enumerate(found[0].sources)
    )


def untold_directivities(directing: Directing) -> FoundDirectivities:
    """Return what was known beforehand, for a band that was not fitted."""
    unknown = before(directing)
    n = unknown.mean.size
    return found_directivities(unknown, np.zeros(n), np.eye(n))


def band_directivities(
    directing: Directing | None,
    hows: Sequence[Directed | None],
    answers: Sequence[BandAnswer | None],
) -> tuple[FoundDirectivities, ...]:
    """Return the vectors b of every band; what was known beforehand where none was fitted."""
    if directing is None:
        return ()
    return tuple(
        untold_directivities(directing)
        if how is None or answer is None or answer.directivity is None
        else found_directivities(how.unknown, *answer.directivity)
        for how, answer in zip(hows, answers, strict=True)
    )
