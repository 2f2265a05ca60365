"""Whether arrivals agree with the specified positions, lengths, speed of sound and latencies.

Positions and delays that the settings fix are fitted for comparison, and a doubt is raised where
the data are far likelier then.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

import numpy as np

from roomfit.base.findings import About, Code, Edit, Finding, Remedy
from roomfit.checks.evidence import Evidence
from roomfit.fit.displacement import AXES, WORTH_TELLING_M
from roomfit.fit.fits import Displacement
from roomfit.model.observation import DEFAULT_POSITION_SD_M
from roomfit.room.scene import Scene

# In prior standard deviations: beyond it, of some thirty unknowns one moves by chance once in 70.
_LARGEST_SHIFT_SD = 3.5
# Log-likelihood that a delay for each wall must gain: far above what a handful of unknowns that
# explain nothing would, half a unit each.
_DELAY_GAIN = 15.0
# Log-likelihood a window that free positions must gain. In boxes with errors of 1 mm and 3 us,
# correctly specified, it was .01 to .05, and answers changed by a tenth of their interval; with
# 1 cm .4 to .9, and by a half.
_POSITION_GAIN_PER_WINDOW = 0.1

_KINDS = ("source", "receiver")
_SDS_M = (0.005, 0.01, 0.02, 0.05)  # by laser, by tape, what is assumed, by steps


def check_specified(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding that names the positions whose standard deviation was assumed."""
    scene = evidence.measured.scene
    names = [p.name for p in (*scene.sources, *scene.receivers) if p.position_sd_m is None]
    if names:
        both = (("sources", scene.sources), ("receivers", scene.receivers))
        ends = [(kind, p.name) for kind, points in both for p in points if p.name in names]
        yield Finding(
            Code.POSITION_UNCERTAINTY_ASSUMED,
            _about_points(scene, [f"{kind} {name}" for name in names for kind in _KINDS]),
            f"No position_sd is specified for {', '.join(names)}; "
            f"{100 * DEFAULT_POSITION_SD_M:g} cm a coordinate was assumed.",
            {"points": names, "position_sd_m": DEFAULT_POSITION_SD_M},
            remedies=[
                Remedy([Edit(end, "position_sd", sd_m, now=[None]) for end in ends])
                for sd_m in _SDS_M
            ],
        )


