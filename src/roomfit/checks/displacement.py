"""Whether positions and the lengths of a box are as specified, by early reflections."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from roomfit.base.findings import About, Code, Finding
from roomfit.checks.evidence import Evidence, Law
from roomfit.fit.displacement import AXES, WORTH_TELLING_M
from roomfit.fit.fits import Displacement

LAWS = {
    Code.DISPLACEMENT_DETECTED: Law(
        "groups of positions, and lengths, are within 3.5 standard deviations of the specified",
        "log-likelihood of early windows gained by one displacement beyond these, above 10",
    )
}


def check(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding where one displacement is farther than its standard deviation allows."""
    found = evidence.fits.displacement
    if found is None:
        return
    gain, farther_m, ends = round(found.gain, 1), found.farther_m, ""
    if farther_m:
        ends = "; counted from all positions " + " and ".join(
            f"{w} is {_metres(x, s, '+')} farther" for w, (x, s) in farther_m.items()
        )
    scene = evidence.measured.scene
    moved = [p.position_m for p in (*scene.sources, *scene.receivers) if p.name in found.points]
    numbers = {
        "what": found.kind,
        "axis": AXES[found.axis],
        "metres": round(found.size_m, 3),
        "sd_m": round(found.sd_m, 3),
        "specified_sd_m": found.specified_sd_m,
        "log_likelihood_gain": gain,
    }
    if farther_m is not None:
        numbers["metres_farther"] = {w: list(pair) for w, pair in farther_m.items()}
    yield Finding(
        Code.DISPLACEMENT_DETECTED,
        About(points_m=[(float(x), float(y), float(z)) for x, y, z in np.array(moved)]),
        f"By early reflections {_in_words(found)}, which raises the log-likelihood by "
        f"{gain:.0f}; {found.specified_sd_m:g} m is its standard deviation{ends}. "
        "Absorption compensates for it, so that no material is called identifiable. Measure it "
        "again, or state how well it is known: [groups] or lengths_sd.",
        numbers,
    )


def _in_words(found: Displacement) -> str:
    """Return what stands elsewhere, and by how much."""
    axis, size_m, walls = AXES[found.axis], found.size_m, found.walls
    size = _metres(abs(size_m), found.sd_m)
    if found.sd_m >= WORTH_TELLING_M:  # no top, so far as second differences say
        size = f"about {abs(size_m):.1f} m"
    if found.points:
        towards = f", towards {walls[int(size_m > 0.0)]}" if walls else ""
        sign = "+" if size_m > 0.0 else "-"
        return f"{found.kind} stand {size} farther along {sign}{axis}{towards}, than specified"
    if found.kind == "wall":
        side = "inside" if size_m < 0.0 else "outside"
        return f"{walls[0]} stands {size} {side} of where it is specified"
    order = "longer" if size_m > 0.0 else "shorter"
    return (
        f"the room is {size} {order} along {axis} than specified, as if {walls[1]} stood elsewhere"
    )


def _metres(x_m: float, sd_m: float, sign: str = "") -> str:
    """Return a length with its standard deviation, never of 0.00 m."""
    digits = 2 if sd_m >= 0.005 else 3
    return f"{x_m:{sign}.{digits}f} +- {sd_m:.{digits}f} m"
