"""A box of 5 x 4 x 3 m in the forms of several programs, for tests that damage them."""

from __future__ import annotations

import struct

POINTS = [(x, y, z) for z in (0, 3) for y in (0, 4) for x in (0, 5)]
QUADS = ((0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6))
TRIANGLES = [t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))]


def obj() -> bytes:
    lines = ["o hall", "g shell", "usemtl plaster", *(f"v {x} {y} {z}" for x, y, z in POINTS)]
    lines += ["f " + " ".join(f"{c + 1}//1" for c in quad) for quad in QUADS]
    return "\n".join(lines).encode()


def ac3d() -> bytes:
    lines = ["AC3Db", 'MATERIAL "plaster" rgb 1 1 1', "OBJECT world", "kids 1", "OBJECT poly"]
    lines += ['name "hall"', "data 3", "abc", "loc 1 2 3", "rot 1 0 0 0 1 0 0 0 1", "numvert 8"]
    lines += [f"{x} {y} {z}" for x, y, z in POINTS] + ["numsurf 6"]
    for quad in QUADS:
        lines += ["SURF 0x10", "mat 0", "refs 4", *(f"{c} 0 0" for c in quad)]
    return "\n".join([*lines, "kids 0"]).encode()


def ply(order: str) -> bytes:
    head = f"ply\nformat {order} 1.0\nelement vertex 8\nproperty float x\nproperty float y\n"
    head += "property float z\nelement face 6\nproperty list uchar int vertex_indices\nend_header\n"
    if order == "ascii":
        rows = [f"{x} {y} {z}" for x, y, z in POINTS]
        return (head + "\n".join(rows + [f"4 {a} {b} {c} {d}" for a, b, c, d in QUADS])).encode()
    mark = "<" if order == "binary_little_endian" else ">"
    body = b"".join(struct.pack(f"{mark}3f", *p) for p in POINTS)
    return head.encode() + body + b"".join(struct.pack(f"{mark}B4i", 4, *q) for q in QUADS)


def layered_ply(order: str) -> bytes:
    """Return the box as I-Simpa writes it: a layer for each face, their names behind the faces."""
    head = f"ply\nformat {order} 1.0\nelement vertex 8\nproperty float x\nproperty float y\n"
    head += "property float z\nelement face 6\nproperty list uchar int vertex_indices\n"
    head += "property int layer_id\nelement layer 2\nproperty list uchar uchar layer_name\n"
    head += "end_header\n"
    names, layers = (b"walls", "Decke ü".encode()), (0, 0, 0, 0, 0, 1)
    if order == "ascii":
        rows = [f"{x} {y} {z}" for x, y, z in POINTS]
        rows += [f"4 {a} {b} {c} {d} {n}" for (a, b, c, d), n in zip(QUADS, layers, strict=True)]
        rows += [" ".join(str(letter) for letter in (len(name), *name)) for name in names]
        return (head + "\n".join(rows)).encode()
    body = b"".join(struct.pack(">3f", *p) for p in POINTS)
    body += b"".join(
        struct.pack(">B5i", 4, *q, layer) for q, layer in zip(QUADS, layers, strict=True)
    )
    return head.encode() + body + b"".join(bytes([len(name)]) + name for name in names)


def chunk(kind: int, content: bytes) -> bytes:
    """Return one chunk of a 3DS file."""
    return struct.pack("<HI", kind, 6 + len(content)) + content


def three_ds(axes: tuple[float, ...] = (), materials: bool = True) -> bytes:
    """Return the box as one object of two materials, with what else such files have."""
    points = struct.pack("<H24f", 8, *(v for p in POINTS for v in p))
    rows = b"".join(struct.pack("<4H", *t, 7) for t in TRIANGLES)
    faces = struct.pack("<H", 12) + rows
    if materials:
        # the ceiling is the last of the quads
        for name, numbers in ((b"plaster", range(10)), (b"tiles", (10, 11))):
            listed = struct.pack(f"<{len(numbers) + 1}H", len(numbers), *numbers)
            faces += chunk(0x4130, name + b"\0" + listed)
    faces += chunk(0x4150, struct.pack("<12I", *12 * (1,)))  # groups of smoothing
    mesh = chunk(0x4110, points) + chunk(0x4120, faces)
    if axes:
        mesh += chunk(0x4160, struct.pack("<12f", *axes))
    lamp = chunk(0x4000, b"lamp\0" + chunk(0x4600, struct.pack("<3f", 1, 1, 1)))
    looks = b"".join(chunk(0xAFFF, chunk(0xA000, n + b"\0")) for n in (b"plaster", b"tiles"))
    hall = chunk(0x4000, b"hall\0" + chunk(0x4100, mesh))
    scene = chunk(0x3D3D, chunk(0x3D3E, struct.pack("<I", 3)) + looks + lamp + hall)
    return chunk(0x4D4D, chunk(0x0002, struct.pack("<I", 3)) + scene)


def stl() -> bytes:
    rows = (struct.pack("<12fH", 0, 0, 0, *(v for k in t for v in POINTS[k]), 0) for t in TRIANGLES)
    return b" " * 80 + struct.pack("<I", len(TRIANGLES)) + b"".join(rows)


def corners() -> bytes:
    rows = [f"{i + 1},{x},{y},{z}" for i, (x, y, z) in enumerate(POINTS)]
    return "\n".join(["number,x,y,z", *rows]).encode()


def planes() -> bytes:
    rows = [f"{i},plaster,9," + ",".join(str(c + 1) for c in q) for i, q in enumerate(QUADS)]
    return "\n".join(["number,material,area,corner 1,corner 2", *rows]).encode()
