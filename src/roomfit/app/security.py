"""Who may speak to the page: the browser of the user who started it, and nobody else.

A page on the user's own machine can be reached by every other page that the user's browser shows,
and by every user of the machine. So each request must name this server in ``Host`` (a foreign name
that leads here is DNS rebinding), come from no foreign ``Origin``, and carry a cookie that only the
address with the random token gives. Bodies end at a limit, whatever they declare.
"""

from __future__ import annotations

import ipaddress
import json
import secrets
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlencode

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]

BODY_BYTES = 2**20
"""Of every request but an upload."""

# NiceGUI evaluates what the server sends, and Vue compiles templates in the browser: script-src
# cannot do without the word in quotes. Inline scripts carry a nonce, another in every answer.
POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self' 'unsafe-eval'",
        "style-src 'self' 'unsafe-inline'",
        "img-src 'self' data: blob:",
        "media-src 'self'",
        "font-src 'self' data:",
        "connect-src 'self'",
        "frame-src 'self'",
        "frame-ancestors 'self'",
        "form-action 'none'",
        "base-uri 'none'",
    )
)
_HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "permissions-policy": "microphone=(self), camera=(), geolocation=()",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "x-frame-options": "SAMEORIGIN",
}


@dataclass(frozen=True, slots=True)
class Door:
    """Who is let in."""

    token: str
    """Of the address; whoever has it gets the cookie."""
    session: str
    """Of the cookie."""
    port: int
    names: frozenset[str]
    """Host names of this server without port, lower case."""
    any_address: bool = False
    """Any address in numbers is one of this server's: it listens at all of them."""
    upload_bytes: int = 2**30

    @property
    def cookie(self) -> str:
        """Cookies know no ports: two workbenches must not take each other's."""
        return f"roomfit-{self.port}"


def new_door(host: str, port: int, upload_bytes: int, names: Iterable[str] = ()) -> Door:
    """Return a door with a new token."""
    is_local = host in ("127.0.0.1", "localhost", "::1")
    known = {"127.0.0.1", "localhost", "[::1]"} if is_local else {host, *names}
    every = host in ("0.0.0.0", "::")
    local = {"127.0.0.1", "localhost", "[::1]"} if every else set()
    return Door(
        secrets.token_urlsafe(32),
        secrets.token_urlsafe(32),
        port,
        frozenset(name.lower() for name in known | local),
        every,
        upload_bytes,
    )


def is_own_host(door: Door, host: str) -> bool:
    """Whether a ``Host`` is this server: its name, and its port.

    Starlette's ``TrustedHostMiddleware`` looks at no port, at the first of two hosts alone, and
    knows names only, not every address in numbers of a server that listens at all of them.
    """
    name, mark, port = host.rpartition(":")
    if not mark or port != str(door.port):
        return False
    if name.lower() in door.names:
        return True
    if not door.any_address:
        return False
    try:  # an address in numbers cannot be rebound
        ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return False
    return True


def is_own_origin(door: Door, origin: str) -> bool:
    """Whether an ``Origin`` is a page of this server; "null" is none."""
    scheme, _, host = origin.partition("://")
    return scheme == "http" and is_own_host(door, host)


def refusal(door: Door, scope: Scope) -> tuple[int, str] | None:
    """Return status and reason with which a request is refused, None where it is let in."""
    hosts = _values(scope, b"host")
    if len(hosts) != 1 or not is_own_host(door, hosts[0]):
        return 400, "this server has another name"
    if any(not is_own_origin(door, origin) for origin in _values(scope, b"origin")):
        return 403, "a page of another origin has no business here"
    if not _has_cookie(door, scope):
        return 403, "open the address that `roomfit app` has printed: it holds the key"
    length = _values(scope, b"content-length")
    if any(not n.isascii() or not n.isdigit() or len(n) > 18 for n in length):
        return 400, "the length of the body is no number"
    if any(int(n) > _limit_bytes(door, scope) for n in length):
        return 413, "larger than what is taken"
    return None


def _limit_bytes(door: Door, scope: Scope) -> int:
    return door.upload_bytes if str(scope["path"]).startswith("/upload/") else BODY_BYTES


def _values(scope: Scope, name: bytes) -> list[str]:
    return [value.decode("latin-1") for key, value in scope["headers"] if key == name]


def _has_cookie(door: Door, scope: Scope) -> bool:
    for text in _values(scope, b"cookie"):
        try:
            own = SimpleCookie(text).get(door.cookie)
        except CookieError:
            continue
        if own is not None and _same(own.value, door.session):
            return True
    return False


