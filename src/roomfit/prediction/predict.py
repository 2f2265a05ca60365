"""What would be measured in a room, between any two points, with any walls."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import ndtri

from roomfit._numba import one_blas_thread
from roomfit.bands import Bands
from roomfit.cache import Cache, cached
from roomfit.errors import InputError
from roomfit.findings import Code, Finding
from roomfit.geometry.mesh import refuse
from roomfit.inversion.measurements import observe
from roomfit.measurement import Measurement, Use
from roomfit.objective.room_parameters import MODEL_ERROR_JND, values_at
from roomfit.prediction.changes import Change, change_text, changed_draws, prior_dominated
from roomfit.prediction.decay import (
    RELATIVE,
    FewRows,
    PairNumbers,
    PredictedDecay,
    changed_numbers,
    few_energies,
    few_rows,
    few_values,
    follow_decay,
    levels_at,
    pair_numbers,
)
from roomfit.response.binned import BinnedPaths
from roomfit.scene import (
    Scene,
    material_areas_m2,
    pair_names,
    pair_states,
    position_findings,
)
from roomfit.settings import Settings
from roomfit.signals.decay import DecayCurve, in_jnd, jnd_of
from roomfit.signals.iso3382 import VALUE_NAMES, MeasuredValues, ValueName
from roomfit.typing import BoolArray, FloatArray, Progress, part
from roomfit.uncertainty.posterior import AbsorptionPosterior, draw_absorption

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Steps of equal probability by which noise widens every draw.
_STEPS = np.asarray(ndtri((np.arange(16) + 0.5) / 16.0))


@dataclass(frozen=True, slots=True, eq=False)
class ValueChange:
    """One room parameter before a change, and what the change does; all of shape (n_bands,)."""

    before: FloatArray  # at the most likely absorption as it was found
    before_lower95: FloatArray  # where a measurement before the change is expected
    before_upper95: FloatArray
    # after over before of EDT, T20 and T30, after minus before of all else; the interval is that of
    # the absorption alone, in which what is common to both cancels
    change: FloatArray
    change_lower95: FloatArray
    change_upper95: FloatArray
    # what was measured before, carried over by the change; a measurement after it is expected
    # between the two, NaN where nothing was measured
    carried: FloatArray
    carried_lower95: FloatArray
    carried_upper95: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PredictedValue:
    """One room parameter in every band; all arrays of shape (n_bands,), NaN where unknown."""

    predicted: FloatArray  # at the most likely absorption; the interval reaches to it at least
    lower95: FloatArray  # a measurement is expected between these two, 95 of 100 times
    upper95: FloatArray
    sd_absorption: FloatArray  # part of the spread, from what is not known of the absorption
    # part of the spread, from reflections that interfere, from the number of rays, and from the
    # error that the model is granted
    sd_rest: FloatArray
    measured: FloatArray
    jnd: FloatArray  # predicted minus measured in just noticeable differences
    mean_of_others: FloatArray  # over the other fitted measurements: a baseline
    change: ValueChange | None = None  # where materials were changed


@dataclass(frozen=True, slots=True, eq=False)
class PredictedPair:
    """What is predicted between one source and one receiver; twice where it was measured twice."""

    source: str
    receiver: str
    use: Use | None  # of its measurement; None where there is none
    parameters: Mapping[ValueName, PredictedValue]
    decay: PredictedDecay


@dataclass(frozen=True, slots=True, eq=False)
class Predicted:
    """Predictions for a room under a given absorption."""

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

    @property
    def compares_states(self) -> bool:
        """Whether the room before the change was predicted, too."""
        return any(v.change is not None for v in self.mean.values())

    def __str__(self) -> str:
        """Return the mean over the pairs, every pair, and all findings."""
        from roomfit.prediction.output import predict_text

        return predict_text(self)

    def _repr_html_(self) -> str:
        """Return the mean over the pairs and all findings in HTML, for notebooks."""
        from roomfit.prediction.output import predicted_html

        return predicted_html(self)

    def plot(self, pair: int = 0) -> Figure:
        """Return the energy decay curves of one pair, predicted and measured, in every band.

        Parameters
        ----------
        pair : int
            Index into `pairs`.
        """
        from roomfit.prediction.output import predicted_decay_figure

        return predicted_decay_figure(self, self.pairs[pair])

    def to_dataframe(self) -> Any:
        """Return a pandas data frame of one row a pair, parameter and band, as predicted.csv.

        Raises
        ------
        InputError
            pandas, on which roomfit does not depend, is not installed.
        """
        from roomfit.prediction.output import COLUMNS, predicted_rows
        from roomfit.report.wording import data_frame

        rows = ((*texts, *values) for texts, values in predicted_rows(self))
        return data_frame(COLUMNS, rows, "predicted.csv")


@one_blas_thread
def predict(
    scene: Scene,
    absorption: AbsorptionPosterior,
    changes: Sequence[Change] = (),
    measurements: Sequence[Measurement | MeasuredValues] = (),
    *,
    settings: Settings | None = None,
    cache: Cache | None = None,
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
        of another room is brought to this form by `roomfit.prediction.campaign.room_posterior`.
    changes : sequence of Change, optional
        What if: materials with another absorption, from `roomfit.prediction.changes.read_change`.
    measurements : sequence of Measurement or MeasuredValues, optional
        Of pairs of the scene, to stand beside the prediction; nothing is fitted to them.
    settings : Settings, optional
        `Settings.n_draws` draws of the absorption stand behind the intervals.
    cache : Cache, optional
        Keeps the trace and the numbers of every finished pair.
    progress : callable, optional
        Called with the share of the work that is done, 0 to 1.

    See Also
    --------
    prepare_prediction, predict_change : the same in two steps, the second in a tenth of a second.

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
    Parameters are those of ISO 3382-1:2009.

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
        settings=settings,
        cache=cache,
        progress=part(progress, 0.0, 0.75 if changes else 1.0),
    )
    done = part(progress, 0.75, 1.0)
    found = predict_change(prepared, changes, exact=True, cache=cache, progress=done)
    return replace(found, seconds=time.perf_counter() - began)


@dataclass(frozen=True, slots=True, eq=False)
class PreparedRoom:
    """A room whose walls may change: all that a prediction needs and no change touches."""

    scene: Scene
    absorption: AbsorptionPosterior
    draws: FloatArray  # (n_draws, n_materials, n_bands), common to all changes
    rng: np.random.Generator  # to be copied: equal changes are drawn alike
    observed: tuple[_ObservedPair, ...]
    binned: BinnedPaths
    weighed_by: tuple[object, ...]  # what decided `binned`, for keys
    # of every pair, as it was found; none where some absorption is known after a change only
    before: tuple[PairNumbers, ...]
    few: tuple[FewRows, ...]  # of every pair
    base: FloatArray  # (n_pairs, n_names, n_bands), values of `few` at the absorption found
    findings: tuple[Finding, ...]
    seed: int


@one_blas_thread
def prepare_prediction(
    scene: Scene,
    absorption: AbsorptionPosterior,
    alternatives: Sequence[Sequence[Change]] = (),
    measurements: Sequence[Measurement | MeasuredValues] = (),
    *,
    settings: Settings | None = None,
    cache: Cache | None = None,
    progress: Progress | None = None,
) -> PreparedRoom:
    """Trace and predict a room as it was found, ready for many changes by `predict_change`.

    Parameters
    ----------
    scene, absorption, measurements, settings, cache, progress
        As of `predict`.
    alternatives : sequence of sequences of Change
        Changes that may be asked for: decays are followed as long as with the hardest of them.

    Raises
    ------
    InputError
        As of `predict`.
    """
    settings = Settings() if settings is None else settings
    _check(scene, absorption, measurements)
    rng = np.random.default_rng(settings.seed)
    draws = draw_absorption(absorption, settings.n_draws, rng)
    changed = [scene.room.materials.index(c.material) for one in alternatives for c in one
               if c.material in scene.room.materials]  # fmt: skip
    is_known = not _is_unknown(absorption)[changed].any()
    followed = [changed_draws(absorption, draws, c, deepcopy(rng))[0] for c in alternatives]
    followed += [absorption.absorption] if is_known or not followed else []
    observed, measured_findings = _observed_pairs(scene, measurements, absorption.bands)
    binned, weighed_by, decay_findings = follow_decay(
        scene,
        absorption,
        np.min(followed, axis=0),
        _longest_s(observed),
        settings,
        cache,
        part(progress, 0.02, 0.6),
    )
    few = tuple(
        few_rows(scene, absorption.bands, binned, i, absorption.absorption)
        for i in range(len(scene.pairs))
    )
    base = [few_values(f, few_energies(f, absorption.absorption[None]))[0] for f in few]
    found = PreparedRoom(
        scene, absorption, draws, rng, observed, binned, weighed_by, (), few, np.array(base),
        (*measured_findings, *decay_findings), settings.seed,
    )  # fmt: skip
    if not is_known:
        return found
    before, cache_findings = _exact_numbers(
        found, absorption.absorption, draws, cache, part(progress, 0.6, 1.0)
    )
    return replace(found, before=before, findings=(*found.findings, *cache_findings))


def _exact_numbers(
    room: PreparedRoom,
    absorption: FloatArray,
    draws: FloatArray,
    cache: Cache | None,
    progress: Progress | None,
) -> tuple[tuple[PairNumbers, ...], tuple[Finding, ...]]:
    """Return the numbers of every pair from all paths, and what happened to the cache."""
    scene, bands, numbers = room.scene, room.absorption.bands, []
    findings: list[Finding] = []
    for i in range(len(scene.pairs)):
        one = cached(
            cache,
            "pair",
            (scene, room.weighed_by, bands, i, absorption, draws),
            lambda i=i: pair_numbers(  # type: ignore[misc]
                scene, bands, room.binned, i, room.few[i], absorption, draws
            ),
            (PairNumbers, PredictedDecay),
        )
        numbers.append(one.value)
        findings += one.findings
        if progress is not None:
            progress((i + 1) / len(scene.pairs))
    return tuple(numbers), tuple(findings)


def numbers_at(
    room: PreparedRoom, absorption: FloatArray, draws: FloatArray
) -> tuple[PairNumbers, ...]:
    """Return the numbers of every pair under another absorption, from few paths.

    Parameters
    ----------
    absorption : float array, shape (n_materials, n_bands)
    draws : float array, shape (n_draws, n_materials, n_bands)
        Of the same draws as `room.draws` in all that stays; none where intervals are not wanted.

    Raises
    ------
    InputError
        The absorption of the room before is not known.
    """
    if not room.before:
        raise InputError(
            "what would be changed is not known before the change",
            needed="an absorption of every material of the room",
            hint="predict the change with roomfit.predict",
        )
    absorptions = np.concatenate((absorption[None], draws))

    def numbers(i: int) -> PairNumbers:
        return changed_numbers(room.before[i], room.few[i], absorptions, room.base[i])

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return tuple(pool.map(numbers, range(len(room.few))))


@one_blas_thread
def predict_change(
    room: PreparedRoom,
    changes: Sequence[Change] = (),
    *,
    exact: bool = False,
    cache: Cache | None = None,
    progress: Progress | None = None,
) -> Predicted:
    """Predict a prepared room with changes, as `predict` does.

    Parameters
    ----------
    room : PreparedRoom
        From `prepare_prediction`.
    changes : sequence of Change
    exact : bool
        From all paths, in seconds; else carried over from the room as it was found by few of them,
        in a tenth of a second: pictures of decays are then those before.
    cache, progress
        For what is exact.

    Raises
    ------
    InputError
        A change that cannot be made, or one of what is not known that is not exact.
    """
    absorption, scene = room.absorption, room.scene
    began, bands, rng = time.perf_counter(), absorption.bands, deepcopy(room.rng)
    expected, drawn, doubts = changed_draws(absorption, room.draws, changes, rng)
    changed = [scene.room.materials.index(c.material) for c in changes]
    numbers: list[tuple[PairNumbers, ...]] = [room.before]
    if changes and exact:
        after, cache_findings = _exact_numbers(room, expected, drawn, cache, progress)
        doubts += cache_findings
        numbers = [after, room.before] if room.before else [after]
    elif changes:
        numbers = [numbers_at(room, expected, drawn), room.before]
    if len(numbers) > 1:
        areas_m2 = material_areas_m2(scene.room, int(pair_states(scene)[0]))
        doubts += prior_dominated(absorption, room.draws, changes, areas_m2, rng)
    means = predicted_means(scene, bands, numbers, room.observed)
    lower, upper = absorption.lower95.copy(), absorption.upper95.copy()
    lower[changed], upper[changed] = np.quantile(drawn[:, changed], (0.025, 0.975), axis=0)
    return Predicted(
        bands,
        scene.room.materials,
        expected,
        lower,
        upper,
        tuple(change_text(c) for c in changes),
        _predicted_pairs(scene, bands, numbers, room.observed),
        means,
        (
            *scene.room.findings,
            *absorption.findings,
            *doubts,
            *room.findings,
            *_what_if(changes, room.observed, bands, means),
        ),
        len(drawn),
        room.seed,
        time.perf_counter() - began,
    )


def check_materials(absorption: AbsorptionPosterior, scene: Scene) -> None:
    """Refuse an absorption of other materials than the room's, or in another order."""
    if absorption.materials != scene.room.materials:
        raise InputError(
            "the absorption is of other materials than the room's",
            found=", ".join(absorption.materials),
            needed=", ".join(scene.room.materials) + ", in this order",
            hint="room_posterior of roomfit.prediction.campaign matches materials by name",
        )


