"""Whether predicted intervals hold what is measured, with draws of the real model and without.

    python benchmarks/predictive_draws.py [N_ROOMS] [--first SEED] [--values | --responses]
        [--room box slanted l-shaped hall]

box        random size and six random materials, simulated by image sources as pressures
slanted, l-shaped  polyhedra of six random materials, simulated by pressures from cell to cell
hall       a fan of 8,064 m3, twelve materials with scattering: other rays of the model itself,
           whose energies modulate noise, so that reflections interfere; the direct sound and the
           first reflections are pulses

The four pairs of one source are fitted, by values of ISO 3382-1 alone or by responses; those of the
other are predicted, and once more with one wall exchanged for a known one, which is simulated, too.
Each is predicted from the same fit with draws of the model itself ("now", the default where
values alone are fitted) and with linearised ones.

T20 and T30 are left out where noise leaves less than 10 dB below their range (ISO 3382-1, 5.3.3).
Errors and half widths are rms values in just noticeable differences; z are errors over the standard
deviations that intervals promise, whose rms is 1 where they keep it. "null" knows nothing of the
room: the mean of the other measured pairs.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np
from scipy import fft

from roomfit.base.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import bands_between
from roomfit.base.errors import InputError
from roomfit.base.logit import Z95, expit, logit
from roomfit.base.polygon import Surface
from roomfit.demo.boxes import (
    ECHOGRAM_BIN_S,
    PRESSURE_SQUARED,
    add_noise,
    modulated_noise,
    write_measured_box,
)
from roomfit.files.campaign import read_campaign
from roomfit.files.inputs import identify_arguments
from roomfit.fit.measurements import observe
from roomfit.identify import identify
from roomfit.materials.catalogue import material_prior
from roomfit.materials.priors import MaterialPrior, Scattering
from roomfit.model.binned import BIN_S, bin_paths, pair_energies
from roomfit.model.weighing import EnergyRows, window_of_rows
from roomfit.predict.changes import Change
from roomfit.predict.predict import predict
from roomfit.predict.prediction import Predicted
from roomfit.predict.question import Question
from roomfit.result import absorption_posterior
from roomfit.room.mesh import Mesh
from roomfit.room.scene import Room, Scene, pair_names, scene_of
from roomfit.settings import Settings
from roomfit.signals.decay import jnd_of
from roomfit.signals.iso3382 import VALUE_NAMES, MeasuredValues, ValueName
from roomfit.signals.measurement import Measurement
from roomfit.tracing.paths import TraceSettings
from roomfit.tracing.trace import trace
from simulated_rooms.hall import hall_room
from simulated_rooms.measured_polyhedron import (
    Shape,
    polyhedron_plan,
    write_measured_polyhedron,
)
from simulated_rooms.random_boxes import random_plan

BANDS = bands_between("octave", 500, 1000)
CHANGED_TO = 0.2
HALL_SCATTERING = 0.3
FEW = Settings(n_rays_beside_images=10_000, n_rays=10_000)


@dataclass(frozen=True)
class Simulated:
    """A room as it was measured, and with one of its walls exchanged."""

    scene: Scene
    materials: tuple[MaterialPrior, ...]
    responses: list[Measurement]
    values: list[MeasuredValues]
    after: list[MeasuredValues]
    changed: str


def simulated(kind: str, seed: int) -> Simulated:
    """Return one room of a kind."""
    both, changed = [], ""
    for exchanged in (False, True):
        with tempfile.TemporaryDirectory() as name:
            if kind == "hall":
                scene, priors, responses, changed = hall(seed, exchanged)
            else:
                path, changed = write(kind, seed, exchanged, Path(name))
                ends_hz = float(BANDS.centres_hz[0]), float(BANDS.centres_hz[-1])
                found = identify_arguments(read_campaign(path), ends_hz)
                scene, priors = found["scene"], tuple(found["materials"])
                responses = [m for m in found["measurements"] if isinstance(m, Measurement)]
        both.append((scene, priors, responses, values_of(scene, responses)))
    (scene, priors, responses, values), (*_, after) = both
    return Simulated(scene, priors, responses, values, after, changed)


def write(kind: str, seed: int, exchanged: bool, folder: Path) -> tuple[Path, str]:
    """Simulate a box or a polyhedron; return its campaign and the material that is exchanged."""
    rng = np.random.default_rng(seed)
    if kind == "box":
        plan = random_plan(rng)
        a = plan.absorption.copy()
        a[seed % 6] = CHANGED_TO if exchanged else a[seed % 6]
        plan = replace(plan, absorption=a)
        return write_measured_box(plan, folder, np.random.default_rng(seed)), plan.materials[
            seed % 6
        ]
    room = polyhedron_plan(cast(Shape, kind), rng)
    a = room.absorption.copy()
    a[seed % 6] = CHANGED_TO if exchanged else a[seed % 6]
    measured = write_measured_polyhedron(
        replace(room, absorption=a), folder, np.random.default_rng([seed, 8])
    )
    return measured.campaign, measured.materials[seed % 6]


def hall(
    seed: int, exchanged: bool
) -> tuple[Scene, tuple[MaterialPrior, ...], list[Measurement], str]:
    """Return a fan-shaped hall, each of its twelve triangles of a material of its own."""
    rng = np.random.default_rng([seed, 5])
    shell = hall_room(12).mesh
    names = tuple(f"material_{i}" for i in range(12))
    surfaces = tuple(Surface(name, None, name) for name in names)
    room = Room(
        Mesh(shell.vertices_m, shell.triangles, np.arange(12), surfaces), names, np.arange(12)
    )
    sources = {"LS1": (4.0, -2.0, 1.7), "LS2": (6.0, 4.0, 1.5)}
    places = {
        f"MP{i}": tuple(rng.uniform((12.0, -8.0, 1.1), (30.0, 8.0, 3.0))) for i in range(1, 5)
    }
    scene = scene_of(room, sources, places)
    priors = tuple(material_prior(n, BANDS, scattering=HALL_SCATTERING) for n in names)
    true = expit(rng.uniform(logit(np.array(0.03)), logit(np.array(0.7)), 12))
    wall = seed % 12
    true[wall] = CHANGED_TO if exchanged else true[wall]
    length_s, rate_hz, wide = 3.0, 8000, bands_between("octave", 250, 2000)
    traced = trace(
        scene,
        TraceSettings(
            duration_s=length_s, n_rays=60_000, image_order=1, seed=99, receiver_radius_m=0.8
        ),
        Scattering(names, np.full(12, HALL_SCATTERING)),
    ).paths
    binned = bin_paths(scene, wide, traced, length_s)
    absorption, air = np.tile(true[:, None], len(wide)), attenuation_per_m(scene.air, wide)
    frequencies = fft.rfftfreq(round(length_s * rate_hz), 1.0 / rate_hz)
    responses = []
    for i, (source, receiver, _) in enumerate(pair_names(scene)):
        energy = pair_energies(binned, wide, i, absorption, air)
        window, own, travel_s = images(binned.rows[i], true, scene, float(air[2]))
        energy -= np.bincount(window, own, energy.shape[1])
        kept = np.maximum(energy[:, binned.edges_s[:-1] > -0.5 * BIN_S], 0.0)
        echogram = kept.reshape(len(wide), -1, round(ECHOGRAM_BIN_S / BIN_S)).sum(axis=2)
        ends = (round(length_s * rate_hz), rate_hz, wide.centres_hz, np.zeros(len(wide)), rng)
        spectrum = np.sqrt(PRESSURE_SQUARED * own) @ np.exp(
            -2j * np.pi * np.outer(travel_s, frequencies)
        )
        pressure = fft.irfft(spectrum, ends[0]) + modulated_noise(echogram, *ends)
        responses.append(Measurement(source, receiver, add_noise(pressure, -75.0, rng), rate_hz))
    return scene, priors, responses, names[wall]


def images(
    rows: EnergyRows, absorption: np.ndarray, scene: Scene, attenuation_per_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the bin, the energy and the travel time of each path that is no ray's."""
    own = np.flatnonzero(rows.batch < 0)
    length_m = rows.length_m[own]
    energy = rows.weight_per_m2[own] * np.exp(-attenuation_per_m * length_m)
    energy = energy * np.prod((1.0 - absorption) ** rows.hits[own], axis=1)
    return window_of_rows(rows)[own], energy, length_m / speed_of_sound_m_s(scene.air)


