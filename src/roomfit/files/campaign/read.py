"""Read and check a campaign file; every complaint names the key and what was needed."""

from __future__ import annotations

import tomllib
import types
from pathlib import Path
from typing import Any, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from roomfit.checks import nearest
from roomfit.errors import InputError
from roomfit.files.campaign.schema import CampaignTable


def read_campaign_table(path: Path, *, to_fit: bool = True) -> CampaignTable:
    """Return the checked contents of a campaign file.

    Parameters
    ----------
    path : Path
    to_fit : bool
        Whether there must be a measurement to fit; a prediction needs none.

    Raises
    ------
    InputError
        The file is missing, not TOML, has an unknown key (the nearest known one is named), a value
        of the wrong kind, or measurements that name undefined sources or receivers.
    """
    table = _read_toml(path)
    try:
        campaign = CampaignTable.model_validate(table)
    except ValidationError as error:
        raise _explained(path, error) from None
    if to_fit:
        _check_data(path, campaign)
    _check_names(path, campaign)
    _check_pairs(path, campaign)
    return campaign


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        text = Path(path).read_bytes()
    except FileNotFoundError:
        raise InputError(
            "the campaign file does not exist", where=str(path), hint="check the path"
        ) from None
    except OSError as error:
        raise InputError(
            "the campaign file cannot be read", where=str(path), found=str(error)
        ) from error
    try:
        return tomllib.loads(text.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise InputError(
            "the campaign file is not text", where=str(path), needed="TOML in UTF-8"
        ) from error
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(
            "the campaign file is not valid TOML",
            where=str(path),
            found=str(error),
            hint="a key may stand only once, text needs quotes, tables begin with [name]",
        ) from error


def _explained(path: Path, error: ValidationError) -> InputError:
    """Turn pydantic's most telling complaint into one message in our words."""
    complaints = error.errors(include_url=False)
    # a union tries every member: an unknown key says most, then what lies deepest in the file
    first = next((c for c in complaints if c["type"] == "extra_forbidden"), None)
    if first is None:
        start = _place(complaints[0])[:2]
        alike = [c for c in complaints if _place(c)[:2] == start]
        first = max(alike, key=lambda c: len(_place(c)))
    place = _place(first)
    # a position of two numbers lacks its third: the fault is the list's
    if first["type"] == "missing" and isinstance(place[-1], int):
        return InputError(
            "a list in the campaign file is too short",
            where=f"{path}, {_key_path(place[:-1])}",
            found=repr(first.get("input")),
            needed=f"{place[-1] + 1} values or more",
        )
    where = f"{path}, {_key_path(place)}"
    if first["type"] == "extra_forbidden":
        key = str(first["loc"][-1])
        known = _known_keys(first["loc"][:-1])
        guess = nearest(key, known)
        return InputError(
            "unknown key in the campaign file",
            where=where,
            found=repr(key),
            needed=f"one of {', '.join(known)}" if known else None,
            hint=f"did you mean {guess!r}?" if guess else None,
        )
    if first["type"] == "missing":
        return InputError(
            "the campaign file lacks a key",
            where=f"{path}, {_key_path(place[:-1])}",
            needed=repr(str(place[-1])),
        )
    return InputError(
        "a value in the campaign file is not what it must be",
        where=where,
        found=repr(first.get("input")),
        needed=first["msg"].removeprefix("Input should be ").split(", unable to parse")[0],
    )


def _place(complaint: ErrorDetails) -> tuple[int | str, ...]:
    """Return where in the file a complaint points, without the names of union members."""
    return tuple(part for part in complaint["loc"] if _stands_in_the_file(part))


def _stands_in_the_file(part: int | str) -> bool:
    """Whether a part of a complaint is a key or an index, not the name of a union member."""
    if isinstance(part, int):
        return True
    return not part.endswith("Table") and "[" not in part and part not in _MEMBER_NAMES


_MEMBER_NAMES = frozenset(
    {
        "Spectrum",
        "Prior",
        "Directivity",
        "MeasuredDirectivity",
        "float",
        "str",
        "int",
        "constrained-float",
        "constrained-str",
    }
)


def _key_path(location: tuple[int | str, ...]) -> str:
    text = ""
    for part in location:
        text += f"[{part + 1}]" if isinstance(part, int) else f".{part}"
    return text.lstrip(".") or "top level"


def _known_keys(location: tuple[int | str, ...]) -> list[str]:
    """Return the keys that the table at a location may have."""
    model: type[BaseModel] = CampaignTable
    for part in location:
        if isinstance(part, str) and part in model.model_fields:
            inner = _models_within(model.model_fields[part].annotation)
            if not inner:
                return []
            model = inner[0]
    return sorted(model.model_fields)


def _models_within(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) in (Union, types.UnionType, dict, list):
        return [m for a in get_args(annotation) for m in _models_within(a)]
    return []


def _check_data(path: Path, campaign: CampaignTable) -> None:
    """Refuse a campaign that leaves nothing to fit."""
    if not campaign.measurements:
        raise InputError(
            "the campaign has no measurement",
            where=str(path),
            needed="at least one [[measurements]] table",
        )
    if all(row.use == "validate" for row in campaign.measurements):
        raise InputError(
            "every measurement is for validation and none is left to fit",
            where=str(path),
            needed='at least one measurement with use = "fit"',
        )


def _check_names(path: Path, campaign: CampaignTable) -> None:
    for number, row in enumerate(campaign.measurements, start=1):
        where = f"{path}, measurements[{number}]"
        kinds = [k for k in ("file", "parameters", "spectrum") if getattr(row, k) is not None]
        if len(kinds) != 1:
            raise InputError(
                "a measurement needs exactly one kind of data",
                where=where,
                found=", ".join(kinds) or "none",
                needed="one of file, parameters, spectrum",
            )
        for kind, name, known in (
            ("source", row.source, campaign.sources),
            ("receiver", row.receiver, campaign.receivers),
        ):
            if name is None and row.parameters is None:
                raise InputError(f"a measurement without a {kind}", where=where, needed=kind)
            if name is not None and name not in known:
                guess = nearest(name, known)
                raise InputError(
                    f"a measurement names a {kind} that is not defined",
                    where=where,
                    found=repr(name),
                    needed=f"one of {', '.join(sorted(known)) or f'no {kind} is defined'}",
                    hint=f"did you mean {guess!r}?" if guess else f"add [{kind}s.{name}]",
                )


def _check_pairs(path: Path, campaign: CampaignTable) -> None:
    """Refuse the same data twice, for one pair or for two: they are one measurement."""
    seen: dict[tuple[object, ...], int] = {}
    for number, row in enumerate(campaign.measurements, start=1):
        data = row.file or row.parameters or row.spectrum
        # a table of parameters holds many pairs, a file's channel one
        pair = () if row.file else (row.source, row.receiver)
        key = (data, row.channel, row.variable, row.measurement, row.receiver_index, *pair)
        earlier = seen.setdefault(key, number)
        if earlier != number:
            other = campaign.measurements[earlier - 1]
            same = (row.source, row.receiver) == (other.source, other.receiver)
            raise InputError(
                "the same measurement stands twice" if same else "two pairs have the same response",
                where=f"{path}, measurements[{earlier}] and measurements[{number}]",
                found=data,
                hint="remove one of them" if same else "name each pair's own file or channel",
            )
