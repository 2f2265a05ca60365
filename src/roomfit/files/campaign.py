"""Reading a campaign file: its keys, its names, and its recordings.

Every complaint names the key and what was needed.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Iterator
from itertools import product
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from roomfit.base.arguments import check_known, did_you_mean, in_short, unique_names
from roomfit.base.door import read_bytes, same_file
from roomfit.base.errors import InputError, located
from roomfit.base.findings import About, Code, Finding
from roomfit.files import schema
from roomfit.files.file_names import FILL_IN as FILL_IN
from roomfit.files.file_names import files_of_shape, shape_of
from roomfit.files.schema import Campaign as Campaign
from roomfit.room.scene import check_groups


def read_toml(path: Path, what: str = "campaign file") -> dict[str, Any]:
    """Return the content of a file of ours."""
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


def blanks(content: object, key: str = "") -> list[str]:
    """Return the keys of a campaign whose values are still to be filled in."""
    if content == FILL_IN:
        return [key]
    if isinstance(content, dict):
        return [b for k, v in content.items() for b in blanks(v, f"{key}.{k}".lstrip("."))]
    if isinstance(content, list):
        return [b for i, v in enumerate(content, start=1) for b in blanks(v, f"{key}[{i}]")]
    return []


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
    >>> text = "[room]\\nshoebox = [6, 5, 3]\\n[receivers.R]\\nposition = [4.0, 3.5, 1.2]"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "campaign.toml"
    ...     _ = file.write_text(text)
    ...     campaign = read_campaign(file, to_fit=False)
    >>> [point.name for point in campaign.receivers]
    ['R']
    """
    path = Path(path)
    content = read_toml(path)
    if found := blanks(content):
        raise InputError(
            "the campaign is not filled in",
            where=str(path),
            found=f"{FILL_IN} for {', '.join(found)}",
            needed="values, as [1.2, 3.4, 1.5] for a position: x, y, z in m",
            hint="roomfit measure asks for positions, or write them beside each FILL IN",
        )
    has_room = "room" in content or not (decay_times and "reverberation" in content)
    if not has_room:
        content["room"] = _NO_ROOM
    try:
        campaign = Campaign.model_validate(content, context={"path": path, "has_room": has_room})
    except ValidationError as error:
        raise explained(path, error, Campaign) from None
    campaign = _with_recordings(campaign, to_fit=to_fit)
    if to_fit:
        _check_data(campaign)
    _check_names(campaign)
    _check_tables(campaign)
    _check_pairs(campaign)
    # keys that are right one by one and not together
    with located(str(path)):
        members = {name: group.members for name, group in campaign.group_tables.items()}
        check_groups(members, [*campaign.source_tables, *campaign.receiver_tables])
    _ = campaign.room, campaign.air, campaign.sources, campaign.receivers, campaign.bands
    _ = campaign.settings, campaign.groups
    return campaign.with_rows(_in_folder(row, path.parent) for row in campaign.rows)


