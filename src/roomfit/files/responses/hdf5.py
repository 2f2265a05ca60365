"""HDF5 files: SOFA files (AES69, which is netCDF-4 [1]_) and MATLAB files of version 7.3.

References
----------
.. [1] Unidata, "NetCDF-4 file format", in The NetCDF User's Guide: dimensions in HDF5.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from roomfit.base.arguments import read_only
from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray
from roomfit.files.door import of_child
from roomfit.files.responses.recordings import Recording, ResponseSpec, pick

_KEPT_BYTES = 2**27

Attributes = Mapping[str, str | float]


@dataclass(frozen=True, slots=True, eq=False)
class Hdf5Variable:
    """One member of the root of an HDF5 file."""

    # In the file's order of axes; None for anything but real numbers
    values: FloatArray | None
    # Names of the netCDF dimensions; empty ones up to three axes, or where the file names
    # none
    axes: tuple[str, ...]
    attributes: Attributes  # texts and single numbers


def read_hdf5_variables(content: bytes) -> tuple[dict[str, Hdf5Variable], Attributes]:
    """Return the variables in the root of an HDF5 file by name, and the file's own attributes.

    Left out are links to elsewhere, and dimensions of netCDF without values. Everything comes back
    as plain arrays and texts, which nobody may change. The library reads in a process of its own
    (`roomfit.files.child`), since damaged files end it or keep it for ever.

    Raises
    ------
    ValueError
        The bytes are no HDF5 file, or are damaged, or contain more than the limits of files allow;
        the message says where.
    """
    return (_of_last_file if len(content) <= _KEPT_BYTES else _in_child)(content)


def _in_child(content: bytes) -> tuple[dict[str, Hdf5Variable], Attributes]:
    with of_child("hdf5", content, "the HDF5 library") as (head, arrays):
        return _received(head, arrays)


# the pairs of a campaign often lie in one file
_of_last_file = lru_cache(maxsize=1)(_in_child)


def _received(
    head: Any, array: Callable[[Any], FloatArray]
) -> tuple[dict[str, Hdf5Variable], Attributes]:
    variables: dict[str, Hdf5Variable] = {}
    for member in head["members"]:
        values = None if member["shape"] is None else read_only(array(member["shape"]))
        axes = tuple(str(axis) for axis in member["axes"])
        variables[str(member["name"])] = Hdf5Variable(values, axes, dict(member["attributes"]))
    return variables, dict(head["attributes"])


_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_HEADER_BYTES = 512
_NUMERIC = (
    "double",
    "single",
    "logical",
    *(f"{u}int{n}" for u in ("", "u") for n in (8, 16, 32, 64)),
)
_KINDS = {"char": "text", "cell": "a cell array", "struct": "a structure"}


def is_mat73(content: bytes) -> bool:
    """Return whether the bytes begin as MATLAB files of version 7.3, or other HDF5 files, do."""
    starts = (content[: len(_SIGNATURE)], content[_HEADER_BYTES:][: len(_SIGNATURE)])
    return content[:19] == b"MATLAB 7.3 MAT-file" or _SIGNATURE in starts


def mat73_arrays(content: bytes) -> dict[str, FloatArray | str]:
    """Return every variable of a MAT file of version 7.3 by name.

    Float64 arrays of the shape they have in MATLAB, whose axes are reversed in the file; what it
    is instead for text, structures, cells, sparse and complex arrays.

    Raises
    ------
    ValueError
        The bytes are no such file, or are damaged; says where.
    """
    variables, _ = read_hdf5_variables(content)
    # MATLAB keeps there what cells and objects refer to
    own = {name: v for name, v in variables.items() if name not in ("#refs#", "#subsystem#")}
    return {name: _array(name, variable) for name, variable in own.items()}


def _array(name: str, variable: Hdf5Variable) -> FloatArray | str:
    """Return the values as they were in MATLAB, or what is there instead."""
    attributes, values = variable.attributes, variable.values
    if "MATLAB_sparse" in attributes:
        return "a sparse array"
    kind = str(attributes.get("MATLAB_class", ""))
    if kind not in _NUMERIC:
        return _KINDS.get(kind, f"of class {kind!r}" if kind else "not written by MATLAB")
    if attributes.get("MATLAB_empty", 0.0):
        return np.zeros((0, 0))
    if values is None:
        return "complex numbers"
    if values.ndim < 2:
        raise ValueError(f"{name!r} has {values.ndim} axes, and an array of MATLAB two or more")
    return values.T


# Measurement, receiver, sample or frequency, emitter: the order of axes of AES69, from which the
# convention MultiSpeakerBRIR deviates.
_AXES = "MRNE"


Variables = Mapping[str, Hdf5Variable]  # by the names of AES69, such as "Data.IR"


def read_sofa(spec: ResponseSpec, content: bytes) -> Recording:
    """Return one measurement at one receiver of a SOFA file, as `spec` chooses them.

    Raises
    ------
    InputError
        The file is no SOFA file or holds no impulse responses, several emitters at once, or no
        such measurement or receiver.
    """
    sofa, data_type = read_sofa_variables(content)
    responses = sofa_data(sofa, "Data.IR")
    rates_hz = sofa_values(sofa, "Data.SamplingRate")
    if responses is None or rates_hz is None:
        raise InputError(
            "the SOFA file holds no impulse responses",
            found=f"data type {data_type!r}",
            needed="data type FIR with a sampling rate",
            hint="export the impulse responses (FIR) into a SOFA file",
        )
    measurement = pick("measurement", spec.measurement, responses.shape[0], "measurement")
    receiver = pick("receiver", spec.receiver_index, responses.shape[1], "receiver_index")
    rate_hz = float(rates_hz.reshape(-1)[min(measurement, rates_hz.size - 1)])
    delay_samples = _delay_samples(sofa, measurement, receiver)
    pressure = responses[measurement, receiver].copy()
    return Recording(pressure, rate_hz, delay_samples / rate_hz if rate_hz > 0.0 else 0.0)


def read_sofa_variables(content: bytes) -> tuple[Variables, str]:
    """Return the variables of a SOFA file, whatever its convention, and its data type.

    The type is FIR, FIR-E, TF, TF-E or SOS; "unknown" where the file does not say.

    Raises
    ------
    InputError
        This is no SOFA file, or a damaged one.
    """
    needed = "a SOFA file (AES69, which is netCDF-4)"
    try:
        variables, attributes = read_hdf5_variables(content)
    except ValueError as error:
        old = content[:3] == b"CDF"
        raise InputError(
            "this is not a SOFA file that can be read",
            found="a file of netCDF-3" if old else str(error),
            needed=needed,
            hint="nccopy -k nc4 old.sofa new.sofa" if old else "copy the file anew",
        ) from error
    if "SOFAConventions" not in attributes and attributes.get("Conventions") != "SOFA":
        raise InputError(
            "this is not a SOFA file that can be read",
            found="an HDF5 file without the attribute SOFAConventions",
            needed=needed,
            hint="write it with a SOFA library, which adds the attribute",
        )
    for name, variable in variables.items():
        # netCDF allows packed numbers; AES69 knows none
        if {"scale_factor", "add_offset"} & set(variable.attributes):
            raise InputError(
                "a variable of the SOFA file holds packed numbers",
                where=name,
                found="an attribute scale_factor or add_offset",
                needed="plain numbers, as AES69 has it",
                hint="write the variable unpacked, as float64",
            )
    return variables, str(attributes.get("DataType", "unknown"))


def sofa_values(sofa: Variables, name: str) -> FloatArray | None:
    """Return the numbers of a variable in the file's order, or None where there are none."""
    variable = sofa.get(name)
    if variable is None or variable.values is None or variable.values.size == 0:
        return None
    return variable.values


