"""Materials of a result as files of other programs.

A table of absorption is resampled to the bands of the other program, given names that it accepts,
and written: for CATT-Acoustic and I-Simpa (which reads the same lines without the first word),
ODEON (a material library, .Li8), pyroomacoustics (its arguments as JSON), or as a wide CSV.
"""

from __future__ import annotations

import colorsys
import json
import re
import unicodedata
from collections.abc import Sequence
from typing import Any, Literal, get_args

import numpy as np

from roomfit.base.arguments import check_known, check_range
from roomfit.base.bands import Bands, bands_between
from roomfit.base.door import complete
from roomfit.base.errors import located
from roomfit.base.findings import About, Code, Finding
from roomfit.base.table import Table, csv_of, workbook_of
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.files.encoding import ResultFile, one_line, path_of
from roomfit.files.results import MaterialTable, read_materials
from roomfit.materials.ratings import (
    noise_reduction_coefficient,
    rated_bands,
    weighted_absorption,
)
from roomfit.result import absorption_records

ExportFormat = Literal["catt", "odeon", "isimpa", "pyroomacoustics", "csv"]
FORMATS: tuple[ExportFormat, ...] = get_args(ExportFormat)
_BANDS = {
    "catt": bands_between("octave", 125.0, 16e3),
    "isimpa": bands_between("octave", 125.0, 4e3),
    "odeon": bands_between("octave", 63.0, 8e3),
}
_LONGEST_NAME = 15
_FIRST_NUMBER = 50001  # of a material in a library of ODEON


def catt_text(
    names: dict[str, str], absorption: FloatArray, scattering: FloatArray, remarks: list[str]
) -> str:
    """Return ``ABS`` lines for a .geo file: octaves 125 Hz to 4 kHz, a colon, 8 and 16 kHz.

    Percent without decimals, 1 to 99: what every version reads. The exact values follow behind a
    semicolon, where a .geo file's comments begin, as do the remarks at the top. `names` are own
    and short names in the order of the rows; arrays have the shape (n_materials, 8).
    """
    lines = [f"; {one_line(remark)}" for remark in remarks]
    for i, (name, short) in enumerate(names.items()):
        # far apart on the circle of hues
        hue = colorsys.hsv_to_rgb(i / max(len(names), 1), 0.55, 0.85)
        colour = " ".join(str(round(255 * part)) for part in hue)
        exact = " ".join(f"{v:.4f}" for v in absorption[i])
        own, scattered = (
            f"<{_percent(x[i, :6], least)} : {_percent(x[i, 6:], least)}>"
            for x, least in ((absorption, 1), (scattering, 0))
        )
        lines.append(f"ABS {short} = {own} L {scattered} {{{colour}}} ; {one_line(name)}: {exact}")
    return "\r\n".join(lines) + "\r\n"


def _isimpa_text(names: dict[str, str], absorption: FloatArray, scattering: FloatArray) -> str:
    """Return the material lines that I-Simpa imports as "CATT-Acoustic" (.txt), without comments.

    Six octaves from 125 Hz in percent without decimals, as in the example of its documentation
    ("Project database", materials, import from a file).
    """
    lines = [
        f"{short} = < {_percent(absorption[i], 1)} > L < {_percent(scattering[i], 0)} >"
        for i, short in enumerate(names.values())
    ]
    return "\n".join(lines) + "\n"


def _percent(values: FloatArray, least: int) -> str:
    return " ".join(str(int(np.clip(round(100.0 * v), least, 99))) for v in values)


def short_names(names: tuple[str, ...]) -> dict[str, str]:
    """Return a name of ASCII letters, digits and underscores for each, beginning with a letter.

    At most 15 of them. No two are alike, not even in another case, which some programs ignore.
    """
    given: dict[str, str] = {}
    for name in names:
        plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
        word = re.sub(r"[^A-Za-z0-9]+", "_", plain).strip("_") or "material"
        word = word if word[0].isalpha() else f"m_{word}"
        candidate, number = word[:_LONGEST_NAME], 1
        while candidate.lower() in (g.lower() for g in given.values()):
            number += 1
            candidate = f"{word[: _LONGEST_NAME - len(str(number)) - 1]}_{number}"
        given[name] = candidate
    return given


def _odeon_text(names: tuple[str, ...], absorption: FloatArray) -> str:
    """Return two lines a material: number and name; then eight octaves from 63 Hz.

    The second line begins with a tabulator, and tabulators separate its values: a program that
    reads ODEON's own library distinguishes the two by it (R. Gueguen, Just4RIR, 2018).
    """
    lines = []
    for i, name in enumerate(names):
        lines.append(f"{_FIRST_NUMBER + i} {one_line(name)}")
        lines.append("".join(f"\t{v:.5f}" for v in absorption[i]))
    return "\r\n".join(lines) + "\r\n"


