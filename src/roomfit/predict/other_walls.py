"""Prediction of room parameters for any positions and wall absorption, by the paths of a room."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from roomfit.base.air import attenuation_per_m
from roomfit.base.errors import InputError
from roomfit.base.findings import Finding
from roomfit.base.forks import in_forks, in_this_process
from roomfit.base.kernels import each_in_threads
from roomfit.base.typing import FloatArray, Progress, part
from roomfit.fit.traced_room import TracedRoom, trace_room
from roomfit.materials.priors import object_area_m2
from roomfit.model.reduced_rows import ReducedRows
from roomfit.predict import decay, tables
from roomfit.predict.changes import Change, change_text, changed_draws
from roomfit.predict.measured import Anchor, anchored, anchors, given_others
from roomfit.predict.prediction import Predicted, PredictedPair, PredictedValue, change_findings
from roomfit.predict.question import Question
from roomfit.predict.split import prior_dominated
from roomfit.result import result_doubts
from roomfit.room.mesh import triangle_areas_m2, volume_m3
from roomfit.room.scene import Scene, material_areas_m2, materials_of_surfaces, pair_states
from roomfit.signals.iso3382 import VALUE_NAMES, ValueName
from roomfit.uncertainty.posterior import AbsorptionPosterior, draw_absorption

_LOG = logging.getLogger("roomfit")


@dataclass(frozen=True, slots=True, eq=False)
class PreparedRoom:
    """A room whose walls may change: all that a prediction needs and no change touches."""

    traced: TracedRoom
    absorption: AbsorptionPosterior
    draws: FloatArray  # (n_draws, n_materials, n_bands), common to all changes
    observed: tuple[tables.ObservedPair, ...]
    # of every pair, as it was found; none where some absorption is known after a change only
    model: tuple[decay.PairNumbers, ...]  # by the model alone
    elsewhere: tuple[FloatArray, ...]  # in fitted states, of a state that was not
    anchors: tuple[Anchor, ...]
    before: tuple[decay.PairNumbers, ...]  # as it was measured, or is expected by other pairs
    expected: tuple[decay.PairNumbers, ...]  # by other pairs, whether it was measured or not
    few: tuple[ReducedRows, ...]  # of every pair
    findings: tuple[Finding, ...]
    dominated: tuple[Finding, ...]  # by material, that the prior decides its share
    seed: int
    speech_db: FloatArray | None  # as of `predict`
    latest: tuple[dict[int, decay.BandNumbers], ...]  # of every pair, what `numbers_at` found last

    @property
    def scene(self) -> Scene:
        """Room, sources, receivers and pairs."""
        return self.traced.scene

    def sabine_ratio(self, absorption: FloatArray) -> FloatArray:
        """Return what Sabine's formula says another absorption does to decay times, (n_bands,)."""
        air_per_m = attenuation_per_m(self.scene.air, self.traced.bands)
        air_m2 = 4.0 * volume_m3(self.scene.room.mesh) * air_per_m

        def area_m2(a: FloatArray) -> FloatArray:
            objects_m2 = _object_areas(self.absorption, a[len(a) - len(self.absorption.objects) :])
            return np.asarray(air_m2 + self.traced.areas_m2 @ a + sum(objects_m2.values()))

        return area_m2(self.absorption.absorption) / area_m2(absorption)


def prepare_paths(
    question: Question, alternatives: Sequence[Sequence[Change]], progress: Progress | None
) -> PreparedRoom:
    """Trace and predict a room as it was found, ready for changes."""
    question.check()
    scene, absorption, settings = question.scene, question.known, question.settings
    speech_db = question.speech_db
    draws = draw_absorption(absorption, settings.n_draws, np.random.default_rng(settings.seed))
    areas_m2 = material_areas_m2(scene.room, int(pair_states(scene)[0]))
    shares = absorption, draws, absorption.materials, areas_m2
    dominated = prior_dominated(*shares, np.random.default_rng(settings.seed))
    followed, is_known = _followed_absorptions(absorption, alternatives)
    observed, measured_findings = tables.observed_pairs(
        scene, question.measurements, absorption.bands
    )
    longest_s, done = _longest_s(observed), part(progress, 0.02, 0.6)
    traced = trace_room(scene, absorption, followed, longest_s, settings, done)
    bands, found = absorption.bands, absorption.absorption
    few = tuple(in_forks(partial(traced.reduced, absorption=found), range(len(scene.pairs))))
    room = PreparedRoom(
        traced, absorption, draws, observed, (), (), (), (), (), few,
        (*measured_findings, *traced.findings), dominated, settings.seed, speech_db,
        tuple({} for _ in few),
    )  # fmt: skip
    if not is_known:
        return room
    model = _numbers(room, found, draws, part(progress, 0.6, 1.0))
    room = replace(room, elsewhere=_in_fitted_states(room))
    model = _given_fitted_states(room, model)
    own = anchors(absorption, scene, model)
    before, expected = (
        tuple(anchored(n, n, a) for n, a in zip(model, moves, strict=True))
        for moves in (own, [a.without_own() for a in own])
    )
    observed = tables.with_sti(scene, bands, observed, before, speech_db)
    return replace(
        room, observed=observed, model=model, anchors=own, before=before, expected=expected
    )


