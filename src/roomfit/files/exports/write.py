"""From a table of materials to the files that another program reads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from roomfit.bands import Bands
from roomfit.errors import InputError
from roomfit.files.exports.catt import (
    CATT_BANDS,
    ISIMPA_BANDS,
    LONGEST_NAME,
    catt_text,
    isimpa_text,
)
from roomfit.files.exports.names import short_names
from roomfit.files.exports.odeon import FIRST_NUMBER, ODEON_BANDS, odeon_text
from roomfit.files.exports.plain import csv_text, pyroomacoustics_text
from roomfit.files.exports.raven import RAVEN_BANDS, raven_text
from roomfit.files.exports.resample import resample
from roomfit.files.exports.table import MaterialTable
from roomfit.findings import Finding
from roomfit.typing import BoolArray, FloatArray

ExportFormat = Literal["catt", "odeon", "isimpa", "raven", "pyroomacoustics", "csv"]
FORMATS: tuple[ExportFormat, ...] = get_args(ExportFormat)
_LONGEST_FILE_NAME = 60


@dataclass(frozen=True, slots=True, eq=False)
class Exported:
    """Files to be written.

    Attributes
    ----------
    texts : dict
        File name to content. One entry named "" for a format that is a single file, whose name
        the user chooses.
    findings : tuple of Finding
        What a reader of the files must know: filled bands, values that the data do not hold.
    """

    texts: dict[str, str]
    findings: tuple[Finding, ...]


def export_materials(table: MaterialTable, wanted: str, scattering: float) -> Exported:
    """Return the files of one format.

    Parameters
    ----------
    table : MaterialTable
    wanted : str
        One of `FORMATS`.
    scattering : float
        Coefficient of every material in every band where the table has none, 0 to 1.

    Raises
    ------
    InputError
        There is no such format, or the scattering is out of range.
    """
    if wanted not in FORMATS:
        raise InputError(
            "no such format for an export", found=repr(wanted), needed=", ".join(FORMATS)
        )
    if not 0.0 <= scattering <= 1.0:
        raise InputError(
            "scattering coefficient out of range", found=f"{scattering:g}", needed="0 to 1"
        )
    told = table.scattering
    scatter = np.full(table.absorption.shape, scattering) if told is None else told
    findings = [*_not_identifiable(table)]
    if told is None and wanted not in ("csv", "odeon"):
        findings.append(_scattering_assumed(scattering))
    if wanted == "pyroomacoustics":
        return Exported({"": pyroomacoustics_text(table, scatter)}, tuple(findings))
    if wanted == "csv":
        return Exported({"": csv_text(table)}, tuple(findings))
    bands = {
        "catt": CATT_BANDS,
        "isimpa": ISIMPA_BANDS,
        "odeon": ODEON_BANDS,
        "raven": RAVEN_BANDS,
    }[wanted]
    absorption, filled = resample(table.absorption, table.bands, bands)
    scatter, _ = resample(scatter, table.bands, bands)
    if np.any(filled):
        findings.append(_bands_filled(bands, filled))
    if wanted == "odeon":
        findings.append(_odeon_numbers(table))
        return Exported({"": odeon_text(table.names, absorption)}, tuple(findings))
    longest = _LONGEST_FILE_NAME if wanted == "raven" else LONGEST_NAME
    names = short_names(table.names, longest)
    findings += _renamed(names)
    texts = _texts(wanted, table, names, absorption, scatter, [f.sentence for f in findings])
    return Exported(texts, tuple(findings))


def _texts(
    wanted: str,
    table: MaterialTable,
    names: dict[str, str],
    absorption: FloatArray,
    scattering: FloatArray,
    remarks: list[str],
) -> dict[str, str]:
    if wanted == "catt":
        head = ["absorption in percent, fitted by roomfit; exact values behind each line"]
        return {"": catt_text(names, absorption, scattering, [*head, *remarks])}
    if wanted == "isimpa":
        return {"": isimpa_text(names, absorption, scattering)}
    fitted = np.isin(
        np.round(RAVEN_BANDS.exact_centres_hz, 3), np.round(table.bands.exact_centres_hz, 3)
    )
    return {
        f"{short}.mat": raven_text(
            short, _raven_notes(table, i), absorption[i], scattering[i], fitted
        )
        for i, short in enumerate(names.values())
    }


def _raven_notes(table: MaterialTable, material: int) -> str:
    notes = "Fitted by roomfit; 1 in interpol: no fitted band"
    sure = table.identifiable[material]
    return notes if np.all(sure) else f"{notes}; not determined {_where(table.bands, ~sure)}"


def _where(bands: Bands, chosen: BoolArray) -> str:
    if np.all(chosen):
        return "in any band"
    return f"at {', '.join(f'{f:g}' for f in bands.centres_hz[chosen])} Hz"


def _bands_filled(bands: Bands, filled: BoolArray) -> Finding:
    listed = [f"{f:g}" for f in bands.centres_hz[filled]]
    return Finding(
        "export-bands-filled",
        "info",
        f"Nothing was fitted at {', '.join(listed)} Hz: the nearest band's value stands there, or "
        "one between two neighbours.",
        {"bands_hz": [float(f) for f in bands.centres_hz[filled]]},
    )


def _not_identifiable(table: MaterialTable) -> list[Finding]:
    doubtful = {
        name: [float(f) for f in table.bands.centres_hz[~sure]]
        for name, sure in zip(table.names, table.identifiable, strict=True)
        if not np.all(sure)
    }
    if not doubtful:
        return []
    listed = "; ".join(
        f"{name} {_where(table.bands, ~sure)}"
        for name, sure in zip(table.names, table.identifiable, strict=True)
        if not np.all(sure)
    )
    return [
        Finding(
            "export-not-identifiable",
            "warning",
            f"The measurement does not determine {listed}; the exported values there are not to "
            "be trusted one by one.",
            {"materials": doubtful},
        )
    ]


def _scattering_assumed(scattering: float) -> Finding:
    return Finding(
        "export-scattering-assumed",
        "info",
        f"The result tells no scattering; {scattering:g} was written for every material.",
        {"scattering": scattering},
    )


def _odeon_numbers(table: MaterialTable) -> Finding:
    last = FIRST_NUMBER + len(table.names) - 1
    return Finding(
        "export-without-scattering",
        "info",
        f"The materials have the numbers {FIRST_NUMBER} to {last}. ODEON's library holds no "
        "scattering: enter it in the list of materials.",
        {"first": FIRST_NUMBER, "last": last},
    )


def _renamed(names: dict[str, str]) -> list[Finding]:
    changed = {name: short for name, short in names.items() if name != short}
    if not changed:
        return []
    listed = ", ".join(f"{short} for {name}" for name, short in changed.items())
    return [
        Finding(
            "export-names-changed",
            "info",
            f"The other program cannot take every name; it is {listed}.",
            {"names": changed},
        )
    ]
