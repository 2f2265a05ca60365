"""Which sources of a campaign have an unknown directivity, and what is known of it beforehand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roomfit.app.measuring import MeasuredPair
from roomfit.errors import InputError
from roomfit.files.campaign.campaign import Campaign
from roomfit.files.campaign.directivity import unknown_directivity
from roomfit.objective.coherent_problem import CoherentProblem
from roomfit.objective.directed_problem import UnknownDirectivities, directed
from roomfit.objective.energy_problem import EnergyProblem
from roomfit.objective.problem import BandProblem
from roomfit.scene.scene import Scene
from roomfit.tracing.paths import Paths
from roomfit.typing import FloatArray, IntArray

# Of each component of b, where nothing is told: an omnidirectional source and a cardioid are both
# within reach.
UNTOLD_B_SD = 0.5
# Between bands an octave apart: a loudspeaker keeps its aim, and becomes narrower by and by.
CORRELATION_PER_OCTAVE = 0.8

_METHODS = ("auto", "least-squares", "posterior")


@dataclass(frozen=True, slots=True, eq=False)
class Directing:
    """Sources whose directivity is to be found.

    Attributes
    ----------
    sources : tuple of str
    number : int array, shape (n_sources,)
        Of each of them in the scene.
    mean, sd : float arrays, shape (n_sources, 3) and (n_sources,)
        Of the vectors b beforehand, alike in all bands.
    """

    sources: tuple[str, ...]
    number: IntArray
    mean: FloatArray
    sd: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Directed:
    """Unknown directivities in one band, and where its rows leave the sources.

    Attributes
    ----------
    unknown : UnknownDirectivities
    source : int array, shape (n_observations,)
    departure : tuple of float32 arrays, one an observation
        See `roomfit.objective.directed_problem.DirectedProblem`.
    """

    unknown: UnknownDirectivities
    source: IntArray
    departure: tuple[NDArray[np.float32], ...]


def campaign_directing(campaign: Campaign, scene: Scene) -> Directing | None:
    """Return the sources of a scene whose directivity is to be fitted; None where there is none.

    Raises
    ------
    InputError
        The campaign asks for a method that cannot, or has no response to fit.
    """
    told = [
        (i, s.name, known)
        for i, s in enumerate(scene.sources)
        if (known := unknown_directivity(campaign, s.name)) is not None
    ]
    if not told:
        return None
    _refuse(campaign, [name for _, name, _ in told])
    mean = np.array([np.zeros(3) if k.mean is None else k.mean for _, _, k in told])
    sd = np.array([UNTOLD_B_SD if k.sd is None else k.sd for _, _, k in told])
    number = np.array([i for i, _, _ in told])
    return Directing(tuple(name for _, name, _ in told), number, mean, sd)


def omnidirectional(campaign: Campaign, scene: Scene) -> Directing | None:
    """Return the sources that are taken for omnidirectional, to see whether the data agree."""
    own = [
        (i, s.name)
        for i, s in enumerate(scene.sources)
        if campaign.directivities.get(s.name, "omni") == "omni"
    ]
    if not own:
        return None
    n = len(own)
    names, number = tuple(name for _, name in own), np.array([i for i, _ in own])
    return Directing(names, number, np.zeros((n, 3)), np.full(n, UNTOLD_B_SD))


def _refuse(campaign: Campaign, sources: Sequence[str]) -> None:
    where = f"{campaign.path}, sources.{sources[0]}.directivity"
    if campaign.method not in _METHODS:
        raise InputError(
            "directivity is fitted by least squares only",
            where=where,
            found=f"method = {campaign.method!r}",
            needed='method = "auto", "least-squares" or "posterior", or a directivity that is told',
        )
    if any(t.use == "fit" for t in campaign.tables):
        raise InputError(
            "directivity is fitted to impulse responses only",
            where=where,
            found="room parameters that are to be fitted as well",
            needed='impulse responses alone, or use = "validate" for the tables',
            hint="fit the directivity to the responses first, then tell it as {aim, b}",
        )


def before(directing: Directing) -> UnknownDirectivities:
    """Return what is known of every source before any data."""
    root = np.diag(np.repeat(directing.sd, 3))
    return UnknownDirectivities(directing.sources, directing.mean.ravel(), root)


def after_others(
    directing: Directing, mean: FloatArray, covariance: FloatArray
) -> UnknownDirectivities:
    """Return what is known when other bands have said what they say of the free numbers."""
    start = before(directing)
    root = start.root @ np.linalg.cholesky(covariance)
    return UnknownDirectivities(directing.sources, start.mean + start.root @ mean, root)


def directed_band(
    directing: Directing,
    scene: Scene,
    paths: Paths,
    problem: EnergyProblem,
    files: Sequence[MeasuredPair],
) -> Directed:
    """Return where the rows of a band's problem leave the sources, nothing known of these yet."""
    unknown_of = {int(n): i for i, n in enumerate(directing.number)}
    source = np.array([unknown_of.get(int(scene.pairs[m.pair][0]), -1) for m in files])
    departure = tuple(
        paths.departure[rows.path] if s >= 0 else np.zeros((0, 3), dtype=np.float32)
        for s, rows in zip(source, problem.rows, strict=True)
    )
    return Directed(before(directing), source, departure)


def made_directed(problem: EnergyProblem | CoherentProblem, how: Directed | None) -> BandProblem:
    """Return the problem with directivity unknown, or as it is where there is none."""
    if how is None:
        return problem
    return directed(problem, how.unknown, how.source, how.departure)
