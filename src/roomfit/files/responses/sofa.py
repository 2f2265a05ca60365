"""SOFA files (AES69) with impulse responses."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.errors import InputError
from roomfit.files.responses.recording import Recording, pick
from roomfit.files.responses.spec import ResponseSpec
from roomfit.typing import FloatArray

# What netCDF4 and sofar raise on files that are not what they claim to be.
_UNREADABLE = (
    *(OSError, RuntimeError, ValueError, TypeError, KeyError, IndexError, AttributeError),
    *(MemoryError, OverflowError, UnicodeError),
)


def read_sofa(spec: ResponseSpec, content: bytes) -> Recording:
    """Return one measurement at one receiver of a SOFA file.

    Parameters
    ----------
    spec : ResponseSpec
        Chooses measurement and receiver.
    content : bytes
        The whole file.

    Raises
    ------
    InputError
        The reader is not installed, the file is no SOFA file or holds no impulse responses, several
        emitters at once, or no such measurement or receiver.
    """
    where = str(spec.path)
    sofa = opened_sofa(content, where)
    responses = real_array(getattr(sofa, "Data_IR", None))
    rates_hz = real_array(getattr(sofa, "Data_SamplingRate", None))
    if responses is None or rates_hz is None or responses.ndim not in (3, 4):
        raise InputError(
            "the SOFA file holds no impulse responses",
            where=where,
            found=f"data type {getattr(sofa, 'GLOBAL_DataType', 'unknown')!r}",
            needed="data type FIR with a sampling rate",
        )
    if responses.ndim == 4:  # FIR-E: measurement, receiver, sample, emitter in sofar's order
        if responses.shape[3] != 1:
            raise InputError(
                "the SOFA file holds several emitters at once",
                where=where,
                found=f"{responses.shape[3]} emitters",
                needed="one emitter a file",
            )
        responses = responses[:, :, :, 0]
    measurement = pick("measurement", spec.measurement, responses.shape[0], "measurement", where)
    receiver = pick("receiver", spec.receiver_index, responses.shape[1], "receiver_index", where)
    rate_hz = float(rates_hz.reshape(-1)[min(measurement, rates_hz.size - 1)])
    delay_samples = _delay_samples(sofa, measurement, receiver)
    pressure = responses[measurement, receiver].copy()
    return Recording(pressure, rate_hz, delay_samples / rate_hz if rate_hz > 0.0 else 0.0)


def opened_sofa(content: bytes, where: str) -> Any:
    """Return what the reader makes of a SOFA file.

    Raises
    ------
    InputError
        The reader is not installed, or this is no SOFA file.
    """
    try:
        import sofar
    except ImportError as error:
        raise InputError(
            "SOFA files need a reader that is not installed",
            where=where,
            found=str(error),
            hint='pip install "sofar>=1.2" "netCDF4<1.7.4"',
        ) from error
    # the netCDF library reads files, not memory; the copy has a plain name and no other writer
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "response.sofa"
        copy.write_bytes(content)
        try:
            return sofar.read_sofa(str(copy), verify=False, verbose=False)
        except _UNREADABLE as error:
            raise InputError(
                "this is not a SOFA file that can be read",
                where=where,
                found=f"{type(error).__name__}: {error}".replace(str(copy), where),
                needed="a SOFA file (AES69) of a known convention",
            ) from error


def _delay_samples(sofa: Any, measurement: int, receiver: int) -> float:
    """Return how many samples the file says its responses are to be delayed."""
    delays = real_array(getattr(sofa, "Data_Delay", None))
    if delays is None:
        return 0.0
    delays = np.atleast_2d(delays)  # sofar drops axes of length one
    row, column = min(measurement, delays.shape[0] - 1), min(receiver, delays.shape[1] - 1)
    return float(delays[row, column].reshape(-1)[0])


def real_array(value: Any) -> FloatArray | None:
    """Return real numbers as float64, or None for anything else."""
    array = np.asarray(value if value is not None else ())
    if array.size == 0 or array.dtype.kind not in "iuf":
        return None
    return np.asarray(array, dtype=np.float64)
