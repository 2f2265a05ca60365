"""Prediction of room parameters for arbitrary positions and wall absorption."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from roomfit.base.bands import Bands
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.forks import in_forks, in_this_process
from roomfit.base.kernels import each_in_threads, one_blas_thread
from roomfit.base.shown import Shown
from roomfit.base.typing import FloatArray, Progress, part
from roomfit.fit.traced_room import TracedRoom, check_scene, trace_room
from roomfit.materials.priors import object_area_m2
from roomfit.model.reduced_rows import ReducedRows
from roomfit.predict.carried import with_common_noise
from roomfit.predict.changes import Change, change_text, changed_draws
from roomfit.predict.decay import (
    LatestBands,
    PairNumbers,
    changed_numbers,
    pair_numbers,
)
from roomfit.predict.misfit import with_misfit
from roomfit.predict.split import open_splits, prior_dominated
from roomfit.predict.tables import (
    ObservedPair,
    PredictedPair,
    PredictedValue,
    ValueChange,
    observed_pairs,
    predicted_means,
    predicted_pairs,
    with_sti,
    without_jnd,
)
from roomfit.result import result_doubts
from roomfit.room.scene import Scene, material_areas_m2, pair_names, pair_states
from roomfit.settings import Settings
from roomfit.signals.decay import FIT_RANGES_DB
from roomfit.signals.iso3382 import VALUE_NAMES, MeasuredValues, ValueName
from roomfit.signals.measurement import Measurement
from roomfit.uncertainty.posterior import AbsorptionPosterior, draw_absorption

_LOG = logging.getLogger("roomfit")


@dataclass(frozen=True, slots=True, eq=False)
class Predicted(Shown):
    """Predictions for a room under a given absorption."""

    described_in: ClassVar[str] = "predicted"
    bands: Bands
    materials: tuple[str, ...]
    absorption: FloatArray  # (n_materials, n_bands), changes included, as the two bounds
    lower95: FloatArray
    upper95: FloatArray
    changes: tuple[str, ...]  # in words
    pairs: tuple[PredictedPair, ...]
    # over the pairs, each counted once; over those measured, where some are
    mean: Mapping[ValueName, PredictedValue]
    findings: tuple[Finding, ...]
    n_draws: int
    seed: int
    seconds: float
    sti: PredictedValue | None = None  # as `mean`, of shape (1,), where the bands give it
    # by object, (3, n_bands): equivalent absorption area in m2 and its bounds, changes included
    objects_m2: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def compares_states(self) -> bool:
        """Whether the room before the change was predicted, too."""
        return any(v.change is not None for v in self.mean.values())

    def to_dataframe(self) -> Any:
        """Return a pandas data frame of one row a pair, parameter and band, as predicted.csv."""
        from roomfit.base.table import data_frame
        from roomfit.predict.output import predicted_records

        return data_frame(predicted_records(self), "predicted.csv")


@one_blas_thread
def predict(
    scene: Scene,
    absorption: AbsorptionPosterior,
    changes: Sequence[Change] = (),
    measurements: Sequence[Measurement | MeasuredValues] = (),
    *,
    speech_db: FloatArray | None = None,
    settings: Settings | None = None,
    progress: Progress | None = None,
) -> Predicted:
    """Predict the room parameters of every pair of a scene, with 95 % intervals.

    The room is traced once; draws of the absorption weigh the same paths. An interval is where a
    measurement is expected: it holds what is not known of the absorption, reflections that
    interfere, the number of rays, and half a just noticeable difference for the model. It holds no
    error of positions or of the geometry, and no spread of scattering or of the air.

    With changes, the room is predicted before and after them with the same draws of all that stays
    (`PredictedValue.change`): what is not known of both states cancels in what the change does, and
    by this what was measured before is carried over. Where the interval of a change includes none,
    its direction is not determined.

    Parameters
    ----------
    scene : Scene
        Room, sources, receivers and air, and the pairs to predict. Nothing in it is fitted.
    absorption : AbsorptionPosterior
        Of exactly the room's materials, in their order; in the bands to predict, 0 to 1,
        dimensionless. Scattering coefficients and directivities of sources come with it. A result
        of another room is brought to this form by `roomfit.core.room_posterior`.
    changes : sequence of Change, optional
        What if: materials with another absorption, from `roomfit.predict.changes.read_change`.
    measurements : sequence of Measurement or MeasuredValues, optional
        Of pairs of the scene, to stand beside the prediction; nothing is fitted to them.
    speech_db : float array, shape (2, 7), optional
        Octave levels from 125 Hz to 8 kHz of speech at 1 m in the free field, and of noise at the
        listeners, from `roomfit.core.speech_levels`; left out: the speech transmission
        index is that of the room, without noise, masking and threshold.
    settings : Settings, optional
        `Settings.n_draws` draws of the absorption stand behind the intervals.
    progress : callable, optional
        Called with the share of the work that is done, 0 to 1.

    See Also
    --------
    prepare_prediction, predict_change : the same in two steps, the second in half a second.

    Returns
    -------
    Predicted
        Every pair of the scene once for each of its measurements, or once without; shapes and
        units stand with its fields.

    Raises
    ------
    InputError
        Other materials than the room's, a change that cannot be made, a position in a wall or
        outside, or a measurement of a pair that is not predicted.

    Notes
    -----
    Parameters are those of ISO 3382-1:2009, and the speech transmission index of IEC
    60268-16:2020 where the bands are the octaves from 125 Hz to 8 kHz.

    Examples
    --------
    >>> import roomfit
    >>> room = roomfit.shoebox_room((6.0, 5.0, 3.0), "plaster")
    >>> scene = roomfit.scene_of(room, {"S": (1.5, 1.2, 1.5)}, {"R": (4.0, 3.5, 1.2)})
    >>> measured = roomfit.MeasuredValues("S", "R", [1000.0], {"T20_s": [0.8]})
    >>> octave, few = roomfit.bands_between("octave", 1000, 1000), roomfit.Settings(n_rays=2000)
    >>> result = roomfit.identify(scene, [measured], bands=octave, settings=few)
    >>> predicted = roomfit.predict(scene, roomfit.absorption_posterior(result), settings=few)
    >>> time = predicted.pairs[0].parameters["T20_s"]
    >>> bool(time.lower95[0] < time.predicted[0] < time.upper95[0])
    True

    ``roomfit.predict(**roomfit.predict_arguments(campaign, result))`` is what the
    command line does.
    """
    began = time.perf_counter()
    prepared = prepare_prediction(
        scene,
        absorption,
        (changes,),
        measurements,
        speech_db=speech_db,
        settings=settings,
        progress=part(progress, 0.0, 0.75 if changes else 1.0),
    )
    done = part(progress, 0.75, 1.0)
    found = predict_change(prepared, changes, exact=True, progress=done)
    return replace(found, seconds=time.perf_counter() - began)


@dataclass(frozen=True, slots=True, eq=False)
class PreparedRoom:
    """A room whose walls may change: all that a prediction needs and no change touches."""

    traced: TracedRoom
    absorption: AbsorptionPosterior
    draws: FloatArray  # (n_draws, n_materials, n_bands), common to all changes
    rng: np.random.Generator  # to be copied: equal changes are drawn alike
    observed: tuple[ObservedPair, ...]
    # of every pair, as it was found; none where some absorption is known after a change only
    before: tuple[PairNumbers, ...]
    few: tuple[ReducedRows, ...]  # of every pair
    base: FloatArray  # (n_pairs, n_names, n_bands), values of `few` at the absorption found
    base_sti: FloatArray  # (n_pairs,), likewise
    findings: tuple[Finding, ...]
    dominated: tuple[Finding, ...]  # by material, that the prior decides its share
    seed: int
    speech_db: FloatArray | None  # as of `predict`
    latest: tuple[LatestBands, ...]  # of every pair, what `numbers_at` found last

    @property
    def scene(self) -> Scene:
        """Room, sources, receivers and pairs."""
        return self.traced.scene


@one_blas_thread
def prepare_prediction(
    scene: Scene,
    absorption: AbsorptionPosterior,
    alternatives: Sequence[Sequence[Change]] = (),
    measurements: Sequence[Measurement | MeasuredValues] = (),
    *,
    speech_db: FloatArray | None = None,
    settings: Settings | None = None,
    progress: Progress | None = None,
) -> PreparedRoom:
    """Trace and predict a room as it was found, ready for many changes by `predict_change`."""
    settings = Settings() if settings is None else settings
    _check(scene, absorption, measurements)
    rng = np.random.default_rng(settings.seed)
    draws = draw_absorption(absorption, settings.n_draws, rng)
    draws, dominated = _open_draws(scene, absorption, draws, alternatives, settings.seed)
    least, is_known = _least_absorption(absorption, draws, alternatives, rng)
    observed, measured_findings = observed_pairs(scene, measurements, absorption.bands)
    longest_s, done = _longest_s(observed), part(progress, 0.02, 0.6)
    traced = trace_room(scene, absorption, least, longest_s, settings, done)
    bands, found = absorption.bands, absorption.absorption
    few = tuple(in_forks(partial(traced.reduced, absorption=found), range(len(scene.pairs))))
    energies = [f.energies(found[None]) for f in few]
    base = [f.values(e) for f, e in zip(few, energies, strict=True)]
    base_sti = [f.sti(e, v, speech_db) for f, e, v in zip(few, energies, base, strict=True)]
    room = PreparedRoom(
        traced, absorption, draws, rng, observed, (), few,
        np.concatenate(base), np.concatenate(base_sti), (*measured_findings, *traced.findings),
        dominated, settings.seed, speech_db, tuple({} for _ in few),
    )  # fmt: skip
    if not is_known:
        return room
    before = _exact_numbers(room, found, draws, part(progress, 0.6, 1.0))
    return replace(
        room,
        before=before,
        observed=with_sti(scene, bands, observed, before, speech_db),
    )


def _open_draws(
    scene: Scene,
    absorption: AbsorptionPosterior,
    draws: FloatArray,
    alternatives: Sequence[Sequence[Change]],
    seed: int,
) -> tuple[FloatArray, tuple[Finding, ...]]:
    """Return draws that hold what changes may do, and materials whose share the prior decides."""
    first = int(pair_states(scene)[0])
    states = [first, *(s for s in range(1 + len(scene.room.states)) if s != first)]
    areas_m2 = np.stack([material_areas_m2(scene.room, s) for s in states])
    rng, names = np.random.default_rng(seed), absorption.materials
    dominated = prior_dominated(absorption, draws, names, areas_m2[0], rng)
    changed = {c.material for one in alternatives for c in one}
    if not changed:
        return draws, dominated
    own = [f for f in dominated if changed & set(f.about.materials)]
    return open_splits(absorption, draws, own, areas_m2, seed), dominated


def _least_absorption(
    absorption: AbsorptionPosterior,
    draws: FloatArray,
    alternatives: Sequence[Sequence[Change]],
    rng: np.random.Generator,
) -> tuple[FloatArray, bool]:
    """Return the least absorption of all alternatives, and whether that before them is known."""
    names = absorption.materials
    changed = [names.index(c.material) for one in alternatives for c in one if c.material in names]
    is_known = not absorption.is_unknown[changed].any()
    followed = [changed_draws(absorption, draws, c, deepcopy(rng))[0] for c in alternatives]
    followed += [absorption.absorption] if is_known or not followed else []
    return np.asarray(np.min(followed, axis=0)), is_known


def _exact_numbers(
    room: PreparedRoom,
    absorption: FloatArray,
    draws: FloatArray,
    progress: Progress | None,
) -> tuple[PairNumbers, ...]:
    """Return the numbers of every pair from all paths."""
    n_pairs = len(room.scene.pairs)
    _LOG.info("predicting")
    shown = in_this_process(progress)

    def of_pair(i: int) -> PairNumbers:
        one = pair_numbers(room.traced, i, room.few[i], absorption, draws, room.speech_db)
        if shown is not None:
            shown((i + 1) / n_pairs)
        return one

    numbers = tuple(in_forks(of_pair, range(n_pairs)))
    return with_misfit(numbers, room.absorption.fitted_jnd, room.traced.by_pressures)


def numbers_at(
    room: PreparedRoom, absorption: FloatArray, draws: FloatArray
) -> tuple[PairNumbers, ...]:
    """Return the numbers of every pair under another absorption, from few paths.

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

    def numbers(i: int) -> PairNumbers:
        base = room.base[i], room.base_sti[i]
        return changed_numbers(
            room.before[i], room.few[i], absorptions, base, room.speech_db, room.latest[i]
        )

    return tuple(each_in_threads(numbers, len(room.few)))


