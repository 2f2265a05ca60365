"""Read and check a campaign file; every complaint names the key and what was needed."""

from __future__ import annotations

import tomllib
import types
from pathlib import Path
from typing import Any, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from roomfit.checks import nearest
from roomfit.errors import InputError
from roomfit.files.campaign.schema import CampaignTable


def read_campaign_table(path: Path) -> CampaignTable:
    """Return the checked contents of a campaign file.

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
    """Turn pydantic's first complaint into one message in our words."""
    complaints = error.errors(include_url=False)
    # a union tries every member; the complaint that is about an unknown key says most
    first = next((c for c in complaints if c["type"] == "extra_forbidden"), complaints[0])
    location = tuple(part for part in first["loc"] if _stands_in_the_file(part))
    where = f"{path}, {_key_path(location)}"
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
            "the campaign file lacks a key", where=where, needed=repr(str(first["loc"][-1]))
        )
    return InputError(
        "a value in the campaign file is not what it must be",
        where=where,
        found=repr(first.get("input")),
        needed=first["msg"],
    )


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


def _check_names(path: Path, campaign: CampaignTable) -> None:
    if not campaign.measurements:
        raise InputError(
            "the campaign has no measurement",
            where=str(path),
            needed="at least one [[measurements]] table",
        )
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
    """Refuse the same file channel twice: it would count one measurement as two."""
    seen: dict[tuple[object, ...], int] = {}
    key: tuple[object, ...]
    for number, row in enumerate(campaign.measurements, start=1):
        data = (row.file, row.parameters, row.spectrum)
        key = (*data, row.channel, row.variable, row.measurement, row.receiver_index)
        key = (*key, row.source, row.receiver)
        if key in seen:
            raise InputError(
                "the same measurement stands twice",
                where=f"{path}, measurements[{seen[key]}] and measurements[{number}]",
                found=row.file or row.parameters or row.spectrum,
                hint="remove one of them",
            )
        seen[key] = number
    if all(row.use == "validate" for row in campaign.measurements):
        raise InputError(
            "every measurement is for validation and none is left to fit",
            where=str(path),
            needed='at least one measurement with use = "fit"',
        )
