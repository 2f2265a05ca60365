"""The statements of a .geo file and of the files that it includes, each with its place.

The format is CATT-Acoustic's; it is described in its manual's "Short GEO, LOC input file syntax
reminder" [1]_, and shown by its tutorial's files MASTER.GEO and REFLECT.GEO.

References
----------
.. [1] CATT, "CATT-Acoustic v8.0 with TUCT, Introduction Manual", appendix 2 (2010).
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

from roomfit.errors import InputError
from roomfit.files.rooms.text import read_text

_MOST_FILES = 200
_WORD = re.compile(r"[A-Za-z_]\w*", re.ASCII)

# What concerns looks or the running of the program, not the room.
_WITHOUT_EFFECT = ("say", "debug", "debugon", "debugoff")


@dataclass(frozen=True, slots=True)
class Line:
    """One statement without its comment.

    Attributes
    ----------
    text : str
    where : str
        File and line.
    """

    text: str
    where: str


@dataclass(slots=True)
class GeoFile:
    """The statements of one file, sorted by what they are about."""

    path: Path
    constants: list[tuple[str, Line]] = field(default_factory=list)  # "global" or "local"
    materials: list[Line] = field(default_factory=list)
    directives: dict[str, Line] = field(default_factory=dict)
    corners: list[Line] = field(default_factory=list)
    planes: list[Line] = field(default_factory=list)
    includes: list[Line] = field(default_factory=list)


def read_files(path: Path) -> list[GeoFile]:
    """Return a file and, behind it, all that it includes.

    An included file comes after the whole of the file that names it, so that it sees constants
    which stand below the INCLUDE.

    Raises
    ------
    InputError
        A file cannot be read, includes itself, or holds a statement that is not understood.
    """
    files: list[GeoFile] = []
    _gather(Path(path), (), files)
    return files


def _gather(path: Path, above: tuple[Path, ...], files: list[GeoFile]) -> None:
    file = _sorted(path)
    files.append(file)
    if len(files) > _MOST_FILES:
        raise InputError(
            "too many files are included", where=str(path), needed=f"at most {_MOST_FILES}"
        )
    for line in file.includes:
        inner = _included(line, path.parent)
        if inner.resolve() in (*above, path.resolve()):
            raise InputError("a file includes itself", where=line.where, found=inner.name)
        _gather(inner, (*above, path.resolve()), files)


def _included(line: Line, folder: Path) -> Path:
    """Return the file that INCLUDE names: its ending may be missing, its case differ."""
    name = line.text.split(None, 1)[1].strip().strip('"').replace("\\", "/")
    wanted = folder / name
    options = (wanted, wanted.with_name(wanted.name + ".geo"))
    try:
        beside = sorted(wanted.parent.iterdir()) if wanted.parent.is_dir() else []
    except (OSError, ValueError):
        beside = []
    lower = [option.name.lower() for option in options]
    for candidate in (*options, *(f for f in beside if f.name.lower() in lower)):
        if candidate in beside:
            return candidate
    raise InputError(
        "an included file does not exist",
        where=line.where,
        found=name,
        needed=f"{wanted.name} or {wanted.name}.geo in {wanted.parent}",
    )


def _sorted(path: Path) -> GeoFile:
    file = GeoFile(path)
    section = ""
    plane: list[str] = []
    began = ""
    for number, raw in enumerate(read_text(path).split("\n"), start=1):
        where = f"{path}, line {number}"
        text = raw.split(";", 1)[0].strip()
        if plane or (section == "planes" and text.startswith("[")):
            began = began or where
            plane.append(text)
            _close_planes(file, plane, began)
            began = began if plane else ""
            continue
        word = (_WORD.match(text) or [""])[0].lower()
        if text:
            section = _sort(file, section, word, Line(text, where))
    if plane:
        raise InputError(
            "a plane is not closed",
            where=began,
            found=" ".join(plane)[:60],
            needed="[number name / corners / material]",
            hint="the file may be cut short: export it again",
        )
    return file


def _close_planes(file: GeoFile, pending: list[str], where: str) -> None:
    """Move whole planes from the pending text to the file."""
    text = " ".join(pending)
    while "]" in text:
        inner, text = text.split("]", 1)
        file.planes.append(Line(inner.split("[", 1)[1] if "[" in inner else inner, where))
        text = text.strip()
        if text and not text.startswith("["):
            raise _unknown(Line(text, where))
    pending[:] = [text] if text else []


def _sort(file: GeoFile, section: str, word: str, line: Line) -> str:
    """Put a statement where it belongs and return the section that holds afterwards."""
    alone = line.text.lower() == word
    if alone and word in ("corners", "planes", "markers"):
        return word
    if section == "markers" or word in _WITHOUT_EFFECT:
        return section
    if word in ("global", "local"):
        file.constants.append((word, line))
    elif word == "abs" and section != "corners":
        file.materials.append(line)
    elif word == "include" and len(line.text.split(None, 1)) == 2:
        file.includes.append(line)
    elif word in ("offsetco", "offsetpl", "mirror", "translate", "object"):
        if word in file.directives:
            raise InputError("a statement stands twice in one file", where=line.where, found=word)
        if file.corners or file.planes:
            raise InputError(
                f"{word.upper()} stands below corners or planes",
                where=line.where,
                needed="a place above CORNERS",
            )
        file.directives[word] = line
    elif section == "corners" and (line.text[0].isdigit() or word == "loop"):
        file.corners.append(line)
    else:
        raise _unknown(line)
    return section


def _unknown(line: Line) -> InputError:
    return InputError(
        "a statement of the .geo file is not supported",
        where=line.where,
        found=line.text[:80],
        needed="ABS, GLOBAL, LOCAL, INCLUDE, OFFSETCO, OFFSETPL, MIRROR, OBJECT with TRANSLATE, "
        "CORNERS with loop(), PLANES",
        hint="let CATT-Acoustic (or TUCT) export the room with everything worked out, or export "
        "it as OBJ",
    )
