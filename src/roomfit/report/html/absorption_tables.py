"""Absorption in tables: coefficients with intervals, their mean, and absorption areas."""

from __future__ import annotations

import numpy as np

from roomfit.air import attenuation_per_m
from roomfit.geometry.measures import volume_m3
from roomfit.report.html.tables import (
    Cell,
    Row,
    Table,
    band_blocks,
    band_heads,
    block_caption,
)
from roomfit.report.html.wording import DASH, area, coefficient, number
from roomfit.scene.scene import Scene
from roomfit.typing import BoolArray, FloatArray, IntArray
from roomfit.uncertainty.answer import Answer
from roomfit.uncertainty.gaussian import LARGEST_PHI

NOT_IDENTIFIABLE = "not identif."


def given(answer: Answer) -> BoolArray:
    """Return which coefficients were held fixed, shape (n_materials, n_bands)."""
    return np.asarray(answer.lower95 == answer.upper95)


def absorption_tables(answer: Answer) -> tuple[Table, ...]:
    """Return absorption with its 95 % interval, materials in rows, with the mean of the room."""
    centres = answer.bands.centres_hz
    return tuple(
        Table(
            block_caption(
                f"Absorption coefficient, 95 % interval ({answer.interval_kind})", centres, block
            ),
            "material",
            band_heads(centres, block),
            (*_material_rows(answer, block), _mean_row(answer, block)),
        )
        for block in band_blocks(len(centres))
    )


def _material_rows(answer: Answer, block: IntArray) -> list[Row]:
    held = given(answer)
    return [
        Row(
            name,
            tuple(
                coefficient_cell(
                    answer.absorption[i, j],
                    answer.lower95[i, j],
                    answer.upper95[i, j],
                    sure=bool(answer.identifiable[i, j]),
                    held=bool(held[i, j]),
                )
                for j in block
            ),
            small=f"{area(float(answer.areas_m2[i]))} m²",
        )
        for i, name in enumerate(answer.materials)
    ]


def _mean_row(answer: Answer, block: IntArray) -> Row:
    total = float(np.sum(answer.areas_m2))
    cells = tuple(
        coefficient_cell(*answer.mean_absorption[:, j], sure=True, held=False) for j in block
    )
    return Row("mean of the room", cells, small=f"by area, {area(total)} m²", style="total")


def coefficient_cell(value: float, lower: float, upper: float, *, sure: bool, held: bool) -> Cell:
    """Return an absorption with its interval; doubt and given values are told in words."""
    if not np.isfinite(value):
        return Cell(DASH, ("not determined",), "unsure")
    if held:
        return Cell(coefficient(value, upper), ("given",), "given")
    text = coefficient(value, upper)
    interval = f"{coefficient(lower, upper)}{DASH}{coefficient(upper, upper)}"
    if sure:
        return Cell(text, (interval,))
    return Cell(f"({text})", (interval, NOT_IDENTIFIABLE), "unsure")


def fit_tables(answer: Answer) -> tuple[Table, ...]:
    """Return how well the model fits each band, and whether the fit came to rest."""
    centres = answer.bands.centres_hz
    return tuple(
        Table(
            block_caption("How well the model explains the data", centres, block),
            "",
            band_heads(centres, block),
            (
                Row("φ", tuple(_phi_cell(float(answer.phi[j])) for j in block), "1: as expected"),
                Row("the fit came to rest", tuple(_rest_cell(answer, j) for j in block)),
            ),
        )
        for block in band_blocks(len(centres))
    )


def _phi_cell(phi: float) -> Cell:
    if not np.isfinite(phi):
        return Cell(DASH, ("too few data",), "unsure")
    if phi > LARGEST_PHI:
        return Cell(number(phi, 1), ("does not fit",), "far")
    return Cell(number(phi, 1), ("fits",), "near")


def _rest_cell(answer: Answer, band: int) -> Cell:
    return Cell("yes") if answer.converged[band] else Cell("no", style="far")


