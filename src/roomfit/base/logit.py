"""The logit of absorption, in which priors and posteriors are taken for normal."""

from __future__ import annotations

import numpy as np

from roomfit.base.typing import FloatArray

# Standard normal quantile of 97.5 %: a 95 % interval reaches so many standard deviations.
Z95 = 1.959963984540054


def logit(share: FloatArray, least: float = 1e-6) -> FloatArray:
    """Return ``ln(a / (1 - a))``, a kept at least `least` away from 0 and from 1."""
    a = np.clip(share, least, 1.0 - least)
    return np.asarray(np.log(a) - np.log1p(-a))


def expit(free: FloatArray) -> FloatArray:
    """Return the inverse of the logit, 0 to 1, without overflow at either end."""
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * free)))
