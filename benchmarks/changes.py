"""Known changes: what a fit of one state says of the room with another material.

    python benchmarks/changes.py boxes [--seeds N] [--responses]
    python benchmarks/changes.py studio FOLDER [--seeds N] [--part PART]

boxes    shoeboxes simulated with image sources as pressures, one wall of which is changed; the room
         fitted before the change, from ISO 3382 values or responses, and predicted after it
studio   PTB's studio (FOLDER/ptb_studio), fitted to the values measured with its curtains open,
         and predicted with these made of another cloth; and the same with values that the model
         itself made of known absorption, so that the truth is known, in both directions

Beside the prediction stand no change, and Sabine's formula: measured absorption area before, plus
the area that the change adds by the absorption stated for the changed material before it.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import room_values
from roomfit.base.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import Bands, bands_between
from roomfit.base.findings import Code
from roomfit.base.logit import expit, logit
from roomfit.demo.boxes import SyntheticBox, add_noise, pressure_response
from roomfit.fit.measurements import observe
from roomfit.identify import identify
from roomfit.materials.catalogue import material_prior
from roomfit.materials.priors import MaterialPrior
from roomfit.model.room_parameters import predicted_values
from roomfit.predict.changes import Change
from roomfit.predict.predict import predict
from roomfit.predict.prediction import Predicted
from roomfit.predict.question import Question
from roomfit.predict.split import for_another_room
from roomfit.result import absorption_posterior
from roomfit.room.mesh import volume_m3
from roomfit.room.scene import Scene, material_areas_m2, scene_of, shoebox_room
from roomfit.settings import Settings
from roomfit.signals.decay import ParameterName
from roomfit.signals.iso3382 import VALUE_NAMES, MeasuredValues, ValueName
from roomfit.signals.measurement import Measurement
from roomfit.uncertainty.other_room import room_posterior

LENGTHS_M = (4.2, 3.3, 2.6)
RATE_HZ = 8000
BANDS = bands_between("octave", 500, 1000)
# of west, east, south, north, floor, ceiling
OWNERS = ("walls", "curtain", "walls", "walls", "floor", "ceiling")
SOURCES_M = {"S1": (1.0, 1.2, 1.1), "S2": (3.1, 0.8, 1.4)}
RECEIVERS_M = {"R1": (2.9, 2.2, 1.3), "R2": (1.6, 2.4, 1.6)}
JUDGED: tuple[ParameterName, ...] = (
    "T20_s",
    "T30_s",
    "EDT_s",
    "C50_dB",
    "C80_dB",
    "D50_percent",
    "TS_ms",
)
SETTINGS = Settings(n_rays=5000, n_rays_beside_images=3000, n_random_starts=0)


@dataclass(frozen=True, eq=False)
class KnownChange:
    """A box before and after one wall is changed, as measured in both states."""

    scene: Scene
    bands: Bands
    before: tuple[Measurement, ...]
    values_before: tuple[MeasuredValues, ...]
    values_after: tuple[MeasuredValues, ...]
    true_before: np.ndarray  # (n_materials, n_bands), in the order of the room
    true_after: np.ndarray


def known_change(seed: int, bands: Bands = BANDS) -> KnownChange:
    """Return a box of smooth walls, random absorption; its curtain gets three times it or a third.

    The absorption of every material is drawn from the broad prior of a material of which nothing is
    specified, the same in all bands, until the mean lies between 0.2 and 0.5: livelier rooms need
    millions of image sources.
    """
    rng = np.random.default_rng(seed)
    room = shoebox_room(
        LENGTHS_M, {"walls": "walls", "east": "curtain", "floor": "floor", "ceiling": "ceiling"}
    )
    areas = material_areas_m2(room)
    while True:
        a = expit(logit(np.array(0.15)) + 1.5 * rng.standard_normal(len(room.materials)))
        other = a.copy()
        i = room.materials.index("curtain")
        other[i] = 3.0 * a[i] if a[i] < 0.25 else a[i] / 3.0
        means = [areas @ x / areas.sum() for x in (a, other)]
        if min(means) > 0.2 and max(means) < 0.5:
            break
    scene = scene_of(room, SOURCES_M, RECEIVERS_M)
    states = []
    wide = bands_between("octave", bands.centres_hz[0] / 2, bands.centres_hz[-1] * 2)
    for x in (a, other):
        walls = np.array([[x[room.materials.index(name)]] * len(wide) for name in OWNERS])
        truth = SyntheticBox(
            LENGTHS_M,
            wide.centres_hz,
            walls,
            attenuation_per_m(scene.air, wide),
            speed_of_sound_m_s(scene.air),
        )
        measured = []
        for s, at in SOURCES_M.items():
            for r, to in RECEIVERS_M.items():
                pressure = pressure_response(
                    truth, np.array(at), np.array(to), 0.5, RATE_HZ, np.zeros(len(wide))
                )
                measured.append(Measurement(s, r, add_noise(pressure, -60.0, rng), RATE_HZ))
        states.append(tuple(measured))
    rows = [np.tile(x[:, None], len(bands)) for x in (a, other)]
    before, after = (values_of(scene, measured, bands) for measured in states)
    return KnownChange(scene, bands, states[0], before, after, *rows)


def values_of(
    scene: Scene, measured: tuple[Measurement, ...], bands: Bands
) -> tuple[MeasuredValues, ...]:
    """Return the room parameters of responses."""
    found, _ = observe(scene, measured, bands)
    return tuple(
        MeasuredValues(
            m.measurement.source,
            m.measurement.receiver,
            bands.centres_hz,
            {name: m.parameters.of(name) for name in JUDGED},
        )
        for m in found
    )


def predicted_change(
    case: KnownChange, *, responses: bool = False, n_draws: int = 128
) -> Predicted:
    """Fit the box before the change, and predict it with the curtain's true new absorption."""
    smooth = [material_prior(m, case.bands, scattering=0.0) for m in case.scene.room.materials]
    data = case.before if responses else case.values_before
    answer = identify(case.scene, data, smooth, case.bands, settings=SETTINGS)
    new = case.true_after[case.scene.room.materials.index("curtain")]
    few = Settings(n_rays=5000, n_rays_beside_images=3000, n_draws=n_draws)
    return predict(
        Question(
            case.scene,
            absorption_posterior(answer),
            [Change("curtain", "value", tuple(new))],
            case.values_before,
            settings=few,
        )
    )


