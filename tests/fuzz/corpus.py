"""Files that once hung the program, ended it with a traceback or asked for gigabytes.

Each is made here, small where it can be; the key is ``what--name``, the name that of an example.
"""

from __future__ import annotations

import io
import json
import struct
import zipfile
import zlib
from functools import cache

import numpy as np
from examples import absorption, campaign, examples, glb, mat, npz, result, rew

from box_files import obj
from scans import scan, scan_json


def _constants() -> bytes:
    lines = [f"GLOBAL c{i} = c{i + 1} + c{i + 1}" for i in range(60)]
    return (
        examples()["box.geo"]
        .replace(b"GLOBAL", "\r\n".join([*lines, "GLOBAL c60 = 1e-20"]).encode() + b"\r\nGLOBAL")
        .replace(b"9 half 0 0", b"9 half+0*c0 0 0")
    )


def _nested_blocks() -> bytes:
    import ezdxf

    document = ezdxf.new("R12", units=6)
    for depth in range(18):
        block = document.blocks.new(f"B{depth}")
        for _ in range(10):
            block.add_blockref(f"B{depth + 1}", (0, 0))
    document.blocks.new("B18").add_3dface([(0, 0, 0), (1, 0, 0), (1, 1, 0)])
    document.modelspace().add_blockref("B0", (0, 0))
    stream = io.StringIO()
    document.write(stream)
    return stream.getvalue().encode()


def _mat_bomb(n_bytes: int = 10**8) -> bytes:
    """One array of int8 zeros, 8 times as much as float64."""

    def element(kind: int, data: bytes) -> bytes:
        return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)

    parts = element(6, struct.pack("<II", 6, 0)) + element(5, struct.pack("<ii", n_bytes, 1))
    parts += element(1, b"RIR") + element(1, b"\0" * n_bytes)
    packed = zlib.compress(element(14, parts))
    return mat(compressed=True)[:128] + struct.pack("<II", 15, len(packed)) + packed


def _mat_fields(n: int, length: int) -> bytes:
    """A structure of fields without content whose names have such a length."""

    def element(kind: int, data: bytes) -> bytes:
        return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)

    parts = element(6, struct.pack("<II", 2, 0)) + element(5, struct.pack("<ii", 1, 1))
    parts += element(1, b"RIR") + element(5, struct.pack("<i", length)) + element(1, b"a" * n)
    return mat(compressed=True)[:128] + element(14, parts + element(14, b"") * n)


def _npy(shape: str, dtype: str = "'<f8'", data: bytes = b"\0" * 8) -> bytes:
    head = f"{{'descr': {dtype}, 'fortran_order': False, 'shape': {shape}, }}"
    head = head + " " * (-(len(head) + 11) % 64) + "\n"
    return b"\x93NUMPY\x01\0" + struct.pack("<H", len(head)) + head.encode() + data


def _archive(entry: bytes, kind: int = zipfile.ZIP_DEFLATED) -> bytes:
    stream = io.BytesIO(npz())
    with zipfile.ZipFile(stream, "a") as archive:
        archive.writestr("more.npy", entry, compress_type=kind)
    return stream.getvalue()


def _text_noise() -> bytes:
    stream = io.BytesIO()
    f = np.arange(100.0, 140.0, 2.0)
    np.savez(stream, f=f, tau=0.1, p=np.exp(1j * f), noise=np.array("loud"))
    return stream.getvalue()


def _glb_with(change: str) -> bytes:
    content = glb()
    (length,) = struct.unpack_from("<I", content, 12)
    tree = json.loads(content[20 : 20 + length])
    match change:
        case "points":
            for accessor in tree["accessors"]:
                del accessor["bufferView"]
                accessor["count"] = 300_000_000
        case "views":
            del tree["bufferViews"]
        case "count":
            tree["accessors"][0]["count"] = 10**12
    head = json.dumps(tree).encode()
    head += b" " * (-len(head) % 4)
    rest = content[20 + length :]
    size = struct.pack("<4sII", b"glTF", 2, 20 + len(head) + len(rest))
    return size + struct.pack("<I4s", len(head), b"JSON") + head + rest


def _polygon(n: int, radius: float) -> bytes:
    angles = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    rows = [f"v {radius * np.cos(a):.9f} {radius * np.sin(a):.9f} 0" for a in angles]
    return "\n".join([*rows, "f " + " ".join(map(str, range(1, n + 1)))]).encode()


def _grain(n: int) -> bytes:
    """n triangles, all of whose corners lie within a tenth of a millimetre."""
    points = np.random.default_rng(1).uniform(-2e-5, 2e-5, (3 * n, 3))
    rows = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in points]
    return "\n".join([*rows, *(f"f {i} {i + 1} {i + 2}" for i in range(1, 3 * n, 3))]).encode()