@one_blas_thread
def predict_change(
    room: PreparedRoom,
    changes: Sequence[Change] = (),
    *,
    exact: bool = False,
    compare_pairs: bool = True,
    progress: Progress | None = None,
) -> Predicted:
    """Predict a prepared room with changes, as `predict` does."""
    absorption, scene = room.absorption, room.scene
    began, bands, rng = time.perf_counter(), absorption.bands, deepcopy(room.rng)
    expected, drawn, doubts = changed_draws(absorption, room.draws, changes, rng)
    names, n = scene.room.materials, len(scene.room.materials) - len(absorption.objects)
    changed = [names.index(c.material) for c in changes]
    numbers: list[tuple[PairNumbers, ...]] = [room.before]
    if changes and exact:
        after = _exact_numbers(room, expected, drawn, progress)
        numbers = [after, room.before] if room.before else [after]
    elif changes:
        numbers = [numbers_at(room, expected, drawn), room.before]
    if len(numbers) > 1 and (compare_pairs or room.observed):  # what both states share
        # a factor of 1, or a material in place of itself, exchanges nothing
        others = np.any(drawn != room.draws, axis=(0, 2))
        others |= np.any(expected != absorption.absorption, axis=1)
        others[n:] = False  # objects take energy from paths, and send none another way
        numbers[0] = tuple(
            with_common_noise(after, before, few, absorption.absorption, expected, others)
            for after, before, few in zip(numbers[0], room.before, room.few, strict=True)
        )
    named = {c.material for c in changes}
    doubts += tuple(f for f in room.dominated if named & set(f.about.materials))
    pairs, means, sti = _tables(room, numbers, compare_pairs=compare_pairs)
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
    room: PreparedRoom, numbers: list[tuple[PairNumbers, ...]], *, compare_pairs: bool
) -> tuple[tuple[PredictedPair, ...], dict[ValueName, PredictedValue], PredictedValue | None]:
    """Return what is predicted of every pair, and the means over them."""
    scene, bands, observed = room.scene, room.absorption.bands, room.observed
    if not room.before:
        observed = with_sti(scene, bands, observed, numbers[-1], room.speech_db)
    means, sti = predicted_means(scene, numbers, observed)
    pairs = predicted_pairs(scene, bands, numbers if compare_pairs else numbers[:1], observed)
    if not room.before:
        # the room as it was measured is not known: nothing stands beside the measurement
        pairs = tuple(
            replace(p, parameters=without_jnd(p.parameters), sti=without_jnd({0: p.sti})[0])
            for p in pairs
        )
        means, sti = without_jnd(means), without_jnd({0: sti})[0]
    return pairs, means, sti