def _check(
    scene: Scene,
    absorption: AbsorptionPosterior,
    measurements: Sequence[Measurement | MeasuredValues],
) -> None:
    check_materials(absorption, scene)
    if not len(scene.pairs):
        raise InputError("the scene has no pair to predict", needed="a source and a receiver")
    refuse(position_findings(scene.room, scene.sources, scene.receivers))
    if np.unique(pair_states(scene)).size > 1:
        raise InputError(
            "a prediction is of one state of the room",
            found="pairs in several states",
            needed="a scene whose pair_state is the same everywhere; predict each state by itself",
        )
    pairs = pair_names(scene)
    for m in measurements:
        if m.pair_name not in pairs:
            raise InputError(
                "a measurement of a pair that is not predicted",
                found=" to ".join(m.pair_name[:2]) + (f" ({m.state})" if m.state else ""),
                needed="a pair of the scene, in its state of the room",
            )


@dataclass(frozen=True, slots=True, eq=False)
class _ObservedPair:
    """What was measured of a pair."""

    source: str
    receiver: str
    use: Use
    values: FloatArray  # (n_names, n_bands), in the order of VALUE_NAMES, NaN where unknown
    sd: FloatArray  # (n_names, n_bands), stated with the values; 0 where none is
    curve: DecayCurve | None  # None where room parameters were measured and no response