def check_freed(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding where data contradict the positions, or that what was fixed is as it is."""
    tests = evidence.fits.tests
    scale, delays, positions = tests.position_sd_scale, tests.freed_delays, tests.freed_positions
    if scale > 1.0:
        larger = [Edit((f"{kind}s", "*"), "position_sd", scale, "scale") for kind in _KINDS]
        words = f"position_sd {scale:.1f} times as large for all positions"
        yield Finding(
            Code.POSITION_UNCERTAINTY_INFLATED,
            About(),
            "Arrival times contradict the specified standard deviations of positions: all "
            f"together, positions are off {scale:.1f} times as far, and were fitted with standard "
            f"deviations {scale:.1f} times as large. Measure the positions again; the room's "
            "dimensions may be wrong, too.",
            {"stretch": scale},
            remedies=[Remedy(larger, words, once=True)],
        )
    if delays is not None and delays.gain > _DELAY_GAIN:
        yield Finding(
            Code.REFLECTION_DELAY_DETECTED,
            About(),
            "Delays of reflections, which were excluded (wall_delays = false), raise the "
            f"log-likelihood by {delays.gain:.0f}: without them intervals are too narrow, and no "
            "material is called identifiable. Use wall_delays = true.",
            {"log_likelihood_gain": delays.gain},
            remedies=[Remedy([Edit(("identify",), "wall_delays", True)])],
        )
    if positions is None:
        return
    gain, n_unknowns, n_windows = positions
    if gain > max(n_unknowns + _DELAY_GAIN, _POSITION_GAIN_PER_WINDOW * n_windows):
        yield Finding(
            Code.POSITION_INCONSISTENT,
            About(),
            "Positions, speed of sound and latencies, which were fixed "
            f'(positions = "fixed"), raise the log-likelihood by {gain:.0f} if they move within '
            "their specified standard deviations: intervals are too narrow, and no material is "
            'called identifiable. Use positions = "fit".',
            {"log_likelihood_gain": gain, "n_unknowns": n_unknowns, "n_windows": n_windows},
            remedies=[Remedy([Edit(("identify",), "positions", "fit")])],
        )


def check_shifts(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding where the fit moved something implausibly far from its prior."""
    geometry = evidence.fits.geometry
    if geometry is None:
        return
    n = len(geometry.labels) - geometry.n_offsets  # those are judged by themselves
    prior_sd = np.where(geometry.prior_sd > 0.0, geometry.prior_sd, np.inf)[:n]
    far = np.flatnonzero(np.abs(geometry.change[:n]) / prior_sd > _LARGEST_SHIFT_SD)
    if far.size:
        names = [geometry.labels[i] for i in far]
        change, stated_sd = geometry.change[far].tolist(), geometry.prior_sd[far].tolist()
        yield Finding(
            Code.GEOMETRY_SHIFT_IMPLAUSIBLE,
            _about_points(evidence.measured.scene, {n.rpartition(" ")[0] for n in names}),
            f"To explain the arrival times, the fit moved {', '.join(names)} by more than "
            f"{_LARGEST_SHIFT_SD:g} prior standard deviations: it may be specified wrongly, or "
            "compensate for an error of the model. Check it.",
            {"labels": names, "change": change, "told_sd": stated_sd},
        )


def _about_points(scene: Scene, labels: Collection[str]) -> About:
    """Return what concerns points that are named as "source LS1" or "receiver MP1"."""
    both = [("source", p) for p in scene.sources] + [("receiver", p) for p in scene.receivers]
    return About(points_m=[p.position_m.tolist() for k, p in both if f"{k} {p.name}" in labels])


def check_displacement(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding where one displacement is farther than its standard deviation allows."""
    found = evidence.fits.displacement
    if found is None:
        return
    gain, ends, scene = round(found.gain, 1), "", evidence.measured.scene
    numbers = {
        "what": found.kind,
        "axis": AXES[found.axis],
        "metres": round(found.size_m, 3),
        "sd_m": round(found.sd_m, 3),
        "specified_sd_m": found.specified_sd_m,
        "log_likelihood_gain": gain,
    }
    if found.farther_m is not None:
        numbers["metres_farther"] = {w: list(pair) for w, pair in found.farther_m.items()}
    if found.farther_m:
        ends = "; counted from all positions " + " and ".join(
            f"{w} is {_metres(x, s, '+')} farther" for w, (x, s) in found.farther_m.items()
        )
    points = [p for p in (*scene.sources, *scene.receivers) if p.name in found.points]
    yield Finding(
        Code.DISPLACEMENT_DETECTED,
        About(points_m=[p.position_m.tolist() for p in points]),
        f"By early reflections {_in_words(found)}, which raises the log-likelihood by "
        f"{gain:.0f}; {found.specified_sd_m:g} m is its standard deviation{ends}. "
        "Absorption compensates for it, so that no material is called identifiable. Measure it "
        "again, or state how well it is known: [groups] or lengths_sd.",
        numbers,
        remedies=_opened(found, scene),
    )


def _opened(found: Displacement, scene: Scene) -> list[Remedy]:
    """Return the offset of positions, the length of a box, or both, fitted within a size."""
    size_m, axis, what = round(float(np.hypot(found.size_m, found.sd_m)), 2), found.axis, found.kind

    def wider(sd_m: object) -> tuple[float, ...]:
        sds_m = np.broadcast_to(np.asarray(0.0 if sd_m is None else sd_m), 3).tolist()
        return (*sds_m[:axis], size_m, *sds_m[axis + 1 :])

    own, edits = {g.name: g.sd_m for g in scene.groups}, []
    if what != "length":
        table = ("groups", what if what in own else "everything")
        if table[1] not in own:
            edits.append(Edit(table, "members", ("*",)))
        edits.append(Edit(table, "sd", wider(own.get(table[1]))))
    if what in ("length", "wall"):
        edits.append(Edit(("room",), "lengths_sd", wider(scene.room.lengths_sd_m)))
    named = {"length": "the length", "wall": "all positions and the length"}.get(what, what)
    words = f"{named} along {AXES[axis]} fitted within {size_m:g} m"
    return [Remedy(edits, words)] if size_m <= 1.0 else []  # else to be measured again


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
    return f"{x_m:{sign}.{digits}f} ± {sd_m:.{digits}f} m"
