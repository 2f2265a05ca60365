"""Just noticeable differences: the scale on which a prediction's error matters to a listener."""

from __future__ import annotations

import numpy as np

from roomfit.errors import InputError
from roomfit.typing import FloatArray

# ISO 3382-1:2009, table A.1: 5 % of EDT (taken for T20 and T30 as well), 1 dB of C80 (and C50) and
# G, 0.05 of D50, 10 ms of TS.
_RELATIVE = {"T20_s": 0.05, "T30_s": 0.05, "EDT_s": 0.05}
_ABSOLUTE = {"C50_dB": 1.0, "C80_dB": 1.0, "D50_percent": 5.0, "TS_ms": 10.0, "G_dB": 1.0}


def in_jnd(parameter: str, measured: FloatArray, predicted: FloatArray) -> FloatArray:
    """Return predicted minus measured in just noticeable differences of ISO 3382-1.

    Examples
    --------
    A reverberation time 10 % too long is two just noticeable differences off.

    >>> in_jnd("T20_s", np.array([1.0]), np.array([1.1])).round(6)
    array([2.])
    """
    difference = np.asarray(predicted) - np.asarray(measured)
    return np.asarray(difference / jnd_of(parameter, measured))


def jnd_of(parameter: str, values: FloatArray) -> FloatArray:
    """Return one just noticeable difference of a parameter, in its own unit, at given values.

    Parameters
    ----------
    parameter : str
        "EDT_s", "T20_s", "T30_s", "C50_dB", "C80_dB", "D50_percent", "TS_ms" or "G_dB".
    values : float array

    Raises
    ------
    InputError
        The standard names none for this parameter.

    Examples
    --------
    >>> float(jnd_of("EDT_s", np.array(2.0)))
    0.1
    """
    if parameter in _RELATIVE:
        return np.asarray(_RELATIVE[parameter] * np.asarray(values))
    if parameter in _ABSOLUTE:
        return np.full(np.shape(values), _ABSOLUTE[parameter])
    raise InputError(
        "no just noticeable difference is known for this parameter",
        found=repr(parameter),
        needed=", ".join((*_RELATIVE, *_ABSOLUTE)),
    )
