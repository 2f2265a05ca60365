"""Whether the mirror image of an answer, in a symmetric room, explains the data as well."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from roomfit.base.bands import Bands, bands_in_words
from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.checks.evidence import UNDECIDED, Evidence, Law
from roomfit.fit.symmetry import Symmetry, deviation_m, fitted_scene, mirror_symmetries
from roomfit.room.scene import Scene
from roomfit.uncertainty.gaussian import MirrorTrial

LAWS = {
    Code.MIRROR_AMBIGUITY: Law(
        "no symmetry of room and pairs exchanges walls of different absorption",
        "whether the exchanged answer lies outside the 95 % interval, log-likelihood within 2",
    )
}


def check(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding with both answers for each symmetry of room and fitted pairs.

    A fit ends in one of two equally good answers. Where both agree within their intervals nothing
    is ambiguous. Directional sources, and materials with different priors, break the symmetry.
    Bands whose second fit from the exchanged answer lost 2 units of log-likelihood are left out.
    """
    measured, absorption = evidence.measured, evidence.absorption
    trials = [b.mirrors for b in evidence.fits.answers]
    scene, bands = fitted_scene(measured), measured.bands
    for number, symmetry in enumerate(mirror_symmetries(measured, evidence.priors)):
        other = absorption[symmetry.exchange]
        differs = (other < evidence.lower95) | (other > evidence.upper95)
        tried = [t[number] if number < len(t) else None for t in trials]
        differs &= np.array([t is None or t.gain > -UNDECIDED for t in tried] or [True])
        if np.any(differs):
            apart = float(deviation_m(symmetry, scene).max())
            yield _finding(symmetry, scene, bands, apart, absorption, differs, tried)


def _finding(
    symmetry: Symmetry,
    scene: Scene,
    bands: Bands,
    apart_m: float,
    absorption: FloatArray,
    differs: BoolArray,
    trials: Sequence[MirrorTrial | None],
) -> Finding:
    names = scene.room.materials
    moved = [i for i in range(len(names)) if differs[i].any()]
    columns = np.flatnonzero(differs.any(axis=0))
    listed = "; ".join(
        f"{names[i]} {_row(absorption[symmetry.exchange[i], columns])} instead of "
        f"{_row(absorption[i, columns])}"
        for i in moved
    )
    centres = bands_in_words(bands, columns)
    gains = {j: t.gain for j, t in enumerate(trials) if t is not None and j in columns}
    confirmed = ""
    if gains:
        least, most = min(gains.values()), max(gains.values())
        between = f"{least:+.1f}" if most - least < 0.05 else f"{least:+.1f} to {most:+.1f}"
        confirmed = (
            f" A second fit that starts there changes the log-likelihood by {between}: "
            "the data do not decide."
        )
    return Finding(
        Code.MIRROR_AMBIGUITY,
        _about(names, bands, differs),
        f"The room is symmetric, and every fitted pair stands within {100 * apart_m:.0f} cm of "
        f"that symmetry: a second answer explains the data as well. At {centres}: {listed}."
        f"{confirmed} Measure a pair off the symmetry, or specify a prior of one of these "
        "materials.",
        {
            "materials": [names[i] for i in moved],
            "bands_hz": bands.centres_hz[columns].tolist(),
            "other_answer": {
                name: absorption[symmetry.exchange[i]].round(6).tolist()
                for i, name in enumerate(names)
            },
            "apart_m": apart_m,
            "log_likelihood_change": [round(g, 3) for g in gains.values()],
        },
    )


def _about(materials: Sequence[str], bands: Bands, differs: BoolArray) -> About:
    """Return the materials and bands that have another value, one by one where that is not all."""
    moved, columns = np.flatnonzero(differs.any(axis=1)), np.flatnonzero(differs.any(axis=0))
    names, centres_hz = [materials[int(i)] for i in moved], bands.centres_hz[columns].tolist()
    if differs[np.ix_(moved, columns)].all():
        return About(materials=names, bands_hz=centres_hz)
    own = np.argwhere(differs).tolist()
    entries = [(materials[i], float(bands.centres_hz[j])) for i, j in own]
    return About(materials=names, bands_hz=centres_hz, entries=entries)


def _row(values: FloatArray) -> str:
    return ", ".join(f"{v:.2f}" for v in values)
