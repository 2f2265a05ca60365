"""Responses in MATLAB files of versions 5 to 7.2."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from roomfit.checks import nearest
from roomfit.errors import InputError
from roomfit.files.responses.mat5 import real_arrays
from roomfit.files.responses.recording import Recording, pick
from roomfit.files.responses.spec import ResponseSpec
from roomfit.typing import FloatArray

Variables = Mapping[str, FloatArray | None]


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
        Not a MAT file, version 4 or 7.3, no such variable or column, or no sampling rate.
    """
    where = str(spec.path)
    variables = _variables(content, where)
    responses = _responses(variables, spec, where)
    channel = pick("response", spec.channel, responses.shape[1], "channel", where)
    return Recording(responses[:, channel].copy(), _sampling_rate_hz(variables, spec, where))


def _variables(content: bytes, where: str) -> Variables:
    needed, hint = "a MATLAB file of version 5 to 7.2", "in MATLAB: save(file, '-v7')"
    if content[:19] == b"MATLAB 7.3 MAT-file" or content[:4] == b"\x89HDF":
        raise InputError(
            "MAT files of version 7.3 are not read", where=where, needed=needed, hint=hint
        )
    try:
        return real_arrays(content)
    except ValueError as error:
        raise InputError(
            "this is not a MAT file that can be read",
            where=where,
            found=str(error),
            needed=needed,
            hint=hint,
        ) from error


def _responses(variables: Variables, spec: ResponseSpec, where: str) -> FloatArray:
    """Return the named variable as columns of samples."""
    if spec.variable is None:
        raise InputError(
            "which variable of the MAT file holds the responses?",
            where=where,
            found=_listed(variables),
            needed="variable = one of these names",
        )
    if spec.variable not in variables:
        guess = nearest(spec.variable, variables)
        raise InputError(
            "the MAT file has no such variable",
            where=where,
            found=f"variable = {spec.variable!r}; the file holds {_listed(variables)}",
            hint=f"did you mean {guess!r}?" if guess else None,
        )
    values = variables[spec.variable]
    if values is None or values.ndim != 2 or values.size == 0:
        raise InputError(
            "the variable of the MAT file holds no responses",
            where=f"{where}, {spec.variable}",
            found=_kind(values),
            needed="an array of real numbers, one response a column",
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


def _sampling_rate_hz(variables: Variables, spec: ResponseSpec, where: str) -> float:
    if spec.sampling_rate_variable is None:
        if spec.sampling_rate_hz is not None:
            return spec.sampling_rate_hz
        single = [name for name, v in variables.items() if v is not None and v.size == 1]
        raise InputError(
            "the sampling rate of the MAT file is missing",
            where=where,
            needed="sampling_rate_variable (a name) or sampling_rate_hz (a number)",
            hint=f"single numbers in the file: {', '.join(single)}" if single else None,
        )
    values = variables.get(spec.sampling_rate_variable)
    if values is None or values.size != 1:
        raise InputError(
            "the MAT file has no such sampling rate",
            where=where,
            found=f"sampling_rate_variable = {spec.sampling_rate_variable!r}",
            needed=f"one number; the file holds {_listed(variables)}",
        )
    return float(values.reshape(-1)[0])


def _listed(variables: Variables) -> str:
    return ", ".join(f"{name} {_kind(v)}" for name, v in variables.items()) or "nothing"


def _kind(values: FloatArray | None) -> str:
    return "(no real numbers)" if values is None else str(values.shape)