def _observed_pairs(
    scene: Scene, measurements: Sequence[Measurement | MeasuredValues], bands: Bands
) -> tuple[tuple[_ObservedPair, ...], tuple[Finding, ...]]:
    """Return what was measured, responses before tables of values."""
    measured, findings = observe(
        scene, [m for m in measurements if isinstance(m, Measurement)], bands
    )
    found = []
    for m in measured:
        # the level of a measurement is a question of its calibration: G is not read from responses
        values = np.vstack([m.parameters.values, np.full(len(bands), np.nan)])
        own = m.measurement
        found.append(
            _ObservedPair(own.source, own.receiver, own.use, values, 0.0 * values, m.curve)
        )
    for t in measurements:
        if isinstance(t, MeasuredValues):
            findings += t.findings
            values = np.stack([values_at(t, name, bands) for name in VALUE_NAMES])
            stated = replace(t, values=t.spread, spread={})
            sds = np.nan_to_num([values_at(stated, name, bands) for name in VALUE_NAMES])
            found.append(_ObservedPair(t.source, t.receiver, t.use, values, sds, None))
    return tuple(found), findings


def _longest_s(observed: Sequence[_ObservedPair]) -> float:
    """Return the longest measured decay time, T20 or T30, 0 where none is known."""
    rows = [VALUE_NAMES.index("T20_s"), VALUE_NAMES.index("T30_s")]
    known = [o.values[rows][np.isfinite(o.values[rows])] for o in observed]
    return max((float(k.max()) for k in known if k.size), default=0.0)


