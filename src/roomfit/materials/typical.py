"""What several tables together say of one kind of wall: a middle value and how far they scatter.

Tables print absorption without a spread. Here it comes from the tables themselves: how far they
disagree where they use the same name. All sums are done in logit absorption, where a spread means
the same for a hard wall and for a soft one.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from roomfit.typing import FloatArray

OCTAVES_HZ = (63.0, 125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0)
LEAST_ALPHA = 0.005  # half of what tables print last
LARGEST_ALPHA = 0.98

# ISO 12999-2:2020, table 1: two laboratories that measure one specimen by ISO 354 differ with the
# standard deviation m alpha + n. The last pair, for 8 kHz, repeats that of 5 kHz, where it ends.
_REPRODUCIBILITY_M = np.array([0.450, 0.180, 0.090, 0.050, 0.040, 0.035, 0.030, 0.026])
_REPRODUCIBILITY_N = np.array([0.015, 0.015, 0.015, 0.015, 0.015, 0.021, 0.040, 0.060])

# How much an own scatter weighs against the common one, in readings: three tables are too few for
# a variance of their own.
_COMMON_WEIGHT = 4.0
_LOW_SLOPE = 0.75
_LOW_STEP = 0.7
LOW_WIDENING = 0.6
HIGH_WIDENING = 0.4


def logit(absorption: FloatArray) -> FloatArray:
    """Return logit absorption; what tables print as 0, 1 or above is moved to 0.005 and 0.98."""
    a = np.clip(absorption, LEAST_ALPHA, LARGEST_ALPHA)
    return np.asarray(np.log(a / (1.0 - a)))


def distinct(readings: FloatArray) -> FloatArray:
    """Return the different rows: a table that reprints another one says nothing new.

    Parameters
    ----------
    readings : float array, shape (n_readings, 8)
        Absorption in octaves from 63 Hz; NaN where not printed.

    Returns
    -------
    float array, shape (n_distinct, 8)
        In the order of first appearance.
    """
    kept: list[FloatArray] = []
    for row in readings:
        if not any(np.array_equal(row[1:7], other[1:7]) for other in kept):
            kept.append(row)
    return np.array(kept)


def common_spread(materials: Iterable[FloatArray]) -> float:
    """Return the standard deviation of logit absorption among readings of the same name.

    Pooled over all names, and over octaves 125 to 4000 Hz: it varies little from band to band.
    Names with a single distinct reading tell nothing and are left out.
    """
    squares, freedom = 0.0, 0
    for readings in materials:
        values = logit(distinct(readings)[:, 1:7])
        squares += float(np.sum((values - values.mean(axis=0)) ** 2))
        freedom += (len(values) - 1) * values.shape[1]
    return float(np.sqrt(squares / freedom))


def typical_logit(readings: FloatArray, common: float) -> tuple[FloatArray, FloatArray]:
    """Return middle and standard deviation of logit absorption, each of shape (8,).

    Octaves 125 to 4000 Hz: the mean over distinct readings; its variance is the readings' own,
    drawn towards the `common` one as if that came from four readings more. It never falls below
    what two laboratories differ by (ISO 12999-2), as far as that is less than half the value:
    tables of hard walls agree better than a reverberation room could measure them.

    63 Hz, where no table prints it: three quarters of the step from 250 to 125 Hz are made once
    more, at most 0.7; 8 kHz: the value of 4 kHz is held. Used the other way round, to foretell
    125 Hz from the next two octaves and 4 kHz from 2 kHz, the two rules miss by 0.6 and 0.4
    (standard deviation over the catalogue): by so much the spread is widened there.
    """
    rows = distinct(readings)
    values = logit(rows)
    n = len(values)
    middle = np.empty(8)
    middle[1:7] = values[:, 1:7].mean(axis=0)
    own = np.sum((values[:, 1:7] - middle[1:7]) ** 2, axis=0)
    variance = np.empty(8)
    variance[1:7] = (_COMMON_WEIGHT * common**2 + own) / (_COMMON_WEIGHT + n - 1)
    for end, inner, rule, widening in (
        (0, 1, middle[1] + _low_step(middle), LOW_WIDENING),
        (7, 6, middle[6], HIGH_WIDENING),
    ):
        printed = values[~np.isnan(values[:, end]), end]
        middle[end] = printed.mean() if printed.size else rule
        variance[end] = variance[inner] + (0.0 if printed.size else widening**2)
    middle = logit(1.0 / (1.0 + np.exp(-middle)))
    return middle, np.maximum(np.sqrt(variance), _between_laboratories(middle))


def _low_step(middle: FloatArray) -> float:
    return float(np.clip(_LOW_SLOPE * (middle[1] - middle[2]), -_LOW_STEP, _LOW_STEP))


def _between_laboratories(middle: FloatArray) -> FloatArray:
    a = 1.0 / (1.0 + np.exp(-middle))
    sd = np.minimum(_REPRODUCIBILITY_M * a + _REPRODUCIBILITY_N, 0.5 * a)
    return np.asarray(sd / (a * (1.0 - a)))