def sofa_data(sofa: Variables, name: str) -> FloatArray | None:
    """Return data as (n_measurements, n_receivers, n), or None where there are no such.

    Several emitters at once are refused.
    """
    values = sofa_values(sofa, name)
    if values is None or values.ndim not in (3, 4):
        return None
    axes = sofa[name].axes
    if sorted(axes) == sorted(_AXES):
        values = values.transpose([axes.index(axis) for axis in _AXES])
    if values.ndim == 4:
        if values.shape[3] != 1:
            what = "the SOFA file holds several emitters at once"
            needed, hint = "one emitter a file", "write one SOFA file for each emitter"
            raise InputError(what, found=f"{values.shape[3]} emitters", needed=needed, hint=hint)
        values = values[:, :, :, 0]
    return values


def _delay_samples(sofa: Variables, measurement: int, receiver: int) -> float:
    """Return how many samples the file says its responses are to be delayed.

    One for all measurements, or one for each: (I or M, R) and for FIR-E an axis of emitters.
    """
    delays = sofa_values(sofa, "Data.Delay")
    if delays is None:
        return 0.0
    delays = np.atleast_2d(delays)
    row, column = min(measurement, delays.shape[0] - 1), min(receiver, delays.shape[1] - 1)
    return float(delays[row, column].reshape(-1)[0])
