"""Records of numbers in a file: dataclasses of arrays, numbers, text and other records."""

from __future__ import annotations

import json
import struct
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.errors import RoomfitError

_OUTLINE = "outline"
# What reading damaged bytes as an archive, as arrays, as JSON, as a record can raise.
_DAMAGE = (
    *(OSError, EOFError, ValueError, KeyError, IndexError, TypeError, AttributeError),
    *(OverflowError, MemoryError, RuntimeError, SyntaxError, struct.error),
    *(zipfile.BadZipFile, zlib.error, RoomfitError),
)


class BrokenRecordError(ValueError):
    """A file that does not hold the record it should; caught within `roomfit.files`."""


def save_record(path: Path, value: object) -> None:
    """Write a record as a NumPy archive: arrays as they are, all else as one text in JSON.

    Parameters
    ----------
    path : Path
        Written directly: write aside and rename, see `roomfit.files.cache`.
    value : object
        None, truth values, numbers, text, arrays, and dataclasses, tuples, lists and mappings
        (with text as keys) of these. Lists come back as tuples.

    Raises
    ------
    TypeError
        A value of another kind: a fault of the calling code.
    """
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    outline = json.dumps(_outlined(value, arrays))
    with path.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **{_OUTLINE: np.array(outline), **arrays})


def load_record(path: Path, classes: Iterable[type]) -> Any:
    """Return the record of a file, made of no other classes than those given.

    Arrays are read-only. The archive holds a checksum of each array, so that a file that was cut
    short or altered is found out.

    Raises
    ------
    BrokenRecordError
        The file is no such record, or damaged, or of another class.
    """
    known = {c.__qualname__: c for c in classes}
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        return _rebuilt(json.loads(str(arrays[_OUTLINE])), arrays, known)
    except FileNotFoundError:
        raise
    except _DAMAGE as error:
        raise BrokenRecordError(f"{path}: {error}") from error


def size_bytes(value: object) -> int:
    """Return the size of a record's arrays: about what its file will take."""
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    _outlined(value, arrays)
    return sum(a.nbytes for a in arrays.values())


def _outlined(value: object, arrays: dict[str, np.ndarray[Any, Any]]) -> Any:
    """Return what JSON can hold of a value, its arrays put aside under numbers."""
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise TypeError("an array of objects cannot be kept")
        name = f"a{len(arrays)}"
        arrays[name] = value
        return {"array": name}
    if isinstance(value, np.generic):
        return _outlined(value.item(), arrays)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if is_dataclass(value) and not isinstance(value, type):
        told = {f.name: getattr(value, f.name) for f in fields(value) if f.init}
        return {
            "record": type(value).__qualname__,
            "fields": {name: _outlined(item, arrays) for name, item in told.items()},
        }
    if isinstance(value, Mapping):
        if not all(isinstance(key, str) for key in value):
            raise TypeError("a mapping is kept only with text as keys")
        return {"mapping": {key: _outlined(item, arrays) for key, item in value.items()}}
    if isinstance(value, list | tuple):
        return [_outlined(item, arrays) for item in value]
    raise TypeError(f"{type(value).__name__} cannot be kept")


def _rebuilt(
    outline: Any, arrays: Mapping[str, np.ndarray[Any, Any]], known: Mapping[str, type]
) -> Any:
    if isinstance(outline, list):
        return tuple(_rebuilt(item, arrays, known) for item in outline)
    if not isinstance(outline, dict):
        return outline
    if "array" in outline:
        array = arrays[outline["array"]]
        array.setflags(write=False)
        return array
    if "mapping" in outline:
        return {key: _rebuilt(item, arrays, known) for key, item in outline["mapping"].items()}
    told = {name: _rebuilt(item, arrays, known) for name, item in outline["fields"].items()}
    return known[outline["record"]](**told)
