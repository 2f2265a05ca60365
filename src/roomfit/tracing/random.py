"""Random numbers that depend only on what they are for: seed, source, ray and hit.

Nothing is drawn in turn from a stream, so that a trace gives the same bits however its rays are
dealt out to threads. The hash is the finaliser of splitmix64 [1]_ applied to a counter.

References
----------
.. [1] G. L. Steele, D. Lea, C. H. Flood, "Fast splittable pseudorandom number generators", Proc.
       OOPSLA 2014, 453-472; constants of variant 13 by D. Stafford.
"""

from __future__ import annotations

import numpy as np

from roomfit.compiled import kernel

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)
_30, _27, _31, _11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
_UNIT = 2.0**-53


@kernel(allocates=False)
def mixed(x: np.uint64) -> np.uint64:
    """Return a 64-bit number each of whose bits depends on every bit of `x`."""
    x = (x ^ (x >> _30)) * _FIRST
    x = (x ^ (x >> _27)) * _SECOND
    return x ^ (x >> _31)


@kernel(allocates=False)
def ray_key(seed: int, source: int, ray: int) -> np.uint64:
    """Return the number that stands for one ray in every later draw."""
    key = mixed(np.uint64(seed) + _GOLDEN)
    key = mixed(key ^ (np.uint64(source) + _GOLDEN))
    return mixed(key ^ (np.uint64(ray) + _GOLDEN))


@kernel(allocates=False)
def uniform(key: np.uint64, draw: int) -> float:
    """Return draw number `draw` of a key, uniform in [0, 1) in steps of 2**-53."""
    bits = mixed(key + (np.uint64(draw) + np.uint64(1)) * _GOLDEN)
    return np.float64(bits >> _11) * _UNIT
