"""Damage to files, also below their compression and their checksums."""

from __future__ import annotations

import io
import json
import struct
import zipfile
import zlib
from random import Random
from typing import Any

_WORDS = (
    *("0", "-1", "1", "7", "9", "65535", "4294967295", "-2147483648", "99999999999999999999"),
    *("1e400", "1e308", "-1e308", "1e-320", "nan", "inf", "-inf", "0x10", "x", "\x00", '"'),
    *("/", "//", ".", ",", "-", "+", "*", "(", ")", "[", "]", "{", "}", "=", ";", "#", "\\"),
    *("\x1b[31m", "é", "kids", "refs", "f", "null"),
)
_NUMBERS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
_VALUES: tuple[Any, ...] = (
    *(None, True, 0, -1, 2**31, 2**63, 10**400, 1e308, -0.5, "", "x", "\x1b[2J", [], {}, [[]]),
    *([1, 2, 3], {"a": 1}, "9" * 5000, [None], [[1e308]], "nan"),
)


def damaged(name: str, content: bytes, rng: Random) -> bytes:
    """Return a file with one to four damages, in a third of all cases those of its own format."""
    special = _SPECIAL.get(name.rpartition(".")[2])
    for _ in range(rng.choice((1, 1, 2, 4))):
        if special is not None and rng.random() < 0.6:
            try:
                content = special(content, rng)
                continue
            except Exception:  # noqa: BLE001 -- it was damaged too much for its own format
                pass
        content = _damaged_bytes(content, rng)
    return content


def _damaged_bytes(content: bytes, rng: Random) -> bytes:
    at = rng.randrange(len(content) + 1)
    end = min(len(content), at + rng.choice((1, 2, 4, 8, 64, 1000)))
    match rng.randrange(11):
        case 0:
            return content[:at]
        case 1:
            return content[:at] + content[end:]
        case 2:
            return content[:end] + content[at:end] * rng.choice((1, 2, 50)) + content[end:]
        case 3:
            return content[:at] + rng.randbytes(rng.choice((1, 4, 8))) + content[end:]
        case 4:
            number = struct.pack(rng.choice("<>") + "I", rng.choice(_NUMBERS))
            size = rng.choice((1, 2, 4))
            return content[:at] + number[:size] + content[at + size :]
        case 5:
            flipped = bytes(b ^ (1 << rng.randrange(8)) for b in content[at : at + 1])
            return content[:at] + flipped + content[at + 1 :]
        case 6 | 7:
            mark = rng.choice((b" ", b" ", b"\n", b","))
            words = content.split(mark)
            words[rng.randrange(len(words))] = rng.choice(_WORDS).encode()
            return mark.join(words)
        case 8:
            lines = content.split(b"\n")
            lines.insert(rng.randrange(len(lines)), rng.choice(lines))
            return b"\n".join(lines)
        case 9:
            lines = content.split(b"\n")
            lines.pop(rng.randrange(len(lines)))
            return b"\n".join(lines)
        case _:
            letter = rng.choice(
                (b"9", b" ", b"(", b"[", b"\\\n", b"-", b"\t", b'"', b"\xef\xbb\xbf")
            )
            return content[:at] + letter * rng.choice((1, 100, 30_000)) + content[at:]


def _damaged_tree(tree: Any, rng: Random) -> Any:
    """Change one thing somewhere in lists and mappings."""
    if isinstance(tree, dict) and tree and rng.random() < 0.85:
        key = rng.choice(sorted(tree, key=str))
        match rng.randrange(8):
            case 0:
                return {k: v for k, v in tree.items() if k != key}
            case 1:
                return {**tree, key: rng.choice(_VALUES)}
            case _:
                return {**tree, key: _damaged_tree(tree[key], rng)}
    if isinstance(tree, list) and tree and rng.random() < 0.85:
        at = rng.randrange(len(tree))
        match rng.randrange(6):
            case 0:
                return tree[:at] + tree[at + 1 :]
            case 1:
                return tree[: at + 1] * rng.choice((1, 2, 100)) + tree[at:]
            case _:
                return [*tree[:at], _damaged_tree(tree[at], rng), *tree[at + 1 :]]
    if isinstance(tree, int) and rng.random() < 0.5:
        return rng.choice((*_NUMBERS, tree + 1, tree - 1, -tree, tree * 1000, float(tree)))
    return rng.choice(_VALUES)


def _json(content: bytes, rng: Random) -> bytes:
    if rng.random() < 0.1:
        deep = rng.choice((100, 100_000))
        return content.rstrip()[:-1] + b', "deep": ' + b"[" * deep + b"]" * deep + b"}"
    return _dumped(_damaged_tree(json.loads(content), rng))


def _dumped(tree: Any) -> bytes:
    return json.dumps(tree).encode()


def _glb(content: bytes, rng: Random) -> bytes:
    (length,) = struct.unpack_from("<I", content, 12)
    head, rest = content[20 : 20 + length], content[20 + length :]
    if rng.random() < 0.8:
        head = _dumped(_damaged_tree(json.loads(head), rng))
    else:
        rest = _damaged_bytes(rest, rng)
    head += b" " * (-len(head) % 4)
    size = 20 + len(head) + len(rest)
    return (
        struct.pack("<4sII", b"glTF", 2, size)
        + struct.pack("<I4s", len(head), b"JSON")
        + head
        + rest
    )


def _mat(content: bytes, rng: Random) -> bytes:
    """Damage what is compressed in a MAT file of level 5, and compress it again."""
    elements, at = [], 128
    while at + 8 <= len(content):
        kind, size = struct.unpack_from("<II", content, at)
        elements.append((kind, content[at + 8 : at + 8 + size]))
        at += 8 + size
    chosen = rng.randrange(len(elements))
    kind, data = elements[chosen]
    if kind == 15:
        elements[chosen] = kind, zlib.compress(_damaged_bytes(zlib.decompress(data), rng))
    else:
        elements[chosen] = kind, _damaged_bytes(data, rng)
    parts = (struct.pack("<II", kind, len(data)) + data for kind, data in elements)
    return content[:128] + b"".join(parts)


def _npz(content: bytes, rng: Random) -> bytes:
    """Damage one array or its header, and put a right checksum on it."""
    stream = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(stream, "w") as new:
        chosen = rng.choice(old.namelist())
        for entry in old.namelist():
            data = old.read(entry)
            if entry == chosen:
                # the header is text of 128 bytes: most damages hit it
                split = 128 if rng.random() < 0.7 else len(data)
                data = _damaged_bytes(data[:split], rng) + data[split:]
            kind = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA))
            new.writestr(entry, data, compress_type=kind)
    return stream.getvalue()


def _campaign(content: bytes, rng: Random) -> bytes:
    """Replace one value by another that is valid TOML."""
    lines = content.split(b"\n")
    chosen = rng.choice([i for i, line in enumerate(lines) if b" = " in line])
    key = lines[chosen].split(b" = ")[0]
    values = ("0", "-1", "1e300", "nan", "inf", "true", '""', '"x"', "[]", "{}", "[1, 2]")
    value = rng.choice((*values, "9" * 5000, "[" * 500 + "]" * 500, '"' + "x" * 10_000 + '"'))
    lines[chosen] = key + b" = " + value.encode()
    return b"\n".join(lines)


_SPECIAL = {
    "json": _json,
    "glb": _glb,
    "ita": _mat,
    "mat": _mat,
    "npz": _npz,
    "toml": _campaign,
}
