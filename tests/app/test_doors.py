"""The guard, the queue and the served files alone, without a server: each way in that is none."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from roomfit.app.project import served_file
from roomfit.app.security import Door, Guard
from roomfit.base.errors import InputError

DOOR = Door("127.0.0.1", 8321, 2**20)


def scope(path: str) -> dict[str, Any]:
    return {
        "type": "http",
        "method": "GET",
        "path": path,
        "query_string": b"",
        "headers": [(b"host", b"127.0.0.1:8321"), (b"x-forwarded-prefix", b"/evil")],
    }


def answer(door: Door, request: dict[str, Any]) -> tuple[int, list[Any]]:
    """Return the status that the guard answers, and what it passed on."""
    sent: list[Any] = []
    passed: list[Any] = []

    async def app(inner: Any, receive: Any, send: Any) -> None:
        passed.append(inner)
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b""})

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": b""}

    async def send(message: Any) -> None:
        sent.append(message)

    asyncio.run(Guard(app, door)(request, receive, send))
    return sent[0]["status"], passed


def test_the_key_is_the_whole_beginning_of_the_path_and_no_part_of_it() -> None:
    status, (inner,) = answer(DOOR, scope(f"{DOOR.base}/files/a"))
    assert (status, inner["path"]) == (200, "/files/a")
    prefixes = [v for k, v in inner["headers"] if k == b"x-forwarded-prefix"]
    assert prefixes == [DOOR.base.encode()]  # by which the page knows its own address
    key = DOOR.base[1:]
    for part in ("", key[:-1], key[:8], key[1:], key + "x", key.swapcase(), f"x/{key}", f"/{key}"):
        assert answer(DOOR, scope(f"/{part}/files/a")) == (403, []), part
    assert answer(DOOR, scope(DOOR.base)) == (403, [])


def test_a_link_that_leads_out_of_the_project_is_served_by_no_name(tmp_path: Path) -> None:
    outside = tmp_path / "secret.html"
    outside.write_text("secret")
    project = tmp_path / "project"
    (project / "result").mkdir(parents=True)
    (project / "result" / "report.html").write_text("own")
    (project / "result" / "inner.html").symlink_to("report.html")
    (project / "result" / "file.html").symlink_to(outside)
    (project / "result" / "folder").symlink_to(tmp_path, target_is_directory=True)
    (project / "exports").symlink_to(tmp_path, target_is_directory=True)
    for path in ("result/report.html", "result/inner.html"):
        assert served_file(project, path).read_text() == "own"
    for path in ("result/file.html", "result/folder/secret.html", "exports/secret.html"):
        assert (project / path).read_text() == "secret"
        with pytest.raises(InputError):
            served_file(project, path)
