"""The server of the workbench: files in and out, the page, and the guard before all of it."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import secrets
import shutil
import socket
import sys
import tempfile
import webbrowser
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import asdict
from pathlib import Path

import h11
import uvicorn
from fastapi import FastAPI, Request
from nicegui import ui
from starlette.requests import ClientDisconnect
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
from uvicorn.protocols.http.h11_impl import H11Protocol

from roomfit.app import project
from roomfit.app.jobs import Bench
from roomfit.app.page import build_page
from roomfit.app.security import Door, Guard
from roomfit.base.door import limit
from roomfit.base.errors import InputError, RoomfitError
from roomfit.cli.terminal import say
from roomfit.files.responses import sweep

_SHOWN_AS_PAGE = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; sandbox"
_FIRST_PORT, _PORTS = 8321, 20
_HEADER_BYTES = 32 * 1024


def application(bench: Bench, door: Door) -> Guard:
    """Return the whole application behind its guard."""

    @asynccontextmanager
    async def living(_: FastAPI) -> AsyncIterator[None]:
        starting = asyncio.create_task(bench.start())
        yield
        starting.cancel()
        await bench.stop()

    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None, lifespan=living)

    @app.exception_handler(RoomfitError)
    async def refused(_: Request, error: Exception) -> Response:
        return PlainTextResponse(str(error), 400)

    @app.exception_handler(ClientDisconnect)  # or more than the limit, as the guard has answered
    async def ended(_: Request, __: Exception) -> Response:
        return PlainTextResponse("not whole", 400)

    @app.get("/sweeps")
    async def sweeps(request: Request) -> Response:
        """Give what is to be played, as 32-bit floating point numbers."""
        played = await asyncio.to_thread(sweep.excitation, _asked(bench.folder, request)[0])
        return Response(played.astype("<f4").tobytes(), media_type="application/octet-stream")

    @app.put("/upload/measured")
    async def measured(request: Request) -> Response:
        return JSONResponse(await _measure(bench, request))

    @app.put("/upload/{kind}/{name}")
    async def upload(kind: str, name: str, request: Request) -> Response:
        """Take a file: it comes to its place when it is whole and could be read."""
        place = project.upload_place(bench.folder, kind, name)
        async with _received(bench.folder, name, request) as file:
            await bench.ask("look_at_upload", kind=kind, file=f"{file.parent.name}/{name}")
            place.parent.mkdir(exist_ok=True)
            file.replace(place)
        return PlainTextResponse("taken")

    @app.get("/files/{path:path}")
    async def download(path: str, save: bool = False) -> Response:
        return _give(bench.folder, path, save)

    build_page(bench)
    ui.run_with(
        app,
        title="roomfit",
        dark=None,
        language="en-US",
        tailwind=False,
        show_welcome_message=False,
        reconnect_timeout=20.0,
    )
    return Guard(app, door)


@asynccontextmanager
async def _received(folder: Path, name: str, request: Request) -> AsyncIterator[Path]:
    """Give the file that a request brings, in a hidden folder that goes away."""
    waiting = folder / f".roomfit-upload-{secrets.token_hex(8)}"
    waiting.mkdir()
    try:
        with (waiting / name).open("xb") as stream:
            async for chunk in request.stream():
                await asyncio.to_thread(stream.write, chunk)
        yield waiting / name
    finally:
        shutil.rmtree(waiting, ignore_errors=True)


def _asked(folder: Path, request: Request) -> tuple[sweep.SweepPlan, str, str]:
    """Return what a page asks to measure: how, the source and the receiver."""
    asked = request.query_params
    try:
        rate_hz, seconds, silence_s = (float(asked[k]) for k in ("rate_hz", "seconds", "silence_s"))
        plan = sweep.SweepPlan(rate_hz, seconds, silence_s, int(asked["repetitions"]))
        source, receiver, again = asked["source"], asked["receiver"], asked["again"] == "true"
    except (KeyError, ValueError, OverflowError) as error:
        what, found = "a measurement is four numbers and two names", str(error)[:80]
        needed = "rate_hz, seconds, silence_s, repetitions, source and receiver"
        hint = "reload the page, and start the measurement from it"
        raise InputError(what, found=found, needed=needed, hint=hint) from None
    place = project.upload_place(folder, project.RECORDINGS, sweep.response_name(source, receiver))
    sweep.check_not_measured(place, again=again)
    return plan, source, receiver


async def _measure(bench: Bench, request: Request) -> dict[str, object]:
    """Take what a page has recorded; the response comes to the recordings, its quality back."""
    plan, source, receiver = _asked(bench.folder, request)
    name = sweep.response_name(source, receiver)
    place = bench.folder / project.RECORDINGS / name
    async with _received(bench.folder, "recorded", request) as recorded:
        file = recorded.with_name(name)
        own = {"file": f"{recorded.parent.name}/{name}", "plan": asdict(plan)}
        quality: dict[str, object] = await bench.ask("measure", **own)
        place.parent.mkdir(exist_ok=True)
        file.replace(place)
    try:
        project.name_measured(bench.folder, source, receiver)
    except InputError as error:  # the response is there all the same
        quality["not_named"] = f"The response is not in the campaign: {error.what}."
    return quality


def _give(folder: Path, path: str, save: bool) -> Response:
    """Return a file of a result or an export, to be shown or to be saved."""
    try:
        file = project.served_file(folder, path)
    except InputError as error:
        return PlainTextResponse(str(error), 404)
    # a result may be another's: its page runs nothing, whatever it holds
    headers = {"content-security-policy": _SHOWN_AS_PAGE, "cache-control": "no-store"}
    is_shown = file.suffix in (".html", ".svg", ".png", ".wav") and not save
    return FileResponse(file, filename=None if is_shown else file.name, headers=headers)


class _Punctual(H11Protocol):
    """Ends a connection whose next request does not come as a whole, or not at all, in time.

    uvicorn waits for ever for the first head of a connection and for the rest of a later one. Its
    other parser takes a header of any length.
    """

    _late: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._late = self.loop.call_later(limit("request_s"), transport.abort)

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        if self.conn.their_state is not h11.IDLE:
            self._on_time()
        elif self._late is None:  # once a head: a letter now and then buys no time
            self._late = self.loop.call_later(limit("request_s"), self.transport.abort)

    def connection_lost(self, exc: Exception | None) -> None:
        self._on_time()
        super().connection_lost(exc)

    def _on_time(self) -> None:
        if self._late is not None:
            self._late.cancel()
            self._late = None


async def serve(
    bench: Bench,
    *,
    host: str = "127.0.0.1",
    port: int | None = None,
    open_browser: bool = True,
) -> None:
    """Show a project in the browser until somebody interrupts."""
    folder = bench.folder
    if folder.exists() and not folder.is_dir():
        what, needed = "a project is a folder", "a folder, or a name that is free"
        hint = "name the folder in which the file lies"
        raise InputError(what, where=str(folder), found="a file", needed=needed, hint=hint)
    folder.mkdir(parents=True, exist_ok=True)
    listening = _socket(host, port)
    port = int(listening.getsockname()[1])
    door = Door(host, port, int(limit("file_bytes")), (socket.gethostname(),))
    shown = "127.0.0.1" if door.any_address else host
    address = f"http://{f'[{shown}]' if ':' in shown else shown}:{port}{door.base}/"
    config = uvicorn.Config(
        application(bench, door),
        log_level="warning",
        http=_Punctual,
        h11_max_incomplete_event_size=_HEADER_BYTES,
        access_log=False,
        server_header=False,
        date_header=False,
        proxy_headers=False,
        ws_max_size=2**20,
        timeout_graceful_shutdown=0,
    )
    say(f"The workbench of {folder} is at\n  {address}\nCtrl-C ends it.")
    sys.stdout.flush()
    with tempfile.TemporaryDirectory(prefix="roomfit-") as hidden:
        if open_browser:  # by a file that the user alone can read: others see a browser's arguments
            page = Path(hidden) / "roomfit.html"
            page.touch(0o600)
            page.write_text(f'<meta http-equiv="refresh" content="0; url={address}">', "ascii")
            with contextlib.suppress(webbrowser.Error):
                webbrowser.open(page.as_uri())
        server = uvicorn.Server(config)
        # nothing of requests that its end cuts off
        logging.getLogger("uvicorn.error").addFilter(lambda _: not server.should_exit)
        await server.serve(sockets=[listening])


def _socket(host: str, port: int | None) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    tried = range(_FIRST_PORT, _FIRST_PORT + _PORTS) if port is None else (port,)
    for one in tried:
        own = socket.socket(family, socket.SOCK_STREAM)
        own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            own.bind((host, one))
            own.listen(128)  # who comes before the server is up waits
            return own
        except OSError as error:
            own.close()
            why = error.strerror or str(error)
    what, needed = "the address cannot be listened at", "a free port of an address of this machine"
    where, hint = f"{host}, port {port}", "add --port 0, which takes a free one"
    raise InputError(what, where=where, found=why, needed=needed, hint=hint)
