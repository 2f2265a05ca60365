"""SOFA files (AES69, which is netCDF-4)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray
from roomfit.files.responses.recordings import Recording, pick
from roomfit.files.schema import ResponseSpec
from roomfit.formats.hdf5 import Hdf5Variable, hdf5_variables
from roomfit.model.patterns import loudspeaker_axes

# Measurement, receiver, sample or frequency, emitter: the order of axes of AES69, from which the
# convention MultiSpeakerBRIR deviates.
_AXES = "MRNE"

Variables = Mapping[str, Hdf5Variable]  # by the names of AES69, such as "Data.IR"


def read_sofa(spec: ResponseSpec, content: bytes) -> Recording:
    """Return one measurement at one receiver of a SOFA file, as `spec` chooses them."""
    sofa, data_type = read_sofa_variables(content)
    responses = _all_data(sofa, "Data.IR")
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
    emitter = pick("emitter", spec.emitter_index, responses.shape[3], "emitter_index")
    rate_hz = float(rates_hz.reshape(-1)[min(measurement, rates_hz.size - 1)])
    # one for all measurements, or one for each: (I or M, R) and for FIR-E an axis of emitters
    delays = sofa_values(sofa, "Data.Delay")
    delays = np.zeros((1, 1)) if delays is None else np.atleast_2d(delays)
    at = zip((measurement, receiver, emitter), delays.shape, strict=False)
    delay_samples = float(delays[tuple(min(i, n - 1) for i, n in at)])
    pressure = responses[measurement, receiver, :, emitter].copy()
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
        hint = "nccopy -k nc4 old.sofa new.sofa" if old else "copy it anew, or raise the limit"
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
    values = _all_data(sofa, name)
    if values is not None and values.shape[3] != 1:
        what = "the SOFA file holds several emitters at once"
        needed, hint = "one emitter a file", "write one SOFA file for each emitter"
        raise InputError(what, found=f"{values.shape[3]} emitters", needed=needed, hint=hint)
    return None if values is None else values[:, :, :, 0]


def _all_data(sofa: Variables, name: str) -> FloatArray | None:
    """Return data as (n_measurements, n_receivers, n, n_emitters), None where there are none."""
    values = sofa_values(sofa, name)
    if values is None or values.ndim not in (3, 4):
        return None
    axes = sofa[name].axes
    if sorted(axes) == sorted(_AXES):
        values = values.transpose([axes.index(axis) for axis in _AXES])
    return values.reshape(*values.shape[:3], -1)


def sofa_points(sofa: Variables, name: str, n: int) -> FloatArray | None:
    """Return n positions as (n, 3) in Cartesian coordinates (m), or None if not so many.

    Refused are coordinates of another type, or in other units than metres and degrees.
    """
    values = sofa_values(sofa, name)
    if values is None or values.size != 3 * n:
        return None
    if values.ndim == 3:  # receiver, coordinate, measurement
        values = np.moveaxis(values, 1, 2)
    values = values.reshape(n, 3)
    kind = sofa[name].attributes.get("Type")
    view = sofa.get(name.replace("Up", "View"))
    if kind is None and view is not None:  # an Up shares the type of the View
        kind = view.attributes.get("Type")
    if kind not in (None, "cartesian", "spherical"):
        what, needed = "the SOFA file has coordinates of another type", "cartesian or spherical"
        hint = "directions on a grid instead of coefficients of spherical harmonics"
        raise InputError(what, where=name, found=f"Type {kind!r}", needed=needed, hint=hint)
    spherical, units = kind == "spherical", sofa[name].attributes.get("Units")
    # the length of a direction in Cartesian coordinates has no unit that matters
    if units is not None and (spherical or name.endswith("Position")):
        words = [word.rstrip("s") for word in str(units).lower().replace(",", " ").split()]
        found = [_SPELLINGS.get(word, word) for word in words]
        expected = ["degree", "degree", "metre"] if spherical else ["metre"] * len(found)
        if found != expected:
            what = "the SOFA file has coordinates in other units"
            needed = "degree, degree, metre" if spherical else "metre"
            hint = f"convert them, and set the attribute Units of {name}"
            raise InputError(what, where=name, found=repr(str(units)), needed=needed, hint=hint)
    if not spherical:
        return values
    azimuth, elevation = np.radians(values[:, 0]), np.radians(values[:, 1])
    across, height = values[:, 2] * np.cos(elevation), values[:, 2] * np.sin(elevation)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), height], axis=1)


# of the units that AES69 has
_SPELLINGS = {"meter": "metre", "m": "metre", "deg": "degree"}


class SofaPairs(NamedTuple):
    """The responses of a SOFA file, and where they were measured."""

    choices: list[dict[str, int]]  # what chooses each; nothing of the only one
    ends_m: FloatArray  # (2, n_responses, 3) of source and receiver, NaN where it is not known
    corner_m: FloatArray  # (3,), of its room, 0 without one
    lengths_m: tuple[float, float, float] | None
    temperature_c: float | None
    doubts: tuple[str, ...]  # what conventions write where nothing is known, and is not taken


_DEFAULT_ROOM = ((0.0, 0.0, 0.0), (1.0, 2.0, 3.0))  # RoomCornerA and B of AES69


def read_sofa_pairs(content: bytes) -> SofaPairs:
    """Return which responses a SOFA file holds, and positions, room and temperature if it says so.

    Without corners of a room, receivers that are all near zero are at a head or about a
    loudspeaker in a free field, or what libraries write where nothing is known.
    """
    sofa, _ = read_sofa_variables(content)
    data = _all_data(sofa, "Data.IR")
    m, r, _, e = (1, 1, 1, 1) if data is None else data.shape
    sources = _placed(sofa, "Source", "Emitter", m, e)
    receivers = _placed(sofa, "Listener", "Receiver", m, r)
    corners = np.array([_one(sofa, f"RoomCorner{e}", 1, (0.0, 0.0, 0.0))[0] for e in "AB"])
    doubts = []
    if np.array_equal(corners, _DEFAULT_ROOM):
        doubts.append("the room of 1 m x 2 m x 3 m is a default of SOFA, and not taken")
        corners[:] = 0.0
    x, y, z = np.ptp(corners, axis=0).tolist()
    is_room = x * y * z > 0.0
    unknown = 0.0 if is_room or np.abs(receivers).max(initial=0.0) > 0.5 else np.nan
    grid = [(i, j, k) for i in range(m) for j in range(r) for k in range(e)]
    ends_m = np.array([[sources[i, k], receivers[i, j]] for i, j, k in grid]).swapaxes(0, 1)
    several = {"measurement": m > 1, "receiver_index": r > 1, "emitter_index": e > 1}
    choices = [
        {key: i for (key, many), i in zip(several.items(), own, strict=True) if many}
        for own in grid
    ]
    kelvin = sofa_values(sofa, "RoomTemperature")
    celsius = None
    if kelvin is not None and kelvin.size == 1:
        unit = str(sofa["RoomTemperature"].attributes.get("Units", "kelvin")).lower()
        celsius = float(kelvin.reshape(-1)[0]) - (273.15 if unit.startswith("k") else 0.0)
        if celsius == -273.15:
            doubts.append("a temperature of 0 K is a default of SOFA, and not taken")
            celsius = None
    lengths = (x, y, z) if is_room else None
    corner = corners.min(axis=0)
    return SofaPairs(choices, ends_m + unknown, corner, lengths, celsius, tuple(doubts))


def _one(sofa: Variables, name: str, n: int, otherwise: tuple[float, ...]) -> FloatArray:
    """Return n points, or the only one, (n or 1, 3); another one where the file has none."""
    found = (sofa_points(sofa, name, k) for k in (n, 1))
    return next((p for p in found if p is not None), np.array([otherwise]))


def _placed(sofa: Variables, whole: str, part: str, m: int, n: int) -> FloatArray:
    """Return positions of the parts of a source or a listener, shape (m, n, 3), NaN for unknown."""
    base = _one(sofa, f"{whole}Position", m, (np.nan,) * 3)
    view = _one(sofa, f"{whole}View", m, (1.0, 0.0, 0.0))
    view, up = np.broadcast_arrays(view, _one(sofa, f"{whole}Up", m, (0.0, 0.0, 1.0)))
    axes = np.array([loudspeaker_axes(v, u) for v, u in zip(view, up, strict=True)])
    moved = sofa_points(sofa, f"{part}Position", n * m)  # with each measurement
    offsets = _one(sofa, f"{part}Position", n, (0.0, 0.0, 0.0))[None]
    if moved is not None:
        offsets = moved.reshape(n, m, 3).swapaxes(0, 1)
    return np.broadcast_to(base[:, None] + offsets @ axes, (m, n, 3))
