"""The workbench over time: simulated users at the demo project, and what memory it takes.

Each user has a browser window, goes from tab to tab, chooses surfaces, types positions and reloads.
Printed every half minute: memory of the server and of its workers in MiB (Linux), files that the
server holds open, and how long a tab took. Memory that grows without end is a fault.

    python benchmarks/app_soak.py --minutes 3 --users 3
    python benchmarks/app_soak.py --minutes 60 --users 5
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

_TABS = ("Room", "Measurements", "Identify", "Report")


def main() -> None:
    """Run and print; end with 1 where memory has doubled in the second half."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=3.0)
    parser.add_argument("--users", type=int, default=3)
    parser.add_argument("--browser", default="/usr/bin/chromium")
    options = parser.parse_args()
    from roomfit.app import views

    with tempfile.TemporaryDirectory() as folder:
        views.demo(lambda _: None, folder)
        command = [sys.executable, "-m", "roomfit", "app", folder, "--port", "0", "--no-browser"]
        server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            address = address_of(server)
            memory_mib = _soak(address, server.pid, options)
        finally:
            server.terminate()
            server.wait(15)
    half = memory_mib[len(memory_mib) // 2 :]
    print(f"server: {half[0]:.0f} MiB at half of the time, {half[-1]:.0f} MiB at the end")
    sys.exit(1 if half[-1] > 2.0 * half[0] else 0)


def address_of(server: subprocess.Popen[str]) -> str:
    """Return the address that a workbench prints."""
    for line in server.stdout or ():
        found = re.search(r"http://\S+", line)
        if found:
            return found[0]
    raise SystemExit("the workbench did not start")


def _soak(address: str, pid: int, options: argparse.Namespace) -> list[float]:
    from playwright.sync_api import sync_playwright

    rng = random.Random(1)
    began = printed_at = time.monotonic()
    memory_mib, times_s = [_memory_mib(pid)], [0.0]
    n_steps = 0
    print(f"{'s':>6} {'server':>8} {'workers':>8} {'files':>6} {'steps':>6} {'tab, s':>7}")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=options.browser, args=["--no-sandbox"])
        pages = [browser.new_context().new_page() for _ in range(options.users)]
        for page in pages:
            page.set_default_timeout(60_000)
            page.goto(address)
        while time.monotonic() - began < 60.0 * options.minutes:
            times_s.append(_step(rng.choice(pages), rng))
            n_steps += 1
            if time.monotonic() - printed_at > 30.0:
                printed_at = time.monotonic()
                memory_mib.append(_memory_mib(pid))
                workers = sum(_memory_mib(child) for child in children_of(pid))
                n_files = len(list(Path(f"/proc/{pid}/fd").iterdir()))
                print(
                    f"{printed_at - began:6.0f} {memory_mib[-1]:8.0f} {workers:8.0f} {n_files:6d} "
                    f"{n_steps:6d} {sorted(times_s)[len(times_s) // 2]:7.2f}",
                    flush=True,
                )
        browser.close()
    return memory_mib


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
    else:
        page.get_by_text("No answer yet").last.wait_for()
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
