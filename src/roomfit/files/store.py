"""Writing that never leaves half a file: aside first, then renamed."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from roomfit.errors import InputError, StoreError

# Within an output folder: intermediate results of a run, see `roomfit.files.cache`.
CACHE_FOLDER = ".roomfit-cache"


def check_output_folder(path: Path, *, overwrite: bool = False) -> None:
    """Refuse a folder that results cannot go into, before the work and without making it.

    Raises
    ------
    InputError
        The folder exists and holds something other than the cache of an unfinished run, and
        `overwrite` is false; or a file is in its place.
    StoreError
        Nothing can be written there.
    """
    path = Path(path)
    try:
        nearest = _nearest_existing(path)
        filled = path.is_dir() and not _holds_only_cache(path)
    except OSError as error:
        raise _cannot_be_made(path, error) from error
    if not nearest.is_dir():
        raise InputError(
            "the output folder is a file" if nearest == path else "the output folder is in a file",
            where=str(path),
            found=None if nearest == path else f"{nearest} is a file",
            hint="choose another name",
        )
    if filled and not overwrite:
        raise InputError(
            "the output folder exists and is not empty",
            where=str(path),
            needed="a new or an empty folder, so that no earlier result is lost",
            hint="choose another folder, or add --overwrite",
        )
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise StoreError(
            "the output folder cannot be written to",
            where=str(path),
            found=f"no permission to write in {nearest}",
            hint="choose another folder",
        )


@contextmanager
def whole_output_folder(
    path: Path, *, overwrite: bool = False, own: Sequence[str] = ()
) -> Iterator[Path]:
    """Give a folder to fill, which takes its place and name when the block ends well.

    It is made aside, hidden, on the same disk. An error or an interruption within the block leaves
    nothing: neither the folder nor a changed file of an earlier one. With `overwrite`, files of the
    same name are replaced, those that an earlier run of the same command wrote and this one did
    not are removed, and all others stay, as does the cache.

    Parameters
    ----------
    path : Path
    overwrite : bool
    own : sequence of str
        Patterns of the names that the command writes, as in ``"decay_[0-9]*.png"``.

    Raises
    ------
    InputError, StoreError
        See `check_output_folder`.
    """
    path = Path(path)
    check_output_folder(path, overwrite=overwrite)
    try:
        aside = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=_nearest_existing(path.parent)))
    except OSError as error:
        raise _cannot_be_made(path, error) from error
    try:
        yield aside
        written = {p.name for p in aside.iterdir()}
        _put_in_place(aside, path)
        _remove_stale(path, own, written)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


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
        _give_usual_permissions(Path(aside), 0o666)
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


def _nearest_existing(path: Path) -> Path:
    """Return the path itself, or the nearest folder above it that exists."""
    return next((p for p in (path, *path.absolute().parents) if p.exists()), Path.cwd())


def _cannot_be_made(path: Path, error: OSError) -> StoreError:
    return StoreError("the output folder cannot be made", where=str(path), found=str(error))


def _give_usual_permissions(path: Path, most: int) -> None:
    """What is made aside, only its owner may read; give what any new file or folder gets."""
    umask = os.umask(0)
    os.umask(umask)
    path.chmod(most & ~umask)


def _holds_only_cache(path: Path) -> bool:
    return all(p.name == CACHE_FOLDER for p in path.iterdir())


def _put_in_place(aside: Path, path: Path) -> None:
    """Rename a folder; where there is one of that name, move every file into its place there."""
    if _renamed(aside, path):
        return
    try:
        for file in sorted(p for p in aside.rglob("*") if p.is_file()):
            place = path / file.relative_to(aside)
            place.parent.mkdir(parents=True, exist_ok=True)
            file.replace(place)
    except OSError as error:
        raise StoreError(
            "the results cannot be put into the output folder", where=str(path), found=str(error)
        ) from error


def _renamed(aside: Path, path: Path) -> bool:
    """Take a place that is free, or holds nothing but a cache, by one renaming if that is possible.

    Another run that finishes at the same moment may be quicker.
    """
    try:
        if path.exists():
            if not _holds_only_cache(path):
                return False
            if (path / CACHE_FOLDER).exists():
                (path / CACHE_FOLDER).rename(aside / CACHE_FOLDER)
            path.rmdir()
        path.parent.mkdir(parents=True, exist_ok=True)
        _give_usual_permissions(aside, 0o777)
        aside.rename(path)
    except OSError:
        return False
    return True


def _remove_stale(path: Path, own: Sequence[str], written: set[str]) -> None:
    """Remove what an earlier run wrote and this one did not, so that no answer is a mixture."""
    for pattern in own:
        for file in path.glob(pattern):
            if file.name not in written and file.is_file():
                file.unlink(missing_ok=True)
