"""A campaign in the words of the science: what a campaign file says, checked and converted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from roomfit.air import Air
from roomfit.bands import OCTAVES_HZ, Bands, bands_between
from roomfit.errors import InputError, located
from roomfit.files.campaign.read import read_campaign_table
from roomfit.files.campaign.schema import (
    AirTable,
    CampaignTable,
    DesignTable,
    Directivity,
    IdentifyTable,
    ImpedanceTable,
    MaterialTable,
    MeasuredDirectivity,
    MeasurementTable,
    ReceiverTable,
    SourceTable,
)
from roomfit.files.responses.spec import ResponseSpec
from roomfit.files.rooms.spec import PolygonSpec, RoomSpec
from roomfit.response.directivity import FirstOrderBands
from roomfit.scene.scene import Point

Level = Literal["per-source", "per-file", "absolute"]
Use = Literal["fit", "validate"]


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredFile:
    """One measured response: where it lies, whose pair it is, and how it is to be used.

    Attributes
    ----------
    source, receiver : str
    response : ResponseSpec
    level : {"per-source", "per-file", "absolute"}
    use : {"fit", "validate"}
    latency_sd_s : float or None
        How uncertain the moment of emission is; None where nothing was told.
    """

    source: str
    receiver: str
    response: ResponseSpec
    level: Level
    use: Use
    latency_sd_s: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredTable:
    """One table of ISO 3382 values, and which of its rows are meant; None means all."""

    path: Path
    source: str | None
    receiver: str | None
    use: Use


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredSpectrum:
    """One file of damped pressures, for impedances; `level` is None where none was told."""

    source: str
    receiver: str
    path: Path
    level: Level | None
    use: Use


@dataclass(frozen=True, slots=True, eq=False)
class Campaign:
    """Everything that a campaign file says.

    Attributes
    ----------
    path : Path
        The file itself; paths in it are relative to its folder.
    room : RoomSpec
    air : Air
    sources, receivers : tuple of Point
        All that the file defines, measured or not.
    measurements : tuple of MeasuredFile
    tables : tuple of MeasuredTable
    bands : Bands
        Bands to fit.
    materials : mapping of name to MaterialTable
        What the file says of materials, for `material_knowledge`.
    method, model : str
    seed : int
    positions : {"auto", "fit", "fixed"}
        Whether told positions may move within their spread.
    wall_delays : bool
        Whether walls may delay what they reflect.
    smoothness_per_octave : float or None
        Standard deviation by which logit absorption changes from octave to octave.
    temperature_sd_c : float or None
    directivities : mapping of source name to what the file says of its directivity
        For `roomfit.files.campaign.directivity.campaign_directivities`; or what a fit found.
    spectra : tuple of MeasuredSpectrum
    impedance : ImpedanceTable
    design : DesignTable
    """

    path: Path
    room: RoomSpec
    air: Air
    sources: tuple[Point, ...]
    receivers: tuple[Point, ...]
    measurements: tuple[MeasuredFile, ...]
    tables: tuple[MeasuredTable, ...]
    bands: Bands
    materials: dict[str, MaterialTable]
    method: str
    model: str
    seed: int
    positions: Literal["auto", "fit", "fixed"] = "auto"
    wall_delays: bool = True
    smoothness_per_octave: float | None = None
    temperature_sd_c: float | None = None
    directivities: Mapping[str, str | Directivity | MeasuredDirectivity | FirstOrderBands] = field(
        default_factory=dict
    )
    spectra: tuple[MeasuredSpectrum, ...] = ()
    impedance: ImpedanceTable = field(default_factory=ImpedanceTable)
    design: DesignTable = field(default_factory=DesignTable)


def read_campaign(path: Path, *, to_fit: bool = True) -> Campaign:
    """Read a campaign file.

    Parameters
    ----------
    path : Path
    to_fit : bool
        Whether there must be a measurement to fit; a prediction or a design needs none.

    Raises
    ------
    InputError
        See `read_campaign_table`.
    """
    path = Path(path)
    table = read_campaign_table(path, to_fit=to_fit)
    settings = table.identify
    return Campaign(
        path,
        _room_spec(path, table),
        _air(path, table.air),
        _points(table.sources),
        _points(table.receivers),
        tuple(_measured_file(path, m) for m in table.measurements if m.file is not None),
        tuple(_measured_table(path, m) for m in table.measurements if m.parameters is not None),
        _bands(path, settings),
        dict(table.materials),
        settings.method,
        settings.model,
        settings.seed,
        settings.positions,
        settings.wall_delays,
        settings.smoothness_per_octave,
        table.air.temperature_sd_c,
        {name: source.directivity for name, source in table.sources.items()},
        tuple(_measured_spectrum(path, m) for m in table.measurements if m.spectrum is not None),
        table.impedance,
        table.design,
    )


def input_files(campaign: Campaign) -> tuple[Path, ...]:
    """Return every file whose content decides the answer, each once, the campaign's own first."""
    room = campaign.room
    files = [campaign.path]
    if room.file is not None:
        files.append(room.file)
    if room.polygons is not None:
        files += [*room.polygons.corners, *room.polygons.planes, *room.polygons.replace.values()]
    files += [m.response.path for m in campaign.measurements]
    files += [m.response.excitation for m in campaign.measurements if m.response.excitation]
    files += [t.path for t in campaign.tables]
    files += [s.path for s in campaign.spectra]
    files += _directivity_files(campaign)
    return tuple(dict.fromkeys(files))


