"""What a file's data model complains of, as one message that says what, where, found and needed."""

from __future__ import annotations

import re
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from roomfit.base.arguments import did_you_mean
from roomfit.base.errors import InputError
from roomfit.files.schema import BECAUSE, GONE


def explained(path: Path, error: ValidationError, table: type[BaseModel]) -> InputError:
    """Turn pydantic's most telling complaint into one message in our words.

    Parameters
    ----------
    path : Path
        Of the file that was read.
    error : ValidationError
    table : type
        Of the whole file, whose keys are named where one is unknown.
    """
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
            hint=_meaning(table, place),
        )
    where = f"{path}, {_key_path(place)}"
    if (advice := _gone(table, first)) is not None:
        return InputError(
            "a key or value of the campaign file is of an earlier version",
            where=where,
            found=repr(place[-1] if first["type"] == "extra_forbidden" else first["input"]),
            needed="keys and values of this version",
            hint=advice,
        )
    if first["type"] == "extra_forbidden":
        key = str(first["loc"][-1])
        known = _known_keys(table, first["loc"][:-1])
        return InputError(
            "unknown key in the campaign file",
            where=where,
            found=repr(key),
            needed=f"one of {', '.join(known)}" if known else None,
            hint=did_you_mean(key, known),
        )
    if first["type"] == "missing":
        return InputError(
            "the campaign file lacks a key",
            where=f"{path}, {_key_path(place[:-1])}",
            found="no such key",
            needed=repr(str(place[-1])),
            hint=_meaning(table, place),
        )
    # where several kinds are taken, a number of the right kind but out of its range says most
    same = [c for c in complaints if _place(c) == place]
    ranged = [c for c in same if c["type"].endswith("than_equal")]
    needed = (_in_our_words(c["msg"]) for c in ranged or same)
    return InputError(
        "a value in the campaign file is not what it must be",
        where=where,
        found=repr(first.get("input")),
        needed=", or ".join(dict.fromkeys(needed)),
        hint=(_reason(table, place) if ranged else None) or _meaning(table, place),
    )


def _gone(table: type[BaseModel], complaint: ErrorDetails) -> str | None:
    """Return what to do without a key, or a value, that earlier versions had."""
    place, model, known = _place(complaint), table, []
    for part in place[:-1]:
        field = _fields(model).get(str(part))
        if field is not None:
            known.append(str(part))
            model = next(iter(_models_within(field.annotation)), model)
    key = ".".join([*known, str(place[-1])]) if place else ""
    is_value = complaint["type"] == "literal_error"
    return GONE.get(f"{key} = {complaint['input']}" if is_value else key)


def _in_our_words(message: str) -> str:
    text = re.sub(_OF_PYDANTIC, "", message)
    text = re.sub(r"greater than or equal to (\S+)", r"\1 or more", text)
    text = re.sub(r"less than or equal to (\S+)", r"\1 or less", text)
    return text.replace("a valid dictionary", "a table").replace("valid tuple", "valid list")


_OF_PYDANTIC = (
    r"^Input should be |^\w+ should have |, unable to parse.*| after validation.*"
    r"| or (instance|an object).*"
)


def _key(table: type[BaseModel], place: tuple[int | str, ...]) -> FieldInfo | None:
    """Return the innermost key of the file's model on the way to a place."""
    model, found = table, None
    for part in place:
        field = _fields(model).get(str(part))
        if field is not None:
            found = field
            model = next(iter(_models_within(field.annotation)), model)
    return found


def _reason(table: type[BaseModel], place: tuple[int | str, ...]) -> str | None:
    """Return why a number of the file ends where it does."""
    key = _key(table, place)
    return next(_reasons(key), None) if key else None


def _meaning(table: type[BaseModel], place: tuple[int | str, ...]) -> str:
    """Return what a key means, in the first sentence that the schema says of it."""
    key = _key(table, place)
    words = " ".join((key.description or "").split()) if key else ""
    return f"{words.partition('. ')[0].rstrip('.')} (roomfit schema prints all keys)".lstrip()


def _reasons(part: Any) -> Iterator[str]:
    """Yield why the numbers of a key end where they do, of unions and lists the first."""
    if isinstance(part, FieldInfo):
        if isinstance(part.json_schema_extra, dict) and BECAUSE in part.json_schema_extra:
            yield str(part.json_schema_extra[BECAUSE])
        part = part.annotation
    for inner in (*get_args(part), *getattr(part, "__metadata__", ())):
        yield from _reasons(inner)


def _place(complaint: ErrorDetails) -> tuple[int | str, ...]:
    """Return where in the file a complaint points, without the names of union members."""
    return tuple(
        part
        for part in complaint["loc"]
        if isinstance(part, int)
        or not (part.endswith("Table") or "[" in part or part in _MEMBER_NAMES)
    )


_MEMBER_NAMES = {
    *("AreaSpectrum", "AreaPrior", "Spectrum", "Prior"),
    *("Directivity", "MeasuredDirectivity", "SharedDirectivity"),
    *("float", "str", "int", "constrained-float", "constrained-str"),
}


def _key_path(location: tuple[int | str, ...]) -> str:
    text = ""
    for part in location:
        text += f"[{part + 1}]" if isinstance(part, int) else f".{part}"
    return text.lstrip(".") or "top level"


def _known_keys(table: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Return the keys that the table at a location may have."""
    model = table
    for part in location:
        if isinstance(part, str) and part in _fields(model):
            inner = _models_within(_fields(model)[part].annotation)
            if not inner:
                return []
            model = inner[0]
    return sorted(_fields(model))


def _fields(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Return the fields of a table by the names of their keys in the file."""
    return {field.alias or name: field for name, field in model.model_fields.items()}


def _models_within(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) in (Union, types.UnionType, dict, list):
        return [m for a in get_args(annotation) for m in _models_within(a)]
    return []