def _is_unknown(absorption: AbsorptionPosterior) -> BoolArray:
    """Return of which materials nothing is known before a change, (n_materials,)."""
    variance = np.diagonal(absorption.logit_covariance, axis1=1, axis2=2).T
    return np.asarray(((variance <= 0.0) & (absorption.lower95 < absorption.upper95)).any(axis=1))


# Of a mean one decay time, and the parameters by which a change is described.
_SUMMARY: tuple[tuple[ValueName, ...], ...] = (("T30_s", "T20_s", "EDT_s"), ("C80_dB",), ("G_dB",))


def _what_if(
    changes: Sequence[Change],
    observed: Sequence[_ObservedPair],
    bands: Bands,
    means: Mapping[ValueName, PredictedValue],
) -> tuple[Finding, ...]:
    if not changes:
        return ()
    sentence = f"Predicted with {', '.join(change_text(c) for c in changes)}."
    if observed:
        sentence += " Measured values beside it are those of the room as it was measured."
    directions: dict[str, dict[str, list[float]]] = {}
    for names in _SUMMARY:
        known = [n for n in names if np.isfinite(means[n].predicted).any()]
        change = means[known[0]].change if known else None
        if change is not None:
            directions[known[0]] = _directions(bands, change, known[0])
    phrases = [
        f"{name.split('_')[0]} "
        + ", ".join(f"{way} at {', '.join(f'{f:g}' for f in at)} Hz" for way, at in ways.items())
        for name, ways in directions.items()
    ]
    if phrases:
        sentence += f" At 95 % the mean of {'; of '.join(phrases)}."
    evidence = {"changes": [change_text(c) for c in changes], "directions": directions}
    return (Finding(Code.MATERIALS_CHANGED, sentence, evidence),)


