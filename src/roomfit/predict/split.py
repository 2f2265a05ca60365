"""How the absorption that was measured is split among walls, where the data do not say it.

What a change does hangs on the share of what is changed in the absorption of the room before it. A
decay determines the sum; where the prior alone decides the shares, a finding says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from roomfit.base.bands import Bands
from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import FloatArray, IntArray
from roomfit.materials.catalogue import suggested_entries
from roomfit.uncertainty.combinations import area_shares
from roomfit.uncertainty.posterior import AbsorptionPosterior, draw_absorption, draw_prior

# Areas that differ by less are those of one room described twice.
_SAME_AREA = 0.05


def for_another_room(
    posterior: AbsorptionPosterior, areas_m2: dict[str, float], n_draws: int, seed: int
) -> tuple[AbsorptionPosterior, tuple[Finding, ...]]:
    """Return a result as it is to predict a room with other areas from.

    And what the prior alone says there of materials whose areas differ.
    """
    own = posterior.areas_m2
    if own is None:
        return posterior, ()
    there = np.array([areas_m2.get(name, 0.0) for name in posterior.materials])
    is_other = np.abs(there - own) > _SAME_AREA * np.maximum(there, own)
    if not is_other.any():
        return posterior, ()
    # that its pressures add was seen in the room that was measured
    posterior = replace(posterior, by_pressures=None, is_other_room=True)
    rng = np.random.default_rng(seed)
    draws = draw_absorption(posterior, n_draws, rng)
    changed = [name for name, other in zip(posterior.materials, is_other, strict=True) if other]
    return posterior, prior_dominated(posterior, draws, changed, own, rng)


# A share that is known no better than this, and hardly better than before the measurement.
_WIDE_RATIO = 3.0
_LARGE_SHARE = 0.05
_LEFT_OF_PRIOR = 0.5
_MORE_PAIRS = (
    "and identify again; or measure more pairs, which `roomfit design` with --result names."
)
_WITH_POSITIONS = "or measure responses with positions, which tell walls apart."


def prior_dominated(
    posterior: AbsorptionPosterior,
    draws: FloatArray,
    changed: Sequence[str],
    areas_m2: FloatArray,
    rng: np.random.Generator,
    *,
    from_times: bool = False,
) -> tuple[Finding, ...]:
    """Return a finding for each changed material of whose weight in the room the data say little.

    What a change does hangs on the share of the material in the absorption of the room before it.
    Where the 95 % interval of that share reaches 5 %, spans more than a factor of 3, and its
    standard deviation is above half of the prior's, the prior decides; where the posterior comes
    without its prior, the first two count.

    Shapes: `draws` (n_draws, n_materials, n_bands), `areas_m2` (n_materials,).
    """
    shares = _band_shares(areas_m2, draws)
    low, high = np.quantile(shares, (0.025, 0.975), axis=0)
    is_wide = (high > _WIDE_RATIO * low) & (high >= _LARGE_SHARE)
    drawn, before = draw_prior(posterior, len(draws), rng), None
    if drawn is not None:
        prior = _band_shares(areas_m2, drawn)
        before = np.quantile(prior, (0.025, 0.975), axis=0)
        is_wide &= np.std(shares, axis=0) > _LEFT_OF_PRIOR * np.std(prior, axis=0)
    found = _band_shares(areas_m2, posterior.absorption[None])[0]
    findings = []
    for name in changed:
        i = posterior.materials.index(name)
        at = np.flatnonzero(is_wide[i])
        if at.size:
            of_prior = None if before is None else before[:, i]
            own = found[i], low[i], high[i]
            more = _WITH_POSITIONS if from_times else _MORE_PAIRS
            findings.append(_prior_dominated(name, posterior.bands, at, own, of_prior, more))
    return tuple(findings)


def _prior_dominated(
    name: str,
    bands: Bands,
    at: IntArray,
    shares: tuple[FloatArray, FloatArray, FloatArray],
    before: FloatArray | None,
    more: str,
) -> Finding:
    """Return the finding of one material in the bands `at`.

    Shapes: `shares` (n_bands,), `before` (2, n_bands).
    """
    found, low, high = shares
    b = int(at[np.argmax(high[at] - low[at])])
    centres_hz = bands.centres_hz
    known = ""
    if before is not None:
        known = f" ({_percents(before[0, b], before[1, b])} before anything was measured)"
    entries = ", ".join(f'"{e}"' for e in suggested_entries(name)) or "a name of the catalogue"
    return Finding(
        Code.CHANGE_PRIOR_DOMINATED,
        About(materials=[name], bands_hz=centres_hz[at].tolist()),
        f"What a change of {name} does hangs on its prior at "
        f"{', '.join(f'{f:g}' for f in centres_hz[at])} Hz: before the change its share in "
        f"the absorption of the room is {_percents(low[b], high[b])} at "
        f"{centres_hz[b]:g} Hz{known}. State what is known of it: "
        f'[materials."{name}"] prior = '
        f"{entries}, or a mean and a standard deviation, {more}",
        {
            "material": name,
            "bands_hz": centres_hz[at].tolist(),
            "share": found[at].tolist(),
            "share_lower95": low[at].tolist(),
            "share_upper95": high[at].tolist(),
        },
    )


def _band_shares(areas_m2: FloatArray, draws: FloatArray) -> FloatArray:
    parts = areas_m2[:, None] * draws
    return np.stack([area_shares(parts[:, :, b]) for b in range(parts.shape[2])], axis=2)


def _percents(low: float, high: float) -> str:
    return f"{100 * low:.0f} to {100 * high:.0f} %"
