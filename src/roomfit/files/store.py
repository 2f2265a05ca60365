"""Writing that never leaves half a file: aside first, then renamed."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from roomfit.errors import InputError, StoreError


def new_output_folder(path: Path, *, overwrite: bool = False) -> Path:
    """Make a folder for results and return it.

    Raises
    ------
    InputError
        The folder exists and holds something, and `overwrite` is false; or a file is in its place.
    StoreError
        The folder cannot be made.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise InputError("the output folder is a file", where=str(path), hint="choose another name")
    if path.is_dir() and any(path.iterdir()) and not overwrite:
        raise InputError(
            "the output folder exists and is not empty",
            where=str(path),
            needed="a new or an empty folder, so that no earlier result is lost",
            hint="choose another folder, or add --overwrite",
        )
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(
            "the output folder cannot be made", where=str(path), found=str(error)
        ) from error
    return path


def write_bytes_atomically(path: Path, content: bytes) -> Path:
    """Write a file aside and rename it, so that readers see the old file or the new one.

    Raises
    ------
    StoreError
        The disk refuses.
    """
    path = Path(path)
    aside = None
    try:
        handle, aside = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        # mkstemp makes files that only the owner may read; give the usual permissions
        umask = os.umask(0)
        os.umask(umask)
        Path(aside).chmod(0o666 & ~umask)
        Path(aside).replace(path)
    except OSError as error:
        raise StoreError("a file cannot be written", where=str(path), found=str(error)) from error
    finally:
        if aside is not None:
            Path(aside).unlink(missing_ok=True)
    return path


def write_text_atomically(path: Path, text: str) -> Path:
    """Write a UTF-8 text file aside and rename it; see `write_bytes_atomically`."""
    return write_bytes_atomically(path, text.encode())


def write_json_atomically(path: Path, content: Mapping[str, Any]) -> Path:
    """Write JSON that any parser reads: an unknown value must be None, never NaN.

    Raises
    ------
    ValueError
        The content holds NaN or infinity: a fault of the caller's code, not of a user.
    """
    return write_text_atomically(path, json.dumps(content, indent=1, allow_nan=False) + "\n")