def _directions(bands: Bands, change: ValueChange, name: ValueName) -> dict[str, list[float]]:
    """Return in which bands a value rises and falls at 95 %, and in which none of it is known."""
    none = 1.0 if RELATIVE[VALUE_NAMES.index(name)] else 0.0
    rises, falls = change.change_lower95 > none, change.change_upper95 < none
    ways = {"rises": rises, "falls": falls, "has no determined direction": ~(rises | falls)}
    known = np.isfinite(change.change)
    found = {way: bands.centres_hz[at & known].tolist() for way, at in ways.items()}
    return {way: at for way, at in found.items() if at}


def _predicted_pairs(
    scene: Scene,
    bands: Bands,
    numbers: Sequence[Sequence[PairNumbers]],
    observed_pairs: Sequence[_ObservedPair],
) -> tuple[PredictedPair, ...]:
    """Return every pair of the scene, once for each of its measurements, or once without."""
    found = []
    nothing = np.full((len(VALUE_NAMES), len(bands)), np.nan)
    for i, (source, receiver, _) in enumerate(pair_names(scene)):
        states = [of_state[i] for of_state in numbers]
        measured = [m for m in observed_pairs if (m.source, m.receiver) == (source, receiver)]
        rows: list[_ObservedPair | None] = [*measured] or [None]
        for m in rows:
            values, sd, mean = nothing, nothing, nothing
            if m is not None:
                others = [o.values for o in observed_pairs if o.use == "fit" and o is not m]
                values, sd, mean = m.values, m.sd, _mean(others, len(bands))
            use = None if m is None else m.use
            decay = _decay(states[0], m)
            if len(states) > 1:
                decay = replace(decay, before_db=states[1].decay.predicted_db)
            found.append(
                PredictedPair(source, receiver, use, _table(states, values, sd, mean), decay)
            )
    return tuple(found)


def predicted_means(
    scene: Scene,
    bands: Bands,
    numbers: Sequence[Sequence[PairNumbers]],
    observed_pairs: Sequence[_ObservedPair],
) -> dict[ValueName, PredictedValue]:
    """Return means over the measured pairs of each band, over all where none was measured."""
    of_pairs = [
        [m for m in observed_pairs if (m.source, m.receiver) == p[:2]] for p in pair_names(scene)
    ]
    measured = np.array([_mean([m.values for m in own], len(bands)) for own in of_pairs])
    sd = np.nan_to_num([_mean([m.sd for m in own], len(bands)) for own in of_pairs])
    chosen = np.isfinite(measured)
    for of_state in numbers:
        chosen &= np.isfinite([n.values for n in of_state])
    chosen |= ~chosen.any(axis=0)
    weights = chosen / chosen.sum(axis=0)
    observed = np.where(np.isfinite(measured).any(axis=0), _weighted(weights, measured), np.nan)
    states = [
        PairNumbers(
            _weighted(weights, np.array([n.values for n in of_state])),
            _weighted(weights[:, None], np.array([n.draws for n in of_state])),
            np.sqrt(_weighted(weights**2, np.array([n.noise_sd for n in of_state]) ** 2)),
            of_state[0].decay,
        )
        for of_state in numbers
    ]
    sd = np.sqrt(_weighted(weights**2, sd**2))
    return _table(states, observed, sd, np.full_like(observed, np.nan))


def _weighted(weights: FloatArray, values: FloatArray) -> FloatArray:
    """Sum over the first axis; what has no weight may be unknown."""
    return np.asarray(np.where(weights > 0.0, weights * values, 0.0).sum(axis=0))