def _check(
    scene: Scene,
    absorption: AbsorptionPosterior,
    measurements: Sequence[Measurement | MeasuredValues],
) -> None:
    absorption.check_materials(scene.room.materials)
    check_scene(scene)
    pairs = pair_names(scene)
    for m in measurements:
        if m.pair_name not in pairs:
            raise InputError(
                "a measurement of a pair that is not predicted",
                found=" to ".join(m.pair_name[:2]) + (f" ({m.state})" if m.state else ""),
                needed="a pair of the scene, in its state of the room",
                hint="leave it out, or add the pair to the scene",
            )


def _longest_s(observed: Sequence[ObservedPair]) -> float:
    """Return the longest measured decay time, T20 or T30, 0 where none is known."""
    rows = [VALUE_NAMES.index("T20_s"), VALUE_NAMES.index("T30_s")]
    known = [o.values[rows][np.isfinite(o.values[rows])] for o in observed]
    return max((float(k.max()) for k in known if k.size), default=0.0)


# Of a mean one decay time, and the parameters by which a change is described.
_SUMMARY: tuple[tuple[ValueName, ...], ...] = (("T30_s", "T20_s", "EDT_s"), ("C80_dB",), ("G_dB",))


def change_findings(
    changes: Sequence[Change],
    is_measured: bool,
    bands: Bands,
    means: Mapping[ValueName, PredictedValue],
) -> tuple[Finding, ...]:
    """Return what was changed, and in which bands the direction of its effect is determined."""
    if not changes:
        return ()
    sentence = f"Predicted with {', '.join(change_text(c) for c in changes)}."
    if is_measured:
        sentence += " Measured values beside it are those of the room as it was measured."
    directions, in_words = change_directions(bands, means)
    sentence = f"{sentence} {in_words}".rstrip()
    evidence = {"changes": [change_text(c) for c in changes], "directions": directions}
    about = About(materials=[c.material for c in changes])
    return (Finding(Code.MATERIALS_CHANGED, about, sentence, evidence),)


