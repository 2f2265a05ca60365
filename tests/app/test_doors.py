"""The guard, the queue and the served files alone, without a server: each way in that is none."""

from __future__ import annotations

import asyncio
import sys
from argparse import Namespace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from roomfit.app import jobs as jobs_module
from roomfit.app.jobs import Jobs
from roomfit.app.project import served_file
from roomfit.app.security import Door, Guard, new_door, refusal
from roomfit.cli.app import run
from roomfit.errors import InputError

DOOR = new_door("127.0.0.1", 8321, 2**20)


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
    assert refusal(DOOR, scope(f"{DOOR.cookie}={whole}")) is None
    for part in ("", whole[:-1], whole[:8], whole[1:], whole + "x", whole.swapcase(), DOOR.token):
        refused = refusal(DOOR, scope(f"{DOOR.cookie}={part}"))
        assert refused is not None and refused[0] == 403, part
    for cookie in (None, "", DOOR.cookie, f"roomfit-8322={whole}", f"x={whole}", whole):
        refused = refusal(DOOR, scope(cookie))
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


def test_a_piece_of_work_that_fails_is_no_work_that_is_done(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Three ends, told apart: an answer, what a task says of its input, and an interruption."""

    class Worker:
        async def ask(self, task: str, _: object, *, progress: Any) -> str:
            progress(0.4)
            if task == "fail":
                raise InputError("the room has no faces")
            if task == "wait":
                await asyncio.sleep(60)
            return "found"

        async def stop(self) -> None:
            pass

    monkeypatch.setattr(jobs_module, "Worker", Worker)

    async def whole() -> list[jobs_module.Job]:
        jobs = Jobs()
        made = [jobs.add(name, name, {}) for name in ("fail", "answer", "wait")]
        while made[2].fraction < 0.4:
            await asyncio.sleep(0.001)
        await jobs.cancel(made[2])
        return made

    failed, done, cancelled = asyncio.run(whole())
    assert (failed.state, failed.answer, failed.fraction) == ("failed", None, 0.4)
    assert "the room has no faces" in failed.error
    assert (done.state, done.answer, done.fraction, done.error) == ("done", "found", 1.0, "")
    assert (cancelled.state, cancelled.answer, cancelled.fraction) == ("cancelled", None, 0.4)


def test_work_finds_a_process_that_has_begun_and_none_is_left_at_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One ahead of each piece of work, a new one only when all is done, and never two."""
    said: list[str] = []

    class Worker:
        def __init__(self) -> None:
            self.name = f"{len([s for s in said if s.startswith('new')]) + 1}"
            said.append(f"new {self.name}")

        async def initialise(self) -> None:
            said.append(f"begun {self.name}")

        async def ask(self, task: str, *_: object, **__: object) -> None:
            said.append(f"{task} by {self.name}")

        async def stop(self) -> None:
            said.append(f"end {self.name}")

    monkeypatch.setattr(jobs_module, "Worker", Worker)

    async def whole() -> None:
        jobs = Jobs()
        jobs.prepare()
        jobs.prepare()
        await asyncio.sleep(0)
        for names in (("a", "b"), ("c",)):
            for name in names:
                jobs.add(name, name, {})
            for _ in range(20):
                await asyncio.sleep(0)
        await jobs.stop()

    asyncio.run(whole())
    assert said == [
        *("new 1", "begun 1", "a by 1", "end 1", "new 2", "b by 2", "end 2"),
        *("new 3", "begun 3", "c by 3", "end 3", "new 4", "begun 4", "end 4"),
    ]


def test_what_reads_begins_before_the_page_is_imported_and_ends_with_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Its imports take as long as the page's; without the page's packages nothing is left."""
    said: list[str] = []

    class Worker:
        def __init__(self, most_mib: int) -> None:
            self.name = "reader" if most_mib else "other"

        async def started(self) -> None:
            said.append(f"{self.name} started")

        async def stop(self) -> None:
            said.append(f"{self.name} stopped")

    async def serve(bench: jobs_module.Bench, **_: object) -> None:
        said.append(f"page of {bench.folder.name}")

    monkeypatch.setattr(jobs_module, "Worker", Worker)
    options = Namespace(folder=tmp_path, host="127.0.0.1", port=0, no_browser=True)
    monkeypatch.setitem(sys.modules, "roomfit.app.server", SimpleNamespace(serve=serve))
    run(options)
    monkeypatch.setitem(sys.modules, "roomfit.app.server", None)
    with pytest.raises(InputError, match="the extra app"):
        run(options)
    page, ends = f"page of {tmp_path.name}", "reader stopped"
    assert said == ["reader started", page, ends, "reader started", ends]


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
