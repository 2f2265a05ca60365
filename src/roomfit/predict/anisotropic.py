"""Decay times of a field that is not diffuse, followed direction by direction.

In a flat room sound that travels along it hardly meets floor and ceiling, and lasts until side
walls absorb it or scatter it upwards. Formulas of a diffuse field know of no directions: there a
panel on the ceiling counts as much as one on a side wall.
"""

from __future__ import annotations

import math

import numpy as np

from roomfit.base.kernels import in_threads, kernel
from roomfit.base.typing import FloatArray

# Heights, and azimuths, of the directions of one octant; more change T30 by 1 %.
_N_DIRECTIONS = 8
# Of the logarithm of the energy, in a step of time; and how far a decay is followed.
_STEP, _LEAST = 0.4, 1e-5
# Of diagonally implicit steps of the second order that damp what is fast (Alexander, 1977).
_GAMMA = 1.0 - math.sqrt(0.5)
# Scattering coefficients between which that of a decay time is sought: of walls as smooth, and as
# rough, as walls with all that stands in front of them are.
_SCATTERING = np.geomspace(0.02, 0.95, 7)


def anisotropic_times_s(
    kept: FloatArray, scattering: FloatArray, hits_per_s: FloatArray, air_per_s: FloatArray
) -> FloatArray:
    """Return T30 of rooms whose walls lie across three axes, shape (n,).

    Shapes: `kept` (n, 3), `hits_per_s` (3,).

    Notes
    -----
    Energy of a direction u, alike at all places, meets walls across an axis k at the rate
    ``|u_k| c S_k / (2 V)`` and decays by ``-ln R`` times that rate, as regular reflections have it;
    the share s of each goes on in directions v by ``|v_k|``. Without scattering this is the decay
    of image sources of a box by directions [1]_; where all walls are alike and s is large it is
    Eyring's.

    References
    ----------
    .. [1] E. A. Lehmann, A. M. Johansson, "Prediction of energy decay in room impulse responses
           simulated with an image-source model", J. Acoust. Soc. Am. 124, 269-277 (2008).
    """
    x, weight = np.polynomial.legendre.leggauss(_N_DIRECTIONS)
    x = 0.5 * (x + 1.0)
    # close together where sound travels along walls, which lasts
    place, weight = x**2 * (3.0 - 2.0 * x), 3.0 * weight * x * (1.0 - x)
    height, azimuth = place[:, None], 0.5 * np.pi * place
    level = np.sqrt(1.0 - height**2)
    along = np.broadcast_arrays(level * np.cos(azimuth), level * np.sin(azimuth), height)
    directions = np.stack(along, axis=-1).reshape(-1, 3)
    share, out = np.outer(weight, weight).ravel(), np.empty(len(kept))
    given = [np.ascontiguousarray(a, dtype=np.float64) for a in (kept, scattering, air_per_s)]
    in_threads(_fill_times, len(kept), *given, hits_per_s, directions, share, out)
    return out


def implied_scattering(
    kept: FloatArray, decay_s: FloatArray, hits_per_s: FloatArray, air_per_s: FloatArray
) -> FloatArray:
    """Return with which scattering coefficient rooms have their decay times, shape (n,).

    The less is scattered the longer a flat room sounds. Between .02 and .95; where no value gives
    the time, the nearest end. Shapes as of `anisotropic_times_s`.
    """
    logs = np.log(_SCATTERING)
    times = np.log(
        [
            anisotropic_times_s(kept, np.full(len(kept), s), hits_per_s, air_per_s)
            for s in _SCATTERING
        ]
    )
    times = np.minimum.accumulate(times, axis=0)
    sought = np.clip(np.log(decay_s), times[-1], times[0])
    at = np.clip(np.count_nonzero(times > sought, axis=0) - 1, 0, len(logs) - 2)
    columns = np.arange(len(kept))
    above, below = times[at, columns], times[at + 1, columns]
    share = (above - sought) / np.maximum(above - below, 1e-12)
    return np.asarray(np.exp(logs[at] + np.clip(share, 0.0, 1.0) * (logs[at + 1] - logs[at])))


