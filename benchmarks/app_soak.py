"""The workbench over time: simulated users at the demo project, and what memory it takes.

Each user has a browser window, goes from tab to tab, chooses surfaces, types positions, moves
sliders and reloads, on the demo project with a first answer at 1 kHz. Printed every half minute:
memory of the server, of its workers and of the scripts of all windows in MiB (Linux), files that
the server holds open, and how long a step took. Memory that grows without end is a fault: the
medians of the second and of the last quarter of the time are compared.

    python benchmarks/app_soak.py --minutes 3 --users 3
    python benchmarks/app_soak.py --minutes 60 --users 5 --pause 3
"""

from __future__ import annotations

import argparse
import random
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

_TABS = ("Room", "Measurements", "Identify", "What if", "Report")
_SEEN = {"Identify": "Absorption: first answer", "Report": "Download result.json"}
_SETTINGS = "\n[settings]\nn_rays = 3000\nn_scattering_rays = 1000\n"
_MOST_GROWTH = 1.25
_PRINTED_EVERY_S = 30.0


def main() -> None:
    """Run and print; end with 1 where memory has grown by more than a quarter."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=3.0)
    parser.add_argument("--users", type=int, default=3)
    parser.add_argument("--pause", type=float, default=0.0, help="s between two steps")
    parser.add_argument("--browser", default="/usr/bin/chromium")
    options = parser.parse_args()
    from roomfit.app import project, views

    with tempfile.TemporaryDirectory() as folder:
        views.demo(lambda _: None, folder)
        campaign = Path(folder) / "campaign.toml"
        campaign.write_text(campaign.read_text() + _SETTINGS)
        project.set_bands(Path(folder), 1000.0, 1000.0)
        views.identify(lambda _: None, folder, True)
        command = [sys.executable, "-m", "roomfit", "app", folder, "--port", "0", "--no-browser"]
        server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            address = address_of(server)
            memory_mib = _soak(address, server.pid, options)
        finally:
            server.terminate()
            server.wait(15)
    n = len(memory_mib)
    second = np.median(memory_mib[n // 4 : max(n // 2, n // 4 + 1)], axis=0)
    last = np.median(memory_mib[3 * n // 4 :], axis=0)
    for name, was, now in zip(("server", "workers", "windows"), second, last, strict=True):
        print(f"{name}: {was:.1f} MiB in the second quarter, {now:.1f} MiB in the last")
    sys.exit(1 if np.any(last > _MOST_GROWTH * second) else 0)


def address_of(server: subprocess.Popen[str]) -> str:
    """Return the address that a workbench prints."""
    for line in server.stdout or ():
        found = re.search(r"http://\S+", line)
        if found:
            return found[0]
    raise SystemExit("the workbench did not start")


def _soak(address: str, pid: int, options: argparse.Namespace) -> list[tuple[float, float, float]]:
    from playwright.sync_api import sync_playwright

    rng = random.Random(1)
    began = printed_at = time.monotonic()
    memory_mib: list[tuple[float, float, float]] = []
    times_s: list[float] = []
    print("     s   server  workers  windows  files  steps step, s")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=options.browser, args=["--no-sandbox"])
        pages = [browser.new_context().new_page() for _ in range(options.users)]
        looks = [page.context.new_cdp_session(page) for page in pages]
        for page, look in zip(pages, looks, strict=True):
            page.set_default_timeout(300_000)
            page.goto(address)
            look.send("Performance.enable")
        while time.monotonic() - began < 60.0 * options.minutes:
            times_s.append(_step(rng.choice(pages), rng))
            pages[0].wait_for_timeout(1e3 * options.pause)
            if time.monotonic() - printed_at > _PRINTED_EVERY_S:
                printed_at = time.monotonic()
                workers = sum(_memory_mib(child) for child in children_of(pid))
                windows = sum(map(_heap_mib, looks))
                memory_mib.append((_memory_mib(pid), workers, windows))
                n_files = len(list(Path(f"/proc/{pid}/fd").iterdir()))
                print(
                    f"{printed_at - began:6.0f} {memory_mib[-1][0]:8.1f} {workers:8.1f} "
                    f"{windows:8.1f} {n_files:6d} {len(times_s):6d} {np.median(times_s):7.2f}",
                    flush=True,
                )
        browser.close()
    return memory_mib


def _heap_mib(look: Any) -> float:
    """Return what the scripts of a window hold after all that can be collected is, in MiB."""
    look.send("HeapProfiler.collectGarbage")  # gc() leaves documents that were reloaded
    found = look.send("Performance.getMetrics")["metrics"]
    return float(next(m["value"] for m in found if m["name"] == "JSHeapUsedSize")) / 2**20


def _step(page: Any, rng: random.Random) -> float:
    """Let one user do something; return how long the page took, in s."""
    began = time.monotonic()
    if rng.random() < 0.1:
        page.reload()
        page.get_by_role("tab", name="Room").wait_for()
        return time.monotonic() - began
    name = rng.choice(_TABS)
    page.get_by_role("tab", name=name).click()
    if name == "Room":
        surface = rng.choice(("floor", "ceiling", "east", "west"))
        page.get_by_role("button", name=re.compile(f"^{surface}")).click()
        page.get_by_text(f"Surface {surface}").wait_for()
    elif name == "Measurements":
        field = page.get_by_label("MP1 z in m")
        field.fill(f"{rng.uniform(1.1, 1.3):.3f}")
        field.press("Enter")
    elif name == "What if":
        slider = page.get_by_label(re.compile("^Absorption of .* at 1 kHz"))
        slider.press(rng.choice(("ArrowRight", "ArrowLeft")))
        page.get_by_text("1 material changed").wait_for()
    else:
        page.get_by_text(_SEEN[name]).wait_for()
    return time.monotonic() - began


def children_of(pid: int) -> list[int]:
    """Return the processes that a process has started, on Linux."""
    listed = Path(f"/proc/{pid}/task/{pid}/children")
    return [int(child) for child in listed.read_text().split()]


def _memory_mib(pid: int) -> float:
    status = Path(f"/proc/{pid}/status").read_text()
    found = re.search(r"VmRSS:\s+(\d+) kB", status)
    return int(found[1]) / 1024 if found else 0.0


if __name__ == "__main__":
    main()