def _surface_areas_m2(scene: Scene) -> FloatArray:
    mesh = scene.room.mesh
    areas_m2 = np.bincount(mesh.triangle_surface, triangle_areas_m2(mesh), len(mesh.surfaces))
    return np.asarray(areas_m2, dtype=np.float64)


def _given_fitted_states(
    room: PreparedRoom, numbers: Sequence[decay.PairNumbers]
) -> tuple[decay.PairNumbers, ...]:
    """Return predictions of a state that was not fitted, draws as the decays of others allow."""
    if not room.elsewhere:
        return tuple(numbers)
    return tuple(given_others(n, e) for n, e in zip(numbers, room.elsewhere, strict=True))


def _in_fitted_states(room: PreparedRoom) -> tuple[FloatArray, ...]:
    """Return what the absorption and its draws say of every pair in the states that were fitted.

    By the paths of a state that was not, each material in place of that which its surfaces have
    there; nothing elsewhere. Shapes (n_states, 1 + n_draws, n_names, n_bands).
    """
    known, scene = room.absorption, room.scene
    names, at = ["", *(s.name for s in scene.room.states)], int(pair_states(scene)[0])
    if known.is_other_room or not known.fitted or names[at] in known.fitted_states:
        return ()
    owners, areas_m2 = materials_of_surfaces(scene.room), _surface_areas_m2(scene)
    swaps = []
    for state in known.fitted_states:
        swap = np.arange(len(known.materials))
        if state in names:
            for m in np.unique(owners[at]):
                there = owners[names.index(state), owners[at] == m]
                swap[m] = np.argmax(np.bincount(there, areas_m2[owners[at] == m]))
            swaps.append(swap)
    every = np.concatenate((known.absorption[None], room.draws))

    def of_pair(i: int) -> FloatArray:
        return np.array([room.few[i].values(room.few[i].energies(every[:, s])) for s in swaps])

    return tuple(in_forks(of_pair, range(len(room.few)))) if swaps else ()


def _followed_absorptions(
    absorption: AbsorptionPosterior, alternatives: Sequence[Sequence[Change]]
) -> tuple[FloatArray, bool]:
    """Return the absorption of all alternatives, and whether that before them is known."""
    names = absorption.materials
    changed = [names.index(c.material) for one in alternatives for c in one if c.material in names]
    is_known = not absorption.is_unknown[changed].any()
    found = absorption.absorption
    followed = [changed_draws(absorption, found[None], c, 0)[0] for c in alternatives]
    followed += [found] if is_known or not followed else []
    return np.array(followed), is_known


def _numbers(
    room: PreparedRoom, absorption: FloatArray, draws: FloatArray, progress: Progress | None
) -> tuple[decay.PairNumbers, ...]:
    """Return the numbers of every pair, as nothing is known of them before."""
    n_pairs = len(room.scene.pairs)
    _LOG.info("predicting")
    shown = in_this_process(progress)
    absorptions = np.concatenate((absorption[None], draws))

    def of_pair(i: int) -> decay.PairNumbers:
        one = decay.pair_numbers(room.traced, i, room.few[i], absorptions, room.speech_db)
        if shown is not None:
            shown((i + 1) / n_pairs)
        return one

    return tuple(in_forks(of_pair, range(n_pairs)))


def numbers_at(
    room: PreparedRoom, absorption: FloatArray, draws: FloatArray
) -> tuple[decay.PairNumbers, ...]:
    """Return the numbers of every pair under another absorption.

    Shapes: `absorption` (n_materials, n_bands), `draws` (n_draws, n_materials, n_bands).
    """
    if not room.before:
        raise InputError(
            "what would be changed is not known before the change",
            found="a material of which nothing is known",
            needed="an absorption of every material of the room",
            hint="predict the change with roomfit.predict",
        )
    absorptions = np.concatenate((absorption[None], draws))

    def numbers(i: int) -> decay.PairNumbers:
        own = room.few[i], absorptions, room.speech_db, room.model[i], room.latest[i]
        return decay.pair_numbers(room.traced, i, *own)

    after = _given_fitted_states(room, tuple(each_in_threads(numbers, len(room.few))))
    found = room.absorption.absorption
    # a factor of 1, or a material in place of itself, exchanges nothing
    others = np.any(draws != room.draws, axis=(0, 2)) | np.any(absorption != found, axis=1)
    # objects take energy from paths, and send none another way
    others[len(others) - len(room.absorption.objects) :] = False
    return tuple(
        anchored(decay.with_common_noise(new, old, few, found, absorption, others), old, anchor)
        for new, old, few, anchor in zip(after, room.model, room.few, room.anchors, strict=True)
    )


