"""Directivities of loudspeakers from SOFA files (AES69)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from roomfit.base.arguments import check_range
from roomfit.base.bands import Bands
from roomfit.base.door import read_bytes
from roomfit.base.errors import InputError, located
from roomfit.base.typing import FloatArray
from roomfit.files.responses.sofa import (
    Variables,
    read_sofa_variables,
    sofa_data,
    sofa_points,
    sofa_values,
)
from roomfit.model.patterns import MeasuredDirectivity, loudspeaker_axes, measured_directivity

_LARGEST = 1e100  # far above any, far below where squares overflow


def read_directivity(
    path: Path, bands: Bands, aim: ArrayLike = (1.0, 0.0, 0.0), up: ArrayLike = (0.0, 0.0, 1.0)
) -> MeasuredDirectivity:
    """Return the directivity of a loudspeaker in every band, of unit sound power.

    Read are transfer functions (data type TF, as in FreeFieldDirectivityTF and GeneralTF) and
    impulse responses (data type FIR) that receivers all around a source have measured, one
    measurement; energies are means of the squared magnitude over the frequencies of each band.

    `aim` and `up`, shape (3,), are where the front and the top of the loudspeaker point in the
    room. In the file's own frame they are `SourceView` and `SourceUp`, x and z without these.
    """
    content = read_bytes(path, "directivity file")
    with located(str(path)):
        sofa, data_type = read_sofa_variables(content)
        frequencies_hz, magnitude = _spectra(sofa, data_type)
        if not (magnitude < _LARGEST).all():  # written so that nan is refused, too
            raise InputError(
                "a magnitude of the directivity is out of range",
                found=f"{np.max(magnitude):g}",
                needed=f"less than {_LARGEST:g}",
                hint="divide by the magnitude at the front: the level does not matter",
            )
        directions = _directions(sofa, magnitude.shape[0])
        energy = np.empty((len(directions), len(bands)))
        octaves = np.log2(np.maximum(frequencies_hz, 1e-3))
        for band, (low, high) in enumerate(zip(bands.lower_hz, bands.upper_hz, strict=True)):
            inside = (frequencies_hz >= low) & (frequencies_hz < high)
            if not inside.any():  # the one that is nearest, which the band's own centre rounds to
                off = np.abs(octaves - np.log2(bands.centres_hz[band]))
                inside = np.arange(len(off)) == np.argmin(off)
                if off.min() > 1.01 * np.log2(high / low) / 2.0:
                    raise InputError(
                        "the directivity has no value for a band",
                        found=f"{frequencies_hz.min():g} to {frequencies_hz.max():g} Hz",
                        needed=f"a frequency from {low:g} to {high:g} Hz",
                        hint="choose other bands with from_hz and to_hz",
                    )
            energy[:, band] = np.mean(magnitude[:, inside] ** 2, axis=1)
    return measured_directivity(directions, energy, bands.centres_hz, loudspeaker_axes(aim, up))


def _spectra(sofa: Variables, data_type: str) -> tuple[FloatArray, FloatArray]:
    """Return frequencies (n,) and magnitudes (n_directions, n)."""
    impulse, rates_hz = sofa_data(sofa, "Data.IR"), sofa_values(sofa, "Data.SamplingRate")
    if impulse is not None and rates_hz is not None and rates_hz.size == 1:
        samples, rate_hz = _one_measurement(impulse), float(rates_hz.reshape(-1)[0])
        check_range("Data.SamplingRate", rate_hz, 1e-3, 1e9, "Hz")
        frequencies_hz = np.fft.rfftfreq(samples.shape[1], 1.0 / rate_hz)
        return np.asarray(frequencies_hz), np.asarray(np.abs(np.fft.rfft(samples, axis=1)))
    real, imaginary = (sofa_data(sofa, f"Data.{part}") for part in ("Real", "Imag"))
    frequencies = sofa_values(sofa, "N")
    if real is None or imaginary is None or frequencies is None or real.shape != imaginary.shape:
        raise InputError(
            "the SOFA file holds no directivity",
            found=f"data type {data_type!r}",
            needed="data type TF with its frequencies, or FIR with a sampling rate",
            hint="convert it to FreeFieldDirectivityTF, or give another file",
        )
    magnitude = np.hypot(_one_measurement(real), _one_measurement(imaginary))
    if frequencies.size != magnitude.shape[1]:
        raise InputError(
            "the SOFA file has another number of frequencies than of values",
            found=f"{frequencies.size} and {magnitude.shape[1]}",
            needed=f"{magnitude.shape[1]} frequencies N, one a value",
            hint="write the file again, with N along the values",
        )
    return np.asarray(frequencies.reshape(-1)), np.asarray(magnitude)


def _one_measurement(data: FloatArray) -> FloatArray:
    """Return data as (n_receivers, n): one measurement, or one receiver at many positions."""
    if 1 in data.shape[:2]:
        return data.reshape(-1, data.shape[2])
    what = "the SOFA file is no directivity of one source"
    needed, hint = "one measurement by many receivers", "keep a single measurement of the source"
    raise InputError(what, found=f"data of shape {data.shape}", needed=needed, hint=hint)


def _directions(sofa: Variables, n: int) -> FloatArray:
    """Return directions in the loudspeaker's own frame: x front, y left, z top."""
    positions = sofa_points(sofa, "ReceiverPosition", n)
    if positions is None:
        raise InputError(
            "the SOFA file does not say where its receivers stood",
            found="no such positions",
            needed=f"ReceiverPosition of {n} receivers",
            hint="write ReceiverPosition, one row for each receiver",
        )
    # receivers are specified relative to the listener
    source, listener = (sofa_points(sofa, f"{end}Position", 1) for end in ("Source", "Listener"))
    positions = positions + (0.0 if listener is None else listener)
    positions = positions - (0.0 if source is None else source)
    view, top = (sofa_points(sofa, f"Source{way}", 1) for way in ("View", "Up"))
    axes = loudspeaker_axes(
        np.array([1.0, 0.0, 0.0]) if view is None else view[0],
        np.array([0.0, 0.0, 1.0]) if top is None else top[0],
    )
    return np.asarray(positions @ axes.T)