def _with_recordings(campaign: Campaign, *, to_fit: bool) -> Campaign:
    """Return a campaign with all measurements in full: those found by name, and all defaults.

    A pair, or a file, that has a [[measurements]] of its own is left to it.
    """
    path, rows = campaign.path, list(campaign.rows)
    common = campaign.defaults.model_dump(exclude_unset=True)
    # a state that is the default is that of a row, too, when it is asked who has one
    stated = {(r.source, r.receiver, r.state or campaign.defaults.state) for r in rows}
    used = {same_file(path.parent / r.file) for r in rows if r.file}
    given = campaign.recordings
    found, findings = [], []
    for template in given if isinstance(given, list) else [given] if given else []:
        with located(f"{path}, recordings"):
            files = files_of_shape(path.parent, template)
        free = [f for f in files if same_file(path.parent / f) not in used]
        known: set[str] = set()
        new: list[dict[str, str]] = []
        for source, receiver in product(campaign.source_tables, campaign.receiver_tables):
            own = {"source": source, "receiver": receiver}
            shape = shape_of(template, own)
            names = [name for name in files if shape.fullmatch(name)]
            known.update(names)
            if (source, receiver, campaign.defaults.state) not in stated:
                new += [{**own, "file": name} for name in names if name in free]
        if to_fit and not new and not rows:
            raise InputError(
                "no recording has the name of a source and a receiver",
                where=f"{path}, recordings",
                found=f"{template}: {in_short(files) or 'no files'}",
                needed=f"sources {in_short(list(campaign.source_tables))}, "
                f"receivers {in_short(list(campaign.receiver_tables))}",
                hint="name them alike: LS1_MP1.wav for [sources.LS1] and [receivers.MP1]",
            )
        found += [schema.MeasurementTable.model_validate(row) for row in new]
        if unused := [f for f in free if f not in known]:
            text = f"No source and receiver have the names of these recordings: {in_short(unused)}."
            about, evidence = About(files=unused), {"files": unused}
            findings.append(Finding(Code.RECORDINGS_UNUSED, about, text, evidence))
    whole = [
        row.model_copy(update={k: v for k, v in common.items() if k not in row.model_fields_set})
        for row in (*rows, *found)
    ]
    return campaign.with_rows(whole, findings)


def _in_folder(row: schema.MeasurementTable, folder: Path) -> schema.MeasurementTable:
    """Return a measurement whose paths are complete."""
    names = ("file", "parameters", "spectrum", "excitation")
    paths = {k: str(folder / own) for k in names if (own := getattr(row, k)) is not None}
    return row.model_copy(update=paths)


# What is checked once every key is right by itself.


def _check_data(campaign: Campaign) -> None:
    """Refuse a campaign that leaves nothing to fit."""
    if not campaign.rows:
        hint = "roomfit reverberation reads decay times without positions"
        raise InputError(
            "the campaign has no measurement",
            where=str(campaign.path),
            needed="at least one [[measurements]] table, or recordings = "
            '"DIR/{source}_{receiver}.wav"',
            hint=hint if campaign.reverberation else None,
            found="neither [[measurements]] nor files that recordings names",
        )
    if all(row.use == "validate" for row in campaign.rows):
        raise InputError(
            "every measurement is for validation and none is left to fit",
            where=str(campaign.path),
            needed='at least one measurement with use = "fit"',
            found='use = "validate" for all of them',
            hint="leave use out of those that are to be fitted",
        )


def _check_names(campaign: Campaign) -> None:
    """Refuse names that are none, twice the same, or of nothing that is defined."""
    path, materials = campaign.path, campaign.materials
    used = [campaign.room.materials, *campaign.states.values()]
    defined: dict[str, Iterable[str]] = {
        "material": dict.fromkeys((*materials, *(m for own in used for m in own.values() if m))),
        "product": campaign.products,
        "object": campaign.objects,
        "loudspeaker": campaign.loudspeakers,
        "source": campaign.source_tables,
        "receiver": campaign.receiver_tables,
        "group": campaign.group_tables,
        "state": [state.name for state in campaign.state_tables],
    }
    for kind, names in defined.items():
        with located(f"{path}, [{kind}s]"):
            unique_names(kind, names)
    named = [
        (f"sources.{own}.directivity.loudspeaker", "source", "loudspeaker", shared.loudspeaker)
        for own, table in campaign.source_tables.items()
        if isinstance(shared := table.directivity, schema.SharedDirectivity)
    ]
    named += [
        (f"materials.{own}.product", "material", "product", wall.product or "")
        for own, wall in materials.items()
    ]
    for number, row in enumerate(campaign.rows, start=1):
        where = f"measurements[{number}]"
        of_row = {"state": row.state, "source": row.source, "receiver": row.receiver}
        named += [(where, "measurement", kind, name) for kind, name in of_row.items()]
    for where, owner, kind, name in named:
        if name:
            check_known(
                f"a {owner} names a {kind} that is not defined",
                name,
                sorted(defined[kind]),
                where=f"{path}, {where}",
                else_needed=f"a table [{kind}s.NAME]",
                else_try=f"add [{kind}s.{name}]",
            )


