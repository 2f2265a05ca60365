"""The treatment file, for ``roomfit treat``: every key with its type, range and default."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from roomfit.files.schema import Hertz, PerBand, Position, PriorSd, Spectrum, Table, limited

SquareMetre = Annotated[float, limited(0.0, 1e6, "m2; no surface of a room is larger")]
Depth = Annotated[float, limited(0.0, 10.0, "m; what is deeper is a piece of furniture")]


class TreatedTable(Table):
    """``[surfaces."NAME"]`` of a treatment: a material of the room that may be covered."""

    free_m2: SquareMetre | None = None
    """Area that may be covered. Default: all of it."""
    forbidden_m2: SquareMetre | list[SquareMetre] = 0.0
    """Of the free area: doors, lamps, what must stay; one number, or one for each piece."""
    forbidden: list[Annotated[list[Position], Field(min_length=3, max_length=200)]] = Field([])
    """Such pieces by their corners in m, as polygons on the surface; beside `forbidden_m2`."""
    depth_m: Depth | None = None
    """How deep a product may be. Default: any."""
    products: list[str] = Field([])
    """Which products may hang there. Default: all."""


class HungTable(Table):
    """``[products."NAME"]`` of a treatment: one of absorption, catalogue and material."""

    absorption: PerBand | Spectrum | None = None
    """Number, list by band, or {centres_hz, values}."""
    sd: PriorSd | None = None
    """Standard deviation of `absorption`. Default: 0.05."""
    catalogue: str | None = None
    """Entry of the catalogue, with its spread."""
    material: str | None = None
    """Material of the room that was identified, with all that is known of it."""
    cost_per_m2: Annotated[float, limited(0.0, 1e6, "in any one unit of your own")] = 1.0
    """Cost, or how unwelcome it is."""
    piece_m2: Annotated[float, limited(1e-3, 1e6, "m2; of one piece")] = 1.0
    """Least area: whole pieces are hung."""
    depth_m: Depth = 0.0
    """Depth."""


class TargetTable(Table):
    """``[[targets]]`` of a treatment: a standard, or limits of a parameter."""

    standard: str | None = None
    """Entry of roomfit's standards, as din-18041-a3."""
    parameter: str = "T30_s"
    """Any that `roomfit predict` names; STI has no bands."""
    at_most: float | None = None
    """Upper limit."""
    at_least: float | None = None
    """Lower limit."""
    value: float | None = None
    """In place of limits, with `tolerance`."""
    tolerance: Annotated[float, limited(0.0, 1e3, "of the parameter's own unit")] | None = None
    """About `value`, either way. Default: a just noticeable difference."""
    bands_hz: list[Hertz] = Field([])
    """Centres. Default: 500, 1000 and 2000 Hz."""
    mean_of_bands: bool = False
    """Whether the limits are of the mean of these bands."""


class TreatmentTable(Table):
    """A treatment file, for ``roomfit treat``."""

    format_version: Literal[1] = 1
    """Of this file's format: 1, the only one."""
    surfaces: dict[str, TreatedTable] = Field(min_length=1)
    """Which surfaces may be covered, by the name of their material."""
    products: dict[str, HungTable] = Field(min_length=1)
    """What may be hung, by name."""
    targets: list[TargetTable] = Field(min_length=1)
    """What is to be reached, as means over all pairs."""
    number: Annotated[int, limited(1, 20, "more answers than one reads")] = 3
    """How many arrangements are wanted."""
    probability: Annotated[float, limited(0.5, 0.99, "half: just met; 1 is never reached")] = 0.5
    """With which each target is to be met in each band."""
    most_cost: Annotated[float, limited(0.0, 1e12, "in the unit of cost_per_m2")] | None = None
    """What all of it may cost."""


def treatment_schema() -> dict[str, Any]:
    """Return the JSON schema of a treatment file."""
    own = TreatmentTable.model_json_schema()
    title = {"title": "Treatment of roomfit, format_version 1"}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **own, **title}
