"""Two measured rooms by ISO 3382-1 values: one source fitted, the other predicted.

    python benchmarks/bras.py FOLDER [--room cr2 cr3] [--exchanged]

FOLDER holds `bras_cr2` and `bras_cr3`: meshes and measured values of two sources and five receivers
of a seminar room and of a chamber music hall (Aspoeck et al. 2020). Neither comes with roomfit.

The five pairs of one source are fitted, those of the other predicted: the mean difference in just
noticeable differences, in brackets how many of all lie within one; beside Barron's revised theory
with the mean T30 of the fitted pairs, and the mean of these. `--exchanged`: sources exchanged.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

import roomfit
from roomfit.base.typing import FloatArray, ValueName
from roomfit.files.rooms import read_room
from roomfit.files.schema import RoomSpec
from roomfit.model.eyring import diffuse_values
from roomfit.predict.measured import in_units
from roomfit.predict.predict import predict
from roomfit.predict.prediction import PredictedPair
from roomfit.predict.question import Question
from roomfit.result import absorption_posterior
from roomfit.room.mesh import volume_m3
from roomfit.room.scene import Scene, distances_m, pair_names
from roomfit.signals.iso3382 import VALUE_NAMES
from roomfit.signals.measurement import Use

BANDS = roomfit.bands_between("octave", 125, 4000)
TABLES = {"cr2": "measured_all_pairs.json", "cr3": "measured.json"}
CLIMATE = {"cr2": roomfit.Air(19.5, 41.7), "cr3": roomfit.Air(22.4, 40.9)}
# Columns of the tables, and what makes them the unit of the parameter.
COLUMNS: dict[str, tuple[ValueName, float]] = {
    "edt": ("EDT_s", 1.0),
    "t20": ("T20_s", 1.0),
    "t30": ("T30_s", 1.0),
    "c50": ("C50_dB", 1.0),
    "c80": ("C80_dB", 1.0),
    "d50": ("D50_percent", 100.0),
    "ts": ("TS_ms", 1000.0),
}


def room_of(folder: Path, name: str, fitted: str) -> tuple[Scene, list[roomfit.MeasuredValues]]:
    """Return a room with its measured values, those of all but one source for validation."""
    own = folder / f"bras_{name}"
    table = json.loads((own / TABLES[name]).read_text())
    room, _ = read_room(RoomSpec(file=own / f"{name.upper()}.obj", unit="m", up="z"))
    receivers = table.get("listeners") or table["receivers"]
    at = [table["bands_hz"].index(f) for f in BANDS.centres_hz]
    measured = []
    for pair, columns in table["pairs"].items():
        source, receiver = pair.split()
        values = {
            to: factor * np.array(columns[key], dtype=np.float64)[at]
            for key, (to, factor) in COLUMNS.items()
        }
        use: Use = "fit" if source == fitted else "validate"
        measured.append(roomfit.MeasuredValues(source, receiver, BANDS.centres_hz, values, use=use))
    return roomfit.scene_of(room, table["sources"], receivers, air=CLIMATE[name]), measured


def baselines(
    scene: Scene, fitted: list[roomfit.MeasuredValues], left: list[PredictedPair]
) -> FloatArray:
    """Return Barron's theory and the mean of fitted pairs, (2, n_pairs, n_names, n_bands)."""
    values = [[m.at(n, BANDS.centres_hz) for n in VALUE_NAMES] for m in fitted]
    mean = np.ma.masked_invalid(values).mean(axis=0).filled(np.nan)
    lengths_m = dict(zip((n[:2] for n in pair_names(scene)), distances_m(scene), strict=True))
    distance_m = np.array([lengths_m[p.source, p.receiver] for p in left])
    decay_s = mean[VALUE_NAMES.index("T30_s")]
    barron = diffuse_values(decay_s, volume_m3(scene.room.mesh), distance_m)
    return np.stack([barron, np.broadcast_to(mean, barron.shape)])


def main() -> None:
    """Print a table of each room."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else None)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--room", nargs="+", choices=list(TABLES), default=list(TABLES))
    parser.add_argument("--exchanged", action="store_true")
    if (asked := parser.parse_args()).folder is None:
        print("no folder of measurements given: nothing to do")
        return
    for name in asked.room:
        began = time.perf_counter()
        scene, measured = room_of(asked.folder, name, "LS2" if asked.exchanged else "LS1")
        result = roomfit.identify(scene, measured, bands=BANDS)
        known = absorption_posterior(result)
        found = predict(Question(scene, known, (), measured, settings=result.settings))
        fitted = [m for m in measured if m.use == "fit"]
        left = [p for p in found.pairs if p.use == "validate"]
        barron, mean = baselines(scene, fitted, left)

        def read(key: str, pairs: list[PredictedPair] = left) -> FloatArray:
            return np.array([[getattr(p.parameters[n], key) for n in VALUE_NAMES] for p in pairs])

        truth, low, high = (read(key) for key in ("measured", "lower95", "upper95"))
        units, held = in_units(truth), (low <= truth) & (truth <= high)
        off = [in_units(x) - units for x in (read("predicted"), barron, mean)]
        half = 0.5 * (in_units(high) - in_units(low))
        minutes = (time.perf_counter() - began) / 60.0
        print(f"\n{name.upper()}, {minutes:.1f} minutes, chi-square {result.chi2_reduced.round(1)}")
        print(f"{'':6}{'predicted':>12}{'Barron':>12}{'mean':>12}{'held':>8}  half width over rms")
        for row, parameter in enumerate(VALUE_NAMES[:-1]):
            cells = [np.abs(x[:, row]) for x in off]
            texts = [f"{np.nanmean(x):.2f} ({np.sum(x <= 1.0)})" for x in cells]
            rms = np.sqrt(np.nanmean(np.square([half[:, row], off[0][:, row]]), axis=(1, 2)))
            print(
                f"{parameter.split('_')[0]:6}" + "".join(f"{t:>12}" for t in texts)
                + f"{100 * held[:, row][np.isfinite(truth[:, row])].mean():>6.0f} %"
                f"{rms[0] / rms[1]:8.1f}"
            )  # fmt: skip


if __name__ == "__main__":
    main()