def area_tables(answer: Answer, scene: Scene) -> tuple[Table, ...]:
    """Return equivalent absorption areas ``A = alpha S`` in m2, their sum, and the air's ``4 m V``.

    The interval of the sum is that of the mean absorption times the whole area. The air's part is
    the last term of the reverberation formula of ISO 354:2003, equation 6.
    """
    centres = answer.bands.centres_hz
    areas = answer.absorption * answer.areas_m2[:, None]
    walls = areas.sum(axis=0)
    air = 4.0 * attenuation_per_m(scene.air, answer.bands) * volume_m3(scene.room.mesh)
    bounds = answer.mean_absorption[1:] * float(np.sum(answer.areas_m2))
    return tuple(
        Table(
            block_caption(
                "Equivalent absorption area A = \N{GREEK SMALL LETTER ALPHA}S in m²", centres, block
            ),
            "material",
            ("S in m²", *band_heads(centres, block)),
            (
                *_area_rows(answer, areas, block),
                _wall_row(answer, walls, bounds, block),
                _sum_row("air, 4mV", air, block, f"V = {area(volume_m3(scene.room.mesh))} m³"),
                _sum_row("total", walls + air, block, "surfaces and air", "total"),
            ),
        )
        for block in band_blocks(len(centres))
    )


def _area_rows(answer: Answer, areas: FloatArray, block: IntArray) -> list[Row]:
    rows = []
    for i, name in enumerate(answer.materials):
        cells = [Cell(area(float(answer.areas_m2[i])), style="first")]
        for j in block:
            cell = _area_cell(float(areas[i, j]))
            if np.isfinite(areas[i, j]) and not answer.identifiable[i, j]:
                cell = Cell(f"({cell.text})", style="unsure")
            cells.append(cell)
        rows.append(Row(name, tuple(cells)))
    return rows


def _wall_row(answer: Answer, walls: FloatArray, bounds: FloatArray, block: IntArray) -> Row:
    cells = []
    for j in block:
        known = bool(np.isfinite(bounds[:, j]).all())
        interval = f"{area(bounds[0, j])}{DASH}{area(bounds[1, j])}" if known else ""
        cells.append(_area_cell(float(walls[j]), interval))
    whole = Cell(area(float(np.sum(answer.areas_m2))), style="first")
    return Row("all surfaces", (whole, *cells), "95 % interval below", style="total")


def _sum_row(head: str, values: FloatArray, block: IntArray, small: str, style: str = "") -> Row:
    cells = tuple(_area_cell(float(values[j])) for j in block)
    return Row(head, (Cell("", style="first"), *cells), small, style=style)


def share_tables(answer: Answer) -> tuple[Table, ...]:
    """Return what share of the room's absorption each material contributes, with its interval."""
    if answer.shares is None:
        return ()
    centres, shares = answer.bands.centres_hz, answer.shares
    return tuple(
        Table(
            block_caption(
                "Share of the surfaces' absorption in %, 95 % interval below", centres, block
            ),
            "material",
            band_heads(centres, block),
            tuple(
                Row(name, tuple(_share_cell(*shares[:, i, j]) for j in block))
                for i, name in enumerate(answer.materials)
            ),
        )
        for block in band_blocks(len(centres))
    )


def prior_tables(answer: Answer) -> tuple[Table, ...]:
    """Return what was known beforehand, in the order of `absorption_tables`."""
    if answer.prior is None:
        return ()
    centres, prior, held = answer.bands.centres_hz, answer.prior, given(answer)
    return tuple(
        Table(
            block_caption("Known or assumed beforehand, 95 % interval", centres, block),
            "material",
            band_heads(centres, block),
            tuple(
                Row(
                    name,
                    tuple(
                        coefficient_cell(*prior[:, i, j], sure=True, held=bool(held[i, j]))
                        for j in block
                    ),
                )
                for i, name in enumerate(answer.materials)
            ),
        )
        for block in band_blocks(len(centres))
    )


def _share_cell(value: float, lower: float, upper: float) -> Cell:
    told = [number(100.0 * x, 0) for x in (value, lower, upper)]
    return Cell(told[0], (f"{told[1]}{DASH}{told[2]}",))


def _area_cell(value_m2: float, interval: str = "") -> Cell:
    if not np.isfinite(value_m2):
        return Cell(DASH, ("not determined",), "unsure")
    return Cell(area(value_m2), (interval,) if interval else ())
