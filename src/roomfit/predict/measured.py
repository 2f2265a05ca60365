"""Predictions that begin with what was measured in a room, with intervals that its pairs show.

A model's absolute prediction has all its errors in it. Those that a room's pairs share are seen in
the pairs that were fitted, and leave every prediction of that room; what the model says of one
place against another counts as far as it has distinguished the fitted pairs, each from all others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from roomfit.base.typing import FloatArray
from roomfit.model.eyring import diffuse_values
from roomfit.model.room_parameters import MODEL_ERROR_JND
from roomfit.predict.decay import RELATIVE, PairNumbers
from roomfit.room.mesh import volume_m3
from roomfit.room.scene import Scene, distances_m, pair_names
from roomfit.signals.decay import jnd_of
from roomfit.signals.iso3382 import VALUE_NAMES
from roomfit.uncertainty.posterior import AbsorptionPosterior

# Of each parameter, one just noticeable difference: of times in their logarithm.
_UNIT = np.array([float(jnd_of(name, np.ones(()))) for name in VALUE_NAMES])[:, None]
_IS_TIME = RELATIVE[:, None]
_D50 = VALUE_NAMES.index("D50_percent")
_DECAY = [VALUE_NAMES.index(name) for name in ("T30_s", "T20_s", "EDT_s")]
# Standard deviation, in just noticeable differences, of an error that the pairs of a room share,
# before any was measured.
_SHARED_SD = 0.5
# That counts as so many values of the kind; likewise what is known of how well the model tells
# places apart, and of how far values scatter.
_SHARED_PRIOR, _WEIGHT_PRIOR, _SCATTER_PRIOR = 3.0, 30.0, 6.0
# A departure counts as no more than so many standard deviations: a single EDT of a few
# milliseconds is no scatter of all pairs.
_MOST_SDS = 4.0

_SAME_PLACE_M = 0.05


class Anchor(NamedTuple):
    """How predictions of one pair are moved, in just noticeable differences, (n_names, n_bands)."""

    shift: FloatArray  # of every prediction, by what other pairs depart from theirs
    own: FloatArray  # what the pair itself was measured beyond that, 0 where it was not
    is_own: FloatArray  # 1 where it was measured, else 0
    scatter: FloatArray  # on the variance of the noise
    shared_sd: FloatArray  # of the error that all pairs share
    kept: FloatArray  # of what a draw of the walls changes before a change: the share it cancels

    def without_own(self) -> Anchor:
        """Return how a prediction is moved by the other pairs alone."""
        return self._replace(own=0.0 * self.own, is_own=0.0 * self.is_own)


def in_units(values: FloatArray) -> FloatArray:
    """Return room parameters (..., n_names, n_bands), times as logarithms, in noticeable steps."""
    with np.errstate(divide="ignore", invalid="ignore"):  # unknown values
        logs = np.log(np.where(_IS_TIME, values, 1.0))
    return np.asarray(np.where(_IS_TIME, logs, values) / _UNIT)


def from_units(values: FloatArray) -> FloatArray:
    """Return the inverse of `in_units`, within the range of each parameter."""
    scaled = values * _UNIT
    found = np.where(_IS_TIME, np.exp(np.where(_IS_TIME, scaled, 0.0)), scaled)
    for name, most in (("D50_percent", 100.0), ("TS_ms", np.inf)):
        row = VALUE_NAMES.index(name)
        found[..., row, :] = np.clip(found[..., row, :], 0.0, most)
    return found


class _State(NamedTuple):
    """Fitted pairs of one state of a room."""

    names: tuple[tuple[str, str], ...]
    distance_m: FloatArray  # (n_pairs,)
    measured: FloatArray  # (n_pairs, n_names, n_bands), as `in_units`
    off: FloatArray  # (2, n_pairs, n_names, n_bands), from the model and from a diffuse field
    decay_s: FloatArray  # (n_bands,)


def _states(known: AbsorptionPosterior, volume: float) -> dict[str, _State]:
    """Return the fitted pairs by state."""
    found = {}
    for state in dict.fromkeys(p.state for p in known.fitted):
        own = [p for p in known.fitted if p.state == state]
        measured = in_units(np.array([p.measured for p in own]))
        means = from_units(_mean(measured))[_DECAY]
        decay_s = next((m for m in means if np.isfinite(m).any()), means[0])
        distance_m = np.array([p.distance_m for p in own])
        by_model = in_units(np.array([p.predicted for p in own]))
        off = measured - [by_model, in_units(diffuse_values(decay_s, volume, distance_m))]
        names = tuple((p.source, p.receiver) for p in own)
        found[state] = _State(names, distance_m, measured, off, decay_s)
    return found


def anchors(
    known: AbsorptionPosterior, scene: Scene, numbers: Sequence[PairNumbers]
) -> tuple[Anchor, ...]:
    """Return how predictions of the pairs of a scene, all in one state, begin with measurements.

    Notes
    -----
    Measured values y of fitted pairs depart from the model f by an error e that they share, of a
    variance v, and by noise of the variance s^2, of interference and rays: e is the share
    ``n v / (n v + s^2)`` of their mean departure. Likewise they depart from the law d of a diffuse
    field with the measured decay time (`diffuse_values`). A pair that was not fitted is expected at
    ``w (f + e) + (1 - w) (d + e')``. Over all bands, and either decay times or all else, v is what
    the mean departures show, and w explains the fitted pairs best, each by the others alone [1]_;
    what is left of these departures gives the scatter. A state of the room that was not fitted has
    no such law, and the mean error of the fitted ones.

    References
    ----------
    .. [1] D. H. Wolpert, "Stacked generalization", Neural Networks 5, 241-259 (1992).
    """
    names, values = pair_names(scene), in_units(np.array([n.values for n in numbers]))
    noise = _mean(np.array([_noise_in_units(n) for n in numbers]) ** 2)
    nothing, state = np.zeros(noise.shape), names[0][2]
    if not known.fitted:
        model = np.full(noise.shape, MODEL_ERROR_JND)
        return (Anchor(nothing, nothing, nothing, nothing + 1.0, model, nothing),) * len(names)
    volume = volume_m3(scene.room.mesh)
    states = _states(known, volume)
    variance = _shared_variance(list(states.values()), noise)
    errors = {s: _shared_errors(own.off, noise, variance) for s, own in states.items()}
    left = {s: own.off - errors[s][1] for s, own in states.items()}
    weight = _weights(np.concatenate(list(left.values()), axis=1), noise)
    rest = {s: _mixed(off, weight) for s, off in left.items()}
    scatter = _scatter(np.concatenate(list(rest.values())), noise)
    if known.is_other_room or state not in states:
        counts = [_count(own.off[0]) for own in states.values()]
        left_open = 1.0 - np.mean([_share(n, noise, variance[0]) for n in counts], axis=0)
        each = np.array([e[0][0] for e in errors.values()])
        shift = nothing if known.is_other_room else each.mean(axis=0)
        least = MODEL_ERROR_JND if known.is_other_room else _SHARED_SD
        between = (least**2 + np.sum((each - shift) ** 2, axis=0)) / len(each)
        shared = np.sqrt(between + scatter * left_open * variance[0])
        return (Anchor(shift, nothing, nothing, scatter, shared, nothing),) * len(names)
    here = states[state]
    kept = _share(_count(here.off[0]), noise, variance[0])
    shared = np.sqrt(scatter * (1.0 - kept) * variance[0])
    # what walls leave open between two places, departures of two pairs and more show by themselves
    kept = np.where(_count(states[state].off[0]) > 1.0, 1.0, kept)
    distance_m = distances_m(scene)
    law = in_units(diffuse_values(here.decay_s, volume, distance_m))
    expected = _mixed(np.stack([values, law]) + errors[state][0][:, None], weight)
    found = []
    for i, name in enumerate(names):
        shift, own, is_own = expected[i] - values[i], nothing, nothing
        # the same names at other places are another pair; old files do not say where it was
        near = ~(np.abs(here.distance_m - distance_m[i]) > _SAME_PLACE_M)
        rows = [k for k, other in enumerate(here.names) if other == name[:2] and near[k]]
        if rows:
            # what other pairs say of this one, as its recording lets it be evaluated
            measured = _mean(here.measured[rows])
            alone = _mean((here.measured - rest[state])[rows]) - values[i]
            is_known = np.isfinite(measured) & np.isfinite(alone)
            shift = np.where(is_known, alone, shift)
            own = np.where(is_known, measured - values[i] - shift, 0.0)
            is_own = is_known.astype(np.float64)
        found.append(Anchor(np.nan_to_num(shift), own, is_own, scatter, shared, kept))
    return tuple(found)


def anchored(after: PairNumbers, before: PairNumbers, anchor: Anchor) -> PairNumbers:
    """Return predictions of a pair that begin with what was measured before walls changed.

    Errors that the walls leave stay with it; of what its own measurement departs, as much as its
    noise has in common with that before. Where nothing changed, `after` is `before`.
    """
    first, noise = in_units(before.values), _noise_in_units(before)
    same = np.ones(first.shape)
    if after is not before:
        unit = _unit_at(after.values) * _unit_at(before.values)
        with np.errstate(divide="ignore", invalid="ignore"):  # unknown values, no noise
            same = np.nan_to_num(np.clip(after.common_noise / unit / noise**2, 0.0, 1.0), nan=1.0)
    shift = anchor.shift + same * anchor.own
    values = from_units(in_units(after.values) + shift)
    # walls under the condition that they give what was measured before
    off, drawn = in_units(before.draws) - first, in_units(after.draws)
    off = off - off.mean(axis=0)
    variance = np.mean(off**2, axis=0)
    both = np.mean(off * drawn, axis=0)
    slope = np.divide(both, variance, out=np.zeros_like(both), where=variance > 0.0)
    draws = from_units(drawn + shift - anchor.kept * slope * (in_units(before.draws) - first))
    left = 1.0 - anchor.is_own * same**2
    scatter_sd = after.noise_sd * np.sqrt(anchor.scatter)
    sti = after.sti
    if sti is not None:  # early against late energy, too, over all octaves
        of_speech = float(np.nanmean(anchor.scatter[_D50]))
        sti_sd = sti.noise_sd * np.sqrt(of_speech)
        step = float(jnd_of("STI", np.ones(())) * np.nanmean(shift[_D50]))
        index, of_draws = (np.clip(x + step, 0.0, 1.0) for x in (sti.values, sti.draws))
        sti = replace(sti, values=index, draws=of_draws, noise_sd=sti_sd, scatter_sd=sti_sd)
    return replace(
        after,
        values=values,
        draws=draws,
        noise_sd=scatter_sd * np.sqrt(left),
        common_noise=after.common_noise * anchor.scatter,
        shared_sd=anchor.shared_sd * (1.0 - anchor.is_own * same) * _unit_at(values),
        scatter_sd=scatter_sd,
        sti=sti,
    )


def given_others(numbers: PairNumbers, others: FloatArray) -> PairNumbers:
    """Return predictions whose draws give what was measured in other states of the room.

    By regression of the parameters on the same ones there. Shapes: `others` (n_states, 1 + n_draws,
    n_names, n_bands), the first by the likeliest absorption.
    """
    there = in_units(others)
    off = np.nan_to_num(there[:, 1:] - there[:, :1])
    off -= off.mean(axis=1, keepdims=True)
    drawn = in_units(numbers.draws)
    own = np.nan_to_num(drawn - np.mean(drawn, axis=0))
    squares = np.einsum("sdnb,tdnb->nbst", off, off)
    least = 1e-9 * np.trace(squares, axis1=2, axis2=3)[..., None, None] + 1e-300
    both = np.einsum("sdnb,dnb->nbs", off, own)
    slopes = np.linalg.solve(squares + least * np.eye(len(off)), both[..., None])[..., 0]
    return replace(numbers, draws=from_units(drawn - np.einsum("sdnb,nbs->dnb", off, slopes)))


def _unit_at(values: FloatArray) -> FloatArray:
    """Return a just noticeable difference of room parameters, in their own units."""
    return np.asarray(np.where(_IS_TIME, values, 1.0) * _UNIT)


def _noise_in_units(numbers: PairNumbers) -> FloatArray:
    return np.asarray(numbers.noise_sd / _unit_at(numbers.values))


def _count(off: FloatArray) -> FloatArray:
    return np.asarray(np.isfinite(off).sum(axis=0), dtype=np.float64)


def _share(count: FloatArray, noise: FloatArray, variance: FloatArray) -> FloatArray:
    """Return the share of a mean over some departures that is due to the error they share."""
    return np.asarray(count * variance / (count * variance + noise))


def _shared_variance(states: Sequence[_State], noise: FloatArray) -> FloatArray:
    """Return the variance of the errors that pairs share, (2, n_names, 1), as means show it."""
    found = np.empty((2, len(RELATIVE), 1))
    for which, rows in ((w, r) for w in range(2) for r in (RELATIVE, ~RELATIVE)):
        excess = [
            _mean(s.off[which]) ** 2 - noise / np.maximum(_count(s.off[which]), 1.0) for s in states
        ]
        known = np.array(excess)[:, rows]
        known = known[np.isfinite(known)]
        sum_of_squares = _SHARED_PRIOR * _SHARED_SD**2 + float(known.sum())
        least = 0.25 * _SHARED_SD**2
        found[which, rows] = max(sum_of_squares / (_SHARED_PRIOR + known.size), least)
    return found


def _shared_errors(
    off: FloatArray, noise: FloatArray, variance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the error that departures share, by all of them and by the others of each.

    Shapes: `off` (2, n_pairs, n_names, n_bands), `variance` (2, n_names, 1), what comes back
    (2, n_names, n_bands) and as `off`.
    """
    known = np.isfinite(off)
    count, total = known.sum(axis=1), np.where(known, off, 0.0).sum(axis=1)
    others = count[:, None] - known
    of_others = (total[:, None] - np.where(known, off, 0.0)) / np.maximum(others, 1)
    shares = _share(count, noise, variance), _share(others, noise, variance[:, None])
    return shares[0] * total / np.maximum(count, 1), shares[1] * of_others


def _weights(left: FloatArray, noise: FloatArray) -> FloatArray:
    """Return the weight of the model by parameter, against a diffuse field, (n_names, 1).

    Shapes: `left` (2, n_pairs, n_names, n_bands), departures of each pair by the other pairs.
    """
    own, apart = left[1] / np.sqrt(noise), (left[1] - left[0]) / np.sqrt(noise)
    known = np.isfinite(own * apart)
    own, apart = np.where(known, own, 0.0), np.where(known, apart, 0.0)
    found = np.ones(len(RELATIVE))
    for rows in (RELATIVE, ~RELATIVE):
        size, count = float(np.sum(apart[:, rows] ** 2)), float(known[:, rows].sum())
        if size > 0.0:
            prior = _WEIGHT_PRIOR * size / count
            slope = (float(np.sum((own * apart)[:, rows])) + 0.5 * prior) / (size + prior)
            found[rows] = np.clip(slope, 0.0, 1.0)
    return found[:, None]


def _mixed(of_both: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the model's and the diffuse field's values as one; the model's where that has none."""
    model, diffuse = of_both
    return np.asarray(
        np.where(np.isfinite(diffuse), weight * model + (1.0 - weight) * diffuse, model)
    )


def _scatter(rest: FloatArray, noise: FloatArray) -> FloatArray:
    """Return by which factor departures scatter more than noise, in variance, (n_names, n_bands).

    The mean of its posterior under an inverse chi-square prior [1]_: of a band about that of its
    parameter, of this about that of its kind, and of that about the theory of the noise.

    References
    ----------
    .. [1] A. Gelman et al., Bayesian Data Analysis, 3rd ed. (2013), section 2.6.
    """
    squares = np.minimum(rest**2 / noise, _MOST_SDS**2)
    known = np.isfinite(squares)
    count, total = known.sum(axis=0), np.where(known, squares, 0.0).sum(axis=0)

    def about(prior: FloatArray | float, sums: FloatArray, counts: FloatArray) -> FloatArray:
        return np.asarray((_SCATTER_PRIOR * prior + sums) / (_SCATTER_PRIOR + counts))

    found = np.empty(noise.shape)
    for rows in (RELATIVE, ~RELATIVE):
        of_kind = about(1.0, total[rows].sum(), count[rows].sum())
        of_name = about(of_kind, total[rows].sum(axis=1), count[rows].sum(axis=1))
        found[rows] = about(of_name[:, None], total[rows], count[rows])
    return found


def _mean(values: FloatArray) -> FloatArray:
    """Return the mean over the first axis of what is known, NaN where nothing is."""
    known = np.isfinite(values)
    with np.errstate(invalid="ignore"):  # nothing is known
        return np.asarray(np.where(known, values, 0.0).sum(axis=0) / known.sum(axis=0))
