"""Who may speak to the page: the browser of the user who started it, and nobody else.

A page on the user's own machine can be reached by every other page that the user's browser shows,
and by every user of the machine. So each request must name this server in ``Host`` (a foreign name
that leads here is DNS rebinding), come from no foreign ``Origin``, and be below the random key that
the address begins with: there is no cookie, which browsers send to every port of a machine. Bodies
end at a limit, whatever they declare.
"""

from __future__ import annotations

import ipaddress
import json
import secrets
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from contextlib import suppress
from typing import Any

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]

_BODY_BYTES = 2**20  # of every request but an upload
_LOCAL = ("127.0.0.1", "localhost", "[::1]")
# NiceGUI evaluates what the server sends, and Vue compiles templates in the browser: script-src
# cannot do without the word in quotes. Inline scripts carry a nonce, another in every answer.
_POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; media-src 'self'; font-src 'self' data:; connect-src 'self'; "
    "frame-src 'self'; frame-ancestors 'self'; form-action 'none'; base-uri 'none'"
)
_HEADERS = {
    "content-security-policy": _POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "permissions-policy": "microphone=(self), camera=(), geolocation=()",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "x-frame-options": "SAMEORIGIN",
}
_TOO_LARGE = "larger than what is taken"


class Door:
    """Who is let in: whoever knows the key in the address."""

    def __init__(self, host: str, port: int, upload_bytes: int, names: Iterable[str] = ()) -> None:
        self.base = f"/{secrets.token_urlsafe(32)}"  # of the path of every request
        self.port, self.upload_bytes = port, upload_bytes
        # any address in numbers is one of this server's: it listens at all of them
        self.any_address = host in ("0.0.0.0", "::")
        known = {*_LOCAL} if self.any_address or host in (*_LOCAL, "::1") else set()
        if host not in (*_LOCAL, "::1"):
            known |= {host, *names}
        self.names = frozenset(name.lower() for name in known)

    def is_own_host(self, host: str) -> bool:
        """Whether a ``Host`` is this server: its name, and its port.

        Starlette's ``TrustedHostMiddleware`` looks at no port, at the first of two hosts alone, and
        knows names only, not every address in numbers of a server that listens at all of them.
        """
        name, mark, port = host.rpartition(":")
        if not mark or port != str(self.port):
            return False
        is_own = name.lower() in self.names
        if self.any_address and not is_own:  # an address in numbers cannot be rebound
            with suppress(ValueError):
                is_own = bool(ipaddress.ip_address(name.strip("[]")))
        return is_own

    def is_own_origin(self, origin: str) -> bool:
        """Whether an ``Origin`` is a page of this server; "null" is none."""
        scheme, _, host = origin.partition("://")
        return scheme == "http" and self.is_own_host(host)

    def refusal(self, scope: Scope) -> tuple[int, str] | None:
        """Return status and reason with which a request is refused, None where it is let in."""
        hosts = _values(scope, b"host")
        if len(hosts) != 1 or not self.is_own_host(hosts[0]):
            return 400, "this server has another name"
        if not all(map(self.is_own_origin, _values(scope, b"origin"))):
            return 403, "a page of another origin has no business here"
        begin = str(scope["path"])[: len(self.base) + 1].encode()
        if not secrets.compare_digest(begin, f"{self.base}/".encode()):
            return 403, "open the address that `roomfit app` has printed: it holds the key"
        length = _values(scope, b"content-length")
        if any(not n.isascii() or not n.isdigit() or len(n) > 18 for n in length):
            return 400, "the length of the body is no number"
        if any(int(n) > self.limit_bytes(scope) for n in length):
            return 413, _TOO_LARGE
        return None

    def inside(self, scope: Scope) -> Scope:
        """Return a request that was let in as the application sees it, with the key as a prefix."""
        # nothing is compressed: the page is to be read here, and the way is short
        dropped = (b"accept-encoding", b"x-forwarded-prefix")
        headers = [(k, v) for k, v in scope["headers"] if k not in dropped]
        path = str(scope["path"])[len(self.base) :]
        own = [*headers, (b"x-forwarded-prefix", self.base.encode())]
        return {**scope, "path": path, "raw_path": path.encode(), "headers": own}

    def limit_bytes(self, scope: Scope) -> int:
        """Return how long a body may be."""
        place = f"{self.base}/upload/"
        return self.upload_bytes if str(scope["path"]).startswith(place) else _BODY_BYTES


def _values(scope: Scope, name: bytes) -> list[str]:
    return [value.decode("latin-1") for key, value in scope["headers"] if key == name]


