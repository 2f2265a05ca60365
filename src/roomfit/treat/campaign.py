"""A treatment file, and a campaign with its result, as the arguments of `roomfit.treat`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from pydantic import ValidationError

from roomfit.base.arguments import check_known
from roomfit.base.bands import Bands
from roomfit.base.errors import InputError, located
from roomfit.base.findings import Finding
from roomfit.base.typing import FloatArray
from roomfit.files.campaign import read_toml
from roomfit.files.complaints import explained
from roomfit.files.inputs import at_bands
from roomfit.files.schema import Spectrum
from roomfit.files.treatment_schema import HungTable, TargetTable, TreatmentTable
from roomfit.materials.catalogue import catalogue_prior
from roomfit.predict.changes import Change
from roomfit.room.scene import Room, Scene
from roomfit.signals.decay import jnd_of
from roomfit.treat.polygons import forbidden_area_m2
from roomfit.treat.question import (
    USUAL_HZ,
    Product,
    Surface,
    Target,
    columns_of,
    row_weights,
    target_name,
)
from roomfit.treat.standards import standard_target
from roomfit.uncertainty.posterior import AbsorptionPosterior


def read_treatment(path: Path) -> TreatmentTable:
    """Read a treatment file."""
    return checked_treatment(path, read_toml(path, "treatment file"))


def checked_treatment(path: Path, content: Mapping[str, Any]) -> TreatmentTable:
    """Return the content of a treatment file, checked key by key; the path is for messages."""
    try:
        return TreatmentTable.model_validate(content)
    except ValidationError as error:
        found = explained(path, error, TreatmentTable)
        what = found.what.replace("campaign file", "treatment file")
        raise InputError(
            what, where=found.where, found=found.found, needed=found.needed, hint=found.hint
        ) from None


def treat_arguments(
    path: Path, table: TreatmentTable, known: AbsorptionPosterior, scene: Scene
) -> tuple[dict[str, Any], tuple[Finding, ...]]:
    """Return a treatment file as arguments, and what is in doubt about its standards."""
    surfaces = tuple(
        Surface(
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
    targets: list[Target] = []
    findings: list[Finding] = []
    for i, t in enumerate(table.targets, start=1):
        with located(f"{path}, targets[{i}]"):
            target, doubts = _target(t, scene.room)
            row_weights(target, known.bands)
            if not target.bands_hz and target.parameter != "STI":  # those that are left are named
                usual = tuple(f for f in USUAL_HZ if f in known.bands.centres_hz)
                target = replace(target, bands_hz=usual)
            targets.append(target)
            findings += doubts
    with located(str(path)):
        columns_of(scene, surfaces, products)
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


def _product(name: str, table: HungTable, known: AbsorptionPosterior) -> Product:
    bands = known.bands
    given = [k for k in ("absorption", "catalogue", "material") if getattr(table, k) is not None]
    if len(given) != 1:
        raise InputError(
            "a product has not one absorption",
            found=", ".join(given) or "none of the three",
            needed="one of absorption, catalogue and material",
            hint="keep what is known best, and leave the others out",
        )
    material = ""
    if table.catalogue is not None:
        mean, sd = catalogue_prior(table.catalogue, bands)
    elif table.material is not None:
        material = table.material
        what = "a product is of a material that the room does not have"
        check_known(what, material, known.materials)
        mean = known.absorption[known.materials.index(material)]
        sd = np.zeros(len(bands))
    else:
        mean = _in_bands(cast("float | list[float] | Spectrum", table.absorption), bands)
        sd = np.where((mean > 0.0) & (mean < 1.0), 0.05 if table.sd is None else table.sd, 0.0)
    return Product(name, mean, sd, table.cost_per_m2, table.piece_m2, table.depth_m, material)


def _in_bands(values: float | Sequence[float] | Spectrum, bands: Bands) -> FloatArray:
    if isinstance(values, Spectrum):
        return at_bands(values.centres_hz, values.values, bands, "absorption")
    found = np.atleast_1d(np.array(values, dtype=np.float64))
    if found.size not in (1, len(bands)):
        raise InputError(
            "a product has not one absorption per predicted band",
            found=f"{found.size} values",
            needed=f"1 or {len(bands)}: {', '.join(f'{f:g}' for f in bands.centres_hz)} Hz",
            hint="{centres_hz = [...], values = [...]} fits any bands",
        )
    return np.broadcast_to(found, len(bands)).copy()


def _target(table: TargetTable, room: Room) -> tuple[Target, tuple[Finding, ...]]:
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
    name = target_name(table.parameter)
    low = -np.inf if table.at_least is None else table.at_least
    high = np.inf if table.at_most is None else table.at_most
    if table.value is not None:
        wide = table.tolerance
        wide = float(jnd_of(name, np.array(table.value))) if wide is None else wide
        low, high = max(low, table.value - wide), min(high, table.value + wide)
    return Target(name, low, high, tuple(table.bands_hz), table.mean_of_bands), ()
