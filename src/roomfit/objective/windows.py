"""Time windows that are fine early, where reflections tell walls apart, and grow late."""

from __future__ import annotations

import numpy as np

from roomfit.typing import FloatArray


def window_edges_s(direct_s: float, end_s: float, bandwidth_hz: float) -> FloatArray:
    """Return the edges of the windows in which a band's energy is compared.

    The first window holds the direct sound. Widths are ``max(dt, 0.1 (t - direct))`` with
    ``dt = max(1 ms, 1.5 / B)``: a band of bandwidth B does not resolve time any finer, and late
    energy falls so evenly that a tenth of the elapsed time loses nothing.

    Parameters
    ----------
    direct_s : float
        Travel time of the direct sound.
    end_s : float
        Where the usable part of the response ends.
    bandwidth_hz : float
        Statistical bandwidth of the band's filter.

    Returns
    -------
    float array, shape (n_windows + 1,)
        Rising, beginning 2 dt before the direct sound (a zero-phase filter rings before it);
        shorter than two entries never: the window of the direct sound is always there.
    """
    finest_s = max(1e-3, 1.5 / bandwidth_hz)
    edges = [direct_s - 2.0 * finest_s, direct_s + finest_s]
    while True:
        following = edges[-1] + max(finest_s, 0.1 * (edges[-1] - direct_s))
        if following > end_s:
            return np.array(edges)
        edges.append(following)
