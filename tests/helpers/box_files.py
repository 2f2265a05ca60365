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


def ply(order: str) -> bytes:
    head = f"ply\nformat {order} 1.0\nelement vertex 8\nproperty float x\nproperty float y\n"
    head += "property float z\nelement face 6\nproperty list uchar int vertex_indices\nend_header\n"
    if order == "ascii":
        rows = [f"{x} {y} {z}" for x, y, z in POINTS]
        return (head + "\n".join(rows + [f"4 {a} {b} {c} {d}" for a, b, c, d in QUADS])).encode()
    mark = "<" if order == "binary_little_endian" else ">"
    body = b"".join(struct.pack(f"{mark}3f", *p) for p in POINTS)
    return head.encode() + body + b"".join(struct.pack(f"{mark}B4i", 4, *q) for q in QUADS)


def stl() -> bytes:
    rows = (struct.pack("<12fH", 0, 0, 0, *(v for k in t for v in POINTS[k]), 0) for t in TRIANGLES)
    return b" " * 80 + struct.pack("<I", len(TRIANGLES)) + b"".join(rows)


def corners() -> bytes:
    rows = [f"{i + 1},{x},{y},{z}" for i, (x, y, z) in enumerate(POINTS)]
    return "\n".join(["number,x,y,z", *rows]).encode()


def planes() -> bytes:
    rows = [f"{i},plaster,9," + ",".join(str(c + 1) for c in q) for i, q in enumerate(QUADS)]
    return "\n".join(["number,material,area,corner 1,corner 2", *rows]).encode()
