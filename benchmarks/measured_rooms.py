"""Measured rooms: how well positions that were not fitted are predicted, beside the null model.

    python benchmarks/measured_rooms.py FOLDER

FOLDER holds `dechorate` (six responses S1_M1.wav ... and positions.csv, Di Carlo et al. 2021) and
`bras_cr2` (scene9.ac and one response, Aspoeck et al. 2020). Neither comes with roomfit.

The null model knows nothing of the room: it takes the mean of the other microphones.
"""

from __future__ import annotations

import csv
import sys
import tempfile
from pathlib import Path

import numpy as np

from roomfit.app.identify import identify
from roomfit.files.campaign.campaign import read_campaign
from roomfit.report.answer_text import absorption_table, separable_text
from roomfit.uncertainty.answer import Answer

DECHORATE_ROOM = """
[room]
shoebox = [5.705, 5.965, 2.355]
[room.materials]
west = "walls"
east = "walls"
south = "walls"
north = "walls"
[air]
temperature_c = 24.0
speed_of_sound_m_s = 346.98
"""


def dechorate_campaign(data: Path, left_out: str | None) -> str:
    """Return the campaign text, one microphone kept for validation or none."""
    with (data / "positions.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    text = DECHORATE_ROOM
    for row in rows:
        position = [float(row[k]) for k in ("x_m", "y_m", "z_m")]
        text += f"[{row['kind']}s.{row['name']}]\nposition = {position}\n"
    for name in (row["name"] for row in rows if row["kind"] == "receiver"):
        text += f'[[measurements]]\nsource = "S1"\nreceiver = "{name}"\nlevel = "per-file"\n'
        text += f'file = "{(data / f"S1_{name}.wav").as_posix()}"\n'
        text += f'use = "{"validate" if name == left_out else "fit"}"\n'
    return text


def bras_campaign(data: Path) -> str:
    """Return the campaign text of seminar room CR2, source LS1, microphone MP1."""
    return f"""
[room]
file = "{(data / "scene9.ac").as_posix()}"
unit = "m"
up = "y"
[air]
temperature_c = 19.5
humidity_percent = 41.7
[sources.LS1]
position = [0.931, -2.547, 0.723]
[receivers.MP1]
position = [-0.993, 1.426, 1.23]
[[measurements]]
source = "LS1"
receiver = "MP1"
file = "{(data / "scene9_RIR_LS1_MP1_Dodecahedron.wav").as_posix()}"
"""


def answer_to(text: str) -> Answer:
    """Return what roomfit says of a campaign given as text."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "campaign.toml"
        path.write_text(text)
        return identify(read_campaign(path))


def errors_percent(answer: Answer, use: str, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return relative errors of model and null model in percent, (n_pairs, n_bands) each."""
    compared = [p.parameters[name] for p in answer.pairs if p.use == use]
    measured = np.array([c.measured for c in compared])
    ours = np.array([c.predicted for c in compared])
    null = np.array([c.null for c in compared])
    return 100.0 * np.abs(ours / measured - 1.0), 100.0 * np.abs(null / measured - 1.0)


def row(label: str, values: np.ndarray, from_band: int) -> str:
    """Return one line: the mean per band, and over the bands from 500 Hz up."""
    means = np.nanmean(values, axis=0)
    cells = " ".join(f"{m:7.1f}" for m in means)
    return f"{label:<38}{cells}   {np.nanmean(means[from_band:]):7.1f}"


def dechorate(data: Path) -> None:
    """Print the answer for all six microphones, then each predicted from the five others."""
    everything = answer_to(dechorate_campaign(data, None))
    print("dEchorate, six microphones fitted\n")
    print(absorption_table(everything), "\n")
    print(separable_text(everything), "\n")
    centres = everything.bands.centres_hz
    from_band = int(np.searchsorted(centres, 500.0))
    print("mean absolute error, %" + " " * 16 + " ".join(f"{f:7g}" for f in centres) + "   500 up")
    fitted = errors_percent(everything, "fit", "T20_s")
    left_out = [answer_to(dechorate_campaign(data, f"M{i}")) for i in range(1, 7)]
    for name in ("T20_s", "T30_s", "EDT_s"):
        short = name.split("_")[0]
        if name == "T20_s":
            print(row("T20, fitted microphones", fitted[0], from_band))
        pairs = [errors_percent(a, "validate", name) for a in left_out]
        ours, null = (np.concatenate([p[i] for p in pairs]) for i in (0, 1))
        print(row(f"{short}, microphone left out, predicted", ours, from_band))
        print(row(f"{short}, mean of the five others (null)", null, from_band))


def bras(data: Path) -> None:
    """Print the answer for seminar room CR2 from its one response."""
    answer = answer_to(bras_campaign(data))
    print("\nBRAS CR2, one response fitted; there is no other measurement for a null model\n")
    print(absorption_table(answer), "\n")
    print(separable_text(answer), "\n")
    pair = answer.pairs[0]
    print("T20 (s)    " + " ".join(f"{f:7g}" for f in answer.bands.centres_hz))
    print("measured   " + " ".join(f"{t:7.2f}" for t in pair.parameters["T20_s"].measured))
    print("predicted  " + " ".join(f"{t:7.2f}" for t in pair.parameters["T20_s"].predicted))


def main() -> None:
    """Run both rooms."""
    if len(sys.argv) != 2:
        print("no folder of measurements given: nothing to do")
        return
    folder = Path(sys.argv[1])
    dechorate(folder / "dechorate")
    bras(folder / "bras_cr2")


if __name__ == "__main__":
    main()