def values_of(scene: Scene, responses: Sequence[Measurement]) -> list[MeasuredValues]:
    """Return the room parameters of responses as a table."""
    names: tuple[ValueName, ...] = ("T20_s", "T30_s", "EDT_s", "C80_dB", "D50_percent", "TS_ms")
    ranges_db = {"T20_s": 35.0, "T30_s": 45.0}
    values = []
    for m in observe(scene, responses, BANDS)[0]:
        table = dict(zip(VALUE_NAMES, m.parameters.values, strict=False))
        kept = {
            n: table[n]
            for n in names
            if np.isfinite(table[n]).all()
            and ranges_db.get(n, 0.0) <= float(m.curve.usable_db.min())
        }
        if kept:
            own = m.measurement
            values.append(MeasuredValues(own.source, own.receiver, BANDS.centres_hz, kept))
    return values


def rows(predicted: Predicted, sources: tuple[str, ...]) -> np.ndarray:
    """Return measured, predicted, lower, upper and the others' mean, in just noticeable steps."""
    found = []
    for pair in predicted.pairs:
        if pair.source in sources:
            for name, v in pair.parameters.items():
                unit = jnd_of(name, v.measured)
                table = (v.measured, v.predicted, v.lower95, v.upper95, v.mean_of_others)
                found += [r for r in (np.array(table) / unit).T if np.isfinite(r[:4]).all()]
    return np.array(found).reshape(-1, 5)


