"""How often a predicted interval holds what is measured, in a box simulated independently.

    python benchmarks/prediction.py [SEED]

A bare box of 30 m3 with smooth walls: pressures of image sources with phase. Four receivers are
fitted, the others predicted; and all are predicted with the true absorption as well.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
import soundfile

from roomfit.base.air import Air, attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import bands_between
from roomfit.demo.boxes import SyntheticBox, add_noise, pressure_response
from roomfit.files.campaign import input_files, read_campaign
from roomfit.files.inputs import identify_arguments
from roomfit.files.questions import question_of
from roomfit.files.results import read_result, write_result
from roomfit.identify import identify
from roomfit.predict.predict import predict
from roomfit.predict.prediction import PredictedPair
from roomfit.signals.iso3382 import ValueName
from roomfit.uncertainty.posterior import AbsorptionPosterior

LENGTHS_M = (3.9, 3.1, 2.5)
SOURCE_M = (1.0, 1.2, 1.1)
ABSORPTION = {"walls": 0.15, "carpet": 0.4, "tiles": 0.3}
RATE_HZ = 8000
NAMES: tuple[ValueName, ...] = (
    "T20_s",
    "T30_s",
    "EDT_s",
    "C50_dB",
    "C80_dB",
    "D50_percent",
    "TS_ms",
)
ROOM = f"""[room]
shoebox = {list(LENGTHS_M)}
[room.materials]
walls = "walls"
floor = "carpet"
ceiling = "tiles"
[sources.LS1]
position = {list(SOURCE_M)}
[identify]
from_hz = 500
to_hz = 1000
"""


def write_campaign(folder: Path, seed: int) -> Path:
    """Simulate up to 24 receivers, those too near to the source left out."""
    rng = np.random.default_rng(seed)
    positions = 0.5 + rng.random((24, 3)) * (np.array(LENGTHS_M) - 1.0)
    positions = positions[np.linalg.norm(positions - SOURCE_M, axis=1) > 1.0]
    bands, air = bands_between("octave", 250, 2000), Air()
    owners = ("walls", "walls", "walls", "walls", "carpet", "tiles")
    box = SyntheticBox(
        LENGTHS_M,
        bands.centres_hz,
        np.array([[ABSORPTION[n]] * len(bands) for n in owners]),
        attenuation_per_m(air, bands),
        speed_of_sound_m_s(air),
    )
    text = ROOM + "".join(f"[materials.{name}]\nscattering = 0.0\n" for name in ABSORPTION)
    for i, position in enumerate(positions):
        pressure = pressure_response(
            box, np.array(SOURCE_M), position, 0.7, RATE_HZ, np.zeros(len(bands))
        )
        noisy = add_noise(pressure, -60, rng).astype(np.float32)
        soundfile.write(folder / f"R{i}.wav", noisy, RATE_HZ, subtype="FLOAT")
        text += f"[receivers.R{i}]\nposition = {position.tolist()}\n[[measurements]]\n"
        text += f'source = "LS1"\nreceiver = "R{i}"\nfile = "R{i}.wav"\n'
        text += f'use = "{"fit" if i < 4 else "validate"}"\n'
    path = folder / "campaign.toml"
    path.write_text(text)
    return path


def formatted(title: str, pairs: list[PredictedPair]) -> str:
    """Return by band how many intervals hold, and the mean and the spread of the misses."""
    lines = [title, "parameter     covered     mean of (measured - predicted) / sd, its spread"]
    covered = []
    for name in NAMES:
        m, value, low, high = (
            np.array([getattr(p.parameters[name], what) for p in pairs])
            for what in ("measured", "predicted", "lower95", "upper95")
        )
        inside = (low <= m) & (m <= high)
        z = (m - value) / ((high - low) / 3.92)
        covered.append(inside)
        cells = "   ".join(
            f"{inside[:, j].mean():.2f} {z[:, j].mean():+5.1f} {z[:, j].std():4.1f}"
            for j in range(m.shape[1])
        )
        lines.append(f"{name:<12}  {cells}")
    lines.append(f"all: {np.sum(covered)} of {np.size(covered)}")
    return "\n".join(lines)


def main() -> None:
    """Print both tables, 500 Hz and 1 kHz side by side."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seed", type=int, nargs="?", default=11)
    seed: int = parser.parse_args().seed
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        campaign = read_campaign(write_campaign(folder, seed))
        write_result(folder, identify(**identify_arguments(campaign)), input_files(campaign))
        fitted = predict(question_of(campaign, read_result(folder / "result.json")))
        a = np.array([[v] * 2 for v in ABSORPTION.values()])
        true = AbsorptionPosterior(
            tuple(ABSORPTION), campaign.bands, a, a, a, np.zeros((2, len(a), len(a)))
        )
        known = predict(question_of(campaign, true))
    sys.stdout.write(
        formatted(
            "fitted absorption, pairs kept apart", [p for p in fitted.pairs if p.use != "fit"]
        )
        + "\n\n"
        + formatted("true absorption, all pairs", list(known.pairs))
        + "\n"
    )


if __name__ == "__main__":
    main()
