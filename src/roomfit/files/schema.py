"""A campaign: the keys of its file, format_version 1, and what they mean together.

Docstrings of keys are their descriptions in the JSON schema that ``roomfit schema`` prints.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PrivateAttr
from pydantic_core import PydanticUndefined

from roomfit.base.air import Air
from roomfit.base.arguments import check_range
from roomfit.base.bands import Bands, bands_between, bands_of
from roomfit.base.errors import InputError, located
from roomfit.base.findings import Finding
from roomfit.materials.priors import PRODUCT_SD, PRODUCT_SDS
from roomfit.room.scene import Point, PointGroup
from roomfit.settings import SETTING_LIMITS, Method, Settings
from roomfit.signals.measurement import Level

BECAUSE = "because"  # why the range of a number ends where it does, in its schema


def limited(low: float, high: float, why: str, default: Any = PydanticUndefined) -> Any:
    """Return the range of a number of the file, and why it ends there: a refusal says it."""
    return Field(default, ge=low, le=high, json_schema_extra={BECAUSE: why})


Fraction = Annotated[float, limited(0.0, 1.0, "a share of energy")]
PerBand = Fraction | list[Fraction]
# smaller ones cannot be distinguished from none, and their logit has no bounds
InnerFraction = Annotated[
    float, limited(1e-3, 0.999, "0 and 1 have no logit; what is known is fixed: absorption = ...")
]
PriorSd = Annotated[
    float, limited(1e-4, 1.0, "absorption lies between 0 and 1; what is known is fixed")
]
Metre = Annotated[float, limited(0.0, 1.0, "m; what is off by more must be measured again")]
Coordinate = Annotated[float, limited(-1e6, 1e6, "m; the corners of a room are not farther off")]
Position = tuple[Coordinate, Coordinate, Coordinate]
Height = Annotated[float, limited(0.0, 1e4, "m above the lowest point of a room")]
Number = Annotated[int, limited(0, 10**6, "counted from 0; no file holds more")]
Strength = Annotated[float, limited(0.0, 10.0, "1 is a cardioid; beyond 10 nothing changes")]
Hertz = Annotated[float, limited(1.0, 1e5, "Hz; bands are defined and sound is recorded there")]


class Table(BaseModel):
    """A table of the file: an unknown key is an error, and nothing changes after reading."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        strict=False,
        allow_inf_nan=False,
        use_attribute_docstrings=True,
    )


def the_one(table: Table, keys: tuple[str, ...], what: str, where: str, hint: str) -> None:
    """Refuse a table that has none or several of some keys."""
    given = [key for key in keys if getattr(table, key) is not None]
    if len(given) != 1:
        found, needed = ", ".join(given) or "none", f"one of {', '.join(keys)}"
        raise InputError(what, where=where, found=found, needed=needed, hint=hint)


class PolygonSpec(Table):
    """``[room] polygons``: corner and plane tables."""

    corners: tuple[Path, ...] = Field(min_length=1)
    """CSV files of corners: number, x, y, z. A later file replaces corners of an earlier one."""
    planes: tuple[Path, ...] = Field(min_length=1)
    """CSV files of planes: number, material, area, and one corner number after the other."""
    replace: dict[str, Path] = {}
    """A plane's number, and the CSV file of planes that replace it."""
    drop: tuple[int, ...] = ()
    """Numbers of planes to leave out."""


