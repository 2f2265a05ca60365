"""What was measured before a change, carried over to the room after it.

A measured value departs from its prediction for two reasons. What the model or the absorption is
wrong by stays when walls change and is carried over. How reflections happen to interfere at a
position changes with them: carried over, it would only be another error.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roomfit.bands import Bands
from roomfit.objective.energy import squared_image_rows
from roomfit.prediction.decay import FewRows, PairNumbers, few_energies
from roomfit.response.energy import weigh_points
from roomfit.signals.decay import echogram_decay_curve
from roomfit.signals.iso3382 import VALUE_NAMES, value_gradients
from roomfit.typing import FloatArray

# Of the absorption of one material from one laboratory to the next, about (ISO 12999-2).
_SAME_MATERIAL_SD = 0.05


def with_common_noise(
    after: PairNumbers,
    before: PairNumbers,
    few: FewRows,
    bands: Bands,
    absorption: FloatArray,
    changed: FloatArray,
) -> PairNumbers:
    """Return the numbers of a pair after a change with what its noise has in common with before.

    Parameters
    ----------
    few : FewRows
        Of the pair.
    absorption, changed : float arrays, shape (n_materials, n_bands)
        Absorption coefficients before and after, 0 to 1.
    """
    alike = scatter_correlation(few, bands, absorption, changed)
    sti = after.sti
    if sti is not None and before.sti is not None:
        # early against late energy, too, over all octaves
        of_speech = alike[[VALUE_NAMES.index("D50_percent")]].mean(keepdims=True)
        sti = replace(sti, common_noise=_common(before.sti, sti, of_speech))
    return replace(after, common_noise=_common(before, after, alike), sti=sti)


def _common(before: PairNumbers, after: PairNumbers, alike: FloatArray) -> FloatArray:
    """Return the covariance of the noise of two states whose interference is alike."""
    variance = before.noise_sd**2
    steady = np.divide(
        before.common_noise, variance, out=np.zeros_like(variance), where=variance > 0.0
    )
    return (steady + (1.0 - steady) * alike) * before.noise_sd * after.noise_sd


def scatter_correlation(
    few: FewRows, bands: Bands, before: FloatArray, after: FloatArray
) -> FloatArray:
    """Return how alike reflections interfere before and after a change, (n_names, n_bands).

    1 where nothing changes, towards 0 where other walls return the energy.

    Parameters
    ----------
    few : FewRows
        Of one pair.
    before, after : float arrays, shape (n_materials, n_bands)
        Absorption coefficients, 0 to 1.

    Notes
    -----
    Pressures of paths with the energies ``e_i`` before and ``f_i`` after, of random phases, bring
    energies with the covariance ``(sum_i sqrt(e_i f_i))^2``, less what single paths bring, over
    paths whose phase is common to both states: those that meet no wall that is exchanged, since
    the phase that another material reflects with is not known. A wall counts the less as exchanged
    the less its absorption changes against ``_SAME_MATERIAL_SD``. `roomfit.objective.
    room_parameters.value_covariances` carries variances through the derivatives of a value alike.
    """
    # a wall that absorbs all leaves the paths that never meet it
    kept = np.exp(-0.5 * ((after - before) / _SAME_MATERIAL_SD) ** 2)
    avoiding = 1.0 - kept * np.sqrt((1.0 - before) * (1.0 - after))
    states = np.stack([before, after, avoiding])
    energies = few_energies(few, states)
    found = np.ones((len(VALUE_NAMES), len(bands)))
    curves = [echogram_decay_curve(bands, e, few.edges_s, few.direct_s) for e in energies[:2]]
    for band, rows in enumerate(few.by_band):
        if np.array_equal(before[:, band], after[:, band]):
            continue
        single = weigh_points(squared_image_rows(rows), states[:, :, band])
        variance = np.maximum(energies[:, band] ** 2 - single, 0.0)
        old, new = (value_gradients(c, band, VALUE_NAMES)[1] for c in curves)
        alone = (old**2 @ variance[0]) * (new**2 @ variance[1])
        found[:, band] = np.divide(
            (old * new) @ variance[2], np.sqrt(alone), out=np.ones(len(found)), where=alone > 0.0
        )
    return np.clip(found, 0.0, 1.0)
