"""A treatment as treatment.json and treatment.csv (format_version 1)."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from roomfit.base.table import Column, Table, csv_of
from roomfit.base.whole_files import write_json_atomically, write_text_atomically
from roomfit.files.encoding import finding_content, numbers_or_null, provenance
from roomfit.predict.output import one_number, parameters_content

if TYPE_CHECKING:
    from roomfit.treat.arrangements import Arrangement, Treatment
    from roomfit.treat.question import Target


def write_treatment(
    folder: Path, treatment: Treatment, sentence: str, inputs: Iterable[Path]
) -> None:
    """Write ``treatment.json`` and, a row a product on a surface, ``.csv`` into a folder."""
    columns = (
        *("arrangement", "surface", "product", Column("area_m2", ".3f"), Column("share", ".4f")),
        *("cost", Column("probability_of_all", ".3f")),
    )
    rows = [
        (number, h.surface, h.product, h.area_m2, h.share, a.cost, a.joint)
        for number, a in enumerate(treatment.arrangements, start=1)
        for h in a.hung
    ]
    write_text_atomically(folder / "treatment.csv", csv_of(Table("", columns, rows)))
    # lists are as long as bands_hz, null stands where nothing is known
    content = {
        "format": "roomfit-treatment",
        "format_version": 1,
        "bands_hz": treatment.bands.centres_hz,
        "is_met": treatment.is_met,
        "probability_asked": treatment.asked,
        "sentence": sentence,
        "targets": [_target_content(t) for t in treatment.targets],
        "arrangements": [_arrangement_content(a) for a in treatment.arrangements],
        "to_measure": list(treatment.to_measure),
        "findings": [finding_content(f) for f in treatment.findings],
        "provenance": provenance(inputs),
    }
    write_json_atomically(folder / "treatment.json", content)


def _target_content(target: Target) -> dict[str, Any]:
    return {
        "parameter": target.parameter,
        "at_least": numbers_or_null(target.low),
        "at_most": numbers_or_null(target.high),
        "bands_hz": list(target.bands_hz),
        "mean_of_bands": target.mean_of_bands,
        "source": target.source,
    }


def _arrangement_content(a: Arrangement) -> dict[str, Any]:
    return {
        "hung": [
            {"surface": h.surface, "product": h.product, "area_m2": h.area_m2, "set": h.change}
            for h in a.hung
        ],
        "cost": a.cost,
        "probability": a.probability,
        "probability_before": a.before,
        "probability_of_all": a.joint,
        "missed": list(a.missed),
        "decisive": [{"material": name, "share": share} for name, share in a.decisive],
        "mean": parameters_content(a.mean),
        "sti": one_number(a.sti),
    }
