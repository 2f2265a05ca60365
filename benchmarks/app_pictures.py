"""Pictures of every tab of the workbench, as docs/app.md shows them.

    python benchmarks/app_pictures.py PROJECT OUT [--browser /usr/bin/chromium]

PROJECT is a folder that `roomfit app` opens, with a result; an empty one is given the demo project,
a target for STI and the full answer from 125 Hz to 8 kHz first. Each tab is taken at 1400 and at
390 px, light and dark; in *What if* the brick is made more absorbing. Written are the tabs, as
TAB-WIDTH-SCHEME.png, and what of them the documentation shows: app_TAB.png, app_dark.png and
app_phone.png.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

from PIL import Image


def address_of(server: subprocess.Popen[str]) -> str:
    """Return the address that the page's server prints."""
    for line in server.stdout or ():
        found = re.search(r"http://\S+", line)
        if found:
            return found[0]
    raise SystemExit("the page did not start")


_SEEN = {
    "Room": "can be traced",
    "Measure": "Measure an impulse response",
    "Measurements": "T20 is not evaluated there",
    "Identify": "Absorption: full answer",
    "What if": "changed.",
    "Report": "Download report.html",
}

_PLAIN_NAME = "() => { document.querySelector('header .soft').textContent = 'my-room'; }"
_FIXED = ".report { height: 675px !important }"
_TREATMENT = """
[surfaces.brick]
[products."wool panel"]
absorption = { centres_hz = [125, 500, 2000, 8000], values = [0.2, 0.9, 0.95, 0.9] }
[[targets]]
parameter = "STI"
at_least = 0.75
"""


def main() -> None:
    """Write the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("project", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--browser", default="/usr/bin/chromium")
    options = parser.parse_args()
    from playwright.sync_api import sync_playwright

    options.out.mkdir(parents=True, exist_ok=True)
    if not (options.project / "campaign.toml").is_file():
        _fill(options.project)
    command = [sys.executable, "-m", "roomfit", "app", str(options.project)]
    command += ["--port", "0", "--no-browser"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        address = address_of(server)
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(
                executable_path=options.browser, args=["--no-sandbox"]
            )
            for width in (1400, 390):
                for scheme in ("light", "dark"):
                    context = browser.new_context(
                        viewport={"width": width, "height": 900}, color_scheme=scheme
                    )
                    page = context.new_page()
                    page.set_default_timeout(600_000)
                    page.goto(address)
                    page.get_by_text("can be traced").wait_for()
                    page.evaluate(_PLAIN_NAME)
                    page.add_style_tag(content=_FIXED)
                    for tab in _SEEN:
                        _show(page, tab)
                        name = f"{tab.lower().replace(' ', '_')}-{width}-{scheme}.png"
                        high = page.evaluate("document.documentElement.scrollHeight")
                        page.set_viewport_size({"width": width, "height": high})
                        page.wait_for_timeout(1000)  # ripples and menus have gone
                        page.screenshot(path=options.out / name)
                        page.set_viewport_size({"width": width, "height": 900})
                    context.close()
            browser.close()
    finally:
        server.terminate()
        server.wait(30)
    tabs = [tab.lower().replace(" ", "_") for tab in _SEEN]
    for tab in tabs:
        if tab == "measure":  # app_measure.png shows a pair that was measured, which takes a loop
            continue
        _sheet(options.out, [f"{tab}-1400-light"], 1, (1120, 900), f"app_{tab}")
    _sheet(options.out, [f"{tab}-1400-dark" for tab in tabs], 3, (560, 480), "app_dark")
    phone = [f"{tab}-390-{scheme}" for scheme in ("light", "dark") for tab in tabs]
    _sheet(options.out, phone, len(tabs), (260, 640), "app_phone")


def _sheet(out: Path, names: list[str], columns: int, most: tuple[int, int], name: str) -> None:
    """Write screens beside each other, in few colours, each as wide and at most as high as said."""
    screens = [Image.open(out / f"{one}.png").convert("RGB") for one in names]
    screens = [s.resize((most[0], round(s.height * most[0] / s.width))) for s in screens]
    high = min(most[1], max(s.height for s in screens))
    rows = -(-len(screens) // columns)
    sheet = Image.new("RGB", (columns * (most[0] + 8) - 8, rows * (high + 8) - 8), "white")
    for i, screen in enumerate(screens):
        row, column = divmod(i, columns)
        at = column * (most[0] + 8), row * (high + 8)
        sheet.paste(screen.crop((0, 0, most[0], min(high, screen.height))), at)
    # coverage keeps the colour of a line that is thin
    sheet.quantize(96, Image.Quantize.MAXCOVERAGE).save(out / f"{name}.png", optimize=True)


def _fill(folder: Path) -> None:
    from roomfit.app import project, tasks

    folder.mkdir(parents=True, exist_ok=True)
    tasks.demo(lambda _: None, folder)
    (folder / "treatment.toml").write_text(_TREATMENT)
    project.set_bands(folder, 125.0, 8000.0)
    tasks.identify(lambda _: None, folder, False)


def _show(page: Any, tab: str) -> None:
    """Go to a tab, and do there what its picture shows."""
    page.get_by_role("tab", name=tab, exact=True).click()
    page.get_by_text(_SEEN[tab]).first.wait_for()
    if tab == "Room":
        page.get_by_role("button", name=re.compile("^floor")).click()
        page.get_by_text("Surface floor").wait_for()
    elif tab == "Identify":
        page.frame_locator("iframe").get_by_text("Provenance").first.wait_for()
    elif tab == "What if":
        page.get_by_role("combobox", name="Material").click()
        page.get_by_role("option", name="brick").click()
        for band in ("500 Hz", "1 kHz", "2 kHz", "4 kHz"):
            page.get_by_label(f"Absorption of brick at {band}").fill("0.9")
        page.get_by_text("1 material changed").wait_for()
        page.wait_for_timeout(3000)  # the last band has been drawn, too


if __name__ == "__main__":
    main()
