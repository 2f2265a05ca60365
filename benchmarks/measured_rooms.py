"""Measured rooms: how well pairs that were not fitted are predicted, beside the null model.

    python benchmarks/measured_rooms.py FOLDER [--room ROOM ...] [--model MODEL]
        [--seed SEED]

FOLDER holds `dechorate` (six responses S1_M1.wav ... and positions.csv, Di Carlo et al. 2021),
`tudelft_inhouse` (five loudspeakers with eight microphones each) and `bras_cr2` (scene9.ac, one
response and measured values of five pairs, Aspoeck et al. 2020). None comes with roomfit.

The null model knows nothing of the room: it takes the mean of the pairs that were fitted.

ROOM        dechorate    three microphones fitted, three predicted
            dechorate-aimed  the same, the loudspeaker specified to aim at the fitted microphones
            dechorate-fitted  the same, the loudspeaker's directivity fitted
            dechorate-1  each microphone predicted from the five others
            tudelft      four loudspeakers fitted, the fifth predicted; the outline in two variants
            tudelft-fitted the same with a directivity of each loudspeaker that is fitted
            tudelft-null the null model alone, each loudspeaker in turn: nothing is fitted
            bras         one response and ISO 3382 values of two pairs fitted, a fourth predicted
"""

from __future__ import annotations

import argparse
import csv
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from _ac3d import as_obj
from roomfit.base.table import text_of
from roomfit.files.campaign import read_campaign
from roomfit.files.inputs import identify_arguments, load_campaign
from roomfit.fit.measurements import collect_measurements
from roomfit.identify import identify
from roomfit.report.tables import absorption_tables, source_tables
from roomfit.result import Result

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
DELFT_ROOM = """
[room]
shoebox = [8.1, 6.8, 3.07]
[room.materials]
west = "walls"
east = "walls"
south = "walls"
north = "walls"
"""
DELFT_LOUDSPEAKERS = (1, 4, 5, 6, 7)
# Where file and room have their corners apart: echoes tell x, nothing tells y.
DELFT_SHIFT_M = (0.45, 0.5, 0.0)
BRAS_PLACES_M = ((-0.993, 1.426), (0.439, -0.147), (1.361, -0.603), (-1.110, -0.256))
# Whether an error is specified relative to the measured value, and in which unit.
JUDGED = {
    "T20_s": ("T20", True, "%"),
    "T30_s": ("T30", True, "%"),
    "EDT_s": ("EDT", True, "%"),
    "C80_dB": ("C80", False, "dB"),
    "D50_percent": ("D50", False, "points"),
}