def _same(found: str, wanted: str) -> bool:
    return secrets.compare_digest(found.encode(), wanted.encode())


def _with_key(door: Door, scope: Scope) -> bool:
    if scope["type"] != "http" or scope["path"] != "/" or scope["method"] != "GET":
        return False
    tokens = parse_qs(scope["query_string"].decode("latin-1")).get("token", [])
    return len(tokens) == 1 and _same(tokens[0], door.token)


class Guard:
    """An application that lets in whom its door lets in."""

    def __init__(self, app: Application, door: Door) -> None:
        self.app = app
        self.door = door

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            return await self.app(scope, receive, send)
        refused = refusal(self.door, scope)
        if refused is not None and refused[0] == 403 and _with_key(self.door, scope):
            origins = _values(scope, b"origin")
            if all(is_own_origin(self.door, origin) for origin in origins):
                return await self._give_cookie(scope, send)
        if refused is not None:
            return await _refuse(scope, send, *refused)
        if scope["type"] == "websocket":
            return await self.app(scope, receive, send)
        # nothing is compressed: the page is to be read here, and the way is short
        plain = [(k, v) for k, v in scope["headers"] if k != b"accept-encoding"]
        await self._counted({**scope, "headers": plain}, receive, send)
        return None

    async def _give_cookie(self, scope: Scope, send: Send) -> None:
        given = parse_qs(scope["query_string"].decode("latin-1"))
        rest = urlencode({k: v for k, v in given.items() if k != "token"}, doseq=True)
        cookie = f"{self.door.cookie}={self.door.session}; Path=/; HttpOnly; SameSite=Strict"
        headers = {"location": "/" + (f"?{rest}" if rest else ""), "set-cookie": cookie}
        await _answer(send, 303, b"", headers)

    async def _counted(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, its body counted, for one in chunks declares no length."""
        most, taken, started, over = _limit_bytes(self.door, scope), 0, False, False

        async def counted() -> MutableMapping[str, Any]:
            nonlocal taken, over
            message = await receive()
            taken += len(message.get("body", b""))
            if taken <= most:
                return message
            if not over and not started:
                await _answer(send, 413, b"larger than what is taken\n", {"connection": "close"})
            over = True
            return {"type": "http.disconnect"}

        page: list[bytes] = []
        waiting: list[MutableMapping[str, Any]] = []

        async def sealed(message: MutableMapping[str, Any]) -> None:
            nonlocal started
            if over:
                return
            if message["type"] == "http.response.start":
                started = True
                named = [(k, v) for k, v in message["headers"] if k.decode() not in _HEADERS]
                own = {k.decode(): v.decode("latin-1") for k, v in message["headers"]}
                # a file may be more strictly sealed than the page
                sealing = {k: own.get(k, v) for k, v in _HEADERS.items()}
                if "sandbox" in sealing["content-security-policy"]:
                    del sealing["cross-origin-opener-policy"]  # browsers show only one of the two
                message["headers"] = [*named, *_encoded(sealing)]
                if own.get("x-nicegui-content") == "page":
                    waiting.append(message)
                    return
            elif waiting:
                page.append(message.get("body", b""))
                if message.get("more_body", False):
                    return
                start, body = with_nonce(waiting.pop(), b"".join(page))
                await send(start)
                message = {"type": "http.response.body", "body": body}
            await send(message)

        try:
            await self.app(scope, counted, sealed)
        except Exception:
            if not over:  # else it is the consequence
                raise


def with_nonce(
    start: MutableMapping[str, Any], body: bytes
) -> tuple[MutableMapping[str, Any], bytes]:
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
        return await _answer(send, status, f"{why}\n".encode(), end)
    if "websocket.http.response" not in scope.get("extensions", {}):
        await send({"type": "websocket.close", "code": 1008, "reason": why})
        return None
    kind = "websocket.http.response"
    await send({"type": f"{kind}.start", "status": status, "headers": []})
    await send({"type": f"{kind}.body", "body": json.dumps(why).encode()})
    return None


async def _answer(send: Send, status: int, body: bytes, headers: dict[str, str]) -> None:
    length = {"content-type": "text/plain; charset=utf-8", "content-length": str(len(body))}
    own = {**_HEADERS, "cache-control": "no-store", **length, **headers}
    await send({"type": "http.response.start", "status": status, "headers": _encoded(own)})
    await send({"type": "http.response.body", "body": body})


def _encoded(headers: dict[str, str]) -> list[tuple[bytes, bytes]]:
    return [(k.encode(), v.encode("latin-1")) for k, v in headers.items()]
