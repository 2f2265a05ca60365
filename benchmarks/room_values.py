"""ISO 3382 values as the only data: pairs left out and predicted, beside the null model.

    python benchmarks/room_values.py FOLDER [--room ROOM] [--closed]

FOLDER holds `bras_cr2` (scene9.ac, measured values of five pairs, one response; Aspoeck et al.,
2020) and `ptb_studio` (polygons, measured values of six pairs; PTB's round robin III). Neither
comes with roomfit. Each pair is left out in turn, the absorption fitted to the others, and all its
values predicted. The null model knows nothing of the room: it takes the mean of the pairs that
were fitted.

--closed   the studio with its curtains closed, from a fit with open ones: by broad priors, by
           classes of the catalogue, and by what the participants knew of its materials
"""

from __future__ import annotations

import argparse
import csv
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from _ac3d import as_obj
from measured_rooms import bras_campaign
from roomfit.base.air import Air, attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import bands_between
from roomfit.files.campaign import read_campaign
from roomfit.files.inputs import read_measurements
from roomfit.files.rooms import read_room
from roomfit.files.schema import PolygonSpec, RoomSpec
from roomfit.files.values import read_parameters
from roomfit.fit.bands import fitted_band
from roomfit.fit.compare import compared_values
from roomfit.fit.measurements import observe
from roomfit.materials.catalogue import material_prior
from roomfit.materials.priors import (
    MaterialPrior,
    Scattering,
    logit_prior,
    prior_logit_law,
    unknown_material,
)
from roomfit.model.binned import BinnedPaths, bin_paths
from roomfit.model.directivity import energy_objective
from roomfit.model.eyring import eyring_absorption
from roomfit.model.observation import energy_terms
from roomfit.model.problem import Objective
from roomfit.model.room_parameters import predicted_values, value_terms, without_responses
from roomfit.room.mesh import surface_area_m2, volume_m3
from roomfit.room.scene import Point, Scene, material_areas_m2
from roomfit.settings import Settings
from roomfit.signals.iso3382 import VALUE_NAMES, MeasuredValues, ValueName
from roomfit.signals.measurement import Measurement
from roomfit.tracing.paths import TraceSettings
from roomfit.tracing.trace import trace
from roomfit.uncertainty.combinations import determined
from roomfit.uncertainty.gaussian import BandEstimate
from roomfit.uncertainty.intervals import Refinement, identifiable_by_rule

BANDS = bands_between("octave", 125, 4000)
N_RAYS = 15_000
STUDIO_TABLE = {"T30/s": "T30", "EDT/s": "EDT", "C/dB": "C80", "D/%": "D50", "TS/ms": "TS"}
STUDIO_TABLE["G/dB"] = "G"
# What somebody who has seen the studio says of its materials.
STUDIO_CLASSES = {"parquet": "linoleum-or-parquet", "studio wall": "plaster-or-concrete"}
STUDIO_CLASSES |= {
    "windowglass": "glass",
    "wilhelmi": "porous-panel-thin",
    "curtain(open)": "curtain",
}
STUDIO_CLASSES |= dict.fromkeys(("wood", "wood absorber"), "wood-on-battens")
STUDIO_CLASSES["ceiling"] = "plasterboard"


@dataclass(frozen=True)
class Case:
    """A measured room: what is known, what was measured, and the bands that are judged."""

    name: str
    scene: Scene
    values: tuple[MeasuredValues, ...]
    scattering: np.ndarray
    priors: tuple[MaterialPrior, ...]
    duration_s: float
    judged: slice
    image_order: int = 2
    n_rays: int = N_RAYS
    model_error_jnd: float = 0.3
    names: tuple[ValueName, ...] = VALUE_NAMES


def seminar_room(folder: Path) -> Case:
    """Return BRAS CR2 with source LS1."""
    room, _ = read_room(RoomSpec(file=as_obj(folder / "scene9.ac"), unit="m", up="y"))
    places = [(-0.993, 1.426, 1.23), (0.439, -0.147, 1.23), (1.361, -0.603, 1.23)]
    places += [(-1.110, -0.256, 1.23), (-0.998, -1.409, 1.23)]
    receivers = tuple(Point(f"MP{i}", np.array(p)) for i, p in enumerate(places, start=1))
    source = Point("LS1", np.array([0.931, -2.547, 0.723]))
    pairs = np.array([(0, i) for i in range(5)])
    scene = Scene(room, (source,), receivers, pairs, Air(19.5, 41.7))
    values, _ = read_parameters(folder / "measured_LS1_per_pair_octave.csv")
    priors = tuple(unknown_material(m, len(BANDS)) for m in room.materials)
    return Case(
        "BRAS CR2, 500 to 4000 Hz",
        scene,
        values,
        np.full(len(room.materials), 0.1),
        priors,
        1.6,
        slice(2, 6),
    )


