"""Draw the pictures of docs/getting-started.md from what its commands write.

    python docs/pictures/getting_started.py [--browser /usr/bin/chromium]

The demo is simulated and identified, checked, and predicted with a curtain; mean absorption is
taken from the page's table of decay times. Pages are taken as a browser shows their heads, and all
pictures are written beside this program with 128 colours.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

HERE = Path(__file__).parent
WIDTH = 1000  # pixels; of a page
_PAGES = {
    "report": ("demo/result/report.html", 700),
    "change": ("predicted/predicted.html", 620),
    "decays": ("mean/reverberation.html", 630),
}
_STEPS = (
    "demo --out demo",
    "check demo/campaign/campaign.toml --out checked --png",
    "predict demo/campaign/campaign.toml --absorption demo/result/result.json "
    "--set brick=curtain-heavy-draped --out predicted",
    "init hall --shoebox 20 14 7 --decay-times t30.csv",
    "reverberation hall/campaign.toml --out mean",
)


def main() -> None:
    """Write the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--browser", default="/usr/bin/chromium")
    browser = parser.parse_args().browser
    page = (HERE.parent / "getting-started.md").read_text(encoding="utf-8")
    (table,) = re.findall(r"^```text\n(place;.*?)^```", page, re.M | re.S)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "t30.csv").write_text(table, encoding="utf-8")
        for step in _STEPS:
            subprocess.run([sys.executable, "-m", "roomfit", *step.split()], cwd=folder, check=True)
        for picture, (file, height) in _PAGES.items():
            shot = folder / f"{picture}.png"
            options = ["--headless", "--no-sandbox", "--hide-scrollbars", f"--screenshot={shot}"]
            window = f"--window-size={WIDTH},{height}"
            address = (folder / file).as_uri()
            subprocess.run([browser, *options, window, address], check=True, capture_output=True)
            keep(shot, picture)
        keep(folder / "checked" / "room.png", "check")
        keep(folder / "checked" / "recording_03_LS1_MP3.png", "recording")


def keep(file: Path, name: str) -> None:
    """Write a picture beside this program, in no more than 128 colours and the width of a page."""
    with Image.open(file) as picture:
        shown = picture.convert("RGB")
        shown.thumbnail((WIDTH, 10 * WIDTH))
        shown.quantize(128).save(HERE / f"start_{name}.png", optimize=True)


if __name__ == "__main__":
    main()
