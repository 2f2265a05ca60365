"""A design as design.json and design.csv (format_version 1)."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from roomfit.base.table import Column, Table, csv_of
from roomfit.base.typing import FloatArray
from roomfit.base.whole_files import write_json_atomically, write_text_atomically
from roomfit.files.encoding import finding_content, numbers_or_null, provenance
from roomfit.room.scene import wall_materials

if TYPE_CHECKING:
    from roomfit.design.positions import Design


def mean_widths(design: Design) -> FloatArray:
    """Return the mean width over all bands and all that is compared, shape (n_chosen + 1,)."""
    return np.asarray(design.widths[:, design.compared].mean(axis=(1, 2)))


def widest(design: Design) -> tuple[int, int]:
    """Return material and band of the widest interval before any of the chosen pairs."""
    widths = np.where(design.compared[:, None], design.widths[0], 0.0)
    material, band = np.unravel_index(int(np.argmax(widths)), widths.shape)
    return int(material), int(band)


def write_design(folder: Path, design: Design, inputs: Iterable[Path]) -> None:
    """Write ``design.json`` and ``design.csv`` into a folder."""
    write_text_atomically(folder / "design.csv", csv_of(design_records(design)))
    write_json_atomically(folder / "design.json", design_content(design, inputs))


def design_content(design: Design, inputs: Iterable[Path]) -> dict[str, Any]:
    """Return what design.json holds: lists over bands are as long as bands_hz."""
    means, (material, band) = mean_widths(design), widest(design)
    return {
        "format": "roomfit-design",
        "format_version": 1,
        "bands_hz": design.bands.centres_hz,
        "chosen": [
            {
                "source": source,
                "source_m": source_m,
                "receiver": receiver,
                "receiver_m": receiver_m,
                "mean_width95": float(means[i + 1]),
                **_by_material(design, design.widths[i + 1], "width95", "width95_m2"),
            }
            for i, (source, source_m, receiver, receiver_m) in enumerate(chosen_positions(design))
        ],
        "before": {
            "mean_width95": float(means[0]),
            **_by_material(design, design.widths[0], "width95", "width95_m2"),
            "after_fit": design.after_fit,
            "measured_pairs": design.n_fixed,
        },
        "widest": {
            "material": design.materials[material],
            "band_hz": float(design.bands.centres_hz[band]),
            "width95": design.widths[:, material, band],
        },
        "random": _random(design),
        "candidates": len(design.scene.pairs) - design.n_fixed,
        "assumed": {
            "criterion": design.criterion,
            "draws": design.n_draws,
            **_by_material(design, design.absorption, "absorption", "absorption_area_m2"),
            "source_distance_m": design.source_distance_m,
            "receiver_distance_m": design.receiver_distance_m,
            "wall_distance_m": design.wall_distance_m,
        },
        "findings": [finding_content(f) for f in design.findings],
        "design": {"seed": design.seed, "seconds": round(design.seconds, 3)},
        "provenance": provenance(inputs),
    }


def design_records(design: Design) -> Table:
    """Return the content of design.csv: one row a chosen pair, and the mean width after it."""
    columns = (
        *("number", "source", "source_x_m", "source_y_m", "source_z_m"),
        *("receiver", "receiver_x_m", "receiver_y_m", "receiver_z_m"),
        *("distance_m", Column("mean_width95", ".4f")),
    )
    after, rows = mean_widths(design)[1:].tolist(), []
    for i, (source, source_m, receiver, receiver_m) in enumerate(chosen_positions(design)):
        ends = (source, *source_m.tolist(), receiver, *receiver_m.tolist())
        distance_m = float(np.linalg.norm(source_m - receiver_m))
        rows.append((i + 1, *ends, distance_m, after[i]))
    return Table("", columns, rows, form=".3f")


def chosen_positions(design: Design) -> list[tuple[str, FloatArray, str, FloatArray]]:
    """Return names and positions of source and receiver of every chosen pair."""
    found = []
    for s, r in design.scene.pairs[design.chosen]:
        source, receiver = design.scene.sources[s], design.scene.receivers[r]
        found.append((source.name, source.position_m, receiver.name, receiver.position_m))
    return found


def _by_material(
    design: Design, table: FloatArray, of_walls: str, of_objects: str
) -> dict[str, Any]:
    """Return the rows of walls under one key, and those of objects, if any, under another."""
    n = len(wall_materials(design.scene.room))
    each = list(zip(design.materials, table, strict=True))
    return {of_walls: dict(each[:n])} | ({of_objects: dict(each[n:])} if each[n:] else {})


def _random(design: Design) -> dict[str, Any]:
    """Return how random designs do after 0 to n pairs: null where none went so far."""
    means = design.random_means
    reached = np.isfinite(means).any(axis=0)
    out: dict[str, Any] = {"designs": len(means)}
    for name, share in (("median", 0.5), ("lower5", 0.05), ("upper95", 0.95)):
        row = np.full(means.shape[1], np.nan)
        if len(means):
            row[reached] = np.nanquantile(means[:, reached], share, axis=0)
        out[f"mean_width95_{name}"] = numbers_or_null(row)
    return out
