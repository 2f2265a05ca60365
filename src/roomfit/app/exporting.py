"""Absorption of a result, written for another program."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from roomfit.app.planning import DEFAULT_SCATTERING
from roomfit.errors import InputError
from roomfit.files.exports.table import read_material_table
from roomfit.files.exports.write import export_materials
from roomfit.files.store import whole_output_folder, write_text_atomically
from roomfit.findings import Finding


@dataclass(frozen=True, slots=True, eq=False)
class ExportedFiles:
    """What was written, and what its reader must know."""

    files: tuple[Path, ...]
    findings: tuple[Finding, ...]


def export_result(
    result_file: Path,
    wanted: str,
    out: Path,
    *,
    scattering: float = DEFAULT_SCATTERING,
    overwrite: bool = False,
) -> ExportedFiles:
    """Write the materials of a result in the format of another program.

    Parameters
    ----------
    result_file : Path
        A ``result.json`` or an ``absorption.csv``.
    wanted : {"catt", "odeon", "isimpa", "raven", "pyroomacoustics", "csv"}
    out : Path
        The file to write; for "raven", which has a file a material, the folder.
    scattering : float
        Coefficient of every material where the result tells none, 0 to 1.
    overwrite : bool
        Replace what is there.

    Raises
    ------
    InputError
        The result cannot be read, the format is unknown, or something is in the way.
    StoreError
        The disk refuses.
    """
    out = Path(out)
    exported = export_materials(read_material_table(result_file), wanted, scattering)
    if "" not in exported.texts:
        with whole_output_folder(out, overwrite=overwrite) as folder:
            for name, text in exported.texts.items():
                write_text_atomically(folder / name, text)
        return ExportedFiles(tuple(out / name for name in exported.texts), exported.findings)
    _check_place(out, overwrite)
    write_text_atomically(out, exported.texts[""])
    return ExportedFiles((out,), exported.findings)


def _check_place(out: Path, overwrite: bool) -> None:
    if out.is_dir():
        raise InputError(
            "the export is one file, and a folder is in its place",
            where=str(out),
            hint=f"write --out {out / 'materials.txt'}",
        )
    if out.exists() and not overwrite:
        raise InputError(
            "the file to write exists",
            where=str(out),
            needed="a new name, so that nothing is lost",
            hint="choose another name, or add --overwrite",
        )
    if not out.parent.is_dir():
        raise InputError(
            "the folder of the file to write does not exist",
            where=str(out.parent),
            hint="make it first",
        )
