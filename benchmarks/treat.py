"""What to hang where: a room whose walls really were turned, and parts of walls.

    python benchmarks/treat.py DATA [--result FILE] [--at-most SECONDS]
    python benchmarks/treat.py --parts

DATA holds `r3vival` (one room in three states of its wall panels, Amengual Gari and others). Its
states 000 and 100 are fitted together; asked is which walls of 000 to turn, as few as possible, so
that the mean T30 of 500 to 2000 Hz is at most so long. What the answer and the right wall alone are
predicted to do stands beside Sabine's formula with the two measured states, and beside state R, of
which nothing was read: its right wall is turned. `--result` takes the result.json of an earlier
fit. `--parts` compares a ceiling that is covered in part, as the mean of its absorption by area,
with a full trace of the ceiling divided.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import roomfit
from known_changes import BANDS, WALLS, fitted, r3vival, r3vival_together
from roomfit.base.polygon import Face
from roomfit.base.polygon import Surface as MeshSurface
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.fit.measurements import observe
from roomfit.predict.predict import prepare
from roomfit.predict.question import Question
from roomfit.result import absorption_posterior
from roomfit.room.build import build_mesh
from roomfit.room.scene import Room, Scene, material_areas_m2, room_from_mesh
from roomfit.signals.decay import jnd_of
from roomfit.signals.iso3382 import VALUE_NAMES
from roomfit.tracing.enclosure import reached
from roomfit.treat.arrangements import treat
from roomfit.treat.question import Product, Surface, Target, problem_of, treated
from roomfit.treat.search import mean_values
from roomfit.uncertainty.posterior import AbsorptionPosterior

MIDDLE_HZ = (500.0, 1000.0, 2000.0)
T30 = VALUE_NAMES.index("T30_s")


def turned_walls(data: Path, result_file: Path | None, at_most_s: float) -> None:
    """Print which walls to turn, what that is predicted to do, and what was measured."""
    scene, measurements, _ = r3vival_together(data, ("000", "100"), ("R",), 30, ("150", "200"))
    if result_file is None:
        case = r3vival_together(data, ("000", "100"), ("R",), 30, ("150", "200"))
        settings = roomfit.Settings(model="energy", seed=1)
        known = absorption_posterior(fitted("r3vival 000 and 100", case, None, settings, 0.3))
    else:
        known = roomfit.read_result(result_file)
    own = [m for m in measurements if not m.state]
    at = replace(scene, pair_state=np.zeros(len(scene.pairs), dtype=np.int64))
    began = time.perf_counter()
    room = prepare(Question(at, known, measurements=own))
    print(f"\nprepared in {time.perf_counter() - began:.1f} s: {len(at.pairs)} pairs")
    areas = dict(zip(at.room.materials, material_areas_m2(at.room), strict=True))
    surfaces, products = [], []
    for wall in WALLS[:4]:
        name, area = f"{wall}, reflecting", float(areas[f"{wall}, reflecting"])
        index = known.materials.index(f"{wall}, absorbing")
        nothing = np.zeros(len(known.bands))
        products.append(
            Product(
                f"{wall} panels, absorbing side", known.absorption[index], nothing,
                1.0 / area, 0.9999 * area, entry=f"{wall}, absorbing",
            )
        )  # fmt: skip
        surfaces.append(Surface(name, products=(products[-1].name,)))
    target = Target("T30_s", high=at_most_s, bands_hz=MIDDLE_HZ, mean_of_bands=True)
    began = time.perf_counter()
    answer = treat(room, surfaces, products, [target], number=3)
    print(f"asked for T30 of at most {at_most_s:g} s, mean of 500 to 2000 Hz, fewest walls turned;")
    print(f"answered in {time.perf_counter() - began:.1f} s\n")
    middle = np.isin(BANDS.centres_hz, MIDDLE_HZ)
    for a in answer.arrangements:
        walls = ", ".join(h.surface.partition(",")[0] for h in a.hung) or "none"
        v = a.mean["T30_s"]
        row = " ".join(f"{x:.2f}" for x in v.predicted)
        print(
            f"turn {walls:<20} T30 {row}   mean {v.predicted[middle].mean():.3f} s, "
            f"met with {100 * a.joint:.0f} %"
        )
    question = problem_of(room, surfaces, products, [target])
    right = np.array(
        [float(question.products[p].name.startswith("right")) for p in question.product]
    )
    predicted = mean_values(question.room, treated(question, right)[None])[0, T30]
    truth, before, after = (measured_t30(data, state) for state in ("R", "000", "100"))
    share = areas["right, reflecting"] / sum(areas[s.material] for s in surfaces)
    sabine = 1.0 / (1.0 / before + share * (1.0 / after - 1.0 / before))
    print(
        "\nThe right wall alone      " + "".join(f"{f:>8g}" for f in BANDS.centres_hz) + "  middle"
    )
    for label, times in (
        ("as it is, measured", before),
        ("right turned, predicted", predicted),
        ("right turned, Sabine", sabine),
        ("right turned, measured", truth),
    ):
        cells = "".join(f"{x:>8.3f}" for x in times)
        print(f"{label:<26}{cells}{times[middle].mean():>8.3f}")
    for label, times in (("predicted", predicted), ("Sabine", sabine)):
        error = 100.0 * (times / truth - 1.0)
        cells = "".join(f"{x:>8.1f}" for x in error)
        own_error = 100.0 * (times[middle].mean() / truth[middle].mean() - 1.0)
        print(f"{'error of ' + label + ', %':<26}{cells}{own_error:>8.1f}")
    sabine_choice(at_most_s, areas, before, after, middle)


def sabine_choice(
    at_most_s: float,
    areas: dict[str, float],
    before: FloatArray,
    after: FloatArray,
    middle: BoolArray,
) -> None:
    """Print which walls Sabine's formula would turn: each counts by its area."""
    whole = sum(areas[f"{w}, reflecting"] for w in WALLS[:4])
    best: tuple[int, float, list[str]] | None = None
    for bits in range(16):
        walls = [w for i, w in enumerate(WALLS[:4]) if bits >> i & 1]
        share = sum(areas[f"{w}, reflecting"] for w in walls) / whole
        t = 1.0 / (1.0 / before + share * (1.0 / after - 1.0 / before))
        mean = float(t[middle].mean())
        if mean <= at_most_s and (best is None or (len(walls), mean) < best[:2]):
            best = (len(walls), mean, walls)
    said = "none of the sixteen" if best is None else f"{', '.join(best[2])} ({best[1]:.3f} s)"
    print(f"Sabine would turn: {said}")