def resample(values: FloatArray, bands: Bands, wanted: Bands) -> tuple[FloatArray, BoolArray]:
    """Return values, shape (n_materials, n_wanted), and which of these bands were not fitted.

    A band that is there is taken as it is; an octave from third octaves is their mean; a third
    octave within the range of the octaves is interpolated linearly in the logarithm of frequency.
    Beyond the lowest and the highest band the nearest value is repeated, and gaps between bands
    are interpolated: those are the ones that were not fitted.
    """
    at, known = np.log2(wanted.exact_centres_hz), np.log2(bands.exact_centres_hz)
    resampled = np.array([np.interp(at, known, row) for row in values])
    filled = np.ones(len(wanted), dtype=np.bool_)
    for i, (low, high) in enumerate(zip(wanted.lower_hz, wanted.upper_hz, strict=True)):
        inside = (bands.exact_centres_hz > low) & (bands.exact_centres_hz < high)
        if np.any(inside):
            resampled[:, i] = values[:, inside].mean(axis=1)
        centre = wanted.exact_centres_hz[i]
        covering = (bands.lower_hz < centre) & (centre < bands.upper_hz)
        filled[i] = not (np.any(inside) or np.any(covering))
    return resampled, filled


def _pyroomacoustics_text(table: MaterialTable, scattering: FloatArray) -> str:
    """Return JSON that maps each material to the arguments of ``pyroomacoustics.Material``."""
    centres = table.bands.centres_hz.tolist()
    spectra = {"energy_absorption": table.absorption, "scattering": scattering}
    content = {
        name: {
            key: {
                "description": name,
                "coeffs": [round(float(v), 5) for v in values[i]],
                "center_freqs": centres,
            }
            for key, values in spectra.items()
        }
        for i, name in enumerate(table.names)
    }
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def _wide_csv_text(table: MaterialTable) -> str:
    """Return a table with one column a band: absorption, intervals, identifiability."""
    quantities = ("absorption", "lower95", "upper95", "scattering", "identifiable")
    rows = [
        (material, quantity, *getattr(table, quantity)[i].tolist())
        for i, material in enumerate(table.names)
        for quantity in quantities
        if getattr(table, quantity) is not None
    ]
    return csv_of(Table("", ("material", "quantity", *_heads(table.bands)), rows, form=".5f"))


def _heads(bands: Bands) -> list[str]:
    return [f"{f:g}" for f in bands.centres_hz]


_COMPARED = ("measured", "predicted", "jnd", "mean_of_others", "diffuse_field")


def workbook_bytes(file: ResultFile) -> bytes:
    """Return the tables of a ``result.json`` or an ``absorption.csv`` as an Excel workbook.

    The sheet ``absorption`` has a row for each material and band, ``absorption by band`` one for
    each material, ``ratings`` its numbers of ISO 11654 and ASTM C423. Of a ``result.json`` also
    ``room parameters`` (measured, predicted, the mean of the others, and Barron's theory with their
    decay time), ``fit`` (a row a band) and ``findings``.
    """
    table, content = read_materials(file)
    values = np.stack([table.absorption, table.lower95, table.upper95])
    by_band = [(n, *a) for n, a in zip(table.names, table.absorption.tolist(), strict=True)]
    sheets = {
        "absorption": absorption_records(table.names, table.bands, values, table.identifiable),
        "absorption by band": Table("", ("material", *_heads(table.bands)), by_band),
    }
    if at := rated_bands(table.bands):
        rated = [
            (name, *weighted_absorption(a[at]), noise_reduction_coefficient(a[at]))
            for name, a in zip(table.names, table.absorption, strict=True)
        ]
        heads = ("material, as found in the room", "alpha_w", "shape", "NRC")
        sheets["ratings"] = Table("", heads, rated)
    if content:
        with located(str(path_of(file))), complete("result", "as roomfit writes it"):
            sheets |= _further_tables(content)
    return workbook_of(sheets)


