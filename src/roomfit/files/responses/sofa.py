"""SOFA files (AES69, which is netCDF-4)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray
from roomfit.files.responses.recordings import Recording, pick
from roomfit.files.schema import ResponseSpec
from roomfit.formats.hdf5 import Hdf5Variable, hdf5_variables

# Measurement, receiver, sample or frequency, emitter: the order of axes of AES69, from which the
# convention MultiSpeakerBRIR deviates.
_AXES = "MRNE"

Variables = Mapping[str, Hdf5Variable]  # by the names of AES69, such as "Data.IR"


def read_sofa(spec: ResponseSpec, content: bytes) -> Recording:
    """Return one measurement at one receiver of a SOFA file, as `spec` chooses them."""
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
    delay_samples = 0.0
    delays = sofa_values(sofa, "Data.Delay")
    if delays is not None:
        # one for all measurements, or one for each: (I or M, R) and for FIR-E an axis of emitters
        delays = np.atleast_2d(delays)
        row, column = min(measurement, delays.shape[0] - 1), min(receiver, delays.shape[1] - 1)
        delay_samples = float(delays[row, column].reshape(-1)[0])
    pressure = responses[measurement, receiver].copy()
    return Recording(pressure, rate_hz, delay_samples / rate_hz if rate_hz > 0.0 else 0.0)


def read_sofa_variables(content: bytes) -> tuple[Variables, str]:
    """Return the variables of a SOFA file, whatever its convention, and its data type.

    The type is FIR, FIR-E, TF, TF-E or SOS; "unknown" where the file does not say.
    """
    what = "this is not a SOFA file that can be read"
    needed = "a SOFA file (AES69, which is netCDF-4)"
    try:
        variables, attributes = hdf5_variables(content)
    except ValueError as error:
        old = content[:3] == b"CDF"
        found = "a file of netCDF-3" if old else str(error)
        hint = "nccopy -k nc4 old.sofa new.sofa" if old else "copy the file anew"
        raise InputError(what, found=found, needed=needed, hint=hint) from error
    if "SOFAConventions" not in attributes and attributes.get("Conventions") != "SOFA":
        found = "an HDF5 file without the attribute SOFAConventions"
        hint = "write it with a SOFA library, which adds the attribute"
        raise InputError(what, found=found, needed=needed, hint=hint)
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
