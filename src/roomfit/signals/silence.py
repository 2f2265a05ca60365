"""Which parts of a filtered response hold noise and nothing else."""

from __future__ import annotations

import numpy as np

from roomfit.typing import FloatArray

TAIL_SHARE = 0.1  # of the file, from its end: the least that noise is estimated from
_RISE = 4.0  # an end that is 6 dB louder than the quietest tenth is no noise floor
_FAIR_VALUES = 16.0
# A zero-phase octave filter rings before a sound: so long, in units of 1 / B, until it is 60 dB
# down, and so many independent values make a fair mean (1.5 dB).
_RINGS = 4.0
_FEW_VALUES = 8.0


def before_rise(energy: FloatArray, independent: float) -> FloatArray:
    """Return the energy without a louder end: what circular deconvolution wraps to there.

    A tenth of the file is compared with another, or more where it would hold fewer independent
    values than a fair comparison needs.

    Parameters
    ----------
    energy : float array, shape (n_samples,)
    independent : float
        How many independent values it holds: bandwidth times duration.
    """
    n = len(energy)
    size = int(n * max(TAIL_SHARE, min(1.0, _FAIR_VALUES / independent)))
    if size == 0:
        return energy
    cumulative = np.concatenate(([0.0], np.cumsum(energy)))
    held = cumulative[size:] - cumulative[:-size]
    quietest = int(np.argmin(held))
    return energy[: quietest + size] if held[-1] > _RISE * held[quietest] else energy


def level_before(energy: FloatArray, rate_hz: float, bandwidth_hz: float) -> float:
    """Return the mean square of what comes before a sound arrives; 0 where that is too short.

    Parameters
    ----------
    energy : float array, shape (n_samples,)
        Filtered pressure squared, up to the arrival.
    bandwidth_hz : float
        Statistical bandwidth of the filter.
    """
    edge = round(rate_hz / bandwidth_hz)
    quiet = energy[edge : max(len(energy) - round(_RINGS * edge), 0)]
    return float(quiet.mean()) if len(quiet) >= _FEW_VALUES * edge else 0.0


def evidence_of_noise(
    energy: FloatArray, rate_hz: float, bandwidth_hz: float, constant_s: float
) -> float:
    """Return how much likelier energy is noise than a decay, as a log likelihood ratio.

    Its halves are compared: noise has equal ones; of a decay that goes on, be it at half the pace,
    the second is quieter. The logarithm of their ratio has the standard deviation
    ``2 / sqrt(B T)``. Near 0 where they are too short to tell.

    Parameters
    ----------
    energy : float array, shape (n_samples,)
    constant_s : float
        Time in which the decay before it fell to 1/e.
    """
    n = len(energy) // 2
    independent = bandwidth_hz * 2 * n / rate_hz
    if independent < 2.0:
        return 0.0
    fall = -0.5 * n / rate_hz / constant_s
    early, late = float(energy[:n].mean()), float(energy[n : 2 * n].mean())
    if not (early > 0.0 and late > 0.0):
        return 0.0
    ratio = float(np.log(late / early))
    return ((ratio - fall) ** 2 - ratio**2) * independent / 8.0
