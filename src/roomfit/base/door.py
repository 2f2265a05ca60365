"""Bounded reading of untrusted files: regular files only, size and counts limited.

A file may come from a stranger. Every reader of this package takes its bytes from `read_bytes` or
`read_text`, and counts what it unpacks with `check_limit`. The limits lie far above what rooms and
their measurements need; the environment variable ``ROOMFIT_LIMITS`` changes them, as in
``ROOMFIT_LIMITS="faces=500000 file_bytes=4e9"``. They are no keys of a campaign, because the
campaign may be the stranger's.
"""

from __future__ import annotations

import codecs
import contextlib
import csv
import hashlib
import io
import json
import logging
import math
import os
import stat
import warnings
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.base.errors import DAMAGE, InputError, StoreError

LIMITS: Mapping[str, tuple[float, str]] = {
    "file_bytes": (2**30, "bytes of one file"),
    "text_bytes": (2**26, "bytes of one file of text (tables, drawings, exports of REW)"),
    "campaign_bytes": (2**22, "bytes of a campaign file"),
    "logo_bytes": (2**19, "bytes of the logo of a report"),
    "header_bytes": (2**16, "bytes of a header (REW, arrays of NumPy)"),
    "unpacked_bytes": (2**30, "bytes of the numbers in one file, as float64"),
    "unpacked_times": (1000, "times its own size that a file may unpack to, beyond 64 MiB"),
    "corners": (1e6, "corners of a room file"),
    "faces": (1e5, "polygons of a room file"),
    "polygon_corners": (2000, "corners of one polygon"),
    "polygon_pairs": (4e6, "pairs of corners of one polygon, over all polygons beyond 100 corners"),
    "near_pairs": (1e6, "pairs of corners that are nearer than 0.1 mm without being equal"),
    "crossings": (20000, "pairs of faces that lie upon or run through each other"),
    "inserts": (10000, "blocks that a drawing inserts, counted as often as they appear"),
    "entities": (1e6, "entities of a drawing, those of blocks as often as they appear"),
    "constants": (10000, "constants of one .geo file"),
    "statement_letters": (20000, "letters of one statement of a .geo file"),
    "part_pairs": (20000, "pairs of parts of one plane of a .geo file, over all planes"),
    "scan_parts": (500, "walls, doors, windows, furniture and corners of the floor of one scan"),
    "reading_s": (
        20,
        "seconds of processor time for one file of SOFA, MAT, GLB, STL, COLLADA, IFC, USDZ or SKP",
    ),
    "request_s": (20, "seconds in which the head of a request to the workbench must be there"),
}
_VARIABLE = "ROOMFIT_LIMITS"
_ALWAYS_UNPACKED_BYTES = 2**26


def limit(name: str) -> float:
    """Return a limit: its default, or what ``ROOMFIT_LIMITS`` says."""
    changed: dict[str, float] = {}
    for word in os.environ.get(_VARIABLE, "").replace(",", " ").split():
        key, _, value = word.partition("=")
        with contextlib.suppress(ValueError):
            changed[key] = float(value)
        if key not in LIMITS or not changed.get(key, math.nan) > 0.0:
            raise InputError(
                "a limit of files is not understood",
                where=f"the environment variable {_VARIABLE}",
                found=repr(word[:80]),
                needed=f"NAME=NUMBER above 0, separated by blanks; names: {', '.join(LIMITS)}",
                hint='write, say, ROOMFIT_LIMITS="faces=500000"',
            )
    return changed.get(name, float(LIMITS[name][0]))


def check_limit(name: str, found: float, where: str) -> None:
    """Refuse more of something than a file may hold."""
    most = limit(name)
    if not found <= most:
        what, said = "a file holds more than is read", f"{found:.10g} {LIMITS[name][1]}"
        hint = f'if the file is meant: {_VARIABLE}="{name}=NUMBER"'
        raise InputError(what, where=where, found=said, needed=f"at most {most:.10g}", hint=hint)


def unpacked_limit_bytes(packed_bytes: int) -> float:
    """Return to how much a file of so many bytes may unpack, its numbers counted as float64."""
    by_size = max(limit("unpacked_times") * packed_bytes, _ALWAYS_UNPACKED_BYTES)
    return min(limit("unpacked_bytes"), by_size)


def too_many_numbers(most_bytes: float) -> ValueError:
    """Return the error of a file whose numbers take more than `unpacked_limit_bytes`."""
    name = "unpacked_bytes" if most_bytes >= limit("unpacked_bytes") else "unpacked_times"
    cure = f'if the file is meant: {_VARIABLE}="{name}=NUMBER"'
    return ValueError(f"more than {most_bytes:.4g} bytes of numbers; {cure}")