class RoomSpec(Table):
    """``[room]``: which room to read, and how to understand it."""

    file: Path | None = None
    """OBJ, PLY, STL, GLB, CATT-Acoustic (.geo), DXF, COLLADA (.dae), IFC,
    SketchUp (.skp), or a scan by Apple's RoomPlan (.json, .usdz)."""
    space: str | None = None
    """Of a building model (IFC) or a scan (JSON): name of the room, where it has several."""
    shoebox: tuple[float, float, float] | None = None
    """Three lengths along x, y and z of a box with one corner at the origin."""
    polygons: PolygonSpec | None = None
    """Tables of corners and planes."""
    plan: list[tuple[Coordinate, Coordinate]] | None = Field(default=None, min_length=3)
    """Corners x, y of the floor in their order around it, under upright walls."""
    height: Height | list[Height] | None = None
    """Of a plan: of the ceiling, or above each corner; with two highest corners a gabled roof."""
    unit: str | None = None
    """m, mm, cm, ft or in; required where the file states none (OBJ, PLY, STL)."""
    up: Literal["z", "y"] | None = None
    """Axis that points up in the file. Default: y for GLB, COLLADA's own, z for all others."""
    materials: dict[str, str] = {}
    """From names of surfaces, groups or the file's own materials to names of materials."""
    lengths_sd: tuple[Metre, Metre, Metre] | None = None
    """Of a shoebox: standard deviations in m of its lengths, which then are fitted; 0: exact."""

    def model_post_init(self, _: Any, /) -> None:
        """Refuse a room without a description, or with two, and a space of a file without them."""
        what, hint = "the room needs exactly one description", "keep the one that is as the room is"
        the_one(self, ("file", "shoebox", "polygons", "plan"), what, "room", hint)
        if self.height is not None and self.plan is None:
            what, found = "a height without a plan", f"height = {self.height}"
            hint = "leave height out: files, boxes and polygons have their own"
            needed = "plan = [[x, y], ...]"
            raise InputError(what, where="room", found=found, needed=needed, hint=hint)
        if self.space is not None and (self.file or Path()).suffix.lower() not in _OF_SEVERAL:
            what = "only a building model and a scan have spaces"
            needed = f"a file of {' or '.join(_OF_SEVERAL)}"
            hint = "leave space out"
            raise InputError(what, where="room", found=self.space, needed=needed, hint=hint)

    def within(self, folder: Path) -> RoomSpec:
        """Return it with paths that were relative to a folder."""
        polygons = None
        if (own := self.polygons) is not None:
            paths: dict[str, Any] = {
                "corners": tuple(folder / f for f in own.corners),
                "planes": tuple(folder / f for f in own.planes),
                "replace": {key: folder / f for key, f in own.replace.items()},
            }
            polygons = own.model_copy(update=paths)
        file = None if self.file is None else folder / self.file
        return self.model_copy(update={"file": file, "polygons": polygons})


_OF_SEVERAL = (".ifc", ".json")  # files that may have several rooms


class GroupTable(Table):
    """``[groups.NAME]``: positions with one common offset."""

    members: list[str] = Field(min_length=1)
    """Names of sources and receivers; * and ? stand for any text."""
    sd: Metre | tuple[Metre, Metre, Metre]
    """Standard deviation of the common offset in m: one number, or one for each axis; 0: exact."""


class AirTable(Table):
    """``[air]``."""

    temperature_c: float = 20.0
    """Temperature in degrees Celsius, -20 to 50."""
    temperature_sd_c: float | None = limited(*SETTING_LIMITS["temperature_sd_c"], None)
    """Its standard deviation, from which the prior of the speed of sound follows."""
    humidity_percent: float = 50.0
    """Relative humidity, 0 to 100."""
    pressure_kpa: float = 101.325
    """Static pressure, 50 to 120."""
    speed_of_sound_m_s: float | None = None
    """In place of the one that follows from the temperature."""
    attenuation: Literal["iso9613", "none"] = "iso9613"
    """Attenuation of sound by air: by ISO 9613-1, or none."""


class Spectrum(Table):
    """Values at frequencies, whatever bands are fitted."""

    centres_hz: list[Hertz] = Field(min_length=1)
    """Frequencies of the values, in any order."""
    values: list[Fraction] = Field(min_length=1)
    """One for each frequency."""


