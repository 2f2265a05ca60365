"""Nobody gets in: what strangers may try, each with a real client against a running server."""

from __future__ import annotations

import contextlib
import http.client
import io
import re
import socket
import struct
import time
import zipfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import soundfile

pytest.importorskip("nicegui", reason="the workbench needs the extra app")

from roomfit.app.security import Door
from workbench import Running, running

pytestmark = pytest.mark.slow


@cache  # soundfile writes the time into the file
def sound() -> bytes:
    """Return a decay in noise as a WAV file."""
    rng, file = np.random.default_rng(1), io.BytesIO()
    decay = np.exp(-np.arange(24_000) / 4000.0) * rng.normal(size=24_000)
    soundfile.write(file, 0.1 * decay, 48_000, format="WAV", subtype="FLOAT")
    return file.getvalue()


def archive() -> bytes:
    """Return a thousand kilobytes of zeros, zipped, under a name that leads elsewhere."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as inside:
        inside.writestr("../../evil.wav", b"\0" * 10**6)
    return file.getvalue()


def entities() -> bytes:
    """Return a workbook whose sheet unfolds to a hundred megabytes of text."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as inside:
        entity = b'<!DOCTYPE a [<!ENTITY b "' + b"x" * 10_000 + b'">]>'
        inside.writestr("xl/workbook.xml", entity + b"<a>" + b"&b;" * 10_000 + b"</a>")
    return file.getvalue()


def hostile_files() -> dict[str, bytes]:
    """Return files by name, each not what it says it is."""
    whole = sound()
    of_data = whole.index(b"data") + 4
    triangle = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"
    return {
        "recordings/lies.wav": whole[:of_data]
        + struct.pack("<I", 2**31 - 1)
        + whole[of_data + 4 :],
        "recordings/ends.wav": whole[: len(whole) // 2],
        "recordings/rate.wav": whole.replace(struct.pack("<I", 48_000), struct.pack("<I", 0), 1),
        "recordings/channels.wav": whole[:22] + struct.pack("<H", 65_535) + whole[24:],
        "recordings/none.wav": b"",
        "recordings/archive.wav": archive(),
        "room/many.stl": b"\0" * 80 + struct.pack("<I", 2**32 - 1),
        "room/deep.glb": b"glTF" + struct.pack("<II", 2, 2**31),
        "room/wide.obj": triangle + b"f " + b"1 2 3 " * 200_000,
        "room/faces.obj": triangle + b"f 1 2 3\n" * 350_000,
        "room/huge.ply": b"ply\nformat ascii 1.0\nelement vertex 99999999999\nend_header\n",
        "room/far.obj": b"v 1e308 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        "room/lol.dae": b'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "'
        + b"x" * 10_000
        + b'">]><COLLADA>'
        + b"&b;" * 10_000
        + b"</COLLADA>",
        "room/archive.ifc": archive(),
        "positions/archive.xlsx": archive(),
        "positions/lol.xlsx": entities(),
        "positions/none.csv": b"",
        "positions/wide.csv": b"name,x,y,z\nLS1," + b"1" * 200_000 + b",1,1\n",
        "positions/program.csv": b"\x7fELF\0\0\0\0",
        "decay-times/lies.csv": b"place;500\nA;1e308\n",
    }


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    folder = tmp_path_factory.mktemp("project")
    (folder.parent / "secret.wav").write_bytes(b"outside")
    (folder / "result").mkdir()
    (folder / "result" / "report.html").write_text("<p>report")
    (folder / "result" / "link.html").symlink_to("/etc/hostname")
    with running(folder, limits="file_bytes=3e6") as one:
        yield one


def test_without_the_key_nothing_is_shown(server: Running) -> None:
    for path in ("/", "/files/result/report.html", "/_nicegui_ws/socket.io/?EIO=4", "/any"):
        for before in ("", "/", "/wrong", f"/{server.key[:-1]}", f"/{server.key}x", "/.."):
            assert server.get(before + path, key=False).status == 403
    assert server.get(f"/?token={server.key}", key=False).status == 403
    assert server.get(f"/x/..%2F{server.key}/", key=False).status == 403
    assert server.put("/upload/room/a.obj", b"v 0 0 0", key=False).status == 403


def test_no_other_port_of_the_machine_gets_the_key(server: Running) -> None:
    """Another user listens there: no cookie goes to it, and no page says where one came from."""
    for path in ("/", "/files/result/report.html", "/sweeps", "/any"):
        headers = server.get(path).headers
        assert "set-cookie" not in headers and headers["referrer-policy"] == "no-referrer"
    page = server.get("/").body.decode()
    assert "cookie" not in page.lower()
    for address in re.findall(r'(?:src|href)="(/[^"]+)"', page):
        assert server.get(address, key=False).status == 200 and server.key in address


def test_the_key_is_no_argument_of_the_browser(tmp_path: Path) -> None:
    """Another user sees all arguments: of a file that the user alone can read, which goes again."""
    said, browser = tmp_path / "said", tmp_path / "browser"
    browser.write_text(
        f'#!/bin/sh\nstat -c %a "${{1#file://}}" > {said}.new\n'
        f'echo "$1" >> {said}.new\ncat "${{1#file://}}" >> {said}.new\n'
        f"mv {said}.new {said}\n"
    )
    browser.chmod(0o700)
    with running(tmp_path / "project", browser=f"{browser} %s") as own:
        end = time.monotonic() + 20.0
        while not said.exists() and time.monotonic() < end:
            time.sleep(0.05)
        mode, argument, content = said.read_text().split("\n", 2)
        assert mode == "600" and own.key not in argument and own.address in content
        assert Path(argument.removeprefix("file://")).exists()
    assert not Path(argument.removeprefix("file://")).exists()


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:{port}", "127.0.0.1:1", "127.0.0.1.evil.example:{port}"]
)
def test_a_foreign_host_gets_400_even_with_the_key(server: Running, host: str) -> None:
    assert server.get("/", {"Host": host.format(port=server.port)}).status == 400


