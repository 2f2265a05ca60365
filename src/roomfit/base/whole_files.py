"""Files and output folders that are whole or absent.

Each is written under another name and renamed when it is complete, so that an interrupted run
leaves no half of one.
"""

from __future__ import annotations

import ctypes
import errno
import hashlib
import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import wraps
from glob import escape
from inspect import signature
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np

from roomfit.base.errors import FolderInUseError, InputError, StoreError

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

CONTENT_DIGEST = "content_sha256"
# Within an output folder: the names of the result's own files.
_LIST = ".roomfit-files"

P = ParamSpec("P")
T = TypeVar("T")


def check_output_folder(path: Path, *, overwrite: bool = False) -> None:
    """Refuse a folder that results cannot go into, before the work and without making it."""
    path = Path(path)
    with _made(path):
        nearest = nearest_existing(path)
        filled = path.is_dir() and any(path.iterdir())
    if not nearest.is_dir():
        what, found = "the output folder is a file, or in one", f"{nearest} is a file"
        needed, hint = "a folder, or a name that is free", "choose another name"
        raise InputError(what, where=str(path), found=found, needed=needed, hint=hint)
    if filled and not overwrite:
        what = "the output folder exists and is not empty"
        needed = "a new or an empty folder, so that no earlier result is lost"
        hint = "choose another folder, or add --overwrite"
        raise InputError(what, where=str(path), found="files in it", needed=needed, hint=hint)
    if not os.access(nearest, os.W_OK | os.X_OK):
        what, found = "the output folder cannot be written to", f"no permission in {nearest}"
        raise StoreError(what, where=str(path), found=found, hint="choose another folder")


def check_place(out: Path, *, overwrite: bool) -> None:
    """Refuse to write a file where something else is, or where one is and may not be replaced."""
    needed, hint = "a new name, so that nothing is lost", "choose another name, or add --overwrite"
    if out.exists() and not out.is_file():
        what = "one file is written, and something else is in its place"
        found = "a folder" if out.is_dir() else "a device, a pipe or a socket"
        # a folder was meant, not a name that a folder has
        meant = out.is_dir() and not out.suffix
        hint = f"write --out {out / 'materials.txt'}" if meant else "choose another name"
    elif out.exists() and not overwrite:
        what, found = "the file to write exists", "a file of this name"
    elif not out.parent.is_dir():
        what, needed = "the folder of the file to write does not exist", "a folder that is there"
        found, hint, out = "no such folder", "make it first, or name another one", out.parent
    else:
        return
    raise InputError(what, where=str(out), found=found, needed=needed, hint=hint)


def make_folder(path: Path) -> None:
    """Make a folder where there is none; errors as of `check_output_folder`."""
    check_output_folder(path, overwrite=True)
    with _made(path):
        path.mkdir(parents=True, exist_ok=True)


def nearest_existing(path: Path) -> Path:
    """Return the path itself, or the nearest folder above it that exists."""
    return next((p for p in (path, *path.absolute().parents) if p.exists()), Path.cwd())


@contextmanager
def _made(path: Path) -> Iterator[None]:
    """Turn what the system says against a folder within the block into our error."""
    try:
        yield
    except OSError as error:
        what, needed = "the output folder cannot be made", "a folder in which files may be written"
        hint = "choose another place, or change who may write there"
        raise StoreError(
            what, where=str(path), found=error.strerror or str(error), needed=needed, hint=hint
        ) from error


def sole_writer(command: Callable[P, T]) -> Callable[P, T]:
    """Let a command run only while no other run writes into the folder that is its argument `out`.

    `FolderInUseError` otherwise. What killed runs have left behind is removed, and what one has
    moved away is put back.
    """
    wanted = signature(command)
    place = "out" if "out" in wanted.parameters else "folder"

    @wraps(command)
    def alone(*args: P.args, **kwargs: P.kwargs) -> T:
        path = Path(wanted.bind(*args, **kwargs).arguments[place]).resolve()
        parent = nearest_existing(path.parent)
        if not (parent.is_dir() and os.access(parent, os.W_OK | os.X_OK)):
            return command(*args, **kwargs)  # which refuses
        with locked(path):
            for old in parent.glob(f".{escape(path.name)}.old-????????"):
                if path.exists():
                    shutil.rmtree(old, ignore_errors=True)
                else:
                    old.rename(path)
            _remove_leftovers(parent, f".{path.name}.making-")
            return command(*args, **kwargs)

    return alone