def studio(folder: Path, *, closed: bool = False) -> Case:
    """Return PTB's studio of phase 3, with its curtains open or closed."""
    spec = PolygonSpec(
        corners=(folder / "corners.csv", folder / "corners_phase3.csv"),
        planes=(folder / "planes.csv",),
        replace={"10": folder / "planes_wood_absorbers.csv", "25": folder / "planes_ceiling.csv"},
        drop=tuple(range(351, 357)) if closed else (301, 391),
    )
    room, _ = read_room(RoomSpec(polygons=spec, materials={"studio_wall": "studio wall"}))
    sources = (Point("S1", np.array([1.5, 3.5, 1.5])), Point("S2", np.array([-1.5, 5.5, 1.5])))
    places = [(-2.0, 3.0, 1.2), (2.0, 6.0, 1.2), (0.0, 7.5, 1.2)]
    receivers = tuple(Point(f"R{i}", np.array(p)) for i, p in enumerate(places, start=1))
    pairs = np.array([(s, r) for s in (0, 1) for r in (0, 1, 2)])
    scene = Scene(room, sources, receivers, pairs, Air(20.0, 50.0, 100.0))
    scattering = np.array([np.mean(stated(folder, m)[1]) for m in room.materials])
    priors = tuple(unknown_material(m, len(BANDS)) for m in room.materials)
    return Case(
        "PTB studio, 250 to 4000 Hz",
        scene,
        studio_values(folder),
        scattering,
        priors,
        1.25,
        slice(1, 6),
        image_order=0,
    )


def stated(folder: Path, material: str) -> tuple[np.ndarray, np.ndarray]:
    """Return absorption and scattering as the participants were given them, (6,) each."""
    wanted = material.replace(" ", "").replace("windowglass", "windowglas")
    with (folder / "properties_conditions.csv").open(encoding="utf-8-sig") as stream:
        for cells in csv.reader(stream):
            if cells[0].replace(" ", "") == wanted:
                return np.array(cells[1:7], dtype=float), np.array(cells[8:14], dtype=float)
    raise SystemExit(f"nothing is stated for {material}")


def studio_values(folder: Path) -> tuple[MeasuredValues, ...]:
    """Return the teams' means with their spread, by way of the table that a campaign would name."""
    cells: dict[tuple[str, str], dict[str, tuple[str, str]]] = {}
    with (folder / "measured_open_curtains.csv").open() as stream:
        for row in csv.DictReader(stream):
            if row["parameter"] in STUDIO_TABLE:
                key = row["position"], STUDIO_TABLE[row["parameter"]]
                cells.setdefault(key, {})[row["band_hz"]] = row["mean"], row["std"]
    bands = [f"{f:g}" for f in BANDS.centres_hz]
    lines = [",".join(["source", "receiver", "parameter", *bands])]
    for (position, name), of_band in cells.items():
        for i, label in enumerate((name, f"{name}_sd")):
            texts = [of_band[b][i] if b in of_band else "" for b in bands]
            lines.append(",".join([position[:2], position[2:], label, *texts]))
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "measured.csv"
        path.write_text("\n".join(lines) + "\n")
        return read_parameters(path)[0]


def with_stated_priors(case: Case, folder: Path, logit_sd: float) -> Case:
    """Return the studio with what the participants knew of its materials as priors."""
    priors = []
    for k in case.priors:
        absorption = np.clip(stated(folder, k.name)[0], 0.01, 0.99)
        mean, _ = logit_prior(absorption, np.ones(len(BANDS)))
        priors.append(
            replace(k, prior_logit_mean=mean, prior_logit_sd=np.full(len(BANDS), logit_sd))
        )
    return replace(case, priors=tuple(priors))


def with_class_priors(case: Case) -> Case:
    """Return the studio with what its materials are made of as priors."""
    names = case.scene.room.materials
    priors = tuple(material_prior(m, BANDS, prior=STUDIO_CLASSES[m]) for m in names)
    return replace(case, priors=priors)


def traced(case: Case) -> BinnedPaths:
    """Trace once for all pairs, fits and bands."""
    settings = TraceSettings(
        duration_s=case.duration_s, n_rays=case.n_rays, image_order=case.image_order, seed=1
    )
    scattering = Scattering(case.scene.room.materials, case.scattering)
    paths = trace(case.scene, settings, scattering).paths
    return bin_paths(case.scene, BANDS, paths, case.duration_s)


