"""Use case: what would be measured in a room, between any two points, with any walls."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from roomfit.app.changes import Change, change_text, changed_draws
from roomfit.app.predicting.pair import PairNumbers, pair_numbers
from roomfit.app.predicting.scene import (
    PairChoice,
    Seen,
    predicted_bands,
    prediction_scene,
    room_posterior,
    scattering_known,
    seen_pairs,
)
from roomfit.app.predicting.sources import directed_as_found
from roomfit.app.predicting.trace import follow_decay
from roomfit.app.predicting.values import predicted_means, predicted_pairs
from roomfit.app.progress import part
from roomfit.files.cache import Cache, cached
from roomfit.files.campaign.campaign import Campaign
from roomfit.files.campaign.materials import material_knowledge
from roomfit.files.rooms.read import read_room
from roomfit.findings import Finding
from roomfit.materials.knowledge import in_bands
from roomfit.signals.parameter_gradients import VALUE_NAMES
from roomfit.threads import one_blas_thread
from roomfit.typing import FloatArray, Progress
from roomfit.uncertainty.draws import draw_absorption
from roomfit.uncertainty.posterior import AbsorptionPosterior
from roomfit.uncertainty.prediction import Predicted

N_DRAWS = 128


@one_blas_thread
def predict_campaign(
    campaign: Campaign,
    absorption: AbsorptionPosterior,
    changes: Sequence[Change] = (),
    *,
    pairs: PairChoice = "all",
    n_draws: int = N_DRAWS,
    cache: Cache | None = None,
    progress: Progress | None = None,
) -> Predicted:
    """Predict the room parameters of every pair, with 95 % intervals.

    The room is traced once; draws of the absorption weigh the same paths. An interval is where a
    measurement is expected: it holds what is not known of the absorption, reflections that
    interfere, the number of rays, and half a just noticeable difference for the model. It holds no
    error of positions or of the geometry, and no spread of scattering or of the air.

    Parameters
    ----------
    campaign : Campaign
        Of the room to predict, which need not be the room in which the absorption was found.
        Nothing in it is fitted.
    absorption : AbsorptionPosterior
        From `roomfit.files.result_reader.read_result`; materials are matched by name.
    changes : sequence of Change
        What if: materials with another absorption.
    pairs : {"all", "campaign"}
        Every source with every receiver, or those that were measured.
    n_draws : int
    cache : Cache, optional
        Keeps the trace and the numbers of every finished pair.
    progress : callable, optional

    Raises
    ------
    InputError
        Materials without absorption, no common band, a change that cannot be made, positions in
        walls, or files that cannot be read.
    """
    began = time.perf_counter()
    room, findings = read_room(campaign.room)
    bands, doubts = predicted_bands(campaign, absorption.bands)
    campaign, sources = directed_as_found(campaign, bands, absorption)
    places = np.flatnonzero(np.isin(campaign.bands.centres_hz, bands.centres_hz))
    told = in_bands(material_knowledge(campaign, room.materials), places)
    knowledge = scattering_known(told, bands, absorption)
    replaced = [c.material for c in changes if c.kind != "factor"]
    posterior = room_posterior(campaign, knowledge, bands, absorption, replaced)
    rng = np.random.default_rng(campaign.seed)
    drawn = draw_absorption(posterior, n_draws, rng)
    expected, drawn, clipped = changed_draws(posterior, drawn, changes, rng)
    scene = prediction_scene(campaign, room, pairs)
    seen, measured_findings = seen_pairs(campaign, bands, scene)
    followed = follow_decay(
        *(campaign, scene, bands, knowledge, expected, _longest_s(seen)),
        *(cache, part(progress, 0.02, 0.5)),
    )
    numbers: list[PairNumbers] = []
    cache_findings: list[Finding] = []
    for i in range(len(scene.pairs)):
        one = cached(
            cache,
            "pair",
            (scene, followed.settings, followed.weighing, bands, i, expected, drawn),
            lambda i=i: pair_numbers(scene, bands, followed.binned, i, expected, drawn),  # type: ignore[misc]
            (PairNumbers,),
        )
        numbers.append(one.value)
        cache_findings += one.findings
        if progress is not None:
            progress(0.5 + 0.5 * (i + 1) / len(scene.pairs))
    changed = [c.material for c in changes]
    lower, upper = _absorption_interval(posterior, drawn, changed)
    return Predicted(
        bands,
        room.materials,
        expected,
        lower,
        upper,
        tuple(change_text(c) for c in changes),
        predicted_pairs(scene, bands, numbers, seen),
        predicted_means(scene, bands, numbers, seen),
        (
            *(*findings, *doubts, *sources, *clipped, *measured_findings, *followed.findings),
            *(*cache_findings, *_what_if(changes, seen)),
        ),
        len(drawn),
        campaign.seed,
        time.perf_counter() - began,
    )


def _longest_s(seen: Sequence[Seen]) -> float:
    """Return the longest measured decay time, T20 or T30, 0 where none is known."""
    rows = [VALUE_NAMES.index("T20_s"), VALUE_NAMES.index("T30_s")]
    known = [s.values[rows][np.isfinite(s.values[rows])] for s in seen]
    return max((float(k.max()) for k in known if k.size), default=0.0)


def _absorption_interval(
    posterior: AbsorptionPosterior, drawn: FloatArray, changed: Sequence[str]
) -> tuple[FloatArray, FloatArray]:
    lower, upper = posterior.lower95.copy(), posterior.upper95.copy()
    rows = [posterior.materials.index(name) for name in changed]
    lower[rows], upper[rows] = np.quantile(drawn[:, rows], (0.025, 0.975), axis=0)
    return lower, upper


def _what_if(changes: Sequence[Change], seen: Sequence[Seen]) -> tuple[Finding, ...]:
    if not changes:
        return ()
    told = ", ".join(change_text(c) for c in changes)
    beside = " Measured values beside it are those of the room as it was measured." if seen else ""
    return (
        Finding(
            "materials-changed",
            "info",
            f"Predicted with {told}.{beside}",
            {"changes": [change_text(c) for c in changes]},
        ),
    )
