"""One number for everything that a result depends on."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

_LIBRARIES = ("numpy", "scipy", "numba")


def digest(*parts: object) -> str:
    """Return the SHA-256 of values, in hexadecimal: the same for equal values, and only for those.

    Parameters
    ----------
    *parts
        None, truth values, numbers, text, bytes, arrays, paths (by their text), and dataclasses,
        sequences and mappings of these. Each is marked with its kind and length, so that
        ("ab", "c") and ("a", "bc") differ, and so do 1, 1.0 and True.

    Raises
    ------
    TypeError
        A value of another kind: a fault of the calling code.
    """
    seen = hashlib.sha256()
    for part in parts:
        _feed(seen, part)
    return seen.hexdigest()


@cache
def code_digest() -> str:
    """Return the SHA-256 of roomfit's own code and of the versions that it computes with.

    Any change of the code makes a cache of numbers worthless; which change alters which number,
    nobody keeps track of without fail. Read once a process: about 20 ms.
    """
    folder = Path(__file__).parents[1]
    files = sorted(p for p in folder.rglob("*.py") if "__pycache__" not in p.parts)
    contents = {p.relative_to(folder).as_posix(): p.read_bytes() for p in files}
    return digest(contents, {name: version(name) for name in _LIBRARIES})


def _feed(seen: hashlib._Hash, value: object) -> None:
    kind, content = _plain(value)
    if isinstance(content, bytes):
        seen.update(f"{kind}:{len(content)}:".encode())
        seen.update(content)
        return
    seen.update(f"{kind}:[{len(content)}]:".encode())
    for item in content:
        _feed(seen, item)


def _plain(value: object) -> tuple[str, bytes | list[Any]]:
    """Return the kind of a value, and its bytes or the values that it is made of."""
    if value is None:
        return "none", b""
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise TypeError("an array of objects has no digest")
        # zeros of either sign weigh the same but are other bytes: a needless second run, no error
        return f"array {value.dtype.str} {value.shape}", np.ascontiguousarray(value).tobytes()
    if isinstance(value, bool | np.bool_):
        return "bool", b"1" if value else b"0"
    if isinstance(value, int | np.integer):
        return "int", str(int(value)).encode()
    if isinstance(value, float | np.floating):
        return "float", struct.pack("<d", float(value))
    if isinstance(value, str | Path):
        return "text", str(value).encode()
    if isinstance(value, bytes):
        return "bytes", value
    if is_dataclass(value) and not isinstance(value, type):
        told = [[f.name, getattr(value, f.name)] for f in fields(value)]
        return f"record {type(value).__qualname__}", told
    if isinstance(value, Mapping):
        return "mapping", [[k, value[k]] for k in sorted(value, key=str)]
    if isinstance(value, list | tuple):
        return "list", list(value)
    raise TypeError(f"no digest for {type(value).__name__}")
