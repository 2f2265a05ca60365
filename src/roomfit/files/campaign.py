"""Reading a campaign file: its names checked, its recordings found.

Every complaint names the key and what was needed.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from itertools import product
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from roomfit.base.arguments import check_known, in_short, unique_names
from roomfit.base.door import read_bytes, same_file
from roomfit.base.errors import InputError, located
from roomfit.base.findings import About, Code, Finding
from roomfit.files.complaints import explained
from roomfit.files.file_names import files_of_shape, shape_of
from roomfit.files.schema import Campaign, MeasuredDirectivity, MeasurementTable, SharedDirectivity
from roomfit.room.scene import check_groups

__all__ = [
    "FILL_IN",
    "Campaign",
    "blanks",
    "input_files",
    "read_campaign",
    "read_toml",
    "refuse_objects",
]


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


def _check_data(campaign: Campaign) -> None:
    """Refuse a campaign that leaves nothing to fit."""
    if not campaign.rows:
        raise InputError(
            "the campaign has no measurement",
            where=str(campaign.path),
            needed="at least one [[measurements]] table, or recordings = "
            '"DIR/{source}_{receiver}.wav"',
            hint="roomfit reverberation reads decay times without positions"
            if campaign.reverberation
            else None,
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


def _with_recordings(campaign: Campaign, *, to_fit: bool) -> Campaign:
    """Return a campaign with all measurements in full: those found by name, and all defaults.

    A pair, or a file, that has a [[measurements]] of its own is left to it.
    """
    path = campaign.path
    common = campaign.defaults.model_dump(exclude_unset=True)
    rows = list(campaign.rows)
    # a state that is the default is that of a row, too, when it is asked who has one
    stated = {(r.source, r.receiver, r.state or campaign.defaults.state) for r in rows}
    used = {same_file(path.parent / r.file) for r in rows if r.file}
    templates = (
        campaign.recordings if isinstance(campaign.recordings, list) else [campaign.recordings]
    )
    found, findings = [], []
    for template in filter(None, templates):
        with located(f"{path}, recordings"):
            files = files_of_shape(path.parent, template)
        known: list[tuple[str, dict[str, str]]] = []
        for source, receiver in product(campaign.source_tables, campaign.receiver_tables):
            own = {"source": source, "receiver": receiver}
            shape = shape_of(template, own)
            known += [(name, own) for name in files if shape.fullmatch(name)]
        new = [
            {**own, "file": name}
            for name, own in known
            if same_file(path.parent / name) not in used
            and (*own.values(), campaign.defaults.state) not in stated
        ]
        if to_fit and not new and not rows:
            raise InputError(
                "no recording has the name of a source and a receiver",
                where=f"{path}, recordings",
                found=f"{template}: {in_short(files) or 'no files'}",
                needed=f"sources {in_short(list(campaign.source_tables))}, "
                f"receivers {in_short(list(campaign.receiver_tables))}",
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
    return campaign.with_rows(rows, findings)


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


def _check_products(campaign: Campaign) -> None:
    for name, table in campaign.materials.items():
        product, where = table.product, f"{campaign.path}, materials.{name}"
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


def _check_names(campaign: Campaign) -> None:
    path = campaign.path
    used = [campaign.room.materials, *(state.materials for state in campaign.state_tables)]
    named: dict[str, Iterable[str]] = {
        "material": dict.fromkeys(
            [*campaign.materials, *(name for given in used for name in given.values() if name)]
        ),
        "product": campaign.products,
        "object": campaign.objects,
        "loudspeaker": campaign.loudspeakers,
        "source": campaign.source_tables,
        "receiver": campaign.receiver_tables,
        "group": campaign.group_tables,
        "state": [state.name for state in campaign.state_tables],
    }
    with located(str(path)):
        for kind, names in named.items():
            with located(f"[{kind}s]"):
                unique_names(kind, names)
    _check_products(campaign)
    for own, of_source in campaign.source_tables.items():
        table = of_source.directivity
        if isinstance(table, SharedDirectivity):
            where = f"{path}, sources.{own}.directivity.loudspeaker"
            _check_defined("source", "loudspeaker", table.loudspeaker, campaign.loudspeakers, where)
    states = [state.name for state in campaign.state_tables]
    for number, row in enumerate(campaign.rows, start=1):
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
            ("source", row.source, campaign.source_tables),
            ("receiver", row.receiver, campaign.receiver_tables),
        ):
            if not name and row.parameters is None:
                raise InputError(
                    f"a measurement without a {kind}",
                    where=where,
                    needed=kind,
                    found=f"no key {kind}",
                    hint=f'{kind} = "NAME", as in [{kind}s.NAME]',
                )
            if name:
                _check_defined("measurement", kind, name, known, where)


def _check_pairs(campaign: Campaign) -> None:
    """Refuse the same data twice, for one pair or for two: they are one measurement."""
    path = campaign.path
    visited: dict[tuple[object, ...], int] = {}
    for number, row in enumerate(campaign.rows, start=1):
        data = row.file or row.parameters or row.spectrum
        # a table of parameters holds many pairs, a file's channel one; unspecified, it is the first
        pair = () if row.file else (row.source, row.receiver, row.state)
        part = (row.channel or 0, row.variable, row.measurement or 0, row.receiver_index or 0)
        key = (same_file(path.parent / str(data)), *part, *pair)
        earlier = visited.setdefault(key, number)
        if earlier != number:
            other = campaign.rows[earlier - 1]
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
    content = read_toml(path)
    _check_blanks(path, content)
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
    _check_pairs(campaign)
    with located(str(path)):
        check_groups(
            {name: group.members for name, group in campaign.group_tables.items()},
            [*campaign.source_tables, *campaign.receiver_tables],
        )
    # keys that are right one by one and not together
    _ = campaign.room, campaign.air, campaign.sources, campaign.receivers, campaign.bands
    _ = campaign.settings, campaign.groups
    return campaign.with_rows(_in_folder(row, path.parent) for row in campaign.rows)


def _in_folder(row: MeasurementTable, folder: Path) -> MeasurementTable:
    """Return a measurement whose paths are complete."""
    names = ("file", "parameters", "spectrum", "excitation")
    paths = {k: str(folder / own) for k in names if (own := getattr(row, k)) is not None}
    return row.model_copy(update=paths)


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
    room = campaign.room
    files = [campaign.path]
    if room.file is not None:
        files.append(room.file)
    if room.polygons is not None:
        files += [*room.polygons.corners, *room.polygons.planes, *room.polygons.replace.values()]
    files += [m.path for m in campaign.measurements]
    files += [Path(m.excitation) for m in campaign.measurements if m.excitation]
    files += [row.path for row in (*campaign.tables, *campaign.spectra)]
    directivities = campaign.directivities.values()
    named = [t for t in directivities if isinstance(t, str) and t not in ("omni", "fit")]
    named += [t.file for t in directivities if isinstance(t, MeasuredDirectivity)]
    named += [t.directivity for t in campaign.loudspeakers.values() if t.directivity != "fit"]
    files += [campaign.path.parent / name for name in named]
    return tuple(dict.fromkeys(files))
