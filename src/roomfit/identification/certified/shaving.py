"""Slices cut off a box where the convex bound shows that nothing near the lowest lies in them."""

from __future__ import annotations

import math

import numpy as np

from roomfit.compiled import kernel
from roomfit.identification.certified.convex import Separable, least_over
from roomfit.identification.certified.question import Arrays
from roomfit.identification.certified.sandwich import Planes
from roomfit.typing import FloatArray

# Slices of a box tried at each face, as a share of its width.
_SLICES = (0.5, 0.25, 0.125)


@kernel()
def shave(
    kind: int,
    question: Arrays,
    planes: Planes,
    separable: Separable,
    box: FloatArray,
    centre: FloatArray,
    half: FloatArray,
    threshold: float,
    lowest: FloatArray,
) -> float:
    """Shrink a box in place and return the share of its volume that is kept.

    Parameters
    ----------
    box : float array, shape (2, n)
        In g; a coordinate that reaches minus infinity keeps its lower end.
    threshold : float
        A slice goes where the convex bound reaches it.
    lowest : float array, shape (n,)
        Where over the whole box the convex bound is lowest, from the centre.
    """
    n = box.shape[1]
    low, high, d = np.empty(n), np.empty(n), np.empty(n)
    for m in range(n):
        low[m], high[m] = -half[m], half[m]
    kept = 1.0
    for m in range(n):
        for side in range(2):
            if not math.isfinite(box[0, m]):
                continue
            for share in _SLICES:
                old_low, old_high = low[m], high[m]
                step = share * (old_high - old_low)
                edge = old_low + step if side == 0 else old_high - step
                if side == 0:
                    high[m] = edge
                else:
                    low[m] = edge
                for a in range(n):
                    d[a] = lowest[a]
                bound = least_over(
                    kind, question, planes, separable, low, high, threshold, d, False
                )
                low[m], high[m] = old_low, old_high
                if bound < threshold:
                    continue
                # more than the rounding of the sum, and of the centre's exponential
                slack = 2e-15 * (1.0 + abs(centre[m]) + abs(edge))
                if side == 0:
                    low[m] = edge
                    box[0, m] = max(box[0, m], centre[m] + edge - slack)
                else:
                    high[m] = edge
                    box[1, m] = min(box[1, m], centre[m] + edge + slack)
                kept *= 1.0 - share
                break
    return kept