def read_bytes(path: Path, what: str, *, most: str = "file_bytes") -> bytes:
    """Return the content of a regular file, at most so much as the limit `most` allows."""
    place = str(path)
    try:
        _check_regular(Path(path).stat().st_mode, what, place)
        # not to wait should a pipe have come into its place meanwhile
        flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        with open(os.open(path, flags), "rb") as stream:  # noqa: PTH123 -- no path
            status = os.fstat(stream.fileno())
            _check_regular(status.st_mode, what, place)
            check_limit(most, status.st_size, place)
            # files of /proc tell no size
            content = stream.read(int(limit(most)) + 1)
    except (FileNotFoundError, NotADirectoryError):
        wrong, needed = f"the {what} does not exist", "a file that can be read"
        hint = "check the path; in a campaign it is relative to the campaign file"
        raise InputError(
            wrong, where=place, found="no such file", needed=needed, hint=hint
        ) from None
    except ValueError as error:  # a NUL, or what the system cannot encode, in the name
        wrong, needed = "this is not a name of a file", "a path as the system writes it"
        hint, place = "type it anew, without signs that no keyboard has", repr(place)
        found = str(error)
        raise InputError(wrong, where=place, found=found, needed=needed, hint=hint) from error
    except OSError as error:
        wrong, found = f"the {what} cannot be read", error.strerror or str(error)
        raise StoreError(wrong, where=place, found=found) from error
    check_limit(most, len(content), place)
    if not content:
        wrong, needed = f"the {what} is empty", "a file with its content"
        hint = "copy or export it again"
        raise InputError(wrong, where=place, found="0 bytes", needed=needed, hint=hint)
    noted = _NOTED.get(None)
    if noted is not None:
        digest = hashlib.sha256(content).hexdigest()
        if noted.setdefault(Path(path), digest) != digest:
            wrong, found = "a file changed while it was in use", "another content than a moment ago"
            needed = "the same content until the end of the command"
            hint = "run the command again when nothing writes into it"
            raise InputError(wrong, where=place, found=found, needed=needed, hint=hint)
    return content


_NOTED: ContextVar[dict[Path, str] | None] = ContextVar("digests of files as they were read")


@contextlib.contextmanager
def reading_noted() -> Iterator[None]:
    """Keep the SHA-256 of every file that is read within the block, for `files_read`.

    A file that lies there when a run of an hour ends need not be the one that was read.
    """
    before = _NOTED.set({})
    try:
        yield
    finally:
        _NOTED.reset(before)


def files_read() -> dict[Path, str]:
    """Return the files read since `reading_noted` began, in order, and the SHA-256 of each."""
    return dict(_NOTED.get(None) or {})


def check_files(paths: Iterable[Path], where: str) -> None:
    """Refuse all files at once that cannot be read; a single one is left to its own reader."""
    faults = []
    for path in paths:
        try:
            status = path.stat()
            fault = _kind(status.st_mode) or ("" if status.st_size else "empty")
            fault = fault or ("too large" if status.st_size > limit("file_bytes") else "")
            fault = f"is {fault}" if fault else ""
        except (FileNotFoundError, NotADirectoryError):
            fault = "does not exist"
        except (OSError, ValueError) as error:
            fault = str(getattr(error, "strerror", None) or error)
        if fault:
            faults.append(f"{path.name or path} {fault}")
    if len(faults) > 1:
        more = len(faults) - _MOST_NAMED
        what = f"{len(faults)} files that the campaign names cannot be read"
        found = "; ".join(faults[:_MOST_NAMED]) + (f"; and {more} more" if more > 0 else "")
        hint = "check the paths, which are relative to the campaign file"
        raise InputError(what, where=where, found=found, needed="regular files", hint=hint)


_MOST_NAMED = 20


def same_file(path: Path) -> tuple[int, int] | str:
    """Return what two spellings of one file have in common, links included.

    Where there is no such file yet, the path without what leads nowhere.
    """
    try:
        status = path.stat()
    except (OSError, ValueError):
        return os.path.normpath(path)
    return (status.st_dev, status.st_ino)


def _check_regular(mode: int, what: str, where: str) -> None:
    found = _kind(mode)
    if found:
        meant = Path(where, "result.json" if what == "result" else "campaign.toml")
        hint = f"give the file in it: {meant}" if meant.is_file() else "give the file itself"
        needed = "a regular file, or a link to one"
        raise InputError(
            f"the {what} cannot be read", where=where, found=found, needed=needed, hint=hint
        )


