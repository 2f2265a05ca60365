"""Every number of a campaign file with its limits; run it for the table of the documentation."""

from __future__ import annotations

import types
from collections.abc import Iterator
from typing import Any, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from roomfit.files.schema import BECAUSE, Campaign
from roomfit.settings import SETTING_LIMITS

# checked where their meaning is known: lengths after their unit, bands, and the air
ELSEWHERE = {
    "format_version": "1, the only one",
    "room.shoebox": "1 mm to 10 km, in the room's unit",
    "room.polygons.drop": "numbers of planes",
    "air.temperature_c": "see above",
    "air.humidity_percent": "see above",
    "air.pressure_kpa": "see above",
    "air.speed_of_sound_m_s": "250 to 450",
}


def numbers(model: type[BaseModel] = Campaign, at: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the place of every number in a campaign file, and what it may be."""
    for name, field in model.model_fields.items():
        place = f"{at}.{field.alias or name}".lstrip(".")
        own = [m for m in field.metadata if hasattr(m, "ge") or hasattr(m, "le")]
        yield from _within(field.annotation, place, own, _why(field))


def _why(field: FieldInfo) -> str | None:
    return (field.json_schema_extra or {}).get(BECAUSE)


def _within(
    annotation: Any, place: str, own: list[Any], why: str | None
) -> Iterator[tuple[str, Any]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield from numbers(annotation, place)
    elif annotation in (float, int):
        limits = {k: getattr(m, k) for m in own for k in ("ge", "le") if hasattr(m, k)}
        yield place, (limits.get("ge"), limits.get("le"), why)
    elif hasattr(annotation, "__metadata__"):
        limits = [m for m in annotation.__metadata__ if isinstance(m, FieldInfo)]
        inner = [k for f in limits for k in f.metadata]
        reason = next((_why(f) for f in limits if _why(f)), why)
        yield from _within(annotation.__origin__, place, inner, reason)
    elif get_origin(annotation) is dict:
        yield from _within(get_args(annotation)[1], f"{place}.NAME", own, why)
    elif get_origin(annotation) in (Union, types.UnionType, list, tuple):
        for part in get_args(annotation):
            yield from _within(part, place, own, why)


def limits() -> dict[str, tuple[float | None, float | None, str | None]]:
    """Return lowest, highest and the reason of every number by its place."""
    found = dict(numbers())
    return {
        place: SETTING_LIMITS[place.split(".")[1]] if place.startswith("settings.") else own
        for place, own in found.items()
    }


def table() -> list[str]:
    """Return the rows of the table in docs/campaign-file.md, one for each range and reason."""
    rows: dict[tuple[Any, ...], list[str]] = {}
    for place, own in limits().items():
        if place not in ELSEWHERE:
            rows.setdefault(own, []).append(f"`{place}`")
    return [
        f"| {', '.join(places)} | {low:.12g} | {high:.12g} | {why} |"
        for (low, high, why), places in rows.items()
    ]


if __name__ == "__main__":
    print("\n".join(table()))