def test_two_hosts_or_none_get_400(server: Running) -> None:
    for hosts in ("", f"Host: 127.0.0.1:{server.port}\r\nHost: evil.example\r\n"):
        with socket.create_connection(("127.0.0.1", server.port), timeout=10) as own:
            own.sendall(f"GET /{server.key}/ HTTP/1.1\r\n{hosts}\r\n".encode())
            assert b" 400 " in own.recv(100)


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://127.0.0.1:{port}", "http://127.0.0.1:1"]
)
def test_a_foreign_origin_is_refused(server: Running, origin: str) -> None:
    own = {"Origin": origin.format(port=server.port)}
    assert server.get("/", own).status == 403
    assert server.put("/upload/room/a.obj", b"v 0 0 0", own).status == 403
    assert server.websocket(own) == 403


def test_a_websocket_needs_host_origin_and_key(server: Running) -> None:
    assert server.websocket({"Origin": f"http://127.0.0.1:{server.port}"}) == 101
    assert server.websocket({"Host": f"evil.example:{server.port}"}) == 400
    assert server.websocket({}, key=False) == 403


def test_an_upload_that_declares_too_much_gets_413_and_leaves_nothing(server: Running) -> None:
    answer = server.put("/upload/room/big.obj", b"", {"Content-Length": "3000001"})
    assert answer.status == 413
    assert server.put("/", b"x" * (2**20 + 1)).status == 413  # elsewhere the limit is 1 MiB
    assert server.put("/upload/room/a.obj", b"", {"Content-Length": "-1"}).status == 400
    assert not list(server.folder.glob("*.obj"))


def test_an_upload_in_chunks_ends_at_the_limit(server: Running) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=20)
    chunks = (b"v 0 0 0\n" * 10_000 for _ in range(60))  # 4.8 MB
    try:
        connection.request(
            "PUT",
            f"/{server.key}/upload/room/chunked.obj",
            chunks,
            encode_chunked=True,
        )
        assert connection.getresponse().status == 413
    except (BrokenPipeError, ConnectionResetError):
        pass  # the server closed before all was sent
    end = time.monotonic() + 20.0
    while server.leftovers() and time.monotonic() < end:
        time.sleep(0.05)  # the guard answers before the part that came is removed
    assert not list(server.folder.glob("*chunked*")) and not server.leftovers()


def test_a_whole_upload_arrives(server: Running) -> None:
    assert server.put("/upload/recordings/LS1_MP1.wav", sound()).status == 200
    assert (server.folder / "recordings" / "LS1_MP1.wav").read_bytes() == sound()
    assert not server.leftovers()


