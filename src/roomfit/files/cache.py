"""Intermediate results kept on disk by what they depend on, so that a killed run continues."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from roomfit.files.digests import code_digest, digest
from roomfit.files.records import BrokenRecordError, load_record, save_record, size_bytes
from roomfit.files.store import CACHE_FOLDER
from roomfit.findings import Finding

T = TypeVar("T")
DEFAULT_LIMIT_BYTES = 2 * 2**30
_SUFFIX = ".npz"


@dataclass(frozen=True, slots=True)
class Cache:
    """A folder for intermediate results; it is made when there is something to put in.

    Attributes
    ----------
    folder : Path
    limit_bytes : int
        The least recently used files go when all together take more. A result that alone is
        larger is not kept.
    """

    folder: Path
    limit_bytes: int = DEFAULT_LIMIT_BYTES


@dataclass(frozen=True, slots=True, eq=False)
class Cached(Generic[T]):
    """A value, whether it was found rather than computed, and what happened to the cache."""

    value: T
    found: bool
    findings: tuple[Finding, ...] = ()


def cache_of(output: Path, limit_bytes: int = DEFAULT_LIMIT_BYTES) -> Cache:
    """Return the cache that belongs to an output folder: a hidden folder within it."""
    return Cache(Path(output) / CACHE_FOLDER, limit_bytes)


def cached(
    cache: Cache | None,
    kind: str,
    key_parts: Sequence[object],
    compute: Callable[[], T],
    classes: Iterable[type],
) -> Cached[T]:
    """Return a value from the cache, or compute it and keep it.

    A cache only saves time: a file that is damaged is removed and computed anew, and a disk that
    is full or forbids writing leaves the value as good as it is. Both are told as findings.

    Parameters
    ----------
    cache : Cache or None
        None computes.
    kind : str
        What it is, in a word that can stand in a file name: "trace".
    key_parts : sequence
        All that decides the value, as `roomfit.files.digests.digest` takes it. The code of roomfit
        is added to it.
    compute : callable
        Returns a record, see `roomfit.files.records`; the same key must give the same bits.
    classes : iterable of type
        Dataclasses that the record is made of.
    """
    if cache is None:
        return Cached(compute(), found=False)
    path = cache.folder / f"{kind}-{digest(code_digest(), kind, *key_parts)[:40]}{_SUFFIX}"
    findings: tuple[Finding, ...] = ()
    try:
        value = load_record(path, classes)
    except FileNotFoundError:
        pass
    except BrokenRecordError:
        findings = (_damaged(kind, path),)
        _remove(path)
    else:
        _touch(path)
        return Cached(value, found=True)
    value = compute()
    return Cached(value, found=False, findings=(*findings, *_keep(cache, kind, path, value)))


def _keep(cache: Cache, kind: str, path: Path, value: object) -> tuple[Finding, ...]:
    """Write a value aside, make room, and rename; tell if the disk refuses."""
    if size_bytes(value) > cache.limit_bytes:
        return ()
    aside: Path | None = None
    try:
        cache.folder.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=cache.folder)
        os.close(handle)
        aside = Path(name)
        save_record(aside, value)
        with aside.open("rb") as stream:
            os.fsync(stream.fileno())
        _make_room(cache, aside)
        aside.replace(path)
    except OSError as error:
        return (
            Finding(
                "cache-not-written",
                "info",
                f"An intermediate result ({kind}) could not be kept: {error}. The answer is not "
                "affected; an interrupted run would begin this step again.",
                {"kind": kind},
            ),
        )
    finally:
        if aside is not None:
            _remove(aside)
    return ()


def _make_room(cache: Cache, newest: Path) -> None:
    """Remove the files that were not used for the longest time until the rest is within limits.

    What killed runs have left half-written is among them.
    """
    files = []
    for path in cache.folder.iterdir():
        try:
            told = path.stat()
        except FileNotFoundError:  # another run has just removed it
            continue
        if path.is_file():
            files.append((told.st_mtime_ns, told.st_size, path))
    total = sum(size for _, size, _ in files)
    for _, size, path in sorted(files):
        if total <= cache.limit_bytes:
            break
        if path != newest:
            _remove(path)
            total -= size


def _remove(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError:  # on a disk that is read-only: it is not used in any case
        return


def _touch(path: Path) -> None:
    try:
        os.utime(path)
    except OSError:
        return


def _damaged(kind: str, path: Path) -> Finding:
    return Finding(
        "cache-file-damaged",
        "info",
        f"An intermediate result ({kind}, {path.name}) was damaged or cut short; it was computed "
        "anew.",
        {"kind": kind, "file": path.name},
    )