def _further_tables(content: dict[str, Any]) -> dict[str, Table]:
    bands = [float(f) for f in content["bands_hz"]]
    compared = [
        (
            *(pair["source"], pair["receiver"], pair["use"], name, band),
            *(values.get(key, [None] * len(bands))[j] for key in _COMPARED),
        )
        for pair in content.get("pairs", [])
        for name, values in pair["parameters"].items()
        for j, band in enumerate(bands)
    ]
    fit = content.get("fit", {})
    columns = {key: fit[key] for key in ("phi", "converged", "models") if fit.get(key)}
    fitted = [(band, *(values[j] for values in columns.values())) for j, band in enumerate(bands)]
    said = ("severity", "code", "sentence")
    findings = [tuple(f[key] for key in said) for f in content.get("findings", [])]
    of_pairs = ("source", "receiver", "use", "parameter", "band_hz", *_COMPARED)
    return {
        "room parameters": Table("", of_pairs, compared),
        "fit": Table("", ("band_hz", *columns), fitted),
        "findings": Table("", said, findings),
    }


def export_materials(
    table: MaterialTable, wanted: str, scattering: float
) -> tuple[str, tuple[Finding, ...]]:
    """Return the text of one of `FORMATS`, and what its reader must know.

    `scattering`, 0 to 1, is written where the table has none.
    """
    if wanted not in FORMATS:  # the other three are no materials as text
        others = ("excel", "pdf", "word")
        check_known("no such format for an export", wanted, (*FORMATS, *others))
    check_range("scattering coefficient", scattering, 0.0, 1.0)
    specified = table.scattering
    scatter = np.full(table.absorption.shape, scattering) if specified is None else specified
    findings = _not_identifiable(table)
    if specified is None and wanted not in ("csv", "odeon"):
        text = f"The result has no scattering; {scattering:g} was written for every material."
        known = {"scattering": scattering}
        findings.append(Finding(Code.EXPORT_SCATTERING_ASSUMED, About(), text, known))
    if wanted == "pyroomacoustics":
        return _pyroomacoustics_text(table, scatter), tuple(findings)
    if wanted == "csv":
        return _wide_csv_text(table), tuple(findings)
    bands = _BANDS[wanted]
    absorption, filled = resample(table.absorption, table.bands, bands)
    scatter, _ = resample(scatter, table.bands, bands)
    if np.any(filled):
        text = (
            f"Nothing was fitted at {', '.join(np.array(_heads(bands))[filled])} Hz: the nearest "
            "band's value is used there, or one between two neighbours."
        )
        at_hz = bands.centres_hz[filled].tolist()
        about = About(bands_hz=at_hz)
        findings.append(Finding(Code.EXPORT_BANDS_FILLED, about, text, {"bands_hz": at_hz}))
    if wanted == "odeon":
        numbers = {"first": _FIRST_NUMBER, "last": _FIRST_NUMBER + len(table.names) - 1}
        text = (
            f"The materials have the numbers {numbers['first']} to {numbers['last']}. ODEON's "
            "library has no scattering: enter it in the list of materials."
        )
        findings.append(Finding(Code.EXPORT_WITHOUT_SCATTERING, About(), text, numbers))
        return _odeon_text(table.names, absorption), tuple(findings)
    names = short_names(table.names)
    if changed := {name: short for name, short in names.items() if name != short}:
        listed = ", ".join(f"{short} for {name}" for name, short in changed.items())
        text = f"The other program cannot take every name; it is {listed}."
        about = About(materials=list(changed))
        findings.append(Finding(Code.EXPORT_NAMES_CHANGED, about, text, {"names": changed}))
    if wanted == "isimpa":
        return _isimpa_text(names, absorption, scatter), tuple(findings)
    head = "absorption in percent, fitted by roomfit; exact values behind each line"
    remarks = [head, *(f.sentence for f in findings)]
    return catt_text(names, absorption, scatter, remarks), tuple(findings)


def _not_identifiable(table: MaterialTable) -> list[Finding]:
    rows = zip(table.names, table.identifiable, strict=True)
    doubtful = {n: table.bands.centres_hz[~sure].tolist() for n, sure in rows if not sure.all()}
    if not doubtful:
        return []

    def listed(name: str, bands_hz: Sequence[float]) -> str:
        at = f"at {', '.join(f'{f:g}' for f in bands_hz)} Hz"
        return f"{name} {at if len(bands_hz) < len(table.bands) else 'in any band'}"

    text = (
        f"The measurement does not determine {'; '.join(map(listed, doubtful, doubtful.values()))};"
        " the exported values there are not to be trusted one by one."
    )
    entries = [(name, f) for name, bands_hz in doubtful.items() for f in bands_hz]
    about = About(materials=list(doubtful), entries=entries)
    return [Finding(Code.EXPORT_NOT_IDENTIFIABLE, about, text, {"materials": doubtful})]