class Prior(Table):
    """Prior of an absorption coefficient: its mean and standard deviation."""

    centres_hz: list[Hertz] | None = None
    """Frequencies of lists of `mean` and `sd`, where they are not those of the fitted bands."""
    mean: InnerFraction | list[InnerFraction]
    """Of the absorption coefficient: one number, or one for each band."""
    sd: PriorSd | list[PriorSd]
    """Standard deviation of the absorption coefficient: one number, or one for each band."""


class MaterialTable(Table):
    """``[materials.NAME]``."""

    scattering: Fraction | list[Fraction] | Spectrum | Literal["fit"] | None = None
    """Scattering coefficient, ISO 17497-1: number, list by band, {centres_hz, values} or "fit"."""
    absorption: PerBand | Spectrum | str | None = None
    """Known, and fixed: number, list by band, {centres_hz, values} or entry of the catalogue."""
    prior: Prior | str | None = None
    """{mean, sd} of the absorption coefficient, or the name of an entry of the catalogue."""
    bounds: tuple[Fraction, Fraction] | None = None
    """Lowest and highest absorption."""
    same_absorption_as: str | None = None
    """Another material of the room that has the same absorption."""
    product: str | None = None
    """What the material is made of: a table [products.NAME]."""
    delay_sd_ms: float | None = limited(0.0, 5.0, "ms; porous layers delay by tenths", None)
    """Standard deviation of the delay of its reflections in ms; 0: none. Default: 0.2."""
    impedance: Literal["spline", "constant"] | None = None
    """For `roomfit impedance`: what its reflection coefficient is like over frequency."""


class ProductTable(Table):
    """``[products.NAME]``: what all materials of one product have in common."""

    sd: float = limited(
        *PRODUCT_SDS, "in logit; equal walls share one: same_absorption_as", PRODUCT_SD
    )
    """How far, in logit, each material lies from what they have in common."""
    prior: Prior | str | None = None
    """Of the absorption that they have in common."""
    bounds: tuple[Fraction, Fraction] | None = None
    """Lowest and highest absorption."""


ObjectArea = Annotated[float, limited(0.0, 1e5, "m2; no hall holds more absorption")]
ObjectAreaLaw = Annotated[float, limited(1e-4, 1e5, "m2; what is known is absorption_area_m2")]


class AreaSpectrum(Spectrum):
    """Equivalent absorption areas at frequencies, whatever bands are fitted."""

    values: list[ObjectArea] = Field(min_length=1)
    """One for each frequency, in m2."""


class AreaPrior(Prior):
    """Prior of an equivalent absorption area: its mean and standard deviation."""

    mean: ObjectAreaLaw | list[ObjectAreaLaw]
    """In m2: one number, or one for each band."""
    sd: ObjectAreaLaw | list[ObjectAreaLaw]
    """Standard deviation in m2: one number, or one for each band."""


class ObjectTable(Table):
    """``[objects.NAME]``: what absorbs in the volume of the room, as people or chairs."""

    absorption_area_m2: ObjectArea | list[ObjectArea] | AreaSpectrum | str | None = None
    """Known equivalent absorption area in m2, or an entry of the catalogue; of one piece, or of
    1 m2 of floor."""
    prior: AreaPrior | str | None = None
    """{mean, sd} of that area in m2, or an entry of the catalogue: it then is fitted."""
    count: float | None = limited(0.0, 1e5, "no hall seats more", None)
    """How many pieces there are. Default: 1."""
    floor_area_m2: ObjectArea | None = None
    """In place of `count`: floor in m2 on which people or seats stand, the area being of 1 m2."""
    outlines: list[Annotated[list[Position], Field(min_length=3)]] | None = None
    """In place of `count`: corners, x, y, z in m on the floor, of each block of seats. Its area is
    that of the block and of a strip along its free edges."""
    edge_m: float = limited(0.0, 2.0, "m; tables of seats have 0.5", 0.5)
    """Width of that strip, up to a wall or half an aisle; 0: none."""
    states: list[str] | None = None
    """States of the room in which it is there, "" as described. Default: all."""