@pytest.mark.parametrize("name", hostile_files())
def test_a_file_that_is_not_what_it_says_is_refused_and_not_kept(
    server: Running, name: str
) -> None:
    """In words, within the time of a look; the server goes on, and no file is left."""
    began = time.monotonic()
    answer = server.put(f"/upload/{name}", hostile_files()[name])
    assert answer.status == 400 and len(answer.body) > 20, answer.body
    assert time.monotonic() - began < 60.0
    assert b".roomfit-upload" not in answer.body and b"Traceback" not in answer.body
    assert not list(server.folder.rglob(Path(name).name)) and not server.leftovers()
    assert server.get("/").status == 200


@pytest.mark.parametrize(
    "path",
    [
        *("/upload/room/..%2F..%2Fsecret.obj", "/upload/recordings/..%2Fa.wav"),
        *("/upload/room/%2Fetc%2Fa.obj", "/upload/room/..%5Ca.obj", "/upload/room/.hidden.obj"),
        *("/upload/room/a.obj%00.wav", "/upload/room/a.toml", "/upload/room/campaign.toml"),
        *("/upload/room/a.zip", "/upload/room/a", "/upload/elsewhere/a.wav"),
        *("/upload/room/a.obj.zip", "/upload/recordings/a.wav%2F..%2Fb.wav", "/upload/dry/a.zip"),
        *("/upload/positions/a.wav", "/upload/positions/..%2Fa.csv", "/upload/decay-times/a.zip"),
        *("/upload/recordings/a.html", "/upload/recordings/a.py", f"/upload/room/{'a' * 300}.obj"),
    ],
)
def test_names_that_lead_elsewhere_or_are_no_room_are_refused(server: Running, path: str) -> None:
    before = sorted(p for p in server.folder.parent.rglob("*"))
    assert server.put(path, b"x").status in (400, 404, 405)
    assert sorted(p for p in server.folder.parent.rglob("*")) == before


ASKED = "rate_hz=48000&seconds=1&silence_s=0.5&repetitions=1&source=LS7&receiver=MP7&again=false"


@pytest.mark.parametrize(
    ("word", "other"),
    [
        ("source=LS7", "source=..%2FLS7"),
        ("receiver=MP7", "receiver=%00"),
        ("source=LS7", "source=.x"),
        ("seconds=1", "seconds=1e9"),
        ("seconds=1", "seconds=nan"),
        ("rate_hz=48000", "rate_hz=1e308"),
        ("repetitions=1", "repetitions=inf"),
        ("&again=false", ""),
    ],
)
def test_a_measurement_that_leads_elsewhere_or_is_endless_is_refused(
    server: Running, word: str, other: str
) -> None:
    before = sorted(server.folder.parent.rglob("*"))
    asked = ASKED.replace(word, other)
    assert server.get(f"/sweeps?{asked}").status == 400
    assert server.put(f"/upload/measured?{asked}", b"x" * 400).status == 400
    assert sorted(server.folder.parent.rglob("*")) == before


def test_a_measurement_needs_the_key_and_leaves_nothing_where_it_is_of_no_use(
    server: Running,
) -> None:
    assert server.get(f"/sweeps?{ASKED}", key=False).status == 403
    assert server.put(f"/upload/measured?{ASKED}", b"", key=False).status == 403
    foreign = {"Origin": "http://evil.example"}
    assert server.put(f"/upload/measured?{ASKED}", b"", foreign).status == 403
    played = server.get(f"/sweeps?{ASKED}").body
    assert len(played) == 4 * 48_000 * 4
    noise = np.random.default_rng(1).normal(size=192_000).astype("<f4")
    too_much = np.full(192_000, np.nan, "<f4")
    for body in (b"", played[:-40], bytes(len(played)), noise.tobytes(), too_much.tobytes()):
        answer = server.put(f"/upload/measured?{ASKED}", body)
        assert answer.status == 400 and len(answer.body) > 20, answer.body
        assert b".roomfit-upload" not in answer.body and b"Traceback" not in answer.body
        assert not list(server.folder.rglob("LS7*")) and not server.leftovers()
    over = {"Content-Length": "3000001"}
    assert server.put(f"/upload/measured?{ASKED}", b"", over).status == 413