def _check_tables(campaign: Campaign) -> None:
    """Refuse keys that do not go together in one table."""
    for own, wall in campaign.materials.items():
        stated = [k for k in ("prior", "bounds", "same_absorption_as") if getattr(wall, k)]
        if wall.product is not None and stated:
            raise InputError(
                f"a material of a product has {stated[0]} of its own",
                where=f"{campaign.path}, materials.{own}.{stated[0]}",
                needed=f"either product = {wall.product!r} or {stated[0]}",
                hint=f"what is known of all its walls belongs to [products.{wall.product}]",
                found=f"{stated[0]} beside product = {wall.product!r}",
            )
    for number, row in enumerate(campaign.rows, start=1):
        where = f"{campaign.path}, measurements[{number}]"
        what = "a measurement needs exactly one kind of data"
        hint = "a table [[measurements]] for each file"
        schema.the_one(row, ("file", "parameters", "spectrum"), what, where, hint)
        for kind in ("source", "receiver") if row.parameters is None else ():
            if not getattr(row, kind):
                what, hint = f"a measurement without a {kind}", f'{kind} = "NAME" of [{kind}s.NAME]'
                raise InputError(what, where=where, found=f"no {kind}", needed=kind, hint=hint)


def _check_pairs(campaign: Campaign) -> None:
    """Refuse the same data twice, for one pair or for two: they are one measurement."""
    first: dict[tuple[object, ...], tuple[int, tuple[str, str, str]]] = {}
    for number, row in enumerate(campaign.rows, start=1):
        data, pair = row.path, (row.source, row.receiver, row.state)
        # a table of parameters holds many pairs, a file's channel one; unspecified, it is the first
        part = (
            row.channel or 0,
            row.variable,
            row.measurement or 0,
            row.receiver_index or 0,
            row.emitter_index or 0,
        )
        key = (same_file(campaign.path.parent / data), *part, *(() if row.file else pair))
        earlier, of = first.setdefault(key, (number, pair))
        if earlier != number:
            same = pair == of
            raise InputError(
                "the same measurement stands twice" if same else "two pairs have the same response",
                where=f"{campaign.path}, measurements[{earlier}] and measurements[{number}]",
                found=str(data),
                hint="remove one of them" if same else "name each pair's own file or channel",
                needed="each response once, with its own pair",
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


def input_files(campaign: Campaign) -> tuple[Path, ...]:
    """Return every file whose content decides the answer, each once, the campaign's own first."""
    room, measured = campaign.room, campaign.measurements
    files = [campaign.path]
    if room.file is not None:
        files.append(room.file)
    if room.polygons is not None:
        files += [*room.polygons.corners, *room.polygons.planes, *room.polygons.replace.values()]
    files += [m.path for m in measured]
    files += [Path(m.excitation) for m in measured if m.excitation]
    files += [row.path for row in (*campaign.tables, *campaign.spectra)]
    directivities = [table.directivity for table in campaign.source_tables.values()]
    named = [t for t in directivities if isinstance(t, str) and t not in ("omni", "fit")]
    named += [t.file for t in directivities if isinstance(t, schema.MeasuredDirectivity)]
    named += [t.directivity for t in campaign.loudspeakers.values() if t.directivity != "fit"]
    files += [campaign.path.parent / name for name in named]
    return tuple(dict.fromkeys(files))


# What pydantic complains of, as one message that says what, where, found and needed.


def explained(
    path: Path, error: ValidationError, table: type[BaseModel], file: str = "campaign file"
) -> InputError:
    """Turn pydantic's most telling complaint into one message in our words.

    `table` is that of the whole `file`, whose keys are named where one is unknown.
    """
    complaints = [(_place(c), c) for c in error.errors(include_url=False)]
    # a union tries every member: an unknown key says most, then what lies deepest in the file
    unknown = [c for c in complaints if c[1]["type"] == "extra_forbidden"]
    alike = [c for c in complaints if c[0][:2] == complaints[0][0][:2]]
    place, first = unknown[0] if unknown else max(alike, key=lambda c: len(c[0]))
    kind, given, last = first["type"], first.get("input"), first["loc"][-1] if first["loc"] else ""
    field, inside = _walk(table, place[:-1] if unknown else place)
    words = " ".join(((field and field.description) or "").split()).partition(". ")[0].rstrip(".")
    hint: str | None = f"{words} (roomfit schema prints all keys)".lstrip()
    what, found = f"a value in the {file} is not what it must be", repr(given)
    if unknown:
        known = sorted(_fields(inside)) if inside else []
        what, needed = f"unknown key in the {file}", f"one of {', '.join(known)}" if known else ""
        found, hint = repr(last), did_you_mean(str(last), known)
    elif kind == "missing" and isinstance(last, int):
        # a position of two numbers lacks its third: the fault is the list's
        what, place = f"a list in the {file} is too short", place[:-1]
        needed = f"{last + 1} values or more"
    elif kind == "missing":
        what, place, found = f"the {file} lacks a key", place[:-1], "no such key"
        needed = repr(str(last))
    else:
        # where several kinds are taken, a number of the right kind but out of its range says most
        same = [c for at, c in complaints if at == place]
        ranged = [c for c in same if c["type"].endswith("than_equal")]
        needed = ", or ".join(dict.fromkeys(_in_our_words(c["msg"]) for c in ranged or same))
        hint = (next(_reasons(field), None) if ranged and field else None) or hint
    where = "".join(f"[{p + 1}]" if isinstance(p, int) else f".{p}" for p in place).lstrip(".")
    where = f"{path}, {where or 'top level'}"
    return InputError(what, where=where, found=found, needed=needed, hint=hint)


def _in_our_words(message: str) -> str:
    for pattern, ours in (
        (r"^Input should be |^\w+ should have |, unable to parse.*| after validation.*", ""),
        (r" or (instance|an object).*", ""),
        (r"(greater|less) than or equal to (\S+)", r"\2 or \1"),
    ):
        message = re.sub(pattern, ours, message)
    for theirs, ours in (
        ("or greater", "or more"),
        ("a valid dictionary", "a table"),
        ("valid tuple", "valid list"),
    ):
        message = message.replace(theirs, ours)
    return message


def _walk(
    table: type[BaseModel], place: tuple[int | str, ...]
) -> tuple[FieldInfo | None, type[BaseModel] | None]:
    """Return the innermost key on the way to a place, and the table below it if any.

    Names of materials and the like, and numbers of rows, are no keys.
    """
    field, model = None, table
    below: type[BaseModel] | None = table
    for part in place:
        if (own := _fields(model).get(str(part))) is not None:
            field, below = own, next(_models_within(own.annotation), None)
            model = below or model
    return field, below


def _fields(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Return the fields of a table by the names of their keys in the file."""
    return {field.alias or name: field for name, field in model.model_fields.items()}


def _models_within(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _models_within(inner)


def _reasons(part: Any) -> Iterator[str]:
    """Yield why the numbers of a key end where they do, of unions and lists the first."""
    if isinstance(part, FieldInfo):
        if isinstance(part.json_schema_extra, dict) and schema.BECAUSE in part.json_schema_extra:
            yield str(part.json_schema_extra[schema.BECAUSE])
        part = part.annotation
    for inner in (*get_args(part), *getattr(part, "__metadata__", ())):
        yield from _reasons(inner)


_MEMBER = re.compile(
    r".*Table|.*\[.*|(Area)?(Spectrum|Prior)|.*Directivity|(constrained-)?(float|str)|int"
)


def _place(complaint: ErrorDetails) -> tuple[int | str, ...]:
    """Return where in the file a complaint points, without the names of union members."""
    return tuple(p for p in complaint["loc"] if isinstance(p, int) or not _MEMBER.fullmatch(p))