def _squares(n: int) -> bytes:
    rows = []
    for i in range(n):
        x, y = 2 * (i % 500), 2 * (i // 500)
        rows += [f"v {x} {y} 0", f"v {x + 1} {y} 0", f"v {x + 1} {y + 1} 0", f"v {x} {y + 1} 0"]
        rows.append("f -4 -3 -2 -1")
    return "\n".join(rows).encode()


def _scanned_floor(n: int) -> bytes:
    content = scan()
    content["floors"][0]["polygonCorners"] *= n // len(content["floors"][0]["polygonCorners"])
    return json.dumps(content).encode()


def _geo_plane(plane: str) -> bytes:
    return examples()["box.geo"] + f"\r\n[99 long / {plane}]".encode()


@cache
def corpus() -> dict[str, bytes]:
    """Return every such file."""
    geo = examples()["box.geo"]
    deep = b"[" * 200_000 + b"]" * 200_000
    digits = b"9" * 5000
    return {
        "constants that double each other--box.geo": _constants(),
        "brackets without end--box.geo": _geo_plane(f"1 2 3 / ({')' * 15_000})"),
        "blanks without end--box.geo": _geo_plane(f"1 {' ' * 15_000} 2 3 / x"),
        "a long line--box.geo": geo.replace(b"ABS wood", b"ABS " + b"w" * 10**6),
        "empty lines in a plane--box.geo": _geo_plane("1 2\r\n" + "\r\n" * 300_000),
        "nested blocks--text.dxf": _nested_blocks(),
        "digits in the header--rew.txt": rew().replace(b"40 //", b"4" * 100_000 + b"x //"),
        "digits of a sample--rew.txt": rew().replace(b"* Data start", b"1" * 100_000 + b"x"),
        "a bomb--packed.mat": _mat_bomb(),
        "8 GB declared--spectrum.npz": _archive(_npy("(1000000000,)")),
        "8 GB zeros--spectrum.npz": _archive(_npy("(20000000,)", data=b"\0" * 160_000_000)),
        "a negative length--spectrum.npz": _archive(_npy("(-1,)")),
        "a header that is no code--spectrum.npz": _archive(_npy("((((")),
        "a header of brackets--spectrum.npz": _archive(_npy("(" * 300 + ")" * 300)),
        "a type that is none--spectrum.npz": _archive(_npy("(1,)", "5")),
        "a dictionary of gigabytes--spectrum.npz": _archive(_npy("(1,)"), zipfile.ZIP_LZMA),
        "objects--spectrum.npz": _archive(_npy("(1,)", "'|O'")),
        "noise that is text--spectrum.npz": _text_noise(),
        "points without bytes--box.glb": _glb_with("points"),
        "points without views--box.glb": _glb_with("views"),
        "points beyond the end--box.glb": _glb_with("count"),
        "a polygon of 20,000 corners--box.obj": _polygon(20_000, 5.0),
        "20,000 corners in a grain--box.obj": _polygon(20_000, 2e-5),
        "3,000 triangles in a grain--box.obj": _grain(3000),
        "20,000 open squares--box.obj": _squares(20_000),
        "a line that goes on--box.obj": obj() + b"\nf " + b"1 \\\n" * 200_000,
        "a long cell--corners.csv": b"number,x,y,z\n1," + b"1" * 140_000 + b",0,0\n",
        "a long cell--absorption.csv": absorption() + b"x" * 140_000,
        "a short row--absorption.csv": absorption() + b"brick\n",
        "a long cell--parameters.csv": examples()["parameters.csv"] + b"x" * 140_000,
        "60,000 fields of a byte--audio.ita": _mat_fields(60_000, 1),
        "fields of no length--audio.ita": _mat_fields(10, 0),
        "deep--result.json": result()[:-1] + b', "deep": ' + deep + b"}",
        "5,000 digits--result.json": result().replace(b"0.3", digits),
        "5,000 digits as number of bands--result.json": result().replace(
            b"500.0", b"1" + b"0" * 400
        ),
        "deep--scan.json": scan_json()[:-1] + b', "deep": ' + deep + b"}",
        "5,000 digits--scan.json": scan_json().replace(b"2.6", digits),
        "100,000 walls--scan.json": json.dumps({"walls": scan()["walls"] * 17_000}).encode(),
        "a floor of 20,000 corners--scan.json": _scanned_floor(20_000),
        "deep--campaign.toml": campaign().replace(b"[5, 4, 3]", deep),
        "5,000 digits--campaign.toml": campaign().replace(b"[5, 4, 3]", digits),
    }