@contextmanager
def locked(path: Path, wait_s: float = 1.0) -> Iterator[None]:
    """Hold a file, or a folder that may still be to be made, by a lock in a hidden file beside it.

    The system frees it when its process ends, however that comes about. `FolderInUseError` where
    another run has held it all the time that this one waited.
    """
    mark = hashlib.sha256(os.fsencode(path)).hexdigest()[:16]
    lock = nearest_existing(path.parent) / f".roomfit-{mark}.lock"
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)
    taken = None
    while taken is None:
        with _made(path):
            descriptor = os.open(lock, flags, 0o666)
            is_locked = _try_lock(descriptor, wait_s)
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(descriptor), lock.stat()):
                    taken = is_locked
        if taken is not True:
            os.close(descriptor)  # another's, or its last owner has just removed it
    if not taken:
        what, found = "another run is writing to this place", f"a run that holds {lock.name}"
        hint = "wait for it, end it, or choose another place"
        raise FolderInUseError(what, where=str(path), found=found, needed="one run", hint=hint)
    try:
        yield
    finally:
        # removed while it is held: whoever waits with the old file open looks again, and what has
        # its name after that may be the lock of another; Windows removes no open file
        if sys.platform == "win32":
            os.close(descriptor)
        with suppress(OSError):
            lock.unlink(missing_ok=True)
        if sys.platform != "win32":
            os.close(descriptor)


def _try_lock(descriptor: int, wait_s: float = 0.0) -> bool:
    """Return whether an open file, or on POSIX a folder, could be locked; True without locks."""
    until_s = time.monotonic() + wait_s
    while True:
        try:
            if sys.platform != "win32":
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            else:
                msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
            return True
        except OSError as error:
            is_free = error.errno not in (errno.EWOULDBLOCK, errno.EACCES, errno.EDEADLK)
            if is_free or time.monotonic() >= until_s:
                return is_free
            time.sleep(0.002)  # copies of a killed run hold its locks until they have died


