"""Opening room files and reading numbers from them, with errors that say where."""

from __future__ import annotations

import math
from pathlib import Path

from roomfit.errors import InputError

# Far above any room in any unit, far below where squares overflow.
_LARGEST = 1e9


def read_bytes(path: Path) -> bytes:
    """Return the contents of a file that must exist and hold something.

    Raises
    ------
    InputError
        It is missing, empty, a folder, or cannot be read.
    """
    try:
        content = Path(path).read_bytes()
    except FileNotFoundError:
        hint = "check the path; in a campaign it is relative to the campaign file"
        raise InputError("the room file does not exist", where=str(path), hint=hint) from None
    except (OSError, ValueError) as error:
        raise InputError(
            "the room file cannot be read", where=str(path), found=str(error)
        ) from error
    if not content.strip():
        raise InputError("the room file is empty", where=str(path), hint="export it again")
    return content


def read_text(path: Path) -> str:
    """Return the contents of a text file: UTF-8, or Latin-1 where it is not that.

    Raises
    ------
    InputError
        As `read_bytes`, or it is binary.
    """
    content = read_bytes(path)
    if b"\0" in content:
        raise InputError(
            "the room file is not text",
            where=str(path),
            needed=f"a text file, as {Path(path).suffix or 'its name'} promises",
            hint="check that the file's name ends as its format demands",
        )
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def finite(token: str, where: str) -> float:
    """Return a coordinate.

    Raises
    ------
    InputError
        Not a number, NaN, infinite, or absurdly large.
    """
    try:
        value = float(token)
    except ValueError:
        value = math.nan
    if not abs(value) <= _LARGEST:
        raise InputError(
            "a coordinate is not a finite number",
            where=where,
            found=repr(token[:40]),
            needed=f"a number of size up to {_LARGEST:g}",
        )
    return value


def whole(token: str, where: str) -> int:
    """Return a whole number.

    Raises
    ------
    InputError
        It is not one.
    """
    try:
        return int(token)
    except ValueError:
        raise InputError(
            "a whole number was expected", where=where, found=repr(token[:40])
        ) from None