class Directivity(Table):
    """First-order directivity of a source."""

    aim: Position
    """The axis, in the room's frame, of any length."""
    order: Literal[1] = 1
    """First order, the only one."""
    b: Strength
    """Amplitude 1 + b cos of the angle to the axis: 0 is omnidirectional, 1 a cardioid."""
    b_sd: Strength = 0.0
    """Standard deviation of b; above 0 the pattern is fitted."""


class MeasuredDirectivity(Table):
    """Directivity of a source from a SOFA file, and how the source stood in the room."""

    file: str
    """A SOFA file of responses all around the source."""
    aim: Position = (1.0, 0.0, 0.0)
    """Where the front of the source pointed."""
    up: Position = (0.0, 0.0, 1.0)
    """Where the top of the source pointed."""


class SharedDirectivity(Table):
    """Directivity of a source that is one of several of a make, and where it aimed."""

    loudspeaker: str
    """The table [loudspeakers.NAME] to which the source belongs."""
    aim: Position
    """Where the front of the source pointed."""
    up: Position = (0.0, 0.0, 1.0)
    """Where the top of the source pointed."""


class LoudspeakerTable(Table):
    """``[loudspeakers.NAME]``: what all sources of one make have in common."""

    directivity: str = "fit"
    """"fit", or a SOFA file of responses all around the loudspeaker."""
    b_sd: float = limited(1e-3, 10.0, "0 would be omnidirectional: leave the table out", 0.5)
    """Prior standard deviation of the coefficients of a pattern that is fitted."""


SourceDirectivity = str | Directivity | MeasuredDirectivity | SharedDirectivity


class ReceiverTable(Table):
    """``[receivers.NAME]``."""

    position: Position
    """x, y, z in m, z up, in the room's frame."""
    position_sd: Metre | None = None
    """Standard deviation of each coordinate in m; 0: exact. Default: 0.02."""


class SourceTable(ReceiverTable):
    """``[sources.NAME]``."""

    directivity: SourceDirectivity = "omni"
    """"omni", "fit", a SOFA file, or a table."""


class _ResponseKeys(Table):
    """How a response is read from its file."""

    excitation: Path | None = None
    """The sweep as it was played (WAV): `file` is its recording, and is deconvolved."""
    excitation_channel: Number | None = None
    """Channel of the excitation, from 0."""
    channel: Number | None = None
    """WAV: channel; MAT: column; from 0. Required where there are several."""
    variable: str | None = None
    """MAT: name of the array of responses."""
    sampling_rate_variable: str | None = None
    """MAT: name of the variable that states the sampling rate."""
    sampling_rate_hz: (
        Annotated[float, limited(100.0, 1e7, "Hz; sound of walls is recorded with 8 to 192 kHz")]
        | None
    ) = None
    """Sampling rate, where the file states none."""
    measurement: Number | None = None
    """SOFA: which measurement, from 0."""
    receiver_index: Number | None = None
    """SOFA: which receiver, from 0."""
    emitter_index: Number | None = None
    """SOFA: which emitter, from 0."""
    time_zero: Literal["emission", "direct", "unknown"] = "emission"
    """What the first sample is: emission by a common clock, the direct sound, or unknown."""
    latency_s: float = limited(-10.0, 10.0, "s; cut the file beyond that", 0.0)
    """Delay of the measuring chain in s: from the first sample to emission."""


class ResponseSpec(_ResponseKeys):
    """One response in a file, as a campaign names it."""

    path: Path
    """Recognised by its suffix."""

    def __init__(self, path: Path, **keys: Any) -> None:
        super().__init__(path=path, **keys)  # type: ignore[call-arg]

    @property
    def where(self) -> str:
        """The file and the part of it, as findings name them."""
        chosen = (
            self.channel,
            self.variable,
            self.measurement,
            self.receiver_index,
            self.emitter_index,
        )
        part = ", ".join(str(c) for c in chosen if c is not None)
        return f"{self.path}[{part}]" if part else str(self.path)


