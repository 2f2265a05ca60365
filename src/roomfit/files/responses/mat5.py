"""Arrays of real numbers in MATLAB files of versions 5 to 7.2.

An own reader, since scipy's ends the whole process on some damaged files (a segmentation fault
within seconds of fuzzing, scipy 1.17), which no caller can turn into a message. It reads what a
measurement needs, full arrays of real numbers, and passes over everything else.

References
----------
.. [1] The MathWorks, "MAT-File Format", R2023b, chapter 1: level 5 MAT-files.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from roomfit.typing import FloatArray

_HEADER_BYTES = 128
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8"}
_NUMBERS[13] = "u8"
_INT32, _UINT32, _INT8, _MATRIX, _COMPRESSED = 5, 6, 1, 14, 15
_NUMERIC_CLASSES = range(6, 16)  # double, single and the integers
_COMPLEX_FLAG = 0x800
_LARGEST_BYTES = 1 << 31


@dataclass(frozen=True, slots=True)
class _Element:
    kind: int
    data: bytes


def real_arrays(content: bytes) -> dict[str, FloatArray | None]:
    """Return every variable of the file by name.

    Parameters
    ----------
    content : bytes
        The whole file.

    Returns
    -------
    dict
        Float64 arrays of the shape they have in the file; None for text, structures, cells, sparse
        and complex arrays.

    Raises
    ------
    ValueError
        The bytes are not a MAT file of level 5, or are damaged; says where.
    """
    order = {b"IM": "<", b"MI": ">"}.get(content[126:_HEADER_BYTES])
    if order is None:
        raise ValueError("no header of a MAT file of version 5 to 7.2")
    variables: dict[str, FloatArray | None] = {}
    for element in _elements(content[_HEADER_BYTES:], order):
        inner = element
        if element.kind == _COMPRESSED:
            inner = next(_elements(_decompressed(element.data), order), element)
        if inner.kind == _MATRIX:
            name, array = _variable(inner.data, order)
            variables[name] = array
    return variables


def _elements(data: bytes, order: str) -> Iterator[_Element]:
    """Walk the data elements that stand one after the other."""
    position = 0
    while position + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, position)
        if kind >> 16:  # a small element: size, kind and up to four bytes of data in eight
            kind, size, start, following = kind & 0xFFFF, kind >> 16, position + 4, position + 8
        else:
            start = position + 8
            following = start + size
            if kind != _COMPRESSED:
                following += -size % 8
        if start + size > len(data) or (following == position + 8 and size > 4):
            raise ValueError(
                f"an element of {size} bytes where {max(0, len(data) - start)} are left"
            )
        yield _Element(kind, data[start : start + size])
        position = following


def _decompressed(data: bytes) -> bytes:
    unpacker = zlib.decompressobj()
    try:
        unpacked = unpacker.decompress(data, _LARGEST_BYTES)
    except zlib.error as error:
        raise ValueError(f"damaged compression: {error}") from error
    if not unpacker.eof:
        raise ValueError("compressed data that does not end")
    return unpacked


def _variable(data: bytes, order: str) -> tuple[str, FloatArray | None]:
    """Return name and values of one array."""
    parts = _elements(data, order)
    flags, shape, name = (next(parts, None) for _ in range(3))
    if flags is None or shape is None or name is None:
        raise ValueError("an array without flags, size or name")
    if flags.kind != _UINT32 or len(flags.data) < 4 or shape.kind != _INT32:
        raise ValueError("an array with foreign flags or size")
    text = name.data.decode("utf-8", errors="replace")
    (word,) = struct.unpack_from(f"{order}I", flags.data)
    if word & 0xFF not in _NUMERIC_CLASSES or word & _COMPLEX_FLAG:
        return text, None
    values = next(parts, None)
    if values is None or values.kind not in _NUMBERS:
        raise ValueError(f"array {text!r} without numbers")
    lengths = np.frombuffer(shape.data, f"{order}i4").tolist()
    numbers = np.frombuffer(values.data, order + _NUMBERS[values.kind]).astype(np.float64)
    if min(lengths, default=-1) < 0 or math.prod(lengths) != numbers.size:
        raise ValueError(f"array {text!r} of {numbers.size} numbers with the size {lengths}")
    return text, numbers.reshape(lengths, order="F")
