"""How often a treatment does what was stated: boxes of another program, before and after a wall.

    python benchmarks/treated_boxes.py [--boxes N] [--first SEED]

pyroomacoustics simulates each box twice: images to the third order, then rays, walls that scatter
by .1 to .4, of which the campaign says nothing. The first is identified as anybody's. Then one wall
is covered, here by what the catalogue says of mineral wool, there by a draw of it, and measured
anew. Stated are eleven limits of the mean T30 of 500 to 2000 Hz about what is predicted, each with
a probability; counted is how often they are met. Beside the prediction stands Sabine's formula by
the same absorption.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from _other_box import write_other_box
from roomfit.base.bands import bands_between
from roomfit.base.errors import InsufficientDataError
from roomfit.base.logit import expit, logit
from roomfit.checks.usable import check_recordings
from roomfit.files.inputs import load_campaign
from roomfit.identify import identify
from roomfit.materials.catalogue import catalogue_prior
from roomfit.predict.changes import Change
from roomfit.predict.predict import predict_change, prepare
from roomfit.predict.question import Question
from roomfit.result import absorption_posterior
from roomfit.room.scene import material_areas_m2
from roomfit.treat.arrangements import treat
from roomfit.treat.question import Product, Surface, Target

HUNG = "mineral-wool-50-mm"
SHARES = (0.7, 0.8, 0.87, 0.93, 0.97, 1.0, 1.03, 1.07, 1.13, 1.2, 1.35)
MID_HZ = (500.0, 1000.0, 2000.0)


class Treated(NamedTuple):
    """One box: T30 in s at 500 to 2000 Hz, and the limits."""

    measured: np.ndarray  # (3,), after
    predicted: np.ndarray  # (3,)
    bounds: np.ndarray  # (2, 3)
    sabine: np.ndarray  # (3,)
    stated: np.ndarray  # (11,), probability of each limit
    met: np.ndarray  # (11,)


def measured_t30_s(campaign: Path) -> np.ndarray:
    """Return the mean T30 over the pairs in every band, (n_bands,)."""
    own = load_campaign(campaign)
    checked = check_recordings(own["scene"], own["measurements"], own["bands"])
    known = np.ma.masked_invalid(checked.parameter("T30_s"))
    return np.asarray(known.mean(axis=0).filled(np.nan))


def treated(seed: int) -> Treated:
    """Identify a box, state what covering one wall does, and measure it."""
    rng = np.random.default_rng([seed, 77])
    wall = int(rng.integers(6))
    mean, sd = catalogue_prior(HUNG, bands_between("octave", 125.0, 8000.0))
    hung = expit(logit(mean) + rng.standard_normal() * sd / (mean * (1.0 - mean)))
    simulated: dict[str, Any] = {"scattering": (0.1, 0.2, 0.3, 0.4)[seed % 4], "noise_db": -60.0}
    simulated |= {"between": (0.02, 0.35), "image_order": 3}
    with tempfile.TemporaryDirectory() as first, tempfile.TemporaryDirectory() as second:
        made = write_other_box(seed, Path(first), **simulated)
        text = made.campaign.read_text()
        made.campaign.write_text(text.replace("scattering = 0.0\n", ""))
        own = load_campaign(made.campaign)
        after = write_other_box(seed, Path(second), covered=(wall, hung), **simulated)
        measured = measured_t30_s(after.campaign)
        answer = identify(**own)
    known, name = absorption_posterior(answer), made.materials[wall]
    mean, sd = catalogue_prior(HUNG, known.bands)
    change = (Change(name, "value", tuple(mean), tuple(sd)),)
    question = Question(own["scene"], known, change, own["measurements"], own["settings"])
    room = prepare(question, (change,))
    value = predict_change(room, change).mean["T30_s"]
    at = np.isin(known.bands.centres_hz, MID_HZ)
    middle_s = float(value.predicted[at].mean())
    limits = [Target("T30_s", high=x * middle_s, mean_of_bands=True) for x in SHARES]
    area_m2 = float(material_areas_m2(room.scene.room)[known.materials.index(name)])
    product = Product("wool", mean, sd, 1.0, 0.9999 * area_m2, entry=HUNG)
    (arrangement,) = treat(room, [Surface(name)], [product], limits, number=1).arrangements
    if not (arrangement.hung and np.isfinite(measured[at]).all()):
        what = "nothing is expected of the wall, or T30 cannot be measured"
        raise InsufficientDataError(what, found=name, needed="", hint="")
    assert value.change is not None
    bounds = np.array([value.lower95[at], value.upper95[at]])
    met = measured[at].mean() <= np.array([limit.high for limit in limits])
    sabine = value.change.sabine[at]
    return Treated(measured[at], value.predicted[at], bounds, sabine, arrangement.probability, met)


def show(boxes: list[Treated]) -> None:
    """Print stated against met, and errors."""
    measured, predicted, sabine = (
        np.array([getattr(b, name) for b in boxes]) for name in ("measured", "predicted", "sabine")
    )
    low, high = np.array([b.bounds for b in boxes]).swapaxes(0, 1)
    held = ((low <= measured) & (measured <= high)).mean()
    width = np.median((high - low) / 2.0 / predicted)
    rms = [np.sqrt(np.mean(np.log(measured / x) ** 2)) for x in (predicted, sabine)]
    print(
        f"{len(boxes)} boxes: rms error of T30 {100 * rms[0]:.0f} %, Sabine {100 * rms[1]:.0f} %;"
    )
    print(f"95 % intervals, half width {100 * width:.0f} % (median), hold {100 * held:.0f} %")
    stated, met = (np.concatenate([getattr(b, n) for b in boxes]) for n in ("stated", "met"))
    for least, most in ((0.0, 0.1), (0.1, 0.3), (0.3, 0.7), (0.7, 0.9), (0.9, 1.01)):
        own = (stated >= least) & (stated < most)
        if own.any():
            shares = 100 * stated[own].mean(), 100 * met[own].mean()
            print(f"stated {shares[0]:3.0f} %   met {shares[1]:3.0f} %   {own.sum():4d} limits")


def main() -> None:
    """Treat box after box; the table so far after every tenth."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--boxes", type=int, default=20)
    parser.add_argument("--first", type=int, default=500)
    asked = parser.parse_args()
    done: list[Treated] = []
    for seed in range(asked.first, asked.first + asked.boxes):
        try:
            done.append(treated(seed))
        except InsufficientDataError as refusal:
            print(f"box {seed}: {refusal.what}", flush=True)
        if len(done) % 10 == 0 and done:
            show(done)
    if done:
        show(done)


if __name__ == "__main__":
    main()
