"""Materials of a result as files of other programs.

A table of absorption is read from a result, resampled to the bands of the other program, given
names that it accepts, and written: for CATT-Acoustic and I-Simpa (which reads the same lines
without the first word), ODEON (a material library, .Li8),
pyroomacoustics (its arguments as JSON), or as a wide CSV.
"""

from __future__ import annotations

import colorsys
import hashlib
import json
import re
import unicodedata
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from roomfit.base.arguments import bool_array, check_known, check_range, float_array, unique_names
from roomfit.base.bands import OCTAVES_HZ, Bands
from roomfit.base.door import complete, csv_rows, decoded, read_text
from roomfit.base.errors import InputError, RoomfitError, located
from roomfit.base.findings import About, Code, Finding
from roomfit.base.table import Table, csv_of, without_apostrophe, workbook_of
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.files.encoding import (
    ResultFile,
    check_keys,
    digest_findings,
    one_line,
    path_of,
    written_content,
)
from roomfit.result import Result, absorption_records

CATT_BANDS = Bands("octave", np.array([125.0, 250.0, 500.0, 1e3, 2e3, 4e3, 8e3, 16e3]))
ISIMPA_BANDS = Bands("octave", np.array([125.0, 250.0, 500.0, 1e3, 2e3, 4e3]))
LONGEST_NAME = 15


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
        lines.append(
            f"ABS {short} = <{_eight(absorption[i], 1)}> L <{_eight(scattering[i], 0)}> "
            f"{{{colour}}} ; {one_line(name)}: {exact}"
        )
    return "\r\n".join(lines) + "\r\n"


def isimpa_text(names: dict[str, str], absorption: FloatArray, scattering: FloatArray) -> str:
    """Return the material lines that I-Simpa imports as "CATT-Acoustic" (.txt).

    Six octaves from 125 Hz in percent without decimals, as in the example of its manual [1]_;
    I-Simpa itself gives each value to three third octaves and extrapolates the outer ones.
    The lines have no comments: its manual shows none.

    References
    ----------
    .. [1] I-Simpa documentation, "Project database", materials, import from a file.
    """
    lines = [
        f"{short} = < {_percent(absorption[i], 1)} > L < {_percent(scattering[i], 0)} >"
        for i, short in enumerate(names.values())
    ]
    return "\n".join(lines) + "\n"


def _eight(values: FloatArray, least: int) -> str:
    return f"{_percent(values[:6], least)} : {_percent(values[6:], least)}"


def _percent(values: FloatArray, least: int) -> str:
    return " ".join(str(int(np.clip(round(100.0 * v), least, 99))) for v in values)


def short_names(names: tuple[str, ...]) -> dict[str, str]:
    """Return a name of ASCII letters, digits and underscores for each, beginning with a letter.

    At most 15 of them. No two are alike, not even in another case, which some programs ignore.

    Examples
    --------
    >>> short_names(("Wand grün", "wall", "Wall"))
    {'Wand grün': 'Wand_grun', 'wall': 'wall', 'Wall': 'Wall_2'}
    """
    given: dict[str, str] = {}
    for name in names:
        plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
        word = re.sub(r"[^A-Za-z0-9]+", "_", plain).strip("_") or "material"
        word = word if word[0].isalpha() else f"m_{word}"
        candidate, number = word[:LONGEST_NAME], 1
        while candidate.lower() in (g.lower() for g in given.values()):
            number += 1
            candidate = f"{word[: LONGEST_NAME - len(str(number)) - 1]}_{number}"
        given[name] = candidate
    return given


ODEON_BANDS = Bands("octave", np.array([63.0, 125.0, 250.0, 500.0, 1e3, 2e3, 4e3, 8e3]))
FIRST_NUMBER = 50001


def odeon_text(names: tuple[str, ...], absorption: FloatArray) -> str:
    """Return two lines a material: number and name; then eight octaves from 63 Hz.

    The second line begins with a tabulator, and tabulators separate its values: a program that
    reads ODEON's own library distinguishes the two by it [1]_. The library has no scattering:
    ODEON expects it for each surface, in its list of materials.

    References
    ----------
    .. [1] R. Gueguen, Just4RIR (2018), ``physic.cpp``.
    """
    lines = []
    for i, name in enumerate(names):
        lines.append(f"{FIRST_NUMBER + i} {one_line(name)}")
        lines.append("".join(f"\t{v:.5f}" for v in absorption[i]))
    return "\r\n".join(lines) + "\r\n"


