"""A campaign file, read: what it says, with paths resolved and names checked.

Every complaint names the key and what was needed.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from roomfit.base.air import Air
from roomfit.base.arguments import check_known, in_short, unique_names
from roomfit.base.bands import OCTAVES_HZ, Bands, bands_between
from roomfit.base.door import read_bytes, same_file
from roomfit.base.errors import InputError, located
from roomfit.base.findings import About, Code, Finding
from roomfit.files.complaints import explained
from roomfit.files.file_names import files_of_shape, shape_of
from roomfit.files.responses.recordings import ResponseSpec
from roomfit.files.rooms.model import PolygonSpec, RoomSpec
from roomfit.files.schema import (
    AirTable,
    CampaignTable,
    DesignTable,
    IdentifyTable,
    ImpedanceTable,
    LoudspeakerTable,
    MaterialTable,
    MeasuredDirectivity,
    MeasurementTable,
    ObjectTable,
    ProductTable,
    ProjectTable,
    ReceiverTable,
    ReverberationTable,
    RoomTable,
    SharedDirectivity,
    SourceDirectivity,
    SourceTable,
    SpeechTable,
)
from roomfit.room.scene import Point, PointGroup, check_groups
from roomfit.settings import Settings
from roomfit.signals.measurement import Level, Use


def read_toml(path: Path, what: str = "campaign file") -> dict[str, Any]:
    """Return the content of a file of ours.

    Raises
    ------
    InputError
        It is missing, too large, not text or not TOML.
    """
    content = read_bytes(path, what, most="campaign_bytes")
    try:
        return tomllib.loads(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(
            f"the {what} is not text",
            where=str(path),
            found=f"a file that begins with {content[:12]!r}",
            needed="TOML in UTF-8",
            hint="save it as UTF-8; recordings and rooms are named in it, and not given for it",
        ) from error
    # whole numbers of thousands of digits are another ValueError
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"the {what} is not valid TOML",
            where=str(path),
            found=str(error)[:200],
            hint="a key may stand only once, text needs quotes, tables begin with [name]",
            needed="TOML: tables, and key = value, one a line",
        ) from error


FILL_IN = "FILL IN"  # what `roomfit init` leaves to be filled in


def blanks(content: object, key: str = "") -> list[str]:
    """Return the keys of a campaign whose values are still to be filled in.

    Examples
    --------
    >>> blanks({"sources": {"S1": {"position": FILL_IN}}, "measurements": [{"file": "a.wav"}]})
    ['sources.S1.position']
    """
    if content == FILL_IN:
        return [key]
    if isinstance(content, dict):
        return [b for k, v in content.items() for b in blanks(v, f"{key}.{k}".lstrip("."))]
    if isinstance(content, list):
        return [b for i, v in enumerate(content, start=1) for b in blanks(v, f"{key}[{i}]")]
    return []


def _check_blanks(path: Path, content: dict[str, Any]) -> None:
    found = blanks(content)
    if found:
        raise InputError(
            "the campaign is not filled in",
            where=str(path),
            found=f"{FILL_IN} for {', '.join(found)}",
            needed="values, as [1.2, 3.4, 1.5] for a position: x, y, z in m",
            hint="roomfit measure asks for positions, or write them beside each FILL IN",
        )


def _check_data(path: Path, campaign: CampaignTable) -> None:
    """Refuse a campaign that leaves nothing to fit."""
    if not campaign.measurements:
        raise InputError(
            "the campaign has no measurement",
            where=str(path),
            needed="at least one [[measurements]] table, or recordings = "
            '"DIR/{source}_{receiver}.wav"',
            hint="roomfit reverberation reads decay times without positions"
            if campaign.reverberation
            else None,
            found="neither [[measurements]] nor files that recordings names",
        )
    if all(row.use == "validate" for row in campaign.measurements):
        raise InputError(
            "every measurement is for validation and none is left to fit",
            where=str(path),
            needed='at least one measurement with use = "fit"',
            found='use = "validate" for all of them',
            hint="leave use out of those that are to be fitted",
        )


def _with_recordings(
    path: Path, table: CampaignTable, *, to_fit: bool
) -> tuple[CampaignTable, tuple[Finding, ...]]:
    """Return the table with all measurements in full: those found by name, and all defaults.

    A pair, or a file, that has a [[measurements]] of its own is left to it.
    """
    common = table.defaults.model_dump(exclude_unset=True)
    rows = list(table.measurements)
    # a state that is the default is that of a row, too, when it is asked who has one
    stated = {(r.source, r.receiver, r.state or table.defaults.state) for r in rows}
    used = {same_file(path.parent / r.file) for r in rows if r.file}
    templates = table.recordings if isinstance(table.recordings, list) else [table.recordings]
    found, findings = [], []
    for template in filter(None, templates):
        with located(f"{path}, recordings"):
            files = files_of_shape(path.parent, template)
        known: list[tuple[str, dict[str, str]]] = []
        for source, receiver in product(table.sources, table.receivers):
            own = {"source": source, "receiver": receiver}
            shape = shape_of(template, own)
            known += [(name, own) for name in files if shape.fullmatch(name)]
        new = [
            {**own, "file": name}
            for name, own in known
            if same_file(path.parent / name) not in used
            and (*own.values(), table.defaults.state) not in stated
        ]
        if to_fit and not new and not rows:
            raise InputError(
                "no recording has the name of a source and a receiver",
                where=f"{path}, recordings",
                found=f"{template}: {in_short(files) or 'no files'}",
                needed=f"sources {in_short(list(table.sources))}, "
                f"receivers {in_short(list(table.receivers))}",
                hint="name them alike: LS1_MP1.wav for [sources.LS1] and [receivers.MP1]",
            )
        found += [MeasurementTable.model_validate(row) for row in new]
        names = {name for name, _ in known}
        unused = [f for f in files if f not in names and same_file(path.parent / f) not in used]
        if unused:
            text = f"No source and receiver have the names of these recordings: {in_short(unused)}."
            findings.append(
                Finding(Code.RECORDINGS_UNUSED, About(files=unused), text, {"files": unused})
            )
    rows = [
        row.model_copy(update={k: v for k, v in common.items() if k not in row.model_fields_set})
        for row in (*rows, *found)
    ]
    return table.model_copy(update={"measurements": rows}), tuple(findings)


def _check_defined(owner: str, kind: str, name: str, known: Iterable[str], where: str) -> None:
    """Refuse a name that no table defines."""
    check_known(
        f"a {owner} names a {kind} that is not defined",
        name,
        sorted(known),
        where=where,
        else_needed=f"a table [{kind}s.NAME]",
        else_try=f"add [{kind}s.{name}]",
    )


def _check_products(path: Path, campaign: CampaignTable) -> None:
    for name, table in campaign.materials.items():
        product, where = table.product, f"{path}, materials.{name}"
        if product is None:
            continue
        _check_defined("material", "product", product, campaign.products, f"{where}.product")
        for key in ("prior", "bounds", "same_absorption_as"):
            if getattr(table, key) is not None:
                raise InputError(
                    f"a material of a product has {key} of its own",
                    where=f"{where}.{key}",
                    needed=f"either product = {product!r} or {key}",
                    hint=f"what is known of all its walls belongs to [products.{product}]",
                    found=f"{key} beside product = {product!r}",
                )


def _check_names(path: Path, campaign: CampaignTable) -> None:
    used = [campaign.room.materials, *(state.materials for state in campaign.states)]
    named: dict[str, Iterable[str]] = {
        "material": dict.fromkeys(
            [*campaign.materials, *(name for given in used for name in given.values() if name)]
        ),
        "product": campaign.products,
        "object": campaign.objects,
        "loudspeaker": campaign.loudspeakers,
        "source": campaign.sources,
        "receiver": campaign.receivers,
        "group": campaign.groups,
        "state": [state.name for state in campaign.states],
    }
    with located(str(path)):
        for kind, names in named.items():
            with located(f"[{kind}s]"):
                unique_names(kind, names)
    _check_products(path, campaign)
    for own, of_source in campaign.sources.items():
        table = of_source.directivity
        if isinstance(table, SharedDirectivity):
            where = f"{path}, sources.{own}.directivity.loudspeaker"
            _check_defined("source", "loudspeaker", table.loudspeaker, campaign.loudspeakers, where)
    states = [state.name for state in campaign.states]
    for number, row in enumerate(campaign.measurements, start=1):
        where = f"{path}, measurements[{number}]"
        if row.state:
            check_known(
                "a measurement names a state of the room that is not defined",
                row.state,
                states,
                where=where,
                else_needed="a table [[states]]",
                else_try="leave it out for the room as described",
            )
        kinds = [k for k in ("file", "parameters", "spectrum") if getattr(row, k) is not None]
        if len(kinds) != 1:
            raise InputError(
                "a measurement needs exactly one kind of data",
                where=where,
                found=", ".join(kinds) or "none",
                needed="one of file, parameters, spectrum",
                hint="a table [[measurements]] for each file",
            )
        for kind, name, known in (
            ("source", row.source, campaign.sources),
            ("receiver", row.receiver, campaign.receivers),
        ):
            if name is None and row.parameters is None:
                raise InputError(
                    f"a measurement without a {kind}",
                    where=where,
                    needed=kind,
                    found=f"no key {kind}",
                    hint=f'{kind} = "NAME", as in [{kind}s.NAME]',
                )
            if name is not None:
                _check_defined("measurement", kind, name, known, where)


def _check_pairs(path: Path, campaign: CampaignTable) -> None:
    """Refuse the same data twice, for one pair or for two: they are one measurement."""
    visited: dict[tuple[object, ...], int] = {}
    for number, row in enumerate(campaign.measurements, start=1):
        data = row.file or row.parameters or row.spectrum
        # a table of parameters holds many pairs, a file's channel one; unspecified, it is the first
        pair = () if row.file else (row.source, row.receiver, row.state)
        part = (row.channel or 0, row.variable, row.measurement or 0, row.receiver_index or 0)
        key = (same_file(path.parent / str(data)), *part, *pair)
        earlier = visited.setdefault(key, number)
        if earlier != number:
            other = campaign.measurements[earlier - 1]
            same = (row.source, row.receiver, row.state) == (
                other.source,
                other.receiver,
                other.state,
            )
            raise InputError(
                "the same measurement stands twice" if same else "two pairs have the same response",
                where=f"{path}, measurements[{earlier}] and measurements[{number}]",
                found=data,
                hint="remove one of them" if same else "name each pair's own file or channel",
                needed="each response once, with its own pair",
            )


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredFile:
    """One measured response: where it lies, whose pair it is, and how it is to be used."""

    source: str
    receiver: str
    response: ResponseSpec
    level: Level
    use: Use
    # how uncertain the moment of emission is; None: unspecified
    latency_sd_s: float | None = None
    state: str = ""  # of the room, "" as it is described


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredTable:
    """One table of ISO 3382 values, and which of its rows are meant; None means all."""

    path: Path
    source: str | None
    receiver: str | None
    use: Use
    state: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredSpectrum:
    """One file of damped pressures, for impedances; `level` is None: unspecified."""

    source: str
    receiver: str
    path: Path
    level: Level | None
    use: Use


@dataclass(frozen=True, slots=True, eq=False)
class Campaign:
    """Everything that a campaign file says; what it leaves out is at its default."""

    path: Path  # the file itself; paths in it are relative to its folder
    room: RoomSpec
    air: Air
    sources: tuple[Point, ...]  # all that the file defines, measured or not
    receivers: tuple[Point, ...]
    measurements: tuple[MeasuredFile, ...]
    tables: tuple[MeasuredTable, ...]
    bands: Bands  # to fit
    materials: dict[str, MaterialTable]  # what the file says of them, for `material_priors`
    settings: Settings = field(default_factory=Settings)
    directivities: Mapping[str, SourceDirectivity] = field(default_factory=dict)  # by source
    loudspeakers: Mapping[str, LoudspeakerTable] = field(default_factory=dict)
    # what materials of one product have in common, each defined
    products: Mapping[str, ProductTable] = field(default_factory=dict)
    spectra: tuple[MeasuredSpectrum, ...] = ()
    impedance: ImpedanceTable = field(default_factory=ImpedanceTable)
    design: DesignTable = field(default_factory=DesignTable)
    # further states of the room: by name, materials by surface
    states: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    groups: tuple[PointGroup, ...] = ()
    project: ProjectTable = field(default_factory=ProjectTable)
    findings: tuple[Finding, ...] = ()  # what is doubtful about the file itself
    reverberation: ReverberationTable | None = None  # decay times without positions
    has_room: bool = True  # only decay times may do without
    speech: SpeechTable | None = None  # levels of speech and noise
    objects: Mapping[str, ObjectTable] = field(default_factory=dict)  # what stands in the room


# stands where decay times come with a volume and a surface alone, and is not looked at
_NO_ROOM = {"shoebox": [1.0, 1.0, 1.0]}


def read_campaign(path: Path, *, to_fit: bool = True, decay_times: bool = False) -> Campaign:
    """Read a campaign file.

    Parameters
    ----------
    path : Path
    to_fit : bool
        Whether there must be a measurement to fit; a prediction or a design needs none.
    decay_times : bool
        Whether decay times are to be read, which may do without a room.

    Raises
    ------
    InputError
        The file is missing, not TOML, has an unknown key (the nearest known one is named), a value
        of the wrong kind, or measurements that name undefined sources or receivers.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> text = '''
    ... [room]
    ... shoebox = [6, 5, 3]
    ... [sources.S]
    ... position = [1.5, 1.2, 1.5]
    ... [receivers.R]
    ... position = [4.0, 3.5, 1.2]
    ... [[measurements]]
    ... parameters = "measured.csv"
    ... '''
    >>> table = "source,receiver,parameter,500,1000\\nS,R,T30,0.9,0.8\\n"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "campaign.toml"
    ...     _ = file.write_text(text)
    ...     _ = file.with_name("measured.csv").write_text(table)
    ...     campaign = read_campaign(file)
    >>> [point.name for point in campaign.receivers], campaign.settings.method
    (['R'], 'auto')
    """
    path = Path(path)
    table, has_room = _campaign_table(path, decay_times)
    table, findings = _with_recordings(path, table, to_fit=to_fit)
    if to_fit:
        _check_data(path, table)
    _check_names(path, table)
    _check_pairs(path, table)
    with located(str(path)):
        check_groups(
            {name: group.members for name, group in table.groups.items()},
            [*table.sources, *table.receivers],
        )
    return _campaign(path, table, findings, has_room)


def _campaign_table(path: Path, decay_times: bool) -> tuple[CampaignTable, bool]:
    """Return what stands in the file, each key checked by itself, and whether there is a room."""
    content = read_toml(path)
    _check_blanks(path, content)
    has_room = "room" in content or not (decay_times and "reverberation" in content)
    if not has_room:
        content["room"] = _NO_ROOM
    try:
        return CampaignTable.model_validate(content), has_room
    except ValidationError as error:
        raise explained(path, error, CampaignTable) from None


def _campaign(
    path: Path, table: CampaignTable, findings: tuple[Finding, ...], has_room: bool
) -> Campaign:
    """Return the campaign of a table whose names and measurements are checked."""
    rows = table.measurements
    return Campaign(
        path,
        _room_spec(path, table.room),
        _air(path, table.air),
        _points(table.sources),
        _points(table.receivers),
        tuple(_measured_file(path, m) for m in rows if m.file is not None),
        tuple(
            MeasuredTable(path.parent / m.parameters, m.source, m.receiver, m.use, m.state)
            for m in rows
            if m.parameters is not None
        ),
        _bands(path, table.identify),
        dict(table.materials),
        _settings(path, table),
        {name: source.directivity for name, source in table.sources.items()},
        dict(table.loudspeakers),
        dict(table.products),
        tuple(
            MeasuredSpectrum(
                str(m.source),
                str(m.receiver),
                path.parent / m.spectrum,
                m.level if "level" in m.model_fields_set else None,
                m.use,
            )
            for m in rows
            if m.spectrum is not None
        ),
        table.impedance,
        table.design,
        {state.name: state.materials for state in table.states},
        tuple(PointGroup(n, tuple(g.members), g.sd) for n, g in table.groups.items()),
        table.project,
        findings,
        table.reverberation,
        has_room,
        table.speech,
        dict(table.objects),
    )


def refuse_objects(campaign: Campaign, command: str) -> None:
    """Refuse a campaign whose room has objects, for a command that counts walls alone."""
    if campaign.objects:
        raise InputError(
            f"{command} counts walls alone, and the room has objects",
            where=str(campaign.path),
            found=", ".join(f"[objects.{name}]" for name in campaign.objects),
            needed="a room without them, and no [objects]",
            hint="roomfit identify and roomfit predict count them",
        )


DEFAULTS = Settings()  # of what a campaign file does not say


def _settings(path: Path, table: CampaignTable) -> Settings:
    own = table.identify
    stated: dict[str, Any] = table.settings.model_dump(exclude_none=True)
    stated = {name: None if value == "auto" else value for name, value in stated.items()}
    with located(str(path)):
        return replace(
            DEFAULTS,
            method=own.method,
            model=own.model,
            seed=own.seed,
            positions=own.positions,
            reflection_delays=own.wall_delays,
            temperature_sd_c=table.air.temperature_sd_c,
            **stated,
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


def _room_spec(path: Path, room: RoomTable) -> RoomSpec:
    kinds = [k for k in ("file", "shoebox", "polygons") if getattr(room, k) is not None]
    if len(kinds) != 1:
        raise InputError(
            "the room needs exactly one description",
            where=f"{path}, room",
            found=", ".join(kinds) or "none",
            needed="one of file, shoebox, polygons",
            hint="keep the one that describes the room as it is",
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
        lengths_sd=room.lengths_sd,
        space=room.space,
    )


def _directivity_files(campaign: Campaign) -> list[Path]:
    directivities = campaign.directivities.values()
    named = [t for t in directivities if isinstance(t, str) and t not in ("omni", "fit")]
    named += [t.file for t in directivities if isinstance(t, MeasuredDirectivity)]
    named += [t.directivity for t in campaign.loudspeakers.values() if t.directivity != "fit"]
    return [campaign.path.parent / name for name in named]


def _points(tables: Mapping[str, SourceTable | ReceiverTable]) -> tuple[Point, ...]:
    return tuple(Point(n, np.array(t.position), t.position_sd) for n, t in tables.items())


def _measured_file(path: Path, row: MeasurementTable) -> MeasuredFile:
    # `_check_names` has made sure that all three are given
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
        row.state,
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
            hint="exchange the two",
        )
    with located(f"{path}, identify.bands"):
        if isinstance(table.bands, str):
            return bands_between(table.bands, table.from_hz, table.to_hz)
        octaves = set(table.bands) <= set(OCTAVES_HZ)
        return Bands("octave" if octaves else "third-octave", np.array(table.bands))
