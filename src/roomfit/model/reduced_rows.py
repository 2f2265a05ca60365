"""Fewer paths of one pair in wider bins, which tell what changes between absorptions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from roomfit.base.bands import Bands
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.model.energy import squared_image_rows
from roomfit.model.weighing import EnergyRows, taken_rows, weigh_points
from roomfit.signals import speech
from roomfit.signals.decay import DecayCurve, echogram_decay_curve
from roomfit.signals.iso3382 import VALUE_NAMES, value_gradients, values_of_bins

# Differences between absorptions are read from so many rows, in bins of a millisecond.
ROWS_OF_A_DRAW, ROWS_OF_A_CASE = 5_000, 600
BINS_TOGETHER = 10
# What comes after this fall of the decay is extrapolated.
_FOLLOWED_DB = 55.0


@dataclass(frozen=True, slots=True, eq=False)
class ReducedRows:
    """Paths of one pair, fewer and in wide bins: for differences between many absorptions.

    5,000 of 290,000 tell a change of T30 by 45 just noticeable differences within a quarter of one.
    """

    bands: Bands
    edges_s: FloatArray  # (n_bins + 1,)
    direct_s: float
    by_band: tuple[EnergyRows, ...]  # with the air in their weights

    def in_bands(self, at: IntArray) -> ReducedRows:
        """Return the rows of some bands, given by their indices."""
        chosen = Bands(self.bands.kind, self.bands.centres_hz[at])
        return replace(self, bands=chosen, by_band=tuple(self.by_band[b] for b in at))

    def energies(self, absorptions: FloatArray) -> FloatArray:
        """Return the energies under several absorptions, (n_points, n_bands, n_bins)."""
        bands = range(len(self.by_band))
        return np.stack([self.band_energies(b, absorptions[:, :, b]) for b in bands], axis=1)

    def band_energies(self, band: int, absorptions: FloatArray) -> FloatArray:
        """Return those of one band, (n_points, n_bins), of absorptions (n_points, n_materials)."""
        energies = weigh_points(self.by_band[band], absorptions)
        # a wall that absorbs all leaves later bins empty: too little to matter, but not nothing
        return np.asarray(np.maximum(energies, 1e-30 * energies.sum(axis=1, keepdims=True)))

    def values(self, energies: FloatArray) -> FloatArray:
        """Return the room parameters of such energies, shape (n_points, n_names, n_bands)."""
        bands = enumerate(energies.transpose(1, 0, 2))
        return np.stack([self.band_values(b, own) for b, own in bands], axis=2)

    def band_values(self, band: int, energies: FloatArray) -> FloatArray:
        """Return those of one band, (n_points, n_names), of energies (n_points, n_bins)."""
        rows = self.by_band[band]
        n = int(np.searchsorted(rows.offsets, len(rows)))  # bins with a row
        own = np.ascontiguousarray(energies[:, :n])
        return values_of_bins(own, np.ones(1), self.edges_s[: n + 1], self.direct_s)

    def modulation(self, energies: FloatArray) -> FloatArray:
        """Return the modulation transfer of energies (..., n_bins), shape (..., 14)."""
        return speech.transfer_of_bins(energies, self.edges_s)

    def sti(
        self, energies: FloatArray, values: FloatArray, speech_db: FloatArray | None
    ) -> FloatArray:
        """Return the speech transmission index of energies, (n_points,); NaN in other bands."""
        if speech.sti_missing(self.bands):
            return np.full(len(energies), np.nan)
        at = speech.speech_bands(self.bands)
        transfer = self.modulation(energies[:, at])
        return speech.speech_transmission(
            transfer, speech.levels_at_listener(speech_db, values[:, -1, at])
        )

    def decay(self, energies: FloatArray) -> DecayCurve:
        """Return the decay curves of energies (n_bands, n_bins)."""
        return echogram_decay_curve(self.bands, energies, self.edges_s, self.direct_s)

    def scatter_correlation(
        self, before: FloatArray, after: FloatArray, exchanged: BoolArray
    ) -> FloatArray:
        """Return how alike reflections interfere before and after a change, (n_names, n_bands).

        1 where nothing changes, towards 0 where other walls return the energy. Pressures of paths
        with the energies ``e_i`` before and ``f_i`` after, of random phases, bring energies with
        the covariance ``(sum_i sqrt(e_i f_i))^2``, less what single paths bring, over paths that
        meet no wall that is exchanged: the phase that another material reflects with is not known.
        """
        # a wall that absorbs all leaves the paths that never meet it
        kept = np.sqrt((1.0 - before) * (1.0 - after))
        avoiding = np.where(exchanged[:, None], 1.0, 1.0 - kept)
        states = np.stack([before, after, avoiding])
        energies = self.energies(states)
        found = np.ones((len(VALUE_NAMES), len(self.bands)))
        curves = [self.decay(e) for e in energies[:2]]
        for band, rows in enumerate(self.by_band):
            if not exchanged.any() and np.array_equal(before[:, band], after[:, band]):
                continue
            single = weigh_points(squared_image_rows(rows), states[:, :, band])
            variance = np.maximum(energies[:, band] ** 2 - single, 0.0)
            old, new = (value_gradients(c, band, VALUE_NAMES)[1] for c in curves)
            alone = (old**2 @ variance[0]) * (new**2 @ variance[1])
            found[:, band] = np.divide(
                (old * new) @ variance[2],
                np.sqrt(alone),
                out=np.ones(len(found)),
                where=alone > 0.0,
            )
        return np.clip(found, 0.0, 1.0)


def reduced(rows: EnergyRows, absorption: FloatArray, most: int) -> EnergyRows:
    """Return a reduced set of rows that reproduces the energies for several absorptions.

    The cases are an absorption, each of its walls changed, and all of them. In every stretch of ten
    bins rows are drawn with the largest share that they have of the energy in any case; then
    weights move as little as it takes to bring the energies of all rows: J.-C. Deville, C.-E.
    Sarndal, "Calibration estimators in survey sampling", J. Am. Stat. Assoc. 87, 376-382 (1992).
    """
    if len(rows) <= most:
        return rows
    far = np.where(absorption < 0.4, 0.6, 0.15)
    cases = np.vstack(
        [absorption, np.where(np.eye(len(far), dtype=np.bool_), far, absorption), far]
    )
    # a case a row: sums along rows are four times as fast as across them
    energy = np.exp(np.log(np.maximum(1.0 - cases, 1e-9)) @ rows.hits.T)
    energy *= rows.weight_per_m2
    last = _followed_windows(rows, energy)
    ends = rows.offsets[np.append(np.arange(0, last, BINS_TOGETHER), last)]
    weight, n_each = np.zeros(len(rows)), most / (ends.size - 1)
    for begin, end in pairwise(ends.tolist()):
        weight[begin:end] = _calibrated(energy[:, begin:end], n_each)
    kept = np.flatnonzero(weight)
    few = taken_rows(rows, kept)
    return replace(few, weight_per_m2=few.weight_per_m2 * weight[kept], n_batches=0, path=None)


def _followed_windows(rows: EnergyRows, energy: FloatArray) -> int:
    """Return the window in which what comes after is too little in all cases, (n_cases, n_rows)."""
    filled = np.flatnonzero(np.diff(rows.offsets))
    starts = rows.offsets[filled]
    after = np.cumsum(np.add.reduceat(energy, starts, axis=1)[:, ::-1], axis=1)[:, ::-1]
    least = 10.0 ** (-0.1 * _FOLLOWED_DB) * after[:, 0]
    first = int(np.argmax(np.append(np.all(after < least[:, None], axis=0), True)))
    # its rows are too little from some of them on where those after it are
    if first > 0:
        end = len(rows) if first == filled.size else starts[first]
        beyond = np.zeros(len(energy)) if first == filled.size else after[:, first]
        own = energy[:, starts[first - 1] : end]
        rest = np.cumsum(own[:, ::-1], axis=1) + beyond[:, None]
        if np.any(np.all(rest < least[:, None], axis=0)):
            return int(filled[first - 1])
    return rows.n_windows if first == filled.size else int(filled[first])


def _calibrated(energy: FloatArray, n_each: float) -> FloatArray:
    """Return factors on the rows of one stretch, 0 for those that are left out.

    `energy` has the shape (n_cases, n_rows); about `n_each` rows are to be kept.
    """
    total = energy.sum(axis=1)
    share = energy * np.divide(1.0, total, out=0.0 * total, where=total > 0.0)[:, None]
    size = share.max(axis=0, initial=0.0)
    chance, rest = np.zeros(size.size), size.copy()
    for _ in range(4):  # what is certain leaves more for the others
        is_sure = chance >= 1.0
        n_sure = np.count_nonzero(is_sure)
        rest[is_sure] = 0.0
        chance = max(n_each - n_sure, 1.0) * rest / max(rest.sum(), 1e-300)
        chance[is_sure] = 1.0
        if not n_sure and not np.any(chance >= 1.0):
            break
    chance = np.minimum(chance, 1.0)
    taken = np.diff(np.floor(np.cumsum(chance) + 0.5), prepend=0.0) > 0.0
    z, c = share[:, taken], 1.0 / chance[taken]
    shift = np.linalg.lstsq((z * c) @ z.T, (total > 0.0) - z @ c, rcond=1e-6)[0]
    weight = np.zeros(size.size)
    weight[taken] = c * np.clip(1.0 + shift @ z, 0.2, 5.0)
    return weight