def resample(values: FloatArray, bands: Bands, wanted: Bands) -> tuple[FloatArray, BoolArray]:
    """Return values in other bands, and which of them were not fitted.

    A band that is there is taken as it is; an octave from third octaves is their mean; a third
    octave within the range of the octaves is interpolated linearly in the logarithm of frequency.
    Beyond the lowest and the highest band the nearest value is repeated, and gaps between bands
    are interpolated: those are the ones that were not fitted.

    Parameters
    ----------
    values : float array, shape (n_materials, n_bands)
    bands, wanted : Bands

    Returns
    -------
    resampled : float array, shape (n_materials, n_wanted)
    filled : bool array, shape (n_wanted,)
        True where no fitted band covers the wanted one.
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


_COLUMNS = ("material", "band_hz", "absorption", "lower95", "upper95", "identifiable")


@dataclass(frozen=True, slots=True, eq=False)
class MaterialTable:
    """Materials of a result."""

    names: tuple[str, ...]
    bands: Bands
    # (n_materials, n_bands); 0 to 1
    absorption: FloatArray
    lower95: FloatArray
    upper95: FloatArray
    identifiable: BoolArray  # (n_materials, n_bands)
    scattering: FloatArray | None = None  # (n_materials, n_bands); None where the result has none
    findings: tuple[Finding, ...] = ()  # on the file

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", unique_names("material", self.names))
        shape = (len(self.names), len(self.bands))
        for name in ("absorption", "lower95", "upper95", "scattering"):
            value = getattr(self, name)
            if value is not None:
                values = float_array(name, value, shape, low=0.0, high=1.0)
                object.__setattr__(self, name, values)
        flags = bool_array("identifiable", self.identifiable, shape)
        object.__setattr__(self, "identifiable", flags)


def material_table_of(result: Result) -> MaterialTable:
    """Return the materials of a result in memory."""
    return MaterialTable(
        result.materials, result.bands, result.absorption, result.lower95, result.upper95,
        result.identifiable, result.scattering,
    )  # fmt: skip


# Of result.json, by table: what may stand there.
RESULT_KEYS = {
    "": "format format_version bands_hz materials combinations pairs findings fit plan settings "
    "trace provenance usable remains states sd_without mean_sd_without directivity geometry "
    "posterior objects reverberation files_sha256 content_sha256",
    "materials": "absorption lower95 upper95 identifiable area_m2 scattering share share_lower95 "
    "share_upper95 prior interval",
    "posterior": "materials logit_mean logit_covariance prior_logit_mean prior_logit_sd "
    "prior_logit_covariance draws prior_specified",
    "fit": "method model cost models phi by_pressures evaluations converged seconds seed "
    "intervals method_chosen reasons",
    "pairs": "source receiver use state parameters sti",
    "findings": "code severity sentence about evidence",
}


def read_result_content(file: ResultFile) -> tuple[dict[str, Any], tuple[Finding, ...]]:
    """Return the content of a ``result.json`` of this version, and what its digest says of it.

    Raises
    ------
    InputError
        There is no such file, it is no result, has unknown keys, or was changed.
    """
    content, findings = written_content(file, "result")
    path = path_of(file)
    with located(str(path)), complete("result", "a result.json as roomfit writes it"):
        _check_format(content)
        for name, known in RESULT_KEYS.items():
            part = content.get(name, {}) if name else content
            tables: dict[str, Any] = {name or "top level": part}
            if name == "materials":
                tables = {f"materials.{own}": table for own, table in part.items()}
            elif isinstance(part, list):
                tables = {f"{name}[{i}]": table for i, table in enumerate(part, start=1)}
            for where, table in tables.items():
                check_keys(table, known.split(), where)
    return content, findings


def _check_format(content: Any) -> None:
    if not isinstance(content, dict) or content.get("format") != "roomfit-result":
        raise InputError(
            "this is no result of roomfit",
            found="another format" if isinstance(content, dict) else "no table",
            needed='"format": "roomfit-result" in the file',
            hint="give a result.json that roomfit identify has written",
        )
    if content.get("format_version") != 1:
        raise InputError(
            "this version of roomfit cannot read that result",
            found=f"format_version {content.get('format_version')}",
            needed="format_version 1",
            hint="identify again, or export with the version of roomfit that wrote it",
        )


def read_material_table(file: ResultFile) -> MaterialTable:
    """Read the materials of a ``result.json`` or an ``absorption.csv``.

    Raises
    ------
    InputError
        There is no such file, it is neither of the two, or its numbers are out of range; or its
        content is not that of its digest, which is in the ``result.json`` beside a table.
    """
    path = path_of(file)
    if path.suffix.lower() != ".csv":
        return material_table(file, *read_result_content(file))
    text = read_text(path, "result")
    findings = digest_findings(file, "table", text_digest(text), _digest_beside(path))
    with located(str(path), hint="export the table again, or give the result.json beside it"):
        return replace(_from_csv(text), findings=findings)


def text_digest(text: str) -> str:
    """Return the SHA-256 of a text file as roomfit writes it, whatever ends its lines."""
    return hashlib.sha256(decoded(text.encode(errors="replace")).encode()).hexdigest()


def _digest_beside(path: Path) -> object:
    """Return the digest of a file that the result beside it states; None without such a result."""
    with suppress(RoomfitError, AttributeError):
        content, doubts = written_content(path.with_name("result.json"), "result")
        return None if doubts else content.get("files_sha256", {}).get(path.name)
    return None


def material_table(
    file: ResultFile, content: dict[str, Any], findings: tuple[Finding, ...] = ()
) -> MaterialTable:
    """Return the materials of a result from its content.

    Raises
    ------
    InputError
        Something is missing, or out of range.
    """
    with (
        located(str(path_of(file))),
        complete(
            "result", "bands_hz, and for each material absorption, lower95, upper95, identifiable"
        ),
    ):
        materials: dict[str, Any] = content["materials"]
        entries = list(materials.values())
        scattering = [m.get("scattering") for m in entries]
        return MaterialTable(
            tuple(materials),
            _bands(content["bands_hz"]),
            np.array([m["absorption"] for m in entries]),
            np.array([m["lower95"] for m in entries]),
            np.array([m["upper95"] for m in entries]),
            np.array([m["identifiable"] for m in entries]),
            None if None in scattering or not entries else np.array(scattering),
            findings,
        )


def _from_csv(text: str) -> MaterialTable:
    header, *lines = [cells for _, cells in csv_rows(text, "") if cells] or [[]]
    if not (set(_COLUMNS) <= set(header) and lines):
        raise InputError(
            "the table of absorption lacks columns or rows",
            found=", ".join(header)[:200] or "nothing",
            needed=", ".join(_COLUMNS),
            hint="give absorption.csv as roomfit identify has written it",
        )
    short = next((cells for cells in lines if len(cells) < len(header)), None)
    if short is not None:
        what = "a row of the table of absorption is too short"
        hint = "fill the row up, or remove it"
        raise InputError(what, found=",".join(short)[:80], needed=f"{len(header)} cells", hint=hint)
    rows = [dict(zip(header, cells, strict=False)) for cells in lines]
    place: dict[tuple[str, float], tuple[list[float], bool]] = {}
    for number, row in enumerate(rows, start=1):
        centre, *values = (_number_in(row, column, number) for column in _NUMBERS)
        is_sure = row["identifiable"].lower() == "true"
        place[without_apostrophe(row["material"]), centre] = (values, is_sure)
    names = tuple(dict.fromkeys(name for name, _ in place))
    centres = sorted({centre for _, centre in place})
    if len(place) != len(rows) or len(rows) != len(names) * len(centres):
        raise InputError(
            "the table of absorption is not complete",
            found=f"{len(rows)} rows, {len(names)} materials, {len(centres)} bands",
            needed="each material in each band once",
            hint="remove the rows given twice, and add what is missing",
        )
    absorption, lower, upper = np.array(
        [[place[m, f][0] for f in centres] for m in names]
    ).transpose(2, 0, 1)
    sure = np.array([[place[m, f][1] for f in centres] for m in names])
    return MaterialTable(names, _bands(centres), absorption, lower, upper, sure)


_NUMBERS = ("band_hz", "absorption", "lower95", "upper95")


def _number_in(row: dict[str, str], column: str, number: int) -> float:
    try:
        return float(row[column])
    except ValueError:
        raise InputError(
            "a cell of the table of absorption is no number",
            where=f"column {column} of row {number} below the heading",
            found=repr(row[column][:40]),
            needed="a number with a decimal point",
            hint="replace it by a number, with a point and without a unit",
        ) from None


def _bands(centres: list[float]) -> Bands:
    octaves = set(centres) <= set(OCTAVES_HZ)
    return Bands("octave" if octaves else "third-octave", np.array(centres, dtype=np.float64))


def pyroomacoustics_text(table: MaterialTable, scattering: FloatArray) -> str:
    """Return JSON that maps each material to the arguments of ``pyroomacoustics.Material``.

    ``pra.Material(**json.load(open(file))["brick"])``: ``energy_absorption`` and ``scattering``,
    each with ``coeffs`` and ``center_freqs`` in the bands of the result.
    """
    centres = [float(f) for f in table.bands.centres_hz]
    quantities = (("energy_absorption", table.absorption), ("scattering", scattering))
    content = {
        name: {
            quantity: {
                "description": name,
                "coeffs": [round(float(v), 5) for v in values[i]],
                "center_freqs": centres,
            }
            for quantity, values in quantities
        }
        for i, name in enumerate(table.names)
    }
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def wide_csv_text(table: MaterialTable) -> str:
    """Return a table with one column a band: absorption, intervals, identifiability."""
    quantities = {
        **{name: getattr(table, name) for name in ("absorption", "lower95", "upper95")},
        **({} if table.scattering is None else {"scattering": table.scattering}),
        "identifiable": table.identifiable,
    }
    rows = [
        (material, quantity, *values[i].tolist())
        for i, material in enumerate(table.names)
        for quantity, values in quantities.items()
    ]
    bands = (f"{f:g}" for f in table.bands.centres_hz)
    return csv_of(Table("", ("material", "quantity", *bands), rows, form=".5f"))


def workbook_bytes(file: ResultFile) -> bytes:
    """Return the tables of a ``result.json`` or an ``absorption.csv`` as an Excel workbook.

    Raises
    ------
    InputError
        The result cannot be read, or openpyxl is not installed.
    """
    return workbook_of(result_tables(file))


_COMPARED = ("measured", "predicted", "jnd", "mean_of_others")


def result_tables(file: ResultFile) -> dict[str, Table]:
    """Return the tables of a result by name.

    ``absorption`` has a row for each material and band, ``absorption by band`` one for each
    material. Of a ``result.json`` also ``room parameters`` (measured, predicted, and the mean of
    the others), ``fit`` (a row a band) and ``findings``.

    Raises
    ------
    InputError
        The result cannot be read.
    """
    path = path_of(file)
    content = {} if path.suffix.lower() == ".csv" else read_result_content(file)[0]
    table = material_table(file, content) if content else read_material_table(file)
    values = np.stack([table.absorption, table.lower95, table.upper95])
    heads = ("material", *(f"{f:g}" for f in table.bands.centres_hz))
    by_band = [(n, *a) for n, a in zip(table.names, table.absorption.tolist(), strict=True)]
    tables = {
        "absorption": absorption_records(table.names, table.bands, values, table.identifiable),
        "absorption by band": Table("", heads, by_band),
    }
    if not content:
        return tables
    with located(str(path)), complete("result", "a result.json as roomfit writes it"):
        return tables | _further_tables(content)


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


ExportFormat = Literal["catt", "odeon", "isimpa", "pyroomacoustics", "csv"]
FORMATS: tuple[ExportFormat, ...] = get_args(ExportFormat)
_BANDS = {"catt": CATT_BANDS, "isimpa": ISIMPA_BANDS, "odeon": ODEON_BANDS}


def export_materials(
    table: MaterialTable, wanted: str, scattering: float
) -> tuple[str, tuple[Finding, ...]]:
    """Return the text of one of `FORMATS`, and what its reader must know.

    `scattering`, 0 to 1, is written where the table has none.
    """
    if wanted not in FORMATS:  # the other four are no materials as text
        others = ("budget", "excel", "pdf", "word")
        check_known("no such format for an export", wanted, (*FORMATS, *others))
    check_range("scattering coefficient", scattering, 0.0, 1.0)
    specified = table.scattering
    scatter = np.full(table.absorption.shape, scattering) if specified is None else specified
    findings = [*_not_identifiable(table)]
    if specified is None and wanted not in ("csv", "odeon"):
        text = f"The result has no scattering; {scattering:g} was written for every material."
        evidence: dict[str, object] = {"scattering": scattering}
        findings.append(Finding(Code.EXPORT_SCATTERING_ASSUMED, About(), text, evidence))
    if wanted == "pyroomacoustics":
        return pyroomacoustics_text(table, scatter), tuple(findings)
    if wanted == "csv":
        return wide_csv_text(table), tuple(findings)
    bands = _BANDS[wanted]
    absorption, filled = resample(table.absorption, table.bands, bands)
    scatter, _ = resample(scatter, table.bands, bands)
    if np.any(filled):
        listed = ", ".join(f"{f:g}" for f in bands.centres_hz[filled])
        text = (
            f"Nothing was fitted at {listed} Hz: the nearest band's value is used there, or one "
            "between two neighbours."
        )
        evidence = {"bands_hz": bands.centres_hz[filled].tolist()}
        about = About(bands_hz=bands.centres_hz[filled].tolist())
        findings.append(Finding(Code.EXPORT_BANDS_FILLED, about, text, evidence))
    if wanted == "odeon":
        last = FIRST_NUMBER + len(table.names) - 1
        text = (
            f"The materials have the numbers {FIRST_NUMBER} to {last}. ODEON's library has no "
            "scattering: enter it in the list of materials."
        )
        evidence = {"first": FIRST_NUMBER, "last": last}
        findings.append(Finding(Code.EXPORT_WITHOUT_SCATTERING, About(), text, evidence))
        return odeon_text(table.names, absorption), tuple(findings)
    names = short_names(table.names)
    changed = {name: short for name, short in names.items() if name != short}
    if changed:
        listed = ", ".join(f"{short} for {name}" for name, short in changed.items())
        text = f"The other program cannot take every name; it is {listed}."
        about = About(materials=list(changed))
        findings.append(Finding(Code.EXPORT_NAMES_CHANGED, about, text, {"names": changed}))
    if wanted == "catt":
        head = "absorption in percent, fitted by roomfit; exact values behind each line"
        remarks = [head, *(f.sentence for f in findings)]
        return catt_text(names, absorption, scatter, remarks), tuple(findings)
    return isimpa_text(names, absorption, scatter), tuple(findings)


def _where(bands: Bands, chosen: BoolArray) -> str:
    if np.all(chosen):
        return "in any band"
    return f"at {', '.join(f'{f:g}' for f in bands.centres_hz[chosen])} Hz"


def _not_identifiable(table: MaterialTable) -> list[Finding]:
    doubtful = {
        name: [float(f) for f in table.bands.centres_hz[~sure]]
        for name, sure in zip(table.names, table.identifiable, strict=True)
        if not np.all(sure)
    }
    if not doubtful:
        return []
    flags = dict(zip(table.names, table.identifiable, strict=True))
    listed = "; ".join(f"{name} {_where(table.bands, ~flags[name])}" for name in doubtful)
    return [
        Finding(
            Code.EXPORT_NOT_IDENTIFIABLE,
            About(
                materials=list(doubtful),
                entries=[(name, f) for name, bands in doubtful.items() for f in bands],
            ),
            f"The measurement does not determine {listed}; the exported values there are not to "
            "be trusted one by one.",
            {"materials": doubtful},
        )
    ]