class Guard:
    """An application that lets in whom its door lets in."""

    def __init__(self, app: Application, door: Door) -> None:
        self.app = app
        self.door = door

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            return await self.app(scope, receive, send)
        refused = self.door.refusal(scope)
        if refused is not None:
            return await _refuse(scope, send, *refused)
        inside = self.door.inside(scope)
        if scope["type"] == "websocket":
            return await self.app(inside, receive, send)
        exchange = _Exchange(self.door.limit_bytes(scope), receive, send)
        try:
            await self.app(inside, exchange.receive, exchange.send)
        except Exception:
            if not exchange.is_over:  # else it is the consequence
                raise
        return None


class _Exchange:
    """A request whose body is counted, for one in chunks declares no length, and its answer."""

    def __init__(self, most_bytes: int, receive: Receive, send: Send) -> None:
        self._left_bytes, self._receive, self._send = most_bytes, receive, send
        self.is_over = self._has_started = False
        self._page: list[bytes] = []
        self._start: Message | None = None  # of a page, which waits for its body

    async def receive(self) -> Message:
        message = await self._receive()
        self._left_bytes -= len(message.get("body", b""))
        if self._left_bytes >= 0:
            return message
        if not self.is_over and not self._has_started:
            end = {"connection": "close"}
            await _answer(self._send, 413, f"{_TOO_LARGE}\n".encode(), end)
        self.is_over = True
        return {"type": "http.disconnect"}

    async def send(self, message: Message) -> None:
        """Send an answer, sealed by headers; a page as a whole, with a nonce in its scripts."""
        if self.is_over:
            return
        if message["type"] == "http.response.start":
            self._has_started = True
            own = {k.decode(): v.decode("latin-1") for k, v in message["headers"]}
            # a file may be more strictly sealed than the page
            seals = {k: own.get(k, v) for k, v in _HEADERS.items()}
            if "sandbox" in seals["content-security-policy"]:
                del seals["cross-origin-opener-policy"]  # browsers show only one of the two
            named = [(k, v) for k, v in message["headers"] if k.decode() not in _HEADERS]
            message["headers"] = [*named, *_encoded(seals)]
            if own.get("x-nicegui-content") == "page":
                self._start = message
                return
        elif self._start is not None:
            self._page.append(message.get("body", b""))
            if message.get("more_body", False):
                return
            start, body = with_nonce(self._start, b"".join(self._page))
            await self._send(start)
            message = {"type": "http.response.body", "body": body}
        await self._send(message)


def with_nonce(start: Message, body: bytes) -> tuple[Message, bytes]:
    """Return a page whose scripts carry a nonce that its policy names.

    What others have written comes into the page only with its angle brackets escaped
    (`HTML_ESCAPE_TABLE` of NiceGUI): every tag of a script is one of NiceGUI's template.
    """
    nonce = secrets.token_urlsafe(18)
    body = body.replace(b"<script", f'<script nonce="{nonce}"'.encode())
    headers = dict(start["headers"])
    policy = headers[b"content-security-policy"]
    own = policy.replace(b"script-src 'self'", f"script-src 'self' 'nonce-{nonce}'".encode())
    headers |= {b"content-security-policy": own, b"content-length": str(len(body)).encode()}
    return {**start, "headers": list(headers.items())}, body


async def _refuse(scope: Scope, send: Send, status: int, why: str) -> None:
    if scope["type"] == "http":
        # a stranger's body is not waited for; the user's browser sends all of it before it reads
        end = {} if status == 413 else {"connection": "close"}
        await _answer(send, status, f"{why}\n".encode(), end)
    elif "websocket.http.response" in scope.get("extensions", {}):
        kind = "websocket.http.response"
        await send({"type": f"{kind}.start", "status": status, "headers": []})
        await send({"type": f"{kind}.body", "body": json.dumps(why).encode()})
    else:
        await send({"type": "websocket.close", "code": 1008, "reason": why})


async def _answer(send: Send, status: int, body: bytes, headers: dict[str, str]) -> None:
    length = {"content-type": "text/plain; charset=utf-8", "content-length": str(len(body))}
    own = {**_HEADERS, "cache-control": "no-store", **length, **headers}
    await send({"type": "http.response.start", "status": status, "headers": _encoded(own)})
    await send({"type": "http.response.body", "body": body})


def _encoded(headers: dict[str, str]) -> list[tuple[bytes, bytes]]:
    return [(k.encode(), v.encode("latin-1")) for k, v in headers.items()]