def measured_t30(data: Path, state: str) -> FloatArray:
    """Return the measured mean T30 of a state by band."""
    scene, measurements, _ = r3vival(data, state, 30, ("150", "200"))
    found, _ = observe(scene, measurements, BANDS)
    return np.asarray(np.nanmean([m.parameters.values[T30] for m in found], axis=0))


def box(lengths_m: tuple[float, float, float], n_pairs: int) -> Scene:
    """Return a box with names for its six sides and pairs spread within."""
    rng = np.random.default_rng(4)
    points = 0.8 + rng.random((n_pairs + 2, 3)) * (np.array(lengths_m) - 1.6)
    sides = {s: s for s in ("west", "east", "south", "north", "floor", "ceiling")}
    room = roomfit.shoebox_room(lengths_m, sides)
    receivers = {f"R{i}": tuple(p) for i, p in enumerate(points[2:])}
    return roomfit.scene_of(room, {"S1": tuple(points[0])}, receivers)


def posterior(materials: tuple[str, ...], absorption: FloatArray) -> AbsorptionPosterior:
    """Return a posterior of 10 % (in logit) about an absorption, shape (n_materials, n_bands)."""
    low, high = (1.0 / (1.0 + (1.0 / absorption - 1.0) * np.exp(s * 0.2)) for s in (1.0, -1.0))
    covariance = np.stack([0.01 * np.eye(len(materials))] * absorption.shape[1])
    bands = roomfit.bands_between("octave", 125, 4000)
    return AbsorptionPosterior(materials, bands, absorption, low, high, covariance)


