"""``roomfit export``: absorption for another program."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from roomfit.base.door import read_bytes, read_text
from roomfit.base.errors import InputError
from roomfit.base.findings import Finding
from roomfit.base.whole_files import check_place, write_bytes_atomically
from roomfit.files.encoding import ResultFile, path_of
from roomfit.files.exports import export_materials, workbook_bytes
from roomfit.files.results import material_table_of, read_materials
from roomfit.report.documents import OWN_PAGE, report_pdf, report_word
from roomfit.report.text import filled
from roomfit.result import Result
from roomfit.settings import Settings


def export(*, result: ResultFile, format: str, out: Path, **how: Any) -> str:  # noqa: A002
    """Return the file that `export_result` writes, and what its reader must know."""
    findings = export_result(result, format, out, **how)
    texts = (f"  {f.severity:<8} {f.sentence}" for f in findings)
    return "\n".join([str(out), *(filled(text, 11) for text in texts)])


def export_result(
    result_file: ResultFile | Result,
    wanted: str,
    out: Path,
    *,
    scattering: float | None = None,
    overwrite: bool = False,
) -> tuple[Finding, ...]:
    """Write the materials of a result for another program; return what its reader must know.

    `InputError` where the result cannot be read, the format is unknown, or the file exists already.

    Parameters
    ----------
    result_file : Path or Result
        A ``result.json`` or an ``absorption.csv``; for "pdf" and "word" with its ``report.html``
        beside it, for "word" its PNG pictures as well. Or a result in memory, but for "excel",
        "pdf" and "word".
    wanted : {"catt", "odeon", "isimpa", "pyroomacoustics", "csv", "excel", "pdf", "word"}
    out : Path
        The file to write.
    scattering : float, optional
        Coefficient of every material where the result contains none, 0 to 1; by default that of
        `Settings`.
    overwrite : bool
        Replace an existing file.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as name:
    ...     result, out = Path(name) / "absorption.csv", Path(name) / "materials.txt"
    ...     _ = result.write_text(
    ...         "material,band_hz,absorption,lower95,upper95,identifiable\\n"
    ...         "carpet,500,0.3,0.25,0.36,true\\n"
    ...     )
    ...     findings = export_result(result, "isimpa", out)
    ...     print(out.read_text().strip())
    carpet = < 30 30 30 30 30 30 > L < 10 10 10 10 10 10 >
    >>> print(findings[0].sentence)
    The result has no scattering; 0.1 was written for every material.
    """
    out = Path(out)
    check_place(out, overwrite=overwrite)
    # as the programs write themselves: CATT-Acoustic, I-Simpa
    wanted = wanted.lower().replace("-", "").removesuffix("acoustic")
    findings: tuple[Finding, ...] = ()
    if wanted in ("excel", "pdf", "word"):
        if isinstance(result_file, Result):
            what = "this format is made from the files of a result"
            found = f"{wanted!r} of a Result"
            needed = "result.json, and for PDF or Word report.html beside it"
            hint = "roomfit.write_result(folder, result, []) first"
            raise InputError(what, found=found, needed=needed, hint=hint)
        content, findings = _of_files(result_file, wanted)
    else:
        if isinstance(result_file, Result):
            table = material_table_of(result_file)
        else:
            table, _ = read_materials(result_file)
        usual = Settings().default_scattering if scattering is None else scattering
        text, findings = export_materials(table, wanted, usual)
        content, findings = text.encode(), (*findings, *table.findings)
    write_bytes_atomically(out, content)
    return findings


def _of_files(result_file: ResultFile, wanted: str) -> tuple[bytes, tuple[Finding, ...]]:
    """Return a workbook of a result, or the page that was written beside it as PDF or Word."""
    path = path_of(result_file)
    if wanted == "excel":
        return workbook_bytes(result_file), read_materials(result_file)[0].findings
    own = path.suffix.lower() in (".html", ".htm")
    file = path if own else path.with_name("report.html")
    page = read_text(file, "report")
    if OWN_PAGE not in page:
        what, found = "this is no page of roomfit", "HTML that another program wrote"
        needed, hint = "report.html or client.html, as roomfit wrote it", "name the result itself"
        raise InputError(what, where=str(file), found=found, needed=needed, hint=hint)
    findings = () if own else read_materials(result_file)[0].findings
    if wanted == "pdf":
        return report_pdf(page), findings
    beside = sorted(path.parent.glob("*.png"))
    return report_word(page, {f.stem: read_bytes(f, "picture") for f in beside}), findings
