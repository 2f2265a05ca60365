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


def scope(
    cookie: str | None = None, *, method: str = "GET", path: str = "/", query: str = ""
) -> dict[str, Any]:
    headers = [(b"host", b"127.0.0.1:8321")]
    if cookie is not None:
        headers.append((b"cookie", cookie.encode()))
    return {
        "type": "http",
        "method": method,
        "path": path,
        "query_string": query.encode(),
        "headers": headers,
    }


def test_the_session_is_the_whole_cookie_and_no_part_of_it() -> None:
    whole = DOOR.session
    assert DOOR.refusal(scope(f"{DOOR.cookie}={whole}")) is None
    for part in ("", whole[:-1], whole[:8], whole[1:], whole + "x", whole.swapcase(), DOOR.token):
        refused = DOOR.refusal(scope(f"{DOOR.cookie}={part}"))
        assert refused is not None and refused[0] == 403, part
    for cookie in (None, "", DOOR.cookie, f"roomfit-8322={whole}", f"x={whole}", whole):
        refused = DOOR.refusal(scope(cookie))
        assert refused is not None and refused[0] == 403, cookie


def answer(door: Door, request: dict[str, Any]) -> tuple[int, dict[bytes, bytes], bool]:
    """Return status and headers of what the guard answers, and whether it passed the request on."""
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
    return sent[0]["status"], dict(sent[0]["headers"]), bool(passed)


def test_the_key_opens_by_a_get_of_the_first_page_alone() -> None:
    query = f"token={DOOR.token}"
    status, headers, passed = answer(DOOR, scope(query=query))
    assert (status, passed) == (303, False)
    assert DOOR.session.encode() in headers[b"set-cookie"]
    others = [scope(query=query, method=m) for m in ("POST", "HEAD", "PUT", "DELETE", "OPTIONS")]
    others += [scope(query=query, path=p) for p in ("/files/result/report.html", "/upload/room/a")]
    whole = DOOR.token
    parts = ("", whole[:-1], whole + "x", whole[1:], DOOR.session)
    others += [scope(query=f"token={part}") for part in parts]
    others += [scope(query=f"{query}&{query}"), scope(query=f"Token={whole}"), scope(query="")]
    for other in others:
        status, headers, passed = answer(DOOR, other)
        assert (status, passed) == (403, False), other
        assert b"set-cookie" not in headers and DOOR.session not in str(headers)


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