class DefaultsTable(_ResponseKeys):
    """``[defaults]``: what holds of every measurement that does not say otherwise."""

    latency_sd_s: float | None = limited(0.0, 0.1, 's; beyond that time_zero = "unknown"', None)
    """Its standard deviation in s. Default: 0.02 ms for emission, else 0.1 ms."""
    level: Literal["per-source", "per-file", "absolute"] = "per-source"
    """Files that share an unknown gain: those of a source, none, or all levels are absolute."""
    use: Literal["fit", "validate"] = "fit"
    """Fitted, or predicted and compared only."""
    state: str = ""
    """State of the room: one of [[states]]."""


class MeasurementTable(DefaultsTable):
    """``[[measurements]]``."""

    source: str = ""
    """Name of a source of this file."""
    receiver: str = ""
    """Name of a receiver of this file."""
    file: str | None = None
    """Impulse response: WAV, MAT, SOFA or export of REW; with `excitation` a recorded sweep."""
    parameters: str | None = None
    """In place of `file`: a CSV table of ISO 3382 values."""
    spectrum: str | None = None
    """In place of `file`: damped pressures (.npz), for `roomfit impedance`."""

    @property
    def path(self) -> Path:
        """The file that holds what was measured."""
        return Path(self.file or self.parameters or self.spectrum or "")

    @property
    def stated_level(self) -> Level | None:
        """The level, None where neither the row nor the defaults state it."""
        return self.level if "level" in self.model_fields_set else None

    @property
    def response(self) -> ResponseSpec:
        """How the response is to be read."""
        keys = {name: getattr(self, name) for name in _ResponseKeys.model_fields}
        return ResponseSpec(self.path, **keys)


class StateTable(Table):
    """``[[states]]``: the same room with other materials on some of its surfaces."""

    name: str = Field(min_length=1)
    """What measurements refer to with `state`."""
    materials: dict[str, str] = Field(min_length=1)
    """As [room.materials]; what is not named stays."""


class IdentifyTable(Table):
    """``[identify]``."""

    bands: Literal["octave", "third-octave"] | list[Hertz] = "octave"
    """Kind of bands, or a list of nominal centres in Hz."""
    from_hz: Hertz = 125.0
    """Lowest centre; ignored where bands are listed."""
    to_hz: Hertz = 4000.0
    """Highest centre."""
    method: Method = "auto"
    """How absorption is searched for."""
    model: Literal["auto", "energy", "coherent"] = "auto"
    """Whether energies or pressures of reflections add."""
    positions: Literal["auto", "fit", "fixed"] = "auto"
    """Whether positions, speed of sound and latencies are fitted within their priors."""
    wall_delays: bool = True
    """Whether delays of reflections are fitted."""
    seed: int = limited(*SETTING_LIMITS["seed"], 1)
    """Of rays and annealing."""


class ImpedanceTable(Table):
    """``[impedance]``: what ``roomfit impedance`` fits, and how."""

    from_hz: Hertz = 100.0
    """Lowest frequency."""
    to_hz: Hertz = 1000.0
    """Highest frequency."""
    step_hz: float = limited(0.1, 1000.0, "Hz; finer than 1/(2 pi tau_s) adds no information", 10.0)
    """Distance of frequencies."""
    tau_s: float = limited(
        1e-3, 1.0, "s; shorter holds no reflection, longer all that is late", 0.015
    )
    """Time constant of the exponential window."""
    gain: Literal["auto", "known", "common", "source", "pair", "spectrum", "pair-spectrum"] = "auto"
    """Which gains are unknown."""
    positions: Literal["fit", "fixed"] = "fit"
    """Fitted within their standard deviations, or exact."""
    speed_of_sound: Literal["fit", "fixed"] = "fit"
    """Fitted, or exact."""
    random_starts: int = limited(0, 100, "each costs as much as a fit", 3)
    """Starts at random besides the usual one."""