def _room_spec(path: Path, table: CampaignTable) -> RoomSpec:
    room = table.room
    kinds = [k for k in ("file", "shoebox", "polygons") if getattr(room, k) is not None]
    if len(kinds) != 1:
        raise InputError(
            "the room needs exactly one description",
            where=f"{path}, room",
            found=", ".join(kinds) or "none",
            needed="one of file, shoebox, polygons",
        )
    folder = path.parent
    polygons = None
    if room.polygons is not None:
        polygons = PolygonSpec(
            corners=tuple(folder / f for f in room.polygons.corners),
            planes=tuple(folder / f for f in room.polygons.planes),
            replace={key: folder / f for key, f in room.polygons.replace.items()},
            drop=tuple(room.polygons.drop),
            sides=dict(room.polygons.sides),
        )
    return RoomSpec(
        file=None if room.file is None else folder / room.file,
        shoebox=room.shoebox,
        polygons=polygons,
        unit=room.unit,
        up=room.up,
        materials=dict(room.materials),
    )


def _directivity_files(campaign: Campaign) -> list[Path]:
    told = campaign.directivities.values()
    named = [t for t in told if isinstance(t, str) and t not in ("omni", "fit")]
    named += [t.file for t in told if isinstance(t, MeasuredDirectivity)]
    return [campaign.path.parent / name for name in named]


def _points(tables: Mapping[str, SourceTable | ReceiverTable]) -> tuple[Point, ...]:
    return tuple(Point(n, np.array(t.position), t.position_sd) for n, t in tables.items())


def _measured_table(path: Path, row: MeasurementTable) -> MeasuredTable:
    return MeasuredTable(path.parent / str(row.parameters), row.source, row.receiver, row.use)


def _measured_spectrum(path: Path, row: MeasurementTable) -> MeasuredSpectrum:
    told = row.level if "level" in row.model_fields_set else None
    spectrum = path.parent / str(row.spectrum)
    return MeasuredSpectrum(str(row.source), str(row.receiver), spectrum, told, row.use)


def _measured_file(path: Path, row: MeasurementTable) -> MeasuredFile:
    # `read_campaign_table` has made sure that all three are given
    return MeasuredFile(
        str(row.source),
        str(row.receiver),
        ResponseSpec(
            path=path.parent / str(row.file),
            channel=row.channel,
            variable=row.variable,
            sampling_rate_variable=row.sampling_rate_variable,
            sampling_rate_hz=row.sampling_rate_hz,
            measurement=row.measurement,
            receiver_index=row.receiver_index,
            time_zero=row.time_zero,
            latency_s=row.latency_s,
            excitation=None if row.excitation is None else path.parent / row.excitation,
            excitation_channel=row.excitation_channel,
        ),
        row.level,
        row.use,
        row.latency_sd_s,
    )


def _air(path: Path, table: AirTable) -> Air:
    with located(str(path)):
        return Air(
            table.temperature_c,
            table.humidity_percent,
            table.pressure_kpa,
            table.speed_of_sound_m_s,
            table.attenuation,
        )


def _bands(path: Path, table: IdentifyTable) -> Bands:
    if table.from_hz > table.to_hz:
        raise InputError(
            "the lowest band lies above the highest",
            where=f"{path}, identify",
            found=f"from_hz = {table.from_hz:g}, to_hz = {table.to_hz:g}",
            needed="from_hz <= to_hz",
        )
    with located(f"{path}, identify.bands"):
        if isinstance(table.bands, str):
            return bands_between(table.bands, table.from_hz, table.to_hz)
        octaves = set(table.bands) <= set(OCTAVES_HZ)
        return Bands("octave" if octaves else "third-octave", np.array(table.bands))
