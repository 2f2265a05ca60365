"""The keys of a campaign file, format_version 1, and what each may hold."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Position = tuple[float, float, float]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
PerBand = Fraction | list[Fraction]


class Table(BaseModel):
    """A table of the file: an unknown key is an error, and nothing changes after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False, allow_inf_nan=False)


class PolygonTable(Table):
    """``[room] polygons``: corner and plane tables."""

    corners: list[str] = Field(min_length=1)
    planes: list[str] = Field(min_length=1)
    replace: dict[str, str] = {}
    drop: list[int] = []
    sides: dict[str, Literal[1, 2]] = {}


class RoomTable(Table):
    """``[room]``."""

    file: str | None = None
    shoebox: tuple[float, float, float] | None = None
    polygons: PolygonTable | None = None
    unit: str | None = None
    up: Literal["z", "y"] | None = None
    materials: dict[str, str] = {}


class AirTable(Table):
    """``[air]``."""

    temperature_c: float = 20.0
    temperature_sd_c: float | None = Field(default=None, ge=0.0)
    humidity_percent: float = 50.0
    pressure_kpa: float = 101.325
    speed_of_sound_m_s: float | None = None
    attenuation: Literal["iso9613", "none"] = "iso9613"


class Spectrum(Table):
    """Values at frequencies, for scattering."""

    centres_hz: list[float] = Field(min_length=1)
    values: list[Fraction] = Field(min_length=1)


class Prior(Table):
    """What is known of an absorption beforehand: mean and standard deviation of alpha."""

    mean: PerBand
    sd: float | list[float]


class MaterialTable(Table):
    """``[materials.NAME]``."""

    scattering: Fraction | list[Fraction] | Spectrum | Literal["fit"] | None = None
    absorption: PerBand | None = None
    prior: Prior | str | None = None
    bounds: tuple[Fraction, Fraction] | None = None
    same_absorption_as: str | None = None
    delay_sd_ms: float | None = Field(default=None, ge=0.0, le=5.0)
    impedance: Literal["spline", "miki", "resonator", "panel", "constant", "auto"] | None = None
    impedance_start: dict[str, float | list[float]] | None = None


class Directivity(Table):
    """First-order directivity of a source."""

    aim: Position
    order: Literal[1] = 1
    b: float = Field(ge=0.0, le=10.0)
    b_sd: float = Field(default=0.0, ge=0.0, le=10.0)


class MeasuredDirectivity(Table):
    """Directivity of a source from a SOFA file, and how the source stood in the room."""

    file: str
    aim: Position = (1.0, 0.0, 0.0)
    up: Position = (0.0, 0.0, 1.0)


class SourceTable(Table):
    """``[sources.NAME]``."""

    position: Position
    position_sd: float | None = Field(default=None, ge=0.0)
    directivity: str | Directivity | MeasuredDirectivity = "omni"


class ReceiverTable(Table):
    """``[receivers.NAME]``."""

    position: Position
    position_sd: float | None = Field(default=None, ge=0.0)


class MeasurementTable(Table):
    """``[[measurements]]``."""

    source: str | None = None
    receiver: str | None = None
    file: str | None = None
    excitation: str | None = None
    excitation_channel: int | None = Field(default=None, ge=0)
    parameters: str | None = None
    spectrum: str | None = None
    channel: int | None = Field(default=None, ge=0)
    variable: str | None = None
    sampling_rate_variable: str | None = None
    sampling_rate_hz: float | None = Field(default=None, gt=0.0)
    measurement: int | None = Field(default=None, ge=0)
    receiver_index: int | None = Field(default=None, ge=0)
    time_zero: Literal["emission", "direct", "unknown"] = "emission"
    latency_s: float = Field(default=0.0, ge=-10.0, le=10.0)
    latency_sd_s: float | None = Field(default=None, ge=0.0, le=0.1)
    level: Literal["per-source", "per-file", "absolute"] = "per-source"
    use: Literal["fit", "validate"] = "fit"


class IdentifyTable(Table):
    """``[identify]``."""

    bands: Literal["octave", "third-octave"] | list[float] = "octave"
    from_hz: float = Field(default=125.0, gt=0.0)
    to_hz: float = Field(default=4000.0, gt=0.0)
    method: Literal["auto", "simplex", "annealing", "least-squares", "certified", "posterior"] = (
        "auto"
    )
    model: Literal["auto", "energy", "coherent"] = "auto"
    positions: Literal["auto", "fit", "fixed"] = "auto"
    wall_delays: bool = True
    smoothness_per_octave: float | None = Field(default=None, gt=0.0)
    seed: int = Field(default=1, ge=0, lt=2**63)


class ImpedanceTable(Table):
    """``[impedance]``: what ``roomfit impedance`` fits, and how."""

    from_hz: float = Field(default=100.0, gt=0.0)
    to_hz: float = Field(default=1000.0, gt=0.0)
    step_hz: float = Field(default=10.0, gt=0.0)
    tau_s: float = Field(default=0.015, gt=0.0, le=1.0)
    gain: Literal["auto", "known", "common", "source", "pair", "spectrum", "pair-spectrum"] = "auto"
    positions: Literal["fit", "fixed"] = "fit"
    speed_of_sound: Literal["fit", "fixed"] = "fit"
    random_starts: int = Field(default=3, ge=0, le=100)


class DesignTable(Table):
    """``[design]``: where ``roomfit design`` may put sources and receivers."""

    sources: list[Position] = []
    receivers: list[Position] = []
    new_sources: int = Field(default=8, ge=0, le=1000)
    grid_m: float | None = Field(default=None, gt=0.0)
    source_heights_m: tuple[float, float] = (1.0, 2.0)
    receiver_heights_m: tuple[float, float] = (1.0, 2.0)
    region_m: tuple[Position, Position] | None = None
    wall_distance_m: float = Field(default=1.0, ge=0.01)
    source_distance_m: float | None = Field(default=None, ge=0.1)
    receiver_distance_m: float = Field(default=2.0, ge=0.0)
    most_sources: int | None = Field(default=None, ge=1)
    criterion: Literal["determinant", "mean", "worst"] = "determinant"
    decay_range_db: float = Field(default=45.0, ge=10.0, le=120.0)
    position_sd: float = Field(default=0.02, ge=0.0)
    level: Literal["per-source", "per-file", "absolute"] = "per-source"
    draws: int = Field(default=2, ge=1, le=100)


class CampaignTable(Table):
    """The whole file."""

    format_version: Literal[1] = 1
    room: RoomTable
    air: AirTable = AirTable()
    materials: dict[str, MaterialTable] = {}
    sources: dict[str, SourceTable] = {}
    receivers: dict[str, ReceiverTable] = {}
    measurements: list[MeasurementTable] = []
    identify: IdentifyTable = IdentifyTable()
    impedance: ImpedanceTable = ImpedanceTable()
    design: DesignTable = DesignTable()