class DesignTable(Table):
    """``[design]``: where ``roomfit design`` may put sources and receivers."""

    sources: list[Position] = []
    """Positions for sources. Left out: spread evenly."""
    receivers: list[Position] = []
    """Positions for receivers."""
    new_sources: int = limited(0, 1000, "candidates are traced one by one", 8)
    """How many positions for sources are generated."""
    grid_m: float | None = limited(0.1, 100.0, "m; nearer positions tell nothing new", None)
    """Spacing of a grid of receivers."""
    source_heights_m: tuple[Height, Height] = (1.0, 2.0)
    """Lowest and highest."""
    receiver_heights_m: tuple[Height, Height] = (1.0, 2.0)
    """Lowest and highest."""
    region_m: tuple[Position, Position] | None = None
    """Lower and upper corner of a box that contains all generated positions."""
    wall_distance_m: float = limited(
        0.01, 100.0, "m; 0 is in the wall, and no room is so wide", 1.0
    )
    """Least distance of generated positions from walls and furniture."""
    source_distance_m: float | None = limited(0.1, 1000.0, "m; nearer is the source itself", None)
    """Least distance of a receiver from its source."""
    receiver_distance_m: float = limited(0.0, 1000.0, "m; no room is so long", 2.0)
    """Least distance of chosen receivers from each other."""
    most_sources: int | None = limited(1, 1000, "candidates are traced one by one", None)
    """How many different sources a design may have."""
    criterion: Literal["determinant", "mean", "worst"] = "determinant"
    """What is minimised."""
    decay_range_db: float = limited(10.0, 120.0, "dB; no recording has more", 45.0)
    """Expected decay above the noise."""
    position_sd: Metre = 0.02
    """Expected standard deviation of positions."""
    level: Literal["per-source", "per-file", "absolute"] = "per-source"
    """As of measurements."""
    draws: int = limited(1, 100, "each costs as much as a design", 2)
    """Of the absorption from its prior."""


class SettingsTable(Table):
    """``[settings]``: constants of `roomfit.Settings` that stand behind the choices."""

    n_rays: int | Literal["auto"] | None = None
    """Rays a source."""
    n_rays_beside_images: int | Literal["auto"] | None = None
    """Rays a source, where image sources bring what is early."""
    receiver_radius_m: float | Literal["auto"] | None = None
    """Radius of the spheres in which rays are counted."""
    default_scattering: float | None = None
    """Scattering coefficient where nothing chooses it."""
    n_draws: int | None = None
    """Draws of the absorption behind predictions."""
    n_random_starts: int | None = None
    """Further starts of a fit of energies."""
    n_scattering_rays: int | None = None
    """Rays of the trials that choose scattering."""
    most_images: int | None = None
    """Image sources a pair at most."""
    most_coherent_images: int | None = None
    """The same, for pressures."""
    most_triangles_for_images: int | None = None
    """Rooms of more triangles are traced by rays after the first orders."""
    coherent_until_s: float | None = None
    """Time after emission until which pressures are added."""
    speed_of_sound_sd: float | None = None
    """Relative standard deviation of the speed of sound."""
    decay_range_db: float | None = None
    """Range of the decay that is fitted."""
    max_rounds: int | None = None
    """Rounds of updated weights at most."""


Words = Annotated[str, Field(max_length=200)]


