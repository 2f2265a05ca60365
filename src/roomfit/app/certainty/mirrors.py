"""Mirror images: answers that a symmetric room makes as good as the one that was found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from roomfit.app.fitting import MirrorTrial
from roomfit.app.gathering import Gathered
from roomfit.app.problems import UNTOLD_POSITION_SD_M
from roomfit.bands import Bands
from roomfit.findings import Finding
from roomfit.materials.knowledge import MaterialKnowledge
from roomfit.scene.scene import Scene
from roomfit.scene.symmetry import Symmetry, deviation_m, room_symmetries
from roomfit.typing import BoolArray, FloatArray, IntArray

# Places may be wrong by this many of their standard deviations.
_SPREADS = 3.0
# Log-likelihoods nearer than this do not decide between an answer and its image.
_UNDECIDED = 2.0


def mirror_findings(
    gathered: Gathered,
    bands: Bands,
    knowledge: tuple[MaterialKnowledge, ...],
    absorption: FloatArray,
    lower95: FloatArray,
    upper95: FloatArray,
    trials: Sequence[tuple[MirrorTrial, ...]] = (),
) -> tuple[BoolArray, tuple[Finding, ...]]:
    """Return what is ambiguous by symmetry, and a finding with both answers for each symmetry.

    A reflection or a turn that keeps the room and every fitted pair (or exchanges its source and
    its receiver) exchanges walls without changing any response. A fit then ends in one of two
    equally good answers and knows nothing of the other. Where both agree within their intervals
    nothing is ambiguous. Directional sources, and walls of which something else is known, break
    the symmetry.

    Parameters
    ----------
    gathered : Gathered
    bands : Bands
    knowledge : tuple of MaterialKnowledge
    absorption, lower95, upper95 : float arrays, shape (n_materials, n_bands)
    trials : sequence of tuples of MirrorTrial, one a band
        Second fits, one a symmetry of `mirror_symmetries`, where they were made: bands are left out
        whose data are likelier by 2 or more, in log-likelihood, without the exchange.

    Returns
    -------
    ambiguous : bool array, shape (n_materials, n_bands)
    findings : tuple of Finding
    """
    ambiguous = np.zeros(absorption.shape, dtype=np.bool_)
    findings = []
    scene = _fitted_scene(gathered)
    for number, symmetry in enumerate(mirror_symmetries(gathered, knowledge)):
        other = absorption[symmetry.exchange]
        differs = (other < lower95) | (other > upper95)
        tried = [t[number] if number < len(t) else None for t in trials]
        differs &= np.array([t is None or t.gain > -_UNDECIDED for t in tried] or [True])
        if np.any(differs):
            ambiguous |= differs
            apart = float(deviation_m(symmetry, scene).max())
            findings.append(_finding(symmetry, scene, bands, apart, absorption, differs, tried))
    return ambiguous, tuple(findings)


def mirror_symmetries(
    gathered: Gathered, knowledge: tuple[MaterialKnowledge, ...]
) -> tuple[Symmetry, ...]:
    """Return the symmetries of room and fitted pairs that exchange materials known alike."""
    scene = _fitted_scene(gathered)
    return tuple(
        symmetry
        for symmetry in (room_symmetries(scene.room) if len(scene.pairs) else ())
        if _unknown_alike(knowledge, symmetry.exchange)
        and not np.any(deviation_m(symmetry, scene) > _allowed_m(scene))
    )


def _fitted_scene(gathered: Gathered) -> Scene:
    """Return the scene of the pairs that are fitted."""
    scene = gathered.scene
    heard = {m.pair for m in gathered.responses if m.file.use == "fit"}
    tabulated = {(v.source, v.receiver) for v in gathered.values}
    kept = [
        i
        for i, (s, r) in enumerate(scene.pairs)
        if i in heard or (scene.sources[s].name, scene.receivers[r].name) in tabulated
    ]
    return replace(scene, pairs=scene.pairs[kept])


def _unknown_alike(knowledge: tuple[MaterialKnowledge, ...], exchange: IntArray) -> bool:
    """Whether materials are exchanged, and only such of which nothing, or the same, is known."""
    moved = np.flatnonzero(exchange != np.arange(exchange.size))
    return moved.size > 0 and all(
        _same_knowledge(knowledge[i], knowledge[exchange[i]]) for i in moved
    )


def _same_knowledge(one: MaterialKnowledge, other: MaterialKnowledge) -> bool:
    if one.known is not None or other.known is not None:
        return False
    return np.array_equal(one.prior_logit_mean, other.prior_logit_mean) and (
        one.lower,
        one.upper,
    ) == (other.lower, other.upper)


def _allowed_m(scene: Scene) -> FloatArray:
    """Return how far from symmetric each pair may be told to stand and yet be so."""
    sources, receivers = (
        np.array(
            [UNTOLD_POSITION_SD_M if p.position_sd_m is None else p.position_sd_m for p in points]
        )
        for points in (scene.sources, scene.receivers)
    )
    sd = np.maximum(sources[scene.pairs[:, 0]], receivers[scene.pairs[:, 1]])
    return np.asarray(_SPREADS * sd + 1e-3)


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
    told = "; ".join(
        f"{names[i]} {_row(absorption[symmetry.exchange[i], columns])} instead of "
        f"{_row(absorption[i, columns])}"
        for i in moved
    )
    centres = ", ".join(f"{f:g}" for f in bands.centres_hz[columns])
    gains = {j: t.gain for j, t in enumerate(trials) if t is not None and j in columns}
    confirmed = ""
    if gains:
        least, most = min(gains.values()), max(gains.values())
        between = f"{least:+.1f}" if most - least < 0.05 else f"{least:+.1f} to {most:+.1f}"
        confirmed = (
            f" A second fit that begins there changes the log-likelihood by {between}: "
            "the data do not decide."
        )
    return Finding(
        "mirror-images",
        "warning",
        f"The room is symmetric, and every fitted pair stands within {100 * apart_m:.0f} cm of "
        f"that symmetry: the data fit a second answer as well. At {centres} Hz: {told}."
        f"{confirmed} Measure a pair off the symmetry, or tell what is known of one of these "
        "walls.",
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


def _row(values: FloatArray) -> str:
    return ", ".join(f"{v:.2f}" for v in values)
