"""Prediction of reverberation times in a room of which no position is known: a diffuse field.

The counterpart of `roomfit.predict.other_walls` for decay times alone: Sabine's, Eyring's or
another formula in place of paths. What was measured is kept, and a change carries it over.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from roomfit.base.bands import Bands
from roomfit.base.findings import About, Code, Finding
from roomfit.base.logit import Z95
from roomfit.base.typing import FloatArray
from roomfit.model.room_parameters import model_sd
from roomfit.predict import diffuse_field, prediction
from roomfit.predict.changes import Change, change_text, changed_draws
from roomfit.predict.split import prior_dominated
from roomfit.result import result_doubts
from roomfit.room.scene import Scene
from roomfit.settings import Settings
from roomfit.signals.decay import in_jnd
from roomfit.signals.iso3382 import VALUE_NAMES, ValueName
from roomfit.uncertainty.posterior import AbsorptionPosterior, draw_absorption

NAME: ValueName = "T30_s"
# Steps of equal probability by which the scatter of a measurement widens every draw.
_STEPS = np.asarray(ndtri((np.arange(16) + 0.5) / 16.0))
# Draws cost nothing without paths, and a probability of 0.9 is then known to 0.01.
_LEAST_DRAWS = 1000


@dataclass(frozen=True, slots=True, eq=False)
class PreparedField:
    """A room as a diffuse field whose walls may change: all that a change does not touch."""

    scene: Scene  # room and air; neither sources nor receivers
    field: diffuse_field.DiffuseField
    absorption: AbsorptionPosterior
    draws: FloatArray  # (n_draws, n_materials, n_bands), common to all changes
    measured_s: FloatArray  # (n_bands,), NaN where nothing was measured
    measured_sd_s: FloatArray  # (n_bands,), as `roomfit reverberation` states it
    scatter: FloatArray  # (n_bands,), relative sd of a mean over as many positions; 0: unknown
    # (n_draws, n_bands), of the logarithm of the time: the error that stays when walls change
    error: FloatArray
    # (2, n_draws, n_bands), standard normal: of what more absorption does, and what less does
    effects: FloatArray
    # (1 + n_draws, n_bands), of a flat room, by the likeliest absorption and by each draw
    scattering: FloatArray | None
    before: FloatArray  # (n_draws, n_bands), logarithm of the time by formula or directions
    seed: int
    findings: tuple[Finding, ...]


def prepare_field(
    field: diffuse_field.DiffuseField,
    scene: Scene,
    absorption: AbsorptionPosterior | None = None,
    settings: Settings | None = None,
) -> PreparedField:
    """Return a room as a diffuse field, ready for changes.

    Notes
    -----
    The logarithm of a measured time is that of the formula's at a draw of the absorption, plus an
    error that stays when walls change, plus the scatter of the mean over positions. Both are drawn
    under the condition that they add up to the departure of the measured time. A change alters that
    logarithm by the formula's difference times a positive factor (`DiffuseField.effect`): more
    absorption never lengthens the decay. In a flat room, where it may, the difference is that of
    directions (`anisotropic_times_s`), with the scattering that the time before implies. The
    scatter is that between the positions, and at least that of ISO 3382-2:2008, annex A, for T30 of
    as many.
    """
    settings = Settings() if settings is None else settings
    n_draws, rng = max(settings.n_draws, _LEAST_DRAWS), np.random.default_rng(settings.seed)
    known = diffuse_field.field_posterior(field, n_draws, rng) if absorption is None else absorption
    known.check_materials(tuple(k.name for k in field.priors))
    draws = draw_absorption(known, n_draws, rng)
    n_bands = len(field.bands)
    measured, sd, scatter = np.full(n_bands, np.nan), np.zeros(n_bands), np.zeros(n_bands)
    # in every band the same errors of the room, and a scatter of its own
    own, *effects = (np.tile(rng.standard_normal((len(draws), 1)), n_bands) for _ in range(3))
    mean, unit = field.formula_error(draws)
    sd_log = np.hypot(diffuse_field.LEAST_RELATIVE_SD, diffuse_field.ERROR_SD * unit)
    error = mean + sd_log * own
    if field.decay_s is not None:
        measured, between = diffuse_field.mean_decay(field.decay_s)
        sd = measured * np.hypot(diffuse_field.LEAST_RELATIVE_SD, between)
        n_positions = np.isfinite(field.decay_s).sum(axis=0)
        scatter = np.maximum(between, _least_scatter(field.bands, measured) / np.sqrt(n_positions))
        n = scatter * rng.standard_normal(error.shape)
        off = np.log(measured / field.times_s(draws)) - (error + n)
        error += off * sd_log**2 / (sd_log**2 + scatter**2)
    scattering, before = None, np.log(field.times_s(draws))
    if field.is_flat:
        scattering = _scattering(field, known.absorption, measured, draws, np.exp(before + error))
        directed = np.log(field.times_s(draws, scattering[1:]))
        # where no scattering gives the time, the error stays
        before, error = directed, before + error - directed
    return PreparedField(
        scene, field, known, draws, measured, sd, scatter, error,
        np.stack(effects), scattering, before, settings.seed, (_source(field), *_shape(field)),
    )  # fmt: skip


def _scattering(
    field: diffuse_field.DiffuseField,
    likeliest: FloatArray,
    measured_s: FloatArray,
    draws: FloatArray,
    drawn_s: FloatArray,
) -> FloatArray:
    """Return what times imply of the likeliest absorption, and of draws, (1 + n_draws, n_bands)."""
    usual_s = field.times_s(likeliest) * np.exp(field.formula_error(likeliest)[0])
    likeliest_s = np.where(np.isfinite(measured_s), measured_s, usual_s)
    every = np.concatenate([likeliest[None], draws])
    return field.scattering(every, np.concatenate([likeliest_s[None], drawn_s]))


def _least_scatter(bands: Bands, decay_s: FloatArray) -> FloatArray:
    """Return the relative standard deviation of T30 of one impulse response in a diffuse field."""
    width_hz = bands.centres_hz * (
        np.sqrt(0.5) if bands.kind == "octave" else 2.0 ** (1 / 6) - 2.0 ** (-1 / 6)
    )
    return np.asarray(0.55 * np.sqrt((1.0 + 1.52 / 10.0) / (width_hz * decay_s)))


def _source(field: diffuse_field.DiffuseField) -> Finding:
    unspecified = [k.name for k in field.priors if not k.specified and k.known is None]
    if field.decay_s is None:
        sentence = (
            f"Nothing was measured: this is what tables and priors say by {field.formula}'s "
            "formula, and no more."
        )
        if unspecified:
            sentence += f" Of {', '.join(unspecified)} nothing is specified at all."
        sentence += " Measured decay times ([reverberation]) would show how far off they are."
        return Finding(Code.FROM_TABLES_ALONE, About(), sentence, {"formula": field.formula})
    sentence = (
        f"From decay times and no positions: by {field.formula}'s formula the mean absorption is "
        "known, and its split over the materials by their priors alone. Only T30 is predicted."
    )
    if unspecified and len(field.priors) > 1:
        sentence += f" Of {', '.join(unspecified)} nothing is specified: a prior would help."
    return Finding(Code.FROM_DECAY_TIMES, About(), sentence, {"formula": field.formula})


def _shape(field: diffuse_field.DiffuseField) -> tuple[Finding, ...]:
    """Return a finding where most of the surface lies across one axis: no formula then holds."""
    if not field.is_flat:
        return ()
    share = field.flatness
    sentence = (
        f"{100 * share:.0f} % of the surface lies across one axis, as in a flat or a narrow room: "
        "its field is not diffuse, and no formula holds. What a change does is followed direction "
        "by direction instead, with one scattering coefficient for all walls that the decay "
        "before it implies. Measure with positions and identify."
    )
    return (Finding(Code.FIELD_NOT_DIFFUSE, About(), sentence, {"share": round(share, 3)}),)


def field_times_s(room: PreparedField, absorption: FloatArray) -> FloatArray:
    """Return likeliest times under other absorptions, shape (..., n_bands): the measured, changed.

    `absorption` has the shape (..., n_materials, n_bands).
    """
    likeliest = None if room.scattering is None else room.scattering[0]
    base = room.field.times_s(room.absorption.absorption, likeliest)
    measured = np.where(np.isfinite(room.measured_s), room.measured_s, base)
    return np.asarray(room.field.times_s(absorption, likeliest) * (measured / base))


def _drawn_s(room: PreparedField, draws: FloatArray) -> FloatArray:
    """Return the times that draws of absorption give, shape (n_draws, n_bands)."""
    more, field, before = np.maximum(room.draws, draws), room.field, room.before
    own = None if room.scattering is None else room.scattering[1:]
    most = before if np.array_equal(more, room.draws) else np.log(field.times_s(more, own))
    after = most if np.array_equal(draws, more) else np.log(field.times_s(draws, own))
    apart = np.max([field.formula_error(d)[1] for d in (room.draws, draws)], axis=0)
    apart = apart if own is None else np.zeros_like(apart)
    less, longer = (
        field.effect(difference, apart, normal)
        for difference, normal in zip((most - before, after - most), room.effects, strict=True)
    )
    return np.asarray(np.exp(before + room.error + less + longer))


def field_values(
    room: PreparedField, absorption: FloatArray, draws: FloatArray, *, is_changed: bool = True
) -> tuple[dict[ValueName, prediction.PredictedValue], FloatArray]:
    """Return T30 of a room with changed walls beside that before, and its draws.

    Shapes: `absorption` (n_materials, n_bands), `draws` (n_draws, n_materials, n_bands), `drawn_s`
    (n_draws, n_bands).
    """
    before_s, after_s = (field_times_s(room, a) for a in (room.absorption.absorption, absorption))
    drawn_before, drawn = _drawn_s(room, room.draws), _drawn_s(room, draws)
    rest_sd = np.hypot(room.scatter * after_s, model_sd(NAME, after_s))
    is_measured = np.isfinite(room.measured_s)
    low, high = _bounds(drawn, rest_sd / after_s)
    first, last = _bounds(drawn_before, np.hypot(room.scatter, model_sd(NAME, before_s) / before_s))
    stated = np.exp(Z95 * room.measured_sd_s / before_s)
    first = np.where(is_measured, before_s / stated, first)
    last = np.where(is_measured, before_s * stated, last)
    unknown = np.full(len(before_s), np.nan)
    ratio = _bounds(drawn / drawn_before, np.zeros(len(before_s)))
    change = prediction.ValueChange(
        before_s, first, last, after_s / before_s,
        np.minimum(ratio[0], after_s / before_s), np.maximum(ratio[1], after_s / before_s),
        before_s * _sabine_m2(room, room.absorption.absorption) / _sabine_m2(room, absorption),
    )  # fmt: skip
    if not is_changed:
        low, high = first, last
    value = prediction.PredictedValue(
        after_s, np.fmin(low, after_s), np.fmax(high, after_s), np.std(drawn, axis=0), rest_sd,
        room.measured_s, in_jnd(NAME, room.measured_s, before_s), unknown,
        change if is_changed else None,
    )  # fmt: skip
    return {NAME: value}, drawn


def _sabine_m2(room: PreparedField, absorption: FloatArray) -> FloatArray:
    field = room.field
    walls_m2 = field.areas_m2.sum(axis=0) @ absorption
    return np.asarray(walls_m2 + 4.0 * field.volume_m3 * field.attenuation_per_m)


def _bounds(drawn: FloatArray, relative_sd: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the quantiles of all draws, each widened by scatter, of shape (n_bands,) each."""
    wide = np.log(drawn)[:, None] + _STEPS[:, None] * relative_sd / np.std(_STEPS)
    low, high = np.quantile(np.exp(wide).reshape(-1, drawn.shape[1]), (0.025, 0.975), axis=0)
    return low, high