@kernel()
def _fill_times(
    first: int,
    last: int,
    kept: FloatArray,
    scattering: FloatArray,
    air_per_s: FloatArray,
    hits_per_s: FloatArray,
    directions: FloatArray,
    share: FloatArray,
    out: FloatArray,
) -> None:
    """Fill the times of some rooms.

    In each step ``(1 + h (L - U F)) after = before`` is solved twice, L the loss of each direction,
    F the flow from it onto walls across each axis, and U where these scatter it: by the three sums
    ``F @ after``, whose own equations have the products of the directions' components.
    """
    n = len(share)
    most = int(-math.log(_LEAST) / _STEP) + 2
    time_s, energy = np.empty(most), np.empty(most)
    loss, own, ahead, inverse = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    x, y, z = directions[:, 0].copy(), directions[:, 1].copy(), directions[:, 2].copy()
    part = np.array([np.sum(share * x), np.sum(share * y), np.sum(share * z)])
    for i in range(first, last):
        s, h = scattering[i], 0.0
        a, b, c = (s - np.log(kept[i])) * hits_per_s
        for d in range(n):
            loss[d] = air_per_s[i] + a * x[d] + b * y[d] + c * z[d]
        # what leaves for good, and what comes back of the flow onto walls across each axis
        a, b, c = -np.log(kept[i]) * hits_per_s
        back = s * hits_per_s / part
        own[:], time_s[0], energy[0], j = 1.0, 0.0, 1.0, 0
        solved = np.eye(3)
        while energy[j] > _LEAST and j < most - 1:
            away = 0.0
            for d in range(n):
                away += share[d] * (air_per_s[i] + a * x[d] + b * y[d] + c * z[d]) * own[d]
            wanted = _GAMMA * _STEP * energy[j] / away
            if abs(wanted - h) > 0.1 * h:
                h = wanted
                xx = xy = xz = yy = yz = zz = 0.0
                for d in range(n):
                    inverse[d] = 1.0 / (1.0 + h * loss[d])
                    weight = share[d] * inverse[d]
                    xx += weight * x[d] * x[d]
                    xy += weight * x[d] * y[d]
                    xz += weight * x[d] * z[d]
                    yy += weight * y[d] * y[d]
                    yz += weight * y[d] * z[d]
                    zz += weight * z[d] * z[d]
                mixed = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
                solved = np.linalg.inv(np.eye(3) - h * mixed * back)
            ahead[:] = own
            for stage in range(2):
                total = sx = sy = sz = 0.0
                for d in range(n):
                    weight = share[d] * inverse[d] * ahead[d]
                    sx += weight * x[d]
                    sy += weight * y[d]
                    sz += weight * z[d]
                u, v, w = h * back * np.sum(solved * np.array([sx, sy, sz]), axis=1)
                for d in range(n):
                    new = inverse[d] * (ahead[d] + u * x[d] + v * y[d] + w * z[d])
                    total += share[d] * new
                    ahead[d] = own[d] + (1.0 - _GAMMA) / _GAMMA * (new - own[d])
                    if stage == 1:
                        own[d] = new
            j += 1
            time_s[j], energy[j] = time_s[j - 1] + h / _GAMMA, total
        out[i] = _t30_s(time_s[: j + 1], energy[: j + 1])


@kernel()
def _t30_s(time_s: FloatArray, energy: FloatArray) -> float:
    """Return T30 of a decay, exponential between its points and beyond the last."""
    n = len(time_s)
    level = np.empty(n)
    rate = math.log(energy[n - 2] / energy[n - 1]) / (time_s[n - 1] - time_s[n - 2])
    behind = energy[n - 1] / rate
    level[n - 1] = behind
    for j in range(n - 2, -1, -1):
        ratio = math.log(energy[j] / energy[j + 1])
        behind += (energy[j] - energy[j + 1]) / ratio * (time_s[j + 1] - time_s[j])
        level[j] = behind
    level = 10.0 * np.log10(level / level[0])
    begin_s, end_s = np.interp(np.array([5.0, 35.0]), -level, time_s)
    t = np.linspace(begin_s, end_s, 60)
    y, t = np.interp(t, time_s, level), t - 0.5 * (begin_s + end_s)
    return float(-60.0 * np.sum(t * t) / np.sum(t * y))