def line(label: str, tables: list[np.ndarray]) -> str:
    """Return how often intervals hold, how wide they are, and where the measured values lie."""
    t = np.concatenate(tables)
    half, error = 0.5 * (t[:, 3] - t[:, 2]), t[:, 1] - t[:, 0]
    held = np.mean((t[:, 2] <= t[:, 0]) & (t[:, 0] <= t[:, 3]))
    rms, width = np.sqrt(np.mean(error**2)), np.sqrt(np.mean(half**2))
    below = np.mean(t[:, 0] < 0.5 * (t[:, 2] + t[:, 3]))
    own = np.mean((t[:, 2] <= t[:, 1]) & (t[:, 1] <= t[:, 3]))
    null = np.sqrt(np.nanmean((t[:, 4] - t[:, 0]) ** 2))
    side = np.where(t[:, 0] < t[:, 1], t[:, 1] - t[:, 2], t[:, 3] - t[:, 1])
    z = Z95 * error / np.maximum(side, 0.05 * half)
    return (
        f"{label:34} held {held:.3f}  error {rms:6.2f}  half width {width:6.2f} "
        f"({width / rms:.2f})  below the middle {below:.2f}  z median {np.median(np.abs(z)):.2f}  "
        f"own estimate held {own:.3f}  null {null:6.2f}  n {len(t)}"
    )


def main() -> None:
    """Print one line for each kind of data, prediction and law."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("n_rooms", type=int, nargs="?", default=6)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--values", action="store_true")
    parser.add_argument("--responses", action="store_true")
    kinds = ("box", "slanted", "l-shaped", "hall")
    parser.add_argument("--room", nargs="+", choices=kinds, default=["box"])
    asked = parser.parse_args()
    both = asked.values == asked.responses
    wanted = [("values", both or asked.values), ("responses", both or asked.responses)]
    found: dict[str, list[np.ndarray]] = {}
    for kind in asked.room:
        for seed in range(asked.first, asked.first + asked.n_rooms):
            try:
                case = simulated(kind, seed)
            except InputError as error:  # a random room may be too dead to be measured
                sys.stdout.write(f"{kind} {seed} left out: {error.what}\n")
                continue
            for data in (name for name, is_wanted in wanted if is_wanted):
                label = f"{kind}, {data}"
                for name, table in judged(case, data, label).items():
                    found.setdefault(name, []).append(table)
                    if len(table):
                        sys.stdout.write("   " + line(name, [table]) + "\n")
                sys.stdout.flush()
    sys.stdout.write("\n")
    for label, tables in found.items():
        sys.stdout.write(line(label, tables) + "\n")


def judged(case: Simulated, data: str, label: str) -> dict[str, np.ndarray]:
    """Return the tables of one room, fitted by values or responses, and print what it took."""
    of: Sequence[Measurement | MeasuredValues] = case.values if data == "values" else case.responses
    fitted = [m for m in of if m.source == "LS1"]
    seconds, answers = [], []
    for drawn in (False, True):
        settings = replace(FEW, posterior_draws=drawn)
        began = time.process_time()
        answers.append(identify(case.scene, fitted, case.materials, BANDS, settings=settings))
        seconds.append(time.process_time() - began)
    sys.stdout.write(
        f"{label}: identify {seconds[1]:.1f} CPU s, linearised {seconds[0]:.1f}; phi "
        + " ".join(f"{x:.2f}" for x in answers[1].chi2_reduced)
        + "\n"
    )
    change = Change(case.changed, "value", (CHANGED_TO,), (0.0,))
    found = {}
    for law, answer in (("linearised", answers[0]), ("now", answers[1])):
        own = absorption_posterior(answer)
        same = predict(Question(case.scene, own, (), case.values, settings=FEW))
        new = predict(Question(case.scene, own, (change,), case.after, settings=FEW))
        found[f"{label}, fitted pairs, {law}"] = rows(same, ("LS1",))
        found[f"{label}, other source, {law}"] = rows(same, ("LS2",))
        found[f"{label}, wall exchanged, {law}"] = rows(new, ("LS1", "LS2"))
    return found


if __name__ == "__main__":
    main()