def strip_room(lengths_m: tuple[float, float, float], shares: FloatArray) -> Room:
    """Return a box whose ceiling is cut across its length at shares of it, 0 and 1 among them."""
    x, y, z = lengths_m
    n = len(shares) - 1
    vertices = [(x * e, w, z) for e in shares for w in (0.0, y)]
    vertices += [(a, b, 0.0) for a in (0.0, x) for b in (0.0, y)]
    last, f = 2 * n, 2 * n + 2
    polygons = {f"strip{i + 1}": (2 * i, 2 * i + 1, 2 * i + 3, 2 * i + 2) for i in range(n)}
    polygons |= {
        "west": (f, f + 1, 1, 0),
        "east": (f + 2, last, last + 1, f + 3),
        "floor": (f, f + 2, f + 3, f + 1),
        "south": (f, *range(0, last + 1, 2), f + 2),
        "north": (f + 1, f + 3, *range(last + 1, 0, -2)),
    }
    faces = [Face(corners, MeshSurface(name)) for name, corners in polygons.items()]
    mesh, _ = reached(build_mesh(np.array(vertices), faces)[0])
    return room_from_mesh(mesh, {name: name for name in polygons})


PARTS = (
    ("end", (0.0, 0.25, 1.0), 0),
    ("end", (0.0, 0.5, 1.0), 0),
    ("end", (0.0, 0.75, 1.0), 0),
    ("middle", (0.0, 0.25, 0.75, 1.0), 1),
    ("middle", (0.0, 0.375, 0.625, 1.0), 1),
)
OWN, COVER = 0.08, 0.75


def parts() -> None:
    """Print a ceiling covered in part as the mean by area and divided, and draw it."""
    lengths_m = (7.0, 5.0, 3.0)
    rows = []
    print("ceiling covered   share   T30 by area, divided (s)     difference in jnd: T30  EDT  C50")
    for where, cuts, covered in PARTS:
        shares = np.array(cuts)
        part = float(np.diff(shares)[covered])
        scene = replace(box(lengths_m, 6), room=strip_room(lengths_m, shares))
        materials = scene.room.materials
        ceiling = [i for i, m in enumerate(materials) if m.startswith("strip")]
        a = np.full((len(materials), 6), OWN)
        a[ceiling] = OWN + part * (COVER - OWN)
        divided = a.copy()
        divided[ceiling] = OWN
        divided[materials.index(f"strip{covered + 1}")] = COVER
        settings = roomfit.Settings(n_rays=8000, n_draws=2)
        found = []
        for absorption in (a, divided):
            room = prepare(Question(scene, posterior(materials, absorption), settings=settings))
            found.append(np.mean([n.values for n in room.before], axis=0)[:, 2:5].mean(axis=1))
        mean, exact = found
        steps = [
            (mean[VALUE_NAMES.index(n)] - exact[VALUE_NAMES.index(n)])
            / float(jnd_of(n, exact[VALUE_NAMES.index(n)]))
            for n in ("T30_s", "EDT_s", "C50_dB")
        ]
        rows.append((f"{100 * part:.0f} % at the {where}", steps))
        print(
            f"at the {where:<8} {100 * part:6.0f} %   {mean[T30]:.3f} {exact[T30]:.3f}"
            f"{'':<29}" + "  ".join(f"{s:+.1f}" for s in steps)
        )


def main() -> None:
    """Run what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else None)
    parser.add_argument("data", nargs="?", type=Path)
    parser.add_argument("--result", type=Path, help="result.json of the fit of 000 and 100")
    parser.add_argument("--at-most", type=float, default=0.57, help="s")
    parser.add_argument("--parts", action="store_true")
    asked = parser.parse_args()
    if asked.data is not None:
        turned_walls(asked.data, asked.result, asked.at_most)
    if asked.parts:
        parts()


if __name__ == "__main__":
    main()