def start(case: Case) -> np.ndarray:
    """Return one absorption for all walls in every band, from the mean T30."""
    mesh, air = case.scene.room.mesh, case.scene.air
    decay_s = np.mean([v.values["T30_s"] for v in case.values], axis=0)
    size = volume_m3(mesh), surface_area_m2(mesh), speed_of_sound_m_s(air)
    return np.array(
        [
            eyring_absorption(13.8 / t, *size, float(m))
            for t, m in zip(decay_s, attenuation_per_m(air, BANDS), strict=True)
        ]
    )


def fitted(
    case: Case, binned: BinnedPaths, values: list[MeasuredValues], n_draws: int = 0
) -> tuple[BandEstimate, ...]:
    """Return what these values say of the walls, with draws of the posterior where asked for."""
    terms = value_terms(case.scene, BANDS, values, binned, names=case.names)
    error, begin = case.model_error_jnd, start(case)
    changed = [t and replace(t, model_error_jnd=error) for t in terms]
    own = [() if t is None else (t,) for t in changed]
    alone = (without_responses(t, case.priors, b, begin) for b, t in enumerate(own))
    return solved(case, tuple(alone), n_draws)


def solved(
    case: Case, problems: tuple[Objective | None, ...], n_draws: int = 0
) -> tuple[BandEstimate, ...]:
    """Fit every band."""
    refine = Refinement(False, 1, n_draws=n_draws)
    return tuple(
        refine(fitted_band(b, problem, case.priors, Settings()))
        for b, problem in enumerate(problems)
    )


def absorption_of(answers: tuple[BandEstimate, ...]) -> np.ndarray:
    """Return the absorption, (n_materials, n_bands)."""
    return np.stack([a.absorption for a in answers], axis=1)


