"""What would be measured in a room, between any two points, with any walls."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

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
    PairNumbers,
    PredictedDecay,
    follow_decay,
    levels_at,
    levels_at_listener,
    pair_numbers,
    speech_bands,
)
from roomfit.scene import (
    Scene,
    material_areas_m2,
    pair_names,
    pair_states,
    position_findings,
)
from roomfit.settings import Settings
from roomfit.signals.decay import FIT_RANGES_DB, DecayCurve, in_jnd, jnd_of
from roomfit.signals.iso3382 import VALUE_NAMES, MeasuredValues, ValueName
from roomfit.signals.speech import modulation_transfer, speech_transmission, sti_missing
from roomfit.typing import BoolArray, FloatArray, Progress, part
from roomfit.uncertainty.posterior import AbsorptionPosterior, draw_absorption

_LOG = logging.getLogger("roomfit")

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
    # predicted minus measured in just noticeable differences; of a changed room what was predicted
    # before the change, NaN where that is not known
    jnd: FloatArray
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
    sti: PredictedValue | None = None  # shape (1,), where the bands give it


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
    sti: PredictedValue | None = None  # as `mean`, of shape (1,), where the bands give it

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
    speech_db: FloatArray | None = None,
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
    speech_db : float array, shape (2, 7), optional
        Octave levels from 125 Hz to 8 kHz of speech at 1 m in the free field, and of noise at the
        listeners, from `roomfit.signals.speech.speech_levels`; left out: the speech transmission
        index is that of the room, without noise, masking and threshold.
    settings : Settings, optional
        `Settings.n_draws` draws of the absorption stand behind the intervals.
    cache : Cache, optional
        Keeps the trace and the numbers of every finished pair.
    progress : callable, optional
        Called with the share of the work that is done, 0 to 1.

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
    settings = Settings() if settings is None else settings
    bands, room = absorption.bands, scene.room
    _check(scene, absorption, measurements)
    rng = np.random.default_rng(settings.seed)
    found = draw_absorption(absorption, settings.n_draws, rng)
    expected, drawn, clipped = changed_draws(absorption, found, changes, rng)
    states = [(expected, drawn)]
    changed = [room.materials.index(c.material) for c in changes]
    if changes and not is_unknown(absorption)[changed].any():
        states.append((absorption.absorption, found))
        areas_m2 = material_areas_m2(room, int(pair_states(scene)[0]))
        clipped += prior_dominated(absorption, found, changes, areas_m2, rng)
    observed, measured_findings = _observed_pairs(scene, measurements, bands)
    binned, weighed_by, decay_findings = follow_decay(
        scene,
        absorption,
        np.min([a for a, _ in states], axis=0),
        _longest_s(observed),
        settings,
        cache,
        part(progress, 0.02, 0.5),
    )
    _LOG.info("predicting")
    # of each state, the changed one first
    numbers: list[list[PairNumbers]] = [[] for _ in states]
    cache_findings: list[Finding] = []
    for i in range(len(scene.pairs)):
        for (a, d), of_state in zip(states, numbers, strict=True):
            one = cached(
                cache,
                "pair",
                (scene, weighed_by, bands, i, a, d, speech_db),
                lambda i=i, a=a, d=d: pair_numbers(  # type: ignore[misc]
                    scene, bands, binned, i, a, d, speech_db
                ),
                (PairNumbers, PredictedDecay),
            )
            of_state.append(one.value)
            cache_findings += one.findings
        if progress is not None:
            progress(0.5 + 0.5 * (i + 1) / len(scene.pairs))
    observed = _with_sti(scene, bands, observed, numbers[-1], speech_db)
    means, sti = _predicted_means(scene, numbers, observed)
    pairs = _predicted_pairs(scene, bands, numbers, observed)
    if changes and len(states) == 1:
        # the room as it was measured is not known: nothing stands beside the measurement
        pairs = tuple(
            replace(p, parameters=_without_jnd(p.parameters), sti=_without_jnd({0: p.sti})[0])
            for p in pairs
        )
        means, sti = _without_jnd(means), _without_jnd({0: sti})[0]
    lower, upper = absorption.lower95.copy(), absorption.upper95.copy()
    lower[changed], upper[changed] = np.quantile(drawn[:, changed], (0.025, 0.975), axis=0)
    return Predicted(
        bands,
        room.materials,
        expected,
        lower,
        upper,
        tuple(change_text(c) for c in changes),
        pairs,
        means,
        (
            *room.findings,
            *absorption.findings,
            *clipped,
            *measured_findings,
            *decay_findings,
            *cache_findings,
            *_what_if(changes, observed, bands, means),
        ),
        len(drawn),
        settings.seed,
        time.perf_counter() - began,
        sti,
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
    sti: float = np.nan


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


def _with_sti(
    scene: Scene,
    bands: Bands,
    observed: Sequence[_ObservedPair],
    numbers: Sequence[PairNumbers],
    speech_db: FloatArray | None,
) -> tuple[_ObservedPair, ...]:
    """Return what was measured with its speech transmission index, at the levels predicted."""
    if sti_missing(bands):
        return tuple(observed)
    at, pairs = speech_bands(bands), [p[:2] for p in pair_names(scene)]
    found = []
    for o in observed:
        if o.curve is not None:
            strength_db = numbers[pairs.index((o.source, o.receiver))].values[-1, at]
            levels_db = levels_at_listener(speech_db, strength_db)
            index = speech_transmission(modulation_transfer(o.curve)[at], levels_db)
            o = replace(o, sti=float(index))
        found.append(o)
    return tuple(found)


def _longest_s(observed: Sequence[_ObservedPair]) -> float:
    """Return the longest measured decay time, T20 or T30, 0 where none is known."""
    rows = [VALUE_NAMES.index("T20_s"), VALUE_NAMES.index("T30_s")]
    known = [o.values[rows][np.isfinite(o.values[rows])] for o in observed]
    return max((float(k.max()) for k in known if k.size), default=0.0)


def is_unknown(absorption: AbsorptionPosterior) -> BoolArray:
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
    none = 1.0 if name in FIT_RANGES_DB else 0.0
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
    unknown = np.full((1, 1), np.nan)
    for i, (source, receiver, _) in enumerate(pair_names(scene)):
        states = [of_state[i] for of_state in numbers]
        measured = [m for m in observed_pairs if (m.source, m.receiver) == (source, receiver)]
        rows: list[_ObservedPair | None] = [*measured] or [None]
        for m in rows:
            values, sd, mean, index, mean_index = nothing, nothing, nothing, unknown, unknown
            if m is not None:
                others = [o for o in observed_pairs if o.use == "fit" and o is not m]
                values, sd, mean = m.values, m.sd, _mean([o.values for o in others], nothing.shape)
                index = np.full((1, 1), m.sti)
                mean_index = _mean([np.array(o.sti) for o in others], (1, 1))
            use = None if m is None else m.use
            decay = _decay(states[0], m)
            if len(states) > 1:
                decay = replace(decay, before_db=states[1].decay.predicted_db)
            table = _table(VALUE_NAMES, states, values, sd, mean)
            of_speech = [n.sti for n in states if n.sti is not None]
            sti = None
            if of_speech:
                sti = _table(("STI",), of_speech, index, 0.0 * unknown, mean_index)["STI"]
            found.append(PredictedPair(source, receiver, use, table, decay, sti))
    return tuple(found)


def _predicted_means(
    scene: Scene,
    numbers: Sequence[Sequence[PairNumbers]],
    observed_pairs: Sequence[_ObservedPair],
) -> tuple[dict[ValueName, PredictedValue], PredictedValue | None]:
    """Return means over the measured pairs of each band, over all where none was measured."""
    of_pairs = [
        [m for m in observed_pairs if (m.source, m.receiver) == p[:2]] for p in pair_names(scene)
    ]
    shape = numbers[0][0].values.shape
    measured = np.array([_mean([m.values for m in own], shape) for own in of_pairs])
    sd = np.nan_to_num([_mean([m.sd for m in own], shape) for own in of_pairs])
    means = _mean_table(VALUE_NAMES, numbers, measured, sd)
    of_speech = [[n.sti for n in of_state if n.sti is not None] for of_state in numbers]
    if not of_speech[0]:
        return means, None
    index = np.array([_mean([np.array(m.sti) for m in own], (1, 1)) for own in of_pairs])
    return means, _mean_table(("STI",), of_speech, index, np.zeros_like(index))["STI"]


def _mean_table(
    names: Sequence[N],
    numbers: Sequence[Sequence[PairNumbers]],
    measured: FloatArray,
    measured_sd: FloatArray,
) -> dict[N, PredictedValue]:
    """Return the means of some parameters.

    Parameters
    ----------
    measured, measured_sd : float arrays, shape (n_pairs, n_names, n_bands)
    """
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
    sd = np.sqrt(_weighted(weights**2, measured_sd**2))
    return _table(names, states, observed, sd, np.full_like(observed, np.nan))


def _weighted(weights: FloatArray, values: FloatArray) -> FloatArray:
    """Sum over the first axis; what has no weight may be unknown."""
    return np.asarray(np.where(weights > 0.0, weights * values, 0.0).sum(axis=0))


def _model_sd(own: PairNumbers, row: int, name: str) -> FloatArray:
    return MODEL_ERROR_JND * jnd_of(name, own.values[row])


N = TypeVar("N", bound=str)
K = TypeVar("K")
V = TypeVar("V", PredictedValue, PredictedValue | None)


def _table(
    names: Sequence[N],
    states: Sequence[PairNumbers],
    measured: FloatArray,
    measured_sd: FloatArray,
    mean_of_others: FloatArray,
) -> dict[N, PredictedValue]:
    """Return predictions with their intervals, and what a change does where there are two states.

    Parameters
    ----------
    states : sequence of PairNumbers
        With the changes, and without where they are compared.
    measured, measured_sd, mean_of_others : float arrays, shape (n_names, n_bands)
    """
    after = states[0]
    table = {}
    for row, name in enumerate(names):
        # the model is wrong in the same way everywhere
        rest_sd = np.hypot(after.noise_sd[row], _model_sd(after, row, name))
        low, high = _interval(name, after.draws[:, row], rest_sd)
        table[name] = PredictedValue(
            after.values[row],
            # of several answers that explain the data alike the likeliest may lie aside of most
            np.fmin(low, after.values[row]),
            np.fmax(high, after.values[row]),
            np.std(after.draws[:, row], axis=0),
            rest_sd,
            measured[row],
            in_jnd(name, measured[row], states[-1].values[row]),
            mean_of_others[row],
            _change(name, row, states, measured[row], measured_sd[row])
            if len(states) > 1
            else None,
        )
    return table


def _without_jnd(table: Mapping[K, V]) -> dict[K, V]:
    return {
        name: v if v is None else replace(v, jnd=np.full_like(v.jnd, np.nan))
        for name, v in table.items()
    }


def _change(
    name: str,
    row: int,
    states: Sequence[PairNumbers],
    measured: FloatArray,
    measured_sd: FloatArray,
) -> ValueChange:
    """Return what a change does, draw by draw: the error that both states share is in neither.

    What is carried over scatters as two measurements do, each with its own interference; the error
    of the model, common to both states, is left out.
    """
    after, before = states
    old, new, drawn_old, drawn_new = (
        before.values[row], after.values[row], before.draws[:, row], after.draws[:, row]
    )  # fmt: skip
    scatter = (before.noise_sd[row], after.noise_sd[row])
    if name in FIT_RANGES_DB:
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
        *_interval(name, drawn_old, np.hypot(scatter[0], _model_sd(before, row, name))),
        change,
        # no direction is said to be determined that the likeliest absorption contradicts
        np.minimum(low, change),
        np.maximum(high, change),
        carried,
        *_interval(name, carried_draws, scatter_sd),
    )


def _interval(name: str, draws: FloatArray, rest_sd: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the quantiles of all draws, each widened by noise, of shape (n_bands,) each."""
    wide = draws[:, None, :] + _STEPS[:, None] * rest_sd / np.std(_STEPS)
    low, high = np.quantile(wide.reshape(-1, rest_sd.size), (0.025, 0.975), axis=0)
    if name in FIT_RANGES_DB:
        low = np.maximum(low, 0.0)
    if name in ("D50_percent", "STI"):
        most = 1.0 if name == "STI" else 100.0
        low, high = np.clip(low, 0.0, most), np.clip(high, 0.0, most)
    return low, high


def _mean(rows: Sequence[FloatArray], shape: tuple[int, ...]) -> FloatArray:
    """Return the mean of what is known, NaN where nothing is."""
    stacked = np.ma.masked_invalid(np.array(rows).reshape(-1, *shape))
    return np.asarray(np.ma.filled(stacked.mean(axis=0), np.nan), dtype=np.float64)


def _decay(own: PairNumbers, m: _ObservedPair | None) -> PredictedDecay:
    if m is None or m.curve is None:
        return own.decay
    usable = own.decay.time_s <= m.curve.usable_end_s[:, None]
    measured = np.where(usable, levels_at(m.curve, own.decay.time_s), np.nan)
    return replace(own.decay, measured_db=measured)