def in_rows(drawn_s: FloatArray) -> FloatArray:
    """Return times among all parameters, NaN but for T30: shape (..., n_names, n_bands)."""
    shape = (*drawn_s.shape[:-1], len(VALUE_NAMES), drawn_s.shape[-1])
    rows = np.full(shape, np.nan)
    rows[..., VALUE_NAMES.index(NAME), :] = drawn_s
    return rows


def predict_field(room: PreparedField, changes: Sequence[Change] = ()) -> prediction.Predicted:
    """Predict T30 of a diffuse field with changes, as `roomfit.predict` does where paths are known.

    What was measured before is kept, with its interval, and carried over by the change.
    """
    began, known = time.perf_counter(), room.absorption
    expected, drawn, doubts = changed_draws(known, room.draws, changes, room.seed)
    means, _ = field_values(room, expected, drawn, is_changed=bool(changes))
    if changes:
        areas_m2 = room.field.areas_m2.sum(axis=0)
        names = [c.material for c in changes]
        rng = np.random.default_rng(room.seed)
        doubts += prior_dominated(known, room.draws, names, areas_m2, rng, from_times=True)
    lower, upper = known.lower95.copy(), known.upper95.copy()
    at = [known.materials.index(c.material) for c in changes]
    lower[at], upper[at] = np.quantile(drawn[:, at], (0.025, 0.975), axis=0)
    found = prediction.Predicted(
        known.bands, known.materials, expected, lower, upper,
        tuple(change_text(c) for c in changes), (), means,
        (
            *result_doubts(known, room.scene.room.findings),
            *known.findings,
            *room.findings,
            *doubts,
            *prediction.change_findings(
                changes, bool(np.isfinite(room.measured_s).any()), known.bands, means
            ),
        ),
        len(drawn), room.seed, 0.0,
    )  # fmt: skip
    return replace(found, seconds=time.perf_counter() - began)
