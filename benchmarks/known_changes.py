"""Known changes of measured rooms: what is said of each wall, and of a room whose walls changed.

    python benchmarks/known_changes.py DATA [--room r3vival together dechorate] [--step DEGREES]
        [--rings 150 200] [--scattering S [S]] [--seed SEED] [--product-sd SD]

DATA holds `r3vival` (one room in three states of its wall panels, Amengual Gari and others) and
`dechorate_states` (one room in two, Di Carlo et al. 2021). Neither comes with roomfit.

For each room: the absorption of every wall in every state with 95 % intervals, and standardised
differences of the walls that did not change. `together` fits two states of the first room at once,
its panels as products (`--product-sd`, logit; 0: independent), predicts state R, whose walls are
those of the two, beside Sabine's formula and the mean of both, and compares every state by itself.
`dechorate`: the change from one state to the other, pair by pair and in the mean, with the floor of
the first and the panels of the second, beside Sabine's and Eyring's formula with the same walls and
the mean of both states.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import soundfile

import roomfit
from roomfit.base.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.base.logit import Z95, logit
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.materials.priors import (
    MaterialPrior,
    prior_logits,
    unknown_material,
)
from roomfit.model.eyring import eyring_time_s
from roomfit.model.patterns import UnknownDirectivity
from roomfit.predict.changes import Change
from roomfit.predict.predict import predict
from roomfit.predict.prediction import Predicted, PredictedValue, ValueChange
from roomfit.predict.question import Question
from roomfit.result import Result, absorption_posterior
from roomfit.room.mesh import surface_area_m2, volume_m3
from roomfit.room.scene import Point, Scene, material_areas_m2, with_states
from roomfit.signals.decay import ParameterName

BANDS = roomfit.bands_between("octave", 125, 4000)
WALLS = ("front", "back", "right", "left", "floor", "ceiling")
SIDES = ("west", "east", "south", "north", "floor", "ceiling")
R3VIVAL_M = (9.55, 5.417, 2.757)
# Which walls of the states have turned their panels to the absorbing side.
ABSORBING = {"000": (), "100": ("front", "back", "right", "left"), "R": ("right",)}
SAME: dict[str, dict[tuple[str, str], tuple[str, ...]]] = {
    "r3vival": {
        ("000", "100"): ("floor", "ceiling"),
        ("000", "R"): ("front", "back", "left", "floor", "ceiling"),
        ("100", "R"): ("right", "floor", "ceiling"),
    },
    "dechorate": {("000000", "011111"): ("floor",)},
}
JUDGED_HZ = 200.0  # what is lower, single modes decide
# As far off the axis as a loudspeaker of this size radiates within some decibels at 4 kHz.
ON_AXIS_DEGREES = 40.0

Case = tuple[Scene, list[roomfit.Measurement], Mapping[str, UnknownDirectivity]]


def r3vival(data: Path, state: str, step: int, rings: Sequence[str]) -> Case:
    """Return one state: loudspeakers of one make on circles about a microphone, facing it."""
    folder = data / "r3vival"
    with (folder / "sources.csv").open() as stream:
        rows = [r for r in csv.DictReader(stream) if is_chosen(r["source"], step, rings)]
    sources = [
        Point(r["source"], np.array([float(r[k]) for k in ("x_m", "y_m", "z_m")]), 0.03)
        for r in rows
    ]
    room = roomfit.shoebox_room(R3VIVAL_M, dict(zip(SIDES, WALLS, strict=True)))
    scene = roomfit.scene_of(room, sources, [Point("M", np.array([5.38, 2.68, 1.378]), 0.03)])
    scene = replace(scene, air=roomfit.Air(temperature_c=22.0, speed_of_sound_m_s=344.5))
    measurements, directivities = [], {}
    for r in rows:
        name = r["source"]
        samples, rate_hz = soundfile.read(folder / f"{state}_{name}.wav")
        measurements.append(
            roomfit.Measurement(name, "M", samples[:, 0], rate_hz, time_zero="unknown")
        )
        aim = np.array([float(r[k]) for k in ("aim_x", "aim_y", "aim_z")])
        directivities[name] = UnknownDirectivity(aim=aim, loudspeaker="array")
    return scene, measurements, directivities


def r3vival_together(
    data: Path, measured: Sequence[str], predicted: Sequence[str], step: int, rings: Sequence[str]
) -> Case:
    """Return several states of the room as one case; nothing of the predicted ones is read.

    Materials are the walls with their panels' side, as "left, absorbing".
    """
    first, *others = measured
    scene, measurements, directivities = r3vival(data, first, step, rings)
    room = roomfit.shoebox_room(R3VIVAL_M, panels(first))
    room = with_states(room, {state: panels(state) for state in (*others, *predicted)})
    for state in others:
        own = r3vival(data, state, step, rings)[1]
        measurements += [replace(m, state=state) for m in own]
    return replace(scene, room=room), measurements, directivities


def panels(state: str) -> dict[str, str]:
    """Return the material of each side of the room in a state."""
    side = {w: "absorbing" if w in ABSORBING[state] else "reflecting" for w in WALLS[:4]}
    return {s: f"{w}, {side[w]}" if w in side else w for s, w in zip(SIDES, WALLS, strict=True)}


def is_chosen(source: str, step: int, rings: Sequence[str]) -> bool:
    """Whether a source of the array, S<azimuth>_<distance>, is among those asked for."""
    azimuth, ring = source[1:].split("_")
    return int(azimuth) % step == 0 and ring in rings


def dechorate(data: Path, state: str) -> Case:
    """Return one state: loudspeakers whose aims are not known."""
    kept = np.load(data / "dechorate_states" / "rirs.npz")
    rows = np.flatnonzero(kept["state"] == state)
    room = roomfit.shoebox_room(kept["room"], dict(zip(SIDES, SIDES, strict=True)))
    points = {
        kind: [
            Point(f"{letter}{n}", kept[f"{kind}_pos"][rows[kept[kind][rows] == n][0]], 0.01)
            for n in np.unique(kept[kind][rows])
        ]
        for kind, letter in (("src", "S"), ("mic", "M"))
    }
    scene = roomfit.scene_of(room, points["src"], points["mic"])
    scene = replace(scene, air=roomfit.Air(temperature_c=24.0, speed_of_sound_m_s=346.98))
    measurements = [
        roomfit.Measurement(
            f"S{kept['src'][i]}",
            f"M{kept['mic'][i]}",
            kept["rir"][i],
            int(kept["fs"]),
            level="per-source" if kept["level_kept"][i] else "per-file",
        )
        for i in rows
    ]
    return scene, measurements, {p.name: UnknownDirectivity() for p in points["src"]}


def material_prior(name: str, scattering: list[float] | None, product_sd: float) -> MaterialPrior:
    """Return the broad prior of a wall; panels turned to one side are of one product.

    `scattering` is that of panels turned to a side and, last, that of all else.
    """
    prior, side = unknown_material(name, len(BANDS)), name.partition(", ")[2]
    if scattering is not None:
        prior = replace(prior, scattering=np.full(len(BANDS), scattering[0 if side else -1]))
    return replace(prior, product=side, product_sd=product_sd) if side and product_sd else prior


def fitted(
    name: str,
    case: Case,
    scattering: list[float] | None,
    settings: roomfit.Settings,
    product_sd: float = 0.0,
) -> Result:
    """Identify one case, and print what its walls absorb."""
    scene, measurements, directivities = case
    priors = [
        material_prior(scene.room.materials[m], scattering, product_sd)
        for m in range(len(scene.room.materials))
    ]
    began = time.process_time()
    result = roomfit.identify(
        scene, measurements, priors, BANDS, settings=settings, directivities=directivities
    )
    print(f"\n{name}: {len(measurements)} responses, {time.process_time() - began:.0f} CPU s")
    print("reduced chi-square " + " ".join(f"{x:.2f}" for x in result.chi2_reduced))
    print(wall_table(result))
    for finding in result.findings:
        if finding.severity != "info":
            print(f"  {finding.severity}: {finding.code}: {finding.sentence[:300]}")
    return result


def wall_table(result: Result) -> str:
    """Return the absorption of every wall with its interval, ? where it is not identifiable."""
    lines = [f"{'Hz':<9}" + "".join(f"{f:>17g}" for f in result.bands.centres_hz)]
    for m, name in enumerate(result.materials):
        cells = [
            f"{result.absorption[m, b]:.2f}{' ' if result.identifiable[m, b] else '?'} "
            f"({result.lower95[m, b]:.2f}-{result.upper95[m, b]:.2f})"
            for b in range(len(result.bands))
        ]
        lines.append(f"{name:<9}" + "".join(f"{c:>17}" for c in cells))
    return "\n".join(lines)


def unchanged(first: Result, second: Result, walls: Sequence[str]) -> str:
    """Return the rms standardised difference of walls that did not change, from 500 Hz up.

    Below 1 where a prior is in both answers: of the variance v of an answer under a prior of the
    variance p the share 1 - v / p is scatter of the estimate (of one unknown; as much of several
    as far as their data do not hang together).
    """
    at = np.flatnonzero(first.bands.centres_hz > 400.0)
    z, half, marks, shares = [], [], [], []
    for name in walls:
        own = [(r, r.materials.index(name)) for r in (first, second)]
        logits = [logit(r.absorption[m, at]) for r, m in own]
        spreads = [
            (logit(r.upper95[m, at]) - logit(r.lower95[m, at])) / (2.0 * Z95) for r, m in own
        ]
        z.append((logits[0] - logits[1]) / np.hypot(*spreads))
        known = [
            np.minimum((s / prior_logits(r.priors)[1, m, at]) ** 2, 1.0)
            for s, (r, m) in zip(spreads, own, strict=True)
        ]
        scatter = sum(s**2 * (1.0 - k) for s, k in zip(spreads, known, strict=True))
        shares.append(scatter / np.sum(np.square(spreads), axis=0))
        for r, m in own:
            half.append(0.5 * (r.upper95[m, at] - r.lower95[m, at]))
            marks.append(r.identifiable[m, at])
    return (
        f"{', '.join(walls)}: standardised difference rms {np.sqrt(np.mean(np.square(z))):.2f} "
        f"({np.sqrt(np.mean(shares)):.2f} to be expected), "
        f"median half width {np.median(half):.2f}, identifiable {np.sum(marks)} of {np.size(marks)}"
    )


def swap_together(
    data: Path, case: Case, result: Result, known: Sequence[str], unknown: str
) -> None:
    """Predict a state from others that were fitted with it, carried over from each of them."""
    scene, measurements, _ = case
    posterior = absorption_posterior(result)
    judged = result.bands.centres_hz > JUDGED_HZ
    step_rings = [m.source for m in measurements if not m.state]
    wanted = panels(unknown)
    found: dict[str, Predicted] = {}
    for state in known:
        number = [0, *(1 + i for i, s in enumerate(scene.room.states) if s.name == state)][-1]
        own = [m for m in measurements if m.state == ("" if number == 0 else state)]
        at = replace(scene, pair_state=np.full(len(scene.pairs), number))
        changes = [
            Change(one, "catalogue", entry=other)
            for one, other in zip(panels(state).values(), wanted.values(), strict=True)
            if one != other
        ]
        found[state] = predict(Question(at, posterior, changes, own))
    truth = r3vival(data, unknown, 1, ("150", "200"))[1]
    truth = [replace(m, state=unknown) for m in truth if m.source in step_rings]
    number = 1 + [s.name for s in scene.room.states].index(unknown)
    at = replace(scene, pair_state=np.full(len(scene.pairs), number))
    itself = predict(Question(at, posterior, measurements=truth))
    measured = itself.mean["T30_s"].measured
    print(
        f"\nMean T30 of {unknown}, predicted over measured, %  "
        + "".join(f"{f:>8g}" for f in result.bands.centres_hz)
    )
    rows = {
        f"model of {s}": change_of(p.mean["T30_s"]).before / p.mean["T30_s"].measured
        for s, p in found.items()
    }
    rows[f"{unknown}, model"] = itself.mean["T30_s"].predicted / measured
    carried = {s: change_of(p.mean["T30_s"]) for s, p in found.items()}
    rows |= {f"{unknown}, carried over from {s}": c.carried / measured for s, c in carried.items()}
    logs = {
        k: np.mean([np.log(getattr(c, k)) for c in carried.values()], axis=0)
        for k in ("carried", "carried_lower95", "carried_upper95")
    }
    both, low, high = (np.exp(logs[k]) for k in logs)
    rows[f"{unknown}, carried over from all"] = both / measured
    t = {s: p.mean["T30_s"].measured for s, p in found.items()}
    first, last = known[0], known[-1]
    areas = material_areas_m2(scene.room), scene.room.materials
    share_of = dict(zip(areas[1], areas[0], strict=True))
    turned = {s: sum(share_of[f"{w}, reflecting"] for w in ABSORBING[s]) for s in (last, unknown)}
    share = turned[unknown] / turned[last]
    sabine = 1.0 / (1.0 / t[first] + share * (1.0 / t[last] - 1.0 / t[first]))
    rows[f"{unknown}, Sabine"] = sabine / measured
    rows[f"{unknown}, mean of both"] = 0.5 * (t[first] + t[last]) / measured
    for name, ratio in rows.items():
        print(error_row(name, ratio, judged))
    held = (low <= measured) & (measured <= high)
    print(
        f"carried over within its interval in {held[judged].sum()} of {judged.sum()} bands, "
        f"median half width {np.median((50.0 * (high - low) / both)[judged]):.1f} %"
    )
    for state, p in found.items():
        print(c50_of(state, unknown, (p,), itself))
    print(c50_of(" and ".join(found), unknown, tuple(found.values()), itself))
    print(edt_of(" and ".join(found), unknown, tuple(found.values()), itself))


def change_of_state(cases: Mapping[str, Case], results: Mapping[str, Result]) -> str:
    """Return how the change from the first state to the second is predicted, walls of both known.

    The floor is that of the first state, all else of the second; pairs measured in both states.
    Formulas have the same walls: measured before times the ratio of their decay times.
    """
    first, second = results
    before, after = (
        {(m.source, m.receiver): m for m in cases[s][1] if isinstance(m, roomfit.Measurement)}
        for s in (first, second)
    )
    common = [name for name in before if name in after]
    scene = cases[first][0]
    names = [
        (s.name, r.name)
        for s, r in ((scene.sources[i], scene.receivers[j]) for i, j in scene.pairs)
    ]
    scene = replace(
        scene,
        pairs=scene.pairs[[names.index(c) for c in common]],
        pair_state=np.zeros(len(common), dtype=np.int64),
    )
    known = absorption_posterior(results[first])
    other = results[second]
    sd = (other.upper95 - other.lower95) / (2.0 * Z95)
    changes = [
        Change(wall, "value", tuple(other.absorption[m]), tuple(sd[m]))
        for m, wall in enumerate(other.materials)
        if wall != "floor"
    ]
    found = predict(Question(scene, known, changes, [before[c] for c in common]))
    truth = predict(Question(scene, known, (), [after[c] for c in common]))
    bands, judged = results[first].bands.centres_hz, results[first].bands.centres_hz > JUDGED_HZ
    lines = [f"\n{first} to {second}, {len(common)} pairs, from {JUDGED_HZ:g} Hz up"]
    judged_by: tuple[tuple[ParameterName, bool], ...] = (
        ("T20_s", True),
        ("T30_s", True),
        ("EDT_s", True),
        ("C50_dB", False),
        ("C80_dB", False),
    )
    for name, relative in judged_by:
        pairs = [
            (p.parameters[name], change_of(p.parameters[name]), q.parameters[name].measured)
            for p, q in zip(found.pairs, truth.pairs, strict=True)
        ]
        error = np.array(
            [(c.carried / y - 1.0) * 100 if relative else c.carried - y for _, c, y in pairs]
        )
        none = np.array(
            [(v.measured / y - 1.0) * 100 if relative else v.measured - y for v, _, y in pairs]
        )
        held = np.array([(c.carried_lower95 <= y) & (y <= c.carried_upper95) for _, c, y in pairs])
        fine = np.isfinite(error) & judged
        unit = "%" if relative else "dB"
        middle, baseline = (np.median(np.abs(x[fine])) for x in (error, none))
        lines.append(
            f"{name:8} by pair, carried over: median |error| {middle:.1f} {unit}, held "
            f"{100 * held[fine].mean():.0f} %; no change {baseline:.1f}; mean by band "
            + " ".join(f"{e:.1f}" for e in np.nanmean(error, axis=0))
        )
    t30 = found.mean["T30_s"].measured, truth.mean["T30_s"].measured
    areas = material_areas_m2(scene.room)
    means = [areas @ a / areas.sum() for a in (known.absorption, found.absorption)]
    mesh, air = scene.room.mesh, attenuation_per_m(scene.air, results[first].bands)
    size = volume_m3(mesh), surface_area_m2(mesh), speed_of_sound_m_s(scene.air)
    eyring = [eyring_time_s(a, *size, air) for a in means]
    sabine = [eyring_time_s(-np.expm1(-a), *size, air) for a in means]
    for label, row in (
        ("Sabine, the same walls", t30[0] * sabine[1] / sabine[0]),
        ("Eyring, the same walls", t30[0] * eyring[1] / eyring[0]),
        ("carried over", change_of(found.mean["T30_s"]).carried),
        ("mean of both states", 0.5 * (t30[0] + t30[1])),
    ):
        lines.append(error_row(f"mean T30, {label}", row / t30[1], judged))
    return "\n".join(lines) + f"\n(bands {' '.join(f'{f:g}' for f in bands)} Hz)"


def error_row(name: str, ratio: FloatArray, judged: BoolArray) -> str:
    """Return one line of errors in per cent, with their median and the largest."""
    error = 100.0 * (ratio - 1.0)
    worst = np.abs(error[judged])
    cells = "".join(f"{e:>8.1f}" for e in error)
    return f"{name:<38}{cells}   median {np.median(worst):.1f}, largest {worst.max():.1f}"


def change_of(value: PredictedValue) -> ValueChange:
    """Return what a change does to a value, of a prediction that was made with changes."""
    if value.change is None:
        raise ValueError("predicted without a change")
    return value.change


def c50_of(state: str, unknown: str, changed: Sequence[Predicted], itself: Predicted) -> str:
    """Return how well C50 is carried over from known states, pair by pair, in their mean."""
    truth = np.array([q.parameters["C50_dB"].measured for q in itself.pairs])[:, 1:]
    before, model, carried, low, high = (
        np.mean([[read(p.parameters["C50_dB"])[1:] for p in c.pairs] for c in changed], axis=0)
        for read in (
            lambda v: v.measured,
            lambda v: v.predicted,
            lambda v: change_of(v).carried,
            lambda v: change_of(v).carried_lower95,
            lambda v: change_of(v).carried_upper95,
        )
    )
    known = np.isfinite(before + truth + carried)
    error, raw, baseline = (np.abs(x - truth)[known] for x in (carried, model, before))
    held = ((low <= truth) & (truth <= high))[known]
    return (
        f"C50, carried over from {state} to {unknown} by pair: median error "
        f"{np.median(error):.2f} dB, {100 * np.mean(error < 1.0):.0f} % within 1 dB, "
        f"{100 * held.mean():.0f} % held (model alone: {np.median(raw):.2f} dB, "
        f"{100 * np.mean(raw < 1.0):.0f} %; no change predicted: {np.median(baseline):.2f} dB, "
        f"{100 * np.mean(baseline < 1.0):.0f} %)"
    )


def edt_of(state: str, unknown: str, changed: Sequence[Predicted], itself: Predicted) -> str:
    """Return how well EDT is carried over from known states, pair by pair, in their mean."""
    truth = np.array([q.parameters["EDT_s"].measured for q in itself.pairs])[:, 1:]
    before, carried, low, high = (
        np.exp(
            np.mean(
                [[np.log(read(p.parameters["EDT_s"])[1:]) for p in c.pairs] for c in changed],
                axis=0,
            )
        )
        for read in (
            lambda v: v.measured,
            lambda v: change_of(v).carried,
            lambda v: change_of(v).carried_lower95,
            lambda v: change_of(v).carried_upper95,
        )
    )
    known = np.isfinite(before + truth + carried)
    error, baseline = (100.0 * np.abs(x / truth - 1.0)[known] for x in (carried, before))
    held = ((low <= truth) & (truth <= high))[known]
    return (
        f"EDT, carried over from {state} to {unknown} by pair: "
        f"median error {np.median(error):.1f} %, "
        f"{100 * held.mean():.0f} % held (no change predicted: {np.median(baseline):.1f} %)"
    )


def c50_text(found: Mapping[str, Predicted]) -> str:
    """Return how well the change of C50 from 000 to R is predicted, pair by pair, from 250 Hz."""
    change = {
        kind: np.array(
            [
                getattr(r.parameters["C50_dB"], kind) - getattr(o.parameters["C50_dB"], kind)
                for r, o in zip(found["R"].pairs, found["000"].pairs, strict=True)
            ]
        )[:, 1:]
        for kind in ("measured", "predicted")
    }
    error = np.abs(change["predicted"] - change["measured"])
    known = np.isfinite(error)
    error, baseline = error[known], np.abs(change["measured"])[known]
    return (
        f"C50, change from 000 to R by pair: median error {np.median(error):.2f} dB, "
        f"{100 * np.mean(error < 1.0):.0f} % within 1 dB "
        f"(no change predicted: {np.median(baseline):.2f} dB, "
        f"{100 * np.mean(baseline < 1.0):.0f} %)"
    )


def main() -> None:
    """Run the rooms that were asked for."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else None)
    parser.add_argument("data", nargs="?", type=Path)
    rooms = [*SAME, "together"]
    parser.add_argument("--room", nargs="+", choices=rooms, default=rooms)
    parser.add_argument("--product-sd", type=float, default=0.3, help="for together, in logit")
    parser.add_argument("--step", type=int, default=30, help="degrees between loudspeakers")
    parser.add_argument("--rings", nargs="+", default=["150", "200"], help="distances in cm")
    about = "of all walls, or of panels and of all else; left out: chosen"
    parser.add_argument("--scattering", type=float, nargs="+", help=about)
    parser.add_argument("--seed", type=int, default=1, help="of the rays")
    parser.add_argument("--model", choices=["auto", "energy", "coherent"], default="auto")
    asked = parser.parse_args()
    if len(asked.scattering or ()) > 2:
        parser.error("--scattering: one coefficient, or two")
    if asked.data is None:
        print("no folder of measurements given: nothing to do")
        return
    settings = roomfit.Settings(model=asked.model, seed=asked.seed)
    for room in asked.room:
        if room == "together":
            known = ("000", "100")
            both = r3vival_together(asked.data, known, ("R",), asked.step, asked.rings)
            result = fitted(
                "r3vival 000 and 100", both, asked.scattering, settings, asked.product_sd
            )
            swap_together(asked.data, both, result, known, "R")
            print()
            for state in ABSORBING:
                alone = r3vival_together(asked.data, (state,), (), asked.step, asked.rings)
                single = fitted(f"r3vival {state}", alone, asked.scattering, settings)
                print(f"{state} and both, {unchanged(single, result, single.materials)}")
            continue
        states = dict.fromkeys(state for pair in SAME[room] for state in pair)
        results, cases = {}, {}
        for state in states:
            case = (
                r3vival(asked.data, state, asked.step, asked.rings)
                if room == "r3vival"
                else dechorate(asked.data, state)
            )
            cases[state] = case
            results[state] = fitted(f"{room} {state}", case, asked.scattering, settings)
        print()
        for (one, other), walls in SAME[room].items():
            print(f"{one} and {other}, {unchanged(results[one], results[other], walls)}")
        if room != "r3vival":
            print(change_of_state(cases, results))


if __name__ == "__main__":
    main()