@contextmanager
def whole_output_folder(path: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Give a folder to fill, which takes its final name when the block ends without an error.

    Until then it has a hidden name on the same disk. An error or an interruption within the block
    leaves nothing: neither the folder nor a changed file of an earlier one. With `overwrite`, the
    new folder and an earlier one change places in one step, so that either the old result is there
    or the new one, whole. The new one has a list of its files, ``.roomfit-files``; files that the
    earlier list names and this run did not write are gone, and all others stay.

    Where the system cannot exchange folders (Windows, some network disks), the old one is renamed
    first: a run that is killed between the two leaves it under a hidden name, and the next run puts
    it back. The current folder of the process, and a disk of its own, cannot be renamed: there
    files are replaced one by one.
    """
    check_output_folder(path, overwrite=overwrite)
    path = Path(path).resolve()
    parent = nearest_existing(path.parent)
    with _made(parent):
        aside = Path(tempfile.mkdtemp(prefix=f".{path.name}.making-", dir=parent))
    # locked as long as this process lives, by which `_remove_leftovers` knows dead ones
    descriptor = -1 if sys.platform == "win32" else os.open(aside, os.O_RDONLY)
    try:
        if descriptor >= 0:
            _try_lock(descriptor)
        yield aside
        try:
            written = sorted(p.relative_to(aside).as_posix() for p in aside.rglob("*"))
            (aside / _LIST).write_text(json.dumps(written), encoding="utf-8")
            _put_in_place(aside, path)
        except OSError as error:
            what = "the results cannot be put into the output folder"
            raise StoreError(what, where=str(path), found=str(error)) from error
    finally:
        shutil.rmtree(aside, ignore_errors=True)
        if descriptor >= 0:
            os.close(descriptor)


def _remove_leftovers(parent: Path, prefix: str) -> None:
    """Remove the hidden folders of runs that were killed; those of living ones are locked."""
    # Windows locks no folders
    for folder in () if sys.platform == "win32" else parent.glob(f"{escape(prefix)}????????"):
        with suppress(OSError):
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            if _try_lock(descriptor, wait_s=1.0):
                shutil.rmtree(folder, ignore_errors=True)
            os.close(descriptor)


def _put_in_place(aside: Path, path: Path) -> None:
    """Give a folder its final name; where one of that name exists, the two change places."""
    path.parent.mkdir(parents=True, exist_ok=True)
    _give_usual_permissions(aside, 0o777)
    if not path.exists():
        aside.rename(path)
        return
    try:
        earlier = set(json.loads((path / _LIST).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError, RecursionError):
        earlier = set()  # of another version, or no result at all: nothing is removed
    if Path.cwd().is_relative_to(path) or path.is_mount():
        written = {p.relative_to(aside) for p in aside.rglob("*") if p.is_file()}
        for own in sorted(written):
            (path / own).parent.mkdir(parents=True, exist_ok=True)
            (aside / own).replace(path / own)
        for stale in {Path(name) for name in earlier} - written:
            if (path / stale).is_file():
                (path / stale).unlink()
        return
    _carry_over(path, aside, earlier | {_LIST})
    shutil.copymode(path, aside)
    if not _exchange(aside, path):
        old = Path(tempfile.mkdtemp(prefix=f".{path.name}.old-", dir=path.parent))
        old.rmdir()
        path.rename(old)
        try:
            aside.rename(path)
        except OSError:
            old.rename(path)
            raise
        old.rename(aside)  # which is removed


def _carry_over(path: Path, aside: Path, earlier: set[str]) -> None:
    """Enter into the new folder what is not the result's, as further names of the same files."""
    for here, folders, files in os.walk(path):
        for name in (*folders, *files):
            source = Path(here, name)
            place = aside / source.relative_to(path)
            if source.relative_to(path).as_posix() in earlier:
                continue
            if place.exists():
                if name in folders and not place.is_dir():
                    what = "a folder is in the place of a file"
                    raise FileExistsError(errno.EEXIST, what, str(source))
                continue
            place.parent.mkdir(parents=True, exist_ok=True)
            if source.is_dir() and not source.is_symlink():
                place.mkdir()
                shutil.copystat(source, place)
                continue
            try:
                os.link(source, place, follow_symlinks=False)
            except (OSError, NotImplementedError):  # a disk without links
                shutil.copy2(source, place, follow_symlinks=False)


def _exchange(one: Path, other: Path) -> bool:
    """Let two folders change names in one step; return False where the system cannot."""
    names = (os.fsencode(one), os.fsencode(other))
    try:
        library = ctypes.CDLL(None, use_errno=True)
        if sys.platform == "darwin":
            return bool(library.renamex_np(*names, 2) == 0)  # RENAME_SWAP
        # AT_FDCWD and RENAME_EXCHANGE
        return bool(library.renameat2(-100, names[0], -100, names[1], 2) == 0)
    except (AttributeError, OSError, TypeError):
        return False


def write_bytes_atomically(path: Path, content: bytes) -> Path:
    """Write a file under another name and rename it: readers find the old file or the new one."""
    path = Path(path)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        aside = Path(name)
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(content)
                stream.flush()
                os.fsync(stream.fileno())
            _give_usual_permissions(aside, 0o666)
            aside.replace(path)
        finally:
            aside.unlink(missing_ok=True)
    except OSError as error:
        raise StoreError("a file cannot be written", where=str(path), found=str(error)) from error
    return path


def _give_usual_permissions(path: Path, most: int) -> None:
    """Give the permissions of any new file; temporary ones are readable by their owner only."""
    umask = os.umask(0)
    os.umask(umask)
    path.chmod(most & ~umask)


def write_text_atomically(path: Path, text: str) -> Path:
    """Write UTF-8, ? for bytes of names that are none; see `write_bytes_atomically`."""
    return write_bytes_atomically(path, text.encode(errors="replace"))


def write_json_atomically(path: Path, content: Mapping[str, Any]) -> Path:
    """Write `json_text` to a file, with `content_digest`; see `write_bytes_atomically`."""
    whole = {**content, CONTENT_DIGEST: content_digest(content)}
    return write_text_atomically(path, json_text(whole))


def content_digest(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of the JSON text, without spaces, of all but the digest itself."""
    rest = {key: value for key, value in content.items() if key != CONTENT_DIGEST}
    text = json.dumps(rest, separators=(",", ":"), default=_listed)
    return hashlib.sha256(text.encode()).hexdigest()


def json_text(content: Any) -> str:
    """Return JSON that any parser reads: unknown is None, never NaN; arrays become lists."""
    return json.dumps(content, indent=1, allow_nan=False, default=_listed) + "\n"


def _listed(value: object) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no form in JSON")
