"""Whether predicted intervals hold what is measured, with draws of the real model and without.

    python benchmarks/predictive_draws.py [N_BOXES] [--first SEED] [--values | --responses]

Boxes of random size and six random materials, simulated by image sources as pressures. The four
pairs of one source are fitted, by values of ISO 3382-1 alone or by responses; those of the other
are predicted, and once more with one wall exchanged for a known one, which is simulated, too. Each
is predicted from the same fit with the posterior's draws, and with those of the linearised one.

Errors and half widths are rms values in just noticeable differences. "null" knows nothing of the
room: the mean of the other measured pairs.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from roomfit.bands import bands_between
from roomfit.inversion.identify import identify
from roomfit.inversion.measurements import observe
from roomfit.io.campaign import read_campaign
from roomfit.io.inputs import IdentifyArguments, identify_arguments
from roomfit.measurement import Measurement
from roomfit.prediction.changes import Change
from roomfit.prediction.predict import Predicted, predict
from roomfit.results import absorption_posterior
from roomfit.settings import Settings
from roomfit.signals.decay import jnd_of
from roomfit.signals.iso3382 import VALUE_NAMES, MeasuredValues, ValueName
from roomfit.synthetic.boxes import BoxPlan, write_measured_box
from simulated_rooms.random_boxes import random_plan

BANDS = bands_between("octave", 500, 1000)
CHANGED_TO = 0.2
FEW = Settings(n_rays_beside_images=10_000, n_rays=10_000, posterior_draws=True)


def simulated(
    plan: BoxPlan, seed: int
) -> tuple[IdentifyArguments, list[Measurement], list[MeasuredValues]]:
    """Return scene, priors and measurements of a box, with its values as a table."""
    with tempfile.TemporaryDirectory() as name:
        campaign = read_campaign(write_measured_box(plan, Path(name), np.random.default_rng(seed)))
        arguments = identify_arguments(replace(campaign, bands=BANDS))
    names: tuple[ValueName, ...] = ("T20_s", "T30_s", "EDT_s", "C80_dB", "D50_percent", "TS_ms")
    responses = [m for m in arguments["measurements"] if isinstance(m, Measurement)]
    observed, _ = observe(arguments["scene"], responses, BANDS)
    values = []
    for m in observed:
        table = dict(zip(VALUE_NAMES, m.parameters.values, strict=False))
        own = m.measurement
        kept = {n: table[n] for n in names if np.isfinite(table[n]).all()}
        values.append(MeasuredValues(own.source, own.receiver, BANDS.centres_hz, kept))
    return arguments, responses, values


def rows(predicted: Predicted, sources: tuple[str, ...]) -> np.ndarray:
    """Return measured, predicted, lower, upper and the others' mean, in just noticeable steps."""
    found = []
    for pair in predicted.pairs:
        if pair.source in sources:
            for name, v in pair.parameters.items():
                unit = jnd_of(name, v.measured)
                table = (v.measured, v.predicted, v.lower95, v.upper95, v.mean_of_others)
                found += [r for r in (np.array(table) / unit).T if np.isfinite(r[:4]).all()]
    return np.array(found)


def line(label: str, tables: list[np.ndarray]) -> str:
    """Return how often intervals hold, how wide they are, and where the measured values lie."""
    t = np.concatenate(tables)
    half, error = 0.5 * (t[:, 3] - t[:, 2]), t[:, 1] - t[:, 0]
    held = np.mean((t[:, 2] <= t[:, 0]) & (t[:, 0] <= t[:, 3]))
    rms, width = np.sqrt(np.mean(error**2)), np.sqrt(np.mean(half**2))
    below = np.mean(t[:, 0] < 0.5 * (t[:, 2] + t[:, 3]))
    own = np.mean((t[:, 2] <= t[:, 1]) & (t[:, 1] <= t[:, 3]))
    null = np.sqrt(np.nanmean((t[:, 4] - t[:, 0]) ** 2))
    return (
        f"{label:34} held {held:.3f}  error {rms:6.2f}  half width {width:6.2f} "
        f"({width / rms:.2f})  below the middle {below:.2f}  own estimate held {own:.3f}  "
        f"null {null:6.2f}  n {len(t)}"
    )


def main() -> None:
    """Print one line for each kind of data, prediction and law."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("n_boxes", type=int, nargs="?", default=6)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--values", action="store_true")
    parser.add_argument("--responses", action="store_true")
    asked = parser.parse_args()
    both = asked.values == asked.responses
    found: dict[str, list[np.ndarray]] = {}
    seconds: list[float] = []
    for seed in range(asked.first, asked.first + asked.n_boxes):
        plan = random_plan(np.random.default_rng(seed))
        other = plan.absorption.copy()
        wall = seed % 6
        other[wall] = CHANGED_TO
        arguments, responses, values = simulated(plan, seed)
        _, _, after = simulated(replace(plan, absorption=other), seed)
        for kind, data, asked_for in (
            ("values", values, both or asked.values),
            ("responses", responses, both or asked.responses),
        ):
            if not asked_for:
                continue
            fitted = [m for m in data if m.source == "LS1"]
            began = time.perf_counter()
            answer = identify(
                arguments["scene"], fitted, arguments["materials"], BANDS, settings=FEW
            )
            seconds.append(time.perf_counter() - began)
            posterior = absorption_posterior(answer)
            change = Change(plan.materials[wall], "value", (CHANGED_TO,), (0.0,))
            for law, own in (("before", replace(posterior, draws=None)), ("after", posterior)):
                scene = arguments["scene"]
                same = predict(scene, own, (), values, settings=FEW)
                new = predict(scene, own, (change,), after, settings=FEW)
                for label, table in (
                    ("fitted pairs", rows(same, ("LS1",))),
                    ("other source", rows(same, ("LS2",))),
                    ("wall exchanged", rows(new, ("LS1", "LS2"))),
                ):
                    found.setdefault(f"{kind}, {label}, {law}", []).append(table)
            sys.stdout.write(f"box {seed} {kind}: identify {seconds[-1]:.1f} s\n")
            for label in found:
                if label.startswith(kind):
                    sys.stdout.write("   " + line(label, found[label][-1:]) + "\n")
            sys.stdout.flush()
    sys.stdout.write("\n")
    for label, tables in found.items():
        sys.stdout.write(line(label, tables) + "\n")


if __name__ == "__main__":
    main()
