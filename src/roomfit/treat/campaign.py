"""A treatment file, and a campaign with its result, as the arguments of `roomfit.treat`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError

from roomfit.base.arguments import check_known
from roomfit.base.bands import Bands, one_per_band
from roomfit.base.errors import InputError, located
from roomfit.base.findings import Finding
from roomfit.files.campaign import explained, read_toml
from roomfit.files.inputs import in_these
from roomfit.files.schema import (
    Campaign,
    Hertz,
    PerBand,
    Position,
    PriorSd,
    Spectrum,
    Table,
    json_schema,
    limited,
    the_one,
)
from roomfit.materials.catalogue import catalogue_prior
from roomfit.predict.changes import Change
from roomfit.room.scene import Room, Scene
from roomfit.signals.decay import jnd_of
from roomfit.treat import question
from roomfit.treat.polygons import forbidden_area_m2
from roomfit.treat.standards import standard_target
from roomfit.uncertainty.posterior import AbsorptionPosterior

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


def read_treatment(path: Path) -> TreatmentTable:
    """Read a treatment file."""
    return checked_treatment(path, read_toml(path, "treatment file"))


def checked_treatment(path: Path, content: Mapping[str, Any]) -> TreatmentTable:
    """Return the content of a treatment file, checked key by key; the path is for messages."""
    try:
        return TreatmentTable.model_validate(content)
    except ValidationError as error:
        raise explained(path, error, TreatmentTable, "treatment file") from None


def treat_arguments(
    path: Path, table: TreatmentTable, known: AbsorptionPosterior, scene: Scene
) -> tuple[dict[str, Any], tuple[Finding, ...]]:
    """Return a treatment file as arguments, and what is in doubt about its standards."""
    surfaces = tuple(
        question.Surface(
            name,
            s.free_m2,
            float(np.sum(s.forbidden_m2)) + _forbidden_m2(path, name, s.forbidden, scene.room),
            np.inf if s.depth_m is None else s.depth_m,
            tuple(s.products),
        )
        for name, s in table.surfaces.items()
    )
    products = []
    for name, p in table.products.items():
        with located(f'{path}, products."{name}"'):
            products.append(_product(name, p, known))
    targets: list[question.Target] = []
    findings: list[Finding] = []
    for i, t in enumerate(table.targets, start=1):
        with located(f"{path}, targets[{i}]"):
            target, doubts = _target(t, scene.room)
            question.row_weights(target, known.bands)
            if not target.bands_hz and target.parameter != "STI":  # those that are left are named
                usual = tuple(f for f in question.USUAL_HZ if f in known.bands.centres_hz)
                target = replace(target, bands_hz=usual)
            targets.append(target)
            findings += doubts
    with located(str(path)):
        question.columns_of(scene, surfaces, products)
    return {
        "surfaces": surfaces,
        "products": tuple(products),
        "targets": tuple(targets),
        "number": table.number,
        "probability": table.probability,
        "most_cost": np.inf if table.most_cost is None else table.most_cost,
    }, tuple(findings)


def hardest_changes(arguments: Mapping[str, Any], bands: Bands) -> tuple[tuple[Change, ...], ...]:
    """Return surfaces wholly of what absorbs least: so long is a decay to be followed."""
    least = np.min([p.absorption for p in arguments["products"]], axis=0)
    return tuple(
        (Change(s.material, "value", tuple(np.full(len(bands), least).tolist())),)
        for s in arguments["surfaces"]
    )


def _forbidden_m2(
    path: Path, name: str, polygons: Sequence[Sequence[tuple[float, float, float]]], room: Room
) -> float:
    with located(f'{path}, surfaces."{name}", forbidden'):
        return forbidden_area_m2(room, name, [np.array(corners) for corners in polygons])


def _product(name: str, table: HungTable, known: AbsorptionPosterior) -> question.Product:
    bands = known.bands
    hint = "keep what is known best, and leave the others out"
    what, known_by = "a product has not one absorption", ("absorption", "catalogue", "material")
    the_one(table, known_by, what, "", hint)
    # a name stands for the room's own material first, as in a change
    entry = table.material or (table.catalogue if table.catalogue not in known.materials else "")
    if table.catalogue is not None:
        mean, sd = catalogue_prior(table.catalogue, bands)
    elif table.material is not None:
        what = "a product is of a material that the room does not have"
        check_known(what, table.material, known.materials)
        mean = known.absorption[known.materials.index(table.material)]
        sd = np.zeros(len(bands))
    else:
        mean = one_per_band(in_these(table.absorption, bands, "absorption"), bands)
        sd = np.where((mean > 0.0) & (mean < 1.0), 0.05 if table.sd is None else table.sd, 0.0)
    return question.Product(
        name, mean, sd, table.cost_per_m2, table.piece_m2, table.depth_m, entry or ""
    )


def _target(table: TargetTable, room: Room) -> tuple[question.Target, tuple[Finding, ...]]:
    if table.standard is not None:
        own = table.model_fields_set - {"standard"}
        if own:
            raise InputError(
                "a target is a standard and has limits of its own",
                found=", ".join(sorted(own)),
                needed="one of the two: a second table [[targets]] holds as well",
                hint="write the limits below a [[targets]] of their own",
            )
        return standard_target(table.standard, room)
    name = question.target_name(table.parameter)
    low = -np.inf if table.at_least is None else table.at_least
    high = np.inf if table.at_most is None else table.at_most
    if table.value is not None:
        wide = table.tolerance
        wide = float(jnd_of(name, np.array(table.value))) if wide is None else wide
        low, high = max(low, table.value - wide), min(high, table.value + wide)
    return question.Target(name, low, high, tuple(table.bands_hz), table.mean_of_bands), ()


def schema_text(of: str) -> str:
    """Return the JSON schema of campaign files or of treatment files, for editors."""
    tables: dict[str, type[Table]] = {"campaign": Campaign, "treatment": TreatmentTable}
    check_known("no schema of this name", of, tables)
    return json.dumps(json_schema(tables[of], of.capitalize()), indent=2)
