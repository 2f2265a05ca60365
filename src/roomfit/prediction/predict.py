"""What would be measured in a room, between any two points, with any walls."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
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
from roomfit.prediction.changes import Change, change_text, changed_draws
from roomfit.prediction.decay import (
    RELATIVE,
    PairNumbers,
    PredictedDecay,
    follow_decay,
    levels_at,
    pair_numbers,
)
from roomfit.scene import Scene, position_findings
from roomfit.settings import Settings
from roomfit.signals.decay import DecayCurve, in_jnd, jnd_of
from roomfit.signals.iso3382 import VALUE_NAMES, MeasuredValues, ValueName
from roomfit.typing import FloatArray, Progress, part
from roomfit.uncertainty.posterior import AbsorptionPosterior, draw_absorption

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Steps of equal probability by which noise widens every draw.
_STEPS = np.asarray(ndtri((np.arange(16) + 0.5) / 16.0))


@dataclass(frozen=True, slots=True, eq=False)
class PredictedValue:
    """One room parameter in every band; all arrays of shape (n_bands,), NaN where unknown."""

    # at the most likely absorption; at the nearer end of the interval where it lies outside
    predicted: FloatArray
    lower95: FloatArray  # a measurement is expected between these two, 95 of 100 times
    upper95: FloatArray
    sd_absorption: FloatArray  # part of the spread, from what is not known of the absorption
    # part of the spread, from reflections that interfere, from the number of rays, and from the
    # error that the model is granted
    sd_rest: FloatArray
    measured: FloatArray
    jnd: FloatArray  # predicted minus measured in just noticeable differences
    mean_of_others: FloatArray  # over the other fitted measurements: a baseline


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
    settings = Settings() if settings is None else settings
    bands, room = absorption.bands, scene.room
    _check(scene, absorption, measurements)
    rng = np.random.default_rng(settings.seed)
    drawn = draw_absorption(absorption, settings.n_draws, rng)
    expected, drawn, clipped = changed_draws(absorption, drawn, changes, rng)
    observed, measured_findings = _observed_pairs(scene, measurements, bands)
    binned, weighed_by, decay_findings = follow_decay(
        scene,
        absorption,
        expected,
        _longest_s(observed),
        settings,
        cache,
        part(progress, 0.02, 0.5),
    )
    numbers: list[PairNumbers] = []
    cache_findings: list[Finding] = []
    for i in range(len(scene.pairs)):
        one = cached(
            cache,
            "pair",
            (scene, weighed_by, bands, i, expected, drawn),
            lambda i=i: pair_numbers(scene, bands, binned, i, expected, drawn),  # type: ignore[misc]
            (PairNumbers, PredictedDecay),
        )
        numbers.append(one.value)
        cache_findings += one.findings
        if progress is not None:
            progress(0.5 + 0.5 * (i + 1) / len(scene.pairs))
    lower, upper = absorption.lower95.copy(), absorption.upper95.copy()
    changed = [room.materials.index(c.material) for c in changes]
    lower[changed], upper[changed] = np.quantile(drawn[:, changed], (0.025, 0.975), axis=0)
    return Predicted(
        bands,
        room.materials,
        expected,
        lower,
        upper,
        tuple(change_text(c) for c in changes),
        _predicted_pairs(scene, bands, numbers, observed),
        _predicted_means(scene, bands, numbers, observed),
        (
            *room.findings,
            *absorption.findings,
            *clipped,
            *measured_findings,
            *decay_findings,
            *cache_findings,
            *_what_if(changes, observed),
        ),
        len(drawn),
        settings.seed,
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
    pairs = _pair_names(scene)
    for m in measurements:
        if (m.source, m.receiver) not in pairs:
            raise InputError(
                "a measurement of a pair that is not predicted",
                found=f"{m.source} to {m.receiver}",
                needed="a pair of the scene",
            )


def _pair_names(scene: Scene) -> list[tuple[str, str]]:
    return [(scene.sources[s].name, scene.receivers[r].name) for s, r in scene.pairs]


@dataclass(frozen=True, slots=True, eq=False)
class _ObservedPair:
    """What was measured of a pair."""

    source: str
    receiver: str
    use: Use
    values: FloatArray  # (n_names, n_bands), in the order of VALUE_NAMES, NaN where unknown
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
        found.append(_ObservedPair(own.source, own.receiver, own.use, values, m.curve))
    for t in measurements:
        if isinstance(t, MeasuredValues):
            findings += t.findings
            values = np.stack([values_at(t, name, bands) for name in VALUE_NAMES])
            found.append(_ObservedPair(t.source, t.receiver, t.use, values, None))
    return tuple(found), findings


def _longest_s(observed: Sequence[_ObservedPair]) -> float:
    """Return the longest measured decay time, T20 or T30, 0 where none is known."""
    rows = [VALUE_NAMES.index("T20_s"), VALUE_NAMES.index("T30_s")]
    known = [o.values[rows][np.isfinite(o.values[rows])] for o in observed]
    return max((float(k.max()) for k in known if k.size), default=0.0)


def _what_if(changes: Sequence[Change], observed: Sequence[_ObservedPair]) -> tuple[Finding, ...]:
    if not changes:
        return ()
    listed = ", ".join(change_text(c) for c in changes)
    beside = (
        " Measured values beside it are those of the room as it was measured." if observed else ""
    )
    return (
        Finding(
            Code.MATERIALS_CHANGED,
            f"Predicted with {listed}.{beside}",
            {"changes": [change_text(c) for c in changes]},
        ),
    )


def _predicted_pairs(
    scene: Scene,
    bands: Bands,
    numbers: Sequence[PairNumbers],
    observed_pairs: Sequence[_ObservedPair],
) -> tuple[PredictedPair, ...]:
    """Return every pair of the scene, once for each of its measurements, or once without."""
    found = []
    for names, own in zip(_pair_names(scene), numbers, strict=True):
        measured = [m for m in observed_pairs if (m.source, m.receiver) == names]
        rows: list[_ObservedPair | None] = [*measured] or [None]
        for m in rows:
            table: dict[ValueName, PredictedValue] = {}
            for row, name in enumerate(VALUE_NAMES):
                others = [o.values[row] for o in observed_pairs if o.use == "fit" and o is not m]
                nothing = np.full(len(bands), np.nan)
                values = nothing if m is None else m.values[row]
                mean = nothing if m is None else _mean(others, len(bands))
                rest_sd = np.hypot(own.noise_sd[row], _model_sd(own, row))
                drawn = own.draws[:, row]
                table[name] = _value(name, own.values[row], drawn, rest_sd, values, mean)
            use = None if m is None else m.use
            found.append(PredictedPair(*names, use, table, _decay(own, m)))
    return tuple(found)


def _predicted_means(
    scene: Scene,
    bands: Bands,
    numbers: Sequence[PairNumbers],
    observed_pairs: Sequence[_ObservedPair],
) -> dict[ValueName, PredictedValue]:
    """Return means over the measured pairs of each band, over all where none was measured."""
    index = {names: i for i, names in enumerate(_pair_names(scene))}
    table: dict[ValueName, PredictedValue] = {}
    for row, name in enumerate(VALUE_NAMES):
        measured = np.full((len(numbers), len(bands)), np.nan)
        for i in range(len(numbers)):
            own = [m.values[row] for m in observed_pairs if index[m.source, m.receiver] == i]
            measured[i] = _mean(own, len(bands))
        predicted = np.array([n.values[row] for n in numbers])
        chosen = np.isfinite(measured) & np.isfinite(predicted)
        chosen |= ~chosen.any(axis=0)
        weights = chosen / chosen.sum(axis=0)
        drawn = _weighted(weights[:, None], np.array([n.draws[:, row] for n in numbers]))
        noise = _weighted(weights**2, np.array([n.noise_sd[row] for n in numbers]) ** 2)
        # the model is wrong in the same way everywhere
        model_sd = _weighted(weights, np.array([_model_sd(n, row) for n in numbers]))
        rest_sd = np.hypot(np.sqrt(noise), model_sd)
        observed = np.where(np.isfinite(measured).any(axis=0), _weighted(weights, measured), np.nan)
        nothing = np.full(len(bands), np.nan)
        mean = _weighted(weights, predicted)
        table[name] = _value(name, mean, drawn, rest_sd, observed, nothing)
    return table


def _weighted(weights: FloatArray, values: FloatArray) -> FloatArray:
    """Sum over the first axis; what has no weight may be unknown."""
    return np.asarray(np.where(weights > 0.0, weights * values, 0.0).sum(axis=0))


def _model_sd(own: PairNumbers, row: int) -> FloatArray:
    return MODEL_ERROR_JND * jnd_of(VALUE_NAMES[row], own.values[row])


def _value(
    name: ValueName,
    values: FloatArray,
    draws: FloatArray,
    rest_sd: FloatArray,
    measured: FloatArray,
    mean_of_others: FloatArray,
) -> PredictedValue:
    """Return a prediction with its interval: the quantiles of all draws, each widened by noise."""
    wide = draws[:, None, :] + _STEPS[:, None] * rest_sd / np.std(_STEPS)
    low, high = np.quantile(wide.reshape(-1, rest_sd.size), (0.025, 0.975), axis=0)
    if RELATIVE[VALUE_NAMES.index(name)]:
        low = np.maximum(low, 0.0)
    if name == "D50_percent":
        low, high = np.clip(low, 0.0, 100.0), np.clip(high, 0.0, 100.0)
    # of several answers that explain the data alike the likeliest may lie aside of most others
    values = np.clip(values, low, high)
    return PredictedValue(
        values,
        low,
        high,
        np.std(draws, axis=0),
        rest_sd,
        measured,
        in_jnd(name, measured, values),
        mean_of_others,
    )


def _mean(rows: Sequence[FloatArray], n_bands: int) -> FloatArray:
    """Return the mean of what is known, NaN where nothing is."""
    stacked = np.ma.masked_invalid(np.array(rows).reshape(-1, n_bands))
    return np.asarray(np.ma.filled(stacked.mean(axis=0), np.nan), dtype=np.float64)


def _decay(own: PairNumbers, m: _ObservedPair | None) -> PredictedDecay:
    if m is None or m.curve is None:
        return own.decay
    usable = own.decay.time_s <= m.curve.usable_end_s[:, None]
    measured = np.where(usable, levels_at(m.curve, own.decay.time_s), np.nan)
    return replace(own.decay, measured_db=measured)
