"""HDF5 files, as SOFA (AES69) has them, and MATLAB files, read in a process apart."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from roomfit.base.arguments import read_only
from roomfit.base.door import too_many_numbers
from roomfit.base.isolated import isolated
from roomfit.base.typing import FloatArray

# netCDF keeps a dimension that has no values of its own as a variable with this remark
_ONLY_A_DIMENSION = "This is a netCDF dimension but not a netCDF variable"
_BESIDE_A_DIMENSION = "_nc4_non_coord_"
_MOST_ATTRIBUTES = 10_000

Attributes = Mapping[str, str | float]


class Hdf5Variable(NamedTuple):
    """One member of the root of an HDF5 file."""

    values: FloatArray | None  # in the file's order of axes; None for anything but real numbers
    axes: tuple[str, ...]  # names of netCDF's dimensions, known from four axes on
    attributes: Attributes  # texts and single numbers


@lru_cache(maxsize=1)  # the pairs of a campaign often lie in one file
def hdf5_variables(content: bytes) -> tuple[dict[str, Hdf5Variable], Attributes]:
    """Return the variables in the root of an HDF5 file by name, and the file's own attributes.

    Left out are links to elsewhere, and dimensions of netCDF without values. A ValueError says
    where the bytes are no such file, damaged, or hold more than the limits of files allow.
    """
    variables: dict[str, Hdf5Variable] = {}
    with isolated("roomfit.formats.hdf5:read", content, "the HDF5 library") as (head, array):
        for member in head["members"]:
            values = None if member["shape"] is None else read_only(array(member["shape"]))
            axes = tuple(str(axis) for axis in member["axes"])
            variables[str(member["name"])] = Hdf5Variable(values, axes, dict(member["attributes"]))
        return variables, dict(head["attributes"])


def read(content: bytes, most_bytes: float, place: list[str]) -> tuple[dict[str, Any], list[Any]]:
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
                    raise too_many_numbers(most_bytes)
                if member.shape is not None and member.dtype.kind in "iuf":
                    if member.external or member.is_virtual:
                        raise ValueError("its numbers lie in other files")
                    arrays.append(np.asarray(member[()], dtype=np.float64))
                    entry["shape"] = arrays[-1].shape
            members.append(entry)
    return {"members": members, "attributes": attributes}, arrays


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
    read = "roomfit.formats.hdf5:read_mat"
    with isolated(read, content, "the reader of MAT files") as (head, array):
        return {
            str(name): str(kind) if shape is None else array(shape)
            for name, kind, shape in head["variables"]
        }


def read_mat(
    content: bytes, most_bytes: float, place: list[str]
) -> tuple[dict[str, Any], list[Any]]:
    """Return name, kind and shape of each variable, and the arrays of those that have a shape."""
    named: Iterator[tuple[str, Any]]
    starts = (content[: len(_SIGNATURE)], content[_HEADER_BYTES:][: len(_SIGNATURE)])
    if content[:19] == b"MATLAB 7.3 MAT-file" or _SIGNATURE in starts:
        named = _of_hdf5(*read(content, most_bytes, place))
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
                raise too_many_numbers(most_bytes)
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