def _kind(mode: int) -> str:
    """Return what a file is that is not a regular one, "" for a regular one."""
    kinds = {stat.S_IFREG: "", stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe"}
    return {**kinds, stat.S_IFSOCK: "a socket"}.get(stat.S_IFMT(mode), "a device")


def read_text(path: Path, what: str, *, most: str = "text_bytes") -> str:
    """Return a text, see `decoded`."""
    content = read_bytes(path, what, most=most)
    if b"\0" in content and content[:2] not in _UTF_16:
        needed = f"a text file, as {Path(path).suffix or 'its name'} says"
        hint = "check that the file's name ends as its format demands"
        wrong, found = f"the {what} is not text", "bytes that are no letters"
        raise InputError(wrong, where=str(path), found=found, needed=needed, hint=hint)
    return decoded(content)


_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def decoded(content: bytes) -> str:
    """Return text, UTF-8 or UTF-16 by its mark, else Latin-1, newlines at the ends of lines."""
    try:
        text = content.decode("utf-16" if content[:2] in _UTF_16 else "utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def json_content(text: str, what: str) -> Any:
    """Return what a JSON text holds."""
    try:
        return json.loads(text.removeprefix("\ufeff"))
    except (ValueError, RecursionError) as error:
        wrong, needed = f"the {what} is not JSON", "one JSON text, whole"
        hint = "check that it is the file that was meant; make or copy it again"
        raise InputError(wrong, found=str(error)[:200], needed=needed, hint=hint) from error


@contextlib.contextmanager
def complete(what: str, needed: str) -> Iterator[None]:
    """Refuse content of JSON that lacks keys or has other things in their place."""
    try:
        yield
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        wrong, found = f"the {what} is incomplete", f"{type(error).__name__}: {error}"[:200]
        hint = "copy it again, or have the program that wrote it write it anew"
        raise InputError(wrong, found=found, needed=needed, hint=hint) from error


def csv_rows(text: str, where: str, delimiter: str = ",") -> Iterator[tuple[int, list[str]]]:
    """Yield number of the line and cells of each row of a table with commas or the like."""
    reader = csv.reader(text.split("\n"), delimiter=delimiter)
    try:
        for cells in reader:
            yield reader.line_num, cells
    except csv.Error as error:
        needed = "cells of text without quotation marks left open"
        wrong, hint = "the table cannot be read", "save it again as text with commas or semicolons"
        raise InputError(wrong, where=where, found=str(error), needed=needed, hint=hint) from error


def npz_arrays(content: bytes, where: str) -> dict[str, np.ndarray[Any, Any]]:
    """Return the arrays of numbers of a NumPy archive by name.

    Headers are read before anything is unpacked: the length that an array declares must be that of
    its entry. Only numbers and truth values are taken, no text and no objects.
    """
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            entries = archive.infolist()
            unpacked, most = sum(e.file_size for e in entries), unpacked_limit_bytes(len(content))
            if unpacked > most:
                raise ValueError(f"{unpacked} bytes unpacked, and {most:.4g} at most are read")
            for entry in entries:
                # others ask for gigabytes before they unpack a byte
                if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                    raise ValueError("compressed in another way than by numpy.savez")
                with archive.open(entry) as stream:
                    arrays[entry.filename.removesuffix(".npy")] = npy_array(stream, entry.file_size)
    except DAMAGE as error:
        raise InputError(
            "this is not a NumPy archive of numbers",
            where=where,
            found=" ".join(f"{type(error).__name__}: {error}".split())[:200],
            needed="a file of numpy.savez that holds arrays of numbers",
            hint="save it anew with numpy.savez, arrays of numbers alone",
        ) from error
    return arrays


def npy_array(stream: Any, n_bytes: int) -> np.ndarray[Any, Any]:
    """Return the array of an NPY file of so many bytes, header included."""
    version = np.lib.format.read_magic(stream)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"version {version} of the format of arrays")
    read = np.lib.format.read_array_header_1_0
    shape, by_columns, dtype = (read if version == (1, 0) else np.lib.format.read_array_header_2_0)(
        stream, max_header_size=int(limit("header_bytes"))
    )
    if dtype.kind not in "biufc":
        raise ValueError(f"an array of type {dtype}, which is no number")
    size = math.prod(shape)
    if size < 0 or min(shape, default=0) < 0 or size * dtype.itemsize != n_bytes - stream.tell():
        raise ValueError(f"an array of shape {shape} in {n_bytes} bytes")
    values = np.frombuffer(stream.read(size * dtype.itemsize), dtype)
    return values.reshape(shape, order="F" if by_columns else "C").copy()


@contextlib.contextmanager
def quiet(*loggers: str) -> Iterator[None]:
    """Keep what libraries log, warn or print about a damaged file off the terminal."""
    chosen: Iterable[logging.Logger] = [logging.getLogger(name) for name in loggers]
    before = [logger.disabled for logger in chosen]
    for logger in chosen:
        logger.disabled = True
    try:
        with (
            warnings.catch_warnings(),
            contextlib.redirect_stderr(io.StringIO()),
            np.errstate(all="ignore"),
        ):
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, state in zip(chosen, before, strict=True):
            logger.disabled = state
