"""MATLAB files up to version 7.2."""

from __future__ import annotations

import io
import struct
import zlib
from typing import Any

import numpy as np
import scipy.io
from scipy.io.matlab import MatReadError

from roomfit.checks import nearest
from roomfit.errors import InputError
from roomfit.files.responses.recording import Recording, pick
from roomfit.files.responses.spec import ResponseSpec
from roomfit.typing import FloatArray

# What scipy's reader raises on files that are not what they claim to be.
_UNREADABLE = (
    *(MatReadError, ValueError, TypeError, KeyError, IndexError, AttributeError),
    *(NotImplementedError, OSError, EOFError, MemoryError, OverflowError, RecursionError),
    *(UnicodeError, NameError, AssertionError, SystemError, zlib.error, struct.error),
)


def read_mat(spec: ResponseSpec, content: bytes) -> Recording:
    """Return one column of a variable of a MAT file.

    Parameters
    ----------
    spec : ResponseSpec
        Names the variable, the column and where the sampling rate stands.
    content : bytes
        The whole file.

    Raises
    ------
    InputError
        Not a MAT file, version 7.3, no such variable or column, or no sampling rate.
    """
    where = str(spec.path)
    table = _contents(content, where)
    responses = _responses(table, spec, where)
    channel = pick("response", spec.channel, responses.shape[1], "channel", where)
    rate_hz = _sampling_rate_hz(table, spec, where)
    return Recording(responses[:, channel].copy(), rate_hz)


def _contents(content: bytes, where: str) -> dict[str, Any]:
    if content[:19] == b"MATLAB 7.3 MAT-file" or content[:4] == b"\x89HDF":
        raise InputError(
            "MAT files of version 7.3 are not read",
            where=where,
            needed="version 7 or older",
            hint="in MATLAB: save(file, '-v7')",
        )
    try:
        # scipy's types leave out the open files that its documentation allows
        table = scipy.io.loadmat(io.BytesIO(content))  # type: ignore[arg-type]
    except _UNREADABLE as error:
        raise InputError(
            "this is not a MAT file that can be read",
            where=where,
            found=f"{type(error).__name__}: {error}",
            needed="a MATLAB file of version 7 or older",
        ) from error
    return {str(name): value for name, value in table.items() if not str(name).startswith("__")}


def _responses(table: dict[str, Any], spec: ResponseSpec, where: str) -> FloatArray:
    """Return the named variable as columns of samples."""
    listed = ", ".join(f"{name} {_shape(value)}" for name, value in table.items()) or "nothing"
    if spec.variable is None:
        raise InputError(
            "which variable of the MAT file holds the responses?",
            where=where,
            found=listed,
            needed="variable = one of these names",
        )
    if spec.variable not in table:
        guess = nearest(spec.variable, table)
        raise InputError(
            "the MAT file has no such variable",
            where=where,
            found=f"variable = {spec.variable!r}; the file holds {listed}",
            hint=f"did you mean {guess!r}?" if guess else None,
        )
    values = _real_numbers(table[spec.variable])
    if values is None or values.ndim != 2 or values.size == 0:
        raise InputError(
            "the variable of the MAT file holds no responses",
            where=f"{where}, {spec.variable}",
            found=f"{_shape(table[spec.variable])}",
            needed="real numbers, one response a column",
        )
    if values.shape[0] == 1:
        return np.ascontiguousarray(values.T)
    if values.shape[1] > values.shape[0]:
        raise InputError(
            "the responses of the MAT file stand in rows",
            where=f"{where}, {spec.variable}",
            found=f"{values.shape[0]} rows and {values.shape[1]} columns",
            needed="one response a column",
            hint="transpose the variable",
        )
    return values


def _sampling_rate_hz(table: dict[str, Any], spec: ResponseSpec, where: str) -> float:
    if spec.sampling_rate_variable is None:
        if spec.sampling_rate_hz is not None:
            return spec.sampling_rate_hz
        scalars = [name for name, value in table.items() if np.size(value) == 1]
        raise InputError(
            "the sampling rate of the MAT file is missing",
            where=where,
            needed="sampling_rate_variable (a name) or sampling_rate_hz (a number)",
            hint=f"single numbers in the file: {', '.join(scalars)}" if scalars else None,
        )
    values = _real_numbers(table.get(spec.sampling_rate_variable))
    if values is None or values.size != 1:
        raise InputError(
            "the MAT file has no such sampling rate",
            where=where,
            found=f"sampling_rate_variable = {spec.sampling_rate_variable!r}",
            needed=f"one number; the file holds {', '.join(table) or 'nothing'}",
        )
    return float(values.reshape(-1)[0])


def _real_numbers(value: Any) -> FloatArray | None:
    """Return an array of real numbers as float64, or None for anything else."""
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "iuf":
        return None
    return np.asarray(value, dtype=np.float64)


def _shape(value: Any) -> str:
    return str(tuple(np.shape(value)))