def test_links_lead_nowhere(server: Running) -> None:
    outside = server.folder.parent / "secret.wav"
    places = server.folder / "recordings"
    places.mkdir(exist_ok=True)
    (places / "linked.wav").symlink_to(outside)
    assert server.put("/upload/recordings/linked.wav", b"x").status == 400
    (places / "linked.wav").unlink()
    kept = places.rename(server.folder / "kept")
    places.symlink_to(server.folder.parent)
    assert server.put("/upload/recordings/new.wav", b"x").status == 400
    places.unlink()
    kept.rename(places)
    assert outside.read_bytes() == b"outside" and not (outside.parent / "new.wav").exists()
    assert server.get("/files/result/link.html").status == 404


@pytest.mark.parametrize(
    "path",
    [
        *(
            "/files/campaign.toml",
            "/files/.roomfit-undo.json",
            "/files/../secret.wav",
            "/files/..%2Fsecret.wav",
        ),
        *("/files/result/..%2F..%2Fsecret.wav", "/files/%2Fetc%2Fpasswd", "/files/result/.x"),
        *("/files/result", "/files/result/link.html", "/files/result/%00"),
    ],
)
def test_only_results_and_exports_are_shown(server: Running, path: str) -> None:
    assert server.get(path).status == 404


def test_a_report_runs_nothing_and_the_page_only_its_own(server: Running) -> None:
    report = server.get("/files/result/report.html")
    assert report.status == 200 and "sandbox" in report.headers["content-security-policy"]
    assert "script-src" not in report.headers["content-security-policy"]
    page = server.get("/")
    policy = page.headers["content-security-policy"]
    nonce = re.search(r"'nonce-([\w-]{24})'", policy)
    assert nonce is not None and "unsafe-inline" not in policy.split("; ")[1]
    tags = re.findall(r"<script[^>]*>", page.body.decode())
    assert tags and all(f'nonce="{nonce[1]}"' in tag for tag in tags)
    assert nonce[1] not in server.get("/").headers["content-security-policy"]  # each page its own
    assert "default-src 'none'" in policy and "connect-src 'self'" in policy
    assert page.headers["x-content-type-options"] == "nosniff"
    assert "microphone=(self)" in page.headers["permissions-policy"]
    assert page.headers["cross-origin-resource-policy"] == "same-origin"
    assert "access-control-allow-origin" not in page.headers


def test_it_listens_on_this_machine_only(server: Running) -> None:
    own = {line.split()[1] for line in Path("/proc/net/tcp").read_text().splitlines()[1:]}
    mine = [a for a in own if int(a.split(":")[1], 16) == server.port]
    assert mine and all(a.startswith("0100007F") for a in mine)


def test_open_to_a_network_it_still_answers_to_no_foreign_name() -> None:
    """An address in numbers cannot be rebound, a name can."""
    door = Door("0.0.0.0", 8321, 1, ("desk",))
    assert all(door.is_own_host(h) for h in ("192.168.1.7:8321", "desk:8321", "[fe80::1]:8321"))
    wrong = ("evil.example:8321", "192.168.1.7:80", "192.168.1.7.evil.example:8321", "desk", "")
    assert not any(door.is_own_host(h) for h in wrong)
    assert not Door("127.0.0.1", 8321, 1).is_own_host("192.168.1.7:8321")


def test_a_header_of_200_kilobytes_is_refused_and_the_page_goes_on(server: Running) -> None:
    """In one field, in many, and one that never ends; none reaches the application."""
    host = f"Host: 127.0.0.1:{server.port}\r\n"
    heads = (
        f"GET / HTTP/1.1\r\n{host}X: {'a' * 200_000}\r\n\r\n",
        f"GET / HTTP/1.1\r\n{host}"
        + "".join(f"X{n}: {'a' * 90}\r\n" for n in range(2000))
        + "\r\n",
        f"GET /{'a' * 200_000} HTTP/1.1\r\n{host}\r\n",
        f"GET / HTTP/1.1\r\n{host}X: {'a' * 200_000}",
    )
    for head in heads:
        with socket.create_connection(("127.0.0.1", server.port), timeout=10) as line:
            answer = b""
            try:
                line.sendall(head.encode())
                while part := line.recv(4096):
                    answer += part
            except ConnectionError:
                pass
        assert answer.startswith(b"HTTP/1.1 400") or not answer, answer[:200]
    with socket.create_connection(("127.0.0.1", server.port), timeout=10) as line:
        line.sendall(f"GET / HTTP/1.1\r\n{host}\r\n".encode())
        assert line.recv(4096).startswith(b"HTTP/1.1 403")


