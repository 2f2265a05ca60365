"""The program that reads one HDF5 file in a process of its own; `hdf5` starts it.

Damaged files lead the HDF5 library into endless loops, and to read and write where it must not. So
it runs where nothing can be lost: with limits of memory and time, the file on standard input, and
on standard output one line of JSON (what there is, or an error), and behind it the numbers as
float64 in that order. It imports h5py and NumPy alone, and nothing of roomfit.

Arguments: bytes of memory, seconds of processor time, bytes of numbers.
"""

from __future__ import annotations

import io
import json
import os
import sys
from typing import Any

# netCDF keeps a dimension that has no values of its own as a variable with this remark
_ONLY_A_DIMENSION = "This is a netCDF dimension but not a netCDF variable"
_BESIDE_A_DIMENSION = "_nc4_non_coord_"
# What h5py raises on files that are not what they claim to be.
_UNREADABLE = (
    *(OSError, RuntimeError, ValueError, TypeError, KeyError, IndexError, AttributeError),
    *(MemoryError, OverflowError, UnicodeError, NotImplementedError),
)
_MOST_ATTRIBUTES = 10_000


def main(arguments: list[str]) -> None:
    """Read standard input and write what it holds to standard output."""
    memory_bytes, seconds, most_bytes = (int(float(a)) for a in arguments)
    _limit_this_process(memory_bytes, seconds)
    content = sys.stdin.buffer.read()
    place = ["the file"]
    try:
        head, arrays = _read(content, most_bytes, place)
        text = json.dumps(head)
    except _UNREADABLE as error:
        message = f"{place[0]}: {type(error).__name__}: {error}"
        text, arrays = json.dumps({"error": " ".join(message.split())[:500]}), []
    out = sys.stdout.buffer
    out.write(text.encode("ascii") + b"\n")
    for values in arrays:
        out.write(values.tobytes())
    out.flush()
    # the library would tidy up, and may fail at that
    os._exit(0)


def _limit_this_process(memory_bytes: int, seconds: int) -> None:
    try:
        import resource
    except ImportError:  # Windows: the parent's clock alone
        return
    for kind, most in (
        (resource.RLIMIT_AS, memory_bytes),
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_FSIZE, memory_bytes),
    ):
        _, hard = resource.getrlimit(kind)
        least = most if hard == resource.RLIM_INFINITY else min(most, hard)
        try:
            resource.setrlimit(kind, (least, hard))
        except (ValueError, OSError):  # macOS has no limit of addresses
            continue


def _read(content: bytes, most_bytes: int, place: list[str]) -> tuple[dict[str, Any], list[Any]]:
    """Return what the root of the file holds, and the arrays of its variables in that order."""
    import h5py

    members: list[dict[str, Any]] = []
    arrays: list[Any] = []
    n_bytes = 0
    with h5py.File(io.BytesIO(content), "r") as file:
        attributes = _attributes(file)
        for name in file:
            place[0] = repr(name)
            # a link to another file would read what this file does not contain
            if not isinstance(file.get(name, getlink=True), h5py.HardLink):
                continue
            member = file[name]
            own = _attributes(member)
            entry: dict[str, Any] = {"name": name, "attributes": own, "axes": [], "shape": None}
            if isinstance(member, h5py.Dataset):
                if str(own.get("NAME", "")).startswith(_ONLY_A_DIMENSION):
                    continue
                entry["name"] = name.removeprefix(_BESIDE_A_DIMENSION)
                entry["axes"] = _axes(member)
                n_bytes += 8 * (member.size or 0)
                if n_bytes > most_bytes:
                    raise ValueError(f"more than {most_bytes:.4g} bytes of numbers")
                values = _real_numbers(member)
                if values is not None:
                    entry["shape"] = values.shape
                    arrays.append(values)
            members.append(entry)
    return {"members": members, "attributes": attributes}, arrays


def _real_numbers(dataset: Any) -> Any:
    """Return the values of a dataset as float64, or None where they are no real numbers."""
    import numpy as np

    if dataset.shape is None or dataset.dtype.kind not in "iuf":
        return None
    if dataset.external or dataset.is_virtual:
        raise ValueError("its numbers lie in other files")
    return np.asarray(dataset[()], dtype=np.float64)


def _axes(dataset: Any) -> list[str]:
    """Return the names of the dimensions of four or more axes, which netCDF attaches as scales.

    Up to three axes have one order only, and the library may count scales for ever in a damaged
    file: it is not asked in vain.
    """
    if dataset.ndim < 4:
        return ["" for _ in range(dataset.ndim)]
    names = (str(axis[0].name or "") if len(axis) else "" for axis in dataset.dims)
    return [name.rpartition("/")[2] for name in names]


def _attributes(member: Any) -> dict[str, str | float]:
    """Return texts and single numbers; lists of references and the like are passed over."""
    import h5py
    import numpy as np

    found: dict[str, str | float] = {}
    if len(member.attrs) > _MOST_ATTRIBUTES:
        raise ValueError(f"{len(member.attrs)} attributes")
    for name in member.attrs:
        kind = member.attrs.get_id(name).dtype
        if kind.kind not in "Siuf" and h5py.check_string_dtype(kind) is None:
            continue
        value = np.asarray(member.attrs[name]).reshape(-1)
        if value.size != 1 or isinstance(value[0], h5py.Empty):
            continue
        (single,) = value.tolist()
        if isinstance(single, bytes):
            single = single.decode("utf-8", errors="replace")
        if isinstance(single, str | int | float):
            found[name] = single.rstrip("\0") if isinstance(single, str) else float(single)
    return found


if __name__ == "__main__":
    main(sys.argv[1:])
