"""Time windows that are fine early, where reflections tell walls apart, and grow late."""

from __future__ import annotations

import numpy as np

from roomfit.typing import FloatArray


def window_edges_s(
    direct_s: float, end_s: float, bandwidth_hz: float, *, periods: float = 1.5
) -> FloatArray:
    """Return the edges of the windows in which a band's energy is compared.

    The first window holds the direct sound. Widths are ``max(dt, 0.1 (t - direct))`` with
    ``dt = max(1 ms, periods / B)``: a band of bandwidth B does not resolve time any finer, and late
    energy falls so evenly that a tenth of the elapsed time loses nothing.

    Parameters
    ----------
    direct_s : float
        Travel time of the direct sound.
    end_s : float
        Where the usable part of the response ends.
    bandwidth_hz : float
        Statistical bandwidth of the band's filter.
    periods : float
        Of 1 / B, in the shortest window: 1.5 suits energies that add, 0.75 pressures, whose
        windows say something of each other's phase.

    Returns
    -------
    float array, shape (n_windows + 1,)
        Rising, beginning 3 / B (2 ms at least) before the direct sound, because a zero-phase
        filter rings before it;
        shorter than two entries never: the window of the direct sound is always there.
    """
    finest_s = max(1e-3, periods / bandwidth_hz)
    before_s = 2.0 * max(1e-3, 1.5 / bandwidth_hz)
    edges = [direct_s - before_s, direct_s + finest_s]
    while True:
        following = edges[-1] + max(finest_s, 0.1 * (edges[-1] - direct_s))
        if following > end_s:
            return np.array(edges)
        edges.append(following)
