"""A workbench that runs, and a client that speaks to it as a stranger could."""

from __future__ import annotations

import http.client
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest


@dataclass
class Answer:
    status: int
    headers: Mapping[str, str]
    body: bytes


@dataclass
class Running:
    folder: Path
    address: str
    process: subprocess.Popen[str]

    @property
    def pid(self) -> int:
        return self.process.pid

    def ended(self) -> tuple[int, str]:
        """Interrupt it; return the exit code, and what it has said."""
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(60), self.process.communicate()[1]

    @property
    def port(self) -> int:
        return int(re.search(r":(\d+)/", self.address)[1])  # type: ignore[index]

    @property
    def key(self) -> str:
        return self.address.rstrip("/").rpartition("/")[2]

    def below(self, path: str, key: bool) -> str:
        return f"/{self.key}{path}" if key else path

    def ask(
        self, method: str, path: str, body: bytes, headers: Mapping[str, str], key: bool
    ) -> Answer:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=120)
        try:
            connection.request(method, self.below(path, key), body or None, dict(headers))
            got = connection.getresponse()
            return Answer(got.status, {k.lower(): v for k, v in got.getheaders()}, got.read())
        finally:
            connection.close()

    def get(self, path: str, headers: Mapping[str, str] | None = None, key: bool = True) -> Answer:
        return self.ask("GET", path, b"", headers or {}, key)

    def put(
        self, path: str, body: bytes, headers: Mapping[str, str] | None = None, key: bool = True
    ) -> Answer:
        return self.ask("PUT", path, body, headers or {}, key)

    def websocket(self, headers: Mapping[str, str], key: bool = True, after_s: float = 0.0) -> int:
        """Return the status with which a WebSocket is opened or refused; 101 is opened.

        0 where it was opened and is closed so many seconds later.
        """
        upgrade = {
            "Connection": "Upgrade",
            "Upgrade": "websocket",
            "Sec-WebSocket-Version": "13",
            "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
        }
        path = self.below("/_nicegui_ws/socket.io/?EIO=4&transport=websocket", key)
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=120)
        try:
            connection.request("GET", path, None, {**upgrade, **headers})
            status = connection.getresponse().status
            if after_s > 0.0:
                time.sleep(after_s)
                connection.sock.settimeout(0.2)
                with suppress(TimeoutError):
                    while connection.sock.recv(65536):
                        pass
                    return 0
            return status
        finally:
            connection.close()

    def leftovers(self) -> list[Path]:
        # not below it: a folder that goes away meanwhile would be an error
        return list(self.folder.glob(".roomfit-upload-*"))


@contextmanager
def running(folder: Path, limits: str = "", browser: str = "") -> Iterator[Running]:
    """Start ``roomfit app`` as a user does, and end it."""
    command = [sys.executable, "-m", "roomfit", "app", str(folder), "--port", "0"]
    own = {"ROOMFIT_LIMITS": limits, **({"BROWSER": browser} if browser else {})}
    process = subprocess.Popen(
        [*command, *([] if browser else ["--no-browser"])],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, **own},
    )
    try:
        assert process.stdout is not None
        found = None
        while found is None and (line := process.stdout.readline()):
            found = re.search(r"http://\S+", line)
        assert found is not None, "no address was printed"
        yield Running(folder, found[0], process)
    finally:
        process.terminate()
        try:
            process.wait(60)
        finally:
            process.kill()


def chromium() -> Any:
    """Return a function that starts a browser, or skip."""
    playwright = pytest.importorskip("playwright.sync_api", reason="no playwright")
    usual = ("/usr/bin/chromium", "/usr/bin/chromium-browser")
    path = next((p for p in (os.environ.get("CHROMIUM", ""), *usual) if Path(p).is_file()), "")
    if not path:
        pytest.skip("no Chromium at /usr/bin/chromium, and none that CHROMIUM names")
    # a microphone that beeps, which is asked for without a question
    fake = ["--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream"]
    return playwright.sync_playwright, {"executable_path": path, "args": ["--no-sandbox", *fake]}