def _model_sd(own: PairNumbers, row: int) -> FloatArray:
    return MODEL_ERROR_JND * jnd_of(VALUE_NAMES[row], own.values[row])


def _table(
    states: Sequence[PairNumbers],
    measured: FloatArray,
    measured_sd: FloatArray,
    mean_of_others: FloatArray,
) -> dict[ValueName, PredictedValue]:
    """Return predictions with their intervals, and what a change does where there are two states.

    Parameters
    ----------
    states : sequence of PairNumbers
        With the changes, and without where they are compared.
    measured, measured_sd, mean_of_others : float arrays, shape (n_names, n_bands)
    """
    after = states[0]
    table = {}
    for row, name in enumerate(VALUE_NAMES):
        # the model is wrong in the same way everywhere
        rest_sd = np.hypot(after.noise_sd[row], _model_sd(after, row))
        low, high = _interval(name, after.draws[:, row], rest_sd)
        table[name] = PredictedValue(
            after.values[row],
            # of several answers that explain the data alike the likeliest may lie aside of most
            np.fmin(low, after.values[row]),
            np.fmax(high, after.values[row]),
            np.std(after.draws[:, row], axis=0),
            rest_sd,
            measured[row],
            in_jnd(name, measured[row], after.values[row]),
            mean_of_others[row],
            _change(row, states[1], after, measured[row], measured_sd[row])
            if len(states) > 1
            else None,
        )
    return table


def _change(
    row: int,
    before: PairNumbers,
    after: PairNumbers,
    measured: FloatArray,
    measured_sd: FloatArray,
) -> ValueChange:
    """Return what a change does, draw by draw: the error that both states share is in neither.

    What is carried over scatters as two measurements do, each with its own interference; the error
    of the model, common to both states, is left out.
    """
    name = VALUE_NAMES[row]
    old, new, drawn_old, drawn_new = (
        before.values[row], after.values[row], before.draws[:, row], after.draws[:, row]
    )  # fmt: skip
    scatter = (before.noise_sd[row], after.noise_sd[row])
    if RELATIVE[row]:
        with np.errstate(divide="ignore", invalid="ignore"):  # unknown values
            change, drawn = new / old, drawn_new / drawn_old
            relative = np.hypot(scatter[0] / old, scatter[1] / new)
            relative = np.hypot(relative, measured_sd / measured)
        carried, carried_draws = measured * change, measured * drawn
        scatter_sd = carried * relative
    else:
        change, drawn = new - old, drawn_new - drawn_old
        carried, carried_draws = measured + change, measured + drawn
        scatter_sd = np.hypot(np.hypot(*scatter), measured_sd)
    low, high = np.quantile(drawn, (0.025, 0.975), axis=0)
    return ValueChange(
        old,
        *_interval(name, drawn_old, np.hypot(scatter[0], _model_sd(before, row))),
        change,
        # no direction is said to be determined that the likeliest absorption contradicts
        np.minimum(low, change),
        np.maximum(high, change),
        carried,
        *_interval(name, carried_draws, scatter_sd),
    )


def _interval(
    name: ValueName, draws: FloatArray, rest_sd: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the quantiles of all draws, each widened by noise, of shape (n_bands,) each."""
    wide = draws[:, None, :] + _STEPS[:, None] * rest_sd / np.std(_STEPS)
    low, high = np.quantile(wide.reshape(-1, rest_sd.size), (0.025, 0.975), axis=0)
    if RELATIVE[VALUE_NAMES.index(name)]:
        low = np.maximum(low, 0.0)
    if name == "D50_percent":
        low, high = np.clip(low, 0.0, 100.0), np.clip(high, 0.0, 100.0)
    return low, high


def _mean(rows: Sequence[FloatArray], n_bands: int) -> FloatArray:
    """Return the mean of what is known, NaN where nothing is."""
    stacked = np.ma.masked_invalid(np.array(rows).reshape(-1, len(VALUE_NAMES), n_bands))
    return np.asarray(np.ma.filled(stacked.mean(axis=0), np.nan), dtype=np.float64)


def _decay(own: PairNumbers, m: _ObservedPair | None) -> PredictedDecay:
    if m is None or m.curve is None:
        return own.decay
    usable = own.decay.time_s <= m.curve.usable_end_s[:, None]
    measured = np.where(usable, levels_at(m.curve, own.decay.time_s), np.nan)
    return replace(own.decay, measured_db=measured)