def mean_of(values: tuple[MeasuredValues, ...], name: ValueName) -> np.ndarray:
    """Return the mean over the pairs, (n_bands,)."""
    return np.asarray(np.mean([v.values[name] for v in values], axis=0))


def inside(low: np.ndarray, value: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return which of the values that are known lie between two others."""
    known = np.isfinite(low) & np.isfinite(value) & np.isfinite(high)
    held = (low <= value) & (value <= high)
    return np.asarray(held[known])


def percent_errors(rows: list[np.ndarray]) -> np.ndarray:
    """Return the sizes of relative errors that are known, in per cent."""
    of = 100 * np.abs(np.concatenate(rows))
    return np.asarray(of[np.isfinite(of)])


def sabine_after_s(
    decay_s: np.ndarray, volume: float, area_m2: float, old: np.ndarray, new: np.ndarray
) -> np.ndarray:
    """Return the reverberation time after an area is given another absorption, by Sabine."""
    found = 0.161 * volume / decay_s + area_m2 * (new - old)
    return np.asarray(0.161 * volume / np.maximum(found, 0.01))


def wrong_directions(
    predicted: Predicted, true_change: dict[ValueName, np.ndarray]
) -> tuple[int, int]:
    """Return how many directions of a mean are stated, and how many of them wrongly.

    Parameters
    ----------
    true_change : mapping of parameter to float array, shape (n_bands,)
        After minus before.
    """
    n_stated = n_wrong = 0
    for name, change in true_change.items():
        found = predicted.mean[name].change
        if found is None:
            continue
        none = 1.0 if name in ("T20_s", "T30_s", "EDT_s") else 0.0
        rises, falls = found.change_lower95 > none, found.change_upper95 < none
        n_stated += int(np.sum(rises | falls))
        n_wrong += int(np.sum((rises & (change < 0)) | (falls & (change > 0))))
    return n_stated, n_wrong


def boxes(n_seeds: int, *, responses: bool) -> None:
    """Print how often intervals hold the room after its change, beside what needs no model."""
    held: dict[str, list[np.ndarray]] = {}
    errors: dict[str, list[np.ndarray]] = {}
    widths: list[np.ndarray] = []
    n_stated = n_wrong = n_found = n_directions = 0
    for seed in range(n_seeds):
        case = known_change(seed)
        found = predicted_change(case, responses=responses)
        codes = [f.code for f in found.findings]
        n_found += Code.CHANGE_PRIOR_DOMINATED in codes
        true = {n: (mean_of(case.values_before, n), mean_of(case.values_after, n)) for n in JUDGED}
        stated, wrong = wrong_directions(found, {n: a - b for n, (b, a) in true.items()})
        n_stated, n_wrong = n_stated + stated, n_wrong + wrong
        n_directions += len(JUDGED) * len(BANDS)
        for name, (_, after) in true.items():
            v = found.mean[name]
            c = v.change
            assert c is not None
            held.setdefault("mean, carried over", []).append(
                inside(c.carried_lower95, after, c.carried_upper95)
            )
            held.setdefault("mean, model", []).append(inside(v.lower95, after, v.upper95))
        for pair in found.pairs:
            (own,) = (
                m
                for m in case.values_after
                if (m.source, m.receiver) == (pair.source, pair.receiver)
            )
            for name in JUDGED:
                after = own.values[name]
                c = pair.parameters[name].change
                assert c is not None
                held.setdefault("pairs, carried over", []).append(
                    inside(c.carried_lower95, after, c.carried_upper95)
                )
        before, after = true["T30_s"]
        v = found.mean["T30_s"]
        c = v.change
        assert c is not None
        i = case.scene.room.materials.index("curtain")
        room = volume_m3(case.scene.room.mesh), float(material_areas_m2(case.scene.room)[i])
        old, new = case.true_before[i], case.true_after[i]
        widths.append(0.5 * (c.carried_upper95 - c.carried_lower95) / after)
        for label, row in (
            ("model", v.predicted),
            ("measured, carried over", c.carried),
            ("no change", before),
            ("Sabine, true absorption before", sabine_after_s(before, *room, old, new)),
            ("Sabine, 0.15 before", sabine_after_s(before, *room, 0.15 + 0.0 * old, new)),
        ):
            errors.setdefault(label, []).append(row / after - 1.0)
        print(
            f"seed {seed}: T30 {before.round(2)} to {after.round(2)}, carried {c.carried.round(2)}"
            f" ({c.carried_lower95.round(2)} to {c.carried_upper95.round(2)})",
            flush=True,
        )
    print(f"\n{n_seeds} boxes, fitted to {'responses' if responses else 'ISO 3382 values'}")
    for label, rows in held.items():
        print(f"{label:32} held {100 * np.concatenate(rows).mean():5.1f} %")
    for label, rows in errors.items():
        of = percent_errors(rows)
        rms = np.sqrt(np.mean(of**2))
        print(f"mean T30, {label:32} |error|: median {np.median(of):5.1f}, rms {rms:5.1f} %")
    print(f"median half width of T30 carried over {100 * np.nanmedian(widths):.1f} %")
    print(f"directions stated {n_stated} of {n_directions}, wrong {n_wrong}")
    print(f"change-prior-dominated in {n_found} of {n_seeds}")


# The studio.

CLOTH = {False: "curtain(open)", True: "curtain (closed)"}
STATED_LOGIT_SD = 0.5
CHANGE_SD = 0.25  # relative, of the ratio of the two states of the cloth
STUDIO_SETTINGS = Settings(n_rays=5000, n_random_starts=0, n_draws=64)


def studio_priors(
    folder: Path, materials: tuple[str, ...], bands: Bands, scattering: np.ndarray, *, broad: bool
) -> tuple[MaterialPrior, ...]:
    """Return the stated absorption with a logit sd of 0.5, or nothing but the scattering."""
    found = []
    for name, s in zip(materials, scattering, strict=True):
        a = np.clip(stated_absorption(folder, name, bands), 0.01, 0.99)
        prior = None if broad else (a, STATED_LOGIT_SD * a * (1.0 - a))
        found.append(material_prior(name, bands, prior=prior, scattering=float(s)))
    return tuple(found)


def stated_absorption(folder: Path, name: str, bands: Bands) -> np.ndarray:
    """Return the absorption that the participants were given, (n_bands,)."""
    at = np.isin(room_values.BANDS.centres_hz, bands.centres_hz)
    return np.asarray(room_values.stated(folder, name)[0][at])


def studio_measured(folder: Path) -> None:
    """Print what is said of the studio's curtains closed where only its open state was measured."""
    case = room_values.studio(folder)
    bands = bands_between("octave", 500, 2000)
    new = stated_absorption(folder, CLOTH[True], bands)
    for broad in (False, True):
        priors = studio_priors(
            folder, case.scene.room.materials, bands, case.scattering, broad=broad
        )
        answer = identify(case.scene, case.values, priors, bands, settings=STUDIO_SETTINGS)
        changes = [Change(CLOTH[False], "value", tuple(new), tuple(CHANGE_SD * new * (1 - new)))]
        found = predict(
            Question(
                case.scene,
                absorption_posterior(answer),
                changes,
                case.values,
                settings=STUDIO_SETTINGS,
            )
        )
        label = "broad" if broad else "stated"
        print(f"\nmeasured, open; cloth as stated of the closed one; {label} priors")
        print(found)


def studio_simulated(folder: Path, n_seeds: int) -> None:
    """Print the studio in both directions where the model itself made the values."""
    bands = bands_between("octave", 500, 2000)
    cases = {closed: room_values.studio(folder, closed=closed) for closed in (False, True)}
    binned = {closed: room_values.traced(case) for closed, case in cases.items()}
    names = cases[False].scene.room.materials
    at = slice(2, 5)
    for was_closed in (False, True):
        old, new = cases[was_closed], cases[not was_closed]
        materials = old.scene.room.materials
        errors: dict[str, list[np.ndarray]] = {}
        held: dict[str, list[np.ndarray]] = {}
        n_found = {"stated": 0, "broad": 0}
        for seed in range(n_seeds):
            rng = np.random.default_rng(seed)
            true = {
                n: expit(
                    logit(np.clip(room_values.stated(folder, n)[0], 0.01, 0.99))
                    + STATED_LOGIT_SD * rng.standard_normal()
                )
                for n in names
            }
            ratio = (
                room_values.stated(folder, CLOTH[True])[0]
                / room_values.stated(folder, CLOTH[False])[0]
            )
            ratio_true = ratio * max(1.0 + CHANGE_SD * rng.standard_normal(), 0.2)
            true[CLOTH[True]] = np.minimum(true[CLOTH[False]] * ratio_true, 0.99)
            tables = {}
            for closed, case in cases.items():
                a = np.array([true[m] for m in case.scene.room.materials])
                tables[closed] = predicted_values(case.scene, room_values.BANDS, binned[closed], a)
            noise = 0.3 * np.array([0.05, 0.05, 0.05, 1.0, 1.0, 5.0, 10.0, 1.0])
            data = []
            for v, row in zip(old.values, tables[was_closed], strict=True):
                values = {}
                for k, name in enumerate(VALUE_NAMES):
                    step = noise[k] * rng.standard_normal(row.shape[1])
                    values[name] = row[k] * (1 + step) if name.endswith("_s") else row[k] + step
                data.append(
                    MeasuredValues(v.source, v.receiver, room_values.BANDS.centres_hz, values)
                )
            k = VALUE_NAMES.index("T30_s")
            after = tables[not was_closed][:, k].mean(axis=0)[at]
            before = tables[was_closed][:, k].mean(axis=0)[at]
            area = {
                c: dict(zip(x.scene.room.materials, material_areas_m2(x.scene.room), strict=True))
                for c, x in cases.items()
            }
            added = 0.0
            for m in {*area[False], *area[True]}:
                stated_a = stated_absorption(folder, m, bands)
                added = (
                    added
                    + (area[not was_closed].get(m, 0.0) - area[was_closed].get(m, 0.0)) * stated_a
                )
            volume = volume_m3(old.scene.room.mesh)
            sabine = 0.161 * volume / (0.161 * volume / before + added)
            errors.setdefault("no change", []).append(before / after - 1.0)
            errors.setdefault("Sabine, stated areas added", []).append(sabine / after - 1.0)
            factor = (1.0 / ratio if was_closed else ratio)[at]
            change = Change(
                CLOTH[not was_closed], "factor", tuple(factor), tuple(CHANGE_SD * factor)
            )
            for label in n_found:
                broad = label == "broad"
                priors = studio_priors(folder, materials, bands, old.scattering, broad=broad)
                answer = identify(old.scene, data, priors, bands, settings=STUDIO_SETTINGS)
                known = absorption_posterior(answer)
                renamed = tuple(
                    CLOTH[not was_closed] if m == CLOTH[was_closed] else m for m in known.materials
                )
                theirs = new.scene.room.materials
                own = studio_priors(folder, theirs, bands, new.scattering, broad=broad)
                # as `roomfit.question_of` has it for a campaign of another geometry
                known, dominated = for_another_room(
                    replace(known, materials=renamed),
                    area[not was_closed],
                    STUDIO_SETTINGS.n_draws,
                    STUDIO_SETTINGS.seed,
                )
                known = room_posterior(known, own, bands)
                known = replace(known, findings=(*known.findings, *dominated))
                found = predict(Question(new.scene, known, [change], settings=STUDIO_SETTINGS))
                w = found.mean["T30_s"]
                codes = [f.code for f in (*dominated, *found.findings)]
                n_found[label] += Code.CHANGE_PRIOR_DOMINATED in codes
                errors.setdefault(f"predicted, {label} priors", []).append(
                    w.predicted / after - 1.0
                )
                held.setdefault(f"mean T30, {label} priors", []).append(
                    inside(w.lower95, after, w.upper95)
                )
                for i, pair in enumerate(found.pairs):
                    for row, name in enumerate(VALUE_NAMES):
                        w, y = pair.parameters[name], tables[not was_closed][i, row, at]
                        held.setdefault(f"all values, {label} priors", []).append(
                            inside(w.lower95, y, w.upper95)
                        )
            shown = {k: (100 * e[-1]).round(1).tolist() for k, e in errors.items()}
            print(f"seed {seed}: {shown}", flush=True)
        print(
            f"\nstudio, simulated, {CLOTH[was_closed]} to {CLOTH[not was_closed]}, {n_seeds} seeds"
        )
        for label, rows in errors.items():
            of = percent_errors(rows)
            rms = np.sqrt(np.mean(of**2))
            print(f"mean T30, {label:28} |error|: median {np.median(of):5.1f}, rms {rms:5.1f} %")
        for label, rows in held.items():
            print(f"{label:28} held {100 * np.concatenate(rows).mean():5.1f} %")
        print(f"change-prior-dominated {n_found}")


def main() -> None:
    """Run what was asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("what", nargs="?", choices=("boxes", "studio"))
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--responses", action="store_true")
    parser.add_argument("--part", choices=("both", "measured", "simulated"), default="both")
    asked = parser.parse_args()
    if asked.what == "boxes":
        boxes(asked.seeds, responses=asked.responses)
    elif asked.what == "studio" and asked.folder is not None:
        if asked.part != "simulated":
            studio_measured(asked.folder / "ptb_studio")
        if asked.part != "measured":
            studio_simulated(asked.folder / "ptb_studio", asked.seeds)
    else:
        print("nothing to do: see --help")


if __name__ == "__main__":
    main()