def predict_paths(room: PreparedRoom, changes: Sequence[Change]) -> Predicted:
    """Predict a prepared room with changes, see `roomfit.predict.predict.predict_change`."""
    absorption, scene = room.absorption, room.scene
    began, bands = time.perf_counter(), absorption.bands
    expected, drawn, doubts = changed_draws(absorption, room.draws, changes, room.seed)
    names, n = scene.room.materials, len(scene.room.materials) - len(absorption.objects)
    changed = [names.index(c.material) for c in changes]
    numbers: list[tuple[decay.PairNumbers, ...]] = [room.before]
    if changes and room.before:
        numbers = [numbers_at(room, expected, drawn), room.before]
    elif changes:  # of walls that were fitted elsewhere
        after = _numbers(room, expected, drawn, None)
        moves = anchors(replace(absorption, is_other_room=True), scene, after)
        numbers = [tuple(anchored(n, n, a) for n, a in zip(after, moves, strict=True))]
    named = {c.material for c in changes}
    doubts += tuple(f for f in room.dominated if named & set(f.about.materials))
    sabine = room.sabine_ratio(expected)
    pairs, means, sti = _tables(room, numbers, sabine)
    lower, upper = absorption.lower95.copy(), absorption.upper95.copy()
    lower[changed], upper[changed] = np.quantile(drawn[:, changed], (0.025, 0.975), axis=0)
    stated = change_findings(changes, bool(room.before and room.observed), bands, means)
    return Predicted(
        bands,
        names[:n],
        expected[:n],
        lower[:n],
        upper[:n],
        tuple(change_text(c) for c in changes),
        pairs,
        means,
        (
            *scene.room.findings,
            *result_doubts(absorption, scene.room.findings),
            *absorption.findings,
            *doubts,
            *room.findings,
            *stated,
        ),
        len(drawn),
        room.seed,
        time.perf_counter() - began,
        sti,
        _object_areas(absorption, np.stack([expected, lower, upper])[:, n:]),
    )


def _object_areas(known: AbsorptionPosterior, values: FloatArray) -> dict[str, FloatArray]:
    """Return the areas in m2 of objects, from their absorption (..., n_objects, n_bands)."""
    return {
        name: object_area_m2(values[..., i, :], volume_m3)
        for i, (name, volume_m3) in enumerate(known.objects.items())
    }


def _tables(
    room: PreparedRoom, numbers: list[tuple[decay.PairNumbers, ...]], sabine: FloatArray
) -> tuple[tuple[PredictedPair, ...], dict[ValueName, PredictedValue], PredictedValue | None]:
    """Return what is predicted of every pair, and the means over them."""
    scene, bands, observed = room.scene, room.absorption.bands, room.observed
    if not room.before:
        observed = tables.with_sti(scene, bands, observed, numbers[-1], room.speech_db)
    expected = room.expected or numbers[0]
    means, sti, _ = tables.predicted_means(scene, numbers, observed, expected, sabine)
    of_pairs = [expected] if len(numbers) == 1 else numbers
    pairs = tables.predicted_pairs(scene, bands, of_pairs, observed, expected, sabine)
    if not room.before:
        # the room as it was measured is not known: nothing stands beside the measurement
        pairs = tuple(
            replace(
                p,
                parameters=tables.without_jnd(p.parameters),
                sti=tables.without_jnd({0: p.sti})[0],
            )
            for p in pairs
        )
        means, sti = tables.without_jnd(means), tables.without_jnd({0: sti})[0]
    return pairs, means, sti


def _longest_s(observed: Sequence[tables.ObservedPair]) -> float:
    """Return the longest measured decay time, T20 or T30, 0 where none is known."""
    rows = [VALUE_NAMES.index("T20_s"), VALUE_NAMES.index("T30_s")]
    known = [o.values[rows][np.isfinite(o.values[rows])] for o in observed]
    return max((float(k.max()) for k in known if k.size), default=0.0)
