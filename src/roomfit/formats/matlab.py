"""MATLAB files from version 5 on, by scipy and, from version 7.3 on, HDF5; in a process apart."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from roomfit.base.isolated import isolated
from roomfit.base.typing import FloatArray
from roomfit.formats import hdf5

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_HEADER_BYTES = 512
_KINDS = {"char": "text", "cell": "a cell array", "struct": "a structure"}
_NUMERIC = {
    *("double", "single", "logical"),
    *(f"{u}int{n}" for u in ("", "u") for n in (8, 16, 32, 64)),
}
_MOST_LETTERS = 40

Variables = Mapping[str, FloatArray | str]  # what it is instead, where it is no real numbers


@lru_cache(maxsize=1)  # the pairs of a campaign often lie in one file
def mat_variables(content: bytes) -> Variables:
    """Return every variable of a MAT file by name, in the shape that it has in MATLAB.

    The fields of a single structure of version 5 to 7.2 are named STRUCTURE.FIELD. A ValueError
    says where the bytes are no such file or damaged.
    """
    read = "roomfit.formats.matlab:read"
    with isolated(read, content, "the reader of MAT files") as (head, array):
        return {
            str(name): str(kind) if shape is None else array(shape)
            for name, kind, shape in head["variables"]
        }


def read(content: bytes, most_bytes: float, place: list[str]) -> tuple[dict[str, Any], list[Any]]:
    """Return name, kind and shape of each variable, and the arrays of those that have a shape."""
    named: Iterator[tuple[str, Any]]
    starts = (content[: len(_SIGNATURE)], content[_HEADER_BYTES:][: len(_SIGNATURE)])
    if content[:19] == b"MATLAB 7.3 MAT-file" or _SIGNATURE in starts:
        named = _of_hdf5(*hdf5.read(content, most_bytes, place))
    elif content[126:128] in (b"IM", b"MI"):
        import scipy.io

        found = scipy.io.loadmat(io.BytesIO(content))
        named = ((n, v) for n, v in found.items() if not n.startswith("__") and n)
    else:
        raise ValueError("no header of a MAT file of version 5 to 7.2")
    entries, arrays, n_bytes = [], [], 0.0
    for name, value in _flat(named):
        place[0] = repr(name)
        what, is_array = _kind(value), isinstance(value, np.ndarray)
        entries.append((name, what, value.shape if is_array and not what else None))
        if not what:
            n_bytes += 8 * value.size
            if n_bytes > most_bytes:
                raise ValueError(f"more than {most_bytes:.4g} bytes of numbers")
            arrays.append(np.asarray(value, dtype=np.float64))
    return {"variables": entries}, arrays


def _flat(named: Iterator[tuple[str, Any]]) -> Iterator[tuple[str, Any]]:
    """Yield variables, those of a single structure one by one."""
    for name, value in named:
        if isinstance(value, np.ndarray) and value.dtype.names and value.shape == (1, 1):
            yield from ((f"{name}.{field}", value[0, 0][field]) for field in value.dtype.names)
        else:
            yield name, value


def _kind(value: Any) -> str:
    """Return what a value is instead of real numbers, "" where it is such."""
    if isinstance(value, str):
        return value
    if not isinstance(value, np.ndarray):
        return "a sparse array" if hasattr(value, "tocsc") else "an object"
    if value.dtype.names:
        return "an object" if type(value) is not np.ndarray else "a structure"
    if value.dtype.kind == "U":
        return f"text {''.join(value.reshape(-1)[:1])[:_MOST_LETTERS]!r}"
    kinds = {"O": "a cell array", "c": "complex numbers"}
    return "" if value.dtype.kind in "iufb" else kinds.get(value.dtype.kind, "of another kind")


def _of_hdf5(head: dict[str, Any], arrays: list[Any]) -> Iterator[tuple[str, Any]]:
    """Yield variables as they were in MATLAB, whose axes the file reverses, or their kind."""
    numbers = iter(arrays)
    for member in head["members"]:
        values = None if member["shape"] is None else next(numbers)
        name, attributes = member["name"], member["attributes"]
        kind = str(attributes.get("MATLAB_class", ""))
        if name in ("#refs#", "#subsystem#"):  # what cells and objects refer to
            continue
        if "MATLAB_sparse" in attributes:
            yield name, "a sparse array"
        elif kind not in _NUMERIC:
            yield name, _KINDS.get(kind, f"of class {kind!r}" if kind else "not written by MATLAB")
        elif attributes.get("MATLAB_empty", 0.0):
            yield name, np.zeros((0, 0))
        elif values is None:
            yield name, "complex numbers"
        elif values.ndim < 2:
            raise ValueError(f"{name!r} has {values.ndim} axes, and an array of MATLAB two or more")
        else:
            yield name, values.T