def change_directions(
    bands: Bands, means: Mapping[ValueName, PredictedValue]
) -> tuple[dict[str, dict[str, list[float]]], str]:
    """Return in which bands, Hz, means rise, fall or are not determined, and the same in words."""
    directions: dict[str, dict[str, list[float]]] = {}
    for names in _SUMMARY:
        known = [n for n in names if n in means and np.isfinite(means[n].predicted).any()]
        change = means[known[0]].change if known else None
        if change is not None:
            directions[known[0]] = _directions(bands, change, known[0])
    phrases = [
        f"{name.split('_')[0]} "
        + ", ".join(f"{way} at {', '.join(f'{f:g}' for f in at)} Hz" for way, at in ways.items())
        for name, ways in directions.items()
    ]
    return directions, f"At 95 % the mean of {'; of '.join(phrases)}." if phrases else ""


def _directions(bands: Bands, change: ValueChange, name: ValueName) -> dict[str, list[float]]:
    """Return in which bands a value rises and falls at 95 %, and in which none of it is known."""
    none = 1.0 if name in FIT_RANGES_DB else 0.0
    rises, falls = change.change_lower95 > none, change.change_upper95 < none
    ways = {"rises": rises, "falls": falls, "has no determined direction": ~(rises | falls)}
    known = np.isfinite(change.change)
    found = {way: bands.centres_hz[at & known].tolist() for way, at in ways.items()}
    return {way: at for way, at in found.items() if at}