def test_connections_that_ask_nothing_keep_nobody_waiting_and_are_closed(tmp_path: Path) -> None:
    """200 that send no head, half of one, or half of a second one; letters buy no time."""
    with running(tmp_path, limits="request_s=2") as server:
        half = f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n".encode()
        began = (b"", half, half + b"\r\n" + half, half + b"X: a")
        lines = [socket.create_connection(("127.0.0.1", server.port)) for _ in range(200)]
        try:
            for number, line in enumerate(lines):
                line.sendall(began[number % 4])
            asked = time.monotonic()
            assert server.get("/").status == 200
            assert time.monotonic() - asked < 2.0, "it waited until others were closed"
            for _ in range(6):
                time.sleep(0.5)
                for line in (*lines[2::4], *lines[3::4]):
                    with contextlib.suppress(OSError):
                        line.sendall(b"a")
            for number, line in enumerate(lines):
                line.settimeout(10)
                answer = b""
                with contextlib.suppress(ConnectionError):
                    while part := line.recv(65536):
                        answer += part
                # the second kind asks once as a whole, without the key
                assert answer.startswith(b"HTTP/1.1 403") if number % 4 == 2 else not answer
            assert server.get("/").status == 200
        finally:
            for line in lines:
                line.close()


def test_the_body_of_a_refused_request_is_not_waited_for(tmp_path: Path) -> None:
    """One byte of a million has come, without the key: the answer ends the connection."""
    with running(tmp_path) as server:
        head = f"PUT /upload/x HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n"
        with socket.create_connection(("127.0.0.1", server.port), timeout=3) as line:
            line.sendall(f"{head}Content-Length: 1000000\r\n\r\na".encode())
            answer = b""
            with contextlib.suppress(ConnectionError):
                while part := line.recv(65536):
                    answer += part
        assert answer.startswith(b"HTTP/1.1 403")


def test_an_upload_under_way_ends_with_the_workbench(tmp_path: Path) -> None:
    """At once, without a traceback, and nothing of it is left."""
    address = "127.0.0.1"
    with (
        running(tmp_path / "project") as server,
        socket.create_connection((address, server.port), timeout=10) as own,
    ):
        head = f"PUT /{server.key}/upload/recordings/a.wav HTTP/1.1\r\n"
        host = f"Host: 127.0.0.1:{server.port}\r\nContent-Length: 100000\r\n\r\n"
        own.sendall((head + host).encode() + sound()[:1000])
        end = time.monotonic() + 20.0
        while not server.leftovers() and time.monotonic() < end:
            time.sleep(0.02)
        began = time.monotonic()
        code, said = server.ended()
        assert (code, said) == (130, "interrupted; nothing half-written was left behind\n")
        assert time.monotonic() - began < 2.0  # of which the reader's process takes one
    assert not server.leftovers()


def test_what_has_begun_in_time_may_take_longer(tmp_path: Path) -> None:
    """A slow upload, what is asked next after a pause, and the connection of the page."""
    with running(tmp_path, limits="request_s=1") as server:

        def slowly() -> Iterator[bytes]:
            for part in (sound()[:1000], sound()[1000:]):
                time.sleep(1.5)
                yield part

        connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=20)
        with contextlib.closing(connection):
            connection.request("PUT", f"/{server.key}/upload/recordings/slow.wav", slowly())
            answer = connection.getresponse()
            assert (answer.status, answer.will_close) == (200, False), answer.read()
            answer.read()
            time.sleep(1.5)
            connection.request("GET", f"/{server.key}/")
            assert connection.getresponse().status == 200
        assert (server.folder / "recordings" / "slow.wav").read_bytes() == sound()
        origin = {"Origin": f"http://127.0.0.1:{server.port}"}
        assert server.websocket(origin, after_s=1.5) == 101
