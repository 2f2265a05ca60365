"""Known changes of measured rooms: what is said of each wall, and of a room whose walls changed.

    python benchmarks/known_changes.py DATA [--room r3vival together dechorate] [--step DEGREES]
        [--rings 150 200] [--scattering S [S]] [--seed SEED] [--product-sd SD] [--classes]

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
from roomfit.predict.prediction import Predicted
from roomfit.predict.question import Question
from roomfit.result import Result, absorption_posterior
from roomfit.room.mesh import surface_area_m2, volume_m3
from roomfit.room.scene import Point, Scene, material_areas_m2, pair_names, with_states
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
BY_PAIR: tuple[ParameterName, ...] = ("T20_s", "T30_s", "EDT_s", "C50_dB", "C80_dB")
# What somebody who has seen the room says of its walls, where that is known.
CLASSES = {"reflecting": "wood-on-battens", "absorbing": "porous-panel-thick", "floor": "carpet"}
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


def material_prior(
    name: str, scattering: list[float] | None, product_sd: float, classes: bool
) -> MaterialPrior:
    """Return the broad prior of a wall, or of its class; panels of one side are of one product.

    `scattering` is that of panels turned to a side and, last, that of all else.
    """
    prior, side = unknown_material(name, len(BANDS)), name.partition(", ")[2]
    if classes and (side or name) in CLASSES:
        prior = roomfit.material_prior(name, BANDS, prior=CLASSES[side or name])
    if scattering is not None:
        prior = replace(prior, scattering=np.full(len(BANDS), scattering[0 if side else -1]))
    return replace(prior, product=side, product_sd=product_sd) if side and product_sd else prior


def fitted(
    name: str,
    case: Case,
    scattering: list[float] | None,
    settings: roomfit.Settings,
    product_sd: float = 0.0,
    classes: bool = False,
) -> Result:
    """Identify one case, and print what its walls absorb."""
    scene, measurements, directivities = case
    priors = [
        material_prior(scene.room.materials[m], scattering, product_sd, classes)
        for m in range(len(scene.room.materials))
    ]
    began = time.process_time()
    result = roomfit.identify(
        scene, measurements, priors, BANDS, settings=settings, directivities=directivities
    )
    print(f"\n{name}: {len(measurements)} responses, {time.process_time() - began:.0f} CPU s")
    print("reduced chi-square " + " ".join(f"{x:.2f}" for x in result.chi2_reduced))
    print(wall_table(result))
    half = 0.5 * (result.upper95 - result.lower95)
    print(f"{np.sum(half <= 0.1)} of {half.size} half widths within 0.1")
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
    """Predict a state from others that were fitted with it, and show what was fitted again."""
    scene, measurements, _ = case
    posterior, judged = absorption_posterior(result), result.bands.centres_hz > JUDGED_HZ
    chosen = {m.source for m in measurements}
    states, pairs = ["", *(s.name for s in scene.room.states)], np.unique(scene.pairs, axis=0)
    found: dict[str, Predicted] = {}
    for number, state in enumerate((*known, unknown)):
        name = "" if number == 0 else state
        own = r3vival(data, state, 1, ("150", "200"))[1]
        own = [replace(m, state=name) for m in own if m.source in chosen]
        at = replace(scene, pairs=pairs, pair_state=np.full(len(pairs), states.index(name)))
        found[state] = predict(Question(at, posterior, (), own))
    times = {state: p.mean["T30_s"] for state, p in found.items()}
    head = "".join(f"{f:>8g}" for f in result.bands.centres_hz)
    print(f"\n{'Mean T30, predicted over measured, %':<38}{head}")
    for state, v in times.items():
        print(error_row(f"{state}, predicted", v.predicted / v.measured, judged))
        half = 50.0 * (v.upper95 - v.lower95) / v.predicted
        held = ((v.lower95 <= v.measured) & (v.measured <= v.upper95))[judged]
        cells = "".join(f"{h:>8.1f}" for h in half)
        print(f"{'  half width':<38}{cells}   held {held.sum()} of {held.size}")
    first, last = known[0], known[-1]
    t = {s: v.measured for s, v in times.items()}
    areas = dict(zip(scene.room.materials, material_areas_m2(scene.room), strict=True))
    turned = [sum(areas[f"{w}, reflecting"] for w in ABSORBING[s]) for s in (unknown, last)]
    rate = 1.0 / t[first] + turned[0] / turned[1] * (1.0 / t[last] - 1.0 / t[first])
    print(error_row(f"{unknown}, Sabine", 1.0 / rate / t[unknown], judged))
    both = 0.5 * (t[first] + t[last])
    print(error_row(f"{unknown}, mean of both", both / t[unknown], judged))
    for parameter in BY_PAIR:
        print(by_pair(parameter, unknown, found[unknown], [found[s] for s in known]))


def by_pair(name: ParameterName, state: str, found: Predicted, known: Sequence[Predicted]) -> str:
    """Return how well a parameter of a state is predicted pair by pair, from 250 Hz up."""

    def read(key: str, of: Predicted) -> FloatArray:
        return np.array([getattr(p.parameters[name], key)[1:] for p in of.pairs])

    truth, is_time = read("measured", found), name.endswith("_s")

    def off(values: FloatArray) -> FloatArray:
        return np.asarray(100.0 * np.log(values / truth) if is_time else values - truth)

    error = off(read("predicted", found))
    fine, unit = np.isfinite(error), "%" if is_time else "dB"
    held = (read("lower95", found) <= truth) & (truth <= read("upper95", found))
    unchanged = np.mean([off(read("measured", of)) for of in known], axis=0)
    return (
        f"{name} of {state} by pair: median error {np.median(np.abs(error[fine])):.2f} {unit}, "
        f"{100 * held[fine].mean():.0f} % held; mean of the known states "
        f"{np.nanmedian(np.abs(unchanged[fine])):.2f} {unit}"
    )


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
    common, scene = [name for name in before if name in after], cases[first][0]
    names = [name[:2] for name in pair_names(scene)]
    at = scene.pairs[[names.index(c) for c in common]]
    scene = replace(scene, pairs=at, pair_state=np.zeros(len(common), dtype=np.int64))
    known, other = absorption_posterior(results[first]), results[second]
    sd = (other.upper95 - other.lower95) / (2.0 * Z95)
    changes = [
        Change(wall, "value", tuple(other.absorption[m]), tuple(sd[m]))
        for m, wall in enumerate(other.materials)
        if wall != "floor"
    ]
    found = predict(Question(scene, known, changes, [after[c] for c in common]))
    plain = predict(Question(scene, known, (), [before[c] for c in common]))
    bands, judged = results[first].bands.centres_hz, results[first].bands.centres_hz > JUDGED_HZ
    lines = [f"\n{first} to {second}, {len(common)} pairs, from {JUDGED_HZ:g} Hz up"]
    lines += [by_pair(name, second, found, [plain]) for name in BY_PAIR]
    t30 = plain.mean["T30_s"].measured, found.mean["T30_s"].measured
    areas = material_areas_m2(scene.room)
    means = [areas @ a / areas.sum() for a in (known.absorption, found.absorption)]
    mesh, air = scene.room.mesh, attenuation_per_m(scene.air, results[first].bands)
    size = volume_m3(mesh), surface_area_m2(mesh), speed_of_sound_m_s(scene.air)
    eyring = [eyring_time_s(a, *size, air) for a in means]
    sabine = [eyring_time_s(-np.expm1(-a), *size, air) for a in means]
    for label, row in (
        ("Sabine, the same walls", t30[0] * sabine[1] / sabine[0]),
        ("Eyring, the same walls", t30[0] * eyring[1] / eyring[0]),
        ("predicted", found.mean["T30_s"].predicted),
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


def main() -> None:
    """Run the rooms that were asked for."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else None)
    parser.add_argument("data", nargs="?", type=Path)
    rooms = [*SAME, "together"]
    parser.add_argument("--room", nargs="+", choices=rooms, default=rooms)
    parser.add_argument("--product-sd", type=float, default=0.3, help="for together, in logit")
    parser.add_argument("--classes", action="store_true", help="for together, say what walls are")
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
            given, classes = asked.scattering, asked.classes
            name = "r3vival 000 and 100"
            result = fitted(name, both, given, settings, asked.product_sd, classes)
            swap_together(asked.data, both, result, known, "R")
            print()
            for state in ABSORBING:
                alone = r3vival_together(asked.data, (state,), (), asked.step, asked.rings)
                single = fitted(f"r3vival {state}", alone, given, settings, classes=classes)
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