class ProjectTable(Table):
    """``[project]``: what the report says of itself; nothing of it decides the answer."""

    title: Words | None = None
    """Heading of the report."""
    client: Words | None = None
    """For whom it was measured."""
    author: Words | None = None
    """Who measured, or wrote the report."""
    date: datetime.date | Words | None = None
    """Of the measurement."""
    instruments: Annotated[list[Words], Field(max_length=40)] = []
    """What was measured with."""
    logo: str | None = None
    """A PNG or JPEG file beside the campaign."""
    language: Literal["en", "de", "fr"] = "en"
    """Of pages that a client sees."""


class ReverberationTable(Table):
    """``[reverberation]``: decay times and no positions."""

    file: str
    """CSV table: a line of centres in Hz, then a line of decay times in s for each position."""
    formula: Literal["Sabine", "Eyring", "Arau-Puchades", "Fitzroy"] = "Eyring"
    """By which `roomfit predict` and `treat` go; `reverberation` shows all four."""
    volume_m3: float | None = limited(1.0, 1e7, "m3; of rooms", None)
    """Where there is no [room]."""
    surface_m2: float | None = limited(1.0, 1e6, "m2; of rooms", None)
    """Where there is no [room]."""


Decibels = Annotated[float, limited(-60.0, 140.0, "dB; quieter is nothing, louder hurts")]


class SpeechTable(Table):
    """``[speech]``: levels with which ``roomfit predict`` finds the speech transmission index."""

    level_dba: Decibels
    """A-weighted level of the talker at 1 m in the free field, in dB; 60 is a normal voice."""
    noise_db: Annotated[list[Decibels], Field(min_length=7, max_length=7)] | None = None
    """Levels of noise at the listeners in the octaves from 125 Hz to 8 kHz, in dB."""


