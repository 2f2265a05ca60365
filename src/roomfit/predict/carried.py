"""What was measured before a change, carried over to the room after it.

A measured value departs from its prediction for two reasons. What the model or the absorption is
wrong by stays when walls change and is carried over. How reflections happen to interfere at a
position changes with them: carried over, it would only be another error.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roomfit.base.typing import BoolArray, FloatArray
from roomfit.model.reduced_rows import ReducedRows
from roomfit.predict.decay import PairNumbers
from roomfit.signals.iso3382 import VALUE_NAMES


def with_common_noise(
    after: PairNumbers,
    before: PairNumbers,
    rows: ReducedRows,
    absorption: FloatArray,
    changed: FloatArray,
    exchanged: BoolArray,
) -> PairNumbers:
    """Return the numbers of a pair after a change with what its noise has in common with before.

    Shapes: `absorption, changed` (n_materials, n_bands), `exchanged` (n_materials,).
    """
    alike = rows.scatter_correlation(absorption, changed, exchanged)
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
