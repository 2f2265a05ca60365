"""Arrays as JSON holds them."""

from __future__ import annotations

import numpy as np

from roomfit.typing import FloatArray


def numbers(values: FloatArray) -> list[float]:
    """Return an array of known values as a list."""
    return [float(v) for v in values]


def numbers_or_null(values: FloatArray) -> list[float | None]:
    """Return an array as a list, None for what is unknown."""
    return [float(v) if np.isfinite(v) else None for v in values]