class Campaign(Table):
    """The whole file, as `roomfit.read_campaign` returns it.

    Keys that mean something else than what stands in the file are at hand as what they mean:
    `room`, `air`, `sources`, `receivers`, `groups`, `states`, `bands`, `settings`. Paths of
    measurements are complete; measurements that `recordings` names are among the others.
    """

    format_version: Literal[1] = 1
    """Of this file's format: 1, the only one."""
    project: ProjectTable = ProjectTable()
    """What the report says of itself."""
    room_table: RoomSpec = Field(alias="room")
    """The room."""
    air_table: AirTable = Field(AirTable(), alias="air")
    """The air."""
    materials: dict[str, MaterialTable] = {}
    """What is known of materials before the measurement, by name."""
    products: dict[str, ProductTable] = {}
    """What materials of one product have in common, by name."""
    objects: dict[str, ObjectTable] = {}
    """What stands in the room and absorbs in its volume, by name."""
    loudspeakers: dict[str, LoudspeakerTable] = {}
    """What sources of one make have in common, by name."""
    source_tables: dict[str, SourceTable] = Field({}, alias="sources")
    """Sources by name."""
    receiver_tables: dict[str, ReceiverTable] = Field({}, alias="receivers")
    """Receivers by name."""
    state_tables: list[StateTable] = Field([], alias="states")
    """Further states of the room."""
    group_tables: dict[str, GroupTable] = Field({}, alias="groups")
    """Positions that have a common offset, by name."""
    recordings: str | list[str] | None = None
    """Names of recordings, as "DIR/{source}_{receiver}.wav": one of every pair that is there."""
    defaults: DefaultsTable = DefaultsTable()
    """What holds of every measurement that does not say otherwise."""
    rows: list[MeasurementTable] = Field([], alias="measurements")
    """What was measured, one table each."""
    identify: IdentifyTable = IdentifyTable()
    """How `roomfit identify` fits."""
    reverberation: ReverberationTable | None = None
    """Decay times of a room where no position is known."""
    settings_table: SettingsTable = Field(SettingsTable(), alias="settings")
    """Constants behind these choices."""
    impedance: ImpedanceTable = ImpedanceTable()
    """How `roomfit impedance` fits."""
    design: DesignTable = DesignTable()
    """Where `roomfit design` may measure."""
    speech: SpeechTable | None = None
    """Levels of speech and noise."""

    _path: Path = PrivateAttr(Path())
    _has_room: bool = PrivateAttr(True)
    _findings: tuple[Finding, ...] = PrivateAttr(())

    def model_post_init(self, context: Any, /) -> None:
        """Take where the file lies, and whether it has a room, from what reads it."""
        if context:
            self._path, self._has_room = context["path"], context["has_room"]

    @property
    def path(self) -> Path:
        """The file itself; paths in it are relative to its folder."""
        return self._path

    @property
    def has_room(self) -> bool:
        """Whether it describes a room; only decay times may do without."""
        return self._has_room

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What is doubtful about the file itself."""
        return self._findings

    @property
    def room(self) -> RoomSpec:
        """Which room to read, and how."""
        return self.room_table.within(self.path.parent)

    @property
    def air(self) -> Air:
        """The air."""
        with located(str(self.path)):
            return Air(**self.air_table.model_dump(exclude={"temperature_sd_c"}))

    @property
    def sources(self) -> tuple[Point, ...]:
        """All sources that the file defines, measured or not."""
        return _points(self.source_tables)

    @property
    def receivers(self) -> tuple[Point, ...]:
        """All receivers."""
        return _points(self.receiver_tables)

    @property
    def groups(self) -> tuple[PointGroup, ...]:
        """Positions with a common offset."""
        return tuple(PointGroup(n, tuple(g.members), g.sd) for n, g in self.group_tables.items())

    @property
    def states(self) -> dict[str, dict[str, str]]:
        """Further states of the room: by name, materials by surface."""
        return {state.name: state.materials for state in self.state_tables}

    @property
    def measurements(self) -> tuple[MeasurementTable, ...]:
        """Responses."""
        return tuple(row for row in self.rows if row.file is not None)

    @property
    def tables(self) -> tuple[MeasurementTable, ...]:
        """Tables of room parameters."""
        return tuple(row for row in self.rows if row.parameters is not None)

    @property
    def spectra(self) -> tuple[MeasurementTable, ...]:
        """Damped pressures."""
        return tuple(row for row in self.rows if row.spectrum is not None)

    @property
    def bands(self) -> Bands:
        """Bands to fit."""
        own = self.identify
        check_range(
            "from_hz, at most to_hz,", own.from_hz, 0.0, own.to_hz, where=f"{self.path}, identify"
        )
        with located(f"{self.path}, identify.bands"):
            if isinstance(own.bands, str):
                return bands_between(own.bands, own.from_hz, own.to_hz)
            return bands_of(own.bands)

    @property
    def settings(self) -> Settings:
        """How to fit, to predict and to design."""
        own = self.identify
        table = self.settings_table.model_dump(exclude_none=True)
        stated: dict[str, Any] = {k: None if v == "auto" else v for k, v in table.items()}
        with located(str(self.path)):
            return Settings(
                method=own.method,
                model=own.model,
                seed=own.seed,
                positions=own.positions,
                reflection_delays=own.wall_delays,
                temperature_sd_c=self.air_table.temperature_sd_c,
                **stated,
            )

    def with_rows(
        self, rows: Iterable[MeasurementTable], findings: Iterable[Finding] = ()
    ) -> Campaign:
        """Return the campaign with other measurements, and with what is doubtful about them."""
        copied = self.model_copy(update={"rows": list(rows)})
        copied._findings = (*self._findings, *findings)
        return copied


def _points(tables: Mapping[str, SourceTable | ReceiverTable]) -> tuple[Point, ...]:
    return tuple(Point(n, np.array(t.position), t.position_sd) for n, t in tables.items())


def json_schema(table: type[Table], what: str) -> dict[str, Any]:
    """Return the JSON schema of a file, with which editors complete and check its keys."""
    own = {"$schema": "https://json-schema.org/draft/2020-12/schema", **table.model_json_schema()}
    return own | {"title": f"{what} of roomfit, format_version 1"}