def dechorate_campaign(data: Path, left_out: tuple[str, ...]) -> str:
    """Return the campaign text, some microphones kept for validation."""
    with (data / "positions.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    text = DECHORATE_ROOM
    for row in rows:
        position = [float(row[k]) for k in ("x_m", "y_m", "z_m")]
        text += f"[{row['kind']}s.{row['name']}]\nposition = {position}\n"
    for name in (row["name"] for row in rows if row["kind"] == "receiver"):
        text += f'[[measurements]]\nsource = "S1"\nreceiver = "{name}"\nlevel = "per-file"\n'
        text += f'file = "{(data / f"S1_{name}.wav").as_posix()}"\n'
        text += f'use = "{"validate" if name in left_out else "fit"}"\n'
    return text


def delft_campaign(data: Path, left_out: int, shift_m: tuple[float, float, float]) -> str:
    """Return the campaign text, one loudspeaker kept for validation."""
    text, files = DELFT_ROOM, {n: data / f"RIR_{n}.mat" for n in DELFT_LOUDSPEAKERS}
    shift = np.array(shift_m)
    for i, place in enumerate(loadmat(files[DELFT_LOUDSPEAKERS[0]])["loc_microphone"] + shift):
        text += f"[receivers.M{i}]\nposition = {place.round(4).tolist()}\n"
    for number, file in files.items():
        place = loadmat(file)["loc_loudspeaker"][0] + shift
        text += f"[sources.L{number}]\nposition = {place.round(4).tolist()}\n"
        for i in range(8):
            text += f'[[measurements]]\nsource = "L{number}"\nreceiver = "M{i}"\n'
            text += f'file = "{file.as_posix()}"\nvariable = "RIR"\nchannel = {i}\n'
            text += 'sampling_rate_variable = "Fs"\ntime_zero = "unknown"\n'
            text += f'use = "{"validate" if number == left_out else "fit"}"\n'
    return text


def bras_campaign(data: Path) -> str:
    """Return the campaign text of seminar room CR2, source LS1, microphone MP1."""
    return f"""
[room]
file = "{as_obj(data / "scene9.ac").as_posix()}"
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


def bras_joint_campaign(data: Path) -> str:
    """Return CR2 with its one response, values of MP2 and MP3, and those of MP4 kept apart."""
    text = bras_campaign(data)
    table = (data / "measured_LS1_per_pair_octave.csv").as_posix()
    for i, (x, y) in enumerate(BRAS_PLACES_M[1:], start=2):
        text += f"[receivers.MP{i}]\nposition = [{x}, {y}, 1.23]\n"
        text += f'[[measurements]]\nparameters = "{table}"\nreceiver = "MP{i}"\n'
        text += f'use = "{"validate" if i == len(BRAS_PLACES_M) else "fit"}"\n'
    return text


def answer_to(text: str) -> Result:
    """Return what roomfit says of a campaign given as text."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "campaign.toml"
        path.write_text(text)
        return identify(**load_campaign(path))


def errors(answer: Result, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return absolute errors of model and null model over pairs kept apart, (n_pairs, n_bands)."""
    pairs = [p for p in answer.pairs if p.use == "validate" and name in p.parameters]
    measured, ours, null = (
        np.array([getattr(p.parameters[name], kind) for p in pairs], dtype=np.float64)
        for kind in ("measured", "predicted", "null")
    )
    if not pairs:
        return np.zeros((0, len(answer.bands))), np.zeros((0, len(answer.bands)))
    scale = 100.0 / measured if JUDGED[name][1] else 1.0
    return np.abs(scale * (ours - measured)), np.abs(scale * (null - measured))


def table(answers: list[Result]) -> str:
    """Return mean errors per band and over 500 to 4000 Hz, the null model below each."""
    centres = answers[0].bands.centres_hz
    judged = centres > 400.0
    lines = [f"{'mean |error|':<24}" + " ".join(f"{f:7g}" for f in centres) + "   500-4000"]
    for name, (short, _, unit) in JUDGED.items():
        pairs = [errors(a, name) for a in answers]
        for i, label in enumerate((f"{short} ({unit})", "   null model")):
            both = np.concatenate([p[i] for p in pairs])
            if both.size and np.isfinite(both).any():
                means = [np.nanmean(c) if np.isfinite(c).any() else np.nan for c in both.T]
                cells = " ".join(f"{m:7.2f}" for m in means)
                lines.append(f"{label:<24}{cells}    {np.nanmean(both[:, judged]):7.2f}")
    return "\n".join(lines)


def show(title: str, answers: list[Result], *, whole: bool = True) -> None:
    """Print one room: what was found, what was doubted, and what was predicted how well."""
    first = answers[0]
    print(f"\n{title}\n{'=' * len(title)}")
    if whole:
        print(f"models {', '.join(first.models)}; {first.seconds:.0f} s")
        print("phi    " + " ".join(f"{p:.1f}" for p in first.chi2_reduced), "\n")
        print(*map(text_of, absorption_tables(first)), "", sep="\n")
        for finding in first.findings:
            print(f"{finding.severity}: {finding.code}: {finding.sentence}")
        print()
    print(table(answers))


def dechorate(data: Path, ending: str) -> None:
    """Three microphones fitted, three predicted."""
    text = dechorate_campaign(data / "dechorate", ("M4", "M5", "M6")) + ending
    show("dEchorate, M1 to M3 fitted, M4 to M6 predicted", [answer_to(text)])


def dechorate_aimed(data: Path, ending: str) -> None:
    """Three microphones fitted, three predicted, with an assumed aim of the loudspeaker."""
    text = dechorate_campaign(data / "dechorate", ("M4", "M5", "M6")) + ending
    specified = "[sources.S1]\ndirectivity = {aim = [-0.4, -1.0, -0.1], b = 0.5}\n"
    text = text.replace("[sources.S1]\n", specified)
    show("dEchorate, loudspeaker aimed at M1 to M3, M4 to M6 predicted", [answer_to(text)])


def dechorate_fitted(data: Path, ending: str) -> None:
    """Three microphones fitted, three predicted, with the loudspeaker's directivity fitted."""
    text = dechorate_campaign(data / "dechorate", ("M4", "M5", "M6")) + ending
    text = text.replace("[sources.S1]\n", '[sources.S1]\ndirectivity = "fit"\n')
    answer = answer_to(text)
    show("dEchorate, directivity fitted, M4 to M6 predicted", [answer])
    print("", *map(text_of, source_tables(answer)), sep="\n")


def dechorate_one_out(data: Path, ending: str) -> None:
    """Each microphone predicted from the five others."""
    texts = [dechorate_campaign(data / "dechorate", (f"M{i}",)) + ending for i in range(1, 7)]
    show("dEchorate, each from the five others", [answer_to(t) for t in texts], whole=False)


def delft(data: Path, ending: str) -> None:
    """Four loudspeakers fitted, the last predicted; corners given at the wall, and of the file."""
    for specified, shift in (
        ("x + 0.45 m, y + 0.5 m", DELFT_SHIFT_M),
        ("as in the files", (0, 0, 0)),
    ):
        text = delft_campaign(data / "tudelft_inhouse", 7, shift) + ending
        show(f"TU Delft, loudspeaker 7 predicted; positions {specified}", [answer_to(text)])


def delft_fitted(data: Path, ending: str) -> None:
    """Four loudspeakers fitted with a directivity each, the last predicted as if it had none."""
    text = delft_campaign(data / "tudelft_inhouse", 7, DELFT_SHIFT_M) + ending
    for number in DELFT_LOUDSPEAKERS:
        if number != 7:
            named = f"[sources.L{number}]\n"
            text = text.replace(named, f'{named}directivity = "fit"\n')
    answer = answer_to(text)
    show("TU Delft, directivities fitted, loudspeaker 7 predicted", [answer])
    print("", *map(text_of, source_tables(answer)), sep="\n")


def delft_null(data: Path, ending: str) -> None:
    """How well the mean of four loudspeakers tells the T20 of each fifth; nothing is fitted."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "campaign.toml"
        path.write_text(delft_campaign(data / "tudelft_inhouse", 7, DELFT_SHIFT_M) + ending)
        campaign = read_campaign(path)
        arguments = identify_arguments(campaign)
        responses = collect_measurements(
            arguments["scene"], arguments["measurements"], campaign.bands, {}
        ).responses
    of = {
        n: np.array(
            [m.parameters.of("T20_s") for m in responses if m.measurement.source == f"L{n}"]
        )
        for n in DELFT_LOUDSPEAKERS
    }
    judged = campaign.bands.centres_hz > 400.0
    print("\nTU Delft, null model: T20, 500 to 4000 Hz, mean |error| of")
    print("loudspeaker   each microphone   the microphones' mean")
    every = []
    for left_out, own in of.items():
        null = np.mean(np.concatenate([x for n, x in of.items() if n != left_out]), axis=0)
        each = 100.0 * np.abs(null / own - 1.0)[:, judged].mean()
        mean = 100.0 * np.abs(null / own.mean(axis=0) - 1.0)[judged].mean()
        every.append((each, mean))
        print(f"{left_out:>11} {each:15.1f} % {mean:21.1f} %")
    each, mean = np.mean(every, axis=0)
    print(f"{'all':>11} {each:15.1f} % {mean:21.1f} %")


def bras(data: Path, ending: str) -> None:
    """One response and values of two pairs fitted, a further pair predicted."""
    text = bras_joint_campaign(data / "bras_cr2") + ending
    show("BRAS CR2, the response of MP1 and values of MP2, MP3; MP4 predicted", [answer_to(text)])


ROOMS: dict[str, Callable[[Path, str], None]] = {
    "dechorate": dechorate,
    "dechorate-aimed": dechorate_aimed,
    "dechorate-fitted": dechorate_fitted,
    "dechorate-1": dechorate_one_out,
    "tudelft": delft,
    "tudelft-fitted": delft_fitted,
    "tudelft-null": delft_null,
    "bras": bras,
}


def main() -> None:
    """Run the rooms that were asked for."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--room", nargs="+", choices=list(ROOMS), default=list(ROOMS))
    parser.add_argument("--model", choices=["auto", "energy", "coherent"], default="auto")
    parser.add_argument("--seed", type=int, default=1, help="of the rays")
    asked = parser.parse_args()
    if asked.folder is None:
        print("no folder of measurements given: nothing to do")
        return
    ending = f'\n[identify]\nmodel = "{asked.model}"\nseed = {asked.seed}\n'
    for room in asked.room:
        ROOMS[room](asked.folder, ending)


if __name__ == "__main__":
    main()