def left_out_errors(case: Case, binned: BinnedPaths) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return errors of model and null model, (n_pairs, n_bands) each; of times relative."""
    errors: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    for i, left_out in enumerate(case.values):
        others = [v for v in case.values if v is not left_out]
        answers = fitted(case, binned, others)
        predicted = predicted_values(case.scene, BANDS, binned, absorption_of(answers))[i]
        (compared,) = compared_values([left_out], [predicted], others, BANDS)
        for name, c in compared.items():
            unit = c.measured if name.endswith("_s") else 1.0
            pair = (c.predicted - c.measured) / unit, (c.null - c.measured) / unit
            errors.setdefault(name, []).append((np.abs(pair[0]), np.abs(pair[1])))
    return {
        name: (np.array([r[0] for r in rows]), np.array([r[1] for r in rows]))
        for name, rows in errors.items()
    }


def error_table(case: Case, errors: dict[str, tuple[np.ndarray, np.ndarray]]) -> str:
    """Return mean errors per band and over the judged bands."""
    head = " ".join(f"{f:6g}" for f in BANDS.centres_hz)
    lines = [f"{case.name}: mean |error| of the pair left out", f"{'':24}{head}   judged"]
    for name, pair in errors.items():
        short, unit = name.split("_")
        scale, unit = (100.0, "%") if unit == "s" else (1.0, unit.replace("percent", "points"))
        for label, rows in zip((f"{short} ({unit})", "  mean of the others"), pair, strict=True):
            cells = " ".join(f"{scale * m:6.2f}" for m in rows.mean(axis=0))
            lines.append(f"{label:24}{cells}   {scale * rows[:, case.judged].mean():6.2f}")
    return "\n".join(lines)


def print_combinations(case: Case, answers: tuple[BandEstimate, ...]) -> None:
    """Print what all pairs together say of the walls."""
    absorption = absorption_of(answers)
    covariance = np.stack([a.logit_covariance for a in answers])
    areas = material_areas_m2(case.scene.room)
    sure = identifiable_by_rule(answers, case.priors)
    print(
        f"identifiable by themselves: {sure.sum()} of {sure.size}; phi "
        + " ".join(f"{a.chi2_reduced:.2f}" for a in answers)
    )
    names, priors = case.scene.room.materials, prior_logit_law(case.priors)
    found = determined(names, absorption, covariance, priors, areas, 1)
    for centre_hz, own in zip(BANDS.centres_hz, found, strict=True):
        for c in own.combinations:
            weights = " ".join(f"{w:.2f}" for w in c.weights)
            print(
                f"{centre_hz:6g} Hz  {c.value:.4f} ({c.lower95:.4f} to {c.upper95:.4f}, "
                f"{100 * c.relative:.0f} %) = {weights}"
            )


def seminar(folder: Path) -> None:
    """Print the seminar room, from values alone and with the one response."""
    began = time.perf_counter()
    case = seminar_room(folder)
    binned = traced(case)
    print(f"traced in {time.perf_counter() - began:.1f} s")
    answers = fitted(case, binned, list(case.values))
    print(f"five pairs fitted, {time.perf_counter() - began:.1f} s from the start")
    print_combinations(case, answers)
    print(error_table(case, left_out_errors(case, binned)))
    print("\nwith the response of LS1 to MP1 as well")
    print_combinations(case, with_response(case, binned, folder))


def with_response(case: Case, binned: BinnedPaths, folder: Path) -> tuple[BandEstimate, ...]:
    """Return what the values of all pairs and the window energies of one response say together."""
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "campaign.toml"
        path.write_text(bras_campaign(folder.resolve()))
        read = read_measurements(read_campaign(path))
        responses = [m for m in read if isinstance(m, Measurement)]
        measured, _ = observe(case.scene, responses, BANDS)
    begin = start(case)
    energies = energy_terms(case.scene, BANDS, case.priors, measured, binned, begin)
    values = value_terms(case.scene, BANDS, case.values, binned)
    joint = tuple(
        without_responses(() if v is None else (v,), case.priors, b, begin)
        if e is None or v is None
        else energy_objective(*e, None, () if v is None else (v,))
        for b, (e, v) in enumerate(zip(energies, values, strict=True))
    )
    return solved(case, joint)


def closed_curtains(folder: Path, case: Case, binned: BinnedPaths, label: str) -> None:
    """Print the studio with closed curtains, predicted from what was fitted with open ones.

    The cloth is another wall then: its absorption is the fitted one, times the stated ratio of
    closed to open where more than classes is known, uncertain by a quarter (one standard deviation
    of its logarithm: the table calls both values estimated). All else is as fitted.
    """
    answers = fitted(case, binned, list(case.values), 100)
    half = 0.5 * np.array([a.upper95 - a.lower95 for a in answers])
    sure = identifiable_by_rule(answers, case.priors)
    print(f"\n{label}: {np.sum(half <= 0.1)} of {half.size} within 0.1, {sure.sum()} identifiable")
    other = studio(folder, closed=True)
    paths = traced(other)
    names = [m.replace(" ", "") for m in case.scene.room.materials]
    cloth = names.index("curtain(open)")
    ratio = stated(folder, "curtain(closed)")[0] / stated(folder, "curtain(open)")[0]
    ratio = np.ones(len(BANDS)) if label == "classes" else ratio
    order = [
        cloth if m.replace(" ", "") == "curtain(closed)" else names.index(m.replace(" ", ""))
        for m in other.scene.room.materials
    ]
    at = [m.replace(" ", "") for m in other.scene.room.materials].index("curtain(closed)")
    rng = np.random.default_rng(1)
    fits = absorption_of(answers)
    draws = np.stack([a.draws for a in answers if a.draws is not None], axis=2)
    drawn = []
    for number, walls in enumerate((fits, *draws)):
        absorption = walls[order]
        spread = rng.normal(0.0, 0.25) if number else 0.0
        cloth_closed = absorption[at] * ratio * np.exp(spread)
        absorption[at] = np.clip(cloth_closed, 0.0, 0.99)
        t30 = predicted_values(other.scene, BANDS, paths, absorption, ("T30_s",))
        drawn.append(t30[:, 0].mean(axis=0))
    low, high = np.quantile(drawn[1:], (0.025, 0.975), axis=0)
    open_s = np.mean([v.values["T30_s"] for v in case.values], axis=0)
    print(f"PTB studio, mean T30 of the six pairs (s), {label}")
    for label, row in (
        ("measured, open", open_s),
        ("predicted, closed", drawn[0]),
        ("  lower 95 %", low),
        ("  upper 95 %", high),
    ):
        print(f"{label:24}" + " ".join(f"{t:6.2f}" for t in row))


def main() -> None:
    """Run both rooms."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--closed", action="store_true")
    parser.add_argument("--room", choices=("both", "cr2", "ptb"), default="both")
    asked = parser.parse_args()
    if asked.folder is None:
        print("no folder of measurements given: nothing to do")
        return
    if asked.room != "ptb":
        seminar(asked.folder / "bras_cr2")
    if asked.room != "cr2":
        studio_runs(asked.folder / "ptb_studio", asked)


def studio_runs(folder: Path, asked: argparse.Namespace) -> None:
    """Print the studio."""
    case = studio(folder)
    binned = traced(case)
    print("\n" + error_table(case, left_out_errors(case, binned)), flush=True)
    print_combinations(case, fitted(case, binned, list(case.values)))
    if asked.closed:
        closed_curtains(folder, case, binned, "broad priors")
        closed_curtains(folder, with_class_priors(case), binned, "classes")
        stated_case = with_stated_priors(case, folder, 0.5)
        closed_curtains(folder, stated_case, binned, "stated absorption as priors, logit sd 0.5")


if __name__ == "__main__":
    main()
