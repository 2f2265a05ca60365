"""How soon the page answers a slider, in the browser: from its move to the new drawing.

    python benchmarks/app_slider.py PROJECT [--moves 60] [--browser /usr/bin/chromium]

PROJECT is a folder that `roomfit app` opens, with a result. In *What if* the sliders of one
material are moved one after the other, as a hand does with the arrow keys; the time runs in the
browser from the event of the slider to the change of the first drawing. Printed are median and 90 %
of it, the processor time that server and workers take for a move, and the load of the machine
meanwhile: with more at work than it has cores the first is longer than the page alone would take.
Then what a change takes by itself, and whether its
intervals are those from all bands and draws anew.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from app_soak import address_of, children_of

_MOVE = """([slider, drawn, value]) => new Promise((done) => {
  const began = performance.now();
  const seen = new MutationObserver(() => {
    if (drawn.querySelector('svg').getAttribute('aria-label') === window.lastDrawn) return;
    window.lastDrawn = drawn.querySelector('svg').getAttribute('aria-label');
    seen.disconnect();
    requestAnimationFrame(() => done(performance.now() - began));
  });
  window.lastDrawn = drawn.querySelector('svg').getAttribute('aria-label');
  seen.observe(drawn, { subtree: true, childList: true, characterData: true, attributes: true });
  // a band that is not evaluated changes nothing of the first drawing
  setTimeout(() => { seen.disconnect(); done(null); }, 5000);
  slider.value = value;
  slider.dispatchEvent(new Event('input', { bubbles: true }));
})"""


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("project", type=Path)
    parser.add_argument("--moves", type=int, default=60)
    parser.add_argument("--browser", default="/usr/bin/chromium")
    options = parser.parse_args()
    from playwright.sync_api import sync_playwright

    rng, times_ms = np.random.default_rng(1), []
    command = [sys.executable, "-m", "roomfit", "app", str(options.project)]
    command += ["--port", "0", "--no-browser"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=options.browser, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.set_default_timeout(600_000)
        page.goto(address_of(server))
        page.get_by_role("tab", name="What if").click()
        page.get_by_text("0 materials changed").wait_for()
        drawn = page.locator(".charts > *").first.element_handle()
        sliders = page.get_by_label(re.compile("^Absorption of .* at "))
        load, ran_s = [os.getloadavg()[0]], processor_s(server.pid)
        for move in range(options.moves):
            slider = sliders.nth(move % sliders.count()).element_handle()
            value = f"{rng.uniform(0.05, 0.95):.2f}"
            took_ms = page.evaluate(_MOVE, [slider, drawn, value])
            if took_ms is not None:
                times_ms.append(float(took_ms))
            page.wait_for_timeout(100)
        load.append(os.getloadavg()[0])
        ran_s = processor_s(server.pid) - ran_s
        browser.close()
    server.terminate()
    server.wait(30)
    median, most = np.quantile(times_ms, (0.5, 0.9))
    print(
        f"{len(times_ms)} of {options.moves} moves drawn: median {median:.0f} ms, "
        f"90 % within {most:.0f} ms"
    )
    print(f"server and workers: {1e3 * ran_s / options.moves:.0f} ms of processor time a move")
    print(f"load {load[0]:.1f} to {load[1]:.1f} on {os.cpu_count()} cores")
    computed(options.project)


def processor_s(pid: int) -> float:
    """Return the processor time of a process and of those that it has started, in s, on Linux."""
    ticks = 0
    for one in (pid, *children_of(pid)):
        fields = Path(f"/proc/{one}/stat").read_text().rpartition(")")[2].split()
        ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


def computed(project: Path) -> None:
    """Print what a change takes by itself, and whether its intervals are those of all draws."""
    from roomfit.app import what_if
    from roomfit.predict.changes import Change
    from roomfit.predict.diffuse import PreparedField
    from roomfit.predict.other_walls import predict_change

    what_if.what_if_prepare(lambda _: None, str(project))
    room = what_if.prepared(str(project))
    if isinstance(room, PreparedField):
        raise SystemExit("a project of recordings is needed: decay times alone weigh no draws")
    n = len(room.absorption.bands)
    wall_s, own_s, same = [], [], True
    for i in range(20):
        factors = np.ones(n)
        factors[i % n] = 1.0 + 0.05 * (i + 1)
        change = [Change(room.absorption.materials[0], "factor", tuple(factors.tolist()))]
        began, ran = time.perf_counter(), time.process_time()
        few = predict_change(room, change)
        wall_s.append(time.perf_counter() - began)
        own_s.append(time.process_time() - ran)
        anew = predict_change(replace(room, latest=tuple({} for _ in room.few)), change)
        for name, value in few.mean.items():
            same &= np.array_equal(value.lower95, anew.mean[name].lower95, equal_nan=True)
            same &= np.array_equal(value.upper95, anew.mean[name].upper95, equal_nan=True)
    print(f"computed in {np.median(wall_s):.3f} s, {np.median(own_s):.3f} s of processor time")
    print(f"intervals as from all bands and draws anew: {'bit by bit' if same else 'not'}")


if __name__ == "__main__":
    main()
