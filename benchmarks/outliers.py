"""One of eight responses corrupted in a box of another program: detected or not, at what error.

    python benchmarks/outliers.py [--seeds 2 7] [--kinds none clipped room gain swapped position]

none: no response is corrupted; clipped: cut off at 15 % of its peak; room: from another room; gain:
6 dB too loud; swapped: another pair's; position: the receiver specified a metre beside its place.
"""

from __future__ import annotations

import argparse
import re
import tempfile
from pathlib import Path

import numpy as np
import soundfile

from _other_box import OtherBox, write_other_box
from roomfit.base.findings import Code
from roomfit.files.inputs import load_campaign
from roomfit.identify import identify

KINDS = ("none", "clipped", "room", "gain", "swapped", "position")
TARGET = "LS1_MP2.wav"
DETECTED_BY = {Code.MEASUREMENT_OUTLIER, Code.RESPONSE_CLIPPED, Code.TIME_ZERO_MISMATCH}


def corrupt(kind: str, box: OtherBox, seed: int) -> None:
    """Corrupt the response of LS1 to MP2, or the position of MP2."""
    target = box.campaign.parent / TARGET
    pressure, rate_hz = soundfile.read(target)
    if kind == "clipped":
        limit = 0.15 * np.abs(pressure).max()
        pressure = np.clip(pressure, -limit, limit)
    elif kind == "room":
        with tempfile.TemporaryDirectory() as folder:
            write_other_box(seed + 100, Path(folder))
            pressure, _ = soundfile.read(Path(folder) / TARGET)
    elif kind == "gain":
        pressure = 2.0 * pressure
    elif kind == "swapped":
        pressure, _ = soundfile.read(box.campaign.parent / "LS2_MP2.wav")
    elif kind == "position":
        text = box.campaign.read_text()
        position = re.search(r"\[receivers\.MP2\]\nposition = \[([^,]*),", text)
        assert position is not None
        x = float(position[1])
        moved = x + 1.0 if x + 1.5 < box.lengths_m[0] else x - 1.0
        box.campaign.write_text(text[: position.start(1)] + f"{moved}" + text[position.end(1) :])
    soundfile.write(target, pressure.astype(np.float32), rate_hz, subtype="FLOAT")


def main() -> None:
    """Print a row for every room and kind."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[2, 7])
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    arguments = parser.parse_args()
    print("seed kind      |error| median  90 %  cover  identifiable, wrong  findings")
    for seed in arguments.seeds:
        for kind in arguments.kinds:
            with tempfile.TemporaryDirectory() as folder:
                box = write_other_box(seed, Path(folder))
                corrupt(kind, box, seed)
                answer = identify(**load_campaign(box.campaign))
            true = box.absorption_at(answer.bands.centres_hz)
            error = np.abs(answer.absorption - true)
            covered = (answer.lower95 <= true) & (true <= answer.upper95)
            wrong = int(np.count_nonzero(answer.identifiable & ~covered))
            codes = sorted({f.code for f in answer.findings} & DETECTED_BY)
            print(
                f"{seed:4d} {kind:<9} {np.median(error):8.4f} {np.quantile(error, 0.9):10.3f} "
                f"{covered.mean():6.2f} {answer.identifiable.mean():8.2f} {wrong:8d}     ",
                *codes,
                flush=True,
            )


if __name__ == "__main__":
    main()
